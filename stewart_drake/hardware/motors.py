"""Options and laws of everything between a command and the cranks: delay, link and motors."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from stewart_drake.base.atomic_files import Document
from stewart_drake.base.code import CodePath, UserCode
from stewart_drake.base.config import InOtherKinds, LegNumber, Natural, NotNegative, Section, Seed, Share
from stewart_drake.base.errors import ConfigurationError, NotFiniteError
from stewart_drake.base.families import UserMade
from stewart_drake.base.jit import njit
from stewart_drake.base.records import Matrix, Record, Vec6, Vector, record
from stewart_drake.base.sampling import steps_per
from stewart_drake.hardware.faults import CommandFault, MotorFault, Signal, tick_numbers
from stewart_drake.loop.part import LoopContext, Part
from stewart_drake.mechanics.linear_algebra import copy_to
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import SMALLEST_SIZE

if TYPE_CHECKING:
    from stewart_drake.control.regression_records import Learnt
    from stewart_drake.hardware.presets import Preset

_STREAM = 3  # Number of the stream of random numbers, see `faults.tick_numbers`.
SILENCE = 0.1
"""[s] without a command after which the robot counts as uncontrolled. In free fall it would fall 5 cm in this time."""


class Torque(Record):
    """State of a part whose only output is `torque`."""

    torque: Vec6  # [N m]


class Command(Record):
    """State of a part whose only output is `command`."""

    command: Vec6  # In the motors' unit.


class LinkOptions(Section, key="link"):
    """Faults of the link that carries commands to the motors; none by default.

    If a command is dropped, the motors keep the one before. A late command arrives one step of the plant after its
    tick. A command that is both dropped and late is dropped.
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
        """Whether all commands arrive unchanged and in time."""
        imperfect = self.drop_probability or self.late_probability or self.dropped or self.faults
        return not imperfect and self.stop_time is None

    def fate(self, tick: int, time: float) -> Literal["arrives", "dropped", "late"]:
        """What happens to the command of a tick at a time [s]."""
        drop, late = tick_numbers(self.seed, _STREAM, tick, 2, normal=False)
        stopped = self.stop_time is not None and time >= self.stop_time
        if stopped or tick in self.dropped or drop < self.drop_probability:
            return "dropped"
        return "late" if late < self.late_probability else "arrives"

    def silent_since(self, ticks: int, period: float) -> float | None:
        """Time [s] of the first of the dropped commands, if none has arrived for `SILENCE`; else None.

        Args:
            ticks: Number of ticks so far.
            period: [s] of a tick.
        """
        last = ticks - 1
        while last >= 0 and self.fate(last, last * period) == "dropped":
            last -= 1
        return (last + 1) * period if last < 0 or (ticks - 1 - last) * period > SILENCE else None

    def part(self, period: float, time_step: float, initial: np.ndarray) -> Part:
        """The link as a part: a command per period [s] -> the command in force, per `time_step` [s] of the plant.

        `initial` (6,) is in force until the first command arrives.
        """
        per_tick = steps_per("controller.period", period, time_step)
        constants, inputs = {"options": self, "steps_per_tick": per_tick}, {"torque": 6, "time": 1}
        first = LinkState.new(torque=initial)
        return Part("link", _link, constants, inputs, ("torque", "age"), first, period=time_step)


class LinkState(Record):
    """State of the link between controller and motors."""

    torque: Vec6  # [N m] the command in force.
    age: Annotated[np.ndarray, (1,)]  # [ticks] age of the command in force; 0 for that of the newest tick.
    steps: float  # Number of steps of the plant so far.
    pending: Vec6  # [N m] a late command.
    due: float  # Step at which the late command arrives; 0 if there is none.
    pending_tick: float  # Tick of the late command.
    tick: float  # Tick of the command in force.


def _link(options: LinkOptions, steps_per_tick: int, torque: np.ndarray, time: np.ndarray, state: LinkState) -> None:
    now = state[0]
    step = int(now["steps"])
    if now["due"] > 0.0 and step >= now["due"]:
        now["torque"], now["tick"], now["due"] = now["pending"], now["pending_tick"], 0.0
    tick, steps_since = divmod(step, steps_per_tick)
    if steps_since == 0:
        signal = Signal(np.array(torque, dtype=float), float(time[0]), tick)
        for fault in options.faults:
            fault.spoil(signal)
        fate = options.fate(tick, signal.time)
        if fate == "arrives":
            now["torque"], now["tick"], now["due"] = signal.values, tick, 0.0
        elif fate == "late":
            now["pending"], now["pending_tick"], now["due"] = signal.values, tick, step + 1
    now["age"], now["steps"] = tick - now["tick"], step + 1


