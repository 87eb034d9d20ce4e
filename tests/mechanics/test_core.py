"""Numpy, torch and machine code: equal values, gradients that are our Jacobians, batches of robots, nothing raised."""

# ruff: noqa: ARG005 - one signature for all functions of the table
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import ROBOT, ROBOTS, robots_and_poses, vectors

from stewart_drake.compiled import control as compiled_control
from stewart_drake.compiled import dynamics as compiled_dynamics
from stewart_drake.compiled import mechanism
from stewart_drake.control import state_space
from stewart_drake.errors import UnreachablePoseError
from stewart_drake.mechanics import dynamics, dynamics_core, force_map, kinematics, kinematics_core
from stewart_drake.mechanics.arrays import Robot, numpy_robot, robot_like

GRAVITY = 9.81
FUNCTIONS = {
    "reach_margin": lambda r, q, v, a: kinematics.reach_margin(r, q),
    "inverse_kinematics": lambda r, q, v, a: kinematics.inverse_kinematics(r, q),
    "e_l": lambda r, q, v, a: kinematics.leg_geometry(r, q).e_l,
    "e_n": lambda r, q, v, a: kinematics.leg_geometry(r, q).e_n,
    "transmission": lambda r, q, v, a: kinematics.leg_geometry(r, q).transmission,
    "rotation": lambda r, q, v, a: kinematics.leg_geometry(r, q).rotation,
    "rod_lines": lambda r, q, v, a: kinematics.rod_lines(kinematics.leg_geometry(r, q)),
    "twist_jacobian": lambda r, q, v, a: kinematics.twist_jacobian(r, q),
    "pose_jacobian": lambda r, q, v, a: kinematics.pose_jacobian(r, q),
    "crank_rates": lambda r, q, v, a: kinematics.crank_rates(r, kinematics.leg_geometry(r, q), q, v),
    "pose_rate_to_twist": lambda r, q, v, a: kinematics.pose_rate_to_twist(q, v),
    "twist_to_pose_rate": lambda r, q, v, a: kinematics.twist_to_pose_rate(q, v),
    "forward_kinematics": lambda r, q, v, a: kinematics.forward_kinematics(
        r, kinematics.inverse_kinematics(r, q), q + 0.01
    ),
    "forward_kinematics from home": lambda r, q, v, a: kinematics.forward_kinematics(
        r, kinematics.inverse_kinematics(r, q)
    ),
    "forward_kinematics from numbers": lambda r, q, v, a: kinematics.forward_kinematics(
        r, kinematics.inverse_kinematics(r, q), r.home_pose.tolist()
    ),
    "roll_pitch_yaw": lambda r, q, v, a: kinematics.roll_pitch_yaw(kinematics.rotation_matrix(q[..., :3])),
    "rotation_angle": lambda r, q, v, a: kinematics.rotation_angle(kinematics.rotation_matrix(q[..., :3]))[..., None],
    "euler_rate_matrix": lambda r, q, v, a: kinematics.euler_rate_matrix(q[..., :3]),
    "euler_rate_matrix_dot": lambda r, q, v, a: kinematics.euler_rate_matrix_dot(q[..., :3], v[..., :3]),
    "force_map": lambda r, q, v, a: force_map.force_map(r, q),
    "printed force_map": lambda r, q, v, a: force_map.force_map(r, q, "printed"),
    "acceleration by force_map": lambda r, q, v, a: state_space.acceleration_map(r, q),
    "input_matrix": lambda r, q, v, a: state_space.input_matrix(dynamics.pose_acceleration_map(r, q)),
    "static_torque": lambda r, q, v, a: dynamics.static_torque(r, q, GRAVITY),
    "inverse_dynamics": lambda r, q, v, a: dynamics.inverse_dynamics(r, q, v, a, GRAVITY),
    "forward_dynamics": lambda r, q, v, a: dynamics.forward_dynamics(r, q, v, a, GRAVITY),
    "task_inertia": lambda r, q, v, a: dynamics.task_inertia(r, q),
    "task_bias": lambda r, q, v, a: dynamics.task_bias(r, q, v, GRAVITY),
    "pose_acceleration_map": lambda r, q, v, a: dynamics.pose_acceleration_map(r, q),
    "euler_acceleration": lambda r, q, v, a: dynamics.euler_acceleration(q, v, a),
}
"""Every function of the robot, the pose, and two more vectors of six."""


