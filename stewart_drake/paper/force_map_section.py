"""(7) to (18): the force map as printed and by statics, against torques that really hold and accelerate."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY, task_inertia
from stewart_drake.mechanics.force_map import rod_map
from stewart_drake.mechanics.kinematics import euler_rate_matrix, leg_geometry, reach_margin
from stewart_drake.paper import as_printed
from stewart_drake.paper.accelerations import (
    MODELS,
    Accelerations,
    drift_under,
    exact,
    inertia_in_base,
    light_legs,
    measured,
    predicted,
    relative_error,
    rod_force_per_torque,
    torque_parts,
    weight_torque,
)
from stewart_drake.paper.plots.force_map_plots import RatioSlice, plot_measured, plot_models, plot_ratio, plot_tilt
from stewart_drake.paper.region import ANNOUNCED, NEAR, sample_poses
from stewart_drake.paper.report import Section
from stewart_drake.paper.study import SEED, Study, quantiles
from stewart_drake.references import paper_reference
from stewart_drake.robot import RobotParameters

MASSLESS = 1e-4
"""Factor on the legs' masses and inertias of the plant that stands for massless legs."""
CONFIRMED = 1e-2
"""A model is confirmed where its acceleration is right to this share at all but one pose in twenty."""
LEAST_MARGIN = 1e-3
"""[-] poses keep this far from a crank's dead centre (transmission 0.04), where nothing is finite."""
HOLD_TIME = 0.05
"""[s] of the runs under constant torques."""
PLANTS = ("massless legs", "Table I")
_LARGEST_ANGLE = np.pi / 6.0


def make(study: Study) -> Section:
    """The section on (7) to (18)."""
    robot, rng = study.base.robot, np.random.default_rng(SEED)
    poses = sample_poses(robot, NEAR, study.pick(120, 15), rng, LEAST_MARGIN).poses
    few = poses[: study.pick(6, 2)]
    robots = dict(zip(PLANTS, (light_legs(robot, MASSLESS), robot), strict=True))
    runs: dict[str, Accelerations] = {}
    for share, (plant, body) in enumerate(robots.items(), 1):
        runs[plant] = measured(body, poses, STANDARD_GRAVITY)
        study.progress(0.3 * share)
    numbers, figures = _rod_forces(study, runs[PLANTS[0]], few)
    study.progress(0.75)
    more, figures["force_map_ratio"] = _where(study, rng)
    numbers |= more | _models(robot, runs)
    figures["force_map_models"] = plot_models(numbers["models"])
    held = _holding(robots, runs, len(few))
    typical = {
        f"{plant}, holding torque": float(np.median(np.abs(run.holding_torque).max(axis=-1)))
        for plant, run in runs.items()
    }
    numbers["holding"] = {f"{plant}, {model}": row for plant, model, row in held} | typical
    motion = paper_reference().evaluate(np.linspace(0.0, np.pi, 401))
    if reach_margin(robot, motion[0]).min() >= LEAST_MARGIN:
        numbers["torque_parts"] = _torque_parts(robot, motion)
    study.progress(0.95)
    numbers["tilt"] = {
        f"{degrees} deg": {
            name: None if np.isnan(error) else error
            for name, error in attitude_errors(robot, np.radians(degrees)).items()
        }
        for degrees in (5, 10, 20, 30)
    }
    figures["force_map_tilt"] = _tilt_figure(robot, study.pick(91, 46))
    return study.section(
        "force_map", numbers, figures, poses=len(poses), few=len(few), held=held, models=MODELS,
        massless=MASSLESS, hold_time=HOLD_TIME, confirmed=CONFIRMED,
    )  # fmt: skip


def _rod_forces(study: Study, massless: Accelerations, few: np.ndarray) -> tuple[dict[str, Any], dict[str, Figure]]:
    """The force of a rod, and how the massless limit and the step to zero are approached."""
    robot = study.base.robot
    transmission = leg_geometry(robot, massless.poses).transmission
    force = rod_force_per_torque(light_legs(robot, MASSLESS), massless)
    errors = {"statics_error": force * transmission - 1.0, "printed_error": transmission / force - 1.0}

    def median_error(model: Accelerations, truth: np.ndarray) -> float:
        return float(np.median(relative_error(robot, model.euler_map, truth)))

    scales = np.logspace(0, -6, study.pick(7, 4))
    truth = predicted(robot, few, "massless legs")
    by_scale = {
        name: [median_error(ask(light_legs(robot, float(s)), few, STANDARD_GRAVITY), truth) for s in scales]
        for name, ask in (("Drake", measured), ("exact model", exact))
    }
    steps = study.pick([1e-4, 3e-5, 1e-5, 3e-6, 1e-6], [1e-4, 1e-5, 1e-6])
    by_step = {}
    for name, scale in zip(PLANTS, (MASSLESS, 1.0), strict=True):
        light = light_legs(robot, scale)
        best = exact(light, few, STANDARD_GRAVITY).euler_map
        by_step[name] = [median_error(measured(light, few, STANDARD_GRAVITY, step), best) for step in steps]
    numbers = {
        "rod_force": {name: quantiles(np.abs(error), (0.5, 0.95, 1.0)) for name, error in errors.items()},
        "by_scale": {"scale": scales.tolist(), **by_scale},
        "by_step": {"step": steps, **by_step},
    }
    figure = plot_measured(transmission.ravel(), force.ravel(), scales, by_scale, np.array(steps), by_step)
    return numbers, {"force_map_measured": figure}


