"""Why poses do not fit: swapped or inverted encoders, a single wrong row, a leg on its other branch."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
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


def explain_misfit(given: Callable[[Measurements], Start], measurements: Measurements) -> Start:
    """A start whose measurements fit, or fit as well as anything does.

    Args:
        given: Makes the start of measurements.
        measurements: As they are.

    Raises:
        ConfigurationError: Two encoders are swapped, one is inverted, one row is wrong, or a leg stands on the other
            branch than the guess's; else what `given` raises for the measurements.
    """
    problem: ConfigurationError | None = None
    start: Start | None = None
    try:
        start = given(measurements)
        misfit = start.score
    except ConfigurationError as error:
        problem, misfit = error, np.inf
    if misfit > MISFIT:
        found = [(_misfit(given, other), error) for other, error in _others(measurements, start)]
        best, reason = min(found, key=lambda each: each[0])
        if best * BETTER < misfit and best < np.inf:
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
    for one, other in itertools.combinations(range(LEGS), 2):
        swapped = angles.copy()
        swapped[:, [one, other]] = angles[:, [other, one]]
        got = "readings that fit if these two are swapped"
        error = ConfigurationError(f"{source}: theta_{one} and theta_{other}", got, "each leg's own encoder")
        yield Measurements(pose, swapped, source), error
    for leg in range(LEGS):
        inverted = angles.copy()
        inverted[:, leg] = -angles[:, leg]
        got = "readings that fit with the other sign"
        error = ConfigurationError(f"{source}: theta_{leg}", got, "angles that grow as the guess's crank angle does")
        yield Measurements(pose, inverted, source), error
    if start is None or start.misfit <= MISFIT:
        return
    closures, _ = start.model.closure_error(start.change, measurements)
    for row in np.argsort(-np.abs(closures).max(axis=-1))[:_ROWS].tolist():
        got = "a pose that does not fit the others, which fit without it"
        error = ConfigurationError(f"{source}: row {row + 1}", got, "pose and readings of the same moment, at rest")
        yield measurements.without(row), error


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
