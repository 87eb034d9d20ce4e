import copy
import json
import math

import numpy as np
import pytest
from conftest import make_network, python
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm, solve_discrete_are
from scipy.optimize import brentq
from strategies import ROBOT, poses, vectors

from stewart_drake.control.control_law import ControlLaw
from stewart_drake.control.density import density
from stewart_drake.control.inputs import Measurement, Setpoint, checked_legs
from stewart_drake.control.lqi import initial_memory, lqi_tick
from stewart_drake.control.lqi_options import LqiOptions
from stewart_drake.errors import (
    NotFiniteError,
    RiccatiError,
    SingularPoseError,
    StewartDrakeError,
    UnreachablePoseError,
)
from stewart_drake.mechanics.dynamics import static_torque
from stewart_drake.mechanics.kinematics import conditioning, leg_geometry, pose_jacobian, reach_margin, twist_jacobian

GRAVITY = 9.81
HOME = ROBOT.home_pose
REST = np.zeros(6)
WEIGHTS = np.array([1.0, 1.0])
SOLVERS = ["drake", "split"]
log_ratios = st.floats(-2.0, 2.0)
few = settings(max_examples=30)


def tick(pose=HOME, rate=REST, setpoint=None, weights=WEIGHTS, integral=REST, gravity=GRAVITY, robot=ROBOT, **options):
    setpoint = Setpoint(HOME, REST, REST) if setpoint is None else setpoint
    options = LqiOptions(**{"solver": "split", **options})
    memory = initial_memory()._replace(integral=integral)
    return lqi_tick(robot, options, gravity, Measurement(pose, rate), setpoint, np.asarray(weights), memory)


def potential_energy(pose):
    """Of platform, cranks and rods, from where their centres are."""
    legs = leg_geometry(ROBOT, pose)
    tip = ROBOT.shaft_height + ROBOT.crank_length * legs.crank[:, 2]
    middle_of_crank = 0.5 * (ROBOT.shaft_height + tip)
    middle_of_rod = 0.5 * (tip + pose[5] + legs.arm[:, 2])
    heights = ROBOT.crank_mass * middle_of_crank.sum() + ROBOT.rod_mass * middle_of_rod.sum()
    return GRAVITY * (heights + ROBOT.platform_mass * pose[5])


# --- what the torque is --------------------------------------------------------------------------------------------


@few
@given(poses(0.9), st.sampled_from(["gravity", "platform"]))
def test_at_rest_on_the_setpoint_the_torque_holds_the_robot_by_virtual_work(pose, feedforward):
    output = tick(pose, setpoint=Setpoint(pose, REST, REST), feedforward=feedforward)
    h = 1e-6
    gradient = [(potential_energy(pose + h * e) - potential_energy(pose - h * e)) / (2.0 * h) for e in np.eye(6)]
    np.testing.assert_allclose(pose_jacobian(ROBOT, pose).T @ output.torque, gradient, atol=1e-6)
    np.testing.assert_array_equal(output.error, 0.0)
    np.testing.assert_array_equal(output.integral, 0.0)


def independent_gain(pose, period, ratio, force_map):
    """-K in the order [e, e', z] by matrix exponential and scipy; B from the Jacobian's transpose (virtual work)."""
    mass = np.diag([*ROBOT.platform_inertia, *(ROBOT.platform_mass,) * 3])
    zero, one = np.zeros((6, 6)), np.eye(6)
    a = np.block([[zero, one, zero], [zero, zero, zero], [one, zero, zero]])
    wrench = twist_jacobian(ROBOT, pose).T
    if force_map == "printed":
        # (15) has e_l . e_N where statics has its inverse.
        wrench = wrench * leg_geometry(ROBOT, pose).transmission ** 2
    b = np.vstack([zero, np.linalg.solve(mass, wrench), zero])
    both = expm(period * np.block([[a, b], [np.zeros((6, 24))]]))
    a, b = both[:18, :18], both[:18, 18:]
    q, r = ratio * np.eye(18), np.eye(6)
    p = solve_discrete_are(a, b, q, r)
    return -np.linalg.inv(r + b.T @ p @ b) @ b.T @ p @ a


