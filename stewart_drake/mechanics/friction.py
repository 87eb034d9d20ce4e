"""Friction of motors that sticks: Stribeck's levels, and a bristle below them; arrays of any namespace.

Each crank hangs on a bristle: a spring k from the crank to an anchor in the housing, and a damper d beside it. Its
torque reaches at most the level g; beyond, the crank drags the anchor along. At rest the anchor stays where it is, so
that nothing creeps. The level falls with the speed s of the anchor, from break-away to Coulomb:

    g(s) = coulomb + (break_away - coulomb) exp(-(s / stribeck_rate)^2)

Not with the crank's own: what is elastic weakens nothing. Over any motion the spring gives back at most what it holds,
g^2 / 2k, because each step is paid at its end: a backward Euler of Dahl's model with a sharp edge. Sources: V. Hayward
and B. Armstrong, "A new computational model of friction applied to haptic rendering" (2000), for the anchor that is
dragged; C. Canudas de Wit et al., "A new model for control of systems with friction" (IEEE Trans. Autom. Control 40,
1995) for bristle and levels.

Where gradients are wanted `width` [N m] rounds the corners at the levels; 0 leaves them sharp.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from stewart_drake.mechanics.arrays import Array, namespace

STIFFNESS_NUMBER = 1000.0
"""k h^2 / I of a bristle, for a crank's inertia I and a step h. Taken implicitly a bristle is stable whatever this is:
a load of inertia I' swings on it and decays by (1 + (k + d / h) h^2 / I')^-1/2 a step or faster. It is bounded by SAP,
which makes a servo softer than asked for from h^2 (k + d / h) = 3948 I on (near-rigid, 4 pi^2 / 0.1^2). The anchor
would then give way before the level is reached, and the crank creep; d = k h leaves a factor of two."""
SWEEPS = 30
"""Over the six motors, in `implicit_torque`."""


class FrictionLaw(NamedTuple):
    """Numbers of six motors, (6,) or (..., 6); made by `friction_law`.

    Attributes:
        coulomb: [N m] level in sliding.
        break_away: [N m] level at rest, at least `coulomb`.
        stribeck_rate: [rad/s] of the anchor, at which 37 % of their difference are left.
        viscous: [N m s/rad], beside the bristle.
        stiffness: [N m/rad] k.
        damping: [N m s/rad] d.
    """

    coulomb: Array
    break_away: Array
    stribeck_rate: Array
    viscous: Array
    stiffness: Array
    damping: Array


class Bristles(NamedTuple):
    """What friction remembers.

    Attributes:
        anchor: (..., 6) [rad].
        slip: (..., 6) [rad/s] of the anchor in the step before.
    """

    anchor: Array
    slip: Array


def friction_law(
    coulomb: Any, break_away: Any, stribeck_rate: Any, viscous: Any, axis_inertias: np.ndarray, step: float
) -> FrictionLaw:
    """A law with the bristles that a step can carry, see `STIFFNESS_NUMBER`.

    Args:
        coulomb: [N m] one, or (6,).
        break_away: [N m] likewise.
        stribeck_rate: [rad/s] likewise.
        viscous: [N m s/rad] likewise.
        axis_inertias: (6,) [kg m^2] of cranks and rotors about the motor axes, `robot.crank_axis_inertias`.
        step: [s].

    Returns:
        Arrays (6,) of numpy. A crank at rest yields by g / k = g step^2 / (1000 I).
    """
    stiffness = STIFFNESS_NUMBER * np.asarray(axis_inertias, dtype=float) / step**2
    given = (coulomb, break_away, stribeck_rate, viscous, stiffness, stiffness * step)
    return FrictionLaw(*(np.array(np.broadcast_to(each, stiffness.shape), dtype=float) for each in given))


def at_rest(angles: Array) -> Bristles:
    """Bristles without tension at crank angles (..., 6) [rad]."""
    return Bristles(angles, 0.0 * angles)


def level(law: FrictionLaw, slip: Array) -> Array:
    """Levels g (..., 6) [N m] at speeds (..., 6) [rad/s] of the anchors."""
    xp, ratio = namespace(slip), slip / law.stribeck_rate
    return law.coulomb + (law.break_away - law.coulomb) * xp.exp(-ratio * ratio)


def relief(law: FrictionLaw, slip: Array) -> Array:
    """Torques (..., 6) [N m] that take friction's from break-away to its level, along the slips (..., 6) [rad/s]."""
    return namespace(slip).sign(slip) * (law.break_away - level(law, slip))


def moved(law: FrictionLaw, bristles: Bristles, angles: Array, step: float, width: Array | float = 0.0) -> Bristles:
    """The bristles once the cranks have come to angles (..., 6) [rad] within a step [s]; `width` see above."""
    stretch = bristles.anchor - angles
    kept = _clipped(stretch, level(law, bristles.slip) / law.stiffness, _per(width, law.stiffness))
    # In this form an anchor that holds keeps its last bit.
    anchor = bristles.anchor + (kept - stretch)
    return Bristles(anchor, (anchor - bristles.anchor) / step)


def torque(law: FrictionLaw, bristles: Bristles, angles: Array, rates: Array, width: float = 0.0) -> Array:
    """Torques (..., 6) [N m] on cranks at angles [rad] and rates [rad/s] (..., 6), at the end of a step.

    Args:
        law: Of the motors.
        bristles: At the beginning of the step.
        angles: At its end.
        rates: Likewise.
        width: See above.
    """
    pull = law.stiffness * (bristles.anchor - angles) - law.damping * rates
    return _clipped(pull, level(law, bristles.slip), width) - law.viscous * rates