def compiled(robot, pose):
    """What the compiled functions share: packed robot, legs, lines, rotation."""
    packed, legs, lines, turn = mechanism.pack(robot), np.empty((6, 14)), np.empty((6, 6)), np.empty((3, 3))
    assert mechanism.leg_vectors(packed, pose, legs) == -1
    mechanism.rod_lines(legs, lines)
    mechanism.rotation(pose[:3], turn)
    return packed, legs, lines, turn


def filled(shape, function, *arguments):
    """What a compiled function writes into its last argument."""
    out = np.empty(shape)
    assert function(*arguments, out) in (None, True)
    return out


def compiled_forward_kinematics(robot, pose):
    found = pose + 0.01
    theta = kinematics.inverse_kinematics(robot, pose)
    assert mechanism.forward_kinematics(mechanism.pack(robot), theta, found, 1e-12, 12) <= 1e-12
    return found


def compiled_inverse_dynamics(robot, pose, rate, acceleration):
    twist, twist_rate = kinematics.pose_rate_to_twist(pose, rate), kinematics.pose_rate_to_twist(pose, acceleration)
    twist_rate[:3] += filled(3, mechanism.euler_drift, pose[:3], rate[:3])
    return filled(6, compiled_dynamics.inverse_dynamics, *compiled(robot, pose), twist, twist_rate, GRAVITY)


def compiled_twist_to_pose_rate(pose, twist):
    rate = twist.copy()
    mechanism.euler_rates(pose[:3], rate[:3])
    return rate


COMPILED = {
    "reach_margin": lambda r, q, v, a: compiled(r, q)[1][:, 13],
    "e_l": lambda r, q, v, a: compiled(r, q)[1][:, 9:12],
    "e_n": lambda r, q, v, a: compiled(r, q)[1][:, 6:9],
    "transmission": lambda r, q, v, a: compiled(r, q)[1][:, 12],
    "rotation": lambda r, q, v, a: compiled(r, q)[3],
    "rod_lines": lambda r, q, v, a: compiled(r, q)[2],
    "pose_rate_to_twist": lambda r, q, v, a: np.concatenate(
        [filled(3, mechanism.angular_velocity, q[:3], v[:3]), v[3:]]
    ),
    "twist_to_pose_rate": lambda r, q, v, a: compiled_twist_to_pose_rate(q, v),
    "forward_kinematics": lambda r, q, v, a: compiled_forward_kinematics(r, q),
    "inverse_dynamics": lambda r, q, v, a: compiled_inverse_dynamics(r, q, v, a),
    "task_inertia": lambda r, q, v, a: filled((6, 6), compiled_dynamics.task_inertia, *compiled(r, q)),
    "pose_acceleration_map": lambda r, q, v, a: acceleration_map(r, q).T,
}
"""Those of them that are compiled as well, for one pose."""


def acceleration_map(robot, pose):
    packed, *legs = compiled(robot, pose)
    return filled((6, 6), compiled_control.acceleration_map, packed, True, False, pose, *legs)


def tensors(*arrays):
    return [torch.tensor(np.array(array), dtype=torch.float64) for array in arrays]


def some_poses(robot, shape, seed=0):
    rng = np.random.default_rng(seed)
    pose = robot.home_pose + rng.uniform(-1.0, 1.0, (*shape, 6)) * [0.2, 0.2, 0.2, 0.03, 0.03, 0.01]
    return pose, *rng.normal(size=(2, *shape, 6))


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize(
    "robot",
    # The least alike of them is for daily work.
    [pytest.param(r, marks=() if name == "unequal" else pytest.mark.slow, id=name) for name, r in ROBOTS.items()],
)
def test_numpy_torch_and_numba_give_the_same_over_any_leading_axes(robot, name):
    for shape in ((), (3,), (2, 3)):
        arrays = some_poses(robot, shape)
        traced = (tensor.requires_grad_() for tensor in tensors(*arrays))
        expected, found = FUNCTIONS[name](robot, *arrays), FUNCTIONS[name](robot, *traced)
        assert type(expected) is np.ndarray
        assert isinstance(found, torch.Tensor)
        assert found.dtype == torch.float64
        assert found.requires_grad
        scale = max(1.0, np.abs(expected).max())
        np.testing.assert_allclose(found.detach().numpy(), expected, rtol=0.0, atol=1e-12 * scale)
        for index in np.ndindex(shape):
            one = FUNCTIONS[name](robot, *(array[index] for array in arrays))
            np.testing.assert_allclose(expected[index], one, rtol=0.0, atol=1e-11 * scale)
            if name in COMPILED:
                fast = COMPILED[name](robot, *(array[index].copy() for array in arrays))
                np.testing.assert_allclose(fast, one, rtol=0.0, atol=1e-11 * scale)


