"""A comparison: controllers on references under conditions, best of several, bands; its tables and pictures."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from stewart_drake.config import to_plain
from stewart_drake.errors import ConfigurationError
from stewart_drake.files.whole import locked_folder
from stewart_drake.files.yaml_files import read_mapping
from stewart_drake.logs.metrics import FAILED, OUTCOME, Column, mean_cost
from stewart_drake.logs.metrics import columns as run_columns
from stewart_drake.logs.outcomes import told
from stewart_drake.planning.feasibility import largest_amplitude
from stewart_drake.scenario import Scenario
from stewart_drake.studies.comparison_file import KINDS, Bands, CompareFile, TunedFile, check_names
from stewart_drake.studies.robots import sized
from stewart_drake.studies.runs import Measure, Row, Task, measure_band, measure_run
from stewart_drake.studies.study import Sheet, Study, StudyResult, Tables, load_study, number, vary, within

SEED = "{seed}"
AXES = ("roll", "pitch", "yaw", "X", "Y", "Z")
LARGEST = (0.05,) * 3 + (0.005,) * 3
"""[rad, m] amplitude of a band, where half of the largest feasible one is not less."""
_QUICK_FREQUENCIES, _WINDOW = 2, 1.0
_Parts = Mapping[str, Mapping[str, Mapping[str, Any]]]


class Cell(NamedTuple):
    """One run; of a band, with frequency [Hz], amplitude [rad or m] and window [s], the reference is the axis."""

    controller: str
    reference: str
    condition: str
    seed: int
    changes: Mapping[str, Any]
    frequency: float | None = None
    amplitude: float | None = None
    window: float = 0.0


_NAMES = (
    Column("controller", "", "name of the controller", "text"),
    Column("chosen", "", "in a best-of row: the controller that is best here", "text"),
    Column("reference", "", "name of the reference; for a frequency response, the axis", "text"),
    Column("condition", "", "name of the condition", "text"),
    Column("seed", "", "value of {seed}", "whole"),
)
_SETTLING = Column("settling_s", "s", "time after which the pose error is within the comparison's band; null for never")
_COST = Column("cost", "1", f"J, see `cost` in the comparison; {FAILED:g} for a run that was not completed")
BANDS = (
    *_NAMES,
    *OUTCOME,
    Column("frequency_hz", "Hz", "frequency of the reference sine"),
    Column("amplitude", "rad or m", "amplitude of the reference sine"),
    Column("ratio", "1", "amplitude of the pose over that of the reference"),
    Column("phase_deg", "deg", "phase of the pose relative to the reference, negative for a lag"),
    Column("rest", "1", "RMS of the pose at other frequencies, relative to the RMS of the sine"),
)


@dataclass(frozen=True, eq=False)
class Comparison(Study):
    file: CompareFile
    cells: tuple[Cell, ...]
    kind = "comparison"

    @classmethod
    def from_dict(
        cls, data: Mapping[str, Any], folder: Path | None = None, quick: bool = False, robot: str | None = None
    ) -> Comparison:
        """From plain values of a `CompareFile`; paths relative to `folder`, motions in the size of `robot`."""
        file, base = CompareFile.read("comparison", data, folder)
        parts = {kind: getattr(file, kind) for kind in KINDS}
        if file.tuned is not None:
            if robot is not None:
                allowed = "no value: the gains in `tuned` are for the scenario's robot"
                raise ConfigurationError("--robot", robot, allowed)
            data = read_mapping("tuned", (folder or Path()) / file.tuned, 80)
            tuned = TunedFile.from_dict(data, "tuned").controllers
            check_names("tuned.controllers", tuned, file.controllers)
            parts["controllers"] = {name: {**keys, **tuned.get(name, {})} for name, keys in file.controllers.items()}
        if robot is not None:
            base = base.replace({"robot": robot})
            base = base.replace(sized({"reference": to_plain(base.reference)}, base))
            # One at a time: a motion is fitted for its own duration.
            parts = {kind: {name: sized(keys, base) for name, keys in each.items()} for kind, each in parts.items()}
        cells = _table_cells(file, base, parts, quick)
        if file.bands is not None:
            cells += _band_cells(file.bands, file.seeds[0], base, parts, quick)
        return cls(base, file, tuple(cells), name=file.name, indices=range(len(cells)))

    def task(self, index: int) -> Task:
        cell = self.cells[index]
        how: Measure = partial(measure_run, band=self.file.band, scales=self.file.cost)
        if cell.frequency is not None:
            axis = AXES.index(cell.reference)
            how = partial(measure_band, frequency=cell.frequency, axis=axis, window=cell.window)
        return self._task(index, cell.changes, cell.seed, measure=how)

    @cached_property
    def variants(self) -> list[Scenario]:
        different = {cell[:3]: index for index, cell in enumerate(self.cells)}
        return [self.scenario(index) for index in different.values()]

    @property
    def work(self) -> dict[str, Any]:
        return {
            "scenario": self.base.to_dict(),
            "band": self.file.band,
            "cost": None if self.file.cost is None else self.file.cost.to_dict(),
            "cells": [cell._asdict() for cell in self.cells],
        }

    @property
    def columns(self) -> tuple[Column, ...]:
        return (*_NAMES, *run_columns(*self.variants), _SETTLING, *(() if self.file.cost is None else (_COST,)))

    def tables(self, rows: Sequence[Row]) -> Tables:
        """Of the runs, with a best of several before those that it is chosen from; and of the bands."""
        runs: list[Row] = []
        bands: list[Row] = []
        for row in rows:
            cell = self.cells[row["index"]]
            named = {**row, **cell._asdict(), "chosen": None, "frequency_hz": cell.frequency}
            if self.file.cost is not None:
                named.setdefault("cost", FAILED)  # a run that was refused or broke has no figures at all
            (runs if cell.frequency is None else bands).append(named)
        best_rows: list[Row] = []
        for name, best in self.file.best_of.items():
            own = [row for row in runs if row["controller"] in best.of]
            for group in _groups(own, "reference", "condition", "seed").values():
                if {row["controller"] for row in group} == set(best.of):
                    chosen = min(group, key=_rank)
                    best_rows.append({**chosen, "controller": name, "chosen": chosen["controller"]})
        return {"comparison": (self.columns, best_rows + runs), "bands": (BANDS, bands)}

    def shown(self, rows: Sequence[Row]) -> list[Row]:
        products = self.file.products
        asked = {
            key for each in products for key in itertools.product(each.controllers, each.references, each.conditions)
        }
        names = dict.fromkeys(name for each in products for name in each.controllers)
        own = [row for row in rows if (row["controller"], row["reference"], row["condition"]) in asked]
        return [row for name in names for row in own if row["controller"] == name]

    def sheets(self, rows: Mapping[str, list[Row]]) -> list[Sheet]:
        """The tables that are read: of several seeds the worst number."""
        runs, sheets = self.shown(rows["comparison"]), []
        figures = dict(_FIGURES)
        if self.file.cost is not None:
            figures["cost"] = "cost"
            title = f"cost: mean of the runs; {FAILED:g} for one that was not completed"
            sheets.append(_pivot(title, runs, "condition", _mean_cost, [("all", _mean_cost)]))
        if self.file.layout == "rows":
            lines = []
            for key, group in _groups(runs, "controller", "reference", "condition").items():
                shown, failure = [_worst(group, column) for column in figures.values()], _failure(group)
                if failure is not None:
                    shown = [failure, *(shown[1:] if _only_lost(group) else ["-"] * (len(shown) - 1))]
                lines.append((key[0] + _chosen(group), *key[1:], *shown))
            header = ("controller", "motion", "condition", *figures)
            sheets.append(Sheet(f"{self.name}: RMSE and peak of the length of the error, {_LATE}", header, lines))
        else:
            over_all = [(heading, partial(_worst_done, column)) for heading, column in list(_FIGURES.items())[4:]]
            for condition, group in _groups(runs, "condition").items():
                title = f"{condition[0]}: RMSE {_LATE}, rotation and position; then the worst of all motions"
                sheets.append(_pivot(title, group, "reference", _errors, [*over_all, ("not completed", _missed)]))
        for axis, group in _groups(rows["bands"], "reference").items():
            title = f"{axis[0]}: amplitude ratio and phase, pose to reference"
            sheets.append(_pivot(title, group, "frequency_hz", _band))
        return sheets

    def page(self, rows: Mapping[str, list[Row]]) -> str:
        return "\n".join(sheet.markdown() for sheet in self.sheets(rows))


def load_comparison(path: str | Path, quick: bool = False, robot: str | None = None) -> Comparison:
    return load_study("comparison", path, partial(Comparison.from_dict, quick=quick, robot=robot))


def write_pictures(comparison: Comparison, result: StudyResult) -> None:
    # matplotlib takes a second to load.
    from stewart_drake.plotting import save_figure
    from stewart_drake.plotting.study_plots import plot_bands, plot_error, plot_rmse

    rows, bands = comparison.shown(result.rows["comparison"]), result.rows["bands"]
    figures = {"rmse": partial(plot_rmse, rows)}
    traced = [row for row in rows if row["reference"] == (comparison.file.traced or comparison.cells[0].reference)]
    if any("trace" in row for row in traced):
        figures["error"] = partial(plot_error, traced, comparison.file.band)
    if any(row.get("ratio") is not None for row in bands):
        figures["bands"] = partial(plot_bands, bands)
    with locked_folder(result.folder):
        for name, draw in figures.items():
            save_figure(draw(), result.folder / f"{name}.png")


# --- runs ---


def _table_cells(file: CompareFile, base: Scenario, parts: _Parts, quick: bool) -> list[Cell]:
    names: dict[tuple[str, ...], None] = {}
    for product in file.products:
        members = (file.best_of[name].of if name in file.best_of else (name,) for name in product.controllers)
        controllers = itertools.chain(*members)
        names |= dict.fromkeys(itertools.product(controllers, product.references, product.conditions))
    cells = []
    for controller, reference, condition in names:
        changes = {
            **parts["references"][reference],
            **parts["controllers"][controller],
            **parts["conditions"][condition],
        }
        for seed in file.seeds if _with_seed(changes, 0) != changes else file.seeds[:1]:
            seeded = _with_seed(changes, seed)
            with within(f"{controller}, {reference}, {condition}: "):
                duration = vary(base, seeded).duration
            if quick:
                seeded["duration"] = min(duration, file.quick)
            cells.append(Cell(controller, reference, condition, seed, seeded))
    return cells


def _band_cells(bands: Bands, seed: int, base: Scenario, parts: _Parts, quick: bool) -> list[Cell]:
    frequencies, transient = sorted(set(bands.frequencies)), bands.transient
    if quick:
        frequencies = [f for f in frequencies if f >= 1.0][-_QUICK_FREQUENCIES:] or frequencies[-1:]
        transient = min(transient, 0.5)
    condition = parts["conditions"][bands.condition]
    with within(f"bands, {bands.condition}: "):
        plain = vary(base, condition)
    cells = []
    for axis, frequency in itertools.product(bands.axes, frequencies):
        place = AXES.index(axis)
        most = largest_amplitude(plain.robot, plain.limits, place, frequency, plain.gravity)
        amplitude = min(LARGEST[place], 0.5 * most)
        if amplitude <= 0.0:
            raise ConfigurationError(
                "bands.frequencies", frequency, f"frequencies at which {axis} can move within the limits"
            )
        reference = {
            "kind": "sine",
            "center": plain.robot.home_pose.tolist(),
            "amplitude": (amplitude * np.eye(6)[place]).tolist(),
            "angular_frequency": [2.0 * math.pi * frequency] * 6,
        }
        window = math.ceil(_WINDOW * frequency - 1e-9) / frequency
        for name in bands.controllers:
            changes = {**parts["controllers"][name], **condition, "reference": reference}
            changes = _with_seed({**changes, "duration": transient + window}, seed)
            with within(f"bands, {name}, {axis}, {frequency:g} Hz: "):
                vary(base, changes)
            cells.append(Cell(name, axis, bands.condition, seed, changes, frequency, amplitude, window))
    return cells


def _with_seed(value: Any, seed: int) -> Any:
    if isinstance(value, Mapping):
        return {key: _with_seed(item, seed) for key, item in value.items()}
    if isinstance(value, list):
        return [_with_seed(item, seed) for item in value]
    return seed if value == SEED else value


# --- lines of tables ---


_LATE = "over the second half of the planned duration"
_FIGURES = {
    "RMSE [deg]": "rmse_norm_deg",
    "RMSE [mm]": "rmse_norm_mm",
    "worst half [mm]": "worst_half_rmse_norm_mm",
    "peak [mm]": "peak_norm_mm",
    "settled [s]": "settling_s",
    "torque RMS [N m]": "torque_rms_second_half",
    "change per tick [N m]": "torque_change_rms",
    "at the limit": "saturated_fraction",
}
"""Heading -> column of what is shown of a run; a grid has the last four over all motions."""


def _groups(rows: Sequence[Row], *columns: str) -> dict[tuple[Any, ...], list[Row]]:
    groups: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(row[column] for column in columns), []).append(row)
    return groups


def _pivot(
    title: str,
    rows: Sequence[Row],
    column: str,
    show: Callable[[Sequence[Row]], str],
    more: Sequence[tuple[str, Callable[[Sequence[Row]], str]]] = (),
) -> Sheet:
    cells, lines = _groups(rows, "controller", column), []
    values = [key[0] for key in _groups(rows, column)]
    for (name,), own in _groups(rows, "controller").items():
        texts = [show(cells[name, value]) if (name, value) in cells else "-" for value in values]
        lines.append((name, *texts, *(figure(own) for _, figure in more)))
    headings = [f"{value:g} Hz" if isinstance(value, float) else value for value in values]
    return Sheet(title, ("controller", *headings, *(heading for heading, _ in more)), lines)


def _rank(row: Row) -> tuple[bool, float]:
    """Smallest for the best: the smallest error, and where all have failed the one that got furthest."""
    if row["status"] == "completed" and row.get("pose_rmse_mm") is not None:
        return False, float(row["pose_rmse_mm"])
    return True, -float(row.get("end_time") or 0.0)


def _mean_cost(group: Sequence[Row]) -> str:
    return number(mean_cost(row["cost"] for row in group))


def _worst(group: Sequence[Row], column: str) -> str:
    values: list[Any] = [row.get(column) for row in group]
    return number(max(values, default=None) if None not in values else None)


def _worst_done(column: str, group: Sequence[Row]) -> str:
    return _worst([row for row in group if row["status"] == "completed"], column)


def _missed(group: Sequence[Row]) -> str:
    return f"{sum(row['status'] != 'completed' for row in group)} of {len(group)}"


def _failure(group: Sequence[Row]) -> str | None:
    failed = [row for row in group if row["status"] != "completed"]
    if not failed:
        return None
    words = told(failed[0]["status"], failed[0]["reason"], failed[0].get("outcome_time"))
    return f"{words}, {_missed(group)} runs" if len(group) > 1 else words


def _only_lost(group: Sequence[Row]) -> bool:
    return all(row["status"] in ("completed", "lost") for row in group)


def _chosen(group: Sequence[Row]) -> str:
    names = dict.fromkeys(row["chosen"] for row in group if row["chosen"])
    return f" ({', '.join(names)})" if names else ""


def _errors(group: Sequence[Row]) -> str:
    figures = f"{_worst(group, 'rmse_norm_deg')}° {_worst(group, 'rmse_norm_mm')} mm{_chosen(group)}"
    failure = _failure(group)
    return failure if failure and not _only_lost(group) else "; ".join(filter(None, (failure, figures)))


def _band(group: Sequence[Row]) -> str:
    row = group[0]
    return _failure(group) or "-" if row.get("ratio") is None else f"{row['ratio']:.4f}, {row['phase_deg']:+.1f}°"
