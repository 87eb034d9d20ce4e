import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from stewart_drake import load_scenario, run
from stewart_drake.safety.residual import apply_dry_friction
from stewart_drake.studies.faults import FAULTS, base, stopped_at, travel

ONSET = 0.4
WITHOUT = {"estimator": {"kind": "difference"}, "tuner": {"kind": "block"}}


def heart(**changes):
    common = {"plant.kind": "closed_form", "duration": 1.2, "safety": {}}
    return load_scenario("exact_heart").replace({**common, **changes})


def of_encoder(kind, **more):
    return {"sensors.faults": [{"kind": kind, "leg": 3, "time": ONSET, **more}]}


def of_motor(kind, **more):
    return {"motors.faults": [{"kind": kind, "leg": 3, "time": ONSET, **more}]}


WRONG = {
    "freeze": of_encoder("freeze"),
    "reversed": of_encoder("reversed"),
    "swapped": of_encoder("swapped", other=1),
    "inverted": of_encoder("inverted"),
    "nan": of_encoder("nan"),
    "dead": {"motors.dead": {"leg": 3, "time": ONSET}},
    "motor reversed": of_motor("reversed"),
    "motors swapped": of_motor("swapped", other=1),
}


@pytest.mark.slow
@pytest.mark.parametrize("loop", [{}, WITHOUT], ids=["observer", "no observer"])
@pytest.mark.parametrize("kind", WRONG)
def test_a_wrong_reading_or_motor_in_motion_costs_little_more_than_a_stop_at_its_onset(kind, loop):
    scenario = heart(**loop, **WRONG[kind])
    log, stop = run(scenario, check=False), run(stopped_at(scenario, ONSET), check=False)
    assert log.status == "stopped"
    assert log.safety["monitor"] in ("unexplained_torque", "sensor_failed")
    assert log.safety["stopped"]["leg"] in (3, 1 if "swapped" in kind else 3)
    beyond = np.array(travel(log, ONSET)) - travel(stop, ONSET)
    assert (beyond < (np.radians(6.0), 0.01)).all()


@pytest.mark.slow
def test_a_robot_that_friction_holds_stays_where_it_is_when_a_reading_is_lost():
    # The reference rests; at 100 Hz friction makes the slow estimate of a crank's speed wrong by 12 rad/s.
    changes = {"sensors.faults": [{"kind": "inverted", "leg": 2, "time": 0.945}]}
    common = {"plant.kind": "closed_form", "duration": 1.2, "safety": {}}
    log = run(load_scenario("reachy_look_around").replace({**common, **changes}), check=False)
    assert (log.status, log.safety["monitor"]) == ("stopped", "sensor_failed")
    assert travel(log, 0.945)[0] < np.radians(3.0)


@pytest.mark.parametrize("learns", [{"model.friction.coulomb": 0.2}, {"adaptation": "regression"}])
@pytest.mark.parametrize(("kind", "most"), [("nan", 0.5), ("freeze", 5.0)])
def test_a_stop_without_a_reading_counts_the_friction_that_is_known(kind, most, learns):
    fault = {"kind": kind, "leg": 5, "time": 2.15}
    common = {"plant.kind": "closed_form", "plant.motor_friction": 0.2, "duration": 3.0, "safety": {}}
    sensors = {"kind": "encoders", "resolution_bits": 17, "faults": [fault]}
    log = run(load_scenario("exact_heart").replace({**common, "sensors": sensors, **learns}), check=False)
    assert log.status == "stopped"
    assert travel(log, log.safety["time"])[0] < np.radians(most)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.0, 1.0))
def test_friction_of_six_cranks_takes_as_much_speed_as_it_can(seed, coulomb):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(6, 6)) + 3.0 * np.eye(6)
    mobility, before = 30.0 * root @ root.T, rng.normal(size=6)
    most = 0.001 * coulomb * rng.uniform(0.0, 1.0, 6) + 1e-15
    energy = before @ np.linalg.solve(mobility, before)
    rub, speed = np.zeros(6), before.copy()
    apply_dry_friction(most, 1.0, mobility, speed, rub)
    assert speed @ np.linalg.solve(mobility, speed) <= energy * (1.0 + 1e-9)
    for _ in range(300):
        speed = before.copy()
        apply_dry_friction(most, 1.0, mobility, speed, rub)
    # The least energy that impulses within their bounds leave.
    lower = np.linalg.cholesky(mobility)
    best = lsq_linear(lower.T, -np.linalg.solve(lower, before), (-most, most), tol=1e-14)
    np.testing.assert_allclose(speed, before + mobility @ best.x, atol=1e-6)
    np.testing.assert_allclose(speed, before + mobility @ rub, atol=1e-9)
    turning = np.abs(speed) > 1e-6
    np.testing.assert_allclose(rub[turning], (-np.sign(speed) * most)[turning], atol=1e-9)


@pytest.mark.slow
def test_a_jump_of_a_reading_at_rest_is_no_runaway():
    # 50 rad/s in one difference: the motors stay on, and the robot is held where it is.
    changes = of_encoder("jump", size=0.05) | {"reference": {"kind": "hold"}} | WITHOUT
    log = run(heart(**changes), check=False)
    assert (log.status, log.safety["last"]) == ("stopped", "safe_hold")
    assert travel(log, ONSET)[1] < 0.0034


@pytest.mark.slow
@pytest.mark.parametrize("name", ["push_5N", "blow_0.5Ns", "noise_1N", "payload_1kg", "friction", "encoder_12bit"])
def test_loads_and_pushes_that_the_controller_does_not_know_are_no_fault(name):
    start = base().replace({"plant.kind": "closed_form"})
    log = run(start.replace(FAULTS[name].in_motion("paper", start)))
    assert (log.status, log.safety) == ("completed", None)


@pytest.mark.slow
def test_an_unexplained_torque_beyond_its_limit_stops_the_run_and_null_allows_all():
    heavy = {"plant.payload_mass": 0.5, "plant.payload_position": [0.05, 0.0, 0.0]}
    log = run(heart(**heavy, **{"safety.unexplained_torque": 0.02}))
    assert (log.status, log.reason) == ("stopped", "unexplained_torque")
    assert run(heart(**heavy, **{"safety.unexplained_torque": None})).safety is None
