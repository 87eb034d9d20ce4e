"""States of Drake's plant of one robot: assembled from a pose, and read."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from stewart_drake.base.errors import ConfigurationError, SingularPoseError
from stewart_drake.base.jit import njit
from stewart_drake.base.records import Matrix, Vec12
from stewart_drake.mechanics import kinematics_laws as laws
from stewart_drake.mechanics.kinematics import cross, leg_geometry, pose_rate_to_twist, quaternion, rotation_matrix
from stewart_drake.mechanics.singularities import ASSEMBLED
from stewart_drake.plant.model_files import crank_lateral, crank_rotations, home_frames
from stewart_drake.plant.plant_options import RodJoint
from stewart_drake.robot import RobotParameters


@dataclass(frozen=True, eq=False)
class StateIndices:
    """Indices of the robot in a state [positions; velocities] of the plant, which may have other bodies."""

    crank: np.ndarray  # (6,) motor angles, zero at home.
    rod: np.ndarray  # (6, 2 or 3) angles of the joints between crank and rod.
    quaternion: np.ndarray  # (4,) w, x, y, z of the platform.
    position: np.ndarray  # (3,) X, Y, Z of the platform.
    crank_rate: np.ndarray  # (6,) motor speeds.
    rod_rate: np.ndarray  # (6, 2 or 3) velocities of the joints between crank and rod.
    twist: np.ndarray  # (6,) w_BP, v_BP of the platform, both in B.

    def all(self) -> np.ndarray:
        """All indices of the robot."""
        return np.concatenate([array.ravel() for array in vars(self).values()])


class StateMap:
    """States of one robot, with any leading axes.

    A subclass has `indices`, and a plant's state (n,) `default`, in which the robot's entries are replaced.
    """

    indices: StateIndices
    default: np.ndarray

    def __init__(self, robot: RobotParameters, rod_joint: RodJoint) -> None:
        self.robot, self.rod_joint = robot, rod_joint
        self._home = home_frames(robot)
        self._lateral = crank_lateral(robot)
        self._crank_zero = np.concatenate([self._home.crank_angles, np.zeros(6)])

    @cached_property
    def size(self) -> int:
        """Numbers in a state of the plant."""
        return self.default.size

    @cached_property
    def _crank_index(self) -> np.ndarray:
        return np.concatenate([self.indices.crank, self.indices.crank_rate])

    @cached_property
    def _platform_index(self) -> np.ndarray:
        return np.concatenate([self.indices.quaternion, self.indices.position, self.indices.twist])

    def assemble(self, pose: ArrayLike, pose_rate: ArrayLike | None = None) -> np.ndarray:
        """State (..., nq + nv) of the plant with the closed robot at a pose [rad, m], moving, rods not spinning.

        In closed form; the rest of the plant is in its default state.

        Raises:
            UnreachablePoseError: A rod cannot span.
            SingularPoseError: A crank at its dead centre; a rod turned by 90 deg in its joint at the crank.
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
        x, y, z = np.moveaxis(direction, -1, 0)
        across = np.hypot(y, z)
        _refuse_small("rod_joint", across, pose)
        # Rx(a) Ry(b) z = [sin b, -sin a cos b, cos a cos b] is the direction.
        angles = np.stack([np.arctan2(-y, z), np.arctan2(x, across)], axis=-1)
        (sa, sb), (ca, cb) = np.moveaxis(np.sin(angles), -1, 0), np.moveaxis(np.cos(angles), -1, 0)
        if self.rod_joint == "universal":
            x, y, z = np.moveaxis(_times(to_joint, e_l_rate - cross(w_crank, legs.e_l)), -1, 0)
            rates = np.stack([-(ca * y + sa * z) / cb, cb * x + sb * (sa * y - ca * z)], axis=-1)
        else:
            angles = np.stack([np.arctan2(sa, ca * cb), np.arcsin(ca * sb), np.arctan2(sa * sb, cb)], axis=-1)
            rates = _times(to_joint, cross(legs.e_l, e_l_rate) - w_crank)

        index = self.indices
        state = np.tile(self.default, (*pose.shape[:-1], 1))
        state[..., index.crank] = self._home.motor_angles(legs.crank_angles)
        state[..., index.rod] = angles
        state[..., index.quaternion] = quaternion(pose[..., :3])
        state[..., index.position] = pose[..., 3:]
        state[..., index.crank_rate] = theta_rate
        state[..., index.rod_rate] = rates
        state[..., index.twist] = twist
        return state

    def checked(self, state: ArrayLike) -> np.ndarray:
        """States as an array; ConfigurationError if their size is that of another plant."""
        state = np.asarray(state, dtype=float)
        if state.shape[-1:] != (self.size,):
            raise ConfigurationError("state", f"an array of shape {state.shape}", f"(..., {self.size}) of this plant")
        return state

    def pose_and_rate(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pose (..., 6) [rad, m], pitch in [-pi/2, pi/2], and its rate (..., 6) [rad/s, m/s] of states."""
        platform = self.checked(state)[..., self._platform_index]
        pose, rate = np.empty((2, *platform.shape[:-1], 6))
        _platform_motion(platform.reshape(-1, 13), pose.reshape(-1, 6), rate.reshape(-1, 6))
        return pose, rate

    def read_pose(self, state: np.ndarray, out: Vec12) -> None:
        """`pose_and_rate` of one state (nq + nv,) into (12,), in a third of the time."""
        _platform_motion(state[self._platform_index][None], out[None, :6], out[None, 6:])

    def crank_state(self, state: np.ndarray) -> np.ndarray:
        """Angles [rad] of the cranks, not wrapped, and their rates [rad/s] of states, (..., 12)."""
        return self.checked(state)[..., self._crank_index] + self._crank_zero

    def measure(self, state: np.ndarray) -> np.ndarray:
        """Measurement (..., 24) of a `Plant` in states."""
        return np.concatenate([*self.pose_and_rate(state), self.crank_state(state)], axis=-1)

    def crank_angles(self, state: np.ndarray) -> np.ndarray:
        """Angles theta (..., 6) [rad] of the cranks, not wrapped."""
        return self.checked(state)[..., self.indices.crank] + self._home.crank_angles

    def rod_directions(self, state: np.ndarray) -> np.ndarray:
        """Unit vectors e_l (..., 6, 3) [-] along the rods, from the crank up, from the joint angles at the crank."""
        state = self.checked(state)
        crank, lateral, e_n = np.moveaxis(crank_rotations(self.robot, self.crank_angles(state)), -1, 0)
        angles = state[..., self.indices.rod]
        if self.rod_joint == "universal":
            (sa, sb), (ca, cb) = np.moveaxis(np.sin(angles), -1, 0), np.moveaxis(np.cos(angles), -1, 0)
            direction = np.stack([sb, -sa * cb, ca * cb], axis=-1)
        else:
            direction = rotation_matrix(angles)[..., 2]
        x, y, z = np.moveaxis(_times(self._home.rod_in_crank, direction), -1, 0)
        return np.asarray(x[..., None] * crank + y[..., None] * lateral + z[..., None] * e_n)

    def loop_gap(self, state: np.ndarray) -> np.ndarray:
        """Distance (..., 6) [m] between a rod's end and its joint on the platform; constraints keep it near zero."""
        crank = crank_rotations(self.robot, self.crank_angles(state))[..., 0]
        lengths = self.robot.crank_lengths[:, None], self.robot.rod_lengths[:, None]
        end = self.robot.shaft_positions + lengths[0] * crank + lengths[1] * self.rod_directions(state)
        pose = self.pose_and_rate(state)[0]
        seat = self.robot.platform_joints @ np.swapaxes(rotation_matrix(pose[..., :3]), -1, -2) + pose[..., None, 3:]
        return np.linalg.norm(end - seat, axis=-1)


def _refuse_small(kind: Literal["serial", "rod_joint"], margins: np.ndarray, pose: np.ndarray) -> None:
    """Raises a SingularPoseError where a margin (..., 6) of a leg is almost zero."""
    if margins.min(initial=1.0) < ASSEMBLED:
        at = np.unravel_index(int(margins.argmin()), margins.shape)
        raise SingularPoseError(kind, pose[at[:-1]], float(margins[at]), ASSEMBLED, int(at[-1]))


@njit
def _platform_motion(states: Matrix, poses: Matrix, rates: Matrix) -> None:
    """Poses (n, 6) and their rates (n, 6) from quaternion, position and twist (n, 13)."""
    for n in range(len(states)):
        laws.quaternion_angles(states[n, :4], poses[n, :3])
        for k in range(3):
            poses[n, 3 + k] = states[n, 4 + k]
        laws.rate_of(poses[n], states[n, 7:], rates[n])


def _times(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    return (matrix @ vector[..., None])[..., 0]