@pytest.mark.slow
@few
@given(
    poses(0.8),
    vectors(6, 0.02),
    vectors(6, 0.3),
    vectors(6, 0.05),
    log_ratios,
    st.sampled_from(SOLVERS),
    st.sampled_from(["statics", "printed"]),
    st.sampled_from([0.001, 0.005, 0.02]),
)
def test_the_torque_is_minus_k_times_the_state(pose, error, rate_error, integral, log_ratio, solver, force_map, period):
    setpoint = Setpoint(pose - error, 0.5 * rate_error, np.ones(6))
    output = tick(
        pose,
        1.5 * rate_error,
        setpoint,
        weights=[10.0**log_ratio, 1.0],
        integral=integral,
        feedforward="none",
        solver=solver,
        force_map=force_map,
        period=period,
    )
    # What is left of a tiny error beside the pose.
    error = pose - setpoint.pose
    state = np.concatenate([error, rate_error, integral])
    gain = independent_gain(pose, period, 10.0**log_ratio, force_map)
    # scipy's own residual is the limit here, see the notes on the split solution.
    scale = np.abs(gain).max() * np.abs(state).max()
    np.testing.assert_allclose(output.torque, gain @ state, atol=1e-6 * scale + 1e-30)


@few
@given(poses(0.8), vectors(6, 0.02), log_ratios, st.floats(-3.0, 3.0), st.sampled_from(SOLVERS))
def test_only_the_ratio_of_the_weights_matters(pose, error, log_ratio, log_factor, solver):
    setpoint, factor = Setpoint(pose - error, REST, REST), 10.0**log_factor
    weights = np.array([10.0**log_ratio, 1.0])
    one, other = (tick(pose, setpoint=setpoint, weights=w, solver=solver) for w in (weights, factor * weights))
    np.testing.assert_allclose(other.torque, one.torque, atol=1e-8)


def test_another_ratio_is_another_controller():
    setpoint = Setpoint(HOME - 0.01, REST, REST)
    torques = [tick(setpoint=setpoint, weights=[ratio, 1.0], feedforward="none").torque for ratio in (0.1, 1.0, 10.0)]
    sizes = [np.linalg.norm(torque) for torque in torques]
    assert sizes[0] < 0.8 * sizes[1] < 0.64 * sizes[2]


@few
@given(poses(0.8), vectors(6, 0.02), vectors(6, 0.3), log_ratios, st.sampled_from(["exact", "euler"]))
def test_both_solvers_give_the_same_torque(pose, error, rate, log_ratio, discretization):
    setpoint = Setpoint(pose - error, REST, REST)
    weights = [10.0**log_ratio, 1.0]
    one, other = (
        tick(pose, rate, setpoint, weights, solver=solver, discretization=discretization) for solver in SOLVERS
    )
    np.testing.assert_allclose(one.torque, other.torque, rtol=1e-8, atol=1e-9)
    assert one.error.tobytes() == other.error.tobytes()


def test_euler_and_exact_discretisation_differ_by_the_order_of_the_period():
    setpoint = Setpoint(HOME - 0.01, REST, REST)

    def gap(period):
        torques = [
            tick(setpoint=setpoint, period=period, discretization=kind, feedforward="none").torque
            for kind in ("exact", "euler")
        ]
        return np.linalg.norm(torques[0] - torques[1])

    assert gap(0.005) > 1e-6
    assert gap(0.0025) / gap(0.005) == pytest.approx(0.5, abs=0.1)


