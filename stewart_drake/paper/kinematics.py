"""(1) to (6): inverse and forward kinematics as meant, as Drake has them, and as printed."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import numpy as np

from stewart_drake.errors import ForwardKinematicsError, drake_guard
from stewart_drake.mechanics.kinematics import forward_kinematics, leg_geometry, rod_lines, rotation_matrix
from stewart_drake.paper import as_printed
from stewart_drake.paper.study import ANNOUNCED, SEED, WIDE, Claim, Result, Study, quantiles
from stewart_drake.planning.pose_box import NEAR, sample_poses
from stewart_drake.plant.multibody_plant import build_plant
from stewart_drake.robot import RobotParameters

BRANCHES = (-1, 1)
MISPRINTS = {"(3)": as_printed.platform_joints_3, "(5)": as_printed.platform_joints_5}
SAME_ANGLE = SAME_POSE = 1e-6
"""[rad, m] below this they are the same; next to a dead centre an acos keeps half the digits only."""


def rod_spans(robot: RobotParameters, poses: np.ndarray) -> np.ndarray:
    """Distances (n, 6) [m] of crank tips to platform joints by Drake's forward kinematics: the length of the rods.

    Crank angles, by the closed form, and poses (n, 6) are set independently in the plant.
    """
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


def newton_outcome(robot: RobotParameters, poses: np.ndarray, guess: np.ndarray) -> dict[str, Any]:
    """Inverse kinematics of poses (n, 6) in reach, Newton's method back from `guess`.

    Returns:
        Numbers of poses: `same`, found again; `other`, another assembly of the same crank angles; `other_across`, those
        of them that a parallel singularity parts from home; `failed`. `error` [m]: largest distance to a pose found
        again, shift of the centre plus turn times 1 m.
    """
    legs = leg_geometry(robot, poses)
    found = np.full(poses.shape, np.nan)
    for row, (angles, start) in enumerate(zip(legs.crank_angles, np.broadcast_to(guess, poses.shape), strict=True)):
        with suppress(ForwardKinematicsError):
            found[row] = forward_kinematics(robot, angles, start)
    # Frobenius' norm of the difference is sqrt 2 times a small turn.
    turn = np.linalg.norm(rotation_matrix(found[:, :3]) - rotation_matrix(poses[:, :3]), axis=(-2, -1)) / np.sqrt(2.0)
    error = turn + np.linalg.norm(found[:, 3:] - poses[:, 3:], axis=-1)
    across = np.linalg.det(rod_lines(legs)) * np.linalg.det(rod_lines(leg_geometry(robot, robot.home_pose))) < 0.0
    same, other = error < SAME_POSE, error >= SAME_POSE
    counts = {"same": same, "other": other, "other_across": other & across, "failed": np.isnan(error)}
    largest = float(error[same].max()) if same.any() else None
    return {**{name: int(which.sum()) for name, which in counts.items()}, "error": largest}


def misprint_effect(robot: RobotParameters, poses: np.ndarray, misprint: str) -> tuple[np.ndarray, np.ndarray]:
    """How far (...) [m] one of `MISPRINTS` misplaces a joint of the platform, and whether the rods could follow."""
    joints = MISPRINTS[misprint](robot, poses)
    equation = as_printed.crank_equation(robot, joints)
    shift = np.linalg.norm(joints - as_printed.platform_joints(robot, poses), axis=-1).max(axis=-1)
    return shift, (np.abs(equation.c) <= equation.size).all(axis=-1)


def branch_of_6(robot: RobotParameters, poses: np.ndarray, sense: int = 1) -> dict[str, float]:
    """Shares of the legs at poses (n, 6) in reach where (6) gives branch `-1`, `1` or `neither`; and those with A > 0.

    A `sense` of -1 counts crank angles the other way round, which turns B into -B.
    """
    equation = as_printed.crank_equation(robot, as_printed.platform_joints(robot, poses))
    printed = sense * as_printed.crank_angles_6(equation._replace(b=sense * equation.b))
    off = [printed - as_printed.crank_angles(equation, branch) for branch in BRANCHES]
    hit = np.abs(np.angle(np.exp(1j * np.array(off)))) < SAME_ANGLE
    shares = {str(branch): float(each.mean()) for branch, each in zip(BRANCHES, hit, strict=True)}
    return {**shares, "neither": float((~hit.any(axis=0)).mean()), "a_positive": float((equation.a > 0.0).mean())}


def reproduce(study: Study) -> Result:
    """Kinematics at random poses of three boxes, on both branches, there and back."""
    robot, rng = study.base.robot, np.random.default_rng(SEED)
    samples = [sample_poses(robot, region, study.pick(600, 100), rng) for region in (NEAR, ANNOUNCED, WIDE)]
    near = samples[0].poses
    inverse, forward, branches = {}, {}, {}
    for sample in samples:
        for sense, words in ((1, "our sense"), (-1, "other sense")):
            branches[f"{sample.region.name}, {words}"] = branch_of_6(robot, sample.poses, sense)
        for branch in BRANCHES:
            on_branch, name = robot.replace(branch=branch), f"{sample.region.name} {branch:+d}"
            off = rod_spans(on_branch, sample.poses) - robot.rod_lengths
            inverse[name] = {"rod_error": float(np.abs(off).max())}
            nearby = sample.poses + 0.1 * (robot.home_pose - sample.poses)
            for start, guess in {"home": robot.home_pose, "nearby": nearby}.items():
                forward[f"{name} {start}"] = newton_outcome(on_branch, sample.poses, guess)
    misprints: dict[str, dict[str, Any]] = {}
    for name in MISPRINTS:
        shift, in_reach = misprint_effect(robot, near, name)
        lost = 1.0 - float(in_reach.mean())
        misprints[name] = {"out_of_reach": lost, "joint_shift": quantiles(shift, (0.5, 0.95, 1.0))}
    numbers = {
        "regions": {s.region.name: {"share": s.share, "poses": len(s.poses)} for s in samples},
        "inverse": inverse,
        "forward": forward,
        "misprints": misprints,
        "branch_of_6": branches,
    }
    worst = max(row["rod_error"] for row in inverse.values())
    counts = [forward[name] for name in forward if name.startswith("near ")]
    found = 100.0 * sum(row["same"] for row in counts) / (len(counts) * len(near))
    off = {name: 1e3 * row["joint_shift"][-1] for name, row in misprints.items()}
    lost = 100.0 * branches["announced, our sense"]["neither"]
    claims = [
        Claim("(1), (2): closed form, error of a rod's length", "0", worst, "m", worst < 1e-11),
        Claim("V: direct kinematics finds the near poses", "all", found, "%", found == 100.0),
        *(Claim(f"{n} as printed: a joint is misplaced by up to", "0", off[n], "mm", off[n] < 0.01) for n in off),
        Claim("(6): legs without a solution, announced box", "0", lost, "%", lost == 0.0),
    ]
    return Result(numbers, claims)
