"""Inverse and forward kinematics of the 6-RSS platform, (1)-(6), and their Jacobians, for poses with any leading axes.

Poses are [roll, pitch, yaw, X, Y, Z] of P in B; R_BP = Rz(yaw) Ry(pitch) Rx(roll), the inverse of the paper's (3). A
twist is [w, v]: angular velocity of P and velocity of its origin, both in B. Many poses are computed on all cores.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike

from stewart_drake.base.errors import ConfigurationError, ForwardKinematicsError, UnreachablePoseError
from stewart_drake.base.jit import njit
from stewart_drake.base.records import Matrix, record
from stewart_drake.mechanics import kinematics_laws as laws
from stewart_drake.mechanics.kinematics_laws import OK, UNREACHABLE, Legs, Robot
from stewart_drake.robot import RobotParameters

CHUNK = 512
"""Poses for a thread; to start one takes as long as some fifty poses."""
CLOSED, NEWTON_STEPS = 1e-13, 30
"""`forward_kinematics` ends at this error [m] of the rods' lengths, or after so many steps of Newton's method."""

Loop = Callable[..., int | None]
"""Takes shared arguments, then arrays with a row for each pose, the last to be filled; returns a status."""
RobotLike = RobotParameters | Robot
"""A robot, or its record."""


# --- many poses ------------------------------------------------------------------------------------------------------


def over_rows(loop: Loop, shared: tuple[Any, ...], rows: tuple[np.ndarray, ...]) -> int:
    """Runs a loop over rows, on all cores if there are many rows; the worst status."""

    def run(start: int, stop: int) -> int:
        with np.errstate(all="ignore"):  # for uncompiled laws
            return loop(*shared, *(array[start:stop] for array in rows)) or OK

    count = len(rows[0])
    chunks = min(os.cpu_count() or 1, count // CHUNK)
    if chunks < 2:
        return run(0, count)
    edges = np.linspace(0, count, chunks + 1).astype(int).tolist()
    # A new pool for each call: threads do not survive a fork.
    with ThreadPoolExecutor(chunks) as pool:
        return max(pool.map(run, edges[:-1], edges[1:]))


def at_poses(
    loop: Loop,
    robot: RobotLike,
    inputs: Mapping[str, ArrayLike],
    tail: tuple[int, ...],
    *numbers: float | np.ndarray,
    kind: DTypeLike = float,
) -> np.ndarray:
    """Values (..., *tail) at poses.

    Args:
        loop: Takes the robot's record, the numbers, rows of the inputs, and rows to fill.
        robot: Geometry.
        inputs: Name -> (..., 6), broadcast together; `pose` must be finite.
        tail: Shape of a value.
        numbers: For the loop.
        kind: Type of the values.

    Raises:
        ConfigurationError: A wrong shape, or a pose that is not finite.
        UnreachablePoseError: Of the worst leg of all poses.
        numpy.linalg.LinAlgError: At a singularity.
    """
    arrays = {name: np.asarray(value, dtype=float) for name, value in inputs.items()}
    for name, array in arrays.items():
        finite = name != "pose" or np.isfinite(array).all()
        if array.shape[-1:] != (6,) or not finite:
            wanted = "finite numbers" if name == "pose" else "numbers"
            raise ConfigurationError(name, inputs[name], f"{wanted} of shape (..., 6)")
    names, leading = list(arrays), np.broadcast_shapes(*(array.shape[:-1] for array in arrays.values()))
    rows = [np.array(array, order="C").reshape(-1, 6) for array in np.broadcast_arrays(*arrays.values())]
    values, shared = (
        np.empty((len(rows[0]), *tail), dtype=kind),
        (as_record(robot), *(n if isinstance(n, np.ndarray) else float(n) for n in numbers)),
    )
    if over_rows(loop, shared, (*rows, values)) != OK:
        poses = rows[names.index("pose")]
        margins = reach_margin(robot, poses)
        row, leg = np.unravel_index(int(margins.argmin()), margins.shape)
        if margins[row, leg] < 0.0:
            raise UnreachablePoseError(poses[row].copy(), int(leg), float(margins[row, leg]))
        raise np.linalg.LinAlgError("Singular matrix: the pose is singular")
    return values.reshape((*leading, *tail))[()]


def as_record(robot: RobotLike) -> Robot:
    """The record of a robot, read-only."""
    if isinstance(robot, RobotParameters):
        return laws.robot_record(robot)
    view = robot.view()
    view.flags.writeable = False  # so that laws are compiled for one type
    return view


@njit
def _legs(robot: Robot, poses: Matrix, legs: Any) -> int:
    robot, status = record(robot), OK
    for n in range(len(poses)):
        if laws.legs_at(robot, poses[n], record(legs[n : n + 1])) >= 0:
            status = UNREACHABLE
    return status


def _of_legs(
    values: Callable[[np.ndarray, np.ndarray], np.ndarray],
    robot: RobotLike,
    pose: ArrayLike,
    tail: tuple[int, ...],
    out_of_reach: bool = False,
) -> np.ndarray:
    """Values (..., *tail) of `Legs` records (n,) and poses (n, 6), which may be valid out of reach too."""

    def loop(robot: Robot, poses: np.ndarray, out: np.ndarray) -> int:
        status = OK
        for start in range(0, len(poses), CHUNK):
            rows = slice(start, start + CHUNK)
            legs = np.empty(len(poses[rows]), Legs.layout)
            status = max(status, _legs(robot, poses[rows], legs))
            out[rows] = values(legs, poses[rows])
        return OK if out_of_reach else status

    return at_poses(loop, robot, {"pose": pose}, tail)


# --- orientations ----------------------------------------------------------------------------------------------------


def _on_arrays(law: Callable[..., None], shape: tuple[int, ...], *inputs: ArrayLike, axes: int = 1) -> np.ndarray:
    """A law of vectors (`axes` 1) or matrices (2) for any leading axes: its source, run by numpy on components."""
    arrays = np.broadcast_arrays(*(np.asarray(values, dtype=float) for values in inputs))
    components = [np.moveaxis(array, range(-axes, 0), range(axes)) for array in arrays]
    out = np.empty((*shape, *arrays[0].shape[:-axes]))
    getattr(law, "py_func", law)(*components, out)
    return np.ascontiguousarray(np.moveaxis(out, range(len(shape)), range(-len(shape), 0)))


def rotation_matrix(rpy: ArrayLike) -> np.ndarray:
    """R_BP (..., 3, 3) of roll, pitch, yaw (..., 3) [rad]; the inverse of (3)."""
    return _on_arrays(laws.rotation, (3, 3), rpy)


def quaternion(rpy: np.ndarray) -> np.ndarray:
    """w, x, y, z (..., 4) [-] of `rotation_matrix(rpy)`."""
    (sr, sp, sy), (cr, cp, cy) = np.moveaxis(np.sin(0.5 * rpy), -1, 0), np.moveaxis(np.cos(0.5 * rpy), -1, 0)
    w, x = cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy
    y, z = cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy
    return np.stack([w, x, y, z], axis=-1)


def rotation_angle(rotation: np.ndarray) -> np.ndarray:
    """Angle (...) [rad] of rotations (..., 3, 3)."""
    # An arccos of the trace alone would lose half the digits of a small angle.
    twice_sine = np.linalg.norm(rotation - np.swapaxes(rotation, -1, -2), axis=(-2, -1)) / np.sqrt(2.0)
    return np.arctan2(twice_sine, np.trace(rotation, axis1=-2, axis2=-1) - 1.0)


def roll_pitch_yaw(matrix: ArrayLike) -> np.ndarray:
    """Roll, pitch, yaw (..., 3) [rad] of rotation matrices (..., 3, 3); pitch in [-pi/2, pi/2]."""
    return _on_arrays(laws.roll_pitch_yaw, (3,), matrix, axes=2)


def euler_rate_matrix(rpy: ArrayLike) -> np.ndarray:
    """E (..., 3, 3) with w_B = E(rpy) d(rpy)/dt, of rpy (..., 3) [rad]; singular at pitch = +-pi/2."""
    return np.stack([_on_arrays(laws.angular_velocity, (3,), rpy, rate) for rate in np.eye(3)], axis=-1)


def pose_rate_to_twist(pose: ArrayLike, pose_rate: ArrayLike) -> np.ndarray:
    """Twist [w, v] (..., 6) [rad/s, m/s] of P in B, from poses (..., 6) and their rates (..., 6)."""
    pose, rate = np.broadcast_arrays(np.asarray(pose, dtype=float), np.asarray(pose_rate, dtype=float))
    spin = _on_arrays(laws.angular_velocity, (3,), pose[..., :3], rate[..., :3])
    return np.concatenate([spin, rate[..., 3:]], axis=-1)


def twist_to_pose_rate(pose: ArrayLike, twist: ArrayLike) -> np.ndarray:
    """Inverse of `pose_rate_to_twist`; pitch away from +-pi/2."""
    pose, twist = np.broadcast_arrays(np.asarray(pose, dtype=float), np.asarray(twist, dtype=float))
    return np.concatenate([_on_arrays(laws.euler_rates, (3,), pose[..., :3], twist[..., :3]), twist[..., 3:]], axis=-1)


def cross(a: ArrayLike, b: ArrayLike) -> np.ndarray:
    """Cross product (..., 3); several times faster than numpy's on small arrays."""
    return _on_arrays(laws.cross, (3,), a, b)


