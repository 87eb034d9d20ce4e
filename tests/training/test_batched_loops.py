"""Whole loops in a batch: the runs of the other engines, gradients that are differences, and loops that fail alone."""

import math

import numpy as np
import pytest
import torch

from stewart_drake.errors import ConfigurationError
from stewart_drake.hardware.observer import Observer, ObserverMemory, observe
from stewart_drake.hardware.sensing import LoopSite
from stewart_drake.logs.cost import FAILED, CostScales, run_cost
from stewart_drake.logs.metrics import run_metrics
from stewart_drake.mechanics.arrays import fitted, robot_like
from stewart_drake.mechanics.friction import friction_law
from stewart_drake.mechanics.kinematics import inverse_kinematics
from stewart_drake.plant.closed_chain import advanced, loaded, starting_state
from stewart_drake.plant.plant_options import PlantOptions
from stewart_drake.runs.simulation import run
from stewart_drake.scenario import load_scenario
from stewart_drake.training.batched_loops import BatchedLoops
from stewart_drake.training.loop_model import BatchedObserver, Chain, ObserverState, Plant, PlantState
from stewart_drake.training.loop_state import Costs
from stewart_drake.training.situations import ROBOTS, TRAINING, kinds_of, situation

PUSH = {"kind": "step", "wrench": [0.02, 0, 0, 3, -2, -4], "time": 0.01, "until": 0.15}
IDEAL = {"sensors": {"kind": "ideal"}, "estimator": {"kind": "difference"}}


def sine(amplitude, frequency):
    return {"kind": "sine", "amplitude": amplitude, "angular_frequency": [2.0 * math.pi * frequency] * 6}


HEART, FAST = sine([0, 0, 0, 0.003, 0, 0.005], 1.5), sine([0.02, 0.02, 0, 0.002, 0.002, 0.003], 4.0)
KINDS = {
    "breathing": {},
    "payload": {"reference": HEART, "plant.payload_mass": 0.4, "plant.payload_position": [0.02, 0.01, 0.05]},
    "push": {"reference": {"kind": "hold"}, "disturbances": [PUSH]},
    "noise": {"sensors.noise": 2e-4, "sensors.noise_seed": 7},
    "coarse": {"sensors.resolution_bits": 13, "sensors.offset": [1e-3, 0, 0, 0, -1e-3, 0]},
    "sticks": {"plant.motor_friction": 0.08},
    "late": {"command_delay": 4, "reference": HEART},
    "at once": {"command_delay": 0, "reference": FAST},
    "wrong delay": {"estimator.delay": 2, "reference": FAST},
    "rubs": {
        "disturbances": [PUSH],
        "plant.motor_friction": 0.0,
        "plant.friction": {"coulomb": 0.05, "break_away": [0.1, 0.08, 0.1, 0.1, 0.1, 0.07], "viscous": 0.01},
    },
    "off": {"initial_offset": [0.02, 0, 0, 0, 0.004, 0], "friction_compensation": None},
    "weights": {"tuner.q_pose": 8e5, "tuner.q_rate": 150.0, "tuner.q_integral": 5e6, "estimator.disturbance": 4.0},
    "shorter": {"duration": 0.02, "disturbances": [{"kind": "noise", "rms": [0.01] * 3 + [1.0] * 3}]},
}
"""Changes of `exact_breathing`."""


def base(name="exact_breathing", duration=0.3):
    return load_scenario(name, ("tuner={kind: block}", "safety=null")).replace(
        {"duration": duration, "plant.engine": "reduced"}
    )


def tensor(values):
    return torch.tensor(np.array(values), dtype=torch.float64)


def rolled(loops, setting=None, tuner=None, memory=None):
    """Poses (ticks, 6, B) and torques (ticks, 6, B) on the way, costs, and the state at the end."""
    state, parts, poses, torques = loops.start()._replace(memory=memory), [], [], []
    with torch.no_grad():
        for _ in range(loops.ticks):
            poses.append(state.plant.pose)
            state, costs = loops.advance(state, 1, setting, tuner)
            parts.append(costs)
            torques.append(state.last)
    return torch.stack(poses).numpy(), torch.stack(torques).numpy(), Costs.joined(parts), state


