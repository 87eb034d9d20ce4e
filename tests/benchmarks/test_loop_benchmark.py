"""What the loop costs, as ratios measured in one run: `make bench`."""

import subprocess
import sys
import time

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from stewart_drake.compiled import control
from stewart_drake.systems.motor_encoders import MotorEncoders
from stewart_drake.systems.pose_estimator import PoseEstimator

from stewart_drake import RobotParameters, build_diagram, build_plant, load_network, load_scenario
from stewart_drake.control.lqi import MEMORY_SIZE, flat_tick
from stewart_drake.control.lqi_options import LqiOptions
from stewart_drake.control.riccati import riccati_gain
from stewart_drake.control.state_space import INTEGRAL, POSITION, RATE, STATES, discretize, input_matrix, state_matrix
from stewart_drake.hardware.estimator import flat_estimate, initial_memory
from stewart_drake.hardware.friction_feedforward import FrictionCompensation, flat_feedforward
from stewart_drake.hardware.observer import Observer, ObserverOptions, flat_observer
from stewart_drake.mechanics.dynamics import pose_acceleration_map, static_torque
from stewart_drake.mechanics.kinematics import inverse_kinematics
from stewart_drake.sampling import on_grid
from stewart_drake.systems.density_features import DensityFeatures
from stewart_drake.systems.lqi_controller import LqiController
from stewart_drake.systems.reference_source import ReferenceSource

ROBOT = RobotParameters()
STEP = on_grid(0.001)
STEPS = 50
"""Plant steps in a round."""
BLOCKS = np.array([4e5, 30.0, 4e7, 1.0])
ALL = ["sensors.kind=encoders", "tuner={kind: paper}"]
"""Encoders, forward kinematics, exact model, split gains, densities, network, log: everything at 1 kHz."""


@pytest.fixture
def compare(benchmark):
    """Times a function and what it is compared with in turns, and prints the median of the ratios of neighbours.

    In turns, because the speed of a machine changes from second to second by more than what is measured here. `per`:
    how often the function does its thing in a call. The base times itself, so that it may prepare something first.
    """

    def run(name, function, base_name, base, rounds=80, per=1, base_per=1, inverse=False):
        mine, other = [], []

        def before():
            other.append(base())

        def timed():
            begin = time.perf_counter()
            function()
            mine.append(time.perf_counter() - begin)

        benchmark.pedantic(timed, setup=before, rounds=rounds, warmup_rounds=3)
        mine, other = np.array(mine[3:]) / per, np.array(other[3:]) / base_per
        ratio = float(np.median(other / mine if inverse else mine / other))
        what = f"{base_name} / {name}" if inverse else f"{name} / {base_name}"
        benchmark.extra_info[what] = round(ratio, 3)
        print(
            f"\n{what} = {ratio:.2f} (median; {name} {1e6 * np.median(mine):.1f} us, shortest {1e6 * mine.min():.1f}; "
            f"{base_name} {1e6 * np.median(other):.1f} us, shortest {1e6 * other.min():.1f})"
        )
        assert ratio > 0.0

    return run


def seconds(function):
    begin = time.perf_counter()
    function()
    return time.perf_counter() - begin


class Loop:
    """A closed loop, and beside it the plant alone that starts each round where the loop is, its torque held.

    A step of a moving plant costs a fifth more than one at rest, so the plant alone must move alike.
    """

    def __init__(self, *changes):
        self.loop = build_diagram(load_scenario("exact_fig7", changes))
        self.simulator = Simulator(self.loop, self.loop.create_start_context())
        self.simulator.AdvanceTo(0.02)
        self.alone, self.plant = build_plant(ROBOT)
        self.plant_simulator = Simulator(self.alone)

    def step(self):
        self.simulator.AdvanceTo(self.simulator.get_context().get_time() + STEPS * STEP)

    def plant_alone(self):
        context, own = self.simulator.get_context(), self.plant_simulator.get_mutable_context()
        state = self.loop.plant.state_output_port.Eval(self.loop.plant.plant.GetMyContextFromRoot(context))
        self.plant.plant.SetPositionsAndVelocities(self.plant.plant.GetMyMutableContextFromRoot(own), state)
        self.alone.GetInputPort("torque").FixValue(own, self.loop.GetOutputPort("torque").Eval(context))
        self.plant_simulator.AdvanceTo(own.get_time() + STEP)
        return seconds(lambda: self.plant_simulator.AdvanceTo(own.get_time() + STEPS * STEP))


