"""The way of a command to the motors: a constant delay; ticks that are dropped or late, commands that are corrupted."""

from __future__ import annotations

import contextlib
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from stewart_drake.config import Natural, NotNegative, Section, Seed, Share
from stewart_drake.errors import UnreachablePoseError
from stewart_drake.hardware.faults import CommandFault, Signal, tick_numbers
from stewart_drake.jit import fields, new_record
from stewart_drake.mechanics.dynamics import static_torque
from stewart_drake.part import Part
from stewart_drake.robot import RobotParameters

_STREAM = 3


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

    def fate(self, tick: int, time: float) -> Literal["arrives", "dropped", "late"]:
        """What becomes of the command of a tick."""
        drop, late = tick_numbers(self.seed, _STREAM, tick, 2, normal=False)
        stopped = self.stop_time is not None and time >= self.stop_time
        if stopped or tick in self.dropped or drop < self.drop_probability:
            return "dropped"
        return "late" if tick in self.late or late < self.late_probability else "arrives"


LINK_STATE = fields(torque=6, age=(1,), steps=(), arriving=6, due=(), sent=(), arrived=())
"""torque: in force [N m]. age: of it, counted from the newest tick there was [ticks]. steps: done. arriving: under way
[N m]. due: step at which that arrives, 0 for none. sent: its tick. arrived: tick of the command in force."""


def link_part(options: LinkOptions, steps_per_tick: int, initial: np.ndarray) -> Part:
    """What has arrived by each step of the plant: `torque` (6,) [N m] and `time` (1,) [s] -> `torque`, `age`.

    `initial` (6,) [N m] stands until the first command arrives.
    """

    def tick(torque: np.ndarray, time: np.ndarray, state: np.ndarray) -> None:
        now: Any = state[0]
        step = int(now["steps"])
        if now["due"] > 0.0 and step >= now["due"]:
            now["torque"], now["arrived"], now["due"] = now["arriving"], now["sent"], 0.0
        number, within = divmod(step, steps_per_tick)
        if within == 0:
            signal = Signal(np.array(torque, dtype=float), float(time[0]), number)
            for fault in options.faults:
                fault.spoil(signal)
            fate = options.fate(number, signal.time)
            if fate == "arrives":
                now["torque"], now["arrived"], now["due"] = signal.says, number, 0.0
            elif fate == "late":
                now["arriving"], now["sent"], now["due"] = signal.says, number, step + options.late_steps
        now["age"], now["steps"] = number - now["arrived"], step + 1

    first = new_record(LINK_STATE, torque=initial)
    return Part("link", {"torque": 6, "time": 1}, ("torque", "age"), first, tick, every_step=True)


def delay_part(ticks: int, initial: np.ndarray) -> Part:
    """A constant delay of commands: `torque` (6,) [N m] -> that of so many ticks ago, and `initial` (6,) until then."""
    first = new_record(fields(torque=6, under_way=(ticks, 6)), torque=initial, under_way=initial)

    def tick(torque: np.ndarray, state: np.ndarray) -> None:
        state["torque"][0], under_way = state["under_way"][0, 0], state["under_way"][0]
        under_way[:-1] = under_way[1:]
        under_way[-1] = torque

    return Part("command_delay", {"torque": 6}, ("torque",), first, tick)


def standing_torque(robot: RobotParameters, pose: np.ndarray, gravity: float) -> np.ndarray:
    """Torques (6,) [N m] that hold the robot, as believed, at a pose; zeros where it cannot stand there."""
    # In that case the first tick says so, with a log.
    with contextlib.suppress(UnreachablePoseError, np.linalg.LinAlgError):
        return static_torque(robot, pose, gravity)
    return np.zeros(6)
