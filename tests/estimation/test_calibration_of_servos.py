"""Calibration of servos' gains and offsets: by a tracker, an IMU, a tilt sensor, a level and a jig."""

import functools
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from simulated_calibration import change_to, deviating, measured, placed

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.tables import CRANK_ANGLES, column_name
from stewart_drake.estimation.calibration import calibrate
from stewart_drake.estimation.geometry import (
    FITS,
    GAIN,
    HOMING,
    KINDS,
    OF_ROBOT,
    PER_LEG,
    difference,
    exponential,
    transform,
    transform_of,
)
from stewart_drake.estimation.poses import (
    INSTRUMENTS,
    MeasurementNoise,
    Measurements,
    candidate_poses,
    load_measurements,
    plan_poses,
)
from stewart_drake.hardware.servos import PositionServos
from stewart_drake.hardware.wiring import ServoOptions
from stewart_drake.mechanics.kinematics import forward_kinematics, inverse_kinematics
from stewart_drake.robot.robot_files import load_robot
from stewart_drake.scenario.limits import ReferenceLimits

HOBBY = load_robot("servo_hexapod")
SHIPPED = Path(__file__).parents[2] / "diagrams" / "calibration" / "imu.csv"


@functools.cache
def hobby(instrument, count=40):
    used = INSTRUMENTS[instrument]
    hold = tuple(set(KINDS) - set(FITS[used.fit]))
    return plan_poses(HOBBY, count, None, used.noise, used.known_frames, hold, candidates=200, instrument=used)


def turned(length, seed=0):
    """A hexapod whose servos are off by up to 2 deg and 5 %."""
    return deviating(HOBBY, np.random.default_rng(seed), length, length, np.radians(2.0), 0.05)


def test_gains_are_told_from_the_geometry_by_a_tracker_and_make_poses_right():
    truth, noise = turned(1e-3), INSTRUMENTS["tracker"].noise
    found = calibrate(HOBBY, measured(truth, hobby("tracker").targets, noise, np.random.default_rng(1)), noise)
    assert found.fit == "all"
    off = np.abs(found.robot.servo_gains - truth.servo_gains)
    assert (off < 2.0 * found.half_width[GAIN:OF_ROBOT:PER_LEG]).all()
    assert off.max() < 5e-3
    # At angles that were not measured, in the tracker's frame.
    pose = candidate_poses(HOBBY, 20, ReferenceLimits(), np.random.default_rng(3))
    near = Measurements(pose, inverse_kinematics(HOBBY, pose))
    there, here = (
        transform_of(forward_kinematics(robot, robot.servo_gains * near.angles, near.pose))
        for robot in (truth, found.robot)
    )
    error = difference(there, found.base @ here @ found.marker)
    assert np.sqrt(np.mean(np.sum(error[:, 3:] ** 2, axis=1))) < 2e-5
    assert np.sqrt(np.mean(np.sum(error[:, :3] ** 2, axis=1))) < np.radians(0.01)
    again = calibrate(found.robot, measured(truth, hobby("tracker").targets, noise, np.random.default_rng(2)), noise)
    assert again.robot.servo_gains == pytest.approx(truth.servo_gains, abs=5e-3)


def test_servos_that_turn_right_keep_their_gain():
    truth, noise = deviating(HOBBY, np.random.default_rng(0)), INSTRUMENTS["tracker"].noise
    found = calibrate(HOBBY, measured(truth, hobby("tracker").targets, noise, np.random.default_rng(1)), noise)
    assert found.fit == "geometry"
    assert (found.robot.servo_gains == 1.0).all()
    assert [choice.fit for choice in found.choices] == ["all", "geometry", "servos", "offsets", "none"]


@pytest.mark.parametrize(("instrument", "deg"), [("imu", 1.4), ("tilt", 2.0)])
def test_homing_offsets_from_angles_alone_with_mounting_and_heading_unknown(instrument, deg):
    used, rng = INSTRUMENTS[instrument], np.random.default_rng(4)
    truth = deviating(HOBBY, rng, 0.0, 0.0, np.radians(4.0))
    heading, mounting = (
        transform(exponential(np.array([0.0, 0.0, 1.0])), np.zeros(3)),
        transform(exponential(np.array([0.2, 0.4, -0.3])), np.zeros(3)),
    )
    poses = measured(truth, hobby("tracker").targets, used.noise, rng, heading, mounting).only(used.measured)
    found = calibrate(HOBBY, poses)
    assert found.fit == "offsets"
    off = found.homing_offsets - change_to(HOBBY, truth)[HOMING:OF_ROBOT:PER_LEG]
    width = found.half_width[HOMING:OF_ROBOT:PER_LEG]
    assert np.degrees(np.median(width)) / 1.98 == pytest.approx(deg, rel=0.4)
    assert (np.abs(off) < 2.0 * width).all()
    assert found.noise_ratio == pytest.approx(1.0, abs=0.3)


