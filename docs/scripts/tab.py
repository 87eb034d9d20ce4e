"""Builds docs/tab.html: robots with their controllers in a browser's tab, one file without server and network.

Plant, motors, sensors and controller are printed as C, see docs/export.md, and compiled to WebAssembly by the clang of
the Python package ziglang. The page is that of `live`; tab.js stands in for its server. `python docs/scripts/tab.py
[FILE]`
"""

from __future__ import annotations

import base64
import json
import re
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from stewart_drake import Scenario, load_scenario
from stewart_drake.base.config import NotNegative
from stewart_drake.base.jit import njit
from stewart_drake.base.records import Record, Vec2, Vec6, Vec18, record
from stewart_drake.base.registry import ADAPTATIONS
from stewart_drake.base.sampling import on_grid
from stewart_drake.control.base import AdaptationOptions
from stewart_drake.control.features import TunerParams
from stewart_drake.control.friction_compensation import FrictionCompensation
from stewart_drake.export.fmu import plant_part
from stewart_drake.export.loop import LoopSource
from stewart_drake.export.types import Array
from stewart_drake.live.session import CONTROLLERS
from stewart_drake.live.start import about_robot
from stewart_drake.live.steering import SmoothValue
from stewart_drake.loop.part import LoopContext, Part
from stewart_drake.mechanics import kinematics_laws as laws
from stewart_drake.mechanics.friction import Friction
from stewart_drake.mechanics.singularities import PLANNED
from stewart_drake.plant.closed_form import ClosedForm
from stewart_drake.scenario.assembly import loop_of

HERE = Path(__file__).parent
PAGES = HERE.parents[1] / "stewart_drake" / "pages"
SCENE_PERIOD = 0.02  # [s] between two pictures.
LEARNING = 2.0  # [1/s] of the friction's law, while it is on.
WITHIN = 0.7  # Share of the safety layer's workspace within which a hand stays.
ENDS = 1e-3  # [rad] that a pose set by hand keeps from the cranks' stops.


# --- what runs there and in no other place ---------------------------------------------------------------------------


class FrictionLearner(AdaptationOptions):
    """Dry friction of each motor grows by what the observer cannot explain along the motion."""

    kind: Literal["tab_friction"] = "tab_friction"
    gain: NotNegative = 0.0
    """[1/s] share of that torque."""

    coulomb: NotNegative = 0.0
    """[N m] at the start."""
    viscous: NotNegative = 0.0
    """[N m s/rad]"""

    def parts(self, context: LoopContext) -> tuple[Part, ...]:
        """The law; its output replaces the compensated friction."""
        part = FrictionCompensation(coulomb=self.coulomb, viscous=self.viscous).part(context)
        state = LearntFriction.new(friction=part.parameters["friction"])
        params = LearningParams.new(gain=self.gain, period=context.period)
        inputs = {"disturbance_torque": 6, "reference": 18}
        constants = {"robot": laws.robot_record(context.robot), "params": params}
        return (Part("learner", learn, constants, inputs, ("friction",), state, (laws.Legs,)),)


class LearningParams(Record):
    """Parameters of the friction's law."""

    gain: float  # [1/s]
    period: float  # [s]


class LearntFriction(Record):
    """State of the friction's law."""

    friction: Friction


@njit
def learn(
    robot: laws.Robot,
    params: LearningParams,
    disturbance_torque: Vec6,
    reference: Vec18,
    legs: laws.Legs,
    state: LearntFriction,
) -> None:
    """Coulomb and break-away torque (6,) [N m] of the motors."""
    robot, params, legs, friction = record(robot), record(params), record(legs), record(state).friction
    if laws.legs_at(robot, reference[:6], legs) >= 0:
        return
    twist, rates = np.empty(6), np.empty(6)
    laws.twist_of(reference[:6], reference[6:12], twist)
    laws.crank_rates(legs, twist, rates)
    for i in range(6):
        more = params.gain * params.period * disturbance_torque[i] * np.tanh(rates[i] / friction.width)
        friction.coulomb[i] = max(friction.coulomb[i] + more, 0.0)
        friction.break_away[i] = friction.coulomb[i]


