"""Maps between the state of the simulated robot and what it means: pose, crank angles, loop closure; numpy only.

A state is Drake's [positions; velocities]. Everything is vectorised over leading axes, so it serves a log as well as an
instant. Angles of cranks are theta, not Drake's motor angle, which is zero at home.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from stewart_drake.errors import ConfigurationError, SingularPoseError
from stewart_drake.mechanics.kinematics import cross, leg_geometry, pose_rate_to_twist, roll_pitch_yaw, rotation_matrix
from stewart_drake.plant.sdf_model import RodJoint, crank_lateral, home_frames
from stewart_drake.robot import RobotParameters


@dataclass(frozen=True, eq=False)
class StateIndices:
    """Where things are in a state [positions; velocities] of the plant.

    Attributes:
        crank: (6,) motor angles, zero at home.
        rod: (6, 2 or 3) angles of the joints between crank and rod.
        quaternion: (4,) w, x, y, z of the platform.
        position: (3,) X, Y, Z of the platform.
        crank_rate: (6,) motor speeds.
        rod_rate: (6, 2 or 3) velocities of the joints between crank and rod.
        twist: (6,) w_BP, v_BP of the platform, both in B.
    """

    crank: np.ndarray
    rod: np.ndarray
    quaternion: np.ndarray
    position: np.ndarray
    crank_rate: np.ndarray
    rod_rate: np.ndarray
    twist: np.ndarray

    @property
    def size(self) -> int:
        """Length nq + nv of the state; the indices cover all of it."""
        return sum(array.size for array in vars(self).values())


class StateMap:
    """The state of one robot, read and composed."""

    def __init__(self, robot: RobotParameters, rod_joint: RodJoint, indices: StateIndices) -> None:
        self.robot, self.rod_joint, self.indices = robot, rod_joint, indices
        self._home = home_frames(robot)
        self._lateral = crank_lateral(robot)

    def assemble(self, pose: ArrayLike, pose_rate: ArrayLike | None = None) -> np.ndarray:
        """State of the closed robot with the platform at a pose, moving; in closed form, rods not spinning.

        Args:
            pose: (..., 6) [rad, m] of P in B.
            pose_rate: (..., 6) [rad/s, m/s] Euler rates and velocity; None is rest.

        Returns:
            (..., nq + nv) the state; its loops are closed to rounding.

        Raises:
            UnreachablePoseError: A rod cannot span.
            SingularPoseError: A crank at its dead centre, whose speed is not defined; a rod turned by 90 deg in its
                joint at the crank, whose angles are not.
            ConfigurationError: Not finite, or not (..., 6).
        """
        pose = np.asarray(pose, dtype=float)
        pose_rate = np.zeros_like(pose) if pose_rate is None else np.asarray(pose_rate, dtype=float)
        if pose_rate.shape != pose.shape or not np.isfinite(pose_rate).all():
            raise ConfigurationError("pose_rate", pose_rate, f"finite numbers of the pose's shape {pose.shape}")
        legs = leg_geometry(self.robot, pose)
        _refuse_small("serial", np.abs(legs.transmission), pose)
        twist = pose_rate_to_twist(pose, pose_rate)
        v_joint = twist[..., None, 3:] + cross(twist[..., None, :3], legs.arm)
        theta_rate = np.sum(legs.e_l * v_joint, axis=-1) / (self.robot.crank_lengths * legs.transmission)
        v_tip = legs.e_n * (self.robot.crank_lengths * theta_rate)[..., None]
        e_l_rate = (v_joint - v_tip) / self.robot.rod_lengths[:, None]

        w_crank = -self._lateral * theta_rate[..., None]
        crank_rotation = np.stack(np.broadcast_arrays(legs.crank, self._lateral, legs.e_n), axis=-1)
        to_joint = np.swapaxes(crank_rotation @ self._home.rod_in_crank, -1, -2)
        direction = _times(to_joint, legs.e_l)
        _refuse_small("rod_joint", np.hypot(direction[..., 1], direction[..., 2]), pose)
        angles = _universal_angles(direction)
        if self.rod_joint == "universal":
            rates = _universal_rates(angles, _times(to_joint, e_l_rate - cross(w_crank, legs.e_l)))
        else:
            angles = roll_pitch_yaw(_universal_rotation(angles))
            rates = _times(to_joint, cross(legs.e_l, e_l_rate) - w_crank)

        index = self.indices
        state = np.zeros((*pose.shape[:-1], index.size))
        state[..., index.crank] = self._home.motor_angles(legs.crank_angles)
        state[..., index.rod] = angles
        state[..., index.quaternion] = _quaternion(pose[..., :3])
        state[..., index.position] = pose[..., 3:]
        state[..., index.crank_rate] = theta_rate
        state[..., index.rod_rate] = rates
        state[..., index.twist] = twist
        return state

    def pose_and_rate(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pose (..., 6) [rad, m], pitch in [-pi/2, pi/2], and its rate (..., 6) [rad/s, m/s] of states."""
        state = np.asarray(state, dtype=float)
        pose, rate = np.empty((2, *state.shape[:-1], 6))
        pose[..., 3:] = state[..., self.indices.position]
        rate[..., 3:] = state[..., self.indices.twist[3:]]
        # Component by component: a sensor asks at every tick, and matrices would cost more than the plant's own step.
        w, x, y, z = (state[..., i] for i in self.indices.quaternion)
        size = w * w + x * x + y * y + z * z
        pose[..., 0] = np.arctan2(2.0 * (w * x + y * z), size - 2.0 * (x * x + y * y))
        pose[..., 1] = np.arcsin(np.clip(2.0 * (w * y - x * z) / size, -1.0, 1.0))
        pose[..., 2] = np.arctan2(2.0 * (w * z + x * y), size - 2.0 * (y * y + z * z))
        w_x, w_y, w_z = (state[..., i] for i in self.indices.twist[:3])
        cosine, sine = np.cos(pose[..., 2]), np.sin(pose[..., 2])
        rate[..., 0] = (cosine * w_x + sine * w_y) / np.cos(pose[..., 1])
        rate[..., 1] = cosine * w_y - sine * w_x
        rate[..., 2] = w_z + np.sin(pose[..., 1]) * rate[..., 0]
        return pose, rate

    def crank_angles(self, state: np.ndarray) -> np.ndarray:
        """Angles theta (..., 6) [rad] of the cranks, not wrapped."""
        return np.asarray(state, dtype=float)[..., self.indices.crank] + self._home.crank_angles

    def crank_rates(self, state: np.ndarray) -> np.ndarray:
        """Speeds (..., 6) [rad/s] of the cranks."""
        return np.asarray(state, dtype=float)[..., self.indices.crank_rate]

    def loop_gap(self, state: np.ndarray) -> np.ndarray:
        """Distance (..., 6) [m] between each rod's end and its joint on the platform; constraints keep it near zero."""
        state = np.asarray(state, dtype=float)
        theta = self.crank_angles(state)
        cosine, sine = np.cos(theta)[..., None], np.sin(theta)[..., None]
        along, up = self.robot.crank_zero_directions, self.robot.crank_quarter_directions
        crank, e_n = cosine * along + sine * up, cosine * up - sine * along
        angles = state[..., self.indices.rod]
        turned = _universal_rotation(angles) if self.rod_joint == "universal" else rotation_matrix(angles)
        x, y, z = np.moveaxis(_times(self._home.rod_in_crank, turned[..., 2]), -1, 0)
        e_l = x[..., None] * crank + y[..., None] * self._lateral + z[..., None] * e_n
        lengths = self.robot.crank_lengths[:, None], self.robot.rod_lengths[:, None]
        end = self.robot.shaft_positions + lengths[0] * crank + lengths[1] * e_l
        rotation = _quaternion_rotation(state[..., self.indices.quaternion])
        arm = self.robot.platform_joints @ np.swapaxes(rotation, -1, -2)
        return np.linalg.norm(end - arm - state[..., None, self.indices.position], axis=-1)


