"""Reachy Mini through the manufacturer's daemon: web socket `/ws/sdk`, angles in and out at 50 Hz."""

from __future__ import annotations

import json
import time
from contextlib import ExitStack, suppress
from typing import Any

import numpy as np

from stewart_drake.base.atomic_files import Document
from stewart_drake.base.errors import installed_with
from stewart_drake.machines import machine
from stewart_drake.machines.machine import MachineError, Reading, Takes
from stewart_drake.machines.tick_clock import TickClock
from stewart_drake.reachy.moves import pose_of_head
from stewart_drake.scenario.scenario import Scenario

TICK = 0.02  # [s] Nominal tick of the daemon: one message of each kind per tick, without a time stamp.
PERIOD_TICKS = 25  # Ticks from which the period is measured.
POSE_TIMEOUT = 0.003  # [s] from the angles of a tick to its pose.


class ReachyMachine:
    """The daemon of `reachy_mini`, real or `--sim`. Its ticks are measured: they are 5 to 8 % longer than nominal.

    The body keeps the yaw at which the connection opens. The daemon acknowledges nothing; while it plays a move or
    wakes up it drops commands silently. While the motors are off, readings are `holding`.
    """

    default_port = 8000
    period: float | None = TICK
    takes: Takes = "angle"
    reads = True
    paced = True
    after = "the daemon keeps its motors on, and holds"
    _imu: np.ndarray | None = None  # Inertial reading since the last `read`.

    def __init__(self, scenario: Scenario, host: str, port: int) -> None:
        machine.check_takes(scenario, self.takes, "reachy")
        self._limits, self._url, self._stack = (
            machine.command_limits(scenario),
            f"ws://{host}:{port}/ws/sdk",
            ExitStack(),
        )
        self.name = f"reachy://{host}:{port}"
        self.first = f"; wake it first: curl -X POST {host}:{port}/api/move/play/wake_up"
        self._errors: tuple[type[Exception], ...] = (OSError, EOFError)
        self._socket: Any = None
        self.disconnect()

    def connect(self) -> None:
        """Opens the socket and waits for the first angles."""
        with installed_with("stewart-drake[machines]"):
            from websockets.exceptions import WebSocketException
            from websockets.sync.client import connect
        self.disconnect()
        self._errors = (OSError, EOFError, WebSocketException)
        # No limit of the queue: `read` empties it and uses the newest message.
        options: Document = {"compression": None, "proxy": None, "max_queue": None}
        try:
            opened = connect(self._url, open_timeout=5.0, close_timeout=0.2, **options)
            self._socket = self._stack.enter_context(opened)
        except self._errors as error:
            raise MachineError(self.name, f"no daemon of Reachy Mini answers there; does it run? ({error})") from None
        self._arrived, clock = time.monotonic(), TickClock(TICK, known=0.0)
        while self._number < PERIOD_TICKS:
            clock.take(self.read())
        self.period = clock.tick

    def read(self) -> Reading:
        """The next tick of the daemon."""
        last, deadline = self._number, time.monotonic() + machine.PERIODS_TO_WAIT * TICK
        while (left := deadline - time.monotonic()) > 0.0 and self._take(left):
            if self._number > last:
                deadline = min(deadline, self._arrived + POSE_TIMEOUT if self._pose_number < self._number else 0.0)
        while self._take(0.0):
            pass
        age = time.monotonic() - self._arrived
        if age > machine.LOST_AFTER:
            sent = f"; it sent {self._strange}" if self._strange else ""
            raise MachineError(self.name, f"the daemon has sent no angles for {age:.1f} s{sent}")
        pose = self._pose.copy() if self._pose_number == self._number else None
        imu, self._imu = self._imu, None
        return Reading(self._joints[1:].copy(), self._arrived, age, self._number, 0.0, self._off, pose, imu=imu)

    def command(self, values: np.ndarray) -> None:
        """Sends the yaw of the body and six angles (6,) [rad]; with six alone the daemon would stop."""
        joints = [self._yaw, *machine.within_limits(values, self._limits, self.name).tolist()]
        try:
            self._opened().send(json.dumps({"type": "set_head_joints", "joints": joints}))
        except self._errors as error:
            raise MachineError(self.name, f"the connection is lost ({error})") from None

    def disconnect(self) -> None:
        """Closes the socket; the daemon holds the last angles."""
        with suppress(*self._errors):
            self._stack.close()
        self._socket = None
        self._number, self._pose_number, self._arrived, self._off = -1, -1, 0.0, False
        self._joints, self._yaw, self._pose, self._strange = np.zeros(7), 0.0, np.zeros(6), ""
        self._imu = None

    def _opened(self) -> Any:
        if self._socket is None:
            raise MachineError(self.name, "not connected; call connect first")
        return self._socket

    def _take(self, timeout: float) -> bool:
        """Handles the next message; False if none arrives in a time [s]. An invalid message is ignored."""
        try:
            text = self._opened().recv(timeout=timeout)
        except TimeoutError:
            return False
        except self._errors as error:
            raise MachineError(self.name, f"the connection is lost ({error})") from None
        try:
            self._handle(json.loads(text))
        except Exception:  # No message may end a drive.
            self._strange = f"{text[:60]!r}"
        return True

    def _handle(self, message: Document) -> None:
        """Handles a message; raises any exception if it is invalid."""
        kind = message["type"]
        if kind == "joint_positions":
            joints = _numbers(message["head_joint_positions"], 7, machine.LARGEST_ANGLE)
            self._yaw = float(joints[0]) if self._number < 0 else self._yaw
            self._joints, self._arrived, self._number = joints, time.monotonic(), self._number + 1
        elif kind == "head_pose":
            matrix = _numbers(message["head_pose"], 16).reshape(4, 4)
            self._pose, self._pose_number = pose_of_head(matrix, float(self._joints[0])), self._number
        elif kind == "imu_data":
            # The wireless version: rad/s and m/s^2, in axes and at a place that `model.imu` has.
            self._imu = np.concatenate([_numbers(message[name], 3) for name in ("gyroscope", "accelerometer")])
        elif kind == "daemon_status":
            self._off = (message.get("backend_status") or {}).get("motor_control_mode") != "enabled"


def _numbers(given: object, count: int, largest: float = 1e6) -> np.ndarray:
    numbers = np.ravel(np.array(given, dtype=float))
    if numbers.shape != (count,) or not (np.abs(numbers) <= largest).all():
        raise ValueError(f"expected {count} numbers up to {largest:g}")
    return numbers
