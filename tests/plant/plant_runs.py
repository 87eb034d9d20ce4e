"""Runs of the bare plant that the tests of this folder share."""

import numpy as np
from pydrake.systems.analysis import Simulator
from strategies import ROBOT

from stewart_drake import DrakeOptions, build_plant

_built = {}


def built(rod_joint="universal", robot=ROBOT, gravity=9.81, **options):
    """Diagram and plant; the same arguments share them, because a test may only change a Context of its own."""
    key = (rod_joint, id(robot), gravity, *sorted(options.items()))
    if key not in _built:
        _built[key] = build_plant(robot, DrakeOptions(rod_joint=rod_joint, **options), gravity)
    return _built[key]


class Run:
    """One simulation with torques that hold until they are set again."""

    def __init__(self, pose=None, rate=None, torque=(0.0,) * 6, robot=ROBOT, **plant):
        self.diagram, self.stewart = built(robot=robot, **plant)
        self.simulator = Simulator(self.diagram)
        self.context = self.simulator.get_mutable_context()
        self.stewart.set_state(self.context, robot.home_pose if pose is None else pose, rate)
        self.hold(torque)

    def hold(self, torque):
        self.diagram.GetInputPort("torque").FixValue(self.context, np.array(torque, dtype=float))
        return self

    def to(self, time):
        self.simulator.AdvanceTo(time)
        return self

    @property
    def state(self):
        return self.diagram.GetOutputPort("state").Eval(self.context)

    @property
    def angles(self):
        return self.state[self.stewart.indices.crank].copy()

    @property
    def rates(self):
        return self.state[self.stewart.indices.crank_rate]
