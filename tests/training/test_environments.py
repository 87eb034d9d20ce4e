"""The environments of Gymnasium: what an action does, and what an agent sees."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from stewart_drake.runs.simulation import run
from stewart_drake.training.environments import TrackEnvironment, TuneEnvironment


@pytest.mark.slow
@pytest.mark.parametrize("name", ["Track", "Tune"])
def test_gymnasium_finds_and_accepts_it(name):
    check_env(gymnasium.make(f"stewart_drake/{name}-v0").unwrapped, skip_render_check=True)


def test_torques_that_push_back_bring_the_platform_home():
    environment = TrackEnvironment()

    def end(gain):
        observation, _ = environment.reset(seed=3)
        over = False
        while not over:
            error, rate = np.sinh(observation[5]), np.sinh(observation[11])  # Z [mm], [cm/s]
            action = np.full(6, -gain * (0.05 * error + 0.05 * rate), np.float32)
            observation, _, failed, late, _ = environment.step(action)
            over = failed or late
        return abs(float(np.sinh(observation[5])))

    assert end(1.0) < 0.3 * end(0.0)


def test_no_action_is_the_best_fixed_setting():
    environment = TuneEnvironment()
    environment.reset(seed=5)
    costs, over = [], False
    while not over:
        _, _, _, over, figures = environment.step(np.zeros(4, np.float32))
        costs.append(figures["position_mm"])
    episode = environment.episode
    weights, disturbance = (episode.loop.runner.signal(name) for name in ("weights", "expected_disturbance"))
    fixed = {"kind": "block", **dict(zip(("q_pose", "q_rate", "q_integral", "r"), weights.tolist(), strict=True))}
    log = run(episode.scenario.replace({"tuner": fixed, "estimator.disturbance": float(disturbance[0])}), check=False)
    error = 1e3 * np.linalg.norm((log["pose"] - log["reference"])[1:, 3:], axis=1)
    assert np.sqrt(np.mean(np.square(costs))) == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-6)


def test_an_action_moves_the_setting_to_its_end_of_the_box():
    environment = TuneEnvironment()
    environment.reset(seed=5)
    for _ in range(10):
        environment.step(np.array([1.0, -1.0, 0.0, 0.0], np.float32))
    box, setting = environment.policy, environment.episode.loop.runner.signal("setting")
    np.testing.assert_allclose(setting[0], box.centre[0] + box.above[0])
    np.testing.assert_allclose(setting[1], box.centre[1] - box.below[1])
