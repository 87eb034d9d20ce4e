"""The robot as SDF for Drake, and as MJCF for MuJoCo: links, joints and loop closures at the assembled home pose.

All joint angles are zero at home, Drake's motor angle too; theta of a crank is not. `sdf/stewart.sdf` is the default.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from stewart_drake.base.atomic_files import write_atomically
from stewart_drake.base.config import check_value
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.mechanics.kinematics import cross, leg_geometry, roll_pitch_yaw, rotation_matrix
from stewart_drake.plant.plant_options import DrakeOptions, PlantOptions, RodJoint
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.gravity import Gravity, gravity_vector
from stewart_drake.robot.leg import JOINT_SWING, LARGEST_SIZE, LEG_COUNT

if TYPE_CHECKING:
    from jinja2 import Environment

Pose = tuple[ArrayLike, ArrayLike]
"""Position (3,) [m] and roll, pitch, yaw (3,) [rad]."""
_ROD_DAMPING = 10.0  # [1/s] of a rod about the hinges at its crank; in files for training.
_HOUSING_RADIUS = 3.6  # Radius of a motor's housing over the link radius; decoration only.


@dataclass(frozen=True)
class HomeFrames:
    """Frames of cranks C_i and rods R_i at the home pose; they move with their links."""

    crank_angles: np.ndarray  # (6,) [rad] theta_i at home.
    crank_rotation: np.ndarray  # (6, 3, 3) R_BC: x along the crank, z along the motion of its tip; motor axis -y.
    crank_tips: np.ndarray  # (6, 3) [m] origins of the rod frames in B.
    rod_rotation: np.ndarray  # (6, 3, 3) [-] R_BR: z along the rod, x the motor axis projected across the rod.
    stops: np.ndarray  # (6, 2) [rad] of the motors, from home, in the turn that contains it; infinite without stops.

    @property
    def rod_in_crank(self) -> np.ndarray:
        """(6, 3, 3) [-] R_CF: the rod joint's frame F, fixed in the crank, which is the rod's frame at home."""
        return np.swapaxes(self.crank_rotation, -1, -2) @ self.rod_rotation

    def motor_angles(self, crank_angles: np.ndarray) -> np.ndarray:
        """Motor angles (..., 6) [rad], zero at home, of theta in any turn: within half a turn of the stops' middle."""
        middle = _middles(self.stops)
        off = crank_angles - self.crank_angles - middle
        return middle + np.arctan2(np.sin(off), np.cos(off))


def crank_lateral(robot: RobotParameters) -> np.ndarray:
    """Lateral axes y (6, 3) [-] of the cranks, opposite to the motor axes, the same at every pose."""
    return cross(robot.crank_quarter_directions, robot.crank_zero_directions)


def crank_rotations(robot: RobotParameters, angles: np.ndarray) -> np.ndarray:
    """R_BC (..., 6, 3, 3) of cranks at theta (..., 6) [rad]: x along the crank, z along the motion of its tip."""
    cosine, sine = np.cos(angles)[..., None], np.sin(angles)[..., None]
    along, up = robot.crank_zero_directions, robot.crank_quarter_directions
    axes = cosine * along + sine * up, crank_lateral(robot), cosine * up - sine * along
    return np.stack(np.broadcast_arrays(*axes), axis=-1)


def rod_rotations(robot: RobotParameters, e_l: np.ndarray) -> np.ndarray:
    """R_BR (..., 6, 3, 3) of rods along e_l (..., 6, 3): z along e_l, x the motor's axis projected across it."""
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
    """Middles (6,) of ranges (6, 2) [rad]; zero without stops."""
    return np.clip(ranges, -LARGEST_SIZE, LARGEST_SIZE).mean(axis=-1)


def sdf_text(
    robot: RobotParameters,
    *,
    rod_joint: RodJoint = "universal",
    collision: bool = True,
    joint_swing: float | None = JOINT_SWING,
    name: str = "stewart",
    base: Sequence[Sequence[float]] | None = None,
) -> str:
    """The robot as an SDF model for Drake's parser, always with visual geometry.

    Links `base` (welded to the world), `crank_0..5`, `rod_0..5`, `platform`; joints `motor_0..5` and `universal_0..5`
    or `ball_0..5`; six `drake:ball_constraint` close the loops. A universal joint has stops at -`joint_swing` and
    `joint_swing` [rad] about either axis, None for none. `base` is position [m] and roll, pitch, yaw [rad] of B in the
    world; None for the world's frame.
    """
    check_value("rod_joint", rod_joint, RodJoint)
    frames, radius = home_frames(robot), robot.link_radius

    def sides(z: float, place: Callable[..., Pose] = lambda at, turn: (at, turn)) -> list[Pose]:
        """Poses of the six boxes of a disc."""
        return [place((0.0, 0.0, z), (0.0, 0.0, side * math.pi / 6.0)) for side in range(6)]

    # For an upright crank R_BC = Rz(yaw) Ry(-theta) is exact; no conversion from a matrix is needed.
    crank_turns = [
        (0.0, -frames.crank_angles[leg], robot.crank_yaws[leg])
        if _upright(robot, leg)
        else roll_pitch_yaw(frames.crank_rotation[leg])
        for leg in range(LEG_COUNT)
    ]
    return render(
        "robot.sdf.j2",
        robot=robot,
        default=RobotParameters(),
        rod_joint=rod_joint,
        collision=collision,
        joint_swing=joint_swing,
        name=name,
        base=base,
        frames=frames,
        crank_turns=crank_turns,
        platform_inertia=_moments_and_products(robot),
        on_platform=partial(on_platform, robot),
        sides=sides,
        rod_turns=roll_pitch_yaw(frames.rod_rotation),
        housing_radius=_HOUSING_RADIUS * radius,
        housings=[_housing(robot, frames, leg) for leg in range(LEG_COUNT)],
        # A link collides except within two radii of its joints.
        free_length=lambda span: max(span - 4.0 * radius, radius),
    )


