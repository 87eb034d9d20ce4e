"""The robot as SDF: links, joints and loop closures of Fig. 1 at the assembled home pose; and the state of its plant.

All joint angles are zero at home, Drake's motor angle too; theta of a crank is not. `sdf/stewart.sdf` is the default.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from stewart_drake.config import check_value
from stewart_drake.errors import ConfigurationError, SingularPoseError
from stewart_drake.files.whole import write_atomically
from stewart_drake.mechanics.kinematics import cross, leg_geometry, pose_rate_to_twist, roll_pitch_yaw, rotation_matrix
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LARGEST, LEGS

if TYPE_CHECKING:
    from jinja2 import Environment

RodJoint = Literal["universal", "ball"]
"""Joint between crank and rod. `ball` is the paper's topology; each rod then spins freely about its own axis."""

_HOUSING_RADIUS = 3.6  # Of a motor, in multiples of the link radius: decoration.


@dataclass(frozen=True)
class HomeFrames:
    """Frames of cranks C_i and rods R_i at the home pose; at any other pose they turn with their links."""

    crank_angles: np.ndarray  # (6,) [rad] theta_i at home.
    # (6, 3, 3) [-] R_BC: x along the crank, z along which its tip moves, so the motor axis is -y.
    crank_rotation: np.ndarray
    crank_tips: np.ndarray  # (6, 3) [m] origins of the rod frames in B.
    rod_rotation: np.ndarray  # (6, 3, 3) [-] R_BR: z along the rod, x the motor axis projected square to the rod.
    stops: np.ndarray  # (6, 2) [rad] of the motors, from home, in the turn that holds it; infinite where there is none.

    @property
    def rod_in_crank(self) -> np.ndarray:
        """(6, 3, 3) [-] R_CF: the rod joint's frame F, fixed in the crank, which is the rod's own frame at home."""
        return np.swapaxes(self.crank_rotation, -1, -2) @ self.rod_rotation

    def motor_angles(self, crank_angles: np.ndarray) -> np.ndarray:
        """Motor angles (..., 6) [rad], zero at home, of theta of any turn: within half a turn of the stops' middle."""
        middle = _middles(self.stops)
        off = crank_angles - self.crank_angles - middle
        return middle + np.arctan2(np.sin(off), np.cos(off))


def crank_lateral(robot: RobotParameters) -> np.ndarray:
    """Lateral axes y (6, 3) [-] of the cranks, opposite to the motor axes, the same at every pose."""
    return cross(robot.crank_quarter_directions, robot.crank_zero_directions)


def crank_rotations(robot: RobotParameters, angles: np.ndarray) -> np.ndarray:
    """R_BC (..., 6, 3, 3) [-] of cranks at theta (..., 6) [rad]: x along the crank, z along which its tip moves."""
    cosine, sine = np.cos(angles)[..., None], np.sin(angles)[..., None]
    along, up = robot.crank_zero_directions, robot.crank_quarter_directions
    axes = cosine * along + sine * up, crank_lateral(robot), cosine * up - sine * along
    return np.stack(np.broadcast_arrays(*axes), axis=-1)


def rod_rotations(robot: RobotParameters, e_l: np.ndarray) -> np.ndarray:
    """R_BR (..., 6, 3, 3) [-] of rods along e_l (..., 6, 3): z along it, x as near to the motor's axis as can be."""
    lateral = crank_lateral(robot)
    along_motor = -lateral + np.sum(lateral * e_l, axis=-1, keepdims=True) * e_l
    x = along_motor / np.linalg.norm(along_motor, axis=-1, keepdims=True)
    return np.stack([x, cross(e_l, x), e_l], axis=-1)


def home_frames(robot: RobotParameters) -> HomeFrames:
    legs = leg_geometry(robot, robot.home_pose)
    turns = np.round((_middles(robot.crank_angle_ranges) - legs.crank_angles) / (2.0 * math.pi))
    return HomeFrames(
        crank_angles=legs.crank_angles,
        crank_rotation=np.stack([legs.crank, crank_lateral(robot), legs.e_n], axis=-1),
        crank_tips=robot.shaft_positions + robot.crank_lengths[:, None] * legs.crank,
        rod_rotation=rod_rotations(robot, legs.e_l),
        stops=robot.crank_angle_ranges - (legs.crank_angles + 2.0 * math.pi * turns)[:, None],
    )


