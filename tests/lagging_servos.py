"""A machine in the same process, for tests of drives: Reachy Mini's servos, whose angles follow commands with a lag."""

import numpy as np

from stewart_drake import inverse_kinematics, load_robot
from stewart_drake.machines.machine import Reading

ROBOT = load_robot("reachy_mini")
HOME = inverse_kinematics(ROBOT, ROBOT.home_pose)


class Servos:
    """Paced by its readings, at 50 Hz; `event(machine)` is called before reading number `at`."""

    period, takes, reads, paced = 0.02, "angle", True, True

    def __init__(self, angles=HOME, at=None, event=None):
        self.angles, self.count, self.commands, self.gone = np.array(angles), 0, [], False
        self.at, self.event, self.age, self.holding = at, event, 0.0, False

    def connect(self):
        pass

    def read(self):
        self.count += 1
        if self.count == self.at:
            self.event(self)
        return Reading(self.angles.copy(), 0.02 * self.count, self.age, self.count, holding=self.holding)

    def command(self, values):
        self.commands.append(values.copy())
        self.angles += 0.6 * (values - self.angles)

    def disconnect(self):
        self.gone = True
