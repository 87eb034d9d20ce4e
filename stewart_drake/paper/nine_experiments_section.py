"""The nine weight pairs on (37), (38), with and without gravity and its compensation; sections III.D and IV."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from stewart_drake.control.lqi import lqi_gain
from stewart_drake.control.state_space import acceleration_map
from stewart_drake.errors import ConfigurationError
from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.metrics import integral_at, run_metrics, tracking_error
from stewart_drake.logs.rows import INTEGRAL_TIME
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.mechanics.force_map import ForceMapKind
from stewart_drake.paper.experiments import PAIRS, RATIOS, growth, largest_integral, outcome, pair_of, paper_scenario
from stewart_drake.paper.report import Section
from stewart_drake.paper.study import Study
from stewart_drake.references import paper_reference
from stewart_drake.sampling import steps_per
from stewart_drake.scenario import Scenario

EQUAL_GAINS = 1e-10
"""[-] relative difference below which two gains count as one."""
START = (1.0, 1.0)
"""Pair with which section IV starts."""
NEAR_ZERO = 0.01
"""[rad s, m s] what counts as "near zero" of the integral states at 5 s."""
FEEDFORWARDS: tuple[str, ...] = ("none", "gravity", "platform")
MAPS: tuple[ForceMapKind, ...] = ("statics", "printed")

Cell = tuple[float, str, tuple[float, float]]
"""Gravity [m/s^2], feedforward, pair of weights."""


def gains_along_reference(base: Scenario) -> np.ndarray:
    """K of (31) of each of the nine pairs along (37), (38), for the controller of `base`; (9 poses, 9 pairs, 6, 18)."""
    robot, options = base.believed_robot, base.lqi
    poses = paper_reference().evaluate(np.linspace(0.0, np.pi, 9))[0]
    maps = acceleration_map(robot, poses, options.force_map)
    return np.array([[lqi_gain(b, options, np.array(pair)) for pair in PAIRS] for b in maps])


def relative_distances(gains: np.ndarray) -> np.ndarray:
    """Largest difference between the gains of two pairs as a share of their largest entry, over all poses.

    Args:
        gains: (n, p, ...) at n poses, for p pairs.

    Returns:
        (p, p) [-].
    """
    flat = gains.reshape(*gains.shape[:2], -1)
    largest = np.abs(flat).max(axis=-1)
    apart = np.abs(flat[:, :, None] - flat[:, None]).max(axis=-1)
    return (apart / np.maximum(largest[:, :, None], largest[:, None])).max(axis=0)


def distinct(distances: np.ndarray, tolerance: float) -> int:
    """Number of groups whose members are within `tolerance` of the group's first; distances (p, p)."""
    firsts: list[int] = []
    for index in range(len(distances)):
        if all(distances[index, first] > tolerance for first in firsts):
            firsts.append(index)
    return len(firsts)


def trajectory_spread(logs: Sequence[SimulationLog]) -> float:
    """Largest difference of pose between the runs and the first of them, over their common rows; rad and m alike."""
    rows = min(len(log.time) for log in logs)
    return max(float(np.abs(log["pose"][:rows] - logs[0]["pose"][:rows]).max(initial=0.0)) for log in logs)


def make(study: Study) -> Section:
    """The section; see the module."""
    conditions = [(g, f) for g in (0.0, _gravity(study)) for f in FEEDFORWARDS]
    # Quick: all nine pairs to 5 s where the paper stands, without gravity and feedforward; elsewhere fewer and shorter.
    few = [pair_of(ratio) for ratio in study.pick(RATIOS, RATIOS[::2])]
    pairs = {(0.0, "none"): PAIRS, (_gravity(study), "none"): study.pick(PAIRS, [pair_of(r) for r in RATIOS])}
    cells = [(g, f, pair) for g, f in conditions for pair in pairs.get((g, f), study.pick(PAIRS, few))]
    # Without gravity its feedforward is zero: the same run as with none.
    scenarios = {
        (g, f, pair): paper_scenario(
            study.base, _duration(study, g, f), g, "none" if g == 0.0 and f == "gravity" else f, pair
        )
        for g, f, pair in cells
    }
    logs = study.run(scenarios, 0.0, 0.7)
    rows = {
        condition: [_row(pair, log) for (g, f, pair), log in logs.items() if (g, f) == condition]
        for condition in conditions
    }
    sagging = _without_feedforward(study)
    drops = [1e3 * float(-tracking_error(log)[:, 5].min(initial=0.0)) for log in sagging.values()]
    counts, values = findings(logs)
    numbers = {
        "conditions": {f"gravity {g:g}, {f}": found for (g, f), found in rows.items()},
        **_ratio_only(study.base, logs),
        "largest_drop_mm": [min(drops), max(drops)],
        "time_to_failure": {
            f"{period:g} {kind}": {
                f"ratio {r:g}": None if log.reached_end else log.end_time
                for (p, k, r), log in sagging.items()
                if (p, k) == (period, kind)
            }
            for period, kind, _ in sagging
        },
        **counts,
    }
    ended = {(p, k): [outcome(sagging[p, k, ratio]) for ratio in RATIOS] for p, k, _ in sagging}
    early = {k: sum(not log.reached_end for key, log in sagging.items() if key[1] == k) for k in MAPS}
    return study.section(
        "nine_experiments", numbers, **values, failures=ended, ends=early, asked=len(sagging) // len(MAPS),
        conditions=[(g, f, _duration(study, g, f), found) for (g, f), found in rows.items()], equal_gains=EQUAL_GAINS,
    )  # fmt: skip