def on_platform(
    robot: RobotParameters, at: ArrayLike, turn: ArrayLike = (0.0, 0.0, 0.0)
) -> tuple[np.ndarray, np.ndarray]:
    """Position (3,) [m] and roll, pitch, yaw (3,) [rad] given in P, in the frame of poses, which may be the tool's."""
    if robot.tool is None:
        return np.asarray(at), np.asarray(turn)
    back = robot.tool_rotation.T
    return back @ (np.array(at) - robot.tool_position), roll_pitch_yaw(back @ rotation_matrix(np.array(turn)))


def _moments_and_products(robot: RobotParameters) -> tuple[np.ndarray, np.ndarray]:
    inertia = robot.central_inertia
    return np.diag(inertia), inertia[np.triu_indices(3, 1)]


def write_sdf(
    robot: RobotParameters, path: str | Path, *, rod_joint: RodJoint = "universal", collision: bool = True
) -> None:
    """Writes `sdf_text` to a file, atomically.

    Raises:
        ConfigurationError: The folder is missing or not writable, or unknown `rod_joint`.
    """
    write_atomically(Path(path), sdf_text(robot, rod_joint=rod_joint, collision=collision).encode())


def mjcf_text(
    robot: RobotParameters,
    gravity: Gravity = STANDARD_GRAVITY,
    options: PlantOptions | None = None,
    *,
    joint_swing: float | None = None,
) -> str:
    """The robot in MJCF: bodies at the home pose, rods on two hinges, six `connect` that close the loops.

    MuJoCo's `connect` is a spring and damper on the gap r: here d^2 r/dt^2 = -r / h^2 - dr/dt / h, so that one Euler
    step of length h closes a gap. Its impedance is at most 0.9999: a ten-thousandth of the opening acceleration
    remains, and leads to a gap of order h^2. With heavy rotors that is much in a single acceleration, but little in the
    motion.

    Motors `motor_0..5` take torques [N m] within the effort limit; their joints are zero at home. Links are drawn, but
    do not collide. The options used are `time_step`, `universal_damping` and the motors' friction, without break-away
    torque, which MuJoCo lacks. Gravity is in m/s^2, a number along -z or a vector in B.

    With `joint_swing` [rad] the rods have stops on either side of home about both hinges, and are damped there also
    where `universal_damping` is 0: for torques of any kind, as in training. None leaves the model of the closed form.
    """
    options = DrakeOptions() if options is None else options
    frames, friction = home_frames(robot), options.friction_options
    return render(
        "robot.mjcf.j2",
        robot=robot,
        frames=frames,
        home_rotation=robot.tool_rotation,
        platform_inertia=_moments_and_products(robot),
        disc=on_platform(robot, (0.0, 0.0, 0.0)),
        gravity=gravity_vector(gravity),
        step=options.time_step,
        linear=not any(friction.coulomb) and not np.isfinite(frames.stops).any() and joint_swing is None,
        coulomb=friction.coulomb,
        viscous=friction.viscous,
        joint_swing=joint_swing,
        rod_damping=options.universal_damping or (_ROD_DAMPING * robot.rod_inertia[0] if joint_swing else 0.0),
    )


def _upright(robot: RobotParameters, leg: int) -> bool:
    """Whether a crank turns in a vertical plane, from the horizontal up."""
    return bool((robot.crank_quarter_directions[leg] == (0.0, 0.0, 1.0)).all())


def _housing(robot: RobotParameters, frames: HomeFrames, leg: int) -> dict[str, object]:
    """A motor's housing on its axis: centre (3,) [m], length [m], turn of z; those of a pair are back to back."""
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


def render(template: str, **values: object) -> str:
    """Renders a template of the folder `templates`, in which `exact` and `short` write numbers."""
    return _environment().get_template(template).render(values)


@cache
def _environment() -> Environment:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    loader = PackageLoader("stewart_drake.plant")
    environment = Environment(loader=loader, undefined=StrictUndefined, trim_blocks=True, keep_trailing_newline=True)
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


def _exact(*parts: ArrayLike) -> str:
    """Shortest text that reads back as the same doubles; numbers below 1e-15 are written as zero."""
    values = np.concatenate([np.ravel(np.asarray(part, dtype=float)) for part in parts]).tolist()
    return " ".join(repr(0.0 if abs(value) < 1e-15 else value) for value in values)


def _short(*parts: ArrayLike) -> str:
    """Numbers of shapes, with seven digits."""
    return _exact([float(f"{value:.7g}") for part in parts for value in np.ravel(part)])
