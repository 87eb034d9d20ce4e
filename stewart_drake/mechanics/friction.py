"""Motor friction with stiction: a bristle model with Stribeck's curve, compiled, for six motors.

A bristle is a spring k between the crank and an anchor in the housing, with a damper d in parallel. Its torque is
limited to a level g; beyond that the crank drags the anchor along. At rest the anchor does not move, so that nothing
creeps. The level falls with the speed s of the anchor, the slip, from break-away to Coulomb friction:

    g(s) = coulomb + (break_away - coulomb) exp(-(s / stribeck_velocity)^2)

It depends on the slip and not on the crank's speed: an elastic motion does not weaken it. The spring returns at most
the energy that it stores, g^2 / 2k, because the torque is that of the end of a step: backward Euler of Dahl's model
with a sharp edge. Sources: V. Hayward and B. Armstrong, "A new computational model of friction applied to haptic
rendering" (2000), for the anchor that is dragged; C. Canudas de Wit et al., "A new model for control of systems with
friction" (IEEE Trans. Autom. Control 40, 1995) for bristle and levels.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from stewart_drake.base.config import InOtherKinds, Section, one_for_six
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.jit import njit
from stewart_drake.base.records import Mat6, Record, Vec6
from stewart_drake.robot.leg import Moderate, Size


class Friction(Record):
    """Friction of six motors, see `FrictionOptions`; a number that is not used is 0."""

    coulomb: Vec6  # [N m]
    break_away: Vec6  # [N m]
    stribeck_velocity: Vec6  # [rad/s]
    viscous: Vec6  # [N m s/rad]
    width: float  # [rad/s] of a reversal, as a controller compensates it.
    stiffness: Vec6  # [N m/rad] k of a plant's bristles.
    damping: Vec6  # [N m s/rad] d, k times the plant's step.


class Bristles(Record):
    """State of six bristles."""

    anchor: Vec6  # [rad]
    slip: Vec6  # [rad/s] speed of the anchor in the step before.


STIFFNESS_NUMBER = 1000.0
"""k h^2 / I of a bristle, for a crank's inertia I and a step h. An implicit bristle is stable for any value: a load of
inertia I' swings on it and decays by (1 + (k + d / h) h^2 / I')^-1/2 a step or faster. The bound is SAP's, which
softens a servo above h^2 (k + d / h) = 3948 I (near-rigid, 4 pi^2 / 0.1^2). The anchor would then slip before the level
is reached, and the crank creep; d = k h leaves a factor of two."""
SWEEPS = 30
"""Over the six motors, at most, in `implicit_torque`."""


def bristle_stiffness(axis_inertias: np.ndarray, step: float) -> np.ndarray:
    """Stiffness (6,) [N m/rad] of bristles for a step [s] and `robot.crank_axis_inertias` I, see `STIFFNESS_NUMBER`.

    A crank at rest yields by g / k = g step^2 / (1000 I).
    """
    return STIFFNESS_NUMBER * np.asarray(axis_inertias, dtype=float) / step**2


_NONE = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
SixTorques = Annotated[tuple[Moderate, Moderate, Moderate, Moderate, Moderate, Moderate], one_for_six(Moderate)]
SixRates = Annotated[tuple[Size, Size, Size, Size, Size, Size], one_for_six(Size)]


class FrictionOptions(Section, key="plant.friction"):
    """Motor friction with stiction, see `mechanics.friction`: for each key one number, or one for each motor."""

    width = InOtherKinds(0.0)
    """[rad/s] of a reversal, which a controller's model has."""
    coulomb: SixTorques = _NONE
    """[N m] dry (Coulomb) friction in motion."""
    break_away: SixTorques | None = None
    """[N m] break-away torque (static friction), at least `coulomb`; null for the same."""
    stribeck_velocity: SixRates = (0.01, 0.01, 0.01, 0.01, 0.01, 0.01)
    """[rad/s] Stribeck velocity: at it 37 % of the excess of `break_away` over `coulomb` is left; the default is our
    own."""
    viscous: SixTorques = _NONE
    """[N m s/rad] viscous friction, in proportion to speed."""

    def rules(self) -> None:
        """Break-away is at least Coulomb friction."""
        for static, sliding in zip(self.break_away or (), self.coulomb, strict=False):
            if static < sliding:
                raise ConfigurationError("break_away", static, f"at least `coulomb`, {sliding:g} N m")

    def record(self, stiffness: float | np.ndarray = 0.0, step: float = 0.0) -> Friction:
        """The numbers, with bristles of a stiffness (6,) [N m/rad] for a plant's step [s]."""
        break_away = self.coulomb if self.break_away is None else self.break_away
        return Friction.new(self, break_away=break_away, stiffness=stiffness, damping=stiffness * step)


