"""Geometry, masses and limits of one rotary Stewart platform."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from stewart_drake.base.config import Section
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.robot.geometry import check_geometry
from stewart_drake.robot.leg import (
    LEG_COUNT,
    Branch,
    HalfAngle,
    Height,
    Length,
    Moderate,
    Position,
    Signed,
    Signed3,
    SixLegs,
    Size,
    Size3,
)
from stewart_drake.robot.leg_table import Cranks, Home, Unit, from_table

_PAIR_ANGLES = np.arange(LEG_COUNT) // 2 * (2.0 * math.pi / 3.0)
"""(6,) [rad] directions c_k of the legs' pairs."""
_SIDE = np.where(np.arange(LEG_COUNT) % 2 == 0, -1.0, 1.0)


def _frozen(values: ArrayLike) -> np.ndarray:
    array = np.array(values, dtype=float)
    array.flags.writeable = False
    return array


def _spread(values: np.ndarray) -> str:
    return " to ".join(dict.fromkeys(f"{value:.4g}" for value in (values.min(), values.max())))


def _of_legs(name: str, symmetric: Callable[[RobotParameters], np.ndarray]) -> cached_property[np.ndarray]:
    """Values of the six legs: the symmetric robot's, overwritten by those of `legs`."""

    def values(robot: RobotParameters) -> np.ndarray:
        result = symmetric(robot)
        for leg, parameters in enumerate(robot.legs or ()):
            value = getattr(parameters, name)
            if value is not None:
                result[leg] = value / np.linalg.norm(value) if name.endswith("direction") else value
        return _frozen(result)

    return cached_property(values)


class Tool(Section, key="robot.tool"):
    """A frame on the platform that replaces P in poses, motions, errors and wrenches."""

    position: Position = (0.0, 0.0, 0.0)
    """[m] of the point in P."""
    orientation: Signed3 = (0.0, 0.0, 0.0)
    """[rad] roll, pitch, yaw of the axes in P."""

    def rules(self) -> None:
        """The Euler angles at home are regular."""
        if not abs(self.orientation[1]) < math.radians(85.0):
            allowed = "a pitch below 85 deg, near which the Euler angles of a pose are singular"
            raise ConfigurationError("orientation", self.orientation, allowed)


