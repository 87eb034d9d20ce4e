"""Regression equations for the 32 parameters of a robot, from logs of crank angles and motor torques.

There is one equation for every motor and instant,

    torque_i = exp(-gain_i) (Y_i(motion) bodies + coulomb_i sign(rate_i) + viscous_i rate_i)

The first fourteen parameters belong to the bodies. gain_i is the natural logarithm of the ratio of the true torque of
motor i to the logged one: an error of the amplifier or of the torque constant. Angles and torques are filtered alike.
An equation is left out while its crank turns slowly or reverses, and as long as the filter smears the reversal.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from stewart_drake.base.errors import ConfigurationError, ForwardKinematicsError, UnreachablePoseError
from stewart_drake.base.sampling import unwrapped
from stewart_drake.base.tables import CRANK_ANGLES
from stewart_drake.estimation import core
from stewart_drake.estimation.core import Parameter, Readings
from stewart_drake.logs.log import SimulationLog, load_log
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY, inverse_dynamics
from stewart_drake.mechanics.kinematics import crank_rates, forward_kinematics, inverse_kinematics, leg_geometry
from stewart_drake.mechanics.kinematics_laws import Robot, robot_record
from stewart_drake.robot import Gravity, RobotParameters
from stewart_drake.robot.leg import LEG_COUNT

_MOTORS = tuple(f"motor {leg}" for leg in range(LEG_COUNT))
PARAMETERS = (
    Parameter("platform_mass", "", "kg"),
    *(Parameter("platform_moment", axis, "kg m") for axis in "xyz"),
    *(Parameter("platform_inertia", axes, "kg m^2") for axes in ("xx", "yy", "zz", "xy", "xz", "yz")),
    Parameter("rod_mass", "", "kg"),
    Parameter("rod_inertia", "", "kg m^2"),
    Parameter("crank_mass", "", "kg"),
    Parameter("rotor_inertia", "", "kg m^2"),
    *(Parameter("coulomb", motor, "N m") for motor in _MOTORS),
    *(Parameter("viscous", motor, "N m s/rad") for motor in _MOTORS),
    *(Parameter("torque_constant", motor, "") for motor in _MOTORS),
)
"""`platform_moment` and `platform_inertia` are about the tool's point and along its axes, or those of P without a tool.
The inertia of a crank is not a parameter: the motion depends only on its sum with the rotor's inertia."""
KINDS = tuple(dict.fromkeys(parameter.kind for parameter in PARAMETERS))
SIZE = len(PARAMETERS)
BODIES, COULOMB, VISCOUS, GAIN = slice(0, 14), slice(14, 20), slice(20, 26), slice(26, 32)
MASS, MOMENT, INERTIA, ROD_MASS, ROD_INERTIA, CRANK_MASS, ROTOR = 0, slice(1, 4), slice(4, 10), 10, 11, 12, 13
ENTRIES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Row and column of the six `platform_inertia` parameters in the inertia matrix."""

UNEVEN = 0.1  # Largest deviation of a time step from the median step, as a share of it.
QUANTITIES = (("time", "s"), *CRANK_ANGLES, *((f"torque_{leg}", "N m") for leg in range(LEG_COUNT)))
BANDWIDTH = 15.0  # [Hz] frequency at which the filter halves the amplitude.
ROWS_A_PERIOD = 12.0  # Least number of rows in a period of the bandwidth.
SLOW = 0.05  # [rad/s] rate of a crank below which it may stick.
_OVERSAMPLING = 6.0  # Equations in a period of the bandwidth.
_SMEAR, _EDGE, _SHORTEST = 0.5, 2.0, 20.0
"""In periods of the bandwidth: how far the filter smears a reversal, what is cut off at both ends, the least length of
what is left."""
_HOMOTOPY = 4  # Steps from home to the first pose.


def values_of(robot: RobotParameters) -> np.ndarray:
    """Parameters (`SIZE`,) of a robot; friction and gains are zero, as for a frictionless robot with a correct log."""
    inertia = robot.platform_inertia_about_origin
    platform = [robot.platform_mass, *robot.platform_moment, *(inertia[at] for at in ENTRIES)]
    links = [robot.rod_mass, robot.rod_inertia[0], robot.crank_mass, robot.rotor_inertia]
    return np.array([*platform, *links, *[0.0] * 18])


def as_robot(guess: RobotParameters, values: np.ndarray) -> RobotParameters:
    """The guess with the body parameters of `values` (`SIZE`,); a robot has no keys for friction and gains."""
    mass = float(values[MASS])
    centre = values[MOMENT] / mass
    central = inertia_matrix(values) - mass * ((centre @ centre) * np.eye(3) - np.outer(centre, centre))
    # The keys of a robot are in P, the parameters in the tool's frame.
    central = guess.tool_rotation @ central @ guess.tool_rotation.T
    return guess.replace(
        platform_mass=mass,
        platform_center_of_mass=guess.tool_rotation @ centre + guess.tool_position,
        platform_inertia=np.diag(central),
        platform_products=[central[at] for at in ENTRIES[3:]],
        rod_mass=values[ROD_MASS],
        rod_inertia=(values[ROD_INERTIA], values[ROD_INERTIA], guess.rod_inertia[2]),
        crank_mass=values[CRANK_MASS],
        rotor_inertia=values[ROTOR],
    )


def inertia_matrix(values: np.ndarray) -> np.ndarray:
    """Inertia matrix (3, 3) of the platform from parameters, which are numbers or symbolic expressions."""
    xx, yy, zz, xy, xz, yz = values[INERTIA]
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _body_record(guess: RobotParameters, bodies: np.ndarray) -> Robot:
    """Record of the guess with other body parameters (14,), which need not be physically possible."""
    record, half = robot_record(guess).copy(), 0.5 * guess.crank_lengths
    record["platform_mass"], record["platform_moment"] = bodies[MASS], bodies[MOMENT]
    record["platform_tensor"] = inertia_matrix(bodies)
    record["rod_mass"], record["rod_inertia"], record["crank_mass"] = (
        bodies[ROD_MASS],
        bodies[ROD_INERTIA],
        bodies[CRANK_MASS],
    )
    record["crank_inertia"] = bodies[CRANK_MASS] * half * half + guess.crank_inertia[1] + bodies[ROTOR]
    return record


def scales(guess: RobotParameters) -> np.ndarray:
    """Scales (`SIZE`,) of the parameters: the guess for bodies, 1 % of the effort limit for friction, 0.1 for gains."""
    mass, length, effort = guess.platform_mass, guess.characteristic_length, float(guess.effort_limits.mean())
    platform = [mass, *[mass * length] * 3, *[mass * length**2] * 6]
    links = [guess.rod_mass, guess.rod_inertia[0], guess.crank_mass, float(guess.crank_axis_inertias.mean())]
    return np.array([*platform, *links, *[0.01 * effort] * 12, *[0.1] * 6])


def free_directions(hold: Collection[str]) -> np.ndarray:
    """Orthonormal directions (`SIZE`, k), in `scales`, in which the parameters may change.

    A heavier robot with stronger motors gives the same equations. So the mean of the torque constants is fixed, unless
    `hold` fixes the torque constants or the platform's mass.
    """
    mean_gain = np.zeros(SIZE)
    mean_gain[GAIN] = 1.0
    is_relative = "torque_constant" not in hold and "platform_mass" not in hold
    return core.free_directions(PARAMETERS, KINDS, hold, constraints=[mean_gain] if is_relative else [])


LOST_TICKS, LOST_SHARE = 6, 0.05
"""Longest gap that is filled [ticks], and largest share of filled rows."""


class CrankReadings(Readings):
    """Base of rows at a constant rate with `time` (n,) [s] and `angles` (n, 6) [rad] of the cranks."""

    largest: ClassVar = (300_000_000, 1_000_000)
    time: np.ndarray
    angles: np.ndarray
    gravity: Gravity

    def _fill(self) -> None:
        """Interpolates rows where a machine has lost some ticks; commands keep their last value."""
        steps = np.diff(self.time)
        rows = np.rint(steps / max(float(np.median(steps)), 1e-9)).astype(int)
        if not (rows >= 1).all() or rows.max() > LOST_TICKS or rows.sum() > (1.0 + LOST_SHARE) * len(rows):
            return
        place = np.concatenate([[0], np.cumsum(rows)])
        every, table = np.arange(place[-1] + 1), self.table
        filled = np.stack([np.interp(every, place, column) for column in table.T], axis=1)
        for name, column in self.columns.items():
            held = table[np.searchsorted(place, every, side="right") - 1] if name == "commands" else filled
            object.__setattr__(self, name, held[:, column])

    def check_cranks(self, *also: str) -> None:
        """Checks the rows, fills gaps and unwraps `angles` and the other angles (n, 6) [rad] that are named."""
        self.check()
        if len(self) < 2:
            raise ConfigurationError(self.source, f"{len(self)} rows", "some seconds of motion")
        self._fill()
        steps = np.diff(self.time)
        uneven = np.abs(steps - np.median(steps)) > UNEVEN * np.median(steps)
        if uneven.any() or np.median(steps) <= 0.0:
            row = int(uneven.argmax())
            got = f"{self.time[row]:g} s and then {self.time[row + 1]:g} s in row {row + 2}"
            raise ConfigurationError(f"{self.source}: time", got, "rows at a constant rate, without gaps")
        too_large = np.zeros(self.table.shape, dtype=bool)
        for name in ("angles", *also):
            too_large[:, self.columns[name]] = np.abs(getattr(self, name)) > 4.0 * math.pi
        allowed = "radians within +-4 pi; for degrees name the columns crank_angle_0_deg to crank_angle_5_deg"
        self.refuse(too_large, allowed)
        for name in ("angles", *also):
            object.__setattr__(self, name, unwrapped(getattr(self, name)))
            getattr(self, name).flags.writeable = False

    @property
    def rate(self) -> float:
        return (len(self) - 1) / float(self.time[-1] - self.time[0])


@dataclass(frozen=True, eq=False)
class Recording(CrankReadings):
    """n readings of six cranks and six torques at a constant rate, checked.

    Attributes:
        time: (n,) [s].
        angles: (n, 6) [rad] encoder readings; kept without jumps by whole turns, the first within half a turn.
        torque: (n, 6) [N m] as reported by the motors' amplifiers.
        lag: [s] from the time of a row to the middle of the interval in which its torque acts.
        gravity: [m/s^2].
        source: Name for messages, such as the file's name.

    Raises:
        ConfigurationError: Wrong shapes; a value that is not finite; angles beyond two turns; gaps in time; torques
            that are always zero.
    """

    time: np.ndarray
    angles: np.ndarray
    torque: np.ndarray
    lag: float = 0.0
    gravity: Gravity = STANDARD_GRAVITY
    source: str = "recording"

    quantities: ClassVar = QUANTITIES
    columns: ClassVar = {"time": 0, "angles": slice(1, 7), "torque": slice(7, 13)}

    def __post_init__(self) -> None:
        self.check_cranks()
        zero = (self.torque == 0.0).all(axis=0)
        if zero.any():
            raise ConfigurationError(f"{self.source}: torque_{zero.argmax()}", "0 in all rows", "measured torques")


def load_recording(path: str | Path, lag: float = 0.0) -> Recording:
    """A recording from a log of this package (.parquet, or a folder), or a CSV file with `QUANTITIES` and a lag [s]."""
    if Path(path).suffix.lower() != ".csv":
        return recording_of_log(load_log(path), f"log {path}")
    return Recording.of_file(path, f"recording {path}", lag=lag)


def recording_of_log(log: SimulationLog, source: str = "log") -> Recording:
    """Readings of encoders and amplifiers in a run."""
    motors = log.scenario.motors
    if motors.command_quantity != "torque":
        allowed = f"a log of motors that take torque: the torque of {motors.kind} motors changes between two rows; "
        allowed += "for motors that take angles use `identify_servos`"
        raise ConfigurationError(source, f"motors.kind {motors.kind}", allowed)
    rows, angles = readings_of_log(log, source)
    # A torque acts until the next tick. In a step of the plant, the acceleration is half a step ahead of its torque.
    lag = 0.5 * (log.scenario.controller.period - log.scenario.plant.time_step)
    return Recording(log.time[rows], angles, log["torque_applied"][rows], lag, log.scenario.gravity_in_base, source)


def readings_of_log(log: SimulationLog, source: str) -> tuple[slice, np.ndarray]:
    """Rows of a log that are ticks, and the angles (n, 6) [rad] that were read there."""
    log.scenario.base.refuse_motion("an identification: it takes the base for one at rest")
    if "reading" not in log:
        allowed = "a log with the angles that were read, the signal reading; run with sensors=encoders"
        raise ConfigurationError(source, f"sensors.kind {log.scenario.sensors.kind}", allowed)
    # Between two ticks nothing is read, and the command is held.
    rows = slice(None, None, max(1, round(log.scenario.controller.period / log.scenario.effective_log_period)))
    return rows, log["reading"][rows]


@dataclass(frozen=True, eq=False)
class Samples:
    """Equations of the motors at n instants."""

    time: np.ndarray  # (n,) [s]
    measured: np.ndarray  # (n, 6) [N m] torques, or angles [rad].
    columns: np.ndarray  # (n, 6, 26) [N m] torque for one unit of a parameter of bodies or friction.
    known: np.ndarray  # (n, 6) [N m] torque that does not depend on the parameters.
    rates: np.ndarray  # (n, 6) [rad/s] of the cranks.
    used: np.ndarray  # (n, 6) True for an equation that is used.
    pieces: tuple[slice, ...]  # Instants of a recording, for all recordings.
    step: float  # [s] between instants.
    repeats: float  # Instants in half a period of the filter: so many equations count as one.
    source: str

    def predicted(self, values: np.ndarray) -> np.ndarray:
        """Torques (n, 6) [N m] that a robot with parameters (`SIZE`,) would log."""
        return np.exp(-values[GAIN]) * (self.columns @ values[: GAIN.start] + self.known)

    def derivative(self, values: np.ndarray) -> np.ndarray:
        """Derivatives (n, 6, `SIZE`) of `predicted` with respect to the parameters."""
        by_gain = -self.predicted(values)[..., None] * np.eye(LEG_COUNT)
        return np.concatenate([np.exp(-values[GAIN])[:, None] * self.columns, by_gain], axis=-1)


def samples_of(guess: RobotParameters, recording: Recording, bandwidth: float | None = None) -> Samples:
    """Equations of a recording; the motion should be well below the filter's bandwidth [Hz]."""
    samples, smooth = filtered(guess, recording, bandwidth)
    return replace(samples, measured=smooth(recording.torque)(samples.time - recording.lag))


