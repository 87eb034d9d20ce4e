import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from strategies import ROBOT

from stewart_drake.plant.sdf_model import home_frames, sdf_text
from stewart_drake.robot import RobotParameters

FOLDER = Path(__file__).parents[2] / "sdf"
NUMBER = re.compile(r"(?<![\w.])-?\d+\.\d+(?:e-?\d+)?")


def test_file_in_the_repository_is_the_generated_one():
    on_disk, generated = (FOLDER / "stewart.sdf").read_text(), sdf_text(ROBOT)
    # Sines of another machine's library may differ in the last bits: words must agree exactly, numbers to 1e-14.
    assert NUMBER.sub("#", on_disk) == NUMBER.sub("#", generated)
    numbers = [list(map(float, NUMBER.findall(text))) for text in (on_disk, generated)]
    np.testing.assert_allclose(*numbers, rtol=0.0, atol=1e-14)


def test_python_of_the_readme_runs(monkeypatch):
    monkeypatch.chdir(FOLDER.parent)
    (code,) = re.findall(r"```python\n(.*?)```", (FOLDER / "README.md").read_text(), flags=re.DOTALL)
    names = {}
    exec(code, names)
    assert names["plant"].num_positions() == 25


@pytest.mark.parametrize("turns", [-2, 0, 1])
def test_stops_hold_home_whatever_the_turn_that_their_angles_are_of(turns):
    # An angle within the range stays within it where it leaves (-pi, pi].
    given = np.array([2.0, 8.0]) - 2.0 * np.pi
    robot = RobotParameters(branch=1, legs=[{"crank_angle_range": tuple(given + 2.0 * np.pi * turns)}] * 6)
    frames = home_frames(robot)
    np.testing.assert_allclose(np.diff(frames.stops), 6.0)
    assert (frames.stops[:, 0] < 0.0).all()
    assert (frames.stops[:, 1] > 0.0).all()
    theta = given[0] + np.linspace(0.01, 5.99, 7)[:, None] + np.zeros(6)
    motor = frames.motor_angles(np.arctan2(np.sin(theta), np.cos(theta)))
    np.testing.assert_allclose(motor, theta - given[0] + frames.stops[:, 0], atol=1e-14)
    model = ET.fromstring(sdf_text(robot)).find("model")
    limits = [model.find(f"joint[@name='motor_{leg}']/axis/limit") for leg in range(6)]
    written = [[float(limit.findtext(end)) for end in ("lower", "upper")] for limit in limits]
    np.testing.assert_array_equal(written, frames.stops)
