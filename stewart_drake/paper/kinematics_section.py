"""(1) to (6): inverse and forward kinematics against Drake's plant, and what the misprints of (3), (5), (6) do."""

from __future__ import annotations

from typing import Any

import numpy as np

from stewart_drake.mechanics.kinematics import inverse_kinematics, leg_geometry, line_conditioning
from stewart_drake.paper import as_printed
from stewart_drake.paper.drake_kinematics import DrakeKinematics
from stewart_drake.paper.kinematics_checks import (
    BRANCHES,
    MisprintEffect,
    NewtonOutcome,
    branch_of_6,
    misprint_effect,
    newton_outcome,
    solver_differences,
)
from stewart_drake.paper.plots.kinematics_plots import plot_forward, plot_misprints
from stewart_drake.paper.region import ANNOUNCED, NEAR, WIDE, PoseSample, sample_poses
from stewart_drake.paper.report import Section
from stewart_drake.paper.study import SEED, Study
from stewart_drake.robot import RobotParameters

EXACT = 1e-11
"""[m, rad] rounding of lengths of a metre and of angles, with room."""

CLAIM = (
    "The paper writes the vectors from motor to platform joint (2), their lengths (5), and says that the six crank "
    "angles (1) follow from the pose in closed form (6), in one branch and without its coefficients A, B, C."
)


def make(study: Study) -> Section:
    """The section on (1) to (6)."""
    section = Section("kinematics", "Kinematics: (1) to (6)", CLAIM)
    robot, rng = study.base.robot, np.random.default_rng(SEED)
    samples = [sample_poses(robot, region, study.pick(600, 100), rng) for region in (NEAR, ANNOUNCED, WIDE)]
    section.text(
        "Poses are drawn at random from three boxes around home and kept where all six rods can span:\n\n"
        + "\n".join(f"- *{s.region.name}*: {s.region.words}; {s.share:.1%} of it is in reach." for s in samples)
    )
    section.numbers["regions"] = {s.region.name: {"share": s.share, "poses": len(s.poses)} for s in samples}
    _inverse(section, robot, samples, study.pick(25, 5))
    study.progress(0.3)
    _forward(section, study, robot, samples)
    study.progress(0.8)
    _misprints(section, study, robot, samples)
    _branches(section, robot, samples)
    section.verdict = verdict(section.numbers)
    return section


def verdict(numbers: dict[str, Any]) -> str:
    """The section's last word, from its numbers."""
    inverse, forward, prints = numbers["inverse"], numbers["forward"], numbers["misprints"]
    rod = max(row["rod_error"] for row in inverse.values())
    near = [row for name, row in forward.items() if name.startswith("near ")]
    found = sum(row["same"] for row in near) / sum(sum(row[k] for k in ("same", "other", "failed")) for row in near)
    exact = rod < EXACT
    kept = f"to {rod:.1g} m" if exact else f"only to {rod:.1g} m, which is more than rounding"
    harm = [
        f"(3) misplaces a joint by up to {1e3 * prints['(3)']['joint_shift'][-1]:.2g} mm",
        f"(5) by up to {1e3 * prints['(5)']['joint_shift'][-1]:.0f} mm",
    ]
    wrong = any(prints[name]["joint_shift"][-1] > EXACT for name in ("(3)", "(5)"))
    lost = {name: max(row["neither"] for key, row in numbers["branch_of_6"].items() if key.startswith(f"{name},"))
            for name in ("near", "announced")}  # fmt: skip
    return (
        f"{'Holds' if exact and not wrong else 'Holds in part' if exact else 'Does not hold'}: the closed form of "
        f"(1), (2) closes Drake's plant {kept} on both branches, and Newton's method returns from home to {found:.1%} "
        f"of the near poses. As printed, {' and '.join(harm)} over the near box; (6) is no solution for "
        f"{lost['near']:.0%} of the legs there and {lost['announced']:.0%} in the announced box."
    )


