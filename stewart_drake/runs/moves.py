"""Moves of Reachy Mini: whether they can be done, how they can, and as poses from which its servos follow them."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from stewart_drake.analysis import feasibility
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.mechanics.kinematics import forward_kinematics, reach_margin, rotation_angle, rotation_matrix
from stewart_drake.references.moves import STEP, Move
from stewart_drake.robot import RobotParameters
from stewart_drake.scenario.controller import Controller
from stewart_drake.scenario.limits import ReferenceLimits, limit_margins
from stewart_drake.scenario.scenario import Scenario

SPEED, TORQUE = math.radians(618.0), 0.5  # [rad/s] without load, and [N m] of a fixed move: an XL330-M288-T at 5 V.
MOVING = ("crank_speed", "torque")  # What a move breaks by its speed; the rest it breaks by where it is.
NEAR = 0.05  # [s] about a place that is broken within which the move changes.
SMALLER, SMOOTHER, SLOWER = 0.02, 0.004, 0.01  # In a step: [-] of its size, [s] and [-] of its duration.
SMOOTHEST = 0.06  # [s] that a move is averaged over at most, the standard deviation of a Gaussian; then it is slowed.
_STEPS = 2000


class Checked(NamedTuple):
    """A move against the limits of its robot."""

    report: feasibility.FeasibilityReport
    unreachable: float  # [-] share of its ticks at which no crank angles make its pose.


class Fixed(NamedTuple):
    """A move that can be done, and what was changed, at most and in RMS."""

    move: Move
    size: float  # [-] where it is smallest.
    smoothing: float  # [s] where it is largest.
    slowdown: float  # [-]
    position: tuple[float, float]  # [m]
    rotation: tuple[float, float]  # [rad]


def motion_of(move: Move) -> Any:
    """Spline through the poses of a move, from t = 0."""
    from scipy.interpolate import CubicSpline

    return CubicSpline(move.time - move.time[0], move.pose)


def check_move(robot: RobotParameters, move: Move) -> Checked:
    """All limits along a move: those of a scenario, with the speed of the robot's servos."""
    motion = motion_of(move)
    times = feasibility.checked_times(float(motion.x[-1]))
    signals = [motion(times, order) for order in range(3)]
    limits = ReferenceLimits(crank_speed=SPEED)
    report = feasibility.check_motion(robot, limits, times, *signals, STANDARD_GRAVITY)
    return Checked(report, float((reach_margin(robot, move.pose) < 0.0).any(axis=-1).mean()))


def averaged(pose: np.ndarray, widths: np.ndarray) -> np.ndarray:
    """Poses (n, 6) of rows `STEP` apart, each averaged by a Gaussian of its own standard deviation (n,) [s]."""
    most = math.ceil(4.0 * widths.max() / STEP)
    padded = np.pad(pose, ((most, most), (0, 0)), mode="edge")
    shifts = np.arange(-most, most + 1)
    weights = np.exp(-0.5 * (STEP * shifts / np.maximum(widths, 1e-3)[:, None]) ** 2)
    total = sum(weights[:, [place]] * padded[place : place + len(pose)] for place in range(len(shifts)))
    return np.asarray(total / weights.sum(axis=1, keepdims=True))


