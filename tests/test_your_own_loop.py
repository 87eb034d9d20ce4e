"""The page docs/your_own_loop.md: a plant, motors and a controller that the package has never seen."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest

from stewart_drake import ConfigurationError, Scenario, inverse_kinematics, load_scenario, run
from stewart_drake.live.loop import LiveLoop

PAGE = (Path(__file__).parents[1] / "docs" / "your_own_loop.md").read_text()
MINE, GIVEN = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
(FILE,) = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)


@pytest.fixture
def mine(tmp_path, monkeypatch):
    (tmp_path / "mine.py").write_text(MINE)
    (tmp_path / "mine.yaml").write_text(FILE)
    monkeypatch.syspath_prepend(tmp_path)
    names = {"__name__": "page", "folder": tmp_path}
    exec(compile(GIVEN, "page", "exec"), names)
    del sys.modules["mine"]
    return names


def test_the_loop_of_the_page_moves_by_the_equations_of_the_page(mine):
    log, h = mine["log"], 0.001
    assert (log.status, log.scenario.plant.kind.name) == ("completed", "Platform")
    pose, rate, torque = log["pose"], log["pose_rate"], log["torque_applied"]
    np.testing.assert_allclose(pose[1:], pose[:-1] + h * rate[1:], atol=1e-15)
    force = torque[:-1] @ mine["Platform"].step.__globals__["FORCE"].T
    mass = np.array([0.004, 0.004, 0.007, 1.0, 1.0, 1.0])
    np.testing.assert_allclose(np.diff(rate, axis=0), h * (force / mass - [0, 0, 0, 0, 0, 9.81]), atol=1e-12)
    np.testing.assert_allclose(torque[1:], 0.7 * torque[:-1] + 0.3 * log["torque"][1:], atol=1e-12)
    np.testing.assert_allclose(log["crank_angle"], inverse_kinematics(log.scenario.robot, pose), atol=1e-12)
    away = pose - log["reference"]
    assert np.ptp(log["reference"], axis=0).max() > 0.01
    assert np.abs(away[:, 3:]).max() < 1e-3


def test_a_file_gives_the_same_run(mine):
    log = run(load_scenario(mine["folder"] / "mine.yaml", trust_code=True))
    np.testing.assert_array_equal(log["pose"], mine["log"]["pose"])
    with pytest.raises(ConfigurationError, match="code that you trust"):
        run(load_scenario(mine["folder"] / "mine.yaml"))


def test_it_is_steered_by_hand_and_a_motor_dies(mine):
    loop = LiveLoop(mine["log"].scenario.replace(reference="hold"))
    loop.advance(50)
    before = loop.pose
    loop.push(np.array([0.0, 0.0, 0.0, 5.0, 0.0, 0.0]), 0.1)
    loop.advance(60)
    assert loop.pose[3] > before[3] + 1e-4
    with pytest.raises(ConfigurationError, match=r"^plant.payload_mass: no such key"):
        loop.change({"plant.payload_mass": 0.1})
    here = loop.pose
    loop.change({"motors": {"kind": "torque", "dead": {"leg": 2}}})
    np.testing.assert_array_equal(loop.pose, here)
    loop.advance(1)
    assert loop.torque[2] == 0.0


class Still:
    def initial(self, pose, pose_rate):
        return pose, pose_rate

    def step(self, *_):
        return np.zeros((2, 6))


def answering(step):
    return type("Mine", (Still,), {"step": lambda *_: step()})


def motors(torque):
    return type("Mine", (), {"torque": lambda *_: torque()})


def raising():
    raise ValueError("of my own")


WRONG = {
    "five numbers": ("plant", answering(lambda: (np.zeros(5), np.zeros(6))), "not \\(5,\\), \\(6,\\)"),
    "nothing": ("plant", answering(lambda: None), "not a NoneType"),
    "no initial": ("plant", type("Mine", (), {"step": raising}), "not one without initial"),
    "seven torques": ("motors", motors(lambda: np.zeros(7)), "not an array of shape \\(7,\\)"),
    "a word": ("motors", motors(lambda: "much"), "not a str"),
}


@pytest.mark.parametrize(("key", "kind", "told"), WRONG.values(), ids=WRONG.keys())
def test_what_they_return_is_checked(key, kind, told):
    with pytest.raises(ConfigurationError, match=f"^{key}.kind: expected a class whose .*, {told}") as caught:
        run(Scenario(**{key: kind, "duration": 0.01, "controller": "pid"}))
    assert "\n" not in str(caught.value)


ENDS = {
    "raises": ("plant", answering(raising), "controller_raised", "ValueError: of my own"),
    "no number": ("plant", answering(lambda: np.full((2, 6), np.nan)), "not_finite", "is not finite"),
    "out of reach": ("plant", answering(lambda: np.ones((2, 6))), "unreachable_pose", "out of reach"),
    "motors raise": ("motors", motors(raising), "controller_raised", "ValueError: of my own"),
    "motors give no number": ("motors", motors(lambda: np.full(6, np.inf)), "not_finite", "is not finite"),
}


@pytest.mark.parametrize(("key", "kind", "reason", "message"), ENDS.values(), ids=ENDS.keys())
def test_what_goes_wrong_midway_ends_the_run_and_keeps_its_log(key, kind, reason, message):
    changes = {"plant": "closed_form", key: kind, "controller": "pid", "duration": 0.05}
    log = run(Scenario(**changes))
    assert (log.status, log.reason) == ("failed", reason)
    assert message in log.message
