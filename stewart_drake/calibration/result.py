"""What a calibration found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from stewart_drake.calibration.measurements import MeasurementNoise, Measurements
from stewart_drake.calibration.model import Frame
from stewart_drake.calibration.parameters import (
    NAMES,
    OF_LEG,
    OF_ROBOT,
    PER_LEG,
    FrameName,
    Name,
)
from stewart_drake.files.tables import need_pandas
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEGS

COLUMNS = ("leg", "parameter", "axis", "unit", "guess", "value", "half_width")


@dataclass(frozen=True, eq=False, repr=False)
class Calibration:
    """A calibrated robot, and how well it is known.

    Attributes:
        robot: Its crank angles are the encoders' readings: the homing offsets are in its crank directions.
        guess: What the calibration started from.
        measurements: What it was made of.
        noise: As stated.
        known_frames: Frames of the tracker that were those of the robot.
        hold: Parameters that kept their value.
        change: (78,) [m, rad] of the guess's parameters and the tracker's frames, see `parameters`.
        half_width: (78,) [m, rad] of the 95 % intervals; 0 for what was held or known, infinite for what is not told.
        told: How many independent numbers were estimated.
        untold: What these poses cannot tell, a sentence each.
        base: Pose of B in the tracker's frame.
        marker: Pose of the marker in P.
        before: (n, 6) [rad, m] measured minus believed poses of the marker, the tracker's frames being fitted to the
            guess; NaN where the guess cannot be assembled.
        after: (n, 6) [rad, m] measured minus calibrated poses of the marker.
        noise_ratio: [-] errors over the stated noise; the intervals are scaled by it.
    """

    robot: RobotParameters
    guess: RobotParameters
    measurements: Measurements
    noise: MeasurementNoise
    known_frames: tuple[FrameName, ...]
    hold: tuple[Name, ...]
    change: np.ndarray
    half_width: np.ndarray
    told: int
    untold: tuple[str, ...]
    base: Frame
    marker: Frame
    before: np.ndarray
    after: np.ndarray
    noise_ratio: float

    @property
    def homing_offsets(self) -> np.ndarray:
        """(6,) [rad] readings minus the true angles of the guess's convention."""
        return self.change[:OF_ROBOT].reshape(LEGS, PER_LEG)[:, -1].copy()

    def rows(self) -> list[tuple[Any, ...]]:
        """A row of `COLUMNS` for each parameter of each leg, in SI units; the half width is that of 95 %."""
        guess = self.guess
        nothing = np.zeros((LEGS, 1))
        positions = guess.shaft_positions, guess.platform_joints
        lengths = guess.crank_lengths[:, None], guess.rod_lengths[:, None]
        of_guess = np.concatenate([*positions, *lengths, nothing, nothing, nothing], axis=-1).ravel()
        return [
            (at // PER_LEG, own.name, own.axis, own.unit, float(start), float(start + change), float(width))
            for at, (own, start, change, width) in enumerate(
                zip(OF_LEG * LEGS, of_guess, self.change, self.half_width, strict=False)
            )
        ]

    def to_pandas(self) -> Any:
        """`rows` as a pandas.DataFrame.

        Raises:
            ConfigurationError: pandas is not installed.
        """
        need_pandas("rows() gives the same as tuples")
        import pandas as pd

        return pd.DataFrame(self.rows(), columns=COLUMNS)

    def error_sizes(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """RMS over the poses of position [m] and rotation [rad] error, before and after."""

        def sizes(error: np.ndarray) -> tuple[float, float]:
            square = np.nanmean(error**2, axis=0)
            return float(np.sqrt(square[3:].sum())), float(np.sqrt(square[:3].sum()))

        return sizes(self.before), sizes(self.after)

    def widest(self) -> dict[Name, float]:
        """Largest half width [m, rad] of each parameter over its axes and the legs."""
        of_leg = self.half_width[:OF_ROBOT].reshape(LEGS, PER_LEG).max(axis=0)
        return {name: max(float(of_leg[at]) for at, own in enumerate(OF_LEG) if own.name == name) for name in NAMES}

    def __repr__(self) -> str:
        """What was calibrated, how well it fits, and what is not told, in five lines."""
        before, after = self.error_sizes()
        sizes = " -> ".join(
            f"{1e3 * position:.3g} mm, {1e3 * rotation:.3g} mrad" for position, rotation in (before, after)
        )
        units = {own.name: own.unit for own in OF_LEG}
        widths = ", ".join(f"{name} {1e3 * width:.2g} m{units[name]}" for name, width in self.widest().items())
        return (
            f"Calibration of {self.measurements.source}: {len(self.measurements)} poses tell {self.told} numbers\n"
            f"  pose error (RMS): {sizes}\n"
            f"  errors are {self.noise_ratio:.3g} times the stated noise\n"
            f"  widest 95 % intervals, +-: {widths}\n"
            f"  not told: {'; '.join(self.untold) or 'nothing'}"
        )
