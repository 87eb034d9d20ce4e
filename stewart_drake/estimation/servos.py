"""Servos that take angles, from commands and measured angles alone: stiffness, damping, friction, delay, head's mass.

    angle_i(t) = command_i(t - delay - age) - (mass Y_head + rotor Y_rotor + Y_rest + damping_i rate_i
                 + coulomb_i sign(rate_i)) / stiffness

A servo is a spring between its command and its angle, so it is itself the sensor of the torque. Y are torques of the
motion that was read, by the exact inverse dynamics; all pass one filter, see `torques`. Damping has back-EMF and
viscous friction: they act as one. The delay of a command and the age of a reading do too, so the age must be told. All
torques may be larger by one factor: the inertia of rotors and cranks, which is believed, makes them absolute, or else
a head that was weighed.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from stewart_drake.base.errors import ConfigurationError, RunFailure
from stewart_drake.base.tables import CRANK_ANGLES
from stewart_drake.base.yaml_files import to_yaml
from stewart_drake.estimation import core, torques
from stewart_drake.estimation.core import Estimate, Parameter, Result
from stewart_drake.estimation.identification import Problem, fitted
from stewart_drake.estimation.torques import CrankReadings, Samples
from stewart_drake.hardware.servos import PositionServos
from stewart_drake.logs.log import SimulationLog, load_log
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.plant.closed_form import ClosedFormOptions
from stewart_drake.plant.plant_options import ANGLES, CRANK_RATES
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEG_COUNT

_MOTORS = tuple(f"motor {leg}" for leg in range(LEG_COUNT))
PARAMETERS = (
    Parameter("stiffness", "", "N m/rad"),
    Parameter("delay", "", "s"),
    Parameter("reading_age", "", "s"),
    Parameter("platform_mass", "", "kg"),
    Parameter("rotor_inertia", "", "kg m^2"),
    *(Parameter("damping", motor, "N m s/rad") for motor in _MOTORS),
    *(Parameter("coulomb", motor, "N m") for motor in _MOTORS),
)
KINDS = tuple(dict.fromkeys(parameter.kind for parameter in PARAMETERS))
HELD = ("platform_mass",)
ASKED = ("stiffness", "delay", "platform_mass", "damping", "coulomb")
STIFFNESS, DELAY, AGE, MASS, ROTOR, DAMPING, COULOMB = 0, 1, 2, 3, 4, slice(5, 11), slice(11, 17)
_LOADS = slice(MASS, COULOMB.stop)  # In which torques are linear.
QUANTITIES = (("time", "s"), *CRANK_ANGLES, *((f"commanded_angle_{leg}", "rad") for leg in range(LEG_COUNT)))
_LONGEST, _STEP = 0.3, 0.005  # [s] delays that are tried first.
_UNEXPLAINED = 0.5  # [-] of the changes of command minus angle that may be left.
_LEAST = 0.05  # [-] of the rows in which each crank must turn.
_KERNEL = 0.03  # [s] standard deviation of the kernel.
_ROWS_A_PERIOD, _SMEAR = 6.25, 1.0
"""Rows in a period of the filter before it, and how many periods from a reversal of a crank its rows are used."""
_FINEST = 1e-6  # [rad] of an encoder's steps.
_SERVO_STEP = 0.001  # [s] of the simulation, and of the servos' own loop there.
_WIDTH = 0.004  # [rad/s] of the friction that is believed, as with motors that one can buy.


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
    gravity: float = STANDARD_GRAVITY
    source: str = "recording"

    quantities: ClassVar = QUANTITIES
    columns: ClassVar = {"time": 0, "angles": slice(1, 7), "commands": slice(7, 13)}

    def __post_init__(self) -> None:
        self.check_cranks("commands")
        for what, values in (("commanded_angle", self.commands), ("crank_angle", self.angles)):
            still = np.ptp(values, axis=0) == 0.0
            if still.any():
                raise ConfigurationError(f"{self.source}: {what}_{still.argmax()}", "the same in all rows", _MOTION)


_BALL_JOINTS = (
    "friction of the rods' ball joints is not identified here; let `drive` learn it: --set "
    '"adaptation={kind: regression, ball_joints: true, noise: 0.06, slowest: 0.05}" --keep-model head.yaml'
)
_MOTION = "a motion in which all motors turn; `excite` designs one"


@dataclass(frozen=True, eq=False)
class ServoSamples(Samples):
    """Samples whose measured values are angles [rad]; columns (n, 6, 14) are those of torques by `_LOADS`.

    `commands` are filtered, as functions of time [s], one for each piece.
    """

    commands: tuple[Callable[..., np.ndarray], ...] = ()

    def command(self, values: np.ndarray, order: int = 0) -> np.ndarray:
        """Commands (n, 6) [rad] that acted at the readings, or their derivatives by time."""
        late = values[DELAY] + values[AGE]
        return np.concatenate(
            [each(self.time[piece] - late, order) for piece, each in zip(self.pieces, self.commands, strict=True)]
        )

    def predicted(self, values: np.ndarray) -> np.ndarray:
        """Angles (n, 6) [rad] of parameters (17,)."""
        return self.command(values) - (self.columns @ values[_LOADS] + self.known) / values[STIFFNESS]

    def derivative(self, values: np.ndarray) -> np.ndarray:
        by_delay = -self.command(values, 1)[..., None]
        loads = -self.columns / values[STIFFNESS]
        by_stiffness = (self.columns @ values[_LOADS] + self.known)[..., None] / values[STIFFNESS] ** 2
        return np.concatenate([by_stiffness, by_delay, by_delay, loads], axis=-1)


def servo_samples_of(
    guess: RobotParameters, recordings: Sequence[ServoRecording], bandwidth: float | None = None
) -> ServoSamples:
    """Equations of recordings: the head's bodies in proportion to its mass, rods and cranks those of the guess.

    The motion passes a filter that leaves its harmonics alone; then all passes one kernel, friction's sign too.
    """
    from scipy.ndimage import gaussian_filter1d

    values, parts, commands = torques.values_of(guess), [], []
    for each in recordings:

        def kernel(rows: np.ndarray, rate: float = each.rate) -> np.ndarray:
            return np.asarray(gaussian_filter1d(rows, _KERNEL * rate, axis=0, mode="nearest"))

        width = each.rate / _ROWS_A_PERIOD if bandwidth is None else bandwidth
        samples, smooth = torques.filtered(guess, each, width, _SMEAR)
        columns, known = samples.columns, samples.known
        by_body = columns[..., torques.BODIES] * values[torques.BODIES]
        head = by_body[..., : torques.ROD_MASS].sum(axis=-1, keepdims=True) / guess.platform_mass
        known = known + by_body[..., torques.ROD_MASS : torques.ROTOR].sum(axis=-1)
        chosen = [head, *(columns[..., part] for part in ([torques.ROTOR], torques.VISCOUS, torques.COULOMB))]
        columns, known = (kernel(rows, 1.0 / samples.step) for rows in (np.concatenate(chosen, axis=-1), known))
        used, edge = samples.used.copy(), 1 + int(4.0 * _KERNEL / samples.step)
        used[:edge] = used[-edge:] = False
        measured = smooth(kernel(each.angles))(samples.time)
        parts.append(replace(samples, columns=columns, known=known, measured=measured, used=used))
        # A command holds for a row: its middle is half a row later.
        commands.append(_later(smooth(kernel(each.commands)), 0.5 / each.rate))
    return ServoSamples(**vars(torques.together(parts)), commands=tuple(commands))


def _later(spline: Callable[..., np.ndarray], lag: float) -> Callable[..., np.ndarray]:
    return lambda time, order=0: spline(time - lag, order)


@dataclass(frozen=True, eq=False, repr=False)
class ServoIdentification(Result):
    """Servos and head of a robot, and how well they are known.

    Attributes:
        guess: The robot that the identification started from.
        estimate: (17,) `PARAMETERS`.
        samples: The samples that it used.
        errors: (name, RMS [rad] of predicted angles where no crank sticks) of each log, those for validation last.
        logs: Number of recordings that were fitted.
    """

    guess: RobotParameters
    estimate: Estimate
    samples: ServoSamples
    errors: tuple[tuple[str, float], ...]
    logs: int

    columns: ClassVar = ("parameter", "part", "unit", "value", "half_width")
    about: ClassVar = (
        "Values with 95 % intervals. Damping has back-EMF and viscous friction, which act as one. What is kept was\n"
        "believed: nothing in commands and angles tells it from others."
    )
    picture: ClassVar = "Angles and their residuals"
    measured: ClassVar = ("angle", "rad")

    @property
    def title(self) -> str:
        return f"Identification of servos from {self.samples.source}"

    @property
    def values(self) -> np.ndarray:
        """(17,) of `PARAMETERS`."""
        return possible(self.estimate.values)

    @property
    def half_width(self) -> np.ndarray:
        """(17,) of the 95 % intervals; 0 for what kept its value."""
        return self.estimate.half_width

    @cached_property
    def robot(self) -> RobotParameters:
        """The guess with what was identified."""
        return with_head(self.guess, self.values)

    @property
    def motors(self) -> dict[str, Any]:
        """For `model.motors`."""
        stiffness, delay = self.values[[STIFFNESS, DELAY]].tolist()
        return {"kind": "position", "stiffness": stiffness, "damping": self._damping, "delay": delay}

    @property
    def friction(self) -> dict[str, Any]:
        """For `model.friction`: damping beyond the smallest motor's is viscous friction."""
        viscous = self.values[DAMPING] - self._damping
        return {"coulomb": self.values[COULOMB].tolist(), "viscous": viscous.tolist(), "width": _WIDTH}

    @property
    def _damping(self) -> float:
        return float(self.values[DAMPING].min())

    def model_file(self) -> str:
        """`model` of a scenario, but for the robot; the motors' delay has that of the bus."""
        return to_yaml({"model": {"motors": self.motors, "friction": self.friction, "delay": 0}})

    def rows(self) -> list[tuple[Any, ...]]:
        numbers = zip(PARAMETERS, self.values.tolist(), self.half_width.tolist(), strict=True)
        return [(*parameter[:3], value, width) for parameter, value, width in numbers]

    def summary(self) -> list[tuple[str, str]]:
        errors = [
            (f"angle error (RMS), {'fitted' if at < self.logs else 'not used'}: {name}", f"{1e3 * error:.3g} mrad")
            for at, (name, error) in enumerate(self.errors)
        ]
        return [
            ("samples, parameters estimated", f"{len(self.samples.time)}, {len(self.estimate.covariance)}"),
            ("rows in which a crank moves", f"{100.0 * self.samples.used.mean():.0f} %"),
            *errors,
            *((row[0], row[1]) for row in self.table()[1] if row[0] in ("stiffness", "delay", "platform mass")),
            *(("believed, not identified", line) for line in self.estimate.unidentifiable_sentences()),
        ]

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
    logs: Sequence[ServoRecording | SimulationLog | str | Path],
    hold: Collection[str] = (),
    ask: Collection[str] = ASKED,
    validate: Sequence[ServoRecording | SimulationLog | str | Path] = (),
    bandwidth: float | None = None,
    reading_age: float = 0.0,
) -> ServoIdentification:
    """Stiffness, damping, friction and delay of servos that take angles, and the head's mass, without any torque.

    Nothing need be known of the servos before.

    Args:
        robot: The guess. Its geometry, rods and cranks are kept, and the shape of its head.
        logs: At least one: recordings, logs, or files of them.
        hold: Nothing, and then the rotors' inertia keeps the guess's value; or `platform_mass`: a head that was weighed
            tells the rotors' inertia.
        ask: Kinds that the logs must determine.
        validate: Logs that are only predicted.
        bandwidth: [Hz] of the filter; None for one by the logs' rate.
        reading_age: [s] of an angle in its row.

    Raises:
        ConfigurationError: Nothing to read, an unknown kind; a log that is too short, without commands, whose motors
            do not turn, or whose angles are not those of its commands.
    """
    core.check_choices("hold", hold, HELD)
    core.check_choices("ask", ask, KINDS)
    if not logs:
        raise ConfigurationError("logs", "none", "at least one log")

    def read(log: ServoRecording | SimulationLog | str | Path) -> ServoRecording:
        return log if isinstance(log, ServoRecording) else load_servo_recording(log, robot)

    recordings, unseen = [read(log) for log in logs], [read(log) for log in validate]
    if not 0.0 <= reading_age <= 1.0:
        raise ConfigurationError("reading_age", reading_age, "a number of seconds from 0 to 1")
    kinds = {"reading_age", *(hold or ("rotor_inertia",))}
    believed = [at for at, parameter in enumerate(PARAMETERS) if parameter.kind in kinds - {*hold}]
    free, bodies = core.free_directions(PARAMETERS, KINDS, kinds), torques.scales(robot)[[torques.MASS, torques.ROTOR]]

    def fit(recordings: Sequence[ServoRecording]) -> tuple[Estimate, ServoSamples]:
        samples = servo_samples_of(robot, recordings, bandwidth)
        start = _start(robot, samples, reading_age)
        _refuse_other(samples, start)
        least = np.where(np.arange(len(start)) == STIFFNESS, 0.3 * start, -np.inf)
        size = np.array([1.0, 0.01, 0.01, *bodies, *[0.1] * 6, *[0.03] * 6])
        size[[STIFFNESS, *range(DAMPING.start, COULOMB.stop)]] *= start[STIFFNESS]
        problem = Problem(PARAMETERS, size, start, free, set(ask) - kinds, believed)
        return fitted(samples, problem, partial(_refuse_other, samples), partial(np.maximum, least)), samples

    estimate, samples = fit(recordings)
    try:
        again, _ = fit([replayed(robot, each, estimate.values) for each in recordings])
    except RunFailure as failure:
        allowed = "angles and commands of the guessed robot; it cannot follow them with what was identified"
        raise ConfigurationError(samples.source, str(failure).splitlines()[0], allowed) from failure
    # The bias is as uncertain as the estimate: its readings are rounded anew.
    values, covariance = 2.0 * estimate.values - again.values, 2.0 * estimate.covariance
    estimate = replace(estimate, values=values, covariance=covariance)
    parts = [servo_samples_of(robot, [each], bandwidth) for each in (*recordings, *unseen)]
    errors = tuple((each.source, _rms(each, each.measured - each.predicted(values))) for each in parts)
    return ServoIdentification(robot, estimate, samples, errors, len(recordings))


