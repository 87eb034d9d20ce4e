"""The paper's tuner in the loop, Fig. 7, against fixed weights; on (37), (38) and on motions beyond its training.

Deviation: the paper's Fig. 7 is one motion under one controller. What online tuning is worth can only be told against
the weights that it chooses from, so every trajectory is run under each of them too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from stewart_drake.control.network import default_network_path, load_network
from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.metrics import run_metrics
from stewart_drake.paper.experiments import (
    RATIOS,
    growth,
    largest_integral,
    outcome,
    pair_of,
    paper_scenario,
    refusal,
    score,
)
from stewart_drake.paper.plots.in_the_loop_plots import plot_ranking, plot_weights_in_force
from stewart_drake.paper.report import Section
from stewart_drake.paper.study import Study
from stewart_drake.paper.trajectories import Trajectory, paper_trajectory, unseen_trajectories
from stewart_drake.paper.tuner_comparison import (
    MEAN_OF_NINE,
    ORACLE,
    Comparison,
    constant_at,
    falling,
    findings,
    fit_answers,
    improvements,
    log_ratio,
    mean_answer,
    mean_log_ratio,
)
from stewart_drake.plotting import plot_states, plot_torques
from stewart_drake.scenario import AnnTuner, Scenario

APART = 1e-10
"""[rad, m] between starts that nobody could tell apart."""
_QUICK = "heartbeat"
_TUNER = None
"""Key of the runs under the network, beside the ratios of the fixed ones."""
_START = {_TUNER: "tuner", 1.0: "1 / 1, fixed"}
"""The tuner, and the weights that it starts from."""

Key = tuple[str, float | None]
"""Trajectory, or condition and weights of Fig. 7; a ratio, or the number of a start."""


def under_tuner(study: Study, scenario: Scenario) -> Scenario:
    """`scenario` with the report's network in the loop, from 1/1 as in section IV, densities as it was trained on."""
    network = load_network(study.tuner_file)
    own = None if study.tuner_file == default_network_path() else str(study.tuner_file.absolute())
    tuner = AnnTuner(density=network.density, window=network.window, weights_file=own)
    return scenario.replace({"tuner": tuner.to_dict()})


def on_trajectory(scenario: Scenario, trajectory: Trajectory) -> Scenario:
    """`scenario` with another motion to follow."""
    reference = {"kind": "sine", **asdict(trajectory.reference)}
    return scenario.replace({"reference": reference, "duration": trajectory.duration})


def trajectories_of(study: Study) -> list[Trajectory]:
    """(37), (38) first; but one of the others, and all shorter, where the study is quick."""
    unseen = unseen_trajectories()
    if study.quick:
        unseen = tuple(replace(t, duration=0.5 * t.duration) for t in unseen if t.name == _QUICK)
    return [paper_trajectory(study.pick(10.0, 3.2)), *unseen]


def make(study: Study) -> Section:
    """The section; see the module."""
    reasons = {t.name: refusal(on_trajectory(study.base, t)) for t in trajectories_of(study)}
    trajectories = [t for t in trajectories_of(study) if reasons[t.name] is None]
    main, other = _condition(study), "gravity off, feedforward none"
    followed, beside = _scenarios(study, trajectories, main, other)
    # Each motion has been checked against the limits, which do not depend on the weights.
    logs = study.run({**followed, **beside}, 0.0, 0.95, check=False)
    runs = {key: logs[key] for key in followed}
    scores = {key: score(log) for key, log in runs.items()}
    pose = {key: None if found is None else found["pose_mm"] for key, found in scores.items()}
    comparisons = [Comparison(t.name, pose[t.name, _TUNER], {r: pose[t.name, r] for r in RATIOS}) for t in trajectories]
    gains = improvements(comparisons)
    values = findings(comparisons, gains)
    best = values["best"]
    fig7 = [
        *_fig7(main, {which: runs[trajectories[0].name, key] for key, which in _START.items()}),
        *_fig7(other, {which: logs[f"{other}, {which}", _TUNER] for which in _START.values()}),
    ]
    starts = study.pick(5, 2)
    nearby = {name: [logs[name, float(i)] for i in range(starts)] for name, key in beside if key == 0.0}
    numbers = {
        "fig7": {f"{where}, {which}": found for where, which, found, *_ in fig7},
        "nearby_starts": {name: _nearby(runs) for name, runs in nearby.items()},
        "pose_rmse_mm": {c.name: _rmse_numbers(c) for c in comparisons},
        "best_fixed_ratio": best,
        "improvement_percent": {name: asdict(gain) for name, gain in gains.items()},
    }
    network = load_network(study.tuner_file)
    answers = {
        c.name: [mean_answer(network, runs[c.name, ratio]) for ratio in RATIOS]
        for c in comparisons
        if None not in c.fixed.values()
    }
    tuned = {c.name: mean_log_ratio(runs[c.name, _TUNER]) for c in comparisons if c.tuner is not None}
    constant = {c.name: constant_at(c, tuned[c.name]) for c in comparisons if c.name in tuned}
    torques = [[s["torque_rms"] for (n, _), s in scores.items() if n == c.name and s is not None] for c in comparisons]
    factors = {c.name: c.tuner / alike for c in comparisons if c.tuner and (alike := constant[c.name]) is not None}
    numbers |= {
        "answers": fit_answers(np.log10(RATIOS), np.array(list(answers.values()))) if answers else None,
        "ratio_in_the_loop": {name: 10.0**value for name, value in tuned.items()},
        "tuner_over_constant": factors,
        "torque_spread_percent": max((100.0 * (max(t) / min(t) - 1.0) for t in torques if t), default=0.0),
        "incomplete": _incomplete(runs, reasons),
    }
    first = runs[trajectories[0].name, _TUNER]
    in_force = {
        c.name: (runs[c.name, _TUNER].time, 10.0 ** log_ratio(runs[c.name, _TUNER]["weights"])) for c in comparisons
    }
    figures = {
        "in_the_loop_states": plot_states(first),
        "in_the_loop_torques": plot_torques(first),
        "in_the_loop_ranking": plot_ranking(comparisons),
        "in_the_loop_weights": plot_weights_in_force(in_force, {c.name: c.oracle_ratio for c in comparisons}),
    }
    return study.section(
        "in_the_loop",
        numbers,
        figures,
        **values,
        condition=main,
        fig7=fig7,
        span=span,
        starts=starts,
        apart=APART,
        ratios=RATIOS,
        trajectories=trajectories,
        falling=falling(comparisons),
        data_score=network.provenance.get("scores", {}).get("validation R^2 of log ratio"),
        typical=float(np.exp(np.mean(np.log(list(factors.values()))))) if factors else None,
        answers={c.name: [10.0**v for v in answers[c.name]] if c.name in answers else [None] * 5 for c in comparisons},
        constant=constant,
        runs=len(runs),
    )