@few
@given(poses(0.8), vectors(6, 0.02), vectors(6, 5.0), st.sampled_from(["statics", "printed"]))
def test_feedforward_adds_the_static_torque_and_then_the_platforms_acceleration(pose, error, acceleration, force_map):
    setpoint = Setpoint(pose - error, REST, acceleration)
    none, gravity, platform = (
        tick(pose, setpoint=setpoint, feedforward=kind, force_map=force_map).torque
        for kind in ("none", "gravity", "platform")
    )
    # Gravity: of the measured pose, not of the reference's.
    np.testing.assert_allclose(gravity - none, static_torque(ROBOT, pose, GRAVITY), atol=1e-12)
    # Platform: M q'' = tau T of (9), (10), with tau as the option says; here by legs rather than by the force map.
    legs = leg_geometry(ROBOT, pose)
    lever = ROBOT.crank_length * legs.transmission if force_map == "statics" else ROBOT.crank_length / legs.transmission
    rod_forces = (platform - gravity) / lever
    wrench = np.concatenate([np.cross(legs.arm, legs.e_l).T @ rod_forces, legs.e_l.T @ rod_forces])
    expected = np.array([*ROBOT.platform_inertia, *(ROBOT.platform_mass,) * 3]) * acceleration
    np.testing.assert_allclose(wrench, expected, atol=1e-9)


def test_without_gravity_the_gravity_torque_is_off():
    setpoint = Setpoint(HOME - 0.01, REST, REST)
    kinds = [tick(setpoint=setpoint, gravity=0.0, feedforward=kind).torque for kind in ("none", "gravity", "platform")]
    for torque in kinds[1:]:
        np.testing.assert_allclose(torque, kinds[0], atol=1e-15)


@given(vectors(6, 0.01), vectors(6, 0.1), st.sampled_from([0.001, 0.005, 0.02]))
def test_the_integral_grows_by_period_times_error_after_it_was_used(error, integral, period):
    output = tick(setpoint=Setpoint(HOME - error, REST, REST), integral=integral, period=period)
    np.testing.assert_allclose(output.error, error, atol=1e-15)
    np.testing.assert_allclose(output.integral, integral + period * error, atol=1e-15)


def test_the_controller_believes_its_own_robot():
    heavy = ROBOT.replace(platform_mass=2.0)
    held = tick(robot=heavy).torque
    np.testing.assert_allclose(held, static_torque(heavy, HOME, GRAVITY), atol=1e-12)
    assert np.all(np.abs(held) > 1.5 * np.abs(tick().torque))


# --- what it refuses -----------------------------------------------------------------------------------------------

SIDEWAYS = np.array([0.15, -0.1, 0.1, 0.02, 0.01, 0.0])


def towards_dead_centre(transmission):
    """A tilted pose so high that the straightest leg has this |e_l . e_N|."""

    def excess(height):
        return np.abs(leg_geometry(ROBOT, HOME + SIDEWAYS + [0, 0, 0, 0, 0, height]).transmission).min() - transmission

    edge = brentq(
        lambda height: reach_margin(ROBOT, HOME + SIDEWAYS + [0, 0, 0, 0, 0, height]).min(), 0.0, 0.3, xtol=1e-15
    )
    return HOME + SIDEWAYS + [0, 0, 0, 0, 0, brentq(excess, 0.0, edge - 1e-12)]


def test_a_crank_near_its_dead_centre_ends_the_run_and_is_named():
    tick(towards_dead_centre(0.021), feedforward="none")
    pose = towards_dead_centre(0.019)
    with pytest.raises(SingularPoseError) as caught:
        tick(pose)
    error = caught.value
    assert (error.kind, error.reason) == ("serial", "crank_dead_centre")
    assert error.leg == np.abs(leg_geometry(ROBOT, pose).transmission).argmin()
    assert error.margin == pytest.approx(0.019)
    assert f"leg {error.leg}" in str(error)
    # The limit is the caller's.
    assert np.isfinite(tick(pose, min_transmission=0.018).torque).all()


