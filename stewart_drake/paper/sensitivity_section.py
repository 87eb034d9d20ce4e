"""Sensitivity and robustness, promised by the paper's conclusion: tracking of (37), (38) against one change at a time.

Deviation: the paper gives no numbers to vary; the steps are ours.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from matplotlib.figure import Figure

from stewart_drake.errors import ConfigurationError
from stewart_drake.logs.log import SimulationLog
from stewart_drake.paper.experiments import outcome, pair_of, paper_scenario, refusal, score
from stewart_drake.paper.in_the_loop_section import under_tuner
from stewart_drake.paper.plots.sensitivity_plots import plot_effects
from stewart_drake.paper.report import Section
from stewart_drake.paper.sensitivity_changes import Change, changes, feedforward_share
from stewart_drake.paper.study import Study
from stewart_drake.robot import RobotParameters
from stewart_drake.scenario import Scenario

DURATION = 6.28
"""[s] two periods of (37), (38): errors are judged over the second."""
MATTERS, HARDLY = 10.0, 1.0
"""[%] of the unchanged value from which a change matters, and up to which it hardly does."""
BLOWN_UP = 2.0
"""Times the unchanged pose RMSE beyond which a run that completes counts as blown up."""

QUANTITIES = {"pose_mm": "pose RMSE [mm]", "torque_rms": "torque RMS [N m]"}
"""Of a score -> as its figure names them."""

_UNCHANGED = ("unchanged", "")

Score = dict[str, float]


@dataclass(frozen=True)
class Effect:
    """What came of a change.

    Attributes:
        factor: What was changed.
        label: To what.
        score: None where the run ended early, or could not begin.
        ended: `completed`, or why not.
    """

    factor: str
    label: str
    score: Score | None
    ended: str


@dataclass(frozen=True)
class Response:
    """One controller under all changes.

    Attributes:
        name: Of the controller.
        unchanged: Score without any change; None where even that run ended early.
        effects: One for each change.
    """

    name: str
    unchanged: Score | None
    effects: tuple[Effect, ...]

    def shift(self, effect: Effect, quantity: str) -> float | None:
        """[%] change of a quantity against the unchanged run; None where one of the two did not complete."""
        if effect.score is None or self.unchanged is None:
            return None
        return 100.0 * (effect.score[quantity] / self.unchanged[quantity] - 1.0)

    def swings(self, quantity: str) -> dict[str, float]:
        """[%] largest change up or down by factor, the largest first; inf where a run of the factor ended early."""
        found: dict[str, float] = {}
        for effect in self.effects:
            shift = self.shift(effect, quantity)
            size = math.inf if shift is None else abs(shift)
            found[effect.factor] = max(size, found.get(effect.factor, 0.0))
        return dict(sorted(found.items(), key=lambda item: -item[1]))

    def named(self, least: float, most: int | None = None) -> str:
        """The first factors that move the pose error by `least` [%] or more, in words; by how much, or ends early."""
        swings = [(factor, swing) for factor, swing in self.swings("pose_mm").items() if swing >= least]
        words = ((factor, "ends early" if math.isinf(swing) else f"{swing:.0f} %") for factor, swing in swings[:most])
        return ", ".join(f"{factor} ({much})" for factor, much in words)

    def weak(self, most: float) -> list[str]:
        """Factors that move the pose error by no more than `most` [%]."""
        return [factor for factor, swing in self.swings("pose_mm").items() if swing <= most]


def make(study: Study) -> Section:
    """The section; see the module."""
    base, responses = study.base, _run(study)
    numbers: dict[str, Any] = {"controllers": {r.name: _numbers(r) for r in responses}}
    if base.gravity != 0.0 and base.lqi.feedforward != "none":
        numbers["feedforward_share"] = {
            f"{step:+d} mm": feedforward_share(
                base.robot.replace(rod_length=base.robot.rod_length + 1e-3 * step), base.believed_robot, base.gravity
            )
            for step in (-1, 1)
        }
    figures = {f"sensitivity_{r.name.replace(' ', '_')}": _figure(r, r.unchanged) for r in responses if r.unchanged}
    fallen = {r.name: [e.label for e in r.effects if e.factor == "masses" and e.score is None] for r in responses}
    every = dict.fromkeys((e.factor, e.label) for r in responses for e in r.effects)
    return study.section(
        "sensitivity",
        numbers,
        figures,
        **findings(responses),
        duration=study.pick(DURATION, 0.5 * DURATION),
        table={change: [cell for r in responses for cell in _cells(r, *change)] for change in every},
        fallen={name: labels for name, labels in fallen.items() if labels},
        matters=MATTERS,
        hardly=HARDLY,
    )


def findings(responses: Sequence[Response]) -> dict[str, Any]:
    """What the verdict rests on: how many runs end early or blow up, and which controllers complete all of theirs."""
    effects = [(r, e) for r in responses for e in r.effects]
    return {
        "responses": responses,
        "steady": [r.unchanged is not None and all(e.score is not None for e in r.effects) for r in responses],
        "changed": len(effects),
        "early": sum(e.score is None for _, e in effects),
        "blown": sum((r.shift(e, "pose_mm") or 0.0) > 100.0 * (BLOWN_UP - 1.0) for r, e in effects),
        "blown_up": BLOWN_UP,
    }


def _numbers(response: Response) -> dict[str, Any]:
    effects = [{"factor": e.factor, "to": e.label, "ended": e.ended, "score": e.score} for e in response.effects]
    return {"unchanged": {"score": response.unchanged}, "effects": effects}


def controllers(study: Study) -> dict[str, Scenario]:
    """The tuner and fixed weights on (37), (38), by name."""
    duration = study.pick(DURATION, 0.5 * DURATION)
    feedforward = study.base.lqi.feedforward
    ratios = study.pick((1.0, 100.0), (1.0,))
    fixed = {
        f"ratio {ratio:g}": paper_scenario(study.base, duration, study.base.gravity, feedforward, pair_of(ratio))
        for ratio in ratios
    }
    return {"tuner": under_tuner(study, fixed["ratio 1"]), **fixed}


def _run(study: Study) -> list[Response]:
    refusals: dict[RobotParameters, str | None] = {study.base.robot: None}
    plans: dict[str, dict[tuple[str, str], Scenario | str]] = {}
    for name, base in controllers(study).items():
        every = changes(base, study.folder / study.name("scaled_tuners"))
        wanted = (change for change in every if change.quick or not study.quick)
        applied = {(c.factor, c.label): _applied(c, base, refusals) for c in wanted}
        plans[name] = {_UNCHANGED: base, **{change: plan for change, plan in applied.items() if plan != base}}
    scenarios = {(n, c): plan for n, of in plans.items() for c, plan in of.items() if isinstance(plan, Scenario)}
    logs = study.run(scenarios, 0.0, 0.95, check=False)
    responses = []
    for name, of in plans.items():
        effects = [_effect(change, plan, logs.get((name, change))) for change, plan in of.items()]
        responses.append(Response(name, effects[0].score, tuple(effects[1:])))
    return responses


def _effect(change: tuple[str, str], plan: Scenario | str, log: SimulationLog | None) -> Effect:
    return Effect(*change, None, f"not run: {plan}") if log is None else Effect(*change, score(log), outcome(log))


def _applied(change: Change, base: Scenario, refusals: dict[RobotParameters, str | None]) -> Scenario | str:
    """The changed scenario, or why there is none: a value that is not allowed, a reference out of the robot's limits.

    Whether the robot can follow the reference does not depend on its controller, so each robot is checked once.
    """
    try:
        scenario = base.replace(change.keys)
    except ConfigurationError as error:
        return str(error)
    if scenario.robot not in refusals:
        refusals[scenario.robot] = refusal(scenario)
    return refusals[scenario.robot] or scenario


def _cells(response: Response, factor: str, label: str) -> list[str | None]:
    """Pose error and torque after a change, with their shifts; how the run ended where it ended early."""
    effect = next((e for e in response.effects if (e.factor, e.label) == (factor, label)), None)
    if effect is None:
        return [None, None]
    if effect.score is None:
        return [effect.ended, None]
    cells: list[str | None] = []
    for quantity in QUANTITIES:
        shift = response.shift(effect, quantity)
        value = f"{effect.score[quantity]:.4g}"
        cells.append(value if shift is None or effect.score == response.unchanged else f"{value} ({shift:+z.1f} %)")
    return cells


def _figure(response: Response, unchanged: Score) -> Figure:
    order = list(response.swings("pose_mm"))
    effects = [
        (e.factor, e.label, [None if e.score is None else e.score[quantity] for quantity in QUANTITIES])
        for e in sorted(response.effects, key=lambda e: order.index(e.factor))
    ]
    values = {words: unchanged[quantity] for quantity, words in QUANTITIES.items()}
    return plot_effects(values, effects, logarithmic=QUANTITIES["pose_mm"])
