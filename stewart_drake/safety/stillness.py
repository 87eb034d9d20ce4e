"""Cranks that stand while the reference moves: one leg over a second, or six readings that repeat themselves."""

from __future__ import annotations

from typing import Any

import numpy as np

from stewart_drake.base.jit import fields, new_record, njit, record
from stewart_drake.mechanics import kinematics_laws as laws
from stewart_drake.mechanics.linear_algebra import all_finite, copy_to
from stewart_drake.robot import RobotParameters

BLOCK, BLOCKS = 0.2, 5
"""[s] of a block of ticks, and blocks in a window. Of readings one more, newer, counts: a servo may be late by that."""
SHARE = 0.1
"""Of the travel of its reference that a crank must have."""
LEAST = 0.03
"""[rad] travel of a reference in a window from which on its crank must move."""
SLACK, TREMBLE = 0.015, 0.003
"""[rad] half width of a motion that is no travel. Of a reference: play and friction take it, of servos that are sold up
to 1 deg each. Of a reading: noise, and one count of 10 bits to and fro."""
REPEATED, FROZEN_AFTER = 6, 0.05
"""Ticks in a row of readings that all repeat to the last bit, at least half a block, and [rad] travel of the reference
meanwhile, with which they are frozen. Friction that nobody believed in held all six cranks for up to 0.037 rad."""
MOVING, STANDS, FROZEN = range(3)
NAMES = ("none", "not_moving", "reading_stuck")

STILL_PARAMS = fields(block=(), share=(), frozen=())
"""[ticks], share of the travel, [rad]; infinite, or 0 for the share, where it is off."""
STILLNESS = fields(
    watched=(), cosine=6, sine=6, seen=6, turned=6, led=(2, 6), travel=(2, BLOCKS + 1, 6), elapsed=(), ahead=(),
    moved=(), stands=(),
)  # fmt: skip
"""watched: whether there was a tick. cosine, sine: of the wanted angles. seen: angles read [rad]. turned: wanted, from
the first tick on [rad]. led: what wanted and read lead along within the slack [rad]. travel: of these in each block,
newest first [rad]. elapsed: ticks of this block. ahead, moved: since a reading has changed, travel of the reference
[rad], and ticks in which that moved at all. stands: 0, or 2 and the leg that stood in the last window, -1 for
all."""


@njit
def cranks_at(robot: Any, pose: Any, legs: Any, out: Any) -> None:
    """Angles (6,) [rad] of the cranks at a pose (6,); NaN out of reach."""
    reached = all_finite(pose) and laws.legs_at(robot, pose, legs) < 0
    for i in range(6):
        out[i] = np.arctan2(legs.sine[i], legs.cosine[i]) if reached else np.nan


@njit
def _lead(value: float, slack: float, led: Any, leg: int) -> float:
    """Leads something along at a distance of at most `slack`; how far it has gone."""
    before = led[leg]
    led[leg] = min(max(before, value - slack), value + slack)
    return abs(led[leg] - before)


@njit
def watch(robot: Any, params: Any, angles: Any, reference: Any, legs: Any, state: Any) -> tuple[int, int]:
    """A tick of angles read (6,) [rad] and the pose (6,) that is wanted; one without numbers is left out.

    Returns MOVING, STANDS or FROZEN, and the leg that stands, -1 for all of them.
    """
    if not (all_finite(angles) and all_finite(reference) and laws.legs_at(robot, reference, legs) < 0):
        return MOVING, -1
    if state.watched == 0.0:
        state.watched = 1.0
        copy_to(state.led[1], angles)
        copy_to(state.cosine[:], legs.cosine)
        copy_to(state.sine[:], legs.sine)
    repeats, moves, gone = True, False, 0.0
    for i in range(6):
        c, s, c_before, s_before = legs.cosine[i], legs.sine[i], state.cosine[i], state.sine[i]
        turned = np.arctan2(s * c_before - c * s_before, c * c_before + s * s_before)
        state.turned[i] += turned
        moves = moves or turned != 0.0
        wanted = _lead(state.turned[i], SLACK, state.led[0], i)
        state.travel[0, 0, i] += wanted
        state.travel[1, 0, i] += _lead(angles[i], TREMBLE, state.led[1], i)
        gone = max(gone, wanted)
        repeats = repeats and angles[i] == state.seen[i]
        state.cosine[i], state.sine[i], state.seen[i] = c, s, angles[i]
    state.ahead = state.ahead + gone if repeats else 0.0
    state.moved = state.moved + (1.0 if moves else 0.0) if repeats else 0.0
    if state.moved >= max(REPEATED, 0.5 * params.block) and state.ahead > params.frozen:
        return FROZEN, -1
    state.elapsed += 1.0
    if state.elapsed >= params.block:
        _end_block(params, state)
    return (MOVING, -1) if state.stands == 0.0 else (STANDS, int(state.stands) - 2)


