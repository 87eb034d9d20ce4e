"""The mechanism in an MJCF model: finds its six legs by connectivity, and matches its frames to a robot's.

A leg is a motor that turns a crank, a passive joint from crank to rod, and a passive joint from rod to platform. A
passive joint is a ball, a hinge without a motor, a `connect` equality, or two hinges with a body between them. Points
and directions are in the world frame, in the configuration of the file.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import NamedTuple

import mujoco
import numpy as np

from stewart_drake.mechanics.kinematics import rotation_matrix
from stewart_drake.plant.model_files import crank_lateral
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEG_COUNT

ALLOWED = 1e-3
"""[m] largest misfit between a model and the scenario's robot."""
_SAME_FIT = 1e-5  # [m] difference of fits below which they count as equal.
_ORDERS = np.array(list(permutations(range(LEG_COUNT))))


class Legs(NamedTuple):
    """Legs of a model, in the model's order."""

    motors: list[int]  # Joints.
    cranks: list[int]  # Bodies.
    rods: list[list[int]]  # Bodies between crank and platform, by leg.
    platform: int  # Body.
    closures: list[int]  # Equalities.
    centres: np.ndarray  # (6, 3) [m] centres of the circles on which the cranks' tips move.
    axes: np.ndarray  # (6, 3) [-] axes of the motors.
    tips: np.ndarray  # (6, 3) [m] tips of the cranks.
    seats: np.ndarray  # (6, 3) [m] positions of the platform's joints.
    rod_lengths: np.ndarray  # (6,) [m]

    def ordered(self, order: Sequence[int]) -> Legs:
        """The legs in another order."""
        motors, cranks = ([bodies[leg] for leg in order] for bodies in (self.motors, self.cranks))
        points = (values[list(order)] for values in self[5:])
        return Legs(motors, cranks, [self.rods[leg] for leg in order], self.platform, self.closures, *points)


def connect_ends(model: mujoco.MjModel, data: mujoco.MjData, equality: int) -> list[tuple[int, np.ndarray]]:
    """The two points that a `connect` joins, each with its body and its position in the world (3,) [m]."""
    ids = int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])
    if model.eq_objtype[equality] == mujoco.mjtObj.mjOBJ_SITE:
        return [
            (int(model.site_bodyid[site]), _in_world(data, model.site_bodyid[site], model.site_pos[site]))
            for site in ids
        ]
    places = model.eq_data[equality, :6].reshape(2, 3)
    return [(body, _in_world(data, body, place)) for body, place in zip(ids, places, strict=True)]


def _in_world(data: mujoco.MjData, body: int, place: np.ndarray) -> np.ndarray:
    return np.asarray(data.xpos[body] + data.xmat[body].reshape(3, 3) @ place)


def rigid_roots(model: mujoco.MjModel) -> np.ndarray:
    """(nbody,) for every body, the topmost body that it is rigidly fixed to; 0 for the world."""
    roots = np.arange(model.nbody)
    for body in range(1, model.nbody):
        if model.body_jntnum[body] == 0:
            roots[body] = roots[model.body_parentid[body]]
    return roots


_Ends = list[tuple[int, np.ndarray]]  # Bodies at both ends of a joint, with positions (3,) [m] on them.


class _PassiveJoint(NamedTuple):
    """A passive joint, seen from one of its two bodies."""

    number: int
    equality: int | None  # None for a joint of the tree.
    near: np.ndarray  # (3,) [m] position on this body.
    other: int  # The other body.
    far: np.ndarray  # (3,) [m] position on the other body.


class _FoundLeg(NamedTuple):
    crank: int  # Body.
    between: list[int]  # Bodies from platform to crank.
    tip: np.ndarray  # (3,) [m] of the crank.
    seat: np.ndarray  # (3,) [m] on the platform.
    closures: list[int | None]  # Equalities of its joints.
    length: float  # [m] of the bodies between.


