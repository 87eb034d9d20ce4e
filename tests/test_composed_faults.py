"""Faults of the table's kinds, several at once, at random times, into random motions: what must always hold."""

import math
import os

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from stewart_drake import ConfigurationError, load_scenario, run, run_metrics
from stewart_drake.mechanics.kinematics import rotation_angle, rotation_matrix
from stewart_drake.runs.checks import check_scenario
from stewart_drake.safety import HOLD, LEVELS, MONITORS, RAMP, SafetyOptions
from stewart_drake.studies.faults import FAULTS

SEQUENCES = int(os.environ.get("STEWART_DRAKE_SEQUENCES", "40"))
DURATION, TICK = 0.4, 0.001
BOUNDS = math.radians(10.0), 0.03, 0.001
SAFETY = SafetyOptions()

BASE = load_scenario("exact_fig7").replace({"duration": DURATION, "safety": {}})
LIMIT = BASE.robot.effort_limit


def six(low, high):
    return st.lists(st.floats(low, high), min_size=6, max_size=6)


small = st.tuples(*[st.floats(-0.15, 0.15)] * 3, *[st.floats(-0.02, 0.02)] * 3).map(list)
motions = st.one_of(
    st.builds(lambda pose: {"kind": "hold", "pose": [*pose[:5], 0.3 + pose[5]]}, small),
    st.builds(lambda phase: {"kind": "breathing", "phase": phase}, st.floats(0.0, 1.0)),
    st.builds(
        lambda size, speed, phase: {"kind": "sine", "amplitude": size, "angular_frequency": speed, "phase": phase},
        *(small, six(0.5, 8.0), six(0.0, 6.2)),
    ),
)
# What leads the reference astray is no fault of the loop.
CATALOGUE = [fault for fault in FAULTS.values() if fault.drift is None]


def begun(changes, tick, turn):
    """Changes of the catalogue that begin at a tick, at the legs so many farther on."""
    if isinstance(changes, list):
        return [begun(each, tick, turn) for each in changes]
    if not isinstance(changes, dict):
        return changes
    at = {"time": tick * TICK, "stop_time": tick * TICK, "dropped": list(range(tick, tick + 15))}
    at |= {name: (changes[name] + turn) % 6 for name in ("leg", "other") if changes.get(name) is not None}
    return {name: at.get(name, begun(value, tick, turn)) for name, value in changes.items()}


def together(one, other):
    """Sections grow key by key, lists by their ends."""
    if isinstance(one, dict) and isinstance(other, dict):
        both = {name: together(one[name], other[name]) for name in one.keys() & other.keys()}
        return {**one, **other, **both}
    return one + other if isinstance(one, list) and isinstance(other, list) else other


chosen_faults = st.lists(
    st.tuples(st.sampled_from(CATALOGUE), st.integers(0, round(DURATION / TICK)), st.integers(0, 5)),
    min_size=2,
    max_size=4,
)


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


def check_torques(log, motors):
    applied = log["torque_applied"]
    assert np.isfinite(applied).all()
    assert np.abs(applied).max(initial=0.0) <= LIMIT
    if not motors:
        change = np.abs(np.diff(applied, axis=0)).max(initial=0.0)
        assert change <= SAFETY.torque_rate * TICK * (1.0 + 1e-9)


# Four faults are few enough to be looked at as they were drawn; shrinking would take minutes.
@pytest.mark.long
@settings(max_examples=SEQUENCES, print_blob=True, phases=(Phase.explicit, Phase.reuse, Phase.generate), deadline=None)
@given(motion=motions, encoders=st.booleans(), chosen=chosen_faults)
def test_composed_faults(motion, encoders, chosen):
    seen_by = {"sensors": {"kind": "encoders"}, "command_delay": 1} if encoders else {"sensors": {"kind": "ideal"}}
    scenario = BASE.replace({"reference": motion, **seen_by})
    # A motion that can be done without faults: those drawn lie well inside of the workspace.
    check_scenario(scenario)
    changes = {}
    for fault, tick, turn in chosen:
        own = dict(fault.changes)
        # A fault of sensors that this loop has not is left out.
        for section, there in ((own.pop("sensors", None), not encoders), (fault.encoders, encoders)):
            own |= {"sensors": {**seen_by["sensors"], **section}} if section is not None and there else {}
        changes = together(changes, begun(own, tick, turn))
    try:
        log = run(scenario.replace(changes))
    except ConfigurationError:
        return
    assert log.status != "interrupted"
    run_metrics(log)
    check_what_the_layer_tells(log)
    assert log.status in true_outcomes(log), (log.status, log.reason, log.message)
    assert (log.status == "completed") == (log.reason is None) == (log.outcome_time is None)
    # Motors that are wired wrong or dead give other torques than they are asked for.
    check_torques(log, changes.get("motors", {}).keys() & {"faults", "dead", "ripple"})
