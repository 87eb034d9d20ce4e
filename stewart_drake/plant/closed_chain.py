"""The robot in the six coordinates of its platform: the exact closed chain, stepped as the `MultibodyPlant` is.

Semi-implicit Euler, of first order like SAP: accelerations at the step's beginning, the pose by the velocity at its
end, friction by what it is at the end. Loops are closed in every step, rods do not spin.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from stewart_drake.errors import SingularPoseError
from stewart_drake.jit import fields, new_record, njit, record
from stewart_drake.mechanics import kinematics_laws as laws
from stewart_drake.mechanics.dynamics_laws import loads, task_inertia
from stewart_drake.mechanics.friction import SWEEPS, drag_anchors, implicit_torque
from stewart_drake.mechanics.kinematics import crank_rates, inverse_kinematics, leg_geometry, pose_rate_to_twist
from stewart_drake.mechanics.linear_algebra import copy_to, solve
from stewart_drake.plant.plant_options import PlantOptions
from stewart_drake.plant.sdf_model import home_frames
from stewart_drake.robot import RobotParameters
from stewart_drake.sampling import on_grid

CHAIN_STATE = fields(pose=6, pose_rate=6, twist=6, angles=6, crank_rate=6, anchor=6, slip=6)
"""What there is to know of the robot at an instant. pose: [rad, m], pitch in [-pi/2, pi/2]. pose_rate: Euler rates and
velocity [rad/s, m/s]. twist: in B [rad/s, m/s]. angles: of the cranks [rad], not wrapped. crank_rate: theirs [rad/s].
anchor: of the bristles [rad]. slip: speed of the anchors in the step before [rad/s]."""
SETUP = fields(gravity=(), step=())
"""[m/s^2], [s]."""


def loaded(robot: RobotParameters, options: PlantOptions) -> np.ndarray:
    """The robot with the payload as a part of its platform, a `ROBOT` record."""
    return laws.with_payload(laws.robot_record(robot), options.payload_mass, np.array(options.payload_position))


class ClosedChain:
    """The closed chain of a robot, with the options that `engine: reduced` can have."""

    def __init__(self, robot: RobotParameters, options: PlantOptions, gravity: float) -> None:
        self._robot, self._home = robot, home_frames(robot)
        setup = new_record(SETUP, gravity=gravity, step=on_grid(options.time_step))
        self._fixed = loaded(robot, options), options.friction_law(robot), setup, np.empty(1, laws.LEGS)

    def initial(self, pose: np.ndarray, pose_rate: np.ndarray) -> np.ndarray:
        """`CHAIN_STATE` record at a pose (6,) and its rate (6,), friction without tension."""
        home = self._home
        angles = home.crank_angles + home.motor_angles(inverse_kinematics(self._robot, pose))
        twist = pose_rate_to_twist(pose, pose_rate)
        rates = crank_rates(self._robot, leg_geometry(self._robot, pose), pose, pose_rate)
        moving = {"pose": pose, "pose_rate": pose_rate, "twist": twist, "angles": angles, "crank_rate": rates}
        return new_record(CHAIN_STATE, **moving, anchor=angles)

    def step(self, torque: np.ndarray, wrench: np.ndarray, state: np.ndarray) -> None:
        """A step under torques (6,) [N m] asked of the motors and a wrench (6,) [N m, N] on the platform, about P in B.

        Raises:
            SingularPoseError: A crank comes to its dead centre, where this description ends.
        """
        leg, margin = _step(*self._fixed, torque, wrench, state)
        if leg >= 0:
            raise SingularPoseError("serial", state["pose"][0].copy(), margin, 0.0, leg)


@njit
def _step(robots: Any, frictions: Any, setups: Any, leg_records: Any, torque: Any, wrench: Any, states: Any) -> Any:
    """One step of M(pose) d(twist)/dt + h = J' (T + friction) + wrench (6,) [N m, N], the push from outside about P.

    Returns -1, or the leg that cannot span, and then the state is as it was; its margin.
    """
    robot, friction, setup, legs, state = (
        record(robots), record(frictions), record(setups), record(leg_records), record(states),
    )  # fmt: skip
    step = setup.step
    bad = laws.legs_at(robot, state.pose[:], legs)
    if bad >= 0:
        return bad, legs.reach[bad]
    jacobian, inertia, columns = np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 7))
    load, own, still = np.empty(6), np.empty(6), np.zeros(6)
    task_inertia(robot, legs, inertia)
    loads(robot, legs, state.twist[:], still, setup.gravity, load, own)
    laws.crank_jacobian(legs, jacobian)
    # M a = J' (torque - own) - load + wrench; beside it M^-1 J' for friction.
    for k in range(6):
        columns[k, 6] = wrench[k] - load[k]
    for i in range(6):
        limit = robot.effort_limit[i]
        given = min(max(torque[i], -limit), limit) - own[i]
        for k in range(6):
            columns[k, i] = jacobian[i, k]
            columns[k, 6] += jacobian[i, k] * given
    solve(inertia, columns)
    twist = state.twist + step * columns[:, 6]
    if (friction.break_away > 0.0).any() or (friction.viscous > 0.0).any():
        _rub(friction, jacobian, columns, step, state, twist)
    pose, rotation = np.empty(6), np.empty((3, 3))
    for k in range(3):
        _turn(legs.rotation[:, k], twist[:3], step, rotation[:, k])
        pose[3 + k] = state.pose[3 + k] + step * twist[3 + k]
    laws.roll_pitch_yaw(rotation, pose[:3])
    bad = laws.legs_at(robot, pose, legs)
    if bad >= 0:
        return bad, legs.reach[bad]
    copy_to(state.pose[:], pose)
    copy_to(state.twist[:], twist)
    laws.rate_of(pose, twist, state.pose_rate[:])
    laws.crank_rates(legs, twist, state.crank_rate[:])
    for i in range(6):
        ahead = np.arctan2(legs.sine[i], legs.cosine[i]) - state.angles[i]
        state.angles[i] += ahead - 2.0 * np.pi * np.rint(ahead / (2.0 * np.pi))
    drag_anchors(friction, state.angles[:], step, state.anchor[:], state.slip[:])
    return -1, 0.0


@njit
def _rub(friction: Any, jacobian: Any, pushed: Any, step: float, state: Any, twist: Any) -> None:
    """Adds to the twist (6,) at a step's end what friction makes of it; `pushed` begins with M^-1 J' (6, 6)."""
    rates, mobility, dry = np.zeros(6), np.zeros((6, 6)), np.empty(6)
    for i in range(6):
        for m in range(6):
            rates[i] += jacobian[i, m] * twist[m]
            for k in range(6):
                mobility[i, k] += jacobian[i, m] * pushed[m, k]
    implicit_torque(friction, state, state.angles, rates, mobility, step, SWEEPS, dry)
    for k in range(6):
        for i in range(6):
            twist[k] += step * pushed[k, i] * dry[i]


@njit
def _turn(axis: Any, omega: Any, step: float, out: Any) -> None:
    """An axis (3,) of P after a step of a quaternion along its rate, made of length one again.

    v + 2 q x (v + q x v) / (1 + q q) with q = h w / 2: a turn by 2 atan(h w / 2).
    """
    half, inner, outer = 0.5 * step * omega, np.empty(3), np.empty(3)
    scale = 2.0 / (1.0 + half[0] * half[0] + half[1] * half[1] + half[2] * half[2])
    laws.cross(half, axis, inner)
    for k in range(3):
        inner[k] += axis[k]
    laws.cross(half, inner, outer)
    for k in range(3):
        out[k] = axis[k] + scale * outer[k]