def filtered(
    guess: RobotParameters, recording: CrankReadings, bandwidth: float | None = None
) -> tuple[Samples, Callable[[np.ndarray], Callable[[np.ndarray], np.ndarray]]]:
    """Equations of a recording without torques, and a function that filters rows (n, 6) into a spline."""
    import scipy.interpolate
    import scipy.ndimage
    import scipy.signal

    time, rate, source = recording.time, recording.rate, recording.source
    if bandwidth is None:
        bandwidth = min(BANDWIDTH, rate / ROWS_A_PERIOD)
    if not 0.0 < bandwidth <= rate / 5.0:
        allowed = f"above 0, at most {rate / 5.0:g} Hz, a fifth of the rows' rate"
        raise ConfigurationError("bandwidth", bandwidth, allowed)
    length, least = time[-1] - time[0], (2.0 * _EDGE + _SHORTEST) / bandwidth
    if length < least:
        raise ConfigurationError(source, f"{length:.3g} s", f"at least {least:.3g} s of motion")
    sos = scipy.signal.butter(4, bandwidth, fs=rate, output="sos")

    def smooth(values: np.ndarray) -> np.ndarray:
        return np.asarray(scipy.signal.sosfiltfilt(sos, values, axis=0))

    even = np.linspace(time[0], time[-1], len(time))
    angles = smooth(recording.angles)
    rates = np.gradient(angles, even, axis=0)
    stride = max(1, int(rate / (_OVERSAMPLING * bandwidth)))
    motion = scipy.interpolate.make_interp_spline(even[::stride], poses_of(guess, angles[::stride], source), k=5)
    at = even[::stride]
    at = at[(at > at[0] + _EDGE / bandwidth) & (at < at[-1] - _EDGE / bandwidth)]
    middle = np.searchsorted(even, at - 0.5 / rate)
    window = 2 * int(_SMEAR * rate / bandwidth) + 1
    # Smallest |rate| in a window around an instant; zero or negative if the crank reverses in the window.
    slowest = np.maximum(
        scipy.ndimage.minimum_filter1d(rates, window, axis=0), -scipy.ndimage.maximum_filter1d(rates, window, axis=0)
    )
    exact = samples_of_motion(guess, at, (motion(at), motion(at, 1), motion(at, 2)), recording.gravity, source)
    # Dry friction passes the same filter as the torques.
    exact.columns[..., COULOMB] = smooth(np.sign(rates))[middle][..., None] * np.eye(LEG_COUNT)
    used, repeats = slowest[middle] > SLOW, rate / (2.0 * bandwidth * stride)
    samples = replace(exact, used=used, repeats=repeats)
    return samples, lambda rows: scipy.interpolate.make_interp_spline(even, smooth(rows), k=3)