WAYS = {
    "by place": lambda f, p, names: f(ROBOT, *p),
    "by name": lambda f, p, names: f(ROBOT, p[0], **dict(zip(names[1:], p[1:], strict=True))),
    "all by name": lambda f, p, names: f(robot=ROBOT, **dict(zip(names, p, strict=True))),
    "as lists": lambda f, p, names: f(ROBOT, *(array.tolist() for array in p)),
    "list by name": lambda f, p, names: f(ROBOT, *p[:-1], **{names[-1]: p[-1].tolist()}),
}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize(
    ("function", "names"),
    [
        (dynamics.inverse_dynamics, ("pose", "pose_rate", "pose_acceleration")),
        (dynamics.forward_dynamics, ("pose", "pose_rate", "torque")),
        (dynamics.task_bias, ("pose", "twist")),
        (kinematics.inverse_kinematics, ("pose",)),
        (kinematics.pose_jacobian, ("pose",)),
    ],
)
def test_many_poses_give_what_each_gives_in_whatever_way_they_are_passed(function, names, way):
    for shape in ((3000,), (2, 1500)):
        arrays = some_poses(ROBOT, shape)[: len(names)]
        found = WAYS[way](function, arrays, names)
        some = slice(None, None, 300)
        expected = function(ROBOT, *(array.reshape(-1, 6)[some] for array in arrays))
        assert found.shape == shape + expected.shape[1:]
        np.testing.assert_allclose(found.reshape(-1, *expected.shape[1:])[some], expected, rtol=1e-10, atol=1e-10)


@pytest.mark.slow
@settings(max_examples=20, deadline=None)
@given(at=robots_and_poses(), rate=vectors(6, 2.0), acceleration=vectors(6, 5.0))
def test_gradients_are_our_jacobians_and_finite_differences(at, rate, acceleration):
    robot, pose = at
    q, v, a = tensors(pose, rate, acceleration)
    jacobian = torch.autograd.functional.jacobian(lambda x: kinematics.inverse_kinematics(robot, x), q)
    np.testing.assert_allclose(jacobian.numpy(), kinematics.pose_jacobian(robot, pose), rtol=1e-9, atol=1e-9)
    by_acceleration = torch.autograd.functional.jacobian(lambda x: dynamics.inverse_dynamics(robot, q, v, x), a)
    by_torque = dynamics.pose_acceleration_map(robot, pose)
    np.testing.assert_allclose(by_acceleration.numpy() @ by_torque, np.eye(6), atol=1e-7)
    for k in range(3):
        at_step = [[pose, rate, acceleration] for _ in range(4)]
        for values, share in zip(at_step, (-2.0, -1.0, 1.0, 2.0), strict=True):
            values[k] = values[k] + share * 1e-4 * np.ones(6)
        far, near, beyond, farther = (dynamics.inverse_dynamics(robot, *values) for values in at_step)
        numerical = (far - 8.0 * near + 8.0 * beyond - farther) / 12e-4
        inputs = tensors(pose, rate, acceleration)
        _, along = torch.autograd.functional.jvp(
            lambda x, k=k, i=inputs: dynamics.inverse_dynamics(robot, *i[:k], x, *i[k + 1 :]), inputs[k],
            torch.ones(6, dtype=torch.float64),
        )  # fmt: skip
        np.testing.assert_allclose(along.numpy(), numerical, rtol=1e-5, atol=1e-5)


def test_a_batch_of_robots_is_each_robot_alone():
    robots = list(ROBOTS.values())
    pose, rate, torque = some_poses(ROBOT, (5, len(robots)))
    batch = robot_like(robots, pose)
    for name, function in FUNCTIONS.items():
        if name.startswith("forward_kinematics") or "force_map" in name:
            continue
        together = function(batch, pose, rate, torque)
        for k, robot in enumerate(robots):
            alone = function(robot, pose[:, k], rate[:, k], torque[:, k])
            scale = max(1.0, np.abs(alone).max())
            np.testing.assert_allclose(together[:, k], alone, rtol=0.0, atol=1e-11 * scale, err_msg=name)
    many = dynamics.static_torque(batch, ROBOT.home_pose[None])
    assert many.shape == (len(robots), 6)
    np.testing.assert_allclose(many[3], dynamics.static_torque(robots[3], ROBOT.home_pose), rtol=1e-11)


