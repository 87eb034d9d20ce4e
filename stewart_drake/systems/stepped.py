"""A controller that is a LeafSystem, in a run outside of a Diagram."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.systems.analysis import Simulator, SimulatorStatus

from stewart_drake.control.controller_options import ControllerOptions
from stewart_drake.control.parts import Answer, ControllerSite
from stewart_drake.errors import RunFailure
from stewart_drake.registry import CONTROLLERS
from stewart_drake.sampling import WELL

SUBSTEPS = 10
"""Parts of the plant's step in which continuous state of a user's controller is integrated."""


class SteppedControl:
    """A System with its own Simulator; what it sees is fixed from one step of the plant to the next.

    Attributes:
        weighted: Whether it takes weights.
        health: That of a system of which nothing is known.
    """

    health = WELL

    def __init__(self, options: ControllerOptions, site: ControllerSite, time_step: float) -> None:
        self._system = CONTROLLERS.system(options.kind)(options, site)
        self.weighted: bool = self._system.HasInputPort("weights")
        self._tells = self._system.HasOutputPort("error")
        self._simulator = Simulator(self._system)
        integrate_in_substeps(self._simulator, time_step)
        self._context, self._started = self._simulator.get_mutable_context(), False
        self._last = Answer(*np.zeros((3, 6)))

    def tick(self, time: float, measured: np.ndarray, wanted: np.ndarray, weights: np.ndarray) -> Answer:
        """See `TickedControl`."""
        self._last = self._last._replace(error=measured[:6] - wanted[:6])
        return self.between(time, measured, wanted, weights)

    def between(
        self,
        time: float,  # noqa: ARG002 - its Context knows
        measured: np.ndarray,
        wanted: np.ndarray,
        weights: np.ndarray,
    ) -> Answer:
        """See `TickedControl`: what its ports say now."""
        seen = {"measurement": measured, "reference": wanted, **({"weights": weights} if self.weighted else {})}
        for name, value in seen.items():
            self._system.GetInputPort(name).FixValue(self._context, value)
        if not self._started:
            self._simulator.Initialize()
            self._started = True
        told = Answer._fields if self._tells else ("torque",)
        answers = {name: np.array(self._system.GetOutputPort(name).Eval(self._context)) for name in told}
        self._last = self._last._replace(**answers)
        return self._last

    def advance(self, time: float) -> None:
        """Goes on to a time [s]; updates of its state at the present one come first.

        Raises:
            RunFailure: It ends the run.
        """
        refuse_early_end(self._simulator.AdvanceTo(time))

    def close(self) -> None:
        """Lets go of it all."""
        release(self._system)


_PEERS = "_pydrake_internal_ref_cycle_peers"


def release(system: Any) -> None:
    """Lets go of a system that nobody will use again, which Python's garbage collector would keep for ever.

    pydrake ties systems, ports and diagrams together in cycles. Where a system is written in Python, CPython visits the
    dictionary of its attributes twice, once for each base, and takes the cycle for one that is held from outside: each
    run would leave its diagram, some megabytes, behind.
    """
    waiting: list[Any] = [system]
    while waiting:
        peers: set[Any] = getattr(waiting.pop(), _PEERS, set())
        waiting.extend(peers)
        peers.clear()


def integrate_in_substeps(simulator: Simulator, time_step: float) -> None:
    """Fixed steps for continuous state, which only a controller of the user's has.

    Steps as error control wants them would end nowhere once a derivative is not a number.
    """
    if simulator.get_system().num_continuous_states() == 0:
        return
    integrator = simulator.get_mutable_integrator()
    integrator.set_fixed_step_mode(True)
    # The step wanted at first comes before the largest one: Drake refuses it where it is larger.
    integrator.request_initial_step_size_target(time_step / SUBSTEPS)
    integrator.set_maximum_step_size(time_step / SUBSTEPS)


def refuse_early_end(status: SimulatorStatus) -> None:
    """A run that a user's system ended did not complete."""
    if status.reason() == SimulatorStatus.ReturnReason.kReachedTerminationCondition:
        raise RunFailure(" ".join(status.FormatMessage().split()), reason="controller_stopped")
