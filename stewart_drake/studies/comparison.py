"""A comparison as typed YAML: named controllers, references and conditions, each some changed keys of one scenario."""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from stewart_drake.config import Count, Fraction, NotNegative, Positive, PositivePair, Section, Seed, Text, to_plain
from stewart_drake.control.features import CostScales
from stewart_drake.errors import ConfigurationError
from stewart_drake.files.code_trust import trusting_code
from stewart_drake.files.yaml_files import find_file, read_mapping
from stewart_drake.logs.metric_table import Column
from stewart_drake.planning.feasibility import largest_amplitude
from stewart_drake.scenario import Scenario
from stewart_drake.studies.comparison_table import (
    BANDS,
    PICTURES,
    band_rows,
    measure_band,
    measure_run,
    sheets,
    table_columns,
    table_rows,
)
from stewart_drake.studies.robots import sized
from stewart_drake.studies.runs import Measure, Row
from stewart_drake.studies.study import Study, StudyFile, StudyName, vary

SEED = "{seed}"
"""In a value, stands for the seed of the run."""
MAX_RUNS = 10_000
AXIS_NUMBERS = {"roll": 0, "pitch": 1, "yaw": 2, "X": 3, "Y": 4, "Z": 5}
_QUICK_FREQUENCIES = 2
_KINDS = ("controllers", "references", "conditions")
_NAME = re.compile(r"[^|\x00-\x1f\x7f]{1,80}")

Names = Annotated[tuple[Text, ...], Field(min_length=1)]


class BestOf(Section):
    """A row for the best of some controllers, picked again for each reference and condition."""

    of: Names
    """Names of controllers; the one with the smallest pose RMSE is taken. They have no row of their own."""


class Product(Section):
    """Every one of these controllers with every one of these references under every one of these conditions."""

    controllers: Names
    references: Names
    conditions: Names


class Bands(Section):
    """Closed-loop amplitude and phase, one run for each controller, axis and frequency."""

    controllers: tuple[Text, ...]
    condition: Text
    """Name of a condition."""
    axes: tuple[Literal["roll", "pitch", "yaw", "X", "Y", "Z"], ...] = ("Z", "roll")
    """One after the other."""
    frequencies: tuple[Annotated[Positive, Field(le=100.0)], ...] = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
    """[Hz]"""
    largest_angle: Positive = 0.05
    """[rad] amplitude, where half of the largest feasible one is not less."""
    largest_travel: Positive = 0.005
    """[m] amplitude, where half of the largest feasible one is not less."""
    transient: NotNegative = 3.0
    """[s] before the fit begins."""
    window: Positive = 1.0
    """[s] of the fit at least, in whole periods."""


class TuneOptions(Section, key="tune"):
    """Keys of controllers, searched by CMA-ES in their logarithms for the least cost over the comparison's own runs."""

    controllers: dict[Text, dict[Text, PositivePair]]
    """Name -> (scenario key -> lowest and highest value). The search starts from what the controller has."""
    generations: Annotated[Count, Field(ge=1, le=10_000)] = 12
    """Most of them, each of `population` settings; fewer where the search has converged."""
    population: Annotated[Count, Field(ge=4, le=1000)] = 8
    """Settings of a generation, the same for all controllers."""
    spread: Fraction = 0.2
    """Standard deviation of the first generation, as a share of the way from lowest to highest."""
    seed: Annotated[Seed, Field(lt=2**32)] = 1
    """Of the search."""
    seeds: Annotated[tuple[Seed, ...], Field(min_length=1)] = (1,)
    """In place of the comparison's own: of the noise in the runs of the search."""
    set: dict[Text, Any] = Field(default_factory=dict)
    """Scenario key -> value, in the runs of the search alone."""

    def rules(self) -> None:
        if not self.controllers:
            raise ConfigurationError("controllers", {}, "at least one name, with the keys to search")
        for name, keys in self.controllers.items():
            if not keys:
                allowed = "at least one scenario key, with its lowest and highest value"
                raise ConfigurationError(f"controllers.{name}", {}, allowed)
            for key, (low, high) in keys.items():
                if not low < high:
                    raise ConfigurationError(f"controllers.{name}.{key}", [low, high], "a lowest below a highest value")


