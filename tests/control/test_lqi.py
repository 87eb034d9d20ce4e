import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import ROBOT, poses, vectors

from stewart_drake.control.inputs import Measurement, Setpoint
from stewart_drake.control.lqi import LqiMemory, block_weights, flat_tick, held_tick, initial_memory, lqi_gain, lqi_tick
from stewart_drake.control.lqi_options import LqiOptions
from stewart_drake.control.state_space import (
    INTEGRAL,
    POSITION,
    RATE,
    acceleration_map,
    discretize,
    input_matrix,
    state_matrix,
)
from stewart_drake.errors import ConfigurationError, NotFiniteError, RiccatiError, SingularPoseError
from stewart_drake.mechanics.dynamics import inverse_dynamics, pose_acceleration_map, static_torque
from stewart_drake.scenario import Scenario, load_scenario

GRAVITY = 9.81
HOME = ROBOT.home_pose
REST = np.zeros(6)
BLOCKS = np.array([4.0e5, 100.0, 1.0e6, 1.0])
EXACT = {"period": 0.001, "model": "exact", "feedforward": "full", "weight_length": 0.11, "solver": "split"}
HEAVY = ROBOT.replace(rod_mass=0.8, crank_mass=0.4, rod_inertia=(0.016, 0.016, 0.00001))
STANDING = Setpoint(HOME, REST, REST)
few = settings(max_examples=25)
both = pytest.mark.parametrize("compiled", [False, True], ids=["numpy", "compiled"])


def tick(pose=HOME, rate=REST, setpoint=STANDING, weights=BLOCKS, memory=None, robot=ROBOT, gravity=GRAVITY, **options):
    compiled = options.pop("compiled", False)
    options = LqiOptions(**(EXACT | options))
    memory = initial_memory() if memory is None else memory
    return lqi_tick(robot, options, gravity, Measurement(pose, rate), setpoint, np.asarray(weights), memory, compiled)


def with_integral(integral):
    return initial_memory()._replace(integral=np.asarray(integral))


def pose_acceleration(robot, pose, rate, torque, gravity=GRAVITY):
    """q'' under a torque by inverse dynamics alone, which is affine in q''; the forward solution of that equation."""
    bias = inverse_dynamics(robot, pose, rate, REST, gravity)
    inertia = np.stack([inverse_dynamics(robot, pose, rate, e, gravity) - bias for e in np.eye(6)], axis=-1)
    return np.linalg.solve(inertia, torque - bias)


def states(gain, error, rate_error, integral):
    return gain[:, POSITION] @ error + gain[:, RATE] @ rate_error + gain[:, INTEGRAL] @ integral


# --- the exact model -----------------------------------------------------------------------------------------------


@pytest.mark.slow
@few
@given(poses(0.8), vectors(6, 1.0), vectors(6, 3.0), st.sampled_from([ROBOT, HEAVY]))
def test_the_exact_map_is_the_change_of_acceleration_with_the_torque(pose, rate, torque, robot):
    h = 0.1
    columns = [
        (pose_acceleration(robot, pose, rate, torque + h * e) - pose_acceleration(robot, pose, rate, torque - h * e))
        / (2.0 * h)
        for e in np.eye(6)
    ]
    by_differences = np.stack(columns, axis=-1)
    tolerance = 1e-9 * np.abs(by_differences).max()
    np.testing.assert_allclose(pose_acceleration_map(robot, pose), by_differences, atol=tolerance)


@few
@given(poses(0.7), st.sampled_from([ROBOT, HEAVY]), st.sampled_from(["drake", "split"]))
def test_the_gain_is_the_one_for_the_chosen_model(pose, robot, solver):
    options = LqiOptions(period=0.005, solver=solver)
    for model, expected in (("exact", pose_acceleration_map), ("paper", acceleration_map)):
        gain = tick(pose, robot=robot, model=model, period=0.005, solver=solver, weight_length=1.0).gain
        wanted = lqi_gain(expected(robot, pose), options, BLOCKS)
        np.testing.assert_allclose(gain, wanted, rtol=0.0, atol=1e-9 * np.abs(wanted).max())
    assert not np.allclose(gain, tick(pose, robot=robot, period=0.005, weight_length=1.0).gain, rtol=0.05)


