"""The exported controller gives the commands of `Controller`, whatever the readings are."""

import contextlib
import subprocess
from functools import cache

import numpy as np
import pytest
from compiled import CHECKED, InC, compiled, compiler

from stewart_drake import Controller, load_scenario
from stewart_drake.base.errors import ConfigurationError, RunFailure
from stewart_drake.base.registry import CONTROLLERS, ESTIMATORS, TUNERS
from stewart_drake.base.sampling import on_grid
from stewart_drake.base.yaml_files import shipped_folder
from stewart_drake.export.controller_c import controller_files, export_controller
from stewart_drake.export.loop import LoopSource
from stewart_drake.scenario.control_side import control_side
from stewart_drake.scenario.controller import controller_parts
from stewart_drake.scenario.stepped_loop import SteppedLoop

NAMES = sorted(path.stem for path in shipped_folder("scenarios").glob("*.yaml"))
SHIPPED = [name for name in NAMES if name != "rolling_deck" and load_scenario(name).adaptation is None]
SAME = 1e-12
"""Of the largest command; what another libm may do."""


def on_closed_form(scenario):
    plant = {
        "kind": "closed_form",
        **{key: getattr(scenario.plant, key) for key in ("motor_damping", "motor_friction")},
    }
    return scenario.replace({"plant": plant})


@cache
def readings(scenario, seconds):
    """Readings of a run in the closed form, at the controller's ticks, with those of a ball."""
    loop = SteppedLoop(on_closed_form(scenario))
    name = control_side(scenario, True, "reading" if "reading" in loop.runner.places else "plant_pose").reading
    stride = round(scenario.reading_period / loop.scenario.plant.time_step)
    rows = []
    loop.begin()
    try:
        for step in range(round(seconds / loop.scenario.plant.time_step) + 1):
            loop.run_parts()
            if step % stride == 0:
                ball = [loop.runner.signal("ball_reading")] if "ball_reading" in loop.runner.places else []
                rows.append(np.concatenate([loop.runner.signal(name), *ball]))
            loop.move()
    except RunFailure:  # as without compensation of the weight
        pass
    return np.array(rows)


def both(controller, in_c, rows, period, ages=None):
    """Commands of both, up to where they give up, which they do at the same step."""
    places = controller._running.places
    wanted = ["reference", "reference_ahead"]
    if "ball_target" in places:
        wanted = ["unturned_reference", "unturned_reference_ahead", "ball_target"]
    names = [name for name in wanted if name in places]
    commands, out, mine = [], np.empty(6), np.empty(6)
    for k, row in enumerate(rows):
        age = 0.0 if ages is None else ages[k]
        try:
            reading, ball = np.split(row, [controller.reading])
            controller.step(reading, k * on_grid(period), out, age, ball=ball if ball.size else None)
            given_up = False
        except RunFailure:
            given_up = True
        wanted = np.concatenate([controller.signal(name) for name in names])
        status = in_c.step(row, wanted, mine, age)
        assert (status != 0) == given_up, (k, status)
        if given_up:
            break
        commands.append((out.copy(), mine.copy()))
    return np.array(commands).reshape(-1, 2, 6)


def assert_same(commands):
    scale = max(np.abs(commands[:, 0]).max(), 1e-9)
    assert np.abs(commands[:, 0] - commands[:, 1]).max() <= SAME * scale


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[] if name in ("exact_fig7", "reachy_nod") else pytest.mark.slow) for name in SHIPPED],
)
def test_commands_are_those_of_the_controller(name, tmp_path):
    scenario = load_scenario(name)
    export_controller(scenario, name, tmp_path)
    rows = readings(scenario, 1.0)
    commands = both(Controller(scenario), InC(tmp_path, name), rows, scenario.reading_period)
    assert len(commands) > 10
    assert_same(commands)


@pytest.mark.long
@pytest.mark.parametrize("name", SHIPPED)
def test_commands_of_ten_seconds(name, tmp_path):
    scenario = load_scenario(name, ["duration=10"])
    export_controller(scenario, name, tmp_path)
    assert_same(
        both(Controller(scenario), InC(tmp_path, name, ["-O2"]), readings(scenario, 10.0), scenario.reading_period)
    )


