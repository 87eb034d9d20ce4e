"""Feasibility of moves of Reachy Mini, feasible versions of them, and poses for which its servos follow them."""

from __future__ import annotations

import math

import numpy as np

from stewart_drake.analysis import feasibility
from stewart_drake.base.errors import ConfigurationError, RunFailure
from stewart_drake.mechanics import kinematics
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.reachy.moves import STEP, Move
from stewart_drake.references.rows import RowsMotion
from stewart_drake.robot import RobotParameters
from stewart_drake.scenario.controller import Controller
from stewart_drake.scenario.limits import ReferenceLimits, limit_bounds, limit_margins
from stewart_drake.scenario.scenario import Scenario

TORQUE = 0.5  # [N m] largest in a fixed move.
RESERVE = 0.002  # Relative margin, or [rad] to a stop, of a fixed move: a player samples it at other times.
MOTION_LIMITS = ("crank_speed", "torque")  # Limits on the speed of a move; all others are on its poses.
CHANGE_RANGE = 0.05  # [s] A move changes this far before and after a violation.
SMALLER, SMOOTHER, SLOWER = 0.02, 0.004, 0.01  # Step of the size [-], averaging [s], duration [-].
SMOOTHEST = 0.035  # [s] largest standard deviation of the averaging; then the move is slowed.
_STEPS, _SHARES = 2000, 21


def _of_head(robot: RobotParameters) -> RobotParameters:
    """The robot without its tool, as moves are poses of the head."""
    return robot if robot.tool is None else robot.replace(tool=None)


def motion_of(move: Move) -> RowsMotion:
    """The motion of a move, from t = 0: as `reference: {kind: recorded}` plays its file."""
    return RowsMotion(move.time, move.pose)


def _limits(robot: RobotParameters) -> ReferenceLimits:
    """The limits of a scenario with that robot."""
    return Scenario(robot=robot).limits


def check_move(robot: RobotParameters, move: Move) -> tuple[feasibility.FeasibilityReport, float]:
    """All limits along a move, and the share of its ticks [-] out of reach."""
    robot, motion = _of_head(robot), motion_of(move)
    report = feasibility.check_reference(robot, _limits(robot), motion, motion.end)
    rows = motion.rows(feasibility.checked_times(motion.length))
    return report, float((kinematics.reach_margin(robot, rows) < 0.0).any(axis=-1).mean())


def averaged(pose: np.ndarray, widths: np.ndarray) -> np.ndarray:
    """Poses (n, 6) of rows `STEP` apart, row k averaged by a Gaussian of standard deviation `widths[k]` [s]."""
    most = math.ceil(4.0 * widths.max() / STEP)
    padded = np.pad(pose, ((most, most), (0, 0)), mode="edge")
    weights = np.exp(-0.5 * (STEP * np.arange(-most, most + 1) / np.maximum(widths, 1e-3)[:, None]) ** 2)
    total = sum(weights[:, [place]] * padded[place : place + len(pose)] for place in range(2 * most + 1))
    return np.asarray(total / weights.sum(axis=1, keepdims=True))