def cost_of(log):
    return run_cost(run_metrics(log), log.status, log.scenario.controller.period, CostScales())


def same_as_reduced(scenarios, tolerance):
    loops = BatchedLoops(scenarios)
    poses, torques, costs, state = rolled(loops)
    scores = loops.scored(costs, state)
    assert state.alive.all()
    for loop, scenario in enumerate(scenarios):
        log = run(scenario, check=False)
        # A row of the log is a tick.
        rows, limit = len(log["pose"]), scenario.robot.effort_limit
        np.testing.assert_allclose(poses[:rows, :, loop], log["pose"], rtol=0.0, atol=tolerance)
        asked = np.clip(log["torque"], -limit, limit)
        np.testing.assert_allclose(torques[:rows, :, loop], asked, rtol=0.0, atol=1e4 * tolerance)
        assert float(scores[loop]) == pytest.approx(cost_of(log), rel=1e-6)


@pytest.mark.parametrize("duration", [0.03, pytest.param(0.3, marks=pytest.mark.slow)])
def test_it_is_the_run_of_the_reduced_engine(duration):
    """All kinds in one batch, with counts and noise: the same numbers but for rounding."""
    same_as_reduced([base(duration=duration).replace(changes) for changes in KINDS.values()], 1e-10)


@pytest.mark.parametrize("duration", [0.02, pytest.param(0.3, marks=pytest.mark.slow)])
def test_so_it_is_without_an_observer(duration):
    sensed = ("sensors", "estimator")
    fine = [each for each in KINDS.values() if not any(key.split(".")[0] in sensed for key in each)]
    same_as_reduced([base(duration=duration).replace({**changes, **IDEAL}) for changes in fine], 1e-10)


@pytest.mark.parametrize("saturation", ["none", "clamp", "back_calculation"])
def test_so_it_is_at_the_motors_limits(saturation):
    cuts = {"initial_offset": [0, 0, 0, 0.01, 0, 0], "robot.effort_limit": 1.2}
    same_as_reduced([base(duration=0.03).replace({**IDEAL, **cuts, "controller.saturation": saturation})], 1e-10)


@pytest.mark.parametrize("duration", [0.1, pytest.param(0.8, marks=pytest.mark.slow)])
def test_so_is_another_robot_at_100_hz(duration):
    kinds = ({}, {"plant.payload_mass": 0.05}, {"reference": {"kind": "hold"}}, {"command_delay": 2})
    same_as_reduced([base("reachy_nod", duration).replace(changes) for changes in kinds], 1e-8)


def test_an_observer_of_a_pose_and_a_model_that_is_wrong():
    wrong = base().robot.replace(platform_mass=1.1)
    same_as_reduced([base(duration=0.03).replace({"sensors": {"kind": "ideal"}, "model_robot": wrong})], 1e-10)


def test_a_tuner_acts_from_the_next_tick_on():
    seen = []

    def tuner(observed, memory):
        seen.append((observed, memory))
        return torch.full((2, 4), 0.1 * (memory >= 2), dtype=torch.float64), memory + 1

    loops = BatchedLoops([base(duration=0.01)] * 2)
    told = rolled(loops, tuner=tuner, memory=0)[1]
    plain = rolled(loops)[1]
    assert [memory for _, memory in seen] == list(range(11))
    assert [np.shape(each) for each in seen[0][0]] == [(2, 6), (2, 6), (2, 6), (2, 18)]
    np.testing.assert_array_equal(told[:3], plain[:3])
    assert np.abs(told[3] - plain[3]).min() > 1e-9


