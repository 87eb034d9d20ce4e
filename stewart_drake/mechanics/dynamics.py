"""Exact rigid-body dynamics of the closed chain, and the paper's map from torques to a wrench, for arrays of poses.

The model is that of `dynamics_laws`, which has the same for one pose, compiled.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.jit import njit
from stewart_drake.base.records import Matrix, Vec9, record
from stewart_drake.mechanics import dynamics_laws as laws
from stewart_drake.mechanics.kinematics import LegGeometry, RobotLike, at_poses, leg_geometry, rod_lines
from stewart_drake.mechanics.kinematics_laws import LEGS, OK, PARALLEL, UNREACHABLE, Robot, legs_at
from stewart_drake.robot import Gravity, RobotParameters, base_reading

STANDARD_GRAVITY = 9.81
"""[m/s^2] as in Drake's default field."""
ForceMapKind = Literal["printed", "statics"]
_MOTION_TORQUE, _ACCELERATION, _BIAS, _INERTIA, _ACCELERATION_MAP = range(5)
"""Laws that `_rows` evaluates."""


def static_torque(robot: RobotLike, pose: ArrayLike, gravity: Gravity = STANDARD_GRAVITY) -> np.ndarray:
    """Motor torques (..., 6) [N m] that hold platform, rods and cranks at rest at poses (..., 6) [rad, m]."""
    return inverse_dynamics(robot, pose, np.zeros(6), np.zeros(6), gravity)


def inverse_dynamics(
    robot: RobotLike,
    pose: ArrayLike,
    pose_rate: ArrayLike,
    pose_acceleration: ArrayLike,
    gravity: Gravity = STANDARD_GRAVITY,
) -> np.ndarray:
    """Motor torques of a motion, all bodies included.

    Args:
        robot: Geometry and masses.
        pose: (..., 6) [rad, m].
        pose_rate: (..., 6) [rad/s, m/s] Euler rates and velocity.
        pose_acceleration: (..., 6) [rad/s^2, m/s^2] their time derivatives.
        gravity: [m/s^2] along -z of B; or a vector (3,) in B; or (9,), what the inertial unit of a moving base
            reads, see `robot.gravity.base_reading`.

    Returns:
        (..., 6) [N m].

    Raises:
        UnreachablePoseError, ConfigurationError: As in `inverse_kinematics`; a rate or acceleration of another shape.
        numpy.linalg.LinAlgError: Exactly at a parallel singularity.
    """
    motion = {"pose": pose, "pose_rate": pose_rate, "pose_acceleration": pose_acceleration}
    return _at_poses(_MOTION_TORQUE, robot, motion, gravity)[..., 0, :]


def forward_dynamics(
    robot: RobotLike,
    pose: ArrayLike,
    pose_rate: ArrayLike,
    torque: ArrayLike,
    gravity: Gravity = STANDARD_GRAVITY,
) -> np.ndarray:
    """Second derivative (..., 6) [rad/s^2, m/s^2] of the pose under motor torques (..., 6) [N m].

    The inverse of `inverse_dynamics`, with its arguments and errors; pitch away from +-pi/2.
    """
    motion = {"pose": pose, "pose_rate": pose_rate, "torque": torque}
    return _at_poses(_ACCELERATION, robot, motion, gravity)[..., 0, :]


def task_bias(robot: RobotLike, pose: ArrayLike, twist: ArrayLike, gravity: Gravity = STANDARD_GRAVITY) -> np.ndarray:
    """h(pose, twist) (..., 6) [N m, N]: Coriolis, centrifugal, gyroscopic and gravity terms in task coordinates."""
    return _at_poses(_BIAS, robot, {"pose": pose, "twist": twist}, gravity)[..., 0, :]


def task_inertia(robot: RobotLike, pose: ArrayLike) -> np.ndarray:
    """M(pose) (..., 6, 6) [kg m^2, kg m, kg]: inertia of the closed chain in task coordinates."""
    return _at_poses(_INERTIA, robot, {"pose": pose})


def crank_inertia(robot: RobotParameters, pose: np.ndarray) -> np.ndarray:
    """Inertia (6, 6) [kg m^2] of the whole robot in the cranks' angles, at a pose (6,)."""
    legs = leg_geometry(robot, pose)
    to_twist = np.linalg.inv(rod_lines(legs) / (robot.crank_lengths * legs.transmission)[:, None])
    return np.asarray(to_twist.T @ task_inertia(robot, pose) @ to_twist)


def pose_acceleration_map(robot: RobotLike, pose: ArrayLike) -> np.ndarray:
    """E^-1 M^-1 J' (..., 6, 6): second derivative of the pose per unit of motor torque; M^-1 tau of (10), exact."""
    return _at_poses(_ACCELERATION_MAP, robot, {"pose": pose})


