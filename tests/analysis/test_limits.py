import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.math import RollPitchYaw
from scipy.optimize import minimize_scalar
from strategies import ROBOT, poses, vectors

from stewart_drake import ReferenceLimits, inverse_dynamics, inverse_kinematics, leg_geometry
from stewart_drake.mechanics.kinematics import conditioning, pose_jacobian, reach_margin
from stewart_drake.mechanics.pose_margins import segment_distance as distance_of
from stewart_drake.scenario.limits import PLACES, limit_margins

ALL = ReferenceLimits()
NONE = ReferenceLimits(**dict.fromkeys(ReferenceLimits.__pydantic_fields__))
GRAVITY = 9.81


def margins_at(pose, rate=None, acceleration=None, within=ALL, robot=ROBOT):
    zero = np.zeros(6)
    one = [zero if v is None else v for v in (pose, rate, acceleration)]
    return {k: v[0] for k, v in limit_margins(robot, within, *np.array(one)[:, None], GRAVITY).items()}


def segment_distance(a, b, c, d):
    a, b, c, d = (np.array(point, dtype=float) for point in (a, b, c, d))
    return distance_of(a, b - a, c, d - c)


def brute_distance(a, b, c, d):
    """Minimum over s in [0, 1] of the distance of one point of the first segment to the second; convex in s.

    The minimiser stops near the square root of rounding, so 1e-6 is what it can vouch for.
    """

    def from_point(s):
        point = a + s * (b - a)
        along, length = d - c, (d - c) @ (d - c)
        t = np.clip((point - c) @ along / length, 0.0, 1.0) if length > 0.0 else 0.0
        return np.linalg.norm(point - c - t * along)

    inside = minimize_scalar(from_point, bounds=(0.0, 1.0), method="bounded", options={"xatol": 1e-10, "maxiter": 200})
    return min(inside.fun, from_point(0.0), from_point(1.0))


@given(points=st.lists(st.integers(-2, 2), min_size=12, max_size=12).map(np.array) | vectors(12))
def test_segment_distance_is_the_minimum_over_both_segments_parallel_touching_or_of_no_length(points):
    a, b, c, d = points.reshape(4, 3).astype(float)
    assert segment_distance(a, b, c, d) == pytest.approx(brute_distance(a, b, c, d), abs=1e-6)


@pytest.mark.parametrize("turn", [0.0, -2.0 * np.pi])
def test_a_crank_keeps_within_its_stops_and_one_without_them_anywhere(turn):
    pose = ROBOT.home_pose + [0.0, 0.0, 0.0, 0.0, 0.0, 0.02]
    theta = inverse_kinematics(ROBOT, pose)
    robot = ROBOT.replace(legs=[{"crank_angle_range": (-0.5 + turn, 0.6 + turn)}] + [{}] * 5)
    found = margins_at(pose, within=NONE, robot=robot)["crank_range"]
    assert found[0] == pytest.approx(min(theta[0] + 0.5, 0.6 - theta[0]))
    assert (found[1:] >= np.pi).all()


@given(pose=poses(), rate=vectors(6, 2.0), acceleration=vectors(6, 20.0))
def test_margins_are_the_limits_minus_what_kinematics_and_dynamics_give(pose, rate, acceleration):
    margins = margins_at(pose, rate, acceleration)
    np.testing.assert_allclose(margins["reach"], 0.98 - (1.0 - reach_margin(ROBOT, pose)), atol=1e-14)
    np.testing.assert_allclose(margins["euler_pitch"], np.radians(85.0) - abs(pose[1]), rtol=1e-14)
    np.testing.assert_allclose(margins["conditioning"], conditioning(ROBOT, pose) - 0.05, atol=1e-13)
    np.testing.assert_allclose(margins["transmission"], leg_geometry(ROBOT, pose).transmission - 0.2, atol=1e-14)
    speed = pose_jacobian(ROBOT, pose) @ rate
    np.testing.assert_allclose(margins["crank_speed"], 10.0 - np.abs(speed), rtol=1e-10, atol=1e-10)
    torque = inverse_dynamics(ROBOT, pose, rate, acceleration, GRAVITY)
    np.testing.assert_allclose(margins["torque"], 5.0 - np.abs(torque), rtol=1e-10, atol=1e-10)


@given(pose=poses())
def test_joint_swing_is_the_angle_of_the_rod_seen_by_its_two_neighbours(pose):
    def rods(at):
        legs, z = leg_geometry(ROBOT, at), np.array([0.0, 0.0, 1.0])
        ball, universal = legs.e_l @ RollPitchYaw(at[:3]).ToRotationMatrix().matrix(), []
        for h, theta, rod in zip(ROBOT.crank_zero_directions, legs.crank_angles, legs.e_l, strict=True):
            along, across = np.cos(theta) * h + np.sin(theta) * z, -np.sin(theta) * h + np.cos(theta) * z
            universal.append(np.array([along, np.cross(z, h), across]) @ rod)
        return np.concatenate([ball, universal])

    cosine = np.sum(rods(pose) * rods(ROBOT.home_pose), axis=-1)
    swing = ALL.joint_swing - margins_at(pose)["joint_swing"]
    np.testing.assert_allclose(np.cos(swing), cosine, atol=1e-14)
    assert np.all(swing >= 0.0)


@settings(max_examples=10)
@given(pose=poses(), radius=st.sampled_from([0.005, 0.012]))
def test_clearance_is_the_distance_of_the_two_named_links_of_two_legs_between_their_surfaces(pose, radius):
    margins = margins_at(pose, robot=ROBOT.replace(link_radius=radius))["clearance"]
    assert len({where for _, where in PLACES["clearance"]}) == len(margins) == 60
    legs = leg_geometry(ROBOT, pose)
    tips = ROBOT.shaft_positions + ROBOT.crank_length * legs.crank
    joints = legs.arm + pose[3:]
    ends = {f"crank {i}": (ROBOT.shaft_positions[i], tips[i]) for i in range(6)}
    ends |= {f"rod {i}": (tips[i], joints[i]) for i in range(6)}
    for (leg, name), margin in zip(PLACES["clearance"], margins, strict=True):
        one, other = name.split(" to ")
        assert leg == int(one.split()[1]) != int(other.split()[1])
        gap = segment_distance(*ends[one], *ends[other]) - 2 * radius
        assert margin == pytest.approx(gap - 0.005, abs=1e-14)


def test_a_parallel_singularity_jumped_over_between_two_samples_counts():
    singular = 1.549023038254185
    pose = np.tile(ROBOT.home_pose, (3, 1))
    pose[:, 2] = singular - 0.1, singular + 0.015, singular - 0.1
    values = limit_margins(ROBOT, ReferenceLimits(conditioning=1e-4), pose, 0.0 * pose, 0.0 * pose, GRAVITY)[
        "conditioning"
    ]
    alone = conditioning(ROBOT, pose)
    np.testing.assert_allclose(values[:, 0], [alone[0] - 1e-4, -alone[1] - 1e-4, alone[2] - 1e-4], atol=1e-12)
    assert alone.min() > 1e-4
