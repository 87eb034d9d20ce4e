"""The reference by a stream of target poses from outside, kept within the limits: options, sources and part."""

from __future__ import annotations

import copy
import socket
from collections.abc import Callable
from functools import cached_property
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, PrivateAttr

from stewart_drake.base.config import Flag, Positive, Section, Text
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.tables import POSE, column_of
from stewart_drake.loop.part import Part
from stewart_drake.mechanics.reach_laws import Probe, Space, at_rest
from stewart_drake.references.recorded import load_recording
from stewart_drake.robot.robot_scale import LENGTH
from stewart_drake.safety.stream_laws import ROWS, StreamParams, StreamState, stream_rows, stream_tick

Targets = Callable[[float], np.ndarray]
"""The newest target (6,) [rad, m] at a time [s] of the motion; NaN for none."""
NO_TARGET = np.full(6, np.nan)
_SHARE = 0.9  # Of `safety.workspace`, in which targets are put: readings and their prediction are also off.
_MOST_DATAGRAMS, _LONGEST = 1000, 1000  # Read at a time; bytes.


class StreamReference(Section, key="reference"):
    """Target poses from outside, as they come: over UDP, from Python, or from a file.

    A filter follows the newest target with bounded speed and acceleration, and never leaves `limits`, whatever is sent:
    it rests at the nearest pose that it can take. Targets outside of nine tenths of `safety.workspace` are moved into
    it, towards home. It begins at home, and holds the last target when none comes. What is no pose is dropped. `drive`
    listens at `udp`; a simulation does not, and plays the file, or holds home without one.
    """

    kind: Literal["stream"] = "stream"
    motion_file: Text | None = None
    """File with targets, in the form of a recorded motion, for simulation; a target is held until the next row's
    time."""
    udp: Text | None = None
    """Address at which `drive` listens for targets, HOST:PORT. A datagram is one line of text with as many numbers as
    `columns`, between commas, spaces, or semicolons; with semicolons a comma is a decimal point."""
    columns: tuple[Text, ...] = ("roll_deg", "pitch_deg", "yaw_deg", "x_mm", "y_mm", "z_mm")
    """Meaning of the numbers in a line, in order: names with units as in tables of poses; others are ignored."""
    relative: Flag = False
    """Whether the numbers in a line count from home."""
    period: Positive = 0.02
    """[s] between two decisions of the filter."""
    speed: Annotated[Positive, LENGTH] = 0.3
    """[m/s] largest speed of the platform; the default scales with the robot."""
    acceleration: Annotated[Positive, LENGTH] = 2.0
    """[m/s^2] largest acceleration of the platform; the default scales with the robot."""
    turn_speed: Positive = 2.0
    """[rad/s] largest size of the rates of roll, pitch and yaw together."""
    turn_acceleration: Positive = 15.0
    """[rad/s^2] largest size of their accelerations together."""
    reserve: Annotated[Positive, Field(le=0.1)] = 0.005
    """[-] distance that is kept from every limit, in its unit or, for clearance, speeds and torques, as a share of the
    robot's size or of the limit."""
    _setup: tuple[np.ndarray, Callable[[], Space], tuple[float, float]] | None = PrivateAttr(None)

    def rules(self) -> None:
        """Columns are those of a pose, the address has a port."""
        self._order  # noqa: B018 - raises
        if self.udp is not None:
            address_of(self.udp)

    def bound(self, home: np.ndarray, space: Callable[[], Space], workspace: tuple[float, float] | None = None) -> Self:
        """The reference of a robot with a home (6,), its limits, and `safety.workspace`."""
        made = copy.copy(self)
        for name in ("params", "_recorded", "_targets"):
            made.__dict__.pop(name, None)
        made._setup = home, space, workspace or (np.inf, np.inf)
        return made

    @property
    def _robot(self) -> tuple[np.ndarray, Callable[[], Space], tuple[float, float]]:
        if self._setup is None:
            raise ConfigurationError("reference.kind", "stream", "another kind within a sum or an adjusted motion")
        return self._setup

    @property
    def home(self) -> np.ndarray:
        """(6,) [rad, m] where it begins."""
        return self._robot[0]

    @cached_property
    def params(self) -> StreamParams:
        """Numbers of its filter."""
        home, space = self.home, self._robot[1]()
        least, _ = at_rest(space, home.copy(), Probe.new())
        if least < self.reserve:
            allowed = f"less than the least relative margin of the robot at home, {least:.3g}"
            raise ConfigurationError("reference.reserve", self.reserve, allowed)
        bounds = {"speed": [self.turn_speed, self.speed], "acceleration": [self.turn_acceleration, self.acceleration]}
        workspace = _SHARE * np.array(self._robot[2])
        numbers = {"period": self.period, "reserve": self.reserve, "home": home, "workspace": workspace}
        return StreamParams.new(space=space, **numbers, **bounds)

    def part(self, ahead: float) -> Part:
        """The filter as a part of a loop, from the signal `target` (6,) to the reference now and `ahead` [s]."""
        if ahead > (ROWS - 1) * self.period:
            raise ConfigurationError("reference.period", self.period, f"at least {ahead / (ROWS - 1):.3g} s")
        params, home = self.params.copy(), np.concatenate([self.home, np.zeros(12)])
        params["ahead"] = ahead
        initial = StreamState.new(rows=home, target=self.home, reference=home, reference_ahead=home)
        inputs, outputs = {"target": 6, "time": 1}, ("reference", "reference_ahead")
        return Part("stream", stream_tick, {"params": params}, inputs, outputs, initial, (Probe,))

    def targets(self, times: np.ndarray) -> np.ndarray:
        """Targets (n, 6) of the file at times (n,) [s]; home without one."""
        if self.motion_file is None:
            return np.tile(self.home, (len(times), 1))
        rows = self._targets
        place = np.searchsorted(rows[:, 0] - rows[0, 0], np.asarray(times) + 1e-9, side="right") - 1
        return np.where(place[:, None] < 0, self.home, rows[place, 1:])

    @cached_property
    def _targets(self) -> np.ndarray:
        return load_recording(str(self.motion_file))

    @cached_property
    def _recorded(self) -> StreamMotion:
        return StreamMotion(self.params, self.home, self._target_at)

    def _target_at(self, time: float) -> np.ndarray:
        target: np.ndarray = self.targets(np.array([time]))[0]
        return target

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self._recorded.evaluate(time)

    def live(self, source: Targets | None = None) -> StreamMotion | None:
        """The motion by targets as they come, from Python or at `udp`; None without either."""
        if source is None and self.udp is not None:
            source = UdpTargets(self)
        return None if source is None else StreamMotion(self.params, self.home, source)

    @cached_property
    def _order(self) -> list[tuple[int, float]]:
        """Place of each coordinate in a line, and its factor to SI."""
        names = list(self.columns)
        chosen = (column_of(names, quantity, unit, "reference.columns") for quantity, unit in POSE)
        return [(names.index(name), factor) for name, factor in chosen]

    def target_of(self, line: bytes) -> np.ndarray:
        """Target (6,) in a line of text; NaN if it is none."""
        try:
            text = line.decode("ascii").strip()
            if ";" in text:
                text = text.replace(",", ".")
            words = text.rstrip(";,").split(";" if ";" in text else "," if "," in text else None)
            if len(words) != len(self.columns):
                return NO_TARGET
            target = np.array([float(words[place]) * factor for place, factor in self._order])
        except (ValueError, IndexError):
            return NO_TARGET
        if not np.isfinite(target).all():
            return NO_TARGET
        return target + self.home if self.relative else target


