"""Training of the policy by an evolution strategy: whole runs on the fast engine, on all cores.

It minimises the mean of log J over situations; all kinds of situations have the same weight.
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import date
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from stewart_drake.base.atomic_files import MAX_FILE_BYTES, checksum, read_checked, seal, unseal, write_atomically
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.records import Record, Vec6, Vec12, Vec18, record
from stewart_drake.control.features import FEATURES, CostScales, TunerParams, TunerState, compute_features
from stewart_drake.control.policy import LARGEST_FEATURE, SIZE, Policy, SettingSource, policy_setting, slew
from stewart_drake.control.tuners import PolicyTuner
from stewart_drake.logs.versions import collect_versions
from stewart_drake.scenario.scenario import Scenario
from stewart_drake.studies.runs import simulate_unchecked
from stewart_drake.studies.workers import Workers, run_all
from stewart_drake.training.benchmark import (
    HIGHEST,
    LOWEST,
    Baselines,
    Candidate,
    cases_of,
    cells_for,
    cells_of,
    fixed_rows,
    log_cost,
    mean_over_cells,
    measure_parts,
)
from stewart_drake.training.situations import ROBOTS, TRAINING, VALIDATION, Case, situation

HIDDEN = 16
WEIGHTS = HIDDEN * len(FEATURES) + HIDDEN + SIZE * HIDDEN + SIZE
"""Size of the flat vector of a network: hidden layer and its biases, output layer and its biases."""
FAR = 1e5  # Limits of the features before their range is known
SPREAD = 0.1
LEARNING_RATE = 0.03  # Initial learning rate of Adam; it falls to a tenth along half a cosine.
FAIRNESS = 10.0
"""Extra weight of a kind in which the policy is worse than a fixed setting, per unit of log J."""
MORE = {"reachy_mini": 2}  # Times as many situations in a generation, for a robot with short runs
VALIDATED = 5  # [generations] between two validations
_SKIPPED, _SAMPLED = 30, 10  # [ticks] before the first sample of features, and between samples


def policy_of(
    weights: np.ndarray,
    centre: np.ndarray,
    mean: ArrayLike = 0.0,
    scale: ArrayLike = 1.0,
    ends: np.ndarray | tuple[float, float] = (-FAR, FAR),
) -> Policy:
    """A policy from flat weights (`WEIGHTS`,); zeros give the centre (4,). Mean, scale (13,), range (2, 13)."""
    parts = np.split(weights, np.cumsum([HIDDEN * len(FEATURES), HIDDEN, SIZE * HIDDEN]))
    mean, scale, low, high = (np.broadcast_to(values, len(FEATURES)) for values in (mean, scale, *ends))
    return Policy(
        input_mean=mean,
        input_scale=scale,
        hidden_weights=parts[0].reshape(HIDDEN, -1),
        hidden_bias=parts[1],
        output_weights=parts[2].reshape(SIZE, -1),
        output_bias=parts[3],
        centre=centre,
        below=centre - LOWEST,
        above=HIGHEST - centre,
        low=low,
        high=high,
    )


def episode_cost(source: SettingSource, case: Case) -> float:
    """Log of the cost of a run of a policy on the fast engine, at the kappa of the case."""
    log = simulate_unchecked(tuned_by(source, fast_scenario(case), case.kappa))
    return log_cost({"status": log.status, **measure_parts(log)}, CostScales().at(case.kappa))


def fixed_cost(candidate: Candidate, case: Case) -> float:
    """Log of the cost of a run with a fixed setting."""
    scenario = fast_scenario(case)
    log = simulate_unchecked(scenario.replace(candidate(case, scenario)))
    return log_cost({"status": log.status, **measure_parts(log)}, CostScales().at(case.kappa))


def episode_features(policy: Policy, case: Case) -> np.ndarray:
    """Features (n, 13) of a run of a policy."""
    rows, params = [], record(policy.params())

    def choose(features: np.ndarray, setting: np.ndarray) -> float:
        rows.append(features)
        return policy_setting(params, features, setting)

    episode_cost(FunctionSource(policy, choose), case)
    return np.array(rows[_SKIPPED::_SAMPLED]).reshape(-1, len(FEATURES))


@lru_cache(maxsize=4096)
def fast_scenario(case: Case) -> Scenario:
    """The situation on the fast engine, with at most two steps of the plant in a tick."""
    scenario = situation(*case[:3])
    step = max(scenario.plant.time_step, scenario.controller.period / 2)
    return scenario.replace({"plant.kind": "closed_form", "plant.time_step": step, "log_period": None})


def tuned_by(source: SettingSource, scenario: Scenario, kappa: float = 0.0) -> Scenario:
    """A scenario with block weights and a source of settings."""
    q_pose, q_rate, q_integral, r = scenario.tuner.weights
    tuner = PolicyTuner(q_pose=q_pose, q_rate=q_rate, q_integral=q_integral, r=r, kappa=kappa)
    tuner._source = source
    return scenario.replace({"tuner": tuner})


class FunctionSource:
    """Settings in the box of a policy by `choose(features, setting)`, which fills the setting; gives a confidence."""

    def __init__(self, policy: Policy, choose: Callable[[np.ndarray, np.ndarray], float]) -> None:
        self.centre, self.width, self.params, self._choose = policy.centre, policy.width, policy.params, choose

    def kernel(
        self,
        params: TunerParams,
        _: Record,
        density: Vec12,
        error: Vec6,
        torque: Vec6,
        innovation: Vec6,
        reference: Vec18,
        state: TunerState,
    ) -> None:
        features, setting, confidence = np.empty(len(FEATURES)), self.centre.copy(), 0.0
        if compute_features(params, density, error, torque, innovation, reference, state, features):
            confidence = self._choose(features, setting)
        slew(params, setting, confidence, state)


@dataclass(frozen=True)
class PolicyOptions:
    """Options: a generation has `situations` per kind and robot, times `MORE`, out of a `pool`.

    `start` is the file of an initial policy; without one it is random, at the centre.
    """

    seed: int = 0
    generations: int = 150
    situations: int = 6
    pool: int = 24
    validation: int = 6
    robots: tuple[str, ...] = tuple(ROBOTS)
    start: str | None = None


@dataclass
class State:
    """State of a training."""

    fixed: np.ndarray  # (m, n) log J of the fixed settings in the pool, the centre first.
    validated: np.ndarray  # (m, n) log J of the fixed settings in validation.
    mean: np.ndarray  # (13,) of the features.
    scale: np.ndarray  # (13,) of the features.
    weights: np.ndarray
    moments: np.ndarray  # (2, n) of Adam.
    best: np.ndarray  # Weights with the least objective in validation.
    least: float = 1e9  # Value of that objective.
    generation: int = 0
    seconds: float = 0.0
    history: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    """Generation, mean of log J relative to the centre, and objective of the validations."""

    def save(self, file: Path, identity: str) -> None:
        values = {name: np.asarray(value).tolist() for name, value in vars(self).items()}
        write_atomically(file, json.dumps(seal({"identity": identity, **values})).encode())

    @classmethod
    def load(cls, file: Path, identity: str) -> State:
        content = read_checked(file, f"state {file}", MAX_FILE_BYTES)
        values = unseal(content, f"state {file}", "`stewart-drake train`; remove it to start anew")
        if values.pop("identity", None) != identity:
            allowed = "the state of a training with the same options; remove the file to start anew"
            raise ConfigurationError(f"state {file}", "of other options", allowed)
        values |= {name: np.array(value) for name, value in values.items() if isinstance(value, list)}
        return cls(**values | {"history": values["history"].reshape(-1, 3)})


class Training:
    def __init__(self, options: PolicyOptions, workers: Workers) -> None:
        self.options, self._workers = options, workers
        baselines = Baselines.load()
        self.centre, self._rows = np.array(baselines.best), list(fixed_rows(baselines).values())
        cells = [cell for robot in options.robots for cell in cells_for(robot, trained=True)]
        pool = cases_of(cells, TRAINING[: options.pool])
        rng = np.random.default_rng(options.seed)
        # Half of the pool has a random smoothness (kappa).
        kappas = np.where(rng.random(len(pool)) < 0.5, rng.uniform(-1.0, 1.0, len(pool)), 0.0)
        self.pool = [case._replace(kappa=float(kappa)) for case, kappa in zip(pool, kappas, strict=True)]
        self.validation = cases_of(cells, VALIDATION[: options.validation])
        self._start = Policy.load(Path(options.start)) if options.start else None
        subject = {"options": dataclasses.asdict(options), "baselines": baselines.to_dict()}
        self.identity = checksum({**subject, "start": self._start and self._start.content()})

    def begin(self) -> State:
        """Costs of the fixed settings, and statistics of the features at and around the centre."""
        rng = np.random.default_rng([self.options.seed, 1])
        weights = np.zeros(WEIGHTS)
        at_centre = policy_of(weights, self.centre)
        fixed, validated = (self._fixed(cases) for cases in (self.pool, self.validation))
        runs = []
        for places in cells_of(self.pool).values():
            for place in places[:4]:
                weights[-SIZE:] = rng.uniform(-1.5, 1.5, SIZE)
                runs += [(at_centre, self.pool[place]), (policy_of(weights, self.centre), self.pool[place])]
        found = np.concatenate(run_all(episode_features, runs, self._workers))
        if (start := self._start) is not None:
            weights = self._like(start, found)
            return State(
                fixed, validated, start.input_mean, start.input_scale, weights, np.zeros((2, WEIGHTS)), best=weights
            )
        hidden = rng.standard_normal(HIDDEN * len(FEATURES)) / math.sqrt(len(FEATURES))
        weights = np.concatenate([hidden, np.zeros(WEIGHTS - len(hidden))])
        scale = np.maximum(found.std(axis=0), 1e-3)
        return State(fixed, validated, found.mean(axis=0), scale, weights, np.zeros((2, WEIGHTS)), best=weights)

    def _like(self, start: Policy, features: np.ndarray) -> np.ndarray:
        """Weights that approximate the settings of another policy, in this box, at features (n, 13)."""
        inside = (np.clip(features, -LARGEST_FEATURE, LARGEST_FEATURE) - start.input_mean) / start.input_scale
        hidden = np.tanh(inside @ start.hidden_weights.T + start.hidden_bias)
        output = np.tanh(hidden @ start.output_weights.T + start.output_bias)
        away = start.centre + output * np.where(output < 0.0, start.below, start.above) - self.centre
        share = away / np.where(away < 0.0, self.centre - LOWEST, HIGHEST - self.centre)
        rows = np.column_stack([hidden, np.ones(len(hidden))])
        layer = np.linalg.lstsq(rows, np.arctanh(np.clip(share, -0.95, 0.95)))[0].T
        return np.concatenate([start.hidden_weights.ravel(), start.hidden_bias, layer[:, :-1].ravel(), layer[:, -1]])

    def step(self, state: State) -> State:
        """One generation: every situation twice, with weights on opposite sides of the present ones."""
        began, at = time.perf_counter(), dataclasses.replace(state)
        chosen = self._batch(at.generation)
        rng = np.random.default_rng([self.options.seed, 2, at.generation])
        directions = rng.standard_normal((len(chosen), WEIGHTS))
        policies = [self.policy(at, at.weights + side * SPREAD * way) for side in (1.0, -1.0) for way in directions]
        plus, minus = self.costs(policies, [self.pool[place] for place in chosen] * 2).reshape(2, -1)
        share = self._shares(chosen, 0.5 * (plus + minus) - at.fixed[:, chosen])
        _adam(at, (share * (plus - minus) / (2.0 * SPREAD)) @ directions, self.options.generations)
        at.generation += 1
        if at.generation % VALIDATED == 0 or at.generation == self.options.generations:
            ratio = self.validate(at, self.policy(at, at.weights))
            value = _objective(ratio, self.validation)
            at.history = np.vstack([at.history, [at.generation, mean_over_cells(ratio[0], self.validation), value]])
            if value < at.least:
                at.best, at.least = at.weights, value
        at.seconds += time.perf_counter() - began
        return at

    def finish(self, state: State) -> Policy:
        """The best policy, with the range of its features on the pool, and its provenance."""
        policy = self.policy(state, state.best)
        runs = [(policy, case) for case in self.pool]
        found = np.concatenate(run_all(episode_features, runs, self._workers))
        ends = np.stack([found.min(axis=0), found.max(axis=0)])
        # Kappa was drawn from its whole range.
        ends[:, FEATURES.index("kappa")] = -1.0, 1.0
        policy = policy_of(state.best, self.centre, state.mean, state.scale, ends)
        return dataclasses.replace(policy, provenance=self._card(state, self.validate(state, policy)))

    def policy(self, state: State, weights: np.ndarray) -> Policy:
        return policy_of(weights, self.centre, state.mean, state.scale)

    def validate(self, state: State, policy: Policy) -> np.ndarray:
        return self.costs([policy] * len(self.validation), self.validation) - state.validated

    def _fixed(self, cases: Sequence[Case]) -> np.ndarray:
        runs = [(row, case) for row in self._rows for case in cases]
        return np.reshape(run_all(fixed_cost, runs, self._workers), (len(self._rows), -1))

    def costs(self, policies: Sequence[Policy], cases: Sequence[Case]) -> np.ndarray:
        return np.array(run_all(episode_cost, list(zip(policies, cases, strict=True)), self._workers))

    def _batch(self, generation: int) -> np.ndarray:
        chosen = []
        for (_, robot), places in cells_of(self.pool).items():
            count = min(self.options.situations * MORE.get(robot, 1), len(places))
            chosen.append(places[(generation * count + np.arange(count)) % len(places)])
        return np.concatenate(chosen)

    def _shares(self, chosen: np.ndarray, ratio: np.ndarray) -> np.ndarray:
        """Weights of the cases: equal by kind, larger where the policy is worse than a fixed setting.

        `ratio` (m, n): log J relative to the fixed settings. They give the gradient of `_objective`.
        """
        share = np.zeros(len(chosen))
        cells = cells_of([self.pool[place] for place in chosen])
        for places in cells.values():
            share[places] = (1.0 + FAIRNESS * _behind(ratio[:, places])) / (len(places) * len(cells))
        return share

    def _card(self, state: State, ratio: np.ndarray) -> dict[str, object]:
        """Provenance of a policy, with the result of `validate`."""
        cells = {f"{robot}: {kind}": places for (kind, robot), places in cells_of(self.validation).items()}
        kinds = {name: ratio[0, places].mean() for name, places in cells.items()}
        behind = {name: ratio[:, places].mean(axis=1).max() for name, places in cells.items()}
        return {
            "made_by": "stewart-drake train --tuner policy",
            "date": date.today().isoformat(),
            "method": "evolution on the fast engine",
            "data": f"situations of training/situations.py, seeds from {TRAINING[0]} on; chosen by those from "
            f"{VALIDATION[0]} on",
            "cost": "J of control/features.py at kappa 0; other kappa in half of the situations",
            "options": {**dataclasses.asdict(self.options), "robots": list(self.options.robots)},
            "J_over_best_fixed_by_generation": [[int(at), round(math.exp(value), 3)] for at, value, _ in state.history],
            "J_over_best_fixed": round(math.exp(mean_over_cells(ratio[0], self.validation)), 3),
            "J_over_best_fixed_by_kind": {name: round(math.exp(value), 3) for name, value in kinds.items()},
            "J_over_best_row_by_kind": {name: round(math.exp(value), 3) for name, value in behind.items()},
            "seconds": round(state.seconds),
            "limits": "robots, sensors and motions of training/situations.py; see docs/results/tuner.md",
            "versions": {name: version for name, version in collect_versions().items() if version is not None},
        }


def _behind(ratio: np.ndarray) -> float:
    """Excess of a kind over the best fixed setting, from log J relative to the settings (m, n); 0 if below."""
    return max(0.0, float(ratio.mean(axis=1).max()))


def _objective(ratio: np.ndarray, cases: Sequence[Case]) -> float:
    """Mean over the kinds of log J relative to the centre, plus a penalty on the square of `_behind`."""
    behind = [_behind(ratio[:, places]) for places in cells_of(cases).values()]
    return float(mean_over_cells(ratio[0], cases) + 0.5 * FAIRNESS * np.mean(np.square(behind)))


def _adam(at: State, gradient: np.ndarray, generations: int) -> None:
    gradient = gradient / max(1.0, float(np.linalg.norm(gradient)))
    first, second = 0.9 * at.moments[0] + 0.1 * gradient, 0.99 * at.moments[1] + 0.01 * gradient**2
    at.moments = np.stack([first, second])
    steps = at.generation + 1
    mean, square = first / (1.0 - 0.9**steps), second / (1.0 - 0.99**steps)
    along = 0.5 * (1.0 + math.cos(math.pi * at.generation / generations))
    at.weights = at.weights - LEARNING_RATE * (0.1 + 0.9 * along) * mean / (np.sqrt(square) + 1e-8)


def train_policy(
    options: PolicyOptions,
    file: Path | None = None,
    tell: Callable[[float, str], None] = lambda *_: None,
    workers: Workers | None = None,
) -> Policy:
    """Trains; the same options give the same policy for any number of processes and after any interruption.

    `file` is written after every generation, and read to continue; removed at the end.
    """
    # No replacement of workers: without Drake a process stays small, and it caches its situations.
    training = Training(options, workers or Workers(os.cpu_count(), runs_per_process=None))
    if file is not None and file.exists():
        state = State.load(file, training.identity)
    else:
        tell(0.0, "costs of the best fixed setting")
        state = training.begin()
    while state.generation < options.generations:
        state = training.step(state)
        if file is not None:
            state.save(file, training.identity)
        last = f"generation {state.generation}"
        if len(state.history):
            _, value, objective = state.history[-1]
            last += f", J {math.exp(value):.3f} of best fixed, objective {objective:.3f}"
        tell(float(state.generation), last)
    policy = training.finish(state)
    if file is not None:
        file.unlink(missing_ok=True)
    return policy
