"""What a trained tuner has to beat, by searches on what it is trained on: settings that stay, and a schedule."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from stewart_drake.campaigns.executors import Workplace
from stewart_drake.files.whole import PACKAGE, write_atomically
from stewart_drake.files.yaml_files import read_mapping, to_yaml
from stewart_drake.section import Real, Section, Text
from stewart_drake.training.contest import (
    DIGITS,
    POPULATION,
    Case,
    Cell,
    Contest,
    Contestant,
    best_of,
    cases_of,
    cells_for,
    mean_over_cells,
    with_setting,
)
from stewart_drake.training.situations import KINDS, ROBOTS, TRAINING, Changes, kinds_of

SHIPPED = PACKAGE / "weights" / "baselines.yaml"
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
_LOWEST, _HIGHEST = np.append(np.tile(LOW, 2), [0.1, -2.0]), np.append(np.tile(HIGH, 2), [1.2, -0.3])
"""The same for a schedule: two settings, decades of its threshold and of its time."""

Numbers = tuple[Real, Real, Real, Real]


class Baselines(Section, key=""):
    """What the search has found: settings (4,) in decades above the default, and what they cost in it."""

    name: Text = "baselines"
    best: Numbers
    """Over both robots."""
    best_of_robot: dict[Text, Numbers]
    """Robot -> the best over its own kinds."""
    best_of_kind: dict[Text, dict[Text, Numbers]]
    """Robot -> kind -> the best for it, also of kinds that nothing is trained on: what knowing the kind is worth."""
    pair: dict[Text, tuple[Real, Real]]
    """Robot -> the best of the paper's nine pairs."""
    schedule: dict[Text, Any]
    """Keys of `ScheduleTuner`, made over both robots."""
    costs: dict[Text, dict[Text, dict[Text, Real]]]
    """Robot -> kind -> geometric mean of J over the seeds: default, and the above."""
    evaluations: dict[Text, Real]
    """Points in each search, and seeds of each kind."""

    @classmethod
    def load(cls, path: Path | None = None) -> Baselines:
        """Reads the file that `save` writes; None takes the one that the package carries.

        Raises:
            ConfigurationError: Missing, unreadable or malformed.
        """
        path = SHIPPED if path is None else path
        return cls.from_dict(read_mapping("settings", path, 200))

    def save(self, path: Path) -> None:
        """Writes it as YAML.

        Raises:
            ConfigurationError: The folder is missing or not writable.
        """
        write_atomically(path, to_yaml(self.to_dict()).encode())


def with_pair(pair: tuple[float, float], setting: Sequence[float] | np.ndarray) -> Contestant:
    """The paper's pair of weights, held fixed, with the observer of a setting (4,)."""
    told = with_setting(setting)

    def changes(case: Any, scenario: Any) -> dict[str, Any]:
        tuner = {"kind": "fixed", "omega_q": pair[0], "omega_r": pair[1]}
        return {**told(case, scenario), "tuner": tuner}

    return changes


class Generations(NamedTuple):
    """Of the searches, `POPULATION` points each: over all kinds, of the schedule, for one robot or kind."""

    best: int = 6
    schedule: int = 11
    few: int = 3


def schedule_of(numbers: np.ndarray) -> Changes:
    """Keys of a `ScheduleTuner` from ten numbers: two settings, and decades of its threshold and of its time."""
    calm, alert, (threshold, hold) = np.split(np.round(numbers, DIGITS), [4, 8])
    keys = {"threshold": float(f"{10.0**threshold:.4g}"), "hold": float(f"{10.0**hold:.4g}")}
    return {"kind": "schedule", "calm": calm.tolist(), "alert": alert.tolist(), **keys}


def always(changes: Changes) -> Contestant:
    """A contestant that is the same in all situations."""
    return lambda *_: changes


def find_baselines(
    folder: Path,
    generations: Generations = Generations(),  # noqa: B008 - it cannot be changed
    seeds: int = 3,
    where: Workplace | Executor | None = None,
    tell: Callable[[str, float], None] | None = None,
    restart: bool = False,
) -> Baselines:
    """Searches, on the reduced engine; what has been run in the folder is not run again.

    Args:
        folder: For the rows.
        generations: Of the searches; all but the first start from what that has found.
        seeds: Of each kind.
        where: Where the runs go; None for processes of this machine.
        tell: Called with what is searched and the number of runs done.
        restart: Throw away what is in the folder.

    Raises:
        ConfigurationError, StewartDrakeError, KeyboardInterrupt: See `Contest`.
    """
    run_on, what = TRAINING[:seeds], ""
    shown = tell or (lambda *_: None)
    every = cells_for()
    trained = [cell for cell in every if KINDS[cell[0]].trained]
    with Contest(folder, "reduced", where, lambda done: shown(what, done), restart) as contest:

        def search(
            name: str,
            cells: list[Cell],
            start: np.ndarray,
            most: int,
            contestant_of: Callable[[np.ndarray], Contestant] = with_setting,
        ) -> np.ndarray:
            nonlocal what
            what, cases = name, cases_of(cells, run_on)
            low, high = (box[: len(start)] for box in (_LOWEST, _HIGHEST))
            return best_of(contest, contestant_of, cases, start, low, high, most)

        best = search("all kinds", trained, START, generations.best)
        few = generations.few
        of_kind = {cell: search(" ".join(cell), [cell], best, few) for cell in every}
        of_robot = {each: search(each, [cell for cell in trained if cell[1] == each], best, few) for each in ROBOTS}
        schedule = schedule_of(
            search("schedule", trained, SCHEDULE, generations.schedule, lambda x: always({"tuner": schedule_of(x)}))
        )
        pairs = {
            each: _best_pair(contest, cases_of([c for c in trained if c[1] == each], run_on), best) for each in ROBOTS
        }
        costs: dict[str, dict[str, dict[str, float]]] = {robot: {} for robot in ROBOTS}
        for kind, robot in every:
            entered = {
                "default": with_setting(np.zeros(4)),
                "best": with_setting(best),
                "best_of_robot": with_setting(of_robot[robot]),
                "best_of_kind": with_setting(of_kind[kind, robot]),
                "pair": with_pair(pairs[robot], best),
                "schedule": always({"tuner": schedule}),
            }
            found = contest.log_costs(list(entered.values()), cases_of([(kind, robot)], run_on)).mean(axis=1)
            costs[robot][kind] = {name: float(f"{np.exp(each):.4g}") for name, each in zip(entered, found, strict=True)}
    kinds = {robot: {kind: of_kind[kind, robot].tolist() for kind in kinds_of(robot)} for robot in ROBOTS}
    return Baselines.from_dict(
        {
            "best": best.tolist(),
            "best_of_robot": {robot: setting.tolist() for robot, setting in of_robot.items()},
            "best_of_kind": kinds,
            "pair": {robot: list(pair) for robot, pair in pairs.items()},
            "schedule": schedule,
            "costs": costs,
            "evaluations": {
                "each": EARLIER + 1 + generations.best * POPULATION,
                "schedule": EARLIER_SCHEDULE + 1 + generations.schedule * POPULATION,
                "few": 1 + few * POPULATION,
                "seeds": seeds,
            },
        }
    )


def _best_pair(contest: Contest, cases: list[Case], setting: np.ndarray) -> tuple[float, float]:
    costs = contest.log_costs([with_pair(pair, setting) for pair in PAIRS], cases)
    return PAIRS[int(np.argmin(mean_over_cells(costs, cases)))]
