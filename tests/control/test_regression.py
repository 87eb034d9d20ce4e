"""What a robot learns of itself: the estimator against dense least squares, the law against robots of known truth."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import optimize

from stewart_drake import ConfigurationError, Controller, inverse_kinematics, load_robot, load_scenario, run
from stewart_drake.control import adaptation_laws as law
from stewart_drake.control import square_root_filter
from stewart_drake.control.adaptation import (
    RegressionOptions,
    kernel_weights,
    last_learnt,
    late_weights,
    model_of,
    regression_part,
    room_of,
    rows_of,
)
from stewart_drake.control.ball_joints import BallJoints
from stewart_drake.control.learnt_parameters import first_intervals
from stewart_drake.control.regression_records import Learnt, Sample
from stewart_drake.control.square_root_filter import N_MOTOR, N_SHARED
from stewart_drake.logs.signals import SIGNALS
from stewart_drake.mechanics.kinematics_laws import Legs
from stewart_drake.scenario.control_side import context_of

SIZE = 6 * N_MOTOR + N_SHARED
REAL = {"stiffness": 0.85, "ratios": [1.04, 0.97, 1.0, 0.96, 1.03, 1.0], "delay": 0.04, "damping": 0.044}
DRY = [0.02, 0.022, 0.018, 0.021, 0.019, 0.02]
SERVOS = {
    "robot": "reachy_mini",
    "plant": {"kind": "closed_form", "integrator": "rk4", "friction": {"coulomb": DRY, "viscous": 0.006}},
    "motors": {"kind": "position", "preset": "xl330_m288", **REAL},
    "sensors": {"kind": "encoders", "resolution_bits": 12, "delay": 0.01},
    "bounds": {"rotation": None, "position": None, "motion_ratio": None, "error_ratio": None},
    "model": {
        "motors": {"kind": "position", "preset": "xl330_m288", "delay": 0.03},
        "friction": {"coulomb": 0.0128, "viscous": 0.0037, "width": 0.004},
    },
    "reference": {"kind": "sine", "amplitude": [0.0, 0.26, 0.0, 0.0, 0.0, 0.0], "angular_frequency": "1 Hz"},
    "controller": {"kind": "feedforward", "period": 0.02},
    "adaptation": {"kind": "regression"},
    "estimator": "difference",
    "tuner": "block",
    "command_delay": 0,
    "safety": None,
}


def servos(duration=8.0, **changes):
    return load_scenario("reachy_nod").replace({**SERVOS, "duration": duration, "plant.time_step": 0.0005, **changes})


def late_error(log):
    return float(np.sqrt(np.mean(np.sum(log.error[log.time > 0.6 * log.scenario.duration, :3] ** 2, axis=1))))


def arrows(rng, rows=40):
    """A factor with a prior, and the dense rows (n, SIZE), with right-hand sides, that it stands for."""
    motor_rows, shared_rows = np.zeros((6, N_MOTOR, N_MOTOR + N_SHARED + 1)), np.zeros((N_SHARED, N_SHARED + 1))
    prior = rng.uniform(0.5, 2.0, SIZE)
    for k in range(N_MOTOR):
        motor_rows[:, k, k] = prior[k : 6 * N_MOTOR : N_MOTOR]
    shared_rows[range(N_SHARED), range(N_SHARED)] = prior[6 * N_MOTOR :]
    dense, right = [np.diag(prior)], [np.zeros(SIZE)]
    for leg in rng.integers(0, 6, rows):
        row = rng.normal(size=N_MOTOR + N_SHARED + 1)
        whole = np.zeros(SIZE)
        whole[N_MOTOR * leg : N_MOTOR * (leg + 1)], whole[6 * N_MOTOR :] = row[:N_MOTOR], row[N_MOTOR:-1]
        dense.append(whole[None])
        right.append(row[-1:].copy())
        square_root_filter.add_row(motor_rows[leg], shared_rows, row)
    return motor_rows, shared_rows, np.concatenate(dense), np.concatenate(right), prior


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6))
def test_the_square_root_filter_is_dense_least_squares(seed):
    motor_rows, shared_rows, dense, right, _ = arrows(np.random.default_rng(seed))
    expected = np.linalg.lstsq(dense, right, rcond=None)[0]
    covariance, row = np.linalg.inv(dense.T @ dense), np.arange(1.0, N_MOTOR + N_SHARED + 1.0)
    whole = np.zeros(SIZE)
    whole[2 * N_MOTOR : 3 * N_MOTOR], whole[6 * N_MOTOR :] = row[:N_MOTOR], row[N_MOTOR:]
    assert square_root_filter.variance_along(motor_rows[2], shared_rows, row) == pytest.approx(
        whole @ covariance @ whole, rel=1e-8
    )
    per_motor, shared = np.zeros((6, N_MOTOR)), np.zeros(N_SHARED)
    square_root_filter.apply_correction(motor_rows, shared_rows, per_motor, shared)
    np.testing.assert_allclose(np.concatenate([per_motor.ravel(), shared]), expected, atol=1e-9)
    assert not motor_rows[:, :, -1].any()
    assert not shared_rows[:, -1].any()


@pytest.mark.long
@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10**6))
def test_bounded_parameters_move_the_others_to_the_constrained_optimum(seed):
    rng = np.random.default_rng(seed)
    motor_rows, shared_rows, dense, right, _ = arrows(rng)
    # Two that are nearly the same thing, or the opposite.
    same = np.zeros(N_MOTOR + N_SHARED + 1)
    same[-3:-1] = 6.0, rng.choice([-6.0, 6.0])
    dense, right = np.vstack([dense, np.r_[np.zeros(6 * N_MOTOR), same[N_MOTOR:-1]]]), np.r_[right, same[-1]]
    square_root_filter.add_row(motor_rows[0], shared_rows, same)
    per_motor, shared = np.zeros((6, N_MOTOR)), np.zeros(N_SHARED)
    square_root_filter.apply_correction(motor_rows, shared_rows, per_motor, shared)
    before = motor_rows.copy(), shared_rows.copy()
    least, most = np.full(SIZE, -np.inf), np.full(SIZE, np.inf)
    least[-2:], most[-2:] = 0.0, (0.05, 0.1)
    expected = optimize.lsq_linear(dense, right, (least, most), method="bvls", tol=1e-14).x
    square_root_filter.constrain_last_two(motor_rows, shared_rows, per_motor, shared, most[-2:])
    np.testing.assert_allclose(np.concatenate([per_motor.ravel(), shared]), expected, atol=1e-6)
    np.testing.assert_array_equal(motor_rows, before[0])
    np.testing.assert_array_equal(shared_rows, before[1])


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.01, 1.0), st.floats(0.01, 1.0))
def test_forgetting_goes_back_to_the_first_information_alone_and_a_push_does_so_faster(seed, keep, keep_push):
    rng = np.random.default_rng(seed)
    motor_rows, shared_rows, dense, _, _ = arrows(rng)
    square_root_filter.apply_correction(motor_rows, shared_rows, np.zeros((6, N_MOTOR)), np.zeros(N_SHARED))
    motor_sigma, shared_sigma = rng.uniform(0.1, 1.0, N_MOTOR), rng.uniform(0.1, 1.0, N_SHARED)
    first = np.diag(np.concatenate([np.tile(motor_sigma, 6), shared_sigma]) ** -2.0)
    square_root_filter.forget(motor_rows, shared_rows, keep, keep_push, motor_sigma, shared_sigma)
    # Correlations of what was known stay, each with its own share.
    kept = np.full(SIZE, keep)
    kept[6 * N_MOTOR + square_root_filter.PUSH : 6 * N_MOTOR + square_root_filter.PUSH + 3] = keep_push
    known = np.sqrt(np.outer(kept, kept)) * (dense.T @ dense)
    covariance = np.linalg.inv(known + np.diag(1.0 - kept) @ first)
    for k in range(N_MOTOR + N_SHARED):
        row = np.eye(N_MOTOR + N_SHARED)[k]
        at = k if k < N_MOTOR else 5 * N_MOTOR + k
        assert square_root_filter.variance_along(motor_rows[0], shared_rows, row) == pytest.approx(
            covariance[at, at], rel=1e-8
        )
    assert not shared_rows[:, -1].any()  # The estimate stays.


def test_kernels_are_exact_for_parabolas_and_agree_on_a_late_signal():
    at, width, late = np.arange(-law.HALF, law.HALF + 1.0), 1.5, 2.7
    weights = kernel_weights(width)
    # Value, rate and acceleration of 1 + 2 t + 3 t^2, smoothed.
    spread = weights[0] @ at**2
    np.testing.assert_allclose(weights @ (1.0 + 2.0 * at + 3.0 * at**2), [1.0 + 3.0 * spread, 2.0, 6.0], atol=1e-12)
    rows = np.arange(law.ROWS) - law.MIDDLE
    for frequency in (0.05, 0.3):
        signal, sent = np.sin(frequency * at), np.sin(frequency * (rows + late))
        value, rate, _ = late_weights(width, late) @ sent
        assert value == pytest.approx(weights[0] @ signal, abs=3e-3)
        assert rate == pytest.approx(weights[1] @ signal, rel=0.02)


@pytest.mark.parametrize("takes", ["torque", "current", "angle"])
def test_intervals_are_those_of_a_dense_covariance_and_at_most_what_the_first_one_gives(takes):
    options = {"kind": "regression", "ball_joints": True}
    scenario = servos() if takes == "angle" else load_scenario("reachy_nod").replace({"motors": takes})
    part = regression_part(RegressionOptions.from_dict(options, "adaptation"), context_of(scenario))
    state, params, robot = part.initial.copy(), part.constants["params"], part.constants["robot"]
    rng, size = np.random.default_rng(1), state["shared"].size
    per_motor, shared = (params[name][0] for name in ("motor_sigma", "shared_sigma"))
    for leg in rng.integers(0, 6, 60):
        row = rng.normal(size=N_MOTOR + size + 1) / np.concatenate([per_motor, shared, [1.0]])
        square_root_filter.add_row(state["motor_rows"][0, leg], state["shared_rows"][0], row)
    state["bounded_shared"][0] += 0.3 * shared * rng.uniform(0.5, 1.0, size)
    state["bounded_per_motor"][0] += 0.3 * per_motor * rng.uniform(-1.0, 1.0, (6, N_MOTOR))
    # Columns: own numbers of motor 1, of motor 2, ..., common ones.
    dense = np.zeros((6 * N_MOTOR + size, 6 * N_MOTOR + size))
    for leg in range(6):
        place, rows = slice(N_MOTOR * leg, N_MOTOR * (leg + 1)), state["motor_rows"][0, leg]
        dense[place, place], dense[place, 6 * N_MOTOR :] = rows[:, :N_MOTOR], rows[:, N_MOTOR:-1]
    dense[6 * N_MOTOR :, 6 * N_MOTOR :] = state["shared_rows"][0, :, :-1]
    covariance = np.linalg.inv(dense.T @ dense)

    def shown(change, noise_scale=1.0):
        at = state.copy()
        at["noise_scale"] = noise_scale
        at["bounded_per_motor"][0] += change[: 6 * N_MOTOR].reshape(6, N_MOTOR)
        at["bounded_shared"][0] += change[6 * N_MOTOR :]
        first_intervals(params, robot, at)
        center, joints = (
            at[f"learnt_{name}"].view((float, size))[0] for name, size in (("center_of_mass", 6), ("joints", 4))
        )
        values, widths = (at[name].view((float, 20))[0] for name in ("learnt", "learnt_half_width"))
        return np.r_[values, center[:3], joints[:2]], np.r_[widths, center[3:], joints[2:]]

    steps = 1e-6 * np.concatenate([np.tile(per_motor, 6), shared])
    slopes = np.array([(shown(step)[0] - shown(-step)[0]) / (2.0 * step.sum()) for step in np.diag(steps)])
    first = np.diag(np.concatenate([np.tile(per_motor, 6), shared]) ** 2)
    if takes != "angle":
        slopes[:, 1] = 0.0  # Its commands do not show a delay.
    now, most = (np.einsum("ik,ij,jk->k", slopes, each, slopes) for each in (covariance, first))
    for noise_scale in (1.0, 5.0):
        width = shown(np.zeros(len(steps)), noise_scale)[1]
        np.testing.assert_allclose(width, 1.96 * np.sqrt(np.minimum(noise_scale**2 * now, most)), rtol=1e-5)
    assert 0 < (25.0 * now > most).sum() < len(now)


def rows_made(part, state, **changes):
    """The rows (6, n) of a sample that a state's blocks give."""
    params, rows = part.constants["params"].copy(), np.zeros((6, N_MOTOR + state["shared"].size + 1))
    for name, value in changes.items():
        params[name] = value
    numbers = *(part.constants[name] for name in ("robot", "rest", "joints")), params, Legs.new(), Sample.new(), state
    assert law.sample_rows(*(each.view(np.recarray)[0] for each in numbers), rows)
    return rows


