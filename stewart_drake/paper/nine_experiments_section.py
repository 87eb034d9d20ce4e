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
from stewart_drake.logs.metrics import integral_at, run_metrics, second_half, tracking_error
from stewart_drake.logs.tally import INTEGRAL_TIME
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.mechanics.force_map import ForceMapKind
from stewart_drake.paper.report import Section, holds
from stewart_drake.paper.study import Study
from stewart_drake.references import paper_reference
from stewart_drake.sampling import steps_per
from stewart_drake.scenario import FixedTuner, Scenario
from stewart_drake.training.collect import OMEGAS

PAIRS = tuple(itertools.product(OMEGAS, OMEGAS))
"""omega_Q, omega_R of the nine experiments."""
RATIOS = (0.01, 0.1, 1.0, 10.0, 100.0)
"""Their distinct ratios: five controllers."""
EQUAL_GAINS = 1e-10
"""[-] relative difference below which two gains count as one."""
_START = (1.0, 1.0)
"""Pair with which section IV starts."""
NEAR_ZERO = 0.01
"""[rad s, m s] what counts as "near zero" of the integral states at 5 s."""
FEEDFORWARDS: tuple[str, ...] = ("none", "gravity", "platform")

_CLAIM = (
    "Nine experiments with omega_Q and omega_R in {0.1, 1, 10} are nine behaviours from which a network can learn the "
    "pair (section III.D); on (37), (38) the integral states are near zero at 5 s and the error shrinks (section IV)."
)


def pair_of(ratio: float) -> tuple[float, float]:
    """The first pair of the nine with this ratio omega_Q / omega_R.

    Raises:
        ValueError: None has it.
    """
    for pair in PAIRS:
        if np.isclose(pair[0] / pair[1], ratio):
            return pair
    raise ValueError(f"ratio {ratio:g}; the nine pairs have {', '.join(f'{r:g}' for r in RATIOS)}")


def paper_scenario(
    base: Scenario, duration: float, gravity: float, feedforward: str, pair: Sequence[float]
) -> Scenario:
    """(37), (38) under one pair of weights, the rest as in `base`."""
    return base.replace(
        {
            "name": f"{feedforward}-{gravity:g}-{pair[0]:g}-{pair[1]:g}",
            "duration": duration,
            "gravity": gravity,
            "reference": {"kind": "sine"},
            "controller.feedforward": feedforward,
            "tuner": FixedTuner(omega_q=pair[0], omega_r=pair[1]).to_dict(),
        }
    )


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


def growth(log: SimulationLog) -> float | None:
    """RMS tracking error of the second half over that of the first, the larger of roll and Z; None if it ended early.

    The two axes that (37), (38) move; below 1 the error shrinks.
    """
    if not log.reached_end:
        return None
    error, late = tracking_error(log)[:, (0, 5)], second_half(log)
    return float(np.sqrt(np.mean(error[late] ** 2, axis=0) / np.mean(error[~late] ** 2, axis=0)).max())


def outcome(log: SimulationLog) -> str:
    """`completed`, or what happened, with its leg and time."""
    if log.status == "completed":
        return "completed"
    if log.status == "lost":
        return f"lost: {(log.reason or '').replace('_', ' ')}, {log.outcome_time:.3f} s"
    return f"{(log.reason or '').replace('_', ' ')}, leg {log.leg}, {log.end_time:.3f} s"


_COLUMNS = (
    "omega_Q / omega_R",
    "RMSE roll [deg]",
    "RMSE Z [mm]",
    "peak roll [deg]",
    "peak Z [mm]",
    "torque RMS [N m]",
    "torque peak [N m]",
    "largest abs(z) at 5 s [rad s, m s]",
    "largest abs(z) of the run",
    "ended",
)

Cell = tuple[float, str, tuple[float, float]]
"""Gravity [m/s^2], feedforward, pair of weights."""


def make(study: Study) -> Section:
    """The section; see the module."""
    section = Section("nine_experiments", "The nine experiments", _CLAIM)
    conditions = [(g, f) for g in (0.0, _gravity(study)) for f in FEEDFORWARDS]
    # Quick: all nine pairs to 5 s where the paper stands, without gravity and feedforward; elsewhere fewer and shorter.
    few = [pair_of(ratio) for ratio in study.pick(RATIOS, RATIOS[::2])]
    pairs = {(0.0, "none"): PAIRS, (_gravity(study), "none"): study.pick(PAIRS, [pair_of(r) for r in RATIOS])}
    cells = [(g, f, pair) for g, f in conditions for pair in pairs.get((g, f), study.pick(PAIRS, few))]
    # Without gravity its feedforward is zero: the same run as with none.
    scenarios = [
        paper_scenario(study.base, _duration(study, g, f), g, "none" if g == 0.0 and f == "gravity" else f, pair)
        for g, f, pair in cells
    ]
    logs = dict(zip(cells, study.store.run_all(scenarios, lambda s: study.progress(0.7 * s)), strict=True))
    _tables(section, conditions, logs)
    _ratio_only(section, study, logs)
    _time_to_failure(section, study)
    section.verdict = verdict(section.numbers, logs)
    return section


