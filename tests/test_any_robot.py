"""All works for the three shipped robots; mechanics, SDF, MuJoCo and a run for ten with legs of any kind."""

import mujoco
import numpy as np
import pytest
from mujoco_robot import MujocoRobot
from multibody_model import task_dynamics
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from random_robots import random_robot

from stewart_drake import DrakeOptions, build_plant, forward_dynamics, load_robot, load_scenario, run, run_metrics
from stewart_drake.mechanics.kinematics import pose_rate_to_twist, reach_margin
from stewart_drake.plant.model_files import sdf_text
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
def test_its_sdf_is_closed_at_home_and_moves_as_the_exact_model(which):
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
    # step; what they do is told from a motion, in plant/test_mujoco.py.
    robot = robot_of(which).replace(rotor_inertia=0.0)
    _, stewart = build_plant(robot, DrakeOptions(time_step=STEP))
    engine = MujocoRobot(robot, options=DrakeOptions(time_step=STEP))
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


@pytest.mark.long
@pytest.mark.parametrize("name", SHIPPED)
def test_faults_of_a_shipped_robot_do_what_they_do_to_the_papers(name):
    plan = fault_study(quick=True, robot=name)
    for wanted in ("push_5N", "motor_reversed", "encoder_nan", "command_nan", "reference_refused"):
        trial = next(trial for trial in plan.trials if trial.labels["fault"] == wanted)
        (row,) = plan.tables([execute(trial)])["faults"][1]
        assert row["reaction"] in FAULTS[wanted].expected, (wanted, row)