def replayed(guess: RobotParameters, recording: ServoRecording, values: np.ndarray) -> ServoRecording:
    """What a simulated robot of parameters (17,) does with the commands of a recording; it begins there at rest.

    What the estimate makes of it, less what it was made with, is the estimate's bias by filter, reversals and steps: B.
    Efron and R. J. Tibshirani, An Introduction to the Bootstrap (1993), chapter 10.
    """
    robot, values = with_head(guess, values), possible(values)
    friction = {"coulomb": values[COULOMB].tolist(), "viscous": values[DAMPING].tolist()}
    options = {"integrator": "rk4", "time_step": _SERVO_STEP, "friction": friction}
    plant = ClosedFormOptions.from_dict(options).make(robot, recording.gravity)
    servos = PositionServos(stiffness=float(values[STIFFNESS]), damping=0.0, resolution_bits=None)
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
    read = np.stack([np.interp(rows - values[AGE], time, column) for column in angles.T], axis=-1)
    # In the steps of its encoders.
    apart = np.abs(np.diff(recording.angles, axis=0))
    count = apart[apart > _FINEST].min()
    return replace(recording, angles=count * np.rint(read / count))


def with_head(guess: RobotParameters, values: np.ndarray) -> RobotParameters:
    """The guess with the head's mass of parameters (17,), its inertia in proportion, and the rotors' inertia."""
    heavier = guess.heavier(float(values[MASS]) / guess.platform_mass)
    return guess.replace(**heavier | {"rotor_inertia": float(values[ROTOR])})


