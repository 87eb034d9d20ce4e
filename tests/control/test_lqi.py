import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm, solve_discrete_are
from scipy.optimize import brentq
from strategies import ROBOT, poses, vectors
from ticks import GRAVITY, REST, standing, ticked

from stewart_drake.base.errors import NotFiniteError, RiccatiError, SingularPoseError
from stewart_drake.control.base import Setpoint
from stewart_drake.control.lqi import LqiOptions, lqi_part
from stewart_drake.control.riccati import INTEGRAL, POSITION, RATE
from stewart_drake.mechanics.dynamics import inverse_dynamics, pose_acceleration_map, static_torque
from stewart_drake.mechanics.kinematics import conditioning, leg_geometry, reach_margin, twist_jacobian

HOME = ROBOT.home_pose
AT_HOME = standing(HOME)
BLOCKS = np.array([4.0e5, 100.0, 1.0e6, 1.0])
Z = np.array([1e-3, -2e-3, 1e-3, 3e-4, -1e-4, 2e-4])
EXACT = {"period": 0.001, "model": "exact", "feedforward": "full", "weight_length": 0.11, "solver": "split"}
HEAVY = ROBOT.replace(rod_mass=0.8, crank_mass=0.4, rod_inertia=(0.016, 0.016, 0.00001))
few = settings(max_examples=25)


def tick(pose=HOME, rate=REST, setpoint=None, weights=BLOCKS, robot=ROBOT, gravity=GRAVITY, before=None, **options):
    weights = np.asarray(weights, dtype=float)
    part = lqi_part(LqiOptions(**(EXACT | options)), robot, gravity, len(weights))
    return ticked(part, pose, rate, standing(HOME) if setpoint is None else setpoint, weights, **(before or {}))


def states(gain, error, rate_error, integral):
    return gain[:, POSITION] @ error + gain[:, RATE] @ rate_error + gain[:, INTEGRAL] @ integral


def independent_gain(pose, period, ratio, force_map):
    """-K in the order [e, e', z] by matrix exponential and scipy; B from the Jacobian's transpose (virtual work)."""
    mass = np.diag([*ROBOT.platform_inertia, *(ROBOT.platform_mass,) * 3])
    zero, one = np.zeros((6, 6)), np.eye(6)
    a = np.block([[zero, one, zero], [zero, zero, zero], [one, zero, zero]])
    wrench = twist_jacobian(ROBOT, pose).T
    if force_map == "printed":
        # (15) has e_l . e_N where statics has its inverse.
        wrench = wrench * leg_geometry(ROBOT, pose).transmission ** 2
    both = period * np.block([[a, np.vstack([zero, np.linalg.solve(mass, wrench), zero])], [np.zeros((6, 24))]])
    both = expm(both)
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
        }
    ),
)
def test_the_torque_is_minus_k_times_the_state_and_z_grows_after_it_was_used(
    pose, error, rate_error, z, log_ratio, options
):
    setpoint, weights = Setpoint(pose - error, 0.5 * rate_error, np.ones(6)), [3.0 * 10.0**log_ratio, 3.0]
    paper = options | {"model": "paper", "feedforward": "none", "weight_length": 1.0}
    output = tick(pose, 1.5 * rate_error, setpoint, weights, before={"integral": z}, **paper)
    error = pose - setpoint.pose
    np.testing.assert_allclose(output.integral, z + options["period"] * error, atol=1e-15)
    state = np.concatenate([error, rate_error, z])
    gain = independent_gain(pose, options["period"], 10.0**log_ratio, options["force_map"])
    # scipy's own residual is the limit here, see the notes on the split solution.
    scale = np.abs(gain).max() * np.abs(state).max()
    np.testing.assert_allclose(output.torque, gain @ state, atol=1e-6 * scale + 1e-30)


@few
@given(poses(0.7), vectors(6, 0.5), vectors(6, 3.0), vectors(6, 0.01), vectors(6, 0.1), vectors(6, 1e-3))
def test_with_full_feedforward_the_error_obeys_the_linear_law(pose, rate, acceleration, error, rate_error, integral):
    # e'' = -A K [e; e'; z] exactly: no gravity, no Coriolis term, no leg is left over.
    setpoint = Setpoint(pose - error, rate - rate_error, acceleration)
    output = tick(pose, rate, setpoint, robot=HEAVY, before={"integral": integral})
    # q'' by inverse dynamics alone, which is affine in q''.
    bias = inverse_dynamics(HEAVY, pose, rate, REST, GRAVITY)
    inertia = np.stack([inverse_dynamics(HEAVY, pose, rate, e, GRAVITY) - bias for e in np.eye(6)], axis=-1)
    moved = np.linalg.solve(inertia, output.torque - bias) - acceleration
    law = -pose_acceleration_map(HEAVY, pose) @ states(output.gain, error, rate_error, integral)
    np.testing.assert_allclose(moved, law, atol=1e-8 * (1.0 + np.abs(law).max()))


