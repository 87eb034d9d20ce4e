"""Kinematics of the closed chain, (1)-(6), compiled, for one robot at one pose.

Poses are [roll, pitch, yaw, X, Y, Z] of P in B; a twist is [w, v], angular velocity of P and velocity of its origin in
B. Functions fill their last argument. `kinematics` has the same for arrays of poses, with checks.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from stewart_drake.base.jit import njit
from stewart_drake.base.records import Mat3, Mat6, Mat6x1, Mat6x3, Matrix, Record, Vec3, Vec4, Vec6
from stewart_drake.mechanics.linear_algebra import singular_vectors, solve
from stewart_drake.robot import RobotParameters

OK, UNREACHABLE, SERIAL, PARALLEL, NOT_FINITE, NO_CONVERGENCE, NO_GAIN = range(7)
"""Status of a law; its caller raises the error of that name, see `control.base.failure`."""
QUICK = 1e-7
"""Tolerance of `conditioning` for seven digits."""


class Robot(Record):
    """Numbers of a robot. P is the tool's frame where it has a tool."""

    shaft: Mat6x3  # [m] P_i in B.
    joint: Mat6x3  # [m] p_i in P.
    center: Vec3  # [m] of the platform in P; zeros without a tool.
    crank_x: Mat6x3  # Direction of a crank at theta = 0, in B.
    crank_y: Mat6x3  # The same at theta = 90 deg.
    crank_length: Vec6  # [m]
    rod_length: Vec6  # [m]
    branch: Vec6  # 1 or -1: solution of (6) in which the leg is assembled.
    crank_inertia: Vec6  # [kg m^2] of crank and rotor about the motor's axis.
    effort_limit: Vec6  # [N m]
    rod_mass: float  # [kg]
    rod_inertia: float  # [kg m^2] across the rod.
    crank_mass: float  # [kg]
    crank_tensor: Vec3  # [kg m^2] of a crank about its centre: along it, about the motor's axis, across both.
    length: float  # [m] characteristic length.
    platform_mass: float  # [kg]
    platform_moment: Vec3  # [kg m] mass times centre of mass in P.
    platform_tensor: Mat3  # [kg m^2] about the origin of P.
    platform_inertia: Vec3  # [kg m^2] about the centre of mass, for the paper's model.


class Legs(Record):
    """Result of `legs_at` at a pose; vectors in B."""

    rotation: Mat3  # R_BP
    arm: Mat6x3  # [m] R p_i
    crank: Mat6x3  # Unit vectors along the cranks.
    e_n: Mat6x3  # Unit vectors in which crank tips move for growing theta.
    e_l: Mat6x3  # Unit vectors along the rods, from crank to platform.
    line: Mat6  # [(R p_i) x e_l, e_l], rows of (14) transposed.
    lever: Vec6  # [m] torque of a motor over force in its rod.
    transmission: Vec6  # e_l . e_N
    cosine: Vec6  # Cosine of theta.
    sine: Vec6
    reach_margin: Vec6  # 1 - |C| / sqrt(A^2 + B^2); negative where a rod cannot span.


LEGS = Legs.layout
"""For `np.empty(1, LEGS)` in a compiled law."""


@lru_cache(maxsize=1024)
def robot_record(robot: RobotParameters) -> Robot:
    """The record of a robot; read-only."""
    numbers = Robot.new(
        shaft=robot.shaft_positions,
        joint=robot.platform_joints,
        center=robot.platform_origin,
        crank_x=robot.crank_zero_directions,
        crank_y=robot.crank_quarter_directions,
        crank_length=robot.crank_lengths,
        rod_length=robot.rod_lengths,
        branch=robot.branches,
        crank_inertia=robot.crank_axis_inertias,
        effort_limit=robot.effort_limits,
        rod_mass=robot.rod_mass,
        rod_inertia=robot.rod_inertia[0],
        crank_mass=robot.crank_mass,
        crank_tensor=robot.crank_inertia,
        length=robot.characteristic_length,
        platform_mass=robot.platform_mass,
        platform_moment=robot.platform_moment,
        platform_tensor=robot.platform_inertia_about_origin,
        platform_inertia=np.diag(robot.central_inertia),
    )
    numbers.flags.writeable = False
    return numbers


def with_payload(robot: Robot, mass: float, place: np.ndarray) -> Robot:
    """The robot with a point mass [kg] at a place (3,) [m] in P added to its platform."""
    loaded = robot.copy()
    loaded["platform_mass"] += mass
    loaded["platform_moment"] += mass * place
    loaded["platform_tensor"] += mass * ((place @ place) * np.eye(3) - np.outer(place, place))
    return loaded