def _where(study: Study, rng: np.random.Generator) -> tuple[dict[str, Any], Figure]:
    """The part of the true rod force that (15) sees: over boxes, along (37), (38), and over slices through home."""
    robot = study.base.robot
    poses = {
        region.name: sample_poses(robot, region, study.pick(20000, 2000), rng).poses for region in (NEAR, ANNOUNCED)
    }
    motion = paper_reference().evaluate(np.linspace(0.0, np.pi, 201))[0]
    motion = motion[reach_margin(robot, motion).min(axis=-1) >= 0.0]
    if len(motion):
        poses["(37), (38)"] = motion
    ratios = {name: (leg_geometry(robot, at).transmission ** 2).ravel() for name, at in poses.items()}
    count = study.pick(161, 41)
    slices = [
        _slice(robot, count, (0, 1.05), (1, 1.05)),
        _slice(robot, count, (3, 0.22), (5, 0.13)),
        _slice(robot, count, (0, 1.05), (5, 0.13), motion[:, [0, 5]]),
    ]
    return {"ratio": {name: quantiles(values) for name, values in ratios.items()}}, plot_ratio(ratios, slices)


def _slice(
    robot: RobotParameters, count: int, x: tuple[int, float], y: tuple[int, float], path: np.ndarray | None = None
) -> RatioSlice:
    """(axis, half width) of the horizontal and the vertical; the rest as at home."""
    names = ("roll", "pitch", "yaw", "X", "Y", "Z")
    across = [robot.home_pose[axis] + np.linspace(-half, half, count) for axis, half in (x, y)]
    poses = np.tile(robot.home_pose, (count, count, 1))
    poses[..., x[0]], poses[..., y[0]] = across[0], across[1][:, None]
    values = np.full((count, count), np.nan)
    reached = reach_margin(robot, poses).min(axis=-1) >= 0.0
    values[reached] = (leg_geometry(robot, poses[reached]).transmission ** 2).min(axis=-1)
    scale = np.array([180.0 / np.pi if axis < 3 else 1e3 for axis in (x[0], y[0])])
    x_label, y_label = (f"{names[axis]} [{'deg' if axis < 3 else 'mm'}]" for axis in (x[0], y[0]))
    return RatioSlice(
        title=f"Worst leg over {names[x[0]]} and {names[y[0]]}",
        x=across[0] * scale[0],
        y=across[1] * scale[1],
        values=values,
        x_label=x_label,
        y_label=y_label,
        path=None if path is None else path * scale,
    )


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


def _holding(
    robots: Mapping[str, RobotParameters], runs: Mapping[str, Accelerations], some: int
) -> list[tuple[str, str, dict[str, Any]]]:
    """What the torques do that hold the platform by each map: plant, map and numbers."""
    rows = []
    for plant, run in runs.items():
        robot, truth = robots[plant], run.holding_torque
        maps = ("printed, p_i unrotated", "printed", "statics")
        torques = {model: weight_torque(robot, run.poses, model, STANDARD_GRAVITY) for model in maps}
        for model, torque in (torques | {"measured": truth}).items():
            rate = run.under(torque)
            moved = drift_under(robot, run.poses[:some], torque[:some], STANDARD_GRAVITY, HOLD_TIME)
            row: dict[str, Any] = {
                "torque_error": quantiles(np.abs(torque - truth).max(axis=-1), (0.5, 0.95)),
                "linear": float(np.median(np.linalg.norm(rate[:, 3:], axis=-1))),
                "angular": float(np.median(np.linalg.norm(rate[:, :3], axis=-1))),
                "moved": float(np.median(moved)),
            }
            rows.append((plant, model, row))
    return rows


def _torque_parts(
    robot: RobotParameters, motion: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> dict[str, dict[str, float]]:
    parts = torque_parts(robot, *motion, STANDARD_GRAVITY)
    parts["all"] = np.sum(list(parts.values()), axis=0)
    return {
        name: {"rms": float(np.sqrt(np.mean(torque**2))), "peak": float(np.abs(torque).max())}
        for name, torque in parts.items()
    }


def _tilt_figure(robot: RobotParameters, count: int) -> Figure:
    angle = np.linspace(0.0, np.radians(45.0), count)
    errors = [attitude_errors(robot, float(a)) for a in angle]
    curves = {name: np.array([row[name] for row in errors]) for name in errors[0]}
    reached = ~np.isnan(np.array(list(curves.values()))).any(axis=0)
    return plot_tilt(angle[reached], {name: values[reached] for name, values in curves.items()}, _LARGEST_ANGLE)


def attitude_errors(robot: RobotParameters, angle: float) -> dict[str, float]:
    """What (9) and (11) get wrong at home's position, turned by the same angle about all three axes.

    Args:
        robot: Geometry and masses.
        angle: [rad] roll = pitch = yaw.

    Returns:
        Relative errors [-]: the worst of |E^-1 w' - w'| / |w'| over angular accelerations w'; the worst of
        |I^-1 M - w'| / |w'| over moments M in B, w' = (R I R^T)^-1 M; the RMS over the legs of e_M with p_i unrotated
        less e_M, by the RMS of e_M, NaN out of reach.
    """
    rpy = np.full(3, angle)
    rates = np.linalg.inv(euler_rate_matrix(rpy)) - np.eye(3)
    inertia = np.diag(1.0 / np.array(robot.platform_inertia)) @ inertia_in_base(robot, rpy) - np.eye(3)
    pose = robot.home_pose + np.concatenate([rpy, np.zeros(3)])
    arm = float("nan")
    if reach_margin(robot, pose).min() >= 0.0:
        legs = leg_geometry(robot, pose)
        right, printed = rod_map(legs)[:3], as_printed.rod_map_11(robot, legs)[:3]
        arm = float(np.linalg.norm(printed - right) / np.linalg.norm(right))
    return {
        "Euler second derivatives for angular acceleration": float(np.linalg.norm(rates, 2)),
        "inertia in P with moments in B": float(np.linalg.norm(inertia, 2)),
        "moment arm p_i unrotated": arm,
    }