@pytest.mark.parametrize("takes", ["torque", "current", "angle"])
def test_a_sample_in_which_a_crank_rests_weighs_less_by_what_its_dry_friction_may_be(takes):
    scenario = servos() if takes == "angle" else load_scenario("reachy_nod").replace({"motors": takes})
    # So much that the hyperbolic tangent of that speed over the width is 1.
    options = RegressionOptions(slowest=0.04)
    part = regression_part(options, context_of(scenario.replace({"model.friction": {"coulomb": DRY, "width": 0.001}})))
    (params,), state, rng = part.constants["params"], part.initial.copy(), np.random.default_rng(2)
    speeds = rng.choice([0.01, 0.039, 0.041, 0.5], (2 * law.HALF + 1, 6)) * rng.choice([-1.0, 1.0], 6)
    state["unsmoothed"][0, :, 0], state["coulomb_uncertainty"] = speeds, rng.uniform(0.1, 1.0, 6)
    state["per_motor"][0, :, 2], state["shared"][0, 3] = rng.uniform(-0.01, 0.01, 6), 0.03
    state["angles"][0] += 0.01 * np.arange(law.ROWS)[:, None]
    rows, whole = rows_made(part, state), rows_made(part, state, slowest=1e-9)
    level = np.hypot(
        0.03 + state["per_motor"][0, :, 2],
        state["coulomb_uncertainty"][0] * np.hypot(params["shared_sigma"][3], params["motor_sigma"][2]),
    )
    rests = params["kernel"][0] @ (np.abs(speeds) < options.slowest)
    least = options.noise * params["limit"]
    np.testing.assert_allclose(rows, whole * (least / np.hypot(least, rests * level))[:, None], rtol=1e-12)
    np.testing.assert_array_equal(rows[:, 5:7], rows[:, 1:3])  # damping and friction in common, and one's own
    rate = 0.01 * params["kernel"][1] @ np.arange(2 * law.HALF + 1)
    np.testing.assert_allclose(whole[:, 1], rate / least, rtol=1e-12)
    np.testing.assert_allclose(whole[:, 2], params["kernel"][0] @ np.tanh(speeds / 0.001) / least, rtol=1e-12)
    assert rests.min() < 0.5 < rests.max()


