"""Sensors: encoders on the motors, a sensor of the platform's pose, and how they fail."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from stewart_drake.config import Natural, NotNegative, Positive, PositivePair, Section, Seed, Vector6
from stewart_drake.hardware.faults import EncoderFault, Fault, PoseFault, Signal, tick_numbers
from stewart_drake.jit import fields, new_record, njit, record
from stewart_drake.part import Part, Setup
from stewart_drake.robot.leg import LARGEST
from stewart_drake.robot.robot_scale import LENGTH

_STREAM = 1  # Of random numbers, see `faults.tick_numbers`.


class SensorOptions(Section, key="sensors"):
    """Base of the options of sensors; wiring, safety and logs ask these, not which kind it is."""

    reading_size: ClassVar[int] = 12
    """Numbers in a reading: 6 angles of the cranks [rad], or 12 of pose [rad, m] and its rate."""
    kind: str
    """Kind of sensor."""
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

    def parts(self, setup: Setup) -> tuple[Part, ...]:  # noqa: ARG002 - exact readings need none
        """What makes of `plant_pose` or `crank_state` the signal `reading`; none where it is `plant_pose`."""
        return ()


class IdealSensors(SensorOptions):
    """Ideal sensors: exact pose and rate of the platform."""

    kind: Literal["ideal"] = "ideal"
    faults: tuple[PoseFault, ...] = ()
    """Faults of the sensor."""

    @property
    def exact(self) -> bool:
        return not self.faults

    def parts(self, setup: Setup) -> tuple[Part, ...]:
        if not self.faults:
            return ()
        return (faulty_sensor_part(self.faults, 12, setup.period).connected(reading="plant_pose"),)


class EncoderOptions(SensorOptions):
    """Motor encoders, and how the pose is computed from their readings."""

    reading_size: ClassVar[int] = 6
    kind: Literal["encoders"] = "encoders"
    resolution_bits: Annotated[Natural, Field(le=40)] = 17
    """Encoder resolution: 2 to the power of this, in counts per turn; 0 for encoders without steps."""
    offset: Vector6 = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    """[rad] homing error of each encoder: reading minus true angle."""
    noise: Annotated[NotNegative, Field(le=LARGEST)] = 0.0
    """[rad] standard deviation of each reading before it is rounded to counts; independent from tick to tick."""
    noise_seed: Seed = 0
    """Seed of the noise."""
    faults: tuple[EncoderFault, ...] = ()
    """Faults of the encoders, applied in order."""
    rate_cutoff: Positive | None = None
    """[Hz] corner frequency of the first-order low pass on crank rates, which are differences over one tick; null for
    none."""
    max_speed: Positive = 60.0
    """[rad/s] largest plausible crank speed; a reading that has moved faster is rejected."""
    max_step: Annotated[PositivePair, LENGTH] = (0.2, 0.05)
    """[rad, m] largest plausible step from the last pose, at first from the start; a pose beyond it is rejected, for
    Newton's method has found another assembly mode."""
    hold_ticks: Annotated[Natural, Field(le=1000)] = 10
    """Rejected readings in a row that the last good pose may replace before the run ends."""

    @cached_property
    def quantum(self) -> float:
        return 2.0 * math.pi / 2.0**self.resolution_bits if self.resolution_bits else 0.0

    @property
    def reading_noise(self) -> float:
        """Noise, and rounding to counts as noise."""
        return math.hypot(self.noise, self.quantum / math.sqrt(12.0))

    def parts(self, setup: Setup) -> tuple[Part, ...]:
        if not self.faults:
            return (encoder_part(self),)
        true = encoder_part(self).named(reading="true_reading")
        return true, faulty_sensor_part(self.faults, 6, setup.period).connected(reading="true_reading")

    def read(self, crank_angles: np.ndarray) -> np.ndarray:
        """Readings (..., 6) [rad] of angles: with the offset, rounded to whole counts; without noise and faults."""
        angles = crank_angles + np.array(self.offset)
        return np.rint(angles / self.quantum) * self.quantum if self.quantum > 0.0 else angles


_ENCODERS = fields(offset=6, noise=(), quantum=())  # [rad] each.
_ENCODER_STATE = fields(reading=6, ticks=())  # [rad], and ticks done, of which each has its own noise.


@njit
def _read(params: Any, drawn: Any, crank_state: Any, states: Any) -> None:
    """`EncoderOptions.read` for a tick of a loop, of true angles with noise for standard normal numbers (6,)."""
    setup, state = record(params), record(states)
    for k in range(6):
        angle = crank_state[k] + setup.offset[k] + setup.noise * drawn[k]
        state.reading[k] = np.rint(angle / setup.quantum) * setup.quantum if setup.quantum > 0.0 else angle
    state.ticks += 1.0


def encoder_part(options: EncoderOptions) -> Part:
    """Encoders without faults: `crank_state` (12,), angles [rad] and rates, -> `reading` (6,) [rad]."""
    params, initial = new_record(_ENCODERS, options), new_record(_ENCODER_STATE)
    if options.noise == 0.0:
        constants: dict[str, Any] = {"params": params, "drawn": np.zeros(6)}
        return Part("encoders", _read, constants, {"crank_state": 12}, ("reading",), initial)
    constants = {"params": params, "seed": options.noise_seed}
    return Part("encoders", _read_with_noise, constants, {"crank_state": 12}, ("reading",), initial)


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
