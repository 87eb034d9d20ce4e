"""Error and time of every engine, docs/results/integrators.md: `make results/integrators`, five minutes."""

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from matplotlib.figure import Figure

from stewart_drake import DrakeOptions, RobotParameters, build_plant, load_scenario, run, run_metrics
from stewart_drake.base.markdown import markdown_table
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY, inverse_dynamics, static_torque
from stewart_drake.plant.closed_form import ClosedFormOptions
from stewart_drake.plotting.style import chart, save_figure

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
from mujoco_robot import MujocoRobot

OUT = Path(__file__).parents[1] / "results"
ROBOT, STILL = RobotParameters(), np.zeros(6)
TICK, TICKS = 0.001, 400  # [s] for which a torque is held, and how many of them there are.
AMPLITUDE = np.array([np.radians(16.0), np.radians(-8.0), np.radians(10.0), 0.01, -0.01, 0.025])
FRICTION = {"motor_friction": 0.05, "motor_damping": 0.02}
SHOWN = (1.0, 0.1)  # [ms] of the steps below that the tables have; the picture has all.
STEPS = {"drake": (1.0, 0.5, 0.25, 0.1), "euler": (1.0, 0.25, 0.1, 0.01), "rk4": (1.0, 0.5, 0.1)}  # [ms]
ENGINES = {
    name: ("duration=2", *keys)
    for name, keys in {
        "exact_fig7": (),
        "sway": (),
        "exact_breathing": (),
        "exact_heart": (),
        "hold": ("robot=servo_hexapod",),
    }.items()
}
TRACKING = ("exact_heart", "exact_breathing", "exact_fig7")


class Row(NamedTuple):
    """What an engine needs and how far it is off."""

    engine: str
    step: float  # [s].
    friction: bool
    error: float  # [mm] of the platform, the largest at a tick.
    seconds: float  # of processor time for a second.


def torques() -> np.ndarray:
    """(n, 6) [N m] of a motion by `AMPLITUDE` and back, each for the middle of its tick."""
    rate, made = 2.0 * np.pi / (TICK * TICKS), []
    for t in (np.arange(TICKS) + 0.5) * TICK:
        away = 0.5 * AMPLITUDE
        pose = ROBOT.home_pose + away * (1.0 - np.cos(rate * t))
        speed, acceleration = away * rate * np.sin(rate * t), away * rate**2 * np.cos(rate * t)
        made.append(inverse_dynamics(ROBOT, pose, speed, acceleration, STANDARD_GRAVITY))
    return np.array(made)


def stepped(options: ClosedFormOptions | DrakeOptions) -> tuple[Callable[[np.ndarray], None], Callable[[], np.ndarray]]:
    """A tick of a plant of the package, and where the platform is."""
    plant, count = options.make(ROBOT, STANDARD_GRAVITY), round(TICK / options.time_step)
    measured = [plant.initial(ROBOT.home_pose, STILL)]

    def tick(torque: np.ndarray) -> None:
        for _ in range(count):
            measured[0] = plant.step(torque, STILL)

    return tick, lambda: np.array(measured[0][3:6])


def in_mujoco(step: float, integrator: int) -> tuple[Callable[[np.ndarray], None], Callable[[], np.ndarray]]:
    """The same of MuJoCo."""
    robot = MujocoRobot(ROBOT, STANDARD_GRAVITY, DrakeOptions(time_step=step))
    robot.model.opt.integrator = integrator
    _, plant = build_plant(ROBOT)
    robot.set_state(plant, plant.assemble(ROBOT.home_pose))
    return (lambda torque: robot.advance(torque, round(TICK / step))), lambda: robot.platform[:3]


def measured(
    engine: str, step: float, friction: bool, made: tuple[Callable[[np.ndarray], None], Callable[[], np.ndarray]],
    truth: np.ndarray,
) -> Row:  # fmt: skip
    """A row, of a tick and where the platform is."""
    (tick, place), seconds, places = made, 0.0, []
    for torque in torques():
        begin = time.process_time()
        tick(torque)
        seconds += time.process_time() - begin
        places.append(place())
    error = float(np.linalg.norm(np.array(places) - truth, axis=1).max())
    return Row(engine, step, friction, 1e3 * error, seconds / (TICK * TICKS))


def truth(friction: bool, step: float | None = None) -> np.ndarray:
    """Where the platform is after each tick (n, 3) [m] by steps [s] of `rk4`, by default the finest."""
    keys = FRICTION if friction else {}
    step = step or (2e-6 if friction else 2e-5)
    tick, place = stepped(ClosedFormOptions(time_step=step, integrator="rk4", **keys))
    places = []
    for torque in torques():
        tick(torque)
        places.append(place())
    return np.array(places)


def rows() -> list[Row]:
    """All engines at all steps, without friction and with."""
    made, at = [], {friction: truth(friction) for friction in (False, True)}
    for friction, keys in ((False, {}), (True, FRICTION)):
        for ms in STEPS["drake"]:
            plant = stepped(DrakeOptions(time_step=1e-3 * ms, **keys))
            made.append(measured("Drake SAP", 1e-3 * ms, friction, plant, at[friction]))
        for integrator, name in (("semi_implicit", "euler"), ("rk4", "rk4")):
            for ms in STEPS[name]:
                plant = stepped(ClosedFormOptions(time_step=1e-3 * ms, integrator=integrator, **keys))
                plant[0](torques()[0])  # compiles
                plant = stepped(ClosedFormOptions(time_step=1e-3 * ms, integrator=integrator, **keys))
                made.append(measured(f"closed form, {integrator}", 1e-3 * ms, friction, plant, at[friction]))
    for name, integrator in (("euler", mujoco.mjtIntegrator.mjINT_EULER), ("rk4", mujoco.mjtIntegrator.mjINT_RK4)):
        for ms in STEPS[name]:
            plant = in_mujoco(1e-3 * ms, integrator)
            made.append(measured(f"MuJoCo, {name}", 1e-3 * ms, False, plant, at[False]))
    return made


