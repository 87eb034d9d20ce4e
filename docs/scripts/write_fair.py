"""Judges the settings of the comparison `fair` and writes docs/results/fair_comparison.md.

python docs/scripts/write_fair.py runs/fair-tune   # those of a search, which `compare fair` takes from now on
python docs/scripts/write_fair.py                  # those that it has: three minutes in place of an hour
"""

import shutil
import sys
from pathlib import Path

from stewart_drake.analysis.linear_loop import linear_loops, poses_to_stand_at
from stewart_drake.analysis.margins import loop_margins
from stewart_drake.base.atomic_files import checksum
from stewart_drake.base.markdown import markdown_table, number
from stewart_drake.base.yaml_files import find_file, parse_yaml, read_mapping
from stewart_drake.logs.metrics import mean_cost
from stewart_drake.scenario.scenario import Scenario
from stewart_drake.studies.comparison import Comparison
from stewart_drake.studies.experiment import run_experiment
from stewart_drake.studies.tune import START, TUNED, load_tuning

POSES = 100

TEXT = """# What the LQI itself adds

With the same observer, the same friction compensation and the same search for gains: is the exact-model LQI better than
simpler controllers? Command: `make results/fair_comparison`. A new search takes an hour: `stewart-drake tune fair`.

**Cost of the runs, at the start of the search and tuned**

{settings}

J = sqrt((RMSE / 0.03 deg)^2 + (RMSE / 0.03 mm)^2 + (RMS change of torque in a millisecond / 0.03 N m)^2), the mean of
{runs} runs on Drake's plant; 1000 for a run that is not completed. Disk margin: all six motors at once, the least of
{poses} poses near home (`stewart-drake margins`; 0.45 means 25 deg). A user's own controller has none.

![Cost over evaluations](fair_search.png)

- The LQI and computed torque tie. A few percent decide nothing: with the settings of the first search, a change of the
  observer took computed torque from 0.90 to 1.04 times the cost of the LQI.
{answer}
- A search for the least cost leaves small margins, so none of these settings is a default.
- CMA-ES with {evaluations} evaluations tunes gains and the observer's disturbance, on the closed form with other noise.
  {made}

**Cost by condition**

{conditions}

**RMSE as believed, tuned, over the second half of a run**

{errors}

Runs and start are in [fair.yaml](../../diagrams/comparisons/fair.yaml); `stewart-drake compare fair` writes all
figures.
"""


def main(searched: Path | None) -> None:
    """Writes them; ends with a line where the search is not whole."""
    results = Path(__file__).parents[1] / "results"
    kept = results.parents[1] / "diagrams" / "comparisons" / "tuned" / "fair.yaml"
    made = "The settings are those of an earlier search, tested again."
    if searched is not None:
        shutil.copyfile(searched / "tuned.yaml", kept)
        shutil.copyfile(searched / "tune.png", results / "fair_search.png")
        made = "All is of one search."
    tuned = parse_yaml(kept.read_text(encoding="utf-8"), "tuned")["controllers"]
    tuning = load_tuning("fair")
    if set(tuned) != set(tuning.start):
        sys.exit(f"{kept}: {', '.join(tuned)}; the whole search has {', '.join(tuning.start)}")
    # Where the search has its verdict too, so that nothing is run twice.
    folder = (searched or Path("runs/fair-tune")) / f"verdict-{checksum(tuned)[:8]}"
    table = run_experiment(tuning.test(tuned), folder).rows["comparison"]
    page = write(table, tuned, tuning.evaluations, made, (folder / "comparison.md").read_text(encoding="utf-8"))
    (results / "fair_comparison.md").write_text(page, encoding="utf-8")


def write(table: list[dict], tuned: dict[str, dict[str, float]], evaluations: int, made: str, verdict: str) -> str:
    """The page of rows of a comparison, settings, and the comparison's own page."""
    return TEXT.format(
        poses=POSES,
        runs=len(costs(table, f"{next(iter(tuned))}, tuned")),
        evaluations=evaluations,
        made=made,
        answer=answer({name: costs(table, f"{name}, tuned") for name in tuned}),
        settings=settings(table, tuned, margins()),
        conditions=part(verdict, "cost: ", TUNED),
        errors=part(verdict, "as believed: ", TUNED, columns=7),
    )


def settings(table: list[dict], tuned: dict[str, dict[str, float]], margins: dict[str, list[float]]) -> str:
    """Cost and margin before and after, and what was found."""
    rows = []
    for name, found in tuned.items():
        means = (mean_cost(costs(table, f"{name}, {way}").values()) for way in (START, TUNED))
        least = [f"{margin:.2f}" for margin in margins.get(name, [])] or ["-", "-"]
        shown = ", ".join(f"{key.rpartition('.')[2]} {value:g}" for key, value in found.items())
        rows.append((name, *map(number, means), *least, shown))
    header = ("controller", START, TUNED, f"disk margin, {START}", f"disk margin, {TUNED}", "setting")
    return markdown_table(header, rows)


def part(page: str, title: str, *ways: str, columns: int | None = None) -> str:
    """The rows of some ways in a table of a comparison's page, and its first columns."""
    _, _, text = page.partition(f"**{title}")
    lines = [line.strip("| ").split(" | ") for line in text.split("\n\n")[1].strip().splitlines()]
    rows = [line for line in lines[2:] if line[0].endswith(tuple(f", {way}" for way in ways))]
    return markdown_table(lines[0][:columns], [row[:columns] for row in rows])


def margins() -> dict[str, list[float]]:
    """Least disk margin of each controller of the package, all motors at once, as it starts and as it was tuned."""
    data = read_mapping("comparison", find_file("comparison", "fair"), 80)
    folder, found = find_file("comparison", "fair").parent, {}
    before, after = (Comparison.from_dict({**data, **each}, folder) for each in ({"tuned": None}, {}))
    names = [trial.labels["controller"] for trial in after.trials]
    for name in dict.fromkeys(names):
        place = names.index(name)
        if after.scenario(place).controller.code is None:
            found[name] = [least_disk(each.scenario(place)) for each in (before, after)]
    return found


def least_disk(scenario: Scenario) -> float:
    """Disk margin, all motors at once, the least of some poses."""
    loops = linear_loops(scenario, poses_to_stand_at(scenario, POSES, seed=0))
    return float(loop_margins(loops).all_at_once.disk.min())


def costs(table: list[dict], name: str) -> dict[tuple[str, str], float]:
    """Mean cost of a controller by motion and condition."""
    found: dict[tuple[str, str], list[float]] = {}
    for row in table:
        if row["controller"] == name:
            found.setdefault((row["reference"], row["condition"]), []).append(row["cost"])
    return {key: mean_cost(each) for key, each in found.items()}


def answer(of: dict[str, dict[tuple[str, str], float]]) -> str:
    """How much more the others cost than the LQI, over all runs and where they are nearest and farthest."""
    lqi, *others = of
    lines = []
    for name in others:
        ratio = {key: of[name][key] / of[lqi][key] for key in of[lqi]}
        low, high = min(ratio, key=ratio.__getitem__), max(ratio, key=ratio.__getitem__)
        whole = mean_cost(of[name].values()) / mean_cost(of[lqi].values())
        lines.append(
            f"- {name}: {whole:.2f} times the cost of the LQI, from {ratio[low]:.2f} ({', '.join(low)}) "
            f"to {ratio[high]:.2f} ({', '.join(high)})."
        )
    return "\n".join(lines)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
