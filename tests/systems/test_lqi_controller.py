import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.systems.analysis import Simulator
from strategies import ROBOT, poses, vectors

from stewart_drake.control.inputs import Measurement, Setpoint
from stewart_drake.control.lqi import initial_memory, lqi_tick
from stewart_drake.control.lqi_options import LqiOptions
from stewart_drake.errors import NotFiniteError, SingularPoseError
from stewart_drake.plant.multibody_plant import build_plant
from stewart_drake.sampling import on_grid, steps_per
from stewart_drake.scenario import Scenario
from stewart_drake.systems.diagram import ClosedLoop
from stewart_drake.systems.lqi_controller import LqiController

GRAVITY = 9.81
OPTIONS = LqiOptions(solver="split")


def fixed(system, measurement, reference, weights):
    context = system.CreateDefaultContext()
    for port, value in ((system.measurement, measurement), (system.reference, reference), (system.weights, weights)):
        port.FixValue(context, np.asarray(value))
    return context


def test_ports():
    system = LqiController(ROBOT, OPTIONS, GRAVITY)
    inputs = {system.get_input_port(i).get_name(): system.get_input_port(i).size() for i in range(3)}
    outputs = {system.get_output_port(i).get_name(): system.get_output_port(i).size() for i in range(4)}
    assert inputs == {"measurement": 12, "reference": 18, "weights": 2}
    assert outputs == {"result": 138, "torque": 6, "error": 6, "integral": 6}
    assert (system.num_input_ports(), system.num_output_ports()) == (3, 4)
    assert system.GetInputPort("weights").get_index() == system.weights.get_index()
    assert system.GetOutputPort("torque").get_index() == system.torque.get_index()


@settings(max_examples=30)
@given(poses(0.7), vectors(6, 0.3), vectors(18, 0.02), st.floats(-1.0, 1.0))
def test_a_tick_is_the_pure_function(pose, rate, reference, log_ratio):
    system = LqiController(ROBOT, OPTIONS, GRAVITY)
    reference = reference + np.concatenate([pose, np.zeros(12)])
    weights = np.array([10.0**log_ratio, 1.0])
    context = fixed(system, np.concatenate([pose, rate]), reference, weights)
    memory = initial_memory()
    for k in range(3):
        context.SetTime(k * system.period)
        setpoint = Setpoint(reference[:6], reference[6:12], reference[12:])
        expected = lqi_tick(ROBOT, OPTIONS, GRAVITY, Measurement(pose, rate), setpoint, weights, memory)
        for name in ("torque", "error", "integral"):
            np.testing.assert_array_equal(system.GetOutputPort(name).Eval(context), getattr(expected, name))
        memory = expected
        store(system, context)


def store(system, context):
    """The update event of a tick, by the Simulator, and nothing after it."""
    simulator = Simulator(system, context.Clone())
    simulator.AdvanceTo(context.get_time() + 0.1 * system.period)
    context.SetTimeStateAndParametersFrom(simulator.get_context())


def test_errors_carry_the_time_of_the_tick():
    system = LqiController(ROBOT, OPTIONS, GRAVITY)
    home = np.concatenate([ROBOT.home_pose, np.zeros(12)])
    high = home[:12] + [0, 0, 0.3, 0, 0, 0.115, 0, 0, 0, 0, 0, 0]
    for measurement, kind in ((high, SingularPoseError), (np.full(12, np.nan), NotFiniteError)):
        context = fixed(system, home[:12], home, [1.0, 1.0])
        simulator = Simulator(system, context)
        simulator.AdvanceTo(0.0499)
        system.measurement.FixValue(simulator.get_mutable_context(), measurement)
        with pytest.raises(kind) as caught:
            simulator.AdvanceTo(0.1)
        assert caught.value.time == pytest.approx(0.05)


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


@pytest.mark.slow
@pytest.mark.parametrize("tuner", ["fixed", "ann"])
@pytest.mark.parametrize(
    ("step", "period"), [(0.001, 0.005), (0.0001, 0.001), (0.001, 0.001), (0.001, 0.002), (1 / 3000, 1 / 600)]
)
def test_no_delay_is_added_the_loop_is_the_pure_law_and_the_plant(step, period, tuner):
    # A torque one plant step late, a tick that sees the plant of the next step, or rates that drift apart: each shows.
    case = scenario(step, period, tuner={"kind": tuner})
    steps = round((0.3 if tuner == "ann" else 0.05) / step)
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


def test_running_one_diagram_twice_gives_identical_logs():
    loop = ClosedLoop(scenario(tuner={"kind": "ann"}))
    first, second = simulate(loop, 0.2), simulate(loop, 0.2)
    for name, values in first.items():
        np.testing.assert_array_equal(second[name], values)


def test_two_runs_of_one_diagram_side_by_side_do_not_touch_each_other():
    loop = ClosedLoop(scenario(tuner={"kind": "ann"}))
    alone = simulate(loop, 0.1)
    one = Simulator(loop, loop.create_start_context())
    other = loop.create_start_context()
    loop.plant.set_state(other, ROBOT.home_pose + [0.05, 0, 0, 0.01, 0, 0])
    other = Simulator(loop, other)
    for k in range(1, 11):
        for simulator in (one, other):
            simulator.AdvanceTo(0.01 * k + 1e-6)
    for name, values in alone.items():
        np.testing.assert_array_equal(logged(loop, one.get_context())[name], values)
    assert np.any(logged(loop, other.get_context())["torque"] != alone["torque"])


@pytest.mark.parametrize("pause", [0.1, 0.1025])
def test_a_context_cloned_midway_goes_on_identically(pause):
    loop = ClosedLoop(scenario(tuner={"kind": "ann"}))
    simulator = Simulator(loop, loop.create_start_context())
    simulator.AdvanceTo(pause)
    twin = Simulator(loop, simulator.get_context().Clone())
    for each in (simulator, twin):
        each.AdvanceTo(0.2)
    mine, theirs = (logged(loop, each.get_context()) for each in (simulator, twin))
    for name, values in mine.items():
        np.testing.assert_array_equal(theirs[name][-90:], values[-90:])
