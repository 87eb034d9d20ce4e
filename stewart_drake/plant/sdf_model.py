"""The robot as SDF: links, joints and loop closures of Fig. 1 at the assembled home pose, from `RobotParameters`.

Every link pose in the file is that of the home pose, so a freshly parsed plant is closed and all joint angles are zero
there. `sdf/stewart.sdf` is this text for the default robot; `sdf/README.md` says where each number comes from.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from stewart_drake.errors import ConfigurationError
from stewart_drake.files.whole import PACKAGE, write_atomically
from stewart_drake.mechanics.kinematics import cross, leg_geometry, roll_pitch_yaw
from stewart_drake.plant.sdf_elements import (
    add_axis,
    add_collision,
    add_disc_collision,
    add_element,
    add_inertial,
    add_joint,
    add_shape,
    box,
    cylinder,
    ellipsoid,
    exact_text,
    free_length,
    note,
    rendered,
    sphere,
)
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LARGEST, LEGS
from stewart_drake.section import check_value

RodJoint = Literal["universal", "ball"]
"""Joint between crank and rod. `ball` is the paper's topology; each rod then spins freely about its own axis."""


_HOUSING_RADIUS, _PLATE_THICKNESS, _DISC_THICKNESS = 3.6, 2.0, 1.6
"""Decoration in multiples of the link radius, so that any robot looks like itself."""


@dataclass(frozen=True)
class HomeFrames:
    """Frames of cranks C_i and rods R_i at the home pose; at any other pose they turn with their links.

    Attributes:
        crank_angles: (6,) [rad] theta_i at home.
        crank_rotation: (6, 3, 3) [-] R_BC: x along the crank, z along which its tip moves, so the motor axis is -y.
        crank_tips: (6, 3) [m] origins of the rod frames in B.
        rod_rotation: (6, 3, 3) [-] R_BR: z along the rod, x the motor axis projected square to the rod.
        stops: (6, 2) [rad] of the motors, from home, in the turn that holds it; infinite where there is none.
    """

    crank_angles: np.ndarray
    crank_rotation: np.ndarray
    crank_tips: np.ndarray
    rod_rotation: np.ndarray
    stops: np.ndarray

    @property
    def rod_in_crank(self) -> np.ndarray:
        """(6, 3, 3) [-] R_CF: the rod joint's frame F, fixed in the crank, which is the rod's own frame at home."""
        rotation: np.ndarray = np.swapaxes(self.crank_rotation, -1, -2) @ self.rod_rotation
        return rotation

    def motor_angles(self, crank_angles: np.ndarray) -> np.ndarray:
        """Motor angles (..., 6) [rad], zero at home, of theta of any turn: within half a turn of the stops' middle."""
        middle = _middles(self.stops)
        off = crank_angles - self.crank_angles - middle
        return middle + np.arctan2(np.sin(off), np.cos(off))


def crank_lateral(robot: RobotParameters) -> np.ndarray:
    """Lateral axes y of the cranks, quarter x zero, opposite to the motor axes; (6, 3) [-], the same at every pose."""
    return cross(robot.crank_quarter_directions, robot.crank_zero_directions)


def home_frames(robot: RobotParameters) -> HomeFrames:
    """Frames of cranks and rods at the home pose."""
    legs = leg_geometry(robot, robot.home_pose)
    lateral = crank_lateral(robot)
    # The shortest rotation that a universal joint leaves to the rod: its first axis as near to the motor's as can be.
    along_motor = -lateral + np.sum(lateral * legs.e_l, axis=-1, keepdims=True) * legs.e_l
    x = along_motor / np.linalg.norm(along_motor, axis=-1, keepdims=True)
    turns = np.round((_middles(robot.crank_angle_ranges) - legs.crank_angles) / (2.0 * math.pi))
    return HomeFrames(
        crank_angles=legs.crank_angles,
        crank_rotation=np.stack([legs.crank, lateral, legs.e_n], axis=-1),
        crank_tips=robot.shaft_positions + robot.crank_lengths[:, None] * legs.crank,
        rod_rotation=np.stack([x, cross(legs.e_l, x), legs.e_l], axis=-1),
        stops=robot.crank_angle_ranges - (legs.crank_angles + 2.0 * math.pi * turns)[:, None],
    )