class StreamMotion:
    """The motion that follows targets; a period's row is made when it is first asked for, and kept.

    Args:
        params: Numbers of the filter.
        home: (6,) [rad, m] where it begins.
        source: The newest target at a time.

    Attributes:
        source: As given.
    """

    def __init__(self, params: StreamParams, home: np.ndarray, source: Targets) -> None:
        self._params, self._period, self.source = params, float(params["period"][0]), source
        self._rows, self._probe = np.zeros((1, 18)), Probe.new()
        self._count, self._target = 1, home.copy()
        self._rows[0, :6] = home

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pose, rate and acceleration (..., 6) at times (...) [s] from 0."""
        times = np.maximum(np.asarray(time, dtype=float), 0.0)
        places = np.floor(times / self._period + 1e-9).astype(int)
        for n in range(self._count, int(places.max(initial=0)) + 1):
            self._append(n)
        rows, left = self._rows[places], np.maximum(times - places * self._period, 0.0)[..., None]
        pose, rate, acceleration = rows[..., :6], rows[..., 6:12], rows[..., 12:]
        return pose + left * (rate + 0.5 * left * acceleration), rate + left * acceleration, acceleration.copy()

    def _append(self, n: int) -> None:
        if n >= len(self._rows):
            self._rows = np.concatenate([self._rows, np.zeros((max(256, n), 18))])
        target = np.asarray(self.source(n * self._period), dtype=float)
        if target.shape == (6,) and np.isfinite(target).all():
            self._target[:] = target
        stream_rows(self._params, np.stack([self._target] * 2), self._probe, self._rows[n - 1 : n + 1])
        self._count = n + 1

    def close(self) -> None:
        """Closes its source."""
        if isinstance(self.source, UdpTargets):
            self.source.close()


class UdpTargets:
    """Targets in datagrams; the newest that is a pose counts.

    Attributes:
        address: Host and port at which it listens.
    """

    def __init__(self, options: StreamReference) -> None:
        self._options, self._latest = options, NO_TARGET
        self._asked, self._read, self._dropped, self._last_dropped = False, 0, 0, b""
        host, port = address_of(str(options.udp))
        try:
            family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
            self._line = socket.socket(family, socket.SOCK_DGRAM)
            try:
                self._line.bind(address)
            except OSError:
                self._line.close()
                raise
        except OSError as error:
            allowed = f"an address of this computer with a free port ({error.strerror or error})"
            raise ConfigurationError("reference.udp", options.udp, allowed) from None
        self._line.setblocking(False)
        self.address = f"{host}:{self._line.getsockname()[1]}"

    @property
    def warning(self) -> tuple[int, str] | None:
        """Datagrams that were used, and a text where none came or some were dropped."""
        used = self._read - self._dropped
        if self._asked and not self._read:
            return used, f"no target came at {self.address}"
        if not self._dropped:
            return None
        last = repr(self._last_dropped.decode("ascii", "backslashreplace")[:80])
        wanted = f"{len(self._options.columns)} finite numbers"
        return used, f"{self._dropped} of {self._read} datagrams are not {wanted} and were dropped, the last {last}"

    def __call__(self, time: float) -> np.ndarray:  # noqa: ARG002
        self._asked = True
        for _ in range(_MOST_DATAGRAMS):
            try:
                line = self._line.recv(_LONGEST)
            except OSError:
                break
            target, self._read = self._options.target_of(line), self._read + 1
            if np.isfinite(target).all():
                self._latest = target
            else:
                self._dropped, self._last_dropped = self._dropped + 1, line
        return self._latest

    def close(self) -> None:
        """Frees the port."""
        self._line.close()


def address_of(text: str) -> tuple[str, int]:
    """Host and port of an address."""
    host, colon, port = text.rpartition(":")
    if not (colon and host and port.isdecimal() and int(port) < 65536):
        raise ConfigurationError("reference.udp", text, "HOST:PORT, such as 127.0.0.1:4444")
    return host.strip("[]"), int(port)
