"""Figures of a run, gathered while it goes: from every control tick, and peaks from every step of the plant; pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from stewart_drake.logs.metric_table import metrics_of
from stewart_drake.mechanics.kinematics import rotation_angle, rotation_matrix
from stewart_drake.safety import MONITORS, RAMP
from stewart_drake.sampling import steps_per

if TYPE_CHECKING:
    from stewart_drake.scenario import Scenario

INTEGRAL_TIME = 5.0
"""[s] when the paper looks at the integral states."""
SETTLING, SETTLING_SHARE = 3.0, 0.6
"""[s], and share of the run; the shorter of the two is left out at the start. It takes the best of the paper's weights
3 s to make up for a payload of 0.3 kg that nobody told it of."""
SHORTEST = 0.5
"""[s] of a run whose errors are compared with its motion: a loop that follows well settles in 0.1 s, a third of what is
then left out."""
WINDOW = 2.0
"""[s] over which an error is averaged, at least: half a slow breath. In less of a sine its peak would count."""
LEAST_MOTION = 0.003
"""Of the robot's characteristic length, 0.33 mm for the paper's: a smaller motion says nothing about an error. A load
moves a robot that follows well by that much: 0.3 kg that a PD does not know of by 0.23 mm, 5 N by up to 0.74 mm."""

_BOUNDED = ("rotation", "position", "loop_gap")


def pose_distance(pose: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angle (n,) [rad] and distance (n,) [m] between poses (n, 6)."""
    relative = rotation_matrix(pose[:, :3]) @ np.swapaxes(rotation_matrix(other[:, :3]), -1, -2)
    return rotation_angle(relative), np.linalg.norm(pose[:, 3:] - other[:, 3:], axis=1)