@few
@given(poses(0.7), vectors(6, 0.5), vectors(6, 3.0), vectors(6, 0.01), vectors(6, 0.1), vectors(6, 1e-3))
def test_with_full_feedforward_the_error_obeys_the_linear_law(pose, rate, acceleration, error, rate_error, integral):
    """e'' = -A K [e; e'; z] exactly: no gravity, no Coriolis term, no leg is left over."""
    setpoint = Setpoint(pose - error, rate - rate_error, acceleration)
    for compiled in (False, True):
        output = tick(pose, rate, setpoint, memory=with_integral(integral), robot=HEAVY, compiled=compiled)
        found = pose_acceleration(HEAVY, pose, rate, output.torque) - acceleration
        law = -pose_acceleration_map(HEAVY, pose) @ states(output.gain, error, rate_error, integral)
        np.testing.assert_allclose(found, law, atol=1e-8 * (1.0 + np.abs(law).max()))
        # And without an error the acceleration is the reference's.
        calm = tick(pose, rate, Setpoint(pose, rate, acceleration), robot=HEAVY, compiled=compiled)
        np.testing.assert_allclose(pose_acceleration(HEAVY, pose, rate, calm.torque), acceleration, atol=1e-8)


@both
def test_feedforward_is_taken_where_the_option_says(compiled):
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
        output = tick(pose, rate, setpoint, feedforward=kind, feedforward_at=at, compiled=compiled)
        np.testing.assert_allclose(output.feedforward, torque, atol=1e-11)
        correction = states(output.gain, pose - wanted, rate - wanted_rate, REST)
        np.testing.assert_allclose(output.torque, torque - correction, rtol=1e-9, atol=1e-9)


@both
def test_full_feedforward_without_gravity_has_none(compiled):
    acceleration = np.array([3.0, 2.0, -4.0, 1.0, -1.0, 2.0])
    output = tick(setpoint=Setpoint(HOME, REST, acceleration), gravity=0.0, compiled=compiled)
    np.testing.assert_allclose(output.torque, inverse_dynamics(ROBOT, HOME, REST, acceleration, 0.0), atol=1e-12)


# --- weights -------------------------------------------------------------------------------------------------------


@few
@given(poses(0.7), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.sampled_from(["drake", "split"]))
def test_the_papers_pair_is_a_special_case_of_the_blocks(pose, log_q, log_r, solver):
    q, r = 10.0**log_q, 10.0**log_r
    pair, blocks = (
        tick(pose, weights=w, model="paper", weight_length=1.0, solver=solver) for w in ([q, r], [q, q, q, r])
    )
    np.testing.assert_array_equal(pair.gain, blocks.gain)
    np.testing.assert_array_equal(pair.weights, [q, q, q, r])


@few
@given(poses(0.7), st.sampled_from(["drake", "split"]), st.sampled_from([0.05, 0.11, 3.0]))
def test_weight_length_weighs_a_rotation_like_the_path_at_that_radius(pose, solver, length):
    """The gain for q is that for rotations in metres, length * angle, with nothing scaled: K for x = S x'."""
    scaled = np.array([length] * 3 + [1.0] * 3)
    own = pose_acceleration_map(ROBOT, pose)
    blocks = np.array([1e3, 10.0, 1e3, 1.0])
    gain = lqi_gain(own, LqiOptions(solver=solver, weight_length=length), blocks)
    in_metres = lqi_gain(scaled[:, None] * own, LqiOptions(solver=solver), blocks)
    for part in (POSITION, RATE, INTEGRAL):
        expected = in_metres[:, part] * scaled
        np.testing.assert_allclose(gain[:, part], expected, rtol=0.0, atol=1e-8 * np.abs(expected).max())


@few
@given(poses(0.7), st.floats(0.0, 5.0), st.floats(-1.0, 3.0), st.floats(0.0, 6.0))
def test_the_closed_loop_of_the_gain_is_stable(pose, log_e, log_v, log_z):
    blocks = np.array([10.0**log_e, 10.0**log_v, 10.0**log_z, 1.0])
    gain = tick(pose, weights=blocks).gain
    a, b = discretize(state_matrix(), input_matrix(pose_acceleration_map(ROBOT, pose)), EXACT["period"])
    assert np.abs(np.linalg.eigvals(a - b @ gain)).max() < 1.0


BAD_WEIGHTS = {
    "zero": [1.0, 0.0],
    "negative": [1.0, 1.0, -1.0, 1.0],
    "not a number": [np.nan, 1.0],
    "infinite": [1.0, 1.0, np.inf, 1.0],
    "one": [1.0],
    "three": [1.0, 1.0, 1.0],
    "five": [1.0] * 5,
    "none": [],
    "square": np.ones((2, 2)),
}


