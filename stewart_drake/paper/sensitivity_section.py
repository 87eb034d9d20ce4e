"""Sensitivity and robustness, promised by the paper's conclusion: tracking of (37), (38) against one change at a time.

Deviation: the paper gives no numbers to vary; the steps are ours.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

from matplotlib.figure import Figure

from stewart_drake.errors import ConfigurationError
from stewart_drake.paper.experiments import outcome, pair_of, paper_scenario
from stewart_drake.paper.in_the_loop_section import under_tuner
from stewart_drake.paper.plots.sensitivity_plots import Tornado, TornadoBar, plot_tornados
from stewart_drake.paper.report import Section
from stewart_drake.paper.sensitivity_changes import Change, changes, feedforward_share, longer
from stewart_drake.paper.study import Study
from stewart_drake.paper.tracking_score import TrackingScore, refusal, tracking_score
from stewart_drake.robot import RobotParameters
from stewart_drake.scenario import AnnTuner, Scenario

DURATION = 6.28
"""[s] two periods of (37), (38): errors are judged over the second."""
MATTERS, HARDLY = 10.0, 1.0
"""[%] of the unchanged value from which a change matters, and up to which it hardly does."""
BLOWN_UP = 2.0
"""Times the unchanged pose RMSE beyond which a run that completes counts as blown up."""

Quantity = Literal["pose_mm", "torque_rms"]


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
    score: TrackingScore | None
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
    unchanged: TrackingScore | None
    effects: tuple[Effect, ...]

    def shift(self, effect: Effect, quantity: Quantity) -> float | None:
        """[%] change of a quantity against the unchanged run; None where one of the two did not complete."""
        if effect.score is None or self.unchanged is None:
            return None
        return 100.0 * (getattr(effect.score, quantity) / getattr(self.unchanged, quantity) - 1.0)

    def swings(self, quantity: Quantity) -> dict[str, float]:
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
            f"{step:+d} mm": feedforward_share(longer(base.robot, 1e-3 * step), base.believed_robot, base.gravity)
            for step in (-1, 1)
        }
    figures = {f"sensitivity_{r.name.replace(' ', '_')}": _figure(r) for r in responses if r.unchanged is not None}
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
    def of(score: TrackingScore | None) -> dict[str, Any]:
        return {"score": None if score is None else asdict(score)}

    effects = [{"factor": e.factor, "to": e.label, "ended": e.ended, **of(e.score)} for e in response.effects]
    return {"unchanged": of(response.unchanged), "effects": effects}


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
    wanted = [c for c in changes(study.folder / study.name("scaled_tuners")) if c.quick or not study.quick]
    refusals: dict[RobotParameters, str | None] = {study.base.robot: None}
    plans: list[tuple[str, Change | None, Scenario | str]] = []
    for name, base in controllers(study).items():
        plans.append((name, None, base))
        for change in wanted:
            if change.factor == "window m" and not isinstance(base.tuner, AnnTuner):
                continue
            plan = _applied(change, base, refusals)
            if plan != base:
                plans.append((name, change, plan))
    scenarios = [plan for _, _, plan in plans if isinstance(plan, Scenario)]
    logs = iter(study.store.run_all(scenarios, lambda share: study.progress(0.95 * share), check=False))
    responses: dict[str, Response] = {}
    for name, made, plan in plans:
        log = next(logs) if isinstance(plan, Scenario) else None
        score = None if log is None else tracking_score(log)
        if made is None:
            responses[name] = Response(name, score, ())
            continue
        ended = f"not run: {plan}" if log is None else outcome(log)
        effect = Effect(made.factor, made.label, score, ended)
        responses[name] = replace(responses[name], effects=(*responses[name].effects, effect))
    return list(responses.values())


def _applied(change: Change, base: Scenario, refusals: dict[RobotParameters, str | None]) -> Scenario | str:
    """The changed scenario, or why there is none: a value that is not allowed, a reference out of the robot's limits.

    Whether the robot can follow the reference does not depend on its controller, so each robot is checked once.
    """
    try:
        scenario = change.apply(base)
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
    quantities: tuple[Quantity, ...] = ("pose_mm", "torque_rms")
    for quantity in quantities:
        shift = response.shift(effect, quantity)
        value = f"{getattr(effect.score, quantity):.4g}"
        cells.append(value if shift is None or effect.score == response.unchanged else f"{value} ({shift:+z.1f} %)")
    return cells


def _figure(response: Response) -> Figure:
    tornados = []
    quantities: tuple[tuple[Quantity, str, str], ...] = (
        ("pose_mm", "pose RMSE", "mm"),
        ("torque_rms", "torque RMS", "N m"),
    )
    for quantity, name, unit in quantities:
        bars = []
        for factor in response.swings(quantity):
            own = [effect for effect in response.effects if effect.factor == factor]
            levels = [(e.label, None if e.score is None else getattr(e.score, quantity)) for e in own]
            bars.append(TornadoBar(factor, levels))
        unchanged = getattr(response.unchanged, quantity)
        tornados.append(Tornado(name, unit, unchanged, bars, logarithmic=quantity == "pose_mm"))
    return plot_tornados(tornados)