@pytest.mark.parametrize(("kind", "place"), [("none", "measured"), ("gravity", "reference"), ("full", "reference")])
def test_feedforward_is_evaluated_where_the_option_asks(kind, place):
    pose, wanted = HOME + [0.1, -0.05, 0.08, 0.01, 0.02, -0.005], HOME + [0.02, 0.1, -0.03, -0.01, 0.01, 0.01]
    rate, wanted_rate, acceleration = np.full(6, 0.3), np.linspace(-0.4, 0.5, 6), np.linspace(3.0, -4.0, 6)
    expected = {
        "none": REST,
        "gravity": static_torque(ROBOT, pose, GRAVITY),
        "full": inverse_dynamics(ROBOT, wanted, wanted_rate, acceleration, GRAVITY),
    }
    setpoint = Setpoint(wanted, wanted_rate, acceleration)
    output = tick(pose, rate, setpoint, feedforward=kind, feedforward_at=place)
    np.testing.assert_allclose(output.feedforward, expected[kind], atol=1e-11)
    correction = states(output.gain, pose - wanted, rate - wanted_rate, REST)
    np.testing.assert_allclose(output.torque, expected[kind] - correction, rtol=1e-9, atol=1e-9)


def test_bumpless_a_change_of_weights_leaves_the_torque_by_z_as_it_was():
    other, known = np.array([1.0e4, 20.0, 3.0e6, 1.0]), {"integral": Z, "weights": BLOCKS}
    before = tick(before={"integral": Z}, bumpless=True)
    after = tick(weights=other, before=known, bumpless=True)
    np.testing.assert_allclose(after.gain[:, INTEGRAL] @ after.integral, before.gain[:, INTEGRAL] @ Z, rtol=1e-6)
    np.testing.assert_allclose(after.torque, before.torque, rtol=1e-9)
    # Without it the torque jumps; at the first tick there were no weights before.
    assert np.abs(tick(weights=other, before=known).torque - before.torque).max() > 0.05
    np.testing.assert_array_equal(tick(before={"integral": Z}, weights=other, bumpless=True).integral, Z)


@few
@given(vectors(6, 0.15), vectors(6, 0.05), st.sampled_from(["clamp", "back_calculation"]))
def test_torque_and_integral_keep_to_their_limits_and_clamp_stops_the_integral(error, z, saturation):
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


@pytest.mark.parametrize(
    ("axis", "beyond", "margin", "least", "said"),
    [
        (5, 0.13, lambda at: np.abs(leg_geometry(ROBOT, at).transmission).min(), 0.02, ("serial", "crank_dead_centre")),
        (0, 1.335, lambda at: conditioning(ROBOT, at), 0.005, ("parallel", "parallel_singularity")),
    ],
)
def test_a_singularity_ends_the_run_and_is_named(axis, beyond, margin, least, said):
    def far(way):
        return HOME + way * np.eye(6)[axis]

    if said[0] == "serial":
        beyond = brentq(lambda way: reach_margin(ROBOT, far(way)).min() - 1e-9, 0.0, beyond)
    edge = brentq(lambda way: margin(far(way)) - least, 0.0, beyond)
    tick(far(edge - 1e-6))
    with pytest.raises(SingularPoseError) as caught:
        tick(far(edge + 1e-6))
    assert (caught.value.kind, caught.value.reason) == said
    assert caught.value.margin == pytest.approx(least, rel=0.05)


NAN = np.full(6, np.nan)
FAILURES = {
    "pose": ({"pose": NAN}, NotFiniteError, "not_finite"),
    "reference": ({"setpoint": standing(NAN)}, NotFiniteError, "not_finite"),
    "weights": ({"weights": np.array([1.0, np.nan, 1.0, 1.0])}, RiccatiError, "riccati"),
    "singular": ({"pose": HOME + [0, 0, 0.3, 0, 0, 0.115]}, SingularPoseError, "crank_dead_centre"),
}


@pytest.mark.parametrize(("bad", "kind", "reason"), FAILURES.values(), ids=FAILURES.keys())
def test_so_many_bad_ticks_are_bridged_and_no_more_and_a_good_one_starts_anew(bad, kind, reason):
    part = lqi_part(LqiOptions(**EXACT, hold_ticks=3), ROBOT, GRAVITY, 4)
    state = part.initial.copy()

    def run(pose=HOME, setpoint=AT_HOME, weights=BLOCKS):
        part.tick(np.concatenate([pose, REST]), np.concatenate(setpoint), weights, state)
        return state.copy().view(np.recarray)[0]

    with pytest.raises(kind):
        run(**bad)
    for _ in range(2):
        good = run(pose=HOME + 1e-3)
        assert good.bridged == 0.0
        for count in range(1, 4):
            after = run(**bad)
            assert after.bridged == count
            assert np.isfinite(after.torque).all()
            for name in ("gain", "weights", "feedforward", "integral", *["torque"] * (reason == "not_finite")):
                np.testing.assert_array_equal(after[name], good[name])
    with pytest.raises(kind) as caught:
        run(**bad)
    assert caught.value.reason == reason
