import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm, solve_discrete_are
from scipy.optimize import brentq
from strategies import ROBOT, poses, vectors
from ticks import GRAVITY, REST, standing, ticked

from stewart_drake.control.base import Setpoint
from stewart_drake.control.lqi import LqiOptions, block_weights, lqi_gain, lqi_part
from stewart_drake.control.riccati import INTEGRAL, POSITION, RATE
from stewart_drake.errors import NotFiniteError, RiccatiError, SingularPoseError, UnreachablePoseError
from stewart_drake.mechanics.dynamics import inverse_dynamics, pose_acceleration_map, static_torque
from stewart_drake.mechanics.kinematics import conditioning, leg_geometry, reach_margin, twist_jacobian

HOME = ROBOT.home_pose
BLOCKS = np.array([4.0e5, 100.0, 1.0e6, 1.0])
Z = np.array([1e-3, -2e-3, 1e-3, 3e-4, -1e-4, 2e-4])
EXACT = {"period": 0.001, "model": "exact", "feedforward": "full", "weight_length": 0.11, "solver": "split"}
HEAVY = ROBOT.replace(rod_mass=0.8, crank_mass=0.4, rod_inertia=(0.016, 0.016, 0.00001))
few = settings(max_examples=25)
solvers = pytest.mark.parametrize("solver", ["drake", "split"])


def tick(pose=HOME, rate=REST, setpoint=None, weights=BLOCKS, robot=ROBOT, gravity=GRAVITY, before=None, **options):
    weights = np.asarray(weights, dtype=float)
    part = lqi_part(LqiOptions(**(EXACT | options)), robot, gravity, len(weights))
    return ticked(part, pose, rate, standing(HOME) if setpoint is None else setpoint, weights, **(before or {}))


def states(gain, error, rate_error, integral):
    return gain[:, POSITION] @ error + gain[:, RATE] @ rate_error + gain[:, INTEGRAL] @ integral


# --- the paper's model -----------------------------------------------------------------------------------------------


def independent_gain(pose, period, ratio, force_map, discretization):
    """-K in the order [e, e', z] by matrix exponential and scipy; B from the Jacobian's transpose (virtual work)."""
    mass = np.diag([*ROBOT.platform_inertia, *(ROBOT.platform_mass,) * 3])
    zero, one = np.zeros((6, 6)), np.eye(6)
    a = np.block([[zero, one, zero], [zero, zero, zero], [one, zero, zero]])
    wrench = twist_jacobian(ROBOT, pose).T
    if force_map == "printed":
        # (15) has e_l . e_N where statics has its inverse.
        wrench = wrench * leg_geometry(ROBOT, pose).transmission ** 2
    both = period * np.block([[a, np.vstack([zero, np.linalg.solve(mass, wrench), zero])], [np.zeros((6, 24))]])
    both = expm(both) if discretization == "exact" else np.eye(24) + both
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
    st.floats(-2.0, 2.0),
    st.fixed_dictionaries(
        {
            "solver": st.sampled_from(["drake", "split"]),
            "force_map": st.sampled_from(["statics", "printed"]),
            "period": st.sampled_from([0.001, 0.005, 0.02]),
            "discretization": st.sampled_from(["exact", "euler"]),
        }
    ),
)
def test_the_torque_is_minus_k_times_the_state_and_z_grows_after_it_was_used(
    pose, error, rate_error, z, log_ratio, options
):
    setpoint, weights = Setpoint(pose - error, 0.5 * rate_error, np.ones(6)), [3.0 * 10.0**log_ratio, 3.0]
    paper = options | {"model": "paper", "feedforward": "none", "weight_length": 1.0}
    output = tick(pose, 1.5 * rate_error, setpoint, weights, before={"integral": z}, **paper)
    # What is left of a tiny error beside the pose.
    error = pose - setpoint.pose
    np.testing.assert_array_equal(output.error, error)
    np.testing.assert_allclose(output.integral, z + options["period"] * error, atol=1e-15)
    state = np.concatenate([error, rate_error, z])
    own = (options[name] for name in ("force_map", "discretization"))
    gain = independent_gain(pose, options["period"], 10.0**log_ratio, *own)
    # scipy's own residual is the limit here, see the notes on the split solution.
    scale = np.abs(gain).max() * np.abs(state).max()
    np.testing.assert_allclose(output.torque, gain @ state, atol=1e-6 * scale + 1e-30)


