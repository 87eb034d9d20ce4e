"""The robot in the six coordinates of its platform: the exact closed chain, stepped as the `MultibodyPlant` is.

Semi-implicit Euler, of first order like SAP: accelerations at the step's beginning, the pose by the velocity at its
end, friction by what it is at the end. Loops are closed in every step, rods do not spin. `advanced` is the readable
reference; `ClosedChain` runs the same as machine code.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from stewart_drake.compiled.constants import CHAIN_STATE
from stewart_drake.errors import SingularPoseError
from stewart_drake.mechanics import dynamics_core, kinematics_core
from stewart_drake.mechanics.arrays import Robot, numpy_robot
from stewart_drake.mechanics.friction import SWEEPS, Bristles, FrictionLaw, at_rest, implicit_torque, moved
from stewart_drake.mechanics.kinematics import (
    inverse_kinematics,
    pose_rate_to_twist,
    roll_pitch_yaw,
    twist_to_pose_rate,
)
from stewart_drake.plant.plant_options import PlantOptions
from stewart_drake.plant.sdf_model import home_frames
from stewart_drake.robot import RobotParameters
from stewart_drake.sampling import on_grid


class ChainState(NamedTuple):
    """What there is to know of the robot at an instant.

    Attributes:
        pose: (6,) [rad, m], pitch in [-pi/2, pi/2].
        pose_rate: (6,) [rad/s, m/s] Euler rates and velocity.
        twist: (6,) [rad/s, m/s] in B.
        angles: (6,) [rad] of the cranks, not wrapped.
        anchor: (6,) [rad] of the bristles.
        slip: (6,) [rad/s] of the anchors in the step before.
    """

    pose: np.ndarray
    pose_rate: np.ndarray
    twist: np.ndarray
    angles: np.ndarray
    anchor: np.ndarray
    slip: np.ndarray


def starting_state(robot: RobotParameters, pose: np.ndarray, pose_rate: np.ndarray) -> ChainState:
    """At a pose (6,) and its rate (6,), friction without tension.

    Raises:
        UnreachablePoseError: A rod cannot span.
    """
    home = home_frames(robot)
    angles = home.crank_angles + home.motor_angles(inverse_kinematics(robot, pose))
    return ChainState(pose, pose_rate, pose_rate_to_twist(pose, pose_rate), angles, *at_rest(angles))


def loaded(robot: RobotParameters, options: PlantOptions) -> Robot:
    """The robot with the payload as a part of its platform."""
    own, mass, place = numpy_robot(robot), options.payload_mass, np.array(options.payload_position)
    return own._replace(
        platform_mass=own.platform_mass + mass,
        platform_moment=own.platform_moment + mass * place,
        platform_inertia=own.platform_inertia + mass * ((place @ place) * np.eye(3) - np.outer(place, place)),
    )


def advanced(
    robot: Robot,
    law: FrictionLaw,
    gravity: float,
    step: float,
    torque: np.ndarray,
    wrench: np.ndarray,
    state: ChainState,
) -> ChainState:
    """One step.

    Args:
        robot: See `loaded`.
        law: Of the motors' friction.
        gravity: [m/s^2].
        step: [s].
        torque: (6,) [N m] of the motors, within their limits.
        wrench: (6,) [N m, N] on the platform from outside, about P in B.
        state: At the step's beginning, a pose within reach.
    """
    legs = kinematics_core.legs_at(robot, state.pose)
    jacobian = np.swapaxes(kinematics_core.twist_jacobian(robot, legs, masked=False), 0, 1)
    inertia = dynamics_core.task_inertia(robot, legs, masked=False)
    bias = dynamics_core.task_bias(robot, legs, state.twist, gravity, masked=False)
    free = state.twist + step * np.linalg.solve(inertia, jacobian.T @ torque + wrench - bias)
    pushed = np.linalg.solve(inertia, jacobian.T)
    bristles = Bristles(state.anchor, state.slip)
    dry = implicit_torque(law, bristles, state.angles, jacobian @ free, jacobian @ pushed, step)
    twist = free + step * pushed @ dry
    # A quaternion along its rate, made of length one again: a turn by 2 atan(h w / 2).
    half = 0.5 * step * np.cross(np.eye(3), twist[:3])
    turn = np.linalg.solve(np.eye(3) - half, np.eye(3) + half) @ legs.rotation
    pose = np.concatenate([roll_pitch_yaw(turn), state.pose[3:] + step * twist[3:]])
    ahead = kinematics_core.crank_angles(kinematics_core.cranks_at(robot, pose)) - state.angles
    angles = state.angles + ahead - 2.0 * np.pi * np.rint(ahead / (2.0 * np.pi))
    return ChainState(pose, twist_to_pose_rate(pose, twist), twist, angles, *moved(law, bristles, angles, step))


class ClosedChain:
    """The same by numba, on flat vectors.

    Args:
        robot: Geometry and masses.
        options: What else is modelled; of those that `engine: reduced` can have.
        gravity: [m/s^2].
    """

    def __init__(self, robot: RobotParameters, options: PlantOptions, gravity: float) -> None:
        # numba takes half a second to import, and compiles on first use.
        from stewart_drake.compiled.closed_chain import advance
        from stewart_drake.compiled.mechanism import pack

        own = loaded(robot, options)
        packed = pack(robot, (float(own.platform_mass), own.platform_moment, own.platform_inertia))
        law = np.stack(options.friction_law(robot))
        self._advance, self._fixed = advance, (packed, law, float(gravity), on_grid(options.time_step), SWEEPS)

    def advance(self, torque: np.ndarray, wrench: np.ndarray, now: np.ndarray, then: np.ndarray) -> None:
        """One step.

        Args:
            torque: (6,) [N m] asked of the motors.
            wrench: (6,) [N m, N] on the platform.
            now: (36,) a `ChainState` in a row.
            then: (36,) out, likewise.

        Raises:
            SingularPoseError: A crank comes to its dead centre, where this description of the robot ends.
        """
        leg, margin = self._advance(*self._fixed, torque, wrench, now, then)
        if leg >= 0:
            raise SingularPoseError("serial", now[: CHAIN_STATE.pose_rate].copy(), margin, 0.0, leg)