@pytest.mark.parametrize("periods", [1.0, 2.9, 3.1, 3.3, 3.4, 8.0])
def test_any_smoothing_from_a_period_on_has_a_kernel(periods):
    options = RegressionOptions.from_dict({"kind": "regression", "smoothing": 0.02 * periods}, "adaptation")
    kernel = regression_part(options, context_of(servos())).constants["params"]["kernel"][0, 0]
    spread = (np.arange(-law.HALF, law.HALF + 1) ** 2 * kernel).sum()
    assert np.sqrt(spread) >= 0.95
    assert kernel[0] < 0.14 * kernel.max()  # Two standard deviations off at least.


def test_columns_of_what_was_learnt_are_the_fields_of_its_record():
    rows = Learnt.of(np.arange(40.0).reshape(2, 20))
    columns = [name.rpartition("_")[0] or name for name in SIGNALS["learnt"].components]
    assert list(dict.fromkeys(columns)) == list(Learnt.fields)
    for name in Learnt.fields:
        at = np.flatnonzero([column == name for column in columns])
        np.testing.assert_array_equal(np.reshape(rows[name], (2, -1)), np.arange(40.0).reshape(2, 20)[:, at])
    assert Learnt.of(np.arange(20.0)).delay == 1.0


def test_a_robot_with_servos_learns_its_constants_and_follows():
    unaware, learns = run(servos(adaptation=None), check=False), run(servos(), check=False)
    assert late_error(learns) < 0.2 * late_error(unaware)
    value, width = Learnt.of(learns["learnt"][-1]), Learnt.of(learns["learnt_half_width"][-1])
    truth = 0.85 * np.array(REAL["ratios"])
    assert abs(value.delay - 0.01) < 2.0 * width.delay
    # Weight over stiffness is what a slow motion tells; of each alone the interval says how little.
    head = learns.scenario.robot.platform_mass
    np.testing.assert_allclose(value.mass / value.drive, head / truth, rtol=0.05)
    assert (np.abs(value.drive - truth) < width.drive).all()
    assert (np.abs(value.coulomb - DRY) < width.coulomb).all()


