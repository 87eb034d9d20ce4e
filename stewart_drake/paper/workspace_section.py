"""Section on the workspace: what the robot's poses allow, and the region of states and torques that motions visit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from stewart_drake.logs.motion_envelope import envelope_of_all
from stewart_drake.paper.pose_study import KINDS, PoseStudy, motion_slice, slice_surveys, survey_poses
from stewart_drake.paper.report import Section
from stewart_drake.paper.study import Study
from stewart_drake.paper.visited_region import VisitedRegion, controlled_motions, findings, visited_region
from stewart_drake.planning.limits import RULES, limit_bounds
from stewart_drake.planning.workspace import LIMIT_NAMES, SINGULARITIES, Kind, Survey
from stewart_drake.plotting.envelope_plots import plot_motion_map, plot_state_region, plot_torque_region
from stewart_drake.plotting.panels import COORDINATES, SCALES
from stewart_drake.plotting.workspace_plots import (
    CAPABILITIES,
    WORDS,
    plot_capability,
    plot_slices,
)

MASKS = ("spanning", "regular", "feasible", "connected")
"""Which poses a workspace counts: ever fewer."""


def make(study: Study) -> Section:
    """The section, for the robot of `study.base` around its home pose."""
    return make_section(study, study.pick(1_000_000, 40_000), study.base.robot.home_pose)


def make_section(study: Study, samples: int, center: np.ndarray) -> Section:
    """The section around any pose.

    Args:
        study: Where to, and for which robot and limits.
        samples: Poses in each of the two workspaces.
        center: (6,) [rad, m] gives the fixed orientation and the fixed position.

    Raises:
        ConfigurationError: A center that `check_center` refuses; too few samples; a motion that is refused.
    """
    poses = survey_poses(study, samples, center)
    logs = study.run(controlled_motions(study), 0.6, 0.3)
    regions = [visited_region(name, log) for name, log in logs.items() if len(log.time)]
    numbers: dict[str, Any] = {
        "poses": sum(len(found.grid.poses) for found in poses.surveys.values()),
        "poses_per_second": poses.rate,
        "center": poses.center.tolist(),
        "ranges": poses.ranges.tolist(),
        "range_cuts": [[LIMIT_NAMES[i] if i >= 0 else None for i in row] for row in poses.cuts.tolist()],
        "workspaces": {kind: _numbers(poses, kind) for kind in KINDS},
        "other_centers": {
            f"{kind}, {name}": None if found is None else found.size(found.connected)
            for name, kind, found in poses.others
        },
    }
    figures = _pose_figures(study, poses)
    values: dict[str, Any] = {}
    if regions:
        first = regions[0]
        numbers["motions"] = {region.name: _motion_numbers(region) for region in regions}
        figures |= _motion_figures(study, poses, regions)
        values = {
            "first": first.envelope,
            "whole": envelope_of_all([region.log for region in regions]),
            "added": max((region.peak_torque - region.reference_torque, region.name) for region in regions),
            "too_weak": [_too_weak(poses.surveys[kind], first.peak_torque) for kind in KINDS],
        }
    around = [("the centre", kind, poses.surveys[kind]) for kind in KINDS]
    section = study.section(
        "workspace",
        numbers,
        figures,
        **findings(regions, len(logs)),
        **values,
        coordinates=list(zip(COORDINATES, SCALES, strict=True)),
        ranges=poses.ranges,
        limits=_limits_words(study),
        limit={None: "nothing", **WORDS},
        singularities=SINGULARITIES,
        surveys=[(f"{kind}s, {name}", kind, found) for name, kind, found in (*around, *poses.others)],
        sizes=sizes,
        span=_span,
        capabilities={label: _capability_cells(poses, name, scale) for name, (label, scale, _) in CAPABILITIES.items()},
    )
    study.progress(1.0)
    return section


def summary(numbers: dict[str, Any]) -> list[tuple[str, str]]:
    """The section's main figures, for the terminal."""
    rows = []
    for kind, scale, unit in (("position", 1e3, "L"), ("orientation", 100.0, "% of all")):
        found = numbers["workspaces"][kind]
        rows += [
            (f"{kind}s that the mechanism can reach", f"{scale * found['regular']:.3g} {unit}"),
            (f"{kind}s within all limits", f"{scale * found['connected']:.3g} {unit}"),
            (f"first limit on straight ways through {kind}s", next(iter(found["first"]), "none").replace("_", " ")),
        ]
    radius = [numbers["workspaces"][kind]["inscribed_radius"] for kind in KINDS]
    rows.append(("free in every direction", f"{1e3 * radius[0]:.0f} mm, {np.degrees(radius[1]):.0f} deg"))
    for name, motion in numbers.get("motions", {}).items():
        rows.append((f"torque of {name}", f"{motion['peak_torque']:.3f} N m, {motion['status']}"))
    return [*rows, ("poses measured a second", f"{numbers['poses_per_second']:,.0f}")]


