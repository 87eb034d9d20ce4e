"""II.C and (1) to (6): the multibody plant against mechanics; kinematics as meant, by Drake, and as printed.

Printed equations keep their misprints here, in radians, for comparison only.
"""

from __future__ import annotations

from contextlib import suppress
from functools import partial

import numpy as np
from pydrake.systems.analysis import Simulator
from scipy.integrate import solve_ivp

from stewart_drake.analysis.feasibility import NEAR, sample_poses
from stewart_drake.base.atomic_files import Document
from stewart_drake.base.errors import ForwardKinematicsError, drake_guard
from stewart_drake.mechanics.dynamics import task_bias, task_inertia
from stewart_drake.mechanics.kinematics import (
    forward_kinematics,
    leg_geometry,
    rod_lines,
    rotation_matrix,
    twist_jacobian,
    twist_to_pose_rate,
)
from stewart_drake.paper.reproduce import ANNOUNCED, SEED, WIDE, Claim, Reproduction, Result, quantiles
from stewart_drake.plant.multibody_plant import build_plant
from stewart_drake.plant.plant_options import DrakeOptions
from stewart_drake.plotting.style import chart
from stewart_drake.robot import Gravity, RobotParameters
from stewart_drake.robot.leg import crank_angles, crank_equation

START = np.array([0.1, -0.05, 0.1, 0.01, -0.02, 0.01])
"""[rad, m] start of a free motion, relative to home, at rest."""
TORQUE = np.array([0.2, 0.3, 0.25, 0.3, 0.2, 0.3])  # [N m] constant
DURATION = 0.15
BRANCHES = (-1, 1)
SAME_ANGLE = SAME_POSE = 1e-6
"""[rad, m] tolerance of equality; next to a dead centre an acos has only half the digits."""


def exact_motion(robot: RobotParameters, gravity: Gravity) -> np.ndarray:
    """Pose (6,) [rad, m] after `DURATION` of `TORQUE` from rest at `START` by the closed-form model, to about 1e-12."""

    def derivative(_: float, state: np.ndarray) -> np.ndarray:
        pose, twist = state[:6], state[6:]
        load = twist_jacobian(robot, pose).T @ TORQUE - task_bias(robot, pose, twist, gravity)
        return np.concatenate([twist_to_pose_rate(pose, twist), np.linalg.solve(task_inertia(robot, pose), load)])

    start = np.concatenate([robot.home_pose + START, np.zeros(6)])
    return solve_ivp(derivative, (0.0, DURATION), start, method="DOP853", rtol=1e-12, atol=1e-13).y[:6, -1]


def plant_motion(robot: RobotParameters, gravity: Gravity, time_step: float) -> tuple[np.ndarray, float]:
    diagram, plant = build_plant(robot, DrakeOptions(time_step=time_step), gravity)
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    diagram.GetInputPort("torque").FixValue(context, TORQUE)
    plant.set_state(context, robot.home_pose + START)
    simulator.AdvanceTo(round(DURATION / time_step) * plant.plant.time_step())
    state = diagram.GetOutputPort("state").Eval(context)
    return plant.pose_and_rate(state)[0], float(plant.loop_gap(state).max())


def rotation_3(rpy: np.ndarray) -> np.ndarray:
    """R_xyz (..., 3, 3) of (3), with the printed entry (3,1): cos theta cos psi sin theta + sin phi sin psi."""
    rpy = np.asarray(rpy, dtype=float)
    matrix = np.swapaxes(rotation_matrix(rpy), -1, -2).copy()
    (sin_phi, sin_theta, sin_psi), (_, cos_theta, cos_psi) = (np.moveaxis(f(rpy), -1, 0) for f in (np.sin, np.cos))
    matrix[..., 2, 0] = cos_theta * cos_psi * sin_theta + sin_phi * sin_psi
    return matrix


