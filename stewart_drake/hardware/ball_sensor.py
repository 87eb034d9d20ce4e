"""The sensor of a ball's place on the platform; it also tells when the ball has left the plate."""

from __future__ import annotations

import math

import numpy as np

from stewart_drake.base.errors import Status
from stewart_drake.base.records import Record, Vec2
from stewart_drake.hardware.faults import tick_numbers
from stewart_drake.hardware.motors import delay_part
from stewart_drake.loop.part import Part
from stewart_drake.mechanics.ball import BALL_FELL, BallOptions

_STREAM = 8  # Number of the stream of random numbers, see `faults.tick_numbers`.
_FELL, _ENDLESS = 1, 2  # Statuses.
_STATUSES = {
    _FELL: Status(
        BALL_FELL, text="the ball fell off the plate, whose rim is {options.plate.radius:g} m from its centre"
    ),
    _ENDLESS: Status("not_finite", "ball", text="the ball's motion"),
}


class BallReading(Record):
    """State of the sensor."""

    ball_reading: Vec2  # [m] NaN where there is no new reading.
    ticks: float  # Done.


def _sense(
    options: BallOptions, every: int, ball: np.ndarray, ball_seen: np.ndarray, state: BallReading
) -> tuple[int, int, float]:
    now, ticks = state["ball_reading"][0], int(state["ticks"][0])
    away = math.hypot(ball[0], ball[1])
    if not away <= options.plate.radius:
        return (_FELL if math.isfinite(away) else _ENDLESS), -1, away
    now[:] = np.nan
    if ticks % every == 0:
        normal = tick_numbers(options.sensor.noise_seed, _STREAM, ticks // every, 2, normal=True)
        now[:] = ball_seen[:2] + options.sensor.noise * normal
    state["ticks"] += 1.0
    return 0, -1, 0.0


def ball_parts(options: BallOptions, period: float, step: float) -> list[Part]:
    """Parts from the plant's `ball` (5,) to `ball_reading` (2,), for ticks of a period [s] and steps [s] of the plant.

    A reading is NaN where there is no new one.
    """
    late, first = round(options.sensor.delay / step), np.array([*options.start, *options.velocity, 0.0])
    constants, inputs = {"options": options, "every": options.sensor.ticks(period)}, {"ball": 5, "ball_seen": 5}
    outputs, state = ("ball_reading",), BallReading.new()
    part = Part("ball_sensor", _sense, constants, inputs, outputs, state, statuses=_STATUSES)
    if not late:
        return [part.connected(ball_seen="ball")]
    delay = delay_part(late, first, "ball_delay")._replace(period=step).connected(value="ball")
    return [delay.named(value="ball_seen"), part]
