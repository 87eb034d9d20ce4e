"""The whole loop: what acts when, what is held, what is remembered where, and how it ends."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from strategies import ROBOT

from stewart_drake import ClosedLoop, Controller, Scenario, build_plant, load_scenario, run
from stewart_drake.base.sampling import on_grid, steps_per
from stewart_drake.control.policy import disturbance_of, weights_of
from stewart_drake.mechanics.dynamics import static_torque


def paper(step=0.001, period=0.005, **changes):
    """The paper's loop with the split solution."""
    keys = {
        "duration": 0.5,
        "plant": {"time_step": step},
        "controller": {"period": period, "solver": "split"},
        "tuner": {"kind": "fixed"},
        "log_period": step,
    }
    return Scenario.from_dict({**keys, **changes})


def exact(*overrides, **changes):
    """The shipped scenario, shortened; `changes` are whole sections."""
    scenario = load_scenario("exact_fig7", ["duration=0.1", *overrides])
    return Scenario.from_dict({**scenario.to_dict(), **changes})


def simulate(loop, end):
    simulator = Simulator(loop)
    simulator.AdvanceTo(end + 1e-6)
    return logged(loop, simulator.get_context())


def logged(loop, context):
    return {name: sink.FindLog(context).data().T.copy() for name, sink in loop.sinks.items()}


@pytest.mark.parametrize(
    "changes",
    [
        {"tuner": {"kind": "paper"}, "disturbances": [{"kind": "noise", "rms": [0, 0, 0, 1, 0, 0]}]},
        pytest.param({"sensors": {"kind": "encoders"}, "command_delay": 1, "safety": {}}, marks=pytest.mark.slow),
    ],
    ids=["exact", "encoders"],
)
def test_rows_of_a_sparse_log_are_those_of_a_full_one_to_the_bit(changes):
    case, end = paper(**changes), 0.053
    full, sparse = simulate(ClosedLoop(case), end), ClosedLoop(case, sparse=True)
    simulator = Simulator(sparse)
    simulator.AdvanceTo(end + 1e-6)
    count, rows = sparse.rows(simulator.get_context())
    assert count == 54
    assert rows.keys() == full.keys() | {"measured"}
    for name, values in full.items():
        np.testing.assert_array_equal(rows[name], values, name)
    assert sparse.sinks["torque"].FindLog(simulator.get_context()).num_samples() == 11


def by_hand(scenario, steps, command):
    """The plant alone, stepped one by one: states (n, nq + nv) and torques (n, 6) of `command(pose, rate, step)`."""
    diagram, plant = build_plant(scenario.robot, scenario.plant, scenario.gravity)
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    plant.set_state(context, *scenario.start())
    plant_context = plant.plant.GetMyContextFromRoot(context)
    states, torques = [], []
    for n in range(steps + 1):
        if n:
            simulator.AdvanceTo(n * on_grid(scenario.plant.time_step))
        states.append(plant.plant.GetPositionsAndVelocities(plant_context).copy())
        torques.append(command(*plant.pose_and_rate(states[-1]), n))
        diagram.GetInputPort("torque").FixValue(context, torques[-1])
    return np.array(states), np.array(torques)


