"""The interface of a machine, `Machine`, and the machine that a URL names."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Literal, NamedTuple, Protocol
from urllib.parse import urlsplit

import numpy as np

from stewart_drake.base.code import CLASS_PATH
from stewart_drake.base.errors import ConfigurationError, RunFailure
from stewart_drake.base.families import imported
from stewart_drake.base.registry import MACHINES
from stewart_drake.scenario.scenario import Scenario

LOCALHOST = "127.0.0.1"
LOST_AFTER = 1.0  # [s] without a reading, until the connection counts as lost.
LARGEST_ANGLE = 4.0 * np.pi  # [rad] Readings beyond it are dropped.
PERIODS_TO_WAIT = 3  # Longest wait of `read` for the next reading of a paced machine.
Takes = Literal["angle", "torque", "current"]
_URLS = "reachy://HOST:PORT, udp://HOST:PORT, serial:DEVICE, sim: or mine.py:MyMachine"


class MachineError(RunFailure):
    """A machine cannot be reached, is lost, or sends an invalid reading. One line that begins with its name."""

    reason = "machine"

    def __init__(self, name: str, problem: str | Exception) -> None:
        super().__init__(f"{name}: {' '.join(str(problem).split()) or type(problem).__name__}")


@contextmanager
def line_errors(name: str) -> Iterator[None]:
    """Turns errors of a socket or a serial line into a MachineError."""
    try:
        yield
    except ConnectionRefusedError:
        raise MachineError(name, "nobody listens there") from None
    except (OSError, ValueError) as error:
        raise MachineError(name, error) from None


class Reading(NamedTuple):
    """A reading of a machine.

    Attributes:
        angles: (6,) [rad] of the cranks.
        time: [s] by the machine's clock if it has one, else `time.monotonic` at arrival.
        age: [s] since it arrived, at the moment that `read` returns.
        number: Count of readings. It is that of the last `read` if no new one has come; a jump by more than one means
            that readings were lost, or came faster than they were read.
        command_age: [s] since the newest acknowledged command was sent, an upper bound of the reading's age. 0 if the
            machine acknowledges none.
        holding: Whether the machine follows no command: it has got none yet, or the last is too old.
        pose: (6,) [rad, m] of the platform, if the machine measures it; for comparison only, no law uses it.
        arrived: (6,) the newest acknowledged command; None if the machine acknowledges none.
        imu: (6,) rates [rad/s] and specific force [m/s^2] of its inertial sensor; None or NaN where none is new.
    """

    angles: np.ndarray
    time: float
    age: float
    number: int
    command_age: float = 0.0
    holding: bool = False
    pose: np.ndarray | None = None
    arrived: np.ndarray | None = None
    imu: np.ndarray | None = None


class Machine(Protocol):
    """Six motors that take commands. `open_machine` makes one; nothing happens before `connect`.

    Every method but `disconnect` may raise a `MachineError`.

    Attributes:
        period: [s] between two readings, known once it is connected; None where that does not matter.
        takes: What `command` takes: `angle` [rad], `torque` [N m] or `current` [A].
        reads: Whether it measures its angles; otherwise `read` gives the last command.
        after: What its motors do after `disconnect`, as a clause for messages; may be empty.
        paced: Whether its readings set the pace of the loop. `read` then waits for the next one, at most
            `PERIODS_TO_WAIT` periods; if none comes it returns the last one again, older. Otherwise `read` returns the
            latest at once.
    """

    period: float | None
    takes: Takes
    reads: bool
    paced: bool
    after: str

    def connect(self) -> None:
        """Opens the connection and waits for the first reading; moves nothing."""

    def read(self) -> Reading:
        """The next or the latest reading, see `paced`."""

    def command(self, values: np.ndarray) -> None:
        """Sends six commands (6,), see `takes`, cut to the robot's limits; does not wait."""

    def disconnect(self) -> None:
        """Closes the connection; the machine holds its position. Never raises, and may be called twice."""