@njit
def _end_block(params: Any, state: Any) -> None:
    """Notes the leg that stood in the window and lacks most, or all six; begins the next block."""
    most, leg, standing = 0.0, -1, 0
    for i in range(6):
        wanted, read = 0.0, state.travel[1, 0, i]
        for row in range(1, BLOCKS + 1):
            wanted += state.travel[0, row, i]
            read += state.travel[1, row, i]
        if wanted > LEAST and read < params.share * wanted:
            standing += 1
            # Of a tie the first on any processor.
            if wanted > 1.01 * most:
                most, leg = wanted, i
    for kind in range(2):
        for row in range(BLOCKS, 0, -1):
            copy_to(state.travel[kind, row], state.travel[kind, row - 1])
        for i in range(6):
            state.travel[kind, 0, i] = 0.0
    state.elapsed = 0.0
    state.stands = 0.0 if standing == 0 else 1.0 if standing == 6 else 2.0 + leg


@njit
def watch_rows(robot: Any, params: Any, angles: Any, references: Any, legs: Any, state: Any) -> tuple[int, int, int]:
    """`watch` of ticks (n, 6): the first that does not move, as MOVING, STANDS or FROZEN, its leg, and the row."""
    robot, params, legs, state = record(robot), record(params), record(legs), record(state)
    for row in range(len(angles)):
        kind, leg = watch(robot, params, angles[row], references[row], legs, state)
        if kind != MOVING:
            return kind, leg, row
    return MOVING, -1, -1


@njit
def _cranks_at(robot: Any, pose: Any, legs: Any, out: Any) -> None:
    cranks_at(record(robot), pose, record(legs), out)


def still_params(period: float, share: float | None = SHARE, frozen: float | None = FROZEN_AFTER) -> dict[str, float]:
    """The values of `STILL_PARAMS` for ticks of a period [s]; None is off."""
    block = max(1.0, round(BLOCK / period))
    return {"block": block, "share": share or 0.0, "frozen": np.inf if frozen is None else frozen}


class Stillness:
    """`watch`, tick by tick, where no safety layer does it.

    Attributes:
        latest: What stands, `not_moving` or `reading_stuck`, and its leg or None for all six; None where all is well.
    """

    def __init__(self, robot: RobotParameters, period: float) -> None:
        self._robot, self._params = laws.robot_record(robot), new_record(STILL_PARAMS, **still_params(period))
        self._legs, self._angles = laws.Legs.empty(), np.empty((1, 6))
        self.reset()

    def reset(self) -> None:
        """As before the first tick."""
        self._state = new_record(STILLNESS)
        self.latest: tuple[str, int | None] | None = None

    def look(self, readings: np.ndarray, reference: np.ndarray) -> None:
        """A tick: angles (6,) [rad], or a pose and its rate (12,), beside the pose that is wanted, (6,) or more."""
        self._angles[0] = readings[:6]
        if len(readings) == 12:
            _cranks_at(self._robot, readings[:6], self._legs, self._angles[0])
        kind, leg, _ = self.rows(self._angles, reference[None, :6])
        self.latest = None if kind == MOVING else (NAMES[kind], None if leg < 0 else int(leg))

    def rows(self, angles: np.ndarray, references: np.ndarray) -> tuple[int, int, int]:
        """`watch_rows` of ticks (n, 6)."""
        return watch_rows(self._robot, self._params, angles, references, self._legs, self._state)


def first_standstill(
    robot: RobotParameters, period: float, angles: np.ndarray, references: np.ndarray
) -> tuple[int, int | None] | None:
    """The first of ticks (n, 6) of angles [rad] and poses wanted in which a crank stands, and its leg; else None."""
    angles, references = (np.ascontiguousarray(rows, dtype=float) for rows in (angles, references))
    kind, leg, row = Stillness(robot, period).rows(angles, references)
    return None if kind == MOVING else (row, None if leg < 0 else int(leg))


def standstill_text(name: str, leg: int | None) -> str:
    """What stands, in words, and what to look at."""
    if name == NAMES[FROZEN]:
        return "all six readings repeat themselves while the motion goes on: are the motors on, and the encoders read?"
    if leg is None:
        return "no leg moves while the motion goes on: are the motors and their power on?"
    return f"leg {leg} does not move while its motion goes on: are its motor and its encoder on?"
