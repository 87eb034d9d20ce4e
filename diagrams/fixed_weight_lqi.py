"""LQI with fixed weights, wired by hand: plant, sensor, reference, controller. Prints the error on (37), (38)."""

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput

from stewart_drake import LqiOptions, RobotParameters, add_plant, paper_reference
from stewart_drake.systems import LqiController, ReferenceSource, TaskSpaceSensor, TrackingError

DURATION = 10.0  # [s]
GRAVITY = 9.81  # [m/s^2]


def main() -> None:
    """Builds, runs, prints."""
    parameters, reference = RobotParameters(), paper_reference()
    options = LqiOptions(period=0.005, feedforward="platform")

    builder = DiagramBuilder()
    robot = add_plant(builder, parameters, gravity=GRAVITY)
    sensor = builder.AddNamedSystem("sensor", TaskSpaceSensor(robot))
    source = builder.AddNamedSystem("reference", ReferenceSource(reference))
    weights = builder.AddNamedSystem("weights", ConstantVectorSource([10.0, 0.1]))  # omega_Q, omega_R
    error = builder.AddNamedSystem("tracking_error", TrackingError(options.period))
    controller = builder.AddNamedSystem("controller", LqiController(parameters, options, GRAVITY))
    builder.Connect(robot.state_output_port, sensor.plant_state)
    for system in (error, controller):
        builder.Connect(sensor.measurement, system.measurement)
        builder.Connect(source.reference, system.reference)
    builder.Connect(weights.get_output_port(), controller.weights)
    builder.Connect(controller.torque, robot.torque_input_port)
    errors = LogVectorOutput(error.error, builder, publish_period=controller.period)
    diagram = builder.Build()

    simulator = Simulator(diagram)
    pose, rate, _ = reference.evaluate(0.0)
    robot.set_state(simulator.get_mutable_context(), pose, rate)
    simulator.AdvanceTo(DURATION)

    log = errors.FindLog(simulator.get_context())
    rms = np.sqrt(np.mean(log.data()[:, log.sample_times() >= DURATION / 2] ** 2, axis=1))
    print(f"RMSE, second half: roll pitch yaw {np.degrees(rms[:3]).round(4)} deg, X Y Z {(1e3 * rms[3:]).round(4)} mm")


if __name__ == "__main__":
    main()