@njit
def rotation(rpy: Vec3, out: Mat3) -> None:
    """R_BP = Rz(yaw) Ry(pitch) Rx(roll) of rpy [rad]; the inverse of (3).

    Deviation: entry (3,1) of (3) is a misprint, corrected here.
    """
    sr, sp, sy = np.sin(rpy[0]), np.sin(rpy[1]), np.sin(rpy[2])
    cr, cp, cy = np.cos(rpy[0]), np.cos(rpy[1]), np.cos(rpy[2])
    out[0, 0], out[0, 1], out[0, 2] = cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr
    out[1, 0], out[1, 1], out[1, 2] = sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr
    out[2, 0], out[2, 1], out[2, 2] = -sp, cp * sr, cp * cr


@njit
def roll_pitch_yaw(matrix: Mat3, out: Vec3) -> None:
    """Roll, pitch, yaw [rad] of a rotation matrix; pitch in [-pi/2, pi/2]."""
    out[0] = np.arctan2(matrix[2, 1], matrix[2, 2])
    out[1] = np.arcsin(np.minimum(1.0, np.maximum(-1.0, -matrix[2, 0])))
    out[2] = np.arctan2(matrix[1, 0], matrix[0, 0])


@njit
def quaternion_angles(quaternion: Vec4, out: Vec3) -> None:
    """Roll, pitch, yaw [rad] of a quaternion w, x, y, z of any length; pitch in [-pi/2, pi/2]."""
    w, x, y, z = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    size = w * w + x * x + y * y + z * z
    out[0] = np.arctan2(2.0 * (w * x + y * z), size - 2.0 * (x * x + y * y))
    out[1] = np.arcsin(np.minimum(1.0, np.maximum(-1.0, 2.0 * (w * y - x * z) / size)))
    out[2] = np.arctan2(2.0 * (w * z + x * y), size - 2.0 * (y * y + z * z))


@njit
def angular_velocity(rpy: Vec3, rate: Vec3, out: Vec3) -> None:
    """Angular velocity w = E(rpy) rate [rad/s] in B, of Euler rates."""
    sp, cp, sy, cy = np.sin(rpy[1]), np.cos(rpy[1]), np.sin(rpy[2]), np.cos(rpy[2])
    out[0], out[1], out[2] = cy * cp * rate[0] - sy * rate[1], sy * cp * rate[0] + cy * rate[1], rate[2] - sp * rate[0]


@njit
def euler_rates(rpy: Vec3, omega: Vec3, out: Vec3) -> None:
    """Euler rates of an angular velocity in B, which may be the same array; pitch away from +-pi/2."""
    sp, cp, sy, cy = np.sin(rpy[1]), np.cos(rpy[1]), np.sin(rpy[2]), np.cos(rpy[2])
    roll = (cy * omega[0] + sy * omega[1]) / cp
    out[0], out[1], out[2] = roll, cy * omega[1] - sy * omega[0], omega[2] + sp * roll


@njit
def euler_rates_of_columns(rpy: Vec3, columns: Matrix) -> None:
    """`euler_rates` of the first three rows of columns (6, n), in place."""
    sp, cp, sy, cy = np.sin(rpy[1]), np.cos(rpy[1]), np.sin(rpy[2]), np.cos(rpy[2])
    for i in range(columns.shape[1]):
        x, y = columns[0, i], columns[1, i]
        roll = (cy * x + sy * y) / cp
        columns[0, i], columns[1, i] = roll, cy * y - sy * x
        columns[2, i] += sp * roll


@njit
def euler_drift(rpy: Vec3, rate: Vec3, out: Vec3) -> None:
    """Angular acceleration dE/dt rate [rad/s^2] at constant Euler rates."""
    sp, cp, sy, cy = np.sin(rpy[1]), np.cos(rpy[1]), np.sin(rpy[2]), np.cos(rpy[2])
    roll, pitch, yaw = rate[0], rate[1], rate[2]
    out[0] = (-sy * cp * yaw - cy * sp * pitch) * roll - cy * yaw * pitch
    out[1] = (cy * cp * yaw - sy * sp * pitch) * roll - sy * yaw * pitch
    out[2] = -cp * pitch * roll


