"""The tuners as systems: the neural one, and weights that stay."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pydrake.systems.framework import Context, DiscreteValues, LeafSystem, OutputPort
from pydrake.systems.primitives import ConstantVectorSource

from stewart_drake.control import tuners
from stewart_drake.control.network import TunerNetwork, network_part
from stewart_drake.errors import RunFailure
from stewart_drake.sampling import on_grid


class NetworkTuner(LeafSystem):
    """omega_Q and omega_R from the densities, Fig. 5; public as `systems.AnnTuner`.

    `stewart_drake.AnnTuner` is the section of a scenario that asks for it.

    The weights found at a tick act from the next one on: the densities of a tick need its torque, which needs the
    weights. Until the first inference they are `initial`; they are never zero and never outside the range that the
    network was trained on.

    Args:
        network: Trained.
        period: [s] tick period.
        initial: omega_Q, omega_R before the first inference.
        compiled: See `Scenario.compiled`.

    Raises:
        ConfigurationError: `initial` is not two finite numbers.

    Ports:
        density: in (12,) [-].
        weights: out (2,), omega_Q, omega_R.
    """

    def __init__(
        self,
        network: TunerNetwork,
        period: float,
        initial: Sequence[float] = (1.0, 1.0),
        compiled: bool = False,
    ) -> None:
        super().__init__()
        first, self._tick = network_part(network, initial, compiled)
        self.density = self.DeclareVectorInputPort("density", 12)
        index = self.DeclareDiscreteState(first)
        self.weights = self.DeclareStateOutputPort("weights", index)
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=on_grid(period), offset_sec=0.0, update=self._update)

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        try:
            weights = self._tick(self.density.Eval(context), context.get_discrete_state(0).value())
        except RunFailure as error:
            error.time = context.get_time()
            raise
        discrete_state.set_value(weights)


AnnTuner = NetworkTuner
"""The public name."""


def add_network_tuner(wiring: Any, options: tuners.AnnTuner, density: OutputPort) -> OutputPort:
    """Adds the network to a closed loop; its weights (2,)."""
    tuner = NetworkTuner(options.network(), wiring.period, options.weights, wiring.scenario.compiled)
    return wiring.add("tuner", tuner, density=density).weights


def add_fixed_weights(wiring: Any, options: tuners.Tuner, density: OutputPort) -> OutputPort:  # noqa: ARG001 - they stay
    """Adds weights that stay to a closed loop, (2,) or (4,)."""
    port: OutputPort = wiring.add("tuner", ConstantVectorSource(options.weights)).get_output_port()
    return port
