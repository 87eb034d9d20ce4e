"""Searches what a trained tuner has to beat, and keeps it with the package: `make tuner_baselines`.

python docs/tuner_baselines.py runs/tuner-baselines

CMA-ES on situations that are trained on, on the closed form; what has been run in the folder is not run again.
"""

import sys
from pathlib import Path

import numpy as np

from stewart_drake.base.yaml_files import to_yaml
from stewart_drake.cli.terminal import progress_bar
from stewart_drake.studies.tune import minimise
from stewart_drake.training.benchmark import (
    DIGITS,
    SHIPPED,
    Baselines,
    Benchmark,
    always,
    cases_of,
    cells_for,
    mean_over_cells,
    with_pair,
    with_setting,
)
from stewart_drake.training.situations import ROBOTS, TRAINING, kinds_of

POPULATION = 10
"""Points in a generation of a search."""
LOW, HIGH = np.array([-0.3, -0.6, -1.2, -1.9]), np.array([0.4, 0.4, 0.7, 0.6])
"""Decades about the default within which a setting is searched."""
START = np.array([0.142, -0.347, -0.692, -1.217])
"""Where the search over all kinds starts: the best of an earlier one, from the default and in a smaller box."""
EARLIER = 151
"""Evaluations of that one."""
PAIRS = [(omega_q, omega_r) for omega_q in (0.1, 1.0, 10.0) for omega_r in (0.1, 1.0, 10.0)]
"""The paper's (omega_Q, omega_R)."""
SCHEDULE = np.array([0.02, -0.413, -1.188, -1.688, 0.119, -0.597, -0.694, -0.141, 0.294, -0.302])
"""Where the search of the schedule starts, see `schedule_of`: the best of one when settings could move faster."""
EARLIER_SCHEDULE = 101
"""Evaluations of that one."""
LOWEST, HIGHEST = np.append(np.tile(LOW, 2), [0.1, -2.0]), np.append(np.tile(HIGH, 2), [1.2, -0.3])
"""The same for a schedule: two settings, decades of its threshold and of its time."""


GENERATIONS, GENERATIONS_OF_SCHEDULE, FEW = 6, 11, 3
"""Of the searches: over all kinds, of the schedule, for one robot or kind."""
SEEDS = 3
"""Situations of each kind."""


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

    low, high = LOWEST[: len(start)], HIGHEST[: len(start)]
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
    of_kind = {cell: search(benchmark, [cell], run_on, best, FEW) for cell in cells_for()}
    of_robot = {each: search(benchmark, cells_for(each, True), run_on, best, FEW) for each in ROBOTS}
    numbers = search(
        benchmark, trained, run_on, SCHEDULE, GENERATIONS_OF_SCHEDULE, lambda x: always({"tuner": schedule_of(x)})
    )
    schedule = schedule_of(numbers)
    pairs = {each: best_pair(benchmark, cells_for(each, True), run_on, best) for each in ROBOTS}
    costs = {robot: {} for robot in ROBOTS}
    for kind, robot in cells_for():
        entered = {
            "default": with_setting(np.zeros(4)),
            "best": with_setting(best),
            "best_of_robot": with_setting(of_robot[robot]),
            "best_of_kind": with_setting(of_kind[kind, robot]),
            "pair": with_pair(pairs[robot], best),
            "schedule": always({"tuner": schedule}),
        }
        means = benchmark.log_costs(list(entered.values()), cases_of([(kind, robot)], run_on)).mean(axis=1)
        costs[robot][kind] = {name: float(f"{np.exp(mean):.4g}") for name, mean in zip(entered, means, strict=True)}
    return Baselines.from_dict(
        {
            "best": best.tolist(),
            "best_of_robot": {robot: setting.tolist() for robot, setting in of_robot.items()},
            "best_of_kind": {
                robot: {kind: of_kind[kind, robot].tolist() for kind in kinds_of(robot)} for robot in ROBOTS
            },
            "pair": {robot: list(pair) for robot, pair in pairs.items()},
            "schedule": schedule,
            "costs": costs,
            "evaluations": {
                "each": EARLIER + 1 + GENERATIONS * POPULATION,
                "schedule": EARLIER_SCHEDULE + 1 + GENERATIONS_OF_SCHEDULE * POPULATION,
                "few": 1 + FEW * POPULATION,
                "seeds": SEEDS,
            },
        }
    )


def main(folder: Path) -> None:
    """Writes the file."""
    with (
        progress_bar("baselines", 13_000.0, unit="runs") as advance,
        Benchmark(folder, "closed_form", progress=advance) as benchmark,
    ):
        found = find(benchmark)
    SHIPPED.write_text(to_yaml(found.to_dict()))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