def tracking() -> list[tuple[str, ...]]:
    """RMS position error [um] of shipped scenarios by integrator and step."""
    lines = []
    for name in TRACKING:
        scenario = load_scenario(name).replace({"plant": "closed_form"})
        ways = (("semi_implicit", 1e-3), ("rk4", 1e-3), ("semi_implicit", 2e-5), ("rk4", 1e-4))
        errors = []
        for integrator, step in ways:
            log = run(scenario.replace({"plant.integrator": integrator, "plant.time_step": step}), check=False)
            errors.append(f"{1e3 * run_metrics(log)['rmse_norm_mm']:.3g}")
        lines.append((f"`{name}`", *errors))
    return lines


def engines() -> list[tuple[str, ...]]:
    """Scenarios on all three engines: how far apart their runs are, and what a step of the plant takes."""
    lines = []
    for name, keys in ENGINES.items():
        scenarios = [
            load_scenario(name, keys).replace({"plant.kind": kind}) for kind in ("drake", "mujoco", "closed_form")
        ]
        logs, took = [run(each, check=False) for each in scenarios], []
        for each in scenarios:
            plant, (pose, rate) = each.plant.make(each.robot, each.gravity), each.start()
            torque = static_torque(each.robot, pose, each.gravity)
            seconds = []
            for _ in range(21):  # near the start, as without a controller it falls
                plant.initial(pose, rate)
                begin = time.process_time()
                for _ in range(25):
                    plant.step(torque, STILL)
                seconds.append(time.process_time() - begin)
            took.append(f"{1e6 * float(np.median(seconds)) / 25:.0f}")
        apart = [
            f"{1e6 * float(np.abs(one['pose'] - other['pose'])[:, 3:].max()):.2g}"
            for one, other in ((logs[0], logs[2]), (logs[1], logs[2]), (logs[0], logs[1]))
        ]
        lines.append((" ".join((f"`{name}`", *keys[1:])), *apart, " / ".join(took)))
    return lines


def draw(made: list[Row]) -> Figure:
    """Error against time, without friction."""
    curves = {}
    for engine in dict.fromkeys(row.engine for row in made):
        points = [row for row in made if row.engine == engine and not row.friction]
        curves[engine] = [row.seconds for row in points], [row.error for row in points]
    of_time, of_error = "processor time for a simulated second [s]", "largest error in 0.4 s [mm]"
    return chart("Error over processor time, without friction; a mark is a step", of_time, of_error, curves, "o-", "xy")


def main() -> None:
    """Writes the page and its picture."""
    made = rows()
    tables = {}
    for friction in (False, True):
        lines = [
            (row.engine, f"{1e3 * row.step:g} ms", f"{row.error:.1e} mm", f"{1e3 * row.seconds:.1f} ms")
            for row in made
            if row.friction == friction and round(1e3 * row.step, 6) in SHOWN
        ]
        tables[friction] = markdown_table(("engine", "step", "error", "processor time for a second"), lines)
    save_figure(draw(made), OUT / "integrators.png")
    header = ("scenario", "semi_implicit, 1 ms", "rk4, 1 ms", "semi_implicit, 0.02 ms", "rk4, 0.1 ms")
    parts = {"plain": tables[False], "rubbing": tables[True], "tracking": markdown_table(header, tracking())}
    text = TEXT.format(**parts, engines=markdown_table(OF_ENGINES, engines()))
    (OUT / "integrators.md").write_text(text, encoding="utf-8")


OF_ENGINES = (
    *("scenario, 2 s", "Drake, closed form [µm]", "MuJoCo, closed form [µm]", "Drake, MuJoCo [µm]"),
    "step: Drake / MuJoCo / closed form [µs]",
)
TEXT = """# How exact the engines are

How far is the platform off with each engine, and what does a second of simulation cost?
Command: `make results/integrators`, on
one core.

{plain}

![error against processor time](integrators.png)

- The paper's robot, moved by 25 mm and 16 deg and back in 0.4 s by torques that are held for 1 ms. The error is the
  largest distance of the platform, at any tick, from where the finest steps of `rk4` bring it.
- `plant.integrator: rk4` is for figures that must not depend on the step. The errors of the others shrink with the
  first power of the step, but for MuJoCo's `rk4`, whose joints are soft.

## With friction

Dry friction of 0.05 N m and viscous friction of 0.02 N m s/rad in each motor. Where a motor sticks or turns round, all
are of first order; `rk4` divides such a step into eight.

{rubbing}

## What that means for tracking

RMS position error [µm] of shipped scenarios on the closed form, with the friction of their motors.

{tracking}

## Three engines, one robot

The same loop with steps of 1 ms: the largest distance between two runs, and the processor time of a step of the plant.
With encoders and dry friction, a reading that falls into the next count is worth micrometres.

{engines}
"""

if __name__ == "__main__":
    main()