def _middles(ranges: np.ndarray) -> np.ndarray:
    """Middles (6,) of ranges (6, 2) [rad]; zero where there are no stops."""
    return np.clip(ranges, -LARGEST, LARGEST).mean(axis=-1)


def sdf_text(robot: RobotParameters, *, rod_joint: RodJoint = "universal", collision: bool = True) -> str:
    """The robot as an SDF model named `stewart` for Drake's parser; pictures are written always.

    Links `base` (welded to the world), `crank_0..5`, `rod_0..5`, `platform`; joints `motor_0..5` and `universal_0..5`
    or `ball_0..5`; six `drake:ball_constraint` close the loops.
    """
    check_value("rod_joint", rod_joint, RodJoint)
    frames, radius = home_frames(robot), robot.link_radius
    # Of an upright crank R_BC = Rz(yaw) Ry(-theta): no rounding of a matrix on the way.
    crank_turns = [
        (0.0, -frames.crank_angles[leg], robot.crank_yaws[leg])
        if _upright(robot, leg)
        else roll_pitch_yaw(frames.crank_rotation[leg])
        for leg in range(LEGS)
    ]
    return render(
        "robot.sdf.j2",
        robot=robot,
        default=RobotParameters(),
        rod_joint=rod_joint,
        collision=collision,
        frames=frames,
        crank_turns=crank_turns,
        rod_turns=roll_pitch_yaw(frames.rod_rotation),
        housing_radius=_HOUSING_RADIUS * radius,
        housings=[_housing(robot, frames, leg) for leg in range(LEGS)],
        # All of a link but two radii at either joint may collide.
        free_length=lambda span: max(span - 4.0 * radius, radius),
    )


def write_sdf(
    robot: RobotParameters, path: str | Path, *, rod_joint: RodJoint = "universal", collision: bool = True
) -> None:
    """Writes `sdf_text` to a file; a reader sees the old file or the new one, never a half.

    Raises:
        ConfigurationError: The folder is missing or not writable, or unknown `rod_joint`.
    """
    write_atomically(Path(path), sdf_text(robot, rod_joint=rod_joint, collision=collision).encode())


def _upright(robot: RobotParameters, leg: int) -> bool:
    """Whether a crank turns in a vertical plane, from the horizontal up."""
    return bool((robot.crank_quarter_directions[leg] == (0.0, 0.0, 1.0)).all())


def _housing(robot: RobotParameters, frames: HomeFrames, leg: int) -> dict[str, Any]:
    """A motor's housing on its axis: centre (3,) [m], length [m], turn of z; those of a pair stand back to back."""
    r, axis, shaft = robot.link_radius, frames.crank_rotation[leg, :, 1], robot.shaft_positions[leg]
    partner = robot.shaft_positions[leg ^ 1] - shaft
    apart = float(partner @ axis)
    if abs(apart) > 0.99 * float(np.linalg.norm(partner)):
        gap, side = 0.5 * abs(apart), math.copysign(1.0, apart)
        length = max(gap - 2.0 * r, r)
    else:
        gap, side = 2.0 * _HOUSING_RADIUS * r, -math.copysign(1.0, float(shaft @ axis))
        length = gap - 2.0 * r
    x, y, z = axis
    turn = (0.0, math.atan2(math.hypot(x, y), z), math.atan2(y, x))
    if _upright(robot, leg):
        turn = (0.5 * math.pi, 0.0, robot.crank_yaws[leg])
    return {"centre": shaft + side * (gap - 0.5 * length) * axis, "length": length, "turn": turn}


def render(template: str, **values: Any) -> str:
    """A text of the folder `templates`, in which `exact` and `short` write numbers."""
    return _environment().get_template(template).render(values)


