"""The exact controller in the loop: compiled, delayed, by encoders, and when its sensors fail."""

import json

import numpy as np
import pytest
from conftest import python
from pydrake.systems.analysis import Simulator

from stewart_drake.logs.log import SIGNALS, load_log
from stewart_drake.mechanics.dynamics import static_torque
from stewart_drake.plant.multibody_plant import build_plant
from stewart_drake.runs.simulation import run
from stewart_drake.sampling import on_grid, steps_per
from stewart_drake.scenario import Scenario, load_scenario
from stewart_drake.systems.diagram import ClosedLoop

ENCODERS = {"kind": "encoders", "rate_cutoff": 150.0}


def exact(*overrides, **changes):
    """The shipped scenario, shortened; `changes` are whole sections."""
    scenario = load_scenario("exact_fig7", ["duration=0.1", *overrides])
    return Scenario.from_dict({**scenario.to_dict(), **changes})


def same(one, other, tolerance):
    for name in set(one.signals) - {"density", "weights"}:
        np.testing.assert_allclose(other[name], one[name], rtol=0.0, atol=tolerance, err_msg=name)


@pytest.mark.slow
@pytest.mark.parametrize("sensors", [{"kind": "ideal"}, ENCODERS], ids=["ideal", "encoders"])
def test_compiled_and_numpy_do_the_same_run(sensors):
    one, other = (run(exact("duration=0.3", f"compiled={compiled}", sensors=sensors)) for compiled in ("false", "true"))
    assert one.status == other.status == "completed"
    assert one.scenario.compiled != other.scenario.compiled
    # Rounding grows by the quantum of the encoders, where a reading falls on an edge.
    same(one, other, 1e-9)
    assert np.abs(one["error"][-1]).max() < 1e-3


@pytest.mark.slow
def test_with_the_networks_weights_too():
    tuner = {"kind": "ann"}
    changes = {"model": "exact", "feedforward": "full", "solver": "split", "bumpless": True, "period": 0.005}
    logs = [
        run(Scenario.from_dict({"duration": 0.3, "tuner": tuner, "controller": changes, "compiled": compiled}))
        for compiled in (False, True)
    ]
    assert np.ptp(logs[0]["weights"][:, 0]) > 0.0
    # A density divides by the mean of errors that are almost zero.
    np.testing.assert_allclose(logs[1]["weights"], logs[0]["weights"], rtol=1e-5)
    same(*logs, 1e-9)


def test_the_start_lies_on_the_reference_and_stays_there():
    log = run(exact("duration=0.2"))
    error = np.abs(log["pose"] - log["reference"])
    assert error[:, :3].max() < np.radians(0.002)
    assert error[:, 3:].max() < 5e-6


# --- delay ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("step", "period"), [(0.001, 0.001), (0.001, 0.005), (0.0005, 0.001), (1 / 3000, 1 / 600), (1 / 7000, 1 / 1400)]
)
@pytest.mark.parametrize("delay", [0, 1, 3])
def test_the_plant_gets_the_torque_of_so_many_ticks_before(step, period, delay):
    scenario = exact(
        f"plant.time_step={step!r}",
        f"controller.period={period!r}",
        f"command_delay={delay}",
        f"log_period={step!r}",
        "duration=0.03",
        "compiled=false",
        initial_offset=[0.01, 0.0, -0.01, 0.001, 0.0, 0.002],
    )
    log, ratio = run(scenario), steps_per("", period, step)
    assert log.status == "completed"
    late = delay * ratio
    still = static_torque(scenario.robot, scenario.start()[0], scenario.gravity)
    np.testing.assert_allclose(log["torque_applied"][:late], np.broadcast_to(still, (late, 6)), rtol=1e-12)
    np.testing.assert_array_equal(log["torque_applied"][late:], log["torque"][: len(log.time) - late])
    assert np.ptp(log["torque"], axis=0).min() > 0.0
    # That is no matter of the log alone: the plant by itself, given these torques, goes the same way.
    diagram, plant = build_plant(scenario.robot, scenario.plant, scenario.gravity)
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    plant.set_state(context, *scenario.start())
    for row in range(len(log.time)):
        state = plant.plant.GetPositionsAndVelocities(plant.plant.GetMyContextFromRoot(context))
        np.testing.assert_allclose(log["plant_state"][row], state, atol=1e-11)
        diagram.GetInputPort("torque").FixValue(context, log["torque_applied"][row])
        simulator.AdvanceTo((row + 1) * on_grid(step))