def _gravity(study: Study) -> float:
    return study.base.gravity or STANDARD_GRAVITY


def _duration(study: Study, gravity: float, feedforward: str) -> float:
    """[s] a little more than five where the claim is about the fifth second, else a little more than one period."""
    return study.pick(10.0, 5.2 if gravity == 0.0 and feedforward != "platform" else 3.2)


def _tables(section: Section, conditions: Sequence[tuple[float, str]], logs: dict[Cell, SimulationLog]) -> None:
    section.text(
        "Feedforward `none` is (34) alone; `gravity` adds the static torque of all bodies at the measured pose; "
        "`platform` adds to that M q''_d, the reference's own acceleration, which (20) leaves out. Without gravity the "
        "feedforward `gravity` is zero, so those runs are the ones with `none` again. Torques are over all motors and "
        "the whole run; z are the integral states."
    )
    rows_by_condition = section.numbers.setdefault("conditions", {})
    for gravity, feedforward in conditions:
        of_condition = {pair: log for (g, f, pair), log in logs.items() if (g, f) == (gravity, feedforward)}
        rows = [_row(pair, log) for pair, log in of_condition.items()]
        title = "no gravity" if gravity == 0.0 else f"gravity {gravity:g} m/s^2"
        duration = next(iter(of_condition.values())).scenario.duration
        section.table(
            f"(37), (38) for {duration:g} s, {title}, feedforward {feedforward}; RMSE and peak over the second half",
            _COLUMNS,
            rows,
        )
        named = [dict(zip(_COLUMNS, row, strict=True)) for row in rows]
        rows_by_condition[f"gravity {gravity:g}, {feedforward}"] = named


def _row(pair: tuple[float, float], log: SimulationLog) -> tuple[object, ...]:
    m = run_metrics(log)
    z = m["integral_at_5s"]
    return (
        f"{pair[0]:g} / {pair[1]:g}",
        None if m["rmse_deg"] is None else m["rmse_deg"][0],
        None if m["rmse_mm"] is None else m["rmse_mm"][2],
        None if m["peak_deg"] is None else m["peak_deg"][0],
        None if m["peak_mm"] is None else m["peak_mm"][2],
        m["torque_rms"],
        m["torque_peak"],
        None if z is None else float(np.abs(z).max()),
        float(np.abs(log["integral"]).max()) if len(log.time) else None,
        outcome(log),
    )


def _ratio_only(section: Section, study: Study, logs: dict[Cell, SimulationLog]) -> None:
    distances = relative_distances(gains_along_reference(study.base))
    ratio = np.array([omega_q / omega_r for omega_q, omega_r in PAIRS])
    equal = np.isclose(ratio[:, None], ratio)
    controllers = distinct(distances, EQUAL_GAINS)
    free = [logs[0.0, "none", pair] for pair in PAIRS]
    apart = np.array([[trajectory_spread([a, b]) for b in free] for a in free])
    section.numbers |= {
        "gain_spread": float(distances[equal].max()),
        "gain_spread_next_ratio": float(distances[~equal].min()),
        "controllers": controllers,
        "trajectory_spread_same_ratio": float(apart[equal].max()),
        "trajectory_spread_next_ratio": float(apart[~equal].min()),
    }
    n = section.numbers
    section.text(
        "### Only the ratio matters\n\n"
        "Scaling Q and R of (27) by one factor scales the Riccati solution by it and leaves K of (31) as it is. Along "
        f"(37), (38) the gains of pairs with one ratio omega_Q / omega_R differ by {n['gain_spread']:.1e} relative at "
        f"most, those of other ratios by {n['gain_spread_next_ratio']:.1e} at least; the runs (no gravity, no "
        f"feedforward) of pairs with one ratio by {n['trajectory_spread_same_ratio']:.1e} rad or m at most, of other "
        f"ratios by {n['trajectory_spread_next_ratio']:.1e} at least. With gains within {EQUAL_GAINS:g} counted as one "
        f"the nine experiments are {controllers} controllers; 0.1/0.1, 1/1 and 10/10 are three labels of one ratio."
    )


