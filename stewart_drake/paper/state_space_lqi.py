"""(26) to (34) for the section on the state space: gains as printed and as meant, and how the error decays."""

from __future__ import annotations

from typing import Any

import numpy as np

from stewart_drake.control.riccati import split_gain
from stewart_drake.control.state_space import AXES, STATES, Discretization, acceleration_map
from stewart_drake.paper.experiments import RATIOS
from stewart_drake.paper.lqi_poles import (
    channel_decay,
    closed_loop,
    decay_limit,
    faster_weights,
    gain_of_ratio,
    gain_without_discretisation,
    product_shape,
    riccati_residual,
    slowest_decay,
)
from stewart_drake.paper.study import SEED, Study
from stewart_drake.planning.pose_box import NEAR, sample_poses

ZERO_GAIN = 1e-10
"""Entries of a gain below this are rounding."""
PERIODS = (1e-4, 1e-3, 5e-3, 2e-2, 0.1)
"""[s] control periods of the table; the paper gives none."""
METHODS: tuple[Discretization, ...] = ("exact", "euler")
FASTER = 10.0
"""By how much the better weights of the decay's table speed up its limit."""


def riccati(at_home: np.ndarray, period: float) -> tuple[dict[str, Any], dict[str, tuple[int, int] | None]]:
    """What (30) to (34) come to as printed; and the sizes of the terms of (32)."""
    c, q, a, b, r = (AXES, STATES), (STATES, STATES), (STATES, STATES), (STATES, AXES), (AXES, AXES)
    terms = {
        "P": q,
        "C^T Q C": product_shape(c[::-1], q, c),
        "A^T P A": product_shape(a, q, a),
        "A^T P B (R + B^T P B)^-1": product_shape(a, q, b, r),
        "A^T P B (R + B^T P B)^-1 B^T P A, not printed": product_shape(a, q, b, r, b[::-1], q, a),
        "Q of (27), not printed": q,
    }
    gain = gain_of_ratio(at_home, period, 1.0)
    grows, calm = (float(np.abs(closed_loop(at_home, sign * gain, period)).max()) for sign in (-1.0, 1.0))
    numbers = {
        "sizes_fit": len({shape for name, shape in terms.items() if "not printed" not in name}) == 1,
        "undiscretised_gain": float(max(np.abs(gain_without_discretisation(at_home, r)).max() for r in RATIOS)),
        "residual": max(riccati_residual(at_home, period, ratio, 1.0) for ratio in RATIOS),
        "radius_30": grows,
        "radius_34": calm,
        "doubling": float(period * np.log(2.0) / np.log(grows)) if grows > 1.0 else None,
    }
    return numbers, terms


def discretisations(at_home: np.ndarray) -> list[dict[str, float]]:
    """The two discretisations at home, for several periods and ratios."""
    some = (0.01, 1.0, 100.0)
    return [{"period": p, "ratio": r, **compare_discretisations(at_home, p, r)} for p in PERIODS for r in some]


def compare_discretisations(at_pose: np.ndarray, period: float, ratio: float) -> dict[str, float]:
    """Euler's gain against the exact one, both on the exact sampled system.

    Returns:
        `gain` relative difference [-]; `exact`, `euler` slowest decay [rad/s]; `radius` spectral radius under Euler's.
    """
    exact, euler = (gain_of_ratio(at_pose, period, ratio, method) for method in METHODS)
    poles = [closed_loop(at_pose, gain, period) for gain in (exact, euler)]
    return {
        "gain": float(np.linalg.norm(euler - exact) / np.linalg.norm(exact)),
        "exact": slowest_decay(poles[0], period),
        "euler": slowest_decay(poles[1], period),
        "radius": float(np.abs(poles[1]).max()),
    }


def decay(study: Study, at_home: np.ndarray) -> tuple[dict[str, Any], int]:
    """The limit that equal weights put on the decay of the error; numbers, and at how many poses."""
    robot, period = study.base.robot, study.base.lqi.period
    maps = acceleration_map(
        robot, sample_poses(robot, NEAR, study.pick(100, 15), np.random.default_rng(SEED), 1e-2).poses
    )
    faster = faster_weights(FASTER)

    def rate(b: np.ndarray, gain: np.ndarray) -> float:
        return slowest_decay(closed_loop(b, gain, period), period)

    rows = []
    for ratio in RATIOS:
        rates = [rate(b, gain_of_ratio(b, period, ratio)) for b in maps]
        tuned = (ratio * faster[0], ratio * faster[1], ratio * faster[2], 1.0)
        quick = min(rate(b, split_gain(b, period, tuned)) for b in maps)
        home = rate(at_home, gain_of_ratio(at_home, period, ratio))
        rows.append({"ratio": ratio, "home": home, "least": min(rates), "most": max(rates), "faster": quick})
    squares = np.linalg.svd(at_home, compute_uv=False) ** 2
    numbers = {
        "limit": decay_limit(),
        "faster_limit": decay_limit(faster),
        "peak": float(channel_decay(np.logspace(-2, 8, 201)).max()),
        "strongest": float(channel_decay(RATIOS[0] * squares)[0]),
        "rows": rows,
    }
    return numbers, len(maps)
