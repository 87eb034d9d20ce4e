"""From logs to a robot: reads, fits, makes it one of bodies, and asks logs that were not used; and what was found."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np

from stewart_drake.errors import ConfigurationError
from stewart_drake.files.report import Report
from stewart_drake.files.yaml_files import to_yaml
from stewart_drake.identification.estimate import ASKED, Estimate, Unidentifiable, consistent, estimate
from stewart_drake.identification.parameters import (
    COULOMB,
    GAIN,
    KINDS,
    PARAMETERS,
    VISCOUS,
    Kind,
    as_robot,
    of_robot,
    scales,
)
from stewart_drake.identification.samples import Recording, Samples, load_recording, of_log, samples_of, together
from stewart_drake.logs.log import SimulationLog
from stewart_drake.robot import RobotParameters

AnyLog = Recording | SimulationLog | str | Path
_SHOWN = 0.02  # [-] of its own size by which a parameter must be in a sum for it to be named there


class Prediction(NamedTuple):
    """Errors of predicted torques over their RMS [-], the first two where no crank sticks."""

    source: str
    guess: float
    found: float
    everywhere: float


@dataclass(frozen=True, eq=False, repr=False)
class Identification(Report):
    """A robot's parameters, and how well they are known.

    Attributes:
        guess: The robot that the identification started from.
        values: (32,) estimated parameters, physically consistent.
        estimate: (32,) result of the least squares before that.
        held: Kinds that kept the guess's value.
        samples: The samples that it used.
        logs: Number of recordings.
        predictions: Of the recordings that were fitted, then of those for validation.
    """

    guess: RobotParameters
    values: np.ndarray
    estimate: Estimate
    held: tuple[Kind, ...]
    samples: Samples
    logs: int
    predictions: tuple[Prediction, ...]

    columns: ClassVar = ("parameter", "part", "unit", "guess", "value", "half_width", "base_parameter")
    about: ClassVar = (
        "Values with 95 % intervals. Moments and inertias of the platform are about the origin of P. Where a value\n"
        "means a sum, the parameters after the first have the guess's values; the logs determine only the sum."
    )
    picture: ClassVar = "Torques and their residuals"

    @property
    def title(self) -> str:
        return f"Identification from {self.samples.source}"

    @cached_property
    def robot(self) -> RobotParameters:
        return as_robot(self.guess, self.values)

    @property
    def half_width(self) -> np.ndarray:
        """(32,) of the 95 % intervals; 0 for what kept its value."""
        return self.estimate.half_width

    @property
    def coulomb(self) -> np.ndarray:
        """(6,) [N m] dry friction of each motor."""
        return self.values[COULOMB].copy()

    @property
    def viscous(self) -> np.ndarray:
        """(6,) [N m s/rad] viscous friction of each motor."""
        return self.values[VISCOUS].copy()

    @property
    def torque_constants(self) -> np.ndarray:
        """(6,) [-] true torques over those of the log; of geometric mean 1 unless the platform's mass is held."""
        return np.exp(self.values[GAIN])

    @property
    def payload(self) -> tuple[float, np.ndarray]:
        """Mass [kg] of the platform above the guess's, and where in P (3,) [m] it sits; NaN where there is none."""
        change = self.values - of_robot(self.guess)
        mass = float(change[0])
        known = abs(mass) > self.half_width[0] > 0.0
        return mass, change[1:4] / mass if known else np.full(3, np.nan)

    def base_parameters(self) -> list[str]:
        """What each parameter's value means: itself, or a sum with those that keep the guess's value."""
        names, size = [str(own) for own in PARAMETERS], scales(self.guess)
        for kept in self.estimate.unidentifiable:
            unit = np.eye(len(names))[kept.at]
            for at, amount in enumerate(self.estimate.identifiable_part(unit)):
                if at != kept.at and abs(amount) * size[kept.at] > _SHOWN * size[at]:
                    names[at] += f" {'+' if amount > 0.0 else '-'} {abs(amount):.3g} {PARAMETERS[kept.at]}"
        return names

    def rows(self) -> list[tuple[Any, ...]]:
        """A row of `columns` for each parameter; torque constants as natural logarithms."""
        numbers = np.stack([of_robot(self.guess), self.values, self.half_width], axis=-1).tolist()
        rows = zip(PARAMETERS, numbers, self.base_parameters(), strict=True)
        return [(*own, *row, meaning) for own, row, meaning in rows]

    def summary(self) -> list[tuple[str, str]]:
        mass, place = self.payload
        at = f" at {' '.join(f'{1e3 * x:.1f}' for x in place)} mm in P" if np.isfinite(place).all() else ""
        corrected = (np.abs(self.values - self.estimate.values) > 1e-9 * scales(self.guess)).any()
        torques = [
            (
                f"torque error (RMS), {'fitted' if at < self.logs else 'not used'}: {each.source}",
                f"{100 * each.guess:.3g} % -> {100 * each.found:.3g} % where no crank sticks, "
                f"{100 * each.everywhere:.3g} % everywhere",
            )
            for at, each in enumerate(self.predictions)
        ]
        return [
            ("samples, parameters estimated", f"{len(self.samples.time)}, {len(self.estimate.covariance)}"),
            ("rows in which a crank moves", f"{100.0 * self.samples.used.mean():.0f} %"),
            *torques,
            ("platform beyond the guess", f"{mass:+.4g} ± {self.half_width[0]:.2g} kg{at}"),
            ("bodies", "moved to the nearest physical ones" if corrected else "physical as estimated"),
            ("coulomb, viscous friction", f"{_few(self.coulomb)} N m, {_few(self.viscous)} N m s/rad"),
            ("torque constants", self._constants()),
            *(("not identifiable, guess kept", self._sentence(each)) for each in self.estimate.unidentifiable),
        ]

    def _constants(self) -> str:
        constants = ", ".join(f"{constant:.4f}" for constant in self.torque_constants)
        what = "of the torques in the logs" if "platform_mass" in self.held else "of their geometric mean, taken as 1"
        return f"Motors 0 to 5 give {constants} {what}"

    def _sentence(self, unidentifiable: Unidentifiable) -> str:
        """How badly the motion tells a parameter, and what goes with it."""
        size, own = scales(self.guess), PARAMETERS[unidentifiable.at]
        others = ", ".join(
            f"{other} by {unidentifiable.direction[at]:+.3g} {other.unit}".strip()
            for at, other in enumerate(PARAMETERS)
            if at != unidentifiable.at
            and abs(unidentifiable.direction[at]) * size[unidentifiable.at] > _SHOWN * size[at]
        )
        badly = (
            "by no motion"
            if np.isinf(unidentifiable.deviation)
            else f"off by {unidentifiable.deviation:.2g} times its size"
        )
        return f"{own} ({badly}): with each {own.unit or 'unit'} more of it {others or 'nothing'}"

    def table(self) -> tuple[list[str], list[list[str]]]:
        rows = []
        for own, (*_, guess, value, width, meaning) in zip(PARAMETERS, self.rows(), strict=True):
            if own.kind == "torque_constant":
                guess, value, width = np.exp(guess), np.exp(value), np.exp(value) * width
            name = f"{own}".replace("_", " ") + (f" [{own.unit}]" if own.unit else "")
            sure = f"{value:.5g} ± {width:.2g}" if width > 0.0 else f"{value:.5g}, kept"
            rows.append([name, f"{guess:.5g}", sure, "" if meaning == str(own) else meaning])
        return ["", "guess", "value", "means"], rows

    def friction_file(self) -> str:
        return to_yaml({"plant": {"friction": {"coulomb": self.coulomb.tolist(), "viscous": self.viscous.tolist()}}})

    def robot_file(self) -> str:
        within = [
            f"{'its torques' if at < self.logs else 'torques of a log not used'} within {100 * each.found:.2g} %"
            for at, each in enumerate(self.predictions)
        ]
        about = f"identified from {self.logs} {'log' if self.logs == 1 else 'logs'}: {'; '.join(within)}"
        lines = ["Friction, for `plant.friction` of a scenario:", *self.friction_file().splitlines()]
        lines += [self._constants(), "Values with 95 % intervals:"]
        lines += [f"  {name}: {text}" for name, _, text, _ in self.table()[1]]
        comments = "".join(f"# {line}\n" for line in lines)
        return f"{comments}{to_yaml({'about': about, **self.robot.to_dict()})}"


