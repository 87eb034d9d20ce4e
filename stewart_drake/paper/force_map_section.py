"""(7) to (18): the force map as printed and by statics, against torques that really hold and accelerate."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY, task_inertia
from stewart_drake.mechanics.kinematics import leg_geometry, reach_margin
from stewart_drake.paper.accelerations import (
    MODELS,
    Accelerations,
    exact,
    light_legs,
    measured,
    predicted,
    relative_error,
    rod_force_per_torque,
    torque_parts,
)
from stewart_drake.paper.plots.force_map_plots import plot_rod_force
from stewart_drake.paper.region import ANNOUNCED
from stewart_drake.paper.report import Section
from stewart_drake.paper.study import SEED, Study, quantiles
from stewart_drake.planning.pose_box import NEAR, sample_poses
from stewart_drake.references import paper_reference
from stewart_drake.robot import RobotParameters

MASSLESS = 1e-4
"""Factor on the legs' masses and inertias of the plant that stands for massless legs."""
CONFIRMED = 1e-2
"""A model is confirmed where its acceleration is right to this share at all but one pose in twenty."""
LEAST_MARGIN = 1e-3
"""[-] poses keep this far from a crank's dead centre (transmission 0.04), where nothing is finite."""
PLANTS = ("massless legs", "Table I")


def make(study: Study) -> Section:
    """The section on (7) to (18)."""
    robot, rng = study.base.robot, np.random.default_rng(SEED)
    poses = sample_poses(robot, NEAR, study.pick(120, 15), rng, LEAST_MARGIN).poses
    robots = dict(zip(PLANTS, (light_legs(robot, MASSLESS), robot), strict=True))
    runs: dict[str, Accelerations] = {}
    for share, (plant, body) in enumerate(robots.items(), 1):
        runs[plant] = measured(body, poses, STANDARD_GRAVITY)
        study.progress(0.3 * share)
    numbers, figure = _rod_forces(robot, runs[PLANTS[0]])
    study.progress(0.75)
    numbers |= {"ratio": _ratio(study, rng)} | _models(robot, runs)
    motion = paper_reference().evaluate(np.linspace(0.0, np.pi, 401))
    if reach_margin(robot, motion[0]).min() >= LEAST_MARGIN:
        numbers["torque_parts"] = _torque_parts(robot, motion)
    return study.section(
        "force_map", numbers, {"force_map_measured": figure}, poses=len(poses), models=MODELS, massless=MASSLESS,
        confirmed=CONFIRMED,
    )  # fmt: skip


def _rod_forces(robot: RobotParameters, massless: Accelerations) -> tuple[dict[str, Any], Figure]:
    """The force of a rod per torque, and how far (15) and statics are off."""
    transmission = leg_geometry(robot, massless.poses).transmission
    force = rod_force_per_torque(light_legs(robot, MASSLESS), massless)
    errors = {"statics_error": force * transmission - 1.0, "printed_error": transmission / force - 1.0}
    numbers = {"rod_force": {name: quantiles(np.abs(error), (0.5, 0.95, 1.0)) for name, error in errors.items()}}
    return numbers, plot_rod_force(transmission.ravel(), force.ravel())


def _ratio(study: Study, rng: np.random.Generator) -> dict[str, list[float]]:
    """The part of the true rod force that (15) sees: over boxes, and along (37), (38)."""
    robot = study.base.robot
    poses = {
        region.name: sample_poses(robot, region, study.pick(20000, 2000), rng).poses for region in (NEAR, ANNOUNCED)
    }
    motion = paper_reference().evaluate(np.linspace(0.0, np.pi, 201))[0]
    motion = motion[reach_margin(robot, motion).min(axis=-1) >= 0.0]
    if len(motion):
        poses["(37), (38)"] = motion
    return {name: quantiles(leg_geometry(robot, at).transmission ** 2) for name, at in poses.items()}


def _models(robot: RobotParameters, runs: Mapping[str, Accelerations]) -> dict[str, Any]:
    table = runs["Table I"]
    ours = exact(robot, table.poses, STANDARD_GRAVITY).euler_map
    return {
        "models": {
            plant: {
                model: quantiles(relative_error(robot, predicted(robot, run.poses, model), run.euler_map))
                for model in MODELS
            }
            for plant, run in runs.items()
        },
        "exact_model_error": float(relative_error(robot, ours, table.euler_map).max()),
        "felt_inertia": np.diag(task_inertia(robot, robot.home_pose)).tolist(),
    }


def _torque_parts(
    robot: RobotParameters, motion: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> dict[str, dict[str, float]]:
    parts = torque_parts(robot, *motion, STANDARD_GRAVITY)
    parts["all"] = np.sum(list(parts.values()), axis=0)
    return {
        name: {"rms": float(np.sqrt(np.mean(torque**2))), "peak": float(np.abs(torque).max())}
        for name, torque in parts.items()
    }
