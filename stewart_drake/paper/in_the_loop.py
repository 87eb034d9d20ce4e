"""Fig. 7: the paper's tuner in the loop; (37), (38) and motions beyond its training.

Deviation: the paper has one motion and one controller; here every motion is also run with fixed weights.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from importlib.resources import files
from typing import Any, TypedDict

import numpy as np
from ruamel.yaml import YAML

from stewart_drake.base.tables import AXES
from stewart_drake.control.network import load_network
from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.metrics import run_metrics
from stewart_drake.paper.reproduce import (
    NEAR_ZERO,
    PAIRS,
    RATIOS,
    Claim,
    Reproduction,
    Result,
    growth,
    integral_share,
    largest_integral,
    pair_of,
    paper_scenario,
    score,
)
from stewart_drake.plotting.run_plots import plot_states, plot_torques
from stewart_drake.plotting.style import chart
from stewart_drake.references import SineReference, paper_reference
from stewart_drake.scenario.scenario import Scenario
from stewart_drake.studies.experiment import Figures
from stewart_drake.training.paper_network import six

CLAIMED = 45.0  # [%] improvement on average, of the later paper (doi 10.1177/10775463211019177).
BEST_FIXED, MEAN_OF_NINE, ORACLE = "best fixed pair", "mean of the nine", "oracle"
APART = 1e-10
"""[rad, m] between practically equal starts: a chaotic loop needs several samples."""
MAIN, TUNER = "(37), (38)", "tuner"
LIGHT, HEAVY = 0.02, 0.05  # [N m] dry friction of a motor.
FIXED = {f"ratio {ratio:g}": ratio for ratio in RATIOS}
Errors = Mapping[str, Mapping[str, float]]
_Key = tuple[str, Any]  # Trajectory or name of a run in Fig. 7, and controller, friction, start or None.


def unseen_trajectories() -> dict[str, tuple[SineReference, float]]:
    """The eleven motions of trajectories.yaml and their durations [s], the second half of which gives the error."""
    table = YAML(typ="safe", pure=True).load(
        files(__package__).joinpath("trajectories.yaml").read_text(encoding="utf-8")
    )
    unit, motions = np.repeat([math.radians(1.0), 1e-3], 3), {}
    for name, (duration, axes) in table.items():
        size, frequency, phase = (np.array([axes.get(axis, (0.0, 1.0, 0.0))[i] for axis in AXES]) for i in range(3))
        omega = six(2.0 * np.pi * frequency)
        motion = SineReference(amplitude=six(size * unit), angular_frequency=omega, phase=six(np.radians(phase)))
        motions[name] = motion, float(duration)
    return motions


def baselines(errors: Errors) -> dict[str, list[float]]:
    """Pose RMSE [mm] by trajectory of the baselines; the oracle takes the best fixed pair of a trajectory."""
    fixed = {name: [row[name] for row in errors.values()] for name in FIXED}
    best = min(FIXED, key=lambda name: float(np.mean(np.log(fixed[name]))))
    labels = [sum(np.isclose(q / r, ratio) for q, r in PAIRS) for ratio in RATIOS]
    table = np.array(list(fixed.values()))
    mean_of_nine = (np.array(labels) @ table / len(PAIRS)).tolist()
    return fixed | {BEST_FIXED: fixed[best], MEAN_OF_NINE: mean_of_nine, ORACLE: table.min(axis=0).tolist()}


class Improvement(TypedDict):
    """Reduction of the RMSE [%]."""

    each: list[float]  # By trajectory.
    mean: float
    typical: float  # Geometric mean.


def improvement(errors: Errors, baseline: Sequence[float]) -> Improvement:
    """Reduction of the RMSE by the tuner against a baseline."""
    share = np.array([row[TUNER] for row in errors.values()]) / baseline
    percent = 100.0 * (1.0 - share)
    typical = 100.0 * (1.0 - float(np.exp(np.mean(np.log(share)))))
    return {"each": percent.tolist(), "mean": float(percent.mean()), "typical": typical}


def _trajectories(study: Reproduction) -> dict[str, tuple[SineReference, float]]:
    unseen = unseen_trajectories()
    if study.quick:
        unseen = {"heartbeat": (unseen["heartbeat"][0], 4.0)}
    return {MAIN: (paper_reference(), study.pick(10.0, 3.2)), **unseen}


def _controllers(study: Reproduction) -> dict[str, Scenario]:
    condition = study.base.gravity_in_base, study.base.lqi.feedforward
    fixed = {name: paper_scenario(study.base, 10.0, *condition, pair_of(ratio)) for name, ratio in FIXED.items()}
    return {**fixed, TUNER: study.under_tuner(fixed["ratio 1"])}


def reproduce(study: Reproduction) -> Result:
    base, network = study.base, load_network(study.tuner_file)
    trajectories, controllers = _trajectories(study), _controllers(study)
    scenarios: dict[_Key, Scenario] = {
        (name, who): scenario.replace({"reference": motion.to_dict(), "duration": duration})
        for name, (motion, duration) in trajectories.items()
        for who, scenario in controllers.items()
    }
    main, other = f"gravity on, feedforward {base.lqi.feedforward}", "gravity off, feedforward none"
    free = paper_scenario(base, study.pick(10.0, 5.2), 0.0, "none", pair_of(1.0))
    fig7 = {
        f"{main}, tuner": scenarios[MAIN, TUNER],
        f"{main}, 1 / 1, fixed": scenarios[MAIN, "ratio 1"],
        f"{other}, tuner": study.under_tuner(free),
        f"{other}, 1 / 1, fixed": free,
    }
    offsets = APART * np.random.default_rng(0).uniform(-1.0, 1.0, (study.pick(5, 2), 6))
    nearby = [name for name in fig7 if name != f"{main}, 1 / 1, fixed"]
    scenarios |= {(name, None): scenario for name, scenario in fig7.items()}
    scenarios |= {(MAIN, f): scenarios[MAIN, TUNER].replace({"plant.motor_friction": f}) for f in (LIGHT, HEAVY)}
    for i, offset in enumerate(offsets.tolist()):
        scenarios |= {(name, i): fig7[name].replace({"initial_offset": offset}) for name in nearby}
    logs = study.run(scenarios, check=False)
    scores = {name: {who: score(logs[name, who]) for who in controllers} for name in trajectories}
    errors = {name: {who: score["pose_mm"] for who, score in row.items() if score} for name, row in scores.items()}
    against = baselines(errors)
    gains = {name: improvement(errors, values) for name, values in against.items()}
    fixed_logs = {key: log for key, log in logs.items() if key[1] in FIXED}
    answers = [_mean_ratio(log, network.weights(log["density"])) for log in fixed_logs.values()]
    slope = float(np.polyfit([np.log10(FIXED[who]) for _, who in fixed_logs], answers, 1)[0])
    figures = {key: _figures(log) for key, log in logs.items() if key[0] in fig7}
    starts_of = {name: [figures[name, i] for i in range(len(offsets))] for name in nearby}
    numbers = {
        "fig7": {name: figures[name, None] for name in fig7},
        "nearby_starts": {
            name: {key: [row[key] for row in rows] for key in rows[0]} for name, rows in starts_of.items()
        },
        "pose_rmse_mm": {
            name: row | {MEAN_OF_NINE: against[MEAN_OF_NINE][i], ORACLE: against[ORACLE][i]}
            for i, (name, row) in enumerate(errors.items())
        },
        "improvement_percent": gains,
    }
    # Without gravity the loop is chaotic, so this is the worst of the starts.
    starts = [(f"{other}, tuner", i) for i in (None, *range(len(offsets)))]
    swing = max(integral_share(logs[key]) for key in starts)
    grown = max(figures[key]["growth"] or np.inf for key in starts)
    claims = [
        Claim("Fig. 7: integral states at 5 s over their largest", "near 0", 100.0 * swing, "%", swing < NEAR_ZERO),
        Claim("Fig. 7: error of the second half over the first", "< 1", grown, "", grown < 1.0),
        *_friction_claims(logs, trajectories[MAIN][1]),
        Claim("III.D: the answer follows the weights, slope", "1", slope, "", slope > 0.8),
    ]
    means = {name: gains[name]["mean"] for name in ("ratio 1", BEST_FIXED, MEAN_OF_NINE)}
    means["the worst baseline"] = max(gain["mean"] for gain in gains.values())
    paper = f"{CLAIMED:g} %"
    claims += [Claim(f"later paper: improvement on {who}", paper, x, "%", x >= CLAIMED) for who, x in means.items()]
    return Result(numbers, claims, _pictures(logs[MAIN, TUNER], errors))


def _pictures(log: SimulationLog, errors: Errors) -> Figures:
    curves = {who: ([row[who] for row in errors.values()], list(errors)) for who in (*FIXED, TUNER)}
    title = "The tuner among the five controllers"
    return {
        "fig7_states": partial(plot_states, log),
        "fig7_torques": partial(plot_torques, log),
        "ranking": partial(chart, title, "pose RMSE over the second half [mm]", "", curves, "o", "x", 5.0),
    }


def _figures(log: SimulationLog) -> dict[str, float | None]:
    metrics = run_metrics(log)
    sizes = {"roll_rmse_deg": metrics["rmse_deg"][0], "z_rmse_mm": metrics["rmse_mm"][2]}
    return {**sizes, "integral_at_5s": largest_integral(log), "growth": growth(log)}


def _friction_claims(logs: Mapping[_Key, SimulationLog], duration: float) -> list[Claim]:
    """Claims on the paper's motion with dry friction in the motors."""
    roll, light = (run_metrics(logs[MAIN, who])["rmse_deg"][0] for who in (TUNER, LIGHT))
    heavy, whole = logs[MAIN, HEAVY], f"{duration:g} s"
    kept = heavy.end_time if heavy.outcome_time is None else heavy.outcome_time
    return [
        Claim(f"II.C: Fig. 7 with friction of {LIGHT} N m, RMSE of roll", "as without", light, "deg", light < 2 * roll),
        Claim(f"II.C: Fig. 7 with friction of {HEAVY} N m, followed for", whole, kept, "s", not heavy.reason),
    ]


def _mean_ratio(log: SimulationLog, weights: np.ndarray) -> float:
    return float((np.log10(weights[log.second_half]) @ (1.0, -1.0)).mean())
