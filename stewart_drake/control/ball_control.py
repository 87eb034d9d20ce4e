"""Balances a ball on the platform: an outer loop that tilts the reference.

Of each axis of the plate the ball's place and velocity follow from the tilt t, about P, by

    x'' = a t + b t'' + disturbance,    with a, b of `KnownBall.per_tilt`,

and the input is u = t'', so that the tilted reference has a consistent rate and acceleration, and the inner loop can
follow it exactly. Readings are old, and a tilt that is decided now acts later. So a tick has three steps:

1. Observe: place, velocity and disturbance at the time of the reading, by the steady Kalman filter of `kalman_gains`.
2. Look ahead: the model moves the ball to the time when this tick's decision acts, under the tilts decided before.
3. Decide: u = -K [place, velocity, tilt, its rate], errors from the target, by the discrete Riccati equation. The tilt
   that balances the disturbance takes the part of an integral. u keeps the tilt within its limits: it can always stop.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from pydantic import Field

from stewart_drake.base.config import NotNegative, Positive, Real, Section
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.jit import njit
from stewart_drake.base.records import Record, Vec2, Vec3, Vec4, Vec18, record
from stewart_drake.control.observer import kalman_gains
from stewart_drake.loop.part import LoopContext, Part
from stewart_drake.mechanics.rolling_ball import SLOW
from stewart_drake.references import AnyReference
from stewart_drake.references.motions import smoothstep
from stewart_drake.robot.gravity import Gravity, gravity_vector
from stewart_drake.robot.leg import Coordinate

MOST_TICKS = 200  # [ticks] from a reading to the time when the tilt decided from it acts.
PATIENCE = 10  # [readings] missing in a row, after which the plate goes level.
_STENCIL = 0.005  # [s] step of the differences that give the third and fourth derivative of a path.
Vec10 = Annotated[np.ndarray, (10,)]
Tilts = Annotated[np.ndarray, (MOST_TICKS + 2, 3, 2)]


HOLDS = "gravity within 45 deg of -z of the base, which holds the ball on the plate"


def holds_ball(gravity: Gravity) -> bool:
    """Whether a ball stays on a plate that is level in the base."""
    x, y, z = gravity_vector(gravity)
    return bool(0.0 < -z >= math.hypot(x, y))


class BallTarget(Section, key="ball_control.target"):
    """Where the ball is to be on the plate: at a place, on a circle about it, or on the path of a motion."""

    center: tuple[Coordinate, Coordinate] = (0.0, 0.0)
    """[m] x, y of the place, or of the circle's centre."""
    radius: NotNegative = 0.0
    """[m] of the circle; 0 for none."""
    turn_time: Positive = 4.0
    """[s] of a turn, anticlockwise; the first one is a spiral out of the centre."""
    begin: NotNegative = 0.0
    """[s] when the circle begins."""
    motion: AnyReference | None = None
    """A motion whose X and Y are added to the place, in m; null for none."""

    def evaluate(self, times: np.ndarray) -> np.ndarray:
        """Place (n, 10) [m], velocity, acceleration and two further derivatives, x and y each, at times (n,) [s]."""
        ahead, back = self._path(times + _STENCIL)[:, 2], self._path(times - _STENCIL)[:, 2]
        now = self._path(times)
        third, fourth = (ahead - back) / (2.0 * _STENCIL), (ahead + back - 2.0 * now[:, 2]) / _STENCIL**2
        return np.concatenate([*np.moveaxis(now, 1, 0), third, fourth], axis=1)

    def _path(self, times: np.ndarray) -> np.ndarray:
        """Place, velocity and acceleration (n, 3, 2)."""
        turns, rate = (times - self.begin) / self.turn_time, 2.0 * math.pi / self.turn_time
        grown, slope, bend = smoothstep(turns)
        size = self.radius * np.stack([grown, slope / self.turn_time, bend / self.turn_time**2])
        angle = 2.0 * math.pi * turns
        along, across = np.stack([np.cos(angle), np.sin(angle)]), np.stack([-np.sin(angle), np.cos(angle)])
        place = size[0] * along + np.array(self.center)[:, None]
        velocity = size[1] * along + rate * size[0] * across
        acceleration = size[2] * along + 2.0 * rate * size[1] * across - rate**2 * size[0] * along
        path = np.moveaxis(np.stack([place, velocity, acceleration]), 2, 0)
        if self.motion is not None:
            path = path + np.stack(self.motion.evaluate(times), axis=1)[:, :, 3:5]
        return path


