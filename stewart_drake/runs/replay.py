"""The recording of a run for a browser."""

from __future__ import annotations

import gc
import html
import json
import logging
import re
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.geometry import (
    Cylinder,
    Meshcat,
    MeshcatParams,
    MeshcatVisualizer,
    MeshcatVisualizerParams,
    Rgba,
)
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.framework import DiagramBuilder

from stewart_drake.config import Positive, check_value
from stewart_drake.errors import ConfigurationError, drake_guard
from stewart_drake.files.whole import write_atomically
from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.metrics import error_norms
from stewart_drake.plant.multibody_plant import add_plant
from stewart_drake.plant.plant_options import PlantOptions
from stewart_drake.robot import RobotParameters

MAX_FRAMES = 9000
"""A longer recording gets fewer frames a second: at some 2 kB a frame, a browser opens no more than this with ease."""

MAX_POINTS = 3000
"""Of a trace."""
_LENS_ANGLE = 36.0
"""[deg] vertical field of view; Meshcat's own 75 deg would distort a robot so near."""


def write_replay(logs: SimulationLog | Sequence[SimulationLog], path: str | Path, frames_per_second: float = 30.0) -> None:
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
        raise ConfigurationError(
            "log", f"{len(log.time)} rows", "a log with at least one row of finite state to replay"
        )
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
        "torque": [_digits(column) for column in log["torque_applied"][traced].T],
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
    distance = np.abs(time - frame / rate)
    order = np.lexsort((distance, frame))
    frames, first = np.unique(frame[order], return_index=True)
    return frames, order[first]


def _record(log: SimulationLog, frames: np.ndarray, rows: np.ndarray, rate: float) -> str:
    """The recording as the text of a page."""
    robot = log.scenario.robot
    # Drake announces every Meshcat; nobody can look at this one before it is gone.
    drake_log = logging.getLogger("drake")
    level = drake_log.level
    drake_log.setLevel(logging.WARNING)
    try:
        meshcat = Meshcat(MeshcatParams(host="localhost", show_stats_plot=False))
    finally:
        drake_log.setLevel(level)
    furnish(meshcat, robot)
    builder = DiagramBuilder()
    stewart = add_plant(builder, robot, PlantOptions(rod_joint=log.scenario.plant.rod_joint), visuals=True)
    MeshcatVisualizer.AddToBuilder(builder, stewart.scene_graph, meshcat, MeshcatVisualizerParams(prefix="robot"))
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    plant_context = stewart.plant.GetMyMutableContextFromRoot(context)

    meshcat.StartRecording(rate, set_visualizations_while_recording=False)
    for frame, row in zip(frames, rows, strict=True):
        # Meshcat rounds down to the frame; the middle of one is safe from rounding.
        time = (frame + 0.5) / rate
        context.SetTime(time)
        whole = log.signals.get("plant_state")
        state = stewart.assemble(log["pose"][row]) if whole is None else whole[row]
        stewart.plant.SetPositionsAndVelocities(plant_context, state)
        diagram.ForcedPublish(context)
        reference = log["reference"][row]
        meshcat.SetTransform("reference", RigidTransform(RollPitchYaw(reference[:3]), reference[3:]), time)
    meshcat.StopRecording()
    meshcat.PublishRecording()
    return str(meshcat.StaticHtml())


def furnish(meshcat: Meshcat, robot: RobotParameters) -> None:
    """Camera, background and the disc of the reference."""
    camera, target = viewpoint(robot)
    meshcat.SetCamera(Meshcat.PerspectiveCamera(fov=_LENS_ANGLE))
    meshcat.SetCameraPose(camera, target)
    meshcat.SetProperty("/Background", "top_color", [1.0, 1.0, 1.0])
    meshcat.SetProperty("/Background", "bottom_color", [0.80, 0.83, 0.87])
    for path in ("/Grid", "/Axes"):
        meshcat.SetProperty(path, "visible", False)
    # Wider than the platform and thinner: it shows as a ring around a platform that tracks well.
    disc = Cylinder(1.15 * robot.platform_radius, 0.4 * robot.link_radius)
    meshcat.SetObject("reference", disc, Rgba(0.0, 0.62, 0.45, 0.4))


def viewpoint(robot: RobotParameters) -> tuple[np.ndarray, np.ndarray]:
    """Where a camera should stand and look, both (3,) [m] in B, for the whole robot to be seen."""
    height = robot.home_height - robot.base_height
    size = robot.base_radius + float(robot.crank_lengths.max()) + height
    # A robot that is slender for its platform needs room for the tool.
    size = max(size, 2.0 * (0.46 * height + 1.3 * robot.characteristic_length))
    target = np.array([0.0, 0.0, robot.base_height + 0.54 * height])
    direction = np.array([1.05, -0.80, 0.52])
    return target + 1.9 * size * direction / np.linalg.norm(direction), target
