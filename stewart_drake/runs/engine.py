"""One run of a loop, with a row per step of the plant: the base class, and the run of a stepped plant."""

from __future__ import annotations

from abc import ABC, abstractmethod
from contextlib import suppress

import numpy as np

from stewart_drake.base.errors import StewartDrakeError, drake_guard
from stewart_drake.base.sampling import on_grid, times_of
from stewart_drake.logs.rows import Rows
from stewart_drake.logs.signals import signals_of
from stewart_drake.scenario.scenario import Scenario
from stewart_drake.scenario.stepped_loop import SteppedLoop


class Run(ABC):
    """A run of a scenario. It records all steps of the plant, for peaks and bounds; a log may have fewer rows.

    Attributes:
        scenario: Scenario of the run.
        state_names: Names of the columns of the signal `plant_state`, if there is one.
        closed: Whether the run is over; it can be used once.
    """

    state_names: tuple[str, ...] = ()
    closed = False

    def __init__(self, scenario: Scenario) -> None:
        self.scenario, self._step = scenario, on_grid(scenario.plant.time_step)

    def prepare(self) -> None:
        """Compiles the loop's code in a trial step, then goes to the start."""
        scenario = self.scenario
        if scenario.controller.code is None and scenario.plant.code is None and scenario.motors.code is None:
            # Errors will be raised again in the run itself, with a log.
            with suppress(StewartDrakeError), drake_guard("compiling"), np.errstate(all="ignore"):
                self.begin()
                self.advance(1)
        self.begin()

    @abstractmethod
    def begin(self) -> None:
        """Goes to the scenario's start and discards all rows."""

    @abstractmethod
    def advance(self, step: int) -> None:
        """Simulates up to a step of the plant; a RunFailure ends the run."""

    @property
    @abstractmethod
    def time(self) -> float:
        """[s] simulated time."""

    @abstractmethod
    def rows(self) -> tuple[int, dict[str, np.ndarray]]:
        """Number of rows, and logged values (n, k) by the names in `Loop.logged`, with `measured`."""

    def signals(self) -> dict[str, np.ndarray]:
        """Signals of a log by name."""
        count, values = self.rows()
        values["time"] = times_of(np.arange(count), self.scenario.plant.time_step)
        if self.scenario.sensors.exact and self.scenario.estimator.exact:
            del values["measurement"]
        # Loops that are closed by construction have no gap.
        values.setdefault("loop_gap", np.zeros((count, 6)))
        return signals_of(values)

    @abstractmethod
    def safety_state(self) -> np.ndarray:
        """State of the safety layer, a record (1,)."""

    def graph(self) -> str | None:
        """Graphviz text of the Diagram, if there is one."""
        return None

    def close(self) -> None:
        """Ends the use of this object."""
        self.closed = True


class SteppedRun(Run):
    """A run on a `SteppedLoop`."""

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(scenario)
        self._loop = SteppedLoop(scenario)
        runner, logged = self._loop.runner, {"measured": "measured", **self._loop.parts.logged}
        self._places = {name: runner.places[of] if isinstance(of, str) else of for name, of in logged.items()}
        # Logged signals come first in the vector of all values; the large states of learning laws follow.
        end = max(place.stop for place in self._places.values() if isinstance(place, slice))
        self._row_values = runner.values[:end]

    def begin(self) -> None:
        self._rows = Rows(self._places)
        self._loop.begin()

    def advance(self, step: int) -> None:
        if not self._rows:
            self._row()
        while self._loop.now < step:
            self._loop.move()
            self._row()

    def _row(self) -> None:
        self._loop.run_parts()
        self._rows.append(self._row_values)

    @property
    def time(self) -> float:
        return self._loop.time

    def rows(self) -> tuple[int, dict[str, np.ndarray]]:
        return len(self._rows), self._rows.columns()

    def safety_state(self) -> np.ndarray:
        return self._loop.runner.state("safety")
