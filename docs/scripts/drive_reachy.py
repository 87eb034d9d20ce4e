"""Drives the daemon of Reachy Mini's maker; writes docs/results/drive.md and its picture: `make drive`, ten minutes.

The daemon is the maker's own, unchanged, in its simulation; docs/scripts/reachy_daemon.py installs and starts it.
"""

import math
import os
import socket
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from reachy_daemon import install, start, wake

from stewart_drake import SimulationLog, load_scenario, run
from stewart_drake.base.markdown import markdown_table
from stewart_drake.control.adaptation import last_learnt, model_of, rows_of
from stewart_drake.logs.outcomes import RunRows
from stewart_drake.machines.machine import MachineError, Reading, open_machine
from stewart_drake.mechanics.kinematics import forward_kinematics, inverse_kinematics
from stewart_drake.plotting.style import save_figure, styled
from stewart_drake.reachy.machine import ReachyMachine
from stewart_drake.reachy.moves import Move
from stewart_drake.reachy.possible_moves import motion_of, shaped_move
from stewart_drake.runs.drive import Drive, connected
from stewart_drake.scenario.scenario import load_driven

ROOT = Path(__file__).parents[2]
OUT, FOLDER = ROOT / "docs" / "results", ROOT / "build" / "reachy_daemon"
WORKERS = 3  # Daemons at a time; one takes a tenth of a core.
POSE_AGE = 0.002  # [s] by which the pose of a tick is older than its angles: a step of the daemon's simulation.
LOOK = {
    "poses": [
        *([0, 0, 0.5, 0, 0, 0.177], [0, -0.2, -0.4, 0, 0, 0.182], [0, 0.25, -0.3, 0, 0, 0.177]),
        *([0.25, 0, 0.2, 0, 0.005, 0.177], [0, 0, 0, 0, 0, 0.177]),
    ],
    "durations": [0.8, 1.0, 0.7, 0.9, 0.7],
    "dwell": [0.2, 0.3, 0.3, 0.3, 0.3],
}
ROUND = 5.5  # [s] of looking around once.
BREATHING = {"kind": "sine", "amplitude": [0, 0, 0, 0, 0, 0.005], "angular_frequency": "0.1 Hz"}
FREE = {"bounds": {"rotation": None, "position": None, "motion_ratio": None, "error_ratio": None}}


def looks(rounds: int) -> dict[str, Any]:
    """Looking around some times, from home."""
    return {
        "kind": "minimum_jerk",
        "poses": [[0, 0, 0, 0, 0, 0.177], *LOOK["poses"] * rounds],
        "durations": LOOK["durations"] * rounds,
        "dwell": LOOK["dwell"] * rounds,
    }


MOTIONS: Mapping[str, tuple[float, float, Mapping[str, Any]]] = {
    "nod": (8.0, 60.0, {}),
    "look around": (2 * ROUND, 8 * ROUND, {"reference": looks(8)}),
    "breathing": (20.0, 40.0, {"reference": BREATHING}),
}
"""Seconds of a motion, and those where something is learnt, half of which are for that; its changes."""


class Scheme(NamedTuple):
    """A row of the page: changes of `reachy_daemon`, and whether it learns from a cold start."""

    changes: Mapping[str, Any]
    learns: bool = False


FREE_JOINTS = {"model.friction.joints": None}
UNKNOWN_JOINTS = {"model.friction.joints.viscous": 0.0, "model.friction.joints.coulomb": 0.0}
LEARNING = {"adaptation": {"kind": "regression", "ball_joints": True, "noise": 0.06, "slowest": 0.05}}
PLAIN, EXACT, LEARNT = "angles of the inverse kinematics", "exact model", "learning, ball joints believed free"
SCHEMES: Mapping[str, Scheme] = {
    PLAIN: Scheme(
        {
            "controller.feedforward": "none",
            "model.friction": None,
            "model.motors": {"kind": "position", "preset": "perfect_actuator", "damping": 0.0},
        }
    ),
    "exact model, ball joints believed free": Scheme(FREE_JOINTS),
    EXACT: Scheme({}),
    "learning, but not ball joints": Scheme({**FREE_JOINTS, **LEARNING, "adaptation.ball_joints": False}, True),
    LEARNT: Scheme({**UNKNOWN_JOINTS, **LEARNING}, True),
    "learning, ball joints as the file has them": Scheme(LEARNING, True),
}
ENDS = PLAIN, EXACT
FROZEN, CLOCK = "what looking around taught, frozen", "by wall clock at 100 Hz"


