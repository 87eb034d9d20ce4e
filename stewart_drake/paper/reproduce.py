"""The paper, claim by claim: one table, compared with the committed one."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterable
from importlib import import_module
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory

from stewart_drake.paper.study import Claim, Result, Study

MODULES = (
    "plant",
    "kinematics",
    "force_map",
    "state_space",
    "nine_experiments",
    "network",
    "in_the_loop",
    "sensitivity",
    "workspace",
)
"""Of this package, in the paper's order; each has `reproduce(study) -> Result`."""


def reproduce(
    quick: bool = False, out: Path | None = None, progress: Callable[[float, str], None] = lambda *_: None
) -> dict[str, Result]:
    """All claims by module; with `out` the numbers as numbers.json, the network and the figures go there.

    `progress` is called with the share done, 0 to 1, and the module at hand.
    """
    results: dict[str, Result] = {}
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory() as scratch:
        study = Study(quick, folder=out or Path(scratch))
        for name in MODULES:
            study.progress = lambda share: progress((len(results) + share) / len(MODULES), name)  # noqa: B023
            study.progress(0.0)
            results[name] = import_module(f"{__package__}.{name}").reproduce(study)
    if out is not None:
        write(out, results)
    return results


def write(out: Path, results: dict[str, Result]) -> None:
    """The numbers of results as numbers.json, and their figures."""
    from stewart_drake.plotting import save_figure

    numbers = {name: result.numbers for name, result in results.items()}
    (out / "numbers.json").write_text(json.dumps(numbers, indent=1, allow_nan=False) + "\n")
    (out / "figures").mkdir(exist_ok=True)
    for result in results.values():
        for name, draw in result.figures.items():
            save_figure(draw(), out / "figures" / f"{name}.png")


def rows(claims: Iterable[Claim]) -> list[tuple[str, str, str, str]]:
    """The table: claim, paper, ours, verdict."""
    verdicts = {True: "holds", False: "fails", None: "-"}
    shown = ((claim, f"{claim.ours:.4g}" if claim.ours % 1 else f"{claim.ours:.0f}") for claim in claims)
    return [(c.name, c.paper, f"{ours} {c.unit}".strip(), verdicts[c.holds]) for c, ours in shown]


def differences(claims: Iterable[Claim], size: str) -> list[str]:
    """Where claims differ from the committed claims.csv, column `size` (quick or full), by more than its `within`."""
    with files(__package__).joinpath("claims.csv").open(encoding="utf-8") as stream:
        table = {row["claim"]: (float(row[size]), float(row["within"])) for row in csv.DictReader(stream)}
    found = {claim.name: claim.ours for claim in claims}
    lines = [f"{name}: only in the committed table" for name in table if name not in found]
    for name, ours in found.items():
        if name not in table:
            lines.append(f"{name}: not in the committed table")
        elif not abs(ours - table[name][0]) <= table[name][1]:
            lines.append(f"{name}: expected {table[name][0]:g} within {table[name][1]:g}, got {ours:g}")
    return lines


def markdown(header: Iterable[str], lines: Iterable[Iterable[object]]) -> str:
    """A table in Markdown; numbers with four digits, a dash for nothing."""

    def cell(value: object) -> str:
        text = "-" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)
        return text.replace("|", "\\|")

    every = [list(header), ["---"] * len(list(header)), *lines]
    return "\n".join("| " + " | ".join(map(cell, line)) + " |" for line in every)