def _middles(ranges: np.ndarray) -> np.ndarray:
    """Middles (6,) of ranges (6, 2) [rad]; zero where there are no stops."""
    return np.asarray(np.clip(ranges, -LARGEST, LARGEST).mean(axis=-1))


def sdf_text(robot: RobotParameters, *, rod_joint: RodJoint = "universal", collision: bool = True) -> str:
    """The robot as an SDF model named `stewart` for Drake's parser.

    Links `base` (welded to the world), `crank_0..5`, `rod_0..5`, `platform`; joints `motor_0..5` and `universal_0..5`
    or `ball_0..5`; six `drake:ball_constraint` close the loops.

    Args:
        robot: Geometry, masses, effort limit.
        rod_joint: Joint between crank and rod.
        collision: Write collision geometry and its filter group; pictures are written always.

    Returns:
        The text; the same robot always gives the same text.

    Raises:
        ConfigurationError: Unknown `rod_joint`.
    """
    check_value("rod_joint", rod_joint, RodJoint)
    sdf = ET.Element("sdf", {"version": "1.9", "xmlns:drake": "http://drake.mit.edu"})
    note(sdf, "Generated by stewart_drake.plant.sdf_model from RobotParameters: edit those, not this.")
    if robot == RobotParameters():
        note(sdf, "Masses and inertias: Table I of the paper (crank Izz corrected). README.md has all other sources.")
    model = add_element(sdf, "model", name="stewart")
    frames = home_frames(robot)
    _base(model, robot, frames, collision)
    for leg in range(LEGS):
        _crank(model, robot, frames, leg, collision)
    for leg in range(LEGS):
        _rod(model, robot, frames, leg, collision)
    _platform(model, robot, collision)
    for leg in range(LEGS):
        _motor(model, robot, frames, leg)
    for leg in range(LEGS):
        _rod_joint(model, leg, rod_joint)
    _closures(model, robot)
    if collision:
        _collision_filter(model)
    return '<?xml version="1.0"?>\n' + rendered(sdf) + "\n"


def write_sdf(
    robot: RobotParameters, path: str | Path, *, rod_joint: RodJoint = "universal", collision: bool = True
) -> None:
    """Writes `sdf_text` to a file; a reader sees the old file or the new one, never a half.

    Args:
        robot: As in `sdf_text`.
        path: The file; its folder must exist.
        rod_joint: As in `sdf_text`.
        collision: As in `sdf_text`.

    Raises:
        ConfigurationError: The folder is missing or not writable, or unknown `rod_joint`.
    """
    write_atomically(Path(path), sdf_text(robot, rod_joint=rod_joint, collision=collision).encode())


def sdf_path() -> Path:
    """The file `stewart.sdf` of the default robot, in an installed package or a checkout; `package.xml` lies beside it.

    Raises:
        ConfigurationError: Neither place has it.
    """
    for folder in (PACKAGE / "sdf", PACKAGE.parent / "sdf"):
        if (folder / "stewart.sdf").is_file():
            return folder / "stewart.sdf"
    raise ConfigurationError("sdf", str(PACKAGE), "an installation or checkout that has sdf/stewart.sdf")


def _base(model: ET.Element, robot: RobotParameters, frames: HomeFrames, collision: bool) -> None:
    r = robot.link_radius
    note(model, "Frame B is the world. The base stands at the height of the motor shafts and never moves.")
    link = add_element(model, "link", name="base")
    add_inertial(link, robot.base_mass, robot.base_inertia, (0.0, 0.0, robot.base_height))
    plate_z = robot.base_height - (_HOUSING_RADIUS + 0.5 * _PLATE_THICKNESS) * r
    plate = cylinder(robot.base_radius, _PLATE_THICKNESS * r)
    add_shape(link, "plate", plate, (0.0, 0.0, plate_z), colour="plate")
    if collision:
        add_disc_collision(link, "plate", robot.base_radius, _PLATE_THICKNESS * r, plate_z)
    for leg in range(LEGS):
        centre, length = _housing(robot, frames, leg)
        add_shape(
            link,
            f"motor_{leg}",
            cylinder(_HOUSING_RADIUS * r, length),
            centre,
            _motor_turn(robot, frames, leg),
            colour="motor",
        )
        if collision:
            add_collision(link, f"motor_{leg}", sphere(_HOUSING_RADIUS * r), centre)
    weld = add_element(model, "joint", name="base_weld", type="fixed")
    add_element(weld, "parent", "world")
    add_element(weld, "child", "base")


