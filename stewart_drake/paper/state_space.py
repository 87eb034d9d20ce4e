"""(19) to (34): matrices, Hautus ranks, singular poses, gains as printed and as meant, and how the error decays."""

from __future__ import annotations

import dataclasses
import itertools
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from stewart_drake.analysis.feasibility import NEAR, sample_poses
from stewart_drake.base.atomic_files import Document
from stewart_drake.base.errors import drake_guard
from stewart_drake.control.riccati import (
    AXES,
    STATES,
    acceleration_map,
    discretize,
    equation_of_drake,
    input_matrix,
    mass_diagonal,
    output_matrix,
    split_gain,
    state_matrix,
)
from stewart_drake.logs.signals import SCALES
from stewart_drake.mechanics.dynamics import ForceMapKind, force_map, force_map_of_legs
from stewart_drake.mechanics.kinematics import leg_geometry, reach_margin, rod_lines
from stewart_drake.paper.reproduce import ANNOUNCED, RATIOS, SEED, WIDE, Claim, Reproduction, Result
from stewart_drake.plotting.style import COORDINATES
from stewart_drake.robot import RobotParameters

KINDS: tuple[ForceMapKind, ...] = ("printed", "statics")
DEAD = 1e-6
"""[-] transmission of a dead centre that bisection has found: it vanishes with the root of the distance."""
PERIODS = (1e-4, 1e-3, 5e-3, 2e-2, 0.1)  # [s] control periods that are compared; the paper gives none


class Singularity(NamedTuple):
    """The first singular pose on a ray from home: `serial`, a crank at its dead centre, or `parallel`."""

    kind: str
    direction: np.ndarray
    distance: float

    def pose(self, robot: RobotParameters, back: float = 0.0) -> np.ndarray:
        return np.asarray(robot.home_pose + (self.distance - back) * self.direction)


def first_singularity(robot: RobotParameters, direction: np.ndarray, most: float) -> Singularity | None:
    """The first of 400 poses on a ray where a crank is at its dead centre or the determinant of the rods vanishes."""

    def margin(distance: ArrayLike) -> np.ndarray:
        return reach_margin(robot, robot.home_pose + np.multiply.outer(distance, direction)).min(axis=-1)

    def determinant(distance: ArrayLike) -> np.ndarray:
        return np.linalg.det(rod_lines(leg_geometry(robot, robot.home_pose + np.multiply.outer(distance, direction))))

    walk, end = np.linspace(0.0, most, 401), None
    if not (reached := margin(walk) >= 0.0).all():
        inside = int(reached.argmin())
        end = brentq(margin, walk[inside - 1], walk[inside], xtol=1e-16, rtol=1e-15)
        while margin(end) < 0.0:
            end = float(np.nextafter(end, 0.0))
        walk = np.unique([*walk[:inside], end])
    crossed = determinant(walk) * determinant(0.0) < 0.0
    if crossed.any():
        at = int(crossed.argmax())
        return Singularity("parallel", direction, brentq(determinant, *walk[at - 1 : at + 1], xtol=1e-16, rtol=1e-15))
    return None if end is None else Singularity("serial", direction, end)


