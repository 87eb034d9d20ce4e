"""Parameters of robots from their torques: the linear model, what it tells, and how well the intervals hold."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from recordings import FINE, motion, recording, truth_of
from simulated_identification import Setting, coverage, run_trial, with_payload
from strategies import ROBOT, ROBOTS, UNEQUAL, vectors

from stewart_drake import Scenario, load_robot, load_scenario, run
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.estimation.identification import consistent, identify, is_consistent, least_squares
from stewart_drake.estimation.torques import (
    BODIES,
    COULOMB,
    GAIN,
    PARAMETERS,
    SIZE,
    VISCOUS,
    as_robot,
    load_recording,
    recording_of_log,
    samples_of,
    samples_of_motion,
    scales,
    values_of,
)
from stewart_drake.mechanics.dynamics import inverse_dynamics
from stewart_drake.references.motions import HoldReference

AT = {str(own): at for at, own in enumerate(PARAMETERS)}


@pytest.fixture(scope="module")
def exact():
    truth = truth_of(ROBOT)
    return truth, samples_of(ROBOT, recording(ROBOT, truth))


@pytest.mark.parametrize("robot", [*ROBOTS.values(), load_robot("reachy_mini")], ids=[*ROBOTS, "reachy_mini"])
def test_torques_are_linear_in_the_bodies(robot):
    time = np.linspace(0.0, 5.0, 50)
    pose, rate, acceleration = motion(robot, size=0.5).evaluate(time)
    samples = samples_of_motion(robot, time, (pose, rate, acceleration), 9.81)
    again = as_robot(robot, values_of(robot))
    np.testing.assert_allclose(values_of(again), values_of(robot), rtol=1e-12, atol=1e-15)
    for values in (values_of(robot), truth_of(robot)):
        expected = inverse_dynamics(as_robot(robot, values), pose, rate, acceleration)
        np.testing.assert_allclose(
            samples.columns[..., BODIES] @ values[BODIES] + samples.known, expected, rtol=0.0, atol=1e-12
        )


def test_exact_logs_give_the_robot(exact):
    truth, samples = exact
    found = least_squares(ROBOT, samples)
    # The guess's values are kept where a motion tells nothing.
    guess = values_of(ROBOT)
    off = (found.values - guess - found.identifiable_part(truth - guess)) / scales(ROBOT)
    assert np.abs(off).max() < 2e-3
    np.testing.assert_allclose(found.values[COULOMB], truth[COULOMB], rtol=2e-3)
    np.testing.assert_allclose(found.values[VISCOUS], truth[VISCOUS], rtol=2e-3)
    np.testing.assert_allclose(found.values[GAIN], truth[GAIN], atol=1e-4)


def test_what_no_motion_tells_is_named_with_its_sum(exact):
    found = identify(ROBOT, [recording(ROBOT, exact[0])])
    (unidentifiable,) = found.estimate.unidentifiable
    assert str(PARAMETERS[unidentifiable.at]) == "rod_mass"
    assert np.isinf(unidentifiable.deviation)
    # Half of each of six rods hangs on the platform, and half of each on its crank, at whose middle its own mass is.
    assert unidentifiable.direction[AT["platform_mass"]] == pytest.approx(-3.0)
    assert unidentifiable.direction[AT["crank_mass"]] == pytest.approx(-1.0)
    names = dict(zip(map(str, PARAMETERS), found.base_parameters(), strict=True))
    assert names["platform_mass"] == "platform_mass + 3 rod_mass"
    assert names["coulomb motor 3"] == "coulomb motor 3"
    samples = exact[1]
    moved = exact[0] + 0.1 * unidentifiable.direction
    np.testing.assert_allclose(samples.predicted(moved), samples.predicted(exact[0]), atol=1e-12)


def test_a_lag_of_the_torques_is_made_up_for(exact):
    truth, late = exact[0], 0.01
    log = recording(ROBOT, truth)
    shifted = recording(ROBOT, truth, seconds=20.0 + late)
    steps = round(late * shifted.rate)
    # Row k has the torque of the instant `late` after it.
    moved = dataclasses.replace(log, torque=shifted.torque[steps : steps + len(log.time)], lag=late)
    found = identify(ROBOT, [moved])
    np.testing.assert_allclose(found.coulomb, truth[COULOMB], rtol=0.01)
    wrong = identify(ROBOT, [dataclasses.replace(moved, lag=0.0)])
    assert wrong.predictions[0].identified > 3.0 * found.predictions[0].identified


@pytest.mark.slow
@pytest.mark.parametrize(
    ("robot", "payload"),
    [pytest.param(ROBOT, 0.02, id="paper", marks=pytest.mark.long), pytest.param(UNEQUAL, 0.2, id="unequal")],
)
def test_intervals_hold_the_truth(robot, payload):
    # The rods of the second weigh twice its platform, and cranks of different lengths tell their mass, though poorly.
    setting = Setting(robot, motion(robot, size=0.8), motion(robot, 5, 0.8), 250.0, FINE, 0.002, 0.02, 0.01, 20.0)
    trials = [run_trial(setting, seed) for seed in range(12)]
    # Some 350 intervals, which hold the truth or do not in company; the study in docs/results has thousands.
    share = coverage(trials)
    assert 0.88 <= share["all"] <= 0.99
    assert max(trial.predicted for trial in trials) < 0.03
    assert np.median([trial.payload for trial in trials]) < payload
    assert np.median([max(trial.coulomb, trial.viscous) for trial in trials]) < 0.05


@settings(max_examples=10)
@example(np.array([0.0, 0.0, 0.25, 0.0, 0.0, 0.25, 0.0, 0.0, 0.0, 0.0]))  # Rounding below a bound.
@example(np.array([0.5625, 0.4609375, 0.0, 0.0, 0.0, -0.5, 0.125, 0.5625, -0.5, 0.0]))  # A bound, all but kept.
@given(change=vectors(10, 0.6))
def test_the_nearest_bodies_are_bodies_and_nearest(change):
    truth = values_of(ROBOT)
    truth[COULOMB], truth[VISCOUS] = 0.02, 0.01
    truth[:10] += change * scales(ROBOT)[:10]
    samples = dataclasses.replace(EXCITED, measured=EXCITED.predicted(truth))
    found = least_squares(ROBOT, samples)
    nearest = consistent(ROBOT, found)
    assert is_consistent(ROBOT, nearest)
    assert as_robot(ROBOT, nearest).platform_mass == pytest.approx(nearest[0])
    if is_consistent(ROBOT, found.values):
        np.testing.assert_allclose(nearest, found.values, rtol=0.0, atol=1e-9)
        return
    # Optimal: no step from it towards any body is shorter by the estimate's own measure.
    back = np.linalg.lstsq(found.directions, nearest - found.values, rcond=None)[0]
    slope = found.information @ back
    for seed in range(10):
        other = values_of(ROBOT)
        place = np.random.default_rng(seed).uniform(-0.1, 0.1, 3)
        other = with_payload(other, 0.5, place) + np.where(np.arange(SIZE) >= 14, found.values - other, 0.0)
        towards = np.linalg.lstsq(found.directions, other - nearest, rcond=None)[0]
        if np.abs(found.directions @ towards - (other - nearest)).max() < 1e-9:
            assert slope @ towards >= -1e-4 * np.linalg.norm(slope) * np.linalg.norm(towards)


EXCITED = samples_of_motion(ROBOT, np.linspace(0, 20, 400), motion(ROBOT).evaluate(np.linspace(0, 20, 400)), 9.81)


LOG = recording(ROBOT, truth_of(ROBOT), rate=100.0)


def refused(log, robot=ROBOT, **options):
    """The line."""
    with pytest.raises(ConfigurationError) as caught:
        identify(robot, [log], **options)
    assert len(str(caught.value).splitlines()) == 1
    return str(caught.value)


def changed(**changes):
    return dataclasses.replace(LOG, **changes)


def test_angles_that_wrap_or_were_homed_a_turn_away_are_the_same_log():
    # They jump where each crank is in the middle of the log.
    there = LOG.angles[len(LOG.time) // 2]
    wrapped = there + (LOG.angles - there) % math.tau
    assert (np.abs(np.diff(wrapped, axis=0)).max(axis=0) > 6.0).all()
    for angles in (wrapped, LOG.angles - math.tau):
        np.testing.assert_allclose(changed(angles=angles).angles, LOG.angles, atol=1e-12)


def test_a_file_without_a_column(tmp_path):
    rows = [",".join(line.split(",")[:12]) for line in LOG.to_csv().splitlines()]
    (tmp_path / "log.csv").write_text("\n".join(rows))
    assert "column of torque_5: expected " in refused(tmp_path / "log.csv")
    assert "readable" in refused(tmp_path / "none.csv")


def test_of_a_log_the_angles_are_those_that_were_read(tmp_path):
    encoders = {"kind": "encoders", "offset": [0.01] * 6}
    log = run(Scenario(duration=0.1, sensors=encoders, estimator="observer"))
    np.testing.assert_allclose(recording_of_log(log).angles, log["crank_angle"] + 0.01, atol=5e-5)
    log.save(tmp_path / "log.csv")
    np.testing.assert_allclose(load_recording(tmp_path / "log.csv").angles, log["reading"], atol=1e-12)


@pytest.mark.parametrize(
    ("change", "wanted"),
    [
        ({"torque": LOG.torque * [1, 1, 0, 1, 1, 1]}, "torque_2: expected "),
        ({"time": LOG.time + 0.3 * (LOG.time > LOG.time[700])}, "row 702'"),
        ({"angles": LOG.angles + np.where(np.arange(len(LOG.time)) == 41, np.nan, 0.0)[:, None]}, "row 42"),
        ({"angles": np.degrees(LOG.angles)}, "radians within"),
    ],
    ids=["still", "gap", "nan", "degrees"],
)
def test_readings_that_cannot_be_right(change, wanted):
    with pytest.raises(ConfigurationError, match=wanted):
        changed(**change)


def test_readings_and_torques_that_are_not_those_of_the_robot():
    assert "cannot be assembled" in refused(changed(angles=np.degrees(LOG.angles) / 4.0))
    assert "N m" in refused(changed(torque=1e3 * LOG.torque))
    other = recording(ROBOT, truth_of(ROBOT), motion(ROBOT, seed=9), rate=100.0)
    assert "unexplained by any parameters" in refused(changed(torque=other.torque))
    assert "s of motion" in refused(recording(ROBOT, truth_of(ROBOT), seconds=1.0, rate=100.0))
    assert "hold: expected " in refused(LOG, hold=["mass"])


def test_a_motion_that_does_not_excite_the_parameters_is_refused():
    line = refused(recording(ROBOT, truth_of(ROBOT), HoldReference(pose=tuple(ROBOT.home_pose)), rate=100.0))
    assert "excite" in line
    slow = recording(ROBOT, truth_of(ROBOT), motion(ROBOT, size=0.02), rate=100.0, noise=0.02)
    assert "platform_inertia" in refused(slow, ask=["platform_inertia"])


def test_a_log_of_another_robot_or_without_readings():
    log = run(Scenario(duration=0.1))
    with pytest.raises(ConfigurationError, match=r"the signal reading, got 'sensors.kind ideal'; run"):
        recording_of_log(log)
    swaying = load_scenario("sway", ["robot=reachy_mini", "plant.kind=closed_form", "duration=4"])
    assert "a log of the guessed robot" in refused(run(swaying, check=False))