def test_the_shipped_recording_of_an_imu_shows_nothing_that_is_off_and_the_guess_is_kept():
    kept = calibrate(HOBBY, SHIPPED)
    assert (kept.fit, kept.robot) == ("none", HOBBY)
    assert [line.partition(":")[0] for line in kept.warnings()] == ["nothing is changed"]
    assert "as guessed: " in kept.robot_file()
    found = calibrate(HOBBY, SHIPPED, fit="offsets")
    assert "changed by less than their 95 % intervals" in " ".join(found.warnings())
    assert (np.abs(found.homing_offsets) < 1.5 * found.half_width[HOMING:OF_ROBOT:PER_LEG]).all()
    assert found.noise_ratio < 1.5
    assert dict(found.summary())["measured"] == "roll, pitch, yaw"
    assert "mm" not in dict(found.summary())["pose error after (RMS)"]


def test_a_level_and_a_jig_tell_offsets_and_gains():
    truth, rng = turned(0.0), np.random.default_rng(0)
    for instrument, count, most in (("level", 40, 3e-2), ("jig", 5, 3e-2)):
        used = INSTRUMENTS[instrument]
        poses = placed(truth, hobby(instrument, count).targets, used.noise, rng).only(used.measured)
        found = calibrate(HOBBY, poses, used.noise, used.known_frames)
        assert found.fit == "servos"
        assert found.robot.servo_gains == pytest.approx(truth.servo_gains, abs=most)
    assert set(hobby("level").targets.pose[:, 0]) == {0.0}


def test_servos_on_a_board_move_a_calibrated_robot_to_the_asked_pose():
    truth, motors = turned(0.0), PositionServos(preset="mg996r")
    jig = INSTRUMENTS["jig"]
    quiet = MeasurementNoise(position=1e-5, rotation=1e-4)
    poses = placed(truth, hobby("jig", 5).targets, quiet, np.random.default_rng(0))
    found = calibrate(HOBBY, poses, jig.noise, jig.known_frames).robot
    before = ServoOptions().wiring(HOBBY, motors, [0.0] * 6)
    asked = candidate_poses(HOBBY, 20, ReferenceLimits(), np.random.default_rng(1))

    def error(robot):
        """[m] of the true robot at the pulses of an export, by servos that are mounted as before the calibration."""
        wiring = ServoOptions().wiring(robot, motors, [0.0] * 6)
        pulses = wiring.commands(inverse_kinematics(robot, asked) / robot.servo_gains)
        readings = before.zero + (pulses - before.middle) / before.per_rad
        reached = forward_kinematics(truth, truth.servo_gains * readings, asked)
        return np.linalg.norm((reached - asked)[:, 3:], axis=1).max()

    assert error(found) < 2e-4
    forgotten = found.replace(legs=[{**leg, "servo_middle": None} for leg in found.each_leg()])
    assert error(forgotten) > 5.0 * error(found)
    assert error(HOBBY) > 5.0 * error(found)
    # The board's start follows the robot, and a second calibration does not move the servos.
    assert np.abs(ServoOptions().wiring(found, motors, [0.0] * 6).home - before.home).max() > 1e-2
    more = placed(truth, hobby("jig", 5).targets, jig.noise, np.random.default_rng(1))
    again = calibrate(found, more, jig.noise, jig.known_frames, fit="offsets")
    assert again.robot.servo_middles == pytest.approx(before.zero)


@pytest.mark.long
@pytest.mark.parametrize("instrument", ["imu", "tilt"])
def test_a_calibration_by_little_does_not_make_poses_worse(instrument):
    used, sizes = INSTRUMENTS[instrument], []
    near = Measurements(pose := candidate_poses(HOBBY, 30, ReferenceLimits(), np.random.default_rng(3)), pose)
    for seed in range(6):
        truth, rng = turned(0.0, seed), np.random.default_rng(100 + seed)
        poses = measured(truth, hobby(instrument).targets, used.noise, rng).only(used.measured)
        found = calibrate(HOBBY, poses).robot
        angles = inverse_kinematics(HOBBY, pose)
        right, *both = (forward_kinematics(of, of.servo_gains * angles, near.pose) for of in (truth, HOBBY, found))
        sizes.append([np.linalg.norm((one - right)[:, :3]) for one in both])
    before, after = np.mean(sizes, axis=0)
    assert after < before