def test_what_was_kept_is_what_the_next_run_believes():
    first = run(servos(), check=False)
    belief, row = first.scenario.controller_model, first["learnt"][-1]
    model = model_of(last_learnt(first), belief)
    second = run(servos(duration=3.0, model=model), check=False)
    assert late_error(second) < 0.1 * late_error(run(servos(duration=3.0, adaptation=None), check=False))
    value = Learnt.of(row)
    np.testing.assert_allclose(second.scenario.controller_model.motors.gains, value.drive, rtol=1e-12)
    np.testing.assert_allclose(second.scenario.controller_model.friction.coulomb, value.coulomb, rtol=1e-12)
    assert second.scenario.controller_model.robot.platform_mass == pytest.approx(value.mass)
    assert second.scenario.controller_model.friction.width == belief.friction.width
    assert second.scenario.controller_model.motors.dead_time == pytest.approx(0.03 + value.delay)


@pytest.mark.long
def test_much_damping_that_an_earlier_run_has_learnt_is_not_cut():
    believed = {"coulomb": DRY, "viscous": 0.4, "width": 0.004}
    log = run(servos(duration=3.0, **{"plant.friction.viscous": 0.4, "model.friction": believed}), check=False)
    value = Learnt.of(log["learnt"][-1])
    # Per torque of the motor, which so short a motion tells better than both alone.
    assert (value.viscous / value.drive).min() > 0.35


