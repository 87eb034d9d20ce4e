"""The robot on a table in a plant of yours, with a ball that rolls on its platform; `--meshcat` shows it in a browser.

Our LQI is wired in by hand. Prints the tracking error, and where on the platform the ball is.
"""

import sys

import numpy as np
from pydrake.geometry import Box, MeshcatVisualizer, Sphere, StartMeshcat
from pydrake.math import RigidTransform
from pydrake.multibody.meshcat import ContactVisualizer
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput

from stewart_drake import DrakeOptions, LqiOptions, RobotParameters, SineReference, add_robot
from stewart_drake.systems import LqiController, ReferenceSource, TaskSpaceSensor, TrackingError

DURATION = 2.0  # [s]
TABLE, BASE = 0.4, 0.12  # [m] height of the table, and of the frame `base` above it; the motors are 0.07 lower
RADIUS, MASS = 0.01, 0.02  # [m] and [kg] of the ball


def main() -> None:
    """Builds, runs, prints."""
    parameters, options = RobotParameters(), LqiOptions(period=0.005, feedforward="platform", solver="split")
    wave = {"amplitude": (0.05, 0.0, 0.0, 0.0, 0.0, 0.01), "angular_frequency": (6.0,) * 6}
    # From the top of the wave: the ball goes there and back.
    reference = SineReference(**wave, phase=(np.pi / 2,) * 6)
    meshcat = StartMeshcat() if "--meshcat" in sys.argv else None

    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.001)
    on_table = RigidTransform([0.0, 0.0, TABLE + BASE])
    robot = add_robot(plant, parameters, DrakeOptions(collision=True), base=on_table)
    rubber = CoulombFriction(0.8, 0.8)
    inertia = SpatialInertia.SolidSphereWithMass(MASS, RADIUS)
    ball = plant.AddRigidBody("ball", plant.AddModelInstance("ball"), inertia)
    top = RigidTransform([0.0, 0.0, TABLE - 0.01])
    for body, place, shape, name, color in (
        (plant.world_body(), top, Box(0.8, 0.8, 0.02), "table", [0.6, 0.4, 0.3, 1.0]),
        (ball, RigidTransform(), Sphere(RADIUS), "ball", [0.9, 0.2, 0.1, 1.0]),
    ):
        plant.RegisterVisualGeometry(body, place, shape, name, color)
        plant.RegisterCollisionGeometry(body, place, shape, name, rubber)
    plant.Finalize()
    if meshcat is not None:
        MeshcatVisualizer.AddToBuilder(builder, scene_graph, meshcat)
        ContactVisualizer.AddToBuilder(builder, plant, meshcat)

    sensor = builder.AddNamedSystem("sensor", TaskSpaceSensor(robot))
    source = builder.AddNamedSystem("reference", ReferenceSource(reference))
    weights = builder.AddNamedSystem("weights", ConstantVectorSource([10.0, 0.1]))  # omega_Q, omega_R
    error = builder.AddNamedSystem("tracking_error", TrackingError(options.period))
    controller = builder.AddNamedSystem("controller", LqiController(parameters, options, 9.81))
    builder.Connect(robot.state_output_port, sensor.plant_state)
    for system in (error, controller):
        builder.Connect(sensor.measurement, system.measurement)
        builder.Connect(source.reference, system.reference)
    builder.Connect(weights.get_output_port(), controller.weights)
    builder.Connect(controller.torque, robot.torque_input_port)
    errors = LogVectorOutput(error.error, builder, publish_period=options.period)
    diagram = builder.Build()

    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    pose, rate, _ = reference.evaluate(0.0)
    robot.set_state(context, pose, rate)
    mine = plant.GetMyMutableContextFromRoot(context)
    platform = plant.GetBodyByName("platform", robot.instance)
    seat = plant.EvalBodyPoseInWorld(mine, platform) @ RigidTransform([0.0, 0.0, 0.03])
    plant.SetFreeBodyPose(mine, ball, seat)
    if meshcat is not None:
        meshcat.StartRecording()
        simulator.set_target_realtime_rate(1.0)
    simulator.AdvanceTo(DURATION)

    rms = np.sqrt(np.mean(errors.FindLog(context).data() ** 2, axis=1))
    print(f"RMSE: roll pitch yaw {np.degrees(rms[:3]).round(4)} deg, X Y Z {(1e3 * rms[3:]).round(4)} mm")
    place = plant.CalcRelativeTransform(mine, robot.frame("platform"), ball.body_frame()).translation()
    print(f"ball on the platform: X Y Z {(1e3 * place).round(2)} mm")
    print(f"largest loop gap: {robot.loop_gap(plant.GetPositionsAndVelocities(mine)).max():.1e} m")
    if meshcat is not None:
        meshcat.PublishRecording()
        input("Enter ends it. ")


if __name__ == "__main__":
    main()
