"""Draws docs/images/robot.png, the README's picture of the robot: `make pictures`."""

from pathlib import Path

import numpy as np

from stewart_drake import RobotParameters
from stewart_drake.runs.pictures import render_png

picture = Path(__file__).parents[1] / "images" / "robot.png"
render_png(RobotParameters(), np.array([np.radians(20), 0, 0, 0, 0, 0.33]), picture, passes=32)