def test_much_dry_friction_that_is_believed_is_not_cut():
    scenario = servos(1.0, **{"model.friction": {"coulomb": 0.5}, "adaptation.frozen": True})
    np.testing.assert_allclose(run(scenario, check=False)["learnt"][-1, 14:20], 0.5)


def test_a_robot_that_rests_learns_nothing_and_a_frozen_one_keeps_its_model():
    for changes in ({"reference": {"kind": "hold", "pose": [0, 0, 0, 0, 0, 0.177]}}, {"adaptation.frozen": True}):
        learnt = run(servos(3.0, **changes), check=False)["learnt"]
        np.testing.assert_allclose(learnt, np.tile(learnt[0], (len(learnt), 1)), rtol=1e-12)
        assert learnt[0, 0] == servos().robot.platform_mass
    frozen, cautious = (
        run(servos(1.0, adaptation={"kind": "regression", "frozen": True, "cautious": each}), check=False)
        for each in (False, True)
    )
    np.testing.assert_array_equal(frozen["commanded_angle"], cautious["commanded_angle"])


def test_a_right_model_stays_right_while_it_learns():
    pose = [0.0, 0.0, 0.0, 0.0, 0.0, 0.177]
    turned = [[0, 0, 0.5, 0, 0, 0.177], [0, -0.2, -0.4, 0, 0, 0.182], [0, 0.25, -0.3, 0, 0, 0.177], pose] * 4
    look = {
        "kind": "minimum_jerk",
        "poses": [pose, *turned],
        "durations": [0.8, 1.0, 0.7, 0.7] * 4,
        "dwell": [0.25] * 16,
    }
    changes = {
        "reference": look,
        "model.motors": {"kind": "position", "preset": "xl330_m288", **REAL},
        "model.friction": {"coulomb": DRY, "viscous": 0.006, "width": 0.004},
    }
    knows, learns = (
        late_error(run(servos(16.0, **changes, adaptation=adaptation), check=False))
        for adaptation in (None, SERVOS["adaptation"])
    )
    assert learns < 1.2 * knows


def test_cautious_friction_keeps_the_damping_of_a_servo():
    free = {"coulomb": 0.0, "viscous": 0.0}
    bold, cautious = (
        run(servos(3.0, **{"plant.friction": free, "model.friction": free, "adaptation.cautious": each}), check=False)
        for each in (False, True)
    )
    apart = np.abs(bold["commanded_angle"] - cautious["commanded_angle"]).max()
    assert apart < 0.01


def test_a_push_is_not_taken_for_the_robot():
    push = {"kind": "step", "wrench": [0.0, 0.0, 0.0, 0.0, 0.0, 3.0], "time": 6.0, "until": 7.0}
    quiet, pushed = (run(servos(8.0, disturbances=each), check=False)["learnt"][-1] for each in ([], [push]))
    np.testing.assert_allclose(Learnt.of(pushed).coulomb, Learnt.of(quiet).coulomb, atol=0.004)
    assert Learnt.of(pushed).mass / Learnt.of(pushed).drive.mean() == pytest.approx(
        Learnt.of(quiet).mass / Learnt.of(quiet).drive.mean(), rel=0.05
    )


@pytest.mark.parametrize(("coulomb", "viscous"), [(0.08, 0.12), (0.1, 0.05)])
def test_friction_above_the_sliding_level_is_learnt_as_sliding_friction(coulomb, viscous):
    friction = {"coulomb": coulomb, "viscous": viscous, "break_away": 1.5 * coulomb}
    nod = {"kind": "sine", "amplitude": [0.0, 0.26, 0.0, 0.0, 0.0, 0.0], "angular_frequency": "1 Hz"}
    changes = {"plant": {"kind": "closed_form", "friction": friction}, "reference": nod, "duration": 4.0}
    log = run(load_scenario("reachy_slow_bus").replace({**changes, "bounds": SERVOS["bounds"]}), check=False)
    np.testing.assert_allclose(Learnt.of(log["learnt"][-1]).coulomb, coulomb, rtol=0.025)