@njit
def euler_moments(rpy: Vec3, rows: Matrix) -> None:
    """Converts moments in B, the first three columns of rows (n, 6), to moments that act on Euler rates, in place."""
    sp, cp, sy, cy = np.sin(rpy[1]), np.cos(rpy[1]), np.sin(rpy[2]), np.cos(rpy[2])
    for i in range(len(rows)):
        x, y, z = rows[i, 0], rows[i, 1], rows[i, 2]
        rows[i, 0], rows[i, 1] = cp * (cy * x + sy * y) - sp * z, cy * y - sy * x


@njit
def twist_of(pose: Vec6, rate: Vec6, out: Vec6) -> None:
    """Twist [w, v] of P in B from a pose and its rate."""
    angular_velocity(pose[:3], rate[:3], out[:3])
    for k in range(3, 6):
        out[k] = rate[k]


@njit
def rate_of(pose: Vec6, twist: Vec6, out: Vec6) -> None:
    """Rate of a pose from the twist; the inverse of `twist_of`."""
    euler_rates(pose[:3], twist[:3], out[:3])
    for k in range(3, 6):
        out[k] = twist[k]


@njit
def dot(a: Vec3, b: Vec3) -> float:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit
def cross(a: Vec3, b: Vec3, out: Vec3) -> None:
    """Vector product."""
    out[0], out[1], out[2] = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit
def turned(matrix: Mat3, vector: Vec3, out: Vec3) -> None:
    """Matrix times vector."""
    for k in range(3):
        out[k] = matrix[k, 0] * vector[0] + matrix[k, 1] * vector[1] + matrix[k, 2] * vector[2]


@njit
def legs_at(robot: Robot, pose: Vec6, legs: Legs) -> int:
    """Directions of cranks and rods at a pose, closed form of (1)-(6), Fig. 1.

    Deviation: (5) rotates G as well, a misplaced bracket; (6) gives one branch in degrees without A, B, C. Here
    theta_i = atan2(B, A) + branch acos(C / sqrt(A^2 + B^2)); its cosine and sine are computed without the angle.

    Args:
        robot: Geometry.
        pose: [rad, m].
        legs: Out; if the result is not -1, only `rotation`, `arm` and `reach_margin` are valid.

    Returns:
        -1, or the leg of the least margin if that is negative or NaN.
    """
    # A slice of a record's field has the type of other arrays; laws are compiled for that type only.
    turn, span = legs.rotation[:], np.empty(3)
    rotation(pose[:3], turn)
    worst, leg = 0.0, -1
    for i in range(6):
        a, rod, x, y = robot.crank_length[i], robot.rod_length[i], robot.crank_x[i], robot.crank_y[i]
        turned(turn, robot.joint[i], legs.arm[i])
        for k in range(3):
            span[k] = legs.arm[i, k] + pose[3 + k] - robot.shaft[i, k]
        along, up, constant = 2.0 * a * dot(span, x), 2.0 * a * dot(span, y), dot(span, span) + a * a - rod * rod
        size = np.sqrt(along * along + up * up)
        ratio = constant / size if size > 0.0 else np.inf
        legs.reach_margin[i] = 1.0 - abs(ratio)
        if not legs.reach_margin[i] >= worst:
            worst, leg = legs.reach_margin[i], i
        height = robot.branch[i] * np.sqrt(max(0.0, (1.0 - ratio) * (1.0 + ratio)))
        c, s = (along * ratio - up * height) / size, (up * ratio + along * height) / size
        legs.cosine[i], legs.sine[i] = c, s
        for k in range(3):
            legs.crank[i, k] = c * x[k] + s * y[k]
            legs.e_n[i, k] = c * y[k] - s * x[k]
            legs.e_l[i, k] = (span[k] - a * legs.crank[i, k]) / rod
        legs.transmission[i] = dot(legs.e_l[i], legs.e_n[i])
        legs.lever[i] = a * legs.transmission[i]
        cross(legs.arm[i], legs.e_l[i], legs.line[i, :3])
        for k in range(3):
            legs.line[i, 3 + k] = legs.e_l[i, k]
    return leg


@njit
def crank_rates(legs: Legs, twist: Vec6, out: Vec6) -> None:
    """Rates of the cranks [rad/s] from a twist; infinite or NaN at a dead centre."""
    for i in range(6):
        out[i] = (dot(legs.line[i, :3], twist[:3]) + dot(legs.line[i, 3:], twist[3:])) / legs.lever[i]


