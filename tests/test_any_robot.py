"""All works for the three shipped robots; mechanics, SDF, MuJoCo and a run for ten with legs of any kind."""

import mujoco
import numpy as np
import pytest
from multibody_model import task_dynamics
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import Simulator
from random_robots import random_robot

from stewart_drake import (
    PlantOptions,
    Scenario,
    build_plant,
    forward_dynamics,
    forward_kinematics,
    inverse_dynamics,
    inverse_kinematics,
    load_robot,
    load_scenario,
    run,
    run_metrics,
)
from stewart_drake.mechanics.dynamics import static_torque
from stewart_drake.mechanics.kinematics import pose_rate_to_twist, reach_margin
from stewart_drake.mujoco_model import MujocoRobot
from stewart_drake.plant.sdf_model import sdf_text
from stewart_drake.runs.checks import check_scenario
from stewart_drake.runs.replay import write_replay
from stewart_drake.studies import robots as robot_table
from stewart_drake.studies.comparison import load_comparison
from stewart_drake.studies.faults import FAULTS, fault_study
from stewart_drake.studies.runs import execute

SHIPPED = ["paper", "reachy_mini", "servo_hexapod"]
RANDOM = range(10)
STEP = 1e-4


def robot_of(which):
    return load_robot(which) if isinstance(which, str) else random_robot(which)


def near_home(robot, count, seed=0):
    rng = np.random.default_rng(seed)
    size = 0.1 * robot.characteristic_length
    pose = robot.home_pose + rng.uniform(-1.0, 1.0, (count, 6)) * ([0.1] * 3 + [size] * 3)
    return pose[reach_margin(robot, pose).min(axis=-1) > 0.02]