def test_what_an_instrument_cannot_have_measured_is_one_line():
    used = INSTRUMENTS["imu"]
    poses = measured(turned(0.0), hobby("imu").targets, used.noise, np.random.default_rng(0)).only(used.measured)
    with pytest.raises(ConfigurationError, match=r"--with: expected what measures no positions, .*: imu, or a level"):
        poses.refuse_other("tracker", HOBBY)
    level = hobby("level").targets.only(INSTRUMENTS["level"].measured)
    level.refuse_other("level", HOBBY)
    tilted = Measurements(level.pose + [0.05, 0, 0, 0, 0, 0], level.angles)
    with pytest.raises(ConfigurationError, match=r"row 1, pose_roll: expected the planned 0: .* the bubble"):
        tilted.refuse_other("level", HOBBY)
    other = Measurements(poses.pose * [1, -1, 1, 1, 1, 1], poses.angles)
    with pytest.raises(
        ConfigurationError, match=r"pose_roll or pose_pitch: expected R = .* count this angle the other way"
    ):
        calibrate(HOBBY, other)


def test_few_poses_and_larger_noise_are_warnings():
    used, jig = INSTRUMENTS["imu"], INSTRUMENTS["jig"]
    poses = measured(turned(0.0), hobby("imu").targets, used.noise, np.random.default_rng(0)).only(used.measured)
    four = Measurements(poses.pose[:4], poses.angles[:4])
    assert any("are not determined" in line for line in calibrate(HOBBY, four, fit="offsets").warnings())
    rough = MeasurementNoise(position=1e-3, rotation=1e-2)
    rows = placed(turned(0.0), hobby("jig", 5).targets, rough, np.random.default_rng(0))
    found = calibrate(HOBBY, rows, jig.noise, jig.known_frames)
    assert found.noise_ratio > 3.0
    assert any("times the noise of the instrument" in line for line in found.warnings())


def test_tables_of_imus_and_accelerometers(tmp_path):
    used, file = INSTRUMENTS["imu"], tmp_path / "imu.csv"
    poses = measured(HOBBY, hobby("imu").targets, used.noise, np.random.default_rng(0))
    turns = Rotation.from_matrix(poses.marker[:, :3, :3])
    angles = [column_name(*quantity) for quantity in CRANK_ANGLES]
    for names, values, wanted in (
        (["pose_roll_deg", "pitch_deg", "yaw_deg"], np.degrees(poses.pose[:, :3]), "rpy"),
        ([f"quaternion_{axis}" for axis in "xyzw"], 3.0 * turns.as_quat(), "rpy"),
        ([f"acceleration_{axis}" for axis in "xyz"], turns.inv().apply([0.0, 0.0, 9.81]), "rp"),
    ):
        table = np.hstack([values, poses.angles]).tolist()
        file.write_text("\n".join([",".join([*names, *angles]), *(",".join(map(str, row)) for row in table)]))
        read = load_measurements(file)
        assert "".join(np.array([*"rpyXYZ"])[read.measured]) == wanted
        assert read.pose[:, : len(wanted)] == pytest.approx(poses.pose[:, : len(wanted)], abs=1e-9)
        assert load_measurements(file).instrument == {"rpy": "imu", "rp": "tilt"}[wanted]


@pytest.mark.parametrize(
    ("header", "row", "said"),
    [
        ("pose_roll_rad,pose_yaw_rad", "0,0", "column of pose_pitch: expected one of pose_pitch_rad"),
        ("roll_rad,pitch_rad,yaw_turns", "0,0,0", "column of pose_yaw: expected one of"),
        ("roll_rad,pitch_rad,x_m", "0,0,0", "column of pose_yaw: expected one of"),
        ("quaternion_w,quaternion_x,quaternion_y", "1,0,0", "column of quaternion_z: expected"),
        ("quaternion_w,quaternion_x,quaternion_y,quaternion_z", "0,0,0,0", "row 1, quaternion: expected numbers that"),
        ("acceleration_x,acceleration_y,acceleration_z_rad", "0,0,9", "column of acceleration_z: expected one of"),
        ("roll_rad,pitch_rad", "0,nan", "row 1, pose_pitch: expected a finite number"),
        ("roll_rad,pitch_rad", "0,90", "row 1, pose_pitch: expected metres, and radians"),
        ("", "", "column of pose_roll: expected one of"),
    ],
)
def test_wrong_columns_of_an_imu_are_one_line(tmp_path, header, row, said):
    angles = ",".join(f"crank_angle_{leg}_rad" for leg in range(6))
    second = row.replace("nan", "0.1").replace("90", "0.1")
    lines = ((header, angles), (row, "0,0,0,0,0,0"), (second, "0,0,0,0,0,0.1"))
    (tmp_path / "imu.csv").write_text("\n".join(",".join(filter(None, line)) for line in lines))
    with pytest.raises(ConfigurationError) as caught:
        calibrate(HOBBY, tmp_path / "imu.csv")
    assert said in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
