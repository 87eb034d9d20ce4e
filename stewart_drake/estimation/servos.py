"""Identification of position servos, from commands and measured angles alone.

Estimates stiffness, damping, friction and delay of the servos, and the mass of the head. A servo is a spring between
its command and its angle, so it measures its own torque. The law is that of `control.adaptation_laws`, over the rows of
logs without forgetting. It starts again from its result, which is Gauss-Newton for delay and stiffness. The bias by
filter, reversals, rounding is that of an estimate from a simulated robot. Damping is back-EMF plus viscous friction.
The delay of a command and the age of a reading cannot be told apart, so the age must be given. The inertia of rotors
and cranks, or a head that was weighed, fixes the scale of all torques.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import ClassVar

import numpy as np

from stewart_drake.base.atomic_files import Document
from stewart_drake.base.errors import ConfigurationError, RunFailure
from stewart_drake.base.tables import CRANK_ANGLES
from stewart_drake.base.yaml_files import to_yaml
from stewart_drake.control.adaptation import RegressionOptions, regression_part
from stewart_drake.control.regression_records import Learnt
from stewart_drake.estimation import core, torques
from stewart_drake.estimation.core import Parameter, Result
from stewart_drake.estimation.torques import CrankReadings, Samples
from stewart_drake.hardware.servos import PositionServos
from stewart_drake.logs.log import SimulationLog, load_log
from stewart_drake.loop.part import BoundPart
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.plant.closed_form import ClosedFormOptions
from stewart_drake.plant.plant_options import ANGLES, CRANK_RATES
from stewart_drake.robot import Gravity, RobotParameters
from stewart_drake.robot.leg import LEG_COUNT
from stewart_drake.scenario.control_options import ControlOptions
from stewart_drake.scenario.control_side import context_of

_MOTORS = tuple(f"motor {leg}" for leg in range(LEG_COUNT))
PARAMETERS = (
    *(Parameter("stiffness", motor, "N m/rad") for motor in _MOTORS),
    *(Parameter("damping", motor, "N m s/rad") for motor in _MOTORS),
    *(Parameter("coulomb", motor, "N m") for motor in _MOTORS),
    Parameter("delay", "", "s"),
    Parameter("platform_mass", "", "kg"),
    Parameter("rotor_inertia", "", "kg m^2"),
)
KINDS = tuple(dict.fromkeys(parameter.kind for parameter in PARAMETERS))
HELD = ("platform_mass",)
ASKED = ("stiffness", "damping", "coulomb", "delay", "platform_mass")
STIFFNESS, DAMPING, COULOMB, DELAY, MASS, ROTOR = slice(0, 6), slice(6, 12), slice(12, 18), 18, 19, 20
QUANTITIES = (("time", "s"), *CRANK_ANGLES, *((f"commanded_angle_{leg}", "rad") for leg in range(LEG_COUNT)))
_LONGEST, _STEP = 0.2, 0.005  # [s] delays that are tried first.
_AT_FIRST, _UNEXPLAINED = 0.5, 0.2
"""Largest residual of command minus angle over its changes: in the first fit, and after the regression."""
_FEW = 0.01  # [s] scale of a delay.
_LEAST = 0.05  # [-] of the rows in which a crank must turn.
_KERNEL = 0.032  # [s] least standard deviation of the law's kernel: twelve bits are rough.
_FAST, _SHARE = 0.2, 0.2
"""Rows of a crank are left out while it is slower than this rate [rad/s] or this share of its RMS rate, whichever is
less. So no reversal is within the kernel."""
_PASSES = 5  # Passes of the regression over all rows.
_CORRECTIONS = 2  # Corrections of its bias, by simulation.
_PIECES = 10  # Parts of the log that are left out one at a time, for the intervals (jackknife).
_STUDENT = 2.262  # 95 % of Student's distribution of that many pieces.
_UNKNOWN = 0.6  # [-] half width of an interval, over a parameter's size, beyond which it counts as not determined.
_FINEST = 1e-6  # [rad] of an encoder's steps.
_SERVO_STEP = 0.001  # [s] of the simulation, and of the servos' loop there.
_WIDTH = 0.004  # [rad/s] of a reversal in the model's friction, as for motors on the market.


@dataclass(frozen=True, eq=False)
class ServoRecording(CrankReadings):
    """n readings of six cranks and the six angles that were commanded then, at a constant rate, checked.

    Attributes:
        time: (n,) [s].
        angles: (n, 6) [rad] as read.
        commands: (n, 6) [rad] sent at a row's time and held until the next one.
        gravity: [m/s^2].
        source: What it is called in messages.

    Raises:
        ConfigurationError: As for `torques.Recording`; commands that are always the same.
    """

    time: np.ndarray
    angles: np.ndarray
    commands: np.ndarray
    gravity: Gravity = STANDARD_GRAVITY
    source: str = "recording"

    quantities: ClassVar = QUANTITIES
    columns: ClassVar = {"time": 0, "angles": slice(1, 7), "commands": slice(7, 13)}

    def __post_init__(self) -> None:
        self.check_cranks("commands")
        for what, values in (("commanded_angle", self.commands), ("crank_angle", self.angles)):
            still = np.ptp(values, axis=0) == 0.0
            if still.any():
                raise ConfigurationError(f"{self.source}: {what}_{still.argmax()}", "the same in all rows", _MOTION)


AnyLog = ServoRecording | SimulationLog | str | Path
_BALL_JOINTS = (
    "friction of the rods' ball joints is not identified here; let `drive` learn it: --set "
    '"adaptation={kind: regression, ball_joints: true, noise: 0.06, slowest: 0.05}" --keep-model head.yaml'
)
_MOTION = "a motion in which all motors turn; `excite` designs one"


@dataclass(frozen=True, eq=False, repr=False)
class ServoIdentification(Result):
    """Servos and head of a robot, and how well they are known.

    Attributes:
        guess: The robot that the identification started from.
        values: (21,) of `PARAMETERS`.
        half_width: (21,) of the 95 % intervals; 0 for what kept its value.
        samples: Rows of the first log, thinned, with angles.
        left: (n, 6) [rad] error of a simulated robot with these values there.
        errors: (name, RMS of the same [rad]) of all logs, those for validation last.
        logs: Number of recordings that were fitted.
    """

    guess: RobotParameters
    values: np.ndarray
    half_width: np.ndarray
    samples: Samples
    left: np.ndarray
    errors: tuple[tuple[str, float], ...]
    logs: int

    columns: ClassVar = ("parameter", "part", "unit", "value", "half_width")
    about: ClassVar = "Values with 95 % intervals. Damping has back-EMF and viscous friction, which act as one."
    picture: ClassVar = "Angles, and what a simulation with these values is off"
    measured: ClassVar = ("angle", "rad")

    @property
    def title(self) -> str:
        return f"Identification of servos from {self.samples.source}"

    @cached_property
    def robot(self) -> RobotParameters:
        """The guess with what was identified."""
        return with_head(self.guess, self.values)

    @property
    def motors(self) -> Document:
        """For `model.motors`."""
        return motors_of(self.values)[0]

    @property
    def friction(self) -> Document:
        """For `model.friction`: damping beyond the smallest motor's is viscous friction."""
        return motors_of(self.values)[1]

    def model_file(self) -> str:
        """`model` of a scenario, but for the robot; the motors' delay has that of the bus."""
        return to_yaml({"model": {"motors": self.motors, "friction": self.friction, "delay": 0}})

    def rows(self) -> list[tuple[str, str, str, float, float]]:
        numbers = zip(PARAMETERS, self.values.tolist(), self.half_width.tolist(), strict=True)
        return [(*parameter[:3], value, width) for parameter, value, width in numbers]

    def summary(self) -> list[tuple[str, str]]:
        errors = [
            (
                f"simulated angles off (RMS), {'fitted' if at < self.logs else 'not used'}: {name}",
                f"{1e3 * by:.3g} mrad",
            )
            for at, (name, by) in enumerate(self.errors)
        ]
        shown = "stiffness motor 0", "delay", "platform mass"
        return [*errors, *((row[0], row[1]) for row in self.table()[1] if row[0] in shown)]

    def table(self) -> tuple[list[str], list[list[str]]]:
        rows = []
        for parameter, (*_, value, width) in zip(PARAMETERS, self.rows(), strict=True):
            unit, factor = ("ms", 1e3) if parameter.unit == "s" else (parameter.unit, 1.0)
            interval = f" ± {factor * width:.2g} {unit}" if width > 0.0 else f" {unit}, kept"
            rows.append([f"{parameter}".replace("_", " "), f"{factor * value:.4g}{interval}"])
        return ["", "value"], rows

    def robot_file(self) -> str:
        about = f"head identified through its servos from {self.logs} {'log' if self.logs == 1 else 'logs'}"
        comments = ["Servos and friction, for `model` of a scenario:", *self.model_file().splitlines()]
        comments += ["Values with 95 % intervals:", *(f"  {name}: {text}" for name, text in self.table()[1])]
        return core.robot_yaml(about, comments, self.robot)


