"""Friction of motors that sticks: Stribeck's levels, and a bristle below them, compiled, for six motors.

Each crank hangs on a bristle: a spring k from the crank to an anchor in the housing, and a damper d beside it. Its
torque reaches at most the level g; beyond, the crank drags the anchor along. At rest the anchor stays where it is, so
that nothing creeps. The level falls with the speed s of the anchor, from break-away to Coulomb:

    g(s) = coulomb + (break_away - coulomb) exp(-(s / stribeck_velocity)^2)

Not with the crank's own: what is elastic weakens nothing. Over any motion the spring gives back at most what it holds,
g^2 / 2k, because each step is paid at its end: a backward Euler of Dahl's model with a sharp edge. Sources: V. Hayward
and B. Armstrong, "A new computational model of friction applied to haptic rendering" (2000), for the anchor that is
dragged; C. Canudas de Wit et al., "A new model for control of systems with friction" (IEEE Trans. Autom. Control 40,
1995) for bristle and levels.

A bristle is remembered by its anchor [rad] and by the slip [rad/s], the speed of the anchor in the step before.
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np

from stewart_drake.base.config import Section, one_for_six
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.jit import fields, new_record, njit
from stewart_drake.robot.leg import Moderate, Size

FRICTION = fields(coulomb=6, break_away=6, stribeck_velocity=6, viscous=6, width=(), stiffness=6, damping=6)
"""Friction of six motors, see `FrictionOptions`; width: of a crank's reversal as a controller compensates it [rad/s];
stiffness, damping: k [N m/rad] of a plant's bristles, and d, k times the plant's step. Each is 0 where not used."""

STIFFNESS_NUMBER = 1000.0
"""k h^2 / I of a bristle, for a crank's inertia I and a step h. Taken implicitly a bristle is stable whatever this is:
a load of inertia I' swings on it and decays by (1 + (k + d / h) h^2 / I')^-1/2 a step or faster. It is bounded by SAP,
which makes a servo softer than asked for from h^2 (k + d / h) = 3948 I on (near-rigid, 4 pi^2 / 0.1^2). The anchor
would then give way before the level is reached, and the crank creep; d = k h leaves a factor of two."""
SWEEPS = 30
"""Over the six motors, in `implicit_torque`."""


def bristle_stiffness(axis_inertias: np.ndarray, step: float) -> np.ndarray:
    """Stiffness (6,) [N m/rad] of the bristles that a step [s] can carry, see `STIFFNESS_NUMBER`.

    A crank at rest yields by g / k = g step^2 / (1000 I), I of `robot.crank_axis_inertias`.
    """
    stiffness: np.ndarray = STIFFNESS_NUMBER * np.asarray(axis_inertias, dtype=float) / step**2
    return stiffness


_NONE = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
EachMotor = Annotated[tuple[Moderate, Moderate, Moderate, Moderate, Moderate, Moderate], one_for_six(Moderate)]
EachRate = Annotated[tuple[Size, Size, Size, Size, Size, Size], one_for_six(Size)]


class FrictionOptions(Section, key="plant.friction"):
    """Motor friction with stiction, see `mechanics.friction`: for each key one number, or one for each motor."""

    coulomb: EachMotor = _NONE
    """[N m] dry (Coulomb) friction in motion."""
    break_away: EachMotor | None = None
    """[N m] break-away torque (static friction), at least `coulomb`; null for the same."""
    stribeck_velocity: EachRate = (0.01, 0.01, 0.01, 0.01, 0.01, 0.01)
    """[rad/s] Stribeck velocity: at it 37 % of the excess of `break_away` over `coulomb` is left; the default is our
    own."""
    viscous: EachMotor = _NONE
    """[N m s/rad] viscous friction, in proportion to speed."""

    def rules(self) -> None:
        """What breaks a motor away is not less than what it slides with."""
        for above, below in zip(self.break_away or (), self.coulomb, strict=False):
            if above < below:
                raise ConfigurationError("break_away", above, f"at least `coulomb`, {below:g} N m")

    def record(self, stiffness: Any = 0.0, step: float = 0.0) -> np.ndarray:
        """`FRICTION` record, with bristles of a stiffness (6,) [N m/rad] for a plant's step [s]."""
        break_away = self.coulomb if self.break_away is None else self.break_away
        return new_record(FRICTION, self, break_away=break_away, stiffness=stiffness, damping=stiffness * step)


@njit
def dry_level(coulomb: float, break_away: float, stribeck_velocity: float, rate: float) -> float:
    """Stribeck's curve g [N m] at a rate [rad/s]."""
    ratio = rate / stribeck_velocity
    return coulomb + (break_away - coulomb) * np.exp(-ratio * ratio)


@njit
def level(friction: Any, leg: int, slip: float) -> float:
    """Level g [N m] of a motor at a slip [rad/s]."""
    return dry_level(friction.coulomb[leg], friction.break_away[leg], friction.stribeck_velocity[leg], slip)


@njit
def update_bristles(friction: Any, angles: Any, step: float, anchor: Any, slip: Any) -> None:
    """Brings anchors and slips (6,) to where they are once the cranks have come to their angles within a step."""
    for i in range(6):
        stretch = anchor[i] - angles[i]
        bound = level(friction, i, slip[i]) / friction.stiffness[i]
        # In this form an anchor that holds keeps its last bit.
        moved = anchor[i] + (min(max(stretch, -bound), bound) - stretch)
        slip[i] = (moved - anchor[i]) / step
        anchor[i] = moved


@njit
def implicit_torque(
    friction: Any, bristles: Any, angles: Any, free_rates: Any, mobility: Any, step: float, sweeps: int, out: Any
) -> None:
    """Torques of friction that agree with the cranks' motion under them, at the end of a step.

    With v = free_rates + step mobility T and angles that advance by step v,
    T = clip(k (anchor - angles - step v) - d v, -g, g) - viscous v. That is the unique minimum of a convex function,
    found motor by motor (projected Gauss-Seidel). It makes the exact model stable at steps at which no explicit bristle
    is.

    `bristles` has `anchor` [rad] and `slip` [rad/s], (6,) each, and with the angles (6,) [rad] is that of the step's
    beginning; `free_rates` (6,) [rad/s] are those at its end, were there no friction; `mobility` (6, 6) [1/(kg m^2)] is
    the acceleration of the cranks per unit of motor torque, J M^-1 J'. out: (6,) [N m], viscous friction included.
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
        # Further sweeps would change rounding alone; a number that is none goes on to the end.
        if shift <= 1e-16 * largest:
            break
