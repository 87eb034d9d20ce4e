"""LQI by Drake alone: its linearisation of the robot, its regulator, its primitives. Prints the error beside ours.

The gain is that of `LqiController` with the exact model at that pose, which finds a new one at every tick.
"""

from collections.abc import Sequence

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.controllers import DiscreteTimeLinearQuadraticRegulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import AffineSystem, ConstantVectorSource, Linearize, ZeroOrderHold
from scipy.signal import cont2discrete

from stewart_drake import ClosedFormPlant, HoldReference, LqiOptions, RobotParameters
from stewart_drake.mechanics.dynamics import static_torque
from stewart_drake.systems import LqiController, ReferenceSource

ROBOT = RobotParameters()
POSE = np.array([0.1, -0.05, 0.1, 0.01, -0.02, 0.31])  # [rad, m] to be held.
START = POSE + [0.02, 0.03, -0.02, 0.004, 0.003, -0.005]
OPTIONS = LqiOptions(model="exact", period=0.005)
WEIGHTS = np.array([10.0, 0.1])  # omega_Q, omega_R
GRAVITY = 9.81  # [m/s^2]
TIMES = (0.0, 0.1, 0.5, 1.0, 2.0, 5.0)  # [s]


def lqi_gain() -> np.ndarray:
    """K (6, 18) of u = -K [e; e'; z]."""
    # Gravity is compensated, so that the regulator is designed for a robot without.
    plant = ClosedFormPlant(ROBOT, gravity=0.0)
    context = plant.CreateDefaultContext()
    plant.set_state(context, POSE)
    plant.torque.FixValue(context, np.zeros(6))
    robot = Linearize(plant, context, plant.torque.get_index(), plant.measurement.get_index())
    a, b = np.zeros((18, 18)), np.zeros((18, 6))
    a[:12, :12], b[:12], a[12:, :6] = robot.A(), robot.B(), np.eye(6)  # z' = e
    a, b, *_ = cont2discrete((a, b, np.eye(18), np.zeros((18, 6))), OPTIONS.period)  # Torques are held.
    gain, _ = DiscreteTimeLinearQuadraticRegulator(a, b, WEIGHTS[0] * np.eye(18), WEIGHTS[1] * np.eye(6))
    return np.asarray(gain)


def regulated_by_drake(builder: DiagramBuilder, plant: ClosedFormPlant, gain: np.ndarray) -> None:
    """Wires Drake's primitives: z+ = z + T e, and gravity's torque less K [e; e'; z], held between ticks."""
    period, pose_of = OPTIONS.period, np.eye(6, 12)
    regulator = AffineSystem(
        A=np.eye(6),
        B=period * pose_of,
        f0=-period * POSE,
        C=-gain[:, 12:],
        D=-gain[:, :12],
        y0=static_torque(ROBOT, POSE) + gain[:, :6] @ POSE,
        time_period=period,
    )
    builder.AddNamedSystem("regulator", regulator)
    hold = builder.AddNamedSystem("hold", ZeroOrderHold(period, 6))
    builder.Connect(plant.measurement, regulator.get_input_port())
    builder.Connect(regulator.get_output_port(), hold.get_input_port())
    builder.Connect(hold.get_output_port(), plant.torque)


def regulated_by_us(builder: DiagramBuilder, plant: ClosedFormPlant) -> None:
    """Wires our controller, which finds gain and gravity's torque at every tick."""
    controller = builder.AddNamedSystem("controller", LqiController(ROBOT, OPTIONS, GRAVITY))
    reference = builder.AddNamedSystem("reference", ReferenceSource(HoldReference(pose=POSE)))
    weights = builder.AddNamedSystem("weights", ConstantVectorSource(WEIGHTS))
    builder.Connect(plant.measurement, controller.measurement)
    builder.Connect(reference.reference, controller.reference)
    builder.Connect(weights.get_output_port(), controller.weights)
    builder.Connect(controller.torque, plant.torque)


def off(gain: np.ndarray | None, times: Sequence[float] = TIMES) -> np.ndarray:
    """How far the platform is off [mm] at times [s], by Drake's primitives with a gain, or by our controller."""
    builder = DiagramBuilder()
    plant = builder.AddNamedSystem("plant", ClosedFormPlant(ROBOT, gravity=GRAVITY))
    if gain is None:
        regulated_by_us(builder, plant)
    else:
        regulated_by_drake(builder, plant, gain)
    simulator = Simulator(builder.Build())
    context = plant.GetMyContextFromRoot(simulator.get_context())
    plant.set_state(simulator.get_mutable_context(), START)
    result = []
    for time in times:
        simulator.AdvanceTo(time)
        result.append(1e3 * np.linalg.norm(plant.measurement.Eval(context)[3:6] - POSE[3:]))
    return np.array(result)


def main() -> None:
    """Designs, runs, prints."""
    gain = lqi_gain()
    print(f"gain of roll, by Drake: {gain[:, 0].round(3)} N m/rad")
    for time, by_drake, by_us in zip(TIMES, off(gain), off(None), strict=True):
        print(f"t = {time:.1f} s   off by {by_drake:.3f} mm by Drake alone, {by_us:.3f} mm by LqiController")


if __name__ == "__main__":
    main()
