"""(7) to (18): the force map as printed and by statics, compared with accelerations of the multibody plant."""

from __future__ import annotations

from functools import partial

import numpy as np
from pydrake.systems.analysis import Simulator

from stewart_drake.analysis.feasibility import NEAR, sample_poses
from stewart_drake.base.errors import drake_guard
from stewart_drake.control.riccati import mass_diagonal
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY, crank_map, force_map_of_legs
from stewart_drake.mechanics.kinematics import LegGeometry, cross, euler_rate_matrix, leg_geometry, rotation_matrix
from stewart_drake.paper.reproduce import ANNOUNCED, SEED, Claim, Reproduction, Result, quantiles
from stewart_drake.plant.multibody_plant import build_plant
from stewart_drake.plant.plant_options import DrakeOptions
from stewart_drake.plotting.style import chart
from stewart_drake.references import paper_reference
from stewart_drake.robot import Gravity, RobotParameters
from stewart_drake.robot.leg import LEG_COUNT, SMALLEST_SIZE

SETTLING_STEPS = 14
"""Plant steps before the acceleration is read. SAP's near-rigid loop closures yield by 5e-4 in the first step, and by
half as much in every further one."""
_TORQUE_SHARE = 0.2
MASSLESS = 1e-4  # Factor on masses and inertias of the legs in the plant with massless legs
LEAST_MARGIN = 1e-3
"""[-] distance of poses from a crank's dead centre (transmission 0.04), where nothing is finite."""
MODELS = {
    "printed, p_i unrotated": "(9) to (18) to the letter",
    "printed": "the same with e_M from R^-1 p_i",
    "statics": "and with F_i = T_i / (|a| e_l.e_N)",
    "statics, I in B": "and with the platform's inertia turned into B, as its moments are",
    "massless legs": "and with angular acceleration in place of Euler second derivatives: exact without legs",
}
"""The controller's model of M q'' = tau T, corrected step by step."""


def light_legs(robot: RobotParameters, scale: float) -> RobotParameters:
    of_legs = ("rod_mass", "crank_mass", "rod_inertia", "crank_inertia")
    scaled = {name: scale * np.array(getattr(robot, name)) for name in of_legs}
    return robot.replace(**{name: np.maximum(SMALLEST_SIZE, values).tolist() for name, values in scaled.items()})


def measured(robot: RobotParameters, poses: np.ndarray, gravity: Gravity, steps: int = SETTLING_STEPS) -> np.ndarray:
    """d(twist)/dt (n, 6, 6) at rest per N m of a motor, in the last microsecond of Drake's plant."""
    diagram, stewart = build_plant(robot, DrakeOptions(time_step=1e-6), gravity)
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    plant, output = stewart.plant, diagram.GetOutputPort("state")
    plant_context, step = plant.GetMyMutableContextFromRoot(context), plant.time_step()
    torque = _TORQUE_SHARE * robot.effort_limit
    gained = np.empty((len(poses), 1 + LEG_COUNT, 6))
    with drake_guard("measuring accelerations"):
        for row, state in enumerate(stewart.assemble(poses)):
            for column, torques in enumerate([np.zeros(LEG_COUNT), *(torque * np.eye(LEG_COUNT))]):
                context.SetTime(0.0)
                plant.SetPositionsAndVelocities(plant_context, state)
                diagram.GetInputPort("torque").FixValue(context, torques)
                simulator.Initialize()
                simulator.AdvanceTo((steps - 1) * step)
                before = output.Eval(context)[stewart.indices.twist]
                simulator.AdvanceTo(steps * step)
                gained[row, column] = (output.Eval(context)[stewart.indices.twist] - before) / step
    return np.swapaxes(gained[:, 1:] - gained[:, :1], -1, -2) / torque


def rod_map_11(robot: RobotParameters, legs: LegGeometry) -> np.ndarray:
    """tau_1 (..., 6, 6) [m, -] of (14) with the unrotated p_i of (11): e_M = p_i x e_l."""
    joints = np.broadcast_to(robot.platform_joints, legs.e_l.shape)
    return np.swapaxes(np.concatenate([cross(joints, legs.e_l), legs.e_l], axis=-1), -1, -2)


