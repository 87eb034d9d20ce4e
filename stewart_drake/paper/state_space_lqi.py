"""(26) to (34) for the section on the state space: gains as printed and as meant, and how the error decays."""

from __future__ import annotations

import itertools

import numpy as np

from stewart_drake.control.riccati import split_gain
from stewart_drake.control.state_space import AXES, STATES, Discretization, mass_diagonal
from stewart_drake.mechanics.force_map import ForceMapKind, force_map
from stewart_drake.paper.lqi_poles import (
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
from stewart_drake.paper.plots.state_space_plots import plot_decay, plot_discretisation
from stewart_drake.paper.region import NEAR, sample_poses
from stewart_drake.paper.report import Section
from stewart_drake.paper.study import SEED, Study
from stewart_drake.robot import RobotParameters

RATIOS = (0.01, 0.1, 1.0, 10.0, 100.0)
"""omega_Q / omega_R of the paper's nine pairs."""
OMEGAS = (0.1, 1.0, 10.0)
SAME_GAIN = 1e-10
"""[-] gains that agree to this share are one controller."""
PERIODS = (1e-4, 1e-3, 5e-3, 2e-2, 0.1)
"""[s] control periods of the table; the paper gives none."""
METHODS: tuple[Discretization, ...] = ("exact", "euler")
FASTER = 10.0
"""By how much the better weights of the decay's table speed up its limit."""


def acceleration_map(robot: RobotParameters, pose: np.ndarray, kind: ForceMapKind = "statics") -> np.ndarray:
    """M^-1 tau of (10); (..., 6, 6)."""
    return np.asarray(force_map(robot, pose, kind) / mass_diagonal(robot)[:, None])


def add_riccati(section: Section, at_home: np.ndarray, period: float) -> None:
    """Adds what (30) to (34) come to as printed."""
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
        "**D** The terms of (32) do not have one size, so it cannot be evaluated; the standard discrete Riccati "
        f"equation with Q of (27) is meant, and Drake's P leaves a residual of {residual:.1g} in it. **D** (26) and "
        "(31) are discrete while A, B are continuous. Put in as they stand, they give a gain whose largest entry over "
        f"the five ratios is {undiscretised:.1g}: read as x(k+1) = A x(k) + B u(k), the rates of the next tick hold "
        "nothing but the torque, which then can mend nothing. So A, B must be discretised. **D** (30) and (34) "
        f"contradict each other in sign: with u = -K e the spectral radius of the loop at home is {calm:.4f}, with u "
        f"= K e it is {grows:.2f}"
        + (f", and the error doubles every {1e3 * doubling:.0f} ms." if doubling else ", which is stable too.")
    )
    section.table(
        "Sizes of the terms of (32).",
        ("term", "size"),
        [(name, "does not multiply" if s is None else f"{s[0]} x {s[1]}") for name, s in terms.items()],
    )


def add_discretisation(section: Section, study: Study, at_home: np.ndarray) -> None:
    """Adds the comparison of the two discretisations at home."""
    periods = np.logspace(-4, -1, study.pick(25, 9))
    gains: dict[str, np.ndarray] = {}
    decays: dict[str, np.ndarray] = {}
    for ratio in (0.01, 1.0, 100.0):
        compared = [compare_discretisations(at_home, float(period), ratio) for period in periods]
        gains[f"{ratio:g}"] = np.array([row["gain"] for row in compared])
        decays[f"{ratio:g}"] = np.array([row["euler"] / row["exact"] - 1.0 for row in compared])
    rows = [{"period": p, "ratio": ratio, **compare_discretisations(at_home, p, ratio)}
            for p in PERIODS for ratio in (0.01, 1.0, 100.0)]  # fmt: skip
    section.numbers["discretisation"] = rows
    ours = [row for row in rows if row["period"] == PERIODS[2]]
    section.text(
        "### Exact or Euler discretisation\n\n"
        "A is nilpotent, A³ = 0, so the exact zero-order hold is a polynomial of degree two and costs nothing. Both "
        "gains below act on the exact sampled system at home. The spectral radius counts all poles, the fast ones "
        f"too: with Euler's gain the loop is stable where it stays below 1. At {1e3 * PERIODS[2]:g} ms, our control "
        f"period for the paper's runs, Euler's gain is off by {100.0 * max(row['gain'] for row in ours):.1g} % at "
        f"most, and the decay by {100.0 * max(abs(row['euler'] / row['exact'] - 1.0) for row in ours):.1g} %."
    )
    section.table(
        "Gain and closed loop, Euler against exact.",
        ("control period [ms]", "omega_Q / omega_R", "gain differs by", "slowest decay, exact [rad/s]",
         "slowest decay, Euler [rad/s]", "spectral radius, Euler"),
        [(f"{1e3 * row['period']:g}", f"{row['ratio']:g}", f"{100.0 * row['gain']:.2g} %", f"{row['exact']:.4f}",
          f"{row['euler']:.4f}", f"{row['radius']:.4f}") for row in rows],
    )  # fmt: skip
    section.figure(
        "Euler against exact discretisation over the control period: relative differences.",
        study.save_figure(plot_discretisation(periods, gains, decays), "state_space_discretisation"),
    )


