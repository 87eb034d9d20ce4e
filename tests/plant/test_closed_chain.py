"""The closed chain in six coordinates: machine code and reference alike, mechanics' laws, and Drake's plant."""

import itertools

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from pydrake.systems.analysis import Simulator
from scipy.integrate import solve_ivp
from strategies import ALTERNATING, UNEQUAL, vectors

from stewart_drake.errors import ConfigurationError, SingularPoseError
from stewart_drake.mechanics import dynamics_core, kinematics_core
from stewart_drake.mechanics.arrays import numpy_robot
from stewart_drake.mechanics.dynamics import forward_dynamics, static_torque
from stewart_drake.mechanics.kinematics import inverse_kinematics, leg_geometry, reach_margin
from stewart_drake.plant.closed_chain import ChainState, ClosedChain, advanced, loaded, starting_state
from stewart_drake.plant.multibody_plant import build_plant
from stewart_drake.plant.plant_options import PlantOptions
from stewart_drake.robot import RobotParameters
from stewart_drake.sampling import on_grid

GRAVITY = 9.81
PAPER = RobotParameters()
HEAVY = RobotParameters(rod_mass=0.8, rod_inertia=(0.016, 0.016, 1e-5), crank_mass=0.4)
OFF = RobotParameters(
    platform_center_of_mass=(0.01, -0.02, 0.03),
    platform_inertia=(0.003, 0.004, 0.006),
    platform_products=(1e-4, -2e-4, 1e-4),
)
robots = st.sampled_from([PAPER, HEAVY, OFF, ALTERNATING, UNEQUAL])
HALF = np.array([0.2, 0.2, 0.2, 0.02, 0.02, 0.015])
RUBBING = {"coulomb": 0.02, "break_away": 0.03, "viscous": 0.002}
STILL, NO_PUSH = np.zeros(6), np.zeros(6)
MOVING = np.array([0.3, -0.2, 0.4, 0.03, -0.02, 0.05])


def stepped(chain, state, torque, count, push=NO_PUSH):
    """States (count + 1, 36), each a row."""
    rows = np.empty((count + 1, 36))
    rows[0] = np.concatenate(state)
    for now, then in itertools.pairwise(rows):
        chain.advance(torque, push, now, then)
    return rows


def state_of(row):
    return ChainState(*row.reshape(6, 6))


@settings(max_examples=40)
@given(
    robots, vectors(6), vectors(6, 2.0), vectors(6, 1.0), vectors(6, 3.0), st.booleans(), st.sampled_from([1e-4, 2e-3])
)
def test_machine_code_is_the_reference(robot, offset, rate, torque, push, rubs, step):
    pose = robot.home_pose + HALF * offset
    assume(reach_margin(robot, pose).min() > 0.05)
    options = PlantOptions.from_dict(
        {
            "time_step": step,
            "payload_mass": 0.4,
            "payload_position": [0.02, -0.01, 0.05],
            **({"friction": RUBBING} if rubs else {}),
        }
    )
    torque = torque * robot.effort_limits
    rows = stepped(ClosedChain(robot, options, GRAVITY), starting_state(robot, pose, rate), 2.0 * torque, 4, push)
    own, law, state = loaded(robot, options), options.friction_law(robot), starting_state(robot, pose, rate)
    held = np.clip(2.0 * torque, -robot.effort_limits, robot.effort_limits)
    for row in rows[1:]:
        state = advanced(own, law, GRAVITY, on_grid(step), held, push, state)
        scale = np.maximum(1.0, np.abs(np.concatenate(state)))
        np.testing.assert_allclose(row / scale, np.concatenate(state) / scale, atol=1e-9)


def exact(robot, pose, rate, torque, seconds):
    """Pose and rate after so long, by a fine integration of the model's own equation."""

    def change(_, y):
        return np.concatenate([y[6:], forward_dynamics(robot, y[:6], y[6:], torque, GRAVITY)])

    return solve_ivp(change, (0.0, seconds), np.concatenate([pose, rate]), rtol=1e-10, atol=1e-12).y[:, -1]