def fix_move(robot: RobotParameters, move: Move) -> tuple[Move, dict[str, float]]:
    """A feasible version of a move, and by how much it differs.

    The move is changed in small steps until the rows as written break no limit. A pose outside of the workspace comes
    nearer to home. Motion that is too fast, or needs too much torque, is averaged over a longer time, up to
    `SMOOTHEST`; beyond that the whole move is slowed.
    """
    from scipy.ndimage import gaussian_filter1d, maximum_filter1d

    def near(values: np.ndarray) -> np.ndarray:
        widest = maximum_filter1d(values, 2 * round(CHANGE_RANGE / STEP) + 1, mode="nearest")
        return np.asarray(gaussian_filter1d(widest, 0.5 * CHANGE_RANGE / STEP, mode="nearest"))

    signal, robot = motion_of(move), _of_head(robot)
    if signal.length < 3.0 * STEP:
        raise ConfigurationError("move", f"{signal.length:.3g} s", f"at least {3.0 * STEP:g} s")
    time = STEP * np.arange(math.ceil(signal.length / STEP - 1e-6) + 1)
    until = np.minimum(time, signal.length)
    given = move.at(move.time[0] + time)._replace(pose=signal.rows(until))
    count, home, limits = len(time), robot.home_pose, _limits(robot)
    limits = limits.replace(torque_fraction=TORQUE / robot.effort_limit)
    bounds = limit_bounds(robot, limits)
    smaller, widths, slowdown = np.zeros(count), np.zeros(count), 1.0
    for _ in range(_STEPS):
        less, wide = near(smaller), near(widths)
        pose = averaged(home + (1.0 - less)[:, None] * (given.pose - home), wide)
        made = given._replace(time=STEP * slowdown * np.arange(count), pose=pose)
        motion = motion_of(made)
        times = feasibility.checked_times(motion.end)
        margins = limit_margins(robot, limits, *motion.evaluate(times), STANDARD_GRAVITY)
        # Out of reach of a rod, all other margins are NaN.
        kept = {name: (values >= RESERVE * (bounds[name] or 1.0)).all(axis=1) for name, values in margins.items()}
        outside = ~np.all([good for name, good in kept.items() if name not in MOTION_LIMITS], axis=0)
        fast = ~np.all([kept[name] for name in MOTION_LIMITS], axis=0) & ~outside
        if not (outside | fast).any():
            break
        at = np.minimum(np.rint(motion.rows_time(times)[0] / (STEP * slowdown)).astype(int), count - 1)
        smaller[np.unique(at[outside])] += SMALLER
        np.minimum(smaller, 1.0, out=smaller)
        slowdown *= 1.0 + SLOWER * float((widths[at[fast]] >= SMOOTHEST).any() and not outside.any())
        widths[np.unique(at[fast])] += SMOOTHER
        np.minimum(widths, SMOOTHEST, out=widths)
    else:
        raise ConfigurationError("move", move.description, f"a move that can be done after {_STEPS} small changes")
    played, recorded = motion.rows(slowdown * time), signal.recorded(until)
    turns = np.swapaxes(kinematics.rotation_matrix(recorded[:, :3]), 1, 2) @ kinematics.rotation_matrix(played[:, :3])
    apart = 1e3 * np.linalg.norm((played - recorded)[:, 3:], axis=1), np.degrees(kinematics.rotation_angle(turns))
    changes = {"least size %": 100.0 * (1.0 - less.max()), "averaged ms": 1e3 * wide.max()}
    changes["longer %"] = 100.0 * (slowdown - 1.0)
    for unit, each in zip(("mm", "deg"), apart, strict=True):
        changes |= {f"change {unit}": each.max(), f"its RMS {unit}": np.sqrt(np.mean(each**2))}
    return made, changes


def shaped_move(scenario: Scenario, move: Move) -> tuple[Move, np.ndarray]:
    """Poses whose crank angles are the commands of a scenario's controller to position servos.

    A player that only solves inverse kinematics then sends these commands. Six commanded angles may have no pose. Then
    the commands are scaled towards the angles of the move by the largest share that has one.

    Returns:
        The move; the shares (n,) [-], 1 where nothing was scaled.
    """
    if scenario.controller_model.robot.tool is not None:
        sections = "robot", *(["model.robot"] if scenario.model.robot is not None else [])
        # The reference of the scenario would still be one of the tool.
        still = {"reference": {"kind": "hold"}, "initial_offset": [0.0] * 6}
        scenario = scenario.replace({**still, **{f"{section}.tool": None for section in sections}})
    motion = motion_of(move)
    end, ahead = motion.end, scenario.preview

    def row(now: float) -> np.ndarray:
        return np.ravel(motion.evaluate(now))

    controller = Controller(scenario, {"reference": row, "reference_ahead": lambda now: row(now + ahead)})
    if controller.unit != "rad" or scenario.controller.feedback:
        raise ConfigurationError("--shaped", scenario.name, "a `feedforward` controller of motors that take angles")
    times = controller.period * np.arange(math.ceil(end / controller.period - 1e-9) + 1)
    sent, nothing = np.empty((len(times), 6)), np.zeros(controller.reading)
    for time, out in zip(times.tolist(), sent, strict=True):
        try:
            controller.step(nothing, time, out)
        except RunFailure as error:
            got = f"at {min(time + ahead, end):.2f} s: {error}"
            allowed = "poses that the head can take; try: stewart-drake moves fix"
            raise ConfigurationError("move", got, allowed) from None
    robot, made = (
        scenario.controller_model.robot,
        move.at(move.time[0] + motion.rows_time(times)[0])._replace(time=times),
    )
    pose, shares = motion.evaluate(times)[0], np.zeros(len(times))
    plain = kinematics.inverse_kinematics(robot, pose)
    for share in np.linspace(1.0, 0.0, _SHARES, endpoint=False):
        left = np.flatnonzero(shares == 0.0)
        asked = np.clip(plain + share * (sent - plain), *robot.crank_angle_ranges.T)[left]
        found, errors, _ = kinematics.newton(robot, asked, pose[left], kinematics.CLOSED, kinematics.NEWTON_STEPS)
        closed = (errors <= kinematics.CLOSED) & (kinematics.reach_margin(robot, found) > 0.0).all(axis=1)
        # Only poses on the same branch of the inverse kinematics.
        same = np.abs(kinematics.inverse_kinematics(robot, found[closed]) - asked[closed]).max(axis=1) < 1e-6
        there = np.flatnonzero(closed)[same]
        pose[left[there]], shares[left[there]] = found[there], share
    return made._replace(pose=pose), shares