def test_just_across_the_dead_centre_counts_as_there_and_far_out_as_unreachable():
    edge = towards_dead_centre(1e-4)
    leg = int(reach_margin(ROBOT, edge).argmin())
    near, far = edge.copy(), edge.copy()
    near[5] += 1e-3
    far[5] += 0.1
    assert -0.05 < reach_margin(ROBOT, near).min() < 0.0
    assert reach_margin(ROBOT, far).min() < -0.05
    with pytest.raises(SingularPoseError, match="dead centre") as caught:
        tick(near)
    assert caught.value.leg == leg
    with pytest.raises(UnreachablePoseError) as caught:
        tick(far)
    assert caught.value.leg == reach_margin(ROBOT, far).argmin()
    np.testing.assert_array_equal(caught.value.pose, far)


def test_a_parallel_singularity_is_told_from_a_dead_centre():
    pose = HOME + SIDEWAYS
    ratio = float(conditioning(ROBOT, pose))
    checked_legs(ROBOT, LqiOptions(min_conditioning=0.999 * ratio), pose)
    with pytest.raises(SingularPoseError) as caught:
        tick(pose, min_conditioning=1.001 * ratio)
    assert (caught.value.kind, caught.value.reason, caught.value.leg) == ("parallel", "parallel_singularity", None)
    assert caught.value.margin == pytest.approx(ratio)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("axis", range(6))
def test_a_measurement_that_is_not_finite_is_named(axis, bad):
    vector = np.zeros(6)
    vector[axis] = bad
    with pytest.raises(NotFiniteError) as caught:
        tick(HOME + vector)
    assert caught.value.signal == "measured pose"
    with pytest.raises(NotFiniteError) as caught:
        tick(rate=vector)
    assert caught.value.signal == "measured pose rate"


@pytest.mark.parametrize("field", ["pose", "pose_rate"])
def test_a_setpoint_or_integral_that_is_not_finite_ends_in_a_named_error(field):
    vector = np.array([0.0, math.nan, 0.0, 0.0, 0.0, 0.0])
    setpoint = Setpoint(HOME, REST, REST)._replace(**{field: vector})
    with pytest.raises(NotFiniteError, match="reference"):
        tick(setpoint=setpoint)
    with pytest.raises(NotFiniteError, match="reference"):
        tick(setpoint=Setpoint(HOME, REST, vector))
    with pytest.raises(NotFiniteError, match="torque"):
        tick(integral=vector)


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("bad", [0.0, -1.0, math.nan])
@pytest.mark.parametrize("which", [0, 1])
def test_weights_without_a_stabilising_gain_are_a_riccati_error(solver, bad, which):
    weights = np.ones(2)
    weights[which] = bad
    with pytest.raises(RiccatiError):
        tick(weights=weights, solver=solver)


# --- the whole controller of Fig. 6 --------------------------------------------------------------------------------


def drive(law, ticks, state=None):
    """Torques, states and samples along a motion that the controller does not influence."""
    state = law.initial_state() if state is None else state
    torques, states = [], [state]
    for k in range(ticks):
        wave = np.sin(0.3 * k + np.arange(6.0))
        measurement = Measurement(HOME + 0.01 * wave, 0.05 * np.cos(0.2 * k + np.arange(6.0)))
        torque, state = law(measurement, Setpoint(HOME, REST, REST), state)
        torques.append(torque)
        states.append(state)
    return np.array(torques), states


def law_with(network, **changes):
    return ControlLaw(**{"robot": ROBOT, "options": LqiOptions(solver="split"), "network": network, **changes})


