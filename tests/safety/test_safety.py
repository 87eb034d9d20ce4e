import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import field_of
from hypothesis import given, settings
from hypothesis import strategies as st
from setups import setup_for
from strategies import ROBOT

from stewart_drake.base.errors import ConfigurationError, SafetyStop, failure_code
from stewart_drake.loop.part import HEALTHY
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY, inverse_dynamics, static_torque
from stewart_drake.safety import (
    HOLD,
    LEVELS,
    MONITORS,
    NONE,
    NOT_THERE,
    RAMP,
    SAFE_HOLD,
    SafetyOptions,
    first_trip,
    refuse_motion,
    refuse_start,
    safety_part,
)
from stewart_drake.safety.limits import first_least

PERIOD = 0.001
HOME = ROBOT.home_pose
STILL = np.zeros(6)
WEIGHT = static_torque(ROBOT, HOME)
OPTIONS = SafetyOptions()


def inputs(command=WEIGHT, pose=HOME, rate=STILL, reference=None, **rest):
    """A tick: `rest` are age, sensor, controller, angles, pose_reading and parity."""
    reference = pose if reference is None else reference
    more = {"age": 0.0, "sensor": HEALTHY, "controller": HEALTHY, "angles": None, "pose_reading": None}
    more["parity"] = NOT_THERE["parity"]
    command = np.asarray(command, dtype=float)
    return SimpleNamespace(
        command=command, pose=np.asarray(pose), rate=np.asarray(rate), reference=reference, **(more | rest)
    )


def run(sequence, options=OPTIONS, period=PERIOD):
    """What the layer says after each tick, and how it ended."""
    part = safety_part(options, setup_for(period=period, initial_torque=WEIGHT))
    state, done = part.initial.copy(), []
    for one in sequence:
        angles = NOT_THERE["angles"] if one.angles is None else one.angles
        read = NOT_THERE["pose_reading"] if one.pose_reading is None else np.concatenate([one.pose_reading, STILL])
        health = (np.array(each, dtype=float) for each in (one.sensor, one.controller))
        measured, wanted = np.concatenate([one.pose, one.rate]), np.concatenate([one.reference, np.zeros(12)])
        try:
            part.tick(
                one.command, measured, wanted, np.array([one.age]), *health, angles, read, np.array(one.parity), state
            )
        except SafetyStop as stop:
            return done, stop
        said = dict(zip(("level", "monitor", "leg"), state["safety"][0].copy(), strict=True))
        said |= {name: state[name][0].copy() for name in ("torque", "worst")}
        done.append(SimpleNamespace(trip=first_trip(state, period, options.monitor_names), **said))
    return done, None


GOOD = inputs()


def at(**offsets):
    pose = HOME.copy()
    for name, value in offsets.items():
        pose[["roll", "pitch", "yaw", "x", "y", "z"].index(name)] += value
    return pose


ASTRAY = inputs(pose=at(y=1e-9), reference=at(x=0.021))  # The robot stands, and its reference is too far away.
FAST = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 2.5])
# Monitor, what trips it in the tick after a good one, the level that it asks for, its switch.
TRIPS = [
    ("measurement_not_finite", inputs(pose=np.full(6, np.nan), reference=HOME), HOLD, None),
    ("sensor_failed", inputs(sensor=(failure_code("encoder"), 2.0)), HOLD, None),
    ("controller_failed", inputs(controller=(failure_code("riccati"), -1.0)), HOLD, None),
    ("command_not_finite", inputs(command=[0, 0, 0, np.nan, 0, 0]), HOLD, None),
    ("deadline", inputs(age=3.0), HOLD, "deadline"),
    ("workspace", inputs(pose=at(x=0.13)), RAMP, "workspace"),
    ("workspace", inputs(pose=at(yaw=1.25)), RAMP, "workspace"),
    ("serial_singularity", inputs(pose=at(z=-0.1110)), RAMP, "transmission"),
    ("parallel_singularity", inputs(pose=at(pitch=-1.10)), RAMP, "conditioning"),
    ("crank_speed", inputs(rate=FAST), RAMP, "crank_speed"),
    ("following_error", inputs(pose=at(y=1e-9), reference=at(x=0.021)), RAMP, "following_error"),
    ("following_error", inputs(pose=at(y=1e-9), reference=at(roll=0.11)), RAMP, "following_error"),
    ("following_error", inputs(reference=np.full(6, np.nan)), RAMP, None),
    ("torque_limit", inputs(command=[0, 0, 0, 0, 1e6, 0]), HOLD, None),
    ("parity", inputs(parity=[1.0, 3.0]), RAMP, None),
    ("deadline", inputs(age=np.nan), HOLD, None),
]