@both
@pytest.mark.parametrize("weights", [w for w in BAD_WEIGHTS.values() if np.ndim(w) == 1])
def test_bad_weights_end_a_tick_with_a_named_error(weights, compiled):
    with pytest.raises(RiccatiError, match="weights") as caught:
        tick(weights=np.array(weights, dtype=float), compiled=compiled)
    assert caught.value.reason == "riccati"


@pytest.mark.parametrize("weights", BAD_WEIGHTS.values(), ids=BAD_WEIGHTS.keys())
def test_block_weights_takes_two_or_four_positive_numbers_and_nothing_else(weights):
    with pytest.raises(RiccatiError):
        block_weights(weights)
    np.testing.assert_array_equal(block_weights([3, 2]), [3.0, 3.0, 3.0, 2.0])
    np.testing.assert_array_equal(block_weights([4, 3, 2, 1]), [4.0, 3.0, 2.0, 1.0])


def test_compiled_is_a_wish_beside_the_controller_and_an_older_file_is_read_with_a_note():
    split = Scenario.from_dict({"compiled": True, "controller": {"solver": "split"}})
    for old in ({"controller": {"solver": "split", "compiled": True}}, {"compiled": False, **split.to_dict()}):
        if "compiled" in old["controller"]:
            with pytest.warns(FutureWarning, match=r"controller\.compiled is the scenario's own key"):
                assert Scenario.from_dict(old) == split
        else:
            assert Scenario.from_dict(old) == split
    # A wish, which a controller that cannot be compiled does not hear: an override may set another one.
    for controller in ({"period": 0.005}, {"kind": "pid"}):
        wished = split.replace({"controller": controller})
        assert wished.compiled
        assert not wished.controller.compiles
    with pytest.warns(FutureWarning):
        assert not load_scenario("exact_fig7", ["controller.compiled=false"]).compiled
    with (
        pytest.warns(FutureWarning),
        pytest.raises(ConfigurationError, match=r"^controller\.compiled: got True; allowed: False, .* own key"),
    ):
        Scenario.from_dict({"compiled": False, "controller": {"solver": "split", "compiled": True}})


# --- changes of weights --------------------------------------------------------------------------------------------

OTHER = np.array([1.0e4, 20.0, 3.0e6, 1.0])


@pytest.mark.parametrize(("solver", "compiled"), [("drake", False), ("split", False), ("split", True)])
def test_bumpless_a_change_of_weights_leaves_the_torque_by_z_as_it_was(solver, compiled):
    options = {"bumpless": True, "solver": solver, "compiled": compiled}
    z = np.array([1e-3, -2e-3, 1e-3, 3e-4, -1e-4, 2e-4])
    before = tick(memory=with_integral(z), **options)
    np.testing.assert_array_equal(before.integral, z)
    after = tick(memory=before, weights=OTHER, **options)
    by_z = before.gain[:, INTEGRAL] @ z
    np.testing.assert_allclose(after.gain[:, INTEGRAL] @ after.integral, by_z, rtol=1e-6)
    np.testing.assert_allclose(after.torque, before.torque, rtol=1e-9)
    # Without it the torque jumps, and that is what would be seen.
    jump = tick(memory=before, weights=OTHER, **options | {"bumpless": False})
    assert np.abs(jump.torque - before.torque).max() > 0.05


@both
def test_bumpless_touches_z_only_when_weights_change(compiled):
    z = np.array([1e-3, -2e-3, 1e-3, 3e-4, -1e-4, 2e-4])
    options = {"bumpless": True, "compiled": compiled}
    first = tick(memory=with_integral(z), **options)
    same = tick(HOME + 0.01, memory=first, **options)
    np.testing.assert_array_equal(same.integral, z + EXACT["period"] * (HOME + 0.01 - HOME))
    # Nor at the first tick, before which there were no weights.
    np.testing.assert_array_equal(tick(memory=with_integral(z), weights=OTHER, **options).integral, z)


# --- limits --------------------------------------------------------------------------------------------------------


@few
@given(
    vectors(6, 0.15),
    vectors(6, 0.05),
    st.sampled_from(["clamp", "back_calculation"]),
    st.booleans(),
    st.sampled_from([None, (1e-3, 1e-4)]),
)
def test_the_torque_never_exceeds_the_limit_nor_z_its_own(error, z, saturation, compiled, limit):
    output = tick(
        HOME,
        setpoint=Setpoint(HOME - error, REST, REST),
        memory=with_integral(z),
        saturation=saturation,
        compiled=compiled,
        integral_limit=limit,
    )
    free = tick(HOME, setpoint=Setpoint(HOME - error, REST, REST), memory=with_integral(z)).torque
    np.testing.assert_allclose(output.torque, np.clip(free, -ROBOT.effort_limit, ROBOT.effort_limit), rtol=1e-8)
    assert np.abs(output.torque).max() <= ROBOT.effort_limit
    if limit is not None:
        assert np.abs(output.integral[:3]).max() <= limit[0]
        assert np.abs(output.integral[3:]).max() <= limit[1]


