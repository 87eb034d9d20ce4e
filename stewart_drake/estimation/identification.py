"""Identification of a robot from logs: maximum-likelihood parameters, moved to the nearest that bodies can have."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np

from stewart_drake.base.errors import ConfigurationError, StewartDrakeError, drake_guard
from stewart_drake.base.yaml_files import to_yaml
from stewart_drake.estimation import core, torques
from stewart_drake.estimation.core import Estimate, Result
from stewart_drake.estimation.torques import COULOMB, GAIN, KINDS, PARAMETERS, SIZE, VISCOUS, Recording, Samples
from stewart_drake.logs.log import SimulationLog
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEG_COUNT

AnyLog = Recording | SimulationLog | str | Path
ASKED: tuple[str, ...] = ("platform_mass", "coulomb", "viscous")
LARGEST_DEVIATION = 0.3  # [-] in `scales`, beyond which a direction counts as unidentifiable
MEMORY = 0.5  # [s] over which residuals may be correlated
LEAST = 1e-5
"""[-] least eigenvalue of bodies over the platform's mass, and least value of other numbers over the guess's."""
_PASSES = 6
_FIX_FIRST = np.array([5.0 if parameter.kind == "rod_mass" else 1.0 for parameter in PARAMETERS])
"""Preference for keeping the guess's value, if several parameters could: rods can be weighed."""
_ROUNDING = 1e-9  # [-] of the largest singular value
_UNEXPLAINED, _NOISY = 0.5, 0.1  # Largest residual over the RMS change of the torques, or over the RMS torque.
_FACTOR = 30.0  # Largest ratio of measured torques to those of the guess, or its inverse.
_NAMED = 0.02  # [-] of its size by which a parameter must occur in a sum to be named there.


class InconsistentError(StewartDrakeError): ...


class Prediction(NamedTuple):
    """Errors of predicted torques over the RMS of the torques [-]."""

    source: str
    guess: float  # By the guess, where no crank sticks.
    identified: float  # By the result, where no crank sticks.
    everywhere: float  # By the result, in all rows.


