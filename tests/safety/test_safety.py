import dataclasses
import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import field_of
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import ROBOT, poses, vectors

from stewart_drake.errors import ConfigurationError, SafetyStop, failure_code
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY, inverse_dynamics, static_torque
from stewart_drake.mechanics.kinematics import (
    forward_kinematics,
    inverse_kinematics,
    leg_geometry,
    pose_rate_to_twist,
    twist_jacobian,
)
from stewart_drake.part import WELL
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

PERIOD = 0.001
HOME = ROBOT.home_pose
STILL = np.zeros(6)
WEIGHT = static_torque(ROBOT, HOME)
OPTIONS = SafetyOptions()


def inputs(command=WEIGHT, pose=HOME, rate=STILL, reference=None, **rest):
    """A tick: `rest` are age, sensor, controller, surprise, angles and pose_reading."""
    reference = pose if reference is None else reference
    more = {"age": 0.0, "sensor": WELL, "controller": WELL, "surprise": 0.0, "angles": None, "pose_reading": None}
    command = np.asarray(command, dtype=float)
    return SimpleNamespace(
        command=command, pose=np.asarray(pose), rate=np.asarray(rate), reference=reference, **(more | rest)
    )


def run(sequence, options=OPTIONS, period=PERIOD, quantum=0.0):
    """What the layer says after each tick, and how it ended."""
    part = safety_part(ROBOT, options, STANDARD_GRAVITY, period, WEIGHT, quantum)
    state, done = part.initial.copy(), []
    for one in sequence:
        angles = NOT_THERE["angles"] if one.angles is None else one.angles
        read = NOT_THERE["pose_reading"] if one.pose_reading is None else np.concatenate([one.pose_reading, STILL])
        health = (np.array(each, dtype=float) for each in (one.sensor, one.controller))
        measured, wanted = np.concatenate([one.pose, one.rate]), np.concatenate([one.reference, np.zeros(12)])
        odd = np.eye(6)[3] * one.surprise
        try:
            part.tick(one.command, measured, wanted, np.array([one.age]), *health, angles, odd, read, state)
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


SINKING = at(z=-0.1110)
TILTED = at(pitch=-1.10)
FAST = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 2.5])
# Monitor, what trips it within two ticks after a good one, the level that it asks for, its switch.
TRIPS = [
    ("measurement_not_finite", inputs(pose=np.full(6, np.nan), reference=HOME), HOLD, "finite"),
    ("measurement_not_finite", inputs(rate=np.full(6, np.inf)), HOLD, "finite"),
    ("sensor_failed", inputs(sensor=(failure_code("encoder"), 2.0)), HOLD, "failures"),
    ("controller_failed", inputs(controller=(failure_code("riccati"), -1.0)), HOLD, "failures"),
    ("command_not_finite", inputs(command=[0, 0, 0, np.nan, 0, 0]), HOLD, "finite"),
    ("command_not_finite", inputs(command=[0, 0, 0, -np.inf, 0, 0]), HOLD, "finite"),
    ("deadline", inputs(age=3.0), HOLD, "deadline"),
    ("torque_limit", inputs(command=[0, 0, 0, 0, 1e6, 0]), HOLD, "torque_limit"),
    ("workspace", inputs(pose=at(x=0.13)), RAMP, "workspace"),
    ("workspace", inputs(pose=at(yaw=1.25)), RAMP, "workspace"),
    ("serial_singularity", inputs(pose=SINKING), RAMP, "transmission"),
    ("serial_singularity", inputs(pose=at(z=-0.119)), RAMP, "transmission"),
    ("parallel_singularity", inputs(pose=TILTED), RAMP, "conditioning"),
    ("crank_speed", inputs(rate=FAST), RAMP, "crank_speed"),
    ("following_error", inputs(pose=at(y=1e-9), reference=at(x=0.021)), RAMP, "following_error"),
    ("following_error", inputs(pose=at(y=1e-9), reference=at(roll=0.11)), RAMP, "following_error"),
    ("following_error", inputs(reference=np.full(6, np.nan)), RAMP, "following_error"),
]


def off(switch):
    return SafetyOptions(**{switch: False if switch in ("finite", "failures") else None})