@few
@given(poses(0.8), vectors(6, 5.0), st.sampled_from(["statics", "printed"]))
def test_platform_feedforward_is_the_force_on_the_platform_that_its_acceleration_needs(pose, acceleration, force_map):
    """M q'' = tau T of (9), (10), with tau as the option says; here by legs rather than by the force map."""
    options = {"setpoint": Setpoint(pose, REST, acceleration), "model": "paper", "force_map": force_map}
    platform = tick(pose, feedforward="platform", **options).torque
    legs = leg_geometry(ROBOT, pose)
    lever = ROBOT.crank_length * legs.transmission if force_map == "statics" else ROBOT.crank_length / legs.transmission
    rod_forces = (platform - static_torque(ROBOT, pose, GRAVITY)) / lever
    wrench = np.concatenate([np.cross(legs.arm, legs.e_l).T @ rod_forces, legs.e_l.T @ rod_forces])
    expected = np.array([*ROBOT.platform_inertia, *(ROBOT.platform_mass,) * 3]) * acceleration
    np.testing.assert_allclose(wrench, expected, atol=1e-9)


# --- the exact model -------------------------------------------------------------------------------------------------


@few
@given(poses(0.7), vectors(6, 0.5), vectors(6, 3.0), vectors(6, 0.01), vectors(6, 0.1), vectors(6, 1e-3))
def test_with_full_feedforward_the_error_obeys_the_linear_law(pose, rate, acceleration, error, rate_error, integral):
    """e'' = -A K [e; e'; z] exactly: no gravity, no Coriolis term, no leg is left over."""
    setpoint = Setpoint(pose - error, rate - rate_error, acceleration)
    output = tick(pose, rate, setpoint, robot=HEAVY, before={"integral": integral})
    # q'' by inverse dynamics alone, which is affine in q''.
    bias = inverse_dynamics(HEAVY, pose, rate, REST, GRAVITY)
    inertia = np.stack([inverse_dynamics(HEAVY, pose, rate, e, GRAVITY) - bias for e in np.eye(6)], axis=-1)
    moved = np.linalg.solve(inertia, output.torque - bias) - acceleration
    law = -pose_acceleration_map(HEAVY, pose) @ states(output.gain, error, rate_error, integral)
    np.testing.assert_allclose(moved, law, atol=1e-8 * (1.0 + np.abs(law).max()))


@solvers
def test_feedforward_is_taken_where_the_option_says(solver):
    pose, wanted = HOME + [0.1, -0.05, 0.08, 0.01, 0.02, -0.005], HOME + [0.02, 0.1, -0.03, -0.01, 0.01, 0.01]
    rate, wanted_rate = np.full(6, 0.3), np.array([0.5, -0.4, 0.3, 0.1, -0.2, 0.1])
    acceleration = np.array([3.0, 2.0, -4.0, 1.0, -1.0, 2.0])
    setpoint = Setpoint(wanted, wanted_rate, acceleration)
    expected = {
        ("none", "measured"): REST,
        ("gravity", "reference"): static_torque(ROBOT, pose, GRAVITY),
        ("full", "measured"): inverse_dynamics(ROBOT, pose, rate, acceleration, GRAVITY),
        ("full", "reference"): inverse_dynamics(ROBOT, wanted, wanted_rate, acceleration, GRAVITY),
    }
    for (kind, at), torque in expected.items():
        output = tick(pose, rate, setpoint, feedforward=kind, feedforward_at=at, solver=solver)
        np.testing.assert_allclose(output.feedforward, torque, atol=1e-11)
        correction = states(output.gain, pose - wanted, rate - wanted_rate, REST)
        np.testing.assert_allclose(output.torque, torque - correction, rtol=1e-9, atol=1e-9)
    # It is the believed robot's, in the gravity that is believed in.
    output = tick(setpoint=Setpoint(HOME, REST, acceleration), robot=HEAVY, gravity=0.0, solver=solver)
    np.testing.assert_allclose(output.torque, inverse_dynamics(HEAVY, HOME, REST, acceleration, 0.0), atol=1e-12)


# --- weights ---------------------------------------------------------------------------------------------------------


