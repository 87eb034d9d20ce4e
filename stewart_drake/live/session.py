"""A live loop in real time: what the browser asks for goes in, what it draws comes out."""

from __future__ import annotations

import json
import queue
import secrets
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from stewart_drake.base.atomic_files import plain_json
from stewart_drake.base.errors import ConfigurationError, StewartDrakeError, one_line
from stewart_drake.base.real_time import Pace
from stewart_drake.base.tables import COORDINATES
from stewart_drake.live.instrument import (
    AddedMotion,
    Spring,
    TurningSpring,
    changes_of_slider,
    for_live_page,
    knob_value,
    knobs_of,
    spring,
    turning_spring,
)
from stewart_drake.live.loop import LiveLoop
from stewart_drake.mechanics.kinematics import rotation_matrix
from stewart_drake.robot import RobotParameters
from stewart_drake.runs.outputs import claimed_place
from stewart_drake.runs.scene import link_poses
from stewart_drake.safety import standstill_text
from stewart_drake.scenario.scenario import Scenario

SLICE, LATEST = 0.02, 0.5
"""[s] of simulated time between two looks at the clock and at what the browser asks for; [s] behind the clock from
which on the loop gives up catching up: the robot then runs slower than it should."""
CONTROLLERS: Mapping[str, Mapping[str, Any]] = {
    "as in the scenario": {},
    "LQI, exact model": {
        "controller": "lqi",
        **{"controller.model": "exact", "controller.feedforward": "full", "controller.feedforward_at": "reference"},
        "tuner": "block",
    },
    "PID of each motor": {"controller": "pid"},
    "computed torque": {"controller": "computed_torque"},
}
"""What can be chosen in the panel: name -> scenario key -> value."""
Command = Mapping[str, Any]
"""What a page asks for: `do`, the name of an action, and its arguments; all of it is to be checked."""
LARGEST = 1e6  # Number that a page may send.
ROWS_KEPT, COMMANDS_KEPT = 50, 200
"""Rows that a page may be late, one that reads more slowly misses some; commands that may wait for the loop."""


class PageSession:
    """What pages and a loop say to each other, from any thread: commands in, rows out."""

    def __init__(self) -> None:
        self.name, self.message = secrets.token_hex(4), ""
        self._commands: queue.Queue[tuple[int, Any]] = queue.Queue(COMMANDS_KEPT)
        self._received = self._obeyed = 0
        self._rows: deque[str] = deque(maxlen=ROWS_KEPT)
        self._published, self._news, self._receiving = 0, threading.Condition(), threading.Lock()
        # What asks can name no key of the scenario, and so no code, file or other robot.
        self._do: Mapping[str, Callable[[Command], Any]] = {}

    def tell(self, command: Any) -> int:
        """Hands over a command from any thread; its number, which rows have once obeyed; queue.Full if many wait."""
        with self._receiving:
            self._commands.put_nowait((self._received + 1, command))
            self._received += 1
            return self._received

    def rows_after(self, count: int, timeout: float) -> tuple[int, list[str]]:
        """How many rows there were, and those kept after the first `count`, as JSON; waits for one up to a time [s]."""
        with self._news:
            self._news.wait_for(lambda: self._published > count, timeout)
            late = min(self._published - count, len(self._rows))
            return self._published, list(self._rows)[len(self._rows) - late :]

    def obey(self) -> None:
        """Does what has been asked for."""
        while not self._commands.empty():
            self._obey(*self._commands.get())

    def _obey(self, number: int, command: Any) -> None:
        self.message, self._obeyed = "", number
        try:
            self._do[command["do"]](command)
        except StewartDrakeError as error:
            self.message = one_line(error)
        except Exception as error:  # Whatever a page sends, the loop goes on.
            self.message = f"not understood: {one_line(error)}"

    def publish(self, row: Mapping[str, Any]) -> None:
        """Tells pages how things are."""
        # A number that is not finite is null: JSON has none, and a page that cannot read a row stands still.
        text = json.dumps(plain_json(row))
        with self._news:
            self._rows.append(text)
            self._published += 1
            self._news.notify_all()