@contextmanager
def daemon(folder: Path) -> Iterator[str]:
    """The URL of a daemon whose head is at home; it is installed in a folder, if it is not there yet."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    process = start(folder, port)
    # On a busy machine it would stall; not everybody may ask for that.
    with suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, process.pid, -15)
    try:
        wake(port)
        yield f"reachy://127.0.0.1:{port}"
    finally:
        process.terminate()
        process.wait()


STALLS = ("stale_reading", "late", "machine")


class Stalled(Exception):
    """A run in which the machine, or the daemon, did nothing for too long."""


def afresh(what: Callable[..., Any], *given: Any) -> Any:
    """What a function makes of the URL of a daemon that has just started; where that stalls, of another."""
    for _ in range(2):
        with suppress(Stalled), daemon(FOLDER) as url:
            return what(url, *given)
    with daemon(FOLDER) as url:
        return what(url, *given)


def driven(url: str, scheme: str | Scheme, motion: str) -> SimulationLog:
    """One of the page."""
    what = SCHEMES[scheme] if isinstance(scheme, str) else scheme
    short, long, more = MOTIONS[motion]
    scenario = load_driven("reachy_daemon").replace({**FREE, **what.changes, **more})
    machine = open_machine(url, scenario)
    log = Drive(scenario, machine, connected(scenario, machine, long if what.learns else short)).run()
    if log.status != "completed":
        raise (Stalled if log.reason in STALLS else RuntimeError)(f"{scheme}, {motion}: {log.message}")
    return log


class Figures(NamedTuple):
    """Of the second half of a motion: RMS errors, and that of the velocity above 2 Hz."""

    rotation: float  # [deg]
    position: float  # [mm]
    ripple: float  # [mm/s]


def pose_age(log: SimulationLog) -> float:
    """[s] of the poses in a log: where one came too late `drive` has taken all from the angles, which have no age."""
    middle = len(log.time) // 2
    of_angles = forward_kinematics(log.scenario.robot, log["reading"][middle], log["pose"][middle])
    return 0.0 if np.abs(of_angles - log["pose"][middle]).max() < 1e-9 else POSE_AGE


def figures(log: SimulationLog, age: float | None = None) -> Figures:
    """Errors of a log against its reference at the time of the poses, which are older than their rows by an age [s]."""
    age = pose_age(log) if age is None else age
    pose, rate, gain = (log[f"reference{name}"] for name in ("", "_rate", "_acceleration"))
    then = {"reference": pose - age * (rate - 0.5 * age * gain), "reference_rate": rate - age * gain}
    rows = RunRows(log.scenario, {**log.signals, **then})
    rotation, position = rows.second_half_rms_norms
    ripple = rows.ripple
    return Figures(math.degrees(rotation), 1e3 * position, math.nan if ripple is None else 1e3 * ripple[1])


def kept(log: SimulationLog) -> dict[str, Any]:
    """What a run has learnt, as `--keep-model` leaves it."""
    return {"model": {**log.scenario.model.given(), **model_of(last_learnt(log), log.scenario.controller_model)}}


class ByWallClock(ReachyMachine):
    """The daemon at a pace that is not its own, with its poses and when they arrived."""

    period = 0.01
    paced = False

    def connect(self) -> None:
        """And listens from then on: a pose that waits to be read would look late."""
        self.arrived: list[tuple[float, np.ndarray]] = []
        self.sent: list[float] = []
        self._listener = threading.Thread(target=self._listen, daemon=True)
        super().connect()
        self._listener.start()

    def read(self) -> Reading:
        """The newest, at once."""
        if not self._listener.is_alive():
            return super().read()
        return Reading(self._joints[1:].copy(), self._number * 0.02, time.monotonic() - self._arrived, self._number)

    def command(self, values: np.ndarray) -> None:
        """Notes when it was sent."""
        super().command(values)
        self.sent.append(time.monotonic())

    def _listen(self) -> None:
        seen = self._pose_number
        with suppress(MachineError):
            while self._take(1.0):
                if self._pose_number > seen:
                    seen = self._pose_number
                    self.arrived.append((time.monotonic(), self._pose.copy()))


def by_wall_clock(url: str, scheme: str, motion: str) -> tuple[float, float, float]:
    """RMS errors [deg], [mm] of a motion at 100 Hz by our own clock, at the times at which poses arrive.

    And seconds that pass in one of the daemon's.
    """
    short, long, more = MOTIONS[motion]
    what = SCHEMES[scheme]
    # A command is 0 to 10 ms old when a tick takes it, and acts for 20 ms; a reading is 0 to 20 ms old.
    clock = {"controller.period": ByWallClock.period, "model.motors.delay": 0.01, "model.reading_age": 0.01}
    scenario = load_driven("reachy_daemon").replace({**FREE, **what.changes, **more, **clock})
    host, port = url.removeprefix("reachy://").split(":")
    machine = ByWallClock(scenario, host, int(port))
    begin = connected(scenario, machine, long if what.learns else short)
    log = Drive(scenario, machine, begin).run()
    if log.status != "completed":
        raise (Stalled if log.reason in STALLS else RuntimeError)(f"{scheme}, {motion} by wall clock: {log.message}")
    origin = float(np.min(np.array(machine.sent) - log.time))
    arrivals = [arrived for arrived, _ in machine.arrived]
    clock_ratio = (arrivals[-1] - arrivals[0]) / (0.02 * (len(arrivals) - 1))
    at = np.array([arrived for arrived, _ in machine.arrived]) - origin - POSE_AGE
    half = (at > 0.5 * log.time[-1]) & (at < log.time[-1])
    error = np.array([pose for _, pose in machine.arrived])[half] - begin.motion.evaluate(at[half])[0]
    return (*_norms(error), clock_ratio)


def _norms(error: np.ndarray) -> tuple[float, float]:
    rotation, position = np.sqrt(np.mean(np.sum(error.reshape(-1, 2, 3) ** 2, axis=2), axis=0))
    return math.degrees(rotation), 1e3 * float(position)


def played(url: str, scheme: str | None, motion: str) -> tuple[float, float]:
    """RMS errors [deg], [mm] of a move that a player sends as angles of its poses, shaped by a scheme or as it is."""
    seconds, _, more = MOTIONS[motion]
    scenario = load_driven("reachy_daemon").replace({**FREE, **(SCHEMES[scheme].changes if scheme else {}), **more})
    machine = open_machine(url, scenario)
    motion_there = connected(scenario, machine, seconds).motion
    motion_there.stop(motion_there.duration(seconds) - 1.0)
    times = np.arange(0.0, motion_there.rests + 0.2, machine.period)
    pose = motion_there.evaluate(times)[0]
    move = Move(motion, times, pose, np.zeros((len(times), 2)), np.zeros(len(times)))
    sent = shaped_move(scenario, move)[0].pose if scheme else pose
    angles, told = inverse_kinematics(scenario.controller_model.robot, sent), []
    for row in angles:
        told.append(machine.read())
        machine.command(row)
    machine.disconnect()
    numbers = np.array([reading.number for reading in told]) - told[0].number
    at = numbers * machine.period - POSE_AGE
    known = np.array([reading.pose is not None for reading in told]) & (at > 0.5 * times[-1]) & (at < times[-1])
    error = [reading.pose for reading, use in zip(told, known, strict=True) if use] - motion_of(move).evaluate(
        at[known]
    )[0]
    return _norms(np.array(error))


PLANT = {
    "plant": {"kind": "mujoco", "model_file": "reachy_mini", "motor_class": "perfect_actuator", "time_step": 0.002},
    "motors": {"kind": "position", "preset": "perfect_actuator", "delay": 0.02, "period": 0.002},
    "robot.effort_limit": 20.0,
    "sensors": {"kind": "encoders", "resolution_bits": 0},
}
"""The daemon's plant in our own loop, without the daemon."""
AXES = {"model.friction.joints.crank_axes": [[0, 0, 0]] * 6, "model.friction.joints.platform_axes": None}
NO_JOINTS = {"plant.passive_friction": 0.0, "plant.passive_armature": 0.0, **FREE_JOINTS}
NO_FRICTION = {"plant.motor_friction": 0.0, "plant.motor_damping": 0.0, "model.friction": None}
LIMITS: Mapping[str, Mapping[str, Any]] = {
    "exact model": {},
    "axes of the ball joints' dry friction along the rods": AXES,
    "ball joints free, in the file too": NO_JOINTS,
    "no friction at all, in the file too": {**NO_JOINTS, **NO_FRICTION},
    "the same, simulated in steps of 0.5 ms": {
        **{**NO_JOINTS, **NO_FRICTION},
        **{"plant.time_step": 0.0005, "motors.period": 0.0005},
    },
}


