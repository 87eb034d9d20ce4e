"""The robot as a browser draws it: its shapes once, then where its links are. It needs no Drake."""

from __future__ import annotations

from typing import Any
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from stewart_drake.mechanics.kinematics import rotation_matrix
from stewart_drake.plant.model_files import crank_rotations, on_platform, rod_rotations, sdf_text
from stewart_drake.robot import RobotParameters

LENS = 36.0
"""[deg] vertical field of view."""
REFERENCE_COLOUR = (0.0, 0.62, 0.45, 0.4)
"""Red, green, blue and opacity of the disc that shows where the reference wants the platform."""


GHOST_COLOUR = (0.0, 0.62, 0.45, 0.25)
"""Of a robot where the reference wants it."""


def viewpoint(robot: RobotParameters) -> tuple[np.ndarray, np.ndarray]:
    """Where a camera should stand and look, both (3,) [m] in B, for the whole robot to be seen."""
    height = robot.home_height - robot.base_height
    size = robot.base_radius + float(robot.crank_lengths.max()) + height
    # A robot that is slender for its platform needs room for the tool.
    size = max(size, 2.0 * (0.46 * height + 1.3 * robot.characteristic_length))
    target = np.array([0.0, 0.0, robot.base_height + 0.54 * height])
    direction = np.array([1.05, -0.80, 0.52])
    return target + 1.9 * size * direction / np.linalg.norm(direction), target


def reference_disc(robot: RobotParameters) -> tuple[float, float]:
    """Radius and length [m] of a disc that shows as a ring around a platform that tracks well: wider and thinner."""
    return 1.15 * robot.platform_radius, 0.4 * robot.link_radius


def robot_scene(robot: RobotParameters, ghost: bool = False) -> dict[str, Any]:
    """Camera, shapes of what never moves, and shapes of each link, in the order of `link_poses`; for JSON.

    With a `ghost` cranks, rods and platform come once more, pale.
    """
    camera, target = viewpoint(robot)
    model = ElementTree.fromstring(sdf_text(robot, collision=False)).iter("link")
    links = {str(link.get("name")): [_shape(visual) for visual in link.iter("visual")] for link in model}
    disc = {
        "kind": "cylinder",
        "size": reference_disc(robot),
        "at": np.ravel(on_platform(robot, np.zeros(3), np.zeros(3))).tolist(),
        "colour": REFERENCE_COLOUR,
    }
    base = links.pop("base")
    pale = {f"ghost of {name}": [shape | {"colour": GHOST_COLOUR} for shape in links[name]] for name in links}
    links["reference"] = [disc]
    links |= pale if ghost else {}
    return {"camera": camera.tolist(), "target": target.tolist(), "lens": LENS, "fixed": base, "links": links}


def _shape(visual: ElementTree.Element) -> dict[str, Any]:
    """Kind, size [m], pose in its link (x, y, z, roll, pitch, yaw) and colour of a visual of the SDF."""
    (shape,) = visual.iterfind("geometry/*")
    size = [number for dimension in shape for number in _numbers(dimension)]
    pose, colour = visual.find("pose"), visual.find("material/diffuse")
    return {"kind": shape.tag, "size": size, "at": _numbers(pose), "colour": _numbers(colour)}


def _numbers(element: ElementTree.Element | None) -> list[float]:
    return [float(word) for word in ("" if element is None else element.text or "").split()]


def link_poses(
    robot: RobotParameters,
    pose: np.ndarray,
    crank_angles: np.ndarray,
    reference: np.ndarray,
    e_l: np.ndarray | None = None,
) -> np.ndarray:
    """Position [m] and quaternion x, y, z, w (..., 14, 7) in B of cranks, rods, platform and reference disc.

    Rods lie along e_l (..., 6, 3); None takes the way from each crank's tip to its joint on the platform.
    """
    platform, wanted = rotation_matrix(pose[..., :3])[..., None, :, :], rotation_matrix(reference[..., :3])
    cranks = crank_rotations(robot, crank_angles)
    tips = robot.shaft_positions + robot.crank_lengths[:, None] * cranks[..., 0]
    if e_l is None:
        span = (platform @ robot.platform_joints[..., None])[..., 0] + pose[..., None, 3:] - tips
        e_l = span / np.linalg.norm(span, axis=-1, keepdims=True)
    turns = np.concatenate([cranks, rod_rotations(robot, e_l), platform, wanted[..., None, :, :]], axis=-3)
    shafts = np.broadcast_to(robot.shaft_positions, tips.shape)
    places = np.concatenate([shafts, tips, pose[..., None, 3:], reference[..., None, 3:]], axis=-2)
    quaternions = Rotation.from_matrix(turns.reshape(-1, 3, 3)).as_quat().reshape(*turns.shape[:-2], 4)
    return np.concatenate([places, quaternions], axis=-1)
