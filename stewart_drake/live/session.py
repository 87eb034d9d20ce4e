"""A live loop in real time: commands of the browser in, rows to draw out."""

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

from stewart_drake.base.atomic_files import Document, plain_json
from stewart_drake.base.errors import ConfigurationError, StewartDrakeError, one_line
from stewart_drake.base.real_time import Pace
from stewart_drake.base.tables import COORDINATES
from stewart_drake.live.ball import AWAY, BallHand, ball_target
from stewart_drake.live.instrument import (
    Spring,
    TestMotion,
    TurningSpring,
    changes_of_slider,
    for_live_page,
    slider_value,
    sliders_of,
    spring,
    turning_spring,
)
from stewart_drake.live.loop import LiveLoop
from stewart_drake.live.steering import REACH
from stewart_drake.logs.signals import DISPLAY_UNITS, SCALES
from stewart_drake.mechanics.kinematics import rotation_matrix
from stewart_drake.robot import RobotParameters
from stewart_drake.runs.outputs import new_run_folder
from stewart_drake.runs.scene import link_poses
from stewart_drake.safety import standstill_text
from stewart_drake.scenario.scenario import Scenario

SLICE = 0.02  # [s] of simulated time between two rows; commands are handled in between.
MAX_LATENESS = 0.5  # [s] A loop that is later does not catch up: it then runs slower than real time.
Command = Document  # From a page, as JSON; `do` is its name.
PageRow = dict[str, object]  # Values for a page, by name.
CONTROLLERS: Mapping[str, Mapping[str, object]] = {
    "as in the scenario": {},
    "LQI, exact model": {
        "controller": "lqi",
        **{"controller.model": "exact", "controller.feedforward": "full", "controller.feedforward_at": "reference"},
        "tuner": "block",
    },
    "PID of each motor": {"controller": "pid"},
    "computed torque": {"controller": "computed_torque"},
}
"""Controllers of the panel: name -> scenario key -> value."""
LARGEST = 1e6  # Largest number that a page may send.
ROWS_KEPT = 50  # A page that is further behind misses rows.
COMMANDS_KEPT = 200  # Commands that may wait for the loop.


class PageSession:
    """Commands from pages to a loop and rows from the loop to pages; usable from any thread."""

    def __init__(self) -> None:
        self.name, self.message = secrets.token_hex(4), ""
        self._commands: queue.Queue[tuple[int, Command]] = queue.Queue(COMMANDS_KEPT)
        self._received = self._obeyed = 0
        self._rows: deque[str] = deque(maxlen=ROWS_KEPT)
        self._published, self._news, self._receiving = 0, threading.Condition(), threading.Lock()
        # A page cannot name keys of the scenario, and so no code, file or other robot.
        self._do: Mapping[str, Callable[[Command], object]] = {}

    def put(self, command: Command) -> int:
        """Queues a command; returns its number, which rows repeat once it is done. Raises queue.Full."""
        with self._receiving:
            self._commands.put_nowait((self._received + 1, command))
            self._received += 1
            return self._received

    def rows_after(self, count: int, timeout: float) -> tuple[int, list[str]]:
        """Count of rows so far, and those after the first `count` as JSON; waits for one up to `timeout` [s]."""
        with self._news:
            self._news.wait_for(lambda: self._published > count, timeout)
            late = min(self._published - count, len(self._rows))
            return self._published, list(self._rows)[len(self._rows) - late :]

    def obey(self) -> None:
        """Executes the queued commands."""
        while not self._commands.empty():
            self._obey(*self._commands.get())

    def _obey(self, number: int, command: Command) -> None:
        self.message, self._obeyed = "", number
        try:
            self._do[command["do"]](command)
        except StewartDrakeError as error:
            self.message = one_line(error)
        except Exception as error:  # Whatever a page sends, the loop goes on.
            self.message = f"not understood: {one_line(error)}"

    def curves(self) -> PageRow:
        """Curves of the latest test; called by other threads."""
        return {}

    def publish(self, row: PageRow) -> None:
        """Publishes a row to the pages."""
        # Numbers that are not finite become null, as JSON has none.
        text = json.dumps(plain_json(row))
        with self._news:
            self._rows.append(text)
            self._published += 1
            self._news.notify_all()


