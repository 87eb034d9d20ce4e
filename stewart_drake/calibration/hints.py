"""Why poses do not fit: a wrong unit, an inverted encoder, a single wrong row, a leg on its other branch."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from stewart_drake.calibration.frames import derivative
from stewart_drake.calibration.measurements import Measurements
from stewart_drake.calibration.model import Model
from stewart_drake.calibration.parameters import OF_LEG, OF_ROBOT, PER_LEG, scales
from stewart_drake.errors import ConfigurationError
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEGS

MISFIT = 5.0
"""[-] size of the closures over their noise beyond which a reason is looked for."""
BETTER = 5.0
"""[-] how many times smaller they must become for a reason to be named."""
FAR = 0.3
"""[-] change of a parameter, in `parameters.scales`, that nobody's guess is off by: an inverted encoder is fitted well
by a motor that is turned over."""
_FEW = 0.2
"""Of the rows: so many at most can be strays."""
_ROWS = 3
_DEGREE = math.pi / 180.0
_UNITS = tuple(
    (key, columns, factor**sign, ("{0} for {1}", "{1} for {0}")[sign < 0].format(*units))
    for key, columns, factor, units in (
        ("pose_x, y, z", slice(3, 6), 1e-3, ("millimetres", "metres")),
        ("pose_roll, pitch, yaw", slice(0, 3), _DEGREE, ("degrees", "radians")),
        ("crank_angle", slice(6, 12), _DEGREE, ("degrees", "radians")),
    )
    for sign in (1, -1)
)
LEAST = 4
"""Poses of the guess from which both frames follow."""
_APART = 10.0
"""How many times further than rows usually are one is off for a stray."""


@dataclass(frozen=True, eq=False)
class Start:
    """Parameters near the answer: a step (k,) [-] from a model along told directions (`SIZE`, k), in `scales`.

    In untold directions (`SIZE`, j) the guess stands; `misfit` is the size of the closures left over their noise.
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


def stray_rows(guess: RobotParameters, measurements: Measurements) -> list[int]:
    """Rows that are turned or shifted from their neighbours as the guess is not, or where it is none; the worst first.

    How far one pose is turned from another does not depend on any frame, and their distance hardly does.
    """
    believed, good = Model(guess).assembled(measurements.angles)
    seen, steps = (np.linalg.norm(each.steps(), axis=-1) for each in (measurements.marker.rows(good), believed))
    off = np.abs(seen - steps)
    far = np.where(good, 0.0, np.inf)
    if good.any():
        most = (off / (np.median(off, axis=-1, keepdims=True) + 1e-12)).max(axis=0)
        far[good] = np.minimum(most, np.roll(most, -1))
    return [row for row in np.argsort(-far, kind="stable").tolist() if far[row] > _APART]


def explained(fit: Callable[[Measurements], Start], measurements: Measurements, strays: list[int]) -> Start:
    """The fit of measurements; refuses them if others, that are right if something is wrong, fit much better.

    Suspect are some rows, the worst first, and what else people get wrong.
    """
    start, reason, best = None, None, np.inf
    try:
        start = fit(measurements)
    except ConfigurationError as error:
        reason = error
    if start is not None:
        if start.score <= MISFIT:
            return _on_its_branches(start)
        best = start.misfit / BETTER if start.score < np.inf else max(MISFIT, start.misfit / BETTER)
    for table, *why in _others(measurements, start, strays):
        try:
            score = fit(Measurements(table[:, :6], table[:, 6:], measurements.source)).score
        except ConfigurationError:
            continue
        if score < best:
            best, reason = score, ConfigurationError(*why)
            if score <= MISFIT:
                break
    if reason is not None:
        raise reason
    assert start is not None
    if start.score == np.inf:
        at = int(np.abs(start.told @ start.step)[:OF_ROBOT].argmax())
        own, off = OF_LEG[at % PER_LEG], abs(start.change[at])
        got = f"poses that tell a {own} of leg {at // PER_LEG} {off:.3g} {own.unit} off the guess"
        allowed = "readings of this robot; is it another one, or are two encoders swapped?"
        raise ConfigurationError(measurements.source, got, allowed)
    return _on_its_branches(start)


def _others(
    measurements: Measurements, start: Start | None, strays: list[int]
) -> Iterator[tuple[np.ndarray, str, str, str]]:
    """Poses and readings (n, 12) that would be right if something were wrong, and what to say of it."""
    source, suspects = measurements.source, []
    if 0 < len(strays) <= _FEW * len(measurements):
        suspects.append(strays)
    if start is not None:
        at = start.model.measured(start.change, measurements.marker)
        closures = start.model.closures(start.change, at, measurements.angles)
        suspects += [[row] for row in np.argsort(-np.abs(closures).max(axis=-1))[:_ROWS].tolist()]
    table = np.concatenate([measurements.pose, measurements.angles], axis=-1)
    for key, columns, factor, what in _UNITS:
        scaled = table.copy()
        scaled[:, columns] *= factor
        got = f"numbers that fit if they are multiplied by {factor:.4g}"
        yield (scaled, f"{source}: {key}", got, f"the unit that the column's name says; perhaps {what}?")
    for rows in suspects:
        got, allowed = "a pose that does not fit the others, which fit without it", "pose and readings at rest"
        yield np.delete(table, rows, axis=0), f"{source}: row {rows[0] + 1}", got, allowed
    for leg in range(LEGS):
        inverted = table * np.where(np.arange(12) == 6 + leg, -1.0, 1.0)
        key, got = f"{source}: crank_angle_{leg}", "readings that fit with the other sign"
        yield inverted, key, got, "angles that grow as the guess's crank angle does"


def _on_its_branches(start: Start) -> Start:
    """A start; refuses a leg that stands on the other branch than the guess's in each row."""
    model, source = start.model, start.measurements.source
    at = model.measured(start.change, start.measurements.marker)
    by_angle = derivative(lambda step: model.closures(start.change, at, start.measurements.angles + step[0]), 1)
    # By a leg's own angle its closure grows on the branch +1: the rod then pulls against the crank's motion.
    wrong = (np.sign(by_angle[..., 0]) == -model.guess.branches).all(axis=0)
    if wrong.any():
        leg = int(wrong.argmax())
        branch = int(model.guess.branches[leg])
        allowed = f"{-branch}: there the readings of {source} stand"
        raise ConfigurationError(f"robot.legs.{leg}.branch", branch, allowed)
    return start
