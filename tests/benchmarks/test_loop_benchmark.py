"""What the loop costs, as ratios measured in one run: `make bench`."""

import itertools
import time

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from stewart_drake import Controller, RobotParameters, build_plant, inverse_kinematics, load_scenario
from stewart_drake.base.sampling import on_grid
from stewart_drake.control.riccati import (
    INTEGRAL,
    POSITION,
    RATE,
    STATES,
    discretize,
    input_matrix,
    split_solution,
    state_matrix,
)
from stewart_drake.mechanics.dynamics import pose_acceleration_map
from stewart_drake.systems import diagram

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

    def __init__(self, *changes, scenario="exact_fig7", sparse=False):
        self.loop = diagram.ClosedLoop(load_scenario(scenario, changes), sparse=sparse)
        self.simulator = Simulator(self.loop)
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


@pytest.mark.parametrize("observed", [False, True], ids=["differences", "observer"])
def test_a_tick_of_the_controller(compare, observed):
    """The controller's side without a Diagram: estimator, reference, regulator, densities, network."""
    changes = ["estimator={kind: observer}", "model.friction={coulomb: 0.01}"] if observed else []
    scenario = load_scenario("exact_fig7", [*ALL, "reference={kind: breathing}", *changes])
    controller, torque, count = Controller(scenario), np.empty(6), 256
    home, tick = inverse_kinematics(ROBOT, scenario.start()[0]), itertools.count()

    def block():
        for k in range(count):
            controller.step(scenario.sensors.read(home + 1e-4 * (k % 7)), next(tick) * controller.period, torque)

    name = "tick with an observer" if observed else "tick"
    compare(name, block, "plant step", Loop().plant_alone, per=count, base_per=STEPS)


def test_a_tick_that_learns(compare):
    """The controller's side with the regression and without, its blocks included."""
    home, count = inverse_kinematics(ROBOT, load_scenario("exact_breathing").start()[0]), 500

    def steps(*changes):
        scenario = load_scenario("exact_breathing", ["sensors=encoders", "model.friction={coulomb: 0.08}", *changes])
        controller, torque, tick = Controller(scenario), np.empty(6), itertools.count()

        def block():
            for _ in range(count):
                at = next(tick)
                angles = home + 0.1 * np.sin(0.006 * at + np.arange(6.0))
                controller.step(scenario.sensors.read(angles), at * controller.period, torque)

        return block

    without = steps()
    compare(
        "learning tick", steps("adaptation=regression"), "tick", lambda: seconds(without), per=count, base_per=count
    )


def test_riccati_equation(compare):
    """riccati_ratio: Drake's 18-state equation, matrices made beforehand, over the split solution with its gain."""
    from pydrake.math import DiscreteAlgebraicRiccatiEquation

    acceleration_map = pose_acceleration_map(ROBOT, ROBOT.home_pose)
    a, b = discretize(state_matrix(), input_matrix(acceleration_map), 0.001)
    q = np.zeros(STATES)
    for states, weight in zip((POSITION, RATE, INTEGRAL), BLOCKS[:3], strict=True):
        q[states] = weight * np.array([0.11**2] * 3 + [1.0] * 3)
    q, r = np.diag(q), np.eye(6)
    gain = np.empty((6, 18))

    def split():
        return split_solution(acceleration_map, 0.11, 0.001, BLOCKS, gain)

    assert split()
    compare(
        "split solution",
        lambda: [split() for _ in range(20)],
        "DARE of Drake",
        lambda: seconds(lambda: DiscreteAlgebraicRiccatiEquation(a, b, q, r)),
        per=20,
        inverse=True,
    )
