"""One run of a loop, with a row for each step of the plant: what all have in common, and that of a stepped plant."""

from __future__ import annotations

from abc import ABC, abstractmethod
from contextlib import suppress
from typing import Any

import numpy as np

from stewart_drake.base.errors import StewartDrakeError, drake_guard
from stewart_drake.base.sampling import on_grid, times_of
from stewart_drake.logs.rows import Rows
from stewart_drake.logs.signals import signals_of
from stewart_drake.scenario.scenario import Scenario
from stewart_drake.scenario.stepped_loop import SteppedLoop


class Run(ABC):
    """A run of a scenario; peaks and bounds need every step of the plant, whatever the log keeps.

    Attributes:
        scenario: What it is of.
        state_names: Names of the signal `plant_state`, where there is one.
        closed: Whether it has been used.
    """

    state_names: tuple[str, ...] = ()
    closed = False

    def __init__(self, scenario: Scenario) -> None:
        self.scenario, self._step = scenario, on_grid(scenario.plant.time_step)

    def prepare(self) -> None:
        """To the start. First it takes two ticks there and back: numba compiles in the first call of a function."""
        scenario = self.scenario
        if scenario.controller.code is None and scenario.plant.code is None and scenario.motors.code is None:
            # What is wrong with them shows in the run itself, with a log.
            with suppress(StewartDrakeError), drake_guard("compiling"), np.errstate(all="ignore"):
                self.begin()
                self.advance(1)
        self.begin()

    @abstractmethod
    def begin(self) -> None:
        """To the scenario's start, without rows."""

    @abstractmethod
    def advance(self, step: int) -> None:
        """Up to a step of the plant, with a row for each; a RunFailure ends it."""

    @property
    @abstractmethod
    def time(self) -> float:
        """[s] that is reached."""

    @abstractmethod
    def rows(self) -> tuple[int, dict[str, np.ndarray]]:
        """How many rows there are, and what was logged (n, k), by names in `Loop.logged`, beside what is measured."""

    def signals(self) -> dict[str, np.ndarray]:
        """Signals by their names in a log."""
        count, values = self.rows()
        values["time"] = times_of(np.arange(count), self.scenario.plant.time_step)
        if self.scenario.sensors.exact and self.scenario.estimator.exact:
            del values["measurement"]
        # Loops that are closed by construction have no gap.
        values.setdefault("loop_gap", np.zeros((count, 6)))
        return signals_of(values)

    @abstractmethod
    def safety_state(self) -> Any:
        """The record (1,) of the safety layer."""

    def graph(self) -> str | None:
        """Graphviz text, where there is a Diagram."""
        return None

    def close(self) -> None:
        """Its rows and states are those of one run."""
        self.closed = True


class SteppedRun(Run):
    """A run on a `SteppedLoop`."""

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(scenario)
        self._loop = SteppedLoop(scenario)
        # What a log takes stands in front of most of what a law that learns remembers.
        runner, logged = self._loop.runner, {"measured": "measured", **self._loop.parts.logged}
        self._places = {name: runner.places[of] if isinstance(of, str) else of for name, of in logged.items()}
        self._kept = runner.values[: max(each.stop for each in self._places.values() if isinstance(each, slice))]

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
        self._rows.append(self._kept)

    @property
    def time(self) -> float:
        return self._loop.time

    def rows(self) -> tuple[int, dict[str, np.ndarray]]:
        return len(self._rows), self._rows.columns()

    def safety_state(self) -> Any:
        return self._loop.runner.state("safety")