# --- monitors -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("monitor", "bad", "level", "switch"), TRIPS, ids=[f"{t[0]}-{i}" for i, t in enumerate(TRIPS)])
def test_a_monitor_trips_by_name_and_level_and_not_where_it_is_off(monitor, bad, level, switch):
    done, _ = run([GOOD, bad])
    assert (MONITORS[int(done[-1].monitor)], done[-1].level) == (monitor, level)
    told = dict.fromkeys(("level", "worst"), LEVELS[level]) | {"monitor": monitor, "time": 0.001}
    assert told.items() <= done[-1].trip.items()
    if switch != "torque_limit" and not np.isnan(bad.reference).any():
        without, _ = run([GOOD, bad], off(switch))
        assert without[-1].monitor != MONITORS.index(monitor)


def test_innovations_may_be_large_for_a_blow_and_no_longer():
    odd = inputs(surprise=101.0)
    done, stop = run([GOOD, *[odd] * 10, *[GOOD] * 20, *[odd] * 11])
    assert stop is None
    assert all(memory.level == 0.0 for memory in done[:-1])
    trip = done[-1].trip
    assert (trip["monitor"], trip["level"], trip["leg"], trip["time"]) == ("innovation", "ramp", None, 0.041)
    for options in (SafetyOptions(innovation=None), SafetyOptions(innovation=102.0)):
        done, _ = run([GOOD, *[odd] * 50], options)
        assert done[-1].monitor == 0.0


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


@given(poses(0.8), vectors(6, 0.3))
def test_the_leg_of_a_serial_singularity_and_the_crank_speed_are_those_of_the_kinematics(pose, rate):
    transmission = np.abs(leg_geometry(ROBOT, pose).transmission)
    narrow = SafetyOptions(transmission=min(0.999, transmission.min() * 1.0001), horizon=0.0)
    done, _ = run([inputs(pose=pose)], narrow)
    if transmission.min() < 0.99:
        assert MONITORS[int(done[-1].monitor)] == "serial_singularity"
        # Of legs that are alike to the last bits either will do.
        assert transmission[int(done[-1].leg)] == pytest.approx(transmission.min(), rel=1e-12)
    # Of Euler rates zero, so that the twist is the rate.
    speed = np.abs(twist_jacobian(ROBOT, pose)[:, 3:] @ rate[3:])
    moving = inputs(pose=pose, rate=np.concatenate([np.zeros(3), rate[3:]]))
    for factor, trips in ((1.0001, False), (0.9999, True)):
        if speed.max() > 1e-6:
            done, _ = run([GOOD, moving], SafetyOptions(crank_speed=speed.max() * factor, horizon=0.0))
            assert (MONITORS[int(done[-1].monitor)] == "crank_speed") == trips


def test_crossing_a_parallel_singularity_between_two_ticks_is_seen():
    # On either side the conditioning is good; the determinant has changed its sign.
    wide = SafetyOptions(workspace=None, following_error=None, horizon=0.0)
    done, _ = run([inputs(pose=at(pitch=-0.95)), inputs(pose=at(pitch=-1.3))], wide)
    assert done[0].level == NONE
    assert MONITORS[int(done[1].monitor)] == "parallel_singularity"


# --- torque limits --------------------------------------------------------------------------------------------------


def test_torques_are_cut_at_the_limit_and_trip_when_they_stay_there():
    # 120 ticks, of which the 101st is too many.
    rising = [inputs(command=WEIGHT + min(1.0, k / 5.0) * 6.0) for k in range(126)]
    done, _ = run([GOOD, *rising])
    assert max(np.abs(m.torque).max() for m in done) <= ROBOT.effort_limit
    tripped = [MONITORS[int(m.monitor)] == "torque_limit" for m in done]
    assert not any(tripped[:100])
    assert any(tripped)
    half = SafetyOptions(torque_limit=0.5)
    done, _ = run([GOOD, *rising[:20]], half)
    assert max(np.abs(m.torque).max() for m in done) == 0.5 * ROBOT.effort_limit
    # Short visits to the limit are forgiven.
    full, well = inputs(command=np.full(6, 5.0)), inputs(command=np.full(6, 4.9))
    done, stop = run([GOOD, *[full, full, well, well] * 100])
    assert stop is None
    assert done[-1].trip is None


def test_a_jump_is_held_for_a_tick_and_then_led_after_at_the_rate():
    options = SafetyOptions(torque_rate=1000.0)
    far = WEIGHT + np.array([0, 0, 3.5, 0, 0, 0])
    done, _ = run([GOOD, GOOD, *[inputs(command=far)] * 6], options)
    np.testing.assert_allclose([m.torque[2] - WEIGHT[2] for m in done[1:]], [0, 0, 1, 2, 3, 3.5, 3.5], atol=1e-12)
    assert done[-1].trip is None