class LiveSession(PageSession):
    """Runs a `LiveLoop` in real time, executes commands, and publishes 50 rows per second."""

    def __init__(self, scenario: Scenario) -> None:
        super().__init__()
        scenario = for_live_page(scenario)
        self.loop = LiveLoop(scenario)
        self.ghost: LiveLoop | None = None
        self._ghost_name, self.speed, self._initial = "", 1.0, scenario
        self._knobs: tuple[Scenario | None, list[PageRow]] = (None, [])
        self._scenario_choice = {
            key: value for key, value in scenario.to_dict().items() if key in ("controller", "tuner")
        }
        self.paused, self.factor, self._controller = False, 1.0, next(iter(CONTROLLERS))
        self._do = {
            "aim": self._aim,
            "move": lambda command: self._for_all(lambda loop: loop.move(bool(command["on"]))),
            "push": self._push,
            "pull": self._pull,
            "turn": self._turn,
            "release": self._release,
            "hold": self._hold_ball,
            "let_go": lambda _: self._with_ball(lambda hand, _: hand.let_go()),
            "throw": self._throw,
            "ball_target": self._aim_ball,
            "payload": lambda command: self._change({"plant.payload_mass": _number(command["mass"])}),
            "dead": lambda command: self._change({"motors.dead": _leg_key(command["leg"])}),
            "freeze": self._freeze,
            "kappa": lambda command: self.loop.change({"tuner.kappa": _number(command["value"])}),
            "knob": self._set_knob,
            "controller": self._choose,
            "ghost": self._add_ghost,
            "test": self._begin_test,
            "pause": self._pause,
            "step": self._one_tick,
            "speed": self._set_speed,
            "save": self._save,
            "reset": self._reset,
        }

    def run(self, until: float = np.inf) -> None:
        """Runs for some time [s]; by default until KeyboardInterrupt."""
        loop, began, pace = self.loop, time.monotonic(), Pace(SLICE, MAX_LATENESS)
        steps = max(1, round(SLICE / loop.scenario.plant.time_step))
        window = (began, loop.time)
        while time.monotonic() - began < until:
            self.obey()
            if not self.paused:
                self._for_all(lambda loop: loop.advance(max(1, round(steps * self.speed))))
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

    def _for_all(self, do: Callable[[LiveLoop], object]) -> None:
        """Applies a function to the robot and, if there is one, to its ghost."""
        for loop in filter(None, (self.loop, self.ghost)):
            do(loop)

    def _change(self, changes: Mapping[str, object]) -> None:
        self._for_all(lambda loop: loop.change(changes))

    def _push(self, command: Command) -> None:
        wrench, duration = as_six(command["wrench"]), _number(command["duration"])
        self._touch()
        self._for_all(lambda loop: loop.push(wrench, duration))

    def _pull(self, command: Command) -> None:
        """Pulls `point` (3,) [m] of the platform, in P, towards `place` (3,) [m] in B."""
        point, place = (_numbers(command[name], 3) for name in ("point", "place"))
        self._hold(spring(self.loop.scenario.robot, self.loop.scenario.gravity_in_base, point, place))

    def _turn(self, command: Command) -> None:
        """Turns by `turn` (3,) [rad], a rotation vector in B, from the orientation at the start of the pull."""
        scenario, before = self.loop.scenario, self.loop.spring
        held = before.held if isinstance(before, TurningSpring) else rotation_matrix(self.loop.pose[:3])
        self._hold(turning_spring(scenario.robot, scenario.gravity_in_base, held, _numbers(command["turn"], 3)))

    def _hold(self, by: Spring | TurningSpring) -> None:
        self._touch()
        self._for_all(lambda loop: setattr(loop, "spring", by))

    def _touch(self) -> None:
        """Switches off the monitor of motors: a hand at the rim loads one motor as a fault would."""
        safety = self.loop.scenario.safety
        if safety is not None and safety.unexplained_torque is not None:
            self._change({"safety.unexplained_torque": None})

    def _hand_text(self) -> str:
        """What `_touch` has switched off, as long as it is."""
        begun, now = self._initial.safety, self.loop.scenario.safety
        off = begun is not None and now is not None and begun.unexplained_torque and now.unexplained_torque is None
        texts = ["a hand acts on it: safety.unexplained_torque is off until Reset"] if off else []
        if self.loop.ball is not None and self.loop.ball.fell is not None:
            texts.append(f"the ball fell off; it is put back after {AWAY:g} s")
        return "; ".join(texts)

    def _release(self, _: Command) -> None:
        self._for_all(lambda loop: setattr(loop, "spring", None))

    def _hold_ball(self, command: Command) -> None:
        """Holds the ball to `place` (2,) [m] on the plate."""
        place = _numbers(command["place"], 2)
        self._with_ball(lambda hand, _: hand.hold(place))

    def _throw(self, command: Command) -> None:
        """Changes the ball's velocity by `velocity` (2,) [m/s]."""
        velocity = _numbers(command["velocity"], 2)
        self._with_ball(lambda hand, time: hand.throw(velocity, time))

    def _with_ball(self, do: Callable[[BallHand, float], None]) -> None:
        if self.loop.ball is None:
            raise ConfigurationError("ball", None, "a section: this scenario has no ball")
        self._touch()
        for loop in filter(None, (self.loop, self.ghost)):
            if loop.ball is not None:
                do(loop.ball, loop.time)

    def _aim_ball(self, command: Command) -> None:
        """Sets the ball's target to `place` (2,) [m], or to that of the scenario if it is null."""
        ball, control = self._initial.ball, self._initial.ball_control
        if ball is None or control is None:
            raise ConfigurationError("ball_control", None, "a section: nothing balances a ball here")
        target = control.target.to_dict()
        if command["place"] is not None:
            place = _numbers(command["place"], 2)
            if np.linalg.norm(place) > ball.plate.radius:
                raise ConfigurationError("target", place.tolist(), f"a place on the plate, of {ball.plate.radius:g} m")
            target |= {"center": place.tolist(), "radius": 0.0, "motion": None}
        self._change({"ball_control.target": target})

    def _set_knob(self, command: Command) -> None:
        """Sets a slider. Gains and model of the ghost stay."""
        sliders, key = {slider.key: slider for slider in sliders_of(self.loop.scenario, self._initial)}, command["key"]
        if (slider := sliders.get(key)) is None:
            raise ConfigurationError("slider", key, f"one of {', '.join(sliders)}")
        change = changes_of_slider(self.loop.scenario, slider, _number(command["value"]))
        (self._change if slider.group == "Machine" else self.loop.change)(change)

    def _add_ghost(self, command: Command) -> None:
        """Adds a second robot with another controller, in the state of the first, or removes it."""
        name = command["controller"]
        self.ghost, self._ghost_name = None, ""
        if name is not None:
            self.ghost, self._ghost_name = self.loop.copy_with({**self._scenario_choice, **CONTROLLERS[name]}), name

    def _begin_test(self, command: Command) -> None:
        axis, loop = COORDINATES.index(command["axis"]), self.loop
        size = _number(command["size"])
        given, shift = round(float(SCALES[axis] * size), 6), size * np.eye(6)[axis]
        if size == 0.0:
            raise ConfigurationError("amplitude", given, "a number other than 0")
        for limit, most in _most_of_test(loop, axis, command["kind"] == "step").items():
            if abs(size) > most:
                allowed = f"at most {SCALES[axis] * most:.3g} {DISPLAY_UNITS[axis]} here; {limit}"
                raise ConfigurationError("amplitude", given, allowed)
        for ends in (shift,) if command["kind"] == "step" else (shift, -shift):
            reached = loop.reference.reach(loop.scenario, loop.reference.goal + ends)
            if reached.limit:
                most = SCALES[axis] * abs(reached.pose - loop.reference.goal)[axis]
                allowed = f"at most {most:.3g} {DISPLAY_UNITS[axis]} here; {reached.limit}"
                raise ConfigurationError("amplitude", given, allowed)
        frequency = min(max(_number(command.get("frequency", 1.0)), 0.2), 20.0)
        kind = "step" if command["kind"] == "step" else "sine"
        self._for_all(lambda loop: setattr(loop, "test", TestMotion(kind, axis, size, frequency, loop.time)))

    def curves(self) -> PageRow:
        """Axis, reference and response of the latest test, and the response of the second robot."""
        test, pale = self.loop.test, None if self.ghost is None else self.ghost.test
        if test is None:
            return {}
        beside = None if pale is None else pale.curves()["response"]
        return {"axis": test.axis, "beside": beside, **test.curves()}

    def _one_tick(self, _: Command) -> None:
        self.paused = True
        self._for_all(lambda loop: loop.advance(round(loop.scenario.controller.period / loop.scenario.plant.time_step)))

    def _set_speed(self, command: Command) -> None:
        self.speed = min(max(_number(command["value"]), 0.1), 2.0)

    def _save(self, _: Command) -> None:
        scenario = self.loop.scenario.replace({"name": f"{self.loop.scenario.name}-by-hand"})
        with new_run_folder(scenario) as folder:
            self.loop.record.save(folder, scenario)
        self.message = f"saved in {folder}: log.csv, and scenario.yaml, with motion, pushes and the last settings"

    def _freeze(self, command: Command) -> None:
        leg = _leg_key(command["leg"])
        self._change({"sensors.faults": [] if leg is None else [{"kind": "freeze", **leg}]})

    def _choose(self, command: Command) -> None:
        self.loop.change({**self._scenario_choice, **CONTROLLERS[command["name"]]})
        self._controller = command["name"]

    def _pause(self, command: Command) -> None:
        self.paused = bool(command["on"])

    def _reset(self, _: Command) -> None:
        self.loop.reset()
        self.ghost, self._ghost_name = None, ""
        self._controller = next(iter(CONTROLLERS))

    def _knob_rows(self) -> list[PageRow]:
        scenario = self.loop.scenario
        if self._knobs[0] is not scenario:
            sliders = sliders_of(scenario, self._initial)
            rows: list[PageRow] = [{**item._asdict(), "value": slider_value(scenario, item)} for item in sliders]
            self._knobs = scenario, rows
        return self._knobs[1]

    def row(self) -> PageRow:
        """State for the browser: robot, loop, and all settings of the panel."""
        loop, scenario = self.loop, self.loop.scenario
        robots = [(each.pose, each.crank_angles, _ball_links(each)) for each in (loop, self.ghost) if each is not None]
        pull = moment = None
        if isinstance(loop.spring, TurningSpring):
            moment = loop.spring.moment(loop.pose)
        elif loop.spring is not None:
            at, force = loop.spring.force(loop.pose)
            pull = {"at": at, "place": loop.spring.place, "force": np.linalg.norm(force)}
        test = "" if loop.test is None else loop.test.text
        if self.ghost is not None and self.ghost.test is not None and self.ghost.test.complete:
            test += f"; pale, {self._ghost_name}: {self.ghost.test.text.partition(': ')[2]}"
        safety = loop.logged("safety")
        frozen = [fault.leg for fault in scenario.sensors.faults if fault.kind == "freeze"]
        return {
            "session": self.name,
            "obeyed": self._obeyed,
            "time": loop.time,
            "factor": 0.0 if self.paused else self.factor,
            **drawn(scenario.robot, loop.wanted, *robots),
            "ball": _ball_row(loop),
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
            "ghost": self._ghost_name,
            "beside": None if (pale := self.ghost) is None else _beside(pale),
            "pull": pull,
            "moment": moment,
            "test": test,
            "knobs": self._knob_rows(),
            "ended": loop.ended,
            "cause": loop.cause,
            "message": self.message if (still := loop.stillness.latest) is None else standstill_text(*still),
            "hand": self._hand_text(),
        }