def _time_to_failure(section: Section, study: Study) -> None:
    time_step = study.base.plant.time_step
    periods = [p for p in study.pick((0.005, 0.001), (0.005,)) if _ticks(p, time_step)] or [study.base.lqi.period]
    maps: tuple[ForceMapKind, ...] = ("statics", "printed")
    gravity = _gravity(study)
    cells = list(itertools.product(periods, maps, RATIOS))
    scenarios = [
        paper_scenario(study.base, _duration(study, gravity, "none"), gravity, "none", pair_of(ratio)).replace(
            {"controller.period": period, "controller.force_map": kind, "name": f"sag-{period:g}-{kind}-{ratio:g}"}
        )
        for period, kind, ratio in cells
    ]
    logs = dict(zip(cells, study.store.run_all(scenarios, lambda s: study.progress(0.7 + 0.3 * s)), strict=True))

    def ends(kind: str) -> int:
        return sum(not log.reached_end for (_, k, _), log in logs.items() if k == kind)

    drop = [1e3 * float(-tracking_error(log)[:, 5].min(initial=0.0)) for log in logs.values()]
    rows = [
        (f"{1e3 * period:g} ms", kind, *(outcome(logs[period, kind, ratio]) for ratio in RATIOS))
        for period in periods
        for kind in maps
    ]
    section.text(
        "### Gravity and (34) alone\n\n"
        "The paper's model, (7) to (18), has no gravity, its multibody model has. With nothing but (34) the platform "
        f"sags: in these runs by {min(drop):.1f} to {max(drop):.1f} mm below the reference. The map by statics ends "
        f"early in {ends('statics')} of {len(periods) * len(RATIOS)} runs, the printed map in {ends('printed')}. At a "
        "dead centre the two part ways: (15) as printed goes to zero there, by statics it goes to infinity."
    )
    section.table(
        "Gravity on, no feedforward: how the run ends, by control period, force map and ratio omega_Q / omega_R",
        ("control period", "force map", *(f"{ratio:g}" for ratio in RATIOS)),
        rows,
    )

    def ended(log: SimulationLog) -> float | None:
        return None if log.reached_end else log.end_time

    section.numbers["largest_drop_mm"] = [min(drop), max(drop)]
    section.numbers["time_to_failure"] = {
        f"{period:g} {kind}": {f"ratio {ratio:g}": ended(logs[period, kind, ratio]) for ratio in RATIOS}
        for period in periods
        for kind in maps
    }


def _ticks(period: float, time_step: float) -> bool:
    try:
        return steps_per("controller.period", period, time_step) > 0
    except ConfigurationError:
        return False


def verdict(numbers: dict[str, Any], logs: Mapping[Cell, SimulationLog]) -> str:
    """What the runs say about the claim; adds its counts to `numbers`."""
    free = [log for (g, f, _), log in logs.items() if g == 0.0 and f == "none"]
    integral = [integral_at(log, INTEGRAL_TIME) for log in free]
    near = sum(z is not None and float(np.abs(z).max()) < NEAR_ZERO for z in integral)
    # Section IV starts from 1/1: that pair decides, where it was run.
    start = logs.get((0.0, "none", _START))
    asked = integral if start is None else [integral_at(start, INTEGRAL_TIME)]
    settled = all(z is not None and float(np.abs(z).max()) < NEAR_ZERO for z in asked)
    among = "" if start is None else f", 1/1 of section IV {'' if settled else 'not '}among them"
    change = [value for value in map(growth, free) if value is not None]
    shrinks = sum(value < 1.0 for value in change)
    bare = [log for (g, f, _), log in logs.items() if g != 0.0 and f == "none"]
    lost = sum(not log.reached_end for log in bare)
    kept = [log for (g, f, _), log in logs.items() if g != 0.0 and f != "none"]
    survived = sum(log.reached_end for log in kept)
    numbers |= {
        "near_zero_at_5s": near,
        "error_growth": change,
        "lost_uncompensated": lost,
        "survived_compensated": survived,
    }
    span = f" (second half over first: {min(change):.2f} to {max(change):.2f})" if change else ""
    held = (settled, shrinks == len(change) > 0, numbers["controllers"] == len(PAIRS))
    return (
        f"{holds(held)}: without gravity the integral states are below {NEAR_ZERO:g} at 5 s for {near} of {len(free)} "
        f"pairs{among}; the error shrinks from the first to the second half for {shrinks} of the {len(change)} that "
        f"complete{span}. With gravity and (34) alone {lost} of {len(bare)} runs end early; with gravity compensated "
        f"{survived} of {len(kept)} complete. The nine pairs are {numbers['controllers']} controllers."
    )
