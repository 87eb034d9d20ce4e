"""Loops of many settings against those made one by one."""

import numpy as np
import pytest

from stewart_drake.control.settings import disturbance_of, weights_of
from stewart_drake.errors import ConfigurationError
from stewart_drake.scenario import load_scenario
from stewart_drake.stability.linear_loop import linear_loops
from stewart_drake.stability.setting_loops import setting_loops

POSES = np.array([[0.2, -0.1, 0.15, 0.02, -0.01, 0.31], [0.0, 0.0, 0.0, 0.0, 0.0, 0.3]])
SETTINGS = np.array([[0.0, 0.0, 0.0, 0.0], [0.2, -0.2, 0.3, 0.5], [0.2, -0.2, 0.3, -0.5], [-0.1, 0.1, 0.0, 0.5]])


def scenario(*changes):
    return load_scenario("exact_breathing", ["tuner=block", *changes])


def one_by_one(made, pose, setting):
    blocks = weights_of(np.array(made.tuner.weights), setting).tolist()
    tuner = {"kind": "block", **dict(zip(("q_pose", "q_rate", "q_integral", "r"), blocks, strict=True))}
    level = float(disturbance_of(made.estimator.disturbance, setting))
    return linear_loops(made.replace({"tuner": tuner, "estimator.disturbance": level}), pose[None]).closed[0]


@pytest.mark.parametrize("changes", [(), ("command_delay=0",), ("model_robot={platform_mass: 1.3}",)], ids=str)
def test_loops_of_many_settings_are_those_of_each(changes):
    made = scenario(*changes)
    for pose, found in zip(POSES, setting_loops(made, POSES, SETTINGS), strict=True):
        np.testing.assert_array_equal(found.poses, np.tile(pose, (4, 1)))
        for closed, setting in zip(found.closed, SETTINGS, strict=True):
            expected = one_by_one(made, pose, setting)
            np.testing.assert_allclose(closed, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


def test_where_changes_are_bumpless_the_integral_counts_as_its_torque():
    plain, torque = (
        next(setting_loops(scenario(f"controller.bumpless={flag}"), POSES, SETTINGS)) for flag in ("false", "true")
    )
    same = [np.sort(np.abs(np.linalg.eigvals(each.closed)), axis=-1) for each in (plain, torque)]
    np.testing.assert_allclose(same[0][:, -20:], same[1][:, -20:], rtol=1e-6)
    # The next command has it one to one, whatever the weights.
    sent, integral = slice(42, 48), slice(36, 42)
    np.testing.assert_allclose(torque.a[:, sent, integral], np.tile(np.eye(6), (4, 1, 1)), atol=1e-9)
    assert np.ptp(plain.a[:, sent, integral], axis=0).max() > 1.0


@pytest.mark.parametrize(("change", "key"), [("tuner=fixed", "tuner.kind"), ("estimator=difference", "estimator.kind")])
def test_settings_need_an_observer_and_block_weights(change, key):
    with pytest.raises(ConfigurationError) as caught:
        next(setting_loops(scenario(change), POSES, SETTINGS))
    assert caught.value.key == key
