"""Sensors: encoders on the motors, a sensor of the platform's pose, and how they fail."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from stewart_drake.base.config import InOtherKinds, Natural, NotNegative, Section, Seed, Vector6
from stewart_drake.base.jit import fields, new_record, njit, record
from stewart_drake.hardware.faults import EncoderFault, Fault, PoseFault, Signal, tick_numbers
from stewart_drake.loop.part import Part
from stewart_drake.loop.user_parts import UserParts
from stewart_drake.robot.leg import LARGEST_SIZE

_STREAM = 1  # Of random numbers, see `faults.tick_numbers`.


class SensorOptions(Section, key="sensors"):
    """Base of the options of sensors; wiring, safety and logs ask these, not which kind it is."""

    reading: ClassVar[Any] = InOtherKinds("pose")
    """What a reading is: the six angles of the cranks [rad], or pose [rad, m] and its rate."""
    kind: str
    """Kind of sensor."""
    delay: Annotated[NotNegative, Field(le=1.0)] = 0.0
    """[s] age of a reading when the controller gets it, rounded to steps of the plant."""
    faults: tuple[Any, ...] = ()
    """Faults of the sensor."""

    @property
    def exact(self) -> bool:
        """Whether what the controller sees is the truth."""
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
        """What makes of `plant_pose` or `crank_state` the signal `reading` in a period [s]; none for `plant_pose`."""
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
    """Your own sensors: `parts(period)` returns parts that make of `plant_pose` or `crank_state` the signal `reading`.

    The period of the readings is in [s].
    """

    reading: Literal["angles", "pose"] = "pose"  # type: ignore[misc]
    """What a reading is: the six angles of the cranks [rad], or pose [rad, m] and its rate."""


_ENCODERS = fields(offset=6, noise=(), quantum=())  # [rad] each.
_ENCODER_STATE = fields(reading=6, ticks=())  # [rad], and ticks done, of which each has its own noise.


@njit
def _read(params: Any, drawn: Any, crank_state: Any, state: Any) -> None:
    """`EncoderOptions.read` for a tick of a loop, of true angles with noise for standard normal numbers (6,)."""
    params, state = record(params), record(state)
    for k in range(6):
        angle = crank_state[k] + params.offset[k] + params.noise * drawn[k]
        state.reading[k] = np.rint(angle / params.quantum) * params.quantum if params.quantum > 0.0 else angle
    state.ticks += 1.0


def encoder_part(options: EncoderOptions) -> Part:
    """Encoders without faults: `crank_state` (12,), angles [rad] and rates, -> `reading` (6,) [rad]."""
    numbers, inputs = {"params": new_record(_ENCODERS, options)}, {"crank_state": 12}
    initial = new_record(_ENCODER_STATE)
    if options.noise == 0.0:
        return Part("encoders", _read, {"drawn": np.zeros(6)}, inputs, ("reading",), initial, parameters=numbers)
    seed = {"seed": options.noise_seed}
    return Part("encoders", _read_with_noise, seed, inputs, ("reading",), initial, parameters=numbers)


def _read_with_noise(params: np.ndarray, seed: int, crank_state: np.ndarray, state: np.ndarray) -> None:
    _read(params, tick_numbers(seed, _STREAM, int(state["ticks"][0]), 6, normal=True), crank_state, state)


def faulty_sensor_part(faults: Sequence[Fault], size: int, period: float) -> Part:
    """A sensor that may fail: true `reading` (n,) and `time` (1,) [s] -> `reading` (n,), fault after fault."""
    late = tuple(fault.ticks_late(period) for fault in faults)
    # good: for each channel the last reading before it froze or began to count backwards. before: the true readings of
    # now and of the ticks before, newest first.
    kind = fields(reading=size, good=size, before=(1 + max(late, default=0), size), ticks=())

    constants, inputs = {"faults": faults, "late": late}, {"reading": size, "time": 1}
    return Part("faulty_sensor", _fail, constants, inputs, ("reading",), new_record(kind))


def _fail(
    faults: Sequence[Fault], late: Sequence[int], reading: np.ndarray, time: np.ndarray, state: np.ndarray
) -> None:
    good, before, now = state["good"][0], state["before"][0], reading.copy()
    if state["ticks"][0] == 0.0:
        # A sensor that fails from the start repeats what was there at the start.
        good[:] = before[:] = reading
    before[1:] = before[:-1].copy()
    before[0] = reading
    kept = np.zeros(len(reading), dtype=bool)
    for fault, ago in zip(faults, late, strict=True):
        if fault.spoil(Signal(now, float(time[0]), int(state["ticks"][0]), good, before[ago])):
            kept[fault.channels] |= fault.kinds[fault.kind].keeps
    good[~kept] = reading[~kept]
    state["reading"][0] = now
    state["ticks"] += 1.0
