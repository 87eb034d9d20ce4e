"""A sensor that repeats itself while things move; pure."""

from __future__ import annotations

import numpy as np

from stewart_drake.safety.safety_options import SafetyOptions

FROZEN_SIZE = 42
"""Readings of the tick before, and for each of the six what it is compared with as it was when the reading changed."""


def frozen_tick(
    options: SafetyOptions,
    quantum: float,
    angles: np.ndarray | None,
    pose: np.ndarray,
    reference: np.ndarray,
    memory: np.ndarray,
) -> tuple[int | None, np.ndarray]:
    """Looks for a sensor that repeats itself while things move.

    In a robot that stands still nobody can tell: six encoders measure six degrees of freedom, so they can never
    contradict each other.

    Args:
        options: Limits.
        quantum: [rad] of an encoder's count.
        angles: (6,) [rad] readings of encoders; None where there are none.
        pose: (6,) [rad, m] measured.
        reference: (6,) [rad, m].
        memory: (42,) of the tick before, NaN before the first; see `FROZEN_SIZE`.

    Returns:
        Leg whose encoder is frozen, -1 for the pose as a whole, None for nothing; and the memory (42,) of this tick.
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
    leg = int(travel.argmax())
    return (leg if travel[leg] > options.frozen_encoder + 50.0 * quantum else None), after
