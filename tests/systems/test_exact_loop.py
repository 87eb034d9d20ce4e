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

ENCODERS = {"kind": "encoders", "rate_cutoff": 150.0}


def exact(*overrides, **changes):
    """The shipped scenario, shortened; `changes` are whole sections."""
    scenario = load_scenario("exact_fig7", ["duration=0.1", *overrides])
    return Scenario.from_dict({**scenario.to_dict(), **changes})


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"sensors": ENCODERS},
        {
            "tuner": {"kind": "paper"},
            "controller": {
                "model": "exact",
                "feedforward": "full",
                "solver": "split",
                "bumpless": True,
                "period": 0.005,
            },
        },
    ],
    ids=["ideal", "encoders", "with the network's weights"],
)
def test_compiled_and_numpy_do_the_same_run(changes):
    one, other = (run(exact("duration=0.3", f"compiled={compiled}", **changes)) for compiled in ("false", "true"))
    assert one.status == other.status == "completed"
    assert one.scenario.compiled != other.scenario.compiled
    # Rounding grows by the quantum of the encoders, where a reading falls on an edge.
    for name in set(one.signals) - {"density", "weights"}:
        np.testing.assert_allclose(other[name], one[name], rtol=0.0, atol=1e-9, err_msg=name)
    if "tuner" in changes:
        assert np.ptp(one["weights"][:, 0]) > 0.0
        # A density divides by the mean of errors that are almost zero.
        np.testing.assert_allclose(other["weights"], one["weights"], rtol=1e-5)


def test_the_start_lies_on_the_reference_and_stays_there():
    log = run(exact("duration=0.2"))
    error = np.abs(log["pose"] - log["reference"])
    assert error[:, :3].max() < np.radians(0.002)
    assert error[:, 3:].max() < 5e-6


# --- delay ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("step", "period", "delay"),
    [
        (0.001, 0.001, 0),
        (0.001, 0.005, 1),
        *(
            pytest.param(*rates, delay, marks=pytest.mark.slow)
            for rates in ((0.001, 0.001), (0.0005, 0.001), (1 / 3000, 1 / 600), (1 / 7000, 1 / 1400))
            for delay in (1, 3)
        ),
    ],
)
def test_the_plant_gets_the_torque_of_so_many_ticks_before(step, period, delay):
    scenario = exact(
        f"plant.time_step={step!r}",
        f"controller.period={period!r}",
        f"command_delay={delay}",
        f"log_period={step!r}",
        "duration=0.03",
        "compiled=false",
        "bounds.error_ratio=null",  # in so short a time nothing is followed
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
    # One that fails for less than that does not end it.
    shorter = {**ENCODERS, "hold_ticks": 4, "faults": [faults[0] | {"duration": 0.004}]}
    assert run(exact(f"compiled={compiled}", sensors=shorter)).status == "completed"


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
@pytest.mark.parametrize(
    ("changes", "reasons"),
    [
        *(
            ({"tuner": {"kind": "block", "q_pose": q, "q_rate": q, "q_integral": q, "r": r}}, {"riccati", "not_finite"})
            for q, r in ((1e-300, 1e300), (1e300, 1e-300))
        ),
        # A believed robot that cannot stand at the start, delayed or not.
        *(
            ({"model_robot": {"home_height": 0.2, "rod_length": 0.2}, "command_delay": delay}, {"unreachable_pose"})
            for delay in (0, 2)
        ),
    ],
)
def test_a_first_tick_that_fails_ends_the_run_by_name_with_a_log(changes, reasons, compiled):
    log = run(exact(f"compiled={compiled}", **changes))
    assert log.status == "failed"
    assert log.reason in reasons
    assert log.end_time == 0.0


# --- the command line ----------------------------------------------------------------------------------------------

HEAVY = ("torch", "numba", "llvmlite")
"""What a start must not load unless it is used: seconds."""
RUN = "from stewart_drake.scenario import load_scenario; from stewart_drake.runs.simulation import run"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("start", "loaded"),
    [
        ("import stewart_drake", []),
        ("import stewart_drake.runs.simulation, stewart_drake.control.control_law, stewart_drake.systems", []),
        (
            "from click.testing import CliRunner; from stewart_drake.cli.app import cli; "
            "assert CliRunner().invoke(cli, ['run', '--help']).exit_code == 0",
            [],
        ),
        (f"{RUN}; assert run(load_scenario('paper_fig7', ['duration=0.02'])).status == 'completed'", []),
        # So that the others can fail.
        (f"{RUN}; run(load_scenario('exact_fig7', ['duration=0.01']))", ["llvmlite", "numba"]),
    ],
    ids=["import", "import all of a run", "run --help", "a run of the paper", "a compiled run"],
)
def test_a_start_loads_neither_torch_nor_numba_unless_it_uses_them(start, loaded):
    script = f"{start}; import json, sys; print(json.dumps(sorted(set(sys.modules) & set({HEAVY!r}))))"
    assert json.loads(python("-c", script).splitlines()[-1]) == loaded
