"""What an identification found, as numbers, as tables, and as the files that it leaves."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from stewart_drake.files.tables import need_pandas
from stewart_drake.files.yaml_files import to_yaml
from stewart_drake.identification.estimate import Estimate
from stewart_drake.identification.parameters import (
    COULOMB,
    GAIN,
    PARAMETERS,
    VISCOUS,
    Kind,
    as_robot,
    of_robot,
    scales,
)
from stewart_drake.identification.samples import Samples
from stewart_drake.robot import RobotParameters

COLUMNS = ("parameter", "part", "unit", "guess", "value", "half_width", "base_parameter")
_SHOWN = 0.02
"""[-] of its own size by which a parameter must be in a sum for it to be named there."""


class Prediction(NamedTuple):
    """Errors of a recording's predicted torques over their RMS [-]: by the guess without friction, by what was found.

    The first two where no crank sticks, the last everywhere.
    """

    source: str
    guess: float
    found: float
    everywhere: float


@dataclass(frozen=True, eq=False, repr=False)
class Identification:
    """A robot's parameters, and how well they are known.

    Attributes:
        guess: What the identification started from.
        values: (32,) parameters that bodies can have.
        estimate: What the least squares said before that.
        held: Kinds that kept the guess's value.
        samples: What it was made of.
        logs: How many recordings these are.
        predictions: Of the recordings that it was made of, then of those that were not used.
    """

    guess: RobotParameters
    values: np.ndarray
    estimate: Estimate
    held: tuple[Kind, ...]
    samples: Samples
    logs: int
    predictions: tuple[Prediction, ...]

    @cached_property
    def robot(self) -> RobotParameters:
        """The robot with what was found of its bodies."""
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
        """(6,) [-] torques over what the log says; of geometric mean 1 unless the platform's mass is held."""
        return np.exp(self.values[GAIN])

    @property
    def payload(self) -> tuple[float, np.ndarray]:
        """Mass [kg] of the platform above the guess's, and where in P (3,) [m] it sits; NaN where there is none."""
        change = self.values - of_robot(self.guess)
        mass = float(change[0])
        known = abs(mass) > self.half_width[0] > 0.0
        return mass, change[1:4] / mass if known else np.full(3, np.nan)

    @property
    def friction(self) -> dict[str, list[float]]:
        """What goes for `plant.friction` in a scenario."""
        return {"coulomb": self.coulomb.tolist(), "viscous": self.viscous.tolist()}

    def base_parameters(self) -> list[str]:
        """What each parameter's value means: itself, or a sum with those that keep the guess's value."""
        names, size = [str(own) for own in PARAMETERS], scales(self.guess)
        for kept in self.estimate.untold:
            unit = np.eye(len(names))[kept.at]
            for at, amount in enumerate(self.estimate.told(unit)):
                if at != kept.at and abs(amount) * size[kept.at] > _SHOWN * size[at]:
                    names[at] += f" {'+' if amount > 0.0 else '-'} {abs(amount):.3g} {PARAMETERS[kept.at]}"
        return names

    def rows(self) -> list[tuple[Any, ...]]:
        """A row of `COLUMNS` for each parameter; torque constants as natural logarithms."""
        numbers = np.stack([of_robot(self.guess), self.values, self.half_width], axis=-1).tolist()
        rows = zip(PARAMETERS, numbers, self.base_parameters(), strict=True)
        return [(*own, *row, meaning) for own, row, meaning in rows]

    def to_pandas(self) -> Any:
        """`rows` as a pandas.DataFrame.

        Raises:
            ConfigurationError: pandas is not installed.
        """
        need_pandas("rows() gives the same as tuples")
        import pandas as pd

        return pd.DataFrame(self.rows(), columns=COLUMNS)

    def untold(self) -> Iterator[str]:
        """A sentence for each parameter that the motion does not tell: how badly, and what goes with it."""
        size = scales(self.guess)
        for each in self.estimate.untold:
            own = PARAMETERS[each.at]
            others = ", ".join(
                f"{other} by {each.direction[at]:+.3g} {other.unit}".strip()
                for at, other in enumerate(PARAMETERS)
                if at != each.at and abs(each.direction[at]) * size[each.at] > _SHOWN * size[at]
            )
            badly = "by no motion" if np.isinf(each.deviation) else f"off by {each.deviation:.2g} times its size"
            yield f"{own} ({badly}): with each {own.unit or 'unit'} more of it {others or 'nothing'}"

    def __repr__(self) -> str:
        """What was identified and how well it predicts, in some lines."""
        lines = [f"  {name}: {text}" for name, text in summary(self)]
        return "\n".join([f"Identification of {self.samples.source}", *lines])


