import json
import math
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plant_runs import Run, built
from pydrake.math import RigidTransform, RollPitchYaw
from scipy.optimize import brentq
from strategies import ROBOT, poses, vectors

from stewart_drake import ConfigurationError, DrakeOptions, inverse_kinematics, load_scenario, run
from stewart_drake.base.errors import SingularPoseError, UnreachablePoseError
from stewart_drake.mechanics.kinematics import pose_jacobian, pose_rate_to_twist, reach_margin
from stewart_drake.plant.model_files import sdf_text
from stewart_drake.plant.plant_options import platform_damping_limit

FREE_MOTION = json.loads((Path(__file__).parents[1] / "data" / "reference_values.json").read_text())["free_motion"]
HOME = ROBOT.home_pose

universal_or_ball = pytest.mark.parametrize("rod_joint", ["universal", "ball"])


@pytest.mark.parametrize(("time", "step"), [(0.0, 0), (0.0201, 21), (0.02, 20)])
def test_a_rod_breaks_at_the_first_step_that_begins_later(time, step):
    assert DrakeOptions(time_step=0.001, broken_rod={"leg": 1, "time": time}).break_step == step
    assert DrakeOptions().break_step is None


def in_drake(stewart, state):
    """The plant's own Context at a state."""
    context = stewart.plant.CreateDefaultContext()
    stewart.plant.SetPositionsAndVelocities(context, state)
    return context


def gap_vectors(stewart, context):
    """(6, 3) [m] rod end minus platform joint, by Drake."""
    plant, robot = stewart.plant, stewart.robot
    world, platform = plant.world_frame(), plant.GetFrameByName("platform")
    seats = plant.CalcPointsPositions(context, platform, robot.platform_joints.T, world).T
    tip = np.array([0.0, 0.0, robot.rod_length])
    rods = [plant.GetFrameByName(f"rod_{leg}") for leg in range(6)]
    return np.array([plant.CalcPointsPositions(context, rod, tip, world)[:, 0] for rod in rods]) - seats


@universal_or_ball
@settings(max_examples=25, deadline=None)
@given(pose=poses(), rate=vectors(6, 3.0))
def test_assembled_state_is_closed_and_moves_without_opening(rod_joint, pose, rate):
    _, stewart = built(rod_joint)
    state = stewart.assemble(pose, rate)
    context = in_drake(stewart, state)
    assert np.abs(gap_vectors(stewart, context)).max() < 1e-12
    # A short step along its rates opens the loops at second order only.
    plant, moved, step = stewart.plant, state.copy(), 1e-7
    moved[: plant.num_positions()] += step * plant.MapVelocityToQDot(context, state[plant.num_positions() :])
    assert np.abs(gap_vectors(stewart, in_drake(stewart, moved))).max() < 1e-3 * step
    body_pose = stewart.plant.EvalBodyPoseInWorld(context, stewart.plant.GetBodyByName("platform"))
    expected = RigidTransform(RollPitchYaw(pose[:3]), pose[3:])
    assert body_pose.IsNearlyEqualTo(expected, 1e-14)
    twist = stewart.plant.EvalBodySpatialVelocityInWorld(context, stewart.plant.GetBodyByName("platform"))
    np.testing.assert_allclose(twist.get_coeffs(), pose_rate_to_twist(pose, rate), atol=1e-13)
    if rod_joint == "ball":
        for rod in (stewart.plant.GetBodyByName(f"rod_{leg}") for leg in range(6)):
            along = stewart.plant.EvalBodyPoseInWorld(context, rod).rotation().matrix()[:, 2]
            assert abs(stewart.plant.EvalBodySpatialVelocityInWorld(context, rod).rotational() @ along) < 1e-12


@universal_or_ball
@settings(max_examples=25, deadline=None)
@given(pose=poses(), rate=vectors(6, 3.0))
def test_state_gives_back_pose_rate_and_crank_angles(rod_joint, pose, rate):
    _, stewart = built(rod_joint)
    state = stewart.assemble(pose, rate)
    state[stewart.indices.quaternion] *= 1.001  # what a long simulation does to it
    back, back_rate = stewart.pose_and_rate(state)
    np.testing.assert_allclose(back, pose, atol=1e-14)
    np.testing.assert_allclose(back_rate, rate, atol=1e-13)
    np.testing.assert_allclose(stewart.crank_angles(state), inverse_kinematics(ROBOT, pose), atol=1e-14)
    np.testing.assert_allclose(state[stewart.indices.crank_rate], pose_jacobian(ROBOT, pose) @ rate, atol=1e-10)


