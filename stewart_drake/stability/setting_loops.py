"""Linear loops of many settings at the same poses, and as one loop whose setting changes.

A setting acts on the controller by its weights and on the observer by its disturbance, see `control.settings`. So the
parts are linearised once for each weight and each disturbance, and only joined for each pair.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from stewart_drake.control.settings import disturbance_of, weights_of
from stewart_drake.errors import ConfigurationError
from stewart_drake.scenario import Scenario
from stewart_drake.stability.linear_loop import STILL, LinearLoops, Site, grounds, trimmed
from stewart_drake.stability.loop_parts import ESTIMATORS, controller_part, part_of


def setting_loops(scenario: Scenario, poses: np.ndarray, settings: np.ndarray) -> Iterator[LinearLoops]:
    """The loops of all settings at one pose after the other.

    The state is the same for all settings, and goes on when the setting changes: where `controller.bumpless` is set,
    the integral counts as the torque that it gives.

    Args:
        scenario: With an observer, the LQI and block weights, which are the base; delay, robot.
        poses: (m, 6) [rad, m].
        settings: (s, 4), see `control.settings`; the fewer different weights and disturbances, the faster.

    Yields:
        Loops of s settings at a pose each.

    Raises:
        ConfigurationError: Another kind of estimator, controller or weights.
        RunFailure: A loop does not stand still at a pose.
    """
    base, estimator = np.array(scenario.tuner.weights), part_of(ESTIMATORS, "estimator", "observer")
    if scenario.estimator.kind != "observer":
        raise ConfigurationError("estimator.kind", scenario.estimator.kind, "observer, for settings")
    if len(base) != 4:
        raise ConfigurationError("tuner.kind", scenario.tuner.kind, "one of block weights, for settings")
    options: Any = scenario.estimator
    weights, of_weights = np.unique(weights_of(base, settings), axis=0, return_inverse=True)
    levels, of_levels = np.unique(disturbance_of(options.disturbance, settings), return_inverse=True)
    names = ("q_pose", "q_rate", "q_integral", "r")
    tuned = [
        scenario.replace({"tuner": {"kind": "block", **dict(zip(names, each.tolist(), strict=True))}})
        for each in weights
    ]
    controllers = [controller_part(each) for each in tuned]
    observed = [scenario.replace({"estimator.disturbance": float(each)}) for each in levels]
    pairs = list(zip(of_weights.ravel().tolist(), of_levels.ravel().tolist(), strict=True))
    for ground in grounds(scenario, poses):
        estimators = [estimator(each, ground.pose, ground.reading) for each in observed]

        def site(pair: tuple[int, int], ground: Any = ground, estimators: Any = estimators) -> Site:
            return Site(ground, estimators[pair[1]], controllers[pair[0]], scenario.command_delay)

        x = site(pairs[0]).still()
        told = [site((0, k)).estimated(x) for k in range(len(levels))]
        answers = [site((k, 0)).controlled(x, told[0]) for k in range(len(weights))]
        found = []
        for pair in pairs:
            matrices, change = site(pair).joined(x, told[pair[1]], answers[pair[0]])
            # Where the model is not the robot, each setting has a standstill of its own.
            found.append(matrices if np.abs(change).max() < STILL else site(pair).loop())
        a, b, c = (np.stack(each) for each in zip(*found, strict=True))
        if scenario.lqi.bumpless:
            places = site(pairs[0]).places()
            gains = np.stack([answers[pair[0]].by[:6, 12:] for pair in pairs])
            a, b, c = _by_torque(a, b, c, places[2], gains)
        at = np.broadcast_to(ground.pose, (len(a), 6))
        yield trimmed(LinearLoops(a, b, c, scenario.controller.period, at, ()))


def _by_torque(
    a: np.ndarray, b: np.ndarray, c: np.ndarray, integral: slice, gains: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A, B, C with the integral (6,) as the torque that gains (s, 6, 6) make of it."""
    into = np.broadcast_to(np.eye(a.shape[-1]), a.shape).copy()
    back = into.copy()
    into[:, integral, integral], back[:, integral, integral] = gains, np.linalg.inv(gains)
    return into @ a @ back, into @ b, c @ back
