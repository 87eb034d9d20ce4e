"""A controller of one's own for `kind: python`: any LeafSystem with these three ports will do."""

import numpy as np
from pydrake.systems.framework import LeafSystem

from stewart_drake.mechanics.dynamics import static_torque_of_legs, task_inertia
from stewart_drake.mechanics.kinematics import leg_geometry, pose_rate_to_twist, rod_lines


class TaskSpacePd(LeafSystem):
    """Spring and damper between platform and reference, and the torque that holds the robot against gravity.

    `robot` and `gravity` are handed over because the constructor names them; the rest comes from `arguments`.

    Ports: measurement (12,), reference (18,); torque (6,) [N m].
    """

    def __init__(self, robot, gravity, natural_frequency=93.8, damping=0.785):
        super().__init__()
        self._robot, self._gravity = robot, gravity
        inertia = np.diag(task_inertia(robot, robot.home_pose))
        self._stiffness = inertia * natural_frequency**2
        self._damping = inertia * 2.0 * damping * natural_frequency
        self._measurement = self.DeclareVectorInputPort("measurement", 12)
        self._reference = self.DeclareVectorInputPort("reference", 18)
        self.DeclareVectorOutputPort("torque", 6, self._torque)

    def _torque(self, context, output):
        measured, wanted = self._measurement.Eval(context), self._reference.Eval(context)
        pose, rate = measured[:6], measured[6:]
        # Small rotations: errors of roll, pitch and yaw count as a rotation vector.
        error = pose_rate_to_twist(pose, pose - wanted[:6])
        error_rate = pose_rate_to_twist(pose, rate - wanted[6:12])
        wrench = -self._stiffness * error - self._damping * error_rate
        legs = leg_geometry(self._robot, pose)
        # Forces along the rods that make this wrench, each with its crank's lever.
        forces = np.linalg.solve(rod_lines(legs).T, wrench)
        by_springs = self._robot.crank_lengths * legs.transmission * forces
        output.SetFromVector(by_springs + static_torque_of_legs(self._robot, legs, self._gravity))