def _scenarios(
    study: Study, trajectories: Sequence[Trajectory], main: str, other: str
) -> tuple[dict[Key, Scenario], dict[Key, Scenario]]:
    """What is run.

    Returns:
        Every trajectory under the tuner (None) and the five ratios; and by condition and weights, Fig. 7 from the
        reference's own start (None) where that is not among the first, and from numbered ones beside it.
    """
    feedforward, gravity = study.base.lqi.feedforward, study.base.gravity
    followed: dict[Key, Scenario] = {}
    for trajectory in trajectories:
        for ratio in RATIOS:
            fixed = paper_scenario(study.base, trajectory.duration, gravity, feedforward, pair_of(ratio))
            followed[trajectory.name, ratio] = on_trajectory(fixed, trajectory)
        tuned = under_tuner(study, followed[trajectory.name, 1.0])
        followed[trajectory.name, _TUNER] = tuned.replace({"name": "paper_fig7 - tuner in the loop"})
    free = paper_scenario(study.base, study.pick(10.0, 5.2), 0.0, "none", pair_of(1.0))
    alone = {f"{other}, {_START[_TUNER]}": under_tuner(study, free), f"{other}, {_START[1.0]}": free}
    beside: dict[Key, Scenario] = {(name, _TUNER): scenario for name, scenario in alone.items()}
    offsets = APART * np.random.default_rng(0).uniform(-1.0, 1.0, (study.pick(5, 2), 6))
    for name, start in {f"{main}, tuner": followed[trajectories[0].name, _TUNER], **alone}.items():
        beside |= {(name, float(i)): start.replace({"initial_offset": list(o)}) for i, o in enumerate(offsets)}
    return followed, beside


def _condition(study: Study) -> str:
    name = "gravity on" if study.base.gravity > 0.0 else "gravity off"
    return f"{name}, feedforward {study.base.lqi.feedforward}"


def _figures(log: SimulationLog) -> dict[str, Any]:
    m = run_metrics(log)
    return {
        "roll_rmse_deg": (m["rmse_deg"] or [None])[0],
        "z_rmse_mm": (m["rmse_mm"] or [None])[-1],
        "integral_at_5s": largest_integral(log),
    }


def _fig7(where: str, logs: Mapping[str, SimulationLog]) -> list[tuple[str, str, dict[str, Any], tuple[Any, ...]]]:
    """Condition, weights, numbers; RMS and peak of the torque, and outcome of each run."""
    rows = []
    for which, log in logs.items():
        largest, m = float(np.abs(log["integral"]).max(initial=0.0)), run_metrics(log)
        found = {**_figures(log), "integral_largest": largest, "growth": growth(log)}
        rows.append((where, which, found, (m["torque_rms"], m["torque_peak"], outcome(log))))
    return rows


def _nearby(logs: Sequence[SimulationLog]) -> dict[str, list[float | None]]:
    """The figures of Fig. 7 from starts that nobody could tell apart: how firmly they are determined."""
    rows = [_figures(log) for log in logs]
    return {name: [row[name] for row in rows] for name in rows[0]}


def span(values: Sequence[float | None]) -> str | None:
    """Smallest to largest of what there is; one figure where all agree to four digits, None for nothing."""
    known = [value for value in values if value is not None]
    if not known:
        return None
    low, high = (f"{value:.4g}" for value in (min(known), max(known)))
    return low if low == high else f"{low} to {high}"


def _rmse_numbers(c: Comparison) -> dict[str, float | None]:
    fixed = {f"ratio {ratio:g}": value for ratio, value in c.fixed.items()}
    return {"tuner": c.tuner, **fixed, MEAN_OF_NINE: c.mean_of_nine, ORACLE: c.oracle, "oracle_ratio": c.oracle_ratio}


def _incomplete(runs: Mapping[Key, SimulationLog], reasons: Mapping[str, str | None]) -> list[dict[str, str]]:
    """What could not be run, or ended early, and why."""
    rows = [(name, "all", f"not run: {reason}") for name, reason in reasons.items() if reason is not None]
    rows += [
        (name, "tuner" if ratio is None else f"ratio {ratio:g}", outcome(log))
        for (name, ratio), log in runs.items()
        if not log.reached_end
    ]
    return [dict(zip(("trajectory", "weights", "reason"), row, strict=True)) for row in rows]
