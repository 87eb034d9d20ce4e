"""Moves of Reachy Mini: recordings in the manufacturer's JSON format, and dances of the manufacturer's library."""

from __future__ import annotations

import importlib.util
import json
import math
import sys
import types
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from stewart_drake.base.atomic_files import read_checked
from stewart_drake.base.config import choices_text
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.sampling import unwrapped

HEAD_HEIGHT = 0.177  # [m] The robot's frame for poses of the head is this high above the base frame B.
MOST_TURN, MOST_BODY = math.radians(65.0), math.radians(160.0)
"""[rad] largest yaw of the head relative to the body, and of the body; the robot's software turns the body beyond."""
DANCES = "reachy_mini_dances_library==0.2.1"
TEMPO = 114.0  # [beats/min] of a dance.
STEP = 0.01  # [s] between rows of dances and changed moves.
MAX_BYTES = 100_000_000
LONGEST = 600.0  # [s] of a recorded move.
ASKED = "a move of Reachy Mini: `time` and `set_target_data`, a list of head (4x4), antennas (2) and body_yaw"


class Move(NamedTuple):
    """A move in n rows: pose of the head on the body, antennas, yaw of the body."""

    description: str
    time: np.ndarray  # (n,) [s], not going back: stamps may be equal.
    pose: np.ndarray  # (n, 6) [rad, m] of P in the base frame B, which turns with the body.
    antennas: np.ndarray  # (n, 2) [rad].
    body_yaw: np.ndarray  # (n,) [rad].

    def at(self, time: np.ndarray) -> Move:
        """The move at other times (m,), linearly interpolated."""
        columns = np.column_stack([self.pose, self.antennas, self.body_yaw]).T
        rows = np.column_stack([np.interp(time, self.time, column) for column in columns])
        return Move(self.description, time, rows[:, :6], rows[:, 6:8], rows[:, 8])


def pose_of_head(head: np.ndarray, yaw: float | np.ndarray) -> np.ndarray:
    """Pose (..., 6) [rad, m] of P in B from the head's (..., 4, 4) in the world and the yaw (...) of the body."""
    x, y, z = np.moveaxis(head[..., :3, 3], -1, 0)
    turn = np.arctan2(head[..., 1, 0], head[..., 0, 0]) - yaw
    pitch, roll = np.arcsin(np.clip(-head[..., 2, 0], -1.0, 1.0)), np.arctan2(head[..., 2, 1], head[..., 2, 2])
    cosine, sine = np.cos(yaw), np.sin(yaw)
    parts = roll, pitch, np.remainder(turn + math.pi, math.tau) - math.pi, cosine * x + sine * y, cosine * y - sine * x
    return np.stack([*parts, z + HEAD_HEIGHT], axis=-1)