@pytest.mark.parametrize(("monitor", "bad", "level", "switch"), TRIPS, ids=[f"{t[0]}-{i}" for i, t in enumerate(TRIPS)])
def test_a_monitor_trips_by_name_and_level_and_not_where_it_is_off(monitor, bad, level, switch):
    done, _ = run([GOOD, bad])
    assert (MONITORS[int(done[-1].monitor)], done[-1].level) == (monitor, level)
    told = dict.fromkeys(("level", "worst"), LEVELS[level]) | {"monitor": monitor, "time": 0.001}
    assert told.items() <= done[-1].trip.items()
    if switch is not None:
        without, _ = run([GOOD, bad], SafetyOptions(**{switch: None}))
        assert without[-1].monitor != MONITORS.index(monitor)


def test_a_good_tick_passes_the_command_on_to_the_last_bit():
    command = WEIGHT + np.array([0.3, -0.7, 0.123456789, 1e-9, 0.0, 2.0])
    done, _ = run([GOOD, inputs(command=command)])
    np.testing.assert_array_equal(done[-1].torque, command)
    assert done[-1].level == NONE
    assert done[-1].trip is None
    # So the first, whatever it is within the limit; if it is bad, the weight's torque stands in for it.
    np.testing.assert_array_equal(run([inputs(command=np.full(6, 4.9))])[0][0].torque, 4.9)
    (first,), _ = run([inputs(command=np.full(6, np.nan))])
    assert first.level == HOLD
    np.testing.assert_array_equal(first.torque, WEIGHT)


def test_crossing_a_parallel_singularity_between_two_ticks_is_seen():
    # On either side the conditioning is good; the determinant has changed its sign.
    wide = SafetyOptions(workspace=None, following_error=None, horizon=0.0)
    done, _ = run([inputs(pose=at(pitch=-0.95)), inputs(pose=at(pitch=-1.3))], wide)
    assert done[0].level == NONE
    assert MONITORS[int(done[1].monitor)] == "parallel_singularity"


def test_torques_are_cut_at_the_limit_and_trip_when_they_stay_there():
    # 120 ticks, of which the 101st is too many; this robot does not move for it.
    options = SafetyOptions(unexplained_torque=None)
    done, _ = run([GOOD, *[inputs(command=WEIGHT + min(1.0, k / 5.0) * 6.0) for k in range(126)]], options)
    assert max(np.abs(m.torque).max() for m in done) == ROBOT.effort_limit
    tripped = [MONITORS[int(m.monitor)] == "torque_limit" for m in done]
    assert not any(tripped[:100])
    assert any(tripped)
    # Short visits to the limit are forgiven.
    full, well = inputs(command=np.full(6, 5.0)), inputs(command=np.full(6, 4.9))
    done, stop = run([GOOD, *[full, full, well, well] * 100], options)
    assert (stop, done[-1].trip) == (None, None)


def test_a_jump_is_held_for_a_tick_and_then_led_after_at_the_rate():
    options = SafetyOptions(torque_rate=1000.0)
    far = WEIGHT + np.array([0, 0, 3.5, 0, 0, 0])
    done, _ = run([GOOD, GOOD, *[inputs(command=far)] * 6], options)
    np.testing.assert_allclose([m.torque[2] - WEIGHT[2] for m in done[1:]], [0, 0, 1, 2, 3, 3.5, 3.5], atol=1e-12)
    assert done[-1].trip is None


BAD = inputs(command=np.full(6, np.nan))


@pytest.mark.parametrize(
    ("options", "period", "budget"),
    [
        (OPTIONS, 0.001, 20),
        (OPTIONS, 0.005, 6),
        (SafetyOptions(hold_ticks=2), 0.001, 2),
        (SafetyOptions(hold_ticks=0), 0.001, 0),
    ],
)
def test_the_last_good_command_is_held_for_twenty_ticks_and_thirty_milliseconds_at_most(options, period, budget):
    command = WEIGHT + 0.1
    done, _ = run([inputs(command=command), *[BAD] * (budget + 1)], options, period)
    for held in done[1:-1]:
        assert held.level == HOLD
        np.testing.assert_array_equal(held.torque, command)
    assert done[-1].level >= RAMP


def test_a_hold_ends_by_itself_and_a_fault_that_flickers_uses_the_budget_up():
    done, stop = run([GOOD, *[BAD] * 19, inputs(command=WEIGHT + 0.2)])
    assert stop is None
    assert done[-1].level == NONE
    np.testing.assert_array_equal(done[-1].torque, WEIGHT + 0.2)
    assert done[-1].trip["worst"] == "hold"
    done, _ = run([GOOD, *[BAD, GOOD] * 30])
    assert done[-1].level >= RAMP


