"""A comparison of controllers over references and conditions: its runs, tables and figures."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from stewart_drake.analysis.feasibility import largest_amplitude
from stewart_drake.base.config import to_plain
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.families import given_keys
from stewart_drake.base.markdown import TextTable, number
from stewart_drake.base.tables import COORDINATES
from stewart_drake.base.yaml_files import read_mapping
from stewart_drake.logs.metrics import FAILED, OUTCOME, Column, mean_cost
from stewart_drake.logs.metrics import columns as run_columns
from stewart_drake.logs.outcomes import describe_outcome
from stewart_drake.scenario.scenario import Scenario
from stewart_drake.studies.comparison_file import KINDS, Bands, CompareFile, TunedFile, check_names
from stewart_drake.studies.experiment import (
    Experiment,
    Figures,
    Show,
    Tables,
    error_prefix,
    grouped,
    load_experiment,
    not_completed,
    pivot,
    refusals,
    trial_of,
    with_changes,
    worst,
)
from stewart_drake.studies.robots import scale_to_robot
from stewart_drake.studies.runs import Measure, Row, measure_response, measure_tracking

SEED = "{seed}"
NAMES = ("controller", "reference", "condition", "seed")
MAX_AMPLITUDE = (0.05,) * 3 + (0.005,) * 3
"""[rad, m] Amplitude for frequency responses; half of the largest feasible one, if that is less."""
_QUICK_FREQUENCIES = 2  # Frequencies under `--quick`.
_MIN_WINDOW = 1.0  # [s] of the fit, rounded up to whole periods.
_Keys = dict[str, object]  # Scenario key -> value.
_Parts = Mapping[str, Mapping[str, Mapping[str, object]]]  # Kind -> name -> scenario key -> value.
_Run = tuple[_Keys, dict[str, object], Measure]  # Changes, labels, and measure.

_NAMES = (
    Column("controller", "", "name of the controller", "text"),
    Column("chosen", "", "in a best-of row: the best controller for this reference, condition and seed", "text"),
    Column("reference", "", "name of the reference; for a frequency response, the axis", "text"),
    Column("condition", "", "name of the condition", "text"),
    Column("seed", "", "value of {seed}", "integer"),
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


@dataclass(frozen=True, eq=False, kw_only=True)
class Comparison(Experiment):
    file: CompareFile

    @classmethod
    def from_dict(
        cls,
        data: Mapping[str, object],
        folder: Path | None = None,
        quick: bool = False,
        robot: str | None = None,
        trust_code: bool = False,
    ) -> Comparison:
        """Comparison of the plain values of a `CompareFile`; paths relative to `folder`, motions scaled to `robot`."""
        file, base = CompareFile.read("comparison", data, folder, trust_code)
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
            base = base.replace(scale_to_robot({"reference": to_plain(base.reference)}, base))
            # Groups of keys are scaled one by one, because a motion is fitted for the duration in its group.
            parts = {
                kind: {name: scale_to_robot(keys, base) for name, keys in named.items()}
                for kind, named in parts.items()
            }
        runs = _tracking_runs(file, base, parts, quick)
        if file.bands is not None:
            runs += _response_runs(file.bands, file.seeds[0], base, parts, quick)
        given = given_keys(base)
        trials = [
            trial_of(given, index, f"{file.name} {index}", *run, trust_code=trust_code)
            for index, run in enumerate(runs)
        ]
        different = {tuple(trial.labels[name] for name in NAMES[:3]): trial for trial in trials}
        variants = [trial.scenario() for trial in different.values()]
        columns = (*_NAMES, *run_columns(*variants), _SETTLING, *(() if file.cost is None else (_COST,)))
        cost = None if file.cost is None else file.cost.to_dict()
        cells = [{**trial.labels, "changes": trial.changes} for trial in trials]
        return cls(
            kind="comparison",
            name=file.name,
            base=base,
            trials=trials,
            columns=columns,
            work={"scenario": base.to_dict(), "band": file.band, "cost": cost, "cells": cells},
            variants=variants,
            file=file,
        )

    def tables(self, rows: list[Row]) -> Tables:
        """Tables of the runs, best-of rows first, and of the frequency responses."""
        runs = [{**row, "chosen": None} for row in rows if "frequency_hz" not in row]
        bands = [row for row in rows if "frequency_hz" in row]
        best_rows: list[Row] = []
        for name, best in self.file.best_of.items():
            candidates = [row for row in runs if row["controller"] in best.of]
            for group in grouped(candidates, "reference", "condition", "seed").values():
                if {row["controller"] for row in group} == set(best.of):
                    chosen = min(group, key=_rank)
                    best_rows.append({**chosen, "controller": name, "chosen": chosen["controller"]})
        return {"comparison": (self.columns, best_rows + runs), "bands": (BANDS, bands)}

    def shown(self, rows: Sequence[Row]) -> list[Row]:
        products = self.file.products
        requested = {key for item in products for key in item.combinations()}
        names = dict.fromkeys(name for item in products for name in item.controllers)
        by_name = grouped((row for row in rows if tuple(row[name] for name in NAMES[:3]) in requested), "controller")
        return [row for name in names for row in by_name.get((name,), ())]

    def sheets(self, rows: Mapping[str, list[Row]]) -> list[TextTable]:
        """Tables for a reader, with the worst number of several seeds."""
        runs, sheets = self.shown(rows["comparison"]), []
        figures = dict(_FIGURES)
        if self.file.cost is not None:
            figures["cost"] = "cost"
            title = f"cost: mean of the runs; {FAILED:g} for one that was not completed"
            sheets.append(pivot(title, runs, "controller", "condition", _mean_cost, {"all": _mean_cost}))
        if self.file.layout == "rows":
            lines = []
            for key, group in grouped(runs, "controller", "reference", "condition").items():
                shown, failure = [worst(group, column) for column in figures.values()], _failure(group)
                if failure is not None:
                    shown = [failure, *(shown[1:] if _only_lost(group) else ["-"] * (len(shown) - 1))]
                lines.append((key[0] + _chosen(group), *key[1:], *shown))
            header = ("controller", "motion", "condition", *figures)
            title = f"{self.name}: RMSE and peak of the length of the error, {_LATE}"
            sheets.append(TextTable(title, header, lines, refusals(runs)))
        else:
            over_all: dict[str, Show] = {
                heading: lambda group, column=column: worst(  # type: ignore[misc]
                    (row for row in group if row["status"] == "completed"), column
                )
                for heading, column in list(_FIGURES.items())[-4:]
            }
            over_all["not completed"] = _missed
            for condition, group in grouped(runs, "condition").items():
                title = f"{condition[0]}: RMSE {_LATE}, rotation and position; then the worst of all motions"
                sheets.append(pivot(title, group, "controller", "reference", _errors, over_all))
        for axis, group in grouped(rows["bands"], "reference").items():
            title = f"{axis[0]}: amplitude ratio and phase, pose to reference"
            sheets.append(pivot(title, group, "controller", "frequency_hz", _band))
        return sheets

    def page(self, rows: Mapping[str, list[Row]]) -> str:
        return "\n".join(sheet.markdown() for sheet in self.sheets(rows))

    def figures(self, rows: Mapping[str, list[Row]]) -> Figures:
        # Here, because matplotlib takes a second to load.
        from stewart_drake.plotting.study_plots import plot_bands, plot_error, plot_rmse

        runs, bands = self.shown(rows["comparison"]), rows["bands"]
        figures = {"rmse": partial(plot_rmse, runs)}
        reference = self.file.traced or self.trials[0].labels["reference"]
        traced = [row for row in runs if row["reference"] == reference]
        if any("trace" in row for row in traced):
            figures["error"] = partial(plot_error, traced, self.file.band)
        if any(row.get("ratio") is not None for row in bands):
            figures["bands"] = partial(plot_bands, bands)
        return figures


def load_comparison(
    path: str | Path, quick: bool = False, robot: str | None = None, trust_code: bool = False
) -> Comparison:
    make = partial(Comparison.from_dict, quick=quick, robot=robot, trust_code=trust_code)
    return load_experiment("comparison", path, make)


# --- runs ---


def _tracking_runs(file: CompareFile, base: Scenario, parts: _Parts, quick: bool) -> list[_Run]:
    names: dict[tuple[str, ...], None] = {}
    for product in file.products:
        members = (file.best_of[name].of if name in file.best_of else (name,) for name in product.controllers)
        controllers = itertools.chain(*members)
        names |= dict.fromkeys(itertools.product(controllers, product.references, product.conditions))
    measure = partial(measure_tracking, band=file.band, scales=file.cost)
    # A run that was refused or raised an error has no other figures.
    cost = {} if file.cost is None else {"cost": FAILED}
    runs: list[_Run] = []
    for controller, reference, condition in names:
        changes = {
            **parts["references"][reference],
            **parts["controllers"][controller],
            **parts["conditions"][condition],
        }
        for seed in file.seeds if _seeded(changes, 0) != changes else file.seeds[:1]:
            seeded = _seeded(changes, seed)
            with error_prefix(f"{controller}, {reference}, {condition}: "):
                duration = with_changes(base, seeded).duration
            if quick:
                seeded["duration"] = min(duration, file.quick)
            labels = dict(zip(NAMES, (controller, reference, condition, seed), strict=True))
            runs.append((seeded, {**labels, **cost}, measure))
    return runs


def _response_runs(bands: Bands, seed: int, base: Scenario, parts: _Parts, quick: bool) -> list[_Run]:
    frequencies, transient = sorted(set(bands.frequencies)), bands.transient
    if quick:
        frequencies = [f for f in frequencies if f >= 1.0][-_QUICK_FREQUENCIES:] or frequencies[-1:]
        transient = min(transient, 0.5)
    condition = parts["conditions"][bands.condition]
    with error_prefix(f"bands, {bands.condition}: "):
        plain = with_changes(base, condition)
    runs: list[_Run] = []
    for axis, frequency in itertools.product(bands.axes, frequencies):
        place = COORDINATES.index(axis)
        largest = largest_amplitude(plain.robot, plain.limits, place, frequency, plain.gravity_in_base)
        amplitude = min(MAX_AMPLITUDE[place], 0.5 * largest)
        if amplitude <= 0.0:
            allowed = f"frequencies at which {axis} can move within the limits"
            raise ConfigurationError("bands.frequencies", frequency, allowed)
        reference = {
            "kind": "sine",
            "center": plain.robot.home_pose.tolist(),
            "amplitude": (amplitude * np.eye(6)[place]).tolist(),
            "angular_frequency": [2.0 * math.pi * frequency] * 6,
        }
        window = math.ceil(_MIN_WINDOW * frequency - 1e-9) / frequency
        measure = partial(measure_response, frequency=frequency, axis=place, window=window)
        for name in bands.controllers:
            motion = {"reference": reference, "duration": transient + window}
            changes = _seeded({**parts["controllers"][name], **condition, **motion}, seed)
            with error_prefix(f"bands, {name}, {axis}, {frequency:g} Hz: "):
                with_changes(base, changes)
            labels = dict(zip(NAMES, (name, axis, bands.condition, seed), strict=True))
            runs.append((changes, {**labels, "frequency_hz": frequency, "amplitude": amplitude}, measure))
    return runs


def _seeded(changes: Mapping[str, object], seed: int) -> _Keys:
    return {key: _with_seed(value, seed) for key, value in changes.items()}


def _with_seed(value: object, seed: int) -> object:
    if isinstance(value, Mapping):
        return _seeded(value, seed)
    if isinstance(value, list):
        return [_with_seed(item, seed) for item in value]
    return seed if value == SEED else value


# --- lines of tables ---


_LATE = "over the second half of the planned duration"
_FIGURES = {
    "RMSE [deg]": "rmse_norm_deg",
    "RMSE [mm]": "rmse_norm_mm",
    "worst half [mm]": "worst_half_rmse_norm_mm",
    "ripple [deg/s]": "ripple_deg_s",
    "ripple [mm/s]": "ripple_mm_s",
    "peak [mm]": "peak_norm_mm",
    "torque peak [N m]": "torque_peak",
    "speed peak [deg/s]": "crank_speed_peak_deg_s",
    "settled [s]": "settling_s",
    "torque RMS [N m]": "torque_rms_second_half",
    "change per tick [N m]": "torque_change_rms",
    "at the limit": "saturated_fraction",
}
"""Heading -> column of the figures in a sheet; a grid shows the last four for all motions together."""


def _rank(row: Row) -> tuple[bool, float]:
    """Sort key of the best run: the smallest error; of failed runs the latest end."""
    if row["status"] == "completed" and row.get("pose_rmse_mm") is not None:
        return False, float(row["pose_rmse_mm"])
    return True, -float(row.get("end_time") or 0.0)


def _mean_cost(group: Sequence[Row]) -> str:
    return number(mean_cost(row["cost"] for row in group))


def _missed(group: Sequence[Row]) -> str:
    return f"{not_completed(group)} of {len(group)}"


def _failure(group: Sequence[Row]) -> str | None:
    failed = [row for row in group if row["status"] != "completed"]
    if not failed:
        return None
    words = describe_outcome(failed[0]["status"], failed[0]["reason"], failed[0].get("outcome_time"))
    return f"{words}, {_missed(group)} runs" if len(group) > 1 else words


def _only_lost(group: Sequence[Row]) -> bool:
    return all(row["status"] in ("completed", "lost") for row in group)


def _chosen(group: Sequence[Row]) -> str:
    names = dict.fromkeys(row["chosen"] for row in group if row["chosen"])
    return f" ({', '.join(names)})" if names else ""


def _errors(group: Sequence[Row]) -> str:
    figures = f"{worst(group, 'rmse_norm_deg')}° {worst(group, 'rmse_norm_mm')} mm{_chosen(group)}"
    failure = _failure(group)
    return failure if failure and not _only_lost(group) else "; ".join(filter(None, (failure, figures)))


def _band(group: Sequence[Row]) -> str:
    row = group[0]
    return _failure(group) or "-" if row.get("ratio") is None else f"{row['ratio']:.4f}, {row['phase_deg']:+.1f}°"
