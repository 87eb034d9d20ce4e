"""The robot for the browser: shapes of its links, and their poses over time. Drake is not needed."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from stewart_drake.base.atomic_files import Document
from stewart_drake.mechanics.kinematics import rotation_matrix
from stewart_drake.plant.model_files import crank_rotations, on_platform, rod_rotations, sdf_text
from stewart_drake.robot import RobotParameters

LENS = 36.0  # [deg] vertical field of view.
REFERENCE_COLOUR = (0.0, 0.62, 0.45, 0.4)  # Red, green, blue, opacity of the disc at the reference pose.
GHOST_COLOUR = (0.0, 0.62, 0.45, 0.25)  # The same, of a second robot at the reference pose.


def viewpoint(robot: RobotParameters) -> tuple[np.ndarray, np.ndarray]:
    """Camera position and target, (3,) [m] in B, that show the whole robot."""
    up = robot.home_height - robot.base_height
    height = abs(up)
    size = robot.base_radius + float(robot.crank_lengths.max()) + height
    # Tall robots with small platforms need room for the tool.
    size = max(size, 2.0 * (0.46 * height + 1.3 * robot.characteristic_length))
    target = np.array([0.0, 0.0, robot.base_height + 0.54 * up])
    direction = np.array([1.05, -0.80, 0.52])
    return target + 1.9 * size * direction / np.linalg.norm(direction), target


def reference_disc(robot: RobotParameters) -> tuple[float, float]:
    """Radius and thickness [m] of the reference disc, a ring around the platform if the error is small."""
    return 1.15 * robot.platform_radius, 0.4 * robot.link_radius


def robot_scene(robot: RobotParameters, ghost: bool = False) -> dict[str, object]:
    """Camera, fixed shapes, and shapes by link in the order of `link_poses`, as JSON values.

    With a `ghost` there is a second, translucent set of cranks, rods and platform.
    """
    camera, target = viewpoint(robot)
    model = ElementTree.fromstring(sdf_text(robot, collision=False)).iter("link")
    links = {str(link.get("name")): [_shape(visual) for visual in link.iter("visual")] for link in model}
    disc: dict[str, object] = {
        "kind": "cylinder",
        "size": reference_disc(robot),
        "at": np.ravel(on_platform(robot, np.zeros(3), np.zeros(3))).tolist(),
        "colour": REFERENCE_COLOUR,
    }
    base = links.pop("base")
    second = {f"ghost of {name}": [shape | {"colour": GHOST_COLOUR} for shape in links[name]] for name in links}
    links["reference"] = [disc]
    links |= second if ghost else {}
    return {"camera": camera.tolist(), "target": target.tolist(), "lens": LENS, "fixed": base, "links": links}


def _shape(visual: ElementTree.Element) -> dict[str, object]:
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

    Rods have the directions e_l (..., 6, 3); None takes those from crank tips to platform joints.
    """
    platform = rotation_matrix(pose[..., :3])[..., None, :, :]
    disc = rotation_matrix(reference[..., :3])[..., None, :, :]
    cranks = crank_rotations(robot, crank_angles)
    tips = robot.shaft_positions + robot.crank_lengths[:, None] * cranks[..., 0]
    if e_l is None:
        span = (platform @ robot.platform_joints[..., None])[..., 0] + pose[..., None, 3:] - tips
        e_l = span / np.linalg.norm(span, axis=-1, keepdims=True)
    rotations = np.concatenate([cranks, rod_rotations(robot, e_l), platform, disc], axis=-3)
    shafts = np.broadcast_to(robot.shaft_positions, tips.shape)
    positions = np.concatenate([shafts, tips, pose[..., None, 3:], reference[..., None, 3:]], axis=-2)
    quaternions = Rotation.from_matrix(rotations.reshape(-1, 3, 3)).as_quat().reshape(*rotations.shape[:-2], 4)
    return np.concatenate([positions, quaternions], axis=-1)


def on_base(scene: Document, links: np.ndarray, base: np.ndarray) -> tuple[Document, np.ndarray]:
    """Scene and links (n, m, 7) in B as a base with axes (n, 3, 3) in the world carries them; its origin stays."""
    turns, places = Rotation.from_matrix(base), np.einsum("nij,nmj->nmi", base, links[..., :3])
    carried = [turns * Rotation.from_quat(links[:, k, 3:]) for k in range(links.shape[1])]
    own = np.concatenate([np.zeros((len(base), 3)), turns.as_quat()], axis=1)[:, None]
    moved = np.concatenate([places, np.stack([turn.as_quat() for turn in carried], axis=1)], axis=-1)
    shift = base[0] @ scene["target"] - scene["target"]
    view = {name: (scene[name] + shift).tolist() for name in ("camera", "target")}
    shapes = {"fixed": [], "links": {**scene["links"], "base": scene["fixed"]}}
    return {**scene, **view, **shapes}, np.concatenate([moved, own], axis=1)
