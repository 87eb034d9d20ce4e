"""Faults of the table's kinds, several at once, at random times, into random motions: what must always hold."""

import math
import os

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from stewart_drake.errors import ConfigurationError
from stewart_drake.logs.metrics import run_metrics
from stewart_drake.mechanics.kinematics import rotation_angle, rotation_matrix
from stewart_drake.runs.checks import check_scenario
from stewart_drake.runs.simulation import run
from stewart_drake.safety import HOLD, LEVELS, MONITORS, RAMP, SafetyOptions
from stewart_drake.scenario import load_scenario

SEQUENCES = int(os.environ.get("STEWART_DRAKE_SEQUENCES", "40"))
DURATION, TICK = 0.4, 0.001
BOUNDS = math.radians(10.0), 0.03, 0.001
SAFETY = SafetyOptions()

BASE = load_scenario("exact_fig7").replace({"duration": DURATION, "safety": {}})
LIMIT = BASE.robot.effort_limit


def one(kind, **keys):
    return st.fixed_dictionaries({"kind": st.just(kind), **keys})


small = st.tuples(*[st.floats(-0.15, 0.15)] * 3, *[st.floats(-0.02, 0.02)] * 3).map(list)


def six(low, high):
    return st.lists(st.floats(low, high), min_size=6, max_size=6)


motions = st.one_of(
    one("hold", pose=small.map(lambda pose: [*pose[:5], 0.3 + pose[5]])),
    one("breathing", phase=st.floats(0.0, 1.0)),
    one("sine", amplitude=small, angular_frequency=six(0.5, 8.0), phase=six(0.0, 6.2)),
)
# Onsets on the grid of ticks, so that "at the tick of the fault" means one tick.
onsets = st.integers(0, round(DURATION / TICK)).map(lambda tick: tick * TICK)
legs = st.integers(0, 5)
lasting = st.none() | st.integers(1, 60).map(lambda ticks: ticks * TICK)


def two(kind, **keys):
    pairs = st.permutations(range(6)).map(lambda order: {"leg": order[0], "other": order[1]})
    return st.builds(lambda pair, rest: pair | rest, pairs, one(kind, **keys))


timed = {"time": onsets, "duration": lasting}
delays = st.integers(1, 20).map(lambda n: n * TICK)


def kinds(*names, **keys):
    return [one(name, **keys) for name in names]


def force(most):
    return st.tuples(*[st.floats(-most, most)] * 3).map(lambda f: [0, 0, 0, *f])


encoder_faults = st.one_of(
    *kinds("freeze", "nan", "reversed", "inverted", leg=legs, **timed),
    one("jump", leg=legs, size=st.sampled_from([0.005, 0.2, -0.2]), **timed),
    one("drift", leg=legs, size=st.floats(-0.3, 0.3), **timed),
    one("late", leg=st.none() | legs, delay=delays, **timed),
    two("swapped", **timed),
)
pose_faults = st.one_of(*kinds("freeze", "nan", **timed), one("late", delay=delays, **timed))
command_faults = st.one_of(
    *kinds("nan", "inf", leg=st.none() | legs, **timed),
    one("offset", leg=st.none() | legs, size=st.sampled_from([0.3, 20.0, 1e6]), **timed),
    one("chatter", leg=st.none() | legs, size=st.just(4.5), **timed),
)
motor_faults = one("reversed", leg=legs, time=onsets) | two("swapped", time=onsets)
pushes = one("step", wrench=force(60), time=onsets) | one("impulse", impulse=force(2), time=onsets)
of_leg = st.fixed_dictionaries({"leg": legs, "time": onsets})
dropped = st.builds(lambda first, count: list(range(first, first + count)), st.integers(0, 400), st.integers(1, 25))
# Where in a scenario: lists grow, the others are set once.
PLACES = {
    "sensors.faults": st.tuples(encoder_faults, pose_faults),
    "link.faults": command_faults,
    "motors.faults": motor_faults,
    "disturbances": pushes,
    "motors.dead": of_leg,
    "plant.broken_rod": of_leg,
    "link.stop_time": onsets,
    "link.dropped": dropped,
}
FAULTS = st.one_of(*(st.tuples(st.just(place), values) for place, values in PLACES.items()))
LISTS = ("sensors.faults", "link.faults", "motors.faults", "disturbances")


def taken_ticks(log):
    return log["safety"][:, 0] >= HOLD


