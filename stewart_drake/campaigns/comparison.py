"""Runs a comparison and writes its tables and pictures."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stewart_drake.campaigns.comparison_file import Comparison
from stewart_drake.campaigns.comparison_table import (
    BANDS,
    Sheet,
    band_rows,
    order,
    sheets,
    table_columns,
    table_rows,
)
from stewart_drake.campaigns.executors import Workplace
from stewart_drake.campaigns.identity import identity
from stewart_drake.campaigns.one_run import RunFunction, simulate
from stewart_drake.campaigns.row_store import Row, RowStore
from stewart_drake.campaigns.sweep import run_plan
from stewart_drake.campaigns.tables import to_arrow, write_table
from stewart_drake.control.user_controller import PythonOptions, load_class
from stewart_drake.files.whole import locked_folder, write_atomically
from stewart_drake.logs.versions import collect_versions

if TYPE_CHECKING:
    import pyarrow as pa

PICTURES = ("rmse", "error", "bands")
PRODUCTS = (
    *(f"{name}.{ending}" for name in ("comparison", "bands") for ending in ("parquet", "csv")),
    "comparison.md",
    *(f"{name}.png" for name in PICTURES),
)
"""Files that a comparison leaves, the pictures included."""


@dataclass(frozen=True, eq=False)
class ComparisonResult:
    """What a comparison leaves.

    Attributes:
        table: One row a run, see `comparison_table.table_columns`.
        bands: One row a band, see `comparison_table.BANDS`.
        rows: Rows of the table as plain values, with `trace`.
        band_rows: Rows of the bands likewise.
        sheets: The tables that are read.
    """

    table: pa.Table
    bands: pa.Table
    rows: list[Row]
    band_rows: list[Row]
    sheets: list[Sheet]


def run_comparison(
    comparison: Comparison,
    folder: Path,
    where: Workplace | Executor | None = None,
    progress: Callable[[float], None] | None = None,
    restart: bool = False,
    function: RunFunction = simulate,
) -> ComparisonResult:
    """Runs what is missing of a comparison and writes its tables; a run that fails is a row all the same.

    Files: comparison.parquet, .csv and .md; bands.parquet and .csv where there are bands.

    Args:
        comparison: What to run.
        folder: For the files, and for the rows as they come; a second call goes on where the first ended.
        where: Where the runs go; None for processes of this machine.
        progress: Called with the number of runs done.
        restart: Throw away what is in the folder.
        function: Simulates one scenario; for tests.

    Raises:
        ConfigurationError: The folder holds another comparison, is in use or cannot be written to; a weights file or
            a user's controller that cannot be read.
        StewartDrakeError: There are no workers (any more); rows done are kept.
        KeyboardInterrupt: Rows done are kept.
    """
    versions = collect_versions()
    with RowStore(folder, _identity(comparison, versions), restart, PRODUCTS) as store:
        done = run_plan(comparison, store, where, progress, function)
        rows, bands = table_rows(comparison, done), band_rows(comparison, done)
        about = {"comparison": comparison.to_dict(), "versions": dict(versions)}
        result = ComparisonResult(
            to_arrow(table_columns(), rows, "comparison", about),
            to_arrow(BANDS, bands, "comparison", about),
            rows,
            bands,
            sheets(comparison, rows, bands),
        )
        for name, table in (("comparison", result.table), ("bands", result.bands)):
            if table.num_rows:
                write_table(table, folder, name)
        text = "\n".join(sheet.markdown() for sheet in result.sheets)
        write_atomically(folder / "comparison.md", text.encode())
    return result


def write_pictures(comparison: Comparison, result: ComparisonResult, folder: Path) -> list[str]:
    """Draws rmse.png, error.png and, where there are bands, bands.png.

    Returns:
        A line for each that is beyond matplotlib.

    Raises:
        ConfigurationError: The folder cannot be written to, or another process is using it.
    """
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


def _identity(comparison: Comparison, versions: Mapping[str, str | None]) -> dict[str, Any]:
    """What the rows depend on."""
    different: dict[str, int] = {}
    for index, cell in enumerate(comparison.cells):
        sections = {key: value for key, value in cell.changes.items() if key.split(".")[0] in ("tuner", "controller")}
        different.setdefault(json.dumps(sections, sort_keys=True), index)
    scenarios = [comparison.scenario(index) for index in different.values()]
    for scenario in scenarios:
        if isinstance(scenario.controller, PythonOptions):
            # Otherwise a class that does not exist would show after everything has run.
            load_class(scenario.controller)
    return identity(comparison.to_dict(), [scenario.tuner for scenario in scenarios], versions)