def simulated(changes: Mapping[str, Any], motion: str) -> Figures:
    """A motion on the maker's model, in our loop."""
    seconds, _, more = MOTIONS[motion]
    control = load_driven("reachy_daemon").to_dict()
    keys = {name: control[name] for name in ("model", "reference", "controller")}
    keys |= {"robot": "reachy_mini", "safety": None, "command_delay": 0, "tuner": "block", "estimator": "difference"}
    scenario = load_scenario("reachy_nod").replace({**keys, **PLANT, **FREE})
    return figures(run(scenario.replace({**changes, **more, "duration": seconds}), check=False), 0.0)


@styled
def draw(logs: Mapping[tuple[str, str], SimulationLog]) -> Figure:
    """The pitch of two nods, and the error of the pitch of three."""
    figure = Figure((7.5, 5.2), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[3, 2])
    rows = (
        *((PLAIN, "#d55e00", "angles of the inverse kinematics"), (EXACT, "#0072b2", "exact model")),
        (LEARNT, "#009e73", "learning, ball joints believed free"),
    )
    for name, color, label in rows:
        log = logs[name, "nod"]
        wanted = log["reference"][:, 1] - pose_age(log) * log["reference_rate"][:, 1]
        # Of the last whole seconds of a nod, from one zero of it.
        last = math.floor(log.time[-1]) - 4.0
        zeros = np.flatnonzero((wanted[:-1] < 0.0) & (wanted[1:] >= 0.0) & (log.time[:-1] > last))
        part = slice(zeros[0], zeros[0] + 100)
        time = log.time[part] - log.time[zeros[0]]
        if name == PLAIN:
            above.plot(time, np.degrees(wanted[part]), color="0.75", lw=6, label="wanted")
        above.plot(time, np.degrees(log["pose"][part, 1]), color=color, label=label)
        if name != PLAIN:
            below.plot(time, np.degrees(log["pose"][part, 1] - wanted[part]), color=color)
    above.set(ylabel="pitch [deg]", title="A nod through the maker's daemon")
    below.set(xlabel="time [s]", ylabel="error [deg]")
    figure.legend(*above.get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure


TEXT = """# Through the maker's own daemon

`stewart-drake drive` against the daemon of `reachy_mini` 1.12.0, unchanged, in its own MuJoCo simulation, through its
web socket: 50 Hz, in step with its ticks. RMS errors over the second half, lag included; ripple is the error of the
velocity above 2 Hz. A nod is 15 deg at 1 Hz, breathing 5 mm at 0.1 Hz. Rows that learn begin cold: they have
{nod:.0f} s of nodding, {look:.0f} s of looking around, {breathing:.0f} s of breathing, and learn in the first half.

{table}

![Pitch of a nod over time, and its error](drive.png)

- **Angles of the inverse kinematics** is what its owners send.
- **Exact model** is `drive reachy_daemon`: nothing is learnt; the numbers are those of the maker's MJCF, where the ball
  joints of the rods have a motor's friction. A real head hardly has such joints, and its motors have other numbers: see
  [Reachy Mini](reachy.md) for those.
- **Learning**: `--set adaptation="{{kind: regression, noise: 0.06, slowest: 0.05}}"`, and
  `ball_joints: true` but in the first of these rows. Believed free: which joints rub and about which axes is told,
  their friction is believed to be zero. `noise` is what the model leaves unexplained. With the default, 0.003, most of
  this would be taken for pushes at first.
- **What looking around taught**: the model that this left with ball joints believed free, as `--keep-model` does.
  Frozen, it is an identification from commands and angles alone.

Each figure is of a daemon that has just started and risen to home; a run in which it stalls is made again, at most
twice. Its rods turn about themselves as it moves, which
turns the axes of their dry friction. The daemon tells its head's pose of a step, 2 ms, before the angles of the same
tick; errors are at the pose's time.

## What was learnt

Looking around, with ball joints believed free, after {look:.0f} s. The file has 0.1 N m and 0.15 N m s/rad in motors
and in ball joints. What the numbers have in common hardly shows in commands and angles: see the interval of the torque.

{learnt}

## By wall clock, and with another player

| | nod [deg], [mm] | look around [deg], [mm] |
| --- | --- | --- |
{others}

- By wall clock commands go out 100 times a second, whenever the daemon's ticks come. Its clock runs {slow:.1f} % slow
  here, and all that turns on time, damping first, is then another number. It runs otherwise each time: in three such
  tables, one made after another, the nod with learning was 0.7 to 1.6 deg.
- The shaped moves are those of `moves export --shaped reachy_daemon`. The player sends the angles of the inverse
  kinematics of their poses, one row a tick, as any player does.

## Asked for and reached

{asked}

[What is left, and why](#what-is-left-and-why) tells the limits.

## What is left, and why

The maker's model in our own loop, without the daemon, `plant: {{kind: mujoco, model_file: reachy_mini}}`, and the exact
model without learning.

{limits}

- **Axes of dry friction.** MuJoCo's ball joints have dry friction about three axes of the body that hangs in them.
  `model.friction.joints` has these axes from the file; with those of the rods errors are larger.
- **Its reversal.** MuJoCo's friction loss is proportional to the rate at low speeds, of a slope that depends on the
  body, and turns some ms before the motion does. The model has one width for all joints, and no lead. Learning takes
  that for damping or delay: it fits the motion that it sees, and with the file's numbers at hand it is no gain.
- Without any friction the rest is that of 50 Hz and of the simulation's steps.

The daemon's clock stalls, here for {age:.0f} ms at most. `drive` counts its ticks and stays in step.

Made by `make drive`, with the daemon that it installs under build/, 400 MB.
`make results` recomputes some of these numbers.
"""
HEADER = (
    *("", "nod [deg], [mm]", "look around [deg], [mm]", "ripple of both [mm/s]", "breathing [mm]", "its ripple [mm/s]"),
)


def cells(found: Mapping[str, Figures]) -> list[str]:
    """Of a row."""
    nod, look, breathing = (found[motion] for motion in MOTIONS)
    errors = [f"{each.rotation:.3f} / {each.position:.3f}" for each in (nod, look)]
    return [*errors, f"{nod.ripple:.2f} / {look.ripple:.2f}", f"{breathing.position:.3f}", f"{breathing.ripple:.3f}"]


def goals(
    rows: Mapping[str, Mapping[str, Figures]], others: Mapping[str, Sequence[Sequence[float]]]
) -> list[tuple[str, str, str]]:
    """What was asked for and what is reached: of rows by motion, and of errors [deg], [mm] of nod and look around."""
    nod, look = (rows[LEARNT][motion] for motion in ("nod", "look around"))
    clock = {name: [each[0] for each in others[f"{CLOCK}: {name}"]] for name in (EXACT, LEARNT)}
    return [
        ("identified (frozen): nod", "0.3 deg", f"{rows[FROZEN]['nod'].rotation:.3f} deg"),
        ("learning: nod", "0.05 deg", f"{nod.rotation:.3f} deg"),
        ("learning: look around", "0.15 deg", f"{look.rotation:.3f} deg"),
        ("learning: ripple of both", "0.4 mm/s", f"{nod.ripple:.2f} and {look.ripple:.2f} mm/s"),
        *(
            (f"{CLOCK}, {name}: both", "0.15 deg", "{:.2f} and {:.2f} deg".format(*clock[key]))
            for name, key in (("exact model", EXACT), ("learning", LEARNT))
        ),
    ]


def main() -> None:
    """Starts the daemon, drives, and writes the page."""
    if not (FOLDER / "installed").exists():
        install(FOLDER)
    fast, schemes = ("nod", "look around"), dict(SCHEMES)
    with ProcessPoolExecutor(WORKERS) as pool:

        def drives(names: Sequence[str]) -> dict[tuple[str, str], SimulationLog]:
            rows = {
                (name, motion): pool.submit(afresh, driven, schemes[name], motion)
                for name in names
                for motion in MOTIONS
            }
            return {row: log.result() for row, log in rows.items()}

        logs = drives(list(SCHEMES))
        taught = kept(logs[LEARNT, "look around"])
        schemes |= {
            FROZEN: Scheme(taught),
            "the same, learning on": Scheme({**taught, **LEARNING}),
        }
        logs |= drives(list(schemes)[len(SCHEMES) :])
        ways: dict[str, tuple[Callable[..., Any], str | None]] = {
            **{f"{CLOCK}: {name}": (by_wall_clock, name) for name in (PLAIN, EXACT, LEARNT)},
            "an ordinary player, moves as they are": (played, None),
            "an ordinary player, shaped moves": (played, EXACT),
        }
        waiting = {
            name: [pool.submit(afresh, what, by, motion) for motion in fast] for name, (what, by) in ways.items()
        }
        others = {name: [each.result() for each in found] for name, found in waiting.items()}
    rows = {name: {motion: figures(logs[name, motion]) for motion in MOTIONS} for name in schemes}
    table = [(name, *cells(found)) for name, found in rows.items()]
    limits = [
        (name, *cells({motion: simulated(changes, motion) for motion in MOTIONS})) for name, changes in LIMITS.items()
    ]
    known = logs[LEARNT, "look around"]
    learnt = rows_of(last_learnt(known))
    save_figure(draw(logs), OUT / "drive.png")
    values = {
        **{motion.partition(" ")[0]: long for motion, (_, long, _) in MOTIONS.items()},
        "table": markdown_table(HEADER, table),
        "limits": markdown_table(HEADER, limits),
        "learnt": markdown_table(("", "learnt"), [(name.removeprefix("learnt: "), text) for name, text in learnt]),
        "others": "\n".join(
            f"| {name} | {' | '.join(f'{deg:.2f} / {mm:.2f}' for deg, mm, *_ in found)} |"
            for name, found in others.items()
        ),
        "asked": markdown_table(("", "asked for", "reached"), goals(rows, others)),
        "age": 1e3 * max(float(log["reading_age"].max()) for log in logs.values()),
        "slow": 100.0 * (others[f"{CLOCK}: {EXACT}"][0][2] - 1.0),
    }
    (OUT / "drive.md").write_text(TEXT.format(**values), encoding="utf-8")


if __name__ == "__main__":
    main()
