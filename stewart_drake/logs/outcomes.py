"""The rows of a run, one per step of the plant, and the outcome and warnings computed from them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from stewart_drake.base.atomic_files import Document
from stewart_drake.base.config import did_you_mean
from stewart_drake.base.errors import ConfigurationError, RunFailure, SafetyStop, StewartDrakeError
from stewart_drake.base.sampling import steps_per
from stewart_drake.logs.ball_metrics import needed_friction
from stewart_drake.mechanics.ball import BALL_FELL
from stewart_drake.mechanics.kinematics import inverse_kinematics, rotation_angle, rotation_matrix
from stewart_drake.safety import MONITORS, RAMP, first_standstill, standstill_text
from stewart_drake.scenario.limits import LimitMargin, longest_excursion

if TYPE_CHECKING:
    from stewart_drake.scenario.scenario import Scenario

Status = Literal["completed", "stopped", "lost", "failed", "interrupted", "unknown"]
"""How a run ended, see `OUTCOMES`."""
OUTCOMES: Mapping[str, str] = {
    "completed": "The controller was in charge to the end, and the motion was followed.",
    "stopped": "The safety layer held the robot at the end, or until its time limit. The message names the monitor, "
    "the time and the leg.",
    "lost": "The controller was in charge, but the motion was not followed: a bound was exceeded, a rod left its joint "
    "in the simulation, a crank or the platform did not move, its error was larger than the motion, no command "
    "reached the motors, or a ball fell off the platform.",
    "failed": "The run ended early: an error in a tick, in Drake or in a user's controller; or the safety layer gave "
    "up and switched the motors off. In a study also where the worker process died.",
    "interrupted": "Ctrl-C, SIGTERM or SIGHUP ended it.",
    "unknown": "The log is from a file that does not say how the run ended.",
    "rejected": "In a study: the run was refused before it began. The message says why.",
    "raised": "In a study: any other error. The reason names it.",
}
"""Meaning of the status of a run; the last two occur only in rows of studies."""

SETTLING, SETTLING_SHARE = 3.0, 0.6  # [s], share of the run; the shorter of both is left out at the start.
SHORTEST = 0.5  # [s] Errors of shorter runs are not compared with the motion.
WINDOW = 2.0  # [s] Least length of a window for RMS values, half a slow breath.
LEAST_MOTION = 0.003  # Motion over the characteristic length: 0.33 mm for the paper's robot. A load moves it as much.
MUCH_SATURATION = 0.01  # Share of torques at the limit, for a warning.
POORLY_FOLLOWED = 0.5  # Error over motion of a completed run, for a warning.
LARGE_GAP = 0.1  # Loop gap over the RMSE of the position, for a warning: the error may depend on the time step.
RIPPLE = 2.0  # [Hz] Velocity errors of higher frequencies are ripple.
RIPPLE_PERIODS = 4.0  # Least number of periods of that frequency in the second half.
NOISES = 3.0  # Standard deviations of a reading, added to the allowed error of a robot that holds its pose.
AT_REST = 1e-6  # Rate over the largest rate of a motion, below which the motion rests.
EXCURSION = 10.0  # Peak over RMS of the allowed error of a robot that holds its pose.
CHECK_PERIOD = 0.005  # [s] between poses that are checked against the limits.
MAX_CHECKS = 100_000  # Poses of a run that are checked at most.
REST_SHARE = 0.25  # Of the run after the end of the motion, for a warning.
CUT_RATIO = 2.0  # Duration of the motion over that of the run, for a warning.


def pose_distance(pose: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angle (n,) [rad] and distance (n,) [m] between poses (n, 6)."""
    relative = rotation_matrix(pose[:, :3]) @ np.swapaxes(rotation_matrix(other[:, :3]), -1, -2)
    return rotation_angle(relative), np.linalg.norm(pose[:, 3:] - other[:, 3:], axis=1)


def is_measured(signals: Mapping[str, np.ndarray]) -> bool:
    """Whether the pose of a log was measured or simulated, and not computed from commands of a machine."""
    if "crank_angle" in signals or "measured_pose" in signals or "reading" not in signals:
        return True
    return bool(np.isfinite(signals["reading"]).any())