def test_a_ramp_leads_to_the_weights_torque_within_its_time_and_ends_the_run_with_the_monitors_name():
    command = WEIGHT + np.array([0.2, -0.2, 0.1, 0, 0, 0.05])
    options = SafetyOptions(ramp_time=0.05, safe_hold_time=0.1, unexplained_torque=None)
    done, stop = run([inputs(command=command), *[ASTRAY] * 200], options)
    ramp = [m for m in done if m.level == RAMP]
    safe = [m for m in done if m.level == SAFE_HOLD]
    assert (len(ramp), len(safe)) == (49, 101)
    # It begins at the command, but for the damping of what that does to the robot.
    np.testing.assert_allclose(ramp[0].torque, command, atol=0.05)
    np.testing.assert_allclose(safe[-1].torque, WEIGHT, atol=1e-4)
    assert (stop.reason, stop.leg) == ("following_error", None)


def test_what_is_told_names_the_trip_that_stopped_the_robot_and_not_only_the_first():
    # Held through once, long before; then the reference goes astray, and the run ends while the robot is held.
    done, _ = run([GOOD, BAD, *[GOOD] * 50, *[ASTRAY] * 30], SafetyOptions(safe_hold_time=1e9))
    assert [each.trip["last"] for each in done[1:3]] == ["hold", "none"]
    assert done[2].trip["stopped"] is None
    assert done[-1].trip == {
        "monitor": "command_not_finite",
        "level": "hold",
        "time": 0.001,
        "leg": 0,
        "cause": None,
        "worst": "safe_hold",
        "last": "safe_hold",
        "stopped": {"monitor": "following_error", "time": 0.052, "leg": None},
    }
    # A robot that runs away all the same is given up, and the run says so too; not for a single difference.
    away = [inputs(pose=at(z=0.005 * k), rate=2.0 * FAST) for k in range(15)]
    done, stop = run([GOOD, BAD, GOOD, *away])
    assert (stop.reason, stop.trip["worst"], stop.trip["last"]) == ("crank_speed", "end", "end")
    assert len(done) > 8
    done, stop = run([GOOD, GOOD, away[3], *[GOOD] * 40], SafetyOptions(safe_hold_time=1e9))
    assert (stop, done[-1].trip["stopped"]["monitor"]) == (None, "crank_speed")


def test_without_a_measurement_nothing_is_held_for_longer_than_the_budget():
    blind = inputs(pose=np.full(6, np.nan), reference=HOME)
    done, stop = run([GOOD, *[blind] * 100])
    assert [m.level for m in done[1:]] == [HOLD] * 20
    assert (stop.reason, stop.trip["worst"], stop.trip["time"]) == ("measurement_not_finite", "end", 0.001)
    done, stop = run([GOOD, ASTRAY, *[blind] * 100])
    assert len(done) == 22
    assert (stop.reason, stop.trip["worst"]) == ("following_error", "end")


anything = st.floats(-1e3, 1e3) | st.sampled_from([0.0, np.nan, np.inf, -np.inf, 1e300])
wild = st.builds(
    lambda c, p, r, d, a: inputs(np.array(c), np.array(p), np.array(r), np.array(d), age=a),
    *[st.lists(anything, min_size=6, max_size=6)] * 4,
    st.integers(0, 5).map(float),
)


@pytest.mark.slow
@given(st.lists(wild | st.just(GOOD), min_size=1, max_size=40))
@settings(max_examples=150)
def test_whatever_comes_in_torques_are_finite_and_within_the_limit(sequence):
    done, _ = run(sequence)
    for memory in done:
        assert np.isfinite(memory.torque).all()
        assert np.abs(memory.torque).max() <= ROBOT.effort_limit
    for before, after in itertools.pairwise(done):
        # The layer keeps to its own rate, whatever it does; the first torque has nothing before it.
        assert np.abs(after.torque - before.torque).max() <= OPTIONS.torque_rate * PERIOD * (1.0 + 1e-9)
        # Levels are left downwards from hold alone.
        assert after.level >= before.level or before.level == HOLD
        assert after.worst >= before.worst


def frozen(ticks):
    # Leg that is said to be frozen in the end, -1 for a pose; of the other monitors none may see anything.
    names = ("workspace", "transmission", "conditioning", "crank_speed", "following_error", "unexplained_torque")
    done, _ = run(ticks, SafetyOptions(**dict.fromkeys(names), safe_hold_time=10.0))
    trips = [each.trip for each in done if each.trip is not None]
    if not trips:
        return None
    assert trips[0]["monitor"] == "reading_stuck"
    return -1 if trips[0]["leg"] is None else trips[0]["leg"]


