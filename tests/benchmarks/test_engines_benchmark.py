"""Steps a second of Drake's plant and of MuJoCo: the same mechanism, motion and step, in one run: `make bench`."""

import pytest
from pydrake.systems.analysis import Simulator

from stewart_drake import PlantOptions, RobotParameters, build_plant
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY, static_torque
from stewart_drake.mujoco_model import MujocoRobot

ROBOT = RobotParameters()
STEP, STEPS = 0.001, 150
TORQUE = 0.8 * static_torque(ROBOT, ROBOT.home_pose)
"""[N m] lets the platform sink by 2 cm in a round."""
MEDIANS: dict[str, float] = {}


@pytest.fixture
def record(benchmark):
    """Runs a benchmark from the home pose in every round; its steps a second, and Drake's over each other engine's."""

    def run(name, restart, advance, rounds=15):
        benchmark.pedantic(advance, setup=restart, rounds=rounds, warmup_rounds=2)
        MEDIANS[name] = benchmark.stats.stats.median
        rate = STEPS / MEDIANS[name]
        benchmark.extra_info["steps per second"] = round(rate)
        print(f"\n{name}: {rate:,.0f} steps a second")
        if "drake" in MEDIANS and name != "drake":
            ratio = MEDIANS[name] / MEDIANS["drake"]
            benchmark.extra_info[f"drake / {name}"] = round(ratio, 3)
            print(f"steps a second, drake / {name} = {ratio:.3f}")

    return run


def test_drake(record):
    diagram, plant = build_plant(ROBOT)
    assert plant.plant.time_step() == pytest.approx(STEP)
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    diagram.GetInputPort("torque").FixValue(context, TORQUE)

    def restart():
        context.SetTime(0.0)
        plant.set_state(context, ROBOT.home_pose)
        simulator.Initialize()

    record("drake", restart, lambda: simulator.AdvanceTo(STEPS * STEP))
    sunk = ROBOT.home_height - plant.pose_and_rate(diagram.GetOutputPort("state").Eval(context))[0][5]
    assert sunk == pytest.approx(0.02, rel=0.2)


@pytest.mark.parametrize("integrator", ["Euler", "RK4"])
def test_mujoco(record, integrator):
    engine, (_, plant) = (
        MujocoRobot(ROBOT, STANDARD_GRAVITY, PlantOptions(time_step=STEP), integrator),
        build_plant(ROBOT),
    )
    start = plant.assemble(ROBOT.home_pose)
    record(f"mujoco {integrator}", lambda: engine.set_state(plant, start), lambda: engine.advance(TORQUE, STEPS))
    sunk = ROBOT.home_height - engine.platform[2]
    assert sunk == pytest.approx(0.02, rel=0.2)
