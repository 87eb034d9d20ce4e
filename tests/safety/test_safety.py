import dataclasses
import itertools

import numpy as np
import pytest
from conftest import field_of
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import ROBOT, poses, vectors

from stewart_drake.errors import FAILURES, ConfigurationError, SafetyStop, failure_code
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY, inverse_dynamics, static_torque
from stewart_drake.mechanics.kinematics import (
    forward_kinematics,
    inverse_kinematics,
    leg_geometry,
    pose_rate_to_twist,
    twist_jacobian,
)
from stewart_drake.safety import (
    FROZEN_SIZE,
    HOLD,
    LEVELS,
    MONITORS,
    NONE,
    RAMP,
    SAFE_HOLD,
    SafetyInputs,
    SafetyMemory,
    SafetyOptions,
    first_trip,
    flat_tick,
    frozen_tick,
    initial_memory,
    refuse_motion,
    refuse_start,
    safety_tick,
)
from stewart_drake.safety.frozen import flat_frozen
from stewart_drake.safety.monitors import broken, see

PERIOD = 0.001
HOME = ROBOT.home_pose
STILL = np.zeros(6)
WEIGHT = static_torque(ROBOT, HOME)
OPTIONS = SafetyOptions()


def inputs(command=WEIGHT, pose=HOME, rate=STILL, reference=None, **rest):
    reference = pose if reference is None else reference
    return SafetyInputs(np.asarray(command, dtype=float), np.asarray(pose), np.asarray(rate), reference, **rest)


def tick(one, memory, options=OPTIONS):
    return safety_tick(ROBOT, options, STANDARD_GRAVITY, PERIOD, one, memory)


def run(sequence, options=OPTIONS):
    """Memories after each tick, and how it ended."""
    memory, done = initial_memory(WEIGHT), []
    for one in sequence:
        try:
            memory = tick(one, memory, options)
        except SafetyStop as stop:
            return done, stop
        done.append(memory)
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
    ("following_error", inputs(reference=at(x=0.021)), RAMP, "following_error"),
    ("following_error", inputs(reference=at(roll=0.11)), RAMP, "following_error"),
    ("following_error", inputs(reference=np.full(6, np.nan)), RAMP, "following_error"),
]


def off(switch):
    return SafetyOptions(**{switch: False if switch in ("finite", "failures") else None})


# --- monitors -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("monitor", "bad", "level", "switch"), TRIPS, ids=[f"{t[0]}-{i}" for i, t in enumerate(TRIPS)])
def test_a_monitor_trips_by_name_and_level_and_not_where_it_is_off(monitor, bad, level, switch):
    done, _ = run([GOOD, bad])
    assert (MONITORS[int(done[-1].monitor)], done[-1].level) == (monitor, level)
    trip = first_trip(done[-1], PERIOD)
    assert (trip["monitor"], trip["level"], trip["time"], trip["worst"]) == (
        monitor,
        LEVELS[level],
        0.001,
        LEVELS[level],
    )
    if switch != "torque_limit" and not np.isnan(bad.reference).any():
        without, _ = run([GOOD, bad], off(switch))
        assert without[-1].monitor != MONITORS.index(monitor)


def test_innovations_may_be_large_for_a_blow_and_no_longer():
    odd = inputs(surprise=101.0)
    done, stop = run([GOOD, *[odd] * 10, *[GOOD] * 20, *[odd] * 11])
    assert stop is None
    assert all(memory.level == 0.0 for memory in done[:-1])
    trip = first_trip(done[-1], PERIOD)
    assert (trip["monitor"], trip["level"], trip["leg"], trip["time"]) == ("innovation", "ramp", None, 0.041)
    for options in (SafetyOptions(innovation=None), SafetyOptions(innovation=102.0)):
        done, _ = run([GOOD, *[odd] * 50], options)
        assert done[-1].monitor == 0.0


def test_every_monitor_is_tested_here():
    assert {t[0] for t in TRIPS} | {"none", "torque_rate", "innovation", "reading_stuck"} == set(MONITORS)


