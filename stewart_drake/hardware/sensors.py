"""Sensors: encoders on the motors, a sensor of the platform's pose, and how they fail."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from stewart_drake.base.config import InOtherKinds, Natural, NotNegative, Section, Seed, Vector6
from stewart_drake.base.jit import njit
from stewart_drake.base.records import Record, Vec6, Vec12, record
from stewart_drake.hardware.faults import EncoderFault, PoseFault, faulty_sensor_part, tick_numbers
from stewart_drake.hardware.imu import SimulatedImu
from stewart_drake.loop.part import Part
from stewart_drake.loop.user_parts import UserParts
from stewart_drake.robot.leg import LARGEST_SIZE

_STREAM = 1  # Number of the stream of random numbers, see `faults.tick_numbers`.


class SensorOptions(Section, key="sensors"):
    """Base of the options of sensors: all that wiring, safety and logs ask of any kind."""

    reading: ClassVar[Any] = InOtherKinds("pose")
    """What a reading is: the six angles of the cranks [rad], or pose [rad, m] and its rate."""
    imu = InOtherKinds(None)
    """The inertial sensor on the platform; None for none."""
    kind: str
    """Kind of sensor."""
    delay: Annotated[NotNegative, Field(le=1.0)] = 0.0
    """[s] age of a reading when the controller gets it, rounded to steps of the plant."""
    faults: tuple[Any, ...] = ()
    """Faults of the sensor."""

    @property
    def exact(self) -> bool:
        """Whether readings are exact."""
        return False

    @property
    def quantum(self) -> float:
        """[rad] of a count, of sensors that read the cranks' angles; 0 for none."""
        return 0.0

    @property
    def reading_noise(self) -> float:
        """[rad] standard deviation of a crank's angle as it is read."""
        return 0.0

    def parts(self, period: float) -> tuple[Part, ...]:  # noqa: ARG002 - exact readings need none
        """Parts that compute `reading` from `plant_pose` or `crank_state` in a period [s]; none for `plant_pose`."""
        return ()


class IdealSensors(SensorOptions):
    """Ideal sensors: exact pose and rate of the platform."""

    kind: Literal["ideal"] = "ideal"
    faults: tuple[PoseFault, ...] = ()
    """Faults of the sensor."""

    @property
    def exact(self) -> bool:
        return not self.faults and self.delay == 0.0

    def parts(self, period: float) -> tuple[Part, ...]:
        if not self.faults:
            return ()
        return (faulty_sensor_part(self.faults, 12, period).connected(reading="plant_pose"),)


class EncoderOptions(SensorOptions):
    """Motor encoders."""

    moved_keys: ClassVar[Mapping[str, str]] = {
        name: f"estimator.{name}" for name in ("rate_cutoff", "max_speed", "max_step", "hold_ticks")
    }
    reading = "angles"
    kind: Literal["encoders"] = "encoders"
    resolution_bits: Annotated[Natural, Field(le=40)] = 17
    """Encoder resolution: 2 to the power of this, in counts per turn; 0 for encoders without steps."""
    offset: Vector6 = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    """[rad] homing error of each encoder: reading minus true angle."""
    noise: Annotated[NotNegative, Field(le=LARGEST_SIZE)] = 0.0
    """[rad] standard deviation of each reading before it is rounded to counts; independent from tick to tick."""
    noise_seed: Seed = 0
    """Seed of the noise."""
    faults: tuple[EncoderFault, ...] = ()
    """Faults of the encoders, applied in order."""
    imu: SimulatedImu | None = None
    """The inertial sensor on the platform; null for none."""

    @cached_property
    def quantum(self) -> float:
        return 2.0 * math.pi / 2.0**self.resolution_bits if self.resolution_bits else 0.0

    @property
    def reading_noise(self) -> float:
        """Noise, and rounding to counts as noise."""
        return math.hypot(self.noise, self.quantum / math.sqrt(12.0))

    def parts(self, period: float) -> tuple[Part, ...]:
        if not self.faults:
            return (encoder_part(self),)
        true = encoder_part(self).named(reading="true_reading")
        return true, faulty_sensor_part(self.faults, 6, period).connected(reading="true_reading")

    def read(self, crank_angles: np.ndarray) -> np.ndarray:
        """Readings (..., 6) [rad] of angles: with the offset, rounded to whole counts; without noise and faults."""
        angles = crank_angles + np.array(self.offset)
        return np.rint(angles / self.quantum) * self.quantum if self.quantum > 0.0 else angles


class UserSensors(UserParts, SensorOptions, key="sensors"):  # type: ignore[misc]
    """Your own sensors: `parts(period)` returns parts that compute `reading` from `plant_pose` or `crank_state`.

    The period of the readings is in [s].
    """

    gives = "reading"

    reading: Literal["angles", "pose"] = "pose"  # type: ignore[misc]
    """What a reading is: the six angles of the cranks [rad], or pose [rad, m] and its rate."""


class EncoderParams(Record):
    """Parameters of the encoders."""

    offset: Vec6  # [rad]
    noise: float  # [rad] standard deviation.
    quantum: float  # [rad] of a count; 0 for none.


class EncoderState(Record):
    """State of the encoders."""

    reading: Vec6  # [rad]
    ticks: float  # Done; the number of the next tick's noise.


@njit
def _read(params: EncoderParams, normal: Vec6, crank_state: Vec12, state: EncoderState) -> None:
    """Readings of a tick; `normal` are standard normal numbers."""
    params, state = record(params), record(state)
    for k in range(6):
        angle = crank_state[k] + params.offset[k] + params.noise * normal[k]
        state.reading[k] = np.rint(angle / params.quantum) * params.quantum if params.quantum > 0.0 else angle
    state.ticks += 1.0


def encoder_part(options: EncoderOptions) -> Part:
    """Encoders without faults: `crank_state` (12,), angles [rad] and rates, -> `reading` (6,) [rad]."""
    numbers, inputs, initial = {"params": EncoderParams.new(options)}, {"crank_state": 12}, EncoderState.new()
    if options.noise == 0.0:
        return Part("encoders", _read, {"normal": np.zeros(6)}, inputs, ("reading",), initial, parameters=numbers)
    seed = {"seed": options.noise_seed}
    return Part("encoders", _read_with_noise, seed, inputs, ("reading",), initial, parameters=numbers)


def _read_with_noise(params: EncoderParams, seed: int, crank_state: np.ndarray, state: EncoderState) -> None:
    _read(params, tick_numbers(seed, _STREAM, int(state["ticks"][0]), 6, normal=True), crank_state, state)