class LiveSession(PageSession):
    """Paces a `LiveLoop` by the clock, answers commands, and tells in rows, some 50 a second, how things are."""

    def __init__(self, scenario: Scenario) -> None:
        super().__init__()
        scenario = for_live_page(scenario)
        self.loop = LiveLoop(scenario)
        self.ghost: LiveLoop | None = None
        self._ghosts, self.speed, self._test, self._begun = "", 1.0, "", scenario
        self._knobs: tuple[Scenario | None, list[dict[str, Any]]] = (None, [])
        self._own = {key: value for key, value in scenario.to_dict().items() if key in ("controller", "tuner")}
        self.paused, self.factor, self._controller = False, 1.0, next(iter(CONTROLLERS))
        self._do = {
            "aim": self._aim,
            "move": lambda command: self._each(lambda loop: loop.move(bool(command["on"]))),
            "push": self._push,
            "pull": self._pull,
            "turn": self._turn,
            "release": self._release,
            "payload": lambda command: self._change({"plant.payload_mass": _number(command["mass"])}),
            "dead": lambda command: self._change({"motors.dead": _leg_key(command["leg"])}),
            "freeze": self._freeze,
            "kappa": lambda command: self.loop.change({"tuner.kappa": _number(command["value"])}),
            "knob": self._set_knob,
            "controller": self._choose,
            "ghost": self._add_second_robot,
            "test": self._begin_test,
            "pause": self._pause,
            "step": self._one_tick,
            "speed": self._set_speed,
            "save": self._save,
            "reset": self._reset,
        }

    def run(self, until: float = np.inf) -> None:
        """Runs for some seconds of the clock [s]; by default until KeyboardInterrupt."""
        loop, began, pace = self.loop, time.monotonic(), Pace(SLICE, LATEST)
        steps = max(1, round(SLICE / loop.scenario.plant.time_step))
        window = (began, loop.time)
        while time.monotonic() - began < until:
            self.obey()
            if not self.paused:
                self._each(lambda loop: loop.advance(max(1, round(steps * self.speed))))
            pace.advance()
            if (now := time.monotonic()) - window[0] >= 1.0:
                self.factor = (loop.time - window[1]) / (now - window[0])
                window = (now, loop.time)
            self.publish(self.row())
            pace.wait()

    def _aim(self, command: Command) -> None:
        reached = self.loop.aim(as_six(command["pose"]))
        if self.ghost is not None:
            self.ghost.reference.goal = reached.pose
        if reached.limit:
            self.message = f"as far as it goes: {reached.limit}"

    def _each(self, do: Callable[[LiveLoop], Any]) -> None:
        """For the robot and for its ghost."""
        for loop in filter(None, (self.loop, self.ghost)):
            do(loop)

    def _change(self, changes: Mapping[str, Any]) -> None:
        self._each(lambda loop: loop.change(changes))

    def _push(self, command: Command) -> None:
        wrench, duration = as_six(command["wrench"]), _number(command["duration"])
        self._touch()
        self._each(lambda loop: loop.push(wrench, duration))

    def _pull(self, command: Command) -> None:
        """`point` (3,) [m] of the platform, in P, towards `place` (3,) [m] in B."""
        point, place = (_numbers(command[name], 3) for name in ("point", "place"))
        self._hold(spring(self.loop.scenario.robot, self.loop.scenario.gravity, point, place))

    def _turn(self, command: Command) -> None:
        """By `turn` (3,) [rad], a rotation vector in B, from how the platform stood when the hand took it."""
        scenario, before = self.loop.scenario, self.loop.spring
        held = before.held if isinstance(before, TurningSpring) else rotation_matrix(self.loop.pose[:3])
        self._hold(turning_spring(scenario.robot, scenario.gravity, held, _numbers(command["turn"], 3)))

    def _hold(self, by: Spring | TurningSpring) -> None:
        self._touch()
        self._each(lambda loop: setattr(loop, "spring", by))

    def _touch(self) -> None:
        """A hand at the rim loads one motor as a wrong one does, so the safety layer no longer looks for those."""
        safety = self.loop.scenario.safety
        if safety is not None and safety.unexplained_torque is not None:
            self._change({"safety.unexplained_torque": None})
            self.message = "a hand acts on it: safety.unexplained_torque is off until Reset"

    def _release(self, _: Command) -> None:
        self._each(lambda loop: setattr(loop, "spring", None))

    def _set_knob(self, command: Command) -> None:
        """A slider: only keys that the panel has, within their range; of the controller's side not the ghost's."""
        knobs, key = {each.key: each for each in knobs_of(self.loop.scenario, self._begun)}, command["key"]
        if (knob := knobs.get(key)) is None:
            raise ConfigurationError("slider", key, f"one that there is now: {', '.join(knobs)}")
        change = changes_of_slider(self.loop.scenario, knob, _number(command["value"]))
        (self._change if knob.group == "Machine" else self.loop.change)(change)

    def _add_second_robot(self, command: Command) -> None:
        """A second robot beside the first, with another controller; from where the first is."""
        name = command["controller"]
        self.ghost, self._ghosts = None, ""
        if name is not None:
            self.ghost, self._ghosts = self.loop.copy_with({**self._own, **CONTROLLERS[name]}), name

    def _begin_test(self, command: Command) -> None:
        axis, robot = COORDINATES.index(command["axis"]), self.loop.scenario.robot
        size = 0.01 * (1.0 if axis < 3 else robot.characteristic_length)
        frequency = min(max(_number(command.get("frequency", 1.0)), 0.2), 20.0)
        kind = "step" if command["kind"] == "step" else "sine"
        self._each(lambda loop: setattr(loop, "test", AddedMotion(kind, axis, size, frequency, loop.time)))
        at = f", {frequency:g} Hz" if kind == "sine" else ""
        self._test = f"{kind} of {COORDINATES[axis]}{at}: under way"

    def _one_tick(self, _: Command) -> None:
        self.paused = True
        self._each(lambda loop: loop.advance(round(loop.scenario.controller.period / loop.scenario.plant.time_step)))

    def _set_speed(self, command: Command) -> None:
        self.speed = min(max(_number(command["value"]), 0.1), 2.0)

    def _save(self, _: Command) -> None:
        scenario = self.loop.scenario.replace({"name": f"{self.loop.scenario.name}-by-hand"})
        with claimed_place(scenario) as folder:
            self.loop.record.save(folder, scenario)
        self.message = f"saved in {folder}: log.csv, and scenario.yaml, with motion, pushes and the last settings"

    def _freeze(self, command: Command) -> None:
        leg = _leg_key(command["leg"])
        self._change({"sensors.faults": [] if leg is None else [{"kind": "freeze", **leg}]})

    def _choose(self, command: Command) -> None:
        self.loop.change({**self._own, **CONTROLLERS[command["name"]]})
        self._controller = command["name"]

    def _pause(self, command: Command) -> None:
        self.paused = bool(command["on"])

    def _reset(self, _: Command) -> None:
        self.loop.reset()
        self.ghost, self._ghosts, self._test = None, "", ""
        self._controller = next(iter(CONTROLLERS))

    def _knob_rows(self) -> list[dict[str, Any]]:
        scenario = self.loop.scenario
        if self._knobs[0] is not scenario:
            knobs = knobs_of(scenario, self._begun)
            self._knobs = scenario, [{**each._asdict(), "value": knob_value(scenario, each)} for each in knobs]
        return self._knobs[1]

    def row(self) -> dict[str, Any]:
        """What the browser shows of this instant: robot, loop, and everything that a panel can set."""
        loop, scenario = self.loop, self.loop.scenario
        robots = [(each.pose, each.crank_angles) for each in (loop, self.ghost) if each is not None]
        pull = moment = None
        if isinstance(loop.spring, TurningSpring):
            moment = loop.spring.moment(loop.pose)
        elif loop.spring is not None:
            at, force = loop.spring.force(loop.pose)
            pull = {"at": at, "place": loop.spring.place, "force": np.linalg.norm(force)}
        if loop.test is not None and loop.test.result:
            self._test = loop.test.result
            if self.ghost is not None and self.ghost.test is not None and self.ghost.test.result:
                self._test += f"; pale, {self._ghosts}: {self.ghost.test.result.partition(': ')[2]}"
        safety = loop.logged("safety")
        frozen = [fault.leg for fault in scenario.sensors.faults if fault.kind == "freeze"]
        return {
            "session": self.name,
            "obeyed": self._obeyed,
            "time": loop.time,
            "factor": 0.0 if self.paused else self.factor,
            **drawn(scenario.robot, loop.wanted, *robots),
            "torque": loop.torque,
            "setting": loop.logged("setting"),
            "safety": None if safety is None else int(safety[0]),
            "target": loop.reference.goal,
            "pushed": loop.pushed,
            "motion": bool(loop.reference.share.target[0]),
            "payload": scenario.plant.payload_mass,
            "dead": None if scenario.motors.dead is None else scenario.motors.dead.leg,
            "frozen": frozen[0] if frozen else None,
            "controller": self._controller,
            "kappa": getattr(scenario.tuner, "kappa", None),
            "paused": self.paused,
            "speed": self.speed,
            "ghost": self._ghosts,
            "beside": None if (pale := self.ghost) is None else _errors(pale.pose, pale.wanted) | {"ended": pale.ended},
            "pull": pull,
            "moment": moment,
            "test": self._test,
            "knobs": self._knob_rows(),
            "ended": loop.ended,
            "message": self.message if (still := loop.stillness.latest) is None else standstill_text(*still),
        }


