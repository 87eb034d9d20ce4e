"""The best setting that stays, over all kinds of situations that are trained on, and for each kind alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

import numpy as np

from stewart_drake.campaigns.executors import Workplace
from stewart_drake.control.objective import CostScales
from stewart_drake.errors import ConfigurationError
from stewart_drake.files.whole import write_atomically
from stewart_drake.files.yaml_files import read_mapping, to_yaml
from stewart_drake.section import Real, Section, Text
from stewart_drake.training.contest import (
    Cell,
    Contest,
    Contestant,
    best_of,
    cases_of,
    mean_over_cells,
    with_setting,
)
from stewart_drake.training.situations import ROBOTS, TRAINING, kinds_of

LOW, HIGH = np.array([-0.3, -0.4, -0.7, -1.7]), np.array([0.3, 0.4, 0.7, 0.6])
"""Decades about the default within which a setting is searched: disk margins stay above 0.24 for either robot."""
PAIRS = [(omega_q, omega_r) for omega_q in (0.1, 1.0, 10.0) for omega_r in (0.1, 1.0, 10.0)]
"""The paper's (omega_Q, omega_R)."""
SEEDS = TRAINING[:3]
_POPULATION = 10

Numbers = tuple[Real, Real, Real, Real]


class FixedSettings(Section, key=""):
    """What the search has found: settings (4,) in decades above the default, and what they cost in it."""

    best: Numbers
    """Over both robots."""
    best_of_robot: dict[Text, Numbers]
    """Robot -> the best over its own kinds."""
    best_of_kind: dict[Text, dict[Text, Numbers]]
    """Robot -> kind -> the best for it, also of kinds that nothing is trained on: what knowing the kind is worth."""
    pair: dict[Text, tuple[Real, Real]]
    """Robot -> the best of the paper's nine pairs."""
    costs: dict[Text, dict[Text, dict[Text, Real]]]
    """Robot -> kind -> geometric mean of J over the seeds: default, best, best_of_robot, best_of_kind, pair."""
    evaluations: dict[Text, Real]
    """Settings in each search, and seeds of each kind."""

    @classmethod
    def load(cls, path: Path) -> FixedSettings:
        """Reads the file that `save` writes.

        Raises:
            ConfigurationError: Missing, unreadable or malformed.
        """
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


def find_fixed(
    folder: Path,
    generations: int = 15,
    where: Workplace | Executor | None = None,
    tell: Callable[[str, float], None] | None = None,
    restart: bool = False,
    seeds: int = len(SEEDS),
) -> FixedSettings:
    """Searches, on the reduced engine; what has been run in the folder is not run again.

    Args:
        folder: For the rows.
        generations: Of the search over all kinds and of those for each robot; those for one kind have a third.
        where: Where the runs go; None for processes of this machine.
        tell: Called with what is searched and the number of runs done.
        restart: Throw away what is in the folder.
        seeds: Of each kind.

    Raises:
        ConfigurationError, StewartDrakeError, KeyboardInterrupt: See `Contest`.
    """
    if generations < 1 or seeds < 1:
        raise ConfigurationError("generations", generations, "1 or more, as of seeds")
    scales, run_on, what = CostScales(), TRAINING[:seeds], ""
    shown = tell or (lambda *_: None)
    trained = {robot: [(kind, robot) for kind in kinds_of(robot, trained=True)] for robot in ROBOTS}
    every = [(kind, robot) for robot in ROBOTS for kind in kinds_of(robot)]
    with Contest(folder, "reduced", where, lambda done: shown(what, done), restart) as contest:

        def search(name: str, cells: list[Cell], start: np.ndarray, most: int) -> np.ndarray:
            nonlocal what
            what = name
            options = {"generations": most, "population": _POPULATION}
            return best_of(contest, with_setting, cases_of(cells, run_on), scales, start, LOW, HIGH, **options)[0]

        best = search("all kinds", [cell for cells in trained.values() for cell in cells], np.zeros(4), generations)
        of_robot = {robot: search(robot, trained[robot], best, generations) for robot in ROBOTS}
        few = max(1, generations // 3)
        of_kind = {cell: search(" ".join(cell), [cell], of_robot[cell[1]], few) for cell in every}
        pairs = {robot: _best_pair(contest, trained[robot], run_on, best, scales) for robot in ROBOTS}
        costs: dict[str, dict[str, dict[str, float]]] = {robot: {} for robot in ROBOTS}
        for kind, robot in every:
            entered = {
                "default": with_setting(np.zeros(4)),
                "best": with_setting(best),
                "best_of_robot": with_setting(of_robot[robot]),
                "best_of_kind": with_setting(of_kind[kind, robot]),
                "pair": with_pair(pairs[robot], best),
            }
            found = contest.log_costs(list(entered.values()), cases_of([(kind, robot)], run_on), scales).mean(axis=1)
            costs[robot][kind] = {name: float(f"{np.exp(cost):.4g}") for name, cost in zip(entered, found, strict=True)}
    kinds = {robot: {kind: of_kind[kind, robot].tolist() for kind in kinds_of(robot)} for robot in ROBOTS}
    return FixedSettings.from_dict(
        {
            "best": best.tolist(),
            "best_of_robot": {robot: setting.tolist() for robot, setting in of_robot.items()},
            "best_of_kind": kinds,
            "pair": {robot: list(pair) for robot, pair in pairs.items()},
            "costs": costs,
            "evaluations": {"best": 1 + generations * _POPULATION, "kind": 1 + few * _POPULATION, "seeds": seeds},
        }
    )


def _best_pair(
    contest: Contest, cells: list[Cell], seeds: range, setting: np.ndarray, scales: CostScales
) -> tuple[float, float]:
    cases = cases_of(cells, seeds)
    costs = contest.log_costs([with_pair(pair, setting) for pair in PAIRS], cases, scales)
    return PAIRS[int(np.argmin(mean_over_cells(costs, cases)))]