def test_closed_loop(compare):
    """tick_ratio: plant and control at 1 kHz."""
    loop = Loop(*ALL)
    compare("closed loop", loop.step, "plant alone", loop.plant_alone, per=STEPS, base_per=STEPS)


def test_the_same_systems_doing_nothing(compare, monkeypatch):
    """What the Diagram costs: the same systems, ports, events and log, their mathematics left out."""
    angles = inverse_kinematics(ROBOT, ROBOT.home_pose)
    wanted = np.concatenate([ROBOT.home_pose, np.zeros(12)])
    hold = np.zeros(MEMORY_SIZE)
    hold[:6] = static_torque(ROBOT, ROBOT.home_pose)

    def idle(*ports, answer=None):
        def tick(self, context, previous):
            for port in ports:
                getattr(self, port).Eval(context)
            return previous if answer is None else answer

        return tick

    def encoders(self, context, output):
        self.plant_state.Eval(context)
        output.SetFromVector(angles)

    monkeypatch.setattr(PoseEstimator, "tick", idle("angles"))
    monkeypatch.setattr(LqiController, "tick", idle("measurement", "reference", "weights", answer=hold))
    monkeypatch.setattr(DensityFeatures, "tick", idle("error", "torque"))
    monkeypatch.setattr(MotorEncoders, "_calc", encoders)
    monkeypatch.setattr(ReferenceSource, "_calc", lambda _self, _context, output: output.SetFromVector(wanted))
    monkeypatch.setattr(
        "stewart_drake.control.network.TunerNetwork.compiled_weights", lambda _self: lambda _densities: np.ones(2)
    )
    loop = Loop("reference={kind: hold}", *ALL)
    compare("idle loop", loop.step, "plant alone", loop.plant_alone, per=STEPS, base_per=STEPS)


@pytest.mark.parametrize("observed", [False, True], ids=["differences", "observer"])
def test_mathematics_of_a_tick(compare, observed):
    """All that the loop computes in a tick, called one after the other without a Diagram; the observer a tick late."""
    options = load_scenario("exact_fig7").controller
    scenario = load_scenario("exact_fig7", ALL)
    estimate = flat_estimate(ROBOT, scenario.sensors, options.period, compiled=True)
    tick = flat_tick(ROBOT, options, scenario.gravity, compiled=True)
    network = load_network()
    answer = network.compiled_weights()
    features = DensityFeatures(scenario.tuner.window, options.period, scenario.tuner.density, compiled=True)
    # The reference is evaluated some hundred ticks at a time, as `ReferenceSource` does.
    count = 256
    times = np.arange(count) * options.period
    home, still = inverse_kinematics(ROBOT, ROBOT.home_pose), static_torque(ROBOT, ROBOT.home_pose)
    observer = Observer(ROBOT, ObserverOptions(), scenario.gravity, options.period, 2e-5, friction=0.01)
    expected = np.array([observer.options.disturbance])
    observe = flat_observer(observer, lambda _, guess: guess, compiled=True)
    oppose = flat_feedforward(ROBOT, FrictionCompensation(coulomb=0.01), compiled=True)

    def block():
        seen, memory = initial_memory(ROBOT.home_pose), np.zeros(MEMORY_SIZE)
        if observed:
            seen = observer.initial(ROBOT.home_pose, np.zeros(6), still, 1)
        window = np.concatenate([np.ones(12), [0.0], np.zeros(12 * (scenario.tuner.window + 1))])
        weights = np.ones(2)
        reference = np.concatenate(scenario.reference.evaluate(times), axis=-1)
        for k in range(count):
            read = scenario.sensors.read(home + 1e-4 * (k % 7))
            if observed:
                seen = observe(read, still, reference[k], expected, seen)
                memory = tick(seen[12:24], reference[k], weights, memory)
                memory[:6] += seen[24:30] + oppose(reference[k])
            else:
                seen = estimate(read, seen)
                memory = tick(seen[:12], reference[k], weights, memory)
            window = features._tick(memory[6:12], memory[:6], window)
            weights = answer(window[:12])

    name = "mathematics of a tick with an observer" if observed else "mathematics of a tick"
    compare(name, block, "plant step", Loop().plant_alone, per=count, base_per=STEPS)


