"""Six commands rounded together: whole counts, as good as any near them, and quieter in motion."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lsim
from setups import setup_for
from strategies import ROBOT, vectors

from stewart_drake import load_scenario, run, run_metrics
from stewart_drake.hardware.rounding import rounding_part, shaping
from stewart_drake.mechanics.kinematics import leg_geometry, rod_lines

COUNT = 2.0 * np.pi / 4096.0
POSE = ROBOT.home_pose + [0.1, -0.05, 0.1, 0.0, 0.01, 0.01]


def rounded(commands, rate=(0.0, 0.1, 0.0, 0.0, 0.0, 0.0), shares=None):
    part = rounding_part(setup_for(), 2.0, 0.1, COUNT)
    if shares is not None:
        part.parameters["params"]["shares"] = shares
    state, made = part.initial.copy(), []
    for command in commands:
        part.tick(command, np.concatenate([POSE, rate, np.zeros(6)]), state)
        made.append(state["command"][0].copy())
    return np.array(made)


@given(vectors(6, 1.0))
def test_of_the_counts_within_one_of_each_command_they_take_those_that_move_the_platform_least(command):
    (made,) = rounded([command], shares=(0.0, 0.0))
    counts = made / COUNT
    np.testing.assert_allclose(counts, np.rint(counts), atol=1e-6)
    legs = leg_geometry(ROBOT, POSE)
    to_twist = np.linalg.inv(rod_lines(legs) / (ROBOT.crank_lengths * legs.transmission)[:, None])
    to_twist[:3] *= ROBOT.characteristic_length
    nearest = COUNT * np.rint(command / COUNT)
    steps = [np.zeros(6)]
    for i, j in itertools.combinations(range(6), 2):
        for one, other in itertools.product((-COUNT, 0.0, COUNT), repeat=2):
            step = np.zeros(6)
            step[[i, j]] = one, other
            steps.append(step)
    best = min(np.linalg.norm(to_twist @ (nearest + step - command)) for step in steps)
    assert np.linalg.norm(to_twist @ (made - command)) == pytest.approx(best, rel=1e-6)


def test_at_rest_each_is_rounded_alone():
    commands = np.linspace(0.0, 1.3 * COUNT, 7)[:, None] + np.zeros(6)
    np.testing.assert_allclose(rounded(commands, rate=np.zeros(6)), COUNT * np.rint(commands / COUNT))


@settings(max_examples=15)
@given(st.floats(0.5, 20.0), st.floats(0.02, 1.0), st.floats(0.004, 0.04))
def test_the_shares_make_the_velocity_of_a_servo_least(stiffness, damping, period):
    inertia, samples, ticks = 0.003, 16, 150
    system = [stiffness / inertia, 0.0], [1.0, damping / inertia, stiffness / inertia]
    time = np.arange(samples * ticks) * period / samples

    def power(shares):
        # An error, and what the next two commands make of it, each held for a period.
        held = np.repeat([1.0, -shares[0], -shares[1]] + [0.0] * (ticks - 3), samples)
        return np.sum(lsim(system, held, time, interp=False)[1] ** 2)

    best = shaping(stiffness, damping, inertia, period)
    for change in 0.05 * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0], [1.0, -1.0], [-1.0, 1.0]]):
        assert power(best) <= power(best + change) * (1.0 + 1e-6)


def test_a_slow_motion_trembles_less():
    servos = {"kind": "position", "preset": "xl330_m288", "delay": 0.01}
    slow = {"kind": "sine", "amplitude": [0, 0, 0, 0, 0, 0.005], "angular_frequency": 0.7}
    changes = {"reference": slow, "motors": servos, "controller": {"kind": "feedforward", "period": 0.02}}
    scenario = load_scenario("reachy_nod").replace(
        {**changes, "plant.kind": "closed_form", "estimator": {"kind": "difference"}, "tuner": "fixed", "safety": None}
    )
    unaware = scenario.replace({"model.motors": {**servos, "resolution_bits": None}})
    together, alone = (run_metrics(run(each, check=False)) for each in (scenario, unaware))
    assert together["ripple_mm_s"] < 0.6 * alone["ripple_mm_s"]
    assert together["rmse_norm_mm"] < 0.8 * alone["rmse_norm_mm"]
