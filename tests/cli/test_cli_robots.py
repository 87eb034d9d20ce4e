"""The commands `robots`, `write-sdf`, `write-mjcf`, `calibrate`, `identify` and `excite`."""

import csv
import re
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
from simulated_calibration import aligned, change_to, deviating, measured
from strategies import ROBOT

from stewart_drake.estimation.poses import MeasurementNoise, load_measurements
from stewart_drake.estimation.torques import COULOMB, values_of
from stewart_drake.mechanics.friction import FrictionOptions
from stewart_drake.robot.robot_files import load_robot, save_robot
from stewart_drake.scenario.scenario import load_scenario

sys.path.insert(0, str(Path(__file__).parents[1] / "estimation"))
from recordings import motion, recording, truth_of

DOCS = Path(__file__).parents[2] / "docs"


def test_robots_are_listed_and_the_numbers_of_one_have_units(call):
    status, out, _ = call("robots")
    assert status == 0
    assert all(word in out for word in ("paper", "reachy_mini", "servo_hexapod", "Pollen Robotics"))
    status, out, _ = call("robots", "show", "reachy_mini")
    assert status == 0
    for text in ("rotor_inertia", "kg m^2", "0.0018", "-48.0 to 80.0", "conditioning of the rods' lines"):
        assert text in out


def test_a_robot_from_a_table_is_kept_and_comes_back(call, tmp_path):
    (tmp_path / "points.csv").write_text((DOCS / "your_robot.csv").read_text())
    arguments = ["from-table", "points.csv", "--unit", "mm", "--cranks", "towards", "--set", "crank_length=30"]
    status, out, _ = call("robots", *arguments, "--set", "rod_length=180", "--about", "mine", "--out", "mine.yaml")
    assert status == 0
    first, second, *_ = out.splitlines()
    assert first == "pairs of motors: legs 0 and 1, 2 and 3, 4 and 5"
    assert second == "robot in mine.yaml: home at Z = 0.2002 m, shafts 110.2 mm from the middle"
    assert "because not given [kg, kg m^2, N m]: platform_mass = 1" in out
    assert load_robot("mine.yaml").rod_lengths.tolist() == [0.18] * 6
    assert (tmp_path / "mine.yaml").read_text().startswith("about: mine\n")


def test_a_crank_that_is_perhaps_mirrored_is_a_warning_of_the_command(call, tmp_path):
    lines = (DOCS / "your_robot.csv").read_text().splitlines()[1:]
    cranks = ("crank_deg", 90, -90, -149.6, 30.4, 149.6, 149.6)  # that of leg 4 should be at -30.4
    (tmp_path / "points.csv").write_text("\n".join(f"{line}, {end}" for line, end in zip(lines, cranks, strict=True)))
    lengths = ("--set", "crank_length=30", "--set", "rod_length=180")
    status, out, err = call("robots", "from-table", "points.csv", "--unit", "mm", *lengths, "--out", "mine.yaml")
    assert (status, "robot in mine.yaml" in out, "pairs" in out) == (0, True, False)
    assert err.startswith("stewart-drake: warning: the crank of leg 4 is level at ")


def test_a_robot_goes_into_files_for_other_programs(call, tmp_path):
    assert call("write-sdf", "robot.sdf", "--robot", "reachy_mini")[0] == 0
    assert call("write-mjcf", "robot.xml", "--robot", "reachy_mini", "--set", "plant.motor_damping=0.1")[0] == 0
    assert 'type="universal"' in (tmp_path / "robot.sdf").read_text()
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "robot.xml"))
    assert (model.nu, model.neq, model.nv) == (6, 6, 24)
    assert model.joint("motor_3").damping == 0.1
    assert "<model name=" in (tmp_path / "robot.sdf").read_text()


