"""Figures and tables of a comparison: one row a run as Parquet and CSV, what is read as Markdown, and pictures."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from stewart_drake.control.features import CostScales
from stewart_drake.files.whole import locked_folder
from stewart_drake.logs.cost import FAILED, mean_cost, run_cost
from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.metric_table import OUTCOME, Column
from stewart_drake.logs.metric_table import columns as run_columns
from stewart_drake.logs.metrics import error_norms
from stewart_drake.studies.runs import Row, RunFunction, measure, outcome
from stewart_drake.studies.study import flat, markdown, run_study
from stewart_drake.studies.workers import Workers

if TYPE_CHECKING:
    import pyarrow as pa

    from stewart_drake.scenario import Scenario
    from stewart_drake.studies.comparison import Comparison

PICTURES = ("rmse", "error", "bands")
TRACE_POINTS = 240
"""Of the error over time that is kept; each the largest error of its share of the run."""
SMALLEST = 1e-5
"""What is smaller is not written out."""
_LATE = "over the second half of the planned duration"

NAMES = (
    Column("controller", "", "its name", "text"),
    Column("chosen", "", "of a best of several: which it is here", "text"),
    Column("reference", "", "its name; of a band, the axis", "text"),
    Column("condition", "", "its name", "text"),
    Column("seed", "", "what {seed} stood for", "whole"),
)
"""First columns of both tables."""

SETTLING = Column("settling_s", "s", "after which the pose error stays within the comparison's band; null: it does not")
COST = Column("cost", "1", f"J, see `cost` in the comparison; {FAILED:g} for a run that was not completed")

BANDS = (
    *NAMES,
    *OUTCOME,
    Column("frequency_hz", "Hz", "of the sine that is tracked"),
    Column("amplitude", "rad or m", "of that sine"),
    Column("ratio", "1", "amplitude of the pose over that of the reference"),
    Column("phase_deg", "deg", "of the pose to the reference, negative for a lag"),
    Column("rest", "1", "RMS of the pose that is no sine of this frequency, as a part of the RMS of the sine"),
)
"""Columns of the table of bands."""


def table_columns(*scenarios: Scenario, cost: bool = False) -> tuple[Column, ...]:
    """Columns of the table."""
    return (*NAMES, *run_columns(*scenarios), SETTLING, *((COST,) if cost else ()))


@dataclass(frozen=True)
class Sheet:
    """A table as texts.

    Attributes:
        title: One line.
        header: (k,) names with units.
        rows: Each (k,).
        brief: Columns that matter most, for narrow terminals.
    """

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    brief: tuple[int, ...]

    def markdown(self) -> str:
        """The table as GitHub shows it."""
        return "\n".join([f"**{self.title}**", "", *markdown(self.header, self.rows)]) + "\n"


def table_rows(comparison: Comparison, rows: Sequence[Row]) -> list[Row]:
    """Rows of the table, flat; a best of several copies the row that it is, before those it is chosen from."""
    runs = _named(comparison, rows, bands=False)
    if comparison.file.cost is not None:
        # A run that was refused or broke has no figures at all.
        runs = [{"cost": FAILED, **row} for row in runs]
    found: list[Row] = []
    for name, best in comparison.file.best_of.items():
        groups: dict[tuple[str, str, int], list[Row]] = {}
        for row in runs:
            if row["controller"] in best.of:
                groups.setdefault((row["reference"], row["condition"], row["seed"]), []).append(row)
        for group in groups.values():
            if {row["controller"] for row in group} == set(best.of):
                chosen = min(group, key=_rank)
                found.append({**chosen, "controller": name, "chosen": chosen["controller"]})
    return found + runs


def band_rows(comparison: Comparison, rows: Sequence[Row]) -> list[Row]:
    """Rows of the table of bands, flat."""
    cells = comparison.cells
    return [
        {**row, "frequency_hz": cells[row["index"]].frequency, "amplitude": cells[row["index"]].amplitude}
        for row in _named(comparison, rows, bands=True)
    ]


def sheets(comparison: Comparison, rows: Sequence[Row], bands: Sequence[Row]) -> list[Sheet]:
    """The tables that are read, of what `table_rows` and `band_rows` give: of several seeds the worst number."""
    hidden = {name for best in comparison.file.best_of.values() for name in best.of}
    asked = {
        key
        for product in comparison.file.runs or ()
        for key in itertools.product(product.controllers, product.references, product.conditions)
    }
    groups: dict[tuple[str, str, str], list[Row]] = {}
    for name in order(comparison):
        for row in rows:
            key = (row["controller"], row["reference"], row["condition"])
            if name == key[0] and (key in asked if asked else name not in hidden):
                groups.setdefault(key, []).append(row)
    made = [_list(comparison, groups)] if comparison.file.layout == "rows" else _grids(groups)
    if comparison.file.cost is not None:
        made.insert(0, _costs(groups))
    return made + [_band_sheet(axis, bands) for axis in dict.fromkeys(row["reference"] for row in bands)]


def order(comparison: Comparison) -> list[str]:
    """Names of controllers as the file has them: those of `runs`, or a best of several in the place of its first."""
    if comparison.file.runs is not None:
        return list(dict.fromkeys(name for product in comparison.file.runs for name in product.controllers))
    found: dict[str, None] = {}
    for cell in comparison.cells:
        found |= dict.fromkeys(name for name, best in comparison.file.best_of.items() if cell.controller in best.of)
        found[cell.controller] = None
    return list(found)


def _named(comparison: Comparison, rows: Sequence[Row], bands: bool) -> list[Row]:
    """Flat rows of the runs, or of the bands, with the names of what was run."""
    found = []
    for row in rows:
        cell = comparison.cells[row["index"]]
        if (cell.frequency is not None) == bands:
            names = {"controller": cell.controller, "reference": cell.reference, "condition": cell.condition}
            found.append(flat(row, **names, chosen=None, seed=cell.seed))
    return found


def _rank(row: Row) -> tuple[bool, float]:
    """Smallest for the best: the smallest error, and where all have failed the one that got furthest."""
    if row["status"] == "completed" and row.get("pose_rmse_mm") is not None:
        return False, float(row["pose_rmse_mm"])
    return True, -float(row.get("end_time") or 0.0)


def _worst(group: Sequence[Row], name: str) -> float | None:
    values = [row.get(name) for row in group]
    return None if None in values or not values else max(float(value) for value in values if value is not None)


def _failure(group: Sequence[Row]) -> str | None:
    failed = [row for row in group if row["status"] != "completed"]
    if not failed:
        return None
    first = failed[0]
    words = str(first["reason"] or first["status"]).replace("_", " ")
    if first["status"] in ("stopped", "lost"):
        words = f"{first['status']}, {words}"
    end = first.get("outcome_time")
    when = "" if end is None else f" at {end:.2f} s"
    share = f", {len(failed)} of {len(group)} runs" if len(group) > 1 else ""
    return f"{words}{when}{share}"


def _only_lost(group: Sequence[Row]) -> bool:
    """Whether all runs have figures: what was lost went on to its end."""
    return all(row["status"] in ("completed", "lost") for row in group)


def _chosen(group: Sequence[Row]) -> str:
    names = dict.fromkeys(row["chosen"] for row in group if row["chosen"])
    return f" ({', '.join(names)})" if names else ""


def number(value: float | None) -> str:
    """Three significant digits, without an exponent."""
    if value is None:
        return "-"
    if 0.0 < abs(value) < SMALLEST:
        return f"<{SMALLEST:.5f}"
    return format(Decimal(f"{value:.2e}"), "f")


_Show = Callable[[float | None], str]


def _as(form: str) -> _Show:
    return lambda value: "-" if value is None else format(value, form)


_LIST: Sequence[tuple[str, str, _Show]] = (
    ("RMSE [deg]", "rmse_norm_deg", number),
    ("RMSE [mm]", "rmse_norm_mm", number),
    ("worst half [mm]", "worst_half_rmse_norm_mm", number),
    ("peak [mm]", "peak_norm_mm", number),
    ("settled [s]", "settling_s", _as(".2f")),
    ("torque RMS [N m]", "torque_rms_second_half", _as(".3f")),
    ("change per tick [N m]", "torque_change_rms", number),
    ("at the limit", "saturated_fraction", _as(".1%")),
)
"""Heading, column and form of what the list shows of a run."""
_WORST_OF_ALL: Sequence[tuple[str, str, _Show]] = (
    ("settled, slowest [s]", "settling_s", _as(".2f")),
    ("torque RMS, largest [N m]", "torque_rms_second_half", number),
    ("change per tick, largest [N m]", "torque_change_rms", number),
    ("at the limit, most", "saturated_fraction", _as(".1%")),
)
"""The same of what the grid shows over all motions."""


def _list(comparison: Comparison, groups: Mapping[tuple[str, str, str], Sequence[Row]]) -> Sheet:
    shown = _LIST if comparison.file.cost is None else (*_LIST, ("cost", "cost", number))
    lines = []
    for key, group in groups.items():
        failure = _failure(group)
        figures = [show(_worst(group, name)) for _, name, show in shown]
        if failure is not None:
            figures = [failure] + (figures[1:] if _only_lost(group) else ["-"] * (len(shown) - 1))
        lines.append((key[0] + _chosen(group), *key[1:], *figures))
    title = f"{comparison.name}: RMSE and peak of the length of the error, {_LATE}"
    header = ("controller", "motion", "condition", *(heading for heading, _, _ in shown))
    return Sheet(title, header, tuple(lines), (0, 1, 2, 3, 4, 8))


def _costs(groups: Mapping[tuple[str, str, str], Sequence[Row]]) -> Sheet:
    """Mean cost of each controller, under each condition and over all runs."""
    conditions = list(dict.fromkeys(key[2] for key in groups))
    lines = []
    for controller in dict.fromkeys(key[0] for key in groups):
        of = {key: [row["cost"] for row in group] for key, group in groups.items() if key[0] == controller}
        each = [
            [cost for key, costs in of.items() if key[2] == condition for cost in costs] for condition in conditions
        ]
        everything = [cost for costs in of.values() for cost in costs]
        lines.append((controller, *(number(mean_cost(costs) if costs else None) for costs in (*each, everything))))
    title = f"cost: mean of the runs; {FAILED:g} for one that was not completed"
    return Sheet(title, ("controller", *conditions, "all"), tuple(lines), (0, *range(1, len(conditions) + 2)))


def _grids(groups: Mapping[tuple[str, str, str], Sequence[Row]]) -> list[Sheet]:
    made = []
    for condition in dict.fromkeys(key[2] for key in groups):
        here = {key: group for key, group in groups.items() if key[2] == condition}
        references = list(dict.fromkeys(key[1] for key in here))
        lines = []
        for controller in dict.fromkeys(key[0] for key in here):
            line, all_of = [controller], []
            for reference in references:
                group = here.get((controller, reference, condition))
                if group is None:
                    line.append("")
                    continue
                all_of += list(group)
                rotation, position = number(_worst(group, "rmse_norm_deg")), number(_worst(group, "rmse_norm_mm"))
                failure, figures = _failure(group), f"{rotation}° {position} mm{_chosen(group)}"
                line.append(
                    failure if failure and not _only_lost(group) else "; ".join(filter(None, (failure, figures)))
                )
            done = [row for row in all_of if row["status"] == "completed"]
            line += [show(_worst(done, name)) for _, name, show in _WORST_OF_ALL]
            line.append(f"{len(all_of) - len(done)} of {len(all_of)}")
            lines.append(tuple(line))
        header = ("controller", *references, *(heading for heading, _, _ in _WORST_OF_ALL), "not completed")
        brief = (*range(len(references) + 1), len(header) - 1)
        made.append(Sheet(f"{condition}: RMSE {_LATE}, rotation and position", header, tuple(lines), brief))
    return made


def _band_sheet(axis: str, bands: Sequence[Row]) -> Sheet:
    here = [row for row in bands if row["reference"] == axis]
    frequencies = sorted({row["frequency_hz"] for row in here})
    lines = []
    for controller in dict.fromkeys(row["controller"] for row in here):
        line = [controller]
        for frequency in frequencies:
            found = [row for row in here if row["controller"] == controller and row["frequency_hz"] == frequency]
            row = found[0]
            if row.get("ratio") is None:
                line.append(_failure(found) or "-")
            else:
                line.append(f"{row['ratio']:.4f}, {row['phase_deg']:+.1f}°")
        lines.append(tuple(line))
    header = ("controller", *(f"{frequency:g} Hz" for frequency in frequencies))
    brief = tuple(dict.fromkeys(np.linspace(0, len(frequencies), 5).round().astype(int).tolist()))
    return Sheet(f"{axis}: amplitude ratio and phase, pose to reference", header, tuple(lines), brief)


def measure_run(log: SimulationLog, band: float, scales: CostScales | None = None) -> Row:
    """Figures of a run: those of every sweep, settling into `band` [mm], its cost and the trace of its error."""
    rotation, position = error_norms(log)
    pose = np.hypot(1e3 * log.scenario.robot.characteristic_length * np.radians(rotation), position)
    figures = measure(log)
    if scales is not None:
        figures["cost"] = run_cost(figures, log.status, log.scenario.controller.period, scales)
    return {
        **figures,
        "settling_s": settling_time(log.time, pose, band) if log.reached_end else None,
        "trace": {"time": _thinned(log.time), "pose_mm": _thinned(pose)},
    }


def measure_band(log: SimulationLog, frequency: float, axis: int, window: float) -> Row:
    """Amplitude ratio and phase over the last `window` [s] of a run along a sine of `frequency` [Hz] on `axis`."""
    row = outcome(log) | dict.fromkeys(("ratio", "phase_deg", "rest"))
    if not log.reached_end:
        return row
    rows = log.time > log.time[-1] - window + 1e-9
    reference, pose = log["reference"][rows, axis], log["pose"][rows, axis]
    response, rest = sine_response(log.time[rows], reference, pose, frequency)
    return {**row, "ratio": abs(response), "phase_deg": math.degrees(np.angle(response)), "rest": rest}


def settling_time(time: np.ndarray, size: np.ndarray, band: float, start: float = 0.0) -> float | None:
    """Time from `start` (of the run, or of a step) after which `size` stays within `band` to the end.

    0 where it never leaves the band; None where it ends outside, or there are no rows from `start` on.
    """
    after = time >= start - 1e-9
    time, outside = time[after], ~(size[after] <= band)
    if not len(time) or outside[-1]:
        return None
    last = np.flatnonzero(outside)
    return float(time[last[-1] + 1] - start) if len(last) else 0.0


def sine_response(
    time: np.ndarray, reference: np.ndarray, response: np.ndarray, frequency: float
) -> tuple[complex, float]:
    """Response to a sine: least-squares fit of sine, cosine and constant to both signals at the frequency.

    Args:
        time: (n,) [s], best over whole periods, after the transient.
        reference: (n,) what was asked for.
        response: (n,) what came.
        frequency: [Hz].

    Returns:
        Their ratio as a complex number: amplitude ratio and, as its angle, phase (negative for a lag); and the RMS of
        what the fit leaves of the response, as a part of the RMS of the fitted sine.
    """
    angle = 2.0 * np.pi * frequency * np.asarray(time)
    basis = np.stack([np.sin(angle), np.cos(angle), np.ones_like(angle)], axis=1)
    solution, *_ = np.linalg.lstsq(basis, np.stack([reference, response], axis=1), rcond=None)
    asked, came = solution[0] + 1j * solution[1]
    rest = response - basis @ solution[:, 1]
    return complex(came / asked), float(np.sqrt(2.0 * np.mean(rest**2)) / abs(came))


def _thinned(values: np.ndarray) -> list[float]:
    parts = np.array_split(values, min(TRACE_POINTS, len(values))) if len(values) else []
    return [float(f"{np.max(part):.4g}") for part in parts]


@dataclass(frozen=True, eq=False)
class ComparisonResult:
    """What a comparison leaves.

    Attributes:
        table: One row a run, see `table_columns`.
        bands: One row a band, see `BANDS`.
        rows: Rows of the table as plain values, with `trace`.
        band_rows: Rows of the bands likewise.
        sheets: The tables that are read.
        engine: See `StudyTable`.
    """

    table: pa.Table
    bands: pa.Table
    rows: list[Row]
    band_rows: list[Row]
    sheets: list[Sheet]
    engine: str | None = None


def run_comparison(
    comparison: Comparison,
    folder: Path,
    workers: Workers | None = None,
    progress: Callable[[float], None] | None = None,
    restart: bool = False,
    function: RunFunction | None = None,
) -> ComparisonResult:
    """Runs what is missing of a comparison and writes its tables; see `run_study`.

    Files: comparison.parquet, .csv and .md; bands.parquet and .csv where there are bands.
    """
    made = run_study(comparison, folder, workers, progress, restart, function)
    table, bands = made["comparison"], made["bands"]
    read = sheets(comparison, table.rows, bands.rows)
    return ComparisonResult(table.table, bands.table, table.rows, bands.rows, read, table.engine)


def write_pictures(comparison: Comparison, result: ComparisonResult, folder: Path) -> list[str]:
    """Draws rmse.png, error.png and, where there are bands, bands.png; a line for each that is beyond matplotlib."""
    # matplotlib takes a second to load.
    from stewart_drake.plotting import draw
    from stewart_drake.plotting.comparison_plots import plot_bands, plot_error, plot_rmse

    names = order(comparison)
    rows = [row for name in names for row in result.rows if row["controller"] == name]
    figures = {"rmse": partial(plot_rmse, rows)}
    traced = [row for row in rows if row["reference"] == comparison.traced]
    if any("trace" in row for row in traced):
        figures["error"] = partial(plot_error, traced, comparison.file.band)
    if any(row.get("ratio") is not None for row in result.band_rows):
        figures["bands"] = partial(plot_bands, result.band_rows)
    with locked_folder(folder):
        lines = [draw(figure, folder / f"{name}.png") for name, figure in figures.items()]
    return [line for line in lines if line is not None]
