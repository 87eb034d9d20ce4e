"""A controller learned from nothing but tries: PPO of stable-baselines3 on `stewart_drake/Track-v0`.

    pip install "stewart-drake[gym]" stable-baselines3
    python diagrams/learn_to_track.py

The torques that hold the platform are given; the policy learns what to add so that it comes to its pose and stays.
"""

import gymnasium
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env

import stewart_drake.training.environments  # noqa: F401 - registers them

TASK, STEPS, EPISODES = "stewart_drake/Track-v0", 150_000, 20


def mean_error(model: PPO | None) -> float:
    """Position error [mm] over the second half of episodes that no training has seen; without a model no action."""
    environment = gymnasium.make(TASK)
    errors = []
    for seed in range(10_000, 10_000 + EPISODES):
        observation, _ = environment.reset(seed=seed)
        over, own = False, []
        while not over:
            action = np.zeros(6) if model is None else model.predict(observation, deterministic=True)[0]
            observation, _, failed, late, figures = environment.step(action)
            over = failed or late
            own.append(figures.get("position_mm", 100.0))
        errors.append(np.mean(own[len(own) // 2 :]))
    return float(np.mean(errors))


if __name__ == "__main__":
    print(f"without a policy the error is {mean_error(None):.2f} mm")
    environments = make_vec_env(lambda: gymnasium.make(TASK), n_envs=8, seed=0)
    model = PPO("MlpPolicy", environments, n_steps=256, batch_size=512, gamma=0.97, learning_rate=1e-3, seed=0)
    model.learn(STEPS)
    print(f"with the learned one {mean_error(model):.2f} mm")
