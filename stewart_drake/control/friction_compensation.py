"""Torque that compensates the friction of the motors, and the torque that holds a robot at rest."""

from __future__ import annotations

import contextlib

import numpy as np

from stewart_drake.base.config import Positive
from stewart_drake.base.errors import UnreachablePoseError
from stewart_drake.base.jit import njit
from stewart_drake.base.records import Record, Vec6, Vec18, record
from stewart_drake.control.ball_joints import BallJoints, Joints, ball_joint_torques, joints_record
from stewart_drake.loop.part import LoopContext, Part
from stewart_drake.mechanics.dynamics import static_torque
from stewart_drake.mechanics.friction import Friction, FrictionOptions, dry_level
from stewart_drake.mechanics.kinematics_laws import Legs, Robot, crank_rates, legs_at, robot_record, twist_of
from stewart_drake.mechanics.linear_algebra import all_finite, set_to
from stewart_drake.robot import Gravity, RobotParameters


def standing_torque(robot: RobotParameters, pose: np.ndarray, gravity: Gravity) -> np.ndarray:
    """Torques (6,) [N m] that hold the controller's model at a pose; zeros where it cannot be held."""
    # Such a pose makes the first tick fail, which writes a log.
    with contextlib.suppress(UnreachablePoseError, np.linalg.LinAlgError):
        return static_torque(robot, pose, gravity)
    return np.zeros(6)


class FrictionCompensation(FrictionOptions, key="model.friction"):
    """The controller's model of motor friction; its torque at the reference's velocity is added to the command.

    With the reference in place of the measurement, noise cannot make it chatter, and it does not push a robot that
    should rest.
    """

    width: Positive = 0.002
    """[rad/s] crank speed at which 76 % of the dry friction is compensated; larger smooths reversals more."""
    joints: BallJoints | None = None
    """Friction and inertia of the rods' ball joints; null for none."""

    def part(self, context: LoopContext) -> Part:
        """`reference` (18,) -> `friction_torque` (6,) [N m]."""
        robot, joints = robot_record(context.robot), joints_record(self.joints)
        numbers = {"robot": robot, "friction": self.record(), "joints": joints}
        inputs, outputs, first = {"reference": 18}, ("friction_torque",), FrictionTorque.new()
        return Part("friction_compensation", friction_tick, {}, inputs, outputs, first, (Legs,), parameters=numbers)


class FrictionTorque(Record):
    """State of the friction compensation."""

    friction_torque: Vec6  # [N m]


@njit
def friction_tick(
    robot: Robot, friction: Friction, joints: Joints, reference: Vec18, legs: Legs, state: FrictionTorque
) -> None:
    """Torques g(rate) tanh(rate / width) + viscous * rate, g by Stribeck's curve, and those of the ball joints.

    Zeros where the reference is out of reach.
    """
    robot, friction, joints, legs = record(robot), record(friction), record(joints), record(legs)
    out, twist, rates = record(state).friction_torque[:], np.empty(6), np.empty(6)
    set_to(out, 0.0)
    if legs_at(robot, reference[:6], legs) >= 0:
        return
    twist_of(reference[:6], reference[6:12], twist)
    crank_rates(legs, twist, rates)
    if not all_finite(rates):
        return
    for i in range(6):
        dry = dry_level(friction.coulomb[i], friction.break_away[i], friction.stribeck_velocity[i], rates[i])
        out[i] = dry * np.tanh(rates[i] / friction.width) + friction.viscous[i] * rates[i]
    if joints.viscous > 0.0 or joints.coulomb > 0.0 or joints.inertia > 0.0:
        ball_joint_torques(robot, joints, reference[:12], reference[12:], legs, out)
