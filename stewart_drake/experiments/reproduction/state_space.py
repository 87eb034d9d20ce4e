"""(19) to (34): matrices in the paper's order, Hautus ranks, discretisation, decay, and what the weights can do."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from stewart_drake.experiments.report import Section
from stewart_drake.experiments.reproduction.as_printed import matrices_21_22_24
from stewart_drake.experiments.reproduction.lqi_poles import (
    channel_decay,
    closed_loop,
    decay_limit,
    faster_weights,
    gain_by_drake,
    gain_of_ratio,
    gain_without_discretisation,
    product_shape,
    riccati_residual,
    same_gain,
    slowest_decay,
)
from stewart_drake.experiments.reproduction.region import ANNOUNCED, NEAR, WIDE, sample_poses
from stewart_drake.experiments.reproduction.singularities import (
    Singularity,
    first_singularity,
    measures,
    nonzero_columns,
    stabilisability_rank,
)
from stewart_drake.experiments.reproduction.study import SEED, Study
from stewart_drake.force_map import ForceMapKind, force_map
from stewart_drake.plotting_state_space import plot_decay, plot_discretisation, plot_matrices, plot_singular
from stewart_drake.riccati import split_gain
from stewart_drake.robot import RobotParameters
from stewart_drake.state_space import (
    AXES,
    INTEGRAL,
    STATES,
    hautus_detectability,
    input_matrix,
    mass_diagonal,
    output_matrix,
    state_matrix,
)

RATIOS = (0.01, 0.1, 1.0, 10.0, 100.0)
OMEGAS = (0.1, 1.0, 10.0)
SAME_GAIN = 1e-10
"""[-] gains that agree to this share are one controller."""
KINDS: tuple[ForceMapKind, ...] = ("printed", "statics")
AXIS_NAMES = ("roll", "pitch", "yaw", "X", "Y", "Z")
FASTER = 10.0

CLAIM = (
    "With x = [φ, φ', θ, θ', ...] the error obeys (20), (25) with the matrices (21), (22), (24); the pair (A, B) is "
    "stabilisable by (28) and (A, C) detectable by (29), so an LQI gain (31), (32) exists and two weights tune it."
)


def make(study: Study) -> Section:
    """The section on (19) to (34)."""
    section = Section("state_space", "State space and LQI: (19) to (34)", CLAIM)
    robot, period = study.base.robot, study.base.controller.period
    at_home = acceleration_map(robot, robot.home_pose)
    _matrices(section, study, robot, at_home, period)
    study.progress(0.1)
    _hautus(section, study, robot)
    study.progress(0.5)
    _riccati(section, at_home, period)
    _discretisation(section, study, at_home)
    study.progress(0.7)
    _decay(section, study, robot, at_home, period)
    _nine_pairs(section, at_home, period)
    section.verdict = verdict(section.numbers)
    return section


def acceleration_map(robot: RobotParameters, pose: np.ndarray, kind: ForceMapKind = "statics") -> np.ndarray:
    """M^-1 tau of (10); (..., 6, 6)."""
    return np.asarray(force_map(robot, pose, kind) / mass_diagonal(robot)[:, None])


def verdict(numbers: dict[str, Any]) -> str:
    """The section's last word, from its numbers."""
    hautus, nine, mixed = numbers["hautus"], numbers["nine_pairs"], numbers["tau_for_m_inverse_tau"]
    regular = all(row["full"] == row["poses"] for row in hautus["regions"].values())
    lost = sorted({rank for row in hautus["singular"] for rank in row["rank"].values() if rank is not None})
    first = "Holds in part" if regular else "Does not hold"
    where = "at every regular pose tried" if regular else "not even at every regular pose tried"
    falls = f" and falls to {lost[0]} at singular poses" if lost and lost[0] < STATES else ""
    unstable = [row["ratio"] for row in mixed["rows"] if row["radius"] > 1.0]
    tau = (
        f"(22) with tau for M^-1 tau gives an unstable loop at ratio {', '.join(f'{r:g}' for r in unstable)}"
        if unstable
        else "(22) with tau for M^-1 tau still gives stable loops"
    )
    useless = numbers["riccati"]["undiscretised_gain"] < SAME_GAIN
    continuous = "is zero" if useless else "is not zero"
    return (
        f"{first}: (28) has rank {STATES} {where}{falls}; (29) has rank {hautus['detectability']} everywhere. {tau}; (32) "
        f"as printed {'can' if numbers['riccati']['sizes_fit'] else 'cannot'} be evaluated, and the gain from A and B "
        f"undiscretised {continuous}. The nine pairs are {nine['distinct']} controllers, and under equal weights the "
        f"error decays no faster than {numbers['decay']['limit']:.2f} rad/s."
    )