def fix_move(robot: RobotParameters, move: Move) -> Fixed:
    """The move changed where it breaks a limit, step by step until it breaks none.

    Where a pose is outside, the move comes nearer to home; where it is too fast or needs too much torque, it is averaged
    over a longer time, up to `SMOOTHEST`; then all of it is slowed.
    """
    from scipy.ndimage import gaussian_filter1d, maximum_filter1d

    def near(values: np.ndarray) -> np.ndarray:
        widest = maximum_filter1d(values, 2 * round(NEAR / STEP) + 1, mode="nearest")
        return np.asarray(gaussian_filter1d(widest, 0.5 * NEAR / STEP, mode="nearest"))

    rows = np.arange(move.time[0], move.time[-1] + 0.5 * STEP, STEP)
    columns = np.column_stack([move.pose, move.antennas, move.body_yaw])
    if len(rows) < 4:
        raise ConfigurationError("move", f"{move.time[-1] - move.time[0]:g} s", f"at least {3.0 * STEP:g} s")
    given = np.column_stack([np.interp(rows, move.time, column) for column in columns.T])
    wanted, home = given[:, :6], robot.home_pose
    limits = ReferenceLimits(crank_speed=SPEED, torque_fraction=TORQUE / robot.effort_limit)
    smaller, widths, slowdown = np.zeros(len(rows)), np.zeros(len(rows)), 1.0
    for _ in range(_STEPS):
        less, wide = near(smaller), near(widths)
        pose = averaged(home + (1.0 - less)[:, None] * (wanted - home), wide)
        made = Move(move.description, STEP * slowdown * np.arange(len(rows)), pose, given[:, 6:8], given[:, 8])
        motion = motion_of(made)
        times = feasibility.checked_times(float(motion.x[-1]))
        signals = [motion(times, order) for order in range(3)]
        margins = limit_margins(robot, limits, *signals, STANDARD_GRAVITY)
        # Where a rod cannot span the rest is unknown.
        outside = np.any([~(margins[name] >= 0.0).all(axis=1) for name in margins if name not in MOVING], axis=0)
        fast = np.any([(margins[name] < 0.0).any(axis=1) for name in MOVING], axis=0) & ~outside
        if not (outside | fast).any():
            apart = 2 * [0.0]
            turns = np.swapaxes(rotation_matrix(wanted[:, :3]), 1, 2) @ rotation_matrix(pose[:, :3])
            apart = [np.linalg.norm((pose - wanted)[:, 3:], axis=1), rotation_angle(turns)]
            changes = [(float(each.max()), float(np.sqrt(np.mean(each**2)))) for each in apart]
            return Fixed(made, 1.0 - float(less.max()), float(wide.max()), slowdown, changes[0], changes[1])
        at = np.rint(times / (STEP * slowdown)).astype(int)
        smaller[np.unique(at[outside])] += SMALLER
        smaller = np.minimum(smaller, 1.0)
        at = np.unique(at[fast])
        slowdown *= 1.0 + SLOWER * float((widths[at] >= SMOOTHEST).any())
        widths[at] = np.minimum(widths[at] + SMOOTHER, SMOOTHEST)
    raise ConfigurationError("move", move.description, f"a move that can be done after {_STEPS} small changes")


def shaped_move(scenario: Scenario, move: Move) -> Move:
    """Poses whose crank angles are what a scenario's controller would send to servos that take angles.

    Six motors and six numbers of a pose: a player that solves inverse kinematics alone sends the same angles.
    """
    motion = motion_of(move)
    end = float(motion.x[-1])

    def row(now: float) -> np.ndarray:
        values = np.array([motion(min(max(now, 0.0), end), order) for order in range(3)])
        values[1:] *= 0.0 <= now < end
        return values.ravel()

    ahead = scenario.preview
    controller = Controller(scenario, {"reference": row, "reference_ahead": lambda now: row(now + ahead)})
    if controller.unit != "rad" or scenario.controller.feedback:
        raise ConfigurationError("--shaped", scenario.name, "a `feedforward` controller of motors that take angles")
    times = controller.period * np.arange(math.ceil(end / controller.period - 1e-9) + 1)
    angles, nothing = np.empty((len(times), 6)), np.zeros(controller.reading)
    for time, out in zip(times.tolist(), angles, strict=True):
        controller.step(nothing, time, out)
    robot = scenario.belief.robot
    angles = np.clip(angles, *robot.crank_angle_ranges.T)
    pose = forward_kinematics(robot, angles, motion(np.minimum(times, end)))
    columns = np.column_stack([move.antennas, move.body_yaw])
    others = np.column_stack([np.interp(times, motion.x, column) for column in columns.T])
    return Move(move.description, times, pose, others[:, :2], others[:, 2])