@universal_or_ball
@settings(max_examples=25, deadline=None)
@given(data=st.data())
def test_loop_gap_is_drakes_even_where_loops_are_open(rod_joint, data):
    _, stewart = built(rod_joint)
    state = stewart.assemble(HOME)
    state += data.draw(vectors(state.size, 0.2))
    expected = np.linalg.norm(gap_vectors(stewart, in_drake(stewart, state)), axis=-1)
    np.testing.assert_allclose(stewart.loop_gap(state), expected, atol=1e-14)


def test_what_cannot_be_assembled_is_refused():
    diagram, stewart = built()
    edge = brentq(lambda z: reach_margin(ROBOT, np.array([0.0, 0.0, 0.0, 0.0, 0.0, z])).min(), 0.3, 0.6, xtol=1e-15)
    for height, kind in ((edge - 1e-14, SingularPoseError), (0.6, UnreachablePoseError)):
        with pytest.raises(kind):
            stewart.assemble(np.array([0.0, 0.0, 0.0, 0.0, 0.0, height]))
    with pytest.raises(ConfigurationError, match="pose"):
        stewart.set_state(diagram.CreateDefaultContext(), np.full(6, np.nan))
    limit = platform_damping_limit(ROBOT, DrakeOptions())
    with pytest.raises(ConfigurationError, match=r"plant\.platform_joint_damping: expected at most"):
        built(platform_joint_damping=1.01 * limit)


@pytest.mark.slow
@universal_or_ball
def test_free_motion_of_the_reference_converges_at_first_order(rod_joint):
    errors, turns = [], []
    for time_step in (1e-3, 1e-4):
        run = Run(FREE_MOTION["pose"], torque=FREE_MOTION["torque"], rod_joint=rod_joint, time_step=time_step)
        state = run.to(FREE_MOTION["time"]).state
        errors.append(np.linalg.norm(state[run.stewart.indices.position] - FREE_MOTION["position"]))
        turns.append(np.abs(state[run.stewart.indices.quaternion] - FREE_MOTION["quaternion_wxyz"]).max())
        assert run.stewart.loop_gap(state).max() < 5.0 * time_step**2
    assert errors[0] < 2e-4
    assert errors[1] < 2e-5
    assert 8.0 < errors[0] / errors[1] < 12.0
    assert 8.0 < turns[0] / turns[1] < 12.0


def test_a_crank_comes_to_rest_at_its_stop():
    robot = ROBOT.replace(legs=[{"crank_angle_range": (0.3, 0.5)}] * 6)
    run = Run(robot=robot, torque=(2.0,) * 6)
    run.to(0.5)
    theta = run.stewart.crank_angles(run.state)
    np.testing.assert_allclose(theta, 0.5, atol=5e-3)


FOLDER = Path(__file__).parents[2] / "sdf"
NUMBER = re.compile(r"(?<![\w.])-?\d+\.\d+(?:e-?\d+)?")


def test_file_in_the_repository_is_the_generated_one():
    on_disk, generated = (FOLDER / "stewart.sdf").read_text(), sdf_text(ROBOT)
    # Sines of another machine's library may differ in the last bits: words must agree exactly, numbers to 1e-14.
    assert NUMBER.sub("#", on_disk) == NUMBER.sub("#", generated)
    numbers = [list(map(float, NUMBER.findall(text))) for text in (on_disk, generated)]
    np.testing.assert_allclose(*numbers, rtol=0.0, atol=1e-14)


def test_nothing_touches_where_the_paper_s_motion_swings_a_joint_beyond_its_limit():
    free, colliding = (
        run(load_scenario("paper_fig7", ["duration=0.8", *keys])) for keys in ((), ["plant.collision=true"])
    )
    assert "beyond_limits" in {each["name"] for each in free.warnings}
    np.testing.assert_allclose(colliding["pose"], free["pose"], rtol=0.0, atol=1e-12)


def test_the_file_has_the_stops_of_the_universal_joints_and_a_run_has_none():
    text = sdf_text(ROBOT)
    ends = (ET.fromstring(text).iterfind(f".//limit/{end}") for end in ("lower", "upper"))
    stops = [[float(stop.text) for stop in each] for each in ends]
    np.testing.assert_allclose(stops, [[-math.radians(65.0)] * 12, [math.radians(65.0)] * 12])
    # Of a universal joint Drake would pass over them; a later one might not.
    assert "<lower>" not in sdf_text(ROBOT, joint_swing=None)
    joint = built()[1].plant.GetJointByName("universal_2")
    assert not np.isfinite([joint.position_lower_limits(), joint.position_upper_limits()]).any()


def test_python_of_the_readme_runs(monkeypatch):
    monkeypatch.chdir(FOLDER.parent)
    (code,) = re.findall(r"```python\n(.*?)```", (FOLDER / "README.md").read_text(), flags=re.DOTALL)
    names = {}
    exec(code, names)
    assert names["plant"].num_positions() == 25