class DelayState(Record):
    """State of a delay of `ticks`, of a signal of `size` numbers."""

    value: Annotated[np.ndarray, ("size",)]
    pending: Annotated[np.ndarray, ("ticks", "size")]  # Oldest first.


def delay_part(ticks: int, initial: np.ndarray, name: str = "command_delay") -> Part:
    """A part that delays the signal `value` (n,) by a number of ticks; its output begins with `initial` (n,)."""
    size = len(initial)
    first = DelayState.sized(ticks=ticks, size=size).new(value=initial, pending=initial)
    return Part(name, _delay, {}, {"value": size}, ("value",), first)


def _delay(value: Vector, state: DelayState) -> None:
    _shift(state["pending"][0], value, state["value"][0])


@njit
def _shift(pending: Matrix, value: Vector, out: Vector) -> None:
    """Copies the oldest row to `out`, moves the others up, and appends `value`."""
    copy_to(out, pending[0])
    for row in range(len(pending) - 1):
        copy_to(pending[row], pending[row + 1])
    copy_to(pending[len(pending) - 1], value)


class DeadMotor(Section, key="motors.dead"):
    """A motor that loses its torque; its crank turns freely."""

    leg: LegNumber
    """Number of the leg, 0 to 5."""
    time: NotNegative = 0.0
    """[s] when it loses its torque."""


def within_limit(torque: np.ndarray, limit: float | np.ndarray) -> np.ndarray:
    """Torques [N m] limited to the effort limits of the motors; NaN stays NaN."""
    return np.minimum(np.maximum(torque, -limit), limit)


class MotorOptions(Section, ABC, key="motors"):
    """Base of the options of motors. A kind must define `part`; the other members have defaults for torque motors."""

    kind_keys = frozenset({"resolution"})
    command_quantity: ClassVar[str] = "torque"
    """Physical quantity of a command."""
    unit: ClassVar[str] = "N m"
    """Unit of a command."""
    holds: ClassVar[bool] = False
    """Whether a command is an angle, for a position loop in the motor."""
    by_torque: ClassVar[bool] = True
    """Whether a command is a torque."""
    dead = InOtherKinds(None)
    """A motor that loses its torque."""

    kind: str
    """Kind of motor."""

    @abstractmethod
    def part(self, robot: RobotParameters, time_step: float) -> Part:
        """The motors as a part, which runs at every `time_step` [s] of the plant.

        Inputs: `command` (6,); if needed also `crank_state` (12,), angles [rad] and rates [rad/s], and `time` (1,) [s].
        Output: `torque` (6,) [N m], within the limits of the motors.
        """

    def inverse_parts(self, context: LoopContext) -> tuple[Part, ...]:  # noqa: ARG002 - the identity needs nothing
        """Parts of the inverse model, from `torque` (6,) [N m] to `command` (6,); none if commands are torques."""
        return ()

    def initial_command(self, context: LoopContext) -> np.ndarray:
        """Command (6,) in force until the first one arrives."""
        return context.initial_torque

    def command_limits(self, robot: RobotParameters) -> np.ndarray:
        """Lowest and highest commands, (2, 6)."""
        return np.stack([-robot.effort_limits, robot.effort_limits]) / self.gains

    def torque_of(self, signals: Mapping[str, np.ndarray]) -> np.ndarray | None:
        """Torque (n, 6) [N m] in the signals of a run: the command, or for servos that of their position loops."""
        return signals.get("torque" if self.by_torque else "torque_applied")

    def limits(self, robot: RobotParameters) -> np.ndarray:
        """(6,) [N m] largest torques at rest."""
        return robot.effort_limits

    def available(self, robot: RobotParameters, rates: np.ndarray) -> np.ndarray:
        """Largest torque (..., 6) [N m] of motors at rates (..., 6) [rad/s]; negative if they can only brake."""
        return np.broadcast_to(robot.effort_limits, rates.shape)

    @property
    def gains(self) -> np.ndarray:
        """Torques (6,) [N m] per unit of a command."""
        return np.ones(6)

    def with_learnt(self, value: Learnt) -> tuple[Document, np.ndarray, np.ndarray]:
        """Keys of the motors with the values of a `control.adaptation.Learnt`, and its friction.

        Returns the changed keys (none for motors that take torques), and viscous and Coulomb friction (6,) of the
        model.
        """
        return {}, value.viscous, value.coulomb

    @property
    def dead_time(self) -> float:
        """[s] from the arrival of a command to its effect."""
        return 0.0

    @property
    def slack(self) -> float:
        """[rad] by which an angle may differ from its command without a torque, if commands are angles."""
        return 0.0

    @property
    def gear(self) -> Preset | None:
        """Preset of commercial motors, which has the friction of their gears; None without a preset."""
        return None

    @property
    def nominal(self) -> MotorOptions:
        """The same motors without imperfections, for the model of a controller."""
        return self

    @property
    def code(self) -> CodePath | None:
        """The user's code, for a kind that is defined by a user; None for a kind of the package."""
        return None

    @property
    def perfect(self) -> bool:
        """Whether the torque is exactly the command, within the limit."""
        return False