# --- legs ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class LegGeometry:
    """Vectors of the six legs at one pose (or many), all in B.

    Attributes:
        rotation: (..., 3, 3) [-] R_BP.
        crank_angles: (..., 6) [rad] theta_i.
        arm: (..., 6, 3) [m] platform joints relative to P: R p_i.
        crank: (..., 6, 3) [-] unit vectors along the cranks.
        e_n: (..., 6, 3) [-] unit vectors along which the crank tips move for growing theta.
        e_l: (..., 6, 3) [-] unit vectors along the rods, from crank tip to platform joint.
        transmission: (..., 6) [-] e_l . e_N; zero where a crank is at its dead centre.
    """

    rotation: np.ndarray
    crank_angles: np.ndarray
    arm: np.ndarray
    crank: np.ndarray
    e_n: np.ndarray
    e_l: np.ndarray
    transmission: np.ndarray


def reach_margin(robot: RobotLike, pose: ArrayLike) -> np.ndarray:
    """1 - |C| / sqrt(A^2 + B^2) (..., 6) of the legs; negative where a rod cannot span, zero at a dead centre."""
    margins = _of_legs(lambda legs, _: legs["reach_margin"], robot, pose, (6,), out_of_reach=True)
    # NaN: so far off that squares overflow.
    return np.where(np.isnan(margins), -np.inf, margins)