def identify(
    robot: RobotParameters,
    logs: Sequence[AnyLog],
    hold: Collection[Kind] = (),
    ask: Collection[Kind] = ASKED,
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
        ConfigurationError: Nothing to read or free, an unknown kind; as `load_recording`, `samples_of` and `estimate`.
        InconsistentError: No physical bodies are near the estimate.
    """
    for name, kinds in (("hold", hold), ("ask", ask)):
        if strange := set(kinds) - set(KINDS):
            raise ConfigurationError(name, min(strange), f"some of {', '.join(KINDS)}")
    if not logs:
        raise ConfigurationError("logs", "none", "at least one log")

    def read(log: AnyLog) -> Samples:
        if isinstance(log, SimulationLog):
            log = of_log(log, robot, f"log of {log.scenario.name}")
        own = log if isinstance(log, Recording) else load_recording(log, robot, lag)
        return samples_of(robot, own, bandwidth)

    parts = [read(log) for log in logs]
    samples, unseen = together(parts), [read(log) for log in validate]
    found = estimate(robot, samples, hold, ask)
    values = consistent(robot, found)
    predictions = tuple(_prediction(robot, each, values) for each in (*parts, *unseen))
    held = tuple(kind for kind in KINDS if kind in hold)
    return Identification(robot, values, found, held, samples, len(parts), predictions)


def _prediction(guess: RobotParameters, samples: Samples, values: np.ndarray) -> Prediction:
    def off(by: np.ndarray, rows: np.ndarray) -> float:
        error = (samples.torque - samples.predicted(by))[rows]
        return float(np.sqrt(np.mean(error**2) / np.mean(samples.torque[rows] ** 2))) if error.size else np.nan

    used, everywhere = samples.used, np.ones_like(samples.used)
    return Prediction(samples.source, off(of_robot(guess), used), off(values, used), off(values, everywhere))


def _few(values: np.ndarray) -> str:
    return " ".join(f"{value:.3g}" for value in values)
