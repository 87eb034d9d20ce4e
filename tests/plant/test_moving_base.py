"""Gravity as a vector and a base that moves: the closed form against Drake on a deck, and all engines in a run."""

import numpy as np
import pytest
from multibody_model import task_dynamics
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import DiscreteContactApproximation, MultibodyPlant
from pydrake.multibody.tree import QuaternionFloatingJoint
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from strategies import ROBOT, UNEQUAL

from stewart_drake import DrakeOptions, Scenario, add_loop, add_robot, run
from stewart_drake.hardware.moving_base import base_signal
from stewart_drake.mechanics.dynamics import task_bias, task_inertia
from stewart_drake.mechanics.kinematics import pose_rate_to_twist, rotation_matrix
from stewart_drake.plant.model_files import sdf_text
from stewart_drake.plant.multibody_plant import StewartRobot
from stewart_drake.references import SineReference

HEAVY = ROBOT.replace(
    rod_mass=0.8, crank_mass=0.4, rod_inertia=(0.016, 0.016, 1e-12), crank_inertia=(0.001, 0.002, 0.0025)
)
SLIM = UNEQUAL.replace(rod_inertia=(0.0016, 0.0016, 1e-12))
"""The closed form has no spin of the rods, which a turning base gives them."""
ROLLING = {
    "kind": "sine",
    "center": [0.0] * 6,
    "amplitude": [0.3, 0.2, 0.1, 0.05, 0.2, 0.1],
    "angular_frequency": [5.0, 4.0, 3.0, 4.0, 5.0, 6.0],
    "phase": [0.3, 0.5, 0.0, 0.0, 1.0, 0.0],
}
LOOP = {"controller": "computed_torque", "reference": "hold", "duration": 0.2}


def on_deck(robot, gravity):
    # The SDF's base is welded to a free body of the same plant; nothing here knows of forces of a moving base.
    plant = MultibodyPlant(0.001)
    plant.mutable_gravity_field().set_gravity_vector(np.array(gravity))
    inertia = "<inertial><mass>1</mass><inertia><ixx>1</ixx><iyy>1</iyy><izz>1</izz></inertia></inertial>"
    text = sdf_text(robot, rod_joint="ball", collision=False, joint_swing=None, name="stewart", base=None)
    text = text.replace("<parent>world</parent>", "<parent>deck</parent>")
    text = text.replace('<link name="base">', f'<link name="deck">{inertia}</link><link name="base">', 1)
    (instance,) = Parser(plant).AddModelsFromString(text, "sdf")
    stewart = StewartRobot(plant, instance, robot, DrakeOptions(rod_joint="ball"), RigidTransform())
    plant.AddJoint(QuaternionFloatingJoint("platform", stewart.frame("base"), stewart.frame("platform")))
    deck = plant.AddJoint(QuaternionFloatingJoint("deck", plant.world_frame(), stewart.frame("deck")))
    plant.Finalize()
    return stewart, deck


@pytest.mark.slow
@pytest.mark.parametrize("robot", [HEAVY, SLIM])
def test_dynamics_on_a_moving_base_are_those_of_a_robot_on_a_free_deck(robot):
    rng = np.random.default_rng(3)
    for _ in range(5):
        pose, rate = robot.home_pose + rng.uniform(-0.03, 0.03, 6), rng.uniform(-2.0, 2.0, 6)
        gravity, attitude, place = rng.normal(size=3) * 9.81, rng.uniform(-1.0, 1.0, 3), rng.normal(size=3)
        w, alpha, velocity, acceleration = rng.normal(size=(4, 3)) * 3.0
        stewart, deck = on_deck(robot, gravity)
        context = stewart.plant.CreateDefaultContext()
        stewart.plant.SetPositionsAndVelocities(context, stewart.assemble(pose, rate))
        turn = RollPitchYaw(attitude).ToRotationMatrix()
        deck.SetPose(context, RigidTransform(turn, place))
        deck.set_angular_velocity(context, w)
        deck.set_translational_velocity(context, velocity)
        found, start = task_dynamics(stewart, context), deck.velocity_start()
        moved = np.zeros(stewart.plant.num_velocities())
        moved[start : start + 6] = np.concatenate([alpha, acceleration])
        bias = found.bias + found.basis.T @ stewart.plant.CalcMassMatrix(context) @ moved
        base = (np.array([acceleration - gravity, w, alpha]) @ turn.matrix()).ravel()
        expected = task_bias(robot, pose, pose_rate_to_twist(pose, rate), base)
        np.testing.assert_allclose(found.inertia, task_inertia(robot, pose), rtol=0.0, atol=1e-10)
        np.testing.assert_allclose(bias, expected, rtol=0.0, atol=1e-10 * np.abs(expected).max())


