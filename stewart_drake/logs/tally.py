"""Figures of a run, gathered while it goes: from every control tick, and peaks from every step of the plant; pure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from stewart_drake.mechanics.kinematics import rotation_angle, rotation_matrix
from stewart_drake.safety import MONITORS, RAMP
from stewart_drake.sampling import steps_per

if TYPE_CHECKING:
    from stewart_drake.scenario import Scenario

INTEGRAL_TIME = 5.0
"""[s] when the paper looks at the integral states."""
LEAST_MOTION = 2e-5
"""[m] RMS of a reference or of its error, rotations times the characteristic length, that counts as none."""

_BOUNDED = ("rotation", "position", "loop_gap")


class Tally:
    """Figures of a run from its signals, part by part; the parts may be of any length.

    Errors are true pose minus reference. RMSE and peaks are over the second half of the planned duration.

    Args:
        scenario: As run.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._stride = steps_per("controller.period", scenario.controller.period, scenario.plant.time_step)
        self._limit = scenario.controller.limit(scenario.robot)
        # A controller that limits the torque itself asks for the limit and no more.
        self._asks_for_more = scenario.controller.asks_for_more
        length = scenario.robot.characteristic_length
        self._scale = np.array([length] * 3 + [1.0] * 3)
        self._steps = self._ticks = self._late_ticks = self._late_steps = 0
        self._late_squares, self._late_peaks = np.zeros(6), np.zeros(6)
        self._late_norms = np.zeros(2)
        self._largest = dict.fromkeys(_BOUNDED, 0.0)
        self._torque_squares, self._torque_peak = 0.0, 0.0
        self._at_limit = 0
        self._saturated_at: float | None = None
        self._gap_at: float | None = None
        self._weights: np.ndarray | None = None
        self._log_ratio = 0.0
        self._integral: list[float] | None = None
        self._last_time = -np.inf
        self._finite = True
        self._inside = dict.fromkeys(_BOUNDED, False)
        self._left: dict[str, dict[str, Any] | None] = dict.fromkeys(_BOUNDED)
        self._interventions = 0
        self._held: dict[str, Any] | None = None
        self._origin: np.ndarray | None = None
        # Sums of reference, pose and error, and of their squares.
        self._motion, self._motion_ticks = np.zeros((3, 2, 6)), 0

    def add(self, signals: Mapping[str, np.ndarray]) -> None:
        """Takes in the next rows, named as in a log; rows between two ticks count for peaks and bounds alone."""
        time = signals["time"]
        if not len(time):
            return
        with np.errstate(all="ignore"):
            tick = np.rint(time / self._scenario.plant.time_step).astype(np.int64) % self._stride == 0
            late = time >= 0.5 * self._scenario.duration - 1e-9
            level = signals["safety"][:, 0].astype(int) if "safety" in signals else np.zeros(len(time), dtype=int)
            in_charge = level < RAMP
            self._add_error(signals["pose"] - signals["reference"], tick & late, late)
            self._add_torque(signals, time, tick)
            self._add_bounded(signals, time, in_charge)
            self._add_motion(signals["reference"], signals["pose"], tick & late & in_charge)
            self._add_weights(signals, tick)
        self._add_interventions(signals, time)
        by_then = np.flatnonzero(tick & (time <= INTEGRAL_TIME + 1e-9))
        if len(by_then):
            self._integral = signals["integral"][by_then[-1]].tolist()
        self._finite = self._finite and all(bool(np.isfinite(values).all()) for values in signals.values())
        self._steps, self._ticks = self._steps + len(time), self._ticks + int(tick.sum())
        self._last_time = float(time[-1])

    def figures(self) -> dict[str, Any]:
        """Figures so far, in plain values that may not be finite; None for what there is nothing to tell from.

        Returns:
            rmse_deg, rmse_mm, peak_deg, peak_mm [3]; rmse_norm_deg, rmse_norm_mm, peak_norm_deg, peak_norm_mm of the
            length of (roll, pitch, yaw) and of (X, Y, Z); error_max_deg, error_max_mm: largest angle and distance from
            the reference while the controller was in charge; motion_ratio: see `Bounds`; torque_rms, torque_peak
            [N m] within the motors' limits, over the whole run; saturated_fraction of torques at the limit;
            loop_gap_max_m; omega_q, omega_r: means; omega_ratio: geometric mean of their ratio; integral_at_5s [6]
            [rad s, m s]; finite: whether all numbers are; events: when and where, for `outcomes.judge`.
        """
        with np.errstate(all="ignore"):
            return self._figures()

    def _figures(self) -> dict[str, Any]:
        there, late = self._steps > 0, self._late_steps > 0
        rms = np.sqrt(self._late_squares / max(1, self._late_ticks))
        norms = np.linalg.norm(rms.reshape(2, 3), axis=1)
        peaks, scored = self._late_peaks, self._late_ticks > 0
        figures: dict[str, Any] = {
            "rmse_deg": np.degrees(rms[:3]).tolist() if scored else None,
            "rmse_mm": (1e3 * rms[3:]).tolist() if scored else None,
            "peak_deg": np.degrees(peaks[:3]).tolist() if late else None,
            "peak_mm": (1e3 * peaks[3:]).tolist() if late else None,
            "rmse_norm_deg": float(np.degrees(norms[0])) if scored else None,
            "rmse_norm_mm": float(1e3 * norms[1]) if scored else None,
            "peak_norm_deg": float(np.degrees(self._late_norms[0])) if late else None,
            "peak_norm_mm": float(1e3 * self._late_norms[1]) if late else None,
            "error_max_deg": float(np.degrees(self._largest["rotation"])) if there else None,
            "error_max_mm": 1e3 * self._largest["position"] if there else None,
            "motion_ratio": self._motion_ratio(),
            "torque_rms": float(np.sqrt(self._torque_squares / (6 * self._ticks))) if self._ticks else None,
            "torque_peak": self._torque_peak if there else None,
            "saturated_fraction": self._at_limit / (6 * self._ticks) if self._ticks else None,
            "loop_gap_max_m": self._largest["loop_gap"] if there else None,
        }
        mean = (None, None) if self._weights is None else (self._weights / self._ticks).tolist()
        figures["omega_q"], figures["omega_r"] = mean
        figures["omega_ratio"] = None if self._weights is None else float(np.exp(self._log_ratio / self._ticks))
        reached = self._last_time >= INTEGRAL_TIME - 1e-9
        figures["integral_at_5s"] = self._integral if reached else None
        figures["finite"] = self._finite
        bounds = self._scenario.bounds
        never = {
            name: {"time": 0.0, "worst": self._largest[name], "leg": None}
            for name in _BOUNDED
            if there and getattr(bounds, name) is not None and not self._inside[name]
        }
        figures["events"] = {
            "left": {**self._left, **never},
            "interventions": self._interventions,
            "held": self._held,
            "saturated_at": self._saturated_at,
            "gap_at": self._gap_at,
        }
        return figures

    def _add_error(self, error: np.ndarray, scored: np.ndarray, late: np.ndarray) -> None:
        self._late_squares += np.sum(error[scored] ** 2, axis=0)
        self._late_ticks += int(scored.sum())
        if late.any():
            self._late_steps += int(late.sum())
            self._late_peaks = np.maximum(self._late_peaks, np.abs(error[late]).max(axis=0))
            lengths = np.linalg.norm(error[late].reshape(-1, 2, 3), axis=2)
            self._late_norms = np.maximum(self._late_norms, lengths.max(axis=0))

    def _add_torque(self, signals: Mapping[str, np.ndarray], time: np.ndarray, tick: np.ndarray) -> None:
        applied = signals["torque_applied"]
        self._torque_squares += float(np.sum(applied[tick] ** 2))
        self._torque_peak = float(np.maximum(self._torque_peak, np.abs(applied).max()))
        size = np.abs(signals["torque"])
        full = (size > self._limit if self._asks_for_more else size >= self._limit) & tick[:, None]
        self._at_limit += int(full.sum())
        if self._saturated_at is None and full.any():
            self._saturated_at = float(time[int(full.any(axis=1).argmax())])

    def _add_bounded(self, signals: Mapping[str, np.ndarray], time: np.ndarray, in_charge: np.ndarray) -> None:
        pose, reference, gap = signals["pose"], signals["reference"], signals["loop_gap"]
        off = rotation_matrix(pose[:, :3]) @ np.swapaxes(rotation_matrix(reference[:, :3]), -1, -2)
        sizes = {
            "rotation": rotation_angle(off),
            "position": np.linalg.norm(pose[:, 3:] - reference[:, 3:], axis=1),
            "loop_gap": gap.max(axis=1),
        }
        if not sizes["loop_gap"].max() <= self._largest["loop_gap"]:
            self._gap_at = float(time[int(sizes["loop_gap"].argmax())])
        for name, size in sizes.items():
            counts = np.ones(len(time), dtype=bool) if name == "loop_gap" else in_charge
            if counts.any():
                self._largest[name] = float(np.maximum(self._largest[name], size[counts].max()))
            bound = getattr(self._scenario.bounds, name)
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
                event["worst"] = self._largest[name]

    def _add_motion(self, reference: np.ndarray, pose: np.ndarray, counts: np.ndarray) -> None:
        if self._origin is None:
            self._origin = reference[0].copy()
        each = self._scale * np.stack([reference - self._origin, pose - self._origin, pose - reference])[:, counts]
        self._motion += np.stack([each.sum(axis=1), (each * each).sum(axis=1)], axis=1)
        self._motion_ticks += int(counts.sum())

    def _motion_ratio(self) -> float | None:
        count = max(1, self._motion_ticks)
        sums, squares = self._motion[:, 0], self._motion[:, 1]
        wanted, made, error = np.sqrt(np.maximum(0.0, np.sum(squares - sums * sums / count, axis=1)) / count)
        # Where the error is as little as that there is nothing to tell, however little there was to follow.
        return None if min(wanted, error) <= LEAST_MOTION else float(made / wanted)

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
            self._held = {"monitor": MONITORS[int(monitor)], "time": float(time[begins[-1]]), "leg": where}

    def _add_weights(self, signals: Mapping[str, np.ndarray], tick: np.ndarray) -> None:
        if "weights" in signals and tick.any():
            weights = signals["weights"][tick]
            self._weights = weights.sum(axis=0) + (0.0 if self._weights is None else self._weights)
            self._log_ratio += float(np.sum(np.log(weights[:, 0] / weights[:, 1])))
