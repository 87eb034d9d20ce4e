"""The keys of a base that hangs, tilts or moves, in belief and truth; and what is wrong with them, in one line."""

import math

import numpy as np
import pytest

from stewart_drake import Controller, RobotParameters, Scenario, load_scenario, run
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.export.fmu import robot_unit
from stewart_drake.mechanics.dynamics import static_torque
from stewart_drake.runs.checks import check_scenario

SINE = {"kind": "sine", "center": [0] * 6, "amplitude": [0.1, 0, 0, 0, 0, 0], "angular_frequency": 1}
HEADER = "time_s,roll_rad,pitch_rad,yaw_rad,x_m,y_m,z_m\n"


def rows(start):
    return "".join(f"{start + 0.5 * k},{0.01 * k},0,0,0,0,0\n" for k in range(8))


def test_gravity_is_turned_by_the_base_and_a_model_may_believe_another():
    case = Scenario.from_dict({"base": {"orientation": [math.pi, 0, 0]}})
    np.testing.assert_allclose(case.gravity_in_base, [0.0, 0.0, 9.81], atol=1e-12)
    assert case.controller_model.gravity == case.gravity_in_base
    assert case.control().controller_model.gravity == case.gravity_in_base
    level = case.replace({"model.orientation": [0, 0, 0]})
    assert (level.gravity_in_base, level.controller_model.gravity) == (case.gravity_in_base, 9.81)
    believed = case.replace({"base.orientation": [0, 0, 0], "model.gravity": [0, 1, -9]})
    assert (believed.gravity_in_base, believed.controller_model.gravity) == (9.81, (0.0, 1.0, -9.0))
    robot = case.robot
    for same in (-9.81, (0.0, 0.0, 9.81)):
        np.testing.assert_array_equal(
            static_torque(robot, robot.home_pose, same), -static_torque(robot, robot.home_pose)
        )


@pytest.mark.parametrize(
    ("keys", "line"),
    [
        ({"gravity": [1, 2]}, r"gravity: expected a number, along -z, or three numbers .*, got \(1, 2\)"),
        ({"gravity": "down"}, r"gravity: expected a number.*got 'down'"),
        ({"gravity": [0, 0, math.nan]}, r"gravity: expected a number.*nan"),
        ({"model": {"gravity": [1, 2, 3, 4]}}, r"model\.gravity: expected a number"),
        (
            {"base": {"orientation": [0, 30, 0]}},
            r"base\.orientation: expected roll, pitch, yaw \[rad\].*not in degrees",
        ),
        ({"base": {"orientation": [5, 0, 0]}}, r"base\.orientation: expected roll, pitch, yaw \[rad\].* half a turn"),
        ({"base": {"orientation": [0, 0]}}, r"base\.orientation: expected roll, pitch, yaw"),
        ({"base": {"sensor": {}}}, r"base\.sensor: expected null, for a base at rest"),
        ({"base": {"motion": SINE, "sensor": {"noise": 1}}}, r"base\.sensor"),
        ({"base": {"motion": {**SINE, "kind": "wave"}}}, r"base\.motion"),
        ({"base_compensation": "level"}, r"base_compensation: expected none, without base\.sensor"),
    ],
)
def test_wrong_keys_are_one_line(keys, line):
    with pytest.raises(ConfigurationError, match=line) as raised:
        Scenario.from_dict(keys)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (HEADER + rows(3.0), "expected a recording whose first time is 0.*begins at 3 s"),
        (rows(0.0), "header"),
        (None, "deck.csv"),
    ],
)
def test_a_wrong_recording_is_one_line_before_the_run(text, line, tmp_path):
    if text is not None:
        (tmp_path / "deck.csv").write_text(text)
    motion = {"kind": "recorded", "motion_file": str(tmp_path / "deck.csv")}
    case = Scenario.from_dict({"base": {"motion": motion}, "duration": 1.0})
    with pytest.raises(ConfigurationError, match=line):
        check_scenario(case)


def test_a_motion_in_degrees_is_one_line_before_the_run():
    case = Scenario.from_dict({"base": {"motion": {**SINE, "amplitude": [30, 0, 0, 0, 0, 0]}}})
    with pytest.raises(ConfigurationError, match=r"base\.motion: expected roll and pitch \[rad\].*in degrees\?"):
        check_scenario(case)


def test_what_needs_a_base_at_rest_refuses_one_that_moves():
    moving = load_scenario("rolling_deck", ["plant.kind=closed_form"])
    for use, line in (
        (lambda: Controller(moving), "base_compensation: expected none, for a controller without a simulation"),
        (lambda: robot_unit(moving, "deck"), "base.motion: expected null, for the FMU of a robot"),
        (lambda: moving.replace({"plant": "math:sin"}, trust_code=True), "base.motion: expected null, for plant.kind"),
    ):
        with pytest.raises(ConfigurationError, match=line):
            use()


@pytest.mark.slow
def test_a_robot_hangs_with_its_home_below_the_base():
    # Case: `robots from-table ... --set home_height=-0.08`, then a run.
    turn = np.radians([-20, 20, 100, 140, 220, 260])
    joint = np.radians([-40, 40, 80, 160, 200, 280])
    around = [np.stack([r * np.cos(a), r * np.sin(a), 0 * a], axis=1) for r, a in ((0.08, turn), (0.06, joint))]
    masses = {"platform_mass": 0.3, "rod_mass": 0.01, "crank_mass": 0.01, "rotor_inertia": 1e-4, "effort_limit": 2.0}
    lengths = {"crank_length": 0.02, "rod_length": 0.09, "home_height": -0.08}
    robot = RobotParameters.from_table(np.hstack(around), unit="m", cranks="towards", **lengths, **masses)
    pose = robot.home_pose
    assert pose[5] == -0.08
    for kind in ("drake", "closed_form", "mujoco"):
        log = run(load_scenario("sway").replace({"robot": robot, "plant": kind, "duration": 0.2}))
        assert log.status == "completed"
        assert np.abs(log["error"]).max() < 1e-4