def compare_discretisations(at_pose: np.ndarray, period: float, ratio: float) -> dict[str, float]:
    """Euler's gain against the exact one, both on the exact sampled system.

    Returns:
        `gain` relative difference [-]; `exact`, `euler` slowest decay [rad/s]; `radius` spectral radius under Euler's.
    """
    exact, euler = (gain_of_ratio(at_pose, period, ratio, method) for method in METHODS)
    poles = [closed_loop(at_pose, gain, period) for gain in (exact, euler)]
    return {
        "gain": float(np.linalg.norm(euler - exact) / np.linalg.norm(exact)),
        "exact": slowest_decay(poles[0], period),
        "euler": slowest_decay(poles[1], period),
        "radius": float(np.abs(poles[1]).max()),
    }


def add_decay(section: Section, study: Study, robot: RobotParameters, at_home: np.ndarray, period: float) -> None:
    """Adds the limit that equal weights put on the decay of the error."""
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
    strength = np.logspace(-2, 8, 201)
    squares = np.linalg.svd(at_home, compute_uv=False) ** 2
    peak = float(channel_decay(strength).max())
    strongest = float(channel_decay(RATIOS[0] * squares)[0])
    section.numbers["decay"] = {
        "limit": decay_limit(), "faster_limit": decay_limit(faster), "peak": peak, "strongest": strongest, "rows": rows,
    }  # fmt: skip
    section.text(
        "### How fast the error can decay: a limit of Q = omega_Q I\n\n"
        "In the singular vectors of M⁻¹ tau the LQI splits into six channels e'' = s u with z' = e, and a channel's "
        "poles depend on g = s² omega_Q / omega_R alone. However large g, one pair of poles stays at the roots of p⁴ "
        f"- p² + 1: real part -√3/2, {decay_limit():.4f} rad/s. Metres, metres per second and metre seconds weigh the "
        "same in Q, and that balance sets the time scale of a second. At no g is the slowest pole of a channel faster "
        f"than {peak:.2f} rad/s, and this robot's strongest channel is at {strongest:.4f} rad/s already at ratio "
        f"{RATIOS[0]:g}: larger ratios only bring the others there. Weights 1, 1/{FASTER:g}² and {FASTER:g}² on "
        f"error, rate and integral move the limit to {decay_limit(faster):.2f} rad/s."
    )
    section.table(
        f"Slowest decay of the sampled loop, control period {1e3 * period:g} ms, at home and over {len(poses)} poses "
        "of the near box.",
        ("omega_Q / omega_R", "at home [rad/s]", "least [rad/s]", "most [rad/s]",
         f"least with weights 1, 1/{FASTER:g}², {FASTER:g}² [rad/s]"),
        [(f"{r['ratio']:g}", *(f"{r[k]:.4f}" for k in ("home", "least", "most", "faster"))) for r in rows],
    )  # fmt: skip
    curves = {"equal weights (27)": channel_decay(strength),
              f"weights 1, 1/{FASTER:g}², {FASTER:g}²": channel_decay(strength, faster)}  # fmt: skip
    channels = {f"{ratio:g}": ratio * squares for ratio in RATIOS}
    section.figure(
        "Slowest decay of one channel in continuous time, with the channels of this robot at home; dotted: the limits.",
        study.save_figure(
            plot_decay(strength, curves, (decay_limit(), decay_limit(faster)), channels,
                       {name: channel_decay(g) for name, g in channels.items()}),
            "state_space_decay",
        ),
    )  # fmt: skip


def add_nine_pairs(section: Section, at_home: np.ndarray, period: float) -> None:
    """Adds the gains of the paper's nine pairs of weights."""
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
        "Scaling omega_Q and omega_R together scales the cost and changes no minimum. Of the paper's nine pairs, "
        f"solved by Drake one by one, {len(set(labels.tolist()))} gains are different. "
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