@dataclass(frozen=True, eq=False, repr=False)
class Identification(Result):
    """A robot's parameters, and how well they are known.

    Attributes:
        guess: The robot that the identification started from.
        values: (32,) estimated parameters, physically consistent.
        estimate: (32,) result of the least squares before that.
        held: Kinds of parameters that kept the guess's value.
        samples: The samples that it used.
        logs: Number of recordings.
        predictions: Of the recordings that were fitted, then of those for validation.
    """

    guess: RobotParameters
    values: np.ndarray
    estimate: Estimate
    held: tuple[str, ...]
    samples: Samples
    logs: int
    predictions: tuple[Prediction, ...]

    columns: ClassVar = ("parameter", "part", "unit", "guess", "value", "half_width", "base_parameter")
    about: ClassVar = (
        "Values with 95 % intervals. Moments and inertias of the platform are about the origin of P. Where a value\n"
        "means a sum, the parameters after the first have the guess's values; the logs determine only the sum."
    )
    picture: ClassVar = "Torques and their residuals"
    measured: ClassVar = ("torque", "N m")

    @property
    def title(self) -> str:
        return f"Identification from {self.samples.source}"

    @cached_property
    def robot(self) -> RobotParameters:
        return torques.as_robot(self.guess, self.values)

    @property
    def left(self) -> np.ndarray:
        """(n, 6) [N m] residual torques of the samples."""
        return self.samples.measured - self.samples.predicted(self.values)

    @property
    def half_width(self) -> np.ndarray:
        """(32,) of the 95 % intervals; 0 for what kept its value."""
        return self.estimate.half_width

    @property
    def coulomb(self) -> np.ndarray:
        """(6,) [N m] dry friction of the motors."""
        return self.values[COULOMB].copy()

    @property
    def viscous(self) -> np.ndarray:
        """(6,) [N m s/rad] viscous friction of the motors."""
        return self.values[VISCOUS].copy()

    @property
    def torque_constants(self) -> np.ndarray:
        """(6,) [-] true torques over those of the log; of geometric mean 1 unless the platform's mass is held."""
        return np.exp(self.values[GAIN])

    @property
    def payload(self) -> tuple[float, np.ndarray]:
        """Mass [kg] of the platform beyond the guess's, and its place in P (3,) [m]; NaN where there is none."""
        change = self.values - torques.values_of(self.guess)
        mass = float(change[0])
        known = abs(mass) > self.half_width[0] > 0.0
        return mass, change[1:4] / mass if known else np.full(3, np.nan)

    def base_parameters(self) -> list[str]:
        """What the values mean: the parameter itself, or a sum with others that keep the guess's value."""
        names, size = [str(parameter) for parameter in PARAMETERS], torques.scales(self.guess)
        for kept in self.estimate.unidentifiable:
            unit = np.eye(len(names))[kept.at]
            for at, amount in enumerate(self.estimate.identifiable_part(unit)):
                if at != kept.at and abs(amount) * size[kept.at] > _NAMED * size[at]:
                    names[at] += f" {'+' if amount > 0.0 else '-'} {abs(amount):.3g} {PARAMETERS[kept.at]}"
        return names

    def rows(self) -> list[tuple[str, str, str, float, float, float, str]]:
        """A row of `columns` for each parameter; torque constants as natural logarithms."""
        numbers = np.stack([torques.values_of(self.guess), self.values, self.half_width], axis=-1).tolist()
        rows = zip(PARAMETERS, numbers, self.base_parameters(), strict=True)
        return [(*parameter[:3], *row, meaning) for parameter, row, meaning in rows]

    def summary(self) -> list[tuple[str, str]]:
        mass, place = self.payload
        at = f" at {' '.join(f'{1e3 * x:.1f}' for x in place)} mm in P" if np.isfinite(place).all() else ""
        corrected = (np.abs(self.values - self.estimate.values) > 1e-9 * torques.scales(self.guess)).any()
        friction = (" ".join(f"{value:.3g}" for value in values) for values in (self.coulomb, self.viscous))
        errors = [
            (
                f"torque error (RMS), {'fitted' if at < self.logs else 'not used'}: {log.source}",
                f"{100 * log.guess:.3g} % -> {100 * log.identified:.3g} % where no crank sticks, "
                f"{100 * log.everywhere:.3g} % everywhere",
            )
            for at, log in enumerate(self.predictions)
        ]
        return [
            ("samples, parameters estimated", f"{len(self.samples.time)}, {len(self.estimate.covariance)}"),
            ("rows in which a crank moves", f"{100.0 * self.samples.used.mean():.0f} %"),
            *errors,
            ("platform beyond the guess", f"{mass:+.4g} ± {self.half_width[0]:.2g} kg{at}"),
            ("bodies", "moved to the nearest physical ones" if corrected else "physical as estimated"),
            ("coulomb, viscous friction", "{} N m, {} N m s/rad".format(*friction)),
            ("torque constants", self._constants()),
            *(("not identifiable, guess kept", line) for line in self.estimate.unidentifiable_sentences()),
        ]

    def _constants(self) -> str:
        constants = ", ".join(f"{constant:.4f}" for constant in self.torque_constants)
        what = "of the torques in the logs" if "platform_mass" in self.held else "of their geometric mean, taken as 1"
        return f"Motors 0 to 5 give {constants} {what}"

    def table(self) -> tuple[list[str], list[list[str]]]:
        rows = []
        for parameter, (*_, guess, value, width, meaning) in zip(PARAMETERS, self.rows(), strict=True):
            if parameter.kind == "torque_constant":
                guess, value, width = np.exp(guess), np.exp(value), np.exp(value) * width
            name = f"{parameter}".replace("_", " ") + (f" [{parameter.unit}]" if parameter.unit else "")
            interval = f"{value:.5g} ± {width:.2g}" if width > 0.0 else f"{value:.5g}, kept"
            rows.append([name, f"{guess:.5g}", interval, "" if meaning == str(parameter) else meaning])
        return ["", "guess", "value", "means"], rows

    def friction_file(self) -> str:
        return to_yaml({"plant": {"friction": {"coulomb": self.coulomb.tolist(), "viscous": self.viscous.tolist()}}})

    def robot_file(self) -> str:
        within = [
            f"{'its torques' if at < self.logs else 'torques of a log not used'} within {100 * log.identified:.2g} %"
            for at, log in enumerate(self.predictions)
        ]
        about = f"identified from {self.logs} {'log' if self.logs == 1 else 'logs'}: {'; '.join(within)}"
        comments = ["Friction, for `plant.friction` of a scenario:", *self.friction_file().splitlines()]
        comments += [self._constants(), "Values with 95 % intervals:"]
        comments += [f"  {name}: {text}" for name, _, text, _ in self.table()[1]]
        return core.robot_yaml(about, comments, self.robot)


