"""Calibration: derivatives, conventions, what is identifiable, and robots that are found again."""

import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from simulated_calibration import aligned, change_to, coverage, deviating, gains, measured, run_trial
from strategies import ROBOT, ROBOTS

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.estimation.calibration import calibrate
from stewart_drake.estimation.geometry import (
    CLOSED,
    FRAMES,
    HOMING,
    OF_ROBOT,
    PER_LEG,
    SIZE,
    PoseModel,
    as_robot,
    exponential,
    transform,
    transform_of,
)
from stewart_drake.estimation.poses import COLUMNS, MeasurementNoise, Measurements, candidate_poses, plan_poses
from stewart_drake.mechanics.kinematics import forward_kinematics, inverse_kinematics
from stewart_drake.robot.robot_files import load_robot
from stewart_drake.scenario.limits import ReferenceLimits, limit_margins

NOISE = MeasurementNoise()
QUIET = MeasurementNoise(position=1e-12, rotation=1e-12, encoder=1e-13)
BASE = transform(exponential(np.array([0.3, -0.2, 2.0])), np.array([1.0, -2.0, 0.5]))
MARKER = transform(exponential(np.array([0.2, 0.4, -0.3])), np.array([0.01, 0.03, 0.06]))
many = st.sampled_from(list(ROBOTS.values()))


@functools.cache
def targets(robot=ROBOT, count=30, seed=0):
    """Poses all over the workspace, with the guess's angles."""
    rng = np.random.default_rng(seed)
    pose = candidate_poses(robot, count, ReferenceLimits(joint_swing=None, clearance=None), rng)
    return Measurements(pose, inverse_kinematics(robot, pose))


def seen(truth, noise=NOISE, count=30, base=BASE, marker=MARKER, guess=ROBOT):
    return measured(truth, targets(guess, count), noise, np.random.default_rng(5), base, marker)


@given(many, st.integers(0, 1000))
@settings(max_examples=4)
def test_derivatives_are_those_of_finite_differences(robot, seed):
    rng = np.random.default_rng(seed)
    size = np.concatenate([np.full(OF_ROBOT, 3e-3), np.full(12, 0.05)])
    change = size * rng.standard_normal(SIZE)
    model = PoseModel(robot, BASE, MARKER)
    measurements = measured(robot, targets(robot, 4), MeasurementNoise(rotation=1e-3), rng, BASE, MARKER)
    marker, angles = measurements.marker, measurements.angles

    def predicted(change):
        at, off = model.predicted(change, angles, model.platform(change, marker))
        assert off.max() <= CLOSED
        return at

    slope = model.tracker_slope(change, predicted(change), angles, marker)
    for _ in range(3):
        way = size * rng.standard_normal(SIZE)
        there = [change + step * way for step in (1e-4, -1e-4)]
        ahead, behind = (model.tracker_error(each, predicted(each), marker) for each in there)
        assert (ahead - behind) / 2e-4 == pytest.approx(slope @ way, rel=1e-5, abs=1e-8)


@pytest.mark.parametrize(
    ("name", "known"), list(zip(ROBOTS, [("platform",), FRAMES, ("base",), ()], strict=True)), ids=ROBOTS
)
def test_without_noise_the_robot_is_found_again(name, known):
    guess = ROBOTS[name]
    truth = deviating(guess, np.random.default_rng(1))
    base, marker = (np.eye(4) if frame in known else made for frame, made in zip(FRAMES, (BASE, MARKER), strict=True))
    found = calibrate(guess, seen(truth, QUIET, 20, base, marker, guess), QUIET, known)
    same = aligned(truth, guess, known)
    assert found.change[:OF_ROBOT] == pytest.approx(change_to(guess, same)[:OF_ROBOT], abs=2e-8)
    assert np.abs(found.after).max() < 1e-10
    near = targets(guess, 20, 3)
    at, mine = (transform_of(forward_kinematics(robot, near.angles, near.pose)) for robot in (truth, found.robot))
    assert found.base @ mine @ found.marker == pytest.approx(base @ at @ marker, abs=1e-7)