@pytest.mark.parametrize("imu", [{"rotation": [0.1, 0.2, 0.3]}, {"delay": 0.004, "period": 0.002}], ids=["new", "late"])
def test_it_takes_inertial_readings_as_further_numbers_of_a_reading(imu, tmp_path):
    sensors = {"sensors": {"kind": "encoders", "imu": imu}, "estimator": "observer", "safety": {}}
    scenario = load_scenario("exact_fig7").replace({"plant": "closed_form", **sensors})
    export_controller(scenario, "inertial", tmp_path)
    loop, controller, in_c = SteppedLoop(scenario), Controller(scenario), InC(tmp_path, "inertial")
    mine, out = np.empty((2, 6))
    assert "_READING 12 " in (tmp_path / "inertial.h").read_text()
    loop.begin()
    for k in range(300):
        loop.run_parts()
        if k % round(scenario.reading_period / scenario.plant.time_step) == 0:
            reading, imu, wanted = (loop.runner.signal(name) for name in ("reading", "imu", "reference"))
            controller.step(reading, loop.time, out, imu=imu)
            assert in_c.step(np.concatenate([reading, imu]), wanted, mine, 0.0) == 0
            np.testing.assert_allclose(mine, out, rtol=0.0, atol=SAME * np.abs(out).max())
        loop.move()


@pytest.mark.slow
def test_it_goes_on_with_five_encoders_as_python_does(tmp_path):
    """A drift is found, replaced, and the robot led home until the layer ends the run, at the same step."""
    sensors = {"kind": "encoders", "resolution_bits": 17, "noise": 2e-5, "imu": {"delay": 0.002, "period": 0.002}}
    sensors["faults"] = [{"kind": "drift", "size": 0.5, "leg": 4, "time": 0.6}]
    safety = {"on_lost_encoder": "home", "safe_hold_time": 0.1}
    scenario = load_scenario("exact_breathing").replace({"plant": "closed_form", "sensors": sensors, "safety": safety})
    export_controller(scenario, "five", tmp_path)
    loop, controller, in_c = SteppedLoop(scenario), Controller(scenario), InC(tmp_path, "five")
    (mine, out), levels = np.empty((2, 6)), set()
    names = [name for name in ("reference", "reference_ahead") if name in controller._running.places]
    loop.begin()
    for _ in range(4000):
        with contextlib.suppress(RunFailure):
            loop.run_parts()
        reading, imu = (loop.runner.signal(name).copy() for name in ("reading", "imu"))
        wanted = np.concatenate([loop.runner.signal(name) for name in names])
        status = in_c.step(np.concatenate([reading, imu]), wanted, mine, 0.0)
        try:
            controller.step(reading, loop.time, out, imu=imu)
        except RunFailure:
            break
        assert status == 0
        np.testing.assert_allclose(mine, out, rtol=0.0, atol=1e-9 * np.abs(out).max())
        levels.add(controller.status)
        loop.move()
    assert status != 0
    assert levels == {"none", "ramp", "safe_hold"}


def test_what_learns_is_refused_by_its_key(tmp_path):
    with pytest.raises(ConfigurationError, match=r"adaptation\.kind: expected null: .*--keep-model"):
        export_controller(load_scenario("reachy_slow_bus"), "slow", tmp_path)


OTHERS = {
    "pid": ("exact_fig7", {"controller": {"kind": "pid"}}),
    "computed_torque": ("exact_fig7", {"controller": {"kind": "computed_torque"}}),
    "servos": ("reachy_nod", {
        "controller": {"kind": "feedforward", "period": 0.02}, "estimator": "difference", "tuner": "fixed",
        "motors": {"kind": "position", "delay": 0.03}, "command_delay": 0, "safety": {},
    }),
    "servos_with_feedback": ("reachy_nod", {"motors": {"kind": "position"}, "safety": {}}),
    "slow_bus": ("reachy_slow_bus", {"adaptation": None}),
    "currents": ("exact_breathing", {"motors": {"kind": "current", "torque_constant": 0.5}, "safety": {}}),
    "schedule": ("reachy_nod", {"tuner": {"kind": "schedule", "calm": [0, 0, 0, 0], "alert": [0.2, 0, 0, 0.5]}}),
    "joints": ("reachy_nod", {"model.friction.joints": {"viscous": 0.001, "coulomb": 0.001}}),
    "tilted": ("sway", {"gravity": [1.0, -2.0, -9.0], "model.orientation": [0.2, 0.1, 0.0]}),
    "bumpless": ("reachy_nod", {"controller.bumpless": True}),
    "observer_of_poses": ("exact_fig7", {"estimator": "observer", "command_delay": 2, "safety": {}}),
    "fast_readings": ("exact_breathing", {
        "estimator.period": 0.0005, "controller.period": 0.002, "plant.time_step": 0.0005,
    }),
    "printed": ("paper_fig7", {"controller.force_map": "printed", "tuner": "fixed"}),
}  # fmt: skip


def test_every_kernel_that_a_controller_reaches_is_printed():
    """Without a compiler: a law beyond the language is found at once, with its file and line."""
    scenarios = [load_scenario(name) for name in SHIPPED]
    scenarios += [load_scenario(name).replace(changes) for name, changes in OTHERS.values()]
    for scenario in scenarios:
        side, age = control_side(scenario, True), np.zeros(1)
        parts = controller_parts(scenario, side, age)
        text = LoopSource(
            parts, {"time": 1, **side.outside}, {}, side.context.period, scenario.reading_period, {"age": age}
        ).text()
        assert all(f"run_{part.name}(struct loop *loop)" in text for part in parts)
    for key, family in (("controller", CONTROLLERS), ("estimator", ESTIMATORS), ("tuner", TUNERS)):
        assert {getattr(scenario, key).kind for scenario in scenarios} == set(family.kinds)


