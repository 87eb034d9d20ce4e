"""From a command to the cranks: delay, link, motors, and what is added against friction."""

from __future__ import annotations

import contextlib
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from stewart_drake.config import LegNumber, Natural, NotNegative, Positive, Section, Seed, Share
from stewart_drake.errors import ConfigurationError, UnreachablePoseError
from stewart_drake.hardware.faults import CommandFault, MotorFault, Signal, tick_numbers
from stewart_drake.jit import fields, new_record, njit, record
from stewart_drake.mechanics.dynamics import static_torque
from stewart_drake.mechanics.friction import dry_level
from stewart_drake.mechanics.kinematics_laws import LEGS, crank_rates, legs_at, robot_record, twist_of
from stewart_drake.part import Part, Setup
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import SMALLEST, FrictionOptions
from stewart_drake.sampling import steps_per

_STREAM = 3  # Of random numbers, see `faults.tick_numbers`.
SILENCE = 0.1  # [s] without a command after which nobody is in charge; the weight falls by 5 cm in that time.


class LinkOptions(Section, key="link"):
    """Faults of the link that carries commands to the motors; none by default.

    After a dropped command the last one holds. A late command arrives a step of the plant after its tick. A tick that
    is both is dropped.
    """

    drop_probability: Share = 0.0
    """[-] probability that a tick's command is dropped, 0 to 1."""
    dropped: tuple[Natural, ...] = ()
    """Numbers of ticks whose commands are always dropped; tick k is at k controller.period."""
    stop_time: NotNegative | None = None
    """[s] time from which all commands are dropped, as if the controller hangs; null for never."""
    late_probability: Share = 0.0
    """[-] probability that a tick's command is late, 0 to 1."""
    seed: Seed = 0
    """Seed of the random drops and delays; each tick has its own random number."""
    faults: tuple[CommandFault, ...] = ()
    """Faults that corrupt commands before they are sent."""

    @cached_property
    def perfect(self) -> bool:
        chance = self.drop_probability or self.late_probability or self.dropped or self.faults
        return not chance and self.stop_time is None

    def fate(self, tick: int, time: float) -> Literal["arrives", "dropped", "late"]:
        drop, late = tick_numbers(self.seed, _STREAM, tick, 2, normal=False)
        stopped = self.stop_time is not None and time >= self.stop_time
        if stopped or tick in self.dropped or drop < self.drop_probability:
            return "dropped"
        return "late" if late < self.late_probability else "arrives"

    def silent_since(self, ticks: int, period: float) -> float | None:
        """[s] since when no command has arrived, `ticks` of a period [s] after the start; None where one just has."""
        last = ticks - 1
        while last >= 0 and self.fate(last, last * period) == "dropped":
            last -= 1
        return (last + 1) * period if last < 0 or (ticks - 1 - last) * period > SILENCE else None

    def part(self, setup: Setup) -> Part:
        """What has arrived by each step of the plant; until the first command arrives, `setup.initial_torque`."""
        per_tick = steps_per("controller.period", setup.period, setup.time_step)
        constants, inputs = {"options": self, "steps_per_tick": per_tick}, {"torque": 6, "time": 1}
        first = new_record(_LINK_STATE, torque=setup.initial_torque)
        return Part("link", _carry, constants, inputs, ("torque", "age"), first, period=setup.time_step)


_LINK_STATE = fields(torque=6, age=(1,), steps=(), arriving=6, due=(), sent=(), arrived=())
"""torque: in force [N m]. age: of it, counted from the newest tick there was [ticks]. steps: done. arriving: under way
[N m]. due: step at which that arrives, 0 for none. sent: its tick. arrived: tick of the command in force."""


def _carry(options: LinkOptions, steps_per_tick: int, torque: np.ndarray, time: np.ndarray, state: np.ndarray) -> None:
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
            now["arriving"], now["sent"], now["due"] = signal.says, number, step + 1
    now["age"], now["steps"] = number - now["arrived"], step + 1


def delay_part(ticks: int, initial: np.ndarray) -> Part:
    """A constant delay of commands: `torque` (6,) [N m] -> that of so many ticks ago, and `initial` (6,) until then."""
    first = new_record(fields(torque=6, under_way=(ticks, 6)), torque=initial, under_way=initial)
    return Part("command_delay", _delay, {}, {"torque": 6}, ("torque",), first)


def _delay(torque: np.ndarray, state: np.ndarray) -> None:
    state["torque"][0], under_way = state["under_way"][0, 0], state["under_way"][0]
    under_way[:-1] = under_way[1:]
    under_way[-1] = torque


def standing_torque(robot: RobotParameters, pose: np.ndarray, gravity: float) -> np.ndarray:
    """Torques (6,) [N m] that hold the controller's model at a pose; zeros where it cannot be held."""
    # In that case the first tick says so, with a log.
    with contextlib.suppress(UnreachablePoseError, np.linalg.LinAlgError):
        return static_torque(robot, pose, gravity)
    return np.zeros(6)


