"""A scenario's loop around a plant of the user's; and what cannot be right there, which is one line."""

import re

import numpy as np
import pytest
from pydrake.geometry import Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    CoulombFriction,
    DiscreteContactApproximation,
    MultibodyPlant,
)
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput
from strategies import ROBOT

from stewart_drake import (
    ClosedFormPlant,
    DrakeOptions,
    LqiOptions,
    Scenario,
    add_loop,
    add_plant,
    add_robot,
    build_diagram,
)
from stewart_drake.base.errors import ConfigurationError, DrakeCheckError, RunFailure
from stewart_drake.base.sampling import on_grid
from stewart_drake.systems import LqiController, ReferenceSource, TaskSpaceSensor
from stewart_drake.systems.library import PlatformWrench

SPLIT = {"controller": {"solver": "split"}, "tuner": "fixed", "log_period": 0.001}
PUSH = {"disturbances": [{"kind": "constant", "wrench": [0.0, 0.0, 0.0, 1.0, 0.0, 0.0]}]}
STICKING = {"friction": {"coulomb": 0.02, "break_away": 0.03}}
REAL = {"sensors": "encoders", "estimator": "observer", "safety": {}, "plant": STICKING, **PUSH}


def scenario(**keys):
    return Scenario.from_dict({**SPLIT, **keys})


PLAIN, LONGER = scenario(), ROBOT.replace(crank_length=0.12)


@pytest.mark.parametrize("keys", [{"initial_offset": [0.02, 0, 0, 0, 0, 0]}, REAL])
def test_on_the_same_plant_it_is_the_loop_of_build_diagram_to_the_bit(keys):
    case = scenario(**keys)
    builder = DiagramBuilder()
    robot = add_plant(builder, case.robot, case.plant, case.gravity)
    # The plant's options and gravity count, not those of the scenario.
    added = add_loop(
        builder, case.replace({"gravity": 1.6, "plant": "closed_form"}), robot, outputs=["controller.gain"]
    )
    ports = {"plant_state": robot.state_output_port, **added.outputs}
    logs = {name: LogVectorOutput(port, builder, publish_period=0.001) for name, port in ports.items()}
    mine, theirs = Simulator(builder.Build()), Simulator(loop := build_diagram(case, outputs=["controller.gain"]))
    for simulator in (mine, theirs):
        simulator.AdvanceTo(0.02)
    assert set(logs) == set(loop.sinks)
    for name, sink in loop.sinks.items():
        expected = sink.FindLog(theirs.get_context()).data()
        got = logs[name].FindLog(mine.get_context()).data()[:, : expected.shape[1]]
        np.testing.assert_array_equal(got, expected)
    assert added.systems["controller"].state(mine.get_context())["gain"].shape == (1, 6, 18)


def test_two_loops_in_a_plant_with_a_ball_and_a_push_of_the_user():
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.001)
    aside = RigidTransform([1.0, 0.5, 0.2])
    options = DrakeOptions.from_dict(STICKING | {"collision": True})
    robots = [add_robot(plant, ROBOT, options), add_robot(plant, ROBOT, options, model_instance="second", base=aside)]
    ball = plant.AddRigidBody("ball", plant.AddModelInstance("ball"), SpatialInertia.SolidSphereWithMass(0.02, 0.01))
    plant.RegisterCollisionGeometry(ball, RigidTransform(), Sphere(0.01), "ball", CoulombFriction(0.8, 0.8))
    plant.Finalize()
    lifted = builder.AddSystem(PlatformWrench(robots[0]))
    weight = builder.AddSystem(ConstantVectorSource([0.0, 0.0, 0.0, 0.0, 0.0, 2.0]))
    builder.Connect(weight.get_output_port(), lifted.wrench)
    builder.Connect(lifted.spatial_force, plant.get_applied_spatial_force_input_port())
    first, second = (
        add_loop(builder, scenario(reference="hold", **PUSH), robot, inputs=["wrench"], name=name)
        for robot, name in zip(robots, ("first", "second"), strict=True)
    )
    builder.ExportInput(first.inputs["wrench"], "wrench")
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    diagram.GetInputPort("wrench").FixValue(context, [0.0, 0.0, 0.0, 0.0, 3.0, 0.0])
    mine = plant.GetMyMutableContextFromRoot(context)
    plant.SetFreeBodyPose(mine, ball, RigidTransform([0.0, 0.0, 0.32]))
    simulator.AdvanceTo(0.1)
    # Both pushes of the scenario and of the user act, each on its own robot; the ball does not fall through.
    state = plant.GetPositionsAndVelocities(mine)
    pushed, other = (robot.pose_and_rate(state)[0] for robot in robots)
    assert (pushed - other)[4:].min() > 1e-4
    assert np.abs(other[4]) < 1e-5 < 1e-4 < min(pushed[3], other[3])
    assert plant.EvalBodyPoseInWorld(mine, ball).translation()[2] == pytest.approx(pushed[5] + 0.014, abs=1e-3)
    assert second.systems["motors"].get_name() == "second_motors"
    assert max(robot.loop_gap(state).max() for robot in robots) < 1e-5
    # Poses are in the frame of the robot's base.
    world = plant.EvalBodyPoseInWorld(mine, plant.GetBodyByName("platform", robots[1].instance)).translation()
    np.testing.assert_allclose(world, other[3:] + [1.0, 0.5, 0.2], atol=1e-9)
    force = robots[1].push(np.array([0.0, 0.0, 0.0, 1.0, 2.0, 3.0])).F_Bq_W
    np.testing.assert_allclose(force.translational(), [1.0, 2.0, 3.0])