def head_of_pose(pose: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    """The inverse (n, 4, 4) of `pose_of_head`, of poses (n, 6) and yaws (n,)."""
    from scipy.spatial.transform import Rotation

    head, cosine, sine = np.tile(np.eye(4), (len(pose), 1, 1)), np.cos(yaw), np.sin(yaw)
    head[:, :3, :3] = Rotation.from_euler("xyz", pose[:, :3] + np.outer(yaw, [0.0, 0.0, 1.0])).as_matrix()
    x, y, z = pose[:, 3:].T
    head[:, :3, 3] = np.stack([cosine * x - sine * y, sine * x + cosine * y, z - HEAD_HEIGHT], axis=-1)
    return head


def read_move(path: str | Path) -> Move:
    """A recorded move; where the head would turn too far on its body, that turns, as the robot's software lets it."""
    key = f"move {path}"
    content = read_checked(path, key, MAX_BYTES)
    try:
        data = json.loads(content)
        rows = [(row["head"], row["antennas"], row.get("body_yaw", 0.0)) for row in data["set_target_data"]]
        time = np.array(data["time"], dtype=float).reshape(len(rows))
        head, antennas = (np.array([row[place] for row in rows], dtype=float) for place in (0, 1))
        head, antennas = head.reshape(len(rows), 4, 4), antennas.reshape(len(rows), 2)
        yaw = np.array([row[2] for row in rows], dtype=float).reshape(len(rows))
        about = str(data.get("description", ""))
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise ConfigurationError(key, " ".join(f"{type(error).__name__}: {error}".split())[:200], ASKED) from None
    columns = {"time": time, "head": head, "antennas": antennas, "body_yaw": yaw}
    for name, values in columns.items():
        if (wrong := ~np.isfinite(values.reshape(len(rows), math.prod(values.shape[1:]))).all(axis=1)).any():
            raise ConfigurationError(key, f"others in {_place(name, wrong)}", "finite numbers")
    skew = np.abs(np.swapaxes(head[:, :3, :3], 1, 2) @ head[:, :3, :3] - np.eye(3)).max(axis=(1, 2), initial=0.0)
    if (skew > 0.02).any():
        got = f"another matrix in {_place('head', skew > 0.02)}"
        raise ConfigurationError(key, got, "heads that are turned by a rotation")
    if (back := np.diff(time, prepend=-math.inf) < 0.0).any():
        row = int(back.argmax())
        raise ConfigurationError(key, f"{time[row]:g} s after {time[row - 1]:g} s in time[{row}]", "times that ascend")
    if (count := len(np.unique(time))) < 4:
        raise ConfigurationError(key, f"{count} rows", "at least 4 rows, each at a time of its own")
    if (seconds := time[-1] - time[0]) > LONGEST:
        raise ConfigurationError(key, f"{seconds:g} s", f"a move of at most {LONGEST:g} s, with `time` in seconds")
    turn = np.unwrap(np.arctan2(head[:, 1, 0], head[:, 0, 0]))
    yaw = np.clip(np.clip(yaw, turn - MOST_TURN, turn + MOST_TURN), -MOST_BODY, MOST_BODY)
    pose = pose_of_head(head, yaw)
    pose[:, :3] = unwrapped(pose[:, :3])
    return Move(about, time, pose, antennas, yaw)


def read_rows(path: Path) -> np.ndarray:
    """The head in a recorded move, (n, 7) [s, rad, m]."""
    move = read_move(path)
    return np.column_stack([move.time, move.pose])


def _place(name: str, wrong: np.ndarray) -> str:
    """Path in the file of the first value of a column that is marked in `wrong` (n,)."""
    row = int(wrong.argmax())
    return f"time[{row}]" if name == "time" else f"set_target_data[{row}].{name}"


def move_json(move: Move) -> bytes:
    """A move as the maker's player reads it."""
    heads = head_of_pose(move.pose, move.body_yaw).tolist()
    rows = [
        {"head": head, "antennas": antennas, "body_yaw": yaw, "check_collision": False}
        for head, antennas, yaw in zip(heads, move.antennas.tolist(), move.body_yaw.tolist(), strict=True)
    ]
    data = {"description": move.description, "time": move.time.tolist(), "set_target_data": rows}
    return json.dumps(data, allow_nan=False).encode()


def dances() -> Any:
    """Name -> function of the time in beats, its keywords, and facts, of all dances in the maker's library."""
    spec = importlib.util.find_spec(DANCES.partition("=")[0])
    if spec is None:
        allowed = f"an installed package for a dance of Reachy Mini; pip install --no-deps {DANCES}"
        raise ConfigurationError("reference", DANCES, allowed)
    # Under another name, as its own `__init__` imports all of the robot's software.
    package = sys.modules.setdefault("reachy_mini_dances", types.ModuleType("reachy_mini_dances"))
    package.__path__ = list(spec.submodule_search_locations or [])
    return importlib.import_module("reachy_mini_dances.collection.dance").AVAILABLE_MOVES


def dance(name: str) -> Move:
    """A dance once, as `play_on` plays it."""
    known = dances()
    if name not in known:
        raise ConfigurationError("dance", name, choices_text(name, list(known)))
    function, keywords, facts = known[name]
    time = np.arange(0.0, facts["default_duration_beats"] * 60.0 / TEMPO, STEP)
    made = [function(now * TEMPO / 60.0, **keywords) for now in time.tolist()]
    pose = np.array([[*each.orientation_offset, *each.position_offset] for each in made], dtype=float)
    pose[:, 5] += HEAD_HEIGHT
    antennas = np.array([each.antennas_offset for each in made], dtype=float)
    return Move(str(facts.get("description", name)), time, pose, antennas, np.zeros(len(time)))


def files_of(source: str) -> list[Path]:
    """Files of the moves that a source names; none if they are dances of the manufacturer."""
    if source == "dances" or source.startswith("dance:"):
        return []
    path = Path(source)
    if not path.exists() and path.suffix != ".json":
        raise ConfigurationError("move", source, f"FILE.json, a folder, or for a dance dance:{source}")
    files = sorted(path.glob("*.json")) if path.is_dir() else [path]
    if not files:
        raise ConfigurationError("move", source, "a folder with files that end in .json")
    return files


def moves_of(source: str, bad: dict[str, ConfigurationError] | None = None) -> dict[str, Move]:
    """Moves by name: of a file, of a folder's files, `dance:NAME`, or all `dances`.

    Where `bad` is given it gets what is wrong with a folder's files that are no moves; without it they are refused.
    """
    files, found = files_of(source), {}
    if not files:
        return {name: dance(name) for name in (dances() if source == "dances" else [source.removeprefix("dance:")])}
    for file in files:
        try:
            found[file.stem] = read_move(file)
        except ConfigurationError as error:
            if bad is None or not Path(source).is_dir():
                raise
            bad[file.stem] = error
    return found