def test_pieces_and_places_in_a_batch_do_not_matter():
    scenarios = [base(duration=0.04).replace(changes) for changes in KINDS.values()]
    whole, order = BatchedLoops(scenarios), [5, 2, 9]
    some = BatchedLoops([scenarios[loop] for loop in order])
    with torch.no_grad():
        _, costs = whole.advance(whole.start(), 20)
        state, first = some.advance(some.start(), 7)
        _, second = some.advance(state.detached(), 13)
    for mine, theirs in zip(Costs.joined([first, second]), costs, strict=True):
        np.testing.assert_allclose(mine, theirs[order], rtol=1e-6, atol=1e-20)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["exact_breathing", "reachy_nod"])
def test_the_gradient_of_a_runs_cost_is_that_of_differences(name):
    """With friction's corners rounded, and no counts, whose steps have no slope."""
    quiet = base(name, 0.04 if name == "exact_breathing" else 0.25).replace({"sensors.resolution_bits": 0})
    changes = [
        {},
        {"command_delay": 3},
        {"command_delay": 0, "plant.payload_mass": 0.05},
        {"plant.motor_friction": 0.03},
    ]
    push = [{**PUSH, "wrench": [0.1 * part for part in PUSH["wrench"]], "time": 0.02}]
    loops = BatchedLoops([quiet.replace({"disturbances": push, **each}) for each in changes], width=0.2)

    def scores(setting):
        state, costs = loops.advance(loops.start(), loops.ticks, setting)
        return loops.scored(costs, state)

    at = tensor(np.random.default_rng(0).uniform(-0.1, 0.1, (len(changes), 4))).requires_grad_()
    scores(at).sum().backward()
    with torch.no_grad():
        for part, step in enumerate(1e-4 * torch.eye(4, dtype=torch.float64)):
            differences = (scores(at + step) - scores(at - step)) / 2e-4
            np.testing.assert_allclose(at.grad[:, part], differences, rtol=1e-4, atol=1e-5)


def test_a_loop_that_fails_harms_no_other():
    """One is pushed off, one starts where it cannot follow; values and gradients of the others are as without them."""
    good = base(duration=0.03).replace({"sensors.resolution_bits": 0})
    off = {"disturbances": [{"kind": "step", "wrench": [30.0, 40.0, 20.0, 900.0, -900.0, -2000.0], "time": 0.01}]}
    both, alone = BatchedLoops([good, good.replace(off), good], width=0.2), BatchedLoops([good] * 2, width=0.2)

    def scored(loops, count):
        setting = torch.zeros((count, 4), dtype=torch.float64, requires_grad=True)
        state, costs = loops.advance(loops.start(), loops.ticks, setting)
        scores = loops.scored(costs, state)
        scores.sum().backward()
        return state, scores.detach().numpy(), setting.grad.numpy()

    state, scores, slopes = scored(both, 3)
    _, wanted, slopes_alone = scored(alone, 2)
    assert state.alive.tolist() == [True, False, True]
    assert scores[1] == FAILED
    assert np.isfinite(slopes).all()
    np.testing.assert_allclose(scores[[0, 2]], wanted, rtol=1e-9)
    np.testing.assert_allclose(slopes[[0, 2]], slopes_alone, rtol=1e-6)
    assert run(good.replace(off), check=False).status != "completed"


def test_the_taste_scales_the_torques_change():
    loops = BatchedLoops([base(duration=0.02)] * 3)
    *_, costs, state = rolled(loops)
    quiet, even, stiff = loops.scored(costs, state, torch.tensor([-1.0, 0.0, 1.0], dtype=torch.float64)).tolist()
    change = CostScales(torque_change=0.003)
    assert quiet < even < stiff
    assert stiff == pytest.approx(float(loops.scored(costs, state, scales=change)[0]))


REFUSED = {
    "motors={ripple: 0.01}": "motors",
    "link={drop_probability: 0.1}": "link",
    "safety={}": "safety",
    "sensors.faults=[{leg: 1, kind: nan}]": "sensors.faults",
    "controller.model=paper": "controller.model",
    "controller={kind: pid}": "controller.kind",
    "tuner={kind: fixed}": "tuner.kind",
    "estimator={kind: difference}": "sensors.kind",
}