def test_gains_of_servos_are_shown_and_missed_in_other_files(call, tmp_path):
    legs = [{"servo_gain": gain} for gain in (1.02, 0.97, 1, 1.03, 0.98, 1.01)]
    save_robot(load_robot("paper").replace(legs=legs), tmp_path / "mine.yaml")
    assert "1.02, 0.97, 1, 1.03, 0.98, 1.01" in call("robots", "show", "mine.yaml")[1]
    status, _, err = call("write-mjcf", "mine.xml", "--robot", "mine.yaml")
    assert status == 0
    assert err == "stewart-drake: warning: mine.xml has no servo_gain of the legs: keep the robot's YAML file\n"


def test_what_is_doubtful_at_home_and_the_default_of_cranks_are_lines(call, tmp_path):
    (tmp_path / "points.csv").write_text((DOCS / "your_robot.csv").read_text())
    given = ("--set", "crank_length=30", "--set", "rod_length=180", "--set", "link_radius=40", "--out", "mine.yaml")
    status, out, err = call("robots", "from-table", "points.csv", "--unit", "mm", *given)
    assert (status, out.splitlines()[0].partition(";")[0]) == (0, "level cranks point outwards from the centre")
    assert err == "stewart-drake: warning: links of 40 mm radius collide at home: is link_radius right?\n"
    # Joints right above the shafts: rods are parallel, and the platform can turn about z.
    points = ("102, -41, 0", "102, 41, 0", "-16, 109, 0", "-86, 68, 0", "-86, -68, 0", "-16, -109, 0")
    lines = [f"{point}, {point}" for point in points]
    header = "shaft_x, shaft_y, shaft_z, joint_x, joint_y, joint_z"
    (tmp_path / "points.csv").write_text("\n".join([header, *lines]))
    status, out, err = call("robots", "from-table", "points.csv", "--unit", "mm", *given[:4], *given[6:])
    assert (status, err.count("\n")) == (0, 1), err
    assert "warning: home is near a singularity, conditioning 0.0" in err


def test_a_robot_from_a_model_file_is_drawn(call, tmp_path):
    assert call("write-sdf", "robot.sdf", "--robot", "servo_hexapod")[0] == 0
    status, out, err = call("robots", "from-sdf", "robot.sdf", "--out", "made.yaml")
    assert (status, err) == (0, "")
    assert re.search(r"motor_5 +. +-0\.06", out)
    assert "not read: 42 pictures, 30 collision shapes" in out
    status, out, _ = call("robots", "show", "made.yaml", "--plot", "legs.png")
    assert (status, out.splitlines()[-1]) == (0, "legs in legs.png")
    assert (tmp_path / "legs.png").stat().st_size > 20_000
    status, _, err = call("robots", "from-urdf", "made.yaml")
    assert (status, err.count("\n")) == (2, 1)
    assert "model made.yaml: expected a file of URDF, SDF, MJCF, got" in err


def test_home_by_a_height_or_perpendicular_rods(call, tmp_path):
    (tmp_path / "points.csv").write_text((DOCS / "your_robot.csv").read_text())
    lengths = ("--set", "crank_length=30", "--set", "rod_length=180", "--out", "mine.yaml")
    arguments = ("robots", "from-table", "points.csv", "--unit", "mm", "--cranks", "towards", *lengths)
    for home, height in (("perpendicular", None), ("195", 0.195)):
        status, _, err = call(*arguments, "--home", home)
        assert (status, err) == (0, "")
        robot = load_robot("mine.yaml")
        apart = np.linalg.norm((robot.shaft_positions - robot.joints_in_platform)[:, :2], axis=-1)
        wanted = np.mean(0.035 + np.sqrt(0.18**2 + 0.03**2 - apart**2)) if height is None else height
        assert robot.home_height == pytest.approx(wanted, abs=1e-12)
    status, _, err = call(*arguments, "--home", "flat")
    assert (status, err) == (2, "stewart-drake: --home: expected level, perpendicular, or a height, got 'flat'\n")


