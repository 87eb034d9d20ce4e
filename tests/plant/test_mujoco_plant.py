"""The plant from an MJCF file: our own against the closed form, and what Reachy Mini's maker ships."""

import importlib.util
import re
import sys

import mujoco
import numpy as np
import pytest

from stewart_drake import (
    ConfigurationError,
    RobotParameters,
    inverse_kinematics,
    leg_geometry,
    load_robot,
    load_scenario,
    run,
    run_metrics,
)
from stewart_drake.base.errors import NotFiniteError, RunFailure
from stewart_drake.mechanics.dynamics import static_torque
from stewart_drake.mechanics.kinematics import crank_rates, reach_margin, rotation_matrix, twist_jacobian
from stewart_drake.plant import mjcf_legs
from stewart_drake.plant.closed_form import ClosedFormOptions
from stewart_drake.plant.model_files import mjcf_text
from stewart_drake.plant.mujoco_plant import MujocoOptions
from stewart_drake.plant.plant_options import ANGLES, CRANK_RATES, POSE, RATE
from stewart_drake.robot.leg import JOINT_SWING
from stewart_drake.robot.robot_files import robot_model
from stewart_drake.runs.checks import compared_with_model

PAPER, HEAD, GRAVITY, STILL = RobotParameters(), load_robot("reachy_mini"), 9.81, np.zeros(6)
MOTORS = range(6)
makers = pytest.mark.skipif(
    importlib.util.find_spec("reachy_mini") is None,
    reason="pip install --no-deps " + re.search(r"package:([^/]*)", robot_model("reachy_mini"))[1],
)
FREE = {"model_file": "reachy_mini", "passive_friction": 0.0, "motor_friction": 0.0, "motor_damping": 0.0}


def reachable(robot, count, seed=0):
    size = np.linalg.norm(robot.platform_joints, axis=1).mean()
    rng = np.random.default_rng(seed)
    poses = robot.home_pose + rng.uniform(-1.0, 1.0, (3 * count, 6)) * [0.5, 0.5, 0.5, *[0.4 * size] * 3]
    return poses[reach_margin(robot, poses).min(axis=-1) > 0.02][:count]


def write(path, text):
    path.write_text(text, encoding="utf-8")
    return str(path)


