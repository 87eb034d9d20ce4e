"""What the controller knows of an inertial sensor on the platform."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.records import Mat3, Record, Vec3, Vec6
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY

if TYPE_CHECKING:
    from stewart_drake.hardware.imu import ImuOptions

MOST_TICKS = 20  # [ticks] by which inertial readings may be older or newer than those of the angles.
# [-] standard deviation of inertial readings in the filter, over that of the sensor. The white noise of a chain damps
# the loop and does not occur, so the model is better than the filter believes. Without this factor slow noise of the
# accelerometers would move the platform more than that of the encoders: breathing at 17 bits by 4.3 instead of 2 um.
CAUTION = 10.0


class ImuModel(Record):
    """What the controller knows of the inertial sensor."""

    mounting: Mat3  # R_PS
    position: Vec3  # [m] in P.
    variance: Vec6  # [rad^2/s^2, m^2/s^4] of a reading, with `CAUTION`.
    drift: Vec6  # [rad^2/s^2, m^2/s^4] of the change of a bias in a tick.
    bias: Vec6  # [rad^2/s^2, m^2/s^4] of a bias at the start.
    range: Vec6  # [rad/s, m/s^2] readings that are not below it are ignored.
    scale_error: float  # [-] standard deviation of the relative errors of scale.
    lag: float  # [ticks] by which the end of a reading's period is older than the reading of the angles, whole ones.
    ticks: float  # [ticks] of which a reading is the mean, at least 1.
    rest: float  # [s] by which the middle of the reading's share in a tick is older than the end of that tick.
    early: float  # [ticks] for which a reading waits for that of the angles.


def imu_model(options: ImuOptions, period: float, reading_age: float) -> ImuModel:
    """For an observer's `period` [s], and angles that are `reading_age` [s] old."""
    every = options.period or period
    late = (options.delay - reading_age) / period
    early, ticks = max(0, math.ceil(-late - 1e-9)), max(1, round(every / period))
    lag = math.floor(late + early + 1e-9)
    if ticks > MOST_TICKS:
        allowed = f"at most {MOST_TICKS * period:g} s, {MOST_TICKS} of an observer's ticks; or estimator.imu false"
        raise ConfigurationError("model.imu.period", every, allowed)
    if max(early, lag + ticks) > MOST_TICKS:
        allowed = f"an age within {MOST_TICKS * period:g} s of that of the angles, {MOST_TICKS} of an observer's ticks"
        raise ConfigurationError("model.imu.delay", options.delay, allowed)
    bias = np.square(options.by_channel("bias"))
    bias[3:] += (options.scale_error * STANDARD_GRAVITY) ** 2
    return ImuModel.new(
        mounting=options.mounting,
        position=options.position,
        variance=CAUTION**2 * (np.square(options.noise(every)) + np.square(options.quantum) / 12.0),
        drift=np.square(options.by_channel("drift")) * period,
        bias=bias,
        range=options.by_channel("range") - options.quantum,
        scale_error=options.scale_error,
        lag=lag,
        ticks=ticks,
        rest=max(0.0, late + early - lag) * period + 0.5 * min(every, period),
        early=early,
    )
