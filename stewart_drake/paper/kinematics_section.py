"""(1) to (6): inverse and forward kinematics against Drake's plant, and what the misprints of (3), (5), (6) do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from stewart_drake.mechanics.kinematics import inverse_kinematics, leg_geometry, line_conditioning
from stewart_drake.paper import as_printed
from stewart_drake.paper.kinematics_checks import BRANCHES, branch_of_6, misprint_effect, newton_outcome, rod_spans
from stewart_drake.paper.plots.kinematics_plots import plot_misprints
from stewart_drake.paper.region import ANNOUNCED, WIDE
from stewart_drake.paper.report import Section
from stewart_drake.paper.study import SEED, Study, quantiles
from stewart_drake.planning.pose_box import NEAR, PoseSample, sample_poses
from stewart_drake.robot import RobotParameters

EXACT = 1e-11
"""[m, rad] rounding of lengths of a metre and of angles, with room."""


def make(study: Study) -> Section:
    """The section on (1) to (6)."""
    robot, rng = study.base.robot, np.random.default_rng(SEED)
    samples = [sample_poses(robot, region, study.pick(600, 100), rng) for region in (NEAR, ANNOUNCED, WIDE)]
    near = samples[0].poses
    numbers: dict[str, Any] = {"regions": {s.region.name: {"share": s.share, "poses": len(s.poses)} for s in samples}}
    numbers["inverse"] = _inverse(robot, samples)
    study.progress(0.3)
    numbers["forward"] = _forward(robot, samples)
    study.progress(0.8)
    misprints = {"(3)": as_printed.platform_joints_3, "(5)": as_printed.platform_joints_5}
    numbers["misprints"] = {
        name: _misprint_numbers(robot, near, joints(robot, near)) for name, joints in misprints.items()
    }
    numbers["branch_of_6"] = {
        f"{s.region.name}, {name}": branch_of_6(robot, s.poses, sense)
        for s in samples
        for name, sense in (("our sense", 1), ("other sense", -1))
    }
    numbers["branch_conditioning"] = {
        f"{branch:+d}": quantiles(line_conditioning(robot, leg_geometry(robot, near, branch)), (0.0, 0.5))
        for branch in BRANCHES
    }
    figures = {"kinematics_misprints": _misprint_figure(robot, study.pick(121, 41))}
    regions = [sample.region for sample in samples]
    return study.section("kinematics", numbers, figures, **findings(numbers), regions=regions)


def findings(numbers: Mapping[str, Any]) -> dict[str, Any]:
    """What the verdict rests on: share of the near poses that Newton's method finds, shares of legs that (6) loses."""
    near = [row for name, row in numbers["forward"].items() if name.startswith("near ")]
    lost = {
        box: max(row["neither"] for name, row in numbers["branch_of_6"].items() if name.startswith(f"{box},"))
        for box in ("near", "announced")
    }
    asked = sum(row[k] for row in near for k in ("same", "other", "failed"))
    return {"found": sum(row["same"] for row in near) / asked, "lost": lost, "exact": EXACT}


def _inverse(robot: RobotParameters, samples: Sequence[PoseSample]) -> dict[str, dict[str, float]]:
    """Largest errors of the closed form by Drake's forward kinematics, by box and branch."""
    found = {}
    for branch in BRANCHES:
        on_branch = robot.replace(branch=branch)
        for sample in samples:
            spans = rod_spans(on_branch, sample.poses, inverse_kinematics(on_branch, sample.poses))
            error = float(np.abs(spans - robot.rod_lengths).max())
            found[f"{sample.region.name} {branch:+d}"] = {"rod_error": error}
    return found


def _forward(robot: RobotParameters, samples: Sequence[PoseSample]) -> dict[str, dict[str, Any]]:
    """Newton's method from home and from nearby, by box, branch and start."""
    outcomes = {}
    for sample in samples:
        for branch in BRANCHES:
            starts = {"home": robot.home_pose, "nearby": sample.poses + 0.1 * (robot.home_pose - sample.poses)}
            for name, start in starts.items():
                outcome = newton_outcome(robot.replace(branch=branch), sample.poses, start)
                outcomes[f"{sample.region.name} {branch:+d} {name}"] = outcome
    return outcomes


def _misprint_numbers(robot: RobotParameters, poses: np.ndarray, joints: np.ndarray) -> dict[str, Any]:
    """Quantiles of what a misprint does, and at which share of the poses it asks for the impossible."""
    effect = misprint_effect(robot, poses, joints)
    lost = float(np.isnan(effect["crank_error"]).mean())
    return {"out_of_reach": lost, **{name: quantiles(values, (0.5, 0.95, 1.0)) for name, values in effect.items()}}


def _misprint_figure(robot: RobotParameters, count: int) -> Figure:
    """Over roll and pitch at home's position, without yaw."""
    angle = np.linspace(-np.pi / 6.0, np.pi / 6.0, count)
    poses = np.tile(robot.home_pose, (count, count, 1))
    poses[..., 0], poses[..., 1] = angle, angle[:, None]
    right = as_printed.platform_joints(robot, poses)
    by_3, by_5 = as_printed.platform_joints_3(robot, poses), as_printed.platform_joints_5(robot, poses)
    shift_3, shift_5 = (np.linalg.norm(joints - right, axis=-1).max(axis=-1) for joints in (by_3, by_5))
    return plot_misprints(angle, shift_3, shift_5, as_printed.crank_equation(robot, by_5).in_reach)
