"""Gymnasium environments on the fast engine: a policy gives the torques, or tunes the regulator. Extra `gym`.

Importing this module registers `stewart_drake/Track-v0` and `stewart_drake/Tune-v0` for `gymnasium.make`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from stewart_drake.base.atomic_files import Document
from stewart_drake.base.errors import RunFailure, installed_with
from stewart_drake.base.sampling import times_of
from stewart_drake.control.base import Measurement, Setpoint
from stewart_drake.control.features import FEATURES, CostScales, cost
from stewart_drake.control.policy import Policy
from stewart_drake.mechanics.dynamics import inverse_dynamics
from stewart_drake.plant.plant_options import RATE
from stewart_drake.scenario.scenario import Scenario, load_scenario
from stewart_drake.scenario.stepped_loop import SteppedLoop
from stewart_drake.training.policy_training import FunctionSource, tuned_by
from stewart_drake.training.situations import TRAINING, kinds_of, situation

Info = Document  # As in gymnasium.
with installed_with("stewart-drake[gym]"):
    import gymnasium
    from gymnasium import spaces


class _Episode:
    """One run on the fast engine, from decision to decision."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario, self.loop = scenario, SteppedLoop(scenario)
        self._step = scenario.plant.time_step
        self.loop.begin()
        self.end = round(scenario.duration / self._step)
        self._before = np.zeros(6)
        self._run_parts()

    def advance(self, steps: int) -> tuple[float, float, float]:
        """Runs some steps: RMS rotation error [deg], position error [mm] and torque change in a millisecond [N m]."""
        squares = np.zeros(3)
        for _ in range(steps):
            self.loop.move()
            self._run_parts()
            change = 1e-3 / self._step * (self.loop.torque - self._before)
            error = self.error
            squares += np.sum(error[:3] ** 2), np.sum(error[3:] ** 2), np.mean(change**2)
        rotation, position, change_rms = np.sqrt(squares / steps)
        return float(np.degrees(rotation)), float(1e3 * position), float(change_rms)

    def _run_parts(self) -> None:
        self._before[:] = self.loop.torque
        self.loop.run_parts()

    @property
    def error(self) -> np.ndarray:
        """(6,) [rad, m]."""
        return np.asarray(self.loop.pose - self.reference[:6])

    @property
    def reference(self) -> np.ndarray:
        """(18,) of this instant."""
        return self.loop.runner.signal("reference")


class _Environment(gymnasium.Env[np.ndarray, np.ndarray]):
    """Base: episodes, and a reward of 1 / (1 + log10(1 + J)) for a decision, J the cost of its steps."""

    interval: float
    episode: _Episode

    def _decide(self) -> tuple[float, bool, bool, Info]:
        """Reward, terminated (the run failed), truncated (the time is over), and figures."""
        scenario = self.episode.scenario
        steps = max(1, round(self.interval / scenario.plant.time_step))
        try:
            rotation, position, change = self.episode.advance(min(steps, self.episode.end - self.episode.loop.now))
        except RunFailure as failure:
            return 0.0, True, False, {"reason": failure.reason}
        price = cost(rotation, position, change, CostScales())
        figures = {"cost": price, "rotation_deg": rotation, "position_mm": position, "torque_change": change}
        return 1.0 / (1.0 + float(np.log10(1.0 + price))), False, self.episode.loop.now >= self.episode.end, figures