@pytest.mark.slow
@pytest.mark.parametrize("case", OTHERS)
def test_other_kinds(case, tmp_path):
    name, changes = OTHERS[case]
    scenario = load_scenario(name).replace(changes)
    export_controller(scenario, case, tmp_path)
    controller = Controller(scenario)
    rows = replayed_rows(tmp_path, controller.reading)
    commands = both(controller, InC(tmp_path, case), rows, scenario.reading_period)
    assert len(commands) == len(rows)
    assert_same(commands)


def replayed_rows(folder, size):
    return np.loadtxt(folder / "replay.csv", delimiter=",")[:, :size]


@pytest.mark.slow
@pytest.mark.parametrize(("case", "seed"), [*((None, seed) for seed in range(4)), ("servos", 0), ("servos", 1)])
def test_bad_readings_are_taken_alike(case, seed, tmp_path):
    """Jumps, missing readings, late ones: bridged, held, stopped at the same steps and with the same commands."""
    scenario, rng = load_scenario("reachy_nod"), np.random.default_rng(seed)
    scenario = scenario.replace(OTHERS[case][1]) if case else scenario
    export_controller(scenario, "nod", tmp_path)
    rows = readings(scenario, 2.0).copy()
    rows += rng.normal(0.0, 1e-3, rows.shape) * (rng.random((len(rows), 1)) < 0.2)
    rows[rng.random(rows.shape) < 0.02] = np.nan
    begin = rng.integers(60, 150) // (2 if case else 1)
    rows[begin:, rng.integers(6)] += (0.3, np.nan, -0.05, np.inf)[seed]
    ages = np.where(rng.random(len(rows)) < 0.05, 0.1, 0.0)
    controller, in_c = Controller(scenario), InC(tmp_path, "nod")
    commands = both(controller, in_c, rows, scenario.reading_period, ages)
    assert len(commands) > (10 if case else 50)
    assert_same(commands)
    assert controller.status != "none"
    np.testing.assert_array_equal(in_c.signal("safety"), controller.signal("safety"))
    in_c.reset()
    again = both(Controller(scenario), in_c, rows, scenario.reading_period, ages)
    np.testing.assert_array_equal(again[:, 1], commands[:, 1])


def test_signals_and_the_reference(tmp_path):
    scenario = load_scenario("reachy_nod")
    export_controller(scenario, "nod", tmp_path)
    controller, in_c = Controller(scenario), InC(tmp_path, "nod")
    both(controller, in_c, readings(scenario, 0.3), scenario.reading_period)
    for name in ("error", "measurement", "weights", "friction_torque", "density", "expected_disturbance"):
        np.testing.assert_allclose(in_c.signal(name), controller.signal(name), rtol=1e-11, atol=1e-12)
    assert in_c.signal("no such") is None
    wanted = [controller.signal(name) for name in ("reference", "reference_ahead")]
    np.testing.assert_array_equal(in_c.reference(30, 36), np.concatenate(wanted))
    np.testing.assert_array_equal(in_c.reference(10**6, 36), in_c.reference(500, 36))


@pytest.mark.long
@pytest.mark.parametrize("cc", ["gcc", "clang"])
@pytest.mark.parametrize("name", SHIPPED)
def test_clean_under_sanitizers(name, cc, tmp_path):
    compiler(cc)
    export_controller(load_scenario(name), name, tmp_path)
    program = compiled(tmp_path, "main.c", f"{name}.c", f"{name}_reference.c", flags=CHECKED, output="it", cc=cc)
    with (tmp_path / "replay.csv").open() as rows:
        done = subprocess.run([program], stdin=rows, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_a_controller_in_python_is_refused_by_its_key(tmp_path):
    def torques(measurement, _, __):
        return 0.0 * measurement.pose

    scenario = load_scenario("exact_fig7").replace({"controller": torques})
    with pytest.raises(ConfigurationError, match=r"^controller\.kind: expected a kind with compiled laws, .*torques"):
        export_controller(scenario, "mine", tmp_path / "mine")
    assert not (tmp_path / "mine").exists()


def test_the_header_names_every_motion_of_a_reference():
    scenario = load_scenario("reachy_nod")
    header = controller_files(scenario, "reachy_nod")["reachy_nod.h"]
    assert "reference: (36,) pose [rad, m], rate and acceleration, six numbers each, of `reference`, then of " in header
    assert f"`reference_ahead` ({scenario.preview:g} s later)" in header