def identify_servos(
    robot: RobotParameters,
    logs: Sequence[AnyLog],
    hold: Collection[str] = (),
    ask: Collection[str] = ASKED,
    validate: Sequence[AnyLog] = (),
    reading_age: float = 0.0,
) -> ServoIdentification:
    """Stiffness, damping, friction and delay of servos that take angles, and the head's mass, without any torque.

    No values of the servos are needed.

    Args:
        robot: The guess. Its geometry, rods and cranks are kept, and the shape of its head.
        logs: At least one: recordings, logs, or files of them, at one rate.
        hold: Empty, and then the rotors' inertia keeps the guess's value; or `platform_mass`: a head that was weighed
            determines the rotors' inertia.
        ask: Kinds that the logs must determine.
        validate: Logs that are only predicted.
        reading_age: [s] of an angle in its row.

    Raises:
        ConfigurationError: Nothing to read, an unknown kind; a log that is too short, without commands, with motors
            that do not turn, or with angles that do not follow the commands.
    """
    core.check_choices("hold", hold, HELD)
    core.check_choices("ask", ask, KINDS)
    if not logs:
        raise ConfigurationError("logs", "none", "at least one log")
    if not 0.0 <= reading_age <= 1.0:
        raise ConfigurationError("reading_age", reading_age, "a number of seconds from 0 to 1")
    recordings, unseen = ([load_servo_recording(log) for log in some] for some in (logs, validate))
    first, source = recordings[0], ", ".join(recording.source for recording in recordings)
    for recording in recordings:
        if abs(recording.rate / first.rate - 1.0) > 0.01:
            allowed = f"rows at {first.rate:.4g} Hz, as {first.source}"
            raise ConfigurationError(recording.source, f"{recording.rate:.4g} Hz", allowed)
    samples, start, noise, changes = _start(robot, first, reading_age)
    noise = float(np.clip(noise / robot.effort_limits.mean(), 1e-4, 1.0))
    slowest = min(_FAST, _SHARE * _rms(samples.rates))
    smoothing = max(_KERNEL, 1.5 / first.rate)
    law = RegressionOptions(forgetting=1e5, center_of_mass=False, noise=noise, slowest=slowest, smoothing=smoothing)
    regression = _Regression(robot, first, reading_age, law, bool(hold))
    rows = _stacked(recordings)
    estimate = regression.estimate(rows, start)
    try:
        values = estimate
        for _ in range(_CORRECTIONS):
            simulated = [replay(robot, log, values, reading_age) for log in recordings]
            values = feasible(values + estimate - regression.estimate(_stacked(simulated), values))
        errors = [replay(robot, log, values, reading_age).angles - log.angles for log in (*recordings, *unseen)]
    except RunFailure as failure:
        allowed = "angles and commands of the guessed robot; it cannot follow them with what was identified"
        raise ConfigurationError(source, str(failure).splitlines()[0], allowed) from failure
    width = _half_widths(regression, rows, estimate)
    _refuse_other(source, max(map(_rms, errors[: len(recordings)])) / changes, _UNEXPLAINED)
    _refuse_undetermined(source, values, width, {*ask} - {*hold})
    at = np.searchsorted(first.time, samples.time)
    samples = replace(samples, measured=first.angles[at], source=source)
    sizes = tuple((log.source, _rms(error)) for log, error in zip((*recordings, *unseen), errors, strict=True))
    return ServoIdentification(robot, values, width, samples, errors[0][at], sizes, len(recordings))