def check_what_the_layer_tells(log):
    level, monitor, leg = log["safety"].T
    told, tripped = log.safety, np.flatnonzero(taken_ticks(log))
    if told is None or tripped.size == 0:
        # Or it tripped and ended the run in one tick, whose row is not there any more.
        assert tripped.size == 0
        assert told is None or (log.status, told["last"]) == ("failed", "end")
        return
    first = tripped[0]
    assert told["time"] == pytest.approx(log.time[first], abs=1e-9)
    assert (told["monitor"], told["level"]) == (MONITORS[int(monitor[first])], LEVELS[int(level[first])])
    assert told["leg"] == (int(leg[first]) if leg[first] >= 0.0 else None)
    # By the layer: given up, or held for its time.
    ended = told["last"] == "end" or (log.end_time < log.scenario.duration - 1e-9 and log.reason in MONITORS)
    assert ended or told["worst"] == LEVELS[int(level.max())]
    assert (told["stopped"] is not None) == (ended or level[-1] >= RAMP)
    if (level >= RAMP).any():
        took = int((level >= RAMP).argmax())
        assert told["stopped"]["time"] == pytest.approx(log.time[took], abs=1e-9)
        assert told["stopped"]["monitor"] == MONITORS[int(monitor[took])]
        # What has once been taken is not given back.
        assert (level[took:] >= RAMP).all()


def true_outcomes(log):
    early = log.end_time < log.scenario.duration - 1e-9
    # Given up by the layer, or broken without it.
    if early if log.safety is None else log.safety["last"] == "end":
        return {"failed"}
    level = log["safety"][:, 0]
    if early or level[-1] >= HOLD:
        # Held by the layer; or the plant itself gave way under it, which has no signal.
        return {"stopped"} if log.reason in MONITORS else {"failed"}
    off = rotation_matrix(log["pose"][:, :3]) @ np.swapaxes(rotation_matrix(log["reference"][:, :3]), -1, -2)
    away = np.linalg.norm(log["pose"][:, 3:] - log["reference"][:, 3:], axis=1)
    worst = rotation_angle(off).max(), away.max(), log["loop_gap"].max()
    still = all(value <= bound for value, bound in zip(worst, BOUNDS, strict=True)) and moved(log)
    return {"completed"} if still else {"lost"}


def moved(log):
    late = log.time >= 0.5 * log.scenario.duration - 1e-9
    scale = [log.scenario.robot.characteristic_length] * 3 + [1.0] * 3
    wanted, made, error = (
        np.sqrt(np.sum(np.var(values[late] * scale, axis=0)))
        for values in (log["reference"], log["pose"], log["pose"] - log["reference"])
    )
    return min(wanted, error) <= 2e-5 or made >= 0.25 * wanted


def check_torques(log, places):
    applied = log["torque_applied"]
    assert np.isfinite(applied).all()
    assert np.abs(applied).max(initial=0.0) <= LIMIT
    if not places & {"motors.faults", "motors.dead"}:
        change = np.abs(np.diff(applied, axis=0)).max(initial=0.0)
        assert change <= SAFETY.torque_rate * TICK * (1.0 + 1e-9)


# Four faults are few enough to be looked at as they were drawn; shrinking would take minutes.
@pytest.mark.long
@settings(max_examples=SEQUENCES, print_blob=True, phases=(Phase.explicit, Phase.reuse, Phase.generate), deadline=None)
@given(motion=motions, encoders=st.booleans(), chosen=st.lists(FAULTS, min_size=2, max_size=4))
def test_composed_faults(motion, encoders, chosen):
    seen_by = {"sensors": {"kind": "encoders"}, "command_delay": 1} if encoders else {}
    scenario = BASE.replace({"reference": motion, **seen_by})
    # A motion that can be done without faults: those drawn lie well inside of the workspace.
    check_scenario(scenario)
    changes = {}
    for where, value in chosen:
        if where == "sensors.faults":
            value = value[0 if encoders else 1]
        if where in LISTS:
            changes.setdefault(where, []).append(value)
        else:
            changes[where] = value
    try:
        log = run(scenario.replace(changes))
    except ConfigurationError:
        return
    assert log.status != "interrupted"
    run_metrics(log)
    check_what_the_layer_tells(log)
    assert log.status in true_outcomes(log), (log.status, log.reason, log.message)
    assert (log.status == "completed") == (log.reason is None) == (log.outcome_time is None)
    check_torques(log, set(changes))
