"""Replay of runs as an HTML page."""

from __future__ import annotations

import base64
import html
import json
import re
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

import numpy as np

from stewart_drake.base.atomic_files import write_atomically
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.logs.log import SimulationLog, distinct_names
from stewart_drake.mechanics.kinematics import inverse_kinematics, rotation_matrix
from stewart_drake.plant.plant_options import DrakeOptions
from stewart_drake.runs.scene import ball_links, link_poses, on_base, robot_scene

FRAME_RATE = 30.0  # [1/s]
MAX_FRAMES = 9000  # Longer runs get a lower frame rate, so that a page stays small: a frame takes 0.5 kB.
MAX_POINTS = 3000  # Largest number of points of a trace.
_STYLES = ("uPlot.min.css", "common.css", "replay.css")
_SCRIPTS = ("three.min.js", "uPlot.iife.min.js", "scene.js", "plots.js", "replay.js")


def write_replay(
    logs: SimulationLog | Sequence[SimulationLog], path: str | Path, places: Sequence[object] = ()
) -> None:
    """Writes one run, or several side by side, as one HTML page that plays in any browser, offline.

    The page has play and pause, a time slider, speed and loop, and traces of errors and torques with a cursor. A green
    translucent disc shows the reference pose of the platform. A frame is the row of the log nearest in time; between
    frames the browser interpolates. A page has about 0.6 MB, and 0.5 kB per frame. Runs of one scenario are named by
    their `places`, or numbered.
    """
    logs = [logs] if isinstance(logs, SimulationLog) else list(logs)
    names = distinct_names(logs, places)
    runs = [_replay_data(log, name) for log, name in zip(logs, names, strict=True)]
    # "</script>" in a text must not end the script element.
    data = json.dumps(runs).replace("<", "\\u003c")
    page = {"title": html.escape(", ".join(names)), "data": data}
    page |= {"styles": "".join(map(_page_file, _STYLES))}
    page |= {"scripts": "</script>\n<script>".join(map(_page_file, _SCRIPTS))}
    text = re.sub(r"\{\{ (\w+) \}\}", lambda match: page[match[1]], _page_file("replay.html"))
    write_atomically(Path(path), text.encode())


def _page_file(name: str) -> str:
    return (files("stewart_drake") / "pages" / name).read_text(encoding="utf-8")


def _replay_data(log: SimulationLog, name: str) -> dict[str, object]:
    """Data of a run for the page: links as float32 in base64, traces with five digits."""
    # Without Drake's state the links follow from the platform's pose.
    usable = np.flatnonzero(np.isfinite(log.signals.get("plant_state", log["pose"])).all(axis=1))
    if len(usable) == 0:
        allowed = "a log with at least one row of finite state to replay"
        raise ConfigurationError("log", f"{len(log.time)} rows", allowed)
    time = log.time[usable]
    rate = min(FRAME_RATE, (MAX_FRAMES - 1) / time[-1]) if time[-1] > 0.0 else FRAME_RATE
    frames, rows = nearest_rows(time, rate)
    links, base = _link_poses(log, usable[rows]), log.scenario.base
    ball = log.scenario.ball if "ball" in log.signals else None
    control = log.scenario.ball_control
    scene, away = robot_scene(log.scenario.robot, ball=ball, balanced=control is not None), None
    if ball is not None:
        target = np.zeros((len(log.time), 2)) if control is None else control.target.evaluate(log.time)[:, :2]
        shown, away = usable[rows], np.linalg.norm(log["ball"] - target, axis=1)
        rolling = ball_links(ball, log["pose"][shown], log["ball"][shown], target[shown])
        links = np.concatenate([links[:, :-1], rolling, links[:, -1:]], axis=1)
    if any(base.orientation) or base.motion is not None:
        motion = log["base_motion"][usable[rows], 9:] if "base_motion" in log.signals else np.zeros((len(rows), 3))
        scene, links = on_base(scene, links, rotation_matrix(np.array(base.orientation)) @ rotation_matrix(motion))
    points = usable[:: max(1, len(usable) // MAX_POINTS)]
    rotation, position = log.error_norms
    torque = log.signals.get("torque_applied", np.zeros((len(log.time), 0)))
    lines = [(f"{log.status} at {log.end_time:g} s", log.status != "completed")]
    lines += [(line, True) for line in ([] if log.message is None else log.message.splitlines())]
    lines += [(f"warning at {warning['time']:.3f} s: {warning['text']}", False) for warning in log.warnings]
    return {
        "name": name,
        "scene": scene,
        "frames": (frames / rate).round(6).tolist(),
        "links": base64.b64encode(links.astype("<f4").tobytes()).decode(),
        "lines": lines,
        "time": _rounded(log.time[points]),
        "rotation_deg": _rounded(rotation[points]),
        "position_m": _rounded(1e-3 * position[points]),
        "ball_m": None if away is None else _rounded(away[points]),
        "torque": [_rounded(column) for column in torque[points].T],
    }


def _rounded(values: np.ndarray) -> list[float | None]:
    return [float(f"{value:.5g}") if np.isfinite(value) else None for value in values]


def nearest_rows(time: np.ndarray, rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Numbers (k,) of the frames at a rate [1/s], and their nearest rows (k,) among rows at times (n,) [s].

    Times ascend from 0. Frames without a row nearest to them are left out.
    """
    frame = np.rint(time * rate).astype(int)
    order = np.lexsort((np.abs(time - frame / rate), frame))
    frames, first = np.unique(frame[order], return_index=True)
    return frames, order[first]


def _link_poses(log: SimulationLog, rows: np.ndarray) -> np.ndarray:
    """`link_poses` (n, 14, 7) at rows (n,) of a log."""
    robot, pose, reference = log.scenario.robot, log["pose"][rows], log["reference"][rows]
    if "plant_state" not in log.signals:
        return link_poses(robot, pose, inverse_kinematics(robot, pose), reference)
    # The simulated state shows open loops too, such as a broken rod.
    from stewart_drake.plant.multibody_plant import build_plant

    _, stewart = build_plant(robot, DrakeOptions(rod_joint=log.scenario.plant.rod_joint), ball=log.scenario.ball)
    state = log["plant_state"][rows]
    return link_poses(robot, pose, stewart.crank_angles(state), reference, stewart.rod_directions(state))
