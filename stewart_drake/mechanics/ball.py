"""A ball on the platform: what it is, where it starts, who throws it, and how its sensor sees it.

A plate is fixed to the platform, across the z axis of P. Places on it are x, y [m] in P.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from stewart_drake.base.config import Flag, NotNegative, Period, Positive, Real, Section, Seed, Share, Text
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.families import Table
from stewart_drake.base.sampling import steps_per
from stewart_drake.mechanics.rolling_ball import Ball
from stewart_drake.robot.leg import LARGEST_SIZE, Coordinate
from stewart_drake.robot.robot_scale import LENGTH

Pair = tuple[Coordinate, Coordinate]
BALL_FELL = "ball_fell"
"""Reason of a run that ended when the ball left the plate."""

# Steel of 7850 kg/m^3; ITTF, The Laws of Table Tennis, 2.3: 40 mm, 2.7 g.
BALLS: dict[str, dict[str, float]] = {
    "steel": {},
    "table_tennis": {"mass": 0.0027, "hollow": True, "resistance": 0.01},
}
# Assumed: a resistive touch screen read at 100 Hz, and a camera of 50 frames a second above the plate.
SENSORS: dict[str, dict[str, float]] = {"touch": {}, "camera": {"period": 0.02, "delay": 0.04, "noise": 0.001}}


class BallPlate(Section, key="ball.plate"):
    """The plate that a ball rolls on."""

    height: Coordinate = 0.0
    """[m] of the plate's surface over P, along the z axis of P."""
    radius: Annotated[Positive, Field(le=LARGEST_SIZE), LENGTH] = 0.15
    """[m] of the plate; a ball beyond it falls, and ends the run. The default scales with the robot."""


class BallSensor(Section, key="ball.sensor"):
    """The sensor of the ball's place on the plate."""

    preset: Annotated[Text, Table(dict(SENSORS))] | None = None
    """A usual sensor, which sets the defaults of the other keys: touch for a touch screen, camera."""
    period: Period = 0.01
    """[s] between two readings, a multiple of the controller's period; a shorter one has no effect."""
    delay: Annotated[NotNegative, Field(le=0.5)] = 0.0
    """[s] age of a reading when the controller gets it."""
    noise: Annotated[Positive, Field(le=1.0)] = 0.0003
    """[m] standard deviation of each coordinate."""
    noise_seed: Seed = 0
    """Seed of the noise."""

    @model_validator(mode="before")
    @classmethod
    def _with_preset(cls, data: object) -> object:
        return _preset(cls, SENSORS, data)

    def ticks(self, period: float) -> int:
        """Ticks of a controller's period [s] between two readings."""
        return steps_per("ball.sensor.period", max(self.period, period), period, "controller.period")


class Throw(Section, key="ball.throws"):
    """A blow that changes the ball's velocity at once."""

    time: NotNegative
    """[s] when."""
    velocity: Pair
    """[m/s] change of the velocity along x and y of the plate, of a ball that rolls."""


class KnownBall(Section, key="model.ball"):
    """A ball as the controller knows it."""

    preset: Annotated[Text, Table(dict(BALLS))] | None = None
    """A usual ball of 40 mm, which sets the defaults of the other keys: steel, table_tennis."""
    mass: Annotated[Real, Field(ge=1e-6, le=1e4)] = 0.263
    """[kg]"""
    radius: Annotated[Real, Field(ge=1e-3, le=10.0)] = 0.02
    """[m]"""
    hollow: Flag = False
    """Whether all of its mass is in its surface."""
    resistance: Share = 0.001
    """[-] coefficient of rolling resistance; the presets' are assumed."""
    plate: BallPlate = Field(default_factory=BallPlate)
    """The plate that it rolls on."""
    sensor: BallSensor = Field(default_factory=BallSensor)
    """The sensor of its place."""

    @model_validator(mode="before")
    @classmethod
    def _with_preset(cls, data: object) -> object:
        return _preset(cls, BALLS, data)

    @property
    def inertia(self) -> float:
        """[kg m^2] about its centre."""
        return (2.0 / 3.0 if self.hollow else 0.4) * self.mass * self.radius**2

    @property
    def rolling_mass(self) -> float:
        """[kg] its mass, and its rotation as mass."""
        return self.mass + self.inertia / self.radius**2

    def per_tilt(self, gravity: float) -> tuple[float, float]:
        """Acceleration [m/s^2] of the ball per rad of tilt, and per rad/s^2 of its second derivative.

        The plate turns about P, gravity is in [m/s^2].
        """
        arm = self.mass * (self.plate.height + self.radius) + self.inertia / self.radius
        return self.mass * gravity / self.rolling_mass, -arm / self.rolling_mass


class BallOptions(KnownBall, key="ball"):
    """A ball that rolls on the platform."""

    friction: Annotated[Positive, Field(le=10.0)] = 0.5
    """[-] coefficient of sliding friction; where plant.kind is drake the ball may slip, else it never does."""
    start: Pair = (0.0, 0.0)
    """[m] x, y of its centre at the start."""
    velocity: Pair = (0.0, 0.0)
    """[m/s] of its centre on the plate at the start."""
    throws: tuple[Throw, ...] = ()
    """Blows that it gets."""

    def rules(self) -> None:
        """It starts on the plate."""
        if math.hypot(*self.start) >= self.plate.radius:
            allowed = f"a place on the plate, less than {self.plate.radius:g} m from its centre"
            raise ConfigurationError("start", self.start, allowed)

    @property
    def known(self) -> KnownBall:
        """The ball as a controller knows it that knows all of it."""
        names = KnownBall.__pydantic_fields__
        return KnownBall(**{name: getattr(self, name) for name in names})

    def record(self) -> Ball:
        """Numbers for `mechanics.rolling_ball`."""
        return Ball.new(self, inertia=self.inertia, height=self.plate.height, push=0.0)

    def force(self, velocity: np.ndarray | Pair, step: float) -> np.ndarray:
        """Force (..., 2) [N] that changes the velocity by so much [m/s] in a step [s] of the plant."""
        return self.rolling_mass / step * np.asarray(velocity)

    def thrown(self, times: np.ndarray, step: float) -> np.ndarray:
        """Force (n, 2) [N] of the throws in the plant's steps [s] that begin at times (n,) [s]."""
        forces = np.zeros((len(times), 2))
        for throw in self.throws:
            # The first step that begins at the throw's time or later.
            forces[np.rint(times / step) == math.ceil(throw.time / step - 1e-6)] += self.force(throw.velocity, step)
        return forces


def _preset(section: type[Section], presets: Mapping[str, Mapping[str, float]], data: object) -> object:
    """The keys of a section, and those of its preset that it has."""
    if not isinstance(data, dict) or not isinstance(name := data.get("preset"), str):
        return data
    return {key: value for key, value in presets.get(name, {}).items() if key in section.__pydantic_fields__} | data