class TunedFile(Section, key=""):
    """What a search has found."""

    name: Text
    """Of the comparison."""
    controllers: dict[Text, dict[Text, Positive]]
    """Name -> (scenario key -> value)."""

    @classmethod
    def load(cls, path: Path, names: Collection[str]) -> dict[str, dict[str, float]]:
        """Values by controller and key; ConfigurationError for a controller that is not among `names`."""
        if not path.is_file():
            raise ConfigurationError("tuned", str(path), "a file as `stewart-drake tune` writes it")
        found = cls.from_dict(read_mapping("tuned", path, 80), "tuned").controllers
        for name in found:
            if name not in names:
                raise ConfigurationError("tuned.controllers", name, f"one of {', '.join(names)}")
        return found


class CompareFile(StudyFile):
    """Keys of a comparison file."""

    name: StudyName = "comparison"
    controllers: dict[Text, dict[Text, Any]]
    """Name -> (scenario key -> value)."""
    references: dict[Text, dict[Text, Any]]
    """Name -> (scenario key -> value); `duration` and `initial_offset` go well here."""
    conditions: dict[Text, dict[Text, Any]] = Field(default_factory=lambda: {"nominal": dict[str, Any]()})
    """Name -> (scenario key -> value), changed last."""
    best_of: dict[Text, BestOf] = Field(default_factory=dict)
    """Name -> the controllers that it is the best of."""
    runs: Annotated[tuple[Product, ...], Field(min_length=1)] | None = None
    """What is run, at least one; null for all controllers on all references under all conditions."""
    seeds: Annotated[tuple[Seed, ...], Field(min_length=1)] = (0,)
    """A run with the text {seed} among its values is done once with each, any other once with the first."""
    layout: Literal["rows", "grid"] = "rows"
    """Of the Markdown: a row a run, or a table for each condition with a column for each reference."""
    band: Positive = 0.5
    """[mm] of pose error, rotations times the characteristic length, within which a run counts as settled."""
    traced: Text | None = None
    """Reference whose error over time is drawn; null for the first."""
    bands: Bands | None = None
    """Tracked frequencies; null for none."""
    cost: CostScales | None = None
    """Scales of the cost of a run; null for no cost."""
    tune: TuneOptions | None = None
    """What `stewart-drake tune` searches; null for nothing."""
    tuned: Text | None = None
    """File, relative to this one, with values for keys of controllers, as `stewart-drake tune` writes it; `tune` itself
    starts without them. Null for none."""
    quick: Positive = 1.5
    """[s] longest run under `--quick`, which also leaves but two of the frequencies."""


@dataclass(frozen=True, eq=False)
class Cell:
    """One run.

    Attributes:
        controller: Its name.
        reference: Its name; of a band, the axis.
        condition: Its name.
        seed: What {seed} became.
        changes: Scenario key -> value.
        frequency: [Hz] of a band; None for a run of the table.
        amplitude: [rad] or [m] of a band.
        window: [s] at the end of a band's run, over which it is fitted; whole periods.
    """

    controller: str
    reference: str
    condition: str
    seed: int
    changes: Mapping[str, Any]
    frequency: float | None = None
    amplitude: float | None = None
    window: float = 0.0


