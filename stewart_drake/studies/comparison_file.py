"""The file of a comparison: named controllers, references and conditions, as changes of one scenario."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterable, Iterator
from typing import Annotated, Literal

from pydantic import Field

from stewart_drake.base.config import Count, NotNegative, Positive, PositivePair, Section, Seed, Text
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.tables import Coordinate
from stewart_drake.control.features import CostScales
from stewart_drake.studies.experiment import Keys, StudyFile, StudyName

KINDS = ("controllers", "references", "conditions")

Names = Annotated[tuple[Text, ...], Field(min_length=1)]


class BestOf(Section):
    """A row for the best of some controllers, chosen for every reference and condition separately."""

    of: Names
    """Names of controllers; the one with the smallest pose RMSE is taken. They get no separate rows."""


class Product(Section):
    """All combinations of these controllers, references and conditions."""

    controllers: Names
    references: Names
    conditions: Names

    def combinations(self) -> Iterator[tuple[str, str, str]]:
        """Names of controller, reference and condition."""
        return itertools.product(self.controllers, self.references, self.conditions)


class Bands(Section):
    """Closed-loop amplitude and phase, one run per controller, axis and frequency."""

    controllers: tuple[Text, ...]
    condition: Text
    """Name of a condition."""
    axes: tuple[Coordinate, ...] = ("Z", "roll")
    """Axes to test, one at a time."""
    frequencies: tuple[Annotated[Positive, Field(le=100.0)], ...] = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
    """[Hz] at which amplitude and phase are taken."""
    transient: NotNegative = 3.0
    """[s] time before the fit begins; the fit takes whole periods of 1 s or more."""


class TuneOptions(Section, key="tune"):
    """Search of controller keys by CMA-ES, in their logarithms, for the least cost over the comparison's runs."""

    controllers: dict[Text, dict[Text, PositivePair]]
    """Name -> (scenario key -> lowest and highest value). The search starts from the controller's values."""
    generations: Annotated[Count, Field(ge=1, le=10_000)] = 12
    """Largest number of generations, with `population` settings; fewer if the search converges."""
    population: Annotated[Count, Field(ge=4, le=1000)] = 8
    """Settings in a generation, the same for all controllers."""
    seeds: Annotated[tuple[Seed, ...], Field(min_length=1)] = (1,)
    """Seeds of the noise in the runs of the search, in place of the comparison's `seeds`."""
    set: Keys = Field(default_factory=dict)
    """Scenario key -> value, in the runs of the search only."""

    def rules(self) -> None:
        if not self.controllers:
            raise ConfigurationError("controllers", {}, "at least one name, with the keys to search")
        for name, keys in self.controllers.items():
            for key, (low, high) in keys.items():
                if not low < high:
                    raise ConfigurationError(
                        f"controllers.{name}.{key}", [low, high], "a lowest value below the highest"
                    )


class TunedFile(Section, key=""):
    """The result of a search."""

    name: Text
    """Name of the comparison."""
    controllers: dict[Text, dict[Text, Positive]]
    """Name -> (scenario key -> value)."""


class CompareFile(StudyFile):
    """Keys of a comparison file."""

    name: StudyName = "comparison"
    controllers: dict[Text, Keys]
    """Name -> (scenario key -> value)."""
    references: dict[Text, Keys]
    """Name -> (scenario key -> value); `duration` and `initial_offset` may be among them."""
    conditions: dict[Text, Keys] = Field(default_factory=lambda: {"nominal": Keys()})
    """Name -> (scenario key -> value), applied last."""
    best_of: dict[Text, BestOf] = Field(default_factory=dict)
    """Name -> the controllers of which it is the best."""
    runs: Annotated[tuple[Product, ...], Field(min_length=1)] | None = None
    """Combinations to run, at least one; null for all controllers on all references under all conditions."""
    seeds: Annotated[tuple[Seed, ...], Field(min_length=1)] = (0,)
    """Seeds: a run with the text {seed} among its values is repeated with all of them, any other has the first."""
    layout: Literal["rows", "grid"] = "rows"
    """Layout of the Markdown. rows: one row per run. grid: one table per condition, with a column per
    reference."""
    band: Positive = 0.5
    """[mm] pose error within which a run counts as settled; rotations times the characteristic length."""
    traced: Text | None = None
    """Reference whose error over time is plotted; null for the first."""
    bands: Bands | None = None
    """Closed-loop frequency response to measure; null for none."""
    cost: CostScales | None = None
    """Scales of the cost of a run; null for no cost."""
    tune: TuneOptions | None = None
    """Search of `stewart-drake tune`; null for none."""
    tuned: Text | None = None
    """File with tuned values for the controllers, as `stewart-drake tune` writes it, relative to this file. `tune`
    itself starts without them. null for none."""
    quick: Positive = 1.5
    """[s] longest run under `--quick`, which also keeps only two of the frequencies."""

    @property
    def products(self) -> tuple[Product, ...]:
        """Combinations in `runs`, by default all, where a best-of name replaces its controllers."""
        inside = {name for best in self.best_of.values() for name in best.of}
        names = (*(name for name in self.controllers if name not in inside), *self.best_of)
        every = Product(controllers=names, references=tuple(self.references), conditions=tuple(self.conditions))
        return self.runs or (every,)

    def rules(self) -> None:
        for kind in KINDS:
            if not getattr(self, kind):
                raise ConfigurationError(kind, {}, "at least one name, with the scenario keys that it changes")
        if both := set(self.best_of) & set(self.controllers):
            raise ConfigurationError("best_of", min(both), "names that no controller has")
        names = {"controllers": [*self.controllers, *self.best_of], "references": self.references}
        names["conditions"] = self.conditions
        for name, best in self.best_of.items():
            check_names(f"best_of.{name}.of", best.of, self.controllers)
        for index, product in enumerate(self.runs or ()):
            for kind, allowed in names.items():
                check_names(f"runs.{index}.{kind}", getattr(product, kind), allowed)
        if self.traced is not None:
            check_names("traced", [self.traced], self.references)
        if self.bands is not None:
            check_names("bands.controllers", self.bands.controllers, self.controllers)
            check_names("bands.condition", [self.bands.condition], self.conditions)


def check_names(where: str, names: Iterable[str], allowed: Collection[str]) -> None:
    for name in names:
        if name not in allowed:
            raise ConfigurationError(where, name, f"one of {', '.join(allowed)}")
