"""Closed loops in one batch over MuJoCo with the compiled tick, one thread, one process: `make bench`."""

import time

import numpy as np
import pytest
import torch

from stewart_drake import load_scenario
from stewart_drake.control.lqi import MEMORY_SIZE, flat_tick
from stewart_drake.mujoco_model import MujocoRobot
from stewart_drake.plant.multibody_plant import build_plant
from stewart_drake.plant.plant_options import PlantOptions
from stewart_drake.training.batched_loops import BatchedLoops

COUNTS = (1024, 4096)
IDEAL = {
    "sensors": {"kind": "ideal"},
    "tuner": {"kind": "block", "q_pose": 8e5, "q_rate": 150.0, "q_integral": 5e6},
    "estimator": {"kind": "difference"},
    "plant": {},
    "friction_compensation": None,
    "command_delay": 0,
}
SCENARIO = load_scenario("exact_breathing").replace({"duration": 1.0, **IDEAL})
TICKS = {"forward": 20, "forward and gradient": 10}


@pytest.fixture
def one_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def other_engine():
    """A tick: a step of MuJoCo and the compiled LQI of the same scenario, at 1 kHz."""
    robot, options = SCENARIO.robot, PlantOptions()
    engine = MujocoRobot(robot, SCENARIO.gravity, options)
    _, stewart = build_plant(robot, options)
    engine.set_state(stewart, stewart.assemble(robot.home_pose))
    tick = flat_tick(robot, SCENARIO.lqi, SCENARIO.gravity, compiled=True)
    weights, wanted = np.array(SCENARIO.tuner.weights), np.concatenate([robot.home_pose, np.zeros(12)])
    measured, memory = np.concatenate([robot.home_pose, np.zeros(6)]), np.zeros(MEMORY_SIZE)

    def run(ticks):
        said = memory
        for _ in range(ticks):
            # MuJoCo's quaternion is not made a pose: that is no part of either engine.
            said = tick(measured, wanted, weights, said)
            engine.advance(said[:6], 1)

    return run


def batched(count, gradient):
    loops = BatchedLoops([SCENARIO] * count)
    setting = torch.zeros((count, 4), dtype=torch.float64, requires_grad=gradient)
    begin = loops.start()

    def run(ticks):
        with torch.set_grad_enabled(gradient):
            _, costs = loops.advance(begin, ticks, setting)
        if gradient:
            sum(each.sum() for each in costs).backward()

    return run


def per_tick(run, ticks):
    begin = time.process_time()
    run(ticks)
    return (time.process_time() - begin) / ticks


@pytest.mark.parametrize("what", TICKS)
@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.usefixtures("one_thread")
def test_closed_loops_at_1_khz(benchmark, count, what):
    """Exact-model LQI, ideal sensing; in turns with the other engine, as the machine's speed changes."""
    other, mine = other_engine(), batched(count, what != "forward")
    ticks, pairs = TICKS[what], []
    per_tick(other, 100), per_tick(mine, 2)

    def both():
        pairs.append((per_tick(other, 1000), per_tick(mine, ticks) / count))

    benchmark.pedantic(both, rounds=5, warmup_rounds=0)
    theirs, ours = np.array(pairs).T
    ratio = float(np.median(theirs / ours))
    benchmark.extra_info[f"{count} loops, {what}: speed over MuJoCo and compiled tick"] = round(ratio, 2)
    print(
        f"\n{count} loops, {what}: {ratio:.1f} times as fast as MuJoCo with the compiled tick, "
        f"{1e-3 / np.median(ours):.0f} simulated seconds a second (processor time, median; "
        f"{1e6 * np.median(ours):.1f} us a loop and tick, {1e6 * np.median(theirs):.1f} there)"
    )
    assert ratio > 0.0