class Motor(NamedTuple):
    """What friction asks of a motor in a step, by the rate that its crank would have without it; arrays of one shape.

    Attributes:
        own: [rad/s per N m] rate that a torque of the motor itself adds.
        slowed: [-] 1 + own viscous.
        yielding: [rad/s per N m] rate per torque of crank and bristle.
        aim: [rad/s] rate at which the bristle has no tension at the step's end.
        viscous: [N m s/rad].
        bound: [N m] level of the dry part.
        width: [N m] over which corners are rounded; 0.0 for not.
    """

    own: Array
    slowed: Array
    yielding: Array
    aim: Array
    viscous: Array
    bound: Array
    width: Array | float

    @classmethod
    def of(
        cls, law: FrictionLaw, bristles: Bristles, angles: Array, own: Array, step: float, width: Array | float
    ) -> Motor:
        """Six of them, (..., 6), at the beginning of a step."""
        rigidity = law.damping + step * law.stiffness
        slowed = 1.0 + own * law.viscous
        aim = slowed * law.stiffness * (bristles.anchor - angles) / rigidity
        return cls(own, slowed, slowed / rigidity + own, aim, law.viscous, level(law, bristles.slip), width)

    def each(self) -> list[Motor]:
        """One by one."""
        return [Motor(*(each if isinstance(each, float) else each[..., leg] for each in self)) for leg in range(6)]

    def answer(self, without: Array) -> Array:
        """Torques [N m], viscous friction included, at rates [rad/s] that the cranks would have without them."""
        dry = _clipped((self.aim - without) / self.yielding, self.bound, self.width)
        return dry - self.viscous * (without + self.own * dry) / self.slowed

    def slope(self, without: Array) -> Array:
        """Derivative [N m s/rad] of `answer`; at a sharp corner one of its two."""
        inside = -_slope((self.aim - without) / self.yielding, self.bound, self.width) / self.yielding
        return inside - self.viscous * (1.0 + self.own * inside) / self.slowed


def implicit_torque(
    law: FrictionLaw,
    bristles: Bristles,
    angles: Array,
    free_rates: Array,
    mobility: Array,
    step: float,
    width: Array | float = 0.0,
    sweeps: int = SWEEPS,
    tolerance: float = 0.0,
) -> Array:
    """Torques of friction that agree with the cranks' motion under them: `torque` at the end of the step, solved for.

    With v = free_rates + step mobility f and angles that advance by step v, f = torque(angles + step v, v). Without
    corners rounded that is the unique minimum of a convex function, found motor by motor (projected Gauss-Seidel). It
    makes the exact model stable at steps at which no explicit bristle is.

    Args:
        law: Of the motors.
        bristles: At the beginning of the step.
        angles: (..., 6) [rad] likewise.
        free_rates: (..., 6) [rad/s] of the cranks at the step's end, were there no friction.
        mobility: (..., 6, 6) [1/(kg m^2)] acceleration of the cranks per unit of motor torque, J M^-1 J'.
        step: [s].
        width: [N m] see above, one or (..., 6); the rounding is that of the solution, not of `torque`.
        sweeps: Over the motors, at most.
        tolerance: [N m] a sweep that changes no torque by more is the last; 0 makes all.

    Returns:
        (..., 6) [N m], viscous friction included.
    """
    xp = namespace(free_rates)
    pushed = step * mobility
    own = xp.stack([pushed[..., leg, leg] for leg in range(6)], axis=-1)
    motors = Motor.of(law, bristles, angles, own, step, width).each()
    rates, found = free_rates, [0.0 * free_rates[..., leg] for leg in range(6)]
    for _ in range(sweeps):
        before = list(found)
        for leg, motor in enumerate(motors):
            whole = motor.answer(rates[..., leg] - motor.own * found[leg])
            rates = rates + pushed[..., leg] * (whole - found[leg])[..., None]
            found[leg] = whole
        if tolerance and max(float(xp.max(xp.abs(a - b))) for a, b in zip(found, before, strict=True)) <= tolerance:
            break
    return xp.stack(found, axis=-1)


def _per(width: Array | float, by: Array) -> Array | float:
    return width if isinstance(width, float) and width == 0.0 else width / by


def _clipped(value: Array, bound: Array, width: Array | float) -> Array:
    """Between -bound and bound; with corners rounded over `width`, which takes up to half of it off there."""
    xp = namespace(value)
    if isinstance(width, float) and width == 0.0:
        return xp.minimum(xp.maximum(value, -bound), bound)
    above, below, square = value + bound, value - bound, width * width
    return 0.5 * (xp.sqrt(above * above + square) - xp.sqrt(below * below + square))


def _slope(value: Array, bound: Array, width: Array | float) -> Array:
    """Derivative of `_clipped`."""
    xp = namespace(value)
    if isinstance(width, float) and width == 0.0:
        return xp.where(xp.abs(value) < bound, 1.0 + 0.0 * value, 0.0 * value)
    above, below, square = value + bound, value - bound, width * width + 1e-300
    return 0.5 * (above / xp.sqrt(above * above + square) - below / xp.sqrt(below * below + square))