@cache
def _environment() -> Environment:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    form: Any = {"trim_blocks": True, "keep_trailing_newline": True}
    environment = Environment(loader=PackageLoader("stewart_drake.plant"), undefined=StrictUndefined, **form)
    environment.globals |= {
        "exact": _exact,
        "short": _short,
        "zip": zip,
        "pi": math.pi,
        "cos": math.cos,
        "sin": math.sin,
    }
    environment.globals["inf"] = math.inf
    return environment


def _exact(*parts: Any) -> str:
    """Shortest text that reads back as the same doubles; what is zero up to rounding is written as zero."""
    values = np.concatenate([np.ravel(np.asarray(part, dtype=float)) for part in parts]).tolist()
    return " ".join(repr(0.0 if abs(value) < 1e-15 else value) for value in values)


def _short(*parts: Any) -> str:
    """Numbers of shapes, which need no more than seven digits."""
    return _exact([float(f"{value:.7g}") for part in parts for value in np.ravel(part)])


@dataclass(frozen=True, eq=False)
class StateIndices:
    """Where things are in a state [positions; velocities] of the plant."""

    crank: np.ndarray  # (6,) motor angles, zero at home.
    rod: np.ndarray  # (6, 2 or 3) angles of the joints between crank and rod.
    quaternion: np.ndarray  # (4,) w, x, y, z of the platform.
    position: np.ndarray  # (3,) X, Y, Z of the platform.
    crank_rate: np.ndarray  # (6,) motor speeds.
    rod_rate: np.ndarray  # (6, 2 or 3) velocities of the joints between crank and rod.
    twist: np.ndarray  # (6,) w_BP, v_BP of the platform, both in B.

    @property
    def size(self) -> int:
        return sum(array.size for array in vars(self).values())


class StateMap:
    """The state of one robot, read and composed; vectorised over leading axes."""

    def __init__(self, robot: RobotParameters, rod_joint: RodJoint, indices: StateIndices) -> None:
        self.robot, self.rod_joint, self.indices = robot, rod_joint, indices
        self._home = home_frames(robot)
        self._lateral = crank_lateral(robot)

    def assemble(self, pose: ArrayLike, pose_rate: ArrayLike | None = None) -> np.ndarray:
        """State (..., nq + nv) of the closed robot at a pose [rad, m], moving, rods not spinning; in closed form.

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

    def rod_directions(self, state: np.ndarray) -> np.ndarray:
        """Unit vectors e_l (..., 6, 3) [-] along the rods, from the crank up, wherever their far ends are."""
        state = np.asarray(state, dtype=float)
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
        """Distance (..., 6) [m] between each rod's end and its joint on the platform; constraints keep it near zero."""
        crank = crank_rotations(self.robot, self.crank_angles(state))[..., 0]
        lengths = self.robot.crank_lengths[:, None], self.robot.rod_lengths[:, None]
        end = self.robot.shaft_positions + lengths[0] * crank + lengths[1] * self.rod_directions(state)
        pose = self.pose_and_rate(state)[0]
        seat = self.robot.platform_joints @ np.swapaxes(rotation_matrix(pose[..., :3]), -1, -2) + pose[..., None, 3:]
        return np.linalg.norm(end - seat, axis=-1)


def _refuse_small(kind: Literal["serial", "rod_joint"], margins: np.ndarray, pose: np.ndarray) -> None:
    """Raises a SingularPoseError where a margin (..., 6) of a leg is next to nothing."""
    if margins.min(initial=1.0) < 1e-6:
        at = np.unravel_index(int(margins.argmin()), margins.shape)
        raise SingularPoseError(kind, pose[at[:-1]], float(margins[at]), 1e-6, int(at[-1]))


def _times(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    return (matrix @ vector[..., None])[..., 0]


def _quaternion(rpy: np.ndarray) -> np.ndarray:
    """(..., 4) [-] w, x, y, z of `rotation_matrix(rpy)`."""
    (sr, sp, sy), (cr, cp, cy) = np.moveaxis(np.sin(0.5 * rpy), -1, 0), np.moveaxis(np.cos(0.5 * rpy), -1, 0)
    w, x = cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy
    y, z = cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy
    return np.stack([w, x, y, z], axis=-1)
