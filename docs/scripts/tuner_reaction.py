"""How soon a tuner has to react, and what a wider box would be worth: tables for docs/results/tuner_training.md.

python docs/scripts/tuner_reaction.py     # some minutes on two cores
"""

from typing import Any, NamedTuple

import numpy as np

from stewart_drake.base.jit import njit
from stewart_drake.base.markdown import markdown_table
from stewart_drake.base.records import Record, Vec4, record
from stewart_drake.control.features import CostScales
from stewart_drake.control.policy import Policy, slew
from stewart_drake.mechanics.linear_algebra import copy_to
from stewart_drake.studies.runs import simulate_unchecked
from stewart_drake.studies.workers import Workers, run_all
from stewart_drake.training.benchmark import (
    HIGHEST,
    LOWEST,
    Baselines,
    cases_of,
    cells_for,
    log_cost,
    mean_over_cells,
    measure_parts,
    with_setting,
)
from stewart_drake.training.policy_training import episode_cost, fast_scenario, fixed_cost, tuned_by
from stewart_drake.training.situations import VALIDATION, kinds_of

SEEDS = VALIDATION[120:128]
EVENTS = ("blows", "pushes", "load jump")
LATE = (0.0, 0.02, 0.05, 0.1)
"""[s] after the event from which on the setting is another."""
INTEGRALS = (-1.6, -2.2, -2.6, -3.0, -4.0)


class ChangeParams(Record):
    """Parameters of a change of the setting."""

    before: Vec4
    after: Vec4
    time: float  # [s]


class Change(NamedTuple):
    """Settings (4,) before and after a time [s], as a source of settings; between them it moves as a policy does."""

    before: np.ndarray
    after: np.ndarray
    time: float

    @property
    def centre(self) -> np.ndarray:
        """The first setting."""
        return self.before

    @property
    def width(self) -> np.ndarray:
        """Of the box of the searches."""
        return HIGHEST - LOWEST

    @property
    def kernel(self) -> Any:
        """The law."""
        return change_tick

    def params(self) -> ChangeParams:
        """Its constants."""
        return ChangeParams.new(self)


@njit
def change_tick(params, change, density, error, torque, innovation, reference, state):  # noqa: ARG001
    """A tick: the setting of before or after."""
    at, change = record(state), record(change)
    at.ticks += 1.0
    target = np.empty(4)
    copy_to(target, change.after[:] if at.ticks * record(params).period > change.time else change.before[:])
    slew(params, target, 1.0, state)


def change_cost(before, after, late, case):
    """Logarithm of J of a run whose setting changes some time after its event."""
    scenario = fast_scenario(case)
    log = simulate_unchecked(tuned_by(Change(before, after, scenario.disturbances[0].time + late), scenario))
    return log_cost({"status": log.status, **measure_parts(log)}, CostScales())


def reaction(found, workers):
    """A table: J over that of the stiff setting, of the best fixed one that becomes stiff so long after the event."""
    best, stiff = np.array(found.best), np.array(found.stiff)
    rows = []
    for robot, kind in ((robot, kind) for robot in ("paper", "reachy_mini") for kind in EVENTS):
        if kind not in kinds_of(robot):
            continue
        cases = cases_of([(kind, robot)], SEEDS)
        ways = [(best, stiff, late) for late in (*LATE, 1e9)]
        costs = np.reshape(
            run_all(change_cost, [(*way, case) for way in ways for case in cases], workers), (-1, len(cases))
        )
        against = np.array(run_all(fixed_cost, [(with_setting(stiff), case) for case in cases], workers))
        policy = np.array(run_all(episode_cost, [(Policy.load(), case) for case in cases], workers))
        shown = np.exp(np.mean([*costs, policy] - against, axis=1))
        rows.append([kind, robot, *(f"{each:.2f}" for each in shown)])
    header = ["kind", "robot", *(f"{1e3 * late:g} ms" for late in LATE), "never", "the policy that ships"]
    return markdown_table(header, rows)


def wider(found, workers):
    """A table: J of the best fixed setting with more or less integral over its own, all kinds counting alike."""
    cases = cases_of(cells_for(trained=True), SEEDS[:6])
    settings = [np.array([*found.best[:2], integral, found.best[3]]) for integral in INTEGRALS]
    work = [(with_setting(each), case) for each in (np.array(found.best), *settings) for case in cases]
    costs = np.reshape(run_all(fixed_cost, work, workers), (-1, len(cases)))
    shown = np.exp(mean_over_cells(costs[1:] - costs[0], cases))
    header = [f"{integral:g}" for integral in INTEGRALS]
    return markdown_table(["integral", *header], [["J over best fixed", *(f"{each:.3f}" for each in shown)]])


def main():
    """Prints both tables."""
    found, workers = Baselines.load(), Workers(None, worn=None)
    print(reaction(found, workers))
    print()
    print(wider(found, workers))


if __name__ == "__main__":
    main()
