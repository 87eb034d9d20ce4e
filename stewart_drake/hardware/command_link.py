"""The way of a command from the controller to the motors: ticks that are dropped or late, commands spoilt; pure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Literal

import numpy as np

from stewart_drake.errors import ConfigurationError
from stewart_drake.hardware.seeded import tick_uniform
from stewart_drake.section import (
    SECTION,
    Count,
    Leg,
    Natural,
    NotNegative,
    Positive,
    Real,
    Share,
    check_choice,
    check_leg,
    check_positive,
    check_real,
    check_seed,
    check_whole,
)

CommandFaultKind = Literal["nan", "inf", "offset", "chatter"]

MEMORY_SIZE = 16
"""Command 6, its age, command under way 6, step at which that is due, its tick, tick of the command in force."""

_STREAM = 3


@dataclass(frozen=True, kw_only=True)
class CommandFault:
    """Commands that a broken controller would send.

    Raises:
        ConfigurationError: A value outside what the field says.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = SECTION

    kind: CommandFaultKind
    """nan and inf in place of the torque; offset: `size` more; chatter: `size` more and less in turn, tick by tick."""
    leg: Leg | None = None
    """0 to 5; null for all."""
    time: NotNegative = 0.0
    """[s] when it begins."""
    duration: Positive | None = None
    """[s] after which commands are well again; null for never."""
    size: Real = 0.0
    """[N m] of offset and chatter."""

    def __post_init__(self) -> None:
        check_choice("link.faults.kind", self.kind, "nan", "inf", "offset", "chatter")
        if self.leg is not None:
            check_leg("link.faults.leg", self.leg)
        check_real("link.faults.time", self.time)
        if self.duration is not None:
            check_positive("link.faults.duration", self.duration, allowed="a positive number [s], or null")
        check_real("link.faults.size", self.size, -math.inf, "a finite number [N m]")

    def spoil(self, command: np.ndarray, tick: int, time: float) -> None:
        """Changes a command (6,) [N m] in place, where it is time."""
        if not self.time <= time < self.time + (math.inf if self.duration is None else self.duration):
            return
        where = slice(None) if self.leg is None else slice(self.leg, self.leg + 1)
        if self.kind == "offset":
            command[where] += self.size
        elif self.kind == "chatter":
            command[where] += self.size * (-1.0) ** tick
        else:
            command[where] = math.nan if self.kind == "nan" else math.inf


@dataclass(frozen=True, kw_only=True)
class LinkOptions:
    """What may happen to a command on its way; by default nothing does.

    A dropped tick's command never arrives and the last one holds. A late one arrives `late_steps` steps of the plant
    after its tick, unless a newer one came before. Where a tick is both, it is dropped.

    Raises:
        ConfigurationError: A value outside what the field says.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = SECTION

    drop_probability: Share = 0.0
    """[-] of each tick, 0 to 1."""
    dropped: tuple[Count, ...] = ()
    """Ticks that are dropped whatever the chance; tick k is at k controller.period."""
    stop_time: NotNegative | None = None
    """[s] from which on every tick is dropped: the controller hangs; null for never."""
    late_probability: Share = 0.0
    """[-] of each tick, 0 to 1."""
    late: tuple[Count, ...] = ()
    """Ticks that are late whatever the chance."""
    late_steps: Natural = 1
    """Steps of the plant by which a late tick is late, at most one control period."""
    seed: Natural = 0
    """Of what is dropped and late; each tick has its own number, whatever came before."""
    faults: tuple[CommandFault, ...] = ()
    """Commands spoilt before they are sent."""

    def __post_init__(self) -> None:
        for name in ("drop_probability", "late_probability"):
            check_real(f"link.{name}", getattr(self, name), 0.0, "a number from 0 to 1", 1.0)
        for name in ("dropped", "late"):
            ticks = getattr(self, name)
            if not all(type(tick) is int and tick >= 0 for tick in ticks):
                raise ConfigurationError(f"link.{name}", ticks, "numbers of ticks: whole, zero or positive")
        if self.stop_time is not None:
            check_real("link.stop_time", self.stop_time)
        check_whole("link.late_steps", self.late_steps, 1, 100_000)
        check_seed("link.seed", self.seed)

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
            fault.spoil(command, tick, time)
        fate = options.fate(tick, time)
        if fate == "arrives":
            held, arrived, due = command, float(tick), 0.0
        elif fate == "late":
            arriving, sent, due = command, float(tick), float(step + options.late_steps)
    return np.concatenate([held, [tick - arrived], arriving, [due, sent, arrived]])