def test_gradients_by_the_robots_own_numbers_agree_with_finite_differences():
    pose, rate, acceleration = some_poses(ROBOT, ())
    inputs = tensors(pose, rate, acceleration)
    own = robot_like(ROBOTS["unequal"], inputs[0])

    def torque(*fields):
        return dynamics.inverse_dynamics(Robot(*fields), *inputs).sum()

    gradients = torch.autograd.functional.jacobian(torque, tuple(own))
    rng = np.random.default_rng(1)
    for name, field, gradient in zip(Robot._fields, own, gradients, strict=True):
        along = torch.tensor(rng.normal(size=field.shape), dtype=torch.float64)
        ends = [torque(*own._replace(**{name: field + share * along})) for share in (-1e-6, 1e-6)]
        expected = float(ends[1] - ends[0]) / 2e-6
        assert float((gradient * along).sum()) == pytest.approx(expected, rel=1e-6, abs=1e-6), name


def singular_pose(kind):
    home = ROBOT.home_pose
    if kind == "serial":  # the platform joint of leg 0 straight above its shaft, crank and rod in one line
        pose = home.copy()
        reach = ROBOT.crank_length + ROBOT.rod_length
        span = ROBOT.platform_joints[0] + pose[3:] - ROBOT.shaft_positions[0]
        return np.concatenate([np.zeros(3), pose[3:] + span * (reach / np.linalg.norm(span) - 1.0)])
    if kind == "unreachable":
        return np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.8])
    pose = np.zeros(6)  # a platform joint on a motor axis
    pose[3:] = ROBOT.shaft_positions[0] - ROBOT.platform_joints[0] - np.array([0.0, 0.3, 0.0])
    return pose


@pytest.mark.parametrize("kind", ["serial", "unreachable", "on the motor axis"])
def test_the_core_raises_nothing_and_its_gradients_stay_finite_where_the_shells_raise(kind):
    pose = np.stack([ROBOT.home_pose, singular_pose(kind)])
    q, v, a = (x.requires_grad_() for x in tensors(pose, *some_poses(ROBOT, (2,))[1:]))
    own = robot_like(ROBOT, q)
    legs = kinematics_core.legs_at(own, q)
    results = (
        kinematics_core.crank_angles(legs.cranks),
        dynamics_core.inverse_dynamics(own, legs, q, v, a, GRAVITY),
        dynamics_core.forward_dynamics(own, legs, q, v, a, GRAVITY),
        dynamics_core.task_inertia(own, legs),
        dynamics_core.static_torque(own, legs, GRAVITY),
    )
    for result in results:
        gradients = torch.autograd.grad(result.sum(), [q, v, a], retain_graph=True, allow_unused=True)
        for tensor in (result, *(gradient for gradient in gradients if gradient is not None)):
            assert torch.isfinite(tensor).all()
    worst = kinematics_core.reach_margin(own, q)[:, 1].min().detach()
    assert float(worst) < (1e-12 if kind == "serial" else 0.0)
    if kind != "serial":
        for given in (pose, q):
            with pytest.raises(UnreachablePoseError) as caught:
                dynamics.static_torque(ROBOT, given)
            np.testing.assert_array_equal(caught.value.pose, pose[1])


@settings(max_examples=20)
@given(rpy=st.tuples(st.floats(-3.0, 3.0), st.floats(-1.4, 1.4), st.floats(-3.0, 3.0)).map(np.array), rate=vectors(6))
def test_euler_rates_of_components_are_those_of_the_matrices(rpy, rate):
    pose = np.concatenate([rpy, np.zeros(3)])
    matrix = kinematics.euler_rate_matrix(rpy)
    np.testing.assert_allclose(kinematics_core.angular_velocity(pose, rate), matrix @ rate[:3], atol=1e-14)
    drift = kinematics.euler_rate_matrix_dot(rpy, rate[:3]) @ rate[:3]
    np.testing.assert_allclose(kinematics_core.angular_drift(pose, rate), drift, atol=1e-14)
    np.testing.assert_allclose(kinematics_core.euler_rates(pose, matrix @ rate[:3]), rate[:3], atol=1e-13)


def test_arrays_of_a_robot_are_its_own_and_cannot_be_changed():
    own = numpy_robot(ROBOT)
    assert all(not field.flags.writeable for field in own)
    copied = robot_like(ROBOT, torch.zeros(1, dtype=torch.float64))
    assert all(torch.equal(field, torch.tensor(np.array(value))) for field, value in zip(copied, own, strict=True))
