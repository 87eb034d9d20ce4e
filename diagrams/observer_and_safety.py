"""A realistic robot, wired by hand: encoders, observer, LQI, friction compensation, safety layer.

The parts are those of a scenario, which has their numbers. Prints the tracking error and what the safety layer did.
"""

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

from stewart_drake import add_plant, load_scenario
from stewart_drake.systems import PlatformObserver, ReferenceSource, SafetyLayer, ScenarioSystem, TaskSpaceSensor

DURATION = 4.0  # [s]
CHANGES = ("tuner=block", "command_delay=0", "safety={}")


def main() -> None:
    """Builds, runs, prints."""
    scenario = load_scenario("exact_breathing", CHANGES)

    builder = DiagramBuilder()
    robot = add_plant(builder, scenario.robot, scenario.plant, scenario.gravity)
    sensor = builder.AddNamedSystem("sensor", TaskSpaceSensor(robot))
    source = builder.AddNamedSystem("reference", ReferenceSource(scenario.reference))
    observer = builder.AddNamedSystem("observer", PlatformObserver(scenario))
    safety = builder.AddNamedSystem("safety", SafetyLayer(scenario))
    names = ("encoders", "controller", "friction_compensation", "command", "net_torque")
    encoders, controller, friction, command, net_torque = (
        builder.AddNamedSystem(name, ScenarioSystem(scenario, name)) for name in names
    )
    # A port left alone has what the scenario has there: weights, the age of a command, a disturbance that is expected.
    for output, inputs in (
        (robot.state_output_port, (sensor.plant_state,)),
        (sensor.crank_state, (encoders.crank_state,)),
        (source.reference, (observer.reference, controller.reference, friction.reference, safety.reference)),
        (encoders.reading, (observer.reading, safety.angles)),
        (observer.predicted, (controller.measurement,)),  # Where the robot will be once the command acts.
        (observer.measurement, (safety.measurement,)),
        (observer.disturbance_torque, (command.disturbance_torque,)),
        (observer.health, (safety.sensor_health,)),
        (controller.torque, (command.control_torque,)),
        (controller.health, (safety.controller_health,)),
        (friction.friction_torque, (command.friction_torque, net_torque.friction_torque)),
        (command.torque, (safety.command, net_torque.torque)),
        (net_torque.net_torque, (observer.net_torque,)),
        (safety.torque, (robot.torque_input_port,)),
    ):
        for port in inputs:
            builder.Connect(output, port)
    poses = LogVectorOutput(sensor.measurement, builder, publish_period=controller.period)
    references = LogVectorOutput(source.reference, builder, publish_period=controller.period)
    actions = LogVectorOutput(safety.safety, builder, publish_period=controller.period)
    diagram = builder.Build()
    robot.set_default_state(*scenario.start())

    simulator = Simulator(diagram)
    simulator.AdvanceTo(DURATION)

    pose, reference, action = (log.FindLog(simulator.get_context()).data() for log in (poses, references, actions))
    rms = np.sqrt(np.mean((pose[:6] - reference[:6]) ** 2, axis=1))
    print(f"RMSE: roll pitch yaw {np.degrees(rms[:3]).round(4)} deg, X Y Z {(1e3 * rms[3:]).round(4)} mm")
    print(f"highest level of the safety layer: {action[0].max():.1f}")


if __name__ == "__main__":
    main()