class BallControlOptions(Section, key="ball_control"):
    """The loop that balances a ball by tilting the reference; its knowledge of the ball is `model.ball`."""

    target: BallTarget = Field(default_factory=BallTarget)
    """Where the ball is to be."""
    q_place: Positive = 600.0
    """[1/m^2] weight of the error of the ball's place in the quadratic cost."""
    q_velocity: NotNegative = 20.0
    """[s^2/m^2] weight of the error of its velocity."""
    q_tilt: NotNegative = 4.0
    """[1/rad^2] weight of the tilt."""
    q_rate: NotNegative = 0.1
    """[s^2/rad^2] weight of the tilt's rate."""
    r: Positive = 0.001
    """[s^4/rad^2] weight of the tilt's second derivative, the input."""
    disturbance: Annotated[Positive, Field(le=100.0)] = 0.1
    """[m/s^2 per sqrt(s)] expected change of the ball's unmodelled acceleration in a second; low is quiet, high is
    fast."""
    max_tilt: Annotated[Real, Field(gt=0.0, le=0.5)] = 0.14
    """[rad] largest tilt about either axis."""
    max_rate: Annotated[Positive, Field(le=100.0)] = 2.0
    """[rad/s] largest rate of either tilt."""
    max_acceleration: Annotated[Positive, Field(le=1e4)] = 30.0
    """[rad/s^2] largest second derivative of either tilt."""

    def part(self, context: LoopContext, preview: float) -> Part:
        """The loop as a part, whose tilt is part of a reference `preview` [s] ahead.

        From `ball_reading` (2,), `ball_target` (10,), `motion` (18,) and `motion_ahead` (18,), the reference of the
        robot now and ahead, to `reference` (18,) and `reference_ahead` (18,).
        """
        ball, period = context.ball, context.period
        assert ball is not None  # See `ControlOptions.rules`.
        if not holds_ball(context.gravity):
            raise ConfigurationError("model.gravity", context.gravity, HOLDS)
        tilt, bend = ball.per_tilt(-gravity_vector(context.gravity)[2])
        # A loop that is not ahead follows later.
        acts = max(preview, context.delay * period + context.motors.dead_time)
        every, age, late = ball.sensor.ticks(period), round(ball.sensor.delay / period), round(acts / period)
        if age + late > MOST_TICKS:
            allowed = f"at most {(MOST_TICKS - late) * period:g} s, {MOST_TICKS} ticks with the delay of commands"
            raise ConfigurationError("ball.sensor.delay", ball.sensor.delay, allowed)
        gains = kalman_gains(ball.sensor.noise, self.disturbance, every * period)
        params = BallParams.new(
            self,
            period=period,
            tilt=tilt,
            bend=bend,
            drag=ball.resistance * tilt,
            gain=self.gain(tilt, bend, period),
            observer=gains,
            age=age,
            late=late,
            ahead=preview / period,
            patience=(PATIENCE + 1) * every,
        )
        inputs = {"motion": 18, "motion_ahead": 18, "ball_reading": 2, "ball_target": 10}
        outputs = ("reference", "reference_ahead", "ball_estimate")
        # Where the base is tilted, gravity pulls from the beginning.
        first = BallState.new(disturbance=ball.mass / ball.rolling_mass * gravity_vector(context.gravity)[:2])
        return Part("ball_control", ball_tick, {}, inputs, outputs, first, parameters={"params": params})

    def extremes(self, motion: np.ndarray) -> dict[str, np.ndarray]:
        """Rows (m, 18) of a motion (n, 18), tilted as far, as fast and as hard as may be, by the key of the limit."""
        found, pairs = {}, np.array([(a, b) for a in (-1.0, 0.0, 1.0) for b in (-1.0, 0.0, 1.0) if a or b])
        for place, key in ((0, "max_tilt"), (6, "max_rate"), (12, "max_acceleration")):
            rows = np.repeat(motion, len(pairs), axis=0)
            rows[:, place : place + 2] += getattr(self, key) * np.tile(pairs, (len(motion), 1))
            found[key] = rows
        return found

    def gain(self, tilt: float, bend: float, period: float) -> np.ndarray:
        """K (4,) of u = -K [place, velocity, tilt, rate], for `per_tilt` numbers and a period [s]."""
        from scipy.linalg import expm, solve_discrete_are

        model = np.zeros((5, 5))  # With the input, which is constant within a period.
        model[0, 1] = model[2, 3] = model[3, 4] = 1.0
        model[1, 2], model[1, 4] = tilt, bend
        step = expm(period * model)[:4]
        a, b, q = step[:, :4], step[:, 4:], np.diag([self.q_place, self.q_velocity, self.q_tilt, self.q_rate])
        try:
            with np.errstate(all="ignore"):
                p = solve_discrete_are(a, b, q, np.array([[self.r]]))
                gain = np.linalg.solve(self.r + b.T @ p @ b, b.T @ p @ a)[0]
                stable = np.abs(np.linalg.eigvals(a - b * gain)).max() < 1.0
        except (ValueError, np.linalg.LinAlgError):
            stable = False
        if not stable:
            raise ConfigurationError("ball_control.r", self.r, "weights that lie closer together: no gain stabilises")
        return np.asarray(gain)


