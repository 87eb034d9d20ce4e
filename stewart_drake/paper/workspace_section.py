"""Section on the workspace: what the robot's poses allow, and the region of states and torques that motions visit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from stewart_drake.logs.motion_envelope import envelope_of_all
from stewart_drake.paper.pose_study import (
    KINDS,
    PoseStudy,
    motion_slice,
    part_of,
    slice_surveys,
    survey_poses,
)
from stewart_drake.paper.report import Section
from stewart_drake.paper.study import Study
from stewart_drake.paper.visited_region import (
    AMPLITUDE_SHARE,
    VisitedRegion,
    controlled_motions,
    region_verdict,
    visited_region,
)
from stewart_drake.planning.limits import RULES, limit_bounds
from stewart_drake.planning.workspace_boundary import Boundary
from stewart_drake.planning.workspace_region import LIMIT_NAMES, SINGULARITIES, Kind, Loss, Survey, losses

CAPABILITIES = (
    ("transmission", "transmission [-]", 1.0),
    ("conditioning", "conditioning [-]", 1.0),
    ("clearance", "clearance of links [mm]", 1e3),
    ("holding_torque", "holding torque [N m]", 1.0),
    ("force", "force in any direction [N]", 1.0),
    ("moment", "moment in any direction [N m]", 1.0),
)
_NAMES = ("roll", "pitch", "yaw", "X", "Y", "Z")
_SCALES = np.array([180.0 / np.pi] * 3 + [1e3] * 3)
_UNITS = ("deg",) * 3 + ("mm",) * 3


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
    section = Section(
        "workspace",
        "Workspace of the states and the torques",
        "Abstract: the method defines the workspace of both the states and the torques, a start for the design of such "
        "robots; section IV: the torques of Fig. 7(b) serve to choose the motors. The paper shows no region, but the "
        "histories of one motion.",
    )
    poses = survey_poses(study, samples, center)
    motions = controlled_motions(study)
    logs = study.store.run_all(list(motions.values()), part_of(study, 0.6, 0.3))
    regions = [visited_region(name, log) for name, log in zip(motions, logs, strict=True) if len(log.time)]
    section.verdict = region_verdict(regions, len(motions))
    _write_poses(section, study, poses)
    if regions:
        _write_motions(section, study, poses, regions)
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


def _write_poses(section: Section, study: Study, poses: PoseStudy) -> None:
    from stewart_drake.plotting.workspace_plots import plot_boundaries, plot_capability, plot_losses, plot_slices

    count = sum(len(found.grid.poses) for found in poses.surveys.values())
    section.text(
        "### What the poses allow\n\n"
        "Positions at the orientation of the centre, orientations at its position; the centre is "
        f"{_pose_text(poses.center)}. {count:,} poses were measured at {poses.rate:,.0f} poses a second. What the "
        "mechanism alone can reach is all that can be joined to the centre without passing a singularity; the limits "
        f"take their parts of that. They are our assumptions, because the paper gives none: {_limits_words(study)}.\n\n"
        "Two kinds of singularity must be told apart. At a **serial** one a crank stands at its dead centre, "
        "e_l . e_N = 0: its motor turns without moving the platform, and no force along that rod reaches the motor. "
        "The edge of reach is made of these. At a **parallel** one the six rods' lines lose rank, sigma_min of tau_1 "
        "(14) = 0: the platform moves although all motors are locked, and to hold it takes torques without bound."
    )
    section.table(
        "Size of the workspaces: positions in litres (dm^3), orientations in % of all orientations of a body. The box "
        "is that around the poses joined to the centre within all limits.",
        ("workspace", "rods can span", "no singularity passed", "within all limits", "and joined to the centre", "box"),
        [_size_row(*row) for row in _all_surveys(poses)],
    )
    section.table(
        "How far each coordinate goes alone from the centre, and what stops it.",
        ("coordinate", "down to", "stopped by", "up to", "stopped by"),
        [
            (f"{_NAMES[i]} [{_UNITS[i]}]", *(cell for end in (0, 1) for cell in _end_cells(poses, end, i)))
            for i in range(6)
        ],
    )
    nearest = {kind: float(poses.boundaries[kind].radius.min()) for kind in KINDS}
    section.text(
        f"In every direction the platform can be displaced by {1e3 * nearest['position']:.0f} mm without turning, or "
        f"turned by {np.degrees(nearest['orientation']):.0f} deg (in the space of Euler angles) without displacement. "
        + " ".join(_first_words(kind, poses.boundaries[kind]) for kind in KINDS)
    )
    section.figure(
        "The two workspaces as surfaces: where straight ways from the centre first break a limit, in its colour.",
        study.save_figure(
            plot_boundaries([poses.boundaries[kind] for kind in KINDS], study.base.robot), "workspace-boundary"
        ),
    )
    for kind, what in zip(KINDS, ("positions", "orientations"), strict=True):
        slices = slice_surveys(study, poses, kind)
        section.figure(
            f"Slices through the {what}. Inside the black edge the shade gives the largest part of a limit taken up; "
            "outside it the colour names the limit that is broken most.",
            study.save_figure(plot_slices(slices), f"workspace-{kind}-slices"),
        )
        through = slices[-1] if kind == "position" else slices[2]
        section.figure(
            f"What the robot can do over one slice of the {what}.",
            study.save_figure(plot_capability(through), f"workspace-{kind}-capability"),
        )
    lost = {kind: losses(found) for kind, found in poses.surveys.items()}
    section.figure(
        "What each limit takes of the poses that the mechanism alone could reach.",
        study.save_figure(
            plot_losses([(f"{kind}s".capitalize(), lost[kind], poses.boundaries[kind].first()) for kind in KINDS]),
            "workspace-losses",
        ),
    )
    section.text(
        "Strength. To exert the wrench w on something, the motors need T = t + A w: t is the torque that holds the "
        "weight, A the inverse of the map tau of (18), `statics`. A force of size r without moment moves the torque of "
        "motor i by at most r |a_i|, where a_i are the three entries of row i of A that multiply the force, and in one "
        "direction it does move it by that much. So the largest force that can be exerted in every direction is the "
        "smallest of (T_max - |t_i|) / |a_i| over the motors, exactly; so is the moment, with the other three entries."
    )
    section.table(
        "What the robot can do at the centre, and over all poses joined to it within the limits.",
        ("quantity", "centre", *(f"{kind}s: {what}" for kind in KINDS for what in ("smallest", "median", "largest"))),
        [(label, *_capability_cells(poses, name, scale)) for name, label, scale in CAPABILITIES],
    )
    section.numbers |= {
        "poses": count,
        "poses_per_second": poses.rate,
        "center": poses.center.tolist(),
        "ranges": poses.ranges.tolist(),
        "range_cuts": [[_limit_name(i) for i in row] for row in poses.cuts.tolist()],
        "workspaces": {kind: _numbers(poses, kind, lost[kind]) for kind in KINDS},
        "other_centers": {
            f"{kind}, {name}": None if found is None else found.size(found.connected)
            for name, kind, found in poses.others
        },
    }


def _write_motions(section: Section, study: Study, poses: PoseStudy, regions: Sequence[VisitedRegion]) -> None:
    from stewart_drake.plotting.envelope_plots import plot_motion_map, plot_state_region, plot_torque_region

    base = study.base
    section.text(
        "### What controlled motions visit\n\n"
        "The paper speaks of the workspace of states and torques that its method defines. Read literally, these are "
        "the states and torques that motions under its controller pass through. The runs use the base scenario with "
        f"its reference changed; the amplitudes of our own motions are {AMPLITUDE_SHARE:g} of the largest that the "
        "limits allow, to leave room for the error of tracking."
    )
    section.table(
        "Region that each run visited: largest distance of any angle and any coordinate from the motion's centre; "
        "torques within the motors' limits, beside those that the reference needs by the exact inverse dynamics. The "
        "last columns look at poses as if at rest: the largest part of a limit taken up.",
        ("run", "ended", "angles [deg]", "ways [mm]", "crank speed [rad/s]", "peak torque [N m]", "reference's [N m]",
         "part of motor limit", "peak power [W]", "limit on poses: run", "its reference"),
        [_region_row(region) for region in regions],
    )  # fmt: skip
    section.text(_motor_words(poses, regions))
    whole = envelope_of_all([region.log for region in regions])
    first, own = regions[0].envelope, regions[0].name
    section.table(
        f"Envelope of states, from .. to: {own}, all runs, and the range that the limits leave each coordinate alone.",
        ("coordinate", own, "all runs", "allowed at rest", f"rate, {own}", "rate, all runs"),
        [
            (
                f"{_NAMES[i]} [{_UNITS[i]}]",
                *(_span(_SCALES[i] * box[:, i]) for box in (first.pose, whole.pose, poses.ranges)),
                *(_span(_SCALES[i] * box[:, i]) + f" {_UNITS[i]}/s" for box in (first.pose_rate, whole.pose_rate)),
            )
            for i in range(6)
        ],
    )
    section.table(
        f"Envelope of the motors: {own} (first three columns) and all runs; the limit of the torque is "
        f"+-{base.robot.effort_limit:g} N m.",
        ("motor", "angle [deg]", "speed [rad/s]", "torque [N m]", "speed, all runs [rad/s]", "torque, all runs [N m]"),
        [
            (i, _span(np.degrees(first.crank_angle[:, i])), _span(first.crank_rate[:, i], 2),
             _span(first.torque[:, i], 3), _span(whole.crank_rate[:, i], 2), _span(whole.torque[:, i], 3))
            for i in range(6)
        ],
    )  # fmt: skip
    logs, names = [region.log for region in regions], [region.name for region in regions]
    section.figure(
        f"{_sentence(own)} among the limits: its path, and what it takes up of each limit.",
        study.save_figure(
            plot_motion_map(motion_slice(study, poses, logs[0]["reference"]), logs[0], regions[0].use),
            "workspace-motion",
        ),
    )
    section.figure(
        "States that the runs visit; dashed: how far the limits let the coordinate go alone, where near.",
        study.save_figure(plot_state_region(logs, names, poses.ranges), "workspace-states"),
    )
    section.figure(
        "Speed and torque that the runs visit, motor by motor; dashed: the limits, where near.",
        study.save_figure(
            plot_torque_region(logs, names, base.limits.crank_speed, base.robot.effort_limit), "workspace-torques"
        ),
    )
    section.numbers["motions"] = {
        region.name: {
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
        for region in regions
    }


def _all_surveys(poses: PoseStudy) -> list[tuple[str, Kind, Survey | None]]:
    named = {"position": "positions", "orientation": "orientations"}
    around = [(f"{named[kind]} around the centre", kind, poses.surveys[kind]) for kind in KINDS]
    return [*around, *((f"{named[kind]}, centre with {name}", kind, found) for name, kind, found in poses.others)]


def _size_row(name: str, kind: Kind, found: Survey | None) -> tuple[str, ...]:
    if found is None:
        return (name, *("-",) * 5)
    scale, unit = (1e3, "L") if kind == "position" else (100.0, "%")
    masks = (found.spanning, found.regular, found.feasible, found.connected)
    box = found.bounding_box(found.connected)
    ends = "-"
    if box is not None:
        columns = list(found.grid.coordinates)
        ends = (
            ", ".join(f"{_NAMES[i]} {_span(_SCALES[i] * box[:, k])}" for k, i in enumerate(columns))
            + f" {_UNITS[columns[0]]}"
        )
    return (name, *(f"{scale * found.size(mask):.3g} {unit}" for mask in masks), ends)


def _end_cells(poses: PoseStudy, end: int, coordinate: int) -> tuple[str, str]:
    return f"{_SCALES[coordinate] * poses.ranges[end, coordinate]:.1f}", _limit_words(poses.cuts[end, coordinate])


def _limits_words(study: Study) -> str:
    """Each limit on a pose with its value; those on speeds do not act at rest."""
    bounds = limit_bounds(study.base.robot, study.base.limits)
    words = []
    for name, bound in bounds.items():
        if name == "crank_speed":
            continue
        if RULES[name][0] == "rad":
            words.append(RULES[name][1].replace("{:.4g} rad", "{:.4g} deg").format(np.degrees(bound)))
        else:
            words.append(RULES[name][1].format(bound))
    return "; ".join(words)


def _limit_name(index: int) -> str | None:
    return LIMIT_NAMES[index] if index >= 0 else None


def _limit_words(index: int) -> str:
    name = _limit_name(int(index))
    if name is None:
        return "nothing"
    kind = SINGULARITIES.get(name)
    return name.replace("_", " ") + (f" ({kind} singularity)" if kind else "")


def _first_words(kind: Kind, surface: Boundary) -> str:
    """Which limits are met first, in a sentence."""
    first = surface.first()
    if not first:
        return f"No limit is met by any straight way through the {kind}s."
    parts = [f"{_limit_words(LIMIT_NAMES.index(name))} in {100.0 * share:.1f} %" for name, share in first.items()]
    near = {SINGULARITIES[name] for name in first if name in SINGULARITIES}
    told = f"a {' and a '.join(sorted(near))} singularity ends some" if near else "none ends near a singularity"
    return f"Going straight through the {kind}s the first limit met is {', '.join(parts)} of all directions; {told}."


def _capability_cells(poses: PoseStudy, name: str, scale: float) -> list[str]:
    cells: list[str] = []
    for kind in KINDS:
        found = poses.surveys[kind]
        if not cells:
            start = np.linalg.norm(found.grid.poses - poses.center, axis=1).argmin()
            cells.append(f"{scale * getattr(found.measures, name)[start]:.3g}")
        values = getattr(found.measures, name)[found.connected]
        cells += [f"{scale * f(values):.3g}" for f in (np.min, np.median, np.max)] if len(values) else ["-"] * 3
    return cells


def _numbers(poses: PoseStudy, kind: Kind, lost: Sequence[Loss]) -> dict[str, Any]:
    found, surface = poses.surveys[kind], poses.boundaries[kind]
    box = found.bounding_box(found.connected)
    strength = {
        name: None if not found.connected.any() else float(getattr(found.measures, name)[found.connected].min())
        for name in ("force", "moment", "conditioning", "transmission")
    }
    return {
        "cells": list(found.grid.counts),
        "spanning": found.size(found.spanning),
        "regular": found.size(found.regular),
        "feasible": found.size(found.feasible),
        "connected": found.size(found.connected),
        "box": None if box is None else box.tolist(),
        "inscribed_radius": float(surface.radius.min()),
        "boundary_volume": surface.volume,
        "first": surface.first(),
        "lost": {loss.limit: {"broken": loss.broken, "alone": loss.alone} for loss in lost},
        "smallest": strength,
    }


def _region_row(region: VisitedRegion) -> tuple[str, ...]:
    log = region.log
    middle = np.array(getattr(log.scenario.reference, "center", log.scenario.robot.home_pose))
    far = _SCALES * np.abs(region.envelope.pose - middle).max(axis=0)
    uses = (region.worst, region.reference_worst)
    ended = f"{log.end_time:g} s" if log.reached_end else f"{log.reason} at {log.end_time:.3f} s"
    return (
        region.name, ended, f"{far[:3].max():.1f}", f"{far[3:].max():.1f}", f"{region.speed:.2f}",
        f"{region.peak_torque:.3f}", f"{region.reference_torque:.3f}", f"{100.0 * region.torque_use:.1f} %",
        f"{region.power:.2f}", *(f"{100.0 * use:.0f} % of {limit.replace('_', ' ')}" for use, limit in uses),
    )  # fmt: skip


def _sentence(words: str) -> str:
    return words[0].upper() + words[1:]


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _motor_words(poses: PoseStudy, regions: Sequence[VisitedRegion]) -> str:
    """What would come of a motor chosen by the torques of the first motion, the paper's."""
    peak = regions[0].peak_torque
    parts = []
    for kind in KINDS:
        found = poses.surveys[kind]
        total = found.size(found.connected)
        share = found.size(found.connected & (found.measures.holding_torque > peak)) / total if total > 0.0 else 0.0
        parts.append(f"{100.0 * share:.0f} % of the {kind}s within the limits")
    added, most = max((region.peak_torque - region.reference_torque, region.name) for region in regions)
    stronger = sum(region.peak_torque > peak for region in regions[1:])
    return (
        f"Choosing the motors. The largest torque of {regions[0].name} is {peak:.2f} N m. A motor of just that torque "
        f"could not hold the platform still at {' and '.join(parts)}, and {stronger} of the other {len(regions) - 1} "
        f"runs ask for more. What the control adds to what the motion itself needs is largest in {most}: its "
        f"largest torque is {added:.2f} N m above that of its reference by inverse dynamics."
    )


def _span(ends: np.ndarray, digits: int = 1) -> str:
    low, high = (f"{round(float(x), digits) + 0.0:.{digits}f}" for x in ends)
    return f"{low} .. {high}"


def _pose_text(pose: np.ndarray) -> str:
    return ", ".join(f"{n} {s * x:.4g} {u}" for n, s, x, u in zip(_NAMES, _SCALES, pose, _UNITS, strict=True))