@pytest.mark.parametrize("which", [*SHIPPED, *RANDOM])
def test_crank_angles_of_a_pose_lead_back_to_it_and_torques_of_a_motion_make_it(which):
    robot = robot_of(which)
    poses = near_home(robot, 20)
    assert len(poses) > 10
    rng = np.random.default_rng(1)
    for pose in poses:
        found = forward_kinematics(robot, inverse_kinematics(robot, pose), guess=robot.home_pose)
        np.testing.assert_allclose(found, pose, rtol=0.0, atol=1e-10)
        rate, acceleration = rng.uniform(-1.0, 1.0, (2, 6))
        torque = inverse_dynamics(robot, pose, rate, acceleration)
        np.testing.assert_allclose(forward_dynamics(robot, pose, rate, torque), acceleration, rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("which", [*SHIPPED, *RANDOM])
def test_its_sdf_stands_closed_at_home_and_moves_as_the_exact_model_says(which):
    robot = robot_of(which)
    for joint in ("universal", "ball"):
        plant = MultibodyPlant(0.001)
        Parser(plant).AddModelsFromString(sdf_text(robot, rod_joint=joint), "sdf")
    _, stewart = build_plant(robot)
    assert stewart.loop_gap(stewart.assemble(robot.home_pose)).max() < 1e-14
    context = stewart.plant.CreateDefaultContext()
    rng = np.random.default_rng(2)
    for pose in near_home(robot, 5):
        rate, torque = rng.uniform(-1.0, 1.0, 6), rng.uniform(-0.1, 0.1, 6) * robot.effort_limit
        state = stewart.assemble(pose, rate)
        assert stewart.loop_gap(state).max() < 1e-13
        stewart.plant.SetPositionsAndVelocities(context, state)
        found = task_dynamics(stewart, context).acceleration(torque)
        # The plant's rods have an inertia about their own axes, which the closed form leaves out.
        thin = robot.replace(rod_inertia=(*robot.rod_inertia[:2], 1e-12))
        wanted = forward_dynamics(thin, pose, rate, torque)
        twist_rate = pose_rate_to_twist(pose, wanted)
        assert np.abs(found[3:] - twist_rate[3:]).max() < 0.05 * (1.0 + np.abs(twist_rate[3:]).max())


@pytest.mark.parametrize("which", [*SHIPPED, *RANDOM])
def test_mujoco_accelerates_it_as_drake_does(which):
    # Rotors behind gears would open the loops with accelerations of which MuJoCo leaves a ten-thousandth in the first
    # step; what they do is told from the motion below.
    robot = robot_of(which).replace(rotor_inertia=0.0)
    _, stewart = build_plant(robot, PlantOptions(time_step=STEP))
    engine = MujocoRobot(robot, options=PlantOptions(time_step=STEP))
    context = stewart.plant.CreateDefaultContext()
    rng = np.random.default_rng(3)
    for pose in near_home(robot, 5):
        rate, torque = rng.uniform(-1.0, 1.0, 6), rng.uniform(-0.1, 0.1, 6) * robot.effort_limit
        state = stewart.assemble(pose, rate)
        engine.set_state(stewart, state)
        engine.data.ctrl = torque
        mujoco.mj_forward(engine.model, engine.data)
        stewart.plant.SetPositionsAndVelocities(context, state)
        expected = task_dynamics(stewart, context).acceleration(torque)
        np.testing.assert_allclose(engine.acceleration, expected, rtol=0.0, atol=1e-3 * np.abs(expected).max())


@pytest.mark.slow
@pytest.mark.parametrize("which", [*SHIPPED, 0, 1, 2])
def test_mujoco_moves_it_with_its_rotors_as_drake_does(which):
    robot, count = robot_of(which), 500
    diagram, stewart = build_plant(robot, PlantOptions(time_step=STEP))
    engine = MujocoRobot(robot, options=PlantOptions(time_step=STEP))
    torque = static_torque(robot, robot.home_pose) + 0.05 * robot.effort_limit * np.array([1, -0.5, 0.2, 0.4, -1, 0.3])
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    stewart.set_state(context, robot.home_pose)
    diagram.GetInputPort("torque").FixValue(context, torque)
    simulator.AdvanceTo(count * STEP)
    pose = stewart.pose_and_rate(diagram.GetOutputPort("state").Eval(context))[0]
    engine.set_state(stewart, stewart.assemble(robot.home_pose))
    engine.advance(torque, count)
    way = np.linalg.norm(pose[3:] - robot.home_pose[3:])
    assert way > 1e-5
    assert np.abs(engine.platform[:3] - pose[3:]).max() < 0.01 * way


@pytest.mark.long
@pytest.mark.parametrize("which", RANDOM)
def test_a_robot_with_legs_of_any_kind_holds_and_sways(which):
    robot = random_robot(which)
    size = 0.05 * robot.characteristic_length
    sway = {"kind": "sine", "amplitude": [0.03, 0, 0, 0, 0, size], "angular_frequency": [6.0] * 6}
    scenario = load_scenario("sway").replace(
        {"robot": robot, "reference": sway, "duration": 0.3, "limits.clearance": None}
    )
    log = run(scenario)
    assert (log.status, log.message) == ("completed", None)
    assert run_metrics(log)["rmse_norm_mm"] < 1e-2 * 1e3 * size


@pytest.mark.slow
@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_robot_holds_sways_and_is_replayed(name, tmp_path, call):
    for scenario in ("hold", "sway"):
        assert call("check", scenario, "--set", f"robot={name}")[0] == 0
        log = run(load_scenario(scenario, [f"robot={name}", "duration=0.5"]))
        assert log.status == "completed"
        assert run_metrics(log)["rmse_norm_mm"] < 0.02
        write_replay(log, tmp_path / f"{scenario}.html")


@pytest.mark.long
@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_robot_is_compared_and_its_motions_can_all_be_done(name):
    comparison = load_comparison("tracking", True, name)
    for index in range(comparison.runs):
        check_scenario(comparison.scenario(index))
    log = run(comparison.scenario(comparison.runs - 1))
    assert log.status == "completed"


@pytest.mark.long
@pytest.mark.parametrize("name", SHIPPED)
def test_faults_of_a_shipped_robot_do_what_they_do_to_the_papers(name):
    plan = fault_study(quick=True, robot=name)
    for wanted in ("push_5N", "motor_reversed", "encoder_nan", "command_nan", "reference_refused"):
        index = next(i for i in plan.indices if plan.pairs[i][0].name == wanted)
        (row,) = plan.tables([execute(plan.task(index))])["faults"][1]
        assert row["reaction"] in FAULTS[wanted].expected, (wanted, row)


@pytest.mark.long
def test_the_table_of_robots_has_a_row_for_each(monkeypatch):
    monkeypatch.setattr(robot_table, "SAMPLES", 2000)
    monkeypatch.setattr(robot_table, "SCENARIO", "hold")
    rows = robot_table.robot_rows({name: load_robot(name) for name in SHIPPED}, lambda _: None)
    assert [row[0] for row in rows] == SHIPPED
    assert all(len(row) == len(robot_table.HEADER) for row in rows)
    page = robot_table.robots_page(rows)
    assert all(f"| {name} |" in page for name in SHIPPED)


def test_a_region_needs_no_feasible_motion(call, monkeypatch):
    from stewart_drake.planning import workspace

    class DoneError(Exception):
        pass

    def stop(*_, **__):
        raise DoneError

    monkeypatch.setattr(workspace, "study_poses", stop)
    monkeypatch.setenv("STEWART_DRAKE_TRACEBACK", "")
    status, _, error = call("workspace", "--set", "robot.platform_joint_radius=0.16", "--quiet")
    assert "left out is the scenario's own motion: reference: breaks the limit joint_swing" in error
    assert (status, "DoneError" in error) == (4, True)


def test_a_scenario_of_a_random_robot_is_read_back():
    scenario = Scenario(robot=random_robot(0), safety={}, tuner={"kind": "block"})
    assert Scenario.from_dict(scenario.to_dict()) == scenario