def _housing(robot: RobotParameters, frames: HomeFrames, leg: int) -> tuple[np.ndarray, float]:
    """Centre (3,) [m] and length [m] of a motor's housing, on its axis and beside its crank.

    Coaxial motors of a pair stand back to back between their cranks; any other behind its crank, seen from outside.
    """
    r, axis, shaft = robot.link_radius, frames.crank_rotation[leg, :, 1], robot.shaft_positions[leg]
    partner = robot.shaft_positions[leg ^ 1] - shaft
    apart = float(partner @ axis)
    if abs(apart) > 0.99 * float(np.linalg.norm(partner)):
        gap, side = 0.5 * abs(apart), math.copysign(1.0, apart)
        length = max(gap - 2.0 * r, r)
    else:
        gap, length, side = (
            2.0 * _HOUSING_RADIUS * r,
            (2.0 * _HOUSING_RADIUS - 2.0) * r,
            -math.copysign(1.0, float(shaft @ axis)),
        )
    return shaft + side * (gap - 0.5 * length) * axis, length


def _upright(robot: RobotParameters, leg: int) -> bool:
    """Whether a crank turns in a vertical plane, from the horizontal up."""
    return bool((robot.crank_quarter_directions[leg] == (0.0, 0.0, 1.0)).all())


def _motor_turn(robot: RobotParameters, frames: HomeFrames, leg: int) -> tuple[float, ...]:
    """Roll, pitch, yaw [rad] that turn z into a crank's lateral axis, which a cylinder may have either way."""
    if _upright(robot, leg):
        return (0.5 * np.pi, 0.0, robot.crank_yaws[leg])
    x, y, z = frames.crank_rotation[leg, :, 1]
    return (0.0, math.atan2(math.hypot(x, y), z), math.atan2(y, x))


def _crank(model: ET.Element, robot: RobotParameters, frames: HomeFrames, leg: int, collision: bool) -> None:
    a, r = float(robot.crank_lengths[leg]), robot.link_radius
    if leg == 0:
        note(model, "Cranks: x along the crank, the motor axis is -y, centre of mass at mid-length.")
    link = add_element(model, "link", name=f"crank_{leg}")
    # Of an upright crank R_BC = Rz(yaw) Ry(-theta): no rounding of a matrix on the way.
    upright = (0.0, -frames.crank_angles[leg], robot.crank_yaws[leg])
    turn = upright if _upright(robot, leg) else roll_pitch_yaw(frames.crank_rotation[leg])
    add_element(link, "pose", exact_text((*robot.shaft_positions[leg], *turn)))
    middle = (0.5 * a, 0.0, 0.0)
    add_inertial(link, robot.crank_mass, robot.crank_inertia, middle)
    add_shape(link, "bar", box(a, 1.2 * r, 2.4 * r), middle, colour="crank")
    add_shape(link, "shaft", cylinder(1.6 * r, 2.4 * r), (0.0, 0.0, 0.0), (0.5 * np.pi, 0.0, 0.0), colour="crank")
    add_shape(link, "tip", sphere(1.5 * r), (a, 0.0, 0.0), colour="joint")
    if collision:
        add_collision(link, "bar", box(free_length(a, r), 2.0 * r, 2.0 * r), middle)


def _rod(model: ET.Element, robot: RobotParameters, frames: HomeFrames, leg: int, collision: bool) -> None:
    length, r = float(robot.rod_lengths[leg]), robot.link_radius
    if leg == 0:
        note(model, "Rods: origin at the crank tip, z along the rod, centre of mass at mid-length.")
    link = add_element(model, "link", name=f"rod_{leg}")
    add_element(link, "pose", exact_text((*frames.crank_tips[leg], *roll_pitch_yaw(frames.rod_rotation[leg]))))
    middle = (0.0, 0.0, 0.5 * length)
    add_inertial(link, robot.rod_mass, robot.rod_inertia, middle)
    add_shape(link, "tube", cylinder(0.8 * r, length), middle, colour="rod")
    add_shape(link, "end", sphere(1.5 * r), (0.0, 0.0, length), colour="joint")
    if collision:
        add_collision(link, "bar", box(2.0 * r, 2.0 * r, free_length(length, r)), middle)


