"""A reading that stays the same while things move; pure."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from stewart_drake.mechanics import kinematics_core as core
from stewart_drake.mechanics.arrays import arrays_of
from stewart_drake.robot import RobotParameters
from stewart_drake.safety.safety_options import SafetyOptions

FROZEN_SIZE = 42
"""Readings of the tick before, and for each of the six what it is compared with as it was when the reading changed."""


def frozen_tick(
    robot: RobotParameters,
    options: SafetyOptions,
    quantum: float,
    angles: np.ndarray | None,
    pose: np.ndarray,
    reference: np.ndarray,
    memory: np.ndarray,
) -> tuple[int | None, np.ndarray]:
    """Looks for a reading that stays the same while things move.

    Its sensor is frozen, or friction holds the crank, or the platform, that it reads: six encoders measure six degrees
    of freedom, so they can never contradict each other and nobody can tell which. Nor can anybody tell while the robot
    stands still. A crank that friction holds where it turns back does not count: it stands about where it is wanted.

    Args:
        robot: As believed.
        options: Limits.
        quantum: [rad] of an encoder's count.
        angles: (6,) [rad] readings of encoders; None where there are none.
        pose: (6,) [rad, m] measured.
        reference: (6,) [rad, m].
        memory: (42,) of the tick before, NaN before the first; see `FROZEN_SIZE`.

    Returns:
        Leg whose reading is stuck, -1 for the pose as a whole, None for nothing; and the memory (42,) of this tick.
    """
    readings, compared = (pose, reference) if angles is None else (angles, angles)
    # NaN never equals itself; the monitor `finite` looks for it.
    same = readings == memory[:6]
    if angles is None:
        same[:] = same.all()
    anchors = np.where(same[:, None], memory[6:].reshape(6, 6), compared)
    after = np.concatenate([readings, anchors.ravel()])
    moved = np.abs(compared - anchors)
    if angles is None:
        bound = options.frozen_pose
        far = bound is not None and bool((moved[0] > np.repeat(bound, 3)).any())
        return (-1 if far else None), after
    if options.frozen_encoder is None:
        return None, after
    # Two others: one that jumps would make all that stand still look frozen.
    travel = np.sort(moved, axis=1)[:, -2]
    limit = _travel(options.frozen_encoder, quantum)
    suspect = travel > limit
    if suspect.any():
        suspect &= ~(_apart(robot, angles, reference) <= 0.25 * limit)
    return (int(np.where(suspect, travel, 0.0).argmax()) if suspect.any() else None), after


FrozenTick = Callable[[np.ndarray | None, np.ndarray, np.ndarray, np.ndarray], tuple[int | None, np.ndarray]]


def flat_frozen(robot: RobotParameters, options: SafetyOptions, quantum: float, compiled: bool) -> FrozenTick:
    """`frozen_tick` as a function of angles, pose, reference and memory alone, compiled or not."""
    if not compiled:
        return partial(frozen_tick, robot, options, quantum)
    # numba takes half a second to import, and compiles on first use.
    from stewart_drake.compiled.safety import moving

    none = np.full(6, np.inf)
    encoder, pose_limits = options.frozen_encoder, options.frozen_pose
    of_angles = none if encoder is None else np.full(6, _travel(encoder, quantum))
    of_poses = none if pose_limits is None else np.repeat(pose_limits, 3)

    def tick(
        angles: np.ndarray | None, pose: np.ndarray, reference: np.ndarray, memory: np.ndarray
    ) -> tuple[int | None, np.ndarray]:
        after = np.empty(FROZEN_SIZE)
        seen = (pose, reference, True, of_poses) if angles is None else (angles, angles, False, of_angles)
        if moving(*seen, memory, after):
            return None, after
        return frozen_tick(robot, options, quantum, angles, pose, reference, memory)

    return tick


def _travel(bound: float, quantum: float) -> float:
    """[rad] that two others may turn while a reading in counts of `quantum` [rad] stays the same."""
    return bound + 50.0 * quantum


def _apart(robot: RobotParameters, angles: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """(6,) [rad] between cranks and where a pose wants them; NaN where it is out of reach."""
    with np.errstate(invalid="ignore"):
        wanted = core.crank_angles(core.cranks_at(arrays_of(robot, reference), reference))
    return np.abs(np.remainder(angles - wanted + np.pi, 2.0 * np.pi) - np.pi)
