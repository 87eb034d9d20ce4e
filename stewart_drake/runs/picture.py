"""A picture of a robot at a pose."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from pydrake.geometry import (
    ClippingRange,
    ColorRenderCamera,
    Cylinder,
    GeometryInstance,
    LightParameter,
    MakeRenderEngineVtk,
    PerceptionProperties,
    RenderCameraCore,
    RenderEngineVtkParams,
    RenderLabel,
    Rgba,
    SceneGraph,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.sensors import CameraInfo, ImageFileFormat, ImageIo, ImageRgba8U

from stewart_drake.mechanics.kinematics import leg_geometry
from stewart_drake.plant.multibody_plant import add_plant
from stewart_drake.robot import RobotParameters
from stewart_drake.runs.replay import viewpoint

LENS_ANGLE = 32.0
"""[deg] vertical field of view."""


def render_png(
    robot: RobotParameters,
    pose: np.ndarray,
    path: Path,
    *,
    width: int = 1200,
    height: int = 900,
    passes: int = 16,
) -> None:
    """Writes a picture of the robot at a pose, in soft light on a white floor.

    Drawn by Drake's VTK renderer: without a display or a GPU, but it needs the system's libEGL.

    Args:
        robot: Geometry.
        pose: (6,) [rad, m] of P in B.
        path: The PNG to write.
        width: [px].
        height: [px].
        passes: Pictures under different lights that are averaged; more give softer shadows and smoother edges.
    """
    image = ImageRgba8U(width, height)
    image.mutable_data[:] = _render(robot, pose, width, height, passes)
    path.write_bytes(ImageIo().Save(image, ImageFileFormat.kPng))


def _render(robot: RobotParameters, pose: np.ndarray, width: int, height: int, passes: int) -> np.ndarray:
    """(height, width, 4) [0..255] red, green, blue, alpha of the robot at a pose."""
    builder = DiagramBuilder()
    stewart = add_plant(builder, robot, visuals=True)
    scene_graph: SceneGraph = stewart.scene_graph
    _add_floor(scene_graph, robot, pose)
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    scene = scene_graph.GetMyMutableContextFromRoot(context)
    X_WC = _look_at(*viewpoint(robot))  # noqa: N806 - monogram notation
    focal = 0.5 * height / math.tan(math.radians(0.5 * LENS_ANGLE))
    total = np.zeros((height, width, 4))
    for lights, (dx, dy) in zip(_studio(passes), _spread(passes) - 0.5, strict=True):
        # VTK knows only hard shadows and rough edges. Many pictures, each under other lights and shifted by a fraction
        # of a pixel, average to soft ones.
        engine = RenderEngineVtkParams(
            default_clear_color=[1.0, 1.0, 1.0], lights=lights, cast_shadows=True, shadow_map_size=1024
        )
        scene_graph.AddRenderer(scene, "studio", MakeRenderEngineVtk(engine))
        # A renderer added to a Context learns where things are from the next change of the state only.
        stewart.set_state(context, pose)
        camera = CameraInfo(width, height, focal, focal, 0.5 * (width - 1) + dx, 0.5 * (height - 1) + dy)
        core = RenderCameraCore("studio", camera, ClippingRange(0.01, 100.0), RigidTransform())
        query = scene_graph.get_query_output_port().Eval(scene)
        total += query.RenderColorImage(ColorRenderCamera(core, False), SceneGraph.world_frame_id(), X_WC).data
        scene_graph.RemoveRenderer(scene, "studio")
    return np.rint(total / passes).astype(np.uint8)


def _add_floor(scene_graph: SceneGraph, robot: RobotParameters, pose: np.ndarray) -> None:
    """A white disc just below the base, or below the cranks where they hang lower."""
    tips = robot.shaft_positions[:, 2] + robot.crank_lengths * leg_geometry(robot, pose).crank[:, 2]
    top = min(robot.base_height - 6.0 * robot.link_radius, float(tips.min()) - 3.0 * robot.link_radius)
    thickness = 0.01
    floor = GeometryInstance(
        RigidTransform([0.0, 0.0, top - 0.5 * thickness]), Cylinder(3.5 * robot.base_radius, thickness), "floor"
    )
    paint = PerceptionProperties()
    paint.AddProperty("phong", "diffuse", Rgba(1.0, 1.0, 1.0, 1.0))
    paint.AddProperty("label", "id", RenderLabel.kDontCare)
    floor.set_perception_properties(paint)
    scene_graph.RegisterAnchoredGeometry(scene_graph.RegisterSource("studio"), floor)


def _studio(passes: int) -> list[list[LightParameter]]:
    """Lights of each pass: samples of a lamp above, of a lamp round the camera, and of a bright sky."""
    per_pass = 5
    count = passes * per_pass
    angle = 2.0 * np.pi * _spread(count)[:, 1]
    disc = np.sqrt(_spread(count)[:, :1]) * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    one = np.ones((count, 1))
    # Directions in which light travels; those of the sky fill a hemisphere, denser towards its top (Lambert's law). The
    # intensities together light the floor just white, like the background.
    sky = 0.97 * disc
    groups = (
        ("world", 0.56, np.hstack([0.1 * disc + [-0.3, 0.38], -one])),
        ("world", 0.64, np.hstack([sky, -np.sqrt(1.0 - np.sum(sky**2, axis=1, keepdims=True))])),
        ("camera", 0.42, np.hstack([0.5 * disc, one])),
    )
    return [
        [
            LightParameter(type="directional", frame=frame, direction=direction, intensity=intensity / per_pass)
            for frame, intensity, directions in groups
            for direction in directions[start::passes]
        ]
        for start in range(passes)
    ]


def _spread(count: int) -> np.ndarray:
    """(count, 2) points that fill the unit square evenly: Roberts' R2 sequence, after powers of the plastic number."""
    plastic = 1.324717957244746
    index = np.arange(1, count + 1)[:, None]
    points: np.ndarray = (0.5 + index / np.array([plastic, plastic**2])) % 1.0
    return points


def _look_at(camera: np.ndarray, target: np.ndarray) -> RigidTransform:
    """X_WC of a camera that looks at a point, upright; Drake's cameras look along z with y down."""
    z = (target - camera) / np.linalg.norm(target - camera)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    return RigidTransform(RotationMatrix(np.stack([x, np.cross(z, x), z], axis=-1)), camera)
