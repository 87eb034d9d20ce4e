"""How motor torques accelerate the platform from rest: measured on Drake's plant, exactly, and by the paper's models.

At rest the acceleration is affine in the torques: twist_rate = map @ torque + rest. That one pair holds all that the
force map of (10) to (18) claims.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydrake.systems.analysis import Simulator

from stewart_drake.control.state_space import mass_diagonal
from stewart_drake.errors import drake_guard
from stewart_drake.mechanics.dynamics import inverse_dynamics, static_torque, task_bias, task_inertia
from stewart_drake.mechanics.force_map import crank_map, force_map_of_legs
from stewart_drake.mechanics.kinematics import euler_rate_matrix, leg_geometry, rotation_matrix, twist_jacobian
from stewart_drake.paper.as_printed import rod_map_11
from stewart_drake.plant.multibody_plant import build_plant
from stewart_drake.plant.plant_options import PlantOptions
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEGS, SMALLEST

SETTLING_STEPS = 14
"""Plant steps before the acceleration is read. SAP's near-rigid loop closures give way by half a thousandth in the
first step from rest and halve that in each further one."""
_TORQUE_SHARE = 0.2
"""Part of the effort limit that is put on one motor at a time."""

MODELS = {
    "printed, p_i unrotated": "(9) to (18) to the letter",
    "printed": "the same with e_M from R^-1 p_i",
    "statics": "and with F_i = T_i / (|a| e_l.e_N)",
    "statics, I in B": "and with the platform's inertia turned into B, as its moments are",
    "massless legs": "and with Euler second derivatives told from the angular acceleration: exact without legs",
}
"""The controller's model of M q'' = tau T, mended step by step."""


@dataclass(frozen=True)
class Accelerations:
    """Accelerations from rest at n poses.

    Attributes:
        poses: (n, 6) [rad, m].
        map: (n, 6, 6) [rad/s^2, m/s^2 per N m] d(twist)/dt of the platform per unit of motor torque.
        rest: (n, 6) [rad/s^2, m/s^2] d(twist)/dt without torque.
    """

    poses: np.ndarray
    map: np.ndarray
    rest: np.ndarray

    @property
    def euler_map(self) -> np.ndarray:
        """(n, 6, 6) the map to q'', the second derivative of the pose, which is what (9) speaks of."""
        return to_euler(self.poses, self.map)


def light_legs(robot: RobotParameters, scale: float) -> RobotParameters:
    """The robot with masses and inertias of cranks and rods times `scale`, but no less than a robot may have."""
    return robot.replace(
        rod_mass=max(SMALLEST, scale * robot.rod_mass),
        crank_mass=max(SMALLEST, scale * robot.crank_mass),
        rod_inertia=tuple(max(SMALLEST, scale * moment) for moment in robot.rod_inertia),
        crank_inertia=tuple(max(SMALLEST, scale * moment) for moment in robot.crank_inertia),
    )


def measured(
    robot: RobotParameters, poses: np.ndarray, gravity: float, time_step: float = 1e-6, steps: int = SETTLING_STEPS
) -> Accelerations:
    """Accelerations of the discrete SAP plant, from seven short runs at each pose: no torque, and each motor alone.

    Args:
        robot: Geometry and masses.
        poses: (n, 6) [rad, m].
        gravity: [m/s^2] along -z.
        time_step: [s] of the plant.
        steps: Steps in each run; the velocity gained in the last one is read.

    Raises:
        UnreachablePoseError, SingularPoseError: A pose that cannot be assembled.
        DrakeCheckError: Drake refuses the plant.
    """
    diagram, stewart = build_plant(robot, PlantOptions(time_step=time_step), gravity)
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    port, output = diagram.GetInputPort("torque"), diagram.GetOutputPort("state")
    plant, twist = stewart.plant, stewart.indices.twist
    plant_context, step = plant.GetMyMutableContextFromRoot(context), plant.time_step()
    torque = _TORQUE_SHARE * robot.effort_limit
    runs = np.vstack([np.zeros(LEGS), torque * np.eye(LEGS)])
    gained = np.empty((len(poses), len(runs), 6))
    with drake_guard("measuring accelerations"):
        for row, state in enumerate(stewart.assemble(poses)):
            for column, torques in enumerate(runs):
                context.SetTime(0.0)
                plant.SetPositionsAndVelocities(plant_context, state)
                port.FixValue(context, torques)
                simulator.Initialize()
                simulator.AdvanceTo((steps - 1) * step)
                before = output.Eval(context)[twist]
                simulator.AdvanceTo(steps * step)
                gained[row, column] = (output.Eval(context)[twist] - before) / step
    return Accelerations(poses, np.swapaxes(gained[:, 1:] - gained[:, :1], -1, -2) / torque, gained[:, 0])