@pytest.mark.slow
def test_from_a_plan_to_a_calibrated_robot(call, tmp_path):
    status, out, err = call("calibrate", "--plan", 20, "--robot", "paper", "--out", "plan.csv")
    assert (status, err) == (0, "")
    assert "rod length" in out
    planned = load_measurements(tmp_path / "plan.csv")
    assert len(planned) == 20
    rng = np.random.default_rng(0)
    truth = deviating(ROBOT, rng)
    (tmp_path / "poses.csv").write_text(measured(truth, planned, MeasurementNoise(), rng).to_csv())
    arguments = ("calibrate", "poses.csv", "--robot", "paper", "--out", "mine.yaml", "--report", "report")
    status, out, err = call(*arguments)
    assert (status, err) == (0, "")
    assert "pose error after" in out
    off = change_to(aligned(truth, ROBOT), load_robot(tmp_path / "mine.yaml"))
    assert np.abs(off).max() < 5e-3
    names = {path.name for path in (tmp_path / "report").iterdir()}
    assert names == {"calibration.png", "parameters.csv", "report.md", "residuals.csv"}
    with (tmp_path / "report" / "parameters.csv").open() as stream:
        assert len(list(csv.DictReader(stream))) == 72


def test_from_a_log_to_an_identified_robot(call, tmp_path):
    truth = truth_of(ROBOT)
    for name, seed in (("log.csv", 3), ("other.csv", 4)):
        (tmp_path / name).write_text(recording(ROBOT, truth, motion(ROBOT, seed), rate=100.0, noise=0.005).to_csv())
    options = ("--out", "mine.yaml", "--report", "report", "--validate", "other.csv")
    status, out, err = call("identify", "log.csv", "--robot", "paper", *options)
    assert (status, err) == (0, "")
    assert "not used: recording other.csv" in " ".join(out.replace("│", " ").split())
    assert "3 rod_mass" in out
    robot = load_robot(tmp_path / "mine.yaml")
    assert robot.platform_mass == pytest.approx(truth[0], rel=0.01)
    names = {path.name for path in (tmp_path / "report").iterdir()}
    assert names == {"friction.yaml", "identification.png", "parameters.csv", "report.md"}
    with (tmp_path / "report" / "parameters.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == len(values_of(ROBOT))
    assert float(rows[0]["value"]) == pytest.approx(robot.platform_mass)
    # The friction goes into a scenario as it stands.
    friction = (tmp_path / "report" / "friction.yaml").read_text()
    (tmp_path / "run.yaml").write_text(f"model: {{robot: mine.yaml}}\n{friction}")
    believed = load_scenario(tmp_path / "run.yaml")
    assert isinstance(believed.plant.friction, FrictionOptions)
    np.testing.assert_allclose(believed.plant.friction.coulomb, truth[COULOMB], rtol=0.1)


@pytest.mark.long
def test_servos_from_a_designed_motion_to_a_model(call, tmp_path):
    keys = ("--set", "plant={kind: closed_form, integrator: rk4}", "--set", "sensors.delay=0.004")
    assert call("excite", "--robot", "reachy_mini", "--motors", "xl330_m288", *keys, "--out", "excite.yaml")[0] == 0
    assert call("check", "excite.yaml")[0] == 0
    assert call("run", "excite.yaml", "--out", "log")[0] == 0
    options = ("--reading-age", 0.004, "--out", "mine.yaml", "--report", "report")
    status, out, err = call("identify", "log", "--robot", "reachy_mini", *options)
    assert (status, err) == (0, "")
    assert "stiffness" in out
    names = {path.name for path in (tmp_path / "report").iterdir()}
    assert names == {"model.yaml", "identification.png", "parameters.csv", "report.md"}
    model = (tmp_path / "report" / "model.yaml").read_text()
    (tmp_path / "run.yaml").write_text(f"robot: mine.yaml\nmotors: {{kind: position}}\n{model}")
    belief = load_scenario(tmp_path / "run.yaml").controller_model
    assert belief.motors.stiffness == pytest.approx(1.0, rel=0.03)
    assert belief.motors.delay == pytest.approx(0.0, abs=1e-3)
    np.testing.assert_allclose(belief.friction.coulomb, 0.0128, rtol=0.1)
