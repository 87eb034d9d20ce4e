"""A user's controller: anything that is called with measurement, setpoint and time will do."""

import numpy as np

from stewart_drake.mechanics.dynamics import static_torque, task_inertia
from stewart_drake.mechanics.kinematics import leg_geometry, pose_rate_to_twist, rod_lines


class TaskSpacePd:
    """Spring and damper between platform and reference, and the torque that holds the robot against gravity.

    `robot` and `gravity` are handed over because the constructor names them; the rest comes from `arguments`.
    """

    def __init__(self, robot, gravity, natural_frequency=93.8, damping=0.785):
        self.robot, self.gravity = robot, gravity
        inertia = np.diag(task_inertia(robot, robot.home_pose))
        self.stiffness = inertia * natural_frequency**2
        self.damping = inertia * 2.0 * damping * natural_frequency

    def __call__(self, measurement, setpoint, time):  # noqa: ARG002 - it does not depend on the time
        """Torques (6,) [N m]."""
        pose = measurement.pose
        # Small rotations: errors of roll, pitch and yaw count as a rotation vector.
        error = pose_rate_to_twist(pose, pose - setpoint.pose)
        error_rate = pose_rate_to_twist(pose, measurement.pose_rate - setpoint.pose_rate)
        wrench = -self.stiffness * error - self.damping * error_rate
        legs = leg_geometry(self.robot, pose)
        # Forces along the rods that make this wrench, each with its crank's lever.
        forces = np.linalg.solve(rod_lines(legs).T, wrench)
        by_springs = self.robot.crank_lengths * legs.transmission * forces
        return by_springs + static_torque(self.robot, pose, self.gravity)