def test_riccati_equation(compare):
    """riccati_ratio: Drake's 18-state equation, matrices made beforehand, over the split solution with its gain."""
    from pydrake.math import DiscreteAlgebraicRiccatiEquation

    acceleration_map = pose_acceleration_map(ROBOT, ROBOT.home_pose)
    a, b = discretize(state_matrix(), input_matrix(acceleration_map), 0.001)
    q = np.zeros(STATES)
    for states, weight in zip((POSITION, RATE, INTEGRAL), BLOCKS[:3], strict=True):
        q[states] = weight * np.array([0.11**2] * 3 + [1.0] * 3)
    q, r = np.diag(q), np.eye(6)
    work, gain = np.empty((6, 6)), np.empty((6, 18))

    def split():
        work[:] = acceleration_map.T
        return control.split_gain(work, 0.11, 0.001, BLOCKS, True, gain)

    assert split()
    expected = riccati_gain(a, b, r, DiscreteAlgebraicRiccatiEquation(a, b, q, r))
    np.testing.assert_allclose(gain, expected, rtol=1e-8, atol=1e-8 * np.abs(expected).max())
    compare(
        "split solution",
        lambda: [split() for _ in range(20)],
        "DARE of Drake",
        lambda: seconds(lambda: DiscreteAlgebraicRiccatiEquation(a, b, q, r)),
        per=20,
        inverse=True,
    )


def test_numpy_reference_of_a_tick(compare):
    """What compiling gains."""
    home = np.concatenate([ROBOT.home_pose, np.zeros(12)])
    options = LqiOptions(period=0.001, solver="split", model="exact", feedforward="full", weight_length=0.11)
    memory, calls = np.zeros(MEMORY_SIZE), {}
    for compiled in (True, False):
        tick = flat_tick(ROBOT, options, 9.81, compiled)
        calls[compiled] = lambda tick=tick: tick(home[:12], home, BLOCKS, memory)
    compare(
        "compiled LQI",
        lambda: [calls[True]() for _ in range(20)],
        "numpy LQI",
        lambda: seconds(calls[False]),
        per=20,
        inverse=True,
    )


@pytest.mark.parametrize(
    ("what", "code", "needs"),
    [
        ("import stewart_drake", "import stewart_drake", ""),
        (
            "stewart-drake run --help",
            "import sys; sys.argv = ['stewart-drake', 'run', '--help']\n"
            "from stewart_drake.cli.app import main\ntry:\n    main()\nexcept SystemExit:\n    pass",
            "",
        ),
        (
            "building a loop",
            "from stewart_drake import load_scenario, build_diagram; build_diagram(load_scenario('paper_fig7'))",
            "import pydrake.systems.analysis, pydrake.systems.primitives, pydrake.multibody.plant, "
            "pydrake.multibody.parsing, pydrake.geometry",
        ),
    ],
)
def test_start_up(benchmark, what, code, needs):
    """Seconds over those of the pydrake modules that it needs; neither torch nor numba may be among the rest."""
    check = "\nimport sys; assert not {'torch', 'numba'} & set(sys.modules)"

    def fastest(text):
        def once():
            begin = time.perf_counter()
            subprocess.run([sys.executable, "-c", text], check=True, capture_output=True)
            return time.perf_counter() - begin

        return min(once() for _ in range(5))

    base = fastest(needs or "pass")
    own = fastest((needs + "\n" if needs else "") + code + check)
    benchmark.pedantic(lambda: None, rounds=1)
    benchmark.extra_info[f"{what}: seconds"] = round(own - base, 3)
    print(f"\n{what}: {own - base:.2f} s over {base:.2f} s")
