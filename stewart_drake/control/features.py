"""What control is for, in one number, and what a tuner gets of its loop, in numbers that compare between robots.

The densities (35), (36) are the paper's. A density has no scale, so sizes stand beside it: errors and torque changes in
the units of the cost, innovations of the observer in those of the noise of a reading.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from stewart_drake.base.config import Positive, Section, Window, check_value
from stewart_drake.base.jit import fields, new_record, njit, record
from stewart_drake.loop.part import Part
from stewart_drake.mechanics.linear_algebra import copy_to


class CostScales(Section, key="cost"):
    """Scales of the cost of a run: how large an error or change of torque counts as one."""

    rotation: Positive = 0.03
    """[deg] RMS rotation error that counts as one."""
    position: Positive = 0.03
    """[mm] RMS position error that counts as one."""
    torque_change: Positive = 0.03
    """[N m] RMS change of a motor's torque in a millisecond that counts as one."""

    def at(self, kappa: float) -> CostScales:
        """The scales by smoothness, from stiff, kappa = -1, to quiet, 1: the last one divided by 10^kappa."""
        return CostScales(
            rotation=self.rotation, position=self.position, torque_change=self.torque_change * 10.0**-kappa
        )


def cost(rotation: Any, position: Any, torque_change: Any, scales: CostScales) -> Any:
    """J = sqrt((rotation / its scale)^2 + (position / its scale)^2 + (torque_change / its scale)^2) [-].

    Takes numbers, or arrays of any shape: RMS length of the error [deg] and [mm], RMS change of a motor's torque in a
    millisecond [N m].
    """
    squares = (rotation / scales.rotation) ** 2 + (position / scales.position) ** 2
    return (squares + (torque_change / scales.torque_change) ** 2) ** 0.5


# --- densities --------------------------------------------------------------------------------------------------------

DensityKind = Literal["magnitude", "signed"]

MEAN_FLOOR = 1e-9
"""Window means below this, in the signal's unit, count as zero; the density is 1 there."""


@njit
def density_of(samples: Any, signed: bool, out: Any) -> None:
    """Densities (k,) [-] of the last sample of a window (n, k), oldest first, n <= m + 1 (fewer while it fills).

    (35), (36), `signed`: x over the window's mean. Deviation: the print is singular where the signed sum crosses zero;
    the result is held within +-n there. Close to it the quotient is ill-conditioned: rounding errors of the samples
    decide it. Else |x| over the window's mean |x|, which lies in [0, n] by itself and is well-conditioned.
    """
    count = samples.shape[0]
    for k in range(samples.shape[1]):
        total, last = 0.0, samples[count - 1, k]
        for row in range(count):
            total += samples[row, k] if signed else abs(samples[row, k])
        mean, value = total / count, last if signed else abs(last)
        out[k] = 1.0 if abs(mean) < MEAN_FLOOR else min(max(value / mean, -count), count)


@njit
def density_tick(window: Any, filled: Any, error: Any, torque: Any, signed: bool, out: Any) -> None:
    """`density_of` an error (6,) [rad, m] and a torque (6,) [N m] that slide into a window (m + 1, 12), oldest first.

    The last `filled` (1,) rows mean something. out: (12,) [-], of the errors, then of the torques.
    """
    rows = window.shape[0]
    for row in range(rows - 1):
        copy_to(window[row], window[row + 1])
    copy_to(window[rows - 1, :6], error)
    copy_to(window[rows - 1, 6:], torque)
    filled[0] = min(filled[0] + 1.0, float(rows))
    density_of(window[rows - int(filled[0]) :], signed, out)


def density(samples: np.ndarray, kind: DensityKind = "magnitude") -> np.ndarray:
    """`density_of` a window (n, k), oldest first."""
    check_value("density", kind, DensityKind)
    values = np.ascontiguousarray(samples, dtype=float)
    out = np.empty(values.shape[1])
    density_of(values, kind == "signed", out)
    return out


def density_part(window: int, kind: DensityKind) -> Part:
    """Densities of errors and torques over a window of m ticks as a part of a loop."""
    check_value("window", window, Window)
    check_value("density", kind, DensityKind)
    constants, inputs = {"signed": kind == "signed"}, {"error": 6, "torque": 6}
    initial = new_record(fields(density=12, filled=(), window=(window + 1, 12)), density=1.0)
    return Part("density", _density_tick, constants, inputs, ("density",), initial)


def _density_tick(signed: bool, error: np.ndarray, torque: np.ndarray, state: np.ndarray) -> None:
    # Field by field: a record with the window in it would have to be compiled for each length.
    density_tick(state["window"][0], state["filled"], error, torque, signed, state["density"][0])


# --- features ---------------------------------------------------------------------------------------------------------