def identify(
    robot: RobotParameters,
    logs: Sequence[AnyLog],
    hold: Collection[str] = (),
    ask: Collection[str] = ASKED,
    validate: Sequence[AnyLog] = (),
    bandwidth: float | None = None,
    lag: float = 0.0,
) -> Identification:
    """Masses, inertias, friction and torque constants of a robot from logs of its motion.

    Args:
        robot: The guess. Its geometry is kept, and its bodies where the logs do not determine them.
        logs: At least one: recordings, logs, or files of them, see `load_recording`.
        hold: Kinds that keep the guess's value; friction is none there, torque constants are 1.
        ask: Kinds that the logs must determine.
        validate: Logs that are only predicted.
        bandwidth: [Hz] of the filter, see `samples_of`; None for one by the logs' rate.
        lag: [s] of torques in CSV files, see `Recording`.

    Raises:
        ConfigurationError: Nothing to read or free, an unknown kind; as `load_recording`, `samples_of` and
            `least_squares`.
        InconsistentError: No physical bodies are near the estimate.
    """
    core.check_choices("hold", hold, KINDS)
    core.check_choices("ask", ask, KINDS)
    if not logs:
        raise ConfigurationError("logs", "none", "at least one log")

    def read(log: AnyLog) -> Samples:
        if isinstance(log, SimulationLog):
            log = torques.recording_of_log(log, f"log of {log.scenario.name}")
        recording = log if isinstance(log, Recording) else torques.load_recording(log, lag)
        return torques.samples_of(robot, recording, bandwidth)

    fitted, unseen = [read(log) for log in logs], [read(log) for log in validate]
    samples = torques.merge_samples(fitted)
    estimate = least_squares(robot, samples, hold, ask)
    values = consistent(robot, estimate)

    def prediction(part: Samples) -> Prediction:
        def error(values: np.ndarray, rows: np.ndarray) -> float:
            off = (part.measured - part.predicted(values))[rows]
            return float(np.sqrt(np.mean(off**2) / np.mean(part.measured[rows] ** 2))) if off.size else np.nan

        guess = error(torques.values_of(robot), part.used)
        return Prediction(part.source, guess, error(values, part.used), error(values, np.ones_like(part.used)))

    held = tuple(kind for kind in KINDS if kind in hold)
    predictions = tuple(map(prediction, (*fitted, *unseen)))
    return Identification(robot, values, estimate, held, samples, len(fitted), predictions)


