"""Robots that are not quite what was drawn, tracker and encoders simulated, and what their calibrations are worth."""

import math
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from stewart_drake.estimation.calibration import calibrate
from stewart_drake.estimation.geometry import (
    CRANK,
    GAIN,
    HOMING,
    JOINT,
    LEG_PARAMETERS,
    OF_ROBOT,
    PER_LEG,
    ROD,
    SHAFT,
    SIZE,
    as_robot,
    difference,
    exponential,
    transform,
    transform_of,
)
from stewart_drake.estimation.pose_fits import located
from stewart_drake.estimation.poses import MeasurementNoise, Measurements
from stewart_drake.mechanics.kinematics import cross, forward_kinematics, inverse_kinematics, roll_pitch_yaw
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEG_COUNT

STILL = np.eye(4)


def deviating(
    robot: RobotParameters,
    rng: np.random.Generator,
    length: float = 1e-3,
    angle: float = 1e-3,
    offset: float = 0.0,
    gain: float = 0.0,
) -> RobotParameters:
    """A robot whose every parameter is off by a uniform error of up to `length` [m] or `angle` [rad] either way.

    Its servos are off by up to `offset` [rad] more, and their gains by up to `gain` [-].

    Raises:
        ConfigurationError: It cannot be a robot.
    """
    most = np.array([length if each.unit == "m" else angle for each in LEG_PARAMETERS[:GAIN]] * LEG_COUNT)
    legs = np.zeros((LEG_COUNT, PER_LEG))
    legs[:, :GAIN] = rng.uniform(-most, most).reshape(LEG_COUNT, GAIN)
    if offset or gain:
        legs[:, HOMING] += rng.uniform(-offset, offset, LEG_COUNT)
        legs[:, GAIN] = rng.uniform(-gain, gain, LEG_COUNT)
    return as_robot(robot, np.concatenate([legs.ravel(), np.zeros(SIZE - OF_ROBOT)]))


def measured(
    robot: RobotParameters,
    targets: Measurements,
    noise: MeasurementNoise,
    rng: np.random.Generator,
    base: np.ndarray = STILL,
    marker: np.ndarray = STILL,
) -> Measurements:
    """What tracker and encoders say of a robot whose cranks were brought to the angles of planned poses.

    Encoders err by their steps alone, of sqrt(12) times the stated noise.

    Raises:
        ForwardKinematicsError: The robot cannot be assembled near a planned pose.
    """
    pose = forward_kinematics(robot, robot.servo_gains * targets.angles, targets.pose)
    step = noise.encoder * math.sqrt(12.0)
    observed = base @ transform_of(pose) @ marker
    turn = exponential(noise.rotation * rng.standard_normal((len(pose), 3))) @ observed[:, :3, :3]
    place = observed[:, :3, 3] + noise.position * rng.standard_normal((len(pose), 3))
    angles = np.rint(targets.angles / step) * step
    return Measurements(np.concatenate([roll_pitch_yaw(turn), place], axis=-1), angles, "simulated poses")


def placed(
    robot: RobotParameters, targets: Measurements, noise: MeasurementNoise, rng: np.random.Generator
) -> Measurements:
    """What encoders say of a robot that was brought to planned poses by hand, nearly: by a level, or into a jig."""
    turn = exponential(noise.rotation * rng.standard_normal((len(targets), 3))) @ targets.marker[:, :3, :3]
    place = targets.pose[:, 3:] + noise.position * rng.standard_normal((len(targets), 3))
    angles = inverse_kinematics(robot, np.concatenate([roll_pitch_yaw(turn), place], axis=-1)) / robot.servo_gains
    return Measurements(targets.pose, angles, "simulated poses")


def aligned(robot: RobotParameters, guess: RobotParameters, known: Collection[str] = ()) -> RobotParameters:
    """The same robot with B and P where a calibration puts them: its shafts and joints nearest to a guess's.

    Args:
        robot: Any.
        guess: Near to it.
        known: Frames that stay where they are.
    """
    base, platform = STILL, STILL
    if "base" not in known:
        base = _onto(robot.shaft_positions, guess.shaft_positions)
    if "platform" not in known:
        platform = _onto(robot.platform_joints, guess.platform_joints)
    legs: list[dict[str, Any]] = [
        {
            "shaft_position": base[:3, :3] @ robot.shaft_positions[leg] + base[:3, 3],
            "crank_zero_direction": base[:3, :3] @ robot.crank_zero_directions[leg],
            "crank_quarter_direction": base[:3, :3] @ robot.crank_quarter_directions[leg],
            "platform_joint": platform[:3, :3] @ robot.platform_joints[leg] + platform[:3, 3],
            "crank_length": robot.crank_lengths[leg],
            "rod_length": robot.rod_lengths[leg],
            "branch": int(robot.branches[leg]),
            "servo_gain": robot.servo_gains[leg],
        }
        for leg in range(LEG_COUNT)
    ]
    return robot.replace(legs=legs)