class BallParams(Record):
    """Parameters of `ball_tick`."""

    period: float  # [s]
    tilt: float  # [m/s^2] acceleration of the ball per rad of tilt.
    drag: float  # [m/s^2] deceleration by rolling resistance.
    bend: float  # [m] acceleration of the ball per rad/s^2 of the tilt's second derivative.
    gain: Vec4  # K.
    observer: Vec3  # Gains from the innovation to place [-], velocity [1/s] and disturbance [1/s^2].
    age: float  # [ticks] of a reading.
    late: float  # [ticks] from a decision to the time when the ball feels it.
    ahead: float  # [ticks] from a tick to the time of `reference_ahead`.
    patience: float  # [ticks] without a reading after which the plate goes level.
    max_tilt: float  # [rad]
    max_rate: float  # [rad/s]
    max_acceleration: float  # [rad/s^2]


class BallState(Record):
    """State of `ball_tick`; axis x is turned by pitch, axis y by roll backwards."""

    reference: Vec18  # Tilted, now.
    reference_ahead: Vec18  # Tilted, when the command of this tick acts.
    ball_estimate: Vec4  # [m, m/s] place and velocity of the ball when the decision of this tick acts.
    place: Vec2  # [m] estimate at the time of the latest reading, or when it would be.
    velocity: Vec2  # [m/s]
    disturbance: Vec2  # [m/s^2]
    tilts: Tilts  # [rad, rad/s, rad/s^2] by axis, at the beginning of ticks, newest decision first.
    missed: float  # [ticks] since the latest reading.
    started: float  # 1 once there was a reading.


@njit
def _roll(params: BallParams, place: float, velocity: float, force: float, tilt: Vec3) -> tuple[float, float]:
    """Place and velocity of the ball a tick later; `tilt` is the tilt at its beginning, its rate and acceleration."""
    h, t, w, u = params.period, tilt[0], tilt[1], tilt[2]
    pull = params.bend * u + force
    moved = params.tilt * (t / 2.0 + h * (w / 6.0 + h * u / 24.0)) + pull / 2.0
    gained = params.tilt * (t + h * (w / 2.0 + h * u / 6.0)) + pull
    return place + h * (velocity + h * moved), velocity + h * gained


@njit
def largest_bend(params: BallParams, tilt: float, rate: float) -> float:
    """Largest acceleration of a tilt after which it can still stop at `max_tilt`."""
    h, a = params.period, params.max_acceleration
    room = params.max_tilt - tilt - 0.5 * h * rate
    after = -0.5 * a * h + np.sqrt(max(0.0, (0.5 * a * h) ** 2 + 2.0 * a * room))
    return max(-a, min(a, (min(after, params.max_rate) - rate) / h))