def inverse_kinematics(robot: RobotLike, pose: ArrayLike) -> np.ndarray:
    """Crank angles that put the platform at `pose`; closed form of (1)-(6).

    Args:
        robot: Geometry.
        pose: (..., 6) [rad, rad, rad, m, m, m] roll, pitch, yaw, X, Y, Z of P in B.

    Returns:
        (..., 6) [rad] crank angles, wrapped to (-pi, pi].

    Raises:
        UnreachablePoseError: A rod cannot span; `.leg`, `.pose` and `.margin` say which, where and by how much.
        ConfigurationError: A pose that is not finite or not (..., 6).
    """
    return _of_legs(lambda legs, _: np.arctan2(legs["sine"], legs["cosine"]), robot, pose, (6,))


def leg_geometry(robot: RobotLike, pose: ArrayLike) -> LegGeometry:
    """Directions of cranks and rods at poses (..., 6) [rad, m], Fig. 1; else as `inverse_kinematics`."""
    legs = at_poses(_legs, robot, {"pose": pose}, (), kind=Legs.layout)
    names = ("rotation", "arm", "crank", "e_n", "e_l", "transmission")
    theta = np.arctan2(legs["sine"], legs["cosine"])
    return LegGeometry(crank_angles=theta, **{name: np.ascontiguousarray(legs[name]) for name in names})


def rod_lines(legs: LegGeometry) -> np.ndarray:
    """Rows [e_M, e_l] = [(R p_i) x e_l, e_l] (..., 6, 6): the rods as unit lines, (14) transposed."""
    return np.concatenate([cross(legs.arm, legs.e_l), legs.e_l], axis=-1)


def twist_jacobian(robot: RobotLike, pose: ArrayLike) -> np.ndarray:
    """d(theta)/d(twist) (..., 6, 6): crank rates from the twist of P; infinite at a crank's dead centre."""
    return _of_legs(lambda legs, _: legs["line"] / legs["lever"][..., None], robot, pose, (6, 6))


def pose_jacobian(robot: RobotLike, pose: ArrayLike) -> np.ndarray:
    """d(theta)/d(pose) (..., 6, 6): crank rates from the pose's rate (Euler rates)."""

    def values(legs: np.ndarray, poses: np.ndarray) -> np.ndarray:
        jacobian = legs["line"] / legs["lever"][..., None]
        jacobian[..., :3] = jacobian[..., :3] @ euler_rate_matrix(poses[:, :3])
        return np.asarray(jacobian)

    return _of_legs(values, robot, pose, (6, 6))


def crank_rates(robot: RobotParameters, legs: LegGeometry, pose: np.ndarray, pose_rate: np.ndarray) -> np.ndarray:
    """Crank rates (..., 6) [rad/s] from `leg_geometry` of a pose and its rate; infinite or NaN at a dead centre."""
    twist = pose_rate_to_twist(pose, pose_rate)
    return np.einsum("...ij,...j->...i", rod_lines(legs), twist) / (robot.crank_lengths * legs.transmission)