def test_a_command_that_chatters_trips_and_leaves_no_mean_torque():
    chatter = [inputs(command=WEIGHT + 4.5 * (-1.0) ** k) for k in range(20)]
    done, _ = run([GOOD, GOOD, *chatter])
    assert MONITORS[int(done[-1].monitor)] == "torque_rate"
    np.testing.assert_allclose([m.torque for m in done], np.tile(WEIGHT, (len(done), 1)), atol=1e-12)
    without, stop = run([GOOD, GOOD, *chatter], SafetyOptions(torque_rate=None))
    assert stop is None
    assert without[-1].trip is None


# --- levels ---------------------------------------------------------------------------------------------------------

BAD = inputs(command=np.full(6, np.nan))


@pytest.mark.parametrize(
    ("options", "period", "budget"),
    [
        (OPTIONS, 0.001, 20),
        (OPTIONS, 0.005, 6),
        (OPTIONS, 0.002, 15),
        (SafetyOptions(hold_ticks=3), 0.001, 3),
        (SafetyOptions(hold_time=0.002), 0.001, 2),
        (SafetyOptions(hold_ticks=0), 0.001, 0),
    ],
)
def test_the_last_good_command_is_held_for_twenty_ticks_and_thirty_milliseconds_at_most(options, period, budget):
    assert options.budget(period) == budget
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
    command, pose = WEIGHT + np.array([1, -1, 2, 0, 0, 0.5]), at(x=0.13)
    options = SafetyOptions(ramp_time=0.05, safe_hold_time=0.1)
    trip = inputs(pose=pose)
    done, stop = run([inputs(command=command), *[trip] * 200], options)
    ramp = [m for m in done if m.level == RAMP]
    safe = [m for m in done if m.level == SAFE_HOLD]
    assert (len(ramp), len(safe)) == (49, 101)
    weight = static_torque(ROBOT, pose)
    for k, memory in enumerate(ramp):
        share = (k + 1) / 50
        np.testing.assert_allclose(memory.torque, (1 - share) * command + share * weight, atol=1e-9)
    np.testing.assert_allclose(safe[-1].torque, weight, atol=1e-12)
    assert (stop.reason, stop.leg) == ("workspace", None)
    assert stop.trip == {
        "monitor": "workspace",
        "level": "ramp",
        "time": 0.001,
        "leg": None,
        "cause": None,
        "worst": "safe_hold",
        "last": "safe_hold",
        "stopped": {"monitor": "workspace", "time": 0.001, "leg": None},
    }


def test_what_is_told_names_the_trip_that_stopped_the_robot_and_not_only_the_first():
    # Held through once, long before; then the robot leaves the workspace, and the run ends while it is held there.
    done, _ = run([GOOD, BAD, *[GOOD] * 50, *[inputs(pose=at(x=0.13))] * 30], SafetyOptions(safe_hold_time=1e9))
    told = [memory.trip for memory in done]
    assert told[0] is None
    assert [t["last"] for t in told[1:3]] == ["hold", "none"]
    assert [t["stopped"] for t in told[1:3]] == [None, None]
    assert (told[-1]["monitor"], told[-1]["time"], told[-1]["last"]) == ("command_not_finite", 0.001, "safe_hold")
    assert {str(t["stopped"]) for t in told[52:]} == {"{'monitor': 'workspace', 'time': 0.052, 'leg': None}"}
    # A robot that runs away all the same is given up, and the run says so too.
    done, stop = run([GOOD, BAD, GOOD, inputs(rate=FAST), inputs(rate=2.0 * FAST)])
    assert (len(done), stop.reason, stop.trip["worst"], stop.trip["last"]) == (4, "crank_speed", "end", "end")


def test_without_the_guard_other_failures_blind_nobody():
    unguarded, failed = SafetyOptions(failures=False), (failure_code("encoder"), 2.0)
    done, _ = run([GOOD, inputs(pose=at(x=0.13), sensor=failed)], unguarded)
    assert MONITORS[int(done[-1].monitor)] == "workspace"
    told = run([GOOD, inputs(sensor=failed)])[0][-1].trip
    assert (told["cause"], told["leg"]) == ("encoder", 2)


@pytest.mark.parametrize(
    ("bad", "monitor"),
    [
        ({"age": np.nan}, "deadline"),
        ({"sensor": (np.nan, np.nan)}, "sensor_failed"),
        ({"controller": (np.nan, 0.0)}, "controller_failed"),
    ],
)
def test_a_message_that_is_not_a_number_is_no_good_one(bad, monitor):
    (said,), _ = run([inputs(**bad)])
    assert (MONITORS[int(said.monitor)], said.level) == (monitor, HOLD)


