"""`Reach` and the command `reach`."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import reach_study
from random_robots import random_robot
from scipy.optimize import minimize

from stewart_drake import ConfigurationError, Reach, ReferenceLimits, inverse_kinematics, load_robot
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.mechanics.kinematics import rotation_angle, rotation_matrix
from stewart_drake.scenario.limits import limit_margins

ROBOTS = {name: load_robot(name) for name in reach_study.ROBOTS} | {"random": random_robot(3)}
REACHES = {name: Reach(robot) for name, robot in ROBOTS.items()}
MINI = REACHES["reachy_mini"]
HOME = MINI.robot.home_pose


def targets(reach, count, seed=0):
    box = np.repeat([1.0, reach.robot.characteristic_length], 3)
    return reach.robot.home_pose + np.random.default_rng(seed).uniform(-1.0, 1.0, (count, 6)) * box


@pytest.mark.parametrize("name", ROBOTS)
def test_results_are_within_all_limits_and_are_their_own_nearest(name):
    reach = REACHES[name]
    results = [reach.nearest(target) for target in targets(reach, 500)]
    poses = np.array([found.pose for found in results])
    assert reach_study.within(reach, poses).all()
    assert all(reach.check(pose).possible and reach.nearest(pose).distance == 0.0 for pose in poses[:50])
    assert not any(
        reach.check(target).possible
        for target, found in zip(targets(reach, 500), results, strict=True)
        if found.distance > 0.0
    )


@pytest.mark.parametrize("name", reach_study.ROBOTS)
def test_another_search_finds_nothing_that_is_much_nearer(name):
    reach = REACHES[name]

    def margins(pose):
        motion = np.stack([reach.robot.home_pose, pose])
        still = np.zeros_like(motion)
        found = limit_margins(reach.robot, reach.limits, motion, still, still, STANDARD_GRAVITY).values()
        return np.nan_to_num(np.concatenate([values[1] for values in found]), nan=-1.0, neginf=-1.0)

    for target in targets(reach, 6, seed=1):
        found = reach.nearest(target)
        for start in (found.pose, reach.robot.home_pose):
            result = minimize(
                lambda pose, at=target: float(reach_study.distances(reach, pose[None], at)[0]) / reach.weight,
                start,
                method="SLSQP",
                constraints={"type": "ineq", "fun": margins},
                options={"maxiter": 40},
            )
            if margins(result.x).min() >= -1e-6:
                assert found.distance <= 1.02 * result.fun * reach.weight + 1e-5


def test_distances_are_those_of_the_metric():
    target = HOME + [0.3, -0.2, 1.6, 0.01, 0.0, 0.02]
    for weight in (0.01, 0.2):
        found = Reach(MINI.robot, weight=weight).nearest(target)
        turn = rotation_matrix(target[:3]) @ rotation_matrix(found.pose[:3]).T
        assert found.turn == pytest.approx(rotation_angle(turn), abs=1e-9)
        assert found.shift == pytest.approx(np.linalg.norm(target[3:] - found.pose[3:]))
        assert found.distance == pytest.approx(np.hypot(found.shift, weight * found.turn))
    # The heavier turns are, the less the result is turned.
    assert found.turn < Reach(MINI.robot, weight=0.01).nearest(target).turn


def test_half_a_turn_away_and_whole_turns_more():
    assert MINI.nearest(HOME + [2.0 * np.pi, 0, -2.0 * np.pi, 0, 0, 0]).distance == 0.0
    for axis in np.eye(3):
        found = MINI.nearest(HOME + np.concatenate([np.pi * axis, np.zeros(3)]))
        assert 0.5 < found.turn <= np.pi
        assert MINI.check(found.pose).possible


def test_a_pose_on_the_other_side_of_a_singularity_is_refused():
    reach = REACHES["paper"]
    poses = targets(reach, 30_000) + np.random.default_rng(1).uniform(-2.0, 2.0, (30_000, 6)) * [1, 1, 1, 0, 0, 0]
    without = ReferenceLimits(joint_swing=None, clearance=None, torque_fraction=None, transmission=None)
    there = reach_study.within(Reach(reach.robot, without), poses)
    still = np.zeros((1, 6))
    # Alone, a pose is on its own side: its margins do not tell.
    alone = [limit_margins(reach.robot, without, p[None], still, still, STANDARD_GRAVITY) for p in poses[~there][:4000]]
    other = [all((v >= 0.0).all() for v in margins.values()) for margins in alone]
    (pose, *_) = poses[~there][:4000][other]
    answer = Reach(reach.robot, without).check(pose)
    assert (answer.possible, answer.margin.limit) == (False, "conditioning")


def test_in_a_time_no_crank_turns_further_than_its_speed_allows():
    start = MINI.nearest(HOME + [0.1, 0.0, 0.3, 0.0, 0.0, 0.0]).pose
    before = inverse_kinematics(MINI.robot, start)
    target, distances = HOME + [-0.2, 0.1, -0.6, 0.0, 0.0, 0.005], []
    for time in (0.01, 0.03, 1.0):
        found = MINI.nearest(target, start, time)
        distances.append(found.distance)
        way = np.abs(inverse_kinematics(MINI.robot, found.pose) - before).max()
        assert way <= MINI.limits.crank_speed * time
        assert time == 1.0 or way > 0.99 * MINI.limits.crank_speed * time
    assert distances == sorted(distances, reverse=True)
    assert distances[-1] == MINI.nearest(target).distance


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: MINI.nearest([0, 0, np.nan, 0, 0, 0]), "pose: expected six finite numbers"),
        (lambda: MINI.check([0, 0, 0.2]), "pose: expected six finite numbers"),
        (lambda: MINI.check("home"), "pose: expected six finite numbers"),
        (lambda: MINI.check([0, 0, 0, 0, 0, 177e3]), "in millimetres?"),
        (lambda: MINI.nearest(HOME, HOME + [0, 0, 0, 0, 0, 1.0]), "from_pose: expected a pose within the limits"),
        (lambda: MINI.nearest(HOME, time=0.0), "time: expected a number of seconds above 0, got 0"),
        (lambda: Reach(MINI.robot, weight=-1.0), "weight: expected a number above 0"),
        (lambda: Reach(MINI.robot, weight=np.nan), "weight: expected a number above 0"),
        (lambda: Reach(MINI.robot, ReferenceLimits(conditioning=0.9)), "limits that the robot keeps at home"),
    ],
)
def test_bad_input_is_one_line(call, text):
    with pytest.raises(ConfigurationError) as caught:
        call()
    assert text in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_command_gives_answer_reason_and_the_nearest_pose(call, tmp_path):
    status, out, _ = call("reach", "reachy_mini", "--pose", "yaw=70,z=190", "--json")
    answer = json.loads(out)
    found = MINI.nearest([0.0, 0.0, np.radians(70.0), 0.0, 0.0, 0.19])
    assert (status, answer["possible"], answer["limit"]) == (0, False, "crank_range")
    assert answer["distance_m"] == pytest.approx(found.distance, rel=1e-6)
    assert "stops" in answer["reason"]
    (tmp_path / "poses.csv").write_text("x_mm,y_mm,z_mm,roll_deg,pitch_deg,yaw_deg\n0,0,177,0,0,0\n0,0,190,0,0,70\n")
    status, out, _ = call("reach", "reachy_mini", "poses.csv", "--out", "nearest.csv")
    assert (status, "1 of 2 poses can be taken" in out) == (0, True)
    rows = np.genfromtxt(tmp_path / "nearest.csv", delimiter=",", names=True)
    assert rows["possible"].tolist() == [1.0, 0.0]
    assert rows["distance_m"][1] == pytest.approx(found.distance, rel=1e-6)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["nobody", "--pose", "z=1"], "ROBOT_OR_SCENARIO: expected a robot (paper, reachy_mini, servo_hexapod)"),
        (["reachy_mini", "--pose", "up=3"], "--pose: expected pairs such as yaw=70,z=190"),
        (["reachy_mini", "--pose", "yaw=nan"], "--pose yaw: expected a finite number"),
        (["reachy_mini", "--pose", "yaw=3mm"], "--pose yaw: expected"),
        (["reachy_mini", "--pose", "yaw=3", "--weight", "-1mm"], "weight: expected a number above 0"),
        (["reachy_mini", "--pose", "yaw=3,yaw=4"], "--pose: expected yaw once"),
        (["reachy_mini", "--pose", "z=0.19"], "--pose z: expected a height of 1 mm or more, got '0.19 mm'; 0.19m for"),
        (["reachy_mini", "--pose", "yaw=1e9"], "--pose: expected angles below 1000 rad, got"),
        (["reachy_mini", "--pose", "yaw=3", "--in", "0"], "--in: expected a number of seconds above 0"),
        (["reachy_mini"], "give either --pose, or POSES.csv and --out"),
    ],
)
def test_bad_arguments_of_the_command_are_one_line(call, arguments, text):
    status, _, err = call("reach", *arguments)
    assert (status, err.count("\n"), text in err) == (2, 1, True)


def test_the_nearest_pose_that_is_printed_can_be_taken(call):
    for asked in ("yaw=70,z=190", "roll=50,x=40", "pitch=-60"):
        out = call("reach", "reachy_mini", "--pose", asked)[1]
        numbers = re.search(r"nearest \[deg, mm\]\D+?([-\d.]+(?: +[-\d.]+){5}) ", out)[1].split()
        pairs = zip(("roll", "pitch", "yaw", "x", "y", "z"), numbers, strict=True)
        again = ",".join(f"{axis}={number}" for axis, number in pairs if number not in ("0", "-0"))
        assert json.loads(call("reach", "reachy_mini", "--pose", again, "--json")[1])["possible"], again


def test_a_controllers_file_a_weight_in_mm_and_a_time_that_decides(call):
    pose = ["--pose", "yaw=60", "--from-pose", "yaw=20", "--in", "0.02", "--json"]
    answer = json.loads(call("reach", "reachy_servos", *pose)[1])
    assert (answer["possible"], answer["limit"]) == (False, None)
    assert "with 1 rad as 60 mm" in call("reach", "reachy_servos", "--pose", "yaw=60", "--weight", "60")[1]


def test_the_page_holds(call, capsys):
    page = (Path(reach_study.__file__).parents[1] / "reach.md").read_text()
    names = {}
    for code in re.findall(r"```python\n(.*?)```", page, re.DOTALL):
        exec(compile(code, "reach.md", "exec"), names)
    names["sender"].close()
    assert MINI.check(names["sent"]).possible
    assert MINI.check(names["soon"].pose).possible
    capsys.readouterr()
    status, out, _ = call("reach", "reachy_mini", "--pose", "yaw=70,z=190", "--json")
    answer = json.loads(out)
    yaw, height = np.degrees(answer["nearest_pose"][2]), 1e3 * answer["nearest_pose"][5]
    assert (status, f"{yaw:.1f} deg at a height of {height:.1f} mm" in page) == (0, True)
    assert re.search(r"not -(0\.106)", answer["reason"])
    assert "0.106 rad beyond a stop of leg 0" in page


@pytest.mark.long
@pytest.mark.parametrize("name", [*reach_study.ROBOTS, reach_study.STRANGE])
def test_against_a_dense_search(name):
    robot = ROBOTS.get(name) or reach_study.strange_robot()
    row, broken = reach_study.study(name, robot, 25_000, 40_000)
    assert broken == 0
    missed, too_far, much_too_far = map(float, row[3:6])
    assert (missed, too_far < 2.0, much_too_far < 0.5) == (0.0, True, True)