def find_legs(model: mujoco.MjModel, motors: Collection[int], *, welded: bool = False) -> Legs | int:
    """The six legs driven by `motors` (joints); if there are not six, the largest number of legs of a platform.

    With `welded` the bodies of a `weld` are one.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    root, driven = rigid_roots(model), {int(model.jnt_bodyid[joint]): joint for joint in motors}
    for weld in np.flatnonzero((model.eq_type == int(mujoco.mjtEq.mjEQ_WELD)) & model.eq_active0 & welded).tolist():
        one, other = (root[body] for body, _ in connect_ends(model, data, weld))
        root[root == max(one, other)] = min(one, other)
    joints_of: dict[int, list[_PassiveJoint]] = {}
    for number, (equality, ends) in enumerate(_passive(model, data, driven)):
        for (body, near), (other, far) in (ends, ends[::-1]):
            joint = _PassiveJoint(number, equality, near, int(root[other]), far)
            joints_of.setdefault(int(root[body]), []).append(joint)

    def leg(first: _PassiveJoint) -> _FoundLeg | None:
        """Follows passive joints from a platform's joint to a crank; None if they do not lead to one."""
        number, equality, seat, body, place = first
        between, closures, length = list[int](), [equality], 0.0
        while body not in driven:
            onward = [joint for joint in joints_of[body] if joint.number != number]
            if len(onward) != 1 or body in between or body == 0:
                return None
            between.append(body)
            number, equality, near, body, far = onward[0]
            length += float(np.linalg.norm(near - place))
            closures.append(equality)
            place = far
        return _FoundLeg(body, between, place, seat, closures, length) if between else None

    legs_of = {body: list(filter(None, map(leg, first))) for body, first in joints_of.items() if body not in driven}
    platform = max(legs_of, key=lambda body: len(legs_of[body]), default=0)
    legs = legs_of.get(platform, [])
    if len(legs) != LEG_COUNT or len({leg.crank for leg in legs}) != LEG_COUNT:
        return len(legs)
    cranks, rods, tips, seats, closures, lengths = zip(*legs, strict=True)
    joints = [driven[crank] for crank in cranks]
    axes, anchors = data.xaxis[joints], data.xanchor[joints]
    centres = anchors + np.sum(axes * (np.array(tips) - anchors), axis=-1, keepdims=True) * axes
    equalities = [equality for leg in closures for equality in leg if equality is not None]
    points = centres, axes, np.array(tips), np.array(seats), np.array(lengths)
    return Legs(joints, list(cranks), list(rods), platform, equalities, *points)


def _passive(model: mujoco.MjModel, data: mujoco.MjData, driven: Collection[int]) -> Iterator[tuple[int | None, _Ends]]:
    """Passive joints: the equality, or None in the tree; both ends, body and position (3,) [m]."""
    # MuJoCo's enums compare unequal to numpy's integers, so they are converted.
    turning = int(mujoco.mjtJoint.mjJNT_BALL), int(mujoco.mjtJoint.mjJNT_HINGE)
    for body in range(1, model.nbody):
        first, count = model.body_jntadr[body], model.body_jntnum[body]
        if count and body not in driven and np.isin(model.jnt_type[first : first + count], turning).all():
            yield None, [(end, data.xanchor[first].copy()) for end in (body, model.body_parentid[body])]
    for equality in range(model.neq):
        if model.eq_type[equality] == mujoco.mjtEq.mjEQ_CONNECT and model.eq_active0[equality]:
            yield equality, connect_ends(model, data, equality)


@dataclass(frozen=True)
class Fit:
    """Match of a model's legs and frames to a robot's."""

    order: np.ndarray  # (6,) number of the model's leg, by the number of the robot's leg.
    base: tuple[np.ndarray, np.ndarray]  # Rotation (3, 3) [-] and origin (3,) [m] of B in the world.
    platform: tuple[np.ndarray, np.ndarray]  # The same of P, in the configuration of the file.
    signs: np.ndarray  # (6,) [-] -1 for a motor's axis opposite to the robot's; in the robot's order of legs.
    angles: np.ndarray  # (6,) [rad] crank angles in the configuration of the file, up to whole turns; robot's order.
    residual: float  # [m] largest misfit.
    worst: str  # Quantity and leg of the largest misfit.