def possible(values: np.ndarray) -> np.ndarray:
    """Parameters (17,) without negative delay, damping and friction."""
    least = np.full(len(PARAMETERS), -np.inf)
    least[[DELAY, *range(DAMPING.start, COULOMB.stop)]] = 0.0
    return np.maximum(values, least)


def load_servo_recording(log: SimulationLog | str | Path, guess: RobotParameters) -> ServoRecording:
    """A recording from a log of this package whose motors take angles, or from a CSV file with `QUANTITIES`."""
    if not isinstance(log, SimulationLog):
        if Path(log).suffix.lower() == ".csv":
            return ServoRecording.of_file(log, f"recording {log}")
        log = load_log(log)
    source = f"log of {log.scenario.name}"
    if (motors := log.scenario.motors).takes != "angle":
        raise ConfigurationError(source, f"motors.kind {motors.kind}", "a log of motors that take angles")
    rows, angles = torques.readings_of_log(log, guess, source)
    return ServoRecording(log.time[rows], angles, log["commanded_angle"][rows], log.scenario.gravity, source)


def take_angles(logs: Iterable[str | Path]) -> bool:
    """Whether the first of some logs is one of motors that take angles."""
    log = Path(next(iter(logs)))
    if log.suffix.lower() != ".csv":
        return load_log(log).scenario.motors.takes == "angle"
    names = ""
    # What cannot be read says so itself once it is.
    with contextlib.suppress(OSError, ValueError), log.open(encoding="utf-8-sig") as stream:
        names = stream.readline().strip()
    if names and "torque_" not in names and "commanded_angle_" not in names:
        allowed = "torque_0_Nm to torque_5_Nm, or commanded_angle_0_rad to commanded_angle_5_rad, too"
        raise ConfigurationError(f"recording {log}: columns", names[:200], allowed)
    return "commanded_angle_" in names and "torque_" not in names


