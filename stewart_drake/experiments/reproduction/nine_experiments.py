"""The nine weight pairs on (37), (38), with and without gravity and its compensation; sections III.D and IV."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from stewart_drake.control_law import LqiOptions, lqi_gain
from stewart_drake.experiments.report import Section
from stewart_drake.experiments.reproduction.study import Study
from stewart_drake.force_map import ForceMapKind
from stewart_drake.log import SimulationLog
from stewart_drake.metrics import run_metrics
from stewart_drake.references import paper_reference
from stewart_drake.scenario import FixedTuner, Scenario
from stewart_drake.state_space import acceleration_map
from stewart_drake.training.collect import OMEGAS

PAIRS = tuple(itertools.product(OMEGAS, OMEGAS))
"""omega_Q, omega_R of the nine experiments."""
RATIOS = (0.01, 0.1, 1.0, 10.0, 100.0)
"""Their distinct ratios: five controllers."""
FEEDFORWARDS: tuple[str, ...] = ("none", "gravity", "platform")

_CLAIM = (
    "Nine experiments with omega_Q and omega_R in {0.1, 1, 10} are nine behaviours from which a network can learn the "
    "pair (section III.D); on (37), (38) the integral states are near zero at 5 s and the error shrinks (section IV)."
)


def pair_of(ratio: float) -> tuple[float, float]:
    """The first pair of the nine with this ratio omega_Q / omega_R."""
    return next(pair for pair in PAIRS if np.isclose(pair[0] / pair[1], ratio))


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
            "tuner": FixedTuner(omega_q=pair[0], omega_r=pair[1]).model_dump(),
        }
    )


def gain_spread(base: Scenario) -> dict[float, float]:
    """Largest relative difference of the gains of equal-ratio pairs along (37), (38), by ratio."""
    poses = paper_reference().evaluate(np.linspace(0.0, np.pi, 9))[0]
    spread: dict[float, float] = {}
    for pose in poses:
        gains: dict[float, list[np.ndarray]] = {}
        for pair in PAIRS:
            ratio = next(r for r in RATIOS if np.isclose(pair[0] / pair[1], r))
            gains.setdefault(ratio, []).append(
                lqi_gain(acceleration_map(base.robot, pose), LqiOptions(), np.array(pair))
            )
        for ratio, same in gains.items():
            worst = max(float(np.abs(k - same[0]).max() / np.abs(same[0]).max()) for k in same)
            spread[ratio] = max(worst, spread.get(ratio, 0.0))
    return spread


def trajectory_spread(logs: Sequence[SimulationLog]) -> float:
    """Largest difference of pose between runs, over their common rows; rad and m alike."""
    rows = min(len(log.time) for log in logs)
    return max(float(np.abs(log["pose"][:rows] - logs[0]["pose"][:rows]).max()) for log in logs)


def outcome(log: SimulationLog) -> str:
    """`completed`, or reason, leg and time."""
    if log.status == "completed":
        return "completed"
    return f"{(log.reason or '').replace('_', ' ')}, leg {log.leg}, {log.end_time:.3f} s"


def make(study: Study) -> Section:
    """The section; see the module."""
    section = Section("nine_experiments", "Nine experiments, five controllers", _CLAIM)
    duration = study.pick(10.0, 5.2)
    conditions = [(g, f) for g in (0.0, study.base.gravity or 9.81) for f in FEEDFORWARDS]
    # Quick: all nine pairs where the paper stands (no gravity, no feedforward), one pair per ratio elsewhere.
    cells = [
        (gravity, feedforward, pair)
        for gravity, feedforward in conditions
        for pair in (PAIRS if not study.quick or (gravity == 0.0 and feedforward == "none") else map(pair_of, RATIOS))
    ]
    # Without gravity its feedforward is zero: the same run as with none.
    scenarios = [
        paper_scenario(study.base, duration, g, "none" if g == 0.0 and f == "gravity" else f, pair)
        for g, f, pair in cells
    ]
    logs = dict(zip(cells, study.store.run_all(scenarios, lambda s: study.progress(0.7 * s)), strict=True))
    _tables(section, conditions, logs)
    _ratio_only(section, study, logs)
    _time_to_failure(section, study)
    _verdict(section, logs)
    return section


Cell = tuple[float, str, tuple[float, float]]


def _tables(section: Section, conditions: Sequence[tuple[float, str]], logs: dict[Cell, SimulationLog]) -> None:
    rows_by_condition = section.numbers.setdefault("conditions", {})
    for gravity, feedforward in conditions:
        rows = []
        for (g, f, pair), log in logs.items():
            if (g, f) != (gravity, feedforward):
                continue
            m = run_metrics(log)
            z = m["integral_at_5s"]
            rows.append(
                (
                    f"{pair[0]:g} / {pair[1]:g}",
                    None if m["rmse_deg"] is None else m["rmse_deg"][0],
                    None if m["rmse_mm"] is None else m["rmse_mm"][2],
                    None if m["peak_deg"] is None else m["peak_deg"][0],
                    None if m["peak_mm"] is None else m["peak_mm"][2],
                    m["torque_rms"],
                    m["torque_peak"],
                    None if z is None else float(np.abs(z).max()),
                    outcome(log),
                )
            )
        title = "no gravity" if gravity == 0.0 else f"gravity {gravity:g} m/s^2"
        section.table(
            f"(37), (38), {title}, feedforward {feedforward}; RMSE and peak over the second half",
            (
                "omega_Q / omega_R",
                "RMSE roll [deg]",
                "RMSE Z [mm]",
                "peak roll [deg]",
                "peak Z [mm]",
                "torque RMS [N m]",
                "torque peak [N m]",
                "largest abs(z) at 5 s [rad s, m s]",
                "ended",
            ),
            rows,
        )
        rows_by_condition[f"gravity {gravity:g}, {feedforward}"] = [list(row) for row in rows]


def _ratio_only(section: Section, study: Study, logs: dict[Cell, SimulationLog]) -> None:
    spread = gain_spread(study.base)
    same = [logs[0.0, "none", pair] for pair in PAIRS if pair[0] == pair[1]]
    distance = trajectory_spread(same)
    apart = min(
        trajectory_spread([logs[0.0, "none", pair_of(a)], logs[0.0, "none", pair_of(b)]])
        for a, b in itertools.pairwise(RATIOS)
    )
    section.numbers |= {
        "gain_spread": max(spread.values()),
        "trajectory_spread_same_ratio": distance,
        "trajectory_spread_next_ratio": apart,
    }
    section.text(
        "### Only the ratio matters\n\n"
        "Scaling Q and R of (27) by one factor scales the Riccati solution by it and leaves K of (31) as it is. Along "
        f"(37), (38) the gains of pairs with one ratio differ by {max(spread.values()):.1e} relative at most, and the "
        f"runs of 0.1/0.1, 1/1 and 10/10 (no gravity, no feedforward) by {distance:.1e} rad or m at most; neighbouring "
        f"ratios differ by at least {apart:.1e}. The nine experiments are {len(RATIOS)} controllers; three of the nine "
        "labels belong to one and the same data."
    )


def _time_to_failure(section: Section, study: Study) -> None:
    periods = study.pick((0.005, 0.001), (0.005,))
    maps: tuple[ForceMapKind, ...] = ("statics", "printed")
    gravity = study.base.gravity or 9.81
    cells = list(itertools.product(periods, maps, RATIOS))
    scenarios = [
        paper_scenario(study.base, study.pick(10.0, 5.2), gravity, "none", pair_of(ratio)).replace(
            {"controller.period": period, "controller.force_map": kind, "name": f"sag-{period:g}-{kind}-{ratio:g}"}
        )
        for period, kind, ratio in cells
    ]
    logs = dict(zip(cells, study.store.run_all(scenarios, lambda s: study.progress(0.7 + 0.3 * s)), strict=True))

    def ends(kind: str) -> int:
        return sum(log.status != "completed" for (_, k, _), log in logs.items() if k == kind)

    rows = [
        (f"{1e3 * period:g} ms", kind, *(outcome(logs[period, kind, ratio]) for ratio in RATIOS))
        for period in periods
        for kind in maps
    ]
    section.text(
        "### Gravity and (34) alone\n\n"
        "The paper's model has no gravity, its multibody model has. With nothing but (34) the platform sags. The map "
        f"by statics ends early in {ends('statics')} of {len(periods) * len(RATIOS)} runs, the printed map in "
        f"{ends('printed')}. Near a dead centre the two part ways: the printed map fades where statics grows."
    )
    section.table(
        "Gravity on, no feedforward: how the run ends, by control period, force map and ratio omega_Q / omega_R",
        ("control period", "force map", *(f"{ratio:g}" for ratio in RATIOS)),
        rows,
    )

    def ended(log: SimulationLog) -> float | None:
        return None if log.status == "completed" else log.end_time

    section.numbers["time_to_failure"] = {
        f"{period:g} {kind}": [ended(logs[period, kind, ratio]) for ratio in RATIOS]
        for period in periods
        for kind in maps
    }


def _verdict(section: Section, logs: dict[Cell, SimulationLog]) -> None:
    free = {pair: run_metrics(log) for (g, f, pair), log in logs.items() if g == 0.0 and f == "none"}
    near = [p for p, m in free.items() if m["integral_at_5s"] and np.abs(m["integral_at_5s"]).max() < 0.01]
    bare = [log for (g, f, _), log in logs.items() if g != 0.0 and f == "none"]
    lost = sum(log.status != "completed" for log in bare)
    kept = [log for (g, f, _), log in logs.items() if g != 0.0 and f != "none"]
    survived = sum(log.status == "completed" for log in kept)
    section.numbers |= {"near_zero_at_5s": len(near), "lost_uncompensated": lost, "survived_compensated": survived}
    section.verdict = (
        f"Without gravity the integral states are below 0.01 at 5 s for {len(near)} of {len(free)} pairs. "
        f"With gravity and (34) alone {lost} of {len(bare)} runs end early; with gravity compensated {survived} of "
        f"{len(kept)} complete. The nine pairs are five controllers."
    )
