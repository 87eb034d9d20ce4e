"""(7) to (18): the force map as printed and by statics, against torques that really hold and accelerate."""

from __future__ import annotations

from typing import Any

import numpy as np

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
from stewart_drake.paper.study import SEED, Study
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

CLAIM = (
    "The platform obeys M q'' = tau T, (10), with q'' the second derivative of the pose, tau_1 of the rods' "
    "directions (14), and a rod force of (e_l.e_N) T / |a| (15). The legs have no mass, and gravity is left out."
)


def make(study: Study) -> Section:
    """The section on (7) to (18)."""
    section = Section("force_map", "Force map: (7) to (18)", CLAIM)
    robot, rng = study.base.robot, np.random.default_rng(SEED)
    poses = sample_poses(robot, NEAR, study.pick(120, 15), rng, LEAST_MARGIN).poses
    robots = dict(zip(PLANTS, (light_legs(robot, MASSLESS), robot), strict=True))
    section.text(
        "Two plants are asked, both simulated by Drake with gravity: one with the masses of Table I, and one whose "
        f"cranks and rods weigh {MASSLESS:g} of that. At {len(poses)} random poses of the near box (the kinematics "
        "section describes it) the robot is put at rest, each motor in turn gets a torque, and the platform's "
        "acceleration is read a few microseconds later, as soon as the loop closures have settled. The acceleration "
        "is affine in the torques, so this gives the whole map from torque to acceleration, and the torque that holds."
    )
    runs: dict[str, Accelerations] = {}
    for share, (plant, body) in enumerate(robots.items(), 1):
        runs[plant] = measured(body, poses, STANDARD_GRAVITY)
        study.progress(0.3 * share)
    _rod_forces(section, study, robot, runs[PLANTS[0]], poses[: study.pick(6, 2)])
    study.progress(0.75)
    _where(section, study, robot, rng)
    _models(section, study, robot, runs)
    _holding(section, study, robots, runs)
    _disturbance(section, robot)
    study.progress(0.95)
    _tilt(section, study, robot)
    section.verdict = verdict(section.numbers)
    return section


def verdict(numbers: dict[str, Any]) -> str:
    """The section's last word, from its numbers."""
    massless, table = (numbers["models"][plant] for plant in PLANTS)
    force, ratio = numbers["rod_force"], numbers["ratio"]["near"]
    statics, printed = force["statics_error"], force["printed_error"]
    right = printed[1] < CONFIRMED
    if right:
        first = f"Holds for the force of a rod: (15) is right to {printed[1]:.1g} in Drake's massless limit"
    elif statics[1] < CONFIRMED:
        first = (
            "Does not hold: in Drake's massless limit a rod carries the force that statics says, to "
            f"{statics[1]:.1g}; (15) sees {ratio[1]:.0%} of it in the median and {ratio[0]:.0%} or less for "
            "one leg in twenty of the near box"
        )
    else:
        first = f"Neither (15) nor statics is confirmed: they are off by {printed[1]:.1g} and {statics[1]:.1g}"
    return (
        f"{first}. The letter of (9) to (18) is off by {massless['printed, p_i unrotated'][1]:.0%} in the acceleration "
        f"without leg masses and by {table['printed, p_i unrotated'][1]:.0%} with those of Table I (medians); with "
        f"statics by {massless['statics'][1]:.0%} and {table['statics'][1]:.0%}; with all of it mended by "
        f"{massless['massless legs'][1]:.2%} and {table['massless legs'][1]:.0%}: the rest is the mass of the legs."
    )