def test_encoders_and_delay_together_run_and_keep_what_was_measured(tmp_path):
    log = run(exact("command_delay=1", sensors=ENCODERS))
    assert log.status == "completed"
    measured = np.abs(log["measured_pose"] - log["pose"])
    assert 0.0 < measured.max() < 1e-4
    np.testing.assert_allclose(log["error"], log["measured_pose"] - log["reference"], atol=1e-15)
    log.save(tmp_path / "log.parquet")
    again = load_log(tmp_path / "log.parquet")
    assert set(again.signals) == set(log.signals) <= set(SIGNALS)
    np.testing.assert_array_equal(again["block_weights"], np.broadcast_to(log.scenario.tuner.weights, (101, 4)))


def test_a_robot_that_starts_in_motion_is_measured_in_motion_from_the_first_tick():
    log = run(exact("duration=0.02", sensors=ENCODERS))
    wrong = np.abs(log["measured_pose_rate"] - log["pose_rate"])
    assert np.abs(log["pose_rate"][0]).max() > 1.0
    np.testing.assert_allclose(wrong[0], 0.0, atol=1e-5)
    # No kick: the first torque is as near to the weight's as those that follow.
    assert np.abs(log["torque"] - log["torque"].mean(axis=0)).max() < 0.1


@pytest.mark.slow
def test_a_model_that_cannot_stand_at_the_start_ends_the_run_with_a_log_delayed_or_not():
    for delay in (0, 2):
        log = run(exact(f"command_delay={delay}", model_robot={"home_height": 0.2, "rod_length": 0.2}))
        assert (log.status, log.reason) == ("failed", "unreachable_pose")


def test_two_runs_of_one_diagram_share_nothing():
    loop = ClosedLoop(exact("duration=0.05", "command_delay=2", sensors=ENCODERS))
    logs = []
    for _ in range(2):
        simulator = Simulator(loop, loop.create_start_context())
        simulator.AdvanceTo(0.04)
        logs.append(loop.sinks["torque_applied"].FindLog(simulator.get_context()).data().copy())
    np.testing.assert_array_equal(logs[0], logs[1])
    # A clone goes on as the original does.
    simulator = Simulator(loop, loop.create_start_context())
    simulator.AdvanceTo(0.0205)
    twin = Simulator(loop, simulator.get_context().Clone())
    for each in (simulator, twin):
        each.AdvanceTo(0.0395)
        np.testing.assert_array_equal(
            loop.sinks["torque_applied"].FindLog(each.get_context()).data()[:, -15:], logs[0][:, -15:]
        )


# --- failures ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("compiled", ["false", "true"])
@pytest.mark.parametrize(("fault", "size"), [("nan", 0.0), ("jump", 0.5)])
def test_an_encoder_that_fails_ends_the_run_by_name_and_the_log_is_kept(fault, size, compiled):
    faults = [{"kind": fault, "leg": 2, "time": 0.05, "size": size}]
    log = run(exact(f"compiled={compiled}", sensors={**ENCODERS, "hold_ticks": 4, "faults": faults}))
    assert (log.status, log.reason) == ("failed", "encoder")
    # Four ticks are bridged, at 0.050 to 0.053; the fifth ends it.
    assert log.end_time == pytest.approx(0.054)
    assert len(log.time) >= 54
    assert np.isfinite(log["torque"]).all()
    np.testing.assert_array_equal(log["measured_pose"][50:54], np.broadcast_to(log["measured_pose"][49], (4, 6)))


