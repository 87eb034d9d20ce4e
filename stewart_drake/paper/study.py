"""What every section of the reproduction works with."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from stewart_drake.control.network import default_network_path
from stewart_drake.files.whole import locked_folder
from stewart_drake.logs.log import SimulationLog
from stewart_drake.paper.rendering import render
from stewart_drake.paper.report import Section
from stewart_drake.runs.outputs import prepare_folder
from stewart_drake.scenario import Scenario
from stewart_drake.studies.runs import RunStore

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_Key = TypeVar("_Key")

SEED = 20_210_601
"""Of every random choice in the report, unless a section says otherwise."""


def quantiles(values: np.ndarray, at: tuple[float, ...] = (0.05, 0.5, 0.95)) -> list[float]:
    """Quantiles of what is finite, as plain numbers; none where nothing is."""
    usable = values[np.isfinite(values)]
    return [float(q) for q in np.quantile(usable, at)] if usable.size else []


@dataclass(frozen=True)
class Study:
    """One reproduction under way.

    Attributes:
        folder: The report's folder.
        quick: Smaller sizes: under two minutes for the whole report on two cores.
        base: Scenario that the sections vary; the main job of the project unless the user gives another robot.
        progress: Called with the share of the present section that is done, 0 to 1.
    """

    folder: Path
    quick: bool = False
    base: Scenario = field(default_factory=Scenario)
    progress: Callable[[float], None] = lambda _: None

    @property
    def store(self) -> RunStore:
        """Runs that are kept on disk."""
        return RunStore(self.folder / "runs")

    def run(
        self, scenarios: Mapping[_Key, Scenario], start: float = 0.0, size: float = 1.0, check: bool = True
    ) -> dict[_Key, SimulationLog]:
        """Logs of `scenarios`, as by `RunStore.run_all`; progress as by `part`."""
        logs = self.store.run_all(list(scenarios.values()), self.part(start, size), check=check)
        return dict(zip(scenarios, logs, strict=True))

    @property
    def tuner_file(self) -> Path:
        """Weights of the tuner: those that this report's own training has left, else those of the package."""
        own = self.folder / self.name("tuner", ".json")
        return own if own.is_file() else default_network_path()

    @contextmanager
    def locked(self, *inside: str) -> Iterator[None]:
        """Keeps other processes out of the report's folder, and clears it of what a killed one left half written.

        Args:
            inside: Folders in it that are written to; they are made.

        Raises:
            ConfigurationError: Another process has one of them, or it cannot be written to.
        """
        with ExitStack() as locks:
            for folder in (self.folder, *(self.folder / name for name in inside)):
                locks.enter_context(locked_folder(prepare_folder(folder)))
            yield

    def name(self, stem: str, ending: str = "") -> str:
        """Name of a file: a quick and a whole report in one folder do not overwrite each other's."""
        return f"{stem}{'-quick' if self.quick else ''}{ending}"

    def pick(self, full: Any, quick: Any) -> Any:
        """One of two sizes."""
        return quick if self.quick else full

    def part(self, start: float, size: float) -> Callable[[float], None]:
        """Progress of a part of the section: of its own share, `size` of the whole from `start` on."""
        return lambda share: self.progress(start + size * share)

    def section(
        self, key: str, numbers: dict[str, Any], figures: Mapping[str, Figure] | None = None, **values: Any
    ) -> Section:
        """The section that template `key` makes of its numbers; its pictures are kept.

        Args:
            key: Name of the section and of its template.
            numbers: For the report's JSON; `n` in the template.
            figures: Pictures by the names under which the template shows them.
            values: What else the template speaks of, beside the scenario `base`.
        """
        files = {name: self.save_figure(figure, name) for name, figure in (figures or {}).items()}
        blocks = {
            b: render(key, b, files, n=numbers, base=self.base, **values) for b in ("title", "claim", "verdict", "body")
        }
        return Section(key, **blocks, numbers=numbers, files=[f"figures/{file}" for file in files.values()])

    def save_figure(self, figure: Figure, name: str) -> str:
        """Keeps a picture for the report; returns its file's name in the folder `figures`."""
        from stewart_drake.plotting import save_figure

        (self.folder / "figures").mkdir(parents=True, exist_ok=True)
        file = self.name(name, ".png")
        save_figure(figure, self.folder / "figures" / file)
        return file
