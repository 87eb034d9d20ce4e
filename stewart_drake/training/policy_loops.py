"""Policies in batched loops: what they hear, rollouts, and what these cost."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from stewart_drake.compiled.constants import MEAN_FLOOR
from stewart_drake.control.features import Heard, Recent, Site, features, nothing_yet
from stewart_drake.control.objective import CostScales
from stewart_drake.control.policy import Layers, answer, limited
from stewart_drake.control.settings import STEP
from stewart_drake.scenario import Scenario
from stewart_drake.training.batched_loops import BatchedLoops
from stewart_drake.training.loop_state import Costs, LoopState, Observed

LEAK = 0.1
"""See `policy.answer`; without it what is once at an end of its box never comes back."""


class Hearing(NamedTuple):
    """What a policy in batched loops remembers.

    Attributes:
        recent: See `features.Recent`.
        window: Magnitudes (B, 12) of errors and torques, oldest first.
        total: (B, 12) their sum.
        setting: (B, 4) of the tick before.
        found: (B, 13) features of the tick before.
    """

    recent: Recent
    window: tuple[Tensor, ...]
    total: Tensor
    setting: Tensor
    found: Tensor


class PolicyInLoops:
    """A policy as the tuner of batched loops. No gradient passes what it hears, and its rate limit lets all pass.

    Args:
        layers: In torch; weights are one for all loops, or one for each.
        site: Of the loops.
        window: m of (35) [ticks].
    """

    def __init__(self, layers: Layers, site: Site, window: int = 49) -> None:
        self._layers, self._site, self._window = layers, site, window
        self._step = STEP * (layers.below + layers.above)

    def start(self, loops: int) -> Hearing:
        """Before the first tick."""
        none = torch.zeros(loops, 6, dtype=torch.float64)
        dense = torch.zeros(loops, 12, dtype=torch.float64)
        setting = self._layers.centre.expand(loops, 4)
        return Hearing(nothing_yet(none), (), dense, setting, torch.zeros(loops, 13, dtype=torch.float64))

    def __call__(self, seen: Observed, memory: Hearing) -> tuple[Tensor, Hearing]:
        """Settings (B, 4), see `batched_loops.Tuner`."""
        with torch.no_grad():
            sample = torch.cat([seen.error, seen.torque], dim=-1).abs()
            window, total = (*memory.window, sample), memory.total + sample
            if len(window) > self._window + 1:
                total, window = total - window[0], window[1:]
            mean, count = total / len(window), float(len(window))
            flat = mean < MEAN_FLOOR
            density = torch.where(flat, 1.0, (sample / torch.where(flat, 1.0, mean)).clamp(max=count))
            found, recent = features(self._site, Heard(density, *(each.detach() for each in seen)), memory.recent)
        wanted, _ = answer(self._layers, found, LEAK)
        setting = limited(wanted.detach(), memory.setting, self._step)
        return setting + (wanted - wanted.detach()), Hearing(recent, window, total, setting, found)


class Situations:
    """Runs of one robot on which a policy is rolled out.

    Args:
        scenarios: See `BatchedLoops`.
        kappa: (B,) taste in each.
        width: Of friction's corners, see `BatchedLoops`.

    Attributes:
        scenarios: As given.
        ticks: Of a run.
        scored: First tick of its second half, which costs.
        site: See `features.Site`.
    """

    def __init__(self, scenarios: Sequence[Scenario], kappa: Sequence[float], width: float = 0.0) -> None:
        self.scenarios, self._loops = tuple(scenarios), BatchedLoops(scenarios, width=width)
        period, sites = self._loops.period, [scenario.tuner_site() for scenario in scenarios]
        taste, noise, latency = (
            torch.tensor(values, dtype=torch.float64)
            for values in (list(kappa), [site.noise for site in sites], [site.latency for site in sites])
        )
        self.site = Site(period, noise, latency, sites[0].length, taste)
        self.ticks = min(round(scenario.duration / period) for scenario in scenarios)
        self.scored = self.ticks // 2
        scales = CostScales()
        self._rotation, self._position = scales.rotation**-2, scales.position**-2
        self._change = (1e-3 / period / scales.torque_change) ** 2 * 10.0 ** (2.0 * taste)

    def tuner(self, layers: Layers) -> PolicyInLoops:
        """A policy in these runs, see there."""
        return PolicyInLoops(layers, self.site)

    def start(self, tuner: PolicyInLoops) -> LoopState:
        """Before the first tick."""
        memory = tuner.start(len(self.scenarios))
        return self._loops.start()._replace(setting=memory.setting, memory=memory)

    def advance(self, state: LoopState, ticks: int, tuner: PolicyInLoops) -> tuple[LoopState, Tensor]:
        """Some ticks on, and what they add to J^2 (B,) where they are scored."""
        state, costs = self._loops.advance(state, ticks, tuner=tuner)
        return state, self._squares(costs)

    def _squares(self, costs: Costs) -> Tensor:
        error = self._rotation * costs.rotation + self._position * costs.position
        return (error + self._change[:, None] * costs.change).sum(dim=-1) / (self.ticks - self.scored)