@both
def test_clamp_holds_z_while_a_motor_is_at_its_limit_and_only_then(compiled):
    z = np.array([1e-3, -2e-3, 1e-3, 3e-4, -1e-4, 2e-4])
    far, near = (Setpoint(HOME - step, REST, REST) for step in (0.1, 1e-5))
    options = {"saturation": "clamp", "compiled": compiled}
    np.testing.assert_array_equal(tick(setpoint=far, memory=with_integral(z), **options).integral, z)
    moved = tick(setpoint=near, memory=with_integral(z), **options).integral
    np.testing.assert_allclose(moved, z + EXACT["period"] * 1e-5, rtol=1e-9)


@both
def test_back_calculation_takes_off_z_what_was_cut_off_the_torque(compiled):
    z, step = np.array([1e-3, -2e-3, 1e-3, 3e-4, -1e-4, 2e-4]), np.full(6, 0.05)
    far = Setpoint(HOME - step, REST, REST)
    for reset_time, share in ((0.05, EXACT["period"] / 0.05), (1e-5, 1.0)):
        options = {"saturation": "back_calculation", "reset_time": reset_time, "compiled": compiled}
        output = tick(setpoint=far, memory=with_integral(z), **options)
        wanted = output.feedforward - states(output.gain, step, REST, z)
        cut = wanted - output.torque
        assert np.abs(cut).max() > 1.0
        led_back = output.integral - EXACT["period"] * step - z
        np.testing.assert_allclose(output.gain[:, INTEGRAL] @ led_back, share * cut, rtol=1e-6, atol=1e-9)


def step_response(saturation, compiled=True, ticks=1500):
    """The linear model e'' = A u under the limit of the motors, from 60 mm; the error along z."""
    weak = ROBOT.replace(effort_limit=0.6)
    options = LqiOptions(**EXACT | {"saturation": saturation, "reset_time": 0.02})
    run = flat_tick(weak, options, GRAVITY, compiled)
    blocks = np.array([1.0e3, 1.0, 1.0e5, 1.0])
    drive, hold = pose_acceleration_map(weak, HOME), static_torque(weak, HOME, GRAVITY)
    t, error, rate, memory, path = options.period, np.array([0, 0, 0, 0, 0, -0.06]), REST, initial_memory().flat(), []
    for _ in range(ticks):
        # The robot itself stays at home, so that the model stays linear; the reference moves instead.
        reference = np.concatenate([HOME - error, -rate, REST])
        memory = run(np.concatenate([HOME, REST]), reference, blocks, memory)
        acceleration = drive @ (np.clip(memory[:6], -weak.effort_limit, weak.effort_limit) - hold)
        error, rate = error + t * rate + 0.5 * t * t * acceleration, rate + t * acceleration
        path.append(error[5])
    return np.array(path)


@pytest.mark.slow
def test_anti_windup_takes_the_overshoot_off_a_step_that_saturates():
    paths = {kind: step_response(kind) for kind in ("none", "clamp", "back_calculation")}
    overshoot = {kind: path.max() for kind, path in paths.items()}
    assert overshoot["none"] > 0.01
    assert overshoot["clamp"] < 0.7 * overshoot["none"]
    assert overshoot["back_calculation"] < 0.7 * overshoot["none"]
    for path in paths.values():
        assert np.abs(path[-100:]).max() < 0.002
    for kind in ("clamp", "back_calculation"):
        np.testing.assert_allclose(step_response(kind, compiled=False, ticks=200), paths[kind][:200], atol=1e-9)


# --- ticks that fail -----------------------------------------------------------------------------------------------


