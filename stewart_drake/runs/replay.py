"""The recording of a run for a browser."""

from __future__ import annotations

import base64
import html
import json
import re
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from stewart_drake.base.atomic_files import write_atomically
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.logs.log import SimulationLog, distinct_names
from stewart_drake.mechanics.kinematics import inverse_kinematics
from stewart_drake.plant.plant_options import DrakeOptions
from stewart_drake.runs.scene import link_poses, robot_scene

FRAMES_PER_SECOND, MAX_FRAMES = 30.0, 9000
"""A longer recording gets fewer frames a second: at some 0.5 kB a frame, a page stays small enough to be sent."""
MAX_POINTS = 3000
"""Of a trace."""
_STYLES = ("uPlot.min.css", "common.css", "replay.css")
_SCRIPTS = ("three.min.js", "uPlot.iife.min.js", "scene.js", "plots.js", "replay.js")


def write_replay(logs: SimulationLog | Sequence[SimulationLog], path: str | Path, places: Sequence[Any] = ()) -> None:
    """Writes the motion of one run or of several side by side as one HTML page that plays in any browser, offline.

    The page has play and pause, a time slider, speed and loop, and traces of errors and torques whose cursor follows.
    A green translucent disc shows where the reference wants the platform. Each frame is the row of the log nearest to
    it in time; between frames the browser interpolates. A page has about 0.6 MB, and 0.5 kB for each frame of a run.
    Runs of one scenario are called by their `places`, or numbered.
    """
    shown = [logs] if isinstance(logs, SimulationLog) else list(logs)
    runs = [_shown(log) for log in shown]
    for run, name in zip(runs, distinct_names(shown, places), strict=True):
        run["name"] = name
    # A text in a script element must not end it.
    data = json.dumps(runs).replace("<", "\\u003c")
    page = {"title": html.escape(", ".join(run["name"] for run in runs)), "data": data}
    page |= {"styles": "".join(map(_page_file, _STYLES))}
    page |= {"scripts": "</script>\n<script>".join(map(_page_file, _SCRIPTS))}
    text = re.sub(r"\{\{ (\w+) \}\}", lambda match: page[match[1]], _page_file("replay.html"))
    write_atomically(Path(path), text.encode())


def _page_file(name: str) -> str:
    return (files("stewart_drake") / "pages" / name).read_text(encoding="utf-8")


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
    links = _links(log, usable[rows])
    traced = usable[:: max(1, len(usable) // MAX_POINTS)]
    rotation, position = log.error_norms
    torque = log.signals.get("torque_applied", np.zeros((len(log.time), 0)))
    lines = [(f"{log.status} at {log.end_time:g} s", log.status != "completed")]
    lines += [(line, True) for line in ([] if log.message is None else log.message.splitlines())]
    lines += [(f"warning at {each['time']:.3f} s: {each['text']}", False) for each in log.warnings]
    return {
        "name": log.scenario.name,
        "scene": robot_scene(log.scenario.robot),
        "frames": (frames / rate).round(6).tolist(),
        "links": base64.b64encode(links.astype("<f4").tobytes()).decode(),
        "lines": lines,
        "time": _digits(log.time[traced]),
        "rotation_deg": _digits(rotation[traced]),
        "position_m": _digits(1e-3 * position[traced]),
        "torque": [_digits(column) for column in torque[traced].T],
    }


def _digits(values: np.ndarray) -> list[float | None]:
    return [float(f"{value:.5g}") if np.isfinite(value) else None for value in values]


def nearest_rows(time: np.ndarray, rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Frames (k,) at a rate [1/s] for which there is a row, by their number, and the row (k,) nearest to each.

    Rows are at times (n,) [s], ascending from 0 on; frames between sparser rows are left out.
    """
    frame = np.rint(time * rate).astype(int)
    order = np.lexsort((np.abs(time - frame / rate), frame))
    frames, first = np.unique(frame[order], return_index=True)
    return frames, order[first]


def _links(log: SimulationLog, rows: np.ndarray) -> np.ndarray:
    """`link_poses` (n, 14, 7) of rows (n,) of a log."""
    robot, pose, reference = log.scenario.robot, log["pose"][rows], log["reference"][rows]
    if "plant_state" not in log.signals:
        return link_poses(robot, pose, inverse_kinematics(robot, pose), reference)
    # What is not closed as it should be is drawn as it is, such as a rod that has broken.
    from stewart_drake.plant.multibody_plant import build_plant

    _, stewart = build_plant(robot, DrakeOptions(rod_joint=log.scenario.plant.rod_joint))
    state = log["plant_state"][rows]
    return link_poses(robot, pose, stewart.crank_angles(state), reference, stewart.rod_directions(state))
