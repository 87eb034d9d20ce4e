"""A base that is tilted or moves, and the sensor of its motion.

The robot is described in the frame B of its base. W is the world with z up, M the mean position of the base. Gravity
and the motion of B in M act on the robot through what an inertial unit on the base reads, `robot.gravity.base_reading`.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from pydantic import Field

from stewart_drake.base.config import NotNegative, Section, Seed
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.families import user_parts
from stewart_drake.base.jit import njit
from stewart_drake.base.records import Matrix, Record, Vec3, Vec12
from stewart_drake.hardware.faults import tick_numbers
from stewart_drake.hardware.motors import delay_part
from stewart_drake.loop.part import Part
from stewart_drake.mechanics.dynamics_laws import twists_of_motion
from stewart_drake.mechanics.kinematics_laws import rotation
from stewart_drake.references import AnyReference, RecordedReference
from stewart_drake.references.recorded import load_recording
from stewart_drake.robot.gravity import Gravity, Orientation, gravity_vector
from stewart_drake.robot.leg import LARGEST_SIZE

Noise = Annotated[NotNegative, Field(le=LARGEST_SIZE)]
_STREAM = 7  # Number of the stream of random numbers, see `faults.tick_numbers`.
_LATE = 0.01  # [s] Latest first time of a recording.


class BaseSensor(Section, key="base.sensor"):
    """An inertial unit on the base, with a filter that gives its attitude; the controller reads it."""

    attitude_noise: Noise = 0.0
    """[rad] standard deviation of roll, pitch and yaw."""
    rate_noise: Noise = 0.0
    """[rad/s] standard deviation of the angular velocity."""
    force_noise: Noise = 0.0
    """[m/s^2] standard deviation of the specific force."""
    acceleration_noise: Noise = 0.0
    """[rad/s^2] standard deviation of the angular acceleration."""
    delay: Annotated[NotNegative, Field(le=1.0)] = 0.0
    """[s] age of a reading when the controller gets it, rounded to steps of the plant."""
    noise_seed: Seed = 0
    """Seed of the noise."""


class BaseOptions(Section, key="base"):
    """Where the base of the simulated robot is: hanging or tilted, and in motion, as on a ship."""

    orientation: Orientation = (0.0, 0.0, 0.0)
    """[rad] roll, pitch, yaw of the base in the world, or of its mean position M where it moves; pi, 0, 0 hangs."""
    motion: AnyReference | None = None
    """Motion of the base in M, a kind of `reference`: sines, their sum, a recording that begins at t = 0, or yours.
    Poses are roll, pitch, yaw [rad] and x, y, z [m] of B; a constant position has no effect. null for rest."""
    sensor: BaseSensor | None = None
    """The sensor of the base's motion; null for none."""

    def rules(self) -> None:
        if getattr(self.motion, "kind", "") == "stream":
            raise ConfigurationError("motion", "stream", "another kind, as no stream moves a base")
        if self.sensor is not None and self.motion is None:
            raise ConfigurationError("sensor", "a sensor", "null, for a base at rest; or give its motion")

    def sensor_parts(self, gravity: Gravity, period: float, step: float) -> list[Part]:
        """Parts from `base_motion` (12,), see `base_signal`, to `base_reading` (12,); none without a sensor."""
        if (sensor := self.sensor) is None or self.motion is None:
            return []
        noise = sensor.attitude_noise, sensor.rate_noise, sensor.force_noise, sensor.acceleration_noise
        numbers = {"sigma": np.repeat(np.take(noise, [2, 1, 3, 0]), 3), "seed": sensor.noise_seed}
        first, late = base_signal(self.motion, gravity, np.zeros(1))[0], round(sensor.delay / step)
        initial, inputs = BaseReading.new(base_reading=first), {"base_motion": 12}
        part = Part("base_sensor", _read, numbers, inputs, ("base_reading",), initial, period=period)
        if late == 0:
            return [part]
        delay = delay_part(late, first, "base_delay")._replace(period=step).connected(value="base_motion")
        return [delay.named(value="late_base"), part.connected(base_motion="late_base")]

    def refuse_motion(self, what: str) -> None:
        """Refuses a base that moves, for something that needs one at rest."""
        if self.motion is not None:
            raise ConfigurationError("base.motion", "a motion", f"null, for {what}")

    def check(self, duration: float) -> None:
        """Refuses a recording that begins late, and angles in a run of a duration [s] that are probably in degrees."""
        if isinstance(self.motion, RecordedReference):
            first = float(load_recording(self.motion.motion_file)[0, 0]) * self.motion.time_scale
            if abs(first) > _LATE:
                allowed = "a recording whose first time is 0; subtract the first time from all of them"
                raise ConfigurationError("base.motion.motion_file", f"one that begins at {first:g} s", allowed)
        if self.motion is not None and not user_parts(self.motion):
            largest = float(np.abs(self.motion.evaluate(np.linspace(0.0, duration, 201))[0][:, :2]).max())
            if largest > math.pi:
                allowed = "roll and pitch [rad] within half a turn; in degrees?"
                raise ConfigurationError("base.motion", f"{largest:.4g} rad", allowed)


def base_signal(motion: AnyReference, gravity: Gravity, times: np.ndarray) -> np.ndarray:
    """(n, 12) reading of the base's inertial unit (9,), then roll, pitch, yaw [rad] of B in M, at times (n,) [s].

    `gravity` is that in M.
    """
    rows = np.concatenate(motion.evaluate(np.asarray(times, dtype=float)), axis=-1)
    signal = np.empty((len(rows), 12))
    _fill(gravity_vector(gravity), rows, signal)
    return signal


@njit
def _fill(gravity: Vec3, rows: Matrix, out: Matrix) -> None:
    turn, twist, twist_rate = np.empty((3, 3)), np.empty(6), np.empty(6)
    for n in range(len(rows)):
        rotation(rows[n, :3], turn)
        twists_of_motion(rows[n, :6], rows[n, 6:12], rows[n, 12:], twist, twist_rate)
        for k in range(3):
            out[n, k] = out[n, 3 + k] = out[n, 6 + k] = 0.0
            out[n, 9 + k] = rows[n, k]
            for m in range(3):
                out[n, k] += turn[m, k] * (twist_rate[3 + m] - gravity[m])
                out[n, 3 + k] += turn[m, k] * twist[m]
                out[n, 6 + k] += turn[m, k] * twist_rate[m]


class BaseReading(Record):
    """State of the sensor of the base."""

    base_reading: Vec12  # Specific force, angular velocity, angular acceleration; roll, pitch, yaw.
    ticks: float  # Done; the number of the next tick's noise.


def _read(sigma: np.ndarray, seed: int, base_motion: np.ndarray, state: BaseReading) -> None:
    """A reading of the base's motion, with noise."""
    normal = np.zeros(12) if not sigma.any() else tick_numbers(seed, _STREAM, int(state["ticks"][0]), 12, normal=True)
    state["base_reading"][0] = base_motion + sigma * normal
    state["ticks"] += 1.0
