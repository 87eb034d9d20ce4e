"""What the loop costs, as ratios measured in one run: `make bench`."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from stewart_drake import LqiOptions, RobotParameters, build_diagram, build_plant, load_scenario
from stewart_drake.force_map import force_map
from stewart_drake.lqi import lqi_gain
from stewart_drake.state_space import mass_diagonal

SECONDS = 0.5
"""[s] simulated per round."""
MEDIANS: dict[str, float] = {}


@pytest.fixture
def record(benchmark):
    """Runs a benchmark, keeps its median under a name, and prints the ratio to another."""

    def run(name, function, over=None, rounds=5):
        benchmark.pedantic(function, rounds=rounds, warmup_rounds=1)
        MEDIANS[name] = benchmark.stats.stats.median
        if over in MEDIANS:
            ratio = MEDIANS[name] / MEDIANS[over]
            benchmark.extra_info[f"{name} / {over}"] = round(ratio, 3)
            print(f"\n{name} / {over} = {ratio:.3f}")
        assert MEDIANS[name] > 0.0

    return run


def test_plant_alone(record):
    diagram, plant = build_plant(RobotParameters(), gravity=0.0)
    simulator = Simulator(diagram)
    diagram.GetInputPort("torque").FixValue(simulator.get_mutable_context(), np.zeros(6))
    plant.set_state(simulator.get_mutable_context(), plant.robot.home_pose)
    record("plant", lambda: simulator.AdvanceTo(simulator.get_context().get_time() + SECONDS))


@pytest.mark.parametrize("period", [0.005, 0.001])
def test_closed_loop(record, period):
    loop = build_diagram(load_scenario("paper_fig7", [f"controller.period={period}"]))
    simulator = Simulator(loop, loop.create_start_context())
    name = f"loop with control every {1e3 * period:g} ms"
    record(name, lambda: simulator.AdvanceTo(simulator.get_context().get_time() + SECONDS), over="plant")


@pytest.mark.parametrize("solver", ["split", "drake"])
def test_gain(record, solver):
    robot = RobotParameters()
    acceleration_map = force_map(robot, robot.home_pose) / mass_diagonal(robot)[:, None]
    options, weights = LqiOptions(solver=solver), np.ones(2)

    def hundred():
        for _ in range(100):
            lqi_gain(acceleration_map, options, weights)

    record(f"100 gains by {solver}", hundred, over="100 gains by split")
