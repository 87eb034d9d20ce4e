"""The hand that holds, throws and puts back the ball of a live loop."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.control.ball_control import BallControlOptions
from stewart_drake.mechanics.ball import BallOptions
from stewart_drake.mechanics.kinematics import rotation_matrix
from stewart_drake.robot.gravity import gravity_vector
from stewart_drake.runs.scene import ball_links, rolled
from stewart_drake.scenario.scenario import Scenario

_BANDWIDTH = 40.0  # [rad/s] of the spring that holds the ball: it follows a mouse by 50 ms.
_STRONGEST = 20.0  # [m/s^2] largest acceleration by the hand.
_WITHIN = 0.95  # Of the plate's radius, that a hand may use.
_FASTEST = 5.0  # [m/s] largest change of velocity by a throw.
AWAY = 1.0  # [s] from the fall of a ball until it is let go again.
_THROWN = (0.25, 0.55)  # Speed of a random throw, as a share of the one that the steepest tilt can just stop.


class BallHand:
    """Forces on a ball: those of the scenario, of a spring to a held place, and of throws.

    Attributes:
        held: (2,) [m] place on the plate to which the ball is held; None if it is free.
        fell: [s] when it fell; None while it is on the plate.
        thrown: Time [s] and change of velocity [m/s] of the throws by hand.
        touched: Whether it was held by hand.
    """

    def __init__(self, ball: BallOptions, step: float) -> None:
        self._ball, self._step = ball, step
        self.held: np.ndarray | None = None
        self.fell: float | None = None
        self.thrown: list[tuple[float, list[float]]] = []
        self.touched = False
        self._throw = np.zeros(2)
        self._turn, self._seen = Rotation.identity(), np.array(ball.start)
        self._falling = np.zeros((2, 3))  # Place [m] and velocity [m/s] of the centre in B where it left the plate.

    def hold(self, place: np.ndarray) -> None:
        """Pulls the ball towards a place (2,) [m], or towards the last one on the plate on the way to it."""
        if self.fell is None:
            size = float(np.linalg.norm(place))
            self.held = place * min(1.0, _WITHIN * self._ball.plate.radius / size if size else 1.0)
            self.touched = True

    def let_go(self) -> None:
        """Leaves the ball alone, with its velocity."""
        if self.fell is None:
            self.held = None

    def throw(self, velocity: np.ndarray, time: float) -> None:
        """Changes the ball's velocity by (2,) [m/s] at once."""
        if (speed := float(np.linalg.norm(velocity))) > _FASTEST:
            raise ConfigurationError("speed of a throw", round(speed, 6), f"at most {_FASTEST:g} m/s")
        if self.fell is None:
            self._throw = self._throw + velocity
            self.thrown.append((time, velocity.tolist()))

    def put_back(self, time: float, pose: np.ndarray, rate: np.ndarray, motion: np.ndarray) -> None:
        """Takes a ball that fell at a time [s], with a motion (5,), and holds it for `AWAY` at its target."""
        turn, centre = rotation_matrix(pose[:3]), ball_links(self._ball, pose, motion[:2])[0, :3]
        self._falling = np.stack([centre, rate[3:] + turn[:, :2] @ motion[2:4]])
        self.fell, self._seen, self._throw = time, np.array(self._ball.start), np.zeros(2)

    def force(self, scenario: Scenario, time: float, motion: np.ndarray) -> np.ndarray:
        """Force (2,) [N] in the step of the plant that begins at a time [s]; to be called once for each step."""
        if self.fell is not None:
            back = time >= self.fell + AWAY
            self.fell, self.held = (None, None) if back else (self.fell, ball_target(scenario, time))
        ball, pull = self._ball, np.zeros(2)
        if self.held is not None:
            pull = _BANDWIDTH**2 * (self.held - motion[:2]) - 2.0 * _BANDWIDTH * motion[2:4]
            pull *= min(1.0, _STRONGEST / max(float(np.linalg.norm(pull)), 1e-9))
        total = ball.rolling_mass * pull + ball.force(self._throw, self._step)
        self._throw = np.zeros(2)
        return total + ball.thrown(np.array([time]), self._step)[0] if ball.throws else total

    def drawn(self, scenario: Scenario, time: float, pose: np.ndarray, motion: np.ndarray) -> np.ndarray:
        """Poses (2, 7) of ball and target, see `runs.scene.ball_links`; a ball that fell flies for `AWAY`."""
        self._turn = rolled(motion[:2] - self._seen, self._ball.radius) * self._turn
        self._seen = motion[:2].copy()
        links = ball_links(self._ball, pose, motion[:2], ball_target(scenario, time), self._turn)
        if self.fell is not None:
            since, (place, velocity) = time - self.fell, self._falling
            links[0, :3] = place + since * velocity + 0.5 * since**2 * gravity_vector(scenario.gravity_in_base)
        return links


def ball_target(scenario: Scenario, time: float) -> np.ndarray:
    """(2,) [m] target of the ball at a time [s]; the centre if nothing balances it."""
    control = scenario.ball_control
    return np.zeros(2) if control is None else control.target.evaluate(np.array([time]))[0, :2]


def about_ball(scenario: Scenario) -> dict[str, object] | None:
    """The ball for the page: sizes [m], and the speeds [m/s] of a random throw."""
    if (ball := scenario.ball) is None:
        return None
    steepest = (scenario.ball_control or BallControlOptions()).max_tilt
    fastest = np.sqrt(2.0 * 9.81 * ball.mass / ball.rolling_mass * steepest * ball.plate.radius)
    return {
        "radius": ball.radius,
        "plate": ball.plate.radius,
        "height": ball.plate.height,
        "throw": [share * fastest for share in _THROWN],
        "balanced": scenario.ball_control is not None,
    }
