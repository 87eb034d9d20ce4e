"""What a part is made for, for tests of a part by itself."""

import numpy as np
from strategies import ROBOT

from stewart_drake.loop.part import LoopContext
from stewart_drake.scenario.control_side import context_of
from stewart_drake.scenario.scenario import Scenario


def setup_for(robot=ROBOT, **changes) -> LoopContext:
    """Of a scenario of defaults, but at rest at home; fields by name."""
    at_home = {"gravity": 9.81, "period": 0.001, "pose": robot.home_pose, "pose_rate": np.zeros(6)}
    return context_of(Scenario(robot=robot))._replace(**(at_home | changes))