@pytest.mark.parametrize("robot", [PAPER, OFF, UNEQUAL], ids=["paper", "centre off", "unequal legs"])
def test_it_converges_to_the_equation_of_motion_with_order_one(robot):
    torque = 1.1 * static_torque(robot, robot.home_pose) + 0.02
    wanted = exact(robot, robot.home_pose, MOVING, torque, 0.08)
    errors = []
    for step in (1e-3, 5e-4, 2.5e-4):
        chain = ClosedChain(robot, PlantOptions(time_step=step), GRAVITY)
        rows = stepped(chain, starting_state(robot, robot.home_pose, MOVING), torque, round(0.08 / step))
        errors.append(np.abs(rows[-1, :12] - wanted).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(orders, 1.0, atol=0.15)


def energy(robot, options, state):
    own = loaded(robot, options)
    legs = kinematics_core.legs_at(own, state.pose)
    inertia = dynamics_core.task_inertia(own, legs)
    # Height of all that has weight: what gravity's torque would do is the derivative of this.
    tips = leg_geometry(robot, state.pose)
    crank = robot.crank_lengths * tips.crank[:, 2]
    joints = state.pose[5] + tips.arm[:, 2]
    height = (legs.rotation @ own.platform_moment)[2] + own.platform_mass * state.pose[5]
    height += np.sum(0.5 * own.rod_mass * (crank + joints) + 0.5 * own.crank_mass * crank)
    return 0.5 * state.twist @ inertia @ state.twist + GRAVITY * height


@pytest.mark.parametrize("robot", [PAPER, HEAVY, OFF], ids=["paper", "heavy legs", "centre off"])
@pytest.mark.parametrize("push", [NO_PUSH, np.array([0.1, -0.05, 0.08, 1.0, -2.0, 1.5])], ids=["free", "pushed"])
def test_energy_changes_by_the_work_of_motors_and_pushes(robot, push):
    """Up to the order of the method: a step of a tenth leaves a tenth."""
    torque, left = static_torque(robot, robot.home_pose) * 1.05, []
    for step in (1e-3, 1e-4):
        options = PlantOptions.from_dict({"time_step": step, "payload_mass": 0.3, "payload_position": [0, 0.02, 0.04]})
        start = starting_state(robot, robot.home_pose, MOVING)
        rows = stepped(ClosedChain(robot, options, GRAVITY), start, torque, round(0.05 / step), push)
        work = np.sum(torque * (rows[-1] - rows[0])[18:24]) + np.sum(rows[1:, 12:18] @ push) * step
        left.append(energy(robot, options, state_of(rows[-1])) - energy(robot, options, start) - work)
    assert abs(left[1]) < 2e-4
    assert left[1] / left[0] == pytest.approx(0.1, abs=0.02)


@pytest.mark.parametrize(
    ("changes", "bound"),
    [
        ({}, 5e-5),
        ({"friction": RUBBING}, 5e-5),
        ({"payload_mass": 0.5, "payload_position": [0.02, 0.01, 0.05]}, 5e-5),
        ({"time_step": 1e-4}, 5e-6),
    ],
    ids=["bare", "friction", "payload", "fine"],
)
def test_drakes_plant_moves_alike_and_the_difference_is_of_the_order_of_the_step(changes, bound):
    """A tenth of a second of free motion: 0.1 rad and centimetres; the angles of cranks differ by less than `bound`.

    The two integrate in other coordinates: crank by crank Drake's with a gap in the loops, which here are closed.
    """
    options = PlantOptions.from_dict(changes)
    count = round(0.1 / options.time_step)
    torque = 0.9 * static_torque(PAPER, PAPER.home_pose) * np.array([1.0, 1.0, 1.1, 0.9, 1.0, 1.0])
    diagram, plant = build_plant(PAPER, options)
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    diagram.GetInputPort("torque").FixValue(context, torque)
    plant.set_state(context, PAPER.home_pose, MOVING)
    simulator.AdvanceTo(count * on_grid(options.time_step))
    state = diagram.GetOutputPort("state").Eval(context)
    rows = stepped(ClosedChain(PAPER, options, GRAVITY), starting_state(PAPER, PAPER.home_pose, MOVING), torque, count)
    np.testing.assert_allclose(rows[-1, 18:24], plant.crank_angles(state), atol=bound)
    pose, rate = plant.pose_and_rate(state)
    np.testing.assert_allclose(rows[-1, :6], pose, atol=bound)
    np.testing.assert_allclose(rows[-1, 6:12], rate, atol=20.0 * bound)
    assert np.abs(rows[-1, :6] - PAPER.home_pose).max() > 0.01


def test_friction_holds_a_robot_at_rest():
    options = PlantOptions.from_dict({"friction": {"coulomb": 0.05}})
    chain, start = ClosedChain(PAPER, options, GRAVITY), starting_state(PAPER, PAPER.home_pose, STILL)
    torque = static_torque(PAPER, PAPER.home_pose) + 0.04 * np.array([1, -1, 1, -1, 1, -1])
    rows = stepped(chain, start, torque, 3000)
    assert np.ptp(rows[1000:, 18:24], axis=0).max() < 1e-12
    np.testing.assert_array_equal(rows[-1, 24:30], rows[0, 24:30])
    away = stepped(chain, start, torque + 0.04 * np.array([1, -1, 1, -1, 1, -1]), 300)
    assert np.abs(away[-1, 18:24] - away[0, 18:24]).max() > 1e-3


def test_a_crank_at_its_dead_centre_ends_it_and_angles_go_on_beyond_half_a_turn():
    chain = ClosedChain(PAPER, PlantOptions(), GRAVITY)
    with pytest.raises(SingularPoseError, match="dead centre") as caught:
        stepped(chain, starting_state(PAPER, PAPER.home_pose, STILL), STILL, 1000)
    assert caught.value.reason == "crank_dead_centre"
    start = starting_state(PAPER, PAPER.home_pose, STILL)
    turned = start._replace(angles=start.angles + 2.0 * np.pi, anchor=start.anchor + 2.0 * np.pi)
    there = stepped(chain, turned, static_torque(PAPER, PAPER.home_pose), 5)
    np.testing.assert_allclose(there[-1, 18:24], inverse_kinematics(PAPER, PAPER.home_pose) + 2.0 * np.pi, atol=1e-6)


def test_the_payload_is_a_point_of_the_platform():
    place = np.array([0.02, 0.01, 0.05])
    own = loaded(PAPER, PlantOptions(payload_mass=0.5, payload_position=tuple(place)))
    bare = numpy_robot(PAPER)
    omega = np.array([0.3, -1.0, 0.7])
    speed = np.cross(omega, place)
    assert own.platform_mass == bare.platform_mass + 0.5
    kinetic = omega @ (own.platform_inertia - bare.platform_inertia) @ omega
    assert kinetic == pytest.approx(0.5 * speed @ speed, rel=1e-12)
    np.testing.assert_allclose(own.platform_moment - bare.platform_moment, 0.5 * place)


@pytest.mark.parametrize(
    "changes",
    [
        {"rod_joint": "ball"},
        {"collision": True},
        {"universal_damping": 1e-4},
        {"platform_joint_damping": 1e-5},
        {"broken_rod": {"leg": 1, "time": 0.5}},
    ],
    ids=lambda changes: next(iter(changes)),
)
def test_what_it_cannot_have_is_refused_by_name(changes):
    assert PlantOptions.from_dict(changes).engine == "drake"
    with pytest.raises(ConfigurationError) as caught:
        PlantOptions.from_dict({"engine": "reduced", **changes})
    assert str(caught.value) == f"plant.engine: got 'reduced'; allowed: drake, where {next(iter(changes))} is given"