@njit
def _tilted(motion: Vec18, tilts: Tilts, row: int, since: float, out: Vec18) -> None:
    """A reference with the tilt `since` [s] after the beginning of a row's tick."""
    for k in range(18):
        out[k] = motion[k]
    for axis in range(2):
        tilt, rate, bend = tilts[row, 0, axis], tilts[row, 1, axis], tilts[row, 2, axis]
        place, sign = 1 - axis, 1.0 if axis == 0 else -1.0
        out[place] += sign * (tilt + since * (rate + 0.5 * since * bend))
        out[6 + place] += sign * (rate + since * bend)
        out[12 + place] += sign * bend


@njit
def ball_tick(
    params: BallParams, motion: Vec18, motion_ahead: Vec18, ball_reading: Vec2, ball_target: Vec10, state: BallState
) -> None:
    """One tick, see above; a reading that is not finite is missing."""
    params, state = record(params), record(state)
    h, tilts, flight = params.period, state.tilts, int(params.age + params.late)
    read = np.isfinite(ball_reading[0]) and np.isfinite(ball_reading[1])
    state.missed = 0.0 if read else min(state.missed + 1.0, 1e9)
    seen = state.started > 0.0 and state.missed <= params.patience
    for row in range(flight + 1, 0, -1):
        for k in range(3):
            for axis in range(2):
                tilts[row, k, axis] = tilts[row - 1, k, axis]
    tilt = np.empty(3)
    # Rolling resistance of a ball that moves as its target does: a disturbance that need not be observed.
    speed = np.sqrt(ball_target[2] ** 2 + ball_target[3] ** 2 + SLOW**2)
    for axis in range(2):
        known = -params.drag * ball_target[2 + axis] / speed
        place, velocity, force = state.place[axis], state.velocity[axis], state.disturbance[axis] + known
        for k in range(3):
            tilt[k] = tilts[flight + 1, k, axis]
        place, velocity = _roll(params, place, velocity, force, tilt)
        if read and state.started == 0.0:
            place, velocity = ball_reading[axis], 0.0
        elif read:
            innovation = ball_reading[axis] - place
            place += params.observer[0] * innovation
            velocity += params.observer[1] * innovation
            force += params.observer[2] * innovation
        state.place[axis], state.velocity[axis], state.disturbance[axis] = place, velocity, force - known
        for row in range(flight, 0, -1):
            for k in range(3):
                tilt[k] = tilts[row, k, axis]
            place, velocity = _roll(params, place, velocity, force, tilt)
        state.ball_estimate[axis], state.ball_estimate[2 + axis] = place, velocity
        # The tilt at the beginning of this decision, and the one that the target needs.
        at = tilts[1, 0, axis] + h * (tilts[1, 1, axis] + 0.5 * h * tilts[1, 2, axis])
        rate, bend = tilts[1, 1, axis] + h * tilts[1, 2, axis], 0.0
        if seen or read:
            bend = ball_target[8 + axis] / params.tilt
            bend -= params.gain[0] * (place - ball_target[axis])
            bend -= params.gain[1] * (velocity - ball_target[2 + axis])
            bend -= params.gain[2] * (at - (ball_target[4 + axis] - force) / params.tilt)
            bend -= params.gain[3] * (rate - ball_target[6 + axis] / params.tilt)
        else:
            bend = -params.gain[2] * at - params.gain[3] * rate
        bend = max(min(bend, largest_bend(params, at, rate)), -largest_bend(params, -at, -rate))
        tilts[0, 0, axis], tilts[0, 1, axis], tilts[0, 2, axis] = at, rate, bend
    if read:
        state.started = 1.0
    back = np.ceil(params.ahead - 1e-9)
    _tilted(motion_ahead, tilts, 0, 0.0, state.reference_ahead[:])
    _tilted(motion, tilts, int(back), (back - params.ahead) * h, state.reference[:])