class Runner:
    """Ticks one after the other, by the pure function or by the flat one that the LeafSystem calls."""

    def __init__(self, flat, compiled, **options):
        self.options = LqiOptions(**EXACT | options)
        self.compiled = compiled
        self.flat = flat_tick(ROBOT, self.options, GRAVITY, compiled) if flat else None
        self.memory = initial_memory()

    def __call__(self, pose=HOME, rate=REST, setpoint=STANDING, weights=BLOCKS):
        if self.flat is not None:
            vectors_ = np.concatenate([pose, rate]), np.concatenate(setpoint)
            self.memory = LqiMemory.from_flat(self.flat(*vectors_, np.asarray(weights), self.memory.flat()))
        else:
            measurement = Measurement(pose, rate)
            self.memory = held_tick(
                ROBOT, self.options, GRAVITY, measurement, setpoint, weights, self.memory, self.compiled
            )
        return self.memory


runners = pytest.mark.parametrize(("flat", "compiled"), [(False, False), (False, True), (True, False), (True, True)])
NAN = np.full(6, np.nan)
HIGH = HOME + [0, 0, 0.3, 0, 0, 0.115]
FAILURES = {
    "pose": ({"pose": NAN}, NotFiniteError, "not_finite"),
    "rate": ({"rate": NAN}, NotFiniteError, "not_finite"),
    "reference": ({"setpoint": Setpoint(NAN, REST, REST)}, NotFiniteError, "not_finite"),
    "weights": ({"weights": np.array([1.0, np.nan])}, RiccatiError, "riccati"),
    "singular": ({"pose": HIGH}, SingularPoseError, "crank_dead_centre"),
}


@runners
@pytest.mark.parametrize(("bad", "kind", "reason"), FAILURES.values(), ids=FAILURES.keys())
def test_so_many_bad_ticks_are_bridged_and_no_more_and_a_good_one_starts_anew(bad, kind, reason, flat, compiled):
    run = Runner(flat, compiled, hold_ticks=3)
    good = run(pose=HOME + 1e-3)
    for _ in range(2):
        for count in range(1, 4):
            held = run(**bad)
            assert held.held == count
            assert np.isfinite(held.torque).all()
            np.testing.assert_array_equal(held.gain, good.gain)
            np.testing.assert_array_equal(held.weights, good.weights)
            np.testing.assert_array_equal(held.feedforward, good.feedforward)
            np.testing.assert_array_equal(held.integral, good.integral)
        good = run(pose=HOME + 1e-3)
        assert good.held == 0.0
    for _ in range(3):
        run(**bad)
    with pytest.raises(kind) as caught:
        run(**bad)
    assert caught.value.reason == reason


@runners
def test_without_leave_to_bridge_or_before_a_good_tick_a_bad_one_ends_the_run(flat, compiled):
    for hold_ticks in (0, 5):
        run = Runner(flat, compiled, hold_ticks=hold_ticks)
        with pytest.raises(NotFiniteError):
            run(pose=NAN)
    run = Runner(flat, compiled)
    run()
    with pytest.raises(NotFiniteError):
        run(pose=NAN)


@runners
@pytest.mark.parametrize("saturation", ["none", "clamp"])
def test_a_bridged_tick_goes_on_with_the_last_gain_at_the_pose_of_now(flat, compiled, saturation):
    run = Runner(flat, compiled, hold_ticks=1, saturation=saturation)
    good = run(pose=HOME + 1e-3)
    pose, rate = HOME + 0.03, np.full(6, 0.01)
    held = run(pose=pose, rate=rate, weights=np.array([1.0, -1.0]))
    expected = good.feedforward - states(good.gain, np.full(6, 0.03), rate, good.integral)
    limit = np.inf if saturation == "none" else ROBOT.effort_limit
    np.testing.assert_allclose(held.torque, np.clip(expected, -limit, limit), rtol=1e-9)
    np.testing.assert_allclose(held.error, 0.03, rtol=1e-9)
    assert np.abs(expected).max() > ROBOT.effort_limit


@runners
@pytest.mark.parametrize("bad", ["pose", "rate", "reference"])
def test_what_is_not_finite_is_bridged_by_the_last_torque(bad, flat, compiled):
    run = Runner(flat, compiled, hold_ticks=2)
    good = run(pose=HOME + 1e-3)
    for _ in range(2):
        held = run(**FAILURES[bad][0])
        np.testing.assert_array_equal(held.torque, good.torque)


def test_memory_survives_being_flat():
    memory = LqiMemory(*(np.random.default_rng(k).normal(size=n) for k, n in enumerate((6, 6, 6))), *(
        np.arange(108.0).reshape(6, 18), np.arange(6.0), np.arange(4.0), 7.0))  # fmt: skip
    back = LqiMemory.from_flat(memory.flat())
    for name in LqiMemory._fields:
        np.testing.assert_array_equal(getattr(back, name), getattr(memory, name))