def _platform(model: ET.Element, robot: RobotParameters, collision: bool) -> None:
    r, thickness = robot.link_radius, _DISC_THICKNESS * robot.link_radius
    note(model, "End effector: a disc on its joint circle.")
    link = add_element(model, "link", name="platform")
    add_element(link, "pose", exact_text((0.0, 0.0, robot.home_height, 0.0, 0.0, 0.0)))
    centre, products = robot.platform_center_of_mass, robot.platform_products
    add_inertial(link, robot.platform_mass, robot.platform_inertia, centre, products)
    disc = cylinder(robot.platform_radius, thickness)
    add_shape(link, "disc", disc, (0.0, 0.0, 0.0), colour="disc")
    if collision:
        add_disc_collision(link, "disc", robot.platform_radius, thickness, 0.0)
    note(link, "A surgical tool, and a bead towards x that makes yaw visible: pictures only.")
    top, tool = 0.5 * thickness, robot.characteristic_length
    add_shape(link, "tool_holder", cylinder(3.0 * r, 2.0 * r), (0.0, 0.0, top + r), colour="joint")
    add_shape(link, "tool_shaft", cylinder(0.6 * r, tool), (0.0, 0.0, top + 0.5 * tool), colour="tool")
    add_shape(link, "tool_tip", ellipsoid(0.6 * r, 0.6 * r, 2.0 * r), (0.0, 0.0, top + tool), colour="tool")
    add_shape(link, "bead", sphere(r), (robot.platform_radius - 3.0 * r, 0.0, top), colour="crank")


def _motor(model: ET.Element, robot: RobotParameters, frames: HomeFrames, leg: int) -> None:
    if leg == 0:
        note(model, "Motors: the only actuated joints; the effort limits are RobotParameters.effort_limits.")
    joint = add_joint(model, f"motor_{leg}", "revolute", "base", f"crank_{leg}")
    add_axis(joint, "axis", (0.0, -1.0, 0.0), float(robot.effort_limits[leg]), frames.stops[leg])
    if robot.rotor_inertia > 0.0:
        add_element(joint, "drake:rotor_inertia", exact_text((robot.rotor_inertia,)))


def _rod_joint(model: ET.Element, leg: int, rod_joint: RodJoint) -> None:
    if leg == 0:
        note(model, "Crank to rod. Without an effort of zero Drake's parser takes a joint for an actuated one.")
    joint = add_joint(model, f"{rod_joint}_{leg}", rod_joint, f"crank_{leg}", f"rod_{leg}")
    # A ball joint has no axes: the parser warns about any, and finds nothing to actuate without one.
    if rod_joint == "universal":
        add_axis(joint, "axis", (1.0, 0.0, 0.0), 0.0)
        add_axis(joint, "axis2", (0.0, 1.0, 0.0), 0.0)


def _closures(model: ET.Element, robot: RobotParameters) -> None:
    note(model, "Rod ends to platform: the joints that close the six loops.")
    for leg in range(LEGS):
        constraint = add_element(model, "drake:ball_constraint")
        add_element(constraint, "drake:ball_constraint_body_A", f"rod_{leg}")
        add_element(constraint, "drake:ball_constraint_p_AP", exact_text((0.0, 0.0, robot.rod_lengths[leg])))
        add_element(constraint, "drake:ball_constraint_body_B", "platform")
        add_element(constraint, "drake:ball_constraint_p_BQ", exact_text(robot.platform_joints[leg]))


def _collision_filter(model: ET.Element) -> None:
    note(model, "Drake filters bodies that share a joint, but not those that a constraint holds together.")
    rods = add_element(model, "drake:collision_filter_group", name="rods")
    for leg in range(LEGS):
        add_element(rods, "drake:member", f"rod_{leg}")
    add_element(rods, "drake:ignored_collision_filter_group", "end_effector")
    effector = add_element(model, "drake:collision_filter_group", name="end_effector")
    add_element(effector, "drake:member", "platform")
