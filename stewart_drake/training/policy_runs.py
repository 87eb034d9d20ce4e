"""A policy in a situation on the fast engine: what the run costs, and which features the policy gets.

Weights reach a run in memory. Nothing else of training builds a policy or runs one.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from stewart_drake.control.features import FEATURES, CostScales, features
from stewart_drake.control.policy import SIZE, Chooser, Layers, Policy, policy_tick
from stewart_drake.control.tuners import PolicyTuner
from stewart_drake.jit import njit, record
from stewart_drake.scenario import Scenario
from stewart_drake.studies.runs import simulate_unchecked
from stewart_drake.training.benchmark import Case, log_cost, measure_parts
from stewart_drake.training.situations import situation

HIDDEN = 16
"""Hidden units."""
WEIGHTS = HIDDEN * len(FEATURES) + HIDDEN + SIZE * HIDDEN + SIZE
"""Numbers of a network, flat: hidden layer and its biases, output layer and its biases."""
LOWEST, HIGHEST = np.array([-0.05, -0.6, -1.2, -1.9]), np.array([0.4, 0.1, 0.1, 0.5])
"""Box of settings that a policy can choose; docs/results/tuner_safety.md has tried it."""
FAR = 1e5
"""Ends of the features' range while nothing is known of it."""
_SKIPPED, _SAMPLED = 30, 10
"""[ticks] before the first features that are kept, and between them."""


class Episode(NamedTuple):
    """A run of a policy, but for its weights: a case, and the smoothness kappa."""

    case: Case
    kappa: float = 0.0


class Frame(NamedTuple):
    """All of a policy but its weights: the centre of its box (4,), and statistics and range (13,) of its features."""

    centre: np.ndarray
    mean: np.ndarray = np.zeros(len(FEATURES))
    scale: np.ndarray = np.ones(len(FEATURES))
    low: np.ndarray = np.full(len(FEATURES), -FAR)
    high: np.ndarray = np.full(len(FEATURES), FAR)

    def policy(self, weights: np.ndarray) -> Policy:
        """The policy with weights (`WEIGHTS`,); with zeros it stays at the centre."""
        ends = np.cumsum([HIDDEN * len(FEATURES), HIDDEN, SIZE * HIDDEN])
        hidden, hidden_bias, output, output_bias = np.split(weights, ends)
        layers = Layers(
            mean=self.mean,
            scale=self.scale,
            hidden=hidden.reshape(HIDDEN, -1),
            hidden_bias=hidden_bias,
            output=output.reshape(SIZE, -1),
            output_bias=output_bias,
            centre=self.centre,
            below=self.centre - LOWEST,
            above=HIGHEST - self.centre,
            low=self.low,
            high=self.high,
        )
        return Policy(layers)


def episode_cost(policy: Policy, episode: Episode) -> float:
    """Logarithm of what a run of a policy costs, at the kappa of the episode."""
    return _run(policy, episode)


def episode_features(policy: Policy, episode: Episode) -> np.ndarray:
    """Features (n, 13) that a policy gets in a run, some of them."""
    recorder = _Recorder(policy)
    _run(recorder, episode)
    return np.array(recorder.rows[_SKIPPED::_SAMPLED]).reshape(-1, len(FEATURES))


def _run(chooser: Chooser, episode: Episode) -> float:
    scenario = _fast(episode.case)
    q_pose, q_rate, q_integral, r = scenario.tuner.weights
    tuner = _GivenTuner(q_pose=q_pose, q_rate=q_rate, q_integral=q_integral, r=r, kappa=episode.kappa)
    vars(tuner)["given"] = chooser
    log = simulate_unchecked(scenario.replace({"tuner": tuner}))
    return log_cost({"status": log.status, **measure_parts(log)}, CostScales().at(episode.kappa))


@lru_cache(maxsize=4096)
def _fast(case: Case) -> Scenario:
    """The situation on the fast engine, with at most two steps of the plant in a tick."""
    scenario = situation(*case)
    step = max(scenario.plant.time_step, scenario.controller.period / 2)
    return scenario.replace({"plant.engine": "reduced", "plant.time_step": step, "log_period": None})


class _GivenTuner(PolicyTuner):
    """A policy that stands in memory."""

    def chooser(self) -> Chooser:  # type: ignore[override]
        """What it was given."""
        given: Chooser = vars(self)["given"]
        return given


class _Recorder:
    """A policy that writes down its features; see `Chooser`."""

    def __init__(self, policy: Policy) -> None:
        self.centre, self.lowest, self.width = policy.centre, policy.lowest, policy.width
        self.numbers, self.law = policy.numbers, self._tick
        self.rows: list[np.ndarray] = []

    def _tick(self, setups: np.ndarray, own: np.ndarray, *inputs: np.ndarray) -> None:
        density, error, torque, innovation, reference, state = inputs
        found = np.empty(len(FEATURES))
        _features(setups, density, error, torque, innovation, reference, state.copy(), found)
        self.rows.append(found)
        policy_tick(setups, own, *inputs)


@njit
def _features(
    setups: Any, density: Any, error: Any, torque: Any, innovation: Any, reference: Any, states: Any, out: Any
) -> None:
    """`features` of arrays."""
    features(record(setups), density, error, torque, innovation, reference, record(states), out)