class MissingSignal(ConfigurationError, KeyError):
    """The log has no signal of this name."""

    def __init__(self, name: str, signals: Iterable[str]) -> None:
        super().__init__("log", ", ".join(signals), f"one with the signal {name}{did_you_mean(name, signals)}")

    __str__ = Exception.__str__


class RunRows:
    """Signals of a run by name, `rows["pose"]`, with masks of rows; errors are true pose minus reference.

    Attributes:
        time: (n,) [s].
        tick: (n,) mask of the rows at control ticks.
        tick_number: (n,) number of the latest tick.
        second_half, second_half_tick: (n,) masks of the second half of the planned duration, and of its ticks.
        in_charge: (n,) mask of the rows in which the controller is in charge, not the safety layer.
        steps, ticks, second_half_steps, second_half_ticks: Numbers of rows.
    """

    def __init__(self, scenario: Scenario, signals: Mapping[str, np.ndarray]) -> None:
        self.scenario, self.signals, self.time = scenario, signals, signals.get("time", np.empty(0))
        step = np.rint(self.time / scenario.plant.time_step).astype(np.int64)
        stride = steps_per("controller.period", scenario.controller.period, scenario.plant.time_step)
        self.tick, self.tick_number = step % stride == 0, step // stride
        if not np.allclose(self.time, step * scenario.plant.time_step, rtol=0.0, atol=1e-6):
            # On a machine every row is a tick, and ticks vary in length.
            self.tick, self.tick_number = np.ones(len(self.time), bool), np.arange(len(self.time))
        self.second_half = self.time >= 0.5 * scenario.duration - 1e-9
        self.second_half_tick = self.second_half & self.tick
        self.steps, self.ticks = len(self.time), int(self.tick.sum())
        self.second_half_steps, self.second_half_ticks = int(self.second_half.sum()), int(self.second_half_tick.sum())
        self._level = signals["safety"][:, 0] if "safety" in signals else np.zeros(len(self.time))
        self.in_charge = self._level < RAMP
        self._scale = np.array([scenario.robot.characteristic_length] * 3 + [1.0] * 3)

    def __getitem__(self, name: str) -> np.ndarray:
        if name not in self.signals:
            raise MissingSignal(name, self.signals)
        return self.signals[name]

    @cached_property
    def error(self) -> np.ndarray:
        """(n, 6) [rad, m] true pose minus reference."""
        return self["pose"] - self["reference"] if self.steps else np.empty((0, 6))

    @property
    def second_half_rms(self) -> np.ndarray:
        """(6,) [rad, m] RMS error of the second half."""
        return self._rms(self.second_half_tick)

    @property
    def second_half_rms_norms(self) -> np.ndarray:
        """(2,) [rad, m] RMS length of the rotational and of the translational error of the second half."""
        return np.linalg.norm(self.second_half_rms.reshape(2, 3), axis=1)

    @property
    def worst_half_rms_norms(self) -> np.ndarray:
        """(2,) [rad, m] the same for the first or the second half, whichever is larger."""
        first = np.linalg.norm(self._rms(self.tick & ~self.second_half).reshape(2, 3), axis=1)
        return np.maximum(first, self.second_half_rms_norms)

    def _rms(self, rows: np.ndarray) -> np.ndarray:
        return np.sqrt(np.sum(self.error[rows] ** 2, axis=0) / max(1, np.count_nonzero(rows)))

    @property
    def ripple(self) -> np.ndarray | None:
        """(2,) [rad/s, m/s] RMS rotational and translational velocity errors above `RIPPLE` in the second half.

        From the spectrum of all rows in a Hann window, without the linear trend. None if the half is too short, or the
        rows are too far apart.
        """
        count, time = self.second_half_steps, self.time[self.second_half]
        period = float(time[-1] - time[0]) / (count - 1) if count > 1 else 0.0
        if count * period < (1.0 - 1e-9) * RIPPLE_PERIODS / RIPPLE or period > 0.25 / RIPPLE:
            return None
        error = (self["pose_rate"] - self["reference_rate"])[self.second_half]
        line = np.stack([np.ones(count), np.linspace(-1.0, 1.0, count)], axis=1)
        error = error - line @ np.linalg.lstsq(line, error, rcond=None)[0]
        window = np.hanning(count)[:, None]
        power = 2.0 * np.abs(np.fft.rfft(window * error, axis=0)) ** 2 / (count * np.sum(window**2))
        fast = power[np.fft.rfftfreq(count, period) >= RIPPLE].sum(axis=0)
        return np.sqrt(fast.reshape(2, 3).sum(axis=1))

    @cached_property
    def sizes(self) -> dict[str, np.ndarray]:
        """Angle and distance from the reference and largest loop gap, (n,) [rad, m, m]."""
        rotation, position = pose_distance(self["pose"], self["reference"])
        return {"rotation": rotation, "position": position, "loop_gap": self["loop_gap"].max(axis=1)}

    @cached_property
    def largest(self) -> dict[str, float]:
        """Maxima of `sizes`; those of angle and distance are while the controller was in charge."""
        counted = {name: size if name == "loop_gap" else size[self.in_charge] for name, size in self.sizes.items()}
        return {name: float(size.max(initial=0.0)) for name, size in counted.items()}

    @cached_property
    def at_limit(self) -> np.ndarray:
        """(n, 6) mask of torques at their limit, at ticks with the controller in charge."""
        limit, asked = self.scenario.robot.effort_limits, self.scenario.motors.torque_of(self.signals)
        if asked is None:
            return np.zeros((self.steps, 6), bool)
        # Controllers that limit their torques never exceed the limit.
        more = asked is self.signals.get("torque") and self.scenario.controller.asks_for_more
        full = np.abs(asked) > limit if more else np.abs(asked) >= limit
        return full & (self.tick & self.in_charge)[:, None]

    @property
    def saturated_share(self) -> float:
        """Share of the torques at ticks that are at their limit."""
        return int(self.at_limit.sum()) / (6 * self.ticks)

    @cached_property
    def motion_sizes(self) -> tuple[float, float]:
        """Sizes [m] of the reference's motion, 0 if negligible, and of the platform's motion.

        A size is the largest RMS about the mean in any window of at least `WINDOW`, with rotations times the
        characteristic length.
        """
        counts = self.tick & self.in_charge
        if not counts.any():
            return 0.0, 0.0
        wanted, made = (
            float(self._window_rms(counts, 0.0, self._about_mean(name, counts)).max()) for name in ("reference", "pose")
        )
        return (0.0 if wanted <= LEAST_MOTION * self._scale[0] else wanted), made

    @property
    def motion_ratio(self) -> float | None:
        """Size of the platform's motion over that of the reference; None if negligible."""
        wanted, made = self.motion_sizes
        return made / wanted if wanted else None

    @cached_property
    def worst_window(self) -> tuple[float, float, float] | None:
        """Largest ratio of RMS error to motion, and begin and end [s] of its window, or None.

        Windows after `SETTLING` are compared with the size of the motion; the whole run with the RMS of its motion plus
        the error at its start. None if the motion is negligible or the run too short.
        """
        size, counts = self.motion_sizes[0], self.tick & self.in_charge
        if not size or self.worst_error is None:
            return None
        rms, begin, end = self.worst_error
        error, motion = (
            float(np.sqrt(np.mean(np.sum(each**2, axis=1))))
            for each in (self._scale * self.error[counts], self._about_mean("reference", counts))
        )
        whole = error / (motion + float(np.linalg.norm(self._scale * self.error[0])))
        return (whole, 0.0, self.scenario.duration) if whole > rms / size else (rms / size, begin, end)

    @cached_property
    def worst_error(self) -> tuple[float, float, float] | None:
        """Largest RMS error [m] in a window after `SETTLING`, with its begin and end [s]; None if the run is short."""
        counts, duration = self.tick & self.in_charge, self.scenario.duration
        settled = min(SETTLING, SETTLING_SHARE * duration)
        late = counts & (self.time >= settled - 1e-9)
        if not late.any() or duration < SHORTEST:
            return None
        errors = self._window_rms(late, settled, self._scale * self.error[late])
        worst, length = int(errors.argmax()), (duration - settled) / len(errors)
        return float(errors[worst]), settled + worst * length, settled + (worst + 1) * length

    def poorly_held(self) -> tuple[float, float, str] | None:
        """Time [s], error [m] and text if a robot with a constant reference does not hold its pose; else None."""
        if self.worst_error is None or self.motion_sizes[0]:
            return None
        (rms, begin, end), noise = self.worst_error, self.scenario.sensors.reading_noise
        allowed = LEAST_MOTION * self._scale[0] + NOISES * noise * self.scenario.robot.crank_lengths.max()
        if not rms <= allowed:
            return begin, rms, f"from {begin:.4g} to {end:.4g} s the RMS error was {1e3 * rms:.2g} mm"
        off = np.linalg.norm(self._scale * self.error, axis=1) * self.in_charge
        row, bound = int(off.argmax()), off[0] + EXCURSION * allowed
        return (self.time[row], off[row], f"the error reached {1e3 * off[row]:.2g} mm") if off[row] > bound else None

    def wrong_length(self) -> tuple[float, float, str] | None:
        """Time [s], motion over run and text if the motion ends long before the run or is cut; else None.

        A stream may be quiet.
        """
        if getattr(self.scenario.reference, "kind", None) == "stream":
            return None
        moving, duration = np.abs(self["reference_rate"]).max(axis=1), self.scenario.duration
        end = getattr(self.scenario.reference, "end", 0.0)
        if end > CUT_RATIO * duration:
            return duration, end / duration, f"the recorded motion of {end:.4g} s is cut at {duration:.4g} s"
        end = self.time[np.flatnonzero(moving > AT_REST * moving.max())].max(initial=0.0)
        if 0.0 < end < (1.0 - REST_SHARE) * duration:
            return end, end / duration, f"the motion ends at {end:.4g} s; figures of the second half are mostly of rest"
        return None

    @cached_property
    def excursion(self) -> tuple[LimitMargin, float, float] | None:
        """Longest excursion of the motion from the scenario's limits, see `longest_excursion`; None without one."""
        rows, scenario = np.flatnonzero(self.tick), self.scenario
        rows = rows[:: max(1, round(CHECK_PERIOD / scenario.controller.period), len(rows) // MAX_CHECKS)]
        motion = self.time[rows], self["pose"][rows], self["pose_rate"][rows]
        return longest_excursion(scenario.robot, scenario.limits, *motion) if len(rows) else None

    @property
    def error_ratio(self) -> float | None:
        return None if self.worst_window is None else self.worst_window[0]

    def _about_mean(self, name: str, counts: np.ndarray) -> np.ndarray:
        """(n, 6) [m] a signal at some rows minus its mean, with rotations times the characteristic length."""
        values = self._scale * (self[name][counts] - self["reference"][0])
        return values - values.mean(axis=0)

    def _window_rms(self, counts: np.ndarray, begin: float, values: np.ndarray) -> np.ndarray:
        """RMS length of values (n, 6) at some rows, by equal windows from a time [s] to the end."""
        count = max(1, int((self.scenario.duration - begin) / WINDOW + 1e-9))
        length = (self.scenario.duration - begin) / count
        window = np.minimum(((self.time[counts] - begin) / length + 1e-9).astype(np.int64), count - 1)
        sums = np.bincount(window, np.sum(values**2, axis=1), count)
        return np.sqrt(sums / np.maximum(1, np.bincount(window, minlength=count)))

    def left(self) -> dict[str, tuple[float, int | None]]:
        """Bounds that were exceeded with the controller in charge -> time [s], and leg or None.

        A run may start outside of a bound; the time is 0 if it never came inside.
        """
        worst_of: dict[str, tuple[float, int | None]] = {}
        for name, size in self.sizes.items() if self.steps else ():
            bound = getattr(self.scenario.bounds, name)
            if bound is None:
                continue
            entered = np.logical_or.accumulate(size <= bound)
            outside = entered & ~(size <= bound) & self.in_charge
            if outside.any():
                row = int(outside.argmax())
                worst_of[name] = float(self.time[row]), int(self[name][row].argmax()) if name == "loop_gap" else None
            elif not entered[-1]:
                worst_of[name] = 0.0, None
        return worst_of

    def standstill(self) -> tuple[float, int | None] | None:
        """Time [s] and leg of the first crank at standstill while its reference moves; else None."""
        rows, robot = np.flatnonzero(self.tick & self.in_charge), self.scenario.robot
        try:
            cranks = inverse_kinematics(robot, self["pose"][rows])
        except StewartDrakeError:
            # A robot with open loops exceeds other bounds.
            return None
        found = first_standstill(robot, self.scenario.controller.period, cranks, self["reference"][rows])
        return None if found is None else (float(self.time[rows[found[0]]]), found[1])

    def interventions(self) -> tuple[int, Document | None]:
        """Number of times that the safety layer took over; monitor, time and leg if it is in charge at the end."""
        if "safety" not in self.signals or not self.steps:
            return 0, None
        taken = self._level > 0.0
        begins = np.flatnonzero(taken & ~np.append(False, taken[:-1]))
        if not taken[-1]:
            return len(begins), None
        monitors = MONITORS if self.scenario.safety is None else self.scenario.safety.monitor_names
        _, monitor, leg = self["safety"][begins[-1]]
        where = int(leg) if leg >= 0.0 else None
        return len(begins), {"monitor": monitors[int(monitor)], "time": float(self.time[begins[-1]]), "leg": where}


class Outcome(NamedTuple):
    """How a run ended; fields as in `SimulationLog`."""

    status: Status
    reason: str | None = None
    message: str | None = None
    outcome_time: float | None = None
    leg: int | None = None


def describe_outcome(status: str, reason: str | None, time: float | None = None) -> str:
    """Text on how a run ended, such as `failed, crank_dead_centre at t = 0.650 s`."""
    words = status if reason in (None, status) else f"{status}, {reason}"
    return words if time is None else f"{words} at t = {time:.3f} s"


def assess(
    rows: RunRows, trip: Document | None, end_time: float, ended_by: RunFailure | KeyboardInterrupt | None
) -> Outcome:
    """Outcome of a run, from its rows, the error that ended it, and the safety layer's first `trip`, or None."""
    if isinstance(ended_by, KeyboardInterrupt):
        return Outcome("interrupted", "interrupted", "stopped by the user", end_time)
    held = isinstance(ended_by, SafetyStop) and trip is not None and trip["last"] != "end"
    if ended_by is not None and ended_by.reason == BALL_FELL:
        return Outcome("lost", BALL_FELL, str(ended_by), end_time if ended_by.time is None else ended_by.time)
    if ended_by is not None and not held:
        when = end_time if ended_by.time is None else ended_by.time
        text = "\n".join(filter(None, (str(ended_by), ended_by.traceback)))
        return Outcome("failed", ended_by.reason, text, when, ended_by.leg)
    by = None if trip is None else trip["stopped"] or rows.interventions()[1]
    if trip is not None and by is not None:
        text = str(ended_by) if held else f"{by['monitor']}: {trip['last'].replace('_', ' ')} at the end of the run"
        return Outcome("stopped", by["monitor"], text, by["time"], by["leg"])
    since = rows.scenario.link.silent_since(rows.ticks, rows.scenario.controller.period)
    if since is not None and rows.ticks:
        return Outcome("lost", "link_silent", f"no command reached the motors from t = {since:.3f} s on", since)
    bounds, left = rows.scenario.bounds, rows.left()
    if left:
        name = min(left, key=lambda name: left[name][0])
        time, leg = left[name]
        scale, unit = (math.degrees(1.0), "deg") if name == "rotation" else (1e3, "mm")
        bound, worst = (f"{scale * value:.4g} {unit}" for value in (getattr(bounds, name), rows.largest[name]))
        what = "the loop gap exceeded" if name == "loop_gap" else f"the {name} error exceeded"
        text = f"{what} {bound} at t = {time:.3f} s; the largest was {worst}"
        return Outcome("lost", f"{name}_bound", text, time, leg)
    if bounds.motion_ratio is not None and (standstill := rows.standstill()) is not None:
        return Outcome("lost", "not_moving", standstill_text("not_moving", standstill[1]), *standstill)
    ratio = rows.motion_ratio
    if bounds.motion_ratio is not None and ratio is not None and not ratio >= bounds.motion_ratio:
        text = f"the platform moved by {ratio:.1%} of its reference's motion; bound {bounds.motion_ratio:.0%}"
        return Outcome("lost", "not_followed", text, end_time)
    ratio = rows.error_ratio
    if bounds.error_ratio is not None and ratio is not None and not ratio <= bounds.error_ratio:
        return Outcome("lost", "not_followed", f"{_error_over_motion(rows)}; bound {bounds.error_ratio:.3g}", end_time)
    return Outcome("completed")


def _error_over_motion(rows: RunRows) -> str:
    assert rows.worst_window is not None
    ratio, begin, end = rows.worst_window
    return f"from {begin:.4g} to {end:.4g} s the RMS error was {ratio:.3g} times the motion"


def _inertial_warnings(rows: RunRows) -> Iterator[tuple[str, float, float, str]]:
    """Name, time [s], number and text of warnings about the inertial sensor that the controller expects."""
    imu, sensor = rows.signals.get("imu"), rows.scenario.controller_model.imu
    if imu is None or sensor is None:
        return
    beyond = (np.abs(imu) >= sensor.by_channel("range") - sensor.quantum).any(axis=1)
    if beyond.any():
        text = f"{beyond.mean():.1%} of the inertial readings are at the end of the sensor's range"
        yield "imu_saturated", rows.time[int(beyond.argmax())], float(beyond.mean()), text
    told = np.concatenate([rows.time[:1], rows.time[np.isfinite(imu).all(axis=1)], rows.time[-1:]])
    longest = int(np.diff(told).argmax())
    if (gap := float(np.diff(told)[longest])) > sensor.longest_gap(rows.scenario.reading_period):
        yield "imu_silent", told[longest], gap, f"the inertial sensor gave no readings for {gap:.3g} s"


def find_warnings(status: Status, rows: RunRows, trip: Document | None) -> tuple[Document, ...]:
    """Warnings of a run: name, time [s], number and text."""
    events: list[tuple[str, float, float, str]] = []
    if rows.steps and not is_measured(rows.signals):
        text = "the machine does not tell its angles: the pose is that of its commands, and no error is known"
        return ({"name": "not_measured", "time": 0.0, "number": 1.0, "text": text},)
    if trip is not None and trip["last"] == "none":
        text = f"{trip['monitor']}, {trip['worst']}"
        events.append(("safety_intervention", trip["time"], rows.interventions()[0], text))
    if rows.steps:
        share = rows.saturated_share
        if share > MUCH_SATURATION:
            when = rows.time[int(rows.at_limit.any(axis=1).argmax())]
            events.append(("saturation", when, share, f"{share:.1%} of the torques are at their limit"))
        events += _inertial_warnings(rows)
        if (ball := rows.scenario.ball) is not None and (needed := needed_friction(rows) or 0.0) > ball.friction:
            text = (
                f"to roll, the ball needs a friction of {needed:.2g}, and ball.friction is {ball.friction:g}: it slips"
            )
            events.append(("ball_slips", 0.0, needed, text))
        gap, rmse = rows.largest["loop_gap"], rows.second_half_rms_norms[1] if rows.second_half_ticks else math.nan
        if gap > LARGE_GAP * rmse:
            ratio = float(gap / rmse) if rmse > 0.0 else math.inf
            when = rows.time[int(rows.sizes["loop_gap"].argmax())]
            size = f"{gap:.2g} m, {ratio:.0%} of the RMSE of the position"
            text = f"rods end off their joints by up to {size}: errors so small may depend on plant.time_step"
            events.append(("loop_gap", when, ratio, text))
        if rows.excursion is not None and status == "completed":
            margin, share, since = rows.excursion
            text = f"{margin.limit}: {margin.value:.4g} {margin.unit} at {margin.time:.4g} s, for {margin.allowed}"
            events.append(("beyond_limits", since, share, f"{text}; beyond it for {share:.1%} of the run"))
        for name, said in (("motion_length", rows.wrong_length()), ("poorly_held", rows.poorly_held())):
            if status == "completed" and said is not None:
                events.append((name, *said))
        worst = rows.worst_window
        if status == "completed" and worst is not None and not worst[0] <= POORLY_FOLLOWED:
            events.append(("poorly_followed", worst[1], worst[0], _error_over_motion(rows)))
    return tuple(
        {"name": name, "time": float(time), "number": number, "text": text} for name, time, number, text in events
    )
