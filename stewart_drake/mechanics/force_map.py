"""The paper's map from motor torques to the wrench on the platform, (10)-(18), as printed and by statics."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from stewart_drake.errors import ConfigurationError
from stewart_drake.mechanics.kinematics import LegGeometry, leg_geometry, rod_lines
from stewart_drake.robot import RobotParameters

ForceMapKind = Literal["printed", "statics"]


def rod_map(legs: LegGeometry) -> np.ndarray:
    """tau_1 (..., 6, 6) of (14): wrench [M; F] of P in B from the six rod forces.

    Deviation: e_M = (R^-1 p_i) x e_l; the print leaves p_i unrotated.
    """
    return rod_lines(legs).swapaxes(-1, -2)


def crank_map(robot: RobotParameters, legs: LegGeometry, kind: ForceMapKind) -> np.ndarray:
    """Diagonal (..., 6) [1/m] of tau_2 of (16): force in a rod per unit of motor torque.

    `printed` is (e_l . e_N) / |a|. Deviation: the statics of a massless crank and rod give 1 / (|a| (e_l . e_N)),
    `statics`, infinite at a crank's dead centre; the two agree only where the rod lies along e_N.
    """
    cranks = robot.crank_lengths
    if kind == "printed":
        return legs.transmission / cranks
    if kind != "statics":
        raise ConfigurationError("force_map", kind, "statics or printed")
    with np.errstate(divide="ignore"):
        return 1.0 / (cranks * legs.transmission)


def force_map_of_legs(robot: RobotParameters, legs: LegGeometry, kind: ForceMapKind) -> np.ndarray:
    """Map tau of (18) from leg vectors that are already at hand; (..., 6, 6) [-, 1/m]."""
    return rod_map(legs) * crank_map(robot, legs, kind)[..., None, :]


def force_map(robot: RobotParameters, pose: ArrayLike, kind: ForceMapKind = "statics") -> np.ndarray:
    """Map tau (..., 6, 6) of (18): wrench [moment; force] on the platform, in B, per unit of motor torque."""
    return force_map_of_legs(robot, leg_geometry(robot, pose), kind)
