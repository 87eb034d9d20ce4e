"""Rows of a run, one for each step of the plant, and what its metrics and its outcome are made of; pure."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

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


def pose_distance(pose: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angle (n,) [rad] and distance (n,) [m] between poses (n, 6)."""
    relative = rotation_matrix(pose[:, :3]) @ np.swapaxes(rotation_matrix(other[:, :3]), -1, -2)
    return rotation_angle(relative), np.linalg.norm(pose[:, 3:] - other[:, 3:], axis=1)


class RunRows:
    """Signals of a run, `rows["pose"]` and so on, with masks over them; errors are true pose minus reference.

    Attributes:
        scenario: As run.
        time: (n,) [s].
        tick: (n,) whether the controller ticked.
        late: (n,) whether in the second half of the planned duration.
        late_tick: (n,) both.
        steps, ticks, late_steps, late_ticks: How many rows there are of each.
        in_charge: (n,) whether the controller was, and not the safety layer.
        error: (n, 6) [rad, m].
    """

    def __init__(self, scenario: Scenario, signals: Mapping[str, np.ndarray]) -> None:
        self.scenario, self.signals, self.time = scenario, signals, signals.get("time", np.empty(0))
        step = np.rint(self.time / scenario.plant.time_step).astype(np.int64)
        stride = steps_per("controller.period", scenario.controller.period, scenario.plant.time_step)
        self.tick, self._number = step % stride == 0, step // stride
        self.late = self.time >= 0.5 * scenario.duration - 1e-9
        self.late_tick = self.late & self.tick
        self.steps, self.ticks = len(self.time), int(self.tick.sum())
        self.late_steps, self.late_ticks = int(self.late.sum()), int(self.late_tick.sum())
        self._level = signals["safety"][:, 0] if "safety" in signals else np.zeros(len(self.time))
        self.in_charge = self._level < RAMP
        self.error = signals["pose"] - signals["reference"] if len(self.time) else np.empty((0, 6))

    def __getitem__(self, name: str) -> np.ndarray:
        """A signal."""
        return self.signals[name]

    @property
    def late_rms(self) -> np.ndarray:
        """(6,) [rad, m] root mean square error of the second half."""
        return np.sqrt(np.mean(self.error[self.late_tick] ** 2, axis=0))

    @property
    def late_rms_norms(self) -> np.ndarray:
        """(2,) [rad, m] root mean square length of the rotational and of the translational error likewise."""
        return np.linalg.norm(self.late_rms.reshape(2, 3), axis=1)

    @property
    def worst_half_rms(self) -> np.ndarray:
        """(2,) [rad, m] the larger of both halves' root mean square length."""
        lengths = [np.sum(self.error[half] ** 2, axis=0) for half in (self.tick & ~self.late, self.late_tick)]
        counts = np.array([max(1, self.ticks - self.late_ticks), self.late_ticks])
        means: np.ndarray = np.reshape(lengths, (2, 2, 3)).sum(axis=2) / counts[:, None]
        return np.sqrt(means).max(axis=0)

    @property
    def late_peaks(self) -> np.ndarray:
        """(6,) [rad, m] largest error of the second half."""
        return np.abs(self.error[self.late]).max(axis=0)

    @property
    def late_norms(self) -> np.ndarray:
        """(2,) [rad, m] largest length of the rotational and of the translational error of the second half."""
        return np.linalg.norm(self.error[self.late].reshape(-1, 2, 3), axis=2).max(axis=0)

    @cached_property
    def sizes(self) -> dict[str, np.ndarray]:
        """Angle and distance from the reference and largest loop gap (n,) [rad, m, m], by the bounds on them."""
        rotation, position = pose_distance(self["pose"], self["reference"])
        return {"rotation": rotation, "position": position, "loop_gap": self["loop_gap"].max(axis=1)}

    @cached_property
    def largest(self) -> dict[str, float]:
        """The largest of each of `sizes`; of the first two while the controller was in charge."""
        counted = {name: size if name == "loop_gap" else size[self.in_charge] for name, size in self.sizes.items()}
        return {name: float(size.max(initial=0.0)) for name, size in counted.items()}

    def left(self) -> dict[str, dict[str, Any]]:
        """Bounds that were left while the controller was in charge: time, leg and the largest size of each.

        A run that starts outside has to come inside once; one that never did left at its start.
        """
        found: dict[str, dict[str, Any]] = {}
        for name, size in self.sizes.items() if self.steps else ():
            bound = getattr(self.scenario.bounds, name)
            if bound is None:
                continue
            entered = np.logical_or.accumulate(size <= bound)
            outside = entered & ~(size <= bound) & self.in_charge
            if outside.any():
                row = int(outside.argmax())
                leg = int(self["loop_gap"][row].argmax()) if name == "loop_gap" else None
                found[name] = {"time": float(self.time[row]), "leg": leg, "worst": self.largest[name]}
            elif not entered[-1]:
                found[name] = {"time": 0.0, "leg": None, "worst": self.largest[name]}
        return found

    @cached_property
    def at_limit(self) -> np.ndarray:
        """(n, 6) whether a torque is at its limit, at ticks."""
        size, limit = np.abs(self["torque"]), self.scenario.controller.limit(self.scenario.robot)
        # A controller that limits the torque itself asks for the limit and no more.
        full = size > limit if self.scenario.controller.asks_for_more else size >= limit
        return full & self.tick[:, None]

    @property
    def torque_change(self) -> float | None:
        """[N m] RMS of the torque asked for, within the limits, from a late tick to the next; None without such."""
        limit = self.scenario.robot.effort_limits
        torque = np.clip(self["torque"][self.late_tick], -limit, limit)
        change = np.diff(torque, axis=0)[np.diff(self._number[self.late_tick]) == 1]
        return float(np.sqrt(np.mean(change**2))) if change.size else None

    @property
    def integral(self) -> list[float] | None:
        """[6] [rad s, m s] integral states at `INTEGRAL_TIME`; None where the run ended earlier."""
        if self.time[-1] < INTEGRAL_TIME - 1e-9:
            return None
        row = np.flatnonzero(self.tick & (self.time <= INTEGRAL_TIME + 1e-9))[-1]
        return self["integral"][row].tolist()

    @cached_property
    def motion_sizes(self) -> tuple[float, float]:
        """[m] RMS of reference and pose, each about its mean; a reference that moves by less than counts has 0."""
        counts = self.tick & self.in_charge
        if not counts.any():
            return 0.0, 0.0
        origin = self["reference"][0]
        wanted, made = (
            float(np.sqrt(np.var(self._scale * (self[name][counts] - origin), axis=0).sum()))
            for name in ("reference", "pose")
        )
        return (0.0 if wanted <= LEAST_MOTION * self.scenario.robot.characteristic_length else wanted), made

    @property
    def motion_ratio(self) -> float | None:
        """Size of the platform's motion over that of its reference; None for a motion that is small."""
        wanted, made = self.motion_sizes
        return made / wanted if wanted else None

    @cached_property
    def worst_window(self) -> tuple[float, float, float] | None:
        """RMS error [m] of the worst window after `SETTLING`, and its begin and end [s]; None before the first.

        Windows last `WINDOW` or a little more. Rotations count times the characteristic length.
        """
        duration = self.scenario.duration
        settled = min(SETTLING, SETTLING_SHARE * duration)
        count = max(1, int((duration - settled) / WINDOW + 1e-9))
        length = (duration - settled) / count
        counts = self.tick & self.in_charge & (self.time >= settled - 1e-9)
        if not counts.any():
            return None
        window = np.minimum(((self.time[counts] - settled) / length + 1e-9).astype(np.int64), count - 1)
        squares = np.sum((self._scale * self.error[counts]) ** 2, axis=1)
        ticks = np.bincount(window, minlength=count)
        errors = np.sqrt(np.bincount(window, squares, count) / np.maximum(1, ticks))
        worst = int(errors.argmax())
        return float(errors[worst]), settled + worst * length, settled + (worst + 1) * length

    @property
    def error_ratio(self) -> float | None:
        """Error of the worst window over the size of the whole motion; None for a small motion or a run too short."""
        wanted, worst = self.motion_sizes[0], self.worst_window
        too_short = self.scenario.duration < SHORTEST
        return None if not wanted or worst is None or too_short else worst[0] / wanted

    def interventions(self) -> tuple[int, dict[str, Any] | None]:
        """How often the safety layer took over; and since when, by whom and where it has now, or None."""
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

    @property
    def _scale(self) -> np.ndarray:
        length = self.scenario.robot.characteristic_length
        return np.array([length] * 3 + [1.0] * 3)