@pytest.mark.parametrize(("change", "key"), REFUSED.items())
def test_what_a_batch_cannot_have_is_refused(change, key):
    scenario = load_scenario("exact_breathing", ("tuner={kind: block}", change))
    with pytest.raises(ConfigurationError, match=f"^{key}: "):
        BatchedLoops([scenario])


def test_loops_of_a_batch_share_robot_and_ticks():
    with pytest.raises(ConfigurationError, match=r"^robot: .* the same in all loops"):
        BatchedLoops([base(), base().replace({"robot.platform_mass": 1.2})])
    with pytest.raises(ConfigurationError, match=r"^controller: "):
        BatchedLoops([base(), base().replace({"controller.period": 0.002})])
    with pytest.raises(ConfigurationError, match=r"^estimator: "):
        BatchedLoops([base(), base().replace(IDEAL)])
    with pytest.raises(ConfigurationError, match=r"^scenarios: "):
        BatchedLoops([])


def test_a_step_is_that_of_the_closed_chain():
    rng, scenario = np.random.default_rng(8), base()
    robot, options = scenario.robot, PlantOptions(payload_mass=0.3, payload_position=(0.02, 0.01, 0.04))
    law = friction_law(0.05, 0.08, 0.01, 0.02, robot.crank_axis_inertias, 1e-3)
    own, states = loaded(robot, options), []
    for _ in range(7):
        pose, rate = robot.home_pose + 0.02 * rng.standard_normal(6), 0.3 * rng.standard_normal(6)
        state = starting_state(robot, pose, rate)
        states.append(
            state._replace(anchor=state.anchor + 1e-5 * rng.standard_normal(6), slip=0.01 * rng.standard_normal(6))
        )
    torque, wrench = rng.normal(size=(2, 7, 6))
    wanted = [advanced(own, law, 9.81, 1e-3, *given) for given in zip(torque, wrench, states, strict=True)]

    batched = [tensor(np.stack(each, axis=-1)) for each in zip(*states, strict=True)]
    pose, _, *rest = batched
    fixed = fitted(robot_like(robot, pose), 1)._replace(
        platform_mass=tensor([float(own.platform_mass)] * 7),
        platform_moment=tensor(np.stack([own.platform_moment] * 7, axis=-1)),
        platform_inertia=tensor(np.stack([own.platform_inertia] * 7, axis=-1)),
    )
    plant = Plant(fixed, type(law)(*(tensor([each] * 7) for each in law)), 9.81, 1e-3, 0.0)
    # Bristles that are under tension have been looked at.
    state = PlantState(pose, *rest)
    chain = Chain.at(fixed, pose)
    ahead = plant.pushed(state, chain, tensor(torque).T, tensor(wrench).T)
    ahead, _ = plant.arrived(ahead)
    for name in PlantState._fields:
        there = np.stack([getattr(each, name) for each in wanted], axis=-1)
        np.testing.assert_allclose(getattr(ahead, name), there, rtol=1e-9, atol=1e-10, err_msg=name)


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_a_tick_of_the_observer_is_that_of_the_reference(delay):
    rng, scenario = np.random.default_rng(9), base()
    robot, site = scenario.robot, LoopSite.of(scenario)
    observer = Observer(robot, scenario.estimator, 9.81, 1e-3, 2e-5, 0.01)
    poses = robot.home_pose + 0.02 * rng.standard_normal((5, 6))
    rates, surplus, disturbance = 0.2 * rng.standard_normal((5, 6)), rng.normal(size=(5, 6)), rng.uniform(1.0, 60.0, 5)
    commands, sent = site.still + 0.1 * rng.normal(size=(5, delay + 1, 6)), site.still + rng.normal(size=(5, 6))
    angles = inverse_kinematics(robot, poses) + 1e-4 * rng.normal(size=(5, 6))
    angles[2, 3] += 0.2
    wanted = np.concatenate([poses, rates, 0.0 * poses], axis=-1)
    wanted[4, :12] = np.concatenate([poses[4], np.zeros(6)])
    none, there = np.zeros(6), []
    for loop in range(5):
        memory = ObserverMemory(
            poses[loop], rates[loop], none, none, none, none, surplus[loop], none, np.zeros(1), commands[loop]
        )
        there.append(observe(observer, angles[loop], sent[loop], wanted[loop], disturbance[loop], memory))

    same = torch.ones(5, dtype=torch.float64)
    mine = BatchedObserver(
        fitted(robot_like(robot, same), 1), 9.81, 1e-3, 2e-5 * same, observer.slip * same, 0.05 * same, 10.0 * same,
        torch.full((5,), delay), (None,) * delay,
    )  # fmt: skip
    pose, rate, more, kicked = (tensor(each).T for each in (poses, rates, surplus, angles))
    history = [tensor(commands[:, row]).T for row in range(delay + 1)] + [tensor(sent).T]
    expected = mine.advanced(pose, rate, history[1], more)
    state = ObserverState(pose, rate, more, 0.0 * pose, 0.0 * pose, *expected)
    state, good = mine.corrected(state, kicked, tensor(wanted).T, tensor(disturbance))
    assert good.all()
    _, ahead, rate_ahead = mine.looked_ahead(state, tuple(history[2:]))
    found = {**state._asdict(), "pose_ahead": ahead, "rate_ahead": rate_ahead}
    for name in ("pose", "rate", "surplus", "missed", "innovation", "pose_ahead", "rate_ahead"):
        told = np.stack([getattr(each, name) for each in there], axis=-1)
        np.testing.assert_allclose(found[name], told, rtol=1e-9, atol=1e-11, err_msg=name)


