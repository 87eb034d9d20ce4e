"""Stops of a loop at 100 Hz whose friction is not what it believes, and cold starts of one that learns it."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stewart_drake import load_scenario, run

NOWHERE = dict.fromkeys(("rotation", "position", "motion_ratio", "error_ratio"))


def nod(coulomb, viscous, **changes):
    """Reachy Mini nods by torque; its motors have this friction, and 0.058, 0.095 are believed."""
    plant = {"kind": "closed_form", "friction": {"coulomb": coulomb, "viscous": viscous}}
    return load_scenario("reachy_nod").replace({"plant": plant, "bounds": NOWHERE, "duration": 5.0, **changes})


def apart(pose, other):
    """[deg] between orientations."""
    turns = Rotation.from_euler("xyz", pose[:3]), Rotation.from_euler("xyz", other[:3])
    return np.degrees((turns[0] * turns[1].inv()).magnitude())


def moved_by_stopping_and_letting_go(scenario, log):
    """[deg] of the head from where the safety layer took over to the end of the run."""
    begin = np.searchsorted(log.time, log.safety["stopped"]["time"])
    first = log["pose"][begin]
    plant = scenario.plant.make(scenario.robot, scenario.gravity)
    plant.initial(first, log["pose_rate"][begin])
    for _ in range(round((log.time[-1] - log.time[begin]) / scenario.plant.time_step)):
        state = plant.step(np.zeros(6), np.zeros(6))
        if abs(state[0]) + abs(state[1]) > 0.6:
            break  # It lies on its side by then, and out of reach soon.
    return apart(log["pose"][-1], first), apart(state[:6], first)


@pytest.mark.parametrize(("coulomb", "viscous"), [(0.0, 0.0), (0.0128, 0.0037), (0.1, 0.15), (0.13, 0.19)])
def test_a_stop_moves_the_head_less_than_letting_go(coulomb, viscous):
    scenario = nod(coulomb, viscous)
    log = run(scenario, check=False)
    assert log.status == "stopped"
    assert np.linalg.norm(log["pose_rate"][-1, :3]) < 0.2
    moved, let_go = moved_by_stopping_and_letting_go(scenario, log)
    assert moved < max(1.0, let_go)


@pytest.mark.parametrize("fails", ["encoder", "motor"])
@pytest.mark.parametrize(("coulomb", "viscous"), [(0.0, 0.0), (0.03, 0.04), (0.1, 0.15)])
def test_a_stop_of_the_loop_for_slow_buses_does_too(coulomb, viscous, fails):
    when = {"leg": 2, "time": 2.1}
    broken = {"encoder": {"sensors.faults": [{"kind": "freeze", **when}]}, "motor": {"motors.dead": when}}[fails]
    plant = {"kind": "closed_form", "friction": {"coulomb": coulomb, "viscous": viscous}}
    changes = {"plant": plant, "bounds": NOWHERE, "duration": 3.0, **broken}
    scenario = load_scenario("reachy_slow_bus").replace(changes)
    log = run(scenario, check=False)
    assert log.status == "stopped"
    assert log.safety["stopped"]["time"] > 2.1
    moved, let_go = moved_by_stopping_and_letting_go(scenario, log)
    assert moved < max(1.0, let_go)


@pytest.mark.parametrize(("times", "head"), [(0.0, 1.0), (1.0, 1.0), (2.0, 1.0), (0.0, 1.2), (2.5, 0.8), (2.5, 1.2)])
def test_a_cold_start_is_no_fault(times, head):
    plant = {"kind": "closed_form", "motor_friction": 0.058 * times, "motor_damping": 0.095 * times}
    shipped = load_scenario("reachy_slow_bus")
    loop = {"controller": shipped.controller.given(), "estimator": "difference", "tuner": "block"}
    believed, real = shipped.robot, shipped.robot.replace(**shipped.robot.scaled_masses(head))
    changes = {"plant": plant, "duration": 5.0, "robot": real, "model.robot": believed}
    log = run(shipped.replace(changes), check=False)
    assert log.status == "completed", log.message
    assert log.error_norms[0][log.time > 4.0].max() < 0.5
    if times == 2.0:
        assert run(nod(0.116, 0.19, **loop), check=False).status == "stopped"


@pytest.mark.parametrize("fault", ["reversed", "swapped", "dead"])
def test_a_wrong_motor_is_found_while_friction_is_learnt(fault):
    when = {"leg": 1, "time": 0.5}
    wrong = {"reversed": [{"kind": "reversed", **when}], "swapped": [{"kind": "swapped", "other": 3, **when}]}
    changes = {"motors.dead": when} if fault == "dead" else {"motors.faults": wrong[fault]}
    keys = {"plant": {"kind": "closed_form"}, "bounds": NOWHERE, "safety": {}, "adaptation": "regression", **changes}
    log = run(load_scenario("exact_heart").replace({**keys, "duration": 1.5}), check=False)
    assert log.status == "stopped"
    assert log.safety["stopped"]["monitor"] == "unexplained_torque"
    assert log.safety["stopped"]["leg"] in (1, 3)
    assert log.safety["stopped"]["time"] - 0.5 < 0.06
    assert log.error_norms[0].max() < 10.0