class TorqueMotors(MotorOptions):
    """Motors that take torques, with imperfections; by default there are none."""

    kind: Literal["torque"] = "torque"
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
        if 0.0 < self.resolution < SMALLEST_SIZE:
            raise ConfigurationError("resolution", self.resolution, f"0, or at least {SMALLEST_SIZE:g} N m")

    @property
    def nominal(self) -> MotorOptions:
        return TorqueMotors()

    @cached_property
    def perfect(self) -> bool:
        return self.ripple == 0.0 and self.resolution == 0.0 and self.dead is None and not self.faults

    def torque(self, command: np.ndarray, angles: np.ndarray, _: np.ndarray, time: float) -> np.ndarray:
        """Torques (6,) [N m] before the limit, for commands (6,) [N m], crank angles (6,) [rad] and a time [s]."""
        torque = np.array(command, dtype=float)
        if self.resolution > 0.0:
            torque = np.rint(torque / self.resolution) * self.resolution
        for fault in self.faults:
            fault.spoil(Signal(torque, time))
        if self.ripple > 0.0:
            torque += self.ripple * np.sin(self.ripple_periods * angles)
        if self.dead is not None and time >= self.dead.time:
            torque[self.dead.leg] = 0.0
        return torque

    def part(self, robot: RobotParameters, time_step: float) -> Part:
        if not self.perfect:
            return _motor_part(self.torque, robot, time_step)
        inputs, numbers = {"command": 6}, {"limit": robot.effort_limits}
        return Part("motors", limit_torque, {}, inputs, ("torque",), Torque.new(), period=time_step, parameters=numbers)


class UserMotors(UserMade, MotorOptions, key="motors"):  # type: ignore[misc]
    """Your own motors: `torque(command, angles, rates, time)` returns the six torques [N m] that they give.

    It is called at every step of the plant: command (6,) [N m], or [rad] if `model.motors` take angles; angles (6,)
    [rad] and rates (6,) [rad/s] of the cranks; time [s]. The torques are then limited to the effort limit. A
    constructor that names `robot` or `time_step` gets them.
    """

    asked = "torque(command, angles, rates, time) returns six torques [N m]"

    def part(self, robot: RobotParameters, time_step: float) -> Part:
        motors = self.new_object({"robot": robot, "time_step": time_step})
        if not callable(getattr(motors, "torque", None)):
            raise self.refusal("one without torque")
        guard = UserCode(type(motors).__module__)

        def torque(command: np.ndarray, angles: np.ndarray, rates: np.ndarray, time: float) -> np.ndarray:
            with guard:
                # Copies, because the user's code may keep or change them.
                result = motors.torque(command.copy(), angles.copy(), rates.copy(), time)
            torque = self.numbers(result)
            if torque.shape != (6,):
                raise self.refusal(f"an array of shape {torque.shape}")
            if not np.isfinite(torque).all():
                raise NotFiniteError(f"torque of {self.code.name}", torque)
            return torque

        return _motor_part(torque, robot, time_step)


def _motor_part(torque: Callable[..., np.ndarray], robot: RobotParameters, time_step: float) -> Part:
    """Motors as a part, from a function of command, angles, rates and time that returns torques before the limit."""
    constants, inputs = {"torque": torque, "limit": robot.effort_limits}, {"command": 6, "time": 1, "crank_state": 12}
    return Part("motors", _motor_torque, constants, inputs, ("torque",), Torque.new(), period=time_step)


def _motor_torque(
    torque: Callable[..., np.ndarray],
    limit: np.ndarray,
    command: np.ndarray,
    time: np.ndarray,
    crank_state: np.ndarray,
    state: Torque,
) -> None:
    state["torque"][0] = within_limit(torque(command, crank_state[:6], crank_state[6:], float(time[0])), limit)


@njit
def limit_torque(limit: Vec6, command: Vec6, state: Torque) -> None:
    """Torques [N m] of motors without imperfections: the command, limited."""
    state = record(state)
    for i in range(6):
        state.torque[i] = np.minimum(np.maximum(command[i], -limit[i]), limit[i])
