"""Tracker and encoders simulated, and robots that are not quite what was drawn: what calibrations are judged by."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Any

import numpy as np

from stewart_drake.calibration.measurements import MeasurementNoise, Measurements
from stewart_drake.calibration.model import STILL, Frame
from stewart_drake.calibration.parameters import OF_LEG, OF_ROBOT, SIZE, FrameName, as_robot, exponential
from stewart_drake.mechanics.kinematics import forward_kinematics, roll_pitch_yaw, rotation_matrix
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEGS


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


def aligned(robot: RobotParameters, guess: RobotParameters, known: Collection[FrameName] = ()) -> RobotParameters:
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
            "shaft_position": base.turn @ robot.shaft_positions[leg] + base.shift,
            "crank_zero_direction": base.turn @ robot.crank_zero_directions[leg],
            "crank_quarter_direction": base.turn @ robot.crank_quarter_directions[leg],
            "platform_joint": platform.turn @ robot.platform_joints[leg] + platform.shift,
            "crank_length": robot.crank_lengths[leg],
            "rod_length": robot.rod_lengths[leg],
            "branch": int(robot.branches[leg]),
        }
        for leg in range(LEGS)
    ]
    return robot.replace(legs=legs)


def _onto(points: np.ndarray, others: np.ndarray) -> Frame:
    """The motion that brings points nearest to others."""
    from scipy.spatial.transform import Rotation

    middle, goal = points.mean(axis=0), others.mean(axis=0)
    turn = Rotation.align_vectors(others - goal, points - middle)[0].as_matrix()
    return Frame(turn, goal - turn @ middle)
