"""The cost of a run as one number, and the features of the loop that a tuner uses, which compare between robots.

The densities (35), (36) are the paper's. They have no scale, so there are also errors and torque changes in the units
of the cost, and innovations of the observer relative to the noise of a reading.
"""

from __future__ import annotations

from typing import Annotated, Literal, TypeVar

import numpy as np

from stewart_drake.base.config import Positive, Section, Window, check_value
from stewart_drake.base.jit import njit
from stewart_drake.base.records import Matrix, Record, Vec1, Vec4, Vec6, Vec12, Vec18, Vector, record
from stewart_drake.loop.part import Part
from stewart_drake.mechanics.linear_algebra import copy_to

_Number = TypeVar("_Number", float, np.ndarray)


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


def cost(rotation: _Number, position: _Number, torque_change: _Number, scales: CostScales) -> _Number:
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
def density_of(samples: Matrix, first: int, signed: bool, out: Vector) -> None:
    """Densities (k,) [-] of the last sample of a window (m + 1, k), oldest first; rows before `first` do not count.

    (35), (36), `signed`: x over the mean of n rows. Deviation: the printed form is singular where the signed sum
    crosses zero; the result is limited to +-n there, and close to it decided by rounding errors. Otherwise |x| over the
    mean of |x|, which lies in [0, n] and is well-conditioned.
    """
    rows = samples.shape[0]
    count = float(rows - first)
    for k in range(samples.shape[1]):
        total, last = 0.0, samples[rows - 1, k]
        for row in range(first, rows):
            total += samples[row, k] if signed else abs(samples[row, k])
        mean, value = total / count, last if signed else abs(last)
        out[k] = 1.0 if abs(mean) < MEAN_FLOOR else min(max(value / mean, -count), count)


@njit
def density_tick(window: Matrix, filled: Vec1, error: Vec6, torque: Vec6, signed: bool, out: Vec12) -> None:
    """Appends an error [rad, m] and a torque [N m] to a window (m + 1, 12), oldest row first; `density_of` its rows.

    `filled` counts the valid rows, which are the last ones. out: densities of the errors, then of the torques.
    """
    rows = window.shape[0]
    for row in range(rows - 1):
        copy_to(window[row], window[row + 1])
    copy_to(window[rows - 1, :6], error)
    copy_to(window[rows - 1, 6:], torque)
    filled[0] = min(filled[0] + 1.0, float(rows))
    density_of(window, rows - int(filled[0]), signed, out)


def density(samples: np.ndarray, kind: DensityKind = "magnitude") -> np.ndarray:
    """`density_of` a window (n, k), oldest first."""
    check_value("density", kind, DensityKind)
    values = np.ascontiguousarray(samples, dtype=float)
    out = np.empty(values.shape[1])
    density_of(values, 0, kind == "signed", out)
    return out


def density_part(window: int, kind: DensityKind) -> Part:
    """Densities of errors and torques over a window of m ticks as a part of a loop."""
    check_value("window", window, Window)
    check_value("density", kind, DensityKind)
    constants, inputs = {"signed": kind == "signed"}, {"error": 6, "torque": 6}
    initial = DensityState.sized(rows=window + 1).new(density=1.0)
    return Part("density", _density_tick, constants, inputs, ("density",), initial)


class DensityState(Record):
    """State of the densities."""

    density: Vec12  # [-] of errors and torques.
    filled: Vec1  # Valid rows of the window.
    window: Annotated[np.ndarray, ("rows", 12)]  # [rad, m, N m] errors and torques, oldest row first.


def _density_tick(signed: bool, error: Vec6, torque: Vec6, state: DensityState) -> None:
    # Arrays and not the record, which would be compiled for every length of the window.
    density_tick(state["window"][0], state["filled"][0], error, torque, signed, state["density"][0])


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
"""Names of features, as in policy files; all but the last are decimal logarithms. The first two are mean squares of
normalised innovations."""
Features = Annotated[np.ndarray, (len(FEATURES),)]
Vec5 = Annotated[np.ndarray, (5,)]
TIMES = (0.010, 0.100, 0.020, 0.200, 0.020)
"""[s] over which normalised innovations (twice), error (twice) and torque change are averaged."""
DRIFT_TIME = 0.020
"""[s] over which signed innovations are averaged; a push has a lasting sign."""
INNOVATION_FLOOR, DRIFT_FLOOR, COST_FLOOR = 1e-2, 1e-3, 1e-6
"""Added before the logarithm of a square: of innovations, of the drift, of errors and torque changes."""
LARGEST_SIGNAL = 1e9
"""Implausible signals are above it, in any unit; its square is finite."""


class TunerParams(Record):
    """Parameters of a tuner of settings."""

    period: float  # [s]
    noise: float  # [rad] of a reading.
    latency: float  # [s] from a reading to the torque that it causes.
    length: float  # [m] characteristic length of the robot.
    kappa: float  # Smoothness, from stiff, -1, to quiet, 1.
    rotation: float  # [rad] error that counts as one in the cost.
    position: float  # [m] likewise.
    torque_change: float  # [N m] from tick to tick, likewise.
    centre: Vec4  # Setting in the middle of the box.
    step: Vec4  # Largest change of the setting in a tick.
    weights: Vec4  # q_pose, q_rate, q_integral, r at setting 0.
    disturbance: float  # [rad/s^2 per sqrt(s)] at setting 0.


class TunerState(Record):
    """State of a tuner of settings."""

    weights: Vec4  # q_pose, q_rate, q_integral, r
    disturbance: Vec1  # [rad/s^2 per sqrt(s)] that the observer expects.
    setting: Vec5  # The four numbers of the setting, and 1 less the confidence.
    averages: Vec5  # Mean squares over `TIMES`.
    drift: Vec6  # Mean normalised innovations.
    torque: Vec6  # [N m] of the tick before.
    ticks: float  # Ticks with features.
    hold_left: float  # [s] for which a schedule still uses its alert setting.


@njit
def _plausible(signal: Vector) -> bool:
    for k in range(len(signal)):  # noqa: SIM110 - numba knows no generators here
        if not abs(signal[k]) < LARGEST_SIGNAL:
            return False
    return True


@njit
def compute_features(
    params: TunerParams,
    density: Vec12,
    error: Vec6,
    torque: Vec6,
    innovation: Vec6,
    reference: Vec18,
    state: TunerState,
    out: Features,
) -> bool:
    """Features (13,) [-] of a tick, see `FEATURES`; False, with nothing changed, where a signal is implausible.

    Takes the measured tracking error [rad, m], the commanded torque [N m] and the innovation of the observer [rad];
    updates the averages of the state.
    """
    if not (_plausible(density) and _plausible(error) and _plausible(torque)):
        return False
    if not (_plausible(innovation) and _plausible(reference)):
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
    now = np.empty(5)
    now[0], now[1], now[2], now[3], now[4] = innovations, innovations, rotation + position, rotation + position, changes
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
