"""Which poses tell most: a D-optimal choice among poses within the robot's limits."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from stewart_drake.calibration.frames import Frame
from stewart_drake.calibration.measurements import MeasurementNoise, Measurements
from stewart_drake.calibration.model import Model
from stewart_drake.calibration.parameters import LARGEST, OF_ROBOT, SIZE, FrameName, Name, free_directions, scales
from stewart_drake.calibration.result import IN_THOUSANDTHS
from stewart_drake.errors import ConfigurationError
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.mechanics.kinematics import inverse_kinematics, rotation_matrix
from stewart_drake.planning.limits import Limits, limit_bounds
from stewart_drake.planning.measures import measure_poses
from stewart_drake.planning.workspace import LIMIT_NAMES, governing_limit, utilisation
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEGS

CANDIDATES = 1500
MARGIN = 0.85
"""[-] of each limit that a pose may take up: the robot is not quite the guess."""
AMPLIFICATION = 1.3
"""[-] most by which parameters act on a pose more than at home. Poses near a parallel singularity tell much, but a
robot that is not quite the guess cannot be assembled there. With both numbers each of a hundred robots of any of the
three shipped kinds, off by 1 mm and 1 mrad, could be at the cranks' angles of a plan of 60 poses."""
_STEPS, _FARTHEST = 40, 2.0
_PASSES, _DRAWS = 20, 20
_GAIN = 1e-6


@dataclass(frozen=True, eq=False)
class PosePlan:
    """Poses to measure.

    Attributes:
        targets: Poses of P in B and crank angles of the guess, as a file of measured poses has them.
        half_width: (78,) [m, rad] of the 95 % intervals to expect, by the stated noise.
        random_half_width: (78,) [m, rad] the same for as many poses drawn at random from the candidates.
        gain: [-] by which the random poses' intervals are wider, in the geometric mean over all directions.
    """

    targets: Measurements
    half_width: np.ndarray
    random_half_width: np.ndarray
    gain: float

    def table(self) -> tuple[list[str], list[list[str]]]:
        """Header and rows: the largest interval of any leg to expect of these poses, and at random, in mm and mrad."""
        both = (self.half_width, self.random_half_width)
        widths = np.stack([1e3 * each[:OF_ROBOT].reshape(LEGS, -1).max(axis=0) for each in both], axis=-1).tolist()
        cells = [[f"{width:.2g}" if width > 0.0 else "held" for width in row] for row in widths]
        return ["", "planned", "at random"], [[name, *row] for name, row in zip(IN_THOUSANDTHS, cells, strict=True)]


def plan_poses(
    robot: RobotParameters,
    count: int,
    limits: Limits | None = None,
    noise: MeasurementNoise | None = None,
    known_frames: Collection[FrameName] = (),
    hold: Collection[Name] = (),
    seed: int = 0,
    candidates: int = CANDIDATES,
) -> PosePlan:
    """Poses that tell a robot's parameters best: the largest determinant of what they tell, by Fedorov's exchange.

    V. V. Fedorov, Theory of Optimal Experiments (1972). Begun with the pose that adds most, one after the other; then
    each is taken out and the best of all put in its place, until none is better. What is known before the first pose
    is that no direction is off by more than a tenth of the robot's size.

    Args:
        robot: The guess.
        count: How many poses.
        limits: What poses keep to, on the straight way from home too, with a twentieth to spare.
        noise: Of tracker and encoders.
        known_frames: As for `calibrate`.
        hold: As for `calibrate`.
        seed: Of the candidates.
        candidates: How many poses to choose from.

    Raises:
        ConfigurationError: Fewer poses than tell all parameters, or more than candidates; home breaks a limit.
    """
    noise = MeasurementNoise() if noise is None else noise
    rng = np.random.default_rng(seed)
    free = free_directions(robot, known_frames, hold)
    least = free.shape[1] // 6 + 1
    if not least <= count <= candidates // 2:
        raise ConfigurationError("--plan", count, f"a number of poses from {least} to {candidates // 2}")
    pose = candidate_poses(robot, candidates, Limits() if limits is None else limits, rng)
    at, angles, model = _frames(pose), inverse_kinematics(robot, pose), Model(robot)
    ways = scales(robot)[:, None] * free
    slope = model.tracker_slope(np.zeros(SIZE), at, angles)
    rows = model.whitening(np.zeros(SIZE), at, angles, noise) @ slope @ ways
    chosen = _exchange(rows, count)
    told = [_covariance(rows[each]) for each in (chosen, *rng.choice(len(pose), (20, count)))]
    widths = [1.96 * np.linalg.norm(ways @ np.linalg.cholesky(each), axis=1) for each in told]
    volume = [np.linalg.slogdet(each)[1] / (2.0 * free.shape[1]) for each in told]
    return PosePlan(
        Measurements(pose[chosen], angles[chosen], "planned poses"),
        widths[0],
        np.median(widths[1:], axis=0),
        float(np.exp(np.mean(volume[1:]) - volume[0])),
    )


