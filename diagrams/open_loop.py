"""The plant alone under constant motor torques. Prints where the platform goes and how well the loops stay closed."""

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput

from stewart_drake import RobotParameters, add_plant

DURATION = 0.15  # [s]


def main() -> None:
    """Builds, runs, prints."""
    builder = DiagramBuilder()
    robot = add_plant(builder, RobotParameters())
    torque = builder.AddNamedSystem("torque", ConstantVectorSource([0.2, 0.3, 0.25, 0.3, 0.2, 0.3]))  # [N m]
    builder.Connect(torque.get_output_port(), robot.torque_input_port)
    sink = LogVectorOutput(robot.state_output_port, builder, publish_period=0.01)
    diagram = builder.Build()

    simulator = Simulator(diagram)
    robot.set_state(simulator.get_mutable_context(), np.array([0.1, -0.05, 0.1, 0.01, -0.02, 0.31]))
    simulator.AdvanceTo(DURATION)

    log = sink.FindLog(simulator.get_context())
    pose, _ = robot.pose_and_rate(log.data().T)
    for time, row in zip(log.sample_times(), pose, strict=True):
        angles, position = np.degrees(row[:3]).round(3), (1e3 * row[3:]).round(3)
        print(f"t = {time:.2f} s   roll pitch yaw {angles} deg   X Y Z {position} mm")
    print(f"largest loop gap: {robot.loop_gap(log.data().T).max():.1e} m")


if __name__ == "__main__":
    main()
