"""Compiled loops over poses, on all cores: what the public functions of `mechanics` and `planning` share.

A loop takes shared arguments first, then arrays of as many rows as there are poses, those that it fills last. It
returns `OK`, or at the first pose at which its law cannot go on another status.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from stewart_drake.errors import ConfigurationError, UnreachablePoseError
from stewart_drake.jit import njit, record
from stewart_drake.mechanics.kinematics_laws import LEGS, OK, legs_at, robot_record
from stewart_drake.robot import RobotParameters

CHUNK = 512
"""Poses that are worth a thread: starting one takes as long as some fifty."""

Loop = Callable[..., Any]
Robot = RobotParameters | np.ndarray
"""A robot, or its numbers as a `ROBOT` record (1,)."""


def over_rows(loop: Loop, shared: tuple[Any, ...], rows: tuple[np.ndarray, ...]) -> int:
    """Runs a loop over rows, in one chunk for each core where there are enough of them; the worst status."""

    def run(start: int, stop: int) -> int:
        with np.errstate(all="ignore"):  # of the same source uncompiled
            return loop(*shared, *(each[start:stop] for each in rows)) or OK

    count = len(rows[0])
    chunks = min(os.cpu_count() or 1, count // CHUNK)
    if chunks < 2:
        return run(0, count)
    edges = np.linspace(0, count, chunks + 1).astype(int).tolist()
    # A pool that lives as long as the call: threads do not survive a fork.
    with ThreadPoolExecutor(chunks) as pool:
        return max(pool.map(run, edges[:-1], edges[1:]))


def at_poses(
    loop: Loop, robot: Robot, inputs: Mapping[str, Any], tail: tuple[int, ...], *numbers: float, kind: Any = float
) -> Any:
    """Values (..., *tail) at poses with any leading axes.

    Args:
        loop: Called with the robot's record, the numbers, rows of the inputs, and rows to fill.
        robot: Whose.
        inputs: Name -> (..., 6); leading axes broadcast. `pose` is among them, and finite.
        tail: Shape of the value at one pose.
        numbers: Single numbers.
        kind: Type of the values.

    Raises:
        UnreachablePoseError: A rod cannot span; that of the worst leg of all poses.
        ConfigurationError: Inputs that are not (..., 6), or a pose that is not finite.
        numpy.linalg.LinAlgError: The law cannot go on at a singularity.
    """
    arrays = {name: np.asarray(value, dtype=float) for name, value in inputs.items()}
    for name, array in arrays.items():
        finite = name != "pose" or np.isfinite(array).all()
        if array.shape[-1:] != (6,) or not finite:
            wanted = "finite numbers" if name == "pose" else "numbers"
            raise ConfigurationError(name, inputs[name], f"{wanted} of shape (..., 6)")
    leading, rows = broadcast_rows(*arrays.values())
    made = np.empty((len(rows[0]), *tail), dtype=kind)
    robots = robot_records(robot)
    if over_rows(loop, (robots, *map(float, numbers)), (*rows, made)) != OK:
        _raise_if_unreachable(robots, rows[list(arrays).index("pose")])
        raise np.linalg.LinAlgError("Singular matrix: the pose is singular")
    return made.reshape((*leading, *tail))[()]


def broadcast_rows(*arrays: np.ndarray) -> tuple[tuple[int, ...], list[np.ndarray]]:
    """Leading axes that fit all arrays (..., k), and copies of these as rows (n, k)."""
    leading = np.broadcast_shapes(*(array.shape[:-1] for array in arrays))
    return leading, [
        np.array(np.broadcast_to(each, (*leading, each.shape[-1])), order="C").reshape(-1, each.shape[-1])
        for each in arrays
    ]


def robot_records(robot: Robot) -> np.ndarray:
    """The numbers of a robot, a `ROBOT` record that is not to be written to."""
    if isinstance(robot, RobotParameters):
        return robot_record(robot)
    seen = robot.view()
    seen.flags.writeable = False  # laws are compiled once for records of this kind
    return seen


@njit
def reaches(robots: Any, poses: Any, made: Any) -> int:
    """Loop of `LEGS.reach`."""
    robot, store = record(robots), np.empty(1, LEGS)
    for n in range(len(poses)):
        legs = record(store)
        legs_at(robot, poses[n], legs)
        for i in range(6):
            # So far off that squares leave floating point: beyond any reach.
            made[n, i] = -np.inf if np.isnan(legs.reach[i]) else legs.reach[i]
    return OK


def _raise_if_unreachable(robots: np.ndarray, poses: np.ndarray) -> None:
    reach = np.empty((len(poses), 6))
    over_rows(reaches, (robots,), (poses, reach))
    row, leg = np.unravel_index(int(reach.argmin()), reach.shape)
    if reach[row, leg] < 0.0:
        raise UnreachablePoseError(poses[row].copy(), int(leg), float(reach[row, leg]))