def predicted(robot: RobotParameters, poses: np.ndarray, model: str) -> np.ndarray:
    """Acceleration q'' per unit of motor torque by one of `MODELS`; (n, 6, 6) [rad/s^2, m/s^2 per N m]."""
    legs = leg_geometry(robot, poses)
    if model == "printed, p_i unrotated":
        wrench = rod_map_11(robot, legs) * crank_map(robot, legs, "printed")[..., None, :]
    else:
        wrench = force_map_of_legs(robot, legs, "printed" if model == "printed" else "statics")
    if model not in ("statics, I in B", "massless legs"):
        return np.asarray(wrench / mass_diagonal(robot)[:, None])
    rate = wrench / robot.platform_mass
    rotation = rotation_matrix(poses[:, :3])
    inertia = (rotation * np.diag(robot.central_inertia)) @ np.swapaxes(rotation, -1, -2)
    rate[:, :3] = np.linalg.solve(inertia, wrench[:, :3])
    return to_euler(poses, rate) if model == "massless legs" else rate


def relative_error(robot: RobotParameters, model: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Relative RMS error (n,) [-] of an acceleration map over all torques; angles times the characteristic length."""
    scale = np.repeat([robot.characteristic_length, 1.0], 3)[:, None]
    error, size = (np.linalg.norm(scale * values, axis=(-2, -1)) for values in (model - truth, truth))
    return np.asarray(error / size)


def rod_force_per_torque(robot: RobotParameters, poses: np.ndarray, twist_map: np.ndarray) -> np.ndarray:
    """|a| F_i / T_i (n, 6) [-] of massless legs: e_l.e_N by (15), 1 / (e_l.e_N) by statics."""
    force = robot.platform_mass * np.swapaxes(twist_map[:, 3:], -1, -2)
    return np.asarray(robot.crank_lengths * np.sum(leg_geometry(robot, poses).e_l * force, axis=-1))


def to_euler(poses: np.ndarray, twist_rate: np.ndarray) -> np.ndarray:
    """Columns of d(twist)/dt (n, 6, k) at rest as columns of q'' (n, 6, k)."""
    euler = twist_rate.copy()
    euler[..., :3, :] = np.linalg.solve(euler_rate_matrix(poses[..., :3]), twist_rate[..., :3, :])
    return euler


def reproduce(study: Reproduction) -> Result:
    robot, rng = study.base.robot, np.random.default_rng(SEED)
    poses = sample_poses(robot, NEAR, study.pick(120, 15), rng, LEAST_MARGIN)
    light = light_legs(robot, MASSLESS)
    runs = {name: measured(r, poses, STANDARD_GRAVITY) for name, r in (("massless legs", light), ("Table I", robot))}
    transmission = leg_geometry(robot, poses).transmission
    force = rod_force_per_torque(light, poses, runs["massless legs"])
    boxes = {r.name: sample_poses(robot, r, study.pick(20000, 2000), rng) for r in (NEAR, ANNOUNCED)}
    boxes["(37), (38)"] = paper_reference().evaluate(np.linspace(0.0, np.pi, 201))[0]
    ratio = {name: quantiles(leg_geometry(robot, at).transmission ** 2) for name, at in boxes.items()}
    models = {
        legs: {
            model: quantiles(relative_error(robot, predicted(robot, poses, model), to_euler(poses, run)))
            for model in MODELS
        }
        for legs, run in runs.items()
    }
    part, statics = 100.0 * ratio["near"][1], 100.0 * float(np.median(np.abs(force * transmission - 1.0)))
    claims = [
        Claim("(15): part of a rod's true force, median", "100 %", part, "%", part > 99.0),
        Claim("statics for (15): error of a rod's force, median", "-", statics, "%", None),
    ]
    letter, *_, mended = MODELS
    for legs in runs:
        for words, model in (("to the letter", letter), ("mended", mended)):
            error = 100.0 * models[legs][model][1]
            claims.append(Claim(f"(9)-(18) {words}: error, {legs}", "0", error, "%", error < 1.0))
    x = np.linspace(0.12, 1.0, 200)
    curves = {
        "statics: $1/(e_l \\cdot e_N)$": (x, 1.0 / x),
        "(15): $e_l \\cdot e_N$": (x, x),
        "Drake": (np.sort(transmission.ravel()), force.ravel()[transmission.ravel().argsort()]),
    }
    draw = partial(chart, "Force of a rod, massless legs", "$e_l \\cdot e_N$ [-]", "$|a| F / T$ [-]", curves)
    return Result({"ratio": ratio, "models": models}, claims, {"force_map": draw})
