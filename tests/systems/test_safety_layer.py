import numpy as np
import pytest
from ended import ended
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from strategies import ROBOT

from stewart_drake.errors import ConfigurationError, SafetyStop
from stewart_drake.files.yaml_files import shipped_folder
from stewart_drake.logs.log import load_log
from stewart_drake.logs.metrics import run_metrics
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY, static_torque
from stewart_drake.mechanics.kinematics import pose_jacobian
from stewart_drake.plant.multibody_plant import add_plant
from stewart_drake.runs.checks import check_scenario
from stewart_drake.runs.outputs import write_run
from stewart_drake.runs.simulation import run
from stewart_drake.safety import LEVELS, MONITORS, SafetyOptions, first_trip
from stewart_drake.scenario import Scenario, load_scenario
from stewart_drake.systems import ReferenceSource, SafetyLayer, TaskSpaceSensor

BASE = {
    "duration": 0.12,
    "reference": {"kind": "sine"},
    "controller": {
        "period": 0.001,
        "model": "exact",
        "feedforward": "full",
        "weight_length": 0.11,
        "solver": "split",
        "saturation": "clamp",
    },
    "tuner": {"kind": "block", "q_pose": 4e5, "q_rate": 30.0, "q_integral": 4e7},
    "safety": {},
}
NAN = {"faults": [{"kind": "nan", "leg": 3, "time": 0.05}]}


def scenario(**changes):
    return Scenario.from_dict(BASE | changes)


@pytest.mark.slow
def test_a_run_in_which_nothing_is_wrong_is_the_run_without():
    plain, guarded = (run(scenario(safety=safety, sensors={"kind": "encoders"})) for safety in (None, {}))
    assert guarded.safety is None
    for name in plain.signals:
        np.testing.assert_array_equal(guarded[name], plain[name], err_msg=name)
    np.testing.assert_array_equal(guarded["safety"], np.tile([0.0, 0.0, -1.0], (121, 1)))
    assert "safety" not in plain.signals


@pytest.mark.slow
def test_level_monitor_and_leg_are_logged_and_told_in_the_metrics(tmp_path):
    log = run(scenario(link=NAN, duration=1.0))
    level, monitor, leg = log["safety"].T
    assert [LEVELS[int(x)] for x in (level[49], level[50], level[69], level[70], level[-1])] == [
        "none",
        "hold",
        "hold",
        "ramp",
        "safe_hold",
    ]
    assert {MONITORS[int(x)] for x in monitor[50:]} == {"command_not_finite"}
    assert set(leg[50:]) == {3.0}
    # In torques: held, then carried over to those of the weight.
    np.testing.assert_array_equal(log["torque_applied"][50:70], np.tile(log["torque_applied"][49], (20, 1)))
    metrics = run_metrics(log)
    assert (metrics["status"], metrics["reason"], metrics["leg"]) == ("stopped", "command_not_finite", 3)
    assert metrics["end_time"] == pytest.approx(0.05 + 0.02 + 0.02 + 0.5, abs=0.002)
    assert metrics["safety"] == {
        "monitor": "command_not_finite",
        "level": "hold",
        "time": 0.05,
        "leg": 3,
        "cause": None,
        "worst": "safe_hold",
        "last": "safe_hold",
        "stopped": {"monitor": "command_not_finite", "time": 0.07, "leg": 3},
    }
    write_run(log, tmp_path, pictures=False)
    again = load_log(tmp_path)
    assert again.safety == log.safety
    np.testing.assert_array_equal(again["safety"], log["safety"])


@pytest.mark.slow
def test_a_fault_of_the_estimator_or_the_controller_is_bridged_and_has_its_cause():
    encoders = {
        "kind": "encoders",
        "hold_ticks": 2,
        "faults": [{"kind": "nan", "leg": 1, "time": 0.05, "duration": 0.01}],
    }
    log = run(scenario(sensors=encoders))
    assert log.status == "completed"
    assert (log.safety["monitor"], log.safety["cause"], log.safety["worst"]) == ("sensor_failed", "encoder", "hold")
    assert log.safety["time"] == 0.052
    # A limit of the controller's own that the motion soon breaks.
    log = run(scenario(controller=BASE["controller"] | {"min_transmission": 0.97}, duration=0.3), check=False)
    assert (log.safety["monitor"], log.safety["cause"]) == ("controller_failed", "crank_dead_centre")


@pytest.mark.slow
def test_a_motor_that_sticks_is_no_sensor_that_failed():
    log = run(load_scenario("sway", ["robot=servo_hexapod", "plant.motor_friction=0.5", "duration=0.5"]))
    assert (log.status, log.reason, log.safety["monitor"]) == ("failed", "reading_stuck", "reading_stuck")
    assert "friction holds what it reads" in log.message


