"""Detects cranks that do not move while the reference does: one leg over a second, or six readings that repeat."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from stewart_drake.base.jit import njit
from stewart_drake.base.records import Matrix, Record, Vec6, record
from stewart_drake.mechanics import kinematics_laws as laws
from stewart_drake.mechanics.kinematics_laws import Legs, Robot
from stewart_drake.mechanics.linear_algebra import all_finite, copy_to
from stewart_drake.robot import RobotParameters

BLOCK, BLOCKS = 0.2, 5
"""[s] length of a block of ticks, and number of blocks in a window. Readings may be later than the reference by one
block."""
TRAVEL_SHARE = 0.1
"""Share of the travel of its reference that a crank must have."""
LEAST_TRAVEL = 0.03
"""[rad] travel of a reference in a window above which its crank must move."""
REFERENCE_PLAY, READING_PLAY = 0.015, 0.003
"""[rad] half width of a motion that does not count as travel. Reference: play and friction, up to 1 deg each in servos
that are sold. Reading: noise, and one count of 10 bits to and fro."""
LEAST_REPEATS, FROZEN_AFTER = 6, 0.05
"""Readings are frozen after so many ticks in a row, at least half a block, in which all six repeat to the last bit, and
so much travel of the reference [rad]. Friction that was not in the model held all six cranks for up to 0.037 rad."""
MOVING, STANDING, FROZEN = range(3)
NAMES = ("none", "not_moving", "reading_stuck")
Travel = Annotated[np.ndarray, (BLOCKS + 1, 6)]


class StillParams(Record):
    """Parameters of the detection."""

    block: float  # [ticks]
    share: float  # Share of the travel that a crank must have; 0 switches this off.
    frozen: float  # [rad] travel of the reference after which readings are frozen; infinite switches this off.


class StillState(Record):
    """State of the detection."""

    started: float  # 1 after the first tick.
    cosine: Vec6  # Cosines of the reference's crank angles.
    sine: Vec6
    angles: Vec6  # [rad] read last.
    reference: Vec6  # [rad] turned by the reference since the first tick.
    turn: Vec6  # [rad] of that in the last tick.
    dragged_reference: Vec6  # [rad] the same with play.
    dragged_angles: Vec6  # [rad] readings with play.
    reference_travel: Travel  # [rad] of the dragged reference in a block, newest first.
    angle_travel: Travel  # [rad] of the dragged readings.
    elapsed: float  # Ticks of the present block.
    repeat_travel: float  # [rad] of the reference since a reading has changed.
    repeats: float  # Ticks since then in which the reference moved.
    standing: float  # 0, or 2 and the leg that did not move in the last window, 1 for all legs.


@njit
def cranks_at(robot: Robot, pose: Vec6, legs: Legs, out: Vec6) -> None:
    """Angles (6,) [rad] of the cranks at a pose (6,); NaN out of reach."""
    reached = all_finite(pose) and laws.legs_at(robot, pose, legs) < 0
    for i in range(6):
        out[i] = np.arctan2(legs.sine[i], legs.cosine[i]) if reached else np.nan


@njit
def _drag(value: float, play: float, dragged: Vec6, leg: int) -> float:
    """Moves a number with play behind a value, as a backlash does; how far it has moved."""
    before = dragged[leg]
    dragged[leg] = min(max(before, value - play), value + play)
    return abs(dragged[leg] - before)


@njit
def watch(
    robot: Robot, params: StillParams, angles: Vec6, reference: Vec6, legs: Legs, state: StillState
) -> tuple[int, int]:
    """A tick with angles read [rad] and the pose of the reference; one with numbers that are not finite is left out.

    Returns:
        MOVING, STANDING or FROZEN, and the leg that does not move, -1 for all legs.
    """
    if not (all_finite(angles) and all_finite(reference) and laws.legs_at(robot, reference, legs) < 0):
        return MOVING, -1
    if state.started == 0.0:
        state.started = 1.0
        copy_to(state.dragged_angles[:], angles)
        copy_to(state.cosine[:], legs.cosine)
        copy_to(state.sine[:], legs.sine)
    repeats, moves, largest = True, False, 0.0
    for i in range(6):
        c, s, c_before, s_before = legs.cosine[i], legs.sine[i], state.cosine[i], state.sine[i]
        turn = np.arctan2(s * c_before - c * s_before, c * c_before + s * s_before)
        state.reference[i] += turn
        state.turn[i] = turn
        moves = moves or turn != 0.0
        travel = _drag(state.reference[i], REFERENCE_PLAY, state.dragged_reference[:], i)
        state.reference_travel[0, i] += travel
        state.angle_travel[0, i] += _drag(angles[i], READING_PLAY, state.dragged_angles[:], i)
        largest = max(largest, travel)
        repeats = repeats and angles[i] == state.angles[i]
        state.cosine[i], state.sine[i], state.angles[i] = c, s, angles[i]
    state.repeat_travel = state.repeat_travel + largest if repeats else 0.0
    state.repeats = state.repeats + (1.0 if moves else 0.0) if repeats else 0.0
    if state.repeats >= max(LEAST_REPEATS, 0.5 * params.block) and state.repeat_travel > params.frozen:
        return FROZEN, -1
    state.elapsed += 1.0
    if state.elapsed >= params.block:
        _end_block(params, state)
    if state.standing == 0.0:
        return MOVING, -1
    return STANDING, int(state.standing) - 2


@njit
def _end_block(params: StillParams, state: StillState) -> None:
    """Finds the leg that did not move in the window and should have most, or all six; begins the next block."""
    most, leg, count = 0.0, -1, 0
    for i in range(6):
        wanted, read = 0.0, state.angle_travel[0, i]
        for row in range(1, BLOCKS + 1):
            wanted += state.reference_travel[row, i]
            read += state.angle_travel[row, i]
        if wanted > LEAST_TRAVEL and read < params.share * wanted:
            count += 1
            # Between equal legs the first one is chosen, on any processor.
            if wanted > 1.01 * most:
                most, leg = wanted, i
    for row in range(BLOCKS, 0, -1):
        copy_to(state.reference_travel[row], state.reference_travel[row - 1])
        copy_to(state.angle_travel[row], state.angle_travel[row - 1])
    for i in range(6):
        state.reference_travel[0, i] = state.angle_travel[0, i] = 0.0
    state.elapsed = 0.0
    state.standing = 0.0 if count == 0 else 1.0 if count == 6 else 2.0 + leg


@njit
def watch_rows(
    robot: Robot, params: StillParams, angles: Matrix, references: Matrix, legs: Legs, state: StillState
) -> tuple[int, int, int]:
    """`watch` of ticks (n, 6) up to the first that is not MOVING: its result, the leg, and the row."""
    robot, params, legs, state = record(robot), record(params), record(legs), record(state)
    for row in range(len(angles)):
        kind, leg = watch(robot, params, angles[row], references[row], legs, state)
        if kind != MOVING:
            return kind, leg, row
    return MOVING, -1, -1


@njit
def _cranks_at(robot: Robot, pose: Vec6, legs: Legs, out: Vec6) -> None:
    cranks_at(record(robot), pose, record(legs), out)


def still_params(period: float, share: float | None = TRAVEL_SHARE, frozen: float | None = FROZEN_AFTER) -> StillParams:
    """Parameters for ticks of a period [s]; None is off."""
    block = max(1.0, round(BLOCK / period))
    return StillParams.new(block=block, share=share or 0.0, frozen=np.inf if frozen is None else frozen)


class Stillness:
    """`watch`, tick by tick, for loops without a safety layer.

    Attributes:
        latest: `not_moving` or `reading_stuck`, and the leg or None for all six; None where all is well.
    """

    def __init__(self, robot: RobotParameters, period: float) -> None:
        self._robot, self._params = laws.robot_record(robot), still_params(period)
        self._legs, self._angles = laws.Legs.empty(), np.empty((1, 6))
        self.reset()

    def reset(self) -> None:
        """As before the first tick."""
        self._state = StillState.new()
        self.latest: tuple[str, int | None] | None = None

    def look(self, readings: np.ndarray, reference: np.ndarray) -> None:
        """A tick: angles (6,) [rad], or pose and rate (12,); reference (6,) or more, its pose first."""
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
    """First of ticks (n, 6) of angles [rad] and reference poses in which a crank does not move, and its leg."""
    angles, references = (np.ascontiguousarray(rows, dtype=float) for rows in (angles, references))
    kind, leg, row = Stillness(robot, period).rows(angles, references)
    return None if kind == MOVING else (row, None if leg < 0 else int(leg))


def standstill_text(name: str, leg: int | None) -> str:
    """What does not move, in words, and what to check."""
    if name == NAMES[FROZEN]:
        return "all six readings repeat themselves while the motion goes on: are the motors on, and the encoders read?"
    if leg is None:
        return "no leg moves while the motion goes on: are the motors and their power on?"
    return f"leg {leg} does not move while its motion goes on: are its motor and its encoder on?"
