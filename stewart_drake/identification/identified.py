"""What an identification found."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from stewart_drake.files.tables import need_pandas
from stewart_drake.identification.estimate import Estimate
from stewart_drake.identification.parameters import (
    COULOMB,
    GAIN,
    PARAMETERS,
    SIZE,
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


@dataclass(frozen=True)
class Prediction:
    """How well torques of a recording are predicted, as parts of their RMS [-].

    Attributes:
        source: Whose torques.
        guess: By the guess, without friction.
        found: By what was found, where no crank sticks.
        everywhere: By what was found, everywhere.
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
        values: (`SIZE`,) parameters that bodies can have.
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
        """(`SIZE`,) of the 95 % intervals; 0 for what kept its value."""
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
            unit = np.eye(SIZE)[kept.at]
            for at, amount in enumerate(self.estimate.told(unit)):
                if at != kept.at and abs(amount) * size[kept.at] > _SHOWN * size[at]:
                    names[at] += f" {'+' if amount > 0.0 else '-'} {abs(amount):.3g} {PARAMETERS[kept.at]}"
        return names

    def rows(self) -> list[tuple[Any, ...]]:
        """A row of `COLUMNS` for each parameter; torque constants as natural logarithms."""
        start, names = of_robot(self.guess), self.base_parameters()
        return [
            (
                own.kind,
                own.part,
                own.unit,
                float(start[at]),
                float(self.values[at]),
                float(self.half_width[at]),
                names[at],
            )
            for at, own in enumerate(PARAMETERS)
        ]

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
        for each in self.estimate.untold:
            own = PARAMETERS[each.at]
            others = ", ".join(
                f"{other} by {each.direction[at]:+.3g} {other.unit}".strip()
                for at, other in enumerate(PARAMETERS)
                if at != each.at and abs(each.share[at]) > _SHOWN
            )
            badly = "by no motion" if np.isinf(each.deviation) else f"off by {each.deviation:.2g} times its size"
            yield f"{own} ({badly}): with each {own.unit or 'unit'} more of it {others or 'nothing'}"

    def __repr__(self) -> str:
        """What was identified and how well it predicts, in a few lines."""
        mass, place = self.payload
        where = " ".join(f"{1e3 * x:.3g}" for x in place)
        lines = [
            f"Identification of {self.samples.source}: {len(self.estimate.covariance)} numbers",
            *(f"  torques of {p.source}: {100 * p.guess:.3g} % -> {100 * p.found:.3g} % off" for p in self.predictions),
            f"  platform {mass:+.4g} +- {self.half_width[0]:.2g} kg at {where} mm",
            f"  coulomb {_six(self.coulomb)} N m, viscous {_six(self.viscous)} N m s/rad",
            f"  not told: {'; '.join(self.untold()) or 'nothing'}",
        ]
        return "\n".join(lines)


def _six(values: np.ndarray) -> str:
    return " ".join(f"{value:.3g}" for value in values)