def _inverse(section: Section, robot: RobotParameters, samples: list[PoseSample], solves: int) -> None:
    section.text(
        "### Inverse kinematics, (1), (2)\n\n"
        "The crank angles come from theta = atan2(B, A) ± acos(C / sqrt(A² + B²)) with d = R p + G - P, A = 2 |a| "
        f"d·h, B = 2 |a| d·z and C = d·d + |a|² - {robot.rod_length:g}². Crank angles and pose then go into Drake's "
        "plant, each for itself, and Drake's forward kinematics says how far each crank tip is from its platform "
        "joint. The last column puts rods in between as well: the gap at the ball that closes each loop."
    )
    rows, numbers = [], {}
    for branch in BRANCHES:
        on_branch = robot.replace(branch=branch)
        drake = DrakeKinematics(on_branch)
        for sample in samples:
            theta = inverse_kinematics(on_branch, sample.poses)
            rod = float(np.abs(drake.rod_spans(sample.poses, theta) - robot.rod_lengths).max())
            gap = float(drake.loop_gaps(sample.poses).max())
            numbers[f"{sample.region.name} {branch:+d}"] = {"rod_error": rod, "gap": gap}
            rows.append((sample.region.name, f"{branch:+d}", len(sample.poses), f"{rod:.1e}", f"{gap:.1e}"))
    section.table(
        "Closed form against Drake's forward kinematics: largest errors over all legs and poses.",
        ("box", "branch", "poses", "tip to joint, minus rod length [m]", "gap of assembled loops [m]"),
        rows,
    )
    section.numbers["inverse"] = numbers
    found: dict[str, dict[str, Any]] = {}
    for branch in BRANCHES:
        solved = solver_differences(robot.replace(branch=branch), samples[0].poses[:solves])
        found |= {f"{given} {branch:+d}": row for given, row in solved.items()}
    section.numbers["drake_solver"] = found
    section.table(
        "Drake's own `InverseKinematics`, which holds the six ball constraints, against ours; started from the robot "
        "assembled on the same branch at a fifth of the way back to home.",
        ("given, branch", "asked for", "solved", "asked", "largest difference [rad or m]"),
        [
            (name, "crank angles" if name.startswith("pose") else "pose", row["found"], row["asked"],
             None if row["largest"] is None else f"{row['largest']:.1e}")
            for name, row in found.items()
        ],
    )  # fmt: skip


def _forward(section: Section, study: Study, robot: RobotParameters, samples: list[PoseSample]) -> None:
    section.text(
        "### Forward kinematics\n\n"
        "The conclusion speaks of direct kinematics, the text gives none. Ours is Newton's method on the "
        "six rod lengths. The same crank angles can belong to several poses, so three things may come out: the true "
        "pose, another assembly of the same robot, or nothing. *Beyond* counts the poses that a parallel singularity "
        "parts from home."
    )
    outcomes: dict[str, NewtonOutcome] = {}
    for sample in samples:
        for branch in BRANCHES:
            on_branch = robot.replace(branch=branch)
            starts = {"home": robot.home_pose, "nearby": sample.poses + 0.1 * (robot.home_pose - sample.poses)}
            for name, start in starts.items():
                outcomes[f"{sample.region.name} {branch:+d} {name}"] = newton_outcome(on_branch, sample.poses, start)
    numbers = {name: _newton_numbers(outcome) for name, outcome in outcomes.items()}
    section.table(
        "Newton's method from home, and from a tenth of the way back to home.",
        ("box, branch, start", "true pose", "another assembly", "of these beyond", "no convergence",
         "largest error [m]"),
        [
            (name, row["same"], row["other"], row["other_across"], row["failed"],
             None if row["error"] is None else f"{row['error']:.1e}")
            for name, row in numbers.items()
        ],
    )  # fmt: skip
    section.numbers["forward"] = numbers
    shown = {k.removesuffix(" home"): o for k, o in outcomes.items() if k.endswith(" home")}
    bars = {k: (int(o.same.sum()), int(o.other.sum()), int(o.failed.sum())) for k, o in shown.items()}
    own = [o for k, o in shown.items() if k.endswith(f" {robot.branch:+d}")]
    cloud = (np.concatenate([getattr(o, name) for o in own]) for name in ("conditioning", "error", "across"))
    other = sum(row["other"] for row in numbers.values())
    beyond = sum(row["other_across"] for row in numbers.values())
    section.figure(
        "Left: outcomes of Newton's method from home, by box and branch. Right: distance of the pose found to the true "
        f"one on this robot's branch ({robot.branch:+d}), against the conditioning at the true pose.",
        study.save_figure(plot_forward(bars, *cloud), "kinematics_forward"),
    )
    lost = sum(row["failed"] for row in numbers.values())
    section.text(
        f"Of the {other} answers that are another assembly, {beyond} were asked for beyond a parallel singularity; "
        f"{lost} searches found nothing. A controller that starts from the pose of the tick before meets neither, as "
        "long as it keeps clear of those singularities."
        if other or lost
        else "Every pose was found again."
    )


def _newton_numbers(outcome: NewtonOutcome) -> dict[str, Any]:
    same = outcome.same
    return {
        "same": int(same.sum()),
        "other": int(outcome.other.sum()),
        "other_across": int((outcome.other & outcome.across).sum()),
        "failed": int(outcome.failed.sum()),
        "error": float(outcome.error[same].max()) if same.any() else None,
    }