@dataclass(eq=False)
class Tally:
    """Sums over a run, gathered from its signals part by part; the parts may be of any length.

    Errors are true pose minus reference; *late* is the second half of the planned duration. What is public here is what
    the metrics of `metric_table` are made of.
    """

    scenario: Scenario
    """As run."""
    steps: int = 0
    """Rows; one for each step of the plant where `run` feeds it."""
    ticks: int = 0
    """Those of them at a tick of the controller; sums are over these."""
    late_steps: int = 0
    late_ticks: int = 0
    squares: np.ndarray = field(default_factory=partial(np.zeros, (2, 6)))
    """(2, 6) [rad^2, m^2] squared errors of the first and of the second half."""
    late_peaks: np.ndarray = field(default_factory=partial(np.zeros, 6))
    """(6,) [rad, m] largest errors of the second half, of all its rows."""
    late_norms: np.ndarray = field(default_factory=partial(np.zeros, 2))
    """(2,) [rad, m] largest length of the rotational and of the translational error likewise."""
    largest: dict[str, float] = field(default_factory=lambda: dict.fromkeys(_BOUNDED, 0.0))
    """Largest angle and distance from the reference while the controller was in charge [rad, m], and largest loop gap
    [m], of all rows."""
    torque_squares: np.ndarray = field(default_factory=partial(np.zeros, 2))
    """(2,) [(N m)^2] of all motors within their limits, by halves."""
    torque_peak: float = 0.0
    """[N m] of all rows."""
    torque_change: np.ndarray = field(default_factory=partial(np.zeros, 2))
    """Squared change of the torque asked for from one late tick to the next [(N m)^2], and how many."""
    at_limit: int = 0
    """Torques at the limit, of ticks and motors."""
    weights: np.ndarray | None = None
    """(2,) sum of omega_q and omega_r; None without them."""
    log_ratio: float = 0.0
    """Sum of the logarithm of their ratio."""
    finite: bool = True
    """Whether all numbers are."""
    gathered: dict[str, Any] = field(default_factory=dict)
    """By metrics with a `gather` of their own, see `metric_table.Metric`."""

    def __post_init__(self) -> None:
        scenario = self.scenario
        self._metrics = metrics_of(scenario)
        self._stride = steps_per("controller.period", scenario.controller.period, scenario.plant.time_step)
        self._monitors = MONITORS if scenario.safety is None else scenario.safety.monitor_names
        self._limit = scenario.controller.limit(scenario.robot)
        # A controller that limits the torque itself asks for the limit and no more.
        self._asks_for_more = scenario.controller.asks_for_more
        length = scenario.robot.characteristic_length
        self._scale = np.array([length] * 3 + [1.0] * 3)
        self._last_late: tuple[int, np.ndarray] | None = None
        self._saturated_at: float | None = None
        self._gap_at: float | None = None
        self._integral: list[float] | None = None
        self._last_time = -np.inf
        self._inside = dict.fromkeys(_BOUNDED, False)
        self._left: dict[str, dict[str, Any] | None] = dict.fromkeys(_BOUNDED)
        self._interventions = 0
        self._held: dict[str, Any] | None = None
        self._origin: np.ndarray | None = None
        # Ticks with the controller in charge, and there sums of reference and pose, and of their squares.
        self._motion, self._motion_ticks = np.zeros((2, 2, 6)), 0
        self._settled = min(SETTLING, SETTLING_SHARE * scenario.duration)
        windows = max(1, int((scenario.duration - self._settled) / WINDOW + 1e-9))
        self._window = (scenario.duration - self._settled) / windows
        # Squared errors [m^2] of each window, and their number.
        self._window_squares, self._window_ticks = np.zeros(windows), np.zeros(windows)

    def add(self, signals: Mapping[str, np.ndarray]) -> None:
        """Takes in the next rows, named as in a log; rows between two ticks count for peaks and bounds alone."""
        time = signals["time"]
        if not len(time):
            return
        with np.errstate(all="ignore"):
            step = np.rint(time / self.scenario.plant.time_step).astype(np.int64)
            tick = step % self._stride == 0
            late = time >= 0.5 * self.scenario.duration - 1e-9
            level = signals["safety"][:, 0].astype(int) if "safety" in signals else np.zeros(len(time), dtype=int)
            in_charge = level < RAMP
            self._add_error(signals["pose"] - signals["reference"], tick, late)
            self._add_torque(signals, time, tick, late)
            self._add_torque_change(signals["torque"][tick & late], step[tick & late] // self._stride)
            self._add_bounded(signals, time, in_charge)
            self._add_followed(time, signals["reference"], signals["pose"], tick & in_charge)
            self._add_weights(signals, tick)
            for metric in self._metrics:
                self.gathered[metric.name] = metric.gathered(self.gathered.get(metric.name), signals)
        self._add_interventions(signals, time)
        by_then = np.flatnonzero(tick & (time <= INTEGRAL_TIME + 1e-9))
        if len(by_then):
            self._integral = signals["integral"][by_then[-1]].tolist()
        self.finite = self.finite and all(bool(np.isfinite(values).all()) for values in signals.values())
        self.steps, self.ticks = self.steps + len(time), self.ticks + int(tick.sum())
        self.late_steps, self.late_ticks = self.late_steps + int(late.sum()), self.late_ticks + int((tick & late).sum())
        self._last_time = float(time[-1])

    def figures(self) -> dict[str, Any]:
        """Metrics so far, in plain values that may not be finite; None for what there is nothing to tell from.

        Returns:
            Those of `metric_table.metrics_of`, and events: when and where, for `outcomes.judge`.
        """
        with np.errstate(all="ignore"):
            figures = {metric.name: metric.value(self) for metric in self._metrics}
        bounds = self.scenario.bounds
        never = {
            name: {"time": 0.0, "worst": self.largest[name], "leg": None}
            for name in _BOUNDED
            if self.steps and getattr(bounds, name) is not None and not self._inside[name]
        }
        worst = self._worst_window()
        figures["events"] = {
            "left": {**self._left, **never},
            "interventions": self._interventions,
            "held": self._held,
            "saturated_at": self._saturated_at,
            "gap_at": self._gap_at,
            "worst_window": worst and list(worst[1:]),
        }
        return figures

    @property
    def late_rms(self) -> np.ndarray:
        """(6,) [rad, m] root mean square error of the second half."""
        return np.sqrt(self.squares[1] / self.late_ticks)

    @property
    def late_rms_norms(self) -> np.ndarray:
        """(2,) [rad, m] root mean square length of the rotational and of the translational error likewise."""
        return np.linalg.norm(self.late_rms.reshape(2, 3), axis=1)

    @property
    def worst_half_rms(self) -> np.ndarray:
        """(2,) [rad, m] the larger of both halves' root mean square length."""
        counts = np.array([max(1, self.ticks - self.late_ticks), self.late_ticks])
        sums: np.ndarray = self.squares.reshape(2, 2, 3).sum(axis=2)
        return np.sqrt(sums / counts[:, None]).max(axis=0)

    @property
    def integral(self) -> list[float] | None:
        """[6] [rad s, m s] integral states at `INTEGRAL_TIME`; None where the run ended earlier."""
        return self._integral if self._last_time >= INTEGRAL_TIME - 1e-9 else None

    @property
    def motion_ratio(self) -> float | None:
        """Size of the platform's motion over that of its reference; None for a motion that is small."""
        wanted, made = self._motion_sizes()
        return made / wanted if wanted else None

    @property
    def error_ratio(self) -> float | None:
        """RMS error of the worst window over the size of the motion; None for a small motion or a run below `SHORTEST`.

        Errors are those after `SETTLING`, over windows of `WINDOW` or a little more; the motion is that of the whole
        run, for windows in which the reference rests as for others. Rotations count times the characteristic length.
        """
        wanted, _ = self._motion_sizes()
        worst = self._worst_window()
        return worst[0] / wanted if wanted and worst and self.scenario.duration >= SHORTEST else None

    def _motion_sizes(self) -> tuple[float, float]:
        """[m] RMS of reference and pose, each about its mean; a reference that moves by less than counts has 0."""
        mean, squares = self._motion.swapaxes(0, 1) / max(1, self._motion_ticks)
        wanted, made = map(float, np.sqrt(np.maximum(0.0, squares - mean * mean).sum(axis=1)))
        return (0.0 if wanted <= LEAST_MOTION * self.scenario.robot.characteristic_length else wanted), made

    def _worst_window(self) -> tuple[float, float, float] | None:
        """Its RMS error [m], and its begin and end [s]; None before the first."""
        if not self._window_ticks.any():
            return None
        errors = np.sqrt(self._window_squares / np.maximum(1.0, self._window_ticks))
        worst = int(errors.argmax())
        begin = self._settled + worst * self._window
        return float(errors[worst]), begin, begin + self._window

    def _add_error(self, error: np.ndarray, tick: np.ndarray, late: np.ndarray) -> None:
        self.squares += [np.sum(error[tick & half] ** 2, axis=0) for half in (~late, late)]
        if late.any():
            self.late_peaks = np.maximum(self.late_peaks, np.abs(error[late]).max(axis=0))
            lengths = np.linalg.norm(error[late].reshape(-1, 2, 3), axis=2)
            self.late_norms = np.maximum(self.late_norms, lengths.max(axis=0))

    def _add_torque(
        self, signals: Mapping[str, np.ndarray], time: np.ndarray, tick: np.ndarray, late: np.ndarray
    ) -> None:
        applied = signals["torque_applied"]
        self.torque_squares += [np.sum(applied[tick & half] ** 2) for half in (~late, late)]
        self.torque_peak = float(np.maximum(self.torque_peak, np.abs(applied).max()))
        size = np.abs(signals["torque"])
        full = (size > self._limit if self._asks_for_more else size >= self._limit) & tick[:, None]
        self.at_limit += int(full.sum())
        if self._saturated_at is None and full.any():
            self._saturated_at = float(time[int(full.any(axis=1).argmax())])

    def _add_torque_change(self, torque: np.ndarray, number: np.ndarray) -> None:
        """Of ticks whose `number` follows that of the one before: a log may have but every tenth."""
        limit = self.scenario.robot.effort_limits
        torque = np.clip(torque, -limit, limit)
        if self._last_late is not None:
            number, torque = np.append(self._last_late[0], number), np.vstack([self._last_late[1], torque])
        if len(number):
            self._last_late = int(number[-1]), torque[-1]
        change = np.diff(torque, axis=0)[np.diff(number) == 1]
        self.torque_change += np.sum(change**2), change.size

    def _add_bounded(self, signals: Mapping[str, np.ndarray], time: np.ndarray, in_charge: np.ndarray) -> None:
        gap = signals["loop_gap"]
        sizes = dict(
            zip(_BOUNDED, (*pose_distance(signals["pose"], signals["reference"]), gap.max(axis=1)), strict=True)
        )
        if not sizes["loop_gap"].max() <= self.largest["loop_gap"]:
            self._gap_at = float(time[int(sizes["loop_gap"].argmax())])
        for name, size in sizes.items():
            counts = np.ones(len(time), dtype=bool) if name == "loop_gap" else in_charge
            if counts.any():
                self.largest[name] = float(np.maximum(self.largest[name], size[counts].max()))
            bound = getattr(self.scenario.bounds, name)
            if bound is None:
                continue
            inside = size <= bound
            entered = self._inside[name] | np.logical_or.accumulate(inside)
            self._inside[name] = bool(entered[-1])
            left = entered & ~inside & in_charge
            event = self._left[name]
            if event is None and left.any():
                row = int(left.argmax())
                leg = int(gap[row].argmax()) if name == "loop_gap" else None
                event = self._left[name] = {"time": float(time[row]), "leg": leg}
            if event is not None:
                event["worst"] = self.largest[name]

    def _add_followed(self, time: np.ndarray, reference: np.ndarray, pose: np.ndarray, counts: np.ndarray) -> None:
        if self._origin is None:
            self._origin = reference[0].copy()
        each = self._scale * np.stack([reference - self._origin, pose - self._origin])[:, counts]
        self._motion += np.stack([each.sum(axis=1), (each * each).sum(axis=1)], axis=1)
        self._motion_ticks += int(counts.sum())
        counts = counts & (time >= self._settled - 1e-9)
        window = ((time[counts] - self._settled) / self._window + 1e-9).astype(np.int64)
        window = np.minimum(window, len(self._window_ticks) - 1)
        # One after the other, so that the parts in which rows come do not matter.
        np.add.at(self._window_squares, window, np.sum((self._scale * (pose - reference))[counts] ** 2, axis=1))
        np.add.at(self._window_ticks, window, 1.0)

    def _add_interventions(self, signals: Mapping[str, np.ndarray], time: np.ndarray) -> None:
        """How often the safety layer took over, and since when, by whom and where it has now."""
        if "safety" not in signals:
            return
        taken = signals["safety"][:, 0] > 0.0
        begins = np.flatnonzero(taken & ~np.append(self._held is not None, taken[:-1]))
        self._interventions += len(begins)
        if not taken[-1]:
            self._held = None
        elif len(begins):
            _, monitor, leg = signals["safety"][begins[-1]]
            where = int(leg) if leg >= 0.0 else None
            self._held = {"monitor": self._monitors[int(monitor)], "time": float(time[begins[-1]]), "leg": where}

    def _add_weights(self, signals: Mapping[str, np.ndarray], tick: np.ndarray) -> None:
        if "weights" in signals and tick.any():
            weights = signals["weights"][tick]
            self.weights = weights.sum(axis=0) + (0.0 if self.weights is None else self.weights)
            self.log_ratio += float(np.sum(np.log(weights[:, 0] / weights[:, 1])))
