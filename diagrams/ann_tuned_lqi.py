"""The diagram of Fig. 6, wired by hand: LQI whose weights a neural network tunes online from density features."""

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

from stewart_drake import LqiOptions, RobotParameters, add_plant, load_network, paper_reference
from stewart_drake.systems import (
    AnnTuner,
    DensityFeatures,
    LqiController,
    ReferenceSource,
    TaskSpaceSensor,
    TrackingError,
)

DURATION = 4.0  # [s]
GRAVITY = 9.81  # [m/s^2]


def main() -> None:
    """Builds, runs, prints."""
    parameters, reference = RobotParameters(), paper_reference()
    options = LqiOptions(period=0.005, feedforward="gravity")
    network = load_network()

    builder = DiagramBuilder()
    robot = add_plant(builder, parameters, gravity=GRAVITY)
    sensor = builder.AddNamedSystem("sensor", TaskSpaceSensor(robot))
    source = builder.AddNamedSystem("reference", ReferenceSource(reference))
    error = builder.AddNamedSystem("tracking_error", TrackingError(options.period))
    controller = builder.AddNamedSystem("controller", LqiController(parameters, options, GRAVITY))
    density = builder.AddNamedSystem("density", DensityFeatures(network.window, options.period, network.density))
    tuner = builder.AddNamedSystem("tuner", AnnTuner(network, options.period))
    builder.Connect(robot.state_output_port, sensor.plant_state)
    for system in (error, controller):
        builder.Connect(sensor.measurement, system.measurement)
        builder.Connect(source.reference, system.reference)
    builder.Connect(controller.torque, robot.torque_input_port)
    builder.Connect(error.error, density.error)
    builder.Connect(controller.torque, density.torque)
    builder.Connect(density.density, tuner.density)
    builder.Connect(tuner.weights, controller.weights)
    errors = LogVectorOutput(error.error, builder, publish_period=controller.period)
    weights = LogVectorOutput(tuner.weights, builder, publish_period=controller.period)
    diagram = builder.Build()

    simulator = Simulator(diagram)
    pose, rate, _ = reference.evaluate(0.0)
    robot.set_state(simulator.get_mutable_context(), pose, rate)
    simulator.AdvanceTo(DURATION)

    context = simulator.get_context()
    log = errors.FindLog(context)
    rms = np.sqrt(np.mean(log.data()[:, log.sample_times() >= DURATION / 2] ** 2, axis=1))
    omega = weights.FindLog(context).data()
    print(f"RMSE, second half: roll pitch yaw {np.degrees(rms[:3]).round(4)} deg, X Y Z {(1e3 * rms[3:]).round(4)} mm")
    print(f"omega_Q {omega[0].min():.3f} to {omega[0].max():.3f}, omega_R {omega[1].min():.3f} to {omega[1].max():.3f}")


if __name__ == "__main__":
    main()