@few
@given(poses(0.7), st.sampled_from(["drake", "split"]), st.sampled_from([0.05, 0.11, 3.0]))
def test_weight_length_weighs_a_rotation_like_the_path_at_that_radius(pose, solver, length):
    """The gain for q is that for rotations in metres, length * angle, with nothing scaled: K for x = S x'."""
    scaled = np.array([length] * 3 + [1.0] * 3)
    own = pose_acceleration_map(ROBOT, pose)
    blocks = np.array([2e3, 20.0, 3e3, 2.5])
    gain = lqi_gain(own, LqiOptions(solver=solver, weight_length=length), blocks)
    in_metres = lqi_gain(scaled[:, None] * own, LqiOptions(solver="split"), blocks)
    for part in (POSITION, RATE, INTEGRAL):
        expected = in_metres[:, part] * scaled
        np.testing.assert_allclose(gain[:, part], expected, rtol=0.0, atol=1e-8 * np.abs(expected).max())


def test_weights_are_two_or_four_positive_numbers_and_nothing_else():
    for weights in ([1.0, 0.0], [1.0, 1.0, -1.0, 1.0], [np.nan, 1.0], [1.0, 1.0, np.inf, 1.0], [1.0] * 3, []):
        with pytest.raises(RiccatiError, match="weights"):
            block_weights(weights)
    np.testing.assert_array_equal(tick(weights=[3.0, 2.0]).weights, [3.0, 3.0, 3.0, 2.0])
    np.testing.assert_array_equal(tick(weights=[4.0, 3.0, 2.0, 1.0]).weights, [4.0, 3.0, 2.0, 1.0])


@solvers
def test_bumpless_a_change_of_weights_leaves_the_torque_by_z_as_it_was(solver):
    other, known = np.array([1.0e4, 20.0, 3.0e6, 1.0]), {"integral": Z, "weights": BLOCKS}
    before = tick(before={"integral": Z}, bumpless=True, solver=solver)
    after = tick(weights=other, before=known, bumpless=True, solver=solver)
    np.testing.assert_allclose(after.gain[:, INTEGRAL] @ after.integral, before.gain[:, INTEGRAL] @ Z, rtol=1e-6)
    np.testing.assert_allclose(after.torque, before.torque, rtol=1e-9)
    # Without it the torque jumps; at the first tick there were no weights before.
    assert np.abs(tick(weights=other, before=known, solver=solver).torque - before.torque).max() > 0.05
    first = tick(before={"integral": Z}, weights=other, bumpless=True, solver=solver)
    np.testing.assert_array_equal(first.integral, Z)


# --- limits ----------------------------------------------------------------------------------------------------------


@few
@given(vectors(6, 0.15), vectors(6, 0.05), st.sampled_from(["clamp", "back_calculation"]))
def test_the_torque_never_exceeds_the_limit_nor_z_its_own_and_clamp_holds_z_while_a_motor_is_there(
    error, z, saturation
):
    limit, setpoint, before = (0.04, 0.03), standing(HOME - error), {"integral": z}
    output = tick(setpoint=setpoint, before=before, saturation=saturation, integral_limit=limit)
    free = tick(setpoint=setpoint, before=before).torque
    np.testing.assert_allclose(output.torque, np.clip(free, -ROBOT.effort_limit, ROBOT.effort_limit), rtol=1e-8)
    bounds = np.repeat(limit, 3)
    assert (np.abs(output.integral) <= bounds).all()
    if saturation == "clamp":
        cut = np.abs(free).max() > ROBOT.effort_limit
        grown = z if cut else z + EXACT["period"] * (HOME - setpoint.pose)
        np.testing.assert_allclose(output.integral, np.clip(grown, -bounds, bounds), rtol=1e-9, atol=1e-15)


def test_back_calculation_takes_off_z_what_was_cut_off_the_torque():
    step = np.full(6, 0.05)
    for reset_time, share in ((0.05, EXACT["period"] / 0.05), (1e-5, 1.0)):
        options = {"saturation": "back_calculation", "reset_time": reset_time, "before": {"integral": Z}}
        output = tick(setpoint=standing(HOME - step), **options)
        cut = output.feedforward - states(output.gain, step, REST, Z) - output.torque
        assert np.abs(cut).max() > 1.0
        led_back = output.integral - EXACT["period"] * step - Z
        np.testing.assert_allclose(output.gain[:, INTEGRAL] @ led_back, share * cut, rtol=1e-6, atol=1e-9)


# --- poses that end a run --------------------------------------------------------------------------------------------

SIDEWAYS = np.array([0.15, -0.1, 0.1, 0.02, 0.01, 0.0])


