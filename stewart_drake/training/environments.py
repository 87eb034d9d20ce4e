"""Gymnasium environments on the fast engine: a policy gives torques, tunes, or balances a ball. Extra `gym`.

Importing this module registers `stewart_drake/Track-v0`, `Tune-v0` and `Ball-v0` for `gymnasium.make`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from stewart_drake.base.atomic_files import Document
from stewart_drake.base.errors import ConfigurationError, RunFailure, installed_with
from stewart_drake.base.records import record
from stewart_drake.base.sampling import times_of
from stewart_drake.control.ball_control import BallControlOptions, BallParams, largest_bend
from stewart_drake.control.base import Measurement, Setpoint
from stewart_drake.control.features import FEATURES, CostScales, cost
from stewart_drake.control.policy import Policy
from stewart_drake.mechanics.dynamics import inverse_dynamics
from stewart_drake.plant.plant_options import BALL, RATE
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

    def __init__(self, scenario: Scenario, sources: Mapping[str, Callable[[int], np.ndarray]] | None = None) -> None:
        self.scenario, self.loop = scenario, SteppedLoop(scenario, sources=sources)
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


class BallEnvironment(_Environment):
    """The policy balances a ball on the platform by the rates of its tilt; the scenario's controller follows them.

    Action: (2,) in [-1, 1], rates of the tilts that accelerate the ball along x and y of the plate, relative to
    `ball_control.max_rate`; they are reached within `interval`, as far as the scenario's `ball_control` lets tilt, rate
    and acceleration go. Observation: (10,) place, velocity in a second, target, relative to the plate's radius, tilt
    and its rate relative to their limits, x and y each. Reward: 1 minus the distance from the target in radii, minus a
    hundredth of the squared action. A ball that falls ends an episode. Place, velocity and target are drawn.

    Args:
        scenario: A scenario with a ball, its file or its name; its motion and throws are not used.
        duration: [s] of an episode.
        interval: [s] between two actions.
    """

    def __init__(self, scenario: Scenario | str | Path = "ball", duration: float = 5.0, interval: float = 0.02) -> None:
        loaded = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
        if loaded.ball is None:
            raise ConfigurationError("ball", None, "a section: the policy balances a ball")
        self.limits = loaded.ball_control or BallControlOptions()
        still: Info = {"reference": "hold", "ball_control": None, "ball.throws": [], "plant.kind": "closed_form"}
        self._scenario, self._plate = loaded.replace({**still, "duration": duration}), loaded.ball.plate.radius
        step = loaded.plant.time_step
        self.interval, self._home = (
            step * max(1, round(interval / step)),
            np.concatenate(loaded.reference.evaluate(0.0)[:1] + (np.zeros(12),)),
        )
        self._params = record(BallParams.new(self.limits, **dict.fromkeys(_UNUSED, 0.0), period=self.interval))
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.observation_space = spaces.Box(-20.0, 20.0, (10,), np.float32)

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[np.ndarray, Info]:
        """A ball elsewhere, which rolls, and another target."""
        super().reset(seed=seed, options=options)
        place, velocity, self.target = self.np_random.uniform(-0.35, 0.35, (3, 2)) * self._plate
        start = {"ball.start": place.tolist(), "ball.velocity": velocity.tolist()}
        self.tilt = np.zeros((3, 2))  # [rad, rad/s, rad/s^2] by axis, at the latest decision.
        self._decided, preview = 0, self._scenario.preview
        sources = {"reference": lambda step: self._tilted(step, 0.0)}
        if preview > 0.0:
            sources["reference_ahead"] = lambda step: self._tilted(step, preview)
        self.episode = _Episode(self._scenario.replace(start), sources)
        return self._observe(), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, Info]:
        """Changes the rates of tilt, evenly within `interval`."""
        chosen = np.clip(np.asarray(action, float), -1.0, 1.0)
        self._decided, self.tilt = self.episode.loop.now, self._after(self.interval)
        for axis in range(2):
            tilt, rate = self.tilt[:2, axis]
            wanted = (chosen[axis] * self.limits.max_rate - rate) / self.interval
            most, least = largest_bend(self._params, tilt, rate), -largest_bend(self._params, -tilt, -rate)
            self.tilt[2, axis] = max(min(wanted, most), least)
        _, failed, over, figures = self._decide()
        away = float(np.linalg.norm(self.episode.loop.measured[BALL][:2] - self.target))
        reward = 0.0 if failed else 1.0 - away / self._plate - 0.01 * float(chosen @ chosen)
        return self._observe(), reward, failed, over, {**figures, "away_mm": 1e3 * away}

    def _after(self, time: float) -> np.ndarray:
        """`tilt` a time [s] after the latest decision; beyond `interval` it goes on at its rate."""
        within = min(time, self.interval)
        tilt, rate, bend = self.tilt
        tilt, rate = tilt + within * (rate + 0.5 * within * bend), rate + within * bend
        return np.stack([tilt + (time - within) * rate, rate, bend if time < self.interval else np.zeros(2)])

    def _tilted(self, step: int, ahead: float) -> np.ndarray:
        """The reference (18,): a tilt along x is a pitch, one along y a roll backwards."""
        along, row = self._after((step - self._decided) * self._scenario.plant.time_step + ahead), self._home.copy()
        row[1::6] += along[:, 0]
        row[0::6] -= along[:, 1]
        return row

    def _observe(self) -> np.ndarray:
        ball, tilt = self.episode.loop.measured[BALL][:4] / self._plate, self._after(self.interval)
        limits = tilt[0] / self.limits.max_tilt, tilt[1] / self.limits.max_rate
        shown = np.concatenate([ball, self.target / self._plate, *limits])
        return np.clip(shown, -20.0, 20.0).astype(np.float32)


_UNUSED = ("tilt", "drag", "bend", "gain", "observer", "age", "late", "ahead", "patience")

for _name in ("Track", "Tune", "Ball"):
    gymnasium.register(f"stewart_drake/{_name}-v0", f"{__name__}:{_name}Environment")
