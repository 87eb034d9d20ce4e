"""Geometry, masses and limits of one rotary Stewart platform."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from stewart_drake.errors import ConfigurationError
from stewart_drake.section import SECTION, Count, Positive, Real, Vector3, is_finite, plain

LEGS = 6
SMALLEST, LARGEST = 1e-12, 1e6
"""Sizes, masses and inertias beyond these, in SI units, are slips of the pen; squares of them leave floating point."""
_PAIR = np.arange(LEGS) // 2
_SIDE = np.where(np.arange(LEGS) % 2 == 0, -1.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class RobotParameters:
    """One robot: six motors in three pairs 120 deg apart, six cranks, six rods, one platform.

    Leg i = 0..5 belongs to pair k = i // 2 and stands on side s = -1 (even i) or +1 (odd i) of the pair's direction
    c_k = 120 deg * k. Frames: B at the base, z up; P at the centre of the platform's joint circle. Lengths, radii,
    masses and inertias are those of Table I; the joint positions are our own, because the paper gives none.

    Deviation: crank Izz is 5.9e-5 kg m^2, not the printed 6.0e-5, which breaks the triangle inequality.

    Raises:
        ConfigurationError: A value is not finite, not positive where it must be, an inertia is not that of a body, or
            the home pose cannot be assembled.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = SECTION

    shaft_circle_radius: Positive = 0.20
    """[m] radius of the circle of the motor shafts."""
    shaft_height: Real = -0.07
    """[m] z of the motor shafts in B."""
    shaft_half_angle: Positive = math.radians(8.0)
    """[rad] half of the angle between the two shafts of a pair, seen from the centre."""
    platform_joint_radius: Positive = 0.11
    """[m] radius of the circle of the platform's joints."""
    platform_half_angle: Positive = math.radians(52.0)
    """[rad] half of the angle between the two platform joints of a pair."""
    crank_length: Positive = 0.11
    """[m] shaft to crank tip; |a| in the paper."""
    rod_length: Positive = 0.404
    """[m] crank tip to platform joint."""
    home_height: Positive = 0.30
    """[m] Z of P in B at the home pose; roll, pitch, yaw, X, Y are zero there."""
    branch: Count = -1
    """Sign of the acos in the inverse kinematics: -1 (default) or +1."""

    rod_mass: Positive = 0.08
    """[kg]"""
    rod_inertia: Vector3 = (0.0016, 0.0016, 0.000001)
    """[kg m^2] about the centre of mass; z along the rod, Ixx = Iyy."""
    crank_mass: Positive = 0.04
    """[kg]"""
    crank_inertia: Vector3 = (0.000001, 0.000058, 0.000059)
    """[kg m^2] about the centre of mass; x along the crank, y along the motor axis."""
    platform_mass: Positive = 1.0
    """[kg]"""
    platform_inertia: Vector3 = (0.003, 0.003, 0.006)
    """[kg m^2] about P in P."""
    base_mass: Positive = 7.0
    """[kg]; welded to the world, so it never acts."""
    base_inertia: Vector3 = (0.027, 0.027, 0.054)
    """[kg m^2]"""

    effort_limit: Positive = 5.0
    """[N m] largest torque of a motor."""
    link_radius: Positive = 0.005
    """[m] radius of cranks and rods, for pictures, collisions and clearance."""
    characteristic_length: Positive = 0.11
    """[m] makes rotations and translations comparable in conditioning."""

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            given = plain(getattr(self, field.name))
            # Lists and numpy's numbers will do, and become what can be hashed and written to a file.
            object.__setattr__(self, field.name, given)
            values = given if isinstance(given, tuple) else (given,)
            signed = field.name in {"shaft_height", "branch"}
            low = -LARGEST if signed else SMALLEST
            if not all(is_finite(value) and low <= value <= LARGEST for value in values):
                allowed = (
                    f"finite numbers from {low:g} to {LARGEST:g}" if signed else f"positive numbers to {LARGEST:g}"
                )
                raise ConfigurationError(f"robot.{field.name}", given, allowed)
        if self.branch not in (-1, 1):
            raise ConfigurationError("robot.branch", self.branch, "-1 or 1")
        for name in ("rod_inertia", "crank_inertia", "platform_inertia", "base_inertia"):
            inertia = getattr(self, name)
            if not isinstance(inertia, tuple) or len(inertia) != 3:
                raise ConfigurationError(f"robot.{name}", inertia, "three moments Ixx, Iyy, Izz")
            if 2.0 * max(inertia) > sum(inertia) * (1.0 + 1e-12):
                raise ConfigurationError(f"robot.{name}", inertia, "no moment above the sum of the other two")
        if self.rod_inertia[0] != self.rod_inertia[1]:
            raise ConfigurationError("robot.rod_inertia", self.rod_inertia, "Ixx = Iyy: a rod is symmetric about z")
        for name in ("shaft_half_angle", "platform_half_angle"):
            if getattr(self, name) >= math.pi / 3.0:
                raise ConfigurationError(f"robot.{name}", getattr(self, name), "below pi/3 rad: pairs must not cross")
        # A robot that cannot stand at home has no SDF.
        margin = self.reach_margin(self.platform_joints + self.home_pose[3:] - self.shaft_positions)
        if margin.min() <= 0.0:
            raise ConfigurationError(
                "robot.home_height",
                self.home_height,
                f"a height to which cranks of {self.crank_length:g} m and rods of {self.rod_length:g} m reach "
                f"(leg {int(margin.argmin())} has margin {margin.min():.3g})",
            )

    @cached_property
    def home_pose(self) -> np.ndarray:
        """(6,) [rad, rad, rad, m, m, m] pose of P in B at which the SDF is written."""
        return _frozen([0.0, 0.0, 0.0, 0.0, 0.0, self.home_height])

    @cached_property
    def pair_angles(self) -> np.ndarray:
        """(6,) [rad] direction c_k of each leg's pair."""
        return _frozen(_PAIR * (2.0 * math.pi / 3.0))

    @cached_property
    def shaft_positions(self) -> np.ndarray:
        """(6, 3) [m] motor shaft centres P_i in B."""
        angle = self.pair_angles + _SIDE * self.shaft_half_angle
        r = self.shaft_circle_radius
        return _frozen(np.stack([r * np.cos(angle), r * np.sin(angle), np.full(LEGS, self.shaft_height)], axis=-1))

    @cached_property
    def platform_joints(self) -> np.ndarray:
        """(6, 3) [m] joint centres p_i in P."""
        angle = self.pair_angles + _SIDE * self.platform_half_angle
        r = self.platform_joint_radius
        return _frozen(np.stack([r * np.cos(angle), r * np.sin(angle), np.zeros(LEGS)], axis=-1))

    @cached_property
    def crank_zero_directions(self) -> np.ndarray:
        """(6, 3) [-] horizontal unit vectors h_i in B along which the cranks point at theta = 0."""
        return _frozen(np.stack([np.cos(self.pair_angles), np.sin(self.pair_angles), np.zeros(LEGS)], axis=-1))

    @property
    def crank_axis_inertia(self) -> float:
        """[kg m^2] inertia of a crank about its motor axis."""
        return self.crank_inertia[1] + self.crank_mass * (0.5 * self.crank_length) ** 2

    def crank_equation(self, span: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A, B and C / sqrt(A^2 + B^2) of A cos(theta) + B sin(theta) = C; what (6) leaves unsaid.

        Args:
            span: (..., 6, 3) [m] from motor shaft to platform joint, the L_i of (2).

        Returns:
            A (..., 6) [m^2], B (..., 6) [m^2] and the ratio (..., 6) [-], infinite where the platform joint lies on the
            motor axis.
        """
        a = self.crank_length
        along = 2.0 * a * np.sum(span * self.crank_zero_directions, axis=-1)
        up = 2.0 * a * span[..., 2]
        constant = np.sum(span * span, axis=-1) + a * a - self.rod_length**2
        size = np.hypot(along, up)
        return along, up, np.divide(constant, size, out=np.full_like(constant, np.inf), where=size > 0.0)

    def reach_margin(self, span: np.ndarray) -> np.ndarray:
        """1 - |C| / sqrt(A^2 + B^2) of each leg (..., 6), for spans (..., 6, 3) [m]; negative: the rod cannot span."""
        return 1.0 - np.abs(self.crank_equation(span)[2])

    def replace(self, **changes: Any) -> RobotParameters:
        """A robot with some parameters changed, validated again.

        Raises:
            ConfigurationError: Unknown name or unusable value.
        """
        known = {field.name for field in dataclasses.fields(self)}
        for name, value in changes.items():
            if name not in known:
                raise ConfigurationError(f"robot.{name}", value, "one of " + ", ".join(sorted(known)))
        return dataclasses.replace(self, **changes)


def _frozen(values: Any) -> np.ndarray:
    array = np.array(values, dtype=float)
    array.flags.writeable = False
    return array
