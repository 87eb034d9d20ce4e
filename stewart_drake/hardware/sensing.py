"""What stands between the robot and its controller, outside of a Diagram."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np

from stewart_drake.hardware.command_link import standing_torque
from stewart_drake.robot import RobotParameters


class LoopSite(NamedTuple):
    """What sensors and estimators are made for.

    Attributes:
        robot: As the controller believes it to be.
        gravity: [m/s^2].
        period: [s] of the ticks.
        pose: (6,) [rad, m] at the start.
        pose_rate: (6,) [rad/s, m/s] likewise.
        still: (6,) [N m] at the motors until the first command arrives.
        delay: [ticks] of the commands.
        friction: [N m] largest break-away torque that the motors are believed to have.
        guarded: Whether a tick that fails does not end the run, see `sampling.ill`.
        compiled: See `Scenario.compiled`.
        levels: What the tuner makes of the disturbance that an observer expects: shares at the start, and the least.
    """

    robot: RobotParameters
    gravity: float
    period: float
    pose: np.ndarray
    pose_rate: np.ndarray
    still: np.ndarray
    delay: int = 0
    friction: float = 0.0
    guarded: bool = False
    compiled: bool = False
    levels: tuple[float, float] = (1.0, 1.0)

    @classmethod
    def of(cls, scenario: Any) -> LoopSite:
        """That of a scenario."""
        robot, friction = scenario.believed_robot, scenario.friction_compensation
        pose, rate = scenario.start()
        return cls(
            robot,
            scenario.gravity,
            scenario.controller.period,
            pose,
            rate,
            standing_torque(robot, pose, scenario.gravity),
            scenario.command_delay,
            0.0 if friction is None else max(friction.levels[1]),
            scenario.safety is not None and scenario.safety.failures,
            scenario.compiled,
            scenario.tuner.levels,
        )


class Sensing(Protocol):
    """Sensors in one run; made with their options and a `LoopSite`.

    Attributes:
        size: Entries of a reading: 6 angles of the cranks [rad], or 12 of pose [rad, m] and its rate.
        live: Whether they say what is there between ticks too.
        angles: (6,) [rad] last readings of encoders; None where there are none.
    """

    size: int
    live: bool
    angles: np.ndarray | None

    def __call__(self, time: float, tick: int, state: np.ndarray) -> np.ndarray:
        """A reading at a time [s] and tick, of the robot's state (36,), see `constants.CHAIN_STATE`."""


class Estimate(NamedTuple):
    """What an estimator says at a tick.

    Attributes:
        measurement: (12,) pose [rad, m] and its rate now.
        seen: (12,) likewise, what the controller gets.
        compensation: (6,) [N m] to be added to the command; None for none.
        innovation: (6,) [rad] readings less what was expected of them; None where nothing was.
    """

    measurement: np.ndarray
    seen: np.ndarray
    compensation: np.ndarray | None = None
    innovation: np.ndarray | None = None


class Estimating(Protocol):
    """An estimator in one run; made with its options, a `LoopSite`, the sensors' options and the size of a reading.

    Attributes:
        ahead: [ticks] of what the controller sees.
        live: Whether it passes on what is read between ticks too.
        surprise_scale: Of innovations, see `Observer.surprise_scale`; None where there are none.
        health: What was wrong in the last tick, see `sampling.ill`.
    """

    ahead: int
    live: bool
    surprise_scale: tuple[float, float] | None
    health: tuple[float, float]

    def __call__(
        self, time: float, reading: np.ndarray, sent: np.ndarray, reference: np.ndarray, disturbance: np.ndarray | None
    ) -> Estimate:
        """The estimate at a time [s].

        Args:
            time: [s].
            reading: Of the sensors.
            sent: (6,) [N m] the last command less what of it the friction takes.
            reference: (18,) now.
            disturbance: (1,) [rad/s^2 per sqrt(s)] to expect, of a tuner; None where no tuner says.
        """