class Scene(Record):
    """Bodies of the picture."""

    frames: Annotated[np.ndarray, (14, 12)]  # Axes and positions of 6 cranks, 6 rods, the platform, the reference disc.


@njit
def scene_tick(
    robot: laws.Robot, measured: Annotated[np.ndarray, (24,)], reference: Vec18, legs: laws.Legs, state: Scene
) -> None:
    """Axes and positions of cranks, rods, platform and reference disc, as in `runs.scene.link_poses`."""
    robot, legs, state = record(robot), record(legs), record(state)
    laws.rotation(reference[:3], legs.rotation[:])
    for k in range(3):
        for m in range(3):
            state.frames[13, 3 * m + k] = legs.rotation[k, m]
        state.frames[13, 9 + k] = reference[3 + k]
    if laws.legs_at(robot, measured[:6], legs) >= 0:
        return
    lateral, x, y = np.empty(3), np.empty(3), np.empty(3)
    for i in range(6):
        laws.cross(legs.e_n[i], legs.crank[i], lateral)
        along, size = laws.dot(lateral, legs.e_l[i]), 0.0
        for k in range(3):
            x[k] = along * legs.e_l[i, k] - lateral[k]
            size += x[k] * x[k]
        for k in range(3):
            x[k] /= np.sqrt(size)
        laws.cross(legs.e_l[i], x, y)
        for k in range(3):
            state.frames[i, k], state.frames[i, 3 + k], state.frames[i, 6 + k] = (
                legs.crank[i, k],
                lateral[k],
                legs.e_n[i, k],
            )
            state.frames[6 + i, k], state.frames[6 + i, 3 + k], state.frames[6 + i, 6 + k] = x[k], y[k], legs.e_l[i, k]
            state.frames[i, 9 + k] = robot.shaft[i, k]
            state.frames[6 + i, 9 + k] = robot.shaft[i, k] + robot.crank_length[i] * legs.crank[i, k]
    for k in range(3):
        for m in range(3):
            state.frames[12, 3 * m + k] = legs.rotation[k, m]
        state.frames[12, 9 + k] = measured[3 + k]


class Stops(Record):
    """Bounds of poses."""

    middle: Vec6  # [rad] of the cranks' ranges.
    half: Vec6  # [rad] half of the ranges.
    home: Vec6  # [rad, m]
    workspace: Vec2  # [rad, m] largest turn and shift from home.


class Allowed(Record):
    """Result of `allowed_tick`."""

    allowed: float  # 1 for an allowed pose.


@njit
def allowed_tick(robot: laws.Robot, params: Stops, asked: Vec6, legs: laws.Legs, state: Allowed) -> None:
    """Whether a pose (6,) keeps its distance from singularities and stops."""
    robot, params, legs, state = record(robot), record(params), record(legs), record(state)
    state.allowed = 0.0
    if laws.legs_at(robot, asked, legs) >= 0:
        return
    for i in range(6):
        away = np.arctan2(legs.sine[i], legs.cosine[i]) - params.middle[i]
        away -= 2.0 * np.pi * np.rint(away / (2.0 * np.pi))
        if abs(legs.transmission[i]) < PLANNED.transmission or abs(away) > params.half[i]:
            return
    shift = 0.0
    for k in range(3, 6):
        shift += (asked[k] - params.home[k]) ** 2
    turn = np.arccos(min(1.0, 0.5 * (legs.rotation[0, 0] + legs.rotation[1, 1] + legs.rotation[2, 2] - 1.0)))
    if turn > params.workspace[0] or shift > params.workspace[1] ** 2:
        return
    if laws.conditioning(robot, legs, laws.QUICK, PLANNED.conditioning) >= PLANNED.conditioning:
        state.allowed = 1.0


# --- a loop as a module ----------------------------------------------------------------------------------------------

FRICTION_ENDS = {"Robot of the paper": (0.0, 0.04), "Reachy Mini": (0.03, 0.1)}  # [N m] ends of the slider.
VARIABLE = ("plant.robot", "plant.friction", "motors.limit", "learner.params", "tuner.params")