def test_the_unit_on_the_base_reads_what_its_motion_gives():
    motion = SineReference.from_dict({key: value for key, value in ROLLING.items() if key != "kind"})
    h, t, gravity = 1e-4, 0.7, (0.5, -1.0, -9.0)
    turns = [rotation_matrix(motion.evaluate(t + k * h)[0][:3]) for k in (-2, -1, 0, 1, 2)]
    places = [motion.evaluate(t + k * h)[0][3:] for k in (-1, 0, 1)]

    def rate(before, now, after):
        spin = now.T @ (after - before) / (2.0 * h)
        return np.array([spin[2, 1], spin[0, 2], spin[1, 0]])

    signal = base_signal(motion, gravity, np.array([t]))[0]
    force = turns[2].T @ ((places[0] - 2.0 * places[1] + places[2]) / h**2 - gravity)
    np.testing.assert_allclose(signal[:3], force, atol=1e-5)
    np.testing.assert_allclose(signal[3:6], rate(*turns[1:4]), atol=1e-6)
    np.testing.assert_allclose(signal[6:9], (rate(*turns[2:]) - rate(*turns[:3])) / (2.0 * h), atol=1e-5)
    np.testing.assert_allclose(signal[9:], motion.evaluate(t)[0][:3])


@pytest.mark.slow
def test_a_tilted_base_is_the_robot_that_drake_has_tilted():
    tilt = (0.4, -0.3, 0.2)
    case = Scenario.from_dict({**LOOP, "base": {"orientation": tilt}, "initial_offset": [0.02, 0, 0, 0, 0.002, 0]})
    builder, plant = DiagramBuilder(), MultibodyPlant(0.001)
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
    builder.AddSystem(plant)
    robot = add_robot(plant, case.robot, base=RigidTransform(RollPitchYaw(tilt), [0.1, 0.2, 0.3]))
    plant.Finalize()
    add_loop(builder, Scenario.from_dict({**LOOP, "initial_offset": case.initial_offset}), robot)
    diagram = builder.Build()
    simulator = Simulator(diagram)
    simulator.AdvanceTo(case.duration)
    mine = plant.GetMyContextFromRoot(simulator.get_context())
    last = robot.measure(plant.GetPositionsAndVelocities(mine))
    pose = run(case)["pose"]
    assert np.abs(pose[:, 0]).max() > 0.01
    np.testing.assert_allclose(pose[-1], last[:6], rtol=0.0, atol=1e-9)
    for kind in ("closed_form", "mujoco"):
        np.testing.assert_allclose(run(case.replace({"plant": kind}))["pose"], pose, rtol=0.0, atol=1e-7)
    level = run(case.replace({"base.orientation": (0.0, 0.0, 0.0), "model.orientation": tilt}))["pose"]
    assert np.abs(level - pose).max() > 1e-5


@pytest.mark.slow
def test_a_moving_base_is_the_same_on_all_engines_and_a_sensor_of_it_is_worth_its_reading():
    case = Scenario.from_dict({**LOOP, "base": {"motion": ROLLING, "sensor": {}, "orientation": (0.1, 0.0, 0.0)}})
    blind = [run(case.replace({"plant": kind})) for kind in ("drake", "closed_form", "mujoco")]
    for log in blind[1:]:
        np.testing.assert_allclose(log["pose"], blind[0]["pose"], rtol=0.0, atol=1e-7)
    errors = [np.abs(blind[1]["error"]).max()]
    for use in ("torques", "level"):
        logs = [run(case.replace({"plant": kind, "base_compensation": use})) for kind in ("drake", "closed_form")]
        np.testing.assert_allclose(logs[0]["pose"], logs[1]["pose"], rtol=0.0, atol=1e-6)  # Rods spin in Drake.
        errors.append(np.abs(logs[1]["error"]).max())
    assert errors[1] < 0.02 * errors[0]
    assert errors[2] < 0.1 * errors[0]
    world = [
        rotation_matrix(base) @ rotation_matrix(pose[:3])
        for base, pose in zip(logs[1]["base_motion"][:, 9:], logs[1]["pose"], strict=True)
    ]
    assert np.abs(np.array(world) - np.eye(3)).max() < 1e-4