def least_squares(
    guess: RobotParameters, samples: Samples, hold: Collection[str] = (), ask: Collection[str] = ASKED
) -> Estimate:
    """Parameters that fit samples best, by Gauss and Newton; asked kinds must be identifiable.

    Torques are weighted by the residuals' covariance.
    """
    size, start, free = torques.scales(guess), torques.values_of(guess), torques.free_directions(hold)
    values, unidentifiable = start, tuple[core.Unidentifiable, ...]()
    noise = np.eye(LEG_COUNT) * np.mean(samples.measured**2)
    for turn in range(_PASSES):
        slope, residual = _whitened(samples, values, size[:, None] * free, noise)
        values = values + size * (free @ np.linalg.lstsq(slope, residual, rcond=_ROUNDING)[0])
        # A first pass from a crude guess may leave the logarithms of gains far off.
        values[GAIN] = np.clip(values[GAIN], -3.0, 3.0)
        noise = _noise(samples, values)
        if turn == 1:
            _refuse_other(guess, samples, values)
            slope, _ = _whitened(samples, values, size[:, None] * free, noise)
            # Rows closer than half a period of the filter repeat each other.
            slope /= np.sqrt(samples.repeats)
            free, unidentifiable = core.identifiable(slope, free, size, LARGEST_DEVIATION, _FIX_FIRST)
            for kept in unidentifiable:
                if (parameter := PARAMETERS[kept.at]).kind in set(ask) - set(hold):
                    got = f"a motion that leaves an uncertainty of {kept.deviation:.3g} times its size"
                    allowed = "a motion that determines it; `excite` designs one"
                    raise ConfigurationError(f"{samples.source}: {parameter}", got, allowed)
            values = start if unidentifiable else values
    directions = size[:, None] * free
    slope, residual = _whitened(samples, values, directions, noise)
    information = slope.T @ slope
    inverse = np.linalg.inv(information)
    rows = int(samples.used.sum())
    covariance = inverse @ _long_run(samples, slope * residual[:, None]) @ inverse * rows / (rows - len(inverse))
    return Estimate(PARAMETERS, size, values, directions, covariance, information, unidentifiable)