def test_ctrl_c_keeps_the_log_and_what_the_layer_saw():
    def stop(time):
        if time > 0.08:
            raise KeyboardInterrupt

    log = run(scenario(link={"faults": [{"kind": "nan", "time": 0.05, "duration": 0.004}]}), progress=stop)
    assert (log.status, log.reason) == ("interrupted", "interrupted")
    assert log.safety["monitor"] == "command_not_finite"
    assert len(log.time) > 80
    assert run_metrics(log)["safety"]["worst"] == "hold"


# --- any controller -------------------------------------------------------------------------------------------------


class UsersController(LeafSystem):
    """PD in the joints and the weight's torque, until it goes mad."""

    def __init__(self, mad_from, what):
        super().__init__()
        self.measurement = self.DeclareVectorInputPort("measurement", 12)
        self.DeclareVectorOutputPort("torque", 6, self._calc)
        self.mad_from, self.what = mad_from, what

    def _calc(self, context, output):
        pose = self.measurement.Eval(context)[:6]
        jacobian = pose_jacobian(ROBOT, pose)
        error = jacobian @ (pose - ROBOT.home_pose)
        rate = jacobian @ self.measurement.Eval(context)[6:]
        torque = static_torque(ROBOT, pose) - 20.0 * error - 0.5 * rate
        if context.get_time() >= self.mad_from:
            torque = torque + self.what
        output.SetFromVector(torque)


@pytest.mark.slow
@pytest.mark.parametrize(("what", "reason"), [(np.inf, "command_not_finite"), (1e5, "torque_limit")])
def test_a_users_own_system_runs_behind_it(what, reason):
    builder = DiagramBuilder()
    plant = add_plant(builder, ROBOT)
    sensor = builder.AddSystem(TaskSpaceSensor(plant))
    reference = builder.AddSystem(ReferenceSource(Scenario.from_dict({"reference": {"kind": "hold"}}).reference))
    user = builder.AddSystem(UsersController(0.1, what))
    still = static_torque(ROBOT, ROBOT.home_pose)
    layer = builder.AddSystem(SafetyLayer(ROBOT, SafetyOptions(), STANDARD_GRAVITY, 0.001, still))
    builder.Connect(plant.state_output_port, sensor.plant_state)
    for port in (user.measurement, layer.measurement):
        builder.Connect(sensor.measurement, port)
    builder.Connect(reference.reference, layer.reference)
    builder.Connect(user.get_output_port(), layer.command)
    builder.Connect(layer.torque, plant.torque_input_port)
    diagram = builder.Build()
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.1)
    # Ports for which there is no signal are left alone.
    assert first_trip(layer.state(simulator.get_context()), 0.001) is None
    stop = ended(simulator, 2.0, SafetyStop)
    assert stop.reason == reason
    assert stop.trip["time"] == 0.1
    pose = plant.pose_and_rate(plant.state_output_port.Eval(plant.plant.GetMyContextFromRoot(simulator.get_context())))[
        0
    ]
    np.testing.assert_allclose(pose, ROBOT.home_pose, atol=1e-3)


# --- before the start -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"safety": {"damping": 1.0}}, "safety.damping"),
        ({"safety": {"horizon": 0.5}, "duration": 2.0}, "safety.horizon"),
        ({"safety": {"hold_time": 0.0009}}, "safety.hold_time"),
        ({"model_robot": {"rod_length": 0.36, "home_height": 0.25}, "duration": 2.0}, "model_robot"),
    ],
)
def test_what_would_trip_is_refused_before_the_start(changes, key):
    with pytest.raises(ConfigurationError) as caught:
        check_scenario(scenario(**changes))
    assert caught.value.key.startswith(key)


# --- no false alarms ------------------------------------------------------------------------------------------------

# That one falls over on purpose.
NOMINAL = sorted({path.stem for path in shipped_folder("scenarios").glob("*.yaml")} - {"paper_fig7_uncompensated"})


@pytest.mark.slow
@pytest.mark.parametrize("name", NOMINAL)
def test_no_nominal_scenario_trips_anything(name):
    case = load_scenario(name)
    # The part in which the most happens; each has gone through its fastest motion by then.
    log = run(case.replace({"safety": {}, "duration": min(2.5, case.duration), "plant.engine": "reduced"}))
    assert (log.status, log.safety) == ("completed", None)
    assert (log["safety"][:, 0] == 0.0).all()
