"""From readings to equations: filtered without lag, differentiated, thinned out, and one row of the model for each.

Angles and torques go through the same Butterworth filter of fourth order, forwards and backwards, so that neither its
lag nor what it takes off falls between them. Rates and accelerations are those of a quintic spline through the poses
that the filtered angles give. Where a crank turns slowly or back, its friction is anything between its two levels:
the motor's row has no say there, nor as far around as the filter smears.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.interpolate
import scipy.ndimage
import scipy.signal

from stewart_drake.errors import ConfigurationError, ForwardKinematicsError, UnreachablePoseError
from stewart_drake.identification.parameters import BODIES, COULOMB, GAIN, SIZE, VISCOUS, unit_robots
from stewart_drake.identification.recording import Recording
from stewart_drake.mechanics.dynamics import inverse_dynamics
from stewart_drake.mechanics.kinematics import crank_rates, forward_kinematics, inverse_kinematics, leg_geometry
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEGS

BANDWIDTH, ROWS_A_PERIOD = 15.0, 12.0
"""[Hz] at which the filter lets half of the amplitude through, and at least so many rows in one of its periods: what
encoders err by grows in accelerations with the power 2.5 of the bandwidth, and falls with the rows."""
SLOW = 0.05
"""[rad/s] of a crank below which its friction may stick."""
_OVERSAMPLING = 6.0
_SMEAR = 0.5
_EDGE = 2.0
_SHORTEST = 20.0
"""In periods of the bandwidth: rows a period, how far the filter smears, what the ends lose, what must be left."""
_HOMOTOPY = 4


@dataclass(frozen=True, eq=False)
class Samples:
    """n instants with six equations each.

    Torques [N m] filtered; `bodies` (n, 6, 14) per unit of the bodies' parameters; `known` what no parameter changes;
    `sign` of the cranks' `rates` [rad/s], filtered; `used` rows that have a say; `pieces` of the recordings; `step` [s]
    between instants, of which `repeats` lie in half a period of the filter.
    """

    time: np.ndarray
    torque: np.ndarray
    bodies: np.ndarray
    known: np.ndarray
    sign: np.ndarray
    rates: np.ndarray
    used: np.ndarray
    pieces: tuple[slice, ...]
    step: float
    repeats: float
    source: str

    def predicted(self, values: np.ndarray) -> np.ndarray:
        """Torques (n, 6) [N m] that logs of a robot with parameters (`SIZE`,) say."""
        friction = values[COULOMB] * self.sign + values[VISCOUS] * self.rates
        return np.exp(-values[GAIN]) * (self.bodies @ values[BODIES] + self.known + friction)

    def derivative(self, values: np.ndarray) -> np.ndarray:
        """Of `predicted` by the parameters, (n, 6, `SIZE`)."""
        slope = np.zeros((*self.torque.shape, SIZE))
        slope[..., BODIES] = self.bodies
        own = np.arange(LEGS)
        slope[:, own, COULOMB.start + own] = self.sign
        slope[:, own, VISCOUS.start + own] = self.rates
        slope *= np.exp(-values[GAIN])[:, None]
        slope[:, own, GAIN.start + own] = -self.predicted(values)
        return slope


def samples_of(guess: RobotParameters, recording: Recording, bandwidth: float | None = None) -> Samples:
    """Equations of a recording; what moves the robot should lie well below the filter's bandwidth [Hz].

    Raises:
        ConfigurationError: Too short; a bandwidth that the rows' rate does not carry; readings at which the robot
            cannot be.
    """
    time, rate, source = recording.time, recording.rate, recording.source
    if bandwidth is None:
        bandwidth = min(BANDWIDTH, rate / ROWS_A_PERIOD)
    if not 0.0 < bandwidth <= rate / 5.0:
        raise ConfigurationError(
            "bandwidth", bandwidth, f"above 0, at most {rate / 5.0:g} Hz, a fifth of the rows' rate"
        )
    length, least = time[-1] - time[0], (2.0 * _EDGE + _SHORTEST) / bandwidth
    if length < least:
        raise ConfigurationError(source, f"{length:.3g} s", f"at least {least:.3g} s of motion")
    sos = scipy.signal.butter(4, bandwidth, fs=rate, output="sos")

    def smooth(values: np.ndarray) -> np.ndarray:
        return np.asarray(scipy.signal.sosfiltfilt(sos, values, axis=0))

    even = np.linspace(time[0], time[-1], len(time))
    angles = smooth(recording.angles)
    rates = np.gradient(angles, even, axis=0)
    thin = max(1, int(rate / (_OVERSAMPLING * bandwidth)))
    rows = slice(None, None, thin)
    pose = poses_of(guess, angles[rows], source)
    motion = scipy.interpolate.make_interp_spline(even[rows], pose, k=5)
    torque = scipy.interpolate.make_interp_spline(even, smooth(recording.torque), k=3)
    at = even[rows]
    at = at[(at > at[0] + _EDGE / bandwidth) & (at < at[-1] - _EDGE / bandwidth)]
    middle = np.searchsorted(even, at - 0.5 / rate)
    smear = 2 * int(_SMEAR * rate / bandwidth) + 1
    # By what a crank's rate is at least around an instant; where it changes its sign, zero.
    slowest = np.maximum(
        scipy.ndimage.minimum_filter1d(rates, smear, axis=0), -scipy.ndimage.maximum_filter1d(rates, smear, axis=0)
    )
    exact = samples_of_motion(guess, at, (motion(at), motion(at, 1), motion(at, 2)), recording.gravity, source)
    return replace(
        exact,
        torque=torque(at - recording.lag),
        sign=smooth(np.sign(rates))[middle],
        used=slowest[middle] > SLOW,
        repeats=rate / (2.0 * bandwidth * thin),
    )


def samples_of_motion(
    guess: RobotParameters,
    time: np.ndarray,
    motion: tuple[np.ndarray, np.ndarray, np.ndarray],
    gravity: float,
    source: str = "motion",
) -> Samples:
    """Equations of a motion that is known exactly, as `Reference.evaluate` gives it at an even rate, without torques.

    The columns of the model are the exact inverse dynamics, asked once for each parameter of the bodies.
    """
    pose, rate, _ = motion
    *columns, known = (inverse_dynamics(robot, *motion, gravity) for robot in unit_robots(guess))
    speed = crank_rates(guess, leg_geometry(guess, pose), pose, rate)
    used, step = np.abs(speed) > SLOW, float(time[1] - time[0])
    torque, bodies = np.zeros_like(known), np.stack(columns, axis=-1)
    return Samples(time, torque, bodies, known, np.sign(speed), speed, used, (slice(0, len(time)),), step, 1.0, source)


def together(parts: Sequence[Samples]) -> Samples:
    """Several recordings as one."""
    ends = np.cumsum([0, *(len(part.time) for part in parts)]).tolist()
    arrays = ("time", "torque", "bodies", "known", "sign", "rates", "used")
    joined: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in arrays}
    return Samples(
        **joined,
        pieces=tuple(slice(start, end) for start, end in itertools.pairwise(ends)),
        step=max(part.step for part in parts),
        repeats=max(part.repeats for part in parts),
        source=", ".join(part.source for part in parts),
    )


def poses_of(guess: RobotParameters, angles: np.ndarray, source: str) -> np.ndarray:
    """Poses (n, 6) [rad, m] of crank angles (n, 6) [rad], followed from home in a few steps."""
    home = inverse_kinematics(guess, guess.home_pose)
    pose = np.broadcast_to(guess.home_pose, angles.shape)
    try:
        for share in np.linspace(0.0, 1.0, _HOMOTOPY + 1)[1:]:
            pose = forward_kinematics(guess, home + share * (angles - home), pose)
        off = inverse_kinematics(guess, pose) - angles
        stray = np.abs(np.arctan2(np.sin(off), np.cos(off))).max()
    except (ForwardKinematicsError, UnreachablePoseError) as failure:
        stray = failure
    if not isinstance(stray, float) or stray > 1e-6:
        allowed = "readings of the robot that is guessed, in radians or, by their columns' names, in degrees"
        raise ConfigurationError(source, "crank angles at which the robot cannot be assembled", allowed)
    return pose
