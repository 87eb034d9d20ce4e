"""Runs a comparison; its tables and pictures."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from stewart_drake.campaigns.comparison_file import Comparison
from stewart_drake.campaigns.comparison_table import Sheet, order, sheets
from stewart_drake.campaigns.executors import Workplace
from stewart_drake.campaigns.one_run import RunFunction
from stewart_drake.campaigns.plan import run_plan
from stewart_drake.campaigns.tables import Row
from stewart_drake.files.whole import locked_folder

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(frozen=True, eq=False)
class ComparisonResult:
    """What a comparison leaves.

    Attributes:
        table: One row a run, see `comparison_table.table_columns`.
        bands: One row a band, see `comparison_table.BANDS`.
        rows: Rows of the table as plain values, with `trace`.
        band_rows: Rows of the bands likewise.
        sheets: The tables that are read.
        engine: See `plan.Made`.
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
    where: Workplace | Executor | None = None,
    progress: Callable[[float], None] | None = None,
    restart: bool = False,
    function: RunFunction | None = None,
) -> ComparisonResult:
    """Runs what is missing of a comparison and writes its tables; see `plan.run_plan`.

    Files: comparison.parquet, .csv and .md; bands.parquet and .csv where there are bands.
    """
    made = run_plan(comparison, folder, where, progress, restart, function)
    table, bands = made["comparison"], made["bands"]
    read = sheets(comparison, table.rows, bands.rows)
    return ComparisonResult(table.table, bands.table, table.rows, bands.rows, read, table.engine)


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