def _onto(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """The motion that brings points nearest to others."""
    middle, goal = points.mean(axis=0), others.mean(axis=0)
    turn = Rotation.align_vectors(others - goal, points - middle)[0].as_matrix()
    return transform(turn, goal - turn @ middle)


def change_to(guess: RobotParameters, robot: RobotParameters) -> np.ndarray:
    """The change (`SIZE`,) [m, rad] that makes of a guess another robot, frames left alone: undoes `as_robot`."""
    change = np.zeros((LEG_COUNT, PER_LEG))
    change[:, SHAFT] = robot.shaft_positions - guess.shaft_positions
    change[:, JOINT] = robot.platform_joints - guess.platform_joints
    change[:, CRANK] = robot.crank_lengths - guess.crank_lengths
    change[:, ROD] = robot.rod_lengths - guess.rod_lengths
    change[:, GAIN] = robot.servo_gains - guess.servo_gains
    zero, quarter = guess.crank_zero_directions, guess.crank_quarter_directions
    axis, other = cross(zero, quarter), cross(robot.crank_zero_directions, robot.crank_quarter_directions)
    # The turn that takes one motor axis to the other on the shortest way lies across both, so in the crank's plane.
    across = cross(axis, other)
    sine = np.linalg.norm(across, axis=-1)
    angle = np.arctan2(sine, np.sum(axis * other, axis=-1))
    turn = across * np.divide(angle, sine, out=np.ones(LEG_COUNT), where=sine > 0.0)[:, None]
    change[:, 8], change[:, 9] = np.sum(turn * zero, axis=-1), np.sum(turn * quarter, axis=-1)
    rotation = exponential(turn)
    c, s = (np.einsum("lij,lj,li->l", rotation, v, robot.crank_zero_directions) for v in (zero, quarter))
    change[:, HOMING] = np.arctan2(-s, c)
    return np.concatenate([change.ravel(), np.zeros(12)])


@dataclass(frozen=True, eq=False)
class Trial:
    """One robot's calibration, compared with the truth.

    Attributes:
        before: [m, rad] RMS error of unseen poses' position and rotation by the guess.
        after: [m, rad] the same by the calibrated robot.
        inside: (6, 12) bool, whether the 95 % intervals hold the truth.
        width: (6, 12) [m, rad, -] half widths.
        noise_ratio: [-] see `Calibration`.
        fit: What was fitted.
        off: (6, 12) [m, rad, -] errors of the parameters.
    """

    before: tuple[float, float]
    after: tuple[float, float]
    inside: np.ndarray
    width: np.ndarray
    noise_ratio: float
    fit: str
    off: np.ndarray


def run_trial(
    guess: RobotParameters,
    targets: Measurements,
    unseen: Measurements,
    noise: MeasurementNoise,
    seed: int,
    known_frames: Collection[str] = (),
    fit: str | None = None,
    offset: float = 0.0,
    gain: float = 0.0,
) -> Trial:
    """Calibrates a robot that is off in every parameter by up to 1 mm or 1 mrad either way.

    Frames that are not known lie anywhere: the tracker some metres away, the marker some centimetres.

    Args:
        guess: What it was drawn as.
        targets: Poses that are measured.
        unseen: Poses at which it is assessed, by encoder readings with their steps.
        noise: Of tracker and encoders.
        seed: Of the deviations, the frames and the noise.
        known_frames: As for `calibrate`.
        fit: As for `calibrate`.
        offset: [rad] more by which servos are off, at most.
        gain: [-] the same of their gains.
    """
    rng = np.random.default_rng(seed)
    truth = deviating(guess, rng, offset=offset, gain=gain)
    base = transform(exponential(rng.uniform(-2.0, 2.0, 3)), rng.uniform(-3.0, 3.0, 3))
    marker = transform(exponential(rng.uniform(-1.0, 1.0, 3)), rng.uniform(-0.05, 0.05, 3))
    base, marker = (STILL if "base" in known_frames else base), (STILL if "platform" in known_frames else marker)
    observed = measured(truth, targets, noise, rng, base, marker)
    found = calibrate(guess, observed, noise, known_frames, fit=fit)
    tracker_free = MeasurementNoise(position=1e-300, rotation=1e-300, encoder=noise.encoder)
    right = measured(truth, unseen, tracker_free, rng, base, marker)
    believed = located(guess, observed, known_frames)
    same = aligned(truth, guess, known_frames)
    off = (found.change - change_to(guess, same))[:OF_ROBOT].reshape(LEG_COUNT, PER_LEG)
    width = found.half_width[:OF_ROBOT].reshape(LEG_COUNT, PER_LEG)
    return Trial(
        _error(guess, believed.base, believed.marker, right, unseen),
        _error(found.robot, found.base, found.marker, right, unseen),
        np.abs(off) <= width,
        width,
        found.noise_ratio,
        found.fit,
        off,
    )


def coverage(trials: Collection[Trial]) -> dict[str, float]:
    """Share [-] of the intervals that hold the truth: of each parameter that is fitted, and under `all`."""
    fitted = np.all([trial.width > 0.0 for trial in trials], axis=(0, 1))
    inside = np.mean([trial.inside.mean(axis=0) for trial in trials], axis=0)[fitted]
    names = [str(parameter) for parameter, counts in zip(LEG_PARAMETERS, fitted, strict=True) if counts]
    return {**dict(zip(names, inside.tolist(), strict=True)), "all": float(inside.mean())}


def gains(trials: Collection[Trial]) -> np.ndarray:
    """(n, 2) [-] how many times smaller the errors of unseen poses have become, position and rotation."""
    return np.array([np.divide(trial.before, trial.after) for trial in trials])


def _error(
    robot: RobotParameters, base: np.ndarray, marker: np.ndarray, right: Measurements, near: Measurements
) -> tuple[float, float]:
    """RMS [m, rad] of the marker's predicted poses at readings."""
    pose = forward_kinematics(robot, robot.servo_gains * right.angles, near.pose)
    there = base @ transform_of(pose) @ marker
    turn, place = np.split(np.linalg.norm(difference(right.marker, there).reshape(-1, 2, 3), axis=-1), 2, axis=-1)
    return float(np.sqrt(np.mean(place**2))), float(np.sqrt(np.mean(turn**2)))