@settings(max_examples=15)
@given(vectors(6, 0.4))
def test_the_safe_hold_takes_energy_out(rate):
    done, _ = run([GOOD, *[inputs(pose=at(x=0.13), rate=rate)] * 30], SafetyOptions(horizon=0.0))
    held = done[-1]
    assert held.level == SAFE_HOLD
    speed = twist_jacobian(ROBOT, at(x=0.13)) @ pose_rate_to_twist(at(x=0.13), rate)
    power = (held.torque - static_torque(ROBOT, at(x=0.13))) @ speed
    assert power <= 1e-12
    if np.abs(speed).max() > 1e-3:
        assert power < 0.0


def test_without_a_measurement_nothing_is_held_for_longer_than_the_budget():
    blind = inputs(pose=np.full(6, np.nan), reference=HOME)
    done, stop = run([GOOD, *[blind] * 100])
    assert [m.level for m in done[1:]] == [HOLD] * 20
    assert (stop.reason, stop.trip["worst"], stop.trip["time"]) == ("measurement_not_finite", "end", 0.001)
    # Nor when it is lost while the robot is stopping.
    done, stop = run([GOOD, inputs(pose=at(x=0.13)), *[blind] * 100])
    assert len(done) == 22
    assert (stop.reason, stop.trip["worst"]) == ("workspace", "end")


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


# --- frozen sensors -------------------------------------------------------------------------------------------------


def frozen(readings, reference=None, options=OPTIONS, quantum=0.0, wanted=None):
    """Leg that is said to be frozen in the end; with a reference readings are poses, else `wanted` are poses."""
    # Of the other monitors none may see anything.
    names = ("workspace", "transmission", "conditioning", "crank_speed", "following_error")
    options = dataclasses.replace(options, **dict.fromkeys(names), safe_hold_time=10.0)
    ticks = []
    for k, reading in enumerate(readings):
        if reference is None:
            ticks.append(inputs(reference=wanted[k], angles=reading))
        else:
            ticks.append(inputs(reference=reference[k], pose_reading=reading))
    done, _ = run(ticks, options, quantum=quantum)
    trips = [each for each in done if each.trip is not None]
    if not trips:
        return None
    assert (trips[0].trip["monitor"], trips[0].trip["cause"]) == ("reading_stuck", None)
    return -1 if trips[0].trip["leg"] is None else trips[0].trip["leg"]


def test_an_encoder_that_stands_while_others_turn_is_named():
    wanted = HOME + np.arange(100)[:, None] * 2e-4 * np.eye(6)[5]
    turning = inverse_kinematics(ROBOT, wanted)
    jump = np.tile(turning[0], (100, 1))
    jump[50:, 2] += 0.3
    for well, where in ((turning, wanted), (np.tile(turning[0], (100, 1)), wanted), (jump, 0.0 * wanted + HOME)):
        assert frozen(well, wanted=where) is None
    stuck = turning.copy()
    stuck[20:, 4] = stuck[20, 4]
    # The others have turned by 0.04 rad after this many ticks.
    late = int(np.searchsorted(turning[:, 0], turning[20, 0] + OPTIONS.frozen_encoder))
    assert late < 90
    assert frozen(stuck[: late - 1], wanted=wanted) is None
    assert frozen(stuck[: late + 2], wanted=wanted) == 4
    assert frozen(stuck, wanted=wanted, options=SafetyOptions(frozen_encoder=None)) is None
    # Coarse encoders stand still for longer.
    assert frozen(stuck[: late + 2], wanted=wanted, quantum=0.001) is None
    # Nobody can say where a crank is wanted for a pose that is out of reach.
    assert frozen(stuck, wanted=wanted + 1.0) == 4


def test_a_crank_that_friction_holds_where_it_turns_back_is_not_frozen():
    # Crank 4 goes up and down by 0.008 rad while the others turn by 0.1 rad, and sticks all the while.
    time = np.linspace(0.0, np.pi, 200)[:, None]
    angles = inverse_kinematics(ROBOT, HOME) + np.where(np.arange(6) == 4, 0.008 * np.sin(time), 0.1 * time / np.pi)
    wanted, pose = [], HOME
    for each in angles:
        pose = forward_kinematics(ROBOT, each, guess=pose)
        wanted.append(pose)
    angles[:, 4] = angles[0, 4]
    assert frozen(angles, wanted=wanted) is None
    # Wanted elsewhere, the same readings are those of a frozen encoder.
    away = inverse_kinematics(ROBOT, HOME) + np.array([0.0, 0, 0, 0, 0.05, 0])
    assert frozen(angles, wanted=np.tile(forward_kinematics(ROBOT, away, guess=HOME), (200, 1))) == 4