def test_a_robot_knows_the_decimal_step_of_a_plant_on_the_grid():
    for step in (0.0005, 0.0007):
        builder = DiagramBuilder()
        plant = builder.AddSystem(MultibodyPlant(on_grid(step)))
        robot = add_robot(plant, ROBOT)
        plant.Finalize()
        if step == 0.0005:
            assert add_loop(builder, PLAIN, robot).scenario.plant.time_step == step
        else:
            with pytest.raises(ConfigurationError, match=r"whole multiple of the plant's time step 0\.0007 s"):
                add_loop(builder, PLAIN, robot)


def built(**names):
    builder = DiagramBuilder()
    robot = add_plant(builder, ROBOT, DrakeOptions(**names))
    return builder, robot, builder.Build()


def added(plant=None, **names):
    return add_robot(MultibodyPlant(0.001) if plant is None else plant, ROBOT, **names)


def finalised():
    plant = MultibodyPlant(0.001)
    plant.Finalize()
    return plant


def finish(robot):
    robot.plant.Finalize()


def sticking():
    robot = added(options=DrakeOptions(motor_friction=0.02))
    robot.plant.Finalize()
    return robot


def tamsi():
    plant = MultibodyPlant(0.001)
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kTamsi)
    return plant


def twice():
    plant = MultibodyPlant(0.001)
    added(plant)
    added(plant)


def around(robot=ROBOT, case=PLAIN, again=None, **options):
    builder = DiagramBuilder()
    inside = add_plant(builder, robot, DrakeOptions(**options))
    add_loop(builder, case, inside)
    if again is not None:
        add_loop(builder, case, inside if again else add_plant(builder, ROBOT, name="other"))


def fixed(port, value):
    loop = build_diagram(PLAIN, inputs=[port])
    simulator = Simulator(loop)
    loop.GetInputPort(port).FixValue(simulator.get_mutable_context(), value)
    simulator.AdvanceTo(0.01)


def continuous_from_nothing():
    simulator = Simulator(plant := ClosedFormPlant(ROBOT))
    plant.torque.FixValue(simulator.get_mutable_context(), np.zeros(6))
    simulator.get_mutable_context().SetContinuousState(np.full(12, np.nan))
    simulator.AdvanceTo(0.01)


def foreign():
    return build_diagram(PLAIN).CreateDefaultContext()


def put(number, where=Diagram.CreateDefaultContext):
    _, robot, diagram = built()
    robot.put(where(diagram), np.zeros(number))


def slide():
    """Motors that would stick, without what feeds them."""
    builder = DiagramBuilder()
    plant = builder.AddSystem(MultibodyPlant(0.001))
    add_robot(plant, ROBOT, DrakeOptions(motor_friction=0.02))
    plant.Finalize()
    Simulator(builder.Build()).Initialize()


def loop_in(builder, robot, _):
    add_loop(builder, PLAIN, robot)