def _at_poses(law: int, robot: RobotLike, inputs: Mapping[str, ArrayLike], gravity: Gravity = 0.0) -> np.ndarray:
    """A law's matrices (..., 6, 6), or vectors as (..., 1, 6), of a pose and up to two vectors (..., 6)."""
    rows = 6 if law in (_INERTIA, _ACCELERATION_MAP) else 1
    unused = {f"unused {k}": np.zeros(6) for k in range(len(inputs), 3)}
    return at_poses(_rows, robot, {**inputs, **unused}, (rows, 6), law, base_reading(gravity))


@njit
def _rows(robot: Robot, law: float, base: Vec9, poses: Matrix, vectors: Matrix, others: Matrix, out: np.ndarray) -> int:
    memory: Any = np.empty(1, LEGS)
    robot, motion, nothing = record(robot), np.empty(12), np.zeros(6)
    for n in range(len(poses)):
        # In the loop, which keeps `memory` alive.
        legs, pose, vector, done = record(memory), poses[n], vectors[n], True
        if legs_at(robot, pose, legs) >= 0:
            return UNREACHABLE
        if law == _MOTION_TORQUE:
            for k in range(6):
                motion[k], motion[6 + k] = pose[k], vector[k]
            done = laws.motion_torque(robot, legs, motion, others[n], base, out[n, 0])
        elif law == _ACCELERATION:
            done = laws.forward_dynamics(robot, legs, pose, vector, others[n], nothing, base, out[n, 0])
        elif law == _BIAS:
            laws.task_bias(robot, legs, vector, base, out[n, 0])
        elif law == _INERTIA:
            laws.task_inertia(robot, legs, out[n])
        else:
            done = laws.pose_acceleration_map(robot, legs, pose, out[n])
        if not done:
            return PARALLEL
    return OK


def base_wrenches(
    base: np.ndarray, mass: np.ndarray, place: np.ndarray, velocity: np.ndarray, rate: np.ndarray, inertia: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Moments and forces (n, 3) [N m, N] about their centres of mass that a moving base exerts on n free bodies.

    Args:
        base: (9,) reading of the base's inertial unit, see `robot.gravity.base_reading`.
        mass: (n,) [kg].
        place: (n, 3) [m] centres of mass in B.
        velocity: (n, 3) [m/s] their velocities in B.
        rate: (n, 3) [rad/s] angular velocities in B.
        inertia: (n, 3, 3) [kg m^2] about the centres of mass, along the axes of B.
    """
    force, w, alpha = np.reshape(base, (3, 3))
    acceleration = force + np.cross(alpha, place) + np.cross(w, np.cross(w, place) + 2.0 * velocity)
    spin = alpha + np.cross(w, rate)
    moment = np.einsum("nij,nj->ni", inertia, spin) + np.cross(w, np.einsum("nij,nj->ni", inertia, w + rate))
    return -(moment + np.cross(rate, inertia @ w)), -mass[:, None] * acceleration


# --- the paper's force map -------------------------------------------------------------------------------------------


def rod_map(legs: LegGeometry) -> np.ndarray:
    """tau_1 (..., 6, 6) of (14): wrench [M; F] of P in B from the six rod forces.

    Deviation: e_M = (R^-1 p_i) x e_l; in the paper p_i is not rotated.
    """
    return rod_lines(legs).swapaxes(-1, -2)


def crank_map(robot: RobotParameters, legs: LegGeometry, kind: ForceMapKind) -> np.ndarray:
    """Diagonal (..., 6) [1/m] of tau_2 of (16): force in a rod per unit of motor torque.

    `printed` is (e_l . e_N) / |a|. Deviation: the statics of a massless crank and rod give 1 / (|a| (e_l . e_N)),
    `statics`, infinite at a crank's dead centre; both agree only if the rod lies along e_N.
    """
    cranks = robot.crank_lengths
    if kind == "printed":
        return legs.transmission / cranks
    if kind != "statics":
        raise ConfigurationError("force_map", kind, "statics or printed")
    with np.errstate(divide="ignore"):
        return 1.0 / (cranks * legs.transmission)


def force_map_of_legs(robot: RobotParameters, legs: LegGeometry, kind: ForceMapKind) -> np.ndarray:
    """Map tau (..., 6, 6) [-, 1/m] of (18) from leg vectors."""
    return rod_map(legs) * crank_map(robot, legs, kind)[..., None, :]


def force_map(robot: RobotParameters, pose: ArrayLike, kind: ForceMapKind = "statics") -> np.ndarray:
    """Map tau (..., 6, 6) of (18): wrench [moment; force] on the platform, in B, per unit of motor torque."""
    return force_map_of_legs(robot, leg_geometry(robot, pose), kind)
