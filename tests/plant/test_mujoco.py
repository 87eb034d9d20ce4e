"""Drake's plant against another engine, MuJoCo, built from the same parameters.

Drake's SAP and MuJoCo's Euler step are both of first order, with the same error but for second order: 8e-6 m each from
the exact motion of the reference after 0.15 s at steps of 5e-5 s, 5e-10 m from each other.
"""

import json
from pathlib import Path

import numpy as np
import pytest
from mujoco_robot import MujocoRobot
from plant_runs import Run
from strategies import ROBOT

from stewart_drake import DrakeOptions, load_robot
from stewart_drake.mechanics.dynamics import static_torque

FREE_MOTION = json.loads((Path(__file__).parents[1] / "data" / "reference_values.json").read_text())["free_motion"]
DURATION, STEP = 0.15, 5e-5
_BOLD = np.array([0.15, -0.1, 0.2, 0.02, -0.015, 0.31])
HEAD = load_robot("reachy_mini")
_TILTED = HEAD.home_pose + [0.1, -0.08, 0.12, 0.002, -0.003, 0.004]
MOTIONS = {
    # 25 mm down and 15 deg of yaw.
    "reference": (ROBOT, np.array(FREE_MOTION["pose"]), np.array(FREE_MOTION["torque"])),
    # 33 mm up, while it turns by 50 deg.
    "bold": (ROBOT, _BOLD, static_torque(ROBOT, _BOLD) + [0.25, -0.1, 0.2, 0.1, -0.15, 0.3]),
    # Rotors behind gears, the mass far above the joints, legs of either branch.
    "reachy_mini": (HEAD, _TILTED, static_torque(HEAD, _TILTED) + [0.05, -0.02, 0.04, 0.02, -0.03, 0.06]),
}


def platforms(robot, pose, torque, time_step):
    # Where Drake and MuJoCo have the platform after DURATION: X, Y, Z and the quaternion.
    run = Run(pose, torque=torque, robot=robot, time_step=time_step).to(DURATION)
    stewart, state = run.stewart, run.state
    quaternion = state[stewart.indices.quaternion]
    engine = MujocoRobot(robot, options=DrakeOptions(time_step=time_step))
    engine.set_state(stewart, stewart.assemble(pose))
    engine.advance(torque, round(DURATION / time_step))
    # Drake lets the length of its quaternion grow, by parts in a million here.
    return np.concatenate([state[stewart.indices.position], quaternion / np.linalg.norm(quaternion)]), engine.platform


@pytest.mark.slow
@pytest.mark.parametrize("motion", MOTIONS)
def test_drake_and_euler_of_mujoco_differ_at_second_order_only(motion):
    robot, pose, torque = MOTIONS[motion]
    weight = np.array([1.0] * 3 + [2.0 * robot.platform_radius] * 4)
    drake, coarse = (platforms(robot, pose, torque, step) for step in (STEP, 2.0 * STEP))
    apart = [np.abs(weight * (one - other)).max() for one, other in (drake, coarse)]
    assert apart[1] / apart[0] == pytest.approx(4.0, rel=0.1)
    assert apart[0] < 0.02 * np.abs(weight * (coarse[0] - drake[0])).max()
    # What the project promises; 5e-10 m of the reference, 98e-9 m of the bold one.
    assert np.abs((drake[0] - drake[1])[:3]).max() < 1e-7