def fit_frames(robot: RobotParameters, legs: Legs) -> Fit:
    """Matches shafts and platform joints by least squares over all orders of the legs.

    W. Kabsch, Acta Cryst. A32 (1976) 922. Several orders fit equally well if the robot is symmetric. Then the platform
    should be near its home pose, and the base near the world's axes.
    """
    base, base_at, base_error = _rigid(robot.shaft_positions, legs.centres)
    plate, plate_at, plate_error = _rigid(robot.platform_joints, legs.seats)
    cost, home = np.sqrt(base_error + plate_error), robot.home_pose
    rotation_error = np.einsum("nji,njk,lk->nil", base, plate, rotation_matrix(home[:3]))
    distance = np.linalg.norm(np.einsum("nji,nj->ni", base, plate_at - base_at) - home[3:], axis=-1)
    size = np.linalg.norm(robot.shaft_positions - robot.shaft_positions.mean(axis=0), axis=-1).mean()
    score = np.trace(rotation_error, axis1=1, axis2=2) - distance / size + 0.1 * np.trace(base, axis1=1, axis2=2)
    best = int(np.argmax(np.where(cost <= cost.min() + _SAME_FIT, score, -np.inf)))
    order, rotation = _ORDERS[best], base[best]
    arm, axes = (legs.tips - legs.centres)[order] @ rotation, legs.axes[order] @ rotation
    along, up, of_robot = robot.crank_zero_directions, robot.crank_quarter_directions, -crank_lateral(robot)
    signs = np.where(np.sum(axes * of_robot, axis=-1) < 0.0, -1.0, 1.0)
    errors = {
        "motor shaft": robot.shaft_positions @ rotation.T + base_at[best] - legs.centres[order],
        "platform joint": robot.platform_joints @ plate[best].T + plate_at[best] - legs.seats[order],
        "motor axis at a crank's length": robot.crank_lengths[:, None] * (signs[:, None] * axes - of_robot),
        "crank length": (np.linalg.norm(arm, axis=-1) - robot.crank_lengths)[:, None],
        "rod length": (legs.rod_lengths[order] - robot.rod_lengths)[:, None],
    }
    sizes = np.array([np.linalg.norm(error, axis=-1) for error in errors.values()])
    what, leg = np.unravel_index(int(sizes.argmax()), sizes.shape)
    angles = np.arctan2(np.sum(arm * up, axis=-1), np.sum(arm * along, axis=-1))
    frames = (rotation, base_at[best]), (plate[best], plate_at[best])
    return Fit(order, *frames, signs, angles, float(sizes.max()), f"{list(errors)[what]} of leg {leg}")


def _rigid(robot: np.ndarray, model: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Least-squares motions of the robot's points (6, 3) to the model's, for all n orders of the model's points.

    Returns rotations (n, 3, 3), translations (n, 3) and mean square errors (n,).
    """
    robot_centre, model_centre = robot.mean(axis=0), model.mean(axis=0)
    source, target = robot - robot_centre, (model - model_centre)[_ORDERS]
    u, s, vt = np.linalg.svd(np.einsum("nia,ib->nab", target, source))
    s[:, 2] *= (turn := np.sign(np.linalg.det(u @ vt)))
    u[:, :, 2] *= turn[:, None]
    rotation = u @ vt
    error = (np.sum(source**2) + np.sum(target[0] ** 2) - 2.0 * s.sum(axis=-1)) / LEG_COUNT
    return rotation, model_centre - rotation @ robot_centre, np.maximum(error, 0.0)
