"""(19) to (34): matrices in the paper's order, Hautus ranks, discretisation, decay, and what the weights can do."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from stewart_drake.control.state_space import (
    AXES,
    INTEGRAL,
    STATES,
    hautus_detectability,
    input_matrix,
    mass_diagonal,
    output_matrix,
    state_matrix,
)
from stewart_drake.mechanics.force_map import ForceMapKind, force_map
from stewart_drake.paper.as_printed import matrices_21_22_24
from stewart_drake.paper.lqi_poles import closed_loop, gain_of_ratio
from stewart_drake.paper.plots.state_space_plots import plot_matrices, plot_singular
from stewart_drake.paper.region import ANNOUNCED, NEAR, WIDE, sample_poses
from stewart_drake.paper.report import Section
from stewart_drake.paper.singularities import (
    Singularity,
    first_singularity,
    measures,
    nonzero_columns,
    stabilisability_rank,
)
from stewart_drake.paper.state_space_lqi import (
    RATIOS,
    SAME_GAIN,
    acceleration_map,
    add_decay,
    add_discretisation,
    add_nine_pairs,
    add_riccati,
)
from stewart_drake.paper.study import SEED, Study
from stewart_drake.references import paper_reference
from stewart_drake.robot import RobotParameters

KINDS: tuple[ForceMapKind, ...] = ("printed", "statics")
AXIS_NAMES = ("roll", "pitch", "yaw", "X", "Y", "Z")
CLAIM = (
    "With x = [φ, φ', θ, θ', ...] the error obeys (20), (25) with the matrices (21), (22), (24); the pair (A, B) is "
    "stabilisable by (28) and (A, C) detectable by (29), so an LQI gain (31), (32) exists and two weights tune it."
)


def make(study: Study) -> Section:
    """The section on (19) to (34)."""
    section = Section("state_space", "State space and LQI: (19) to (34)", CLAIM)
    robot, period = study.base.robot, study.base.lqi.period
    at_home = acceleration_map(robot, robot.home_pose)
    _matrices(section, study, robot, at_home, period)
    study.progress(0.1)
    _hautus(section, study, robot)
    study.progress(0.5)
    add_riccati(section, at_home, period)
    add_discretisation(section, study, at_home)
    study.progress(0.7)
    add_decay(section, study, robot, at_home, period)
    add_nine_pairs(section, at_home, period)
    section.verdict = verdict(section.numbers)
    return section


def verdict(numbers: dict[str, Any]) -> str:
    """The section's last word, from its numbers."""
    hautus, nine, mixed = numbers["hautus"], numbers["nine_pairs"], numbers["tau_for_m_inverse_tau"]
    regular = all(row["full"] == row["poses"] for row in hautus["regions"].values())
    lost = sorted({rank for row in hautus["singular"] for rank in row["rank"].values() if rank is not None})
    first = "Holds in part" if regular else "Does not hold"
    where = "at every regular pose tried" if regular else "not even at every regular pose tried"
    falls = f" and falls, down to {lost[0]}, at singular poses" if lost and lost[0] < STATES else ""
    unstable = [row["ratio"] for row in mixed["rows"] if row["radius"] > 1.0]
    tau = (
        f"(22) with tau for M^-1 tau gives an unstable loop at ratio {', '.join(f'{r:g}' for r in unstable)}"
        if unstable
        else "(22) with tau for M^-1 tau still gives stable loops"
    )
    continuous = "is zero" if numbers["riccati"]["undiscretised_gain"] < SAME_GAIN else "is not zero"
    rates = [row[k] for row in numbers["decay"]["rows"] for k in ("least", "most")]
    return (
        f"{first}: (28) has rank {STATES} {where}{falls}; (29) has rank {hautus['detectability']} everywhere. {tau} "
        f"(at {1e3 * mixed['period']:g} ms); (32) as printed {'can' if numbers['riccati']['sizes_fit'] else 'cannot'} "
        f"be evaluated, and the gain from A and B undiscretised {continuous}. The nine pairs are {nine['distinct']} "
        f"controllers, under which the slowest error decays at {min(rates):.2f} to {max(rates):.2f} rad/s."
    )