# Position [m] within which a second of a run is that of the closed form. With exact sensors and without friction both
# step by a first-order method with nearly the same error. A reading that rounds to the next count, or a motor that
# sticks a step later, is worth micrometres, between Drake and the closed form just as much.
RUNS = {
    "exact_fig7": ((), 1e-7),
    "hold": (("robot=servo_hexapod",), 1e-7),
    "sway": ((), 5e-6),
    "exact_breathing": ((), 5e-6),
    "exact_heart": ((), 5e-6),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", RUNS)
def test_a_run_on_our_own_mjcf_is_that_of_the_closed_form(name):
    overrides, allowed = RUNS[name]
    logs = [
        run(load_scenario(name, [*overrides, "duration=1"]).replace({"plant.kind": kind}))
        for kind in ("closed_form", "mujoco")
    ]
    assert [log.status for log in logs] == ["completed"] * 2
    apart = np.abs(logs[0]["pose"] - logs[1]["pose"])
    assert apart[:, 3:].max() < allowed
    assert apart[:, :3].max() < allowed / 0.05


LOADS = {
    "free": {},
    "damped": {"motor_damping": 0.02},
    "payload": {"payload_mass": 0.3, "payload_position": (0.02, 0, 0.05)},
}


@pytest.mark.parametrize("load", LOADS)
def test_it_comes_to_the_closed_form_with_the_step(load):
    torque = static_torque(PAPER, PAPER.home_pose) + [0.3, -0.1, 0.2, 0.1, -0.2, 0.1]
    push, apart = np.array([0.1, 0.0, 0.0, 0.0, 1.0, 2.0]), []
    for step in (1e-3, 5e-4):
        ends = []
        for kind in (MujocoOptions, ClosedFormOptions):
            plant = kind(time_step=step, **LOADS[load]).make(PAPER, GRAVITY)
            plant.initial(PAPER.home_pose, np.array([0.3, -0.2, 0.4, 0.03, -0.02, 0.05]))
            for _ in range(round(0.1 / step)):
                end = plant.step(torque, push)
            ends.append(end.copy())
        apart.append(np.abs(ends[0] - ends[1])[POSE].max())
    # After a turn by 15 deg; below 1e-6 rad MuJoCo's soft loops are what is left.
    assert apart[1] < 2e-5
    assert apart[0] / apart[1] == pytest.approx(2.0, rel=0.2)


@pytest.mark.parametrize("name", ["paper", "reachy_mini", "servo_hexapod"])
@pytest.mark.parametrize("model", ["own", pytest.param("makers", marks=makers)])
def test_it_begins_at_any_pose_on_the_robots_branch(name, model):
    if model == "makers" and name != "reachy_mini":
        pytest.skip("the maker ships one model")
    robot = load_robot(name)
    plant = MujocoOptions(model_file=None if model == "own" else name).make(robot, GRAVITY)
    # Crank angles are the model's own, whose geometry is printed with six digits.
    close = 1e-8 if model == "own" else 1e-5
    for pose in reachable(robot, 20):
        rate = np.array([0.3, -0.5, 0.2, 0.02, -0.01, 0.03])
        measured = plant.initial(pose, rate).copy()
        np.testing.assert_allclose(measured[POSE], pose, atol=1e-9)
        np.testing.assert_allclose(measured[RATE], rate, atol=1e-9)
        off = measured[ANGLES] - inverse_kinematics(robot, pose)
        np.testing.assert_allclose(np.sin(0.5 * off), 0.0, atol=close)
        wanted = crank_rates(robot, leg_geometry(robot, pose), pose, rate)
        np.testing.assert_allclose(measured[CRANK_RATES], wanted, atol=100 * close)


@pytest.mark.parametrize("name", ["paper", "servo_hexapod"])
def test_a_model_with_stops_of_the_rods_takes_any_torque(name):
    """As an untrained policy gives them, up to the effort limits; without the stops about half of the runs diverge."""
    robot = load_robot(name)
    text = mjcf_text(robot, GRAVITY, joint_swing=JOINT_SWING).replace('"Euler"', '"implicitfast"')
    model, draw = mujoco.MjModel.from_xml_string(text), np.random.default_rng(0)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    joint = model.joint("universal_3_x")
    assert (joint.range.tolist(), joint.damping[0]) == ([-JOINT_SWING, JOINT_SWING], 10.0 * robot.rod_inertia[0])
    for _ in range(5):
        data, phase, size = mujoco.MjData(model), draw.uniform(0.0, 6.0, 6), draw.uniform(0.2, 1.0, 6)
        while data.time < 1.5:
            data.ctrl[:] = robot.effort_limits * size * np.sin(6.0 * data.time + phase)
            mujoco.mj_step(model, data)
        assert np.isfinite(data.qacc).all()
        gap = data.site_xpos[model.site("end_0").id] - data.site_xpos[model.site("seat_0").id]
        assert np.linalg.norm(gap) < 0.02 * robot.rod_lengths[0]


def test_a_push_is_about_the_origin_of_p():
    plant, push = MujocoOptions().make(HEAD, GRAVITY), np.array([0.01, -0.02, 0.01, 0.3, -0.2, 0.5])
    pose = HEAD.home_pose + [0.1, -0.05, 0.08, 0.002, 0.001, 0.003]
    torque = static_torque(HEAD, pose) - np.linalg.solve(twist_jacobian(HEAD, pose).T, push)
    plant.initial(pose, STILL)
    for _ in range(50):
        measured = plant.step(torque, push)
    np.testing.assert_allclose(measured[POSE], pose, atol=1e-6)


def test_any_order_names_turn_and_mount_of_the_model_will_do(tmp_path):
    # Legs in another order, motors the other way round, and the whole thing hung up elsewhere.
    spec = mujoco.MjSpec.from_string(mjcf_text(HEAD))
    turned = rotation_matrix([2.8, 0.3, -1.0])
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, turned.ravel())
    outer = mujoco.MjSpec()
    for key in ("timestep", "tolerance", "iterations"):
        setattr(outer.option, key, getattr(spec.option, key))
    for leg in (1, 4):
        spec.joint(f"motor_{leg}").axis = [0, 1, 0]
        spec.joint(f"motor_{leg}").range = -np.array(spec.joint(f"motor_{leg}").range)[::-1]
    for joint in list(spec.joints):
        if joint.type == mujoco.mjtJoint.mjJNT_FREE:
            spec.delete(joint)
    frame = outer.worldbody.add_frame(pos=[1.0, 2.0, 3.0], quat=quaternion)
    outer.attach(spec, prefix="x", frame=frame)
    for axis in np.eye(3):
        outer.body("xplatform").add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
    outer.body("xplatform").add_joint(type=mujoco.mjtJoint.mjJNT_BALL)
    file = write(tmp_path / "hung.xml", outer.to_xml())
    hung, own = (MujocoOptions(model_file=each).make(HEAD, GRAVITY) for each in (file, None))
    pose, rate = (
        HEAD.home_pose + [0.1, -0.08, 0.12, 0.002, -0.003, 0.004],
        np.array([0.3, -0.5, 0.2, 0.02, -0.01, 0.03]),
    )
    torque, push = static_torque(HEAD, pose) + 0.01, np.array([0.01, -0.02, 0.01, 0.3, -0.2, 0.5])
    for plant in (hung, own):
        plant.initial(pose, rate)
    for _ in range(20):
        # Other joints to the platform give the soft loops another share of it.
        apart = np.abs(hung.step(torque, push) - own.step(torque, push))
        assert max(apart[POSE].max(), apart[ANGLES].max()) < 1e-4


