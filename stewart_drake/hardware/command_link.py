"""The link from the controller to the motors: ticks that are dropped or late, commands that are corrupted; pure."""

from __future__ import annotations

import contextlib
import math
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import Field

from stewart_drake.errors import UnreachablePoseError
from stewart_drake.families import Table
from stewart_drake.hardware.faults import Fault, FaultKind
from stewart_drake.hardware.seeded import tick_uniform
from stewart_drake.mechanics.dynamics import static_torque
from stewart_drake.registry import COMMAND_FAULTS
from stewart_drake.robot import RobotParameters
from stewart_drake.sampling import Sampled
from stewart_drake.section import LegNumber, Natural, NotNegative, Positive, Real, Section, Seed, Share, Text

MEMORY_SIZE = 16
"""Command 6, its age, command under way 6, step at which that is due, its tick, tick of the command in force."""

_STREAM = 3


class Command(NamedTuple):
    """What a fault of a command finds: torque (6,) [N m], and the number of the tick."""

    torque: np.ndarray
    tick: int


def _nan(fault: Any, now: Command) -> None:
    now.torque[fault.channels] = math.nan


def _inf(fault: Any, now: Command) -> None:
    now.torque[fault.channels] = math.inf


def _offset(fault: Any, now: Command) -> None:
    now.torque[fault.channels] += fault.size


def _chatter(fault: Any, now: Command) -> None:
    now.torque[fault.channels] += fault.size * (-1.0) ** now.tick


NAN, INF, OFFSET, CHATTER = FaultKind(_nan), FaultKind(_inf), FaultKind(_offset), FaultKind(_chatter)


class CommandFault(Fault, key="link.faults"):
    """Commands that a broken controller would send."""

    kinds: ClassVar[Table] = COMMAND_FAULTS
    kind: Annotated[Text, COMMAND_FAULTS]
    """nan and inf in place of the torque; offset: `size` is added; chatter: `size` is added in one tick and
    subtracted in the next."""
    leg: LegNumber | None = None
    """0 to 5; null for all."""
    duration: Positive | None = None
    """[s] after which commands are correct again; null for never."""
    size: Real = 0.0
    """[N m] of offset and chatter."""


class LinkOptions(Section, key="link"):
    """What may happen to a command on its way; by default nothing does.

    A dropped tick's command never arrives and the last one holds. A late one arrives `late_steps` steps of the plant
    after its tick, unless a newer one came before. Where a tick is both, it is dropped.
    """

    drop_probability: Share = 0.0
    """[-] that a tick is dropped, 0 to 1."""
    dropped: tuple[Natural, ...] = ()
    """Ticks that are dropped in any case, whatever `drop_probability` is; tick k is at k controller.period."""
    stop_time: NotNegative | None = None
    """[s] from which on every tick is dropped: the controller hangs; null for never."""
    late_probability: Share = 0.0
    """[-] that a tick is late, 0 to 1."""
    late: tuple[Natural, ...] = ()
    """Ticks that are late in any case."""
    late_steps: Annotated[Natural, Field(ge=1, le=100_000)] = 1
    """Steps of the plant by which a late tick is late, at most one control period."""
    seed: Seed = 0
    """Of what is dropped and late; each tick has its own number, whatever came before."""
    faults: tuple[CommandFault, ...] = ()
    """Commands that are corrupted before they are sent."""

    @cached_property
    def perfect(self) -> bool:
        """Whether every command arrives at once, as it was sent."""
        chance = self.drop_probability or self.late_probability or self.dropped or self.late or self.faults
        return not chance and self.stop_time is None

    @cached_property
    def _listed(self) -> tuple[frozenset[int], frozenset[int]]:
        return frozenset(self.dropped), frozenset(self.late)

    def fate(self, tick: int, time: float) -> Literal["arrives", "dropped", "late"]:
        """What becomes of the command of a tick."""
        drop, late = tick_uniform(self.seed, _STREAM, tick, 2)
        stopped = self.stop_time is not None and time >= self.stop_time
        if stopped or tick in self._listed[0] or drop < self.drop_probability:
            return "dropped"
        return "late" if tick in self._listed[1] or late < self.late_probability else "arrives"


def link_step(
    options: LinkOptions, steps_per_tick: int, step: int, time: float, command: np.ndarray, memory: np.ndarray
) -> np.ndarray:
    """One step of the plant: what has arrived by then.

    Args:
        options: See `LinkOptions`.
        steps_per_tick: Steps of the plant in a control period.
        step: 0, 1, ...
        time: [s] of the step.
        command: (6,) [N m] that the controller says now.
        memory: (16,) of the step before, see `MEMORY_SIZE`; zeros before the first.

    Returns:
        (16,): first the command (6,) [N m] in force and its age [ticks], counted from the newest tick there was.
    """
    held, arriving = np.array(memory[:6]), np.array(memory[7:13])
    due, sent, arrived = memory[13:16]
    if due > 0.0 and step >= due:
        held, arrived, due = arriving, sent, 0.0
    tick, within = divmod(step, steps_per_tick)
    if within == 0:
        command = np.array(command, dtype=float)
        for fault in options.faults:
            fault.spoil(time, Command(command, tick))
        fate = options.fate(tick, time)
        if fate == "arrives":
            held, arrived, due = command, float(tick), 0.0
        elif fate == "late":
            arriving, sent, due = command, float(tick), float(step + options.late_steps)
    return np.concatenate([held, [tick - arrived], arriving, [due, sent, arrived]])


def command_link(options: LinkOptions, steps_per_tick: int, initial: np.ndarray) -> Sampled:
    """`link_step` as a part of a loop, of command (6,), time [s] and step; `initial` (6,) until the first arrives."""

    def tick(command: np.ndarray, time: float, step: int, memory: np.ndarray) -> np.ndarray:
        return link_step(options, steps_per_tick, step, time, command, memory)

    # Age 0 before the first: nothing is overdue at the start.
    return Sampled(np.concatenate([initial, np.zeros(10)]), tick)


def standing_torque(robot: RobotParameters, pose: np.ndarray, gravity: float) -> np.ndarray:
    """Torques (6,) [N m] that hold the robot, as believed, at a pose; zeros where it cannot stand there."""
    # In that case the first tick says so, with a log.
    with contextlib.suppress(UnreachablePoseError, np.linalg.LinAlgError):
        return static_torque(robot, pose, gravity)
    return np.zeros(6)
