"""What logs of a robot can tell: thirty-two numbers as one vector, in which its torques are nearly linear.

    torque_i = exp(-gain_i) (Y_i(motion) bodies + coulomb_i sign(rate_i) + viscous_i rate_i)

The bodies are the first fourteen. Gains are those of the amplifiers, or of the torque constants: gain_i is the natural
logarithm of what motor i gives over what its log says that it gives.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from stewart_drake.errors import ConfigurationError
from stewart_drake.mechanics.kinematics_laws import robot_record
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEGS

Kind = Literal[
    "platform_mass",
    "platform_moment",
    "platform_inertia",
    "rod_mass",
    "rod_inertia",
    "crank_mass",
    "rotor_inertia",
    "coulomb",
    "viscous",
    "torque_constant",
]
KINDS: tuple[Kind, ...] = get_args(Kind)


class Parameter(NamedTuple):
    """One number: one of `KINDS`, which of its components or which motor (or none), and its unit."""

    kind: Kind
    part: str
    unit: str

    def __str__(self) -> str:
        return f"{self.kind} {self.part}".strip()


_MOTORS = tuple(f"motor {leg}" for leg in range(LEGS))
PARAMETERS = (
    Parameter("platform_mass", "", "kg"),
    *(Parameter("platform_moment", axis, "kg m") for axis in "xyz"),
    *(Parameter("platform_inertia", axes, "kg m^2") for axes in ("xx", "yy", "zz", "xy", "xz", "yz")),
    Parameter("rod_mass", "", "kg"),
    Parameter("rod_inertia", "", "kg m^2"),
    Parameter("crank_mass", "", "kg"),
    Parameter("rotor_inertia", "", "kg m^2"),
    *(Parameter("coulomb", motor, "N m") for motor in _MOTORS),
    *(Parameter("viscous", motor, "N m s/rad") for motor in _MOTORS),
    *(Parameter("torque_constant", motor, "") for motor in _MOTORS),
)
"""Moment: mass times centre of mass, in P; inertia: about the origin of P, the tensor's entries. Of a crank the moment
of inertia about its own middle stays that of the guess: it and the rotor's only act as their sum."""
SIZE = len(PARAMETERS)
BODIES, COULOMB, VISCOUS, GAIN = slice(0, 14), slice(14, 20), slice(20, 26), slice(26, 32)
MASS, MOMENT, INERTIA, ROD_MASS, ROD_INERTIA, CRANK_MASS, ROTOR = 0, slice(1, 4), slice(4, 10), 10, 11, 12, 13
ENTRIES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def of_robot(robot: RobotParameters) -> np.ndarray:
    """Parameters (`SIZE`,) of a robot without friction whose torques are what its log says."""
    inertia = robot.platform_inertia_about_origin
    platform = [robot.platform_mass, *robot.platform_moment, *(inertia[at] for at in ENTRIES)]
    links = [robot.rod_mass, robot.rod_inertia[0], robot.crank_mass, robot.rotor_inertia]
    return np.array([*platform, *links, *[0.0] * 18])


def as_robot(guess: RobotParameters, values: np.ndarray) -> RobotParameters:
    """The guess with bodies of parameters (`SIZE`,); friction and gains have no place in a robot."""
    mass = float(values[MASS])
    centre = values[MOMENT] / mass
    central = inertia_matrix(values) - mass * ((centre @ centre) * np.eye(3) - np.outer(centre, centre))
    return guess.replace(
        platform_mass=mass,
        platform_center_of_mass=centre,
        platform_inertia=np.diag(central),
        platform_products=[central[at] for at in ENTRIES[3:]],
        rod_mass=values[ROD_MASS],
        rod_inertia=(values[ROD_INERTIA], values[ROD_INERTIA], guess.rod_inertia[2]),
        crank_mass=values[CRANK_MASS],
        rotor_inertia=values[ROTOR],
    )


def inertia_matrix(values: np.ndarray) -> Any:
    """Inertia (3, 3) of the platform about the origin of P, of parameters, numbers or expressions."""
    xx, yy, zz, xy, xz, yz = values[INERTIA]
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def unit_robots(guess: RobotParameters) -> list[np.ndarray]:
    """Records of the guess's geometry with one of the bodies' parameters 1 and the others 0: columns of the model.

    The last has the cranks' own inertia instead, the part of the torques that is known.
    """

    def only(**values: Any) -> np.ndarray:
        robot = robot_record(guess).copy()
        bodies = ("crank_inertia", "rod_mass", "rod_inertia", "crank_mass")
        for name in (*bodies, "platform_mass", "platform_moment", "platform_tensor"):
            robot[name] = values.get(name, 0.0)
        return robot

    half = 0.5 * guess.crank_lengths
    return [
        only(platform_mass=1.0),
        *(only(platform_moment=row) for row in np.eye(3)),
        *(only(platform_tensor=inertia_matrix(row)) for row in np.eye(10)[4:]),
        only(rod_mass=1.0),
        only(rod_inertia=1.0),
        only(crank_mass=1.0, crank_inertia=half * half),
        only(crank_inertia=1.0),
        only(crank_inertia=guess.crank_inertia[1]),
    ]


def scales(guess: RobotParameters) -> np.ndarray:
    """Change (`SIZE`,) of each parameter that counts as 1: as much again as the guess has, or could well have.

    Friction counts in hundredths of the motors' limit, at 1 rad/s; gains by a tenth.
    """
    mass, length, effort = guess.platform_mass, guess.characteristic_length, float(guess.effort_limits.mean())
    platform = [mass, *[mass * length] * 3, *[mass * length**2] * 6]
    links = [guess.rod_mass, guess.rod_inertia[0], guess.crank_mass, float(guess.crank_axis_inertias.mean())]
    return np.array([*platform, *links, *[0.01 * effort] * 12, *[0.1] * 6])


def free_directions(held: Collection[Kind], kept: Collection[int] = ()) -> np.ndarray:
    """Orthonormal directions (`SIZE`, k), in `scales`, in which the parameters may change.

    No torque tells a heavier robot from stronger motors: unless the platform's mass is held, the geometric mean of the
    torque constants is. Kinds that are held, and single parameters that are kept by their place, do not change.
    """
    from scipy.linalg import null_space

    if set(KINDS) <= set(held):
        raise ConfigurationError("hold", sorted(held), f"some of {', '.join(KINDS)}, not all")
    rows = [np.eye(SIZE)[at] for at, own in enumerate(PARAMETERS) if own.kind in held or at in kept]
    if "torque_constant" not in held and "platform_mass" not in held:
        rows.append(np.eye(SIZE)[GAIN].sum(axis=0))
    return null_space(np.array(rows)) if rows else np.eye(SIZE)