def _most_of_test(loop: LiveLoop, axis: int, step: bool) -> dict[str, float]:
    """Bounds on the amplitude [rad, m] of a test: what sets it -> largest; a step is a following error at first."""
    off = abs(loop.reference.goal - loop.reference.home)[axis]
    most, safety = {"the range of the sliders": float(REACH[axis] - off)}, loop.scenario.safety
    if step and safety is not None and safety.following_error is not None:
        most["safety.following_error"] = 0.99 * safety.following_error[axis // 3]
    return most


def _ball_row(loop: LiveLoop) -> PageRow | None:
    """Place and target of the ball on the plate, and its distance from there; None without a ball or while it falls."""
    if loop.ball is None or loop.ball.fell is not None:
        return None
    place, target = loop.ball_motion[:2], ball_target(loop.scenario, loop.time)
    return {"place": place, "target": target, "away_m": np.linalg.norm(place - target)}


def _beside(pale: LiveLoop) -> PageRow:
    away = None if (ball := _ball_row(pale)) is None else ball["away_m"]
    return {**_errors(pale.pose, pale.wanted), "ended": pale.ended, "away_m": away}


def _ball_links(loop: LiveLoop) -> np.ndarray:
    """(2, 7), see `BallHand.drawn`; (0, 7) without a ball."""
    if loop.ball is None:
        return np.empty((0, 7))
    return loop.ball.drawn(loop.scenario, loop.time, loop.pose, loop.ball_motion)


def drawn(robot: RobotParameters, wanted: np.ndarray, *robots: tuple[np.ndarray, ...]) -> PageRow:
    """Pose, errors and links of a robot by pose (6,), crank angles (6,) and links of a ball, and links of a second."""
    links = []
    for pose, angles, *balls in robots:
        of_robot = link_poses(robot, pose, angles, wanted) if np.isfinite([pose, angles]).all() else np.empty((0, 7))
        links.append(np.concatenate([of_robot[:-1], *balls, of_robot[-1:]]) if len(of_robot) else of_robot)
    # The disc of the reference is drawn once.
    flat = np.concatenate([links[0], *(link[:-1] for link in links[1:])]).round(6).ravel() if len(links[0]) else None
    return {"pose": robots[0][0], **_errors(robots[0][0], wanted), "links": flat}


def _errors(pose: np.ndarray, wanted: np.ndarray) -> dict[str, float]:
    off = pose - wanted
    return {
        "rotation_deg": float(np.degrees(np.linalg.norm(off[:3]))),
        "position_m": float(np.linalg.norm(off[3:])),
    }


def _leg_key(leg: object) -> dict[str, int] | None:
    return None if leg is None else {"leg": int(_number(leg))}


def as_six(values: object) -> np.ndarray:
    """Six numbers up to `LARGEST`; ValueError otherwise."""
    return _numbers(values, 6)


def _numbers(values: object, count: int) -> np.ndarray:
    numbers = np.array(values, dtype=float).reshape(count)
    if not (np.abs(numbers) <= LARGEST).all():
        raise ValueError(f"{numbers} is no number up to {LARGEST:g}")
    return numbers


def _number(value: Any) -> float:
    return float(_numbers(float(value), 1)[0])