def _rod_forces(
    section: Section, study: Study, robot: RobotParameters, massless: Accelerations, few: np.ndarray
) -> None:
    transmission = leg_geometry(robot, massless.poses).transmission
    force = rod_force_per_torque(light_legs(robot, MASSLESS), massless)
    errors = {"statics_error": force * transmission - 1.0, "printed_error": transmission / force - 1.0}
    section.numbers["rod_force"] = {k: [float(q) for q in np.quantile(np.abs(v), (0.5, 0.95, 1.0))]
                                    for k, v in errors.items()}  # fmt: skip
    scales = np.logspace(0, -6, study.pick(7, 4))
    truth = predicted(robot, few, "massless legs")
    by_scale = {"Drake": [], "exact model": []}  # type: dict[str, list[float]]
    for scale in scales:
        light = light_legs(robot, float(scale))
        for name, ask in (("Drake", measured), ("exact model", exact)):
            by_scale[name].append(_median_error(robot, ask(light, few, STANDARD_GRAVITY).euler_map, truth))
    steps = np.array(study.pick([1e-4, 3e-5, 1e-5, 3e-6, 1e-6], [1e-4, 1e-5, 1e-6]))
    by_step: dict[str, list[float]] = {}
    for name, scale in zip(PLANTS, (MASSLESS, 1.0), strict=True):
        light = light_legs(robot, scale)
        best = exact(light, few, STANDARD_GRAVITY).euler_map
        by_step[name] = [
            _median_error(robot, measured(light, few, STANDARD_GRAVITY, float(step)).euler_map, best) for step in steps
        ]
    section.numbers["by_scale"] = {"scale": scales.tolist(), **by_scale}
    section.numbers["by_step"] = {"step": steps.tolist(), **by_step}
    section.text(
        "### The force of a rod, (15)\n\n"
        "A crank tip can only move along e_N, so a torque T at the crank balances the part of the rod's force along "
        "e_N: F e_l.e_N = T / |a|. **D** The print multiplies by e_l.e_N where it must divide. Without leg masses the "
        "platform's acceleration tells the force of each rod, and Drake sides with statics: |a| F / T differs from "
        f"1 / (e_l.e_N) by {section.numbers['rod_force']['statics_error'][2]:.1g} at most, relative to it."
    )
    section.figure(
        "Left: force of a rod per motor torque in the plant whose legs are nearly massless. Middle: acceleration map "
        "against that of massless legs, as the legs are made lighter; Drake and the exact rigid-body model. Right: "
        "Drake against the exact model, as the plant's step shrinks; what remains with Table I is the spin of the rods "
        f"about their own axes, which the exact model leaves out. Medians of {len(few)} poses.",
        study.save_figure(
            plot_measured(
                transmission.ravel(), force.ravel(), scales, {k: np.array(v) for k, v in by_scale.items()},
                steps, {k: np.array(v) for k, v in by_step.items()},
            ),
            "force_map_measured",
        ),
    )  # fmt: skip


def _where(section: Section, study: Study, robot: RobotParameters, rng: np.random.Generator) -> None:
    ratios = {
        region.name: (leg_geometry(robot, sample_poses(robot, region, study.pick(20000, 2000), rng).poses).transmission
                      ** 2)
        for region in (NEAR, ANNOUNCED)
    }  # fmt: skip
    motion = paper_reference().evaluate(np.linspace(0.0, np.pi, 201))[0]
    motion = motion[reach_margin(robot, motion).min(axis=-1) >= 0.0]
    if len(motion):
        ratios["(37), (38)"] = leg_geometry(robot, motion).transmission ** 2
    section.numbers["ratio"] = {
        name: [float(q) for q in np.quantile(values, (0.05, 0.5, 0.95))] for name, values in ratios.items()
    }
    section.table(
        "(e_l.e_N)², the part of the true rod force per torque that (15) sees, over all legs.",
        ("poses", "5 % of legs below", "median", "95 % below"),
        [(name, *(f"{q:.3f}" for q in row)) for name, row in section.numbers["ratio"].items()],
    )
    count = study.pick(161, 41)
    slices = [
        _slice(robot, count, (0, 1.05), (1, 1.05)),
        _slice(robot, count, (3, 0.22), (5, 0.13)),
        _slice(robot, count, (0, 1.05), (5, 0.13), motion[:, [0, 5]]),
    ]
    section.figure(
        "The part of the true rod force that (15) sees: over the legs of random poses, and its worst leg over slices "
        "through home. Grey is out of reach. A controller that trusts (15) asks for the needed torque divided by "
        "this part.",
        study.save_figure(plot_ratio({k: v.ravel() for k, v in ratios.items()}, slices), "force_map_ratio"),
    )


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


