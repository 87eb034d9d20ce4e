"""Steps a second of Drake's plant and of MuJoCo: the same mechanism, motion and step, in one run: `make bench`."""

import time

import numpy as np
import pytest
from mujoco_robot import MujocoRobot
from pydrake.systems.analysis import Simulator

from stewart_drake import DrakeOptions, RobotParameters, build_plant, load_scenario, run
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY, static_torque

ROBOT = RobotParameters()
STEP, STEPS = 0.001, 150
TORQUE = 0.8 * static_torque(ROBOT, ROBOT.home_pose)  # [N m] lets the platform sink by 2 cm in a round


@pytest.fixture
def record(benchmark):
    def run(name, restart, advance):
        benchmark.pedantic(advance, setup=restart, rounds=15, warmup_rounds=2)
        rate = STEPS / benchmark.stats.stats.median
        benchmark.extra_info["steps per second"] = round(rate)
        print(f"\n{name}: {rate:,.0f} steps a second")

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


def test_mujoco(record):
    engine = MujocoRobot(ROBOT, STANDARD_GRAVITY, DrakeOptions(time_step=STEP))
    _, plant = build_plant(ROBOT)
    start = plant.assemble(ROBOT.home_pose)
    record("mujoco", lambda: engine.set_state(plant, start), lambda: engine.advance(TORQUE, STEPS))
    assert ROBOT.home_height - engine.platform[2] == pytest.approx(0.02, rel=0.2)


ENCODERS = (
    "sensors={kind: encoders, resolution_bits: 17, noise: 2.0e-5}",
    "estimator={kind: difference, rate_cutoff: 150}",
    "command_delay=1",
    "plant.motor_friction=0.01",
)
OBSERVER = ("estimator={kind: observer}", "model.friction={coulomb: 0.01}")


SAFETY = (*OBSERVER, "safety={}")


# The safety layer costs both alike.
@pytest.mark.parametrize(
    ("changes", "least"), [((), 9.0), (OBSERVER, 7.5), (SAFETY, 6.5)], ids=["differences", "observer", "safety"]
)
def test_a_whole_run(benchmark, changes, least):
    scenario = load_scenario("exact_breathing", ("duration=2.5", "tuner=block", *ENCODERS, *changes))
    fast = scenario.replace({"plant.kind": "closed_form"})
    mine, drake = [], []

    def seconds(each):
        begin = time.process_time()
        assert run(each).status == "completed"
        return time.process_time() - begin

    def both():
        drake.append(seconds(scenario))
        mine.append(seconds(fast))

    seconds(fast)
    benchmark.pedantic(both, rounds=5, warmup_rounds=1)
    ratio = float(np.median(np.array(drake) / mine))
    ticks = scenario.duration / scenario.controller.period
    benchmark.extra_info["drake / closed form"] = round(ratio, 2)
    print(
        f"\nwhole run: drake / closed form = {ratio:.1f} (processor time, median; "
        f"closed form {1e6 * np.median(mine) / ticks:.0f} us a tick, drake {1e6 * np.median(drake) / ticks:.0f})"
    )
    assert ratio > least