@njit
def crank_jacobian(legs: Legs, out: Mat6) -> None:
    """Jacobian d(theta)/d(twist) [-, rad/m]; infinite at a dead centre."""
    for i in range(6):
        for k in range(6):
            out[i, k] = legs.line[i, k] / legs.lever[i]


@njit
def conditioning(robot: Robot, legs: Legs, tolerance: float, enough: float) -> float:
    """sigma_min / sigma_max of the rods' lines (14), rotations over the characteristic length [-].

    If it is clearly above `enough`, a lower bound that is still above `enough` is returned, in a tenth of the time: one
    over the Frobenius norms of the matrix and its inverse, which are at least sigma_max and 1 / sigma_min.

    Rotations are about the platform's centre, with a tool too. Zero at a parallel singularity; for dead centres see
    `Legs.transmission`. `tolerance` is that of `linear_algebra.singular_vectors`; `QUICK` is enough for a check.
    """
    scaled, s, v = np.empty((6, 6)), np.empty(6), np.zeros((6, 6))
    center, moment = np.empty(3), np.empty(3)
    turned(legs.rotation[:], robot.center[:], center)
    for i in range(6):
        cross(center, legs.e_l[i], moment)
        for k in range(3):
            scaled[i, k] = (legs.line[i, k] - moment[k]) / robot.length
            scaled[i, 3 + k] = legs.line[i, 3 + k]
        v[i, i] = 1.0
    if enough < np.inf and solve(scaled.copy(), v) != 0.0:
        size, inverse_size = 0.0, 0.0
        for i in range(6):
            for k in range(6):
                size += scaled[i, k] * scaled[i, k]
                inverse_size += v[i, k] * v[i, k]
        bound = 1.0 / np.sqrt(size * inverse_size)
        if bound >= enough:
            return bound
    singular_vectors(scaled, s, v, tolerance)
    smallest, largest = s[0], s[0]
    for i in range(1, 6):
        smallest, largest = min(smallest, s[i]), max(largest, s[i])
    return smallest / largest


@njit
def crank_tips(robot: Robot, theta: Vec6, out: Mat6x3) -> None:
    """Ends of the cranks [m] in B at crank angles."""
    for i in range(6):
        c, s = robot.crank_length[i] * np.cos(theta[i]), robot.crank_length[i] * np.sin(theta[i])
        for k in range(3):
            out[i, k] = robot.shaft[i, k] + c * robot.crank_x[i, k] + s * robot.crank_y[i, k]


@njit
def closures(robot: Robot, tips: Mat6x3, pose: Vec6, errors: Mat6x1, slope: Mat6) -> None:
    """Errors [m] of the rods' lengths from crank tips at a pose, and their derivatives with respect to the pose."""
    turn, arm, rod = np.empty((3, 3)), np.empty(3), np.empty(3)
    rotation(pose[:3], turn)
    for i in range(6):
        turned(turn, robot.joint[i], arm)
        for k in range(3):
            rod[k] = arm[k] + pose[3 + k] - tips[i, k]
        size = np.sqrt(dot(rod, rod))
        errors[i, 0] = size - robot.rod_length[i]
        for k in range(3):
            rod[k] /= size
        cross(arm, rod, slope[i, :3])
        for k in range(3):
            slope[i, 3 + k] = rod[k]
    euler_moments(pose[:3], slope)


@njit
def forward_kinematics(robot: Robot, theta: Vec6, pose: Vec6, tolerance: float, iterations: int) -> tuple[float, int]:
    """Pose from crank angles, by Newton's method on the six rod lengths; `pose` holds the guess, then the result.

    Returns:
        Largest remaining error of a rod's length [m], above the tolerance or NaN without convergence; number of steps.
    """
    tips, slope, residual = np.empty((6, 3)), np.empty((6, 6)), np.empty((6, 1))
    crank_tips(robot, theta, tips)
    for iteration in range(iterations + 1):
        closures(robot, tips, pose, residual, slope)
        error = 0.0
        for i in range(6):
            if abs(residual[i, 0]) > error or np.isnan(residual[i, 0]):
                error = abs(residual[i, 0])
        if error <= tolerance or iteration == iterations or not error < np.inf:
            return error, iteration
        if solve(slope, residual) == 0.0:
            return np.inf, iteration
        # A full step from a poor guess can tumble the platform; half a radian and 0.2 m keep it in one piece.
        scale = 1.0
        for k in range(6):
            scale = max(scale, abs(residual[k, 0]) / (0.5 if k < 3 else 0.2))
        for k in range(6):
            pose[k] -= residual[k, 0] / scale
    return np.inf, iterations
