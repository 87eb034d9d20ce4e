"""What a machine is to whoever drives it, and which one a URL names."""

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
LOST = 1.0  # [s] without a reading after which a machine is lost.
LARGEST_ANGLE = 4.0 * np.pi  # [rad] of a reading that is believed.
PATIENCE = 3  # Periods for which `read` waits for the next reading of a machine that sets the pace.
Takes = Literal["angle", "torque", "current"]
_URLS = "reachy://HOST:PORT, udp://HOST:PORT, serial:DEVICE, sim: or mine.py:MyMachine"


class MachineError(RunFailure):
    """A machine that cannot be reached, is lost, or gives what is no reading: one line, which begins with its name."""

    reason = "machine"

    def __init__(self, name: str, problem: str | Exception) -> None:
        super().__init__(f"{name}: {' '.join(str(problem).split()) or type(problem).__name__}")


@contextmanager
def line_errors(name: str) -> Iterator[None]:
    """Within it, what a socket or a serial line raises is a MachineError."""
    try:
        yield
    except ConnectionRefusedError:
        raise MachineError(name, "nobody listens there") from None
    except (OSError, ValueError) as error:
        raise MachineError(name, error) from None


class Reading(NamedTuple):
    """What a machine says of itself.

    Attributes:
        angles: (6,) [rad] of the cranks.
        time: [s] of the machine's own clock where it has one, else of `time.monotonic` when the reading arrived.
        age: [s] since it arrived, at the moment that `read` returns.
        number: Counts the machine's readings. It stays where none has come since the last `read`; a jump by more than
            one says that some were lost, or came too fast to be read.
        command_age: [s] since that command was sent which is known to have arrived; no reading is older than that,
            whatever the network does. 0 where the machine does not say.
        holding: Whether the machine says that it follows no commands: it has got none yet, or the last is too old.
        pose: (6,) [rad, m] of the platform where the machine tells it; for comparison, no law reads it.
        arrived: (6,) the last command that is known to have arrived; None where the machine does not say.
    """

    angles: np.ndarray
    time: float
    age: float
    number: int
    command_age: float = 0.0
    holding: bool = False
    pose: np.ndarray | None = None
    arrived: np.ndarray | None = None


class Machine(Protocol):
    """Six motors that can be told what to do. `open_machine` makes one; nothing happens before `connect`.

    Every method but `disconnect` may raise a `MachineError`.

    Attributes:
        period: [s] between two readings, known once it is connected; None where that does not matter.
        takes: What `command` takes: `angle` [rad], `torque` [N m] or `current` [A].
        reads: Whether it measures its angles; otherwise `read` gives the last command.
        after: What becomes of its motors once it is let go, as a clause; empty where nothing has to be said.
        paced: Whether its own ticks set the pace. `read` then waits for the next reading, for at most `PATIENCE`
            periods; if none comes it gives the last one again, older. Otherwise `read` gives the latest at once.
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
        """Lets go; the machine holds where it is. Never raises, and may be called twice."""


def open_machine(url: str, scenario: Scenario, trust_code: bool = False) -> Machine:
    """The machine that a URL names, not connected yet.

    Args:
        url: `reachy://HOST:PORT`, `udp://HOST:PORT`, `serial:DEVICE` or `serial:DEVICE:BAUD`, `sim:` or `sim:SCENARIO`,
            or a class of the user's own, `mine.py:MyMachine` or `module:Class`, whose code has to be trusted.
        scenario: What is driven; what its motors are believed to take, and the limits of its robot, are the machine's.
        trust_code: Let the code of such a class run.

    Raises:
        ConfigurationError: A URL that names no machine, code that is not trusted, a machine that takes something else.
    """
    kind, _, rest = url.partition(":")
    if kind in MACHINES.names:
        made = MACHINES[kind]
        machine: Machine = made(scenario, *_address(url, getattr(made, "default_port", None)))
    elif kind == "serial" and (parts := re.fullmatch(r"(.+?)(?::(\d{1,8}))?", rest)):
        machine = imported("machines.serial_line:SerialMachine")(scenario, parts[1], int(parts[2] or 1_000_000))
    elif kind == "sim":
        machine = imported("machines.simulated:SimulatedMachine")(scenario, rest)
    elif re.fullmatch(CLASS_PATH, url):
        machine = imported("machines.user_machine:UserMachine")(scenario, url, trust_code)
    else:
        raise ConfigurationError("machine", url, _URLS)
    return Homed(machine, scenario.belief.home) if any(scenario.belief.home) else machine


class Homed:
    """A machine that reads zero at angles `home` (6,) [rad] of the cranks; it is told and tells the model's angles."""

    def __init__(self, machine: Machine, home: Sequence[float]) -> None:
        self._machine, self._home = machine, np.array(home)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._machine, name)

    def read(self) -> Reading:
        """The next or the latest reading."""
        reading = self._machine.read()
        if reading.arrived is not None and self._machine.takes == "angle":
            reading = reading._replace(arrived=reading.arrived + self._home)
        return reading._replace(angles=reading.angles + self._home)

    def command(self, values: np.ndarray) -> None:
        """Sends six commands (6,)."""
        self._machine.command(values - self._home if self._machine.takes == "angle" else values)


def _address(url: str, default_port: int | None) -> tuple[str, int]:
    """Host, this computer where none is named, and port of a URL `kind://HOST:PORT`."""
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
    """Raises a ConfigurationError where the motors that the controller believes in take something else."""
    motors = scenario.belief.motors
    if motors.takes != takes:
        raise ConfigurationError("model.motors", motors.kind, f"motors that take {takes}, as {who} does")


def command_limits(scenario: Scenario) -> np.ndarray:
    """(2, 6) lowest and highest commands in the motors' unit; angles are the machine's own, see `Homed`."""
    belief = scenario.belief
    return belief.motors.command_limits(belief.robot) - belief.motors.holds * np.array(belief.home)


def within_limits(values: np.ndarray, limits: np.ndarray, name: str) -> np.ndarray:
    """Commands (6,) cut to `command_limits` (2, 6); a MachineError of a machine where they are no numbers."""
    given = np.asarray(values, dtype=float)
    if given.shape != (6,) or not np.isfinite(given).all():
        raise MachineError(name, f"a command that is not six finite numbers: {given}")
    return np.clip(given, limits[0], limits[1])
