"""Why poses do not fit: swapped or inverted encoders, a single wrong row, a leg on its other branch."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from stewart_drake.calibration.measurements import Measurements
from stewart_drake.calibration.model import Model
from stewart_drake.calibration.parameters import OF_ROBOT, scales
from stewart_drake.errors import ConfigurationError
from stewart_drake.robot.leg import LEGS

MISFIT = 5.0
"""[-] size of the closures over their noise beyond which a reason is looked for."""
BETTER = 5.0
"""[-] how many times smaller they must become for a reason to be named."""
FAR = 0.3
"""[-] change of a parameter, in `parameters.scales`, that nobody's guess is off by. Legs whose encoders are swapped
are fitted well by a robot whose shafts are swapped too, and an inverted encoder by a motor that is turned over."""
STRAY = 50.0
"""[-] size of a row's closures over their noise, for a robot fitted to the others, beyond which the row is wrong."""
_FEW = 0.2
"""Of the rows: so many at most can be strays."""
_ROWS = 3


@dataclass(frozen=True, eq=False)
class Start:
    """Parameters in the neighbourhood of the answer.

    Attributes:
        model: Guess and frames from which changes are counted.
        measurements: What was fitted.
        told: (`SIZE`, k) directions, in `scales`, that are estimated.
        untold: (`SIZE`, j) directions that the poses cannot tell: the guess stands in them.
        step: (k,) [-] along the told directions.
        misfit: [-] size of the closures that are left over that of their noise.
    """

    model: Model
    measurements: Measurements
    told: np.ndarray
    untold: np.ndarray
    step: np.ndarray
    misfit: float

    @property
    def change(self) -> np.ndarray:
        """(`SIZE`,) [m, rad]."""
        return scales(self.model.guess) * (self.told @ self.step)

    @property
    def score(self) -> float:
        """[-] the misfit; infinite where the legs are nothing like the guess's."""
        return self.misfit if np.abs((self.told @ self.step)[:OF_ROBOT]).max() <= FAR else np.inf


def explain_misfit(
    given: Callable[[Measurements], Start], measurements: Measurements, strays: Sequence[int] = ()
) -> Start:
    """A start whose measurements fit, or fit as well as anything does.

    Args:
        given: Makes the start of measurements.
        measurements: As they are.
        strays: Rows that are suspect, see `frames.stray_rows`.

    Raises:
        ConfigurationError: Two encoders are swapped, one is inverted, one row is wrong, or a leg stands on the other
            branch than the guess's; else what `given` raises for the measurements.
    """
    _refuse_strays(given, measurements, strays)
    problem: ConfigurationError | None = None
    start: Start | None = None
    try:
        start = given(measurements)
        misfit = start.score
    except ConfigurationError as error:
        problem, misfit = error, np.inf
    if misfit > MISFIT:
        best, reason = np.inf, problem
        for other, why in _others(measurements, start):
            if (found := _misfit(given, other)) < best:
                best, reason = found, why
            if best <= min(MISFIT, misfit / BETTER):
                break
        if reason is not None and best * BETTER < misfit and best < np.inf:
            raise reason
    if start is None:
        assert problem is not None
        raise problem
    _refuse_branch(start)
    return start


def _misfit(given: Callable[[Measurements], Start], measurements: Measurements) -> float:
    try:
        return given(measurements).score
    except ConfigurationError:
        return np.inf


def _others(measurements: Measurements, start: Start | None) -> Iterator[tuple[Measurements, ConfigurationError]]:
    """Measurements that would be right if something were wrong, and what to say of it."""
    source, pose, angles = measurements.source, measurements.pose, measurements.angles
    if start is not None and start.misfit > MISFIT:
        closures, _ = start.model.closure_error(start.change, measurements)
        for row in np.argsort(-np.abs(closures).max(axis=-1))[:_ROWS].tolist():
            yield measurements.without(row), _wrong_row(measurements, row)
    for one, other in itertools.combinations(range(LEGS), 2):
        swapped = angles.copy()
        swapped[:, [one, other]] = angles[:, [other, one]]
        got = "readings that fit if these two are swapped"
        error = ConfigurationError(
            f"{source}: crank_angle_{one} and crank_angle_{other}", got, "each leg's own encoder"
        )
        yield Measurements(pose, swapped, source), error
    for leg in range(LEGS):
        inverted = angles.copy()
        inverted[:, leg] = -angles[:, leg]
        got = "readings that fit with the other sign"
        error = ConfigurationError(
            f"{source}: crank_angle_{leg}", got, "angles that grow as the guess's crank angle does"
        )
        yield Measurements(pose, inverted, source), error


def _wrong_row(measurements: Measurements, row: int) -> ConfigurationError:
    got = "a pose that does not fit the others, which fit without it"
    allowed = "pose and readings of the same moment, at rest"
    return ConfigurationError(f"{measurements.source}: row {row + 1}", got, allowed)


def _refuse_strays(given: Callable[[Measurements], Start], measurements: Measurements, strays: Sequence[int]) -> None:
    """Refuses a suspect row that does not fit a robot that fits the others.

    A fit to all rows, one of them absurd, takes long and tells little.

    Raises:
        ConfigurationError: There is one.
    """
    if not 0 < len(strays) <= _FEW * len(measurements):
        return
    try:
        start = given(measurements.without(strays))
    except ConfigurationError:
        return
    if start.score > MISFIT:
        return
    with np.errstate(all="ignore"):
        closures, _ = start.model.closure_error(start.change, measurements)
        sizes = np.linalg.norm(closures, axis=-1)
    usual = np.sqrt(np.mean(np.delete(sizes, strays) ** 2)) / max(start.misfit, 1.0)
    worst = max(strays, key=lambda row: sizes[row])
    if not sizes[worst] <= STRAY * usual:
        raise _wrong_row(measurements, worst)


def _refuse_branch(start: Start) -> None:
    """Refuses a leg that stands on the other branch than the guess's in each row.

    Raises:
        ConfigurationError: There is one.
    """
    model, measurements = start.model, start.measurements
    at = model.measured(start.change, measurements)
    # By a leg's own angle its closure grows on the branch +1: the rod then pulls against the crank's motion.
    side = np.sign(model.closures(start.change, at, measurements.angles).by_angle)
    wrong = (side == -model.guess.branches).all(axis=0)
    if wrong.any():
        leg = int(wrong.argmax())
        branch = int(model.guess.branches[leg])
        allowed = f"{-branch}: there the readings of {measurements.source} stand"
        raise ConfigurationError(f"robot.legs.{leg}.branch", branch, allowed)