def _half_widths(regression: _Regression, rows: np.ndarray, estimate: np.ndarray) -> np.ndarray:
    """Half widths (21,) of 95 % intervals, by the jackknife; the estimate of the bias is as uncertain."""
    pieces, ticks = np.array_split(np.arange(len(rows)), _PIECES), np.arange(len(rows))[:, None]
    without = [regression.estimate(np.where(np.isin(ticks, piece), np.nan, rows), estimate) for piece in pieces]
    width: np.ndarray = _STUDENT * np.sqrt(2.0 * (_PIECES - 1) * np.var(without, axis=0))
    return width


def _refuse_undetermined(source: str, values: np.ndarray, width: np.ndarray, kinds: Collection[str]) -> None:
    """Refuses logs that leave parameters of these kinds undetermined."""
    stiffness = values[STIFFNESS].mean()
    sizes = np.repeat(stiffness * np.array([1.0, 0.1, 0.03]), LEG_COUNT).tolist() + [_FEW, values[MASS], np.inf]
    for parameter, half_width, size in zip(PARAMETERS, width, sizes, strict=True):
        if parameter.kind in kinds and half_width > _UNKNOWN * size:
            got = f"an interval of ± {half_width:.2g} {parameter.unit}"
            raise ConfigurationError(f"{source}: {parameter}", got, _MOTION)


