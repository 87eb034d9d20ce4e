"""What is to be looked at: the recording of a run for a browser, and a still picture of a robot."""

from __future__ import annotations

import gc
import html
import json
import logging
import math
import re
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from pydrake import geometry
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.sensors import CameraInfo, ImageFileFormat, ImageIo, ImageRgba8U

from stewart_drake.config import Positive, check_value
from stewart_drake.errors import ConfigurationError, drake_guard
from stewart_drake.files.whole import write_atomically
from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.metrics import error_norms
from stewart_drake.mechanics.kinematics import leg_geometry
from stewart_drake.plant.multibody_plant import add_plant
from stewart_drake.plant.plant_options import PlantOptions
from stewart_drake.plant.sdf_model import RodJoint
from stewart_drake.robot import RobotParameters

MAX_FRAMES = 9000
"""A longer recording gets fewer frames a second: at some 2 kB a frame, a browser opens no more than this with ease."""
MAX_POINTS = 3000
"""Of a trace."""
_REPLAY_LENS, _PICTURE_LENS = 36.0, 32.0
"""[deg] vertical field of view; Meshcat's own 75 deg would distort a robot so near."""


def write_replay(
    logs: SimulationLog | Sequence[SimulationLog], path: str | Path, frames_per_second: float = 30.0
) -> None:
    """Writes the motion of one run or of several side by side as one HTML page that plays in any browser, offline.

    The page has play and pause, a time slider, speed and loop, and traces of errors and torques whose cursor follows.
    A green translucent disc shows where the reference wants the platform. Each frame is the row of the log nearest to
    it in time; between frames the browser interpolates.

    Args:
        logs: A run, completed or not, or several.
        path: The page to write; about 2.5 MB a run and 2 kB for each frame.
        frames_per_second: [1/s] at most this; less where the run is so long that `MAX_FRAMES` would be exceeded.

    Raises:
        ConfigurationError: No row of finite state, unusable `frames_per_second`, or a folder that is missing or not
            writable.
        DrakeCheckError: Drake could not record, such as for want of a free port.
    """
    check_value("frames_per_second", frames_per_second, Positive)
    runs = [_shown(log, frames_per_second) for log in ([logs] if isinstance(logs, SimulationLog) else logs)]
    # A text in a script element must not end it.
    data = json.dumps(runs).replace("<", "\\u003c")
    page = {"title": html.escape(", ".join(run["name"] for run in runs)), "data": data}
    page |= {"styles": _page_file("uPlot.min.css") + _page_file("replay.css")}
    page |= {"plots": _page_file("uPlot.iife.min.js"), "script": _page_file("replay.js")}
    text = re.sub(r"\{\{ (\w+) \}\}", lambda match: page[match[1]], _page_file("replay.html"))
    write_atomically(Path(path), text.encode())


def _page_file(name: str) -> str:
    return (files("stewart_drake") / "pages" / name).read_text()


