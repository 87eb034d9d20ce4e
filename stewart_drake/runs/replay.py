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
from pydrake import geometry
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.framework import DiagramBuilder

from stewart_drake.errors import ConfigurationError, drake_guard
from stewart_drake.files.whole import write_atomically
from stewart_drake.logs.log import SimulationLog, distinct_names
from stewart_drake.logs.metrics import error_norms
from stewart_drake.plant.multibody_plant import add_plant
from stewart_drake.plant.plant_options import PlantOptions
from stewart_drake.plant.sdf_model import RodJoint
from stewart_drake.robot import RobotParameters
from stewart_drake.runs.pictures import viewpoint

FRAMES_PER_SECOND, MAX_FRAMES = 30.0, 9000
"""A longer recording gets fewer frames a second: at some 2 kB a frame, a browser opens no more than this with ease."""
MAX_POINTS = 3000
"""Of a trace."""
_LENS = 36.0
"""[deg] vertical field of view; Meshcat's own 75 deg would distort a robot so near."""


def write_replay(logs: SimulationLog | Sequence[SimulationLog], path: str | Path) -> None:
    """Writes the motion of one run or of several side by side as one HTML page that plays in any browser, offline.

    The page has play and pause, a time slider, speed and loop, and traces of errors and torques whose cursor follows.
    A green translucent disc shows where the reference wants the platform. Each frame is the row of the log nearest to
    it in time; between frames the browser interpolates. A page has about 2.5 MB a run and 2 kB for each frame.
    """
    shown = [logs] if isinstance(logs, SimulationLog) else list(logs)
    runs = [_shown(log) for log in shown]
    for run, name in zip(runs, distinct_names(shown), strict=True):
        run["name"] = name
    # A text in a script element must not end it.
    data = json.dumps(runs).replace("<", "\\u003c")
    page = {"title": html.escape(", ".join(run["name"] for run in runs)), "data": data}
    page |= {"styles": _page_file("uPlot.min.css") + _page_file("replay.css")}
    page |= {"plots": _page_file("uPlot.iife.min.js"), "script": _page_file("replay.js")}
    text = re.sub(r"\{\{ (\w+) \}\}", lambda match: page[match[1]], _page_file("replay.html"))
    write_atomically(Path(path), text.encode())


def _page_file(name: str) -> str:
    return (files("stewart_drake") / "pages" / name).read_text()


def _shown(log: SimulationLog) -> dict[str, Any]:
    """What the page shows of a run."""
    # Without a state of Drake's own the robot is assembled at the platform's pose.
    usable = np.flatnonzero(np.isfinite(log.signals.get("plant_state", log["pose"])).all(axis=1))
    if len(usable) == 0:
        allowed = "a log with at least one row of finite state to replay"
        raise ConfigurationError("log", f"{len(log.time)} rows", allowed)
    time = log.time[usable]
    rate = min(FRAMES_PER_SECOND, (MAX_FRAMES - 1) / time[-1]) if time[-1] > 0.0 else FRAMES_PER_SECOND
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
    """Frames (k,) at a rate [1/s] for which there is a row, by their number, and the row (k,) nearest to each.

    Rows are at times (n,) [s], ascending from 0 on; frames between sparser rows are left out.
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
    """A robot, the plant `stewart`, and its reference in a Meshcat that only this machine can open."""

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
        meshcat.SetCamera(geometry.Meshcat.PerspectiveCamera(fov=_LENS))
        meshcat.SetCameraPose(*viewpoint(robot))
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