def _pose_figures(study: Study, poses: PoseStudy) -> dict[str, Figure]:
    figures: dict[str, Figure] = {}
    for kind in KINDS:
        slices = slice_surveys(study, poses, kind)
        figures[f"workspace-{kind}-slices"] = plot_slices(slices)
        figures[f"workspace-{kind}-capability"] = plot_capability(slices[-1] if kind == "position" else slices[2])
    return figures


def _motion_figures(study: Study, poses: PoseStudy, regions: Sequence[VisitedRegion]) -> dict[str, Figure]:
    base, first = study.base, regions[0]
    logs, names = [region.log for region in regions], [region.name for region in regions]
    across = motion_slice(study, poses, first.log["reference"])
    return {
        "workspace-motion": plot_motion_map(across, first.log, first.use),
        "workspace-states": plot_state_region(logs, names, poses.ranges),
        "workspace-torques": plot_torque_region(logs, names, base.limits.crank_speed, base.robot.effort_limit),
    }


def sizes(kind: Kind, found: Survey | None) -> list[str]:
    """Sizes of a workspace and the box around it, as cells of a table; dashes where its centre is out of reach."""
    if found is None:
        return ["-"] * (len(MASKS) + 1)
    scale, unit = (1e3, "L") if kind == "position" else (100.0, "%")
    box, ends = found.bounding_box(found.connected), "-"
    if box is not None:
        axes = found.grid.coordinates
        sides = zip(axes, box.T, strict=True)
        ends = ", ".join(f"{COORDINATES[i][0]} {_span(side, SCALES[i])}" for i, side in sides)
        ends += f" {COORDINATES[axes[0]][1]}"
    return [*(f"{scale * found.size(getattr(found, mask)):.3g} {unit}" for mask in MASKS), ends]


def _limits_words(study: Study) -> list[str]:
    """Each limit on a pose with its value; those on speeds do not act at rest."""
    bounds = limit_bounds(study.base.robot, study.base.limits)
    words = []
    for name, bound in bounds.items():
        unit, rule = RULES[name]
        if unit == "rad":
            rule, bound = rule.replace(" rad", " deg"), float(np.degrees(bound))
        if name != "crank_speed":
            words.append(rule.format(bound))
    return words


def _capability_cells(poses: PoseStudy, name: str, scale: float) -> list[str]:
    """A quantity at the centre, then smallest, median and largest over both workspaces."""
    surveys = list(poses.surveys.values())
    start = np.linalg.norm(surveys[0].grid.poses - poses.center, axis=1).argmin()
    cells = [f"{scale * getattr(surveys[0].measures, name)[start]:.3g}"]
    for found in surveys:
        values = getattr(found.measures, name)[found.connected]
        cells += [f"{scale * f(values):.3g}" for f in (np.min, np.median, np.max)] if len(values) else ["-"] * 3
    return cells


def _too_weak(found: Survey, torque: float) -> float:
    """[-] part of a workspace where motors of a torque [N m] cannot hold the platform."""
    total = found.size(found.connected)
    return found.size(found.connected & (found.measures.holding_torque > torque)) / total if total > 0.0 else 0.0


def _numbers(poses: PoseStudy, kind: Kind) -> dict[str, Any]:
    found, surface = poses.surveys[kind], poses.boundaries[kind]
    box = found.bounding_box(found.connected)
    strength = {
        name: None if not found.connected.any() else float(getattr(found.measures, name)[found.connected].min())
        for name in ("force", "moment", "conditioning", "transmission")
    }
    return {
        "cells": list(found.grid.counts),
        **{mask: found.size(getattr(found, mask)) for mask in MASKS},
        "box": None if box is None else box.tolist(),
        "inscribed_radius": float(surface.radius.min()),
        "boundary_volume": surface.volume,
        "first": surface.first(),
        "smallest": strength,
    }


def _motion_numbers(region: VisitedRegion) -> dict[str, Any]:
    return {
        "status": region.log.status,
        "end_time": region.log.end_time,
        "pose": region.envelope.pose.tolist(),
        "pose_rate": region.envelope.pose_rate.tolist(),
        "crank_speed": region.speed,
        "peak_torque": region.peak_torque,
        "reference_torque": region.reference_torque,
        "peak_power": region.power,
        "limit_use": _finite(region.worst[0]),
        "limit": region.worst[1],
        "reference_limit_use": _finite(region.reference_worst[0]),
    }


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _span(ends: np.ndarray, scale: float = 1.0, digits: int = 1) -> str:
    low, high = (f"{round(scale * float(x), digits) + 0.0:.{digits}f}" for x in ends)
    return f"{low} .. {high}"
