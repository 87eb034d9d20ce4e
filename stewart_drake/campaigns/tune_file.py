"""What is searched: a comparison file with `cost` and `tune` in it, its runs, and where the search starts."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stewart_drake.campaigns.comparison_file import Comparison
from stewart_drake.campaigns.plan import vary
from stewart_drake.campaigns.tune_options import TuneOptions
from stewart_drake.errors import ConfigurationError
from stewart_drake.files.code_trust import trusting_code
from stewart_drake.files.yaml_files import find_file, read_mapping
from stewart_drake.keys import value_at
from stewart_drake.section import is_finite

DIGITS = 4
"""Of a setting: what is run is what is written down."""
START, TUNED, SEARCHED = "start", "tuned", "tuned, as searched"
"""What the verdict compares: before, after, and the latter as the search sees it."""
_QUICK_GENERATIONS = 2

Setting = dict[str, float]
"""Scenario key -> value."""


@dataclass(frozen=True)
class Ranges:
    """Keys of a controller with their bounds, and settings of them as points of a unit cube, in logarithms.

    Attributes:
        keys: Scenario key -> lowest and highest value.
        start: The setting to start from.
    """

    keys: Mapping[str, tuple[float, float]]
    start: Setting

    def setting(self, point: Iterable[float]) -> Setting:
        """The setting at a point, to `DIGITS` digits."""
        return {
            key: float(f"{low * (high / low) ** share:.{DIGITS}g}")
            for (key, (low, high)), share in zip(self.keys.items(), point, strict=False)
        }

    def point(self, setting: Setting) -> np.ndarray:
        """Inverse of `setting`, but for the digits."""
        return np.array([math.log(setting[key] / low) / math.log(high / low) for key, (low, high) in self.keys.items()])


@dataclass(frozen=True, eq=False)
class Tuning:
    """A search, ready to be done.

    Attributes:
        comparison: Its cells are the runs of one evaluation of each controller; bands left out.
        options: See `TuneOptions`.
        ranges: Controller -> what is searched of it.
        generations: Of each.
        data: The file in plain values.
        folder: Where it lies.
        quick: Whether runs are short.
    """

    comparison: Comparison
    options: TuneOptions
    ranges: Mapping[str, Ranges]
    generations: int
    data: Mapping[str, Any]
    folder: Path
    quick: bool

    @classmethod
    def from_dict(
        cls,
        data: Mapping[str, Any],
        folder: Path | None = None,
        controllers: Sequence[str] = (),
        budget: int | None = None,
        quick: bool = False,
    ) -> Tuning:
        """A search from plain values, as YAML gives them; every scenario of it is checked at both ends of each key.

        Args:
            data: See `CompareFile`.
            folder: Paths in `data` are relative to it; None for the current folder.
            controllers: Names of those to search; none for all that `tune` names.
            budget: Evaluations of each, in place of `generations` in the file; rounded down to whole generations.
            quick: Short runs, two generations.

        Raises:
            ConfigurationError: Names the key, the value and what is allowed.
        """
        plain = {**data, "tuned": None, "bands": None}
        options = Comparison.from_dict(plain, folder, quick).file.tune
        if options is None:
            raise ConfigurationError("tune", None, "a section that says what to search, as in the comparison `fair`")
        if data.get("cost") is None:
            raise ConfigurationError("cost", None, "scales of what is to be small, such as {position: 0.03}")
        changed = {"seeds": list(options.seeds), "set": {**(data.get("set") or {}), **options.set}}
        try:
            comparison = Comparison.from_dict({**plain, **changed}, folder, quick)
        except ConfigurationError as error:
            raise error.within("tune: ") from None
        for name in controllers:
            if name not in options.controllers:
                raise ConfigurationError("--controller", name, f"one of {', '.join(options.controllers)}")
        ranges = {
            name: _ranges(comparison, name, keys)
            for name, keys in options.controllers.items()
            if not controllers or name in controllers
        }
        generations = _QUICK_GENERATIONS if quick else options.generations
        if budget is not None:
            generations = (budget - 1) // options.population
            if generations < 1:
                raise ConfigurationError(
                    "--budget", budget, f"at least {options.population + 1}: the start and a generation"
                )
        return cls(comparison, options, ranges, generations, data, folder or Path(), quick)

    @property
    def name(self) -> str:
        """For folders and titles."""
        return self.comparison.name

    @property
    def evaluations(self) -> int:
        """Of each controller, at most: the start, and all generations."""
        return 1 + self.generations * self.options.population

    @property
    def runs(self) -> int:
        """At most, the verdict's included."""
        return sum(len(self.cells(name)) for name in self.ranges) * self.evaluations + self.verdict({}).runs

    def cells(self, controller: str) -> list[int]:
        """Runs of an evaluation of a controller, as places in the cells of `comparison`."""
        return [place for place, cell in enumerate(self.comparison.cells) if cell.controller == controller]

    @property
    def work(self) -> dict[str, Any]:
        """What the rows depend on, in plain values: the runs, but not what is searched: each row has its setting."""
        return self.comparison.to_dict()

    def verdict(self, tuned: Mapping[str, Setting]) -> Comparison:
        """The comparison's own runs, with its own seeds, of each controller before and after the search.

        Args:
            tuned: Controller -> what the search has found; the start where it has found nothing.
        """
        controllers: dict[str, Any] = {}
        runs = []
        for name, ranges in self.ranges.items():
            before = self.data["controllers"][name]
            after = {**before, **tuned.get(name, ranges.start)}
            ways = {START: before, TUNED: after}
            if self.options.set:
                ways[SEARCHED] = {**after, **self.options.set}
            named = {f"{name}, {way}": keys for way, keys in ways.items()}
            controllers |= named
            cells = [self.comparison.cells[place] for place in self.cells(name)]
            for reference, condition in dict.fromkeys((cell.reference, cell.condition) for cell in cells):
                runs.append({"controllers": list(named), "references": [reference], "conditions": [condition]})
        changed = {"controllers": controllers, "runs": runs, "best_of": {}, "tune": None, "tuned": None, "bands": None}
        return Comparison.from_dict({**self.data, **changed}, self.folder, self.quick)