@pytest.mark.parametrize(
    ("step", "period", "tuner"),
    [(0.001, 0.005, "fixed"), pytest.param(1 / 3000, 1 / 600, "paper", marks=pytest.mark.slow)],
)
def test_no_delay_is_added_the_loop_is_the_controller_and_the_plant(step, period, tuner):
    # A torque one plant step late, a tick that sees the plant of the next step, or rates that drift apart: each shows.
    case = paper(step, period, tuner={"kind": tuner})
    steps, ratio = round((0.3 if tuner == "paper" else 0.05) / step), steps_per("period", period, step)
    loop = simulate(ClosedLoop(case), steps * step)
    controller, torque = Controller(case), np.empty(6)

    def command(pose, rate, n):
        if n % ratio == 0:
            controller.step(np.concatenate([pose, rate]), n * on_grid(step), torque)
        return torque.copy()

    states, torques = by_hand(case, steps, command)
    np.testing.assert_allclose(loop["plant_state"], states, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(loop["torque"], torques, rtol=0.0, atol=1e-12)
    assert np.ptp(loop["torque"], axis=0).min() > 1e-3


@pytest.mark.parametrize(
    ("step", "period", "delay"), [(0.001, 0.005, 1), pytest.param(1 / 7000, 1 / 1400, 3, marks=pytest.mark.slow)]
)
def test_the_plant_gets_the_torque_of_so_many_ticks_before(step, period, delay):
    overrides = (f"plant.time_step={step!r}", f"controller.period={period!r}", f"log_period={step!r}", "duration=0.03")
    case = exact(*overrides, f"command_delay={delay}", initial_offset=[0.01, 0.0, -0.01, 0.001, 0.0, 0.002])
    log, late = run(case), delay * steps_per("", period, step)
    still = static_torque(case.robot, case.start()[0], case.gravity)
    np.testing.assert_allclose(log["torque_applied"][:late], np.broadcast_to(still, (late, 6)), rtol=1e-12)
    np.testing.assert_array_equal(log["torque_applied"][late:], log["torque"][: len(log.time) - late])
    states, _ = by_hand(case, len(log.time) - 1, lambda _pose, _rate, n: log["torque_applied"][n])
    np.testing.assert_allclose(log["plant_state"], states, atol=1e-11)


def test_runs_of_one_diagram_are_the_same_beside_others_and_where_one_is_cloned():
    loop = ClosedLoop(paper(estimator={"kind": "observer"}, safety={"following_error": [1.0, 1.0]}))
    alone, start = simulate(loop, 0.2), loop.CreateDefaultContext()
    loop.plant.set_state(start, ROBOT.home_pose + [0.05, 0, 0, 0.01, 0, 0])
    one, other = Simulator(loop), Simulator(loop, start)
    for simulator in (one, other):
        simulator.AdvanceTo(0.1025)
    twin = Simulator(loop, one.get_context().Clone())
    for simulator in (one, other, twin):
        simulator.AdvanceTo(0.2 + 1e-6)
    for name, values in alone.items():
        np.testing.assert_array_equal(logged(loop, one.get_context())[name], values)
        np.testing.assert_array_equal(logged(loop, twin.get_context())[name][-90:], values[-90:])
    assert np.any(logged(loop, other.get_context())["torque"] != alone["torque"])


HOME = [0, 0, 0, 0, 0, 0.3]
BASE = load_scenario("exact_breathing").replace({"plant.kind": "closed_form", "tuner": {"kind": "block"}})


@pytest.mark.slow
@pytest.mark.parametrize(("believed", "level"), [(0.01, 0.02), (0.05, 0.1)])
def test_a_robot_with_friction_comes_to_rest_and_stays(believed, level):
    # Up to twice the friction that is believed; without that rule it hunts by ten counts and more for ever.
    rest = {
        "plant.friction": {"coulomb": believed, "break_away": level},
        "model": {"friction": {"coulomb": believed}},
        "reference": {"kind": "minimum_jerk", "poses": [HOME, [0.05, 0, 0, 0.01, 0, 0.31]], "durations": [0.5]},
        "duration": 6.0,
        "estimator": {"kind": "observer"},
        "sensors.noise": 2e-5,
        "tuner": {"kind": "block", "q_pose": 8e5, "q_rate": 150.0, "q_integral": 5e6},
    }
    log = run(BASE.replace({**rest, "plant.motor_friction": 0.0}))
    late = log.time >= 3.5
    count = 2.0 * np.pi / 2**17
    assert np.ptp(log["crank_angle"][late], axis=0).max() < 4.0 * count
    error = np.linalg.norm((log["pose"] - log["reference"])[late, 3:], axis=1)
    assert 1e3 * np.sqrt(np.mean(error**2)) < 0.01 + 0.5 * level


def test_a_schedule_of_one_setting_is_that_setting():
    setting, push = (0.15, -0.2, -0.4, -0.8), {"kind": "step", "wrench": [0, 0, 0, 3, -2, -4], "time": 0.1}
    base = BASE.replace({"duration": 0.25, "disturbances": [push], "safety": {}})
    weights = weights_of(np.array(base.tuner.weights), np.array(setting))
    fixed = {"kind": "block", **dict(zip(("q_pose", "q_rate", "q_integral", "r"), weights, strict=True))}
    level = float(disturbance_of(base.estimator.disturbance, np.array(setting)))
    held = run(base.replace({"tuner": fixed, "estimator.disturbance": level}))
    tuned = run(base.replace({"tuner": {"kind": "schedule", "calm": setting, "alert": setting}}))
    for signal in ("pose", "torque", "innovation", "safety"):
        np.testing.assert_allclose(tuned[signal], held[signal], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(tuned["setting"][:, :4], np.tile(setting, (len(tuned.time), 1)))
    assert "setting" not in held.signals