OTHER, NOWHERE = finalised(), RigidTransform([np.nan, 0.0, 0.0])
CONFIGURATION = (
    ("a plant without our model", lambda: TaskSpaceSensor(finalised()), "robot: expected a StewartRobot, got .*Plant"),
    ("a loop around it", lambda: add_loop(DiagramBuilder(), PLAIN, finalised()), "robot: .*; add_robot and add_plant"),
    ("another kind", lambda: TaskSpaceSensor(ClosedFormPlant(ROBOT)), "robot: expected a StewartRobot, got"),
    ("another parser", lambda: added(parser=Parser(OTHER)), "parser: expected a parser of this plant"),
    ("finalised too early", lambda: added(finalised()), "plant: expected one before Finalize"),
    ("not finalised", lambda: TaskSpaceSensor(added()), "plant: expected one that is finalised, .*; call plant.Final"),
    ("nor for a loop", lambda: add_loop(DiagramBuilder(), PLAIN, added()), "plant: expected one that is finalised"),
    ("a continuous one", lambda: added(MultibodyPlant(0.0)), "plant: expected a discrete one"),
    ("a port too early", lambda: added().torque_input_port, "plant: expected one that is finalised"),
    ("indices too early", lambda: added().indices, "plant: expected one that is finalised"),
    ("a pose too early", lambda: added().assemble(ROBOT.home_pose), "plant: expected one that is finalised"),
    ("two of one name", twice, "model_instance: expected a name that .* got 'stewart'"),
    ("another robot", lambda: around(LONGER), "scenario.robot: expected the robot of the plant, got 'another crank_le"),
    ("a step beyond the tick", lambda: around(time_step=0.01), "controller.period: .* multiple of the plant's time st"),
    ("two loops for a robot", lambda: around(again=True), "robot: .* torques are connected already"),
    ("two loops of a name", lambda: around(again=False), "name: expected another .* sensor already"),
    ("a pose of too few", lambda: built()[1].pose_and_rate(np.zeros(3)), "state: expected .* 49.* got .*shape"),
    ("cranks of too few", lambda: built()[1].crank_state(np.zeros(3)), "state: expected .* 49.* got .*shape"),
    ("gaps of too many", lambda: built()[1].loop_gap(np.zeros(50)), "state: expected .* 49.* got .*shape"),
    ("a state of too few", lambda: put(3), "state: expected .* 49.* got .*shape"),
    ("a builder for a plant", lambda: added(DiagramBuilder()), "plant: expected a MultibodyPlant, got <.*Builder"),
    ("a number for a name", lambda: added(model_instance=3), "model_instance: expected a str, got 3"),
    ("a matrix for a place", lambda: added(base=np.eye(4)), "base: expected a RigidTransform, got array"),
    ("a place that is none", lambda: added(base=NOWHERE), "base: expected a place that is finite"),
    ("a name for a scenario", lambda: build_diagram("paper_fig7"), "scenario: expected a Scenario, .*; load_scenario"),
    ("a name for names", lambda: build_diagram(PLAIN, inputs="wrench"), "inputs: expected a Sequence, got 'wrench'"),
    ("a flag for a Meshcat", lambda: build_diagram(PLAIN, meshcat=True), "meshcat: expected a Meshcat, got True"),
    ("a simulator for a Context", lambda: put(49, Simulator), "context: expected a Context, got <.*Simulator"),
    ("a controller of nothing", lambda: LqiController(ROBOT, None, 9.81), "options: expected a LqiOptions, got None"),
    ("gravity that is none", lambda: LqiController(ROBOT, LqiOptions(), np.nan), "gravity: expected a number"),
    ("a motion of nothing", lambda: ReferenceSource(None), "reference: expected a Reference, got None"),
    ("a continuous one of nothing", lambda: ClosedFormPlant(None), "robot: expected a RobotParameters, got None"),
    ("friction left alone", slide, "friction: expected a call of connect_friction"),
    ("a push of too few", lambda: built()[1].push(np.zeros(3)), "wrench: expected moment .* six finite numbers"),
    ("a push that is none", lambda: built()[1].push(np.full(6, np.nan)), "wrench: expected moment .* six finite numb"),
)
DRAKE = (
    ("finalised by what opens it", lambda: add_plant(DiagramBuilder(), ROBOT, before_finalize=finish), "building the"),
    ("a name that is none", lambda: added(model_instance="a::b"), "adding the robot: .*delimiter '::'"),
    ("TAMSI", lambda: added(tamsi()), "adding the robot: .*TAMSI does not support ball constraints"),
    ("a builder that has built", lambda: add_plant(built()[0], ROBOT, name="other"), "building the plant: .*already"),
    ("a loop in it", lambda: loop_in(*built()), "wiring the loop: .*already been called"),
    ("friction in it", lambda: sticking().connect_friction(built()[0]), "connecting the friction: .*already been call"),
    ("another builder", lambda: loop_in(DiagramBuilder(), *built()[1:]), "wiring the loop: .*has not been registered"),
    ("set_state elsewhere", lambda: built()[1].set_state(foreign(), ROBOT.home_pose), "setting .*the Context of a sys"),
    ("rows elsewhere", lambda: build_diagram(PLAIN, sparse=True).rows(foreign()), "reading .*the Context of a system"),
    ("a state elsewhere", lambda: build_diagram(PLAIN).systems["controller"].state(foreign()), "the .*Context of a sy"),
    ("a continuous one", lambda: ClosedFormPlant(ROBOT).set_state(foreign(), ROBOT.home_pose), "setting .*Context of"),
)
NUMBERS = (
    ("a wrench that is none", lambda: fixed("wrench", np.full(6, np.inf)), "wrench is not finite"),
    ("weights that are none", lambda: fixed("weights", [np.nan, 1.0]), "weights is not finite"),
    ("a state that is none", continuous_from_nothing, "the plant's pose is not finite"),
    ("weights below 0", lambda: fixed("weights", [-1.0, 1.0]), "no gain for weights .*: .* positive and finite"),
    ("a motion that is none", lambda: fixed("reference", np.full(18, np.nan)), "reference is not finite"),
)
SIZES = (("a port of another size", lambda: fixed("wrench", [1.0, 2.0]), "System.*size=6 for input port 'wrench'"),)
KINDS = ((ConfigurationError, CONFIGURATION), (DrakeCheckError, DRAKE), (RunFailure, NUMBERS), (RuntimeError, SIZES))
BAD = [pytest.param(do, error, line, id=name) for error, table in KINDS for name, do, line in table]


@pytest.mark.parametrize(("do", "error", "line"), BAD)
def test_what_cannot_be_right_is_one_line(do, error, line):
    with pytest.raises(error) as caught:
        do()
    assert re.match(line, str(caught.value))
    assert "\n" not in str(caught.value)