def test_a_load_that_is_put_on_later_is_weighed_though_the_estimate_was_sure_of_itself():
    load = {"kind": "step", "wrench": [0.0, 0.0, 0.0, 0.0, 0.0, -3.0], "time": 4.0, "until": 60.0}
    scenario = load_scenario("exact_breathing").replace({**RUBS, "duration": 12.0, "disturbances": [load]})
    log = run(scenario, check=False)
    value, wide = Learnt.of(log["learnt"][-1]), log["learnt_half_width"][:, 0]
    assert (value.mass - scenario.robot.platform_mass) * scenario.gravity == pytest.approx(3.0, rel=0.1)
    np.testing.assert_allclose(value.coulomb, 0.08, rtol=0.1)
    before, then, late = (wide[np.searchsorted(log.time, time)] for time in (3.9, 6.0, 11.9))
    assert before < then > late


def test_after_readings_that_were_missing_while_cranks_moved_it_goes_on_to_learn():
    nods = [[0.0, 0.06 * (-1) ** k, 0.0, 0.0, 0.0, 0.195] for k in range(20)]
    rise = {"poses": [[0, 0, 0, 0, 0, 0.17], *nods], "durations": [0.8, *[0.4] * 19]}
    scenario = servos(8.0, reference={"kind": "minimum_jerk", **rise})
    log = run(scenario, check=False)
    readings, gap = inverse_kinematics(scenario.robot, log["measured_pose"]), (log.time > 0.1) & (log.time < 0.8)
    first, last = np.flatnonzero(gap)[[0, -1]]
    assert (np.abs(readings[last:] - readings[first - 1]).max(axis=1) > 0.5).all()
    broken, out = Controller(scenario.control()), np.empty(6)
    for tick, reading in enumerate(readings):
        broken.step(np.full(6, np.nan) if gap[tick] else reading, log.time[tick], out)
    width = Learnt.of(broken.signal("learnt_half_width"))
    assert width.coulomb.max() < 2.0 * Learnt.of(log["learnt_half_width"][-1]).coulomb.max()