def _matrices(section: Section, study: Study, robot: RobotParameters, at_home: np.ndarray, period: float) -> None:
    a_bar, b_bar, c_bar = matrices_21_22_24(at_home)
    a, b, c = state_matrix(), input_matrix(at_home), output_matrix()
    printed = np.block([[a_bar, np.zeros((12, AXES))], [c_bar, np.zeros((AXES, AXES))]])
    same = {
        "A": bool(np.array_equal(a, printed)),
        "B": bool(np.array_equal(b, np.vstack([b_bar, np.zeros((AXES, AXES))]))),
        "C": bool(np.array_equal(c, np.hstack([c_bar, np.eye(AXES)]))),
    }
    section.numbers["matrices_as_printed"] = same
    pushed = np.abs(paper_reference().evaluate(np.linspace(0.0, np.pi, 201))[2]).max(axis=0)
    agree = [name for name, equal in same.items() if equal]
    section.text(
        "### A, B, C, (21) to (25)\n\n"
        "The matrices of the controller, in the paper's order of states. Written out from (21), (22), (24) index by "
        f"index, {', '.join(agree) if agree else 'none of them'} come{'s' if len(agree) == 1 else ''} out the same. "
        f"**D** (20) leaves out the reference's acceleration, up to {pushed[0]:.2f} rad/s² and {pushed[5]:.2f} m/s² "
        "for (37), (38); it acts as part of d(t). **D** (22) prints tau in B where (10) demands M⁻¹ tau; the matrix "
        "below has M⁻¹ tau."
    )
    section.figure(
        "The matrices of (25) at home, statics.", study.save_figure(plot_matrices(a, b, c), "state_matrices")
    )
    tau = force_map(robot, robot.home_pose)
    section.table(
        "The rows of B at home: tau as (22) prints, and M⁻¹ tau.",
        ("row", *(f"tau T{i}" for i in range(6)), *(f"M⁻¹ tau T{i}" for i in range(6))),
        [(f"{name}''", *(f"{v:.3g}" for v in tau[i] + 0.0), *(f"{v:.3g}" for v in at_home[i] + 0.0))
         for i, name in enumerate(AXIS_NAMES)],
    )  # fmt: skip
    rows = [
        {"ratio": ratio, "radius": float(np.abs(closed_loop(at_home, gain_of_ratio(tau, period, ratio), period)).max()),
         "right": float(np.abs(closed_loop(at_home, gain_of_ratio(at_home, period, ratio), period)).max())}
        for ratio in RATIOS
    ]  # fmt: skip
    section.numbers["tau_for_m_inverse_tau"] = {"period": period, "rows": rows}
    section.table(
        f"Spectral radius of the sampled loop at home, control period {1e3 * period:g} ms: a gain designed on tau does "
        f"not know that the platform turns up to {1.0 / mass_diagonal(robot).min():.0f} times more readily than tau "
        "alone says, and overshoots. Above 1 the loop is unstable.",
        ("omega_Q / omega_R", "gain from tau", "gain from M⁻¹ tau"),
        [(f"{row['ratio']:g}", row["radius"], row["right"]) for row in rows],
    )


