import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from strategies import ROBOT

from stewart_drake.control.inputs import Measurement, Setpoint
from stewart_drake.plant.multibody_plant import build_plant
from stewart_drake.sampling import on_grid, steps_per
from stewart_drake.scenario import Scenario
from stewart_drake.systems.diagram import ClosedLoop

# --- in the loop ---------------------------------------------------------------------------------------------------


def scenario(step=0.001, period=0.005, **changes):
    keys = {
        "duration": 0.5,
        "plant": {"time_step": step},
        "controller": {"period": period, "solver": "split"},
        "tuner": {"kind": "fixed"},
        "log_period": step,
    }
    return Scenario.from_dict({**keys, **changes})


def simulate(loop, end, context=None):
    simulator = Simulator(loop, loop.create_start_context() if context is None else context)
    simulator.AdvanceTo(end + 1e-6)
    return logged(loop, simulator.get_context())


def logged(loop, context):
    return {name: sink.FindLog(context).data().T.copy() for name, sink in loop.sinks.items()}


def by_hand(scenario, steps):
    """The same loop without the LeafSystems: the pure ControlLaw and the plant alone, stepped one by one."""
    diagram, plant = build_plant(scenario.robot, scenario.plant, scenario.gravity)
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    plant.set_state(context, *scenario.start())
    plant_context = plant.plant.GetMyContextFromRoot(context)
    law = scenario.control_law()
    memory = law.initial_state()
    step = on_grid(scenario.plant.time_step)
    ratio = steps_per("period", scenario.controller.period, scenario.plant.time_step)
    states, torques, weights, integrals = [], [], [], []
    for n in range(steps + 1):
        if n:
            simulator.AdvanceTo(n * step)
        state = plant.plant.GetPositionsAndVelocities(plant_context).copy()
        if n % ratio == 0:
            in_force = memory.weights
            setpoint = Setpoint(*scenario.reference.evaluate(n * step))
            torque, memory = law(Measurement(*plant.pose_and_rate(state)), setpoint, memory)
            diagram.GetInputPort("torque").FixValue(context, torque)
        states.append(state)
        torques.append(torque)
        weights.append(in_force)
        integrals.append(memory.integral)
    return {
        "plant_state": np.array(states),
        "torque": np.array(torques),
        "weights": np.array(weights),
        "integral": np.array(integrals),
    }


@pytest.mark.parametrize(
    ("step", "period", "tuner"),
    [
        (0.001, 0.005, "fixed"),
        *(pytest.param(0.001, period, "paper", marks=pytest.mark.slow) for period in (0.001, 0.002, 0.005)),
        *(pytest.param(*rate, "fixed", marks=pytest.mark.slow) for rate in ((0.0001, 0.001), (1 / 3000, 1 / 600))),
    ],
)
def test_no_delay_is_added_the_loop_is_the_pure_law_and_the_plant(step, period, tuner):
    # A torque one plant step late, a tick that sees the plant of the next step, or rates that drift apart: each shows.
    case = scenario(step, period, tuner={"kind": tuner})
    steps = round((0.3 if tuner == "paper" else 0.05) / step)
    loop, hand = simulate(ClosedLoop(case), steps * step), by_hand(case, steps)
    assert len(loop["torque"]) == steps + 1
    for name in ("plant_state", "torque", "integral"):
        np.testing.assert_allclose(loop[name], hand[name], rtol=0.0, atol=1e-12)
    ratio = round(period / step)
    # Between ticks the port already shows the weights of the next one.
    np.testing.assert_allclose(loop["weights"][::ratio], hand["weights"][::ratio], rtol=1e-12)
    assert np.ptp(loop["torque"], axis=0).min() > 1e-3


def test_all_is_held_between_ticks():
    log = simulate(ClosedLoop(scenario()), 0.1)
    for name in ("torque", "error", "integral", "density"):
        blocks = log[name][:100].reshape(20, 5, -1)
        np.testing.assert_array_equal(blocks, np.broadcast_to(blocks[:, :1], blocks.shape))
        assert np.any(blocks[1:, 0] != blocks[:-1, 0])
    # At a tick the error is that of this very row, and the integral that of (23).
    error = log["measurement"][:, :6] - log["reference"][:, :6]
    np.testing.assert_allclose(log["error"][::5], error[::5], atol=1e-15)
    np.testing.assert_allclose(log["integral"][::5], 0.005 * np.cumsum(error[::5], axis=0), atol=1e-15)


@pytest.mark.parametrize(
    ("changes", "pause"),
    [
        ({"tuner": {"kind": "paper"}}, 0.1025),
        ({"command_delay": 2, "sensors": {"kind": "encoders"}, "link": {"drop_probability": 0.5, "seed": 1}}, 0.1),
        ({"safety": {"following_error": [1.0, 1.0]}}, 0.1025),
    ],
    ids=["tuner", "encoders, delay, link", "safety"],
)
def test_runs_of_one_diagram_are_the_same_beside_others_and_where_one_is_cloned(changes, pause):
    loop = ClosedLoop(scenario(**changes))
    alone = simulate(loop, 0.2)
    start = loop.create_start_context()
    loop.plant.set_state(start, ROBOT.home_pose + [0.05, 0, 0, 0.01, 0, 0])
    one, other = Simulator(loop, loop.create_start_context()), Simulator(loop, start)
    for simulator in (one, other):
        simulator.AdvanceTo(pause)
    twin = Simulator(loop, one.get_context().Clone())
    for simulator in (one, other, twin):
        simulator.AdvanceTo(0.2 + 1e-6)
    for name, values in alone.items():
        np.testing.assert_array_equal(logged(loop, one.get_context())[name], values)
        np.testing.assert_array_equal(logged(loop, twin.get_context())[name][-90:], values[-90:])
    assert np.any(logged(loop, other.get_context())["torque"] != alone["torque"])