def _misprints(section: Section, study: Study, robot: RobotParameters, samples: list[PoseSample]) -> None:
    section.text(
        "### Misprints of (3) and (5)\n\n"
        "**D** Entry (3,1) of (3) must be cos φ cos ψ sin θ + sin φ sin ψ; the print has cos θ for cos φ, so its "
        "matrix is no rotation unless θ = 0, φ = ±θ or ψ = ±90°. **D** (5) multiplies R⁻¹ into the bracket p + G, so "
        "that the platform's position turns about the base with its attitude; (2) is right. The table follows a robot "
        "whose crank angles are computed with each misprint: where its platform really goes."
    )
    near = samples[0].poses
    effects = {
        "(3)": misprint_effect(robot, near, as_printed.platform_joints_3(robot, near)),
        "(5)": misprint_effect(robot, near, as_printed.platform_joints_5(robot, near)),
    }
    section.numbers["misprints"] = numbers = {name: _misprint_numbers(effect) for name, effect in effects.items()}
    section.table(
        f"What the misprints do over the near box ({len(near)} poses): median / 95 % / largest.",
        ("misprint", "joint misplaced [mm]", "out of reach", "crank angle off [deg]", "platform shifted [mm]",
         "platform turned [deg]"),
        [
            (name, _triple(row["joint_shift"], 1e3), f"{row['out_of_reach']:.1%}",
             _triple(row["crank_error"], 180.0 / np.pi), _triple(row["position_error"], 1e3),
             _triple(row["turn_error"], 180.0 / np.pi))
            for name, row in numbers.items()
        ],
    )  # fmt: skip
    angle = np.linspace(-np.pi / 6.0, np.pi / 6.0, study.pick(121, 41))
    poses = np.tile(robot.home_pose, (angle.size, angle.size, 1))
    poses[..., 0], poses[..., 1] = angle, angle[:, None]
    right = as_printed.platform_joints(robot, poses)
    shifts, reach = [], []
    for misplaced in (as_printed.platform_joints_3, as_printed.platform_joints_5):
        joints = misplaced(robot, poses)
        shifts.append(np.linalg.norm(joints - right, axis=-1).max(axis=-1))
        reach.append(as_printed.crank_equation(robot, joints).in_reach)
    section.figure(
        "Largest displacement of a platform joint by the two misprints, over roll and pitch at home's position and no "
        "yaw. Hatched: attitudes at which (5) asks for more than a rod can span.",
        study.save_figure(plot_misprints(angle, shifts[0], shifts[1], reach[1]), "kinematics_misprints"),
    )


def _misprint_numbers(effect: MisprintEffect) -> dict[str, Any]:
    names = ("joint_shift", "crank_error", "position_error", "turn_error")
    return {
        "out_of_reach": float(1.0 - effect.in_reach.mean()),
        **{name: _quantiles(getattr(effect, name)) for name in names},
    }


def _branches(section: Section, robot: RobotParameters, samples: list[PoseSample]) -> None:
    shares = {
        f"{s.region.name}, {name}": branch_of_6(robot, s.poses, sense)
        for s in samples
        for name, sense in (("our sense", 1), ("other sense", -1))
    }
    section.numbers["branch_of_6"] = shares
    conditioning = {
        f"{branch:+d}": _quantiles(line_conditioning(robot, leg_geometry(robot, samples[0].poses, branch)), (0.0, 0.5))
        for branch in BRANCHES
    }
    section.numbers["branch_conditioning"] = conditioning
    section.text(
        "### The branch of (6)\n\n"
        "(6) gives one angle, in degrees, through A, B, C that the paper does not define. **D** With ours it is the "
        "one branch or the other, depending on the sense in which a crank angle is counted, which the paper does not "
        "say either. A enters (6) through A² only. So it holds as long as A is not positive, that is, as long as the "
        "platform joint lies inboard of its motor; elsewhere its angle solves nothing. We use atan2 and offer both "
        "branches."
    )
    section.table(
        "Which solution (6) gives with our A, B, C: shares of the legs.",
        ("box, sense of the angle", "branch -1", "branch +1", "neither", "A > 0"),
        [(name, *(f"{row[k]:.1%}" for k in ("-1", "1", "neither", "a_positive"))) for name, row in shares.items()],
    )
    section.text(
        "The branches are not equally good: over the near box the conditioning of the rods' lines is at least "
        + " and ".join(f"{row[0]:.2f} (median {row[1]:.2f}) on branch {name}" for name, row in conditioning.items())
        + f". This robot stands on branch {robot.branch:+d}. Each crank transmits equally well on both."
    )


def _quantiles(values: np.ndarray, at: tuple[float, ...] = (0.5, 0.95, 1.0)) -> list[float]:
    usable = values[np.isfinite(values)]
    return [float(q) for q in np.quantile(usable, at)] if usable.size else []


def _triple(values: list[float], scale: float) -> str:
    return " / ".join(f"{scale * v:.3g}" if v > EXACT else "0" for v in values) if values else "-"
