"""The environments of Gymnasium: what an action does, and what an agent sees."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from stewart_drake import ConfigurationError
from stewart_drake.runs.simulation import run
from stewart_drake.training.environments import BallEnvironment, TrackEnvironment, TuneEnvironment


@pytest.mark.slow
@pytest.mark.parametrize("name", ["Track", "Tune", "Ball"])
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


def balanced(environment, seed, policy):
    """Sum of the rewards of an episode, and whether the ball fell."""
    observation, _ = environment.reset(seed=seed)
    total, failed, late = 0.0, False, False
    while not (failed or late):
        observation, reward, failed, late, _ = environment.step(policy(observation))
        total += reward
    return total, failed


def test_the_lqi_balances_a_ball_and_a_random_policy_does_not():
    environment, random = BallEnvironment(), np.random.default_rng(0)
    limits, plate = environment.limits, 0.15
    environment.reset(seed=0)
    gain = limits.gain(*environment.episode.scenario.ball.per_tilt(9.81), environment.interval)

    def lqi(seen):
        place, velocity, target, tilt, rate = np.split(seen.astype(float), 5)
        errors = plate * (place - target), plate * velocity, limits.max_tilt * tilt, limits.max_rate * rate
        return rate - environment.interval * (gain @ np.stack(errors)) / limits.max_rate

    for seed in range(2):
        total, failed = balanced(environment, seed, lqi)
        assert total > 230.0
        assert not failed
        first = environment.episode.loop.measured.copy()
        assert balanced(environment, seed, lqi)[0] == total
        np.testing.assert_array_equal(environment.episode.loop.measured, first)
        assert balanced(environment, seed, lambda _: random.uniform(-1.0, 1.0, 2)) < (70.0, True)


def test_a_scenario_without_a_ball_is_refused():
    with pytest.raises(ConfigurationError, match="ball: expected a section"):
        BallEnvironment("hold")
