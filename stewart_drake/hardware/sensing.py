"""What stands between the robot and its controller, outside of a Diagram."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from stewart_drake.robot import RobotParameters


class SensorSite(NamedTuple):
    """What sensors and estimator are made for.

    Attributes:
        robot: As the controller believes it to be.
        period: [s] of the ticks.
        pose: (6,) [rad, m] at the start.
        pose_rate: (6,) [rad/s, m/s] likewise.
        guarded: Whether a tick that fails does not end the run, see `sampling.ill`.
        compiled: See `Scenario.compiled`.
    """

    robot: RobotParameters
    period: float
    pose: np.ndarray
    pose_rate: np.ndarray
    guarded: bool = False
    compiled: bool = False


class Sensing(Protocol):
    """Sensors and what estimates from them, in one run.

    Attributes:
        angles: (6,) [rad] last readings of encoders; None where there are none.
        health: What was wrong in the last tick, see `sampling.ill`.
        live: Whether it says what is there between ticks too.
    """

    angles: np.ndarray | None
    live: bool
    health: tuple[float, float]

    def __call__(
        self, time: float, tick: int, state: np.ndarray, command: np.ndarray, reference: np.ndarray
    ) -> np.ndarray:
        """What the controller sees at a tick.

        Args:
            time: [s].
            tick: 0, 1, ...
            state: (36,) of the robot, see `constants.CHAIN_STATE`.
            command: (6,) [N m] of the tick before.
            reference: (18,) now.

        Returns:
            (12,) pose [rad, m], pose rate [rad/s, m/s].
        """
