import numpy as np
import pytest
from strategies import ROBOT

from stewart_drake.control.joint_pid import PidOptions
from stewart_drake.control.lqi_options import LqiOptions
from stewart_drake.errors import ConfigurationError
from stewart_drake.logs.metrics import run_metrics
from stewart_drake.plotting import plot_states, plot_torques
from stewart_drake.runs.simulation import run
from stewart_drake.scenario import Scenario, load_scenario
from stewart_drake.systems.diagram import ClosedLoop

GRAVITY = 9.81
HOME = np.array(ROBOT.home_pose)
KINDS = ("pid", "computed_torque")


def scenario(**changes):
    return Scenario.from_dict({"duration": 0.4, "reference": {"kind": "sine"}} | changes)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_in_the_loop_the_motion_is_followed_and_the_log_is_whole(kind):
    log = run(scenario(controller={"kind": kind}))
    assert log.status == "completed"
    assert np.abs(log["pose"] - log["reference"])[:, 3:].max() < 2e-5
    assert "weights" not in log.signals
    assert "density" not in log.signals
    np.testing.assert_allclose(log["error"], log["pose"] - log["reference"], atol=1e-15)
    assert log["integral"].any() == (kind == "computed_torque")
    assert run_metrics(log)["omega_q"] is None
    assert plot_states(log) is not None
    assert plot_torques(log) is not None


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_with_encoders_and_delay_the_error_is_that_of_the_measured_pose(kind):
    sensors = {"kind": "encoders", "rate_cutoff": 150.0}
    log = run(scenario(duration=0.2, controller={"kind": kind}, sensors=sensors, command_delay=1))
    assert log.status == "completed"
    np.testing.assert_allclose(log["error"], log["measured_pose"] - log["reference"], atol=1e-15)


@pytest.mark.slow
def test_an_unknown_payload_leaves_a_pd_loop_off_and_an_integral_does_not():
    def sag(**controller):
        chosen = {"kind": "computed_torque", **controller}
        heavy = scenario(duration=1.5, reference={"kind": "hold"}, plant={"payload_mass": 0.3}, controller=chosen)
        return run(heavy)["pose"][-1, 5] - 0.3

    # In heave the payload adds weight and inertia: M z'' = -M_believed omega^2 z - 0.3 g.
    from stewart_drake.mechanics.dynamics import task_inertia

    still = -0.3 * GRAVITY / (task_inertia(ROBOT, HOME)[5, 5] * 93.8**2)
    assert sag(integral_frequency=0.0) == pytest.approx(still, rel=0.02)
    assert abs(sag()) < 0.01 * abs(still)


def test_another_kind_drops_the_keys_of_the_old_one_and_keeps_those_that_both_have():
    base = load_scenario("exact_fig7")
    pid = base.replace({"controller.kind": "pid"})
    assert pid.controller == PidOptions(period=0.001)
    assert load_scenario("exact_fig7", ["controller.kind=pid", "controller.kp=3"]).controller.kp == 3.0
    assert Scenario.from_dict({"controller": {"period": 0.002}}).controller == LqiOptions(period=0.002)
    assert Scenario.from_dict(pid.to_dict()) == pid


def test_what_needs_the_lqi_says_so():
    with pytest.raises(ConfigurationError) as caught:
        scenario(controller={"kind": "pid"}).control_law()
    assert caught.value.key == "controller.kind"


def test_the_diagram_names_its_ports():
    loop = ClosedLoop(scenario(controller={"kind": "pid"}))
    names = {loop.get_output_port(i).get_name() for i in range(loop.num_output_ports())}
    assert {"torque", "error", "integral"} <= names
    assert not {"weights", "density"} & names