@njit
def dry_level(coulomb: float, break_away: float, stribeck_velocity: float, rate: float) -> float:
    """Stribeck's curve g [N m] at a rate [rad/s]."""
    ratio = rate / stribeck_velocity
    return coulomb + (break_away - coulomb) * np.exp(-ratio * ratio)


@njit
def level(friction: Friction, leg: int, slip: float) -> float:
    """Level g [N m] of a motor at a slip [rad/s]."""
    return dry_level(friction.coulomb[leg], friction.break_away[leg], friction.stribeck_velocity[leg], slip)


@njit
def update_bristles(friction: Friction, angles: Vec6, step: float, anchor: Vec6, slip: Vec6) -> None:
    """Updates anchors and slips once the cranks have moved to their angles in a step."""
    for i in range(6):
        stretch = anchor[i] - angles[i]
        bound = level(friction, i, slip[i]) / friction.stiffness[i]
        # An anchor that holds keeps its last bit by this formula.
        moved = anchor[i] + (min(max(stretch, -bound), bound) - stretch)
        slip[i] = (moved - anchor[i]) / step
        anchor[i] = moved


@njit
def implicit_torque(
    friction: Friction,
    bristles: Bristles,
    angles: Vec6,
    free_rates: Vec6,
    mobility: Mat6,
    step: float,
    sweeps: int,
    out: Vec6,
) -> None:
    """Implicit friction torques: those at the end of a step, consistent with the motion under them.

    With v = free_rates + step mobility T and angles that advance by step v,
    T = clip(k (anchor - angles - step v) - d v, -g, g) - viscous v. That is the unique minimum of a convex function,
    found motor by motor (projected Gauss-Seidel). The exact model is then stable at steps at which an explicit bristle
    is not.

    Args:
        friction: Parameters.
        bristles: At the beginning of the step.
        angles: [rad] of the cranks, likewise.
        free_rates: [rad/s] of the cranks at the end of the step, without friction.
        mobility: [1/(kg m^2)] acceleration of the cranks per unit of motor torque, J M^-1 J'.
        step: [s].
        sweeps: At most.
        out: [N m], viscous friction included.
    """
    rates, bound, wanted = free_rates.copy(), np.empty(6), np.empty(6)
    for i in range(6):
        out[i] = 0.0
        bound[i] = level(friction, i, bristles.slip[i])
        rigidity = friction.damping[i] + step * friction.stiffness[i]
        wanted[i] = friction.stiffness[i] * (bristles.anchor[i] - angles[i]) / rigidity
    for _ in range(sweeps):
        shift, largest = 0.0, 0.0
        for i in range(6):
            yielding = step * mobility[i, i]
            slowed = 1.0 + yielding * friction.viscous[i]
            without = rates[i] - yielding * out[i]
            rigidity = friction.damping[i] + step * friction.stiffness[i]
            dry = (slowed * wanted[i] - without) / (slowed / rigidity + yielding)
            dry = min(max(dry, -bound[i]), bound[i])
            whole = dry - friction.viscous[i] * (without + yielding * dry) / slowed
            change = step * (whole - out[i])
            for k in range(6):
                rates[k] += mobility[k, i] * change
            shift, largest = max(shift, abs(whole - out[i])), max(largest, abs(whole))
            out[i] = whole
        # Further sweeps would change only rounding; with NaN the loop runs to its end.
        if shift <= 1e-16 * largest:
            break
