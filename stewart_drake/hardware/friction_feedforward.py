"""Torque against the friction that a controller believes its motors to have, from the motion that is wanted."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from stewart_drake.errors import UnreachablePoseError
from stewart_drake.mechanics.kinematics import crank_rates, leg_geometry
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.friction_options import FrictionOptions
from stewart_drake.sampling import Sampled
from stewart_drake.section import Positive


class FrictionCompensation(FrictionOptions, key="friction_compensation"):
    """Friction of the motors as the controller believes it; its torque along the reference is added to the command.

    Along the reference and not along the measurement: noise cannot make it chatter, nor can it push a robot that is to
    stand still.
    """

    width: Positive = 0.002
    """[rad/s] a crank that is to turn at this rate gets 76 % of its dry friction: reversals are that smooth."""

    def torque(self, rates: np.ndarray) -> np.ndarray:
        """Torques (..., 6) [N m] that keep cranks turning at rates (..., 6) [rad/s]."""
        coulomb, break_away, stribeck, viscous = np.array(self.levels)
        level = coulomb + (break_away - coulomb) * np.exp(-((rates / stribeck) ** 2))
        torque: np.ndarray = level * np.tanh(rates / self.width) + viscous * rates
        return torque


FlatFeedforward = Callable[[np.ndarray], np.ndarray]


def feedforward(robot: RobotParameters, options: FrictionCompensation, reference: np.ndarray) -> np.ndarray:
    """Torques (6,) [N m] along a reference (18,); zeros where that is out of reach or a crank at its dead centre.

    Args:
        robot: As believed.
        options: See `FrictionCompensation`.
        reference: Pose [rad, m], its rate and its acceleration.
    """
    try:
        with np.errstate(all="ignore"):
            rates = crank_rates(robot, leg_geometry(robot, reference[:6]), reference[:6], reference[6:12])
    except UnreachablePoseError:
        return np.zeros(6)
    return options.torque(rates) if np.isfinite(rates).all() else np.zeros(6)


def flat_feedforward(robot: RobotParameters, options: FrictionCompensation, compiled: bool) -> FlatFeedforward:
    """`feedforward` as a function of the reference alone, compiled or not."""
    if not compiled:
        return lambda reference: feedforward(robot, options, reference)
    # numba takes half a second to import, and compiles on first use.
    from stewart_drake.compiled import friction
    from stewart_drake.compiled.mechanism import pack

    packed, levels = pack(robot), np.array(options.levels)

    def tick(reference: np.ndarray) -> np.ndarray:
        torque = np.zeros(6)
        friction.feedforward(packed, levels, options.width, reference, torque)
        return torque

    return tick


def feedforward_part(robot: RobotParameters, options: FrictionCompensation, compiled: bool) -> Sampled:
    """`flat_feedforward` as a part of a loop; it remembers nothing."""
    answer = flat_feedforward(robot, options, compiled)
    return Sampled(np.zeros(6), lambda reference, memory: answer(reference))  # noqa: ARG005