def test_learning_stops_after_a_crank_jumps():
    scenario = servos(4.0)
    log = run(scenario, check=False)
    readings, beside, out = inverse_kinematics(scenario.robot, log["measured_pose"]), [], np.empty(6)
    controller = Controller(scenario.control())
    for tick, reading in enumerate(readings):
        jump = np.array([0.0, 0.0, -0.9, 0.0, 0.0, 0.0]) if log.time[tick] > 2.0 else 0.0
        controller.step(reading + jump, log.time[tick], out)
        beside.append(controller.signal("learnt").copy())
    at = np.searchsorted(log.time, 2.1)
    np.testing.assert_array_equal(beside[-1], beside[at])
    assert (beside[at // 2] != beside[at]).any()


RUBS = {"plant": {"kind": "closed_form", "motor_friction": 0.08}, "adaptation": "regression"}


@pytest.mark.parametrize("motion", ["breathing", "heart"])
def test_by_torque_at_1_khz_unknown_friction_costs_nothing(motion):
    scenario = load_scenario(f"exact_{motion}").replace({**RUBS, "duration": 6.0})
    log = run(scenario, check=False)
    value = Learnt.of(log["learnt"][-1])
    np.testing.assert_allclose(value.coulomb, 0.08, atol=0.002)
    np.testing.assert_allclose(value.drive, 1.0, atol=0.03)
    told = run(scenario.replace({"model.friction.coulomb": 0.08, "adaptation": None}), check=False)
    late = log.time > 3.0
    assert np.linalg.norm(log.error[late]) < 1.5 * np.linalg.norm(told.error[late])


@pytest.mark.parametrize("wrench", [[0, 0, 0, 1.0, 0, 0], [0, 0, 0, 0, 1.0, 0], [0, 0, 0.03, 0, 0, 0]])
def test_a_push_sideways_that_lasts_is_not_taken_for_friction(wrench):
    push = {"kind": "step", "wrench": wrench, "time": 3.0, "until": 60.0}
    scenario = load_scenario("exact_heart").replace({**RUBS, "duration": 12.0, "disturbances": [push]})
    log = run(scenario, check=False)
    np.testing.assert_allclose(Learnt.of(log["learnt"][-1]).coulomb, 0.08, atol=0.006)
    told = run(scenario.replace({"model.friction.coulomb": 0.08, "adaptation": None}), check=False)
    late = log.time > 8.0
    assert np.linalg.norm(log.error[late]) < 2.0 * np.linalg.norm(told.error[late])


@pytest.mark.parametrize("motion", ["breathing", "heart"])
def test_a_load_beside_the_middle_moves_the_centre_of_mass_and_is_no_friction(motion):
    load = {"plant.payload_mass": 0.3, "plant.payload_position": [0.03, 0.02, 0.05]}
    scenario = load_scenario(f"exact_{motion}").replace({"plant.kind": "closed_form", "duration": 6.0, **load})
    log = run(scenario.replace({"adaptation": "regression"}), check=False)
    value, place = Learnt.of(log["learnt"][-1]), log["learnt_center_of_mass"][-1]
    assert value.mass == pytest.approx(1.3, abs=0.02)
    truth = 0.3 / 1.3 * np.array([0.03, 0.02, 0.05])
    np.testing.assert_allclose(place[:2], truth[:2], atol=2e-4)
    # How high it is hardly tells where nothing tilts, and the interval says so.
    assert abs(place[2] - truth[2]) < place[5]
    np.testing.assert_allclose(value.coulomb, 0.01, atol=0.002)
    alone = run(scenario.replace({"adaptation": "regression", "plant.payload_mass": 0.0}), check=False)
    late = log.time > 3.0
    assert np.linalg.norm(log.error[late, 3:]) < 1.6 * np.linalg.norm(alone.error[late, 3:])
    kept = scenario.replace({"model": model_of(last_learnt(log), log.scenario.controller_model)}).controller_model.robot
    np.testing.assert_allclose(kept.platform_center_of_mass, place[:3], rtol=1e-12)


@pytest.mark.parametrize("tool", [None, {"position": [0.0, 0.02, 0.05], "orientation": [0.3, 0.0, 0.1]}])
@pytest.mark.parametrize("name", ["paper", "reachy_mini", "servo_hexapod"])
def test_wherever_the_centre_of_mass_is_learnt_to_be_inertia_is_left(name, tool):
    robot = load_robot(name).replace(tool=tool)
    room = room_of(robot)
    assert room > 0.005
    for share in (1.0, 1.2):
        at = robot.platform_center + share * room * np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
        inertia = [
            np.linalg.eigvalsh(
                robot.platform_inertia_about_origin - robot.platform_mass * ((c @ c) * np.eye(3) - np.outer(c, c))
            ).min()
            for c in at
        ]
        assert (min(inertia) > 0.0) == (share == 1.0)


def test_a_centre_of_mass_is_kept_in_p_where_the_robot_has_a_tool():
    tool = {"position": [0.0, 0.02, 0.05], "orientation": [0.3, 0.0, 0.1]}
    scenario = load_scenario("exact_breathing").replace({**RUBS, "duration": 0.01, "robot.tool": tool})
    log = run(scenario, check=False)
    kept = scenario.replace({"model": model_of(last_learnt(log), log.scenario.controller_model)}).controller_model.robot
    np.testing.assert_allclose(kept.platform_center_of_mass, scenario.robot.platform_center_of_mass, atol=1e-12)


def test_one_torque_constant_for_all_motors_keeps_their_friction_in_currents():
    scenario = load_scenario("reachy_nod").replace({"motors": "current", "safety": None, "adaptation": "regression"})
    drive, coulomb = np.array([0.8, 0.9, 1.0, 1.1, 1.2, 1.3]), np.full(6, 0.05)
    learnt = np.concatenate([[0.3, 0.0], drive, 0.1 * coulomb, coulomb])
    belief = scenario.controller_model
    kept = scenario.replace(
        {"model": model_of({"learnt": learnt, "learnt_half_width": 0.1 * learnt}, belief)}
    ).controller_model
    assert kept.motors.torque_constant == pytest.approx(belief.motors.torque_constant * drive.mean())
    currents = coulomb / (belief.motors.torque_constant * drive)
    np.testing.assert_allclose(np.array(kept.friction.coulomb) / kept.motors.torque_constant, currents)
    np.testing.assert_allclose(np.array(kept.friction.viscous) / kept.motors.torque_constant, 0.1 * currents)


JOINTS = BallJoints(viscous=0.004, coulomb=0.003, width=0.02, platform=(0, 0, 0, 0, 0, 1))
LOOKS = {
    "kind": "sine",
    "amplitude": [0.2, 0.26, 0.3, 0.0, 0.0, 0.004],
    "angular_frequency": [5.0, 6.3, 3.9, 0, 0, 7.1],
}


def learnt_of_a_model(joints, **options):
    """What the law learns where readings are the reference, and commands those of a model with these ball joints."""
    known = servos(reference=LOOKS, **{"model.friction.joints": joints.to_dict(), "adaptation": None})
    unknown = joints.to_dict() | {"viscous": 0.0, "coulomb": 0.0}
    believed = servos(reference=LOOKS, **{"model.friction.joints": unknown})
    (part,) = RegressionOptions(noise=0.001, **options).parts(context_of(believed.control()))
    exact, state, command = Controller(known.control()), part.initial.copy(), np.empty(6)
    for tick in range(1000):
        time = 0.02 * tick
        exact.step(np.zeros(6), time, command)
        reading = inverse_kinematics(known.robot, LOOK.evaluate(time)[0])
        part.tick(reading, command, state)
    return part, state


LOOK = load_scenario("reachy_nod").replace({"reference": LOOKS}).reference


@pytest.mark.long
def test_hidden_friction_of_ball_joints_is_found():
    part, state = learnt_of_a_model(JOINTS, ball_joints=True)
    viscous, dry, *half_widths = state["learnt_joints"][0].tolist()
    assert viscous == pytest.approx(0.004, rel=0.1)
    assert dry == pytest.approx(0.003, rel=0.1)
    assert abs(viscous - 0.004) < half_widths[0]
    assert abs(dry - 0.003) < half_widths[1]
    # What stands in for the constant is the believed joints with these two numbers.
    stands = state["joints"][0]
    assert stands["viscous"] == pytest.approx(viscous, rel=0.05)
    np.testing.assert_array_equal(stands["platform"], [0, 0, 0, 0, 0, 1])
    assert set(part.outputs) - set(learnt_of_a_model(JOINTS)[0].outputs) == {"joints", "learnt_joints"}


@pytest.mark.long
def test_what_was_learnt_of_ball_joints_is_kept():
    _, state = learnt_of_a_model(JOINTS, ball_joints=True)
    scenario = servos(**{"model.friction.joints": JOINTS.to_dict() | {"viscous": 0.0, "coulomb": 0.0}})
    joints = state["learnt_joints"][0].tolist()
    known = {name: state[name].view(float) for name in ("learnt", "learnt_half_width", "learnt_joints")}
    model = model_of(known, scenario.controller_model)
    kept = scenario.replace({"model": model}).controller_model.friction.joints
    assert (kept.viscous, kept.coulomb) == tuple(joints[:2])
    assert kept.platform == JOINTS.platform
    lines = dict(rows_of(known))
    assert lines["learnt: dry friction of ball joints"].startswith(f"{joints[1]:.4g} ± ")


@pytest.mark.long
@pytest.mark.parametrize("makes", [servos, lambda: load_scenario("reachy_slow_bus").replace({"duration": 8.0})])
def test_ball_joints_that_turn_freely_are_found_to_be_free(makes):
    alone = makes()
    rub = {"model.friction.joints": {"viscous": 0.003, "coulomb": 0.003}, "adaptation.ball_joints": True}
    log = run(alone.replace(rub), check=False)
    viscous, dry, *half_widths = log["learnt_joints"][-1]
    assert viscous < 0.001
    assert dry < 0.001
    assert max(half_widths) < 0.003
    assert late_error(log) < 3.0 * late_error(run(alone, check=False))


def test_delays_beyond_what_is_remembered_and_a_kernel_below_a_period_are_refused():
    context = context_of(servos().control())
    late = context._replace(reading_age=1.0, latency=1.0 + context.latency)
    with pytest.raises(ConfigurationError, match=r"^model\.reading_age: expected at most .* commands are late, got 1"):
        RegressionOptions().parts(late)
    with pytest.raises(ConfigurationError, match=r"^adaptation\.smoothing: expected at least 0\.02 s"):
        RegressionOptions(smoothing=0.001).parts(context)


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("forgetting", 1e-5, "at least 1 and at most 100,000"),
        ("forgetting", 1e9, "at least 1 and at most 100,000"),
        ("noise", 1e-12, "at least 0.0001 and at most 1"),
        ("noise", 1e12, "at least 0.0001 and at most 1"),
    ],
)
def test_numbers_with_which_nothing_could_be_learnt_are_refused(key, value, words):
    with pytest.raises(ConfigurationError, match=rf"adaptation\.{key}: expected a number .*{words}"):
        load_scenario("reachy_nod").replace({"adaptation": {"kind": "regression", key: value}})