def exact(robot: RobotParameters, poses: np.ndarray, gravity: float) -> Accelerations:
    """Accelerations of the exact rigid-body model; arguments and errors as in `measured`."""
    inertia, bias = task_inertia(robot, poses), task_bias(robot, poses, np.zeros_like(poses), gravity)
    per_torque = np.linalg.solve(inertia, np.swapaxes(twist_jacobian(robot, poses), -1, -2))
    return Accelerations(poses, per_torque, -np.linalg.solve(inertia, bias[..., None])[..., 0])


def predicted(robot: RobotParameters, poses: np.ndarray, model: str) -> np.ndarray:
    """Acceleration q'' per unit of motor torque by one of `MODELS`; (n, 6, 6) [rad/s^2, m/s^2 per N m]."""
    wrench = wrench_map(robot, poses, model)
    if model in ("statics, I in B", "massless legs"):
        rate = _of_body(robot, poses, wrench)
        return to_euler(poses, rate) if model == "massless legs" else rate
    return np.asarray(wrench / mass_diagonal(robot)[:, None])


def wrench_map(robot: RobotParameters, poses: np.ndarray, model: str) -> np.ndarray:
    """Map tau of (18) by one of `MODELS`; (n, 6, 6) [-, 1/m]."""
    legs = leg_geometry(robot, poses)
    if model == "printed, p_i unrotated":
        return np.asarray(rod_map_11(robot, legs) * crank_map(robot, legs, "printed")[..., None, :])
    return force_map_of_legs(robot, legs, "printed" if model == "printed" else "statics")


def relative_error(robot: RobotParameters, model: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Error of an acceleration map over all directions of torque: RMS of the error by RMS of the truth; (n) [-].

    Angular parts count times the characteristic length.
    """
    scale = np.repeat([robot.characteristic_length, 1.0], 3)[:, None]
    return np.asarray(
        np.linalg.norm(scale * (model - truth), axis=(-2, -1)) / np.linalg.norm(scale * truth, axis=(-2, -1))
    )


def rod_force_per_torque(robot: RobotParameters, measurement: Accelerations) -> np.ndarray:
    """|a| F_i / T_i that the platform's acceleration tells of, where legs have no mass; (n, 6) [-].

    (15) says e_l.e_N, statics says 1 / (e_l.e_N).
    """
    legs = leg_geometry(robot, measurement.poses)
    force = robot.platform_mass * np.swapaxes(measurement.map[:, 3:], -1, -2)
    return np.asarray(robot.crank_lengths * np.sum(legs.e_l * force, axis=-1))


def torque_parts(
    robot: RobotParameters, pose: np.ndarray, pose_rate: np.ndarray, pose_acceleration: np.ndarray, gravity: float
) -> dict[str, np.ndarray]:
    """Motor torques of a motion, split into what the controller's model knows, (10) with statics, and the rest.

    Args:
        robot: Geometry and masses.
        pose: (n, 6) [rad, m].
        pose_rate: (n, 6) [rad/s, m/s].
        pose_acceleration: (n, 6) [rad/s^2, m/s^2].
        gravity: [m/s^2] along -z.

    Returns:
        Name -> (n, 6) [N m]; their sum is the torque of the exact model.
    """
    rest = np.zeros_like(pose)
    known = np.linalg.solve(wrench_map(robot, pose, "statics"), (mass_diagonal(robot) * pose_acceleration)[..., None])[
        ..., 0
    ]
    return {
        "M q'' of (10)": known,
        "other inertia: legs, and the platform's attitude": inverse_dynamics(robot, pose, rest, pose_acceleration, 0.0)
        - known,
        "velocity: centrifugal and gyroscopic": inverse_dynamics(robot, pose, pose_rate, rest, 0.0),
        "gravity on all bodies": static_torque(robot, pose, gravity),
    }


def to_euler(poses: np.ndarray, twist_rate: np.ndarray) -> np.ndarray:
    """Columns of d(twist)/dt (n, 6, k) at rest as columns of q'' (n, 6, k)."""
    euler = twist_rate.copy()
    euler[..., :3, :] = np.linalg.solve(euler_rate_matrix(poses[..., :3]), twist_rate[..., :3, :])
    return euler


def inertia_in_base(robot: RobotParameters, rpy: np.ndarray) -> np.ndarray:
    """R I R^T: the platform's inertia in B; (..., 3, 3) [kg m^2]."""
    rotation = rotation_matrix(rpy)
    return (rotation * np.array(robot.platform_inertia)) @ np.swapaxes(rotation, -1, -2)


def _of_body(robot: RobotParameters, poses: np.ndarray, wrench: np.ndarray) -> np.ndarray:
    """d(twist)/dt (n, 6, k) of the platform alone under wrenches (n, 6, k) in B."""
    rate = np.empty_like(wrench)
    rate[:, :3] = np.linalg.solve(inertia_in_base(robot, poses[:, :3]), wrench[:, :3])
    rate[:, 3:] = wrench[:, 3:] / robot.platform_mass
    return rate