def open_machine(url: str, scenario: Scenario, trust_code: bool = False) -> Machine:
    """The machine that a URL names, not connected yet.

    Args:
        url: `reachy://HOST:PORT`, `udp://HOST:PORT`, `serial:DEVICE` or `serial:DEVICE:BAUD`, `sim:` or `sim:SCENARIO`,
            or a user's class, `mine.py:MyMachine` or `module:Class`; its code has to be trusted.
        scenario: Scenario that is driven. Kind and limits of the commands are those of its model.
        trust_code: Let the code of such a class run.

    Raises:
        ConfigurationError: A URL that names no machine, code that is not trusted, a machine that takes something else.
    """
    if scenario.ball_control is not None:
        allowed = "null, for a machine: none reads a ball's place; `Controller.step` in Python takes one"
        raise ConfigurationError("ball_control", "a section", allowed)
    kind, _, rest = url.partition(":")
    if kind in MACHINES.names:
        factory = MACHINES[kind]
        machine: Machine = factory(scenario, *_address(url, getattr(factory, "default_port", None)))
    elif kind == "serial" and (parts := re.fullmatch(r"(.+?)(?::(\d{1,8}))?", rest)):
        machine = imported("machines.packet_machine:SerialMachine")(scenario, parts[1], int(parts[2] or 1_000_000))
    elif kind == "sim":
        machine = imported("machines.simulated:SimulatedMachine")(scenario, rest)
    elif re.fullmatch(CLASS_PATH, url) and (trust_code or kind.endswith(".py")):
        machine = imported("machines.user_machine:UserMachine")(scenario, url, trust_code)
    else:
        module = f"; for class {rest} of module {kind} add --trust-code" if re.fullmatch(CLASS_PATH, url) else ""
        raise ConfigurationError("machine", url, f"{_URLS}{module}")
    home, gains = scenario.controller_model.home, scenario.controller_model.robot.servo_gains
    return Homed(machine, home, gains) if any(home) or (gains != 1.0).any() else machine


class Homed:
    """A machine with its zero at crank angles `home` (6,) [rad] and servos that turn cranks by `gains` (6,) [-].

    Readings and commands are in the model's angles.
    """

    def __init__(self, machine: Machine, home: Sequence[float], gains: np.ndarray | float = 1.0) -> None:
        self._machine, self._home, self._gains = machine, np.array(home), gains

    def __getattr__(self, name: str) -> Any:
        return getattr(self._machine, name)

    def read(self) -> Reading:
        """The next or the latest reading."""
        reading = self._machine.read()
        if reading.arrived is not None and self._machine.takes == "angle":
            reading = reading._replace(arrived=self._gains * reading.arrived + self._home)
        return reading._replace(angles=self._gains * reading.angles + self._home)

    def command(self, values: np.ndarray) -> None:
        """Sends six commands (6,)."""
        self._machine.command((values - self._home) / self._gains if self._machine.takes == "angle" else values)


def _address(url: str, default_port: int | None) -> tuple[str, int]:
    """Host and port of a URL `kind://HOST:PORT`; the default host is this computer."""
    try:
        parts = urlsplit(url)
        host, port = parts.hostname or LOCALHOST, default_port if parts.port is None else parts.port
        more = parts.path.strip("/") + parts.query + parts.fragment + (parts.username or "")
    except ValueError:
        host, port, more = "", None, ""
    if not port or more or "://" not in url:
        raise ConfigurationError("machine", url, f"{url.partition(':')[0]}://HOST:PORT, with a port from 1 to 65535")
    return host, port


def check_takes(scenario: Scenario, takes: str, who: str) -> None:
    """Raises a ConfigurationError if the motors of the controller's model take another quantity."""
    motors = scenario.controller_model.motors
    if motors.command_quantity != takes:
        raise ConfigurationError("model.motors", motors.kind, f"motors that take {takes}, as {who} does")


def command_limits(scenario: Scenario) -> np.ndarray:
    """(2, 6) lowest and highest commands in the motors' unit; angles are those of the machine, see `Homed`."""
    belief = scenario.controller_model
    limits = belief.motors.command_limits(belief.robot)
    if belief.servos is not None and belief.motors.holds:
        return belief.servos.wiring(belief.robot, belief.motors, belief.home).angles
    return (limits - np.array(belief.home)) / belief.robot.servo_gains if belief.motors.holds else limits


def within_limits(values: np.ndarray, limits: np.ndarray, name: str) -> np.ndarray:
    """Commands (6,) cut to `command_limits` (2, 6); MachineError if they are not six finite numbers."""
    given = np.asarray(values, dtype=float)
    if given.shape != (6,) or not np.isfinite(given).all():
        raise MachineError(name, f"a command that is not six finite numbers: {given}")
    return np.clip(given, limits[0], limits[1])