def raised(height):
    return HOME + SIDEWAYS + [0, 0, 0, 0, 0, height]


def dead_centre():
    """Height above `raised(0)` at which the first rod cannot span."""
    return brentq(lambda height: reach_margin(ROBOT, raised(height)).min(), 0.0, 0.3, xtol=1e-15)


def towards_dead_centre(transmission):
    """A tilted pose so high that the straightest leg has this |e_l . e_N|."""

    def excess(height):
        return np.abs(leg_geometry(ROBOT, raised(height)).transmission).min() - transmission

    return raised(brentq(excess, 0.0, dead_centre() - 1e-12))


def test_a_crank_near_its_dead_centre_ends_the_run_and_is_named():
    tick(towards_dead_centre(0.021))
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
    near, far = raised(dead_centre() + 1e-3), raised(dead_centre() + 0.1)
    assert -0.05 < reach_margin(ROBOT, near).min() < 0.0
    for pose, kind in ((near, SingularPoseError), (far, UnreachablePoseError)):
        with pytest.raises(kind) as caught:
            tick(pose)
        assert caught.value.leg == reach_margin(ROBOT, pose).argmin()
    np.testing.assert_array_equal(caught.value.pose, far)
    # A reference just across is out of reach: nobody stands there.
    with pytest.raises(UnreachablePoseError) as caught:
        tick(setpoint=standing(near), feedforward_at="reference")
    np.testing.assert_array_equal(caught.value.pose, near)


def test_a_parallel_singularity_is_told_from_a_dead_centre():
    pose = raised(0.0)
    ratio = float(conditioning(ROBOT, pose))
    tick(pose, min_conditioning=0.999 * ratio)
    with pytest.raises(SingularPoseError) as caught:
        tick(pose, min_conditioning=1.001 * ratio)
    assert (caught.value.kind, caught.value.reason, caught.value.leg) == ("parallel", "parallel_singularity", None)
    assert caught.value.margin == pytest.approx(ratio)


# --- ticks that fail -------------------------------------------------------------------------------------------------


class Runner:
    """Ticks one after the other."""

    def __init__(self, solver, **options):
        self.options = LqiOptions(**EXACT | {"solver": solver} | options)
        self.part = lqi_part(self.options, ROBOT, GRAVITY, 4)
        self.state = self.part.initial.copy()

    def __call__(self, pose=HOME, rate=REST, setpoint=None, weights=BLOCKS):
        wanted = np.concatenate(standing(HOME) if setpoint is None else setpoint)
        self.part.tick(np.concatenate([pose, rate]), wanted, weights, self.state)
        return self.state.copy().view(np.recarray)[0]


NAN = np.full(6, np.nan)
FAILURES = {
    "pose": ({"pose": NAN}, NotFiniteError, "not_finite"),
    "rate": ({"rate": NAN}, NotFiniteError, "not_finite"),
    "reference": ({"setpoint": standing(NAN)}, NotFiniteError, "not_finite"),
    "weights": ({"weights": np.array([1.0, np.nan, 1.0, 1.0])}, RiccatiError, "riccati"),
    "singular": ({"pose": HOME + [0, 0, 0.3, 0, 0, 0.115]}, SingularPoseError, "crank_dead_centre"),
}


@solvers
@pytest.mark.parametrize(("bad", "kind", "reason"), FAILURES.values(), ids=FAILURES.keys())
def test_so_many_bad_ticks_are_bridged_and_no_more_and_a_good_one_starts_anew(bad, kind, reason, solver):
    run = Runner(solver, hold_ticks=3)
    good = run(pose=HOME + 1e-3)
    for _ in range(2):
        for count in range(1, 4):
            held = run(**bad)
            assert held.held == count
            assert np.isfinite(held.torque).all()
            for name in ("gain", "weights", "feedforward", "integral", *["torque"] * (reason == "not_finite")):
                np.testing.assert_array_equal(held[name], good[name])
        good = run(pose=HOME + 1e-3)
        assert good.held == 0.0
    for _ in range(3):
        run(**bad)
    with pytest.raises(kind) as caught:
        run(**bad)
    assert caught.value.reason == reason
    # Neither before a good tick nor without leave to bridge.
    for other in (Runner(solver, hold_ticks=5), Runner(solver)):
        if other.options.hold_ticks == 0:
            other()
        with pytest.raises(kind):
            other(**bad)