def _models(section: Section, study: Study, robot: RobotParameters, runs: dict[str, Accelerations]) -> None:
    errors = {
        plant: {
            model: [float(q) for q in np.quantile(
                relative_error(robot, predicted(robot, run.poses, model), run.euler_map), (0.05, 0.5, 0.95))]
            for model in MODELS
        }
        for plant, run in runs.items()
    }  # fmt: skip
    section.numbers["models"] = errors
    ours = exact(robot, runs["Table I"].poses, STANDARD_GRAVITY).euler_map
    section.numbers["exact_model_error"] = best = float(relative_error(robot, ours, runs["Table I"].euler_map).max())
    felt = np.diag(task_inertia(robot, robot.home_pose))
    section.numbers["felt_inertia"] = felt.tolist()
    section.text(
        "### Which acceleration follows from a torque, (9), (10)\n\n"
        "The table mends the model step by step and compares the acceleration q'' that it predicts with the one that "
        "Drake shows: RMS of the error over all directions of torque, by RMS of the truth, angles times "
        f"{robot.characteristic_length:g} m. With massless legs the last line is exact. **D** With the legs of Table I "
        "none is: at home the platform feels the inertia of "
        f"{felt[5]:.2f} kg along Z instead of {robot.platform_mass:g} kg, {felt[3]:.2f} kg along X, and "
        f"{felt[0]:.4f} kg m² in roll instead of {robot.platform_inertia[0]:g}. All of that the controller has to take "
        f"for the disturbance d(t) of (19). The exact model of this project is within {best:.1g} of Drake there."
    )
    section.table(
        "Relative error of the predicted acceleration: median and, in brackets, where 5 % and 95 % of the poses lie.",
        ("model", "what it is", *(f"{plant} [%]" for plant in PLANTS)),
        [(model, words, *(_range(errors[plant][model]) for plant in PLANTS)) for model, words in MODELS.items()],
    )
    section.figure(
        f"The same as a picture: medians, and bars from 5 % to 95 % of {len(ours)} poses.",
        study.save_figure(plot_models(errors), "force_map_models"),
    )
    section.text(" ".join(_remarks(errors)))


def _remarks(errors: dict[str, dict[str, list[float]]]) -> list[str]:
    """What is surprising in the medians of the models' errors; sentences."""
    massless, heavy = ({model: row[1] for model, row in errors[plant].items()} for plant in PLANTS)
    remarks = [f"The best of these models is off by {min(heavy.values()):.0%} on the plant of Table I (median)."]
    if massless["printed"] > massless["printed, p_i unrotated"]:
        remarks.append(
            "Turning p_i in e_M is right, and yet it makes the predicted acceleration worse without leg masses: the "
            "error of the unrotated p_i partly cancels those of (9), which takes Euler second derivatives for the "
            "angular acceleration and I in P for I in B."
        )
    if heavy["printed"] < heavy["statics"]:
        remarks.append(
            "On the plant of Table I the printed map predicts better than statics, for a bad reason: it makes the "
            "rods' forces too small, and a model that knows of no legs needs forces that are too small."
        )
    return remarks


def _holding(
    section: Section, study: Study, robots: dict[str, RobotParameters], runs: dict[str, Accelerations]
) -> None:
    rows: list[tuple[object, ...]] = []
    numbers: dict[str, Any] = {}
    some = study.pick(6, 2)
    for plant, run in runs.items():
        robot, truth = robots[plant], run.holding_torque
        torques = {
            model: weight_torque(robot, run.poses, model, STANDARD_GRAVITY)
            for model in ("printed, p_i unrotated", "printed", "statics")
        }
        torques["measured"] = truth
        for model, torque in torques.items():
            rate = run.under(torque)
            moved = drift_under(robot, run.poses[:some], torque[:some], STANDARD_GRAVITY, HOLD_TIME)
            row: dict[str, Any] = {
                "torque_error": [float(q) for q in np.quantile(np.abs(torque - truth).max(axis=-1), (0.5, 0.95))],
                "linear": float(np.median(np.linalg.norm(rate[:, 3:], axis=-1))),
                "angular": float(np.median(np.linalg.norm(rate[:, :3], axis=-1))),
                "moved": float(np.median(moved)),
            }
            numbers[f"{plant}, {model}"] = row
            rows.append((plant, model, *row["torque_error"], row["linear"], row["angular"], 1e3 * row["moved"]))
        numbers[f"{plant}, holding torque"] = float(np.median(np.abs(truth).max(axis=-1)))
    section.numbers["holding"] = numbers
    section.text(
        "### Which torque holds\n\n"
        "The maps say which torques carry the platform's weight. Put on the plant, this is what happens. The largest "
        "of the six torques that really hold is "
        + " and ".join(f"{numbers[f'{plant}, holding torque']:.2f} N m with {plant}" for plant in PLANTS)
        + " in the median. *measured* is the torque for which Drake showed no acceleration."
    )
    section.table(
        f"Holding the platform: error of the worst motor, acceleration that follows (medians), and shift of the centre "
        f"after {1e3 * HOLD_TIME:g} ms of simulation (median of {some} poses).",
        ("plant", "torque by", "error, median [N m]", "error, 95 % [N m]", "linear [m/s²]", "angular [rad/s²]",
         "shift [mm]"),
        rows,
    )  # fmt: skip