def loop_source(scenario: Scenario) -> LoopSource:
    """All of a scenario in C: its loop, the closed form and the picture."""
    loop, step, robot = loop_of(scenario, split=True), scenario.plant.time_step, scenario.robot
    ranges = np.clip(robot.crank_angle_ranges, -np.pi, np.pi)
    stops = Stops.new(
        middle=ranges.mean(axis=1),
        half=0.5 * np.ptp(ranges, axis=1) - ENDS,
        home=robot.home_pose,
        workspace=WITHIN * np.array(scenario.safety.workspace),
    )
    numbers, inputs = laws.robot_record(robot), {"measured": 24, "reference": 18}
    parts = [
        *loop.parts,
        Part("scene", scene_tick, {"robot": numbers}, inputs, (), Scene.new(), (laws.Legs,), period=SCENE_PERIOD),
        plant_part(scenario),
    ]
    outside = {
        "time": 1,
        "measured": 24,
        "wrench": 6,
        "asked": 6,
        **{source.signal: source.size for source in loop.sources},
    }
    inside = {
        "plant_pose": Array("double", "loop->measured", (12,)),
        "crank_state": Array("double", "loop->measured", (12,), "12"),
    }
    source = LoopSource(parts, outside, inside, scenario.controller.period, step, {}, VARIABLE)
    constants = {"robot": numbers, "params": stops}
    source.add(len(parts), Part("check", allowed_tick, constants, {"asked": 6}, (), Allowed.new(), (laws.Legs,)))
    return source


def place_of(source: LoopSource, signal: str) -> tuple[int, int]:
    """The double of the record with which a signal begins, and how many it has."""
    part, output = next((p, name) for p in source.parts for name in p.outputs if p.signal(name) == signal)
    return source.places[part.name][0] + part.initial.dtype.fields[output][1] // 8, part.size(output)


def module_text(scenario: Scenario, source: LoopSource) -> str:
    """The source of a module."""
    step = on_grid(scenario.plant.time_step)
    return re.sub(
        r"@(\w+)@",
        lambda m: {"LOOP": source.text(), "STEP": repr(step)}[m[1]],
        (HERE / "tab.c").read_text(encoding="utf-8"),
    )


FLAGS = [
    "--target=wasm32-freestanding",
    "-std=c99",
    "-O2",
    "-Wall",
    "-Wextra",
    "-Werror",
    "-ffp-contract=off",
    "-fno-math-errno",
    "-mbulk-memory",
    "-nostdlib",
]
EXPORTS = ("tab_memory", "tab_begin", "tab_step", "tab_allowed")


