"""The neural tuner as a LeafSystem."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydrake.systems.framework import Context, LeafSystem, State

from stewart_drake.errors import NotFiniteError
from stewart_drake.network import TunerNetwork
from stewart_drake.sampling import on_grid


class AnnTuner(LeafSystem):
    """omega_Q and omega_R from the densities, Fig. 5.

    The weights found at a tick act from the next one on: the densities of a tick need its torque, which needs the
    weights. Until the first inference they are `initial`; they are never zero and never outside the range that the
    network was trained on.

    Ports:
        density: in (12,) [-].
        weights: out (2,), omega_Q, omega_R.
    """

    def __init__(self, network: TunerNetwork, period: float, initial: Sequence[float] = (1.0, 1.0)) -> None:
        super().__init__()
        self._network = network
        self.density = self.DeclareVectorInputPort("density", 12)
        index = self.DeclareDiscreteState(np.clip(initial, network.omega_min, network.omega_max))
        self.weights = self.DeclareStateOutputPort("weights", index)
        # Unrestricted, as in `TickedSystem`, so that every system of the loop updates from the same instant.
        self.DeclarePeriodicUnrestrictedUpdateEvent(period_sec=on_grid(period), offset_sec=0.0, update=self._update)

    def _update(self, context: Context, state: State) -> None:
        features = self.density.Eval(context)
        if not np.isfinite(features).all():
            error = NotFiniteError("density", features)
            error.time = context.get_time()
            raise error
        state.get_mutable_discrete_state().set_value(self._network.weights(features))
