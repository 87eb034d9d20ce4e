"""What margins of many poses leave: a table in words, a document of numbers, a row for each pose."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from stewart_drake.stability.linear_loop import LinearLoops
from stewart_drake.stability.margins import LoopMargins

if TYPE_CHECKING:
    import pyarrow as pa

HEADER = ("", "one motor: least", "5 %", "median", "all at once: least", "5 %", "median")
_POSE = ("roll_rad", "pitch_rad", "yaw_rad", "x_m", "y_m", "z_m")


def quantities(found: LoopMargins, period: float) -> Iterator[tuple[str, str, np.ndarray, np.ndarray]]:
    """Each margin: its key, its name with unit, (m,) of the worst motor alone, (m,) of all at once; period [s]."""
    for key, name, field, scale in (
        ("disk", "disk margin [-]", "disk", 1.0),
        ("gain_low", "gain down to [-]", "gain_low", 1.0),
        ("gain_high", "gain up to [-]", "gain_high", 1.0),
        ("phase_deg", "phase [deg]", "phase", 180.0 / np.pi),
        ("delay_s", "delay [s]", "delay", 1.0),
        ("delay_ticks", "delay [ticks]", "delay", 1.0 / period),
    ):
        alone = getattr(found.single, field)
        worst = alone.max(axis=-1) if key == "gain_low" else alone.min(axis=-1)
        yield key, name, scale * worst, scale * getattr(found.all_at_once, field)


def spread(values: np.ndarray, most: bool) -> tuple[float, float, float]:
    """The worst of values (m,), what all but 5 % reach, and the median; `most`: whether the largest is worst."""
    worst, tail = (values.max(), 0.95) if most else (values.min(), 0.05)
    return float(worst), float(np.quantile(values, tail, method="inverted_cdf")), float(np.median(values))


def table(found: LoopMargins, period: float) -> list[tuple[str, ...]]:
    """Rows of texts under `HEADER`."""
    rows = []
    for key, name, alone, together in quantities(found, period):
        numbers = [each for values in (alone, together) for each in spread(values, key == "gain_low")]
        if key == "delay_s":
            name, numbers = "delay [ms]", [1e3 * each for each in numbers]
        rows.append((name, *(f"{each:.3g}" for each in numbers)))
    return rows


def facts(loops: LinearLoops, found: LoopMargins) -> list[tuple[str, str]]:
    """What else there is to say, as rows of two texts."""
    stable, worst = found.radius < 1.0, int(found.all_at_once.disk.argmin())
    pose = ", ".join(f"{each:.4g}" for each in loops.poses[worst])
    grid = found.frequencies
    rows = [
        ("stable", f"{stable.sum()} of {len(stable)} poses; spectral radius at most {found.radius.max():.5f}"),
        ("worst pose, all at once", f"{pose} [rad, m], at {found.frequency[worst]:.3g} rad/s"),
        ("bounds of mu", f"apart by at most {100.0 * gap(found):.2g} % where it decides"),
        ("frequencies", f"{len(grid)} from {grid[0]:.3g} to {grid[-1]:.4g} rad/s"),
    ]
    if loops.left_out:
        rows.append(("left out", f"{len(loops.left_out)} poses, such as: {loops.left_out[0]}"))
    return rows


def gap(found: LoopMargins) -> float:
    """[-] by how much disk margins all at once may be larger than stated, as a share; 0 where no loop is stable."""
    stable = found.radius < 1.0
    return float(np.max(found.not_above[stable] / found.all_at_once.disk[stable] - 1.0, initial=0.0))


def document(loops: LinearLoops, found: LoopMargins) -> dict[str, Any]:
    """All that `table` and `facts` say, as plain values; no margin without end has a number."""

    def plain(values: np.ndarray, most: bool) -> list[float | None]:
        return [each if np.isfinite(each) else None for each in spread(values, most)]

    worst = int(found.all_at_once.disk.argmin())
    return {
        "poses": len(loops.poses),
        "left_out": len(loops.left_out),
        "stable": int((found.radius < 1.0).sum()),
        "spectral_radius": float(found.radius.max()),
        "period_s": loops.period,
        "worst_pose": loops.poses[worst].tolist(),
        "worst_frequency_rad_s": float(found.frequency[worst]),
        "bounds_apart": gap(found),
        "columns": ["worst", "all but 5 %", "median"],
        "margins": {
            key: {"one_motor": plain(alone, key == "gain_low"), "all_at_once": plain(together, key == "gain_low")}
            for key, _, alone, together in quantities(found, loops.period)
        },
    }


def rows(loops: LinearLoops, found: LoopMargins) -> pa.Table:
    """A row for each pose: pose, spectral radius, margins of each motor and of all at once."""
    import pyarrow as pa

    columns = dict(zip(_POSE, loops.poses.T, strict=True)) | {"spectral_radius": found.radius}
    for name, unit in (("disk", ""), ("gain_low", ""), ("gain_high", ""), ("phase", "_rad"), ("delay", "_s")):
        one = getattr(found.single, name)
        columns |= {f"{name}{unit}_motor_{motor}": one[:, motor] for motor in range(6)}
        columns[f"{name}{unit}"] = getattr(found.all_at_once, name)
    columns |= {"disk_not_above": found.not_above, "frequency_rad_s": found.frequency}
    return pa.table({name: np.ascontiguousarray(values) for name, values in columns.items()})
