"""The controller's side alone: what it says to the readings of a run is what it said in the run."""

import json

import numpy as np
import pytest
from conftest import python

from stewart_drake import Controller, Scenario, load_scenario, run
from stewart_drake.errors import SafetyStop
from stewart_drake.hardware.sensors import EncoderOptions, encoder_part

ENCODERS = {"sensors": {"kind": "encoders", "rate_cutoff": 150.0}}
OBSERVED = {
    **ENCODERS,
    "estimator": "observer",
    "friction_compensation": {"coulomb": 0.01},
    "plant.motor_friction": 0.01,
    "command_delay": 1,
}
POLICY = {**OBSERVED, "tuner": "policy"}


def short(name, changes=(), duration=0.1):
    return load_scenario(name).replace({"duration": duration, **dict(changes)})


def readings_of(log):
    sensors = log.scenario.sensors
    if not isinstance(sensors, EncoderOptions):
        return np.concatenate([log["pose"], log["pose_rate"]], axis=1)
    part, readings = encoder_part(sensors), []
    state = part.initial.copy()
    for angles in log["crank_angle"]:
        part.tick(np.append(angles, np.zeros(6)), state)
        readings.append(state["reading"][0].copy())
    return np.array(readings)


def replayed(controller, log, names=("torque",)):
    period, out, said = controller.period, np.empty(6), {name: [] for name in (*names, "out")}
    for tick, reading in enumerate(readings_of(log)):
        controller.step(reading, tick * period, out)
        said["out"].append(out.copy())
        for name in names:
            said[name].append(controller.signal(name).copy())
    return {name: np.array(values) for name, values in said.items()}


CASES = {
    "pose": ("exact_fig7", {}),
    "encoders": ("exact_breathing", {**ENCODERS, "tuner": "block", "sensors.noise": 2e-5}),
    "observer, friction": ("exact_breathing", {**OBSERVED, "tuner": "block"}),
    "policy": ("exact_breathing", POLICY),
    "the paper's network": ("paper_fig7", {"controller.solver": "split", "duration": 0.3}),
}


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["reduced", "drake"])
@pytest.mark.parametrize(("name", "changes"), CASES.values(), ids=CASES.keys())
def test_fed_with_what_a_run_read_it_says_what_the_run_logged(name, changes, engine):
    log = run(short(name, {**changes, "plant.engine": engine}))
    assert log.status == "completed"
    names = [each for each in ("torque", "error", "integral", "innovation") if each in log.signals]
    said = replayed(Controller(log.scenario), log, names)
    # The fast engine calls the same laws on the same numbers. Drake's angles are sums of other terms, a bit apart.
    bound = {"rtol": 0.0, "atol": 0.0} if engine == "reduced" else {"rtol": 1e-7, "atol": 1e-8}
    for signal in names:
        np.testing.assert_allclose(said[signal], log[signal], **bound, err_msg=signal)
    np.testing.assert_array_equal(said["out"], said["torque"])
    assert np.ptp(said["torque"], axis=0).min() > 0.0


def test_reset_gives_the_same_again():
    log = run(short("exact_breathing", {**POLICY, "plant.engine": "reduced", "safety": {}}))
    controller = Controller(log.scenario)
    first = replayed(controller, log)
    controller.reset()
    again = replayed(controller, log)
    np.testing.assert_array_equal(first["out"], again["out"])


def test_behind_a_safety_layer_it_says_how_it_is_and_ends_by_name():
    log = run(short("exact_breathing", {**ENCODERS, "plant.engine": "reduced", "safety.safe_hold_time": 0.01}, 0.15))
    controller, out = Controller(log.scenario), np.empty(6)
    readings, period = readings_of(log), controller.period
    for tick in range(50):
        controller.step(readings[tick], tick * period, out)
        assert controller.status == "none"
        np.testing.assert_array_equal(out, log["torque"][tick])
    levels = []
    # An encoder that tells nothing more: the estimator bridges it for a while, and then the layer takes over.
    readings[50:, 2] = np.nan

    def go_on():
        for tick in range(50, len(readings)):
            controller.step(readings[tick], tick * period, out)
            levels.append(controller.status)
            assert np.isfinite(out).all()

    with pytest.raises(SafetyStop) as caught:
        go_on()
    assert list(dict.fromkeys(levels))[:2] == ["none", "hold"]
    assert caught.value.reason in ("sensor_failed", "measurement_not_finite")
    assert caught.value.time == pytest.approx((50 + len(levels)) * period)


WITHOUT = """
import json, sys
sys.modules.update(pydrake=None, torch=None, pyarrow=None, matplotlib=None)
import numpy as np
from stewart_drake import Controller, load_scenario
name, changes, readings = json.loads(sys.argv[1])
controller, out = Controller(load_scenario(name).replace(changes)), np.empty(6)
torques = []
for tick, reading in enumerate(readings):
    controller.step(np.array(reading), tick * controller.period, out)
    torques.append(out.tolist())
print(json.dumps(torques))
"""


@pytest.mark.slow
def test_it_runs_where_drake_is_not_installed():
    changes = {**POLICY, "safety": {}, "duration": 0.05}
    log = run(short("exact_breathing", {**changes, "plant.engine": "reduced"}))
    given = json.dumps(["exact_breathing", changes, readings_of(log).tolist()])
    torques = json.loads(python("-c", WITHOUT, given).splitlines()[-1])
    np.testing.assert_array_equal(torques, replayed(Controller(log.scenario), log)["out"])


def test_a_function_is_a_controller():
    controller, out = Controller(Scenario(controller=lambda *_: np.arange(6.0))), np.empty(6)
    controller.step(np.zeros(12), 0.0, out)
    np.testing.assert_array_equal(out, np.arange(6.0))
