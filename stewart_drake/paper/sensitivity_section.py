"""Sensitivity and robustness, promised by the paper's conclusion: tracking of (37), (38) against one change at a time.

Deviation: the paper gives no numbers to vary; the steps are ours.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

from stewart_drake.errors import ConfigurationError
from stewart_drake.paper.in_the_loop_section import under_tuner
from stewart_drake.paper.nine_experiments_section import outcome, pair_of, paper_scenario
from stewart_drake.paper.report import Section, holds
from stewart_drake.paper.sensitivity_changes import Change, changes, feedforward_share, longer
from stewart_drake.paper.study import Study
from stewart_drake.paper.tracking_score import TrackingScore, refusal, tracking_score
from stewart_drake.robot import RobotParameters
from stewart_drake.scenario import AnnTuner, Scenario

_CLAIM = (
    "Sensitivity to the controller's parameters and robustness are left to a later publication (section V); the "
    "integral action is to reject what is uncertain in the dynamics (section III.A)."
)
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


def make(study: Study) -> Section:
    """The section; see the module."""
    section = Section("sensitivity", "Sensitivity and robustness", _CLAIM)
    responses = _run(study)
    section.numbers = {"controllers": {r.name: _numbers(r) for r in responses}}
    _overview(section, study, responses)
    _figures(section, study, responses)
    _findings(section, study, responses)
    section.verdict = verdict(responses)
    return section


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


def _overview(section: Section, study: Study, responses: Sequence[Response]) -> None:
    duration = study.pick(DURATION, 0.5 * DURATION)
    section.text(
        f"(37), (38) for {duration:g} s, errors over the second half; pose RMSE as in the section on the tuner in the "
        "loop, torque RMS over all motors and the same time. One thing is changed at a time. Masses, inertias (of all "
        "moving bodies) and rods are those of the simulated robot; the controller, its feedforward included, goes on "
        "believing in the nominal ones. The window m of (35), (36) counts ticks, so another sample time is another "
        "window in seconds; the network is not trained again for either. For the network, omega_Q and omega_R are "
        "changed at its output. What comes of a controller that leaves gravity out is in the nine experiments."
    )
    every = {(e.factor, e.label): None for r in responses for e in r.effects}
    rows: list[tuple[object, ...]] = [("unchanged", "", *(c for r in responses for c in _cells(r, r.unchanged)))]
    for factor, label in every:
        cells: list[object] = []
        for response in responses:
            effect = next((e for e in response.effects if (e.factor, e.label) == (factor, label)), None)
            if effect is None:
                cells += [None, None]
            elif effect.score is None:
                cells += [effect.ended, None]
            else:
                cells += _cells(response, effect.score)
        rows.append((factor, label, *cells))
    section.table(
        "Pose RMSE [mm] and torque RMS [N m] after each change, and by how much that differs from the unchanged run",
        ("factor", "changed to", *(f"{r.name}: {q}" for r in responses for q in ("pose [mm]", "torque [N m]"))),
        rows,
    )


def _cells(response: Response, score: TrackingScore | None) -> list[object]:
    if score is None:
        return [None, None]
    if response.unchanged is None or score == response.unchanged:
        return [score.pose_mm, score.torque_rms]
    effect = Effect("", "", score, "completed")
    pose, torque = response.shift(effect, "pose_mm"), response.shift(effect, "torque_rms")
    return [f"{score.pose_mm:.4g} ({pose:+z.1f} %)", f"{score.torque_rms:.4g} ({torque:+z.1f} %)"]


def _figures(section: Section, study: Study, responses: Sequence[Response]) -> None:
    from stewart_drake.paper.plots.sensitivity_plots import Tornado, TornadoBar, plot_tornados

    quantities: tuple[tuple[Quantity, str, str], ...] = (
        ("pose_mm", "pose RMSE", "mm"),
        ("torque_rms", "torque RMS", "N m"),
    )
    for response in responses:
        if response.unchanged is None:
            continue
        tornados = []
        for quantity, name, unit in quantities:
            bars = [
                TornadoBar(
                    factor,
                    [
                        (e.label, None if e.score is None else getattr(e.score, quantity))
                        for e in response.effects
                        if e.factor == factor
                    ],
                )
                for factor in response.swings(quantity)
            ]
            value = getattr(response.unchanged, quantity)
            tornados.append(Tornado(name, unit, value, bars, logarithmic=quantity == "pose_mm"))
        section.figure(
            f"{response.name}: largest effect on top; the line is the unchanged run",
            study.save_figure(plot_tornados(tornados), f"sensitivity_{response.name.replace(' ', '_')}"),
        )


def _findings(section: Section, study: Study, responses: Sequence[Response]) -> None:
    lines = []
    for response in responses:
        swings = response.swings("pose_mm")
        strong = [_named(factor, swing) for factor, swing in swings.items() if swing >= MATTERS]
        weak = [factor for factor, swing in swings.items() if swing <= HARDLY]
        rest = f"; by {HARDLY:g} % at most with {', '.join(weak)}" if weak else ""
        lines.append(
            f"- {response.name}: pose RMSE moves by {MATTERS:g} % or more with {', '.join(strong) or 'nothing'}{rest}."
        )
    section.text("\n".join(lines))
    base = study.base
    if base.gravity == 0.0 or base.lqi.feedforward == "none":
        return
    fallen = {r.name: [e.label for e in r.effects if e.factor == "masses" and e.score is None] for r in responses}
    if any(fallen.values()):
        named = "; ".join(f"{name} at {', '.join(labels)}" for name, labels in fallen.items() if labels)
        section.text(
            "Masses that are off leave as much of the weight to (34) alone: a smaller case of the sagging without "
            f"feedforward in the section on the nine experiments. Runs end early: {named}. The integral action is too "
            "slow to take the load up in time."
        )
    shares = {
        step: feedforward_share(longer(base.robot, 1e-3 * step), base.believed_robot, base.gravity) for step in (-1, 1)
    }
    section.text(
        "A rod of another length acts through the feedforward too. Along (37), (38) the wrong static torque leaves a "
        "vertical force in phase with the inertia force -m Z''_d that (20) leaves out: "
        + ", ".join(f"{share:+.2f} times it for {step:+d} mm" for step, share in shares.items())
        + ". Where the sign is positive it adds to that disturbance, where it is negative it makes up for part of it."
    )
    section.numbers["feedforward_share"] = {f"{step:+d} mm": share for step, share in shares.items()}


def verdict(responses: Sequence[Response]) -> str:
    """One line from the numbers."""
    effects = [(r, e) for r in responses for e in r.effects]
    early = sum(e.score is None for _, e in effects)
    blown = sum((r.shift(e, "pose_mm") or 0.0) > 100.0 * (BLOWN_UP - 1.0) for r, e in effects)
    steady = [r.unchanged is not None and all(e.score is not None for e in r.effects) for r in responses]
    parts = [
        f"{holds(steady)}: of {len(effects)} changed runs {early or 'none'} {'ends' if early == 1 else 'end'} early, "
        f"and {blown or 'none'} of the others {'has' if blown == 1 else 'have'} more than {BLOWN_UP:g} times the "
        "unchanged error."
    ]
    for response in responses:
        if response.unchanged is None:
            parts.append(f"{_sentence(response.name)}: even the unchanged run ends early.")
            continue
        most = [_named(factor, swing) for factor, swing in response.swings("pose_mm").items()][:3]
        what = f"{_sentence(response.name)} ({response.unchanged.pose_mm:.3g} mm unchanged)"
        parts.append(f"{what} is most sensitive to {', '.join(most)}.")
    return " ".join(parts)


def _sentence(words: str) -> str:
    return words[0].upper() + words[1:]


def _named(factor: str, swing: float) -> str:
    return f"{factor} (ends early)" if math.isinf(swing) else f"{factor} ({swing:.0f} %)"