def test_what_poses_cannot_tell_is_named_and_kept():
    # Up and down alone: a rod that is longer and a joint that is higher by as much cannot be told apart.
    pose = np.tile(ROBOT.home_pose, (30, 1))
    pose[:, 5] += np.linspace(-0.05, 0.05, 30)
    lifted = Measurements(pose, inverse_kinematics(ROBOT, pose))
    truth = deviating(ROBOT, np.random.default_rng(3), 2e-4, 2e-4)
    found = calibrate(ROBOT, measured(truth, lifted, NOISE, np.random.default_rng(0)), NOISE, FRAMES, fit="geometry")
    assert found.identifiable == 66 - len(found.unidentifiable) < 66
    named = {sentence.partition(" (")[0] for sentence in found.unidentifiable}
    assert named <= {
        f"leg {leg} {name} {axis}".strip() for leg, name, axis, *_, width in found.rows() if width == np.inf
    }
    assert found.noise_ratio < 1.3


def test_homing_offsets_are_readings_minus_true_angles_and_stops_move_with_them():
    offsets = np.array([0.01, -0.02, 0.03, 0.0, 0.005, -0.01])
    exact = targets(ROBOT, 20)
    shifted = Measurements(exact.pose, exact.angles + offsets)
    found = calibrate(ROBOT, shifted, QUIET, FRAMES)
    assert found.homing_offsets == pytest.approx(offsets, abs=1e-9)
    assert inverse_kinematics(found.robot, exact.pose) == pytest.approx(shifted.angles, abs=1e-9)
    guess, change = load_robot("reachy_mini"), np.zeros(SIZE)
    change[HOMING:OF_ROBOT:PER_LEG] = 0.02
    assert as_robot(guess, change).crank_angle_ranges == pytest.approx(guess.crank_angle_ranges + 0.02)


def test_a_plan_keeps_to_the_limits_beats_random_poses_and_predicts_the_intervals():
    limits = ReferenceLimits()
    plan = plan_poses(ROBOT, 30, limits, candidates=100)
    still = np.zeros((30, 6))
    margins = limit_margins(ROBOT, limits, plan.targets.pose, still, still, 9.81)
    assert min(margin.min() for name, margin in margins.items() if name != "conditioning") > 0.0
    assert plan.gain > 1.1
    assert (plan.half_width[:OF_ROBOT] <= plan.random_half_width[:OF_ROBOT]).mean() > 0.9
    assert inverse_kinematics(ROBOT, plan.targets.pose) == pytest.approx(plan.targets.angles)
    found = calibrate(ROBOT, measured(ROBOT, plan.targets, NOISE, np.random.default_rng(0)), NOISE, fit="geometry")
    fitted = plan.half_width[:OF_ROBOT] > 0.0
    ratio = found.half_width[:OF_ROBOT][fitted] / found.noise_ratio / plan.half_width[:OF_ROBOT][fitted]
    assert ratio == pytest.approx(1.0, abs=0.1)
    with pytest.raises(ConfigurationError, match="a limit conditioning that is broken on every line from home"):
        plan_poses(ROBOT, 20, ReferenceLimits(conditioning=0.9))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["paper", pytest.param("servo_hexapod", marks=pytest.mark.long)])
@pytest.mark.parametrize("known", [FRAMES, ()])
def test_poses_become_twenty_times_better_and_the_intervals_hold_the_truth(name, known):
    guess = load_robot(name)
    planned = plan_poses(guess, 60, candidates=600, known_frames=known).targets
    pose = candidate_poses(guess, 30, ReferenceLimits(), np.random.default_rng(7))
    unseen = Measurements(pose, inverse_kinematics(guess, pose))
    trials = [run_trial(guess, planned, unseen, NOISE, seed, known, fit="geometry") for seed in range(12)]
    # Frames fitted to the guess hide a good part of its error: of single robots then so much that less is to be won.
    assert (gains(trials).min() if known else np.median(gains(trials), axis=0).min()) > 20.0
    inside = coverage(trials)
    assert 0.9 <= inside["all"] <= 0.99
    assert np.mean([trial.noise_ratio for trial in trials]) == pytest.approx(1.0, abs=0.05)


