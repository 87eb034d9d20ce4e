"""What may be wrong with measured poses that do not fit a robot: units, single rows, signs of encoders and IMUs."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from stewart_drake.estimation import geometry
from stewart_drake.estimation.geometry import PoseModel
from stewart_drake.estimation.poses import Measurements
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEG_COUNT

_STRAY = 10.0  # Error of a row, over the usual one, above which it counts as a stray row.
_MOST_STRAYS = 0.2  # Largest share of stray rows.
_SUSPECTS = 3  # Rows with the largest errors that are left out on trial.
_DEGREE = math.pi / 180.0
_UNITS = (
    ("pose_x, y, z", slice(3, 6), 1e-3, "millimetres for metres"),
    ("pose_x, y, z", slice(3, 6), 1e3, "metres for millimetres"),
    ("pose_roll, pitch, yaw", slice(0, 3), _DEGREE, "degrees for radians"),
    ("pose_roll, pitch, yaw", slice(0, 3), 1.0 / _DEGREE, "radians for degrees"),
    ("crank_angle", slice(6, 12), _DEGREE, "degrees for radians"),
    ("crank_angle", slice(6, 12), 1.0 / _DEGREE, "radians for degrees"),
)


def corrections(
    guess: RobotParameters, measurements: Measurements, off: np.ndarray | None
) -> Iterator[tuple[np.ndarray, str, str, str]]:
    """Tables (n, 12) with other units, rows or signs, with key, value and remedy of the error if one of them fits.

    `off` (n,) [m] is what rods are off in each row with the best fit; None where there is none.
    """
    source, table = measurements.source, measurements.table
    # Which of roll and pitch is inverted cannot be told where the mounting is unknown.
    for at, name in () if measurements.measured.all() else ((1, "roll or pose_pitch"), (2, "yaw")):
        inverted = table * np.where(np.arange(12) == at, -1.0, 1.0)
        got = "angles that fit with the other sign"
        allowed = "R = Rz(yaw) Ry(pitch) Rx(roll), with z up; does the IMU count this angle the other way?"
        yield inverted, f"{source}: pose_{name}", got, allowed
    for key, columns, factor, units in _UNITS:
        scaled = table.copy()
        scaled[:, columns] *= factor
        got = f"numbers that fit if they are multiplied by {factor:.4g}"
        yield scaled, f"{source}: {key}", got, f"the unit in the column's name; perhaps {units}?"
    strays = _stray_rows(guess, measurements) if measurements.measured.all() else []
    suspects = [strays] if 0 < len(strays) <= _MOST_STRAYS * len(measurements) else []
    if off is not None:
        suspects += [[row] for row in np.argsort(-off)[:_SUSPECTS].tolist()]
    for rows in suspects:
        got, allowed = "a pose that does not fit the others", "pose and readings at rest"
        yield np.delete(table, rows, axis=0), f"{source}: row {rows[0] + 1}", got, allowed
    for leg in range(LEG_COUNT):
        inverted = table * np.where(np.arange(12) == 6 + leg, -1.0, 1.0)
        got, allowed = "readings that fit with the other sign", "angles with the sign of the guess's crank angle"
        yield inverted, f"{source}: crank_angle_{leg}", got, allowed


def _stray_rows(guess: RobotParameters, measurements: Measurements) -> list[int]:
    """Rows turned or shifted from their neighbours otherwise than the guess's poses, or without one; worst first."""
    believed, good = PoseModel(guess).assembled(measurements.angles)
    far = np.where(good, 0.0, np.inf)
    if good.any():
        turns_and_shifts = (
            geometry.steps(frames).reshape(-1, 2, 3) for frames in (measurements.marker[good], believed)
        )
        observed, expected = (np.linalg.norm(steps, axis=-1) for steps in turns_and_shifts)
        off = np.abs(observed - expected)
        most = (off / (np.median(off, axis=0) + 1e-12)).max(axis=-1)
        far[good] = np.minimum(most, np.roll(most, -1))
    return [row for row in np.argsort(-far, kind="stable").tolist() if far[row] > _STRAY]
