"""Poses that a tracker measured, with the encoders' readings at each: from a CSV file or from arrays, checked."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from stewart_drake.calibration.frames import Frame
from stewart_drake.config import Positive, Section
from stewart_drake.errors import ConfigurationError
from stewart_drake.files.tables import column_name, numbers_to_csv, read_numbers
from stewart_drake.mechanics.kinematics import rotation_matrix
from stewart_drake.robot.leg import LEGS

MAX_BYTES, MAX_ROWS = 10_000_000, 10_000
_FARTHEST = 1e6
"""[m] beyond which no tracker is."""
QUANTITIES = (
    *((f"pose_{name}", "rad") for name in ("roll", "pitch", "yaw")),
    *((f"pose_{name}", "m") for name in ("x", "y", "z")),
    *((f"crank_angle_{leg}", "rad") for leg in range(LEGS)),
)
"""What a file has columns of, and the unit in which it is kept."""
COLUMNS = tuple(column_name(*each) for each in QUANTITIES)


class MeasurementNoise(Section, key="noise"):
    """Standard deviations of what is measured; each is independent and alike in all directions."""

    position: Annotated[Positive, Field(le=1.0)] = 2e-5
    """[m] of each coordinate of a measured position."""
    rotation: Annotated[Positive, Field(le=1.0)] = 1e-4
    """[rad] of a measured orientation about each axis."""
    encoder: Annotated[Positive, Field(le=1.0)] = 2.0 * math.pi / 2**17 / math.sqrt(12.0)
    """[rad] of a reading. An encoder that is exact but for its steps has a step over the root of 12: here 17 bits."""


@dataclass(frozen=True, eq=False)
class Measurements:
    """Poses (n, 6) [rad, m] of the marker in the tracker's frame, and encoder readings (n, 6) [rad] there; checked."""

    pose: np.ndarray
    angles: np.ndarray
    source: str = "poses"

    def __post_init__(self) -> None:
        for name in ("pose", "angles"):
            values = np.array(getattr(self, name), dtype=float)
            if values.ndim != 2 or values.shape[1] != 6 or len(values) != len(self.pose):
                raise ConfigurationError(f"{self.source}: {name}", values.shape, "numbers of shape (n, 6)")
            values.flags.writeable = False
            object.__setattr__(self, name, values)
        table = np.concatenate([self.pose, self.angles], axis=-1)
        self._refuse(~np.isfinite(table), table, "a finite number")
        # A stroke of pi covers what roll, pitch and yaw can be; an encoder may have been homed a turn away.
        most = np.array([math.pi, math.pi / 2.0, math.pi] + [_FARTHEST] * 3 + [4.0 * math.pi] * LEGS)
        allowed = (
            "metres, and radians, roll and yaw within +-pi, pitch within +-pi/2, readings within +-4 pi; "
            "millimetres go by _mm, degrees by _deg"
        )
        self._refuse(np.abs(table) > most * (1.0 + 1e-9), table, allowed)
        for columns, what in ((table, "row"), (self.pose, "pose")):
            _, first, which = np.unique(columns, axis=0, return_index=True, return_inverse=True)
            again = np.flatnonzero(first[which.ravel()] != np.arange(len(columns)))
            if again.size:
                got = f"the {what} of row {first[which.ravel()[again[0]]] + 1} again in row {again[0] + 1}"
                allowed = "poses that were each measured: a tracker never gives the same numbers twice"
                raise ConfigurationError(self.source, got, allowed)

    def __len__(self) -> int:
        return len(self.pose)

    @cached_property
    def marker(self) -> Frame:
        """Poses of the marker in the tracker's frame."""
        return Frame(rotation_matrix(self.pose[:, :3]), self.pose[:, 3:])

    def to_csv(self) -> str:
        """A table that `load_measurements` reads."""
        return numbers_to_csv(QUANTITIES, np.concatenate([self.pose, self.angles], axis=-1))

    def _refuse(self, wrong: np.ndarray, table: np.ndarray, allowed: str) -> None:
        if wrong.any():
            row, column = np.argwhere(wrong)[0]
            key = f"{self.source}: row {row + 1}, {QUANTITIES[column][0]}"
            raise ConfigurationError(key, float(table[row, column]), allowed)


def load_measurements(path: str | Path) -> Measurements:
    """Measured poses of a table with `COLUMNS`, in any order and unit; further columns are left alone.

    The pose is that of the marker in the tracker's frame, R = Rz(yaw) Ry(pitch) Rx(roll).
    """
    source = f"poses file {path}"
    values = read_numbers(path, source, QUANTITIES, MAX_BYTES, MAX_ROWS)
    return Measurements(values[:, :6], values[:, 6:], source)
