"""Friction of the motors."""

from __future__ import annotations

import numpy as np

from stewart_drake.compiled.jit import njit
from stewart_drake.compiled.mechanism import CRANK_LENGTH, angular_velocity, leg_vectors, rod_lines, speed_along

COULOMB, BREAK_AWAY, STRIBECK_RATE, VISCOUS, STIFFNESS, DAMPING = range(6)
"""Rows of a law (6, 6), `np.stack(law)` of a `friction.FrictionLaw`."""
ANCHOR, SLIP = 0, 1
"""Rows of bristles (2, 6), `np.stack(bristles)` of `friction.Bristles`."""


@njit(cache=True, error_model="numpy", inline="always")
def level(law: np.ndarray, leg: int, slip: float) -> float:
    """Reference `friction.level`, of one motor."""
    ratio = slip / law[STRIBECK_RATE, leg]
    return law[COULOMB, leg] + (law[BREAK_AWAY, leg] - law[COULOMB, leg]) * np.exp(-ratio * ratio)


@njit(cache=True, error_model="numpy")
def moved(law: np.ndarray, bristles: np.ndarray, angles: np.ndarray, step: float) -> None:
    """Reference `friction.moved`; bristles (2, 6) in place."""
    for i in range(6):
        stretch = bristles[ANCHOR, i] - angles[i]
        bound = level(law, i, bristles[SLIP, i]) / law[STIFFNESS, i]
        anchor = bristles[ANCHOR, i] + (min(max(stretch, -bound), bound) - stretch)
        bristles[SLIP, i] = (anchor - bristles[ANCHOR, i]) / step
        bristles[ANCHOR, i] = anchor


@njit(cache=True, error_model="numpy")
def pull(
    law: np.ndarray, before: np.ndarray, state: np.ndarray, cranks: np.ndarray, step: float, out: np.ndarray
) -> None:
    """Reference `friction.moved` and `friction.relief`.

    Args:
        law: (6, 6).
        before: (12,) bristles in a row, at the step's beginning.
        state: With angles [rad], at its end.
        cranks: (6,) where they are in `state`.
        step: [s].
        out: (18,) bristles in a row, relief.
    """
    out[:12] = before
    bristles = out[:12].reshape((2, 6))
    moved(law, bristles, state[cranks], step)
    for i in range(6):
        slip = bristles[SLIP, i]
        out[12 + i] = np.sign(slip) * (law[BREAK_AWAY, i] - level(law, i, slip))


@njit(cache=True, error_model="numpy")
def implicit_torque(
    law: np.ndarray,
    bristles: np.ndarray,
    angles: np.ndarray,
    free_rates: np.ndarray,
    mobility: np.ndarray,
    step: float,
    sweeps: int,
    out: np.ndarray,
) -> None:
    """Reference `friction.implicit_torque`; mobility (6, 6), out (6,)."""
    rates, bound, wanted = free_rates.copy(), np.empty(6), np.empty(6)
    for i in range(6):
        out[i] = 0.0
        bound[i] = level(law, i, bristles[SLIP, i])
        rigidity = law[DAMPING, i] + step * law[STIFFNESS, i]
        wanted[i] = law[STIFFNESS, i] * (bristles[ANCHOR, i] - angles[i]) / rigidity
    for _ in range(sweeps):
        shift, largest = 0.0, 0.0
        for i in range(6):
            own = step * mobility[i, i]
            slowed = 1.0 + own * law[VISCOUS, i]
            without = rates[i] - own * out[i]
            dry = (slowed * wanted[i] - without) / (slowed / (law[DAMPING, i] + step * law[STIFFNESS, i]) + own)
            dry = min(max(dry, -bound[i]), bound[i])
            whole = dry - law[VISCOUS, i] * (without + own * dry) / slowed
            change = step * (whole - out[i])
            for k in range(6):
                rates[k] += mobility[k, i] * change
            shift, largest = max(shift, abs(whole - out[i])), max(largest, abs(whole))
            out[i] = whole
        # Further sweeps would change rounding alone; a number that is none goes on to the end.
        if shift <= 1e-16 * largest:
            break


@njit(cache=True, error_model="numpy")
def feedforward(robot: np.ndarray, levels: np.ndarray, width: float, reference: np.ndarray, out: np.ndarray) -> None:
    """Reference `friction_feedforward.feedforward`.

    Args:
        robot: From `mechanism.pack`.
        levels: (4, 6) `FrictionOptions.levels`.
        width: [rad/s].
        reference: (18,).
        out: (6,) [N m] zeros; they stay where the reference is out of reach.
    """
    legs, lines, omega, rates = np.empty((6, 14)), np.empty((6, 6)), np.empty(3), np.empty(6)
    if leg_vectors(robot, reference[:6], legs) >= 0:
        return
    rod_lines(legs, lines)
    angular_velocity(reference[:3], reference[6:9], omega)
    for i in range(6):
        rates[i] = speed_along(lines, i, omega, reference[9:12]) / (robot[i, CRANK_LENGTH] * legs[i, 12])
        if not np.isfinite(rates[i]):
            return
    for i in range(6):
        ratio = rates[i] / levels[STRIBECK_RATE, i]
        bound = levels[COULOMB, i] + (levels[BREAK_AWAY, i] - levels[COULOMB, i]) * np.exp(-ratio * ratio)
        out[i] = bound * np.tanh(rates[i] / width) + levels[VISCOUS, i] * rates[i]