def findings(logs: Mapping[Cell, SimulationLog]) -> tuple[dict[str, Any], dict[str, Any]]:
    """What the runs say about the claim: counts for the numbers, and what else the verdict speaks of."""
    free = [log for (g, f, _), log in logs.items() if g == 0.0 and f == "none"]
    bare = [log for (g, f, _), log in logs.items() if g != 0.0 and f == "none"]
    kept = [log for (g, f, _), log in logs.items() if g != 0.0 and f != "none"]

    def near_zero(log: SimulationLog) -> bool:
        z = integral_at(log, INTEGRAL_TIME)
        return z is not None and float(np.abs(z).max()) < NEAR_ZERO

    # Section IV starts from 1/1: that pair decides, where it was run.
    start = logs.get((0.0, "none", START))
    counts = {
        "near_zero_at_5s": sum(map(near_zero, free)),
        "error_growth": [value for value in map(growth, free) if value is not None],
        "lost_uncompensated": sum(not log.reached_end for log in bare),
        "survived_compensated": sum(log.reached_end for log in kept),
    }
    values = {
        "settled": all(map(near_zero, free if start is None else [start])),
        "started": start is not None,
        "near_zero": NEAR_ZERO,
        "free": len(free),
        "bare": len(bare),
        "kept": len(kept),
    }
    return counts, values


def _gravity(study: Study) -> float:
    return study.base.gravity or STANDARD_GRAVITY


def _duration(study: Study, gravity: float, feedforward: str) -> float:
    """[s] a little more than five where the claim is about the fifth second, else a little more than one period."""
    return float(study.pick(10.0, 5.2 if gravity == 0.0 and feedforward != "platform" else 3.2))


def _row(pair: tuple[float, float], log: SimulationLog) -> dict[str, object]:
    m = run_metrics(log)
    return {
        "omega_Q / omega_R": f"{pair[0]:g} / {pair[1]:g}",
        "RMSE roll [deg]": None if m["rmse_deg"] is None else m["rmse_deg"][0],
        "RMSE Z [mm]": None if m["rmse_mm"] is None else m["rmse_mm"][2],
        "peak roll [deg]": None if m["peak_deg"] is None else m["peak_deg"][0],
        "peak Z [mm]": None if m["peak_mm"] is None else m["peak_mm"][2],
        "torque RMS [N m]": m["torque_rms"],
        "torque peak [N m]": m["torque_peak"],
        "largest abs(z) at 5 s [rad s, m s]": largest_integral(log),
        "largest abs(z) of the run": float(np.abs(log["integral"]).max()) if len(log.time) else None,
        "ended": outcome(log),
    }


def _ratio_only(base: Scenario, logs: Mapping[Cell, SimulationLog]) -> dict[str, Any]:
    distances = relative_distances(gains_along_reference(base))
    ratio = np.array([omega_q / omega_r for omega_q, omega_r in PAIRS])
    equal = np.isclose(ratio[:, None], ratio)
    free = [logs[0.0, "none", pair] for pair in PAIRS]
    apart = np.array([[trajectory_spread([a, b]) for b in free] for a in free])
    return {
        "gain_spread": float(distances[equal].max()),
        "gain_spread_next_ratio": float(distances[~equal].min()),
        "controllers": distinct(distances, EQUAL_GAINS),
        "trajectory_spread_same_ratio": float(apart[equal].max()),
        "trajectory_spread_next_ratio": float(apart[~equal].min()),
    }


def _without_feedforward(study: Study) -> dict[tuple[float, str, float], SimulationLog]:
    """Runs with gravity and (34) alone, by control period [s], force map and ratio."""
    gravity, step = _gravity(study), study.base.plant.time_step
    periods = [p for p in study.pick((0.005, 0.001), (0.005,)) if _ticks(p, step)] or [study.base.lqi.period]
    fall = {
        ratio: paper_scenario(study.base, _duration(study, gravity, "none"), gravity, "none", pair_of(ratio))
        for ratio in RATIOS
    }
    scenarios: dict[tuple[float, str, float], Scenario] = {}
    for period, kind, ratio in itertools.product(periods, MAPS, RATIOS):
        changed = {"controller.period": period, "controller.force_map": kind}
        scenarios[period, kind, ratio] = fall[ratio].replace(changed)
    return study.run(scenarios, 0.7, 0.3)


def _ticks(period: float, time_step: float) -> bool:
    try:
        return steps_per("controller.period", period, time_step) > 0
    except ConfigurationError:
        return False