def _matrices(
    section: Section, study: Study, robot: RobotParameters, at_home: np.ndarray, period: float
) -> None:
    a_bar, b_bar, c_bar = matrices_21_22_24(at_home)
    a, b, c = state_matrix(), input_matrix(at_home), output_matrix()
    printed = np.block([[a_bar, np.zeros((12, AXES))], [c_bar, np.zeros((AXES, AXES))]])
    same = {
        "A": bool(np.array_equal(a, printed)),
        "B": bool(np.array_equal(b, np.vstack([b_bar, np.zeros((AXES, AXES))]))),
        "C": bool(np.array_equal(c, np.hstack([c_bar, np.eye(AXES)]))),
    }
    section.numbers["matrices_as_printed"] = same
    agree = [name for name, equal in same.items() if equal]
    section.text(
        "### A, B, C, (21) to (25)\n\n"
        f"The matrices of the controller, in the paper's order of states. Written out from (21), (22), (24) index by "
        f"index, {', '.join(agree) if agree else 'none of them'} come{'s' if len(agree) == 1 else ''} out the same. "
        "**D** (20) leaves out the reference's acceleration; it acts as part of d(t). **D** (22) prints tau in B where "
        "(10) demands M⁻¹ tau; the matrix below has M⁻¹ tau."
    )
    section.figure("The matrices of (25) at home, statics.", study.save_figure(plot_matrices(a, b, c), "state_matrices"))
    tau = force_map(robot, robot.home_pose)
    section.table(
        "The rows of B at home: tau as (22) prints, and M⁻¹ tau.",
        ("row", *(f"tau T{i}" for i in range(1, 7)), *(f"M⁻¹ tau T{i}" for i in range(1, 7))),
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
        "columns. All modes of A lie at zero, so (28) asks for the rank of tau, and that alone depends on the pose. (29) "
        "does not: C holds the integrals themselves, and every other state feeds one."
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
        "lines changes sign (*parallel*: all cranks still transmit). At a dead centre the printed map loses the column of "
        "that leg and (28) fails, while the statics map is infinite: the rod needs no torque to bear any force. At a "
        "parallel singularity both fail, with all six columns of B in place: counting them, as the text does, would not "
        "notice."
    )
    section.table(
        "First singular pose along each axis. Ranks of (28); a dash where the map is infinite.",
        ("axis", "at", "kind", "least transmission", "conditioning", "rank printed", "rank statics",
         "columns of printed B not zero"),
        [
            (row["axis"], row["at"], row["kind"], f"{row['transmission']:.2g}", f"{row['conditioning']:.2g}",
             row["rank"]["printed"], row["rank"]["statics"], row["columns"])
            for row in rows
        ],
    )  # fmt: skip
    approaches = {}
    for kind in ("serial", "parallel"):
        chosen = next((found for found in singular if found.kind == kind), None)
        if chosen is not None:
            approaches |= _approach(robot, chosen, study.pick(60, 30))
    if approaches:
        section.figure(
            "The two kinds told apart on the way to them. Towards a dead centre the transmission falls as the root of "
            "the distance and takes the smallest singular value of the printed map with it, while the largest of the "
            "statics map grows without bound. Towards a parallel singularity the conditioning falls in proportion to the "
            "distance, and with it the smallest singular value of both maps.",
            study.save_figure(plot_singular(approaches), "state_space_singular"),
        )


