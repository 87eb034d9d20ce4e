"""Searches the settings that a trained tuner has to beat: `python docs/scripts/tuner_baselines.py runs/baselines`.

python docs/scripts/tuner_baselines.py runs/tuner-baselines

CMA-ES on situations that are trained on, on the closed form; what has been run in the folder is not run again.
"""

import sys
from pathlib import Path

import numpy as np

from stewart_drake.base.yaml_files import to_yaml
from stewart_drake.cli.terminal import progress_bar
from stewart_drake.control.features import CostScales
from stewart_drake.studies.runs import RowStore, identity
from stewart_drake.studies.tune import minimise
from stewart_drake.training.benchmark import (
    DIGITS,
    HIGHEST,
    LOWEST,
    ORACLE,
    SHIPPED,
    Baselines,
    always,
    candidate_trial,
    cases_of,
    cells_for,
    fixed_rows,
    log_cost,
    mean_over_cells,
    oracle,
    with_pair,
    with_setting,
    work_of,
)
from stewart_drake.training.situations import ROBOTS, TRAINING, kinds_of

POPULATION = 10
"""Points in a generation of a search."""
START = np.array([0.142, -0.347, -0.692, -1.217])
"""Where the search over all kinds starts: the best of an earlier one, from the default and in a smaller box."""
PAIRS = [(omega_q, omega_r) for omega_q in (0.1, 1.0, 10.0) for omega_r in (0.1, 1.0, 10.0)]
"""The paper's (omega_Q, omega_R)."""
SCHEDULE = np.array([0.02, -0.413, -1.188, -1.688, 0.119, -0.597, -0.694, -0.141, 0.294, -0.302])
"""Where the search of the schedule starts, see `schedule_of`: the best of one when settings could move faster."""
SCHEDULE_LOW, SCHEDULE_HIGH = np.append(np.tile(LOWEST, 2), [0.1, -2.0]), np.append(np.tile(HIGHEST, 2), [1.2, -0.3])
"""The box for a schedule: two settings, decades of its threshold and of its time."""
GENERATIONS, GENERATIONS_OF_SCHEDULE, FEW = 7, 8, 4
"""Of the searches: over all kinds, of the schedule, for one robot, one kind or the rough kinds."""
SEEDS = 3
"""Situations of each kind."""
ROUGH = ("load jump", "pushes", "blows", "saturation", "stiction")
"""Kinds in which a stiff loop helps most."""


class Benchmark(RowStore):
    """Runs of candidates for a search on a kind of plant, see `RowStore`."""

    def __init__(self, folder, plant, workers=None, progress=None):
        super().__init__(folder, identity(work_of(plant)), workers, progress)
        self._plant = plant

    def run(self, candidates, cases):
        """Rows of all candidates in all cases."""
        return self.rows([candidate_trial(self._plant, candidate, case) for candidate in candidates for case in cases])

    def log_costs(self, candidates, cases):
        """Logarithms of J (candidates, cases)."""
        costs = [log_cost(row, CostScales()) for row in self.run(candidates, cases)]
        return np.reshape(costs, (len(candidates), len(cases)))


def schedule_of(numbers):
    """A `ScheduleTuner` from ten numbers: two settings, and decades of its threshold and of its time."""
    calm, alert, (threshold, hold) = np.split(np.round(numbers, DIGITS), [4, 8])
    keys = {"threshold": float(f"{10.0**threshold:.4g}"), "hold": float(f"{10.0**hold:.4g}")}
    return {"kind": "schedule", "calm": calm.tolist(), "alert": alert.tolist(), **keys}


def search(benchmark, cells, seeds, start, generations, candidate_of=with_setting):
    """Numbers of the candidate with the least mean logarithm of its costs, each cell counting alike."""
    cases = cases_of(cells, seeds)

    def evaluate(points):
        candidates = [candidate_of(np.round(point, DIGITS)) for point in points]
        return mean_over_cells(benchmark.log_costs(candidates, cases), cases).tolist()

    low, high = SCHEDULE_LOW[: len(start)], SCHEDULE_HIGH[: len(start)]
    best, _ = minimise(evaluate, start, low, high, generations=generations, population=POPULATION, seed=1)
    return np.round(best, DIGITS)


def best_pair(benchmark, cells, seeds, setting):
    """Of `PAIRS`."""
    cases = cases_of(cells, seeds)
    costs = benchmark.log_costs([with_pair(pair, setting) for pair in PAIRS], cases)
    return PAIRS[int(np.argmin(mean_over_cells(costs, cases)))]


def find(benchmark):
    """The baselines."""
    run_on = TRAINING[:SEEDS]
    trained = cells_for(trained=True)
    best = search(benchmark, trained, run_on, START, GENERATIONS)
    stiff = search(benchmark, [cell for cell in trained if cell[0] in ROUGH], run_on, best, FEW)
    of_kind = {cell: search(benchmark, [cell], run_on, best, FEW) for cell in cells_for()}
    of_robot = {each: search(benchmark, cells_for(each, True), run_on, best, FEW) for each in ROBOTS}
    numbers = search(
        benchmark, trained, run_on, SCHEDULE, GENERATIONS_OF_SCHEDULE, lambda x: always({"tuner": schedule_of(x)})
    )
    found = Baselines.from_dict(
        {
            "best": best.tolist(),
            "stiff": stiff.tolist(),
            "best_of_robot": {robot: setting.tolist() for robot, setting in of_robot.items()},
            "best_of_kind": {
                robot: {kind: of_kind[kind, robot].tolist() for kind in kinds_of(robot)} for robot in ROBOTS
            },
            "pair": {each: list(best_pair(benchmark, cells_for(each, True), run_on, best)) for each in ROBOTS},
            "schedule": schedule_of(numbers),
            "costs": {},
            "evaluations": {
                "best": 1 + GENERATIONS * POPULATION,
                "schedule": 1 + GENERATIONS_OF_SCHEDULE * POPULATION,
                "few": 1 + FEW * POPULATION,
                "seeds": SEEDS,
            },
        }
    )
    return Baselines.from_dict({**found.to_dict(), "costs": costs_of(benchmark, found, run_on)})


def costs_of(benchmark, found, seeds):
    """`Baselines.costs`."""
    costs = {robot: {} for robot in ROBOTS}
    entered = {**fixed_rows(found), "schedule": always({"tuner": found.schedule}), ORACLE: oracle(found)}
    for kind, robot in cells_for():
        means = benchmark.log_costs(list(entered.values()), cases_of([(kind, robot)], seeds)).mean(axis=1)
        # YAML does not read a key that a line's end divides.
        names = [name.replace(" ", "_") for name in entered]
        costs[robot][kind] = {name: float(f"{np.exp(mean):.4g}") for name, mean in zip(names, means, strict=True)}
    return costs


def main(folder: Path) -> None:
    """Writes the file."""
    with (
        progress_bar("baselines", 24_700.0, unit="runs") as advance,
        Benchmark(folder, "closed_form", progress=advance) as benchmark,
    ):
        found = find(benchmark)
    SHIPPED.write_text(to_yaml(found.to_dict()), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
