"""Policies in batched loops: rollouts, what they cost, and its gradient by truncated backpropagation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from stewart_drake.compiled.constants import MEAN_FLOOR
from stewart_drake.control.features import Heard, Recent, Site, features, nothing_yet
from stewart_drake.control.objective import CostScales
from stewart_drake.control.policy import Layers, answer, limited
from stewart_drake.logs.cost import FAILED
from stewart_drake.scenario import Scenario
from stewart_drake.training.batched_loops import BatchedLoops, Costs, LoopState, Observed


class Hearing(NamedTuple):
    """What a policy in batched loops remembers.

    Attributes:
        recent: See `features.Recent`.
        window: Magnitudes (B, 12) of errors and torques, oldest first.
        total: (B, 12) their sum.
    """

    recent: Recent
    window: tuple[Tensor, ...]
    total: Tensor


class PolicyInLoops:
    """A policy as a tuner of batched loops; no gradient passes what it hears, nor its rate limit.

    Args:
        layers: In torch; the weights of layers may be one for all or one for each loop.
        site: Of the loops, (B,) where they differ.
        rate: [1/s] see `Policy.rate`.
        window: m of (35) [ticks].

    Attributes:
        found: (B, 13) features of the last tick.
    """

    def __init__(self, layers: Layers, site: Site, rate: float, window: int = 49) -> None:
        self.layers, self._site, self._window = layers, site, window
        self._step = 2.0 * rate * site.period * layers.reach
        self.found: Tensor | None = None

    def start(self, loops: int) -> Hearing:
        """Before the first tick."""
        none = torch.zeros(loops, 6, dtype=torch.float64)
        return Hearing(nothing_yet(none), (), torch.zeros(loops, 12, dtype=torch.float64))

    def __call__(self, seen: Observed, before: Tensor, memory: Hearing) -> tuple[Tensor, Hearing]:
        """Settings (B, 4) after those of the tick before."""
        with torch.no_grad():
            sample = torch.cat([seen.error, seen.torque], dim=-1).abs()
            window, total = (*memory.window, sample), memory.total + sample
            if len(window) > self._window + 1:
                total, window = total - window[0], window[1:]
            mean, count = total / len(window), float(len(window))
            flat = mean < MEAN_FLOOR
            density = torch.where(flat, 1.0, (sample / torch.where(flat, 1.0, mean)).clamp(max=count))
            heard = Heard(density, *(each.detach() for each in seen))
            self.found, recent = features(self._site, heard, memory.recent)
        wanted, _ = answer(self.layers, self.found)
        setting = limited(wanted.detach(), before.detach(), self._step)
        return setting + (wanted - wanted.detach()), Hearing(recent, window, total)


class Loops:
    """Situations of one robot on which a policy is rolled out.

    Args:
        scenarios: See `BatchedLoops`.
        kappa: (B,) taste of each.
        width: Of friction's corners, see `BatchedLoops`.
        scales: Of the cost.
    """

    def __init__(
        self, scenarios: Sequence[Scenario], kappa: np.ndarray, width: float, scales: CostScales | None = None
    ) -> None:
        self.loops = BatchedLoops(scenarios, width=width)
        sites = [scenario.tuner_site() for scenario in scenarios]
        kappas = torch.tensor(kappa, dtype=torch.float64)
        noise, latency = (
            torch.tensor([getattr(s, name) for s in sites], dtype=torch.float64) for name in ("noise", "latency")
        )
        self._scales = CostScales() if scales is None else scales
        self.site = Site(self.loops.period, noise, latency, sites[0].length, kappas, self._scales)
        self.ticks = min(round(s.duration / self.loops.period) for s in scenarios)
        self.scored = self.ticks // 2
        self._change = (1e-3 / self.loops.period / self._scales.torque_change) ** 2 * 10.0 ** (2.0 * kappas)

    def start(self, tuner: PolicyInLoops, centre: Tensor) -> LoopState:
        """Before the first tick, at the setting (4,)."""
        count = len(self.loops.scenarios)
        state = self.loops.start()
        return state._replace(setting=centre.expand(count, 4), memory=tuner.start(count))

    def advance(self, tuner: PolicyInLoops, state: LoopState, ticks: int) -> tuple[LoopState, Costs]:
        """Some ticks on."""
        for _ in range(ticks):
            ...
        raise NotImplementedError

    def squares(self, costs: Costs) -> Tensor:
        """(B,) what ticks of the scored half add to J^2, their mean times their share of it."""
        scales, share = self._scales, 1.0 / (self.ticks - self.scored)
        error = costs.rotation / scales.rotation**2 + costs.position / scales.position**2
        return ((error + self._change[:, None] * costs.change) * share).sum(dim=-1)