def test_a_pose_that_stands_while_the_reference_moves_is_frozen():
    moving = HOME + np.arange(100)[:, None] * 1e-4 * np.eye(6)[5]
    still = np.tile(HOME, (100, 1))
    assert frozen(still, moving) == -1
    assert frozen(moving, moving) is None
    assert frozen(still, still) is None
    assert frozen(still, moving, SafetyOptions(frozen_pose=None)) is None
    # One last bit of one axis is a sign of life.
    alive = still + np.spacing(0.3) * (np.arange(100) % 2)[:, None] * np.eye(6)[5]
    assert frozen(alive, moving) is None


# --- before the start -----------------------------------------------------------------------------------------------


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
    with pytest.raises(ConfigurationError, match=r"safety\.torque_limit.*to stand at the start.*t = 0\.000 s, leg"):
        refuse_start(ROBOT, SafetyOptions(torque_limit=0.999 * weak), STANDARD_GRAVITY, HOME, STILL, HOME)


def test_limits_within_which_the_motors_cannot_do_the_motion_are_refused_and_wider_ones_are_not():
    # Two periods along Z.
    time, omega, along = np.arange(0.0, 0.8, PERIOD), 2.0 * np.pi * 2.5, np.eye(6)[5]
    sine, cosine = (0.003 * wave(omega * time[:, None]) * along for wave in (np.sin, np.cos))
    motion = HOME + sine, omega * cosine, -(omega**2) * sine
    torque = inverse_dynamics(ROBOT, *motion)
    share = np.abs(torque).max() / ROBOT.effort_limit
    steepest = np.abs(np.diff(torque, axis=0)).max() / PERIOD
    for factor, refused in ((1.001, ()), (0.999, ("torque_limit", "torque_rate"))):
        for name, value in (("torque_limit", share), ("torque_rate", steepest)):
            options = SafetyOptions(**{name: factor * value}, torque_rate_time=0.0, torque_limit_time=0.0)
            if name in refused:
                with pytest.raises(ConfigurationError, match=rf"safety\.{name}: .* leg \d") as caught:
                    refuse_motion(ROBOT, options, STANDARD_GRAVITY, time, motion)
                assert "\n" not in str(caught.value)
            else:
                refuse_motion(ROBOT, options, STANDARD_GRAVITY, time, motion)


def test_a_motion_that_keeps_to_a_limit_but_not_where_the_layer_looks_ahead_is_refused():
    # As fast as it may be: the layer sees the pose of so many seconds later already.
    options = SafetyOptions(transmission=None, conditioning=None, crank_speed=None, horizon=0.2)
    time, end = np.linspace(0.0, 1.0, 101), at(x=0.11) - HOME
    motion = HOME + time[:, None] * end, np.tile(end, (101, 1)), np.zeros((101, 6))
    with pytest.raises(ConfigurationError, match=r"safety\.horizon: .*t = 0\.[89]"):
        refuse_motion(ROBOT, options, STANDARD_GRAVITY, time, motion)
    short = dataclasses.replace(options, horizon=0.0)
    refuse_motion(ROBOT, short, STANDARD_GRAVITY, time, motion)


class TooHigh:
    def look(self, inputs):
        return 3 if inputs.pose[5] > HOME[5] + 0.01 else None


def test_a_monitor_of_the_users_own_is_asked_where_all_others_are_content():
    options = SafetyOptions(monitors=(TooHigh,))
    high = inputs(pose=at(z=0.011))
    done, _ = run([GOOD, high, GOOD], options)
    assert [each.level for each in done] == [NONE, RAMP, RAMP]
    assert done[-1].trip["monitor"] == options.monitor_names[-1] == "TooHigh"
    assert (done[-1].trip["leg"], done[-1].trip["time"]) == (3, 0.001)
    done, _ = run([GOOD, inputs(pose=at(z=0.011), command=np.full(6, np.nan))], options)
    assert done[-1].trip["monitor"] == "command_not_finite"
    motion = np.tile(high.pose, (3, 1)), np.zeros((3, 6)), np.zeros((3, 6))
    with pytest.raises(ConfigurationError, match=r"safety\.monitors\.0.*TooHigh"):
        refuse_motion(ROBOT, options, STANDARD_GRAVITY, np.arange(3) * PERIOD, motion)