def compiled(text: str) -> bytes:
    """A module of WebAssembly."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        (folder / "tab.c").write_text(text, encoding="utf-8")
        (folder / "math.h").write_text((HERE / "tab_math.h").read_text(encoding="utf-8"), encoding="utf-8")
        link = [
            "-Wl,--no-entry",
            "-Wl,--strip-all",
            *(f"-Wl,--export={name}" for name in EXPORTS),
        ]
        clang = [sys.executable, "-m", "ziglang", "cc"]
        subprocess.run([*clang, *FLAGS, f"-I{folder}", *link, "-o", "tab.wasm", "tab.c"], cwd=folder, check=True)
        return (folder / "tab.wasm").read_bytes()


# --- robots of the page ----------------------------------------------------------------------------------------------


@cache
def robots() -> dict[str, Scenario]:
    """Scenarios of the page by the names of their robots."""
    ADAPTATIONS.add(FrictionLearner)
    nod = load_scenario("reachy_nod")
    breath = load_scenario("exact_breathing")
    return {
        "Robot of the paper": breath.replace(
            {
                "plant": {"kind": "closed_form", "motor_friction": 0.01},
                "sensors": {"kind": "encoders", "resolution_bits": 17},
                "adaptation": {"kind": "tab_friction", "coulomb": 0.01},
                "safety": {},
            }
        ),
        "Reachy Mini": nod.replace(
            {
                "plant": {"kind": "closed_form", "motor_damping": 0.095, "motor_friction": 0.058},
                "reference": {"kind": "sine", "amplitude": [0, 0.2618, 0, 0, 0, 0], "angular_frequency": 3.0},
                "adaptation": {"kind": "tab_friction", "coulomb": 0.058, "viscous": 0.095},
                # More friction than was believed is shown here, and no fault.
                "safety": {"unexplained_torque": None},
            }
        ),
    }


def choices(scenario: Scenario) -> dict[str, Scenario]:
    """The scenario with each controller of the panel."""
    return {name: scenario.replace(changes) for name, changes in CONTROLLERS.items() if "exact" not in name}


def _change(scenario: Scenario, key: str) -> list[float]:
    """What one more unit of a key of the plant adds to the constants of the plant: robot, then friction."""
    now, more = (
        _fixed(scenario.replace({key: getattr(scenario.plant, key.partition(".")[2]) + extra})) for extra in (0.0, 0.01)
    )
    return ((more - now) / 0.01).tolist()


def _fixed(scenario: Scenario) -> np.ndarray:
    robot, friction, *_ = ClosedForm(scenario.robot, scenario.plant, scenario.gravity)._fixed
    return np.concatenate([robot.view(np.float64), friction.view(np.float64)])


def robot_data(name: str, scenario: Scenario) -> dict[str, Any]:
    """What the page has of a robot."""
    step = on_grid(scenario.plant.time_step)
    smooth = SmoothValue(np.zeros(1))
    modules = {}
    for choice, changed in choices(scenario).items():
        source = loop_source(changed)
        code = compiled(module_text(changed, source))
        tunes = any(part.name == "tuner" and "setting" in part.outputs for part in source.parts)
        modules[choice] = {
            "code": base64.b64encode(code).decode(),
            "places": source.places,
            "parts": [part.name for part in source.parts],
            "kinds": {part.name: str(part.initial.dtype) for part in source.parts},
            "torque": place_of(source, "motor_torque"),
            "safety": place_of(source, "safety"),
            "setting": place_of(source, "setting") if tunes else None,
        }
    motion = scenario.reference
    return {
        "about": about_robot(scenario, home=motion.evaluate(0.0)[0])
        | {"name": name, "encoders": False, "controllers": list(modules)},
        "modules": modules,
        "step": step,
        "stride": round(SCENE_PERIOD / scenario.plant.time_step),
        "ahead": scenario.preview / step,
        "transitions": [smooth.transition(time).tolist() for time in (step, scenario.preview or step)],
        "motion": {key: list(getattr(motion, key)) for key in ("center", "amplitude", "angular_frequency", "phase")},
        "payload": _change(scenario, "plant.payload_mass"),
        "friction": _change(scenario, "plant.motor_friction"),
        "fixed": _fixed(scenario).tolist(),
        "friction_now": scenario.plant.motor_friction,
        "friction_ends": FRICTION_ENDS[name],
        "learning": LEARNING,
        "kappa": TunerParams.layout.fields["kappa"][1] // 8,
        "monitors": list(scenario.safety.monitor_names),
    }


def page(data: dict[str, Any]) -> str:
    """The page of `live` with its files in it, and what stands in for its server."""
    text = (PAGES / "live.html").read_text(encoding="utf-8")
    text = re.sub(
        r'<link rel="stylesheet" href="(.+?)">',
        lambda m: f"<style>{(PAGES / m[1]).read_text(encoding='utf-8')}</style>",
        text,
    )
    own = f'<script type="application/json" id="tab-data">{json.dumps(data).replace("<", chr(92) + "u003c")}</script>\n'
    own += f"<script>{(HERE / 'tab.js').read_text(encoding='utf-8')}</script>\n"

    def script(match: re.Match[str]) -> str:
        return (
            own if match[1] == "live.js" else ""
        ) + f"<script>{(PAGES / match[1]).read_text(encoding='utf-8')}</script>"

    return re.sub(r'<script src="(.+?)"></script>', script, text)


def main() -> None:
    """Writes the page."""
    data = {name: robot_data(name, scenario) for name, scenario in robots().items()}
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else HERE.parent / "tab.html"
    target.write_text(page(data), encoding="utf-8")
    sizes = {
        name: {choice: len(m["code"]) * 3 // 4 for choice, m in robot["modules"].items()}
        for name, robot in data.items()
    }
    print(f"{target}: {target.stat().st_size / 1e6:.2f} MB; modules {sizes}")


if __name__ == "__main__":
    main()