def test_a_good_tick_passes_the_command_on_to_the_last_bit():
    command = WEIGHT + np.array([0.3, -0.7, 0.123456789, 1e-9, 0.0, 2.0])
    done, _ = run([GOOD, inputs(command=command)])
    np.testing.assert_array_equal(done[-1].torque, command)
    assert done[-1].level == NONE
    assert first_trip(done[-1], PERIOD) is None
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


def test_the_horizon_sees_a_limit_before_it_is_reached():
    rate = np.array([0, 0, 0, 1.0, 0, 0])
    late, early = SafetyOptions(horizon=0.0, crank_speed=None), SafetyOptions(horizon=0.01, crank_speed=None)
    pose = at(x=0.115)
    assert run([GOOD, inputs(pose=pose, rate=rate)], late)[0][-1].level == NONE
    assert run([GOOD, inputs(pose=pose, rate=rate)], early)[0][-1].level == RAMP


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
    assert first_trip(done[-1], PERIOD) is None


def test_a_jump_is_held_for_a_tick_and_then_led_after_at_the_rate():
    options = SafetyOptions(torque_rate=1000.0)
    far = WEIGHT + np.array([0, 0, 3.5, 0, 0, 0])
    done, _ = run([GOOD, GOOD, *[inputs(command=far)] * 6], options)
    np.testing.assert_allclose([m.torque[2] - WEIGHT[2] for m in done[1:]], [0, 0, 1, 2, 3, 3.5, 3.5], atol=1e-12)
    assert first_trip(done[-1], PERIOD) is None


def test_a_command_that_chatters_trips_and_leaves_no_mean_torque():
    chatter = [inputs(command=WEIGHT + 4.5 * (-1.0) ** k) for k in range(20)]
    done, _ = run([GOOD, GOOD, *chatter])
    assert MONITORS[int(done[-1].monitor)] == "torque_rate"
    np.testing.assert_allclose([m.torque for m in done], np.tile(WEIGHT, (len(done), 1)), atol=1e-12)
    without, stop = run([GOOD, GOOD, *chatter], SafetyOptions(torque_rate=None))
    assert stop is None
    assert first_trip(without[-1], PERIOD) is None


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
    memory = safety_tick(ROBOT, options, 9.81, period, inputs(command=command), initial_memory(WEIGHT))
    for _ in range(budget):
        memory = safety_tick(ROBOT, options, 9.81, period, BAD, memory)
        assert memory.level == HOLD
        np.testing.assert_array_equal(memory.torque, command)
    assert safety_tick(ROBOT, options, 9.81, period, BAD, memory).level >= RAMP


def test_a_hold_ends_by_itself_and_a_fault_that_flickers_uses_the_budget_up():
    done, stop = run([GOOD, *[BAD] * 19, inputs(command=WEIGHT + 0.2)])
    assert stop is None
    assert done[-1].level == NONE
    np.testing.assert_array_equal(done[-1].torque, WEIGHT + 0.2)
    assert first_trip(done[-1], PERIOD)["worst"] == "hold"
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
    told = [first_trip(memory, PERIOD) for memory in done]
    assert told[0] is None
    assert [t["last"] for t in told[1:3]] == ["hold", "none"]
    assert [t["stopped"] for t in told[1:3]] == [None, None]
    assert (told[-1]["monitor"], told[-1]["time"], told[-1]["last"]) == ("command_not_finite", 0.001, "safe_hold")
    assert {str(t["stopped"]) for t in told[52:]} == {"{'monitor': 'workspace', 'time': 0.052, 'leg': None}"}
    # A robot that runs away all the same is given up, and the run says so too.
    done, stop = run([GOOD, BAD, GOOD, inputs(rate=FAST), inputs(rate=2.0 * FAST)])
    assert len(done) == 4
    assert (stop.reason, stop.trip["worst"]) == ("crank_speed", "end")
    assert (stop.trip["last"], stop.trip["stopped"]["monitor"], stop.trip["stopped"]["time"]) == (
        "end",
        "crank_speed",
        0.003,
    )


