"""What runs a scenario: Drake's plant in a Diagram, or the closed form of the robot; and what both leave."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any

import numpy as np

from stewart_drake.logs.log import SIGNALS
from stewart_drake.safety import first_trip
from stewart_drake.sampling import times_of
from stewart_drake.scenario import Scenario

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat


class Engine(ABC):
    """A scenario on its way, a row of signals for each step of the plant, both ends included.

    Attributes:
        scenario: As run.
        state_names: Names of the columns of `plant_state`; none where there is no such signal.
        stops: Steps at which it must pause.
    """

    scenario: Scenario
    state_names: tuple[str, ...] = ()
    stops: tuple[int, ...] = ()

    @abstractmethod
    def prepare(self) -> None:
        """What is no part of a run's cost, such as compiling; then the state at the start."""

    @abstractmethod
    def start(self) -> None:
        """The row at t = 0."""

    @abstractmethod
    def advance(self, step: int) -> None:
        """Goes on to a step of the plant, and its row; raises RunFailure where the run is over."""

    @property
    @abstractmethod
    def time(self) -> float:
        """[s] reached, as Drake has it, see `sampling.on_grid`."""

    @abstractmethod
    def signals(self) -> dict[str, np.ndarray]:
        """All complete rows so far, see `signals_of`."""

    @abstractmethod
    def safety_state(self) -> Any:
        """Of the safety layer, where there is one."""

    def first_trip(self) -> dict[str, Any] | None:
        """See `safety.first_trip`; None where there is no safety layer."""
        options = self.scenario.safety
        if options is None:
            return None
        return first_trip(self.safety_state(), self.scenario.controller.period, options.monitor_names)

    def graph(self) -> str | None:
        """Graphviz text of the Diagram; None where there is none."""
        return None

    def close(self) -> None:  # noqa: B027 - nothing to do where nothing is held
        """Lets go of it all."""


def engine_of(scenario: Scenario, meshcat: Meshcat | None) -> Engine:
    """The engine that a scenario asks for, see `PlantOptions.engine`."""
    # The closed form needs no Drake, which takes seconds to import.
    if scenario.plant.engine == "reduced":
        from stewart_drake.runs.fast_run import FastRun

        return FastRun(scenario, meshcat)
    from stewart_drake.runs.drake_run import DrakeRun

    return DrakeRun(scenario, meshcat)


def quiet() -> np.errstate:
    """Numbers near the largest overflow on the way to an end with a name; numpy need not say so as well."""
    return np.errstate(all="ignore")


def signals_of(scenario: Scenario, steps: np.ndarray, values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Signals by their names in a log.

    Args:
        scenario: As run.
        steps: (n,) of the plant.
        values: As they were in the loop: measurement (n, 12), reference (n, 18), weights (n, 2 or 4), `torque_applied`
            where it is another than `torque`, and the others as they are called in a log.
    """
    limit = scenario.robot.effort_limits
    reference, measurement = values["reference"], values["measurement"]
    signals = {
        "time": times_of(steps, scenario.plant.time_step),
        "reference": reference[:, :6],
        "reference_rate": reference[:, 6:12],
        "reference_acceleration": reference[:, 12:],
        "torque_applied": np.clip(values.get("torque_applied", values["torque"]), -limit, limit),
    }
    weights = values.pop("weights", None)
    if weights is not None:
        signals["weights" if weights.shape[1] == 2 else "block_weights"] = weights
    if not (scenario.sensors.exact and scenario.estimator.exact):
        signals["measured_pose"], signals["measured_pose_rate"] = measurement[:, :6], measurement[:, 6:]
    signals = values | signals
    return {name: signals[name] for name in SIGNALS if name in signals}