def load_tuning(
    path: str | Path,
    controllers: Sequence[str] = (),
    budget: int | None = None,
    quick: bool = False,
    trust_code: bool = False,
) -> Tuning:
    """Reads a comparison file, see `Tuning.from_dict`, and `load_scenario` for `trust_code`.

    Raises:
        ConfigurationError: Missing, unreadable or malformed file; unknown key; value not allowed.
    """
    path = find_file("comparison", path)
    data = read_mapping("comparison", path, 80)
    with trusting_code(trust_code):
        return Tuning.from_dict(data, path.parent, controllers, budget, quick)


def _ranges(comparison: Comparison, name: str, keys: Mapping[str, tuple[float, float]]) -> Ranges:
    """Bounds and start of a controller's keys."""
    where = f"tune.controllers.{name}"
    cell = next((cell for cell in comparison.cells if cell.controller == name), None)
    if cell is None:
        names = ", ".join(dict.fromkeys(cell.controller for cell in comparison.cells))
        raise ConfigurationError("tune.controllers", name, f"controllers that are run: {names}")
    scenario = vary(comparison.base, cell.changes)
    data, start = scenario.in_full(), {}
    for key, (low, high) in keys.items():
        try:
            start[key] = value_at(data, key)
            for end in (low, high):
                vary(scenario, {key: end})
        except ConfigurationError as error:
            raise error.within(f"{where}: ") from None
        if not is_finite(start[key]) or not low <= start[key] <= high:
            allowed = f"a number from {low:g} to {high:g} in the controller's own keys, to start from"
            raise ConfigurationError(f"{where}: {key}", start[key], allowed)
    return Ranges(keys, start)