def samples_of_motion(
    guess: RobotParameters,
    time: np.ndarray,
    motion: tuple[np.ndarray, np.ndarray, np.ndarray],
    gravity: Gravity,
    source: str = "motion",
) -> Samples:
    """Equations of an exact motion, without torques; calls inverse dynamics once for every body parameter."""
    pose, rate, _ = motion
    bodies = np.vstack([np.zeros(14), np.eye(14)])
    known, *torques = (inverse_dynamics(_body_record(guess, row), *motion, gravity) for row in bodies)
    speed = crank_rates(guess, leg_geometry(guess, pose), pose, rate)
    friction = (signal[..., None] * np.eye(LEG_COUNT) for signal in (np.sign(speed), speed))
    columns = np.concatenate([np.stack(torques, axis=-1) - known[..., None], *friction], axis=-1)
    used, step, pieces = np.abs(speed) > SLOW, float(time[1] - time[0]), (slice(0, len(time)),)
    return Samples(time, np.zeros_like(known), columns, known, speed, used, pieces, step, 1.0, source)


def merge_samples(parts: Sequence[Samples]) -> Samples:
    """Joins the samples of several recordings."""
    ends = np.cumsum([0, *(len(part.time) for part in parts)]).tolist()
    arrays = ("time", "measured", "columns", "known", "rates", "used")
    joined = {name: np.concatenate([getattr(part, name) for part in parts]) for name in arrays}
    return Samples(
        **joined,
        pieces=tuple(slice(start, end) for start, end in itertools.pairwise(ends)),
        step=max(part.step for part in parts),
        repeats=max(part.repeats for part in parts),
        source=", ".join(part.source for part in parts),
    )


def poses_of(guess: RobotParameters, angles: np.ndarray, source: str) -> np.ndarray:
    """Poses (n, 6) [rad, m] of crank angles (n, 6) [rad], by forward kinematics in a few steps from home."""
    home = inverse_kinematics(guess, guess.home_pose)
    pose, misfit = np.broadcast_to(guess.home_pose, angles.shape), np.inf
    try:
        for share in np.linspace(0.0, 1.0, _HOMOTOPY + 1)[1:]:
            pose = forward_kinematics(guess, home + share * (angles - home), pose)
        error = inverse_kinematics(guess, pose) - angles
        misfit = float(np.abs(np.arctan2(np.sin(error), np.cos(error))).max())
    except (ForwardKinematicsError, UnreachablePoseError):
        pass
    if misfit > 1e-6:
        allowed = "angles that the guessed robot can reach, in radians, or in degrees in columns that end in _deg"
        raise ConfigurationError(source, "crank angles at which the robot cannot be assembled", allowed)
    return pose