def _disturbance(section: Section, robot: RobotParameters) -> None:
    motion = paper_reference().evaluate(np.linspace(0.0, np.pi, 401))
    if reach_margin(robot, motion[0]).min() < LEAST_MARGIN:
        return
    parts = torque_parts(robot, *motion, STANDARD_GRAVITY)
    parts["all"] = np.sum(list(parts.values()), axis=0)
    section.numbers["torque_parts"] = numbers = {
        name: {"rms": float(np.sqrt(np.mean(torque**2))), "peak": float(np.abs(torque).max())}
        for name, torque in parts.items()
    }
    heavier = numbers["gravity on all bodies"]["rms"] / numbers["M q'' of (10)"]["rms"]
    section.text(
        "### What the model leaves to d(t)\n\n"
        "(10) knows neither gravity nor legs nor gyroscopic terms; (19) puts them into the disturbance. This is how "
        f"the motor torques of (37), (38) divide, by the exact rigid-body model: gravity takes {heavier:.0f} times "
        "what the model knows of (RMS)."
    )
    section.table(
        "Motor torques along (37), (38), over all motors and one period.",
        ("part", "RMS [N m]", "peak [N m]"),
        [(name, f"{row['rms']:.4f}", f"{row['peak']:.4f}") for name, row in numbers.items()],
    )


def _tilt(section: Section, study: Study, robot: RobotParameters) -> None:
    angle = np.linspace(0.0, np.radians(45.0), study.pick(91, 46))
    errors = [attitude_errors(robot, float(a)) for a in angle]
    curves = {name: np.array([row[name] for row in errors]) for name in errors[0]}
    reached = ~np.isnan(np.array(list(curves.values()))).any(axis=0)
    at = {
        f"{degrees} deg": {k: _number(v) for k, v in attitude_errors(robot, np.radians(degrees)).items()}
        for degrees in (5, 10, 20, 30)
    }
    section.numbers["tilt"] = at
    section.text(
        "### What turning the platform does to (9) and (11)\n\n"
        "Three departures grow with the platform's attitude and vanish at home. **D** (9) takes the second "
        "derivatives of roll, pitch and yaw for the angular acceleration, although ω = E q'. **D** It uses the "
        "inertia about the platform's own axes with moments in the base. **D** (11) takes p_i from the platform's own "
        "axes. All three below are for one and the same angle about each axis: the worst direction of the angular "
        "acceleration for the first two, the RMS over the legs for the third."
    )
    section.table(
        "Error at home's position with the same angle about all three axes.",
        ("angle", *curves),
        [(name, *("-" if v is None else f"{v:.0%}" for v in row.values())) for name, row in at.items()],
    )
    section.figure(
        "The same over the angle; dotted: the paper's largest.",
        study.save_figure(
            plot_tilt(angle[reached], {k: v[reached] for k, v in curves.items()}, _LARGEST_ANGLE), "force_map_tilt"
        ),
    )


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


def _median_error(robot: RobotParameters, model: np.ndarray, truth: np.ndarray) -> float:
    return float(np.median(relative_error(robot, model, truth)))


def _number(value: float) -> float | None:
    return None if np.isnan(value) else value


def _range(quantiles: list[float]) -> str:
    low, middle, high = quantiles
    shown = [f"{100.0 * q:.0f}" if q >= 0.01 else f"{100.0 * q:.1g}" for q in (middle, low, high)]
    return f"{shown[0]} ({shown[1]} to {shown[2]})"
