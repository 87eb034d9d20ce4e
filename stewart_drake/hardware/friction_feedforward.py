"""Torque against the friction that a controller believes its motors to have, from the motion that is wanted."""

from __future__ import annotations

from typing import Any

import numpy as np

from stewart_drake.jit import fields, new_record, njit, record
from stewart_drake.mechanics.friction import dry_level
from stewart_drake.mechanics.kinematics_laws import LEGS, crank_rates, legs_at, robot_record, twist_of
from stewart_drake.part import Part
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.friction_options import FrictionOptions
from stewart_drake.section import Positive


class FrictionCompensation(FrictionOptions, key="friction_compensation"):
    """Friction of the motors as the controller believes it; its torque along the reference is added to the command.

    Along the reference and not along the measurement: noise cannot make it chatter, nor can it push a robot that is to
    stand still.
    """

    width: Positive = 0.002
    """[rad/s] a crank that is to turn at this rate gets 76 % of its dry friction: reversals are that smooth."""


BELIEVED = fields(coulomb=6, break_away=6, stribeck_rate=6, viscous=6, width=())
"""[N m], [N m], [rad/s], [N m s/rad], [rad/s]."""
STATE = fields(against_friction=6)
"""[N m]."""


@njit
def against_friction(robots: Any, believed: Any, reference: Any, states: Any) -> None:
    """Torques g(rate) tanh(rate / width) + viscous rate of cranks that follow a reference.

    Zeros where the reference is out of reach, or a crank at its dead centre.

    Args:
        robots: `ROBOT` record.
        believed: `BELIEVED` record.
        reference: (18,) pose [rad, m], its rate and its acceleration.
        states: `STATE` record, out.
    """
    _torque(record(robots), record(believed), reference, record(states).against_friction, np.empty(1, LEGS))


@njit
def _torque(robot: Any, friction: Any, reference: Any, out: Any, scratch: Any) -> None:
    legs, twist, rates = record(scratch), np.empty(6), np.empty(6)
    out[:] = 0.0
    if legs_at(robot, reference[:6], legs) >= 0:
        return
    twist_of(reference[:6], reference[6:12], twist)
    crank_rates(legs, twist, rates)
    for i in range(6):
        if not np.isfinite(rates[i]):
            return
    for i in range(6):
        dry = dry_level(friction.coulomb[i], friction.break_away[i], friction.stribeck_rate[i], rates[i])
        out[i] = dry * np.tanh(rates[i] / friction.width) + friction.viscous[i] * rates[i]


def friction_part(robot: RobotParameters, options: FrictionCompensation) -> Part:
    """`reference` (18,) -> `against_friction` (6,) [N m], for a robot as believed."""
    coulomb, break_away, stribeck, viscous = options.levels
    own = robot_record(robot)
    believed = new_record(
        BELIEVED,
        coulomb=coulomb,
        break_away=break_away,
        stribeck_rate=stribeck,
        viscous=viscous,
        width=options.width,
    )

    def tick(reference: np.ndarray, state: np.ndarray) -> None:
        against_friction(own, believed, reference, state)

    return Part("friction_compensation", {"reference": 18}, ("against_friction",), new_record(STATE), tick)
