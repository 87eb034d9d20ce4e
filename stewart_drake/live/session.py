"""A live loop in real time: what the browser asks for goes in, what it draws comes out."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from stewart_drake.errors import StewartDrakeError
from stewart_drake.live.loop import LiveLoop
from stewart_drake.scenario import Scenario

SLICE = 0.02
"""[s] of simulated time between two looks at the clock and at what the browser asks for."""
LATEST = 0.5
"""[s] behind the clock from which on the loop gives up catching up: the robot then runs slower than it should."""
CONTROLLERS: Mapping[str, Mapping[str, Any]] = {
    "as in the scenario": {},
    "LQI, exact model": {
        "controller": {"kind": "lqi", "model": "exact", "feedforward": "full", "feedforward_at": "reference"},
        "tuner": "block",
    },
    "PID of each motor": {"controller": "pid"},
    "computed torque": {"controller": "computed_torque"},
}
"""What can be chosen in the panel: name -> scenario key -> value."""
PANEL = {"plant.payload_mass", "motors.dead", "sensors.faults", "tuner.kappa"}
"""Keys of the scenario that the panel changes."""


class LiveSession:
    """Paces a `LiveLoop` by the clock and answers commands; `show` draws the robot, some 50 times a second."""

    def __init__(self, scenario: Scenario, show: Callable[[LiveLoop], None]) -> None:
        self.loop, self._show = LiveLoop(scenario), show
        self._own = {key: value for key, value in scenario.to_dict().items() if key in ("controller", "tuner")}
        self._commands: queue.SimpleQueue[Mapping[str, Any]] = queue.SimpleQueue()
        self.paused, self.factor, self.message = False, 1.0, ""
        self._listeners: list[queue.SimpleQueue[dict[str, Any]]] = []
        self._do = {
            "aim": self._aim,
            "move": lambda told: self.loop.move(bool(told["on"])),
            "push": lambda told: self.loop.push(_six(told["wrench"]), float(told["duration"])),
            "change": self._change,
            "controller": self._choose,
            "pause": self._pause,
            "reset": self._reset,
        }

    def tell(self, command: Mapping[str, Any]) -> None:
        """Hands over a command of the browser; from any thread."""
        self._commands.put(command)

    def listen(self) -> queue.SimpleQueue[dict[str, Any]]:
        """A queue that gets every row from now on; from any thread."""
        listener: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        self._listeners.append(listener)
        return listener

    def leave(self, listener: queue.SimpleQueue[dict[str, Any]]) -> None:
        """Ends `listen`."""
        self._listeners.remove(listener)

    def run(self, until: float = np.inf) -> None:
        """Runs for some seconds of the clock [s]; by default until KeyboardInterrupt."""
        loop, began = self.loop, time.monotonic()
        steps = max(1, round(SLICE / loop.scenario.plant.time_step))
        due = time.monotonic()
        window = (due, loop.time)
        while time.monotonic() - began < until:
            while not self._commands.empty():
                self._obey(self._commands.get())
            if not self.paused:
                loop.advance(steps)
            due += SLICE
            late = time.monotonic() - due
            if late > LATEST:
                due = time.monotonic()
            self._show(loop)
            now = time.monotonic()
            if now - window[0] >= 1.0:
                self.factor = (loop.time - window[1]) / (now - window[0])
                window = (now, loop.time)
            self._publish()
            if (rest := due - time.monotonic()) > 0.0:
                time.sleep(rest)

    def _obey(self, command: Mapping[str, Any]) -> None:
        self.message = ""
        try:
            self._do[command["do"]](command)
        except StewartDrakeError as error:
            self.message = " ".join(str(error).split())
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            self.message = f"not understood: {error}"

    def _aim(self, told: Mapping[str, Any]) -> None:
        reached = self.loop.aim(_six(told["pose"]))
        if reached.limit:
            self.message = f"as far as it goes: {reached.limit}"

    def _change(self, told: Mapping[str, Any]) -> None:
        # The page has these and no others: what asks must not name code, files or another robot.
        if not set(told["keys"]) <= PANEL:
            raise ValueError(f"keys {', '.join(told['keys'])}")
        self.loop.change(told["keys"])

    def _choose(self, told: Mapping[str, Any]) -> None:
        self.loop.change({**self._own, **CONTROLLERS[told["name"]]})

    def _pause(self, told: Mapping[str, Any]) -> None:
        self.paused = bool(told["on"])

    def _reset(self, _: Mapping[str, Any]) -> None:
        self.loop.reset()

    def _publish(self) -> None:
        row = self.row()
        for listener in tuple(self._listeners):
            listener.put(row)

    def row(self) -> dict[str, Any]:
        """What the browser draws of this instant."""
        loop = self.loop
        error = loop.pose - loop.wanted
        setting, safety = loop.logged("setting"), loop.logged("safety")
        return {
            "time": loop.time,
            "factor": 0.0 if self.paused else self.factor,
            "rotation_deg": float(np.degrees(np.linalg.norm(error[:3]))),
            "position_mm": float(1e3 * np.linalg.norm(error[3:])),
            "torque": loop.torque.tolist(),
            "setting": None if setting is None else setting.tolist(),
            "safety": None if safety is None else int(safety[0]),
            "target": loop.reference.hand.target.tolist(),
            "pose": loop.pose.tolist(),
            "pushed": loop.pushed,
            "paused": self.paused,
            "ended": loop.ended,
            "message": self.message,
        }


def _six(values: Any) -> np.ndarray:
    six = np.array(values, dtype=float).reshape(6)
    if not np.isfinite(six).all():
        raise ValueError(f"{six} is not finite")
    return six