def platform_joints(robot: RobotParameters, pose: np.ndarray, misprint: str = "") -> np.ndarray:
    """Platform joints (..., 6, 3) [m] in B as (2) means them, R^-1 p_i + G, or with the misprint of (3) or (5)."""
    position, joints = pose[..., None, 3:], robot.platform_joints
    if misprint == "(3)":
        return joints @ np.swapaxes(np.linalg.inv(rotation_3(pose[..., :3])), -1, -2) + position
    turned = np.swapaxes(rotation_matrix(pose[..., :3]), -1, -2)
    return (joints + position) @ turned if misprint == "(5)" else joints @ turned + position


MISPRINTS = ("(3)", "(5)")


def equation_at(robot: RobotParameters, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A, B, C (..., 6) [m^2] of (6), which the paper does not give, for platform joints (..., 6, 3) [m]."""
    directions = robot.crank_zero_directions, robot.crank_quarter_directions
    return crank_equation(joints - robot.shaft_positions, *directions, robot.crank_lengths, robot.rod_lengths)


def crank_angles_6(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """(6) as printed; (..., 6) [rad], NaN where a rod cannot span. A enters by its square alone."""
    with np.errstate(invalid="ignore"):
        return -(np.arcsin(c / np.hypot(a, b)) - np.arccos(b / np.hypot(a, b)) + np.pi)


def rod_spans(robot: RobotParameters, poses: np.ndarray) -> np.ndarray:
    """Lengths (n, 6) [m] of rods by Drake's forward kinematics at poses and the crank angles of the closed form."""
    stewart = build_plant(robot)[1]
    plant, spans = stewart.plant, np.empty(poses.shape)
    context, world, platform = plant.CreateDefaultContext(), plant.world_frame(), plant.GetFrameByName("platform")
    with drake_guard("setting positions"):
        for row, state in enumerate(stewart.assemble(poses)):
            plant.SetPositionsAndVelocities(context, state)
            joints = plant.CalcPointsPositions(context, platform, robot.platform_joints.T, world).T
            for leg, joint in enumerate(joints):
                crank, tip = plant.GetFrameByName(f"crank_{leg}"), [robot.crank_lengths[leg], 0.0, 0.0]
                spans[row, leg] = np.linalg.norm(joint - plant.CalcPointsPositions(context, crank, tip, world)[:, 0])
    return spans


def newton_outcome(robot: RobotParameters, poses: np.ndarray, guess: np.ndarray) -> Document:
    """Counts of poses (n, 6) for which Newton's method from `guess` finds the `same` pose, an `other`, or `failed`.

    `other_across`: an other pose beyond a parallel singularity. `error` [m]: shift plus turn times 1 m.
    """
    legs = leg_geometry(robot, poses)
    solved = np.full(poses.shape, np.nan)
    for row, (angles, start) in enumerate(zip(legs.crank_angles, np.broadcast_to(guess, poses.shape), strict=True)):
        with suppress(ForwardKinematicsError):
            solved[row] = forward_kinematics(robot, angles, start)
    # The Frobenius norm of the difference is sqrt(2) times a small turn.
    turn = np.linalg.norm(rotation_matrix(solved[:, :3]) - rotation_matrix(poses[:, :3]), axis=(-2, -1)) / np.sqrt(2.0)
    error = turn + np.linalg.norm(solved[:, 3:] - poses[:, 3:], axis=-1)
    across = np.linalg.det(rod_lines(legs)) * np.linalg.det(rod_lines(leg_geometry(robot, robot.home_pose))) < 0.0
    same, other = error < SAME_POSE, error >= SAME_POSE
    counts = {"same": same, "other": other, "other_across": other & across, "failed": np.isnan(error)}
    largest = float(error[same].max()) if same.any() else None
    return {**{name: int(which.sum()) for name, which in counts.items()}, "error": largest}


def misprint_effect(robot: RobotParameters, poses: np.ndarray, misprint: str) -> tuple[np.ndarray, np.ndarray]:
    """Displacement (...) [m] of a platform joint by one of `MISPRINTS`, and whether the rods could reach it."""
    joints = platform_joints(robot, poses, misprint)
    a, b, c = equation_at(robot, joints)
    shift = np.linalg.norm(joints - platform_joints(robot, poses), axis=-1).max(axis=-1)
    return shift, (np.abs(c) <= np.hypot(a, b)).all(axis=-1)


def branch_of_6(robot: RobotParameters, poses: np.ndarray, sense: int = 1) -> dict[str, float]:
    """Shares of the legs at poses (n, 6) at which (6) gives branch `-1`, `1` or `neither`, and with A > 0.

    With a `sense` of -1 crank angles have the opposite sign.
    """
    a, b, c = equation_at(robot, platform_joints(robot, poses))
    off = sense * crank_angles_6(a, sense * b, c) - np.array([crank_angles(a, b, c, branch) for branch in BRANCHES])
    hit = np.abs(np.angle(np.exp(1j * off))) < SAME_ANGLE
    shares = {str(branch): float(legs.mean()) for branch, legs in zip(BRANCHES, hit, strict=True)}
    return {**shares, "neither": float((~hit.any(axis=0)).mean()), "a_positive": float((a > 0.0).mean())}


def reproduce(study: Reproduction) -> Result:
    robot, gravity, rng = study.base.robot, study.base.gravity_in_base, np.random.default_rng(SEED)
    steps = np.array(study.pick((2e-3, 1e-3, 5e-4, 2e-4, 1e-4, 5e-5), (2e-3, 1e-3, 5e-4)))
    motions = [plant_motion(robot, gravity, float(step)) for step in steps]
    off = np.abs([pose for pose, _ in motions] - exact_motion(robot, gravity))[:, 3:].max(axis=1)
    gaps = np.array([gap for _, gap in motions])
    order = float((np.diff(np.log(off)) / np.diff(np.log(steps)))[-1])
    samples = {r.name: sample_poses(robot, r, study.pick(600, 100), rng) for r in (NEAR, ANNOUNCED, WIDE)}
    rod_error, forward, branches = {}, {}, {}
    for region, poses in samples.items():
        for sense, words in ((1, "our sense"), (-1, "other sense")):
            branches[f"{region}, {words}"] = branch_of_6(robot, poses, sense)
        for branch in BRANCHES:
            on_branch, name = robot.replace(branch=branch), f"{region} {branch:+d}"
            rod_error[name] = float(np.abs(rod_spans(on_branch, poses) - robot.rod_lengths).max())
            nearby = poses + 0.1 * (robot.home_pose - poses)
            for start, guess in {"home": robot.home_pose, "nearby": nearby}.items():
                forward[f"{name} {start}"] = newton_outcome(on_branch, poses, guess)
    near = samples["near"]
    shifts = {name: quantiles(misprint_effect(robot, near, name)[0], (0.5, 0.95, 1.0)) for name in MISPRINTS}
    numbers = {
        "plant": {"step": steps.tolist(), "position_error": off.tolist(), "loop_gap": gaps.tolist()},
        "rod_error": rod_error,
        "forward": forward,
        "joint_shift": shifts,
        "branch_of_6": branches,
    }
    at_1_ms, worst = 1e3 * float(off[1]), max(rod_error.values())
    counts = [forward[name]["same"] for name in forward if name.startswith("near ")]
    same = 100.0 * sum(counts) / (len(counts) * len(near))
    shift = {name: 1e3 * values[-1] for name, values in shifts.items()}
    lost = 100.0 * branches["announced, our sense"]["neither"]
    claims = [
        Claim("II.C: the plant against mechanics, order of the error", "valid", order, "", order > 0.9),
        Claim("II.C: error of the plant at 1 ms after 0.15 s", "-", at_1_ms, "mm", None),
        Claim("(1), (2): closed form, error of a rod's length", "0", worst, "m", worst < 1e-11),
        Claim("V: direct kinematics finds the near poses", "all", same, "%", same == 100.0),
        *(Claim(f"{n} as printed: a joint is misplaced by up to", "0", s, "mm", s < 0.01) for n, s in shift.items()),
        Claim("(6): legs without a solution, announced box", "0", lost, "%", lost == 0.0),
    ]
    curves = {"position error": (1e3 * steps, off), "loop gap": (1e3 * steps, gaps)}
    draw = partial(chart, "The plant against exact mechanics", "step [ms]", "[m]", curves, "o-", "xy")
    return Result(numbers, claims, {"plant": draw})