def _singular_numbers(robot: RobotParameters, found: Singularity) -> dict[str, Any]:
    axis = int(np.abs(found.direction).argmax())
    at = float((found.pose(robot) - robot.home_pose)[axis])
    pose, told = found.pose(robot), measures(robot, found.pose(robot))
    return {
        "axis": ("+" if at > 0.0 else "-") + AXIS_NAMES[axis],
        "at": f"{np.degrees(at):.1f} deg" if axis < 3 else f"{1e3 * at:.1f} mm",
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


def _riccati(section: Section, at_home: np.ndarray, period: float) -> None:
    c, q, a, b, r = (AXES, STATES), (STATES, STATES), (STATES, STATES), (STATES, AXES), (AXES, AXES)
    terms = {
        "P": q,
        "C^T Q C": product_shape(c[::-1], q, c),
        "A^T P A": product_shape(a, q, a),
        "A^T P B (R + B^T P B)^-1": product_shape(a, q, b, r),
        "A^T P B (R + B^T P B)^-1 B^T P A, not printed": product_shape(a, q, b, r, b[::-1], q, a),
        "Q of (27), not printed": q,
    }
    printed = [shape for name, shape in terms.items() if "not printed" not in name]
    fit = all(shape == printed[0] for shape in printed)
    undiscretised = float(max(np.abs(gain_without_discretisation(at_home, ratio)).max() for ratio in RATIOS))
    residual = max(riccati_residual(at_home, period, ratio, 1.0) for ratio in RATIOS)
    gain = gain_of_ratio(at_home, period, 1.0)
    grows = float(np.abs(closed_loop(at_home, -gain, period)).max())
    calm = float(np.abs(closed_loop(at_home, gain, period)).max())
    doubling = float(period * np.log(2.0) / np.log(grows)) if grows > 1.0 else None
    section.numbers["riccati"] = {
        "sizes_fit": fit, "undiscretised_gain": undiscretised, "residual": residual,
        "radius_30": grows, "radius_34": calm, "doubling": doubling,
    }  # fmt: skip
    section.text(
        "### (30) to (34) as printed\n\n"
        "**D** The terms of (32) do not have one size, so it cannot be evaluated; the standard discrete Riccati equation "
        f"with Q of (27) is meant, and Drake's P leaves a residual of {residual:.1g} in it. **D** (26) and (31) are "
        "discrete while A, B are continuous. Put in as they stand, they give a gain whose largest entry over the five "
        f"ratios is {undiscretised:.1g}: read as x(k+1) = A x(k) + B u(k), a nilpotent A forgets everything in three "
        "ticks by itself, and the torque is never worth its cost. So A, B must be discretised. **D** (30) and (34) "
        f"contradict each other in sign: with u = -K e the spectral radius of the loop at home is {calm:.4f}, with "
        f"u = K e it is {grows:.2f}"
        + (f", and the error doubles every {1e3 * doubling:.0f} ms." if doubling else ", which is stable too.")
    )
    section.table(
        "Sizes of the terms of (32).",
        ("term", "size"),
        [(name, "does not multiply" if s is None else f"{s[0]} x {s[1]}") for name, s in terms.items()],
    )


def _discretisation(section: Section, study: Study, at_home: np.ndarray) -> None:
    periods = np.logspace(-4, -1, study.pick(25, 9))
    named = [p for p in (1e-4, 1e-3, 5e-3, 2e-2, 0.1)]
    gains: dict[str, np.ndarray] = {}
    decays: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for ratio in (0.01, 1.0, 100.0):
        compared = [compare_discretisations(at_home, float(period), ratio) for period in periods]
        gains[f"{ratio:g}"] = np.array([row["gain"] for row in compared])
        decays[f"{ratio:g}"] = tuple(np.array([row[k] for row in compared]) for k in ("exact", "euler"))  # type: ignore[assignment]
    rows = [{"period": p, "ratio": ratio, **compare_discretisations(at_home, p, ratio)}
            for p in named for ratio in (0.01, 1.0, 100.0)]  # fmt: skip
    section.numbers["discretisation"] = rows
    section.text(
        "### Exact or Euler discretisation\n\n"
        "A is nilpotent, A³ = 0, so the exact zero-order hold is a polynomial of degree two and costs nothing. Both gains "
        "below act on the exact sampled system at home. The radius is that of the fast poles too: a loop with Euler's "
        "gain is stable where it stays below 1."
    )
    section.table(
        "Gain and closed loop, Euler against exact.",
        ("control period [ms]", "omega_Q / omega_R", "gain differs by", "slowest decay, exact [rad/s]",
         "slowest decay, Euler [rad/s]", "spectral radius, Euler"),
        [(f"{1e3 * row['period']:g}", f"{row['ratio']:g}", f"{row['gain']:.2%}", f"{row['exact']:.4f}",
          f"{row['euler']:.4f}", f"{row['radius']:.4f}") for row in rows],
    )  # fmt: skip
    section.figure(
        "Exact against Euler discretisation over the control period.",
        study.save_figure(plot_discretisation(periods, gains, decays), "state_space_discretisation"),
    )


def compare_discretisations(at_pose: np.ndarray, period: float, ratio: float) -> dict[str, float]:
    """Euler's gain against the exact one, both on the exact sampled system.

    Returns:
        `gain` relative difference [-]; `exact`, `euler` slowest decay [rad/s]; `radius` spectral radius under Euler's.
    """
    exact, euler = (gain_of_ratio(at_pose, period, ratio, method) for method in ("exact", "euler"))  # type: ignore[arg-type]
    poles = [closed_loop(at_pose, gain, period) for gain in (exact, euler)]
    return {
        "gain": float(np.linalg.norm(euler - exact) / np.linalg.norm(exact)),
        "exact": slowest_decay(poles[0], period),
        "euler": slowest_decay(poles[1], period),
        "radius": float(np.abs(poles[1]).max()),
    }


def _decay(section: Section, study: Study, robot: RobotParameters, at_home: np.ndarray, period: float) -> None:
    poses = sample_poses(robot, NEAR, study.pick(100, 15), np.random.default_rng(SEED), 1e-2).poses
    maps = acceleration_map(robot, poses)
    faster = faster_weights(FASTER)
    rows = []
    for ratio in RATIOS:
        rates = [slowest_decay(closed_loop(b, gain_of_ratio(b, period, ratio), period), period) for b in maps]
        tuned = (ratio * faster[0], ratio * faster[1], ratio * faster[2], 1.0)
        quick = [slowest_decay(closed_loop(b, split_gain(b, period, tuned), period), period) for b in maps]
        home = slowest_decay(closed_loop(at_home, gain_of_ratio(at_home, period, ratio), period), period)
        rows.append({"ratio": ratio, "home": home, "least": min(rates), "most": max(rates), "faster": min(quick)})
    section.numbers["decay"] = {"limit": decay_limit(), "faster_limit": decay_limit(faster), "rows": rows}
    section.text(
        "### How fast the error can decay: a limit of Q = omega_Q I\n\n"
        "In the singular vectors of M⁻¹ tau the LQI splits into six channels e'' = s u with z' = e, and a channel's poles "
        "depend on g = s² omega_Q / omega_R alone. However large g, one pair of poles stays at the roots of "
        f"p⁴ - p² + 1: real part -√3/2, {decay_limit():.4f} rad/s. Metres, metres per second and metre seconds weigh the "
        "same in Q, and that balance sets the time scale of a second. The strongest channels sit at this limit at every "
        "ratio of the paper, so no weight in the two-weight family makes the whole error decay faster. Weights "
        f"1, 1/{FASTER:g}² and {FASTER:g}² on error, rate and integral move the limit to {decay_limit(faster):.2f} rad/s."
    )
    section.table(
        f"Slowest decay of the sampled loop, control period {1e3 * period:g} ms, at home and over {len(poses)} poses of "
        "the near box.",
        ("omega_Q / omega_R", "at home [rad/s]", "least [rad/s]", "most [rad/s]",
         f"least with weights 1, 1/{FASTER:g}², {FASTER:g}² [rad/s]"),
        [(f"{r['ratio']:g}", *(f"{r[k]:.4f}" for k in ("home", "least", "most", "faster"))) for r in rows],
    )  # fmt: skip
    strength = np.logspace(-2, 7, 200)
    curves = {"equal weights (27)": channel_decay(strength),
              f"weights 1, 1/{FASTER:g}², {FASTER:g}²": channel_decay(strength, faster)}  # fmt: skip
    squares = np.linalg.svd(at_home, compute_uv=False) ** 2
    channels = {f"{ratio:g}": ratio * squares for ratio in RATIOS}
    section.figure(
        "Slowest decay of one channel in continuous time, with the channels of this robot at home; dotted: the limits.",
        study.save_figure(
            plot_decay(strength, curves, (decay_limit(), decay_limit(faster)), channels,
                       {name: channel_decay(g) for name, g in channels.items()}),
            "state_space_decay",
        ),
    )  # fmt: skip


def _nine_pairs(section: Section, at_home: np.ndarray, period: float) -> None:
    pairs = list(itertools.product(OMEGAS, OMEGAS))
    gains = np.array([gain_by_drake(at_home, period, *pair) for pair in pairs])
    labels = same_gain(gains, SAME_GAIN)
    size = np.abs(gains).max(axis=(-2, -1))
    within = [float(np.abs(gains[i] - gains[j]).max() / size[j])
              for i, j in itertools.combinations(range(9), 2) if labels[i] == labels[j]]  # fmt: skip
    between = [float(np.abs(gains[i] - gains[j]).max() / max(size[i], size[j]))
               for i, j in itertools.combinations(range(9), 2) if labels[i] != labels[j]]  # fmt: skip
    section.numbers["nine_pairs"] = {
        "distinct": len(set(labels.tolist())), "labels": labels.tolist(),
        "within": max(within, default=None), "between": min(between, default=None),
    }  # fmt: skip
    section.text(
        "### Only the ratio of the weights matters, (27)\n\n"
        f"Scaling omega_Q and omega_R together scales the cost and changes no minimum. Of the paper's nine pairs, solved by "
        f"Drake one by one, {len(set(labels.tolist()))} gains are different. "
        + (f"Gains of the same ratio agree to {max(within):.1g}" if within else "No two gains agree")
        + (f", the others differ by at least {min(between):.2g}. " if between else ". ")
        + "An estimator that is shown the loop can therefore tell the ratio at best, never the pair."
    )
    section.table(
        f"The gain of each pair at home, control period {1e3 * period:g} ms.",
        ("omega_Q", "omega_R", "ratio", "controller", "largest entry of K"),
        [(f"{q:g}", f"{r:g}", f"{q / r:g}", "ABCDEFGHI"[label], f"{top:.12g}")
         for (q, r), label, top in zip(pairs, labels, size, strict=True)],
    )  # fmt: skip