def forward_kinematics(robot: RobotLike, crank_angles: ArrayLike, guess: ArrayLike | None = None) -> np.ndarray:
    """Pose of the platform from the crank angles, by Newton's method on the six rod lengths.

    The guess decides the assembly mode to which the method converges.

    Args:
        robot: Geometry.
        crank_angles: (..., 6) [rad].
        guess: (..., 6) [rad, m] start; None takes the home pose of a `RobotParameters`.

    Returns:
        (..., 6) [rad, m].

    Raises:
        ForwardKinematicsError: No convergence, or a singular Jacobian; with the largest remaining error.
        ConfigurationError: Wrong shape, or not finite; no guess for a robot that is a record.
    """
    theta = np.asarray(crank_angles, dtype=float)
    if theta.shape[-1:] != (6,) or not np.isfinite(theta).all():
        raise ConfigurationError("crank_angles", crank_angles, "finite numbers of shape (..., 6)")
    guess = robot.home_pose if guess is None and isinstance(robot, RobotParameters) else guess
    start = np.asarray(guess, dtype=float)
    if start.shape[-1:] != (6,) or not np.isfinite(start).all():
        raise ConfigurationError("guess", guess, "finite numbers of shape (..., 6)")
    try:
        poses = np.broadcast_to(start, theta.shape).reshape(-1, 6)
    except ValueError:
        allowed = f"finite numbers whose shape fits that of crank_angles, {theta.shape}"
        raise ConfigurationError("guess", start, allowed) from None
    poses, error, steps = newton(robot, theta.reshape(-1, 6), poses, CLOSED, NEWTON_STEPS)
    if not (error <= CLOSED).all():
        worst = np.nan_to_num(error, nan=np.inf).argmax()
        raise ForwardKinematicsError(float(error[worst]), int(steps[worst]))
    return poses.reshape(theta.shape)


def newton(
    robot: RobotLike, theta: np.ndarray, start: np.ndarray, tolerance: float, iterations: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`forward_kinematics` of angles and starts (n, 6), without raising: poses (n, 6), errors (n,) [m], steps (n,)."""
    poses, results = np.array(start, order="C"), np.zeros((len(theta), 2))
    angles = np.array(theta, order="C")
    over_rows(_forward_kinematics, (as_record(robot), float(tolerance), int(iterations)), (angles, poses, results))
    return poses, results[:, 0], results[:, 1]


def rod_length_errors(robot: RobotLike, crank_angles: ArrayLike, pose: ArrayLike) -> np.ndarray:
    """Distance from crank tip to platform joint minus the rod's length (..., 6) [m]."""
    return at_poses(_closures, robot, {"pose": pose, "crank_angles": crank_angles}, (6,))


def conditioning(robot: RobotLike, pose: ArrayLike) -> np.ndarray:
    """sigma_min / sigma_max (...) of [e_M / length; e_l] of (14), rotations over the characteristic length.

    Rotations are about the platform's centre, with a tool too. Zero at a parallel singularity; for dead centres see
    `LegGeometry.transmission`.
    """
    length, center = (as_record(robot)[name][0] for name in ("length", "center"))

    def ratio(legs: np.ndarray, _: np.ndarray) -> np.ndarray:
        moments = legs["line"][..., :3] - np.cross((legs["rotation"] @ center)[..., None, :], legs["e_l"])
        # At a pose out of reach, an error later, lines may not be finite.
        lines = np.nan_to_num(np.concatenate([moments / length, legs["e_l"]], -1), posinf=0.0, neginf=0.0)
        sigma = np.linalg.svd(lines, compute_uv=False)
        return np.asarray(sigma[:, -1] / sigma[:, 0])

    return _of_legs(ratio, robot, pose, ())


@njit
def _forward_kinematics(
    robot: Robot, tolerance: float, iterations: int, angles: Matrix, poses: Matrix, results: Matrix
) -> None:
    robot = record(robot)
    for n in range(len(angles)):
        results[n, 0], results[n, 1] = laws.forward_kinematics(robot, angles[n], poses[n], tolerance, iterations)


@njit
def _closures(robot: Robot, poses: Matrix, angles: Matrix, out: Matrix) -> int:
    robot, tips, errors, slope = record(robot), np.empty((6, 3)), np.empty((6, 1)), np.empty((6, 6))
    for n in range(len(poses)):
        laws.crank_tips(robot, angles[n], tips)
        laws.closures(robot, tips, poses[n], errors, slope)
        for i in range(6):
            out[n, i] = errors[i, 0]
    return OK