def _rms(samples: Samples, values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values[samples.used] ** 2)))


def _start(guess: RobotParameters, samples: ServoSamples, age: float) -> np.ndarray:
    """Parameters (17,) near the best ones, with the guess's head: linear least squares for the best of many delays.

    command - angle is linear in compliance, and compliance times mass, damping and friction.
    """
    if (few := samples.used.mean(axis=0)).min() < _LEAST:
        got = f"motor {few.argmin()} at rest or reversing in {100.0 * (1.0 - few.min()):.0f} % of the rows"
        raise ConfigurationError(samples.source, got, _MOTION)
    rest = samples.known + samples.columns[..., 1] * guess.rotor_inertia
    columns = np.concatenate([rest[..., None], np.delete(samples.columns, 1, axis=-1)], axis=-1)[samples.used]
    values = np.array([1.0, 0.0, age, 0.0, guess.rotor_inertia, *[0.0] * 12])

    def fit(delay: float) -> tuple[float, float, np.ndarray]:
        values[DELAY] = delay
        twist = (samples.command(values) - samples.measured)[samples.used]
        shares = np.linalg.lstsq(columns, twist, rcond=None)[0]
        return float(np.sum((twist - columns @ shares) ** 2)), delay, shares

    _, values[DELAY], shares = min(map(fit, np.arange(-age, _LONGEST, _STEP)), key=lambda each: each[0])
    # Its weight is better known than the inertia of stiff servos.
    stiffness = guess.platform_mass / shares[1]
    values[STIFFNESS], values[MASS], values[ROTOR + 1 :] = stiffness, guess.platform_mass, stiffness * shares[2:]
    return values


def _refuse_other(samples: ServoSamples, values: np.ndarray) -> None:
    """Refuses angles that are not those of the commands."""
    twist = samples.command(values) - samples.measured
    left, changes = (
        _rms(samples, each) for each in (samples.measured - samples.predicted(values), twist - twist.mean(0))
    )
    if left > _UNEXPLAINED * changes or values[[STIFFNESS, MASS]].min() <= 0.0:
        got = (
            f"commands less angles that no servo explains, {min(100.0, 100.0 * left / changes):.0f} % of their changes"
        )
        allowed = "a log of the guessed robot, commands and angles in rad, no servo at its torque limit"
        raise ConfigurationError(samples.source, got, f"{allowed}; {_BALL_JOINTS}")