@dataclass(frozen=True, eq=False)
class Comparison(Study):
    """What is compared.

    Attributes:
        file: Keys of the file.
        cells: Runs of the table, then bands.
    """

    file: CompareFile
    cells: tuple[Cell, ...]
    kind = "comparison"
    products = (
        *(f"{name}.{ending}" for name in ("comparison", "bands") for ending in ("parquet", "csv")),
        *("comparison.md", *(f"{name}.png" for name in PICTURES)),
    )

    @classmethod
    def from_dict(
        cls, data: Mapping[str, Any], folder: Path | None = None, quick: bool = False, robot: str | None = None
    ) -> Comparison:
        """A comparison from plain values, see `CompareFile`; every scenario of it is checked.

        Args:
            data: Keys and values.
            folder: Paths in `data` are relative to it; None for the current folder.
            quick: Shorter, see `CompareFile.quick`.
            robot: Name or YAML file: all motions and loads in its size, see `sized`; None for the file's own.
        """
        file, base = CompareFile.read("comparison", data, folder)
        parts = {kind: getattr(file, kind) for kind in _KINDS}
        _check_names(file, parts)
        if file.tuned is not None:
            if robot is not None:
                raise ConfigurationError(
                    "--robot", robot, "no value: the gains in `tuned` are for the scenario's robot"
                )
            tuned = TunedFile.load((folder or Path()) / file.tuned, parts["controllers"])
            parts["controllers"] = {name: {**keys, **tuned.get(name, {})} for name, keys in file.controllers.items()}
        if robot is not None:
            base = base.replace({"robot": robot})
            base = base.replace(sized({"reference": to_plain(base.reference)}, base))
            # One at a time: a motion is fitted for its own duration.
            parts = {kind: {name: sized(keys, base) for name, keys in each.items()} for kind, each in parts.items()}
        cells = _table_cells(file, base, parts, quick)
        if file.bands is not None:
            cells += _band_cells(file, file.bands, base, parts, quick)
        if len(cells) > MAX_RUNS:
            raise ConfigurationError("runs", f"{len(cells)} runs", f"at most {MAX_RUNS}")
        return cls(base, file, tuple(cells), runs=len(cells), name=file.name)

    @property
    def traced(self) -> str:
        """Reference whose error over time is drawn."""
        return self.file.traced or self.cells[0].reference

    def run_seed(self, index: int) -> int:
        return self.cells[index].seed

    def draw(self, index: int) -> dict[str, Any]:
        return {"run": index}

    def changes(self, drawn: Mapping[str, Any]) -> Mapping[str, Any]:
        return self.cells[drawn["run"]].changes

    def measure(self, index: int) -> Measure:
        cell = self.cells[index]
        if cell.frequency is None:
            return partial(measure_run, band=self.file.band, scales=self.file.cost)
        return partial(measure_band, frequency=cell.frequency, axis=AXIS_NUMBERS[cell.reference], window=cell.window)

    def variants(self) -> list[Scenario]:
        """One for each setting of what can name a file, in which times and numbers differ."""
        different: dict[str, int] = {}
        for index, cell in enumerate(self.cells):
            named = {key: value for key, value in cell.changes.items() if not isinstance(value, (int, float))}
            different.setdefault(json.dumps(named, sort_keys=True), index)
        return [self.scenario(index) for index in different.values()]

    def tables(self, rows: Sequence[Row]) -> dict[str, tuple[Sequence[Column], list[Row]]]:
        columns = table_columns(*self.variants(), cost=self.file.cost is not None)
        return {
            "comparison": (columns, table_rows(self, rows)),
            "bands": (BANDS, band_rows(self, rows)),
        }

    def page(self, tables: Mapping[str, list[Row]]) -> str:
        return "\n".join(sheet.markdown() for sheet in sheets(self, tables["comparison"], tables["bands"]))

    def to_dict(self) -> dict[str, Any]:
        """All that the rows depend on, in plain types."""
        return {
            "scenario": self.base.to_dict(),
            "band": self.file.band,
            "cost": None if self.file.cost is None else self.file.cost.to_dict(),
            "cells": [dataclasses.asdict(cell) for cell in self.cells],
        }


def load_comparison(
    path: str | Path, quick: bool = False, robot: str | None = None, trust_code: bool = False
) -> Comparison:
    """Reads a comparison file, or a comparison of the package by its name; see `Comparison.from_dict`."""
    path = find_file("comparison", path)
    data = read_mapping("comparison", path, 80)
    with trusting_code(trust_code):
        return Comparison.from_dict(data, path.parent, quick, robot)


_Parts = Mapping[str, Mapping[str, Mapping[str, Any]]]