def test_an_encoder_that_fails_for_less_than_that_does_not():
    faults = [{"kind": "nan", "leg": 2, "time": 0.05, "duration": 0.004}]
    log = run(exact(sensors={**ENCODERS, "hold_ticks": 4, "faults": faults}))
    assert log.status == "completed"
    assert np.abs(log["error"][-1, 3:]).max() < 1e-3


@pytest.mark.parametrize("compiled", ["false", "true"])
def test_an_ideal_sensor_that_fails_is_bridged_by_the_controller_and_then_ends_the_run(compiled):
    sensors = {"kind": "ideal", "faults": [{"kind": "nan", "time": 0.05}]}
    log = run(exact(f"compiled={compiled}", "controller.hold_ticks=3", sensors=sensors))
    assert (log.status, log.reason) == ("failed", "not_finite")
    assert log.end_time == pytest.approx(0.053)
    held = log["torque"][49]
    np.testing.assert_array_equal(log["torque"][50:53], np.broadcast_to(held, (3, 6)))
    np.testing.assert_array_equal(log["integral"][50:53], np.broadcast_to(log["integral"][49], (3, 6)))


@pytest.mark.parametrize("compiled", ["false", "true"])
@pytest.mark.parametrize("weights", [("1e-300", "1e300"), ("1e300", "1e-300")])
def test_weights_without_a_gain_end_the_run_by_name(weights, compiled):
    blocks = {"kind": "block", "q_pose": weights[0], "q_rate": weights[0], "q_integral": weights[0], "r": weights[1]}
    blocks = {key: value if key == "kind" else float(value) for key, value in blocks.items()}
    log = run(exact(f"compiled={compiled}", tuner=blocks))
    assert (log.status, log.reason) in {("failed", "riccati"), ("failed", "not_finite")}
    assert log.end_time == 0.0


# --- the command line ----------------------------------------------------------------------------------------------

HEAVY = ("torch", "numba", "llvmlite")
"""What a start must not load unless it is used: seconds."""


@pytest.mark.slow
def test_the_shipped_scenario_runs_from_the_command_line(tmp_path):
    out = tmp_path / "out"
    python("-m", "stewart_drake", "run", "exact_fig7", "--set", "duration=0.3", "--out", out)
    log = load_log(out)
    assert (log.status, log.end_time) == ("completed", 0.3)
    assert log.scenario.controller.model == "exact"


@pytest.mark.slow
@pytest.mark.parametrize(
    "start",
    [
        "import stewart_drake",
        "import stewart_drake.runs.simulation, stewart_drake.control.control_law, stewart_drake.systems",
        "from click.testing import CliRunner; from stewart_drake.cli.app import cli; "
        "assert CliRunner().invoke(cli, ['run', '--help']).exit_code == 0",
        "from stewart_drake.scenario import load_scenario; from stewart_drake.runs.simulation import run; "
        "assert run(load_scenario('paper_fig7', ['duration=0.02'])).status == 'completed'",
    ],
    ids=["import", "import all of a run", "run --help", "a run of the paper"],
)
def test_a_start_loads_neither_torch_nor_numba(start):
    script = f"{start}; import json, sys; print(json.dumps(sorted(set(sys.modules) & set({HEAVY!r}))))"
    assert json.loads(python("-c", script).splitlines()[-1]) == []


@pytest.mark.slow
def test_a_compiled_run_does_load_numba():
    """So that the test before this one can fail."""
    script = (
        "from stewart_drake.scenario import load_scenario; from stewart_drake.runs.simulation import run; "
        "run(load_scenario('exact_fig7', ['duration=0.01'])); import sys; print('numba' in sys.modules)"
    )
    assert python("-c", script).splitlines()[-1] == "True"