def robot_file(found: Identification) -> str:
    """The identified robot as a file that goes for `robot:` or `model_robot:` in a scenario."""
    within = [
        f"{'its torques' if at < found.logs else 'torques of a log not used'} within {100 * each.found:.2g} %"
        for at, each in enumerate(found.predictions)
    ]
    about = f"identified from {found.logs} {'log' if found.logs == 1 else 'logs'}: {'; '.join(within)}"
    lines = ["Friction, for `plant.friction` of a scenario:", *friction_file(found).splitlines(), _constants(found)]
    lines += ["Values with 95 % intervals:", *(f"  {name}: {text}" for name, _, text, _ in parameter_columns(found)[1])]
    comments = "".join(f"# {line}\n" for line in lines)
    return f"{comments}{to_yaml({'about': about, **found.robot.to_dict()})}"


def friction_file(found: Identification) -> str:
    """Friction of the motors as a part of a scenario."""
    return to_yaml({"plant": {"friction": found.friction}})


def parameter_table(found: Identification) -> str:
    """`Identification.rows` as CSV."""
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerows([COLUMNS, *found.rows()])
    return stream.getvalue()


def summary(found: Identification) -> list[tuple[str, str]]:
    """What was found, as rows of two texts."""
    mass, place = found.payload
    at = f" at {' '.join(f'{1e3 * x:.1f}' for x in place)} mm in P" if np.isfinite(place).all() else ""
    corrected = (np.abs(found.values - found.estimate.values) > 1e-9 * scales(found.guess)).any()
    torques = [
        (
            f"torques off (RMS), {'fitted' if at < found.logs else 'not used'}: {each.source}",
            f"{100 * each.guess:.3g} % -> {100 * each.found:.3g} % where no crank sticks, "
            f"{100 * each.everywhere:.3g} % everywhere",
        )
        for at, each in enumerate(found.predictions)
    ]
    return [
        ("instants, numbers told", f"{len(found.samples.time)}, {len(found.estimate.covariance)}"),
        ("rows in which a crank moves", f"{100.0 * found.samples.used.mean():.0f} %"),
        *torques,
        ("platform beyond the guess", f"{mass:+.4g} ± {found.half_width[0]:.2g} kg{at}"),
        ("bodies", "moved to the nearest that can be" if corrected else "as estimated: they can be"),
        ("coulomb, viscous friction", f"{_few(found.coulomb)} N m, {_few(found.viscous)} N m s/rad"),
        ("torque constants", _constants(found)),
        *(("not told, the guess's stays", line) for line in found.untold()),
    ]


def parameter_columns(found: Identification) -> tuple[list[str], list[list[str]]]:
    """Header and rows: guess, value with 95 % interval and meaning of each parameter; torque constants as factors."""
    rows = []
    for own, (*_, guess, value, width, meaning) in zip(PARAMETERS, found.rows(), strict=True):
        if own.kind == "torque_constant":
            guess, value, width = np.exp(guess), np.exp(value), np.exp(value) * width
        name = f"{own}".replace("_", " ") + (f" [{own.unit}]" if own.unit else "")
        sure = f"{value:.5g} ± {width:.2g}" if width > 0.0 else f"{value:.5g}, kept"
        rows.append([name, f"{guess:.5g}", sure, "" if meaning == str(own) else meaning])
    return ["", "guess", "value", "means"], rows


def report(found: Identification) -> str:
    """A page in Markdown."""
    header, rows = parameter_columns(found)
    lines = [
        f"# Identification from {found.samples.source}",
        "",
        *(f"- {name}: {text}" for name, text in summary(found)),
        "",
        "Values with 95 % intervals. Moments and inertias of the platform are about the origin of P. Where a value",
        "means a sum, the parameters after the first have the guess's values; the logs tell the sum alone.",
        "",
        *(f"| {' | '.join(row)} |" for row in (header, ["---"] * len(header), *rows)),
        "",
        "![Torques and what is left of them](identification.png)",
        "",
    ]
    return "\n".join(lines)


def _few(values: np.ndarray) -> str:
    return " ".join(f"{value:.3g}" for value in values)


def _constants(found: Identification) -> str:
    constants = ", ".join(f"{constant:.4f}" for constant in found.torque_constants)
    what = "of the torques in the logs" if "platform_mass" in found.held else "of their geometric mean, taken as 1"
    return f"Motors 0 to 5 give {constants} {what}"