class TrackEnvironment(_Environment):
    """The policy is the controller: torques that follow a motion.

    Action: (6,) in [-1, 1], torques relative to `authority` times the motors' limit, held for `interval`; inverse
    dynamics of the reference is added. Observation: (24,) arcsinh of errors of pose [deg, mm] and rate [deg/s, cm/s],
    and of the reference's rate and acceleration [10 deg/s^2, dm/s^2]. An episode begins off the motion by up to
    `offset`.

    Args:
        scenario: A scenario, its file or its name; its controller is not used.
        duration: [s] of an episode.
        interval: [s] between two actions.
        authority: [-] share of the motors' limit.
        offset: [deg, mm] of the first pose, largest of any axis.
    """

    def __init__(
        self,
        scenario: Scenario | str | Path = "hold",
        duration: float = 1.0,
        interval: float = 0.005,
        authority: float = 0.3,
        offset: tuple[float, float] = (0.5, 1.0),
    ) -> None:
        loaded = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
        # One tick per step of the plant, and exact measurements.
        plain = {"estimator": {}, "sensors": {}, "controller": {"kind": self._torque}, "plant.kind": "closed_form"}
        self._scenario = loaded.replace({**plain, "duration": duration, "safety": None, "model.friction": None})
        times = times_of(np.arange(round(duration / loaded.plant.time_step) + 2), loaded.plant.time_step)
        self._needed = inverse_dynamics(
            loaded.controller_model.robot, *loaded.reference.evaluate(times), loaded.controller_model.gravity
        )
        self.interval, self._offset = interval, np.repeat([np.radians(offset[0]), 1e-3 * offset[1]], 3)
        self._limit = authority * loaded.robot.effort_limits
        self._action = np.zeros(6)
        self.action_space = spaces.Box(-1.0, 1.0, (6,), np.float32)
        self.observation_space = spaces.Box(-20.0, 20.0, (24,), np.float32)

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[np.ndarray, Info]:
        """A new episode."""
        super().reset(seed=seed, options=options)
        offset = (self.np_random.uniform(-1.0, 1.0, 6) * self._offset).tolist()
        self._action[:] = 0.0
        self.episode = _Episode(self._scenario.replace({"initial_offset": offset}))
        return self._observe(), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, Info]:
        """Holds an action for `interval`."""
        self._action[:] = np.clip(action, -1.0, 1.0)
        reward, failed, over, figures = self._decide()
        return self._observe(), reward, failed, over, figures

    def _torque(self, _: Measurement, __: Setpoint, time: float) -> np.ndarray:
        needed = self._needed[round(time / self._scenario.plant.time_step)]
        return np.asarray(needed + self._limit * self._action)

    def _observe(self) -> np.ndarray:
        episode = self.episode
        reference = episode.reference
        error, rate = episode.error, episode.loop.measured[RATE] - reference[6:12]
        parts = (error, rate, reference[6:12], reference[12:])
        shown = np.concatenate([part * scale for part, scale in zip(parts, _SCALES, strict=True)])
        return np.clip(np.arcsinh(shown), -20.0, 20.0).astype(np.float32)


_DEG = np.degrees(1.0)
_SCALES = (
    np.repeat([_DEG, 1e3], 3),
    np.repeat([_DEG, 1e2], 3),
    np.repeat([_DEG, 1e2], 3),
    np.repeat([0.1 * _DEG, 10.0], 3),
)


class TuneEnvironment(_Environment):
    """The policy tunes the regulator of a loop with an observer, as `tuner: policy` does.

    Action: (4,) in [-1, 1], the setting (speed, damping, integral, disturbance) within the box of the shipped policy; 0
    is the best fixed setting. Observation: (13,) features, see `control.features`. An episode is a random situation by
    the seed: a push, a payload, noise, another motion. Its event is in the second half.

    Args:
        robots: Of `training.situations`.
        interval: [s] between two actions.
    """

    def __init__(self, robots: tuple[str, ...] = ("paper",), interval: float = 0.02) -> None:
        self.interval, self._robots, self.policy = interval, robots, Policy.load()
        self._target, self._features = self.policy.centre.copy(), np.zeros(len(FEATURES))
        self.action_space = spaces.Box(-1.0, 1.0, (4,), np.float32)
        self.observation_space = spaces.Box(-30.0, 30.0, (len(FEATURES),), np.float32)

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[np.ndarray, Info]:
        """A new situation."""
        super().reset(seed=seed, options=options)
        robot = str(self.np_random.choice(list(self._robots)))
        kind = str(self.np_random.choice(kinds_of(robot, trained=True)))
        drawn = situation(kind, robot, int(self.np_random.integers(TRAINING.start, TRAINING.stop)))
        self._target[:], self._features[:] = self.policy.centre, 0.0
        source = FunctionSource(self.policy, self._choose)
        self.episode = _Episode(tuned_by(source, drawn.replace({"plant.kind": "closed_form"})))
        return self._observe(), {"situation": drawn.name}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, Info]:
        """Holds a setting for `interval`; the tuner moves towards it by a small step per tick."""
        width = np.where(action < 0.0, self.policy.below, self.policy.above)
        self._target[:] = self.policy.centre + width * np.clip(action, -1.0, 1.0)
        reward, failed, over, figures = self._decide()
        return self._observe(), reward, failed, over, figures

    def _observe(self) -> np.ndarray:
        return np.clip(self._features, -30.0, 30.0).astype(np.float32)

    def _choose(self, features: np.ndarray, setting: np.ndarray) -> float:
        self._features[:], setting[:] = features, self._target
        return 1.0


for _name in ("Track", "Tune"):
    gymnasium.register(f"stewart_drake/{_name}-v0", f"{__name__}:{_name}Environment")