class _Regression:
    """The law over rows of angles and commands (n, 12) [rad] of a guessed robot; a row of NaN is a gap."""

    def __init__(
        self, guess: RobotParameters, recording: ServoRecording, age: float, law: RegressionOptions, weighed: bool
    ) -> None:
        self.guess, self.age, self.law, self.weighed = guess, age, law, weighed
        self.period, self.gravity = 1.0 / recording.rate, recording.gravity

    def estimate(self, rows: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Parameters (21,) by rows, from a start."""
        for _ in range(_PASSES):
            values = self._once(rows, values)
            if self.weighed:
                # All torques are larger by one factor, and the rotors with them.
                factor = self.guess.platform_mass / values[MASS]
                turns = float(with_head(self.guess, values).crank_axis_inertias.mean())
                values[: COULOMB.stop] *= factor
                values[MASS], values[ROTOR] = self.guess.platform_mass, values[ROTOR] + (factor - 1.0) * turns
        return values

    def _once(self, rows: np.ndarray, values: np.ndarray) -> np.ndarray:
        motors, friction = motors_of(values)
        model = {"robot": with_head(self.guess, values), "motors": motors, "friction": friction}
        model |= {"reading_age": self.age, "gravity": self.gravity}
        loop = {"controller": {"kind": "feedforward", "period": self.period}, "reference": "hold", "model": model}
        # Over a whole log the samples' errors average out.
        part = regression_part(self.law, context_of(ControlOptions.from_dict(loop)), correlation_time=0.0)
        reading, command, state = np.empty(6), np.empty(6), part.initial.copy()
        tick = BoundPart(part, (reading, command), state).fixed()
        for row in rows:
            reading[:], command[:] = row[:6], row[6:]
            tick()
        known = Learnt.of(state["learnt"].view(float))
        stiffness = motors["stiffness"] * np.array(motors["ratios"]) * known.drive
        rest = motors["delay"] + known.delay, known.mass, values[ROTOR]
        return np.array([*stiffness, *(motors["damping"] + known.viscous), *known.coulomb, *rest])


def motors_of(values: np.ndarray) -> tuple[Document, Document]:
    """Motors and friction as keys of `model`, of parameters (21,)."""
    values = feasible(values)
    stiffness, damping = float(values[STIFFNESS].mean()), float(values[DAMPING].min())
    motors = {"kind": "position", "stiffness": stiffness, "ratios": (values[STIFFNESS] / stiffness).tolist()}
    viscous = (values[DAMPING] - damping).tolist()
    friction = {"coulomb": values[COULOMB].tolist(), "viscous": viscous, "width": _WIDTH}
    return motors | {"damping": damping, "delay": float(values[DELAY])}, friction


def _stacked(recordings: Sequence[ServoRecording]) -> np.ndarray:
    """Rows (n, 12) of recordings, with gaps between them."""
    gap = np.full((1, 12), np.nan)
    return np.vstack([part for log in recordings for part in (np.hstack([log.angles, log.commands]), gap)])


def replay(guess: RobotParameters, recording: ServoRecording, values: np.ndarray, age: float) -> ServoRecording:
    """The recording of a simulated robot with parameters (21,) and the same commands; it starts there at rest.

    An estimate from it, less the parameters, is the bias by filter, reversals and rounding: B. Efron and
    R. J. Tibshirani, An Introduction to the Bootstrap (1993), chapter 10.
    """
    import scipy.signal

    robot, values = with_head(guess, values), feasible(values)
    friction = {"coulomb": values[COULOMB].tolist(), "viscous": values[DAMPING].tolist()}
    options = {"integrator": "rk4", "time_step": _SERVO_STEP, "friction": friction}
    plant = ClosedFormOptions.from_dict(options).make(robot, recording.gravity)
    servos = PositionServos(**motors_of(values)[0] | {"damping": 0.0, "delay": 0.0, "resolution_bits": None})
    part = servos.part(robot, _SERVO_STEP)
    state, wrench, still = part.initial.copy(), np.zeros(6), np.zeros(6)
    steps = int((recording.time[-1] - recording.time[0]) / _SERVO_STEP) + 1
    time, rows = _SERVO_STEP * np.arange(steps), recording.time - recording.time[0]
    # A command that arrives within a step counts for its share of it.
    within = time[:, None] + _SERVO_STEP * np.linspace(0.05, 0.95, 10) - values[DELAY]
    newest = np.searchsorted(rows, within, side="right") - 1
    commands, angles = recording.commands[np.maximum(newest, 0)].mean(axis=1), np.empty((steps, 6))
    measured = plant.initial(torques.poses_of(guess, recording.angles[:1], recording.source)[0], still)
    for step in range(steps):
        angles[step] = measured[ANGLES]
        part.kernel(*part.leading.values(), commands[step], measured[ANGLES.start : CRANK_RATES.stop], state)
        measured = plant.step(state["torque"][0], wrench)
    read = np.stack([np.interp(rows - age, time, column) for column in angles.T], axis=-1)
    # With noise and rounding of the encoders.
    apart = np.abs(np.diff(recording.angles, axis=0))
    count = apart[apart > _FINEST].min()
    sos = scipy.signal.butter(4, recording.rate / 6.0, "highpass", fs=recording.rate, output="sos")
    # A third of the noise is below that frequency.
    noise = 1.5 * np.mean(scipy.signal.sosfiltfilt(sos, recording.angles, axis=0) ** 2) - count**2 / 12.0
    read += np.random.default_rng(0).normal(0.0, np.sqrt(max(noise, 0.0)), read.shape)
    return replace(recording, angles=count * np.rint(read / count))


def with_head(guess: RobotParameters, values: np.ndarray) -> RobotParameters:
    """The guess with the head's mass of parameters (21,), its inertia in proportion, and the rotors' inertia."""
    heavier = guess.scaled_masses(float(values[MASS]) / guess.platform_mass)
    return guess.replace(**heavier | {"rotor_inertia": float(values[ROTOR])})


def feasible(values: np.ndarray) -> np.ndarray:
    """Parameters (21,) without negative delay, damping and friction."""
    least = np.full(len(PARAMETERS), -np.inf)
    least[DAMPING.start : DELAY + 1] = 0.0
    return np.maximum(values, least)


def load_servo_recording(log: AnyLog) -> ServoRecording:
    """A recording from a log of this package whose motors take angles, or from a CSV file with `QUANTITIES`."""
    if isinstance(log, ServoRecording):
        return log
    if not isinstance(log, SimulationLog):
        if Path(log).suffix.lower() == ".csv":
            return ServoRecording.of_file(log, f"recording {log}")
        log = load_log(log)
    source = f"log of {log.scenario.name}"
    if (motors := log.scenario.motors).command_quantity != "angle":
        raise ConfigurationError(source, f"motors.kind {motors.kind}", "a log of motors that take angles")
    rows, angles = torques.readings_of_log(log, source)
    return ServoRecording(log.time[rows], angles, log["commanded_angle"][rows], log.scenario.gravity_in_base, source)


def take_angles(logs: Iterable[str | Path]) -> bool:
    """Whether the first of some logs is one of motors that take angles."""
    log = Path(next(iter(logs)))
    if log.suffix.lower() != ".csv":
        return load_log(log).scenario.motors.command_quantity == "angle"
    names = ""
    # A file that cannot be read is refused when it is loaded.
    with suppress(OSError, ValueError), log.open(encoding="utf-8-sig") as stream:
        names = stream.readline().strip()
    if names and "torque_" not in names and "commanded_angle_" not in names:
        allowed = "torque_0_Nm to torque_5_Nm, or commanded_angle_0_rad to commanded_angle_5_rad, too"
        raise ConfigurationError(f"recording {log}: columns", names[:200], allowed)
    return "commanded_angle_" in names and "torque_" not in names


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _start(guess: RobotParameters, recording: ServoRecording, age: float) -> tuple[Samples, np.ndarray, float, float]:
    """Samples, parameters (21,) near the best, unexplained torque [N m], changes of command less angle [rad].

    Linear least squares at the best of many delays, in compliance, and compliance times damping and friction.
    """
    samples, smooth = torques.filtered(guess, recording)
    if (few := samples.used.mean(axis=0)).min() < _LEAST:
        got = f"motor {few.argmin()} at rest or reversing in {100.0 * (1.0 - few.min()):.0f} % of the rows"
        raise ConfigurationError(recording.source, got, _MOTION)
    values = np.zeros(len(PARAMETERS))
    values[MASS], values[ROTOR] = guess.platform_mass, guess.rotor_inertia
    load = samples.known + samples.columns[..., torques.BODIES] @ torques.values_of(guess)[torques.BODIES]
    friction = samples.columns[..., torques.VISCOUS], samples.columns[..., torques.COULOMB]
    columns = np.concatenate([load[..., None], *friction], axis=-1)[samples.used]
    command, angles = smooth(recording.commands), smooth(recording.angles)(samples.time)

    def fit(late: float) -> tuple[float, float, np.ndarray, np.ndarray]:
        # A command holds for a row: its middle is half a row later.
        twist = (command(samples.time - late - 0.5 / recording.rate) - angles)[samples.used]
        shares = np.linalg.lstsq(columns, twist, rcond=None)[0]
        return float(np.sum((twist - columns @ shares) ** 2)), late, shares, twist

    squares, late, shares, twist = min(map(fit, np.arange(0.0, _LONGEST, _STEP)), key=lambda trial: trial[0])
    left, changes = np.sqrt(squares / len(twist)), float(np.std(twist)) + _FINEST
    _refuse_other(recording.source, np.inf if shares[0] <= 0.0 else left / changes, _AT_FIRST)
    values[STIFFNESS], values[DELAY] = 1.0 / shares[0], late - age
    values[DAMPING], values[COULOMB] = np.maximum(shares[1:] / shares[0], 0.0).reshape(2, 6)
    return samples, values, left / shares[0], changes


def _refuse_other(source: str, left: float, most: float) -> None:
    """Refuses angles that do not follow the commands: too large a share of their difference is unexplained."""
    if left > most:
        got = f"commands less angles that no servo explains, {100.0 * min(1.0, left):.0f} % of their changes"
        allowed = "a log of the guessed robot, commands and angles in rad, no servo at its torque limit"
        raise ConfigurationError(source, got, f"{allowed}; {_BALL_JOINTS}")
