"""Two robots in one plant of yours; the second carries a load that its controller does not know.

`--meshcat` shows them in a browser. Prints the tracking errors.
"""

import sys

import numpy as np
from pydrake.geometry import MeshcatVisualizer, Sphere, StartMeshcat
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput

from stewart_drake import LqiOptions, RobotParameters, add_robot, paper_reference
from stewart_drake.systems import LqiController, ReferenceSource, TaskSpaceSensor, TrackingError

DURATION = 2.0  # [s]
LOAD, RADIUS = 0.3, 0.03  # [kg], [m]


def main() -> None:
    """Builds, runs, prints."""
    parameters, options, reference = RobotParameters(), LqiOptions(period=0.005, solver="split"), paper_reference()
    meshcat = StartMeshcat() if "--meshcat" in sys.argv else None

    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.001)
    aside = RigidTransform(RollPitchYaw(0.0, 0.0, np.pi / 2), [0.8, 0.0, 0.0])
    robots = {
        "first": add_robot(plant, parameters, model_instance="first"),
        "second": add_robot(plant, parameters, model_instance="second", base=aside),
    }
    loaded, at = robots["second"], RigidTransform([0.0, 0.0, RADIUS])
    inertia = SpatialInertia.SolidSphereWithMass(LOAD, RADIUS)
    load = plant.AddRigidBody("load", loaded.instance, inertia)
    plant.WeldFrames(loaded.frame("platform"), load.body_frame(), at)
    plant.RegisterVisualGeometry(load, RigidTransform(), Sphere(RADIUS), "load", [0.9, 0.2, 0.1, 1.0])
    plant.Finalize()
    if meshcat is not None:
        MeshcatVisualizer.AddToBuilder(builder, scene_graph, meshcat)

    source = builder.AddNamedSystem("reference", ReferenceSource(reference))
    weights = builder.AddNamedSystem("weights", ConstantVectorSource([10.0, 0.1]))  # omega_Q, omega_R
    logs = {}
    for name, robot in robots.items():
        sensor = builder.AddNamedSystem(f"{name}_sensor", TaskSpaceSensor(robot))
        error = builder.AddNamedSystem(f"{name}_error", TrackingError(options.period))
        controller = builder.AddNamedSystem(f"{name}_controller", LqiController(parameters, options, 9.81))
        builder.Connect(robot.state_output_port, sensor.plant_state)
        for system in (error, controller):
            builder.Connect(sensor.measurement, system.measurement)
            builder.Connect(source.reference, system.reference)
        builder.Connect(weights.get_output_port(), controller.weights)
        builder.Connect(controller.torque, robot.torque_input_port)
        logs[name] = LogVectorOutput(error.error, builder, publish_period=options.period)
    diagram = builder.Build()

    # Where a Context begins: no `set_state` is needed.
    for robot in robots.values():
        robot.set_default_state(*reference.evaluate(0.0)[:2])
    simulator = Simulator(diagram)
    if meshcat is not None:
        meshcat.StartRecording()
        simulator.set_target_realtime_rate(1.0)
    simulator.AdvanceTo(DURATION)

    for name, log in logs.items():
        rms = np.sqrt(np.mean(log.FindLog(simulator.get_context()).data() ** 2, axis=1))
        print(f"{name}: RMSE roll pitch yaw {np.degrees(rms[:3]).round(4)} deg, X Y Z {(1e3 * rms[3:]).round(4)} mm")
    if meshcat is not None:
        meshcat.PublishRecording()
        input("Enter ends it. ")


if __name__ == "__main__":
    main()