def drawn(robot: RobotParameters, wanted: np.ndarray, *robots: tuple[np.ndarray, np.ndarray]) -> dict[str, Any]:
    """Pose, errors and links of a robot, by its pose (6,) and crank angles (6,), and links of a second one, pale."""
    links = [link_poses(robot, *each, wanted) if np.isfinite(each).all() else np.empty((0, 7)) for each in robots]
    # The disc of the reference comes once.
    flat = np.concatenate([links[0], *(each[:-1] for each in links[1:])]).round(6).ravel() if len(links[0]) else None
    return {"pose": robots[0][0], **_errors(robots[0][0], wanted), "links": flat}


def _errors(pose: np.ndarray, wanted: np.ndarray) -> dict[str, float]:
    off = pose - wanted
    return {
        "rotation_deg": float(np.degrees(np.linalg.norm(off[:3]))),
        "position_m": float(np.linalg.norm(off[3:])),
    }


def _leg_key(leg: Any) -> dict[str, int] | None:
    return None if leg is None else {"leg": int(_number(leg))}


def as_six(values: Any) -> np.ndarray:
    """Six numbers up to `LARGEST`; else a ValueError."""
    return _numbers(values, 6)


def _numbers(values: Any, count: int) -> np.ndarray:
    numbers = np.array(values, dtype=float).reshape(count)
    if not (np.abs(numbers) <= LARGEST).all():
        raise ValueError(f"{numbers} is no number up to {LARGEST:g}")
    return numbers


def _number(value: Any) -> float:
    return float(_numbers(float(value), 1)[0])
