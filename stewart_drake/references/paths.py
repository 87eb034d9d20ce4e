"""Paths of a tool through given poses; roll, pitch and yaw are interpolated each by itself."""

from __future__ import annotations

from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from stewart_drake.config import NotNegative, Positive, Section, Vector6
from stewart_drake.errors import ConfigurationError
from stewart_drake.references.basic import smoothstep


class MinimumJerkReference(Section, key="reference"):
    """Straight moves of minimum jerk from pose to pose, at rest at each of them; after the last it stays there.

    The profile is 6 u^5 - 15 u^4 + 10 u^3 of a hand's reach: T. Flash, N. Hogan, J. Neurosci. 5 (1985) 1688.
    """

    kind: Literal["minimum_jerk"] = "minimum_jerk"
    poses: Annotated[tuple[Vector6, ...], Field(min_length=2)]
    """[rad, m] at least 2; the motion starts at the first."""
    durations: tuple[Positive, ...]
    """[s] of each move, one fewer than poses."""
    dwell: tuple[NotNegative, ...] = ()
    """[s] rest before each move, as many as moves; empty for none."""

    def rules(self) -> None:
        moves = len(self.poses) - 1
        if len(self.durations) != moves:
            raise ConfigurationError("durations", self.durations, f"{moves} positive numbers, one per move")
        if len(self.dwell) not in (0, moves):
            raise ConfigurationError("dwell", self.dwell, f"{moves} numbers, one per move, or none")

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        time, poses, durations = np.asarray(time, dtype=float), np.array(self.poses), np.array(self.durations)
        dwell = np.array(self.dwell) if len(self.dwell) else np.zeros_like(durations)
        starts = np.cumsum(dwell + durations) - durations
        move = np.clip(np.searchsorted(starts, time, side="right") - 1, 0, len(durations) - 1)
        lasts = durations[move][..., None]
        value, slope, curvature = smoothstep((time - starts[move])[..., None] / lasts)
        step = poses[move + 1] - poses[move]
        return poses[move] + step * value, step * slope / lasts, step * curvature / lasts**2


class SplineReference(Section, key="reference"):
    """A quintic spline through timed poses, at rest at both ends; before the first and after the last it stays there.

    Four times continuously differentiable between its ends and twice at them.
    """

    kind: Literal["spline"] = "spline"
    times: tuple[NotNegative, ...]
    """[s] ascending, at least 2, the first not below 0."""
    poses: Annotated[tuple[Vector6, ...], Field(min_length=2)]
    """[rad, m] one per time."""

    def rules(self) -> None:
        if len(self.times) != len(self.poses):
            raise ConfigurationError("times", self.times, f"{len(self.poses)} numbers, one per pose, none below 0")
        if not np.all(np.diff(self.times) > 0.0):
            raise ConfigurationError("times", self.times, "ascending numbers")

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        time = np.clip(np.asarray(time, dtype=float), self.times[0], self.times[-1])
        pose, rate, acceleration = (spline(time) for spline in self._splines)
        return pose, rate, acceleration

    @cached_property
    def _splines(self) -> tuple[Any, Any, Any]:
        from scipy.interpolate import make_interp_spline

        rest = [(1, np.zeros(6)), (2, np.zeros(6))]
        spline = make_interp_spline(np.array(self.times), np.array(self.poses), k=5, bc_type=(rest, rest))
        return spline, spline.derivative(1), spline.derivative(2)
