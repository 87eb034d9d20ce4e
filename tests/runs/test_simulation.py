import gc
import itertools
import signal

import numpy as np
import pytest

from stewart_drake.base.errors import ConfigurationError, NotFiniteError
from stewart_drake.logs.log import load_log
from stewart_drake.logs.metrics import run_metrics
from stewart_drake.mechanics.kinematics import inverse_kinematics
from stewart_drake.runs import simulation
from stewart_drake.runs.simulation import run, run_of
from stewart_drake.scenario.scenario import Scenario, load_scenario
from stewart_drake.systems.diagram import ClosedLoop
from stewart_drake.systems.library import PartSystem

BRIEF = {"duration": 0.05, "tuner": {"kind": "fixed"}}


def scenario(**changes):
    return Scenario.from_dict(BRIEF | changes)


def test_the_main_job_runs_to_its_end_and_follows():
    main_job = run(load_scenario("paper_fig7", ["duration=0.5"]))
    assert (main_job.status, main_job.reason, main_job.end_time) == ("completed", None, 0.5)
    error = np.abs(main_job["pose"] - main_job["reference"])
    assert error[:, :3].max() < np.radians(1.0)
    assert error[:, 3:].max() < 0.005
    assert main_job["loop_gap"].max() < 1e-6
    # A row at every tick, both ends included.
    np.testing.assert_allclose(main_job.time, 0.005 * np.arange(101), rtol=1e-15)
    assert all(len(values) == 101 and np.isfinite(values).all() for values in main_job.values())


def test_the_robot_starts_assembled_at_the_references_pose_and_velocity_and_an_offset_moves_it_alone():
    offset = (0.02, -0.01, 0.03, 0.004, -0.003, 0.002)
    log = run(scenario(initial_offset=offset))
    pose, rate, _ = log.scenario.reference.evaluate(0.0)
    np.testing.assert_allclose(log["pose"][0], pose + offset, atol=1e-12)
    np.testing.assert_allclose(log["error"][0], offset, atol=1e-12)
    np.testing.assert_allclose(log["pose_rate"][0], rate, atol=1e-9)
    assert log["loop_gap"][0].max() < 1e-12
    np.testing.assert_allclose(log["crank_angle"][0], inverse_kinematics(log.scenario.robot, pose + offset), atol=1e-12)


@pytest.mark.parametrize("kind", ["drake", "closed_form"])
def test_a_run_that_breaks_at_its_first_tick_has_a_log_without_rows(tmp_path, kind):
    # A believed robot that cannot stand at the start.
    log = run(scenario(model={"robot": {"home_height": 0.2, "rod_length": 0.2}}, plant={"kind": kind}))
    assert (log.status, log.reason, log.end_time) == ("failed", "unreachable_pose", 0.0)
    assert {name: values.shape for name, values in log.signals.items() if len(values)} == {}
    log.save(tmp_path / "log.parquet")
    assert load_log(tmp_path).leg == log.leg in range(6)
    assert run_metrics(log)["torque_rms"] is None


def breaking_at(monkeypatch, tick, error):
    # The first tick of all is taken before the run, in which numba compiles.
    count, real = itertools.count(-1), PartSystem._compute

    def ticked(self, *rest):
        if self.part.name == "controller" and next(count) == tick:
            raise error
        return real(self, *rest)

    monkeypatch.setattr(PartSystem, "_compute", ticked)


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (NotFiniteError("torque", np.array([np.nan])), "not_finite"),
        (SystemExit("condition 'x > 0' failed."), "drake_check"),
        (MemoryError(), "out_of_memory"),
        (KeyboardInterrupt(), "interrupted"),
    ],
    ids=["ours", "drake's exit", "memory", "ctrl-c"],
)
def test_what_a_tick_raises_ends_the_run_with_its_time_and_whole_rows(monkeypatch, error, reason):
    breaking_at(monkeypatch, 4, error)
    log = run(scenario())
    assert (log.status, log.reason) == ("interrupted" if reason == "interrupted" else "failed", reason)
    assert (log.end_time, log.time[-1]) == (0.02, 0.015)
    assert {len(values) for values in log.values()} == {4}
    assert "\n" not in log.message


@pytest.mark.parametrize("kind", ["drake", "closed_form"])
def test_what_is_prepared_runs_once_and_the_scenario_that_it_was_made_of(kind):
    own, allowed = scenario(plant={"kind": kind}), "what run_of has made of this scenario"
    made = run_of(own)
    with pytest.raises(ConfigurationError, match=f"prepared: expected {allowed}"):
        run(scenario(plant={"kind": kind}, gravity=0.0), prepared=made)
    assert run(scenario(plant={"kind": kind}), prepared=made).status == "completed"
    with pytest.raises(ConfigurationError, match=f"{allowed}.* that has run"):
        run(own, prepared=made)


def test_ctrl_c_while_a_run_is_assessed_does_not_lose_it(monkeypatch):
    real = simulation.assessed

    def interrupted(*run):
        signal.raise_signal(signal.SIGINT)
        return real(*run)

    monkeypatch.setattr(simulation, "assessed", interrupted)
    log = run(scenario(plant={"kind": "closed_form"}))
    assert (log.status, log.end_time, len(log.time)) == ("interrupted", 0.05, 11)


def test_a_run_that_does_not_fit_into_memory_is_refused_before_it():
    with pytest.raises(ConfigurationError, match=r"duration: expected at most 2000 s at a plant.time_step"):
        run(scenario(duration=2001.0, log_period=1.0))


@pytest.mark.slow
def test_a_run_leaves_no_diagram_behind():
    # pydrake ties a diagram into cycles that Python's garbage collector does not find: some megabytes a run.
    def alive():
        gc.collect()
        # `isinstance` would ask lazy modules for their class, which warns.
        return sum(issubclass(type(each), ClosedLoop) for each in gc.get_objects())

    before = alive()
    assert run(scenario(duration=0.02, sensors={"kind": "encoders"})).status == "completed"
    assert alive() == before