def _whitened(
    samples: Samples, values: np.ndarray, directions: np.ndarray, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives (6 n, k) of whitened torques, and their residuals (6 n,); zero in rows that are not used."""
    both = samples.used[:, :, None] & samples.used[:, None, :]
    white = np.where(both, core.whitening(np.where(both, noise, np.eye(LEG_COUNT))), 0.0)
    slope = (white @ (samples.derivative(values) @ directions)).reshape(-1, directions.shape[1])
    return slope, np.einsum("nij,nj->ni", white, samples.measured - samples.predicted(values)).ravel()


def _noise(samples: Samples, values: np.ndarray) -> np.ndarray:
    """Covariance (6, 6) [N^2 m^2] of the residuals, for two motors by the rows that count for both."""
    used = samples.used.astype(float)
    residual = (samples.measured - samples.predicted(values)) * used
    covariance = residual.T @ residual / np.maximum(used.T @ used, 1.0)
    # Pairs that seldom move at once could make it indefinite; half of the correlation is on the safe side.
    covariance = 0.5 * (covariance + np.diag(np.diag(covariance)))
    return covariance + 1e-12 * float(np.mean(samples.measured**2)) * np.eye(LEG_COUNT)


def _long_run(samples: Samples, scores: np.ndarray) -> np.ndarray:
    """Covariance (k, k) of the sum of scores (6 n, k), those of six rows at a time correlated over `MEMORY`.

    W. K. Newey and K. D. West, Econometrica 55 (1987).
    """
    of_instant = scores.reshape(len(samples.time), LEG_COUNT, -1).sum(axis=1)
    lags = max(1, round(MEMORY / samples.step))
    total = of_instant.T @ of_instant
    for recording in (of_instant[piece] for piece in samples.pieces):
        for lag in range(1, min(lags + 1, len(recording))):
            part = (1.0 - lag / (lags + 1.0)) * recording[lag:].T @ recording[:-lag]
            total = total + part + part.T
    return total


def _refuse_other(guess: RobotParameters, samples: Samples, values: np.ndarray) -> None:
    """Refuses torques that do not fit the motion, or are of another size than the guess's."""

    def size(torque: np.ndarray) -> float:
        return float(np.sqrt(np.mean(torque[samples.used] ** 2))) if samples.used.any() else 0.0

    torque = samples.measured
    measured, expected = size(torque), size(samples.predicted(torques.values_of(guess)))
    residual, changes = size(torque - samples.predicted(values)), size(torque - torque.mean(axis=0))
    if residual > max(_UNEXPLAINED * changes, _NOISY * measured):
        share = min(100.0, 100.0 * residual / changes)
        got = f"torques with {share:.0f} % of their changes unexplained by any parameters"
    elif expected > 0.0 and not 1.0 / _FACTOR < measured / expected < _FACTOR:
        got = f"torques of {measured:.3g} N m where the guess needs {expected:.3g} N m (RMS)"
    else:
        return
    raise ConfigurationError(samples.source, got, "a log of the guessed robot, angles in rad, torques in N m")


def pseudo_inertia(guess: RobotParameters, values: np.ndarray) -> np.ndarray:
    """(4, 4) [kg] of the platform with lengths in those of the robot."""
    length = guess.characteristic_length
    inertia, moment = torques.inertia_matrix(values) / length**2, values[torques.MOMENT] / length
    top = np.concatenate([0.5 * np.trace(inertia) * np.eye(3) - inertia, moment[:, None]], axis=1)
    return np.concatenate([top, np.append(moment, values[torques.MASS])[None]])


def _lower_bounds(guess: RobotParameters) -> np.ndarray:
    """Least values (`SIZE`,) of the parameters, -inf for none; half the moment of a rod about its axis is the least."""
    bounds, start = np.full(SIZE, -np.inf), torques.values_of(guess)
    bounds[[torques.ROD_MASS, torques.CRANK_MASS]] = LEAST * start[[torques.ROD_MASS, torques.CRANK_MASS]]
    bounds[torques.ROD_INERTIA] = 0.5 * guess.rod_inertia[2] * (1.0 + LEAST)
    bounds[torques.CRANK_MASS + 1 : VISCOUS.stop] = 0.0
    return bounds


def is_consistent(guess: RobotParameters, values: np.ndarray) -> bool:
    """Whether bodies can have parameters (`SIZE`,), with half of `LEAST` to spare."""
    smallest = np.linalg.eigvalsh(pseudo_inertia(guess, values))[0]
    inside = (values >= _lower_bounds(guess) - 1e-9 * torques.scales(guess)).all()
    return bool(smallest >= 0.5 * LEAST * guess.platform_mass and inside)


def consistent(guess: RobotParameters, estimate: Estimate) -> np.ndarray:
    """Parameters (`SIZE`,) that bodies can have, nearest to an estimate by its information: a semidefinite program.

    P. M. Wensing, S. Kim, J.-J. E. Slotine, "Linear matrix inequalities for physically consistent inertial parameter
    identification" (IEEE RA-L 3, 2018). Rods, cranks and rotors have no negative mass, and no friction drives.
    """
    bounds, values = _lower_bounds(guess), estimate.values
    if is_consistent(guess, values):
        return np.maximum(values, bounds)
    from pydrake.solvers import ClarabelSolver, MathematicalProgram

    with drake_guard("the semidefinite program"):
        program = MathematicalProgram()
        # In these directions the information is a multiple of 1; the longest is the size of a parameter.
        ways = estimate.directions @ core.whitening(estimate.information).T
        ways = ways / np.abs(ways / torques.scales(guess)[:, None]).max()
        along = program.NewContinuousVariables(ways.shape[1], "along")
        program.AddQuadraticCost(2.0 * np.eye(len(along)), np.zeros(len(along)), along)
        constant, *slopes = (pseudo_inertia(guess, row) / guess.platform_mass for row in (values, *ways.T))
        program.AddLinearMatrixInequalityConstraint([constant - LEAST * np.eye(4), *slopes], along)
        size = np.abs(ways).max(axis=1)
        # Parameters that keep the guess's value have size 0, and their values are those of bodies.
        bounded = (size > 0.0) & np.isfinite(bounds)
        least = (bounds - values)[bounded] / size[bounded]
        for row, bound in zip((ways[bounded] / size[bounded, None]), least, strict=True):
            program.AddLinearConstraint(row, bound, np.inf, along)
        result = ClarabelSolver().Solve(program)
        nearest = values + ways @ result.GetSolution(along)
    # The solver keeps bounds within a tolerance.
    nearest[bounded] = np.maximum(nearest, bounds)[bounded]
    if not result.is_success() or not is_consistent(guess, nearest):
        raise InconsistentError(f"no bodies near the estimate: {result.get_solution_result()}")
    return nearest
