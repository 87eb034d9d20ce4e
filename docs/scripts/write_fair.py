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
from stewart_drake.base.markdown import TextTable, number
from stewart_drake.base.yaml_files import find_file, parse_yaml, read_mapping
from stewart_drake.logs.metrics import mean_cost
from stewart_drake.scenario.scenario import Scenario
from stewart_drake.studies.comparison import Comparison
from stewart_drake.studies.experiment import run_experiment
from stewart_drake.studies.tune import SEARCHED, START, TUNED, load_tuning

POSES = 100

TEXT = """# What the LQI itself adds

Four controllers have the same observer and the same friction compensation. The same search, CMA-ES with {evaluations}
evaluations each, tunes their gains and the observer's disturbance for the same cost over the same {runs} runs:
J = sqrt((RMSE / 0.03 deg)^2 + (RMSE / 0.03 mm)^2 + (RMS change of torque in a millisecond / 0.03 N m)^2), averaged
over the runs. Runs, bounds, start and scales are in [fair.yaml](../../diagrams/comparisons/fair.yaml). The search
runs on the closed form; the verdict is on Drake's plant with other noise. {made}

{answer}

A few percent decide nothing: with the settings of the first search, a change of the observer took computed torque from
0.90 to 1.04 times the cost of the LQI. The two tie.

The tuned settings are less robust; of the cost's runs only those with a payload or a later tick show it. The disk
margin, all six motors at once, least of {poses} random poses near home (`stewart-drake margins`; 0.45 means 25 deg; not
available for a user's own controller) is: {margins}. So none of these settings is a default.

{settings}
"tuned, as searched" has the verdict's noise on the closed form: its difference from "tuned" is due to the plant.

![Cost over evaluations](fair_search.png)

## The verdict, before and after

{verdict}
`make results` recomputes some of these numbers.
"""


def main(searched: Path | None) -> None:
    """Writes them; ends with a line where the search is not whole."""
    results = Path(__file__).parents[1] / "results"
    kept = results.parents[1] / "diagrams" / "comparisons" / "tuned" / "fair.yaml"
    made = "The settings are those of an earlier search, tested\nagain by `make fair_verdict`."
    if searched is not None:
        shutil.copyfile(searched / "tuned.yaml", kept)
        shutil.copyfile(searched / "tune.png", results / "fair_search.png")
        made = "`make fair` makes all of this page."
    tuned = parse_yaml(kept.read_text(encoding="utf-8"), "tuned")["controllers"]
    tuning = load_tuning("fair")
    if set(tuned) != set(tuning.start):
        sys.exit(f"{kept}: {', '.join(tuned)}; the whole search has {', '.join(tuning.start)}")
    # Where the search has its verdict too, so that nothing is run twice.
    folder = (searched or Path("runs/fair-tune")) / f"verdict-{checksum(tuned)[:8]}"
    table = run_experiment(tuning.test(tuned), folder).rows["comparison"]
    page = TEXT.format(
        poses=POSES,
        margins=margins(),
        runs=len(costs(table, f"{next(iter(tuned))}, tuned")),
        evaluations=tuning.evaluations,
        made=made,
        answer=answer({name: costs(table, f"{name}, tuned") for name in tuned}),
        settings=settings(table, tuned),
        verdict=(folder / "comparison.md").read_text(encoding="utf-8"),
    )
    (results / "fair_comparison.md").write_text(page, encoding="utf-8")


def settings(table: list[dict], tuned: dict[str, dict[str, float]]) -> str:
    """Cost before and after, and what was found."""
    rows = []
    for name, found in tuned.items():
        means = (mean_cost(costs(table, f"{name}, {way}").values()) for way in (START, TUNED, SEARCHED))
        shown = ", ".join(f"{key.rpartition('.')[2]} {value:g}" for key, value in found.items())
        rows.append((name, *map(number, means), shown))
    title = "Cost of the verdict, mean of the runs, at the start of the search and tuned"
    return TextTable(title, ("controller", START, TUNED, SEARCHED, "setting"), rows).markdown()


def margins() -> str:
    """Least disk margin of each controller of the package, all motors at once, as it starts and as it was tuned."""
    data = read_mapping("comparison", find_file("comparison", "fair"), 80)
    folder, said = find_file("comparison", "fair").parent, []
    before, after = (Comparison.from_dict({**data, **each}, folder) for each in ({"tuned": None}, {}))
    names = [trial.labels["controller"] for trial in after.trials]
    for name in dict.fromkeys(names):
        place = names.index(name)
        if after.scenario(place).controller.code is None:
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
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
