"""The robot for the browser: shapes of its links, and their poses over time. Drake is not needed."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from stewart_drake.base.atomic_files import Document
from stewart_drake.mechanics.ball import BallOptions
from stewart_drake.mechanics.kinematics import rotation_matrix
from stewart_drake.plant.model_files import crank_rotations, on_platform, rod_rotations, sdf_text
from stewart_drake.robot import RobotParameters

LENS = 36.0  # [deg] vertical field of view.
REFERENCE_COLOUR = (0.0, 0.62, 0.45, 0.4)  # Red, green, blue, opacity of the disc at the reference pose.
BALL_COLOUR, SPOT_COLOUR = (0.85, 0.24, 0.12, 1.0), (0.98, 0.95, 0.88, 1.0)  # Of a ball, and of its six spots.
TARGET_COLOUR = (0.0, 0.30, 0.65, 1.0)
PLATE_COLOUR = (0.72, 0.77, 0.83, 1.0)
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


def robot_scene(
    robot: RobotParameters, ghost: bool = False, ball: BallOptions | None = None, balanced: bool = False
) -> dict[str, object]:
    """Camera, fixed shapes, and shapes by link in the order of `link_poses`, as JSON values.

    A ball and its target, if it is `balanced`, come before the reference disc, and its plate is a shape of the
    platform. With a `ghost` there is a second, translucent set of all but the disc.
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
    if ball is not None:
        # The platform without its tool, and not above the plate.
        bare, height = links["platform"][0], ball.plate.height
        lowered = min(bare["at"][2], height - 0.003 - 0.5 * bare["size"][1])
        links["platform"] = [bare | {"at": [*bare["at"][:2], lowered, *bare["at"][3:]]}]
        links["platform"].append(_disc(ball.plate.radius, height - 0.0015, 0.003, PLATE_COLOUR))
        links["ball"] = _ball_shapes(ball.radius)
        links["target of the ball"] = [_disc(0.6 * ball.radius, 0.0005, 0.001, TARGET_COLOUR)] if balanced else []
    second = {f"ghost of {name}": [shape | {"colour": GHOST_COLOUR} for shape in links[name]] for name in links}
    links["reference"] = [disc]
    links |= second if ghost else {}
    return {"camera": camera.tolist(), "target": target.tolist(), "lens": LENS, "fixed": base, "links": links}


def _disc(radius: float, height: float, thickness: float, colour: tuple[float, ...]) -> dict[str, object]:
    return {"kind": "cylinder", "size": (radius, thickness), "at": [0.0, 0.0, height, 0.0, 0.0, 0.0], "colour": colour}


def _ball_shapes(radius: float) -> list[dict[str, object]]:
    """A sphere with six spots, caps of smaller spheres, by which one sees that it rolls."""
    spots = [0.26 * radius * sign * axis for axis in np.eye(3) for sign in (1.0, -1.0)]
    spheres = [(radius, np.zeros(3), BALL_COLOUR), *((0.76 * radius, at, SPOT_COLOUR) for at in spots)]
    return [{"kind": "sphere", "size": [r], "at": [*at, 0.0, 0.0, 0.0], "colour": c} for r, at, c in spheres]


def rolled(way: np.ndarray, radius: float) -> Rotation:
    """Turn in P of a ball that rolls by a way (2,) [m] on the plate."""
    return Rotation.from_rotvec(np.array([-way[1], way[0], 0.0]) / radius)


def ball_links(
    ball: BallOptions,
    pose: np.ndarray,
    place: np.ndarray,
    target: np.ndarray | None = None,
    turn: Rotation | None = None,
) -> np.ndarray:
    """Position [m] and quaternion x, y, z, w (..., 2, 7) in B of a ball and its target, at places (..., 2) [m].

    By default the target is the centre of the plate, and the ball has turned as it rolled along the places.
    """
    target = np.zeros_like(place) if target is None else target
    if turn is None:
        ways, turns = np.diff(place.reshape(-1, 2), axis=0, prepend=place.reshape(-1, 2)[:1]), [Rotation.identity()]
        for way in ways[1:]:
            turns.append(rolled(way, ball.radius) * turns[-1])
        turn = Rotation.concatenate(turns)
    platform, heights = rotation_matrix(pose[..., :3]), (ball.plate.height + ball.radius, ball.plate.height)
    places = [
        np.concatenate([at, np.full((*at.shape[:-1], 1), z)], axis=-1)
        for at, z in zip((place, target), heights, strict=True)
    ]
    positions = pose[..., None, 3:] + np.einsum("...ij,...kj->...ki", platform, np.stack(places, axis=-2))
    level = Rotation.from_matrix(platform.reshape(-1, 3, 3))
    turned = [each.as_quat().reshape(*place.shape[:-1], 4) for each in (level * turn, level)]
    return np.concatenate([positions, np.stack(turned, axis=-2)], axis=-1)


def _shape(visual: ElementTree.Element) -> Document:
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