def _check_names(file: CompareFile, parts: _Parts) -> None:
    def known(where: str, names: Sequence[str], kind: str, others: Sequence[str] = ()) -> None:
        allowed = [*parts[kind], *others]
        for name in names:
            if name not in allowed:
                raise ConfigurationError(where, name, f"one of {', '.join(allowed)}")

    for kind, entries in {**parts, "best_of": file.best_of}.items():
        if not entries and kind != "best_of":
            raise ConfigurationError(kind, {}, "at least one name, with the scenario keys that it changes")
        for name in entries:
            if _NAME.fullmatch(name) is None:
                raise ConfigurationError(kind, name, "names of 1 to 80 characters, without |")
    for name, best in file.best_of.items():
        if name in parts["controllers"]:
            raise ConfigurationError(f"best_of.{name}", name, "a name that no controller has")
        known(f"best_of.{name}.of", best.of, "controllers")
    for index, product in enumerate(file.runs or ()):
        for kind in _KINDS:
            others = list(file.best_of) if kind == "controllers" else ()
            known(f"runs.{index}.{kind}", getattr(product, kind), kind, others)
    if file.traced is not None:
        known("traced", [file.traced], "references")
    if file.bands is not None:
        known("bands.controllers", file.bands.controllers, "controllers")
        known("bands.condition", [file.bands.condition], "conditions")


def _table_cells(file: CompareFile, base: Scenario, parts: _Parts, quick: bool) -> list[Cell]:
    names = [tuple(parts[kind]) for kind in _KINDS]
    products = file.runs or (Product(controllers=names[0], references=names[1], conditions=names[2]),)
    found: dict[tuple[str, str, str], None] = {}
    for product in products:
        controllers = [
            one for name in product.controllers for one in (file.best_of[name].of if name in file.best_of else (name,))
        ]
        found |= dict.fromkeys(itertools.product(controllers, product.references, product.conditions))
    cells = []
    for controller, reference, condition in found:
        changes = {
            **parts["references"][reference],
            **parts["controllers"][controller],
            **parts["conditions"][condition],
        }
        for seed in file.seeds if _with_seed(changes, 0) != changes else file.seeds[:1]:
            seeded = {key: _with_seed(value, seed) for key, value in changes.items()}
            scenario = _checked(base, seeded, f"{controller}, {reference}, {condition}")
            if quick:
                seeded["duration"] = min(scenario.duration, file.quick)
            cells.append(Cell(controller, reference, condition, seed, seeded))
    return cells


def _band_cells(file: CompareFile, bands: Bands, base: Scenario, parts: _Parts, quick: bool) -> list[Cell]:
    frequencies = sorted(set(bands.frequencies))
    transient = bands.transient
    if quick:
        frequencies = [f for f in frequencies if f >= 1.0][-_QUICK_FREQUENCIES:] or frequencies[-1:]
        transient = min(transient, 0.5)
    plain = _checked(base, parts["conditions"][bands.condition], f"bands, {bands.condition}")
    middle = plain.robot.home_pose
    cells = []
    for axis, frequency in itertools.product(bands.axes, frequencies):
        most = largest_amplitude(plain.robot, plain.limits, AXIS_NUMBERS[axis], frequency, plain.gravity)
        cap = bands.largest_angle if AXIS_NUMBERS[axis] < 3 else bands.largest_travel
        amplitude = min(cap, 0.5 * most)
        if amplitude <= 0.0:
            raise ConfigurationError("bands.frequencies", frequency, f"frequencies at which {axis} can move at all")
        size = np.zeros(6)
        size[AXIS_NUMBERS[axis]] = amplitude
        omega = 2.0 * math.pi * frequency
        reference = {
            "kind": "sine",
            "center": middle.tolist(),
            "amplitude": size.tolist(),
            "angular_frequency": [omega] * 6,
        }
        window = math.ceil(bands.window * frequency - 1e-9) / frequency
        for controller in bands.controllers:
            changes = {**parts["controllers"][controller], **parts["conditions"][bands.condition]}
            changes |= {"reference": reference, "duration": transient + window}
            seeded = {key: _with_seed(value, file.seeds[0]) for key, value in changes.items()}
            _checked(base, seeded, f"bands, {controller}, {axis}, {frequency:g} Hz")
            cells.append(Cell(controller, axis, bands.condition, file.seeds[0], seeded, frequency, amplitude, window))
    return cells


def _checked(base: Scenario, changes: Mapping[str, Any], what: str) -> Scenario:
    try:
        return vary(base, changes)
    except ConfigurationError as error:
        raise error.within(f"{what}: ") from None


def _with_seed(value: Any, seed: int) -> Any:
    if isinstance(value, Mapping):
        return {key: _with_seed(item, seed) for key, item in value.items()}
    if isinstance(value, list):
        return [_with_seed(item, seed) for item in value]
    return seed if value == SEED else value
