"""One list of parts, whatever runs it: the kinds in a row, the engines in a column."""

import numpy as np
import pytest

from stewart_drake import ConfigurationError, load_scenario, run, run_metrics
from stewart_drake.live.loop import LiveLoop
from stewart_drake.scenario.stepped_loop import SteppedLoop

PUSH = {"kind": "step", "wrench": [0.02, 0.0, 0.03, 3.0, -2.0, -4.0], "time": 0.05, "until": 0.1}
SMOOTH = {"sensors": {"kind": "encoders", "resolution_bits": 0}}
STIFF = {"tuner": {"kind": "block", "q_pose": 8.0e5, "q_rate": 150.0, "q_integral": 5.0e6}}
SERVOS = {
    "motors": {"kind": "position", "stiffness": 30.0, "damping": 0.1, "resolution_bits": None, "delay": 0.003},
    "controller": {"kind": "feedforward", "period": 0.01},
    **{"estimator": {"kind": "difference"}, "tuner": "fixed", "safety": None},
}
PERIODS = {"controller.period": 0.004, "command_delay": 1, "tuner.period": 0.02, "estimator.period": 0.001}
FRICTION = {"plant.motor_friction": 0.01, "model.friction": {"coulomb": 0.01}}
# Name -> scenario, changes, and how far the closed form may be from Drake's plant [m, or rad].
KINDS = {
    # Soft loops at 200 Hz show the first order of Drake's method.
    "network": ("paper_fig7", {"controller.solver": "split"}, 5e-5),
    "observer, friction, delay": ("exact_heart", {**STIFF, **SMOOTH, **FRICTION, "command_delay": 2}, 3e-7),
    "policy": ("exact_heart", {**SMOOTH, "tuner": "policy"}, 3e-7),
    "push, payload": ("exact_breathing", {**STIFF, **SMOOTH, "disturbances": [PUSH], "plant.payload_mass": 0.3}, 1e-6),
    "pid": ("exact_fig7", {"controller": {"kind": "pid"}, "sensors": "encoders"}, 5e-5),
    "computed torque": ("exact_fig7", {"controller": {"kind": "computed_torque"}}, 1e-6),
    "servos": ("exact_breathing", SERVOS, 3e-7),
    "periods": ("exact_breathing", {**PERIODS, **SMOOTH}, 3e-7),
    "safety": ("exact_breathing", {**SMOOTH, "safety": {}}, 3e-7),
    "learning": ("exact_breathing", {**SMOOTH, "adaptation": "regression"}, 3e-7),
    "real motors": ("exact_breathing", {"motors": {"resolution": 0.01, "ripple": 0.005}, "sensors": "encoders"}, 1e-3),
    "a rod breaks": ("exact_fig7", {"plant.broken_rod": {"leg": 2, "time": 0.1005}}, None),
}


@pytest.fixture(scope="module", params=KINDS)
def kind(request):
    name, changes, tolerance = KINDS[request.param]
    scenario = load_scenario(name).replace({"duration": 0.2, "log_period": 0.001, **changes})
    return scenario, run(scenario, check=False), tolerance


def test_the_stepped_loop_on_drakes_plant_is_the_diagram_to_the_bit(kind):
    scenario, log, _ = kind
    loop = SteppedLoop(scenario)
    loop.begin()
    for step in range(len(log.time)):
        loop.run_parts()
        np.testing.assert_array_equal(loop.pose, log["pose"][step])
        np.testing.assert_array_equal(loop.torque, log["torque_applied"][step])
        if step + 1 < len(log.time):
            loop.move()
    assert len(log.time) > 150
    assert np.ptp(log["pose"], axis=0).max() > 1e-4


def test_the_closed_form_and_the_live_page_go_as_drakes_plant(kind):
    scenario, drake, tolerance = kind
    if tolerance is None:
        pytest.skip("rods break on Drake's plant alone")
    closed_form = scenario.replace({"plant.kind": "closed_form"})
    fast, live = run(closed_form, check=False), LiveLoop(closed_form)
    assert (fast.status, fast.reason) == (drake.status, drake.reason)
    assert set(drake.signals) - set(fast.signals) == {"plant_state"}
    np.testing.assert_array_equal(fast.time, drake.time)
    np.testing.assert_allclose(fast["pose"], drake["pose"], rtol=0.0, atol=tolerance)
    np.testing.assert_allclose(fast["crank_angle"], drake["crank_angle"], rtol=0.0, atol=20.0 * tolerance)
    assert run_metrics(fast)["torque_rms"] == pytest.approx(run_metrics(drake)["torque_rms"], rel=0.2)
    live.advance(len(fast.time) - 1)
    np.testing.assert_allclose(live.pose, fast["pose"][-1], rtol=0.0, atol=1e-7)
    np.testing.assert_allclose(live.wanted, fast["reference"][-1], atol=1e-12)


FALLS = ("paper_fig7_uncompensated", {})
DEAD = ("exact_breathing", {**STIFF, **SMOOTH, "safety": {}, "motors": {"dead": {"leg": 1, "time": 0.2}}})


@pytest.mark.slow
@pytest.mark.parametrize(("name", "changes"), [FALLS, DEAD], ids=["falls", "dead motor"])
def test_a_run_on_the_closed_form_ends_as_on_drakes_plant(name, changes):
    drake = load_scenario(name).replace({"duration": 1.0, **changes})
    mine, other = (run(each, check=False) for each in (drake.replace({"plant.kind": "closed_form"}), drake))
    assert (mine.status, mine.reason) == (other.status, other.reason)
    assert mine.status in ("failed", "stopped")
    # A robot that falls does so a step sooner or later.
    times = [(each.end_time, each.outcome_time) for each in (mine, other)]
    assert times[0] == pytest.approx(times[1], abs=0.003)
    assert (mine.safety or {}) | {"leg": 0} == (other.safety or {}) | {"leg": 0}


@pytest.mark.parametrize("kind", ["drake", "closed_form", "mujoco"])
def test_a_plant_goes_on_from_what_it_has_saved(kind):
    scenario = load_scenario("exact_heart").replace({"plant": {"kind": kind, "motor_friction": 0.02}})
    make, torque, push = scenario.plant.make, np.full(6, 0.3), np.array([0.0, 0.01, 0.0, 1.0, 0.0, 0.0])

    def moved(plant):
        return [plant.step(torque, push).copy() for _ in range(30)]

    first, second = (make(scenario.robot, scenario.gravity) for _ in range(2))
    first.initial(*scenario.start())
    moved(first)
    state = first.save()
    after = moved(first)
    np.testing.assert_array_equal(second.restore(state), first.restore(state))
    np.testing.assert_array_equal(moved(second), after)
    np.testing.assert_array_equal(moved(first), after)
    if kind == "mujoco":
        with pytest.raises(ConfigurationError, match="state of a plant"):
            first.restore(state[:-1])
    # At the start it is again as it was at first.
    allowed = 1e-9 if kind == "mujoco" else 0.0
    np.testing.assert_allclose(first.initial(*scenario.start())[:6], scenario.start()[0], rtol=0.0, atol=allowed)
