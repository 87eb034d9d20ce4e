"""Paths of a tool through given poses; roll, pitch and yaw are interpolated each by itself."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Literal

import numpy as np

from stewart_drake.errors import ConfigurationError
from stewart_drake.references.base import check_poses, smoothstep
from stewart_drake.section import SECTION, Real, Vector6, is_finite


@dataclass(frozen=True, kw_only=True)
class MinimumJerkReference:
    """Straight moves of minimum jerk from pose to pose, at rest at each of them; after the last it stays there.

    The profile is 6 u^5 - 15 u^4 + 10 u^3 of a hand's reach: T. Flash, N. Hogan, J. Neurosci. 5 (1985) 1688.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = SECTION

    kind: Literal["minimum_jerk"] = "minimum_jerk"
    poses: tuple[Vector6, ...]
    """[rad, m] at least 2; the motion starts at the first."""
    durations: tuple[Real, ...]
    """[s] of each move, one fewer than poses."""
    dwell: tuple[Real, ...] = ()
    """[s] rest before each move, as many as moves; empty for none."""

    def __post_init__(self) -> None:
        check_poses(self, "poses", 2)
        moves = len(self.poses) - 1
        allowed = f"{moves} positive numbers, one per move"
        if len(self.durations) != moves or not all(is_finite(value) and value > 0.0 for value in self.durations):
            raise ConfigurationError("reference.durations", self.durations, allowed)
        allowed = f"{moves} numbers of at least 0, one per move, or none"
        if len(self.dwell) not in (0, moves) or not all(is_finite(value) and value >= 0.0 for value in self.dwell):
            raise ConfigurationError("reference.dwell", self.dwell, allowed)

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See `Reference.evaluate`."""
        time, poses, durations = np.asarray(time, dtype=float), np.array(self.poses), np.array(self.durations)
        dwell = np.array(self.dwell) if len(self.dwell) else np.zeros_like(durations)
        starts = np.cumsum(dwell + durations) - durations
        move = np.clip(np.searchsorted(starts, time, side="right") - 1, 0, len(durations) - 1)
        lasts = durations[move][..., None]
        value, slope, curvature = smoothstep((time - starts[move])[..., None] / lasts)
        step = poses[move + 1] - poses[move]
        return poses[move] + step * value, step * slope / lasts, step * curvature / lasts**2


@dataclass(frozen=True, kw_only=True)
class SplineReference:
    """A quintic spline through timed poses, at rest at both ends; before the first and after the last it stays there.

    Four times continuously differentiable between its ends and twice at them, since rate and acceleration are zero
    there.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = SECTION

    kind: Literal["spline"] = "spline"
    times: tuple[Real, ...]
    """[s] ascending, at least 2, the first not below 0."""
    poses: tuple[Vector6, ...]
    """[rad, m] one per time."""

    def __post_init__(self) -> None:
        check_poses(self, "poses", 2)
        times = self.times
        if len(times) != len(self.poses) or not all(map(is_finite, times)) or times[0] < 0.0:
            allowed = f"{len(self.poses)} numbers, one per pose, none below 0"
            raise ConfigurationError("reference.times", times, allowed)
        if not np.all(np.diff(times) > 0.0):
            raise ConfigurationError("reference.times", times, "ascending numbers")

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See `Reference.evaluate`."""
        time = np.clip(np.asarray(time, dtype=float), self.times[0], self.times[-1])
        pose, rate, acceleration = (spline(time) for spline in self._splines)
        return pose, rate, acceleration

    @cached_property
    def _splines(self) -> tuple[Any, Any, Any]:
        # Half a second of import that the other motions need not wait for.
        from scipy.interpolate import make_interp_spline

        rest = [(1, np.zeros(6)), (2, np.zeros(6))]
        try:
            spline = make_interp_spline(np.array(self.times), np.array(self.poses), k=5, bc_type=(rest, rest))
        except (ValueError, np.linalg.LinAlgError) as error:
            allowed = f"times and poses that a spline can join ({' '.join(str(error).split())})"
            raise ConfigurationError("reference.times", self.times, allowed) from None
        return spline, spline.derivative(1), spline.derivative(2)