def _hautus(section: Section, study: Study, robot: RobotParameters) -> None:
    section.text(
        "### Hautus tests, (28), (29)\n\n"
        "**D** The tests concern modes that are not asymptotically stable, Re λ >= 0; the print has λ <= 0 and counts "
        "columns. All modes of A lie at zero, so (28) asks for the rank of tau, and that alone depends on the pose. "
        "(29) does not: C holds the integrals themselves, and every other state feeds one."
    )
    rng = np.random.default_rng(SEED)
    regions: dict[str, dict[str, Any]] = {}
    for region, kind in itertools.product((NEAR, ANNOUNCED, WIDE), KINDS):
        poses = sample_poses(robot, region, study.pick(400, 60), rng).poses
        ranks = [stabilisability_rank(robot, pose, kind) for pose in poses]
        smallest = np.linalg.svd(acceleration_map(robot, poses, kind), compute_uv=False)[:, -1]
        regions[f"{region.name}, {kind}"] = {
            "poses": len(poses), "full": ranks.count(STATES), "smallest": float(smallest.min()),
        }  # fmt: skip
    detectable = hautus_detectability(state_matrix(), output_matrix())
    bare = output_matrix()
    bare[:, INTEGRAL] = 0.0
    section.table(
        f"Rank of (28) at random poses in reach. (29) has rank {detectable} of {STATES} whatever the pose; with C_bar "
        f"alone, without the integrals, it would have {hautus_detectability(state_matrix(), bare)}.",
        ("box, force map", "poses", f"rank {STATES}", "smallest singular value of M⁻¹ tau"),
        [(name, row["poses"], row["full"], row["smallest"]) for name, row in regions.items()],
    )
    singular = [
        found for axis, sign in itertools.product(range(6), (1.0, -1.0))
        if (found := first_singularity(robot, sign * np.eye(6)[axis], np.pi if axis < 3 else 0.6)) is not None
    ]  # fmt: skip
    rows = [_singular_numbers(robot, found) for found in singular]
    section.numbers["hautus"] = {"detectability": detectable, "regions": regions, "singular": rows}
    section.text(
        "Random poses are never exactly singular. So each axis is followed from home until either a crank reaches its "
        "dead centre (*serial*: e_l.e_N = 0 for a leg, the rods' lines keep rank six) or the determinant of the rods' "
        "lines changes sign (*parallel*: all cranks still transmit). At a dead centre the printed map loses the "
        "column of that leg and (28) fails, while the statics map is infinite: the rod needs no torque to bear any "
        "force. At a parallel singularity both fail, with all six columns of B in place: counting them, as the text "
        "does, would not notice."
    )
    section.table(
        "First singular pose along each axis. Ranks of (28); a dash where the map is infinite.",
        ("axis", "offset from home", "kind", "least transmission", "conditioning", "rank printed", "rank statics",
         "columns of printed B not zero"),
        [
            (row["axis"], row["at"], row["kind"], f"{row['transmission']:.2g}", f"{row['conditioning']:.2g}",
             row["rank"]["printed"], row["rank"]["statics"], row["columns"])
            for row in rows
        ],
    )  # fmt: skip
    approaches: dict[str, tuple[np.ndarray, dict[str, np.ndarray]]] = {}
    for sort in ("serial", "parallel"):
        # The purest of its kind: as few dead cranks as can be, and far from the other kind.
        of_kind = [i for i, row in enumerate(rows) if row["kind"] == sort]
        if of_kind:
            best = max(of_kind, key=lambda i: (rows[i]["columns"], rows[i]["transmission"], rows[i]["conditioning"]))
            approaches |= _approach(robot, singular[best], study.pick(60, 30))
    if approaches:
        section.figure(
            "The two kinds told apart on the way to them. Towards a dead centre the transmission falls as the root of "
            "the distance and takes the smallest singular value of the printed map with it, while the largest of the "
            "statics map grows without bound. Towards a parallel singularity the conditioning falls in proportion to "
            "the distance, and with it the smallest singular value of both maps.",
            study.save_figure(plot_singular(approaches), "state_space_singular"),
        )


def _singular_numbers(robot: RobotParameters, found: Singularity) -> dict[str, Any]:
    axis = int(np.abs(found.direction).argmax())
    at = float((found.pose(robot) - robot.home_pose)[axis])
    pose, told = found.pose(robot), measures(robot, found.pose(robot))
    return {
        "axis": ("+" if at > 0.0 else "-") + AXIS_NAMES[axis],
        "at": f"{np.degrees(at):.1f}\u00a0deg" if axis < 3 else f"{1e3 * at:.1f}\u00a0mm",
        "kind": found.kind,
        "transmission": told["transmission"],
        "conditioning": told["conditioning"],
        "rank": {kind: stabilisability_rank(robot, pose, kind) for kind in KINDS},
        "columns": nonzero_columns(robot, pose, "printed"),
    }


def _approach(
    robot: RobotParameters, found: Singularity, count: int
) -> dict[str, tuple[np.ndarray, dict[str, np.ndarray]]]:
    axis = int(np.abs(found.direction).argmax())
    back = np.logspace(np.log10(0.5 * found.distance), -9, count)
    values = [measures(robot, found.pose(robot, float(step))) for step in back]
    names = {
        "printed_min": "smallest singular value, printed",
        "statics_min": "smallest singular value, statics",
        "statics_max": "largest singular value, statics",
        "transmission": "least transmission",
        "conditioning": "conditioning",
    }
    curves = {name: np.array([v[key] for v in values]) for key, name in names.items()}
    title = f"{found.kind.capitalize()}, along {AXIS_NAMES[axis]}|{'deg' if axis < 3 else 'mm'}"
    return {title: (back * (180.0 / np.pi if axis < 3 else 1e3), curves)}