FEATURES = (
    "surprise",
    "surprise_slow",
    "drift",
    "error",
    "error_slow",
    "torque_change",
    "error_density",
    "torque_density",
    "speed",
    "acceleration",
    "noise",
    "latency",
    "kappa",
)
"""Names of features, as policy files have them; all but the last are decimal logarithms. The first two are mean squares
of normalised innovations."""
TIMES = (0.010, 0.100, 0.020, 0.200, 0.020)
"""[s] over which normalised innovations (twice), error (twice) and torque change are averaged."""
DRIFT_TIME = 0.020
"""[s] over which innovations are averaged with their signs: what pushes the robot has one."""
INNOVATION_FLOOR, DRIFT_FLOOR, COST_FLOOR = 1e-2, 1e-3, 1e-6
"""Added before the logarithm of a square: of innovations, of the drift, of errors and torque changes."""
LARGEST_SIGNAL = 1e9
"""Signals are below it, in any unit; squares of it stay finite."""

TUNER_PARAMS = fields(
    period=(), noise=(), latency=(), length=(), kappa=(), rotation=(), position=(), torque_change=(),
    centre=4, step=4, weights=4, disturbance=(),
)  # fmt: skip
"""What a tuner of settings is made for. period [s]. noise of a reading [rad]. latency from a reading to the torque that
it causes [s]. length: characteristic length of the robot [m]. rotation, position, torque_change: what counts as one in
the cost [rad], [m] and, from tick to tick, [N m]. centre, step: of a setting. weights, disturbance: of the base."""
TUNER_STATE = fields(
    weights=4, disturbance=1, setting=5, averages=5, drift=6, torque=6, ticks=(), hold_left=()
)  # fmt: skip
"""weights, disturbance [rad/s^2 per sqrt(s)]. setting: four, and from 0 to 1 how far the features lie outside of the
training. averages: mean squares over `TIMES`. drift: mean normalised innovations. torque: of the tick before [N m].
ticks: with features. hold_left: [s] that a schedule stays alert."""


@njit
def _plausible(signal: Any) -> bool:
    for value in signal:  # noqa: SIM110 - numba knows no generators here
        if not abs(value) < LARGEST_SIGNAL:
            return False
    return True


@njit
def compute_features(
    params: Any, density: Any, error: Any, torque: Any, innovation: Any, reference: Any, state: Any, out: Any
) -> bool:
    """Features (13,) [-] of a tick, see `FEATURES`; False, with nothing changed, where a signal is not plausible.

    Args:
        params: `TUNER_PARAMS`.
        density: (12,) [-].
        error: (6,) [rad, m] that the controller sees.
        torque: (6,) [N m] that is asked for.
        innovation: (6,) [rad] of the observer.
        reference: (18,).
        state: `TUNER_STATE`, whose averages are changed.
        out: (13,) out.
    """
    for signal in (density, error, torque, innovation, reference):
        if not _plausible(signal):
            return False
    params, state = record(params), record(state)
    period = params.period
    innovations, drift, changes, rotation, position = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(6):
        normalised = innovation[i] / params.noise
        innovations += normalised * normalised / 6.0
        state.drift[i] += period / (period + DRIFT_TIME) * (normalised - state.drift[i])
        drift += state.drift[i] ** 2 / 6.0
        if state.ticks > 0.0:
            changes += ((torque[i] - state.torque[i]) / params.torque_change) ** 2 / 6.0
        state.torque[i] = torque[i]
    state.ticks += 1.0
    for k in range(3):
        rotation += (error[k] / params.rotation) ** 2
        position += (error[3 + k] / params.position) ** 2
    now = (innovations, innovations, rotation + position, rotation + position, changes)
    for k in range(5):
        state.averages[k] += period / (period + TIMES[k]) * (now[k] - state.averages[k])
    out[0], out[1] = state.averages[0] + INNOVATION_FLOOR, state.averages[1] + INNOVATION_FLOOR
    out[2] = drift + DRIFT_FLOOR
    for k in range(3):
        out[3 + k] = state.averages[2 + k] + COST_FLOOR
    for part in range(2):
        mean, square = 0.0, 1e-12
        for k in range(6):
            mean += density[6 * part + k] / 6.0
        for k in range(3):
            square += (params.length * reference[6 + 6 * part + k]) ** 2 + reference[9 + 6 * part + k] ** 2
        out[6 + part] = abs(mean) + 0.1
        out[8 + part] = np.sqrt(square) + (1e-3 if part == 0 else 1e-2)
    out[10], out[11] = params.noise / 1e-5, params.latency / 1e-3
    for k in range(12):
        out[k] = np.log10(out[k])
    out[12] = params.kappa
    return True
