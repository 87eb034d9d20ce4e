"""The observer and the friction feedforward in the closed loop, on Drake's plant."""

import numpy as np
import pytest

from stewart_drake.logs.metrics import run_metrics
from stewart_drake.runs.simulation import run
from stewart_drake.scenario import Scenario, load_scenario

HOME = [0, 0, 0, 0, 0, 0.3]
OBSERVER = {"kind": "observer"}


def made(**changes):
    """`exact_breathing` for a second, noisy, with an observer."""
    changes = {name.replace("__", "."): value for name, value in changes.items()}
    noisy = {} if "sensors" in changes else {"sensors.noise": 2e-5}
    return load_scenario("exact_breathing").replace(
        {
            "duration": 1.0,
            "estimator": OBSERVER,
            "friction_compensation": None,
            "tuner": {"kind": "block"},
            **noisy,
            **changes,
        }
    )


def error(log, since=0.5):
    """[mm] RMSE of the position from a time on."""
    signals = log.signals
    off = (signals["pose"] - signals["reference"])[signals["time"] >= since, 3:]
    return 1e3 * float(np.sqrt((off**2).sum(axis=1).mean()))


def change(log):
    """[N m] RMS of the torque's change from tick to tick, in the second half."""
    torque = log.signals["torque"]
    return float(np.sqrt((np.diff(torque[len(torque) // 2 :], axis=0) ** 2).mean()))


def test_it_is_quieter_and_nearer_than_differences():
    known = {"friction_compensation": {"coulomb": 0.01}}
    differences, observed = run(made(estimator={"kind": "difference"})), run(made(**known))
    assert error(observed) < 0.25 * error(differences)
    assert change(observed) < 0.5 * change(differences)


def test_a_rod_that_is_lost_is_noticed_within_ticks():
    lost = {"plant.broken_rod": {"leg": 2, "time": 0.3}, "safety": {}}
    trips = {
        kind: run(made(**lost, **{"estimator": {"kind": kind}})).safety["time"] for kind in ("difference", "observer")
    }
    assert trips["observer"] - 0.3 <= 0.03
    assert trips["difference"] - 0.3 > 0.04


@pytest.mark.slow
def test_a_delay_that_is_known_costs_little():
    log = run(made(command_delay=4, friction_compensation={"coulomb": 0.01}, duration=2.0))
    assert error(log, 1.0) < 0.004


@pytest.mark.slow
def test_reachy_mini_moves_on_its_bus_of_100_hz_with_the_policy():
    scenario = load_scenario("reachy_nod")
    assert (scenario.controller.period, scenario.tuner.kind, scenario.estimator.kind) == (0.01, "policy", "observer")
    log = run(scenario)
    assert (log.status, log.warnings) == ("completed", ())
    assert run_metrics(log)["rmse_norm_deg"] < 0.12


def test_gains_follow_period_and_delay():
    fast = load_scenario("exact_breathing", ["tuner={kind: block}"])
    slow = fast.replace({"controller.period": 0.01})
    # 2 ticks of 10 ms against 5 ms.
    ratio = 5.0 / 20.0
    for name, power in (("q_pose", 4), ("q_rate", 2), ("q_integral", 6)):
        assert getattr(slow.tuner, name) == pytest.approx(ratio**power * getattr(fast.tuner, name))
    assert slow.replace({"controller.period": 0.001}).tuner == fast.tuner
    assert fast.replace({"estimator": OBSERVER, "estimator.delay": 1}).tuner == fast.tuner
    own = Scenario(controller={"kind": "pid", "period": 0.01, "kp": 20.0}, plant={"time_step": 0.001})
    assert own.controller.kp == 20.0
    assert own.controller.ki == pytest.approx(316.0 * 0.5**3)


@pytest.mark.slow
@pytest.mark.parametrize(("believed", "level"), [(0.01, 0.02), (0.05, 0.1)])
def test_a_robot_with_friction_comes_to_rest_and_stays(believed, level):
    """Up to twice the friction that is believed; without that rule it hunts by ten counts and more for ever."""
    rest = {
        "plant": {"friction": {"coulomb": believed, "break_away": level}, "engine": "reduced"},
        "friction_compensation": {"coulomb": believed},
        "reference": {"kind": "minimum_jerk", "poses": [HOME, [0.05, 0, 0, 0.01, 0, 0.31]], "durations": [0.5]},
        "duration": 6.0,
        "tuner": {"kind": "block", "q_pose": 8e5, "q_rate": 150.0, "q_integral": 5e6},
    }
    log = run(made(**rest))
    late = log.signals["time"] >= 3.5
    count = 2.0 * np.pi / 2**17
    assert np.ptp(log.signals["crank_angle"][late], axis=0).max() < 4.0 * count
    assert error(log, 3.5) < 0.01 + 0.5 * level