def candidate_poses(
    robot: RobotParameters, count: int, limits: Limits, rng: np.random.Generator, margin: float = MARGIN
) -> np.ndarray:
    """Poses (count, 6) [rad, m] on straight ways from home in all directions, up to where a limit ends them."""
    home, size = robot.home_pose, np.array([1.0] * 3 + [robot.characteristic_length] * 3)
    found = np.empty((0, 6))
    for _ in range(_DRAWS):
        way = rng.standard_normal((count, 6)) * size
        way /= np.linalg.norm(way / size, axis=1, keepdims=True)
        last = _ends(robot, limits, home, way, margin)
        # Nearer to the end than to home, where poses tell more; the step before the last holds the limits.
        share = rng.uniform(0.0, 1.0, count) ** (1.0 / 3.0)
        pose = (home + (last * share)[:, None] * way)[last > 0.0]
        calm = _amplification(robot, pose) <= AMPLIFICATION * _amplification(robot, home[None])
        found = np.concatenate([found, pose[calm]])
        if len(found) >= count:
            return found[:count]
    raise ConfigurationError("limits", f"{len(found)} poses of {_DRAWS * count} tries", "limits that leave more room")


def _ends(robot: RobotParameters, limits: Limits, home: np.ndarray, way: np.ndarray, margin: float) -> np.ndarray:
    """How far (n,) along ways (n, 6) from home all limits hold, in whole steps."""
    torque = limit_bounds(robot, limits).get("torque")
    last, going = np.zeros(len(way)), np.arange(len(way))
    for step in np.linspace(0.0, _FARTHEST, _STEPS + 1):
        pose = home + step * way[going]
        measures = measure_poses(robot, pose, STANDARD_GRAVITY, torque)
        use, limit = governing_limit(utilisation(robot, limits, pose, measures))
        if step == 0.0 and use[0] > margin:
            got = f"a limit {LIMIT_NAMES[limit[0]]} of which home takes {use[0]:.3g}"
            raise ConfigurationError("limits", got, f"limits of which the home pose uses at most {margin:g}")
        going = going[use <= margin]
        last[going] = step
        if going.size == 0:
            break
    return last


def _frames(pose: np.ndarray) -> Frame:
    return Frame(rotation_matrix(pose[:, :3]), pose[:, 3:])


def _amplification(robot: RobotParameters, pose: np.ndarray) -> np.ndarray:
    """Size (n,) of the derivatives of poses (n, 6) by a robot's parameters, both in `scales`."""
    size = scales(robot)
    slope = Model(robot).tracker_slope(np.zeros(SIZE), _frames(pose), inverse_kinematics(robot, pose))
    return np.asarray(np.linalg.norm(slope[..., :OF_ROBOT] * size[:OF_ROBOT] / size[-6:, None], axis=(1, 2)))


def _exchange(rows: np.ndarray, count: int) -> np.ndarray:
    """Indices (count,) of rows (n, 6, k) with the largest determinant of what they tell together."""

    def gains(covariance: np.ndarray, some: np.ndarray) -> np.ndarray:
        return np.asarray(np.linalg.slogdet(np.eye(6) + some @ covariance @ np.swapaxes(some, -1, -2))[1])

    def best(covariance: np.ndarray, chosen: list[int]) -> tuple[int, float]:
        gain = gains(covariance, rows)
        gain[chosen] = -np.inf
        return int(gain.argmax()), float(gain.max())

    chosen: list[int] = []
    for _ in range(count):
        chosen.append(best(_covariance(rows[chosen]), chosen)[0])
    for _ in range(_PASSES):
        won = 0.0
        for place, now in enumerate(list(chosen)):
            rest = chosen[:place] + chosen[place + 1 :]
            covariance = _covariance(rows[rest])
            had = float(gains(covariance, rows[now]))
            other, gain = best(covariance, rest)
            if gain > had + _GAIN:
                won += gain - had
                chosen[place] = other
        if won < _GAIN:
            break
    return np.array(chosen)


def _covariance(rows: np.ndarray) -> np.ndarray:
    """Of the directions (k, k), from what is known before and from rows (n, 6, k)."""
    flat = rows.reshape(-1, rows.shape[2])
    return np.linalg.inv(flat.T @ flat + np.eye(flat.shape[1]) / LARGEST**2)
