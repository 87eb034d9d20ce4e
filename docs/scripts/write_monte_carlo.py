"""Writes docs/results/monte_carlo.md and .parquet from the table of the sweep: `make results/monte_carlo`.

python docs/scripts/write_monte_carlo.py runs/monte_carlo     # a folder that `stewart-drake sweep monte_carlo` made
"""

import sys
from concurrent.futures import ProcessPoolExecutor
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq

from stewart_drake import run, run_metrics
from stewart_drake.base.markdown import markdown_table
from stewart_drake.studies.sweep import load_sweep

LEARNING, NOT_PUSHED = {"adaptation": "regression"}, {"disturbances": []}
WAYS: dict[str, dict[str, Any]] = {
    "pushed, learning": LEARNING,
    "not pushed": NOT_PUSHED,
    "not pushed, learning": {**LEARNING, **NOT_PUSHED},
}
TEXT = """# A thousand robots that differ from the controller's model

How well does one controller follow on robots that are not as its model has them?
Command: `make results/monte_carlo`; one row a
run is in [monte_carlo.parquet](monte_carlo.parquet).

| of {runs} runs of 4 s | 50 % | 95 % | 99 % | largest |
|---|---|---|---|---|
| RMSE of position, second half [mm] | {position} |
| RMSE of rotation, second half [deg] | {rotation} |

- {completed} completed, {warned} of them with a warning; at most {saturated:.2g} % of a run's torques were at their
  limit. At no instant was the platform off by more than {worst_mm:.2f} mm and {worst_deg:.2f} deg.
- At random ([monte_carlo.yaml](../../diagrams/sweeps/monte_carlo.yaml)): masses and inertias within 20 %, payload up
  to 0.3 kg off centre, 0 to 0.08 N m of friction, torque constants within 10 %, encoder noise up to a count, 1 to 3
  ticks of delay, a push of up to 5 N, a motion of six sines of 0.1 to 1.5 Hz.
- On the closed form, with the exact-model LQI, observer and fixed weights. Its model is the nominal robot with 2
  ticks of delay and 0.04 N m of friction.
- Friction and delay matter little: 99 % are {by_friction} mm with 0 to 0.02, to 0.04, to 0.06, to 0.08 N m, and
  {by_delay} mm with 1, 2, 3 ticks of delay.

## With learning, and without the push

The same robots and motions with `adaptation: regression`. RMSE of position, second half [mm]:

{learning}
"""


@cache
def trials() -> Any:
    """Of the sweep."""
    return load_sweep("monte_carlo").trials


def error(way: str, number: int) -> float:
    """RMS error [mm] of the second half of a run of the sweep in another way."""
    scenario = trials()[number].scenario().replace(WAYS[way])
    return float(run_metrics(run(scenario, check=False))["rmse_norm_mm"])


def main(folder: Path) -> None:
    """Writes both files; ends with a line where the sweep is not whole."""
    table = pq.read_table(folder / "sweep.parquet")
    row = {name: np.array(table[name].to_pylist()) for name in table.column_names if "." not in name}
    friction = np.array(table["plant.motor_friction"].to_pylist())
    runs, done = table.num_rows, row["status"] == "completed"
    if runs != 1000:
        sys.exit(f"{folder}: {runs} runs; the whole sweep has 1000")
    rmse = row["rmse_norm_mm"].astype(float)

    with ProcessPoolExecutor() as workers:
        ways = {way: list(workers.map(partial(error, way), range(runs), chunksize=10)) for way in WAYS}

    def spread(values: np.ndarray) -> str:
        shares = [*np.nanquantile(values, [0.5, 0.95, 0.99]), np.nanmax(values)]
        return " | ".join(f"{share:.3f}" for share in shares)

    bands = []
    for low in (0.0, 0.02, 0.04, 0.06):
        bands.append(f"{np.nanquantile(rmse[(friction >= low) & (friction < low + 0.02)], 0.99):.3f}")
    text = TEXT.format(
        runs=runs,
        completed=f"All {runs}" if done.all() else f"{int(done.sum())} of {runs}",
        warned="none" if not any(row["warnings"]) else sum(map(bool, row["warnings"])),
        position=spread(rmse),
        rotation=spread(row["rmse_norm_deg"].astype(float)),
        saturated=100.0 * np.nanmax(row["saturated_fraction"].astype(float)),
        worst_mm=np.nanmax(row["error_max_mm"].astype(float)),
        worst_deg=np.nanmax(row["error_max_deg"].astype(float)),
        by_friction=", ".join(bands),
        learning=markdown_table(
            ["", "50 %", "95 %", "99 %", "largest"],
            [[way, *spread(np.array(found)).split(" | ")] for way, found in {"pushed": rmse, **ways}.items()],
        ),
        by_delay=", ".join(f"{np.nanquantile(rmse[row['command_delay'] == ticks], 0.99):.3f}" for ticks in (1, 2, 3)),
    )
    results = Path(__file__).parents[1] / "results"
    (results / "monte_carlo.md").write_text(text, encoding="utf-8")
    table = table.drop(["host", "worker", "wall_s", "simulation_s"])
    for way, found in ways.items():
        table = table.append_column(f"rmse_norm_mm {way}", [found])
    pq.write_table(table, results / "monte_carlo.parquet")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