def test_a_constant_pose_while_the_reference_moves_is_frozen():
    def of(poses, wanted):
        return frozen([inputs(reference=w, pose_reading=p) for p, w in zip(poses, wanted, strict=True)])

    moving, still = HOME + np.arange(150)[:, None] * 1e-4 * np.eye(6)[5], np.tile(HOME, (150, 1))
    assert (of(still, moving), of(moving, moving), of(still, still)) == (-1, None, None)
    alive = still + np.spacing(0.3) * (np.arange(150) % 2)[:, None] * np.eye(6)[5]
    assert of(alive, moving) is None


@pytest.mark.parametrize(
    ("motion", "key"),
    [
        (lambda s: at(x=0.13 * s), "workspace"),
        (lambda s: at(yaw=1.25 * s), "workspace"),
        (lambda s: at(z=-0.1110 * s), "transmission"),
        (lambda s: at(pitch=-1.11 * s), "conditioning"),
        (lambda s: at(x=0.0 * s), "crank_speed"),
    ],
)
def test_a_motion_that_would_trip_is_refused_with_its_time(motion, key):
    time = np.linspace(0.0, 1.0, 101)
    pose, rate = np.array([motion(t) for t in time]), np.zeros((101, 6))
    if key == "crank_speed":
        rate[95] = FAST
    with pytest.raises(ConfigurationError) as caught:
        refuse_motion(ROBOT, OPTIONS, 0.0, time, (pose, rate, np.zeros((101, 6))))
    assert field_of(caught.value) == f"safety.{key}"
    assert "t = 0.9" in caught.value.allowed or "t = 1.0" in caught.value.allowed
    refuse_motion(ROBOT, OPTIONS, 0.0, time[:80], (pose[:80], *np.zeros((2, 80, 6))))


def test_a_start_that_would_trip_is_refused():
    refuse_start(ROBOT, OPTIONS, 9.81, HOME, STILL, HOME)
    with pytest.raises(ConfigurationError, match=r"initial_offset.*following_error"):
        refuse_start(ROBOT, OPTIONS, 9.81, at(x=0.03), STILL, HOME)
    # At rest at the start the motors need what the weight needs, whatever the motion is.
    weak = np.abs(WEIGHT).max() / ROBOT.effort_limit
    refuse_start(ROBOT, SafetyOptions(torque_limit=1.001 * weak), STANDARD_GRAVITY, HOME, STILL, HOME)
    with pytest.raises(ConfigurationError, match=r"safety\.torque_limit.*to hold the start pose.*t = 0\.000 s, leg"):
        refuse_start(ROBOT, SafetyOptions(torque_limit=0.999 * weak), STANDARD_GRAVITY, HOME, STILL, HOME)


@pytest.mark.parametrize("name", ["torque_limit", "torque_rate"])
def test_limits_within_which_the_motors_cannot_do_the_motion_are_refused_and_wider_ones_are_not(name):
    # Two slow periods along Z: half of what they need is exceeded for much longer than is allowed.
    time, omega, along = np.arange(0.0, 2.0, PERIOD), 2.0 * np.pi, np.eye(6)[5]
    sine, cosine = (0.003 * wave(omega * time[:, None]) * along for wave in (np.sin, np.cos))
    motion = HOME + sine, omega * cosine, -(omega**2) * sine
    torque = inverse_dynamics(ROBOT, *motion)
    steepest = np.abs(np.diff(torque, axis=0)).max() / PERIOD
    needed = {"torque_limit": np.abs(torque).max() / ROBOT.effort_limit, "torque_rate": steepest}[name]
    refuse_motion(ROBOT, SafetyOptions(**{name: 1.001 * needed}), STANDARD_GRAVITY, time, motion)
    with pytest.raises(ConfigurationError, match=rf"safety\.{name}: .* leg \d"):
        refuse_motion(ROBOT, SafetyOptions(**{name: 0.5 * needed}), STANDARD_GRAVITY, time, motion)


TIED, FIVE = [0.0, 0.5, 1.0, -5e-7, 0.0, 1.0], [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
CASES = [(TIED, 0), ([*TIED[:3], -2e-6, *TIED[4:]], 3), *(([*FIVE[:k], np.nan, *FIVE[k + 1 :]], k) for k in range(6))]


@pytest.mark.parametrize(("values", "leg"), CASES)
def test_the_first_leg_of_a_tie_and_a_leg_that_is_not_a_number_are_named(values, leg):
    assert first_least(np.array(values)) == leg
