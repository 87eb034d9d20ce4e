"""A plant and motors of a user's own, with what the model of a robot does not have, for `adaptation_study`."""

from __future__ import annotations

from typing import Any

import numpy as np

from stewart_drake.hardware.servos import PositionServos
from stewart_drake.plant.closed_form import ClosedForm, ClosedFormOptions
from stewart_drake.robot import RobotParameters


class LoadedFriction(ClosedForm):
    """The closed form, where a motor's dry friction grows by a share of the torque that it gives."""

    def __init__(self, robot: RobotParameters, gravity: float, share: float, options: dict[str, Any]) -> None:
        super().__init__(robot, ClosedFormOptions.from_dict(options), gravity)
        self.share, self.law = share, self._fixed[1]
        self.unloaded = self.law["coulomb"].copy()

    def initial(self, pose: np.ndarray, pose_rate: np.ndarray) -> tuple[np.ndarray, ...]:
        """As the closed form's."""
        return split(super().initial(pose, pose_rate))

    def step(self, torque: np.ndarray, wrench: np.ndarray) -> tuple[np.ndarray, ...]:
        """A step under these torques."""
        self.law["coulomb"] = self.law["break_away"] = self.unloaded + self.share * np.abs(torque)
        return split(super().step(torque, wrench))


def split(measured: np.ndarray) -> tuple[np.ndarray, ...]:
    """Pose, pose rate, crank angles and crank rates, (6,) each."""
    return tuple(measured.reshape(4, 6).copy())


class LateServos:
    """Servos on a bus that brings each command up to `jitter` [s] later than their `delay`, at random."""

    def __init__(
        self, robot: RobotParameters, time_step: float, servos: dict[str, Any], jitter: float, seed: int
    ) -> None:
        options = PositionServos.from_dict(servos)
        self.part, self.delay, self.jitter = options.part(robot, time_step), options.delay, jitter
        self.rng, self.state = np.random.default_rng([seed, 3]), self.part.initial.copy()
        self.under_way: list[tuple[float, np.ndarray]] = []
        self.sent = self.in_force = np.empty(0)

    def torque(self, command: np.ndarray, angles: np.ndarray, rates: np.ndarray, time: float) -> np.ndarray:
        """Torques (6,) [N m]; a command that differs from the one before is one that was sent."""
        if not len(self.sent):
            self.sent = self.in_force = command
        if (command != self.sent).any():
            self.sent = command
            self.under_way.append((time + self.delay + self.rng.uniform(0.0, self.jitter), command))
        while self.under_way and self.under_way[0][0] <= time:
            self.in_force = self.under_way.pop(0)[1]
        self.part.tick(self.in_force, np.concatenate([angles, rates]), self.state)
        return np.array(self.state["torque"][0])