def test_what_blows_up_is_said_without_a_file_of_mujocos(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    plant = MujocoOptions(time_step=0.01, model_file=write(tmp_path / "robot.xml", mjcf_text(PAPER))).make(
        PAPER, GRAVITY
    )
    plant.initial(PAPER.home_pose, STILL)

    def go_on():
        for _ in range(20):
            plant.step(np.full(6, 5.0), np.full(6, 1e200))

    with pytest.raises(NotFiniteError, match="MuJoCo's state is not finite"):
        go_on()
    assert [each.name for each in tmp_path.iterdir()] == ["robot.xml"]


@makers
def test_the_makers_model_is_the_robot_that_we_believe():
    scenario = load_scenario("reachy_nod").replace({"plant": {"kind": "mujoco", "model_file": "reachy_mini"}})
    rows = {name: (simulated, believed) for name, simulated, believed in compared_with_model(scenario)}
    misfit = next(name for name in rows if name.startswith("misfit"))
    assert float(rows[misfit][0].removesuffix(" mm")) < 0.001
    for key in ("platform_mass", "rod_mass", "crank_mass"):
        assert len(set(rows[f"robot.{key}"])) == 1
    assert rows["robot.rotor_inertia"] == ("0.001 kg m^2", "0.0018 kg m^2")
    assert rows["dry friction"] == ("0.1 N m", "0.058 N m")
    assert rows["armature of passive joints"][0] == "0.001 kg m^2"
    assert "reachy_mini" not in sys.modules


@makers
def test_the_motors_class_has_what_our_robot_has_of_it():
    options = MujocoOptions(model_file="reachy_mini", motor_class="xc330m288t")
    assert options.friction_options.coulomb == (0.058,) * 6
    assert options.friction_options.viscous == (0.095,) * 6
    simulated = options.simulated(HEAD)[0]
    assert simulated["rotor_inertia"] == (HEAD.rotor_inertia,) * 6
    assert simulated["effort_limit"] == (0.8,) * 6  # the data sheet has 0.52, and so have we


@makers
def test_it_holds_home_by_the_torque_of_our_statics():
    plant = MujocoOptions(**FREE, passive_armature=0.0).make(HEAD, GRAVITY)
    plant.initial(HEAD.home_pose, STILL)
    for _ in range(100):
        measured = plant.step(static_torque(HEAD, HEAD.home_pose), STILL)
    # [rad, m] The maker's loops give way by 2e-6 m, and nothing holds the fall that this begins.
    assert np.abs(measured[POSE] - HEAD.home_pose).max() < 1e-4


@makers
@pytest.mark.slow
def test_on_the_makers_model_we_nod_as_on_our_own():
    servos = {"motors": {"kind": "position", "delay": 0.01}, "controller": {"kind": "feedforward", "period": 0.02}}
    friction = {"motor_friction": 0.0128, "motor_damping": 0.0037}
    model = {"kind": "mujoco", "model_file": "reachy_mini", "motor_class": "xc330m288t"}
    free = {**model, "passive_friction": 0.0, "passive_armature": 0.0}
    errors = []
    for plant in ({"kind": "closed_form"}, free):
        changes = {
            **servos,
            "plant": {**plant, **friction},
            "safety": None,
            "estimator": "difference",
            "tuner": "fixed",
        }
        changes["model.friction"] = {"coulomb": 0.0128, "viscous": 0.0037, "width": 0.004}
        errors.append(run_metrics(run(load_scenario("reachy_nod").replace(changes)))["rmse_norm_deg"])
    assert errors[1] == pytest.approx(errors[0], rel=0.2)
    assert errors[1] < 0.06


def problem(robot=HEAD, **options):
    with pytest.raises(ConfigurationError) as caught:
        MujocoOptions(**options).make(robot, GRAVITY)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_file_that_is_no_model_is_refused_in_a_line(tmp_path):
    assert "none.xml: expected a readable file" in problem(model_file=str(tmp_path / "none.xml"))
    assert "a regular file" in problem(model_file=str(tmp_path))
    bad = write(tmp_path / "bad.xml", "hello")
    assert problem(model_file=bad).startswith("plant.model_file: expected an MJCF that MuJoCo reads (XML parse error")
    empty = write(tmp_path / "empty.xml", "<mujoco><worldbody/></mujoco>")
    text = problem(model_file=empty)
    assert "six motors each turn a crank with a rod to one platform, not 0" in text
    assert text.endswith("a motor is a hinge with an actuator, or one of plant.motor_joints")
    assert "a robot whose file names a model with the key `mjcf`" in problem(model_file="paper")
    assert problem(model_file="package:no_such_thing==2.0/a.xml").endswith("pip install --no-deps no_such_thing==2.0")
    assert "expected package:NAME/path" in problem(model_file="package:../a.xml")


def test_meshes_need_not_be_there_unless_masses_come_from_them(tmp_path):
    text = mjcf_text(HEAD).replace("</worldbody>", "</worldbody><asset><mesh name='m' file='gone.stl'/></asset>")
    drawn = text.replace('<freejoint name="platform" />', '<freejoint /><geom type="mesh" mesh="m"/>')
    MujocoOptions(model_file=write(tmp_path / "drawn.xml", drawn)).make(HEAD, GRAVITY)
    heavy = re.sub(r"(<freejoint />.*?)", r"\1", re.sub(r"<inertial pos[^>]*>\s*<freejoint />", "<freejoint />", drawn))
    assert "gone.stl" in problem(model_file=write(tmp_path / "heavy.xml", heavy))


def test_another_robot_is_refused_with_what_differs_most(tmp_path):
    file = write(tmp_path / "robot.xml", mjcf_text(HEAD))
    text = problem(PAPER, model_file=file)
    assert re.search(r"a model of `robot` within 1 mm, not 319 mm \(rod length of leg \d\)", text)
    legs = [{"platform_joint": joint.tolist()} for joint in HEAD.platform_joints]
    legs[2]["platform_joint"][2] += 2e-3
    data = HEAD.to_dict()
    data["legs"] = [{**old, **new} for old, new in zip(data["legs"], legs, strict=True)]
    assert "(platform joint of leg 2)" in problem(RobotParameters.from_dict(data), model_file=file)


def test_names_that_the_model_does_not_have(tmp_path):
    file = write(tmp_path / "robot.xml", mjcf_text(HEAD))
    names = [f"motor_{leg}" for leg in MOTORS]
    assert "did you mean motor_" in problem(model_file=file, motor_joints=(*names[:5], "motor5"))
    assert problem(model_file=file, motor_class="servo").startswith("plant.motor_class: expected a class of")
    without = re.sub(r"(?s)<actuator>.*</actuator>", "", mjcf_text(HEAD))
    bare = write(tmp_path / "bare.xml", without)
    assert "not 0" in problem(model_file=bare)
    MujocoOptions(model_file=bare, motor_joints=tuple(names[::-1])).make(HEAD, GRAVITY)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"motor_class": "a"}, "plant.motor_class: expected null, without a `model_file`"),
        ({"friction": {"coulomb": 0.1, "break_away": 0.2}}, "MuJoCo has no stiction"),
        (
            {"friction": {"coulomb": 0.1}, "motor_damping": 0.1},
            "plant.motor_damping: expected null, because `friction`",
        ),
    ],
)
def test_keys_that_do_not_go_together(keys, message):
    with pytest.raises(ConfigurationError, match=message):
        MujocoOptions(**keys)


def test_a_pose_that_the_model_cannot_take_ends_the_run(tmp_path, monkeypatch):
    # Its loops are another robot's: rods a tenth longer.
    text = re.sub(
        r'(<site name="end_0" pos="0.0 0.0 )([\d.]+)', lambda m: f"{m[1]}{3.0 * float(m[2])}", mjcf_text(HEAD)
    )
    monkeypatch.setattr(mjcf_legs, "ALLOWED", 1.0)
    plant = MujocoOptions(model_file=write(tmp_path / "long.xml", text)).make(HEAD, GRAVITY)
    with pytest.raises(RunFailure, match="does not close its loops at pose") as caught:
        plant.initial(HEAD.home_pose, STILL)
    assert caught.value.reason == "unreachable_pose"


def test_without_mujoco_a_line_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    assert problem().startswith("mujoco is not installed: pip install 'stewart-drake[mujoco]'")