class DeadMotor(Section, key="motors.dead"):
    """A motor that loses its torque; its crank turns freely."""

    leg: LegNumber
    """Number of the leg, 0 to 5."""
    time: NotNegative = 0.0
    """[s] when it loses its torque."""


class MotorOptions(Section, key="motors"):
    """Imperfections of the motors; by default there are none."""

    ripple: NotNegative = 0.0
    """[N m] amplitude of the torque ripple (cogging), a sine of the crank's angle."""
    ripple_periods: Annotated[Natural, Field(ge=1, le=10_000)] = 12
    """Periods of the torque ripple in one turn of the crank."""
    resolution: NotNegative = 0.0
    """[N m] torque resolution of the amplifier; torques are rounded to whole steps. 0 for none."""
    dead: DeadMotor | None = None
    """A motor that loses its torque; null for none."""
    faults: tuple[MotorFault, ...] = ()
    """Motors that are wired wrongly, in order, between amplifier and motor."""

    def rules(self) -> None:
        if 0.0 < self.resolution < SMALLEST:
            raise ConfigurationError("resolution", self.resolution, f"0, or at least {SMALLEST:g} N m")

    @cached_property
    def perfect(self) -> bool:
        return self.ripple == 0.0 and self.resolution == 0.0 and self.dead is None and not self.faults

    def torque(self, wanted: np.ndarray, crank_angles: np.ndarray, time: float) -> np.ndarray:
        """What the motors give (6,) [N m] for torques (6,) that are wanted, before the plant's effort limit."""
        torque = np.array(wanted, dtype=float)
        if self.resolution > 0.0:
            torque = np.rint(torque / self.resolution) * self.resolution
        for fault in self.faults:
            fault.spoil(Signal(torque, time))
        if self.ripple > 0.0:
            torque += self.ripple * np.sin(self.ripple_periods * crank_angles)
        if self.dead is not None and time >= self.dead.time:
            torque[self.dead.leg] = 0.0
        return torque

    def part(self, setup: Setup) -> Part:
        """`torque` (6,) [N m], `crank_state` (12,), angles [rad] and rates -> `torque` that the motors give."""
        inputs, first = {"torque": 6, "time": 1, "crank_state": 12}, new_record(fields(torque=6))
        return Part("motors", _drive, {"options": self}, inputs, ("torque",), first, period=setup.time_step)


def _drive(
    options: MotorOptions, torque: np.ndarray, time: np.ndarray, crank_state: np.ndarray, state: np.ndarray
) -> None:
    state["torque"][0] = options.torque(torque, crank_state[:6], float(time[0]))


class FrictionCompensation(FrictionOptions, key="friction_compensation"):
    """The controller's model of motor friction; its torque for the reference's velocity is added to the command.

    It uses the reference and not the measurement: noise cannot make it chatter, and it does not push a robot that
    should rest.
    """

    width: Positive = 0.002
    """[rad/s] crank speed at which 76 % of the dry friction is compensated; larger smooths reversals more."""

    def part(self, setup: Setup) -> Part:
        """`reference` (18,) -> `friction_torque` (6,) [N m]."""
        levels = dict(zip(("coulomb", "break_away", "stribeck_rate", "viscous"), self.levels, strict=True))
        believed = new_record(_BELIEVED, **levels, width=self.width)
        constants, first = (
            {"robot": robot_record(setup.robot), "friction": believed},
            new_record(fields(friction_torque=6)),
        )
        outputs = ("friction_torque",)
        return Part("friction_compensation", friction_tick, constants, {"reference": 18}, outputs, first, (LEGS,))


_BELIEVED = fields(coulomb=6, break_away=6, stribeck_rate=6, viscous=6, width=())
"""[N m], [N m], [rad/s], [N m s/rad], [rad/s]."""


@njit
def friction_tick(robots: Any, frictions: Any, reference: Any, leg_records: Any, states: Any) -> None:
    """Torques (6,) g(rate) tanh(rate / width) + viscous rate along a reference (18,); zeros out of reach."""
    robot, friction, legs = record(robots), record(frictions), record(leg_records)
    out = record(states).friction_torque
    twist, rates = np.empty(6), np.empty(6)
    out[:] = 0.0
    if legs_at(robot, reference[:6], legs) >= 0:
        return
    twist_of(reference[:6], reference[6:12], twist)
    crank_rates(legs, twist, rates)
    if not np.isfinite(rates).all():
        return
    for i in range(6):
        dry = dry_level(friction.coulomb[i], friction.break_away[i], friction.stribeck_rate[i], rates[i])
        out[i] = dry * np.tanh(rates[i] / friction.width) + friction.viscous[i] * rates[i]
