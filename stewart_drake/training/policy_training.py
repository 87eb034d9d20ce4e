"""Training of the policy in the loop: truncated backpropagation, or an evolution strategy, to the least cost.

What is made small is the mean of log J over situations, each kind of them counting alike: a hundredth saved where a
robot stands still counts like one saved under a push.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Sequence
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from stewart_drake.control.features import FEATURES
from stewart_drake.control.policy import Layers, Policy
from stewart_drake.control.settings import SIZE
from stewart_drake.files.whole import checksum
from stewart_drake.logs.versions import collect_versions
from stewart_drake.training.baselines import Baselines
from stewart_drake.training.policy_loops import Situations
from stewart_drake.training.policy_options import Box, PolicyOptions
from stewart_drake.training.policy_progress import Progress, keep, kept
from stewart_drake.training.situations import ROBOTS, TRAINING, kinds_of, situation

_SAMPLED = 10
"""[ticks] between features that are kept for their statistics."""
_WEIGHTS = ("hidden", "hidden_bias", "output", "output_bias")


class Training:
    """Situations and options, and the steps of `train_policy`.

    Args:
        options: See there.
        box: See there; None for that about the best fixed setting.
        robots: Names of those to train on.
        seeds: Of the situations.
        runs: What the situations of a robot run in.
    """

    def __init__(
        self,
        options: PolicyOptions,
        box: Box | None = None,
        robots: Sequence[str] = tuple(ROBOTS),
        seeds: Sequence[int] = TRAINING,
        runs: type[Situations] = Situations,
    ) -> None:
        self.options, self.box = options, box or Box(np.array(Baselines.load().best))
        torch.set_num_threads(1)
        rng = np.random.default_rng(options.seed)
        self._both = 2 if options.method == "evolution" else 1
        self._groups, self.names, tastes, self._robots, self._seeds = [], [], [], list(robots), seeds[0]
        for robot in robots:
            kinds = kinds_of(robot, trained=True)
            drawn = [(kind, situation(kind, robot, seeds[k])) for k in range(options.situations) for kind in kinds]
            self.names += [(robot, kind) for kind, _ in drawn]
            own = rng.random(len(drawn)) < options.tastes
            kappa = np.where(own, rng.uniform(-1.0, 1.0, len(drawn)), 0.0)
            tastes.append(kappa)
            scenarios = [_coarser(scenario) for _, scenario in drawn]
            self._groups.append(runs(scenarios * self._both, [*kappa] * self._both, options.width))
        self.kappa = np.concatenate(tastes)
        self._robot_of = np.repeat(np.arange(len(tastes)), [len(each) for each in tastes])
        counts = {name: self.names.count(name) for name in self.names}
        self.share = np.array([1.0 / (counts[name] * len(counts)) for name in self.names])

    @property
    def identity(self) -> str:
        """Of what a checkpoint must be; the number of epochs is part of it, because the rate follows it."""
        box = [np.asarray(each).tolist() for each in self.box]
        return checksum({"options": self.options.to_dict(), "box": box, "robots": self._robots, "seeds": self._seeds})

    def begin(self, tell: Callable[[str], None], start: Policy | None = None) -> Progress:
        """Costs at the centre, and the statistics of the features there and at settings about it.

        Args:
            tell: See `train_policy`.
            start: A policy to go on from, whose statistics stay; None for weights of zero.
        """
        options, rng = self.options, np.random.default_rng([self.options.seed, 1])
        units = options.hidden
        weights = np.concatenate(
            [
                (rng.standard_normal((units, len(FEATURES))) / math.sqrt(len(FEATURES))).ravel(),
                np.zeros(units + SIZE * units + SIZE),
            ]
        )
        none = np.zeros(len(FEATURES))
        moments, far = np.zeros((2, len(weights))), none + 1e5
        begun = Progress(0, weights, moments, 0, none, none, none, none + 1.0, -far, far, weights)
        fixed, found = self._rollout(begun, None, tell)
        if start is not None:
            own = start.layers
            begun.mean, begun.scale = np.asarray(own.mean), np.asarray(own.scale)
            begun.weights = begun.best = np.concatenate([np.ravel(getattr(own, name)) for name in _WEIGHTS])
            begun.fixed, (begun.latest, _) = fixed, self._rollout(begun, None, tell, own=True)
            begun.least = self._mean(np.log(begun.latest / fixed), self.kappa == 0.0)
            return begun
        wild = rng.uniform(-1.5, 1.5, (len(fixed), SIZE))
        _, more = self._rollout(begun, wild, tell)
        sample = np.concatenate([found, more])
        begun.mean, begun.scale = sample.mean(axis=0), np.maximum(sample.std(axis=0), 1e-3)
        begun.fixed = begun.latest = fixed
        return begun

    def layers(self, at: Progress, weights: Tensor | None = None) -> Layers:
        """The policy in torch."""
        units, count = self.options.hidden, len(FEATURES)
        flat = torch.from_numpy(at.weights) if weights is None else weights
        ends = np.cumsum([0, units * count, units, SIZE * units, SIZE])
        parts = [flat[..., a:b] for a, b in itertools.pairwise(ends)]
        lead = flat.shape[:-1]
        used = torch.tensor([name not in self.options.without for name in FEATURES], dtype=torch.float64)
        hidden = parts[0].reshape(*lead, units, count) * used
        box = (self.box.centre, self.box.centre - self.box.lowest, self.box.highest - self.box.centre)
        numbers = (at.mean, at.scale, *box, at.low, at.high)
        mean, scale, centre, below, above, low, high = (
            torch.from_numpy(np.asarray(each, dtype=float)) for each in numbers
        )
        return Layers(
            mean,
            scale,
            hidden,
            parts[1],
            parts[2].reshape(*lead, SIZE, units),
            parts[3],
            centre,
            below,
            above,
            low,
            high,
        )

    def epoch(self, at: Progress, tell: Callable[[str], None]) -> Progress:
        """One more epoch."""
        began = time.process_time()
        made = self._by_gradient(at, tell) if self.options.method == "gradient" else self._by_evolution(at, tell)
        made.epoch, made.seconds = at.epoch + 1, at.seconds + time.process_time() - began
        ratio = np.log(made.latest / made.fixed)
        plain = self.kappa == 0.0
        made.history = [*at.history, (self._mean(ratio, plain), self._mean(ratio, plain | True))]
        if made.history[-1][0] <= at.least:
            made.best, made.least = made.weights, made.history[-1][0]
        return made

    def finished(self, at: Progress, tell: Callable[[str], None], start: Policy | None = None) -> Policy:
        """The best policy, with the hull of what it hears on the situations, and a card with that of its start."""
        at = Progress(**{**vars(at), "weights": at.best})
        costs, found = self._rollout(at, None, tell, own=True)
        low, high = np.quantile(found, 0.0005, axis=0), np.quantile(found, 0.9995, axis=0)
        # All tastes were drawn, if not to the last one.
        low[FEATURES.index("kappa")], high[FEATURES.index("kappa")] = -1.0, 1.0
        at = Progress(**{**vars(at), "low": low, "high": high, "latest": costs})
        numpy = (each.detach().numpy().copy() for each in self.layers(at))
        before = {} if start is None else {"start": dict(start.provenance)}
        return Policy(Layers(*numpy), {**self._card(at), **before})

    def _card(self, at: Progress) -> dict[str, Any]:
        """Where a policy comes from."""
        kinds = {robot: kinds_of(robot, trained=True) for robot in self._robots}
        versions = {name: version for name, version in collect_versions().items() if version is not None}
        return {
            "made_by": "stewart-drake train --tuner policy",
            "date": date.today().isoformat(),
            "data": {"situations": kinds, "of_each": self.options.situations, "seeds": f"from {self._seeds} on"},
            "cost": "J of control/objective.py at kappa 0; other tastes in half of the situations",
            "options": self.options.to_dict(),
            "epochs_J_over_best_fixed": [round(math.exp(plain), 3) for plain, _ in at.history],
            "J_over_best_fixed_in_training": {
                name: round(value, 3) for name, value in self.by_kind(at.latest, at.fixed).items()
            },
            "processor_seconds": round(at.seconds),
            "limits": "robots, sensors and motions of training/situations.py; see docs/results/tuner.md",
            "versions": {**versions, "torch": torch.__version__},
        }

    def costs(self, layers: Layers) -> np.ndarray:
        """J of a finished policy in every situation, a robot after the other."""
        ready = Layers(*(torch.from_numpy(np.asarray(each, dtype=float)) for each in layers))
        found = (self._roll(group, ready)[0][: len(group.scenarios) // self._both] for group in self._groups)
        return np.concatenate(list(found))

    def by_kind(self, costs: np.ndarray, fixed: np.ndarray) -> dict[str, float]:
        """Geometric mean of J over J at the centre, at kappa 0, by robot and kind."""
        ratio, plain = np.log(costs / fixed), self.kappa == 0.0
        return {
            f"{robot}: {kind}": float(np.exp(ratio[own].mean()))
            for robot, kind in dict.fromkeys(self.names)
            if (own := np.array([name == (robot, kind) for name in self.names]) & plain).any()
        }

    def _weighed(self, at: Progress) -> np.ndarray:
        """What each situation counts: each kind alike, but more where the policy is worse than the centre."""
        ratio, names = np.log(at.latest / at.fixed), np.array([f"{robot} {kind}" for robot, kind in self.names])
        found = self.share.copy()
        for name in dict.fromkeys(names):
            own = names == name
            found[own] *= 1.0 + self.options.fairness * max(0.0, float(ratio[own].mean()))
        return found

    def _mean(self, ratio: np.ndarray, chosen: np.ndarray) -> float:
        share = self.share * chosen
        return float((share * ratio).sum() / share.sum())

    def _rate(self, epoch: int) -> float:
        along = 0.5 * (1.0 + math.cos(math.pi * epoch / self.options.epochs))
        return self.options.learning_rate * (0.1 + 0.9 * along)

    def _adam(self, at: Progress, gradient: np.ndarray) -> None:
        size = float(np.linalg.norm(gradient))
        gradient = gradient / max(1.0, size)
        at.steps += 1
        first, second = 0.9 * at.moments[0] + 0.1 * gradient, 0.99 * at.moments[1] + 0.01 * gradient**2
        at.moments = np.stack([first, second])
        step = (first / (1.0 - 0.9**at.steps)) / (np.sqrt(second / (1.0 - 0.99**at.steps)) + 1e-8)
        at.weights = at.weights - self._rate(at.epoch) * step

    def _by_gradient(self, at: Progress, tell: Callable[[str], None]) -> Progress:
        made, groups = Progress(**vars(at)), self._groups
        # The gradient of log J is half of that of J^2 over J^2.
        share = torch.from_numpy(self._weighed(at) / at.latest**2 * 0.5)
        with torch.no_grad():
            layers = self.layers(made)
            tuners = [group.tuner(layers) for group in groups]
            states = [
                group.advance(group.start(tuner), group.scored, tuner)[0]
                for group, tuner in zip(groups, tuners, strict=True)
            ]
        squares = np.zeros(len(share))
        for piece in range(self.options.pieces):
            weights = torch.from_numpy(made.weights.copy()).requires_grad_()
            layers, parts = self.layers(made, weights), []
            for k, group in enumerate(groups):
                tuner = group.tuner(layers)
                late = group.ticks - group.scored
                ticks = late * (piece + 1) // self.options.pieces - late * piece // self.options.pieces
                states[k], found = group.advance(states[k].detached(), ticks, tuner)
                parts.append(found)
            found = torch.cat(parts)
            (self.options.pieces * (share * found).sum()).backward()  # type: ignore[no-untyped-call]
            gradient = np.zeros_like(made.weights) if weights.grad is None else weights.grad.numpy()
            squares += found.detach().numpy()
            if np.isfinite(gradient).all():
                self._adam(made, gradient)
            tell(f"piece {piece + 1} of {self.options.pieces}")
        made.latest = self._costs(squares, states)
        return made

    def _by_evolution(self, at: Progress, tell: Callable[[str], None]) -> Progress:
        made = Progress(**vars(at))
        rng = np.random.default_rng([self.options.seed, 2, at.epoch])
        ticks = [group.ticks for group in self._groups]
        # Short runs are cheap: each robot gets about the same time.
        often = [max(ticks) // each for each in ticks]
        for step in reversed(range(max(often))):
            self._step([k for k, times in enumerate(often) if step < times], made, rng)
            tell(f"{step} more steps")
        return made

    def _step(self, chosen: Sequence[int], made: Progress, rng: np.random.Generator) -> None:
        """One of evolution, by the situations of some robots."""
        ways, logs, owns = [], [], []
        made.latest = made.latest.copy()
        for k in chosen:
            group, own = self._groups[k], np.flatnonzero(self._robot_of == k)
            half = len(own)
            way = rng.standard_normal((half, len(made.weights)))
            layers = self.layers(
                made, torch.from_numpy(made.weights + self.options.spread * np.concatenate([way, -way]))
            )
            costs, _ = self._roll(group, layers)
            made.latest[own] = np.sqrt(costs[:half] * costs[half:])
            ways.append(way)
            logs.append(np.log(costs[:half]) - np.log(costs[half:]))
            owns.append(own)
        slope = self._weighed(made)[np.concatenate(owns)] * np.concatenate(logs) / (2.0 * self.options.spread)
        # Of one pair a situation, each a guess of its own slope.
        self._adam(made, slope @ np.concatenate(ways))

    def _rollout(
        self, at: Progress, wild: np.ndarray | None, tell: Callable[[str], None], own: bool = False
    ) -> tuple[np.ndarray, np.ndarray]:
        """J of all situations at the centre, at settings `wild` of their own or with the policy; features (n, 13)."""
        costs, found, start = [], [], 0
        for group in self._groups:
            count = len(group.scenarios) // self._both
            layers = self.layers(at)
            if not own:
                bias = np.zeros((count, SIZE)) if wild is None else wild[start : start + count]
                start += count
                bias = np.concatenate([bias] * self._both)
                layers = layers._replace(output=0.0 * layers.output, output_bias=torch.from_numpy(bias))
            cost, heard = self._roll(group, layers)
            costs.append(cost[:count])
            found.append(heard)
            tell("rolled out")
        return np.concatenate(costs), np.concatenate(found)

    def _roll(self, group: Situations, layers: Layers) -> tuple[np.ndarray, np.ndarray]:
        with torch.no_grad():
            tuner = group.tuner(layers)
            state, found = group.start(tuner), []
            while state.tick < group.scored:
                state, _ = group.advance(state, min(_SAMPLED, group.scored - state.tick), tuner)
                found.append(state.memory.found.numpy())
            squares = np.zeros(len(group.scenarios))
            while state.tick < group.ticks:
                state, more = group.advance(state, min(_SAMPLED, group.ticks - state.tick), tuner)
                squares += more.numpy()
                found.append(state.memory.found.numpy())
        return self._costs(squares, [state]), np.concatenate(found[3:])

    def _costs(self, squares: np.ndarray, states: Sequence[Any]) -> np.ndarray:
        alive = np.concatenate([(state.alive & state.followed).numpy() for state in states])
        return np.where(alive, np.sqrt(np.maximum(squares, 1e-12)), 100.0)


def _coarser(scenario: Any) -> Any:
    """With fewer steps of the plant where a tick has many."""
    steps = round(scenario.controller.period / scenario.plant.time_step)
    return scenario.replace({"plant.time_step": scenario.controller.period / 2}) if steps > 2 else scenario


def train_policy(
    training: Training,
    checkpoint: Path | None = None,
    tell: Callable[[float, str], None] | None = None,
    start: Policy | None = None,
) -> Policy:
    """Trains, going on from a checkpoint where there is one; the same options give the same policy.

    Args:
        training: See there.
        checkpoint: File that is written after each epoch, and taken away at the end; None for none.
        tell: Called with epochs done and a word on it.
        start: A policy to go on from.

    Raises:
        ConfigurationError: See `policy_progress.kept`.
    """
    say = tell or (lambda *_: None)
    identity = checksum([training.identity, None if start is None else [np.ravel(x).tolist() for x in start.layers]])
    at = kept(checkpoint, identity) or training.begin(lambda text: say(0.0, text), start)
    while at.epoch < training.options.epochs:
        done = float(at.epoch)
        at = training.epoch(at, lambda text, done=done: say(done, text))  # type: ignore[misc]
        say(float(at.epoch), f"J {math.exp(at.history[-1][0]):.3f} of fixed")
        if checkpoint is not None:
            keep(at, identity, checkpoint)
    policy = training.finished(at, lambda text: say(float(training.options.epochs), text), start)
    if checkpoint is not None:
        checkpoint.unlink(missing_ok=True)
    return policy
