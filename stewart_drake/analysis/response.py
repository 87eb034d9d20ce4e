"""Frequency response of the linear loop, figures of a step response, and response to a sine."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from stewart_drake.analysis.linear_loop import StateSpace, linearize
from stewart_drake.scenario.scenario import Scenario


class FrequencyResponse(NamedTuple):
    """Frequency response of a loop, opened at the torques of the six motors.

    Attributes:
        frequency: (f,) [Hz].
        loop: (f, 6, 6) L [-], from torques to commanded torques, with negative feedback.
        sensitivity: (f, 6, 6) S = (I + L)^-1.
        complementary: (f, 6, 6) T = I - S.
    """

    frequency: np.ndarray
    loop: np.ndarray
    sensitivity: np.ndarray
    complementary: np.ndarray

    def gains(self, name: str) -> np.ndarray:
        """Singular values (f, 6) [-] of `loop`, `sensitivity` or `complementary`, the largest first."""
        return np.asarray(np.linalg.svd(getattr(self, name), compute_uv=False))

    @property
    def crossover(self) -> tuple[float, float]:
        """Lowest and highest frequency [Hz] at which a gain of the loop falls below 1; NaN if none does."""
        gains = self.gains("loop")
        falls = (gains[:-1] >= 1.0) & (gains[1:] < 1.0)
        at = self.frequency[1:][falls.any(axis=1)]
        return (float(at[0]), float(at[-1])) if len(at) else (np.nan, np.nan)

    def __str__(self) -> str:
        low, high = self.crossover
        peaks = (self.gains(name).max() for name in ("sensitivity", "complementary"))
        return (
            f"{len(self.frequency)} frequencies from {self.frequency[0]:g} to {self.frequency[-1]:g} Hz\n"
            f"gains of the loop fall below 1 at {low:.3g} to {high:.3g} Hz\n"
            "largest sensitivity {:.3g}, largest complementary {:.3g}".format(*peaks)
        )


def frequency_response(system: StateSpace, frequency: ArrayLike) -> np.ndarray:
    """C (z I - A)^-1 B + D (f, p, m) at z = exp(i 2 pi f T), for frequencies (f,) [Hz]."""
    points = np.exp(2j * np.pi * np.asarray(frequency, dtype=float) * system.period)
    resolvent = np.linalg.solve(points[:, None, None] * np.eye(len(system.a)) - system.a, system.b.astype(complex))
    return np.asarray(system.c @ resolvent + system.d)


def bode(
    scenario: Scenario | str | Path, pose: ArrayLike | None = None, frequency: Sequence[float] | None = None
) -> FrequencyResponse:
    """Frequency response of a scenario's loop at a pose, see `linearize`.

    Args:
        scenario: A scenario, its file or its name.
        pose: (6,) [rad, m]; None for the initial pose.
        frequency: (f,) [Hz]; None for 400 from 0.1 Hz to Nyquist's.
    """
    loop = linearize(scenario, pose).loop
    at = np.geomspace(0.1, 0.5 / loop.period, 400) if frequency is None else np.asarray(frequency, dtype=float)
    # The loop is closed by u = y, so the sign of L changes for negative feedback.
    gain = -frequency_response(loop, at)
    sensitivity = np.linalg.inv(np.eye(6) + gain)
    return FrequencyResponse(at, gain, sensitivity, np.eye(6) - sensitivity)


class StepResponse(NamedTuple):
    """Step response of a coordinate of the platform.

    Attributes:
        time: (n,) [s].
        value: (n,) [-] 0 at the start, 1 at the target.
        rise_time: [s] from 0.1 to 0.9 of the step; NaN if it is not reached.
        overshoot: [-] largest value less 1; at least 0.
        settling_time: [s] until it remains within 0.02; NaN if it is not within for the last `SETTLED_SHARE`.
    """

    time: np.ndarray
    value: np.ndarray
    rise_time: float
    overshoot: float
    settling_time: float

    def __str__(self) -> str:
        return "\n".join(f"{name}: {value}" for name, value in self.rows())

    def rows(self) -> list[tuple[str, str]]:
        """Figures as rows of text."""
        end = self.time[-1] - self.time[0]
        rise, settling = (
            f"{value:.3f} s" if np.isfinite(value) else f"not reached in {end:g} s"
            for value in (self.rise_time, self.settling_time)
        )
        overshoot = f"{100.0 * self.overshoot:.1f} %"
        return [("rise time, 10 to 90 %", rise), ("overshoot", overshoot), ("settling time, 2 %", settling)]


SETTLED_SHARE = 0.05
"""Last share of a response in which it must be within its band to have settled there, and not only cross it."""


def step_figures(time: np.ndarray, value: np.ndarray) -> StepResponse:
    """Rise time, overshoot and settling time of values (n,) that go from 0 to 1 over times (n,) [s]."""
    above_low, above_high = value >= 0.1, value >= 0.9
    rise = time[above_high.argmax()] - time[above_low.argmax()] if above_high.any() else np.nan
    outside = np.flatnonzero(~(np.abs(value - 1.0) <= 0.02))
    last = outside[-1] + 1 if len(outside) else 0
    settled = last < len(time) and time[-1] - time[last] >= SETTLED_SHARE * (time[-1] - time[0])
    settling = time[last] - time[0] if settled else np.nan
    return StepResponse(time, value, float(rise), float(max(0.0, value.max() - 1.0)), float(settling))


def sine_response(
    time: np.ndarray, reference: np.ndarray, response: np.ndarray, frequency: float
) -> tuple[complex, float]:
    """Complex ratio of a response (n,) to a sine (n,) of `frequency` [Hz], by least squares.

    Also the RMS of the residual over the RMS of the fitted sine.
    """
    angle = 2.0 * np.pi * frequency * np.asarray(time)
    basis = np.stack([np.sin(angle), np.cos(angle), np.ones_like(angle)], axis=1)
    solution, *_ = np.linalg.lstsq(basis, np.stack([reference, response], axis=1), rcond=None)
    target, actual = solution[0] + 1j * solution[1]
    residual = response - basis @ solution[:, 1]
    return complex(actual / target), float(np.sqrt(2.0 * np.mean(residual**2)) / abs(actual))
