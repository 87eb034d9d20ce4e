"""Why poses do not fit: a wrong unit, an inverted encoder, a single wrong row, a leg on its other branch."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from stewart_drake.calibration.frames import Frame
from stewart_drake.calibration.measurements import Measurements
from stewart_drake.calibration.model import Model
from stewart_drake.calibration.parameters import HOMING, OF_LEG, OF_ROBOT, PER_LEG, scales
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
LEAST = 4
"""Poses of the guess from which both frames follow."""
_APART, _OTHERS = 10.0, 50
"""How many times further than rows usually are one is off for a stray, and the most rows that it is compared with."""


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


def stray_rows(guess: RobotParameters, measurements: Measurements) -> list[int]:
    """Rows that are turned or shifted from the others as the guess is not, and at which it is none; the worst first.

    Turns between two poses do not depend on any frame, and their distance hardly does.
    """
    believed, good = Model(guess).assembled(measurements.angles)
    seen = measurements.marker.rows(good)
    far = np.where(good, 0.0, np.inf)
    if len(seen.shift) >= LEAST:
        others = np.unique(np.linspace(0, len(seen.shift) - 1, _OTHERS).astype(int))

        def apart(frames: Frame) -> np.ndarray:
            traces = np.einsum("nij,mij->nm", frames.turn, frames.turn[others])
            distances = np.linalg.norm(frames.shift[:, None] - frames.shift[others], axis=-1)
            return np.stack([np.arccos(np.clip(0.5 * (traces - 1.0), -1.0, 1.0)), distances])

        off = np.median(np.abs(apart(seen) - apart(believed)), axis=-1)
        far[good] = (off / (np.median(off, axis=-1, keepdims=True) + 1e-12)).max(axis=0)
    return [row for row in np.argsort(-far, kind="stable").tolist() if far[row] > _APART]


def refuse_units(guess: RobotParameters, measurements: Measurements) -> None:
    """Refuses motions so much larger or smaller than believed that a unit must be wrong."""
    believed, good = Model(guess).assembled(measurements.angles)
    seen = measurements.marker.rows(good)
    if len(seen.shift) < LEAST:
        return
    (turned, moved), (turned_too, moved_too) = (
        [float(np.median(np.linalg.norm(each, axis=-1))) for each in frames.steps()] for frames in (seen, believed)
    )
    tiny = 1e-9
    turns, moves = (turned + tiny) / (turned_too + tiny), (moved + tiny) / (moved_too + tiny)
    degrees, kilo = 57.3, 1000.0
    if max(turns, moves) < 3.0 / degrees and min(turns, moves) > 1.0 / (3.0 * degrees):
        key, what = "crank_angle", "degrees for radians"
    elif min(turns, moves) > degrees / 6.0 and max(turns, moves) < 6.0 * degrees:
        key, what = "crank_angle", "radians for degrees"
    elif not 4.0 / kilo < moves < kilo / 4.0:
        key, what = "pose_x, y, z", "millimetres for metres" if moves > 1.0 else "metres for millimetres"
    elif turned_too > 0.01 and not 3.0 / degrees < turns < degrees / 3.0:
        key, what = "pose_roll, pitch, yaw", "degrees for radians" if turns > 1.0 else "radians for degrees"
    else:
        return
    got = f"poses {moved:.3g} m and {turned:.3g} rad apart where the guess moves by {moved_too:.3g} m and "
    got += f"{turned_too:.3g} rad"
    raise ConfigurationError(f"{measurements.source}: {key}", got, f"motions of that size; perhaps {what}?")


def explained(fit: Callable[[Measurements], Start], measurements: Measurements, strays: list[int]) -> Start:
    """The fit of measurements, unless others, that are right if something is wrong, fit much better.

    Args:
        fit: Fits any measurements.
        measurements: As they are.
        strays: Rows that are suspect, the worst first.

    Raises:
        ConfigurationError: What is wrong; else what `fit` raises for the measurements.
    """
    start, reason, misfit, best = None, None, np.inf, np.inf
    try:
        start = fit(measurements)
        misfit = start.score
    except ConfigurationError as error:
        reason = error
    if misfit > MISFIT:
        for other, why in _others(measurements, start, strays):
            try:
                score = fit(other).score
            except ConfigurationError:
                continue
            if score < best:
                best, reason = score, why
            if best <= min(MISFIT, misfit / BETTER):
                break
    if reason is not None and (start is None or (best * BETTER < misfit and best < np.inf)):
        raise reason
    assert start is not None
    _refuse_far(start)
    _refuse_branch(start)
    return start


def _others(
    measurements: Measurements, start: Start | None, strays: list[int]
) -> Iterator[tuple[Measurements, ConfigurationError]]:
    """Measurements that would be right if something were wrong, and what to say of it."""
    source, suspects = measurements.source, []
    if 0 < len(strays) <= _FEW * len(measurements):
        suspects.append(strays)
    if start is not None:
        at = start.model.measured(start.change, measurements.marker)
        closures = start.model.closures(start.change, at, measurements.angles)
        suspects += [[row] for row in np.argsort(-np.abs(closures).max(axis=-1))[:_ROWS].tolist()]
    for rows in suspects:
        got, allowed = "a pose that does not fit the others, which fit without it", "pose and readings at rest"
        yield measurements.without(rows), ConfigurationError(f"{source}: row {rows[0] + 1}", got, allowed)
    for leg in range(LEGS):
        angles = measurements.angles * np.where(np.arange(LEGS) == leg, -1.0, 1.0)
        key, got = f"{source}: crank_angle_{leg}", "readings that fit with the other sign"
        error = ConfigurationError(key, got, "angles that grow as the guess's crank angle does")
        yield Measurements(measurements.pose, angles, source), error


def _refuse_far(start: Start) -> None:
    """Refuses poses that only a robot fits which is nothing like the guess."""
    size = np.abs(start.told @ start.step)[:OF_ROBOT]
    at = int(size.argmax())
    if size[at] > FAR:
        own = OF_LEG[at % PER_LEG]
        got = f"poses that tell a {own} of leg {at // PER_LEG} {abs(start.change[at]):.3g} {own.unit} off the guess"
        raise ConfigurationError(start.measurements.source, got, "readings of this robot; are two encoders swapped?")


def _refuse_branch(start: Start) -> None:
    """Refuses a leg that stands on the other branch than the guess's in each row."""
    model, source = start.model, start.measurements.source
    at = model.measured(start.change, start.measurements.marker)
    slope = model.leg_slope(start.change, at, start.measurements.angles)
    # By a leg's own angle its closure grows on the branch +1: the rod then pulls against the crank's motion.
    by_angle = -np.stack([slope[:, leg, leg * PER_LEG + HOMING] for leg in range(LEGS)], axis=-1)
    wrong = (np.sign(by_angle) == -model.guess.branches).all(axis=0)
    if wrong.any():
        leg = int(wrong.argmax())
        branch = int(model.guess.branches[leg])
        allowed = f"{-branch}: there the readings of {source} stand"
        raise ConfigurationError(f"robot.legs.{leg}.branch", branch, allowed)