TURN = 180.0 / np.pi


@pytest.fixture(scope="module")
def good():
    rng = np.random.default_rng(0)
    pose = candidate_poses(ROBOT, 25, ReferenceLimits(), rng)
    exact = Measurements(pose, inverse_kinematics(ROBOT, pose))
    return measured(deviating(ROBOT, rng), exact, MeasurementNoise(), rng)


def test_the_table_has_intervals_and_marks_what_was_held(good):
    calibration = calibrate(ROBOT, good, hold=("rod_length",), fit="geometry")
    legs, rows = calibration.table()
    cells = {name: cells for name, *cells in rows}
    assert len(legs) == 7
    assert cells["rod length [mm]"] == ["held"] * 6
    assert all("±" in cell for cell in cells["crank length [mm]"])
    assert calibration.robot.rod_length == ROBOT.rod_length


@pytest.fixture
def refused(tmp_path):
    """The line with which a table is refused."""

    def refused(header, table, fit="geometry"):
        path = tmp_path / "poses.csv"
        path.write_text("\n".join([",".join(header), *(",".join(map(str, row)) for row in table)]))
        with pytest.raises(ConfigurationError) as caught:
            calibrate(ROBOT, path, fit=fit)
        assert len(str(caught.value).splitlines()) == 1
        assert str(path) in str(caught.value)
        return str(caught.value)

    return refused


@pytest.mark.parametrize(
    ("columns", "factor", "said"),
    [
        (slice(3, 6), 1e3, "millimetres for metres"),
        (slice(6, 12), 1.0 / TURN, "radians for degrees"),
        (slice(0, 3), TURN, "_deg for degrees"),
        (9, -1.0, "crank_angle_3: expected "),
    ],
)
def test_wrong_units_and_an_inverted_encoder(refused, good, columns, factor, said):
    table = good.table.copy()
    table[:, columns] *= factor
    assert said in refused(COLUMNS, table, None if factor == 1e3 else "geometry")


@pytest.mark.parametrize(("column", "by"), [(5, 2e-3), (8, 0.02), (3, 1e3), (0, 2.9)])
def test_a_single_wrong_row_is_named_whether_it_is_a_little_off_or_absurd(refused, good, column, by):
    table = good.table.copy()
    table[17, column] += by
    assert "row 18: expected " in refused(COLUMNS, table)


def test_cells_rows_and_columns_that_cannot_be(refused, good):
    table = good.table.copy()
    assert "column of pose_yaw: expected " in refused([*COLUMNS[:2], "yaw_turns", *COLUMNS[3:]], table)
    assert "at least 12 poses for 66 unknown numbers, better some 60, got '11 rows'" in refused(
        COLUMNS, table[:11], "geometry"
    )
    table[8, :6] = table[3, :6]
    assert "the pose of row 4 again in row 9" in refused(COLUMNS, table)
    table[6, 4] = -1e300
    assert "row 7, pose_y: expected metres" in refused(COLUMNS, table)
    table = good.table.copy()
    table[:, [7, 10]] = table[:, [10, 7]]
    assert "off the guess'; is it another one, or are two encoders swapped?" in refused(COLUMNS, table)


def test_another_branch_is_named_and_words_that_are_none(good):
    guess = ROBOT.replace(legs=[{"branch": 1 if leg == 2 else -1} for leg in range(6)])
    with pytest.raises(ConfigurationError, match=r"robot.legs.2.branch: expected -1"):
        calibrate(guess, good)
    with pytest.raises(ConfigurationError, match=r"hold: expected .*got 'mass'"):
        calibrate(ROBOT, good, hold=("mass",))


def test_a_plan_that_nobody_has_measured_is_no_measurement(tmp_path):
    plan = tmp_path / "plan.csv"
    plan.write_text(plan_poses(ROBOT, 20, candidates=100).targets.to_csv())
    with pytest.raises(
        ConfigurationError, match=r"plan.csv: expected measured poses, .*; is this a plan, not measured yet"
    ):
        calibrate(ROBOT, plan)