class RobotParameters(Section, key="robot"):
    """One robot: six motors in three pairs 120 deg apart, six cranks, six rods, one platform.

    Leg i = 0..5 belongs to pair k = i // 2 and is on side s = -1 (even i) or +1 (odd i) of the pair's direction
    c_k = 120 deg * k. Frames: B at the base, z up; P at the centre of the platform's joint circle. Poses are those of
    P, or of a `tool`. Lengths, radii, masses and inertias are those of Table I; the joint positions are assumed,
    because the paper gives none.

    The parameters describe a symmetric robot; `legs` has other values for single legs. Mechanics, plants and pictures
    use the arrays of all six legs, `shaft_positions` to `crank_angle_ranges`.

    Deviation: crank Izz is 5.9e-5 kg m^2, not the printed 6.0e-5, which violates the triangle inequality.

    Raises:
        ConfigurationError: A value is not finite or not positive, an inertia is not physical, directions of a crank are
            not perpendicular unit vectors, or the home pose cannot be assembled.
    """

    shaft_circle_radius: Length = 0.20
    """[m] radius of the circle of the motor shafts."""
    shaft_height: Signed = -0.07
    """[m] height of the motor shafts, z in B."""
    shaft_half_angle: HalfAngle = math.radians(8.0)
    """[rad] half the angle between the two shafts of a pair, seen from the centre."""
    crank_plane_angle: Signed = 0.0
    """[rad] angle about z from the pair's direction to a crank's plane, away from the other crank; pi/2: tangential."""
    platform_joint_radius: Length = 0.11
    """[m] radius of the circle of the platform's joints."""
    platform_half_angle: HalfAngle = math.radians(52.0)
    """[rad] half the angle between the two platform joints of a pair."""
    crank_length: Length = 0.11
    """[m] length of a crank, shaft to tip; |a| in the paper."""
    rod_length: Length = 0.404
    """[m] length of a rod, crank tip to platform joint."""
    home_height: Height = 0.30
    """[m] Z of P in B at home, negative below the base, the pose of P with roll, pitch, yaw, X, Y zero."""
    tool: Tool | None = None
    """Frame of a tool, whose poses replace those of P; null for P. The robot's other keys still refer to P."""
    branch: Branch = -1
    """Sign of the acos in the inverse kinematics: -1 (default) or +1; it selects one of the two crank angles."""
    legs: SixLegs | None = None
    """Six sections with the parameters that differ from leg to leg; null for none."""

    rod_mass: Size = 0.08
    """[kg] mass of a rod."""
    rod_inertia: Size3 = (0.0016, 0.0016, 0.000001)
    """[kg m^2] inertia of a rod about its centre of mass; z along the rod, Ixx = Iyy."""
    crank_mass: Size = 0.04
    """[kg] mass of a crank."""
    crank_inertia: Size3 = (0.000001, 0.000058, 0.000059)
    """[kg m^2] inertia of a crank about its centre of mass; x along the crank, y along the motor axis."""
    platform_mass: Size = 1.0
    """[kg] mass of the platform, without payload."""
    platform_inertia: Size3 = (0.003, 0.003, 0.006)
    """[kg m^2] inertia Ixx, Iyy, Izz of the platform about its centre of mass, along the axes of P."""
    platform_products: Signed3 = (0.0, 0.0, 0.0)
    """[kg m^2] products of inertia Ixy, Ixz, Iyz of the platform."""
    platform_center_of_mass: Signed3 = (0.0, 0.0, 0.0)
    """[m] centre of mass of the platform in P."""
    rotor_inertia: Moderate = 0.0
    """[kg m^2] inertia of a motor's rotor and gear, reflected to its crank, about the motor axis."""
    base_mass: Size = 7.0
    """[kg] mass of the base; it is fixed, so this has no effect."""
    base_inertia: Size3 = (0.027, 0.027, 0.054)
    """[kg m^2] inertia of the base about its centre of mass; it is fixed, so this has no effect."""

    effort_limit: Size = 5.0
    """[N m] largest torque of a motor."""
    link_radius: Size = 0.005
    """[m] radius of cranks and rods, for pictures, collisions and clearance."""
    characteristic_length: Size = 0.11
    """[m] length that makes rotations comparable with translations in conditioning."""

    def rules(self) -> None:
        """Inertias are physical, and the home pose can be assembled."""
        for name in ("rod_inertia", "crank_inertia", "platform_inertia", "base_inertia"):
            inertia = getattr(self, name)
            if 2.0 * max(inertia) > sum(inertia) * (1.0 + 1e-12):
                allowed = f"three moments [kg m^2], none above the sum of the other two; {max(inertia):g} is"
                raise ConfigurationError(f"robot.{name}", inertia, allowed)
        principal = np.linalg.eigvalsh(self.central_inertia)
        if principal[0] <= 0.0 or 2.0 * principal[2] > principal.sum() * (1.0 + 1e-9):
            allowed = "products that leave principal moments positive, and none above the sum of the others"
            raise ConfigurationError("robot.platform_products", self.platform_products, allowed)
        if self.rod_inertia[0] != self.rod_inertia[1]:
            raise ConfigurationError("robot.rod_inertia", self.rod_inertia, "Ixx = Iyy: a rod is symmetric about z")
        check_geometry(self)

    @classmethod
    def from_table(
        cls,
        table: str | Path | ArrayLike,
        *,
        unit: Unit = "m",
        cranks: Cranks = "outwards",
        home: Home = "level",
        **parameters: object,
    ) -> RobotParameters:
        """A robot from measured positions, a row per leg; for missing parameters see `leg_table.from_table`.

        A warning names a leg that breaks the pattern of the others, or has an unlikely size.

        Args:
            table: Path of a CSV file, or an array (6, 6) of motor shafts in B and platform joints in P; in a seventh
                column the two motors of a pair have the same number.
            unit: Of all lengths in the table and in `parameters`: m, mm, cm or in.
            cranks: Direction of level cranks, if not in the table: outwards from the centre; towards the other motor of
                the pair; away from it; or tangential to the circle about the centre, and away from it.
            home: Without a `home_height`, where the cranks are level, or perpendicular to the rods.
            **parameters: Keys of this class.

        Raises:
            ConfigurationError: As for the class; a table with too few rows, columns or numbers.
        """
        result = from_table(table, unit, cranks, parameters, home)
        if result.warning:
            warnings.warn(result.warning, stacklevel=2)
        return cls(**result.parameters)

    @cached_property
    def home_pose(self) -> np.ndarray:
        """(6,) [rad, rad, rad, m, m, m] pose in B, of the tool or of P, at which the SDF is written."""
        tool = self.tool or Tool()
        return _frozen([*tool.orientation, *tool.position[:2], tool.position[2] + self.home_height])

    @cached_property
    def tool_rotation(self) -> np.ndarray:
        """(3, 3) [-] R_PT of the tool's axes; the identity without one."""
        (cr, cp, cy), (sr, sp, sy) = (of((self.tool or Tool()).orientation) for of in (np.cos, np.sin))
        return _frozen(
            [
                [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
                [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
                [-sp, cp * sr, cp * cr],
            ]
        )

    @property
    def tool_position(self) -> np.ndarray:
        """(3,) [m] of the tool's point in P; zeros without one."""
        return np.array((self.tool or Tool()).position)

    @cached_property
    def crank_yaws(self) -> np.ndarray:
        """(6,) [rad] angles about z from x to the cranks at theta = 0, for cranks that are then horizontal."""
        given = [leg.crank_zero_direction for leg in self.legs] if self.legs else [None] * LEG_COUNT
        symmetric = _PAIR_ANGLES + _SIDE * self.crank_plane_angle
        return _frozen([yaw if h is None else math.atan2(h[1], h[0]) for h, yaw in zip(given, symmetric, strict=True)])

    shaft_positions = _of_legs(
        "shaft_position", lambda r: r._around(r.shaft_half_angle, r.shaft_circle_radius, r.shaft_height)
    )
    """(6, 3) [m] motor shaft centres P_i in B."""
    joints_in_platform = _of_legs("platform_joint", lambda r: r._around(r.platform_half_angle, r.platform_joint_radius))
    """(6, 3) [m] joint centres in P."""
    crank_zero_directions = _of_legs("crank_zero_direction", lambda r: r._around(r.crank_plane_angle, 1.0))
    """(6, 3) [-] unit vectors h_i in B along which the cranks point at theta = 0."""
    crank_lengths = _of_legs("crank_length", lambda r: np.full(LEG_COUNT, r.crank_length))
    """(6,) [m] |a|."""
    rod_lengths = _of_legs("rod_length", lambda r: np.full(LEG_COUNT, r.rod_length))
    """(6,) [m]"""
    branches = _of_legs("branch", lambda r: np.full(LEG_COUNT, float(r.branch)))
    """(6,) -1.0 or 1.0."""
    crank_angle_ranges = _of_legs("crank_angle_range", lambda _: np.tile([-np.inf, np.inf], (LEG_COUNT, 1)))
    """(6, 2) [rad] lowest and highest theta; infinite without a stop."""
    servo_gains = _of_legs("servo_gain", lambda _: np.ones(LEG_COUNT))
    """(6,) [-] angles of the cranks over those that their motors are commanded and read."""
    servo_middles = _of_legs("servo_middle", lambda _: np.full(LEG_COUNT, np.nan))
    """(6,) [rad] readings of the servos in the middle of their travel; NaN for those at home."""
    _crank_ups = _of_legs("crank_quarter_direction", lambda _: np.tile([0.0, 0.0, 1.0], (LEG_COUNT, 1)))
    effort_limits = _of_legs("effort_limit", lambda r: np.full(LEG_COUNT, r.effort_limit))
    """(6,) [N m] largest torques of the motors."""

    @cached_property
    def platform_joints(self) -> np.ndarray:
        """(6, 3) [m] joint centres p_i in the tool's frame, or P."""
        return self._in_tool(self.joints_in_platform)

    @cached_property
    def platform_origin(self) -> np.ndarray:
        """(3,) [m] centre of the platform, the origin of P, in the tool's frame; zeros without one."""
        return self._in_tool(np.zeros(3))

    @cached_property
    def platform_center(self) -> np.ndarray:
        """(3,) [m] centre of mass of the platform in the tool's frame, or P."""
        return self._in_tool(np.array(self.platform_center_of_mass))

    @cached_property
    def crank_quarter_directions(self) -> np.ndarray:
        """(6, 3) [-] unit vectors in B along which the cranks point at theta = pi/2."""
        h, up = self.crank_zero_directions, self._crank_ups
        across = up - np.sum(up * h, axis=-1, keepdims=True) * h
        return _frozen(across / np.linalg.norm(across, axis=-1, keepdims=True))

    @cached_property
    def effort_shares(self) -> np.ndarray:
        """(6,) [-] `effort_limits` over `effort_limit`."""
        return _frozen(self.effort_limits / self.effort_limit)

    def scaled_masses(self, head: float, links: float = 1.0) -> dict[str, float | list[float]]:
        """Keys of all masses and inertias: the platform's times `head`, all others but the base's times `links`."""
        shares = {"rod_mass": links, "rod_inertia": links, "crank_mass": links, "crank_inertia": links}
        shares |= {"rotor_inertia": links, "platform_mass": head, "platform_inertia": head, "platform_products": head}
        return {name: (share * np.asarray(getattr(self, name))).tolist() for name, share in shares.items()}

    @cached_property
    def crank_axis_inertias(self) -> np.ndarray:
        """(6,) [kg m^2] inertia of the cranks about their motor axes, rotor included."""
        crank = self.crank_inertia[1] + self.crank_mass * (0.5 * self.crank_lengths) ** 2
        return _frozen(crank + self.rotor_inertia)

    @cached_property
    def platform_moment(self) -> np.ndarray:
        """(3,) [kg m] mass times centre of mass of the platform, in the tool's frame, or P."""
        return _frozen(self.platform_mass * self.platform_center)

    @cached_property
    def platform_inertia_about_origin(self) -> np.ndarray:
        """(3, 3) [kg m^2] inertia of the platform about the tool's point, or P, along its axes."""
        c = self.platform_center
        return _frozen(self.central_inertia + self.platform_mass * ((c @ c) * np.eye(3) - np.outer(c, c)))

    @cached_property
    def smallest_platform_inertia(self) -> float:
        """[kg m^2] smallest principal moment of the platform about its centre of mass."""
        return float(np.linalg.eigvalsh(self.central_inertia)[0])

    @cached_property
    def base_radius(self) -> float:
        """[m] radius of the circle about z that contains all motor shafts."""
        return float(np.hypot(self.shaft_positions[:, 0], self.shaft_positions[:, 1]).max())

    @cached_property
    def base_height(self) -> float:
        """[m] z of the lowest motor shaft in B."""
        return float(self.shaft_positions[:, 2].min())

    @cached_property
    def platform_radius(self) -> float:
        """[m] radius of the circle about z of P that contains all platform joints."""
        return float(np.hypot(self.joints_in_platform[:, 0], self.joints_in_platform[:, 1]).max())

    @property
    def links_text(self) -> str:
        """Lengths of its links, for messages."""
        return f"cranks {_spread(self.crank_lengths)} m, rods {_spread(self.rod_lengths)} m"

    def __repr__(self) -> str:
        """A summary in five lines; `to_dict` has all numbers."""
        shafts, joints = (np.hypot(*places.T[:2]) for places in (self.shaft_positions, self.joints_in_platform))
        masses = f"platform {self.platform_mass:.4g} kg, rod {self.rod_mass:.4g} kg, crank {self.crank_mass:.4g} kg"
        return (
            f"RobotParameters, six {'equal' if self.legs is None else 'different'} legs\n"
            f"  shafts {_spread(shafts)} m and platform joints {_spread(joints)} m from the middle\n"
            f"  {self.links_text}, home at {self.home_height:.4g} m\n"
            f"  {masses}\n"
            f"  motors {_spread(self.effort_limits)} N m"
        )

    def each_leg(self) -> list[dict[str, object]]:
        """Values of all six legs, in the form of `legs`."""
        names = ("shaft_position", "crank_zero_direction", "crank_quarter_direction", "crank_length", "rod_length")
        legs: list[dict[str, object]] = [
            {name: getattr(self, f"{name}s")[leg].tolist() for name in names} for leg in range(LEG_COUNT)
        ]
        for leg, joint in zip(legs, self.joints_in_platform, strict=True):
            leg["platform_joint"] = joint.tolist()
        for leg, branch, angles in zip(legs, self.branches, self.crank_angle_ranges, strict=True):
            leg["branch"] = int(branch)
            leg["crank_angle_range"] = angles.tolist() if np.isfinite(angles[0]) else None
        for leg, gain, middle in zip(legs, self.servo_gains.tolist(), self.servo_middles.tolist(), strict=True):
            leg["servo_gain"] = None if gain == 1.0 else gain
            leg["servo_middle"] = None if math.isnan(middle) else middle
        return legs

    @cached_property
    def central_inertia(self) -> np.ndarray:
        """(3, 3) [kg m^2] inertia of the platform about its centre of mass, along the tool's axes, or P's."""
        xy, xz, yz = self.platform_products
        inertia = np.diag(self.platform_inertia) + np.array([[0.0, xy, xz], [xy, 0.0, yz], [xz, yz, 0.0]])
        return _frozen(inertia if self.tool is None else self.tool_rotation.T @ inertia @ self.tool_rotation)

    def _in_tool(self, points: np.ndarray) -> np.ndarray:
        """Points (..., 3) [m] of P in the tool's frame, or P."""
        return _frozen(points if self.tool is None else (points - self.tool_position) @ self.tool_rotation)

    def _around(self, half_angle: float, radius: float, height: float = 0.0) -> np.ndarray:
        """(6, 3) points at an angle from their pair's direction: clockwise for even legs, else counterclockwise."""
        angle = _PAIR_ANGLES + _SIDE * half_angle
        return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(LEG_COUNT, height)], axis=-1)