def test_a_reading_that_is_stuck_is_called_that_for_nobody_can_tell_a_sensor_from_a_motor():
    stuck = inputs(sensor=(failure_code("frozen"), 2.0))
    unguarded = SafetyOptions(failures=False)
    for options in (OPTIONS, unguarded):
        trip = first_trip(run([GOOD, stuck], options)[0][-1], PERIOD)
        assert (trip["monitor"], trip["level"], trip["leg"], trip["cause"]) == ("reading_stuck", "hold", 2, None)
    _, stop = run([GOOD, *[stuck] * 100])
    assert stop.reason == "reading_stuck"
    assert str(stop).startswith("reading_stuck: a sensor repeats itself, or friction holds what it reads; stopped: ")


def test_a_failed_sensor_blinds_no_other_monitor():
    unguarded = SafetyOptions(failures=False)
    told = first_trip(run([GOOD, inputs(sensor=(failure_code("encoder"), 2.0))])[0][-1], PERIOD)
    assert (told["cause"], told["leg"]) == ("encoder", 2)
    assert failure_code("something of a user's own") == 1
    assert len(set(map(failure_code, FAILURES))) == len(FAILURES)
    # Another failure is told by a system that nobody asked to tell: the pose is looked at all the same.
    done, _ = run([GOOD, inputs(pose=at(x=0.13), sensor=(failure_code("encoder"), -1.0))], unguarded)
    assert MONITORS[int(done[-1].monitor)] == "workspace"


@pytest.mark.parametrize(
    ("bad", "monitor"),
    [
        ({"age": np.nan}, "deadline"),
        ({"sensor": (np.nan, np.nan)}, "sensor_failed"),
        ({"controller": (np.nan, 0.0)}, "controller_failed"),
    ],
)
def test_a_message_that_is_not_a_number_is_no_good_one(bad, monitor):
    for compiled in (False, True):
        one = flat_tick(ROBOT, OPTIONS, STANDARD_GRAVITY, PERIOD, compiled)
        memory = SafetyMemory.from_flat(one(inputs(**bad), initial_memory(WEIGHT).flat()))
        assert (MONITORS[int(memory.monitor)], memory.level) == (monitor, HOLD)


def test_a_rate_that_leads_beyond_all_numbers_is_no_measurement():
    done, _ = run([GOOD, inputs(rate=np.full(6, 1e300))], SafetyOptions(horizon=1e10))
    assert MONITORS[int(done[-1].monitor)] == "measurement_not_finite"


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


def test_what_has_tripped_to_a_ramp_does_not_come_back():
    done, stop = run([GOOD, inputs(pose=at(x=0.13)), *[GOOD] * 300])
    assert stop is None
    assert all(m.level >= RAMP for m in done[1:])


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


# --- compiled -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@given(st.lists(st.tuples(poses(0.6), vectors(6, 1.0), vectors(6, 4.0), vectors(6, 0.02)), min_size=1, max_size=4))
@settings(max_examples=60)
def test_compiled_ticks_are_the_reference(ticks):
    plain, fast = (flat_tick(ROBOT, OPTIONS, STANDARD_GRAVITY, PERIOD, compiled) for compiled in (False, True))
    memory = [initial_memory(WEIGHT).flat()] * 2
    for pose, rate, command, error in [(HOME, STILL, WEIGHT, STILL), *ticks]:
        one = inputs(command, pose, rate, pose + error)
        ends = []
        for k, function in enumerate((plain, fast)):
            try:
                memory[k] = function(one, memory[k])
                ends.append(None)
            except SafetyStop as stop:
                ends.append((stop.reason, stop.leg, stop.trip))
        assert ends[0] == ends[1]
        if ends[0] is not None:
            return
        np.testing.assert_allclose(memory[1], memory[0], rtol=1e-9, atol=1e-9)
        # What the motors get is the same to the last bit where nothing is wrong.
        if memory[0][6] == 0.0:
            np.testing.assert_array_equal(memory[1][:6], memory[0][:6])


