"""Tracker and encoders simulated, and robots that are not quite what was drawn: what calibrations are judged by."""

from __future__ import annotations

import math

import numpy as np

from stewart_drake.calibration.measurements import MeasurementNoise, Measurements
from stewart_drake.calibration.model import STILL, Frame
from stewart_drake.calibration.parameters import OF_LEG, OF_ROBOT, SIZE, as_robot, exponential
from stewart_drake.leg import LEGS
from stewart_drake.mechanics.kinematics import forward_kinematics, roll_pitch_yaw, rotation_matrix
from stewart_drake.robot import RobotParameters


def deviating(
    robot: RobotParameters, rng: np.random.Generator, length: float = 1e-3, angle: float = 1e-3
) -> RobotParameters:
    """A robot whose every parameter is off by a uniform error of up to `length` [m] or `angle` [rad] either way.

    Raises:
        ConfigurationError: It cannot be a robot.
    """
    most = np.array([length if each.unit == "m" else angle for each in OF_LEG] * LEGS)
    change = np.zeros(SIZE)
    change[:OF_ROBOT] = rng.uniform(-most, most)
    return as_robot(robot, change)


def measured(
    robot: RobotParameters,
    targets: Measurements,
    noise: MeasurementNoise,
    rng: np.random.Generator,
    base: Frame = STILL,
    marker: Frame = STILL,
) -> Measurements:
    """What tracker and encoders say of a robot whose cranks were brought to the angles of planned poses.

    Encoders err by their steps alone, of sqrt(12) times the stated noise.

    Raises:
        ForwardKinematicsError: The robot cannot be assembled near a planned pose.
    """
    pose = forward_kinematics(robot, targets.angles, targets.pose)
    step = noise.encoder * math.sqrt(12.0)
    seen = base.after(Frame(rotation_matrix(pose[:, :3]), pose[:, 3:])).after(marker)
    turn = exponential(noise.rotation * rng.standard_normal((len(pose), 3))) @ seen.turn
    place = seen.shift + noise.position * rng.standard_normal((len(pose), 3))
    angles = np.rint(targets.angles / step) * step
    return Measurements(np.concatenate([roll_pitch_yaw(turn), place], axis=-1), angles, "simulated poses")