def matrices_21_22_24(tau: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A_bar, B_bar and C_bar by the indices of (21), (22), (24), which begin at 1, with the rows of `tau` in B_bar."""
    a, b, c = np.zeros((12, 12)), np.zeros((12, 6)), np.zeros((6, 12))
    for k in range(1, 7):
        even, odd = 2 * k, 2 * k - 1
        a[odd - 1, odd] = 1.0  # (21): i = 2 k - 1, j = i + 1
        b[even - 1] = tau[even // 2 - 1]  # (22): i = 2 k
        c[k - 1, 2 * k - 2] = 1.0  # (24): i = k, j = 2 i - 1
    return a, b, c


def inputs_at(robot: RobotParameters, pose: np.ndarray, kind: ForceMapKind) -> np.ndarray | None:
    """M^-1 tau (6, 6) at a pose, with a transmission near zero set to zero; None where `statics` is infinite."""
    legs = leg_geometry(robot, pose)
    transmission = np.where(np.abs(legs.transmission) < DEAD, 0.0, legs.transmission)
    if kind == "statics" and not transmission.all():
        return None
    tau = force_map_of_legs(robot, dataclasses.replace(legs, transmission=transmission), kind)
    return np.asarray(tau / mass_diagonal(robot)[:, None])


def stabilisability_rank(robot: RobotParameters, pose: np.ndarray, kind: ForceMapKind) -> int | None:
    """Rank (28) of [lambda I - A, B] at a pose; None where the map is infinite."""
    at_pose = inputs_at(robot, pose, kind)
    return None if at_pose is None else _hautus(state_matrix(), input_matrix(at_pose))


def _hautus(a: np.ndarray, b: np.ndarray) -> int:
    """Rank of [lambda I - A, B] at the only mode of (25), zero: (28); and with transposed matrices (29).

    Deviation: the test is for Re(lambda) >= 0; the paper prints lambda <= 0 and counts columns of B.
    """
    return int(np.linalg.matrix_rank(np.hstack([-a, b])))


def nonzero_columns(robot: RobotParameters, pose: np.ndarray) -> int:
    """Nonzero columns of the printed B, which the paper counts in place of the rank."""
    return int(np.any(inputs_at(robot, pose, "printed") != 0.0, axis=0).sum())


def radius(at_pose: np.ndarray, gain: np.ndarray, period: float) -> float:
    """Spectral radius of one tick of (25) under u = -gain x, for M^-1 tau (6, 6) at a pose; exact sampled system."""
    a, b = discretize(state_matrix(), input_matrix(at_pose), period)
    return float(np.abs(np.linalg.eigvals(a - b @ gain)).max())


def slowest_decay(at_pose: np.ndarray, gain: np.ndarray, period: float) -> float:
    """Rate [rad/s] at which the slowest mode of the closed loop decays; negative where it grows."""
    return float(-np.log(radius(at_pose, gain, period)) / period)


def gain_of_ratio(at_pose: np.ndarray, period: float, ratio: float) -> np.ndarray:
    return split_gain(at_pose, period, (ratio, ratio, ratio, 1.0))


def whole_gain(a: np.ndarray, b: np.ndarray, q: np.ndarray, r: np.ndarray) -> np.ndarray:
    """K (6, 18) of (31) with P of one Riccati equation of 18 states by Drake, for matrices as of `discretize`."""
    with drake_guard("discrete Riccati equation"):
        p = equation_of_drake()(a, b, q, r)
    return np.linalg.solve(r + b.T @ p @ b, b.T @ p @ a)


def gain_without_discretisation(at_pose: np.ndarray, ratio: float) -> np.ndarray:
    """K (6, 18) of the discrete (31) with the continuous A, B of (25), as in the paper's text."""
    return whole_gain(state_matrix(), input_matrix(at_pose), ratio * np.eye(STATES), np.eye(AXES))


def decay_limit(weights: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> float:
    """Limit of the slowest decay [rad/s] for r -> 0: stable roots of q_v p^4 - q_e p^2 + q_z."""
    q_e, q_v, q_z = weights
    return float(np.sqrt(np.roots([q_v, -q_e, q_z]).astype(complex)).real.min())


def compare_discretisations(at_pose: np.ndarray, period: float, ratio: float) -> dict[str, float]:
    """Euler's gain against the exact one, both on the exact sampled system: difference, slowest decays, radius."""
    exact, a, b = gain_of_ratio(at_pose, period, ratio), state_matrix(), input_matrix(at_pose)
    euler = whole_gain(np.eye(STATES) + period * a, period * b, ratio * np.eye(STATES), np.eye(AXES))
    return {
        "period": period,
        "ratio": ratio,
        "gain": float(np.linalg.norm(euler - exact) / np.linalg.norm(exact)),
        "exact": slowest_decay(at_pose, exact, period),
        "euler": slowest_decay(at_pose, euler, period),
        "radius": radius(at_pose, euler, period),
    }


def reproduce(study: Reproduction) -> Result:
    robot, period = study.base.robot, study.base.lqi.period
    at_home, tau = acceleration_map(robot, robot.home_pose), force_map(robot, robot.home_pose)
    a, b, c = matrices_21_22_24(at_home)
    none = np.zeros((AXES, AXES))
    printed = np.block([[a, np.zeros((12, AXES))], [c, none]]), np.vstack([b, none]), np.hstack([c, np.eye(AXES)])
    ours = state_matrix(), input_matrix(at_home), output_matrix()
    equal = sum(np.array_equal(*pair) for pair in zip(ours, printed, strict=True))
    inputs = {"radius": tau, "right": at_home}
    rows = [
        {"ratio": r} | {k: radius(at_home, gain_of_ratio(m, period, r), period) for k, m in inputs.items()}
        for r in RATIOS
    ]
    unstable = sum(row["radius"] > 1.0 for row in rows)
    ways = ((sign * np.eye(6)[axis], np.pi if axis < 3 else 0.6) for axis in range(6) for sign in (1.0, -1.0))
    singular = [_singular(robot, singularity) for way in ways if (singularity := first_singularity(robot, *way))]
    lowest = min(rank for row in singular for rank in row["rank"].values() if rank is not None)
    rng = np.random.default_rng(SEED)
    ranks = {
        stabilisability_rank(robot, pose, kind)
        for region, kind in itertools.product((NEAR, ANNOUNCED, WIDE), KINDS)
        for pose in sample_poses(robot, region, study.pick(400, 60), rng)
    }
    full = ranks == {STATES}
    detectable = _hautus(state_matrix().T, output_matrix().T)
    gain = gain_of_ratio(at_home, period, 1.0)
    wrong_sign, right_sign = radius(at_home, -gain, period), radius(at_home, gain, period)
    largest = float(max(np.abs(gain_without_discretisation(at_home, r)).max() for r in RATIOS))
    decay = _decay(study, at_home)
    least = {row["ratio"]: row["least"] for row in decay}
    tuned, slow = least[100.0] / least[0.1], max(row["most"] for row in decay)
    numbers = {
        "tau_for_m_inverse_tau": {"period": period, "rows": rows},
        "hautus": {"singular": singular},
        "discretisation": [compare_discretisations(at_home, p, r) for p in PERIODS for r in RATIOS[::2]],
        "decay": {"limit": decay_limit(), "rows": decay},
    }
    claims = [
        Claim("(21), (22), (24): matrices like ours by index", "3", equal, "of 3", equal == 3),
        Claim("(22) with tau for M^-1 tau: unstable ratios", "0", unstable, "of 5", unstable == 0),
        Claim("(28): least rank at random poses", "18", STATES if full else 0, "", full),
        Claim("(28): least rank at singular poses", "18", lowest, "", lowest == STATES),
        Claim("(29): rank", "18", detectable, "", detectable == STATES),
        Claim("(30): spectral radius with u = K e", "< 1", wrong_sign, "", wrong_sign < 1.0),
        Claim("(34): spectral radius with u = -K e", "< 1", right_sign, "", right_sign < 1.0),
        Claim("(31), (32) with continuous A, B: largest gain", "> 0", largest, "", largest > 1e-10),
        Claim("(27): slowest decay at ratio 100 over ratio 0.1", "> 1", tuned, "", tuned > 1.1),
        Claim("(27): slowest decay at the best ratio", "-", slow, "rad/s", None),
    ]
    return Result(numbers, claims)


def _singular(robot: RobotParameters, singularity: Singularity) -> Document:
    axis, pose = int(np.abs(singularity.direction).argmax()), singularity.pose(robot)
    name, unit = COORDINATES[axis]
    return {
        "axis": ("+" if singularity.direction[axis] > 0.0 else "-") + name,
        "at": f"{SCALES[axis] * (pose - robot.home_pose)[axis]:.1f}\u00a0{unit}",
        "kind": singularity.kind,
        "rank": {kind: stabilisability_rank(robot, pose, kind) for kind in KINDS},
        "columns": nonzero_columns(robot, pose),
    }


def _decay(study: Reproduction, at_home: np.ndarray) -> list[dict[str, float]]:
    """Slowest decay of the error [rad/s] by ratio: at home, and the least and most of it in the near box."""
    poses = sample_poses(study.base.robot, NEAR, study.pick(100, 15), np.random.default_rng(SEED), 1e-2)
    maps, period, rows = acceleration_map(study.base.robot, poses), study.base.lqi.period, []
    for ratio in RATIOS:
        home, *rates = (slowest_decay(b, gain_of_ratio(b, period, ratio), period) for b in (at_home, *maps))
        rows.append({"ratio": ratio, "home": home, "least": min(rates), "most": max(rates)})
    return rows
