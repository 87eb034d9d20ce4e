"""Writes docs/results/fair_comparison.md, its picture, and what `compare fair` takes, from a search: `make fair`.

python docs/write_fair.py runs/fair-tune     # a folder that `stewart-drake tune fair` made
"""

import shutil
import sys
from pathlib import Path

import pyarrow.parquet as pq

from stewart_drake.campaigns.comparison_file import Comparison
from stewart_drake.files.whole import checksum
from stewart_drake.files.yaml_files import find_file, parse_yaml, read_mapping
from stewart_drake.logs.cost import mean_cost
from stewart_drake.scenario import Scenario
from stewart_drake.stability.linear_loop import linear_loops, poses_to_stand_at
from stewart_drake.stability.margins import loop_margins

POSES = 100

TEXT = """# What the LQI itself adds

Four controllers with the same observer, whose level is searched for each, and the same torque against friction. All
are tuned by the same search, CMA-ES with {evaluations} evaluations each, for the same cost over the same {runs} runs:
J = sqrt((RMSE / 0.03 deg)^2 + (RMSE / 0.03 mm)^2 + (RMS change of torque in a millisecond / 0.03 N m)^2), the plain
mean of the runs. Runs, bounds, start and scales are in [fair.yaml](../../diagrams/comparisons/fair.yaml). The search
runs on the reduced engine; the verdict is Drake's plant with other noise. `make fair` makes all of this page.

{answer}

What that costs in robustness, which the cost sees but in the runs with a payload and a later tick: disk margin, all six
motors at once, the least of {poses} poses of the near box (`stewart-drake margins`; 0.45 stands for 25 deg; of a user's
own controller the linear loop is not known): {margins}. So none of these settings is a default.

{search}
"verdict: tuned, as searched" is the reduced engine with the verdict's noise: against "verdict: tuned" it is what the
engine makes of it.

![Cost over evaluations](fair_search.png)

## The verdict, before and after

{verdict}"""


def main(folder: Path) -> None:
    """Writes them; ends with a line where the search is not whole."""
    rows = pq.read_table(folder / "tune.parquet").to_pylist()
    text = (folder / "tuned.yaml").read_text()
    tuned = parse_yaml(text, "tuned")["controllers"]
    judged = folder / f"verdict-{checksum(tuned)[:8]}"
    table = pq.read_table(judged / "comparison.parquet").to_pylist()
    if len(tuned) != 4:
        sys.exit(f"{folder}: {len(tuned)} controllers; the whole search has 4")
    results = Path(__file__).with_name("results")
    kept = results.parents[1] / "diagrams" / "comparisons" / "tuned" / "fair.yaml"
    kept.parent.mkdir(exist_ok=True)
    kept.write_text(text)
    page = TEXT.format(
        poses=POSES,
        margins=margins(),
        runs=len(costs(table, f"{next(iter(tuned))}, tuned")),
        evaluations=max(row["evaluation"] for row in rows) + 1,
        answer=answer({name: costs(table, f"{name}, tuned") for name in tuned}),
        search=(folder / "tune.md").read_text(),
        verdict=(judged / "comparison.md").read_text(),
    )
    (results / "fair_comparison.md").write_text(page)
    shutil.copyfile(folder / "tune.png", results / "fair_search.png")


def margins() -> str:
    """Least disk margin of each controller of the package, all motors at once, as it starts and as it was tuned."""
    data = read_mapping("comparison", find_file("comparison", "fair"), 80)
    folder, said = find_file("comparison", "fair").parent, []
    before, after = (Comparison.from_dict({**data, **each}, folder) for each in ({"tuned": None}, {}))
    for name in dict.fromkeys(cell.controller for cell in after.cells):
        place = next(place for place, cell in enumerate(after.cells) if cell.controller == name)
        if after.scenario(place).controller.kind != "python":
            least = [least_disk(each.scenario(place)) for each in (before, after)]
            said.append(f"{name} {least[0]:.2f} at the start of the search, {least[1]:.2f} tuned")
    return "; ".join(said)


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
            f"- {name}: {whole:.2f} times the cost of the {lqi} over all runs; from {ratio[low]:.2f} times "
            f"({', '.join(low)}) to {ratio[high]:.2f} times ({', '.join(high)})."
        )
    return "\n".join(lines)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
