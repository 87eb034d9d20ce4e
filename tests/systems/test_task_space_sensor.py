import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.math import RollPitchYaw
from pydrake.systems.framework import DiagramBuilder
from strategies import ROBOT, poses, vectors

from stewart_drake.plant.multibody_plant import add_plant
from stewart_drake.plant.plant_options import PlantOptions
from stewart_drake.systems.task_space_sensor import TaskSpaceSensor


def build(rod_joint):
    builder = DiagramBuilder()
    plant = add_plant(builder, ROBOT, PlantOptions(rod_joint=rod_joint))
    sensor = builder.AddSystem(TaskSpaceSensor(plant))
    builder.Connect(plant.state_output_port, sensor.plant_state)
    builder.ExportInput(plant.torque_input_port, "torque")
    builder.ExportOutput(sensor.measurement, "measurement")
    return builder.Build(), plant, sensor


LOOPS = {kind: build(kind) for kind in ("universal", "ball")}


@settings(max_examples=30)
@given(poses(), vectors(6), st.sampled_from(sorted(LOOPS)))
def test_it_reports_what_drake_says_of_the_platform_and_what_the_robot_was_put_to(pose, rate, rod_joint):
    diagram, plant, _ = LOOPS[rod_joint]
    context = diagram.CreateDefaultContext()
    plant.set_state(context, pose, rate)
    measured = diagram.GetOutputPort("measurement").Eval(context)
    np.testing.assert_allclose(measured, np.concatenate([pose, rate]), atol=1e-12)
    plant_context = plant.plant.GetMyContextFromRoot(context)
    body = plant.plant.GetBodyByName("platform")
    rpy = RollPitchYaw(body.EvalPoseInWorld(plant_context).rotation())
    velocity = body.EvalSpatialVelocityInWorld(plant_context)
    rates = rpy.CalcRpyDtFromAngularVelocityInParent(velocity.rotational())
    np.testing.assert_allclose(measured[:3], rpy.vector(), atol=1e-12)
    np.testing.assert_allclose(measured[6:9], np.ravel(rates), atol=1e-11)
    np.testing.assert_allclose(measured[9:], velocity.translational(), atol=1e-12)
    state = plant.plant.GetPositionsAndVelocities(plant_context)
    np.testing.assert_array_equal(measured, np.concatenate(plant.pose_and_rate(state)))