@pytest.mark.slow
def test_paths_are_those_of_drakes_plant():
    """Without noise and counts, over four seconds."""
    push, exact = {**PUSH, "time": 1.0, "until": 1.5}, {"sensors.resolution_bits": 0, "sensors.noise": 0.0}
    chosen = (KINDS[kind] for kind in ("breathing", "payload", "push", "late", "rubs", "off"))
    scenarios = [base(duration=4.0).replace({**changes, **exact}) for changes in chosen]
    scenarios = [each.replace({"disturbances": [push]}) if each.disturbances else each for each in scenarios]
    poses = rolled(BatchedLoops(scenarios))[0]
    for loop, scenario in enumerate(scenarios):
        apart = poses[:, :, loop] - run(scenario.replace({"plant.engine": "drake"}), check=False)["pose"]
        assert 1e3 * np.linalg.norm(apart[:, 3:], axis=1).max() < 0.02
        assert np.degrees(np.linalg.norm(apart[:, :3], axis=1)).max() < 0.01


def both_costs(robot, count, changes):
    """J of situations of all kinds for the robot, here and on Drake's plant."""
    kinds = kinds_of(robot)
    drawn = [situation(kinds[number % len(kinds)], robot, TRAINING[number]) for number in range(count)]
    scenarios = [each.replace(changes) for each in drawn]
    loops = BatchedLoops(scenarios)
    *_, costs, state = rolled(loops)
    return loops.scored(costs, state).numpy(), np.array([cost_of(run(each, check=False)) for each in scenarios])


@pytest.mark.slow
@pytest.mark.parametrize("robot", ROBOTS)
def test_costs_of_situations_are_those_on_drakes_plant(robot):
    """Fifty of them between the two robots, with noise, friction that sticks, payloads, delays and pushes.

    A Reachy Mini that rests costs 0.02, and by a tenth of that Drake's friction yields otherwise than ours.
    """
    mine, drakes = both_costs(robot, 25, {"sensors.resolution_bits": 0})
    np.testing.assert_allclose(mine, drakes, rtol=0.05, atol=0.002)


@pytest.mark.slow
def test_counts_change_a_runs_cost_no_more_than_another_seed_would():
    """A reading at the edge of a count falls to the other side: other noise from there on, of the same size."""
    mine, drakes = both_costs("paper", 14, {})
    off = np.abs(mine / drakes - 1.0)
    assert np.median(off) < 0.02
    assert off.max() < 0.12
