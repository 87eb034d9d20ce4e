"""(19) to (34): matrices in the paper's order, Hautus ranks, discretisation, decay, and what the weights can do."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Any

import numpy as np

from stewart_drake.control.state_space import (
    AXES,
    INTEGRAL,
    STATES,
    acceleration_map,
    hautus_detectability,
    input_matrix,
    mass_diagonal,
    output_matrix,
    state_matrix,
)
from stewart_drake.mechanics.force_map import ForceMapKind, force_map
from stewart_drake.paper.as_printed import matrices_21_22_24
from stewart_drake.paper.experiments import RATIOS
from stewart_drake.paper.lqi_poles import closed_loop, gain_of_ratio
from stewart_drake.paper.region import ANNOUNCED, WIDE
from stewart_drake.paper.report import Section
from stewart_drake.paper.singularities import (
    Singularity,
    first_singularity,
    measures,
    nonzero_columns,
    stabilisability_rank,
)
from stewart_drake.paper.state_space_lqi import PERIODS, ZERO_GAIN, decay, discretisations, riccati
from stewart_drake.paper.study import SEED, Study
from stewart_drake.planning.pose_box import NEAR, sample_poses
from stewart_drake.plotting.panels import COORDINATES, SCALES
from stewart_drake.references import paper_reference
from stewart_drake.robot import RobotParameters

KINDS: tuple[ForceMapKind, ...] = ("printed", "statics")


def make(study: Study) -> Section:
    """The section on (19) to (34)."""
    robot, period = study.base.robot, study.base.lqi.period
    at_home, tau = acceleration_map(robot, robot.home_pose), force_map(robot, robot.home_pose)
    a, b, c = state_matrix(), input_matrix(at_home), output_matrix()
    numbers: dict[str, Any] = {"matrices_as_printed": _as_printed(at_home, a, b, c)}
    radii = {
        name: [float(np.abs(closed_loop(at_home, gain_of_ratio(g, period, r), period)).max()) for r in RATIOS]
        for name, g in (("radius", tau), ("right", at_home))
    }
    rows = [dict(zip(("ratio", *radii), row, strict=True)) for row in zip(RATIOS, *radii.values(), strict=True)]
    numbers["tau_for_m_inverse_tau"] = {"period": period, "rows": rows}
    study.progress(0.1)
    singular = _singular(robot)
    numbers["hautus"] = {
        "detectability": hautus_detectability(a, c),
        "regions": _ranks(study),
        "singular": [_singular_numbers(robot, found) for found in singular],
    }
    study.progress(0.5)
    numbers["riccati"], terms = riccati(at_home, period)
    numbers["discretisation"] = discretisations(at_home)
    study.progress(0.7)
    numbers["decay"], poses = decay(study, at_home)
    ours = [row for row in numbers["discretisation"] if row["period"] == PERIODS[2]]
    bare = c.copy()
    bare[:, INTEGRAL] = 0.0
    return study.section(
        "state_space",
        numbers,
        **findings(numbers),
        axes=[name for name, _ in COORDINATES],
        tau=tau + 0.0,
        at_home=at_home + 0.0,
        pushed=np.abs(paper_reference().evaluate(np.linspace(0.0, np.pi, 201))[2]).max(axis=0),
        lightness=1.0 / mass_diagonal(robot).min(),
        without_integrals=hautus_detectability(a, bare),
        terms=terms,
        decay_off=max(abs(row["euler"] / row["exact"] - 1.0) for row in ours),
        decay_poses=poses,
    )


def findings(numbers: Mapping[str, Any]) -> dict[str, Any]:
    """What the verdict rests on."""
    hautus = numbers["hautus"]
    ranks = [rank for row in hautus["singular"] for rank in row["rank"].values() if rank is not None]
    return {
        "regular": all(row["full"] == row["poses"] for row in hautus["regions"].values()),
        "lowest": min(ranks, default=STATES),
        "unstable": [row["ratio"] for row in numbers["tau_for_m_inverse_tau"]["rows"] if row["radius"] > 1.0],
        "zero_gain": ZERO_GAIN,
    }


def _as_printed(at_home: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> dict[str, bool]:
    """Whether A, B, C are those of (21), (22), (24), written out index by index."""
    a_bar, b_bar, c_bar = matrices_21_22_24(at_home)
    printed = np.block([[a_bar, np.zeros((12, AXES))], [c_bar, np.zeros((AXES, AXES))]])
    return {
        "A": bool(np.array_equal(a, printed)),
        "B": bool(np.array_equal(b, np.vstack([b_bar, np.zeros((AXES, AXES))]))),
        "C": bool(np.array_equal(c, np.hstack([c_bar, np.eye(AXES)]))),
    }


def _ranks(study: Study) -> dict[str, dict[str, Any]]:
    """How many random poses have full rank (28), by box and force map."""
    robot, rng = study.base.robot, np.random.default_rng(SEED)
    found = {}
    for region, kind in itertools.product((NEAR, ANNOUNCED, WIDE), KINDS):
        poses = sample_poses(robot, region, study.pick(400, 60), rng).poses
        ranks = [stabilisability_rank(robot, pose, kind) for pose in poses]
        smallest = np.linalg.svd(acceleration_map(robot, poses, kind), compute_uv=False)[:, -1].min()
        found[f"{region.name}, {kind}"] = {
            "poses": len(poses), "full": ranks.count(STATES), "smallest": float(smallest),
        }  # fmt: skip
    return found


def _singular(robot: RobotParameters) -> list[Singularity]:
    """First singular pose along each axis, both ways."""
    ways = ((sign * np.eye(6)[axis], np.pi if axis < 3 else 0.6) for axis in range(6) for sign in (1.0, -1.0))
    return [found for way, most in ways if (found := first_singularity(robot, way, most)) is not None]


def _singular_numbers(robot: RobotParameters, found: Singularity) -> dict[str, Any]:
    axis = int(np.abs(found.direction).argmax())
    at = float((found.pose(robot) - robot.home_pose)[axis])
    pose, (name, unit) = found.pose(robot), COORDINATES[axis]
    told = measures(robot, pose)
    return {
        "axis": ("+" if at > 0.0 else "-") + name,
        "at": f"{SCALES[axis] * at:.1f}\u00a0{unit}",
        "kind": found.kind,
        "transmission": told["transmission"],
        "conditioning": told["conditioning"],
        "rank": {kind: stabilisability_rank(robot, pose, kind) for kind in KINDS},
        "columns": nonzero_columns(robot, pose, "printed"),
    }