def _refuse_small(kind: Literal["serial", "rod_joint"], margins: np.ndarray, pose: np.ndarray) -> None:
    """Raises a SingularPoseError where a margin (..., 6) of a leg is next to nothing."""
    if margins.min(initial=1.0) < 1e-6:
        at = np.unravel_index(int(margins.argmin()), margins.shape)
        raise SingularPoseError(kind, pose[at[:-1]], float(margins[at]), 1e-6, int(at[-1]))


def _times(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    return (matrix @ vector[..., None])[..., 0]


def _universal_angles(direction: np.ndarray) -> np.ndarray:
    """(..., 2) [rad] a, b for which Rx(a) Ry(b) z is `direction`: [sin b, -sin a cos b, cos a cos b]."""
    x, y, z = np.moveaxis(direction, -1, 0)
    return np.stack([np.arctan2(-y, z), np.arctan2(x, np.hypot(y, z))], axis=-1)


def _universal_rates(angles: np.ndarray, direction_rate: np.ndarray) -> np.ndarray:
    """(..., 2) [rad/s] rates of a, b from the time derivative of the direction, both in the joint's frame F."""
    x, y, z = np.moveaxis(direction_rate, -1, 0)
    (sa, sb), (ca, cb) = np.moveaxis(np.sin(angles), -1, 0), np.moveaxis(np.cos(angles), -1, 0)
    return np.stack([-(ca * y + sa * z) / cb, cb * x + sb * (sa * y - ca * z)], axis=-1)


def _universal_rotation(angles: np.ndarray) -> np.ndarray:
    """(..., 3, 3) [-] Rx(a) Ry(b)."""
    (sa, sb), (ca, cb) = np.moveaxis(np.sin(angles), -1, 0), np.moveaxis(np.cos(angles), -1, 0)
    return _matrix([cb, np.zeros_like(sa), sb], [sa * sb, ca, -sa * cb], [-ca * sb, sa, ca * cb])


def _quaternion(rpy: np.ndarray) -> np.ndarray:
    """(..., 4) [-] w, x, y, z of `rotation_matrix(rpy)`."""
    (sr, sp, sy), (cr, cp, cy) = np.moveaxis(np.sin(0.5 * rpy), -1, 0), np.moveaxis(np.cos(0.5 * rpy), -1, 0)
    w, x = cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy
    y, z = cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy
    return np.stack([w, x, y, z], axis=-1)


def _quaternion_rotation(quaternion: np.ndarray) -> np.ndarray:
    """(..., 3, 3) [-] rotation of a quaternion of any length, as Drake reads it."""
    w, x, y, z = np.moveaxis(quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True), -1, 0)
    return _matrix(
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    )


def _matrix(*rows: list[np.ndarray]) -> np.ndarray:
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
