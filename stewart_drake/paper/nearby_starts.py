"""Fig. 7 from starts that nobody could tell apart: how firmly its figures are determined."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.metrics import run_metrics
from stewart_drake.paper.report import Section
from stewart_drake.paper.study import Study

_APART = 1e-10
"""[rad, m] between starts that nobody could tell apart."""


def start_offsets(study: Study) -> np.ndarray:
    """Offsets (n, 6) [rad, m] of the starts, in random directions."""
    return _APART * np.random.default_rng(0).uniform(-1.0, 1.0, (study.pick(5, 2), 6))


def show_nearby(section: Section, study: Study, nearby: Mapping[str, list[SimulationLog]]) -> None:
    """Adds the table of runs from nearby starts, by condition."""
    rows, numbers = [], section.numbers.setdefault("nearby_starts", {})
    for name, logs in nearby.items():
        found: dict[str, list[float | None]] = {"roll_rmse_deg": [], "z_rmse_mm": [], "integral_at_5s": []}
        for log in logs:
            m = run_metrics(log)
            found["roll_rmse_deg"].append((m["rmse_deg"] or [None])[0])
            found["z_rmse_mm"].append((m["rmse_mm"] or [None])[-1])
            found["integral_at_5s"].append(largest_integral(log))
        numbers[name] = found
        rows.append((name, *(span(values) for values in found.values())))
    section.table(
        f"The same runs from {study.pick(5, 2)} starts up to {_APART:g} rad and m beside the reference's, in random "
        "directions: smallest to largest figure. Where they spread the loop is chaotic: a run is one sample, and the "
        "rounding of another processor gives another",
        ("condition and weights", "RMSE roll [deg]", "RMSE Z [mm]", "abs(z) at 5 s"),
        rows,
    )


def span(values: Sequence[float | None]) -> str | None:
    """Smallest to largest of what there is; one figure where all agree to four digits, None for nothing."""
    known = [value for value in values if value is not None]
    if not known:
        return None
    low, high = (f"{value:.4g}" for value in (min(known), max(known)))
    return low if low == high else f"{low} to {high}"


def largest_integral(log: SimulationLog) -> float | None:
    """Largest |z| at 5 s [rad s, m s]; None where the run ended before."""
    z = run_metrics(log)["integral_at_5s"]
    return None if z is None else float(np.abs(z).max())
