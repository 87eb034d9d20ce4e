"""III.D and IV: the nine weight pairs on (37), (38), with and without gravity and its compensation."""

from __future__ import annotations

import itertools
from functools import partial
from typing import Any

import numpy as np

from stewart_drake.control.lqi import lqi_gain
from stewart_drake.control.riccati import acceleration_map
from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.metrics import run_metrics
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.paper.reproduce import (
    NEAR_ZERO,
    PAIRS,
    RATIOS,
    Claim,
    Reproduction,
    Result,
    followed,
    growth,
    integral_share,
    largest_integral,
    outcome,
    pair_of,
    paper_scenario,
)
from stewart_drake.plotting.style import chart
from stewart_drake.references import paper_reference
from stewart_drake.scenario.scenario import Scenario

EQUAL_GAINS = 1e-10
CONDITIONS = tuple(itertools.product((0.0, STANDARD_GRAVITY), ("none", "gravity", "platform")))
FREE, BARE = (0.0, "none"), (STANDARD_GRAVITY, "none")  # No gravity; gravity, with (34) alone


def gains_along_reference(base: Scenario) -> np.ndarray:
    """K of (31) for the nine pairs along (37), (38), with the controller of `base`; (9 poses, 9 pairs, 6, 18)."""
    poses = paper_reference().evaluate(np.linspace(0.0, np.pi, 9))[0]
    maps = acceleration_map(base.controller_model.robot, poses, base.lqi.force_map)
    return np.array([[lqi_gain(b, base.lqi, np.array(pair)) for pair in PAIRS] for b in maps])


def relative_distances(gains: np.ndarray) -> np.ndarray:
    """Largest difference (p, p) [-] of two pairs' gains (n poses, p pairs, ...), relative to their largest entry."""
    flat = gains.reshape(*gains.shape[:2], -1)
    largest = np.abs(flat).max(axis=-1)
    apart = np.abs(flat[:, :, None] - flat[:, None]).max(axis=-1)
    return (apart / np.maximum(largest[:, :, None], largest[:, None])).max(axis=0)


def distinct(distances: np.ndarray, tolerance: float) -> int:
    """Number of groups: members are within `tolerance` of the first of a group; distances (p, p)."""
    firsts: list[int] = []
    for index in range(len(distances)):
        if all(distances[index, first] > tolerance for first in firsts):
            firsts.append(index)
    return len(firsts)


def reproduce(study: Reproduction) -> Result:
    # Quick: all nine pairs to 5 s in the paper's case, without gravity and feedforward; otherwise fewer and shorter.
    pairs = dict.fromkeys(CONDITIONS, study.pick(PAIRS, [pair_of(ratio) for ratio in RATIOS[::2]]))
    pairs |= {FREE: PAIRS, BARE: study.pick(PAIRS, [pair_of(ratio) for ratio in RATIOS])}
    scenarios: dict[Any, Scenario] = {}
    for (gravity, feedforward), some in pairs.items():
        # Without gravity its feedforward is zero: the same run as without it.
        acting = "none" if gravity == 0.0 and feedforward == "gravity" else feedforward
        duration = study.pick(10.0, 5.2 if gravity == 0.0 and feedforward != "platform" else 3.2)
        for pair in some:
            scenarios[(gravity, feedforward), pair] = paper_scenario(study.base, duration, gravity, acting, pair)
    for period, kind, ratio in itertools.product(study.pick((0.005, 0.001), (0.005,)), ("statics", "printed"), RATIOS):
        fall = paper_scenario(study.base, study.pick(10.0, 3.2), *BARE, pair_of(ratio))
        scenarios[period, kind, ratio] = fall.replace({"controller.period": period, "controller.force_map": kind})
    logs = study.run(scenarios)
    runs = {condition: {pair: logs[condition, pair] for pair in some} for condition, some in pairs.items()}
    ends: dict[str, dict[str, float | None]] = {}
    for (period, kind, ratio), log in ((key, log) for key, log in logs.items() if len(key) == 3):
        ends.setdefault(f"{period:g} {kind}", {})[f"ratio {ratio:g}"] = None if log.reached_end else log.end_time
    controllers = distinct(relative_distances(gains_along_reference(study.base)), EQUAL_GAINS)
    numbers = {
        "conditions": {f"gravity {g:g}, {f}": [_row(*run) for run in runs[g, f].items()] for g, f in CONDITIONS},
        "controllers": controllers,
        "time_to_failure": ends,
    }
    swing = integral_share(runs[FREE][1.0, 1.0])
    least = min(value for value in map(growth, runs[FREE].values()) if value is not None)
    bare = list(runs[BARE].values())
    lost = len(bare) - followed(bare)
    helped = [log for at in CONDITIONS if at[0] and at != BARE for log in runs[at].values()]
    kept = followed(helped)
    claims = [
        Claim("III.D: different controllers among the nine pairs", "9", controllers, "", controllers == 9),
        Claim("IV: integral states at 5 s over their largest", "near 0", 100.0 * swing, "%", swing < NEAR_ZERO),
        Claim("IV: error of the second half over the first, least", "< 1", least, "", least < 1.0),
        Claim("IV: with gravity and (34) alone, runs lost", "0", lost, f"of {len(bare)}", lost == 0),
        Claim("IV: with gravity compensated, runs completed", "-", kept, f"of {len(helped)}", None),
    ]
    falls = {ratio: runs[BARE][pair_of(ratio)] for ratio in RATIOS}
    curves = {f"ratio {ratio:g}": (log.time, 1e3 * log.error[:, 5]) for ratio, log in falls.items()}
    draw = partial(chart, "Gravity, and (34) alone against it", "time [s]", "error of Z [mm]", curves)
    return Result(numbers, claims, {"nine_experiments": draw})


def _row(pair: tuple[float, float], log: SimulationLog) -> dict[str, object]:
    m = run_metrics(log)

    def of(name: str, axis: int) -> float | None:
        return None if m[name] is None else m[name][axis]

    return {
        "omega_Q / omega_R": f"{pair[0]:g} / {pair[1]:g}",
        "RMSE roll [deg]": of("rmse_deg", 0),
        "RMSE Z [mm]": of("rmse_mm", 2),
        "peak roll [deg]": of("peak_deg", 0),
        "peak Z [mm]": of("peak_mm", 2),
        "torque RMS [N m]": m["torque_rms"],
        "torque peak [N m]": m["torque_peak"],
        "largest abs(z) at 5 s [rad s, m s]": largest_integral(log),
        "largest abs(z) of the run": float(np.abs(log["integral"]).max()),
        "ended": outcome(log),
    }
