"""Reachy Mini through its maker's daemon: the web socket `/ws/sdk`, angles in, angles out at 50 Hz."""

from __future__ import annotations

import json
import time
from contextlib import ExitStack
from typing import Any

import numpy as np

from stewart_drake.base.errors import installed_with
from stewart_drake.machines.machine import (
    LOST,
    PATIENCE,
    MachineError,
    Reading,
    Takes,
    check_takes,
    command_limits,
    within_limits,
)
from stewart_drake.scenario.scenario import Scenario

TICK = 0.02
"""[s] of the daemon between two messages of a kind; it sends one in each of its ticks, and no time stamp."""
PAIR = 0.003
"""[s] after the angles of a tick in which its pose is expected."""
HEAD_HEIGHT = 0.177
"""[m] of the origin in which `head_pose` is told, above the robot's base frame B."""


class ReachyMachine:
    """The daemon of `reachy_mini`, real or `--sim`; its clock is the count of its ticks.

    The body keeps the yaw that it has when the connection opens. The daemon acknowledges nothing, and while it plays a
    move or wakes up it drops commands without a word. With motors that are off, readings say `holding`.
    """

    period: float | None = TICK
    takes: Takes = "angle"
    reads = True
    paced = True

    def __init__(self, scenario: Scenario, host: str, port: int) -> None:
        check_takes(scenario, self.takes, "reachy")
        self._limits, self._url = command_limits(scenario), f"ws://{host}:{port}/ws/sdk"
        self._stack, self._socket = ExitStack(), None
        self.disconnect()

    def connect(self) -> None:
        """Opens the socket and waits for the first angles."""
        with installed_with("stewart-drake[machines]"):
            from websockets.exceptions import WebSocketException
            from websockets.sync.client import connect
        self._errors = (OSError, EOFError, WebSocketException)
        try:
            opened = connect(self._url, open_timeout=5.0, close_timeout=0.2, compression=None, proxy=None, max_queue=None)
            self._socket = self._stack.enter_context(opened)
        except self._errors as error:
            allowed = "does the daemon run? See docs/machines.md"
            raise MachineError(f"no daemon of Reachy Mini at {self._url} ({_line(error)}); {allowed}") from None
        self._arrived = time.monotonic()
        while self._number < 0:
            self.read()

    def read(self) -> Reading:
        """The next tick of the daemon."""
        last, deadline = self._number, time.monotonic() + PATIENCE * TICK
        while (left := deadline - time.monotonic()) > 0.0 and (message := self._receive(left)) is not None:
            self._take(message)
            # Of the tick that has begun comes the pose; what else is there already is newer, or of no use here.
            if self._number > last:
                deadline = min(deadline, self._arrived + PAIR if self._pose_number < self._number else 0.0)
        while (message := self._receive(0.0)) is not None:
            self._take(message)
        age = time.monotonic() - self._arrived
        if age > LOST:
            raise MachineError(f"Reachy Mini's daemon has sent no angles for {age:.1f} s")
        pose = self._pose.copy() if self._pose_number == self._number else None
        return Reading(self._angles.copy(), self._number * TICK, age, self._number, 0.0, self._off, pose)

    def command(self, values: np.ndarray) -> None:
        """Sends six angles (6,) [rad], behind the yaw of the body: with six alone the daemon would stop for good."""
        joints = [self._yaw, *within_limits(values, self._limits).tolist()]
        try:
            self._opened().send(json.dumps({"type": "set_head_joints", "joints": joints}))
        except self._errors as error:
            raise MachineError(f"the connection to Reachy Mini's daemon is lost ({_line(error)})") from None

    def disconnect(self) -> None:
        """Closes the socket; the daemon holds the last angles."""
        self._stack.close()
        self._socket, self._number, self._pose_number, self._arrived = None, -1, -1, 0.0
        self._angles, self._yaw, self._pose, self._off = np.zeros(6), 0.0, np.zeros(6), False

    def _opened(self) -> Any:
        if self._socket is None:
            raise MachineError("Reachy Mini is not connected; call connect first")
        return self._socket

    def _receive(self, timeout: float) -> Any:
        """The next message; None where none has come in a time [s]."""
        try:
            return json.loads(self._opened().recv(timeout=timeout)) or {}
        except TimeoutError:
            return None
        except ValueError:
            return {}
        except self._errors as error:
            raise MachineError(f"the connection to Reachy Mini's daemon is lost ({_line(error)})") from None

    def _take(self, message: Any) -> None:
        """Notes what a message says; what is no message that is known here, or has bad numbers, is passed over."""
        kind = message.get("type") if isinstance(message, dict) else None
        if kind == "joint_positions" and (joints := _numbers(message.get("head_joint_positions"), 7)) is not None:
            self._yaw = float(joints[0]) if self._number < 0 else self._yaw
            self._angles, self._arrived, self._number = joints[1:], time.monotonic(), self._number + 1
            self._body = float(joints[0])
        elif kind == "head_pose" and (matrix := _numbers(message.get("head_pose"), 16)) is not None:
            self._pose, self._pose_number = _pose(matrix.reshape(4, 4), self._body), self._number
        elif kind == "daemon_status":
            self._off = (message.get("backend_status") or {}).get("motor_control_mode") != "enabled"


def _numbers(given: Any, count: int) -> np.ndarray | None:
    try:
        numbers = np.ravel(np.array(given, dtype=float))
    except (TypeError, ValueError):
        return None
    return numbers if numbers.shape == (count,) and np.isfinite(numbers).all() else None


def _pose(head: np.ndarray, yaw: float) -> np.ndarray:
    """Pose (6,) [rad, m] of P in B of `head_pose` (4, 4), which is told in the world, and the yaw of the body [rad]."""
    cosine, sine = np.cos(yaw), np.sin(yaw)
    turned = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]]) @ head[:3]
    roll, pitch = np.arctan2(turned[2, 1], turned[2, 2]), np.arcsin(np.clip(-turned[2, 0], -1.0, 1.0))
    return np.array([roll, pitch, np.arctan2(turned[1, 0], turned[0, 0]), *turned[:, 3] + [0.0, 0.0, HEAD_HEIGHT]])


def _line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