def _shown(log: SimulationLog, frames_per_second: float) -> dict[str, Any]:
    """What the page shows of a run."""
    # Without a state of Drake's own the robot is assembled at the platform's pose.
    usable = np.flatnonzero(np.isfinite(log.signals.get("plant_state", log["pose"])).all(axis=1))
    if len(usable) == 0:
        allowed = "a log with at least one row of finite state to replay"
        raise ConfigurationError("log", f"{len(log.time)} rows", allowed)
    time = log.time[usable]
    rate = min(frames_per_second, (MAX_FRAMES - 1) / time[-1]) if time[-1] > 0.0 else frames_per_second
    frames, rows = nearest_rows(time, rate)
    try:
        with drake_guard("recording the replay"):
            page = _record(log, frames, usable[rows], rate)
    finally:
        # A Diagram and its systems refer to each other; until they are collected, Meshcat keeps its port.
        gc.collect()
    traced = usable[:: max(1, len(usable) // MAX_POINTS)]
    rotation, position = error_norms(log)
    torque = log.signals.get("torque_applied", np.zeros((len(log.time), 0)))
    lines = [(f"{log.status} at {log.end_time:g} s", log.status != "completed")]
    lines += [(line, True) for line in ([] if log.message is None else log.message.splitlines())]
    lines += [(f"warning at {each['time']:.3f} s: {each['text']}", False) for each in log.warnings]
    return {
        "name": log.scenario.name,
        "page": page,
        "lines": lines,
        "time": _digits(log.time[traced]),
        "rotation_deg": _digits(rotation[traced]),
        "position_mm": _digits(position[traced]),
        "torque": [_digits(column) for column in torque[traced].T],
    }


def _digits(values: np.ndarray) -> list[float]:
    return [float(f"{value:.5g}") for value in values]


def nearest_rows(time: np.ndarray, rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Frames of an animation for which there is a row, and the row nearest to each.

    Args:
        time: (n,) [s] ascending, from 0 on.
        rate: [1/s] frames.

    Returns:
        Frame numbers (k,), ascending, and indices (k,) into `time`. Frames between sparser rows are left out.
    """
    frame = np.rint(time * rate).astype(int)
    order = np.lexsort((np.abs(time - frame / rate), frame))
    frames, first = np.unique(frame[order], return_index=True)
    return frames, order[first]


def _record(log: SimulationLog, frames: np.ndarray, rows: np.ndarray, rate: float) -> str:
    """The recording as the text of a page."""
    view, states = RobotView(log.scenario.robot, log.scenario.plant.rod_joint), log.signals.get("plant_state")
    view.meshcat.StartRecording(rate, set_visualizations_while_recording=False)
    for frame, row in zip(frames, rows, strict=True):
        state = view.stewart.assemble(log["pose"][row]) if states is None else states[row]
        # Meshcat rounds down to the frame; the middle of one is safe from rounding.
        view.show((frame + 0.5) / rate, state, log["reference"][row])
    view.meshcat.StopRecording()
    view.meshcat.PublishRecording()
    return str(view.meshcat.StaticHtml())


class RobotView:
    """A robot and its reference in a Meshcat that only this machine can open.

    Attributes:
        meshcat: With our camera and background.
        stewart: The plant that is drawn, with `assemble`.
    """

    def __init__(self, robot: RobotParameters, rod_joint: RodJoint = "universal") -> None:
        # Drake announces every Meshcat; ours is seen in a page of our own.
        drake_log = logging.getLogger("drake")
        level = drake_log.level
        drake_log.setLevel(logging.WARNING)
        try:
            meshcat = geometry.Meshcat(geometry.MeshcatParams(host="localhost", show_stats_plot=False))
        finally:
            drake_log.setLevel(level)
        self.meshcat = meshcat
        meshcat.SetCamera(geometry.Meshcat.PerspectiveCamera(fov=_REPLAY_LENS))
        meshcat.SetCameraPose(*_viewpoint(robot))
        meshcat.SetProperty("/Background/<object>", "top_color", [1.0, 1.0, 1.0])
        meshcat.SetProperty("/Background/<object>", "bottom_color", [0.80, 0.83, 0.87])
        for path in ("/Grid", "/Axes"):
            meshcat.SetProperty(path, "visible", False)
        # Wider than the platform and thinner: it shows as a ring around a platform that tracks well.
        disc = geometry.Cylinder(1.15 * robot.platform_radius, 0.4 * robot.link_radius)
        meshcat.SetObject("reference", disc, geometry.Rgba(0.0, 0.62, 0.45, 0.4))
        builder = DiagramBuilder()
        self.stewart = add_plant(builder, robot, PlantOptions(rod_joint=rod_joint), visuals=True)
        parameters = geometry.MeshcatVisualizerParams(prefix="robot")
        geometry.MeshcatVisualizer.AddToBuilder(builder, self.stewart.scene_graph, meshcat, parameters)
        self._diagram = builder.Build()
        self._context = self._diagram.CreateDefaultContext()
        self._plant_context = self.stewart.plant.GetMyMutableContextFromRoot(self._context)

    def show(self, time: float, state: np.ndarray, reference: np.ndarray) -> None:
        """Draws the plant's state and the pose (6,) [rad, m] of the reference at a time [s] of the recording."""
        self._context.SetTime(time)
        self.stewart.plant.SetPositionsAndVelocities(self._plant_context, state)
        self._diagram.ForcedPublish(self._context)
        self.meshcat.SetTransform("reference", RigidTransform(RollPitchYaw(reference[:3]), reference[3:]), time)


def _viewpoint(robot: RobotParameters) -> tuple[np.ndarray, np.ndarray]:
    """Where a camera should stand and look, both (3,) [m] in B, for the whole robot to be seen."""
    height = robot.home_height - robot.base_height
    size = robot.base_radius + float(robot.crank_lengths.max()) + height
    # A robot that is slender for its platform needs room for the tool.
    size = max(size, 2.0 * (0.46 * height + 1.3 * robot.characteristic_length))
    target = np.array([0.0, 0.0, robot.base_height + 0.54 * height])
    direction = np.array([1.05, -0.80, 0.52])
    return target + 1.9 * size * direction / np.linalg.norm(direction), target


def render_png(
    robot: RobotParameters, pose: np.ndarray, path: Path, *, width: int = 1200, height: int = 900, passes: int = 16
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
    builder = DiagramBuilder()
    stewart = add_plant(builder, robot, visuals=True)
    scene_graph: geometry.SceneGraph = stewart.scene_graph
    _add_floor(scene_graph, robot, pose)
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    scene = scene_graph.GetMyMutableContextFromRoot(context)
    # X_WC looks at the target, upright; Drake's cameras look along z with y down.
    camera, target = _viewpoint(robot)
    z = (target - camera) / np.linalg.norm(target - camera)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    X_WC = RigidTransform(RotationMatrix(np.stack([x, np.cross(z, x), z], axis=-1)), camera)  # noqa: N806
    focal = 0.5 * height / math.tan(math.radians(0.5 * _PICTURE_LENS))
    total = np.zeros((height, width, 4))
    for lights, (dx, dy) in zip(_studio(passes), _spread(passes) - 0.5, strict=True):
        # VTK knows only hard shadows and rough edges. Many pictures, each under other lights and shifted by a fraction
        # of a pixel, average to soft ones.
        engine = geometry.RenderEngineVtkParams(
            default_clear_color=[1.0, 1.0, 1.0], lights=lights, cast_shadows=True, shadow_map_size=1024
        )
        scene_graph.AddRenderer(scene, "studio", geometry.MakeRenderEngineVtk(engine))
        # A renderer added to a Context learns where things are from the next change of the state only.
        stewart.set_state(context, pose)
        lens = CameraInfo(width, height, focal, focal, 0.5 * (width - 1) + dx, 0.5 * (height - 1) + dy)
        core = geometry.RenderCameraCore("studio", lens, geometry.ClippingRange(0.01, 100.0), RigidTransform())
        query = scene_graph.get_query_output_port().Eval(scene)
        total += query.RenderColorImage(
            geometry.ColorRenderCamera(core, False), geometry.SceneGraph.world_frame_id(), X_WC
        ).data
        scene_graph.RemoveRenderer(scene, "studio")
    image = ImageRgba8U(width, height)
    image.mutable_data[:] = np.rint(total / passes).astype(np.uint8)
    path.write_bytes(ImageIo().Save(image, ImageFileFormat.kPng))


def _add_floor(scene_graph: geometry.SceneGraph, robot: RobotParameters, pose: np.ndarray) -> None:
    """A white disc just below the base, or below the cranks where they hang lower."""
    tips = robot.shaft_positions[:, 2] + robot.crank_lengths * leg_geometry(robot, pose).crank[:, 2]
    top = min(robot.base_height - 6.0 * robot.link_radius, float(tips.min()) - 3.0 * robot.link_radius)
    thickness = 0.01
    floor = geometry.GeometryInstance(
        RigidTransform([0.0, 0.0, top - 0.5 * thickness]),
        geometry.Cylinder(3.5 * robot.base_radius, thickness),
        "floor",
    )
    paint = geometry.PerceptionProperties()
    paint.AddProperty("phong", "diffuse", geometry.Rgba(1.0, 1.0, 1.0, 1.0))
    paint.AddProperty("label", "id", geometry.RenderLabel.kDontCare)
    floor.set_perception_properties(paint)
    scene_graph.RegisterAnchoredGeometry(scene_graph.RegisterSource("studio"), floor)


def _studio(passes: int) -> list[list[geometry.LightParameter]]:
    """Lights of each pass: samples of a lamp above, of a lamp round the camera, and of a bright sky."""
    per_pass = 5
    spread = _spread(passes * per_pass)
    angle = 2.0 * np.pi * spread[:, 1]
    disc = np.sqrt(spread[:, :1]) * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    one = np.ones((len(disc), 1))
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
            geometry.LightParameter(
                type="directional", frame=frame, direction=direction, intensity=intensity / per_pass
            )
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