def test_weights_found_in_a_tick_act_in_the_next(network):
    law = law_with(network, window=4, initial_weights=(2.0, 0.5))
    torques, states = drive(law, 8)
    history = []
    for k in range(8):
        wave = np.sin(0.3 * k + np.arange(6.0))
        rate = 0.05 * np.cos(0.2 * k + np.arange(6.0))
        expected = tick(HOME + 0.01 * wave, rate, weights=states[k].weights, integral=states[k].integral)
        np.testing.assert_array_equal(torques[k], expected.torque)
        np.testing.assert_array_equal(states[k + 1].integral, expected.integral)
        history.append(np.concatenate([expected.error, expected.torque]))
        features = density(np.array(history[-5:]))
        np.testing.assert_allclose(states[k + 1].weights, network.weights(features), rtol=1e-12)
    np.testing.assert_array_equal(states[0].weights, [2.0, 0.5])
    assert len({tuple(state.weights) for state in states}) > 3  # the network does answer


def test_without_a_network_the_weights_stay():
    _, states = drive(law_with(None, initial_weights=(3.0, 0.2)), 3)
    for state in states:
        np.testing.assert_array_equal(state.weights, [3.0, 0.2])


def test_initial_weights_are_held_within_the_networks_range(network):
    np.testing.assert_array_equal(law_with(network, initial_weights=(99.0, 1e-6)).initial_state().weights, [10.0, 0.1])
    np.testing.assert_array_equal(law_with(None, initial_weights=(99.0, 1e-6)).initial_state().weights, [99.0, 1e-6])


@pytest.mark.parametrize("kind", ["magnitude", "signed"])
def test_the_law_is_pure(kind):
    law = law_with(make_network(density=kind), window=3, density_kind=kind)
    _, states = drive(law, 5)
    state = states[-1]
    kept = copy.deepcopy(state)
    first, second = drive(law, 4, state), drive(law, 4, state)
    np.testing.assert_array_equal(first[0], second[0])
    for name in ("integral", "weights", "window"):
        np.testing.assert_array_equal(getattr(state, name), getattr(kept, name))
    assert state.filled == kept.filled == 4


@pytest.mark.slow
def test_the_law_runs_where_drake_is_not_installed(tmp_path, network):
    network.save(tmp_path / "net.json")
    code = (
        "import sys, json\n"
        "sys.modules.update(pydrake=None, torch=None, pyarrow=None, matplotlib=None)\n"
        "import numpy as np\n"
        "from stewart_drake.control.control_law import ControlLaw\n"
        "from stewart_drake.control.inputs import Measurement, Setpoint\n"
        "from stewart_drake.control.lqi_options import LqiOptions\n"
        "from stewart_drake.control.network import load_network\n"
        "from stewart_drake.robot import RobotParameters\n"
        "robot = RobotParameters()\n"
        "law = ControlLaw(robot, LqiOptions(solver='split'), network=load_network(sys.argv[1]), window=4)\n"
        "state, torques, home, rest = law.initial_state(), [], robot.home_pose, np.zeros(6)\n"
        "for k in range(6):\n"
        "    pose = home + 0.01 * np.sin(0.3 * k + np.arange(6.0))\n"
        "    rate = 0.05 * np.cos(0.2 * k + np.arange(6.0))\n"
        "    torque, state = law(Measurement(pose, rate), Setpoint(home, rest, rest), state)\n"
        "    torques.append(torque.tolist())\n"
        "print(json.dumps(torques))\n"
    )
    torques = json.loads(python("-c", code, tmp_path / "net.json"))
    np.testing.assert_array_equal(torques, drive(law_with(network, window=4), 6)[0])


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"window": 0}, "window"),
        ({"window": 2.5}, "window"),
        ({"density_kind": "loud"}, "magnitude or signed"),
        ({"density_kind": "signed"}, "as the network was trained on"),
        ({"initial_weights": (1.0, 0.0)}, "positive"),
        ({"initial_weights": (1.0, 1.0, 1.0, 1.0)}, "two, with a network"),
    ],
)
def test_what_cannot_be_a_law_is_refused_when_it_is_made(network, changes, words):
    with pytest.raises(StewartDrakeError, match=words):
        ControlLaw(ROBOT, network=network, **changes)