# --- frozen sensors -------------------------------------------------------------------------------------------------


def frozen(readings, reference=None, options=OPTIONS, quantum=0.0, wanted=None):
    """What is said in the end of a sequence of readings; with a reference they are poses, else `wanted` are poses."""
    memory, said = np.full(FROZEN_SIZE, np.nan), None
    for k, reading in enumerate(readings):
        angles = reading if reference is None else None
        pose = reference[k] if wanted is None else wanted[k]
        fast = flat_frozen(ROBOT, options, quantum, compiled=True)(angles, reading, pose, memory)
        said, memory = frozen_tick(ROBOT, options, quantum, angles, reading, pose, memory)
        assert fast[0] == said
        np.testing.assert_array_equal(fast[1], memory)
    return said


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


def swing(frequency, amplitude):
    """Times, and poses, rates and accelerations of two periods along Z."""
    time = np.arange(0.0, 2.0 / frequency, PERIOD)
    omega, along = 2.0 * np.pi * frequency, np.eye(6)[5]
    phase = omega * time[:, None]
    sine, cosine = amplitude * np.sin(phase) * along, amplitude * np.cos(phase) * along
    return time, (HOME + sine, omega * cosine, -(omega**2) * sine)


@pytest.mark.slow
@given(st.floats(0.5, 6.0), st.floats(0.001, 0.005))
@settings(max_examples=30)
def test_limits_within_which_the_motors_cannot_do_the_motion_are_refused_and_wider_ones_are_not(frequency, amplitude):
    time, motion = swing(frequency, amplitude)
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


def test_what_the_layer_forgives_for_a_while_is_not_refused():
    time, motion = swing(2.0, 0.005)
    needed = np.abs(inverse_dynamics(ROBOT, *motion)).max() / ROBOT.effort_limit
    refuse_motion(ROBOT, SafetyOptions(torque_limit=0.999 * needed), STANDARD_GRAVITY, time, motion)
    with pytest.raises(ConfigurationError, match=r"torque_limit.*for too long"):
        refuse_motion(ROBOT, SafetyOptions(torque_limit=0.8 * needed), STANDARD_GRAVITY, time, motion)
    slope = np.abs(np.diff(inverse_dynamics(ROBOT, *motion), axis=0)).max() / PERIOD
    fast = SafetyOptions(torque_rate=0.999 * slope, torque_rate_time=0.05)
    refuse_motion(ROBOT, fast, STANDARD_GRAVITY, time, motion)
    with pytest.raises(ConfigurationError, match=r"torque_rate"):
        refuse_motion(ROBOT, SafetyOptions(torque_rate=0.2 * slope), STANDARD_GRAVITY, time, motion)


@pytest.mark.parametrize("limit", ["workspace", "transmission", "conditioning"])
def test_a_motion_that_keeps_to_a_limit_but_not_where_the_layer_looks_ahead_is_refused(limit):
    # As fast as it may be: the layer sees the pose of so many seconds later already.
    others = {"workspace": None, "transmission": None, "conditioning": None, "crank_speed": None}
    options = SafetyOptions(**{**others, limit: getattr(OPTIONS, limit)}, horizon=0.2)
    time = np.linspace(0.0, 1.0, 101)
    end = {"workspace": at(x=0.11), "transmission": at(z=-0.1), "conditioning": at(pitch=-1.0)}[limit] - HOME
    motion = HOME + time[:, None] * end, np.tile(end, (101, 1)), np.zeros((101, 6))
    with pytest.raises(ConfigurationError, match=r"safety\.horizon: got 0\.2; .*t = 0\.[89]"):
        refuse_motion(ROBOT, options, STANDARD_GRAVITY, time, motion)
    tripped = [
        broken(options, see(ROBOT, options.horizon, p, r, p)) is not None for p, r in zip(*motion[:2], strict=True)
    ]
    assert any(tripped)
    short = dataclasses.replace(options, horizon=0.0)
    refuse_motion(ROBOT, short, STANDARD_GRAVITY, time, motion)
