"""What tracker and encoders would say of a robot, and the derivatives of that by every parameter.

Two kinds of error. The closure of leg i, |R p_i + G - s_i - a_i u_i| - l_i, needs measured pose and reading and has a
value whatever the guess; the noise of both is in it. The tracker's error, measured pose minus the pose that forward
kinematics makes of the readings, is plain noise where the parameters are right: its derivatives do not depend on the
measured pose, so that noise does not bias the estimate. The first leads to the neighbourhood, the second to the answer.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from stewart_drake.calibration.measurements import MeasurementNoise, Measurements
from stewart_drake.calibration.parameters import (
    OF_ROBOT,
    PER_LEG,
    Geometry,
    changed,
    exponential,
    left_jacobian,
    logarithm,
    skew,
)
from stewart_drake.mechanics.kinematics import cross, newton, roll_pitch_yaw, rotation_matrix
from stewart_drake.mechanics.kinematics_laws import robot_record
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEGS

_NEWTON_STEPS = 40
CLOSED = 1e-12
"""[m] rod-length error at which a pose counts as that of the readings."""


class Frame(NamedTuple):
    """A rigid motion.

    Attributes:
        turn: (3, 3) [-] or (n, 3, 3).
        shift: (3,) [m] or (n, 3).
    """

    turn: np.ndarray
    shift: np.ndarray

    def after(self, other: Frame) -> Frame:
        """This motion of what the other has moved."""
        return Frame(self.turn @ other.turn, np.einsum("...ij,...j->...i", self.turn, other.shift) + self.shift)

    def inverse(self) -> Frame:
        """What undoes it."""
        back = np.swapaxes(self.turn, -1, -2)
        return Frame(back, -np.einsum("...ij,...j->...i", back, self.shift))


STILL = Frame(np.eye(3), np.zeros(3))


class Closures(NamedTuple):
    """Errors of the rods' lengths at n poses and their derivatives.

    Attributes:
        error: (n, 6) [m] length minus rod.
        by_twist: (n, 6, 6) by a twist of P in B, one row per leg.
        by_own: (n, 6, 11) by the parameters of the leg.
        by_angle: (n, 6) [m/rad] by the reading.
    """

    error: np.ndarray
    by_twist: np.ndarray
    by_own: np.ndarray
    by_angle: np.ndarray


@dataclass(frozen=True, eq=False)
class Model:
    """A guess and where the tracker stands; changes are counted from both.

    Attributes:
        guess: The robot as believed.
        base: Of B in the tracker's frame.
        marker: Of the marker in P.
    """

    guess: RobotParameters
    base: Frame = STILL
    marker: Frame = STILL

    def frames(self, change: np.ndarray) -> tuple[Frame, Frame]:
        """Base and marker after a change (`SIZE`,)."""
        base, marker = change[OF_ROBOT : OF_ROBOT + 6], change[OF_ROBOT + 6 :]
        return (
            Frame(exponential(base[:3]) @ self.base.turn, self.base.shift + base[3:]),
            Frame(exponential(marker[:3]) @ self.marker.turn, self.marker.shift + marker[3:]),
        )

    def with_frames(self, change: np.ndarray) -> Model:
        """The same guess with the frames of a change."""
        base, marker = self.frames(change)
        return replace(self, base=base, marker=marker)

    def measured(self, change: np.ndarray, measurements: Measurements) -> Frame:
        """Poses of P in B as the tracker has them, given its frames."""
        base, marker = self.frames(change)
        seen = Frame(measurements.rotation, measurements.position)
        return base.inverse().after(seen).after(marker.inverse())

    def predicted(self, change: np.ndarray, angles: np.ndarray, start: Frame) -> tuple[Frame, np.ndarray]:
        """Poses of P in B that forward kinematics makes of readings (n, 6), and which rods' lengths (n,) [m] stay off.

        Args:
            change: (`SIZE`,).
            angles: (n, 6) [rad] readings.
            start: Poses near to them.
        """
        own = changed(self.guess, change)
        robot = robot_record(self.guess).copy()
        robot["shaft"], robot["joint"] = own.shafts, own.joints
        robot["crank_x"], robot["crank_y"] = own.zeros, own.quarters
        robot["crank_length"], robot["rod_length"] = own.cranks, own.rods
        pose = np.concatenate([roll_pitch_yaw(start.turn), start.shift], axis=-1)
        pose, off, _ = newton(robot, angles - own.homing, pose, CLOSED, _NEWTON_STEPS)
        pose, off = np.nan_to_num(pose, posinf=0.0, neginf=0.0), np.nan_to_num(off, nan=np.inf)
        return Frame(rotation_matrix(pose[:, :3]), pose[:, 3:]), off

    def closures(self, change: np.ndarray, at: Frame, angles: np.ndarray) -> Closures:
        """Errors of the rods' lengths at poses of P in B and readings (n, 6)."""
        return closures(changed(self.guess, change), at, angles)

    def closure_error(self, change: np.ndarray, measurements: Measurements) -> tuple[np.ndarray, np.ndarray]:
        """Closures (n, 6) [m] of measured poses and readings, and their derivatives (n, 6, `SIZE`)."""
        base, marker = self.frames(change)
        at = self.measured(change, measurements)
        found = self.closures(change, at, measurements.angles)
        twist = np.zeros((len(at.shift), 6, 12))
        back = base.turn.T
        turned = back @ left_jacobian(change[OF_ROBOT : OF_ROBOT + 3])
        away = np.einsum("ij,nj->ni", back, measurements.position - base.shift)
        twist[:, :3, :3], twist[:, 3:, 3:6] = -turned, -back
        twist[:, 3:, :3] = skew(away) @ turned
        twist[:, :3, 6:9] = -at.turn @ left_jacobian(change[OF_ROBOT + 6 : OF_ROBOT + 9])
        twist[:, 3:, 9:] = -at.turn
        # The marker's place turns with the platform: G = ... - R p.
        arm = skew(np.einsum("nij,j->ni", at.turn, marker.shift))
        twist[:, 3:, :9] += arm @ twist[:, :3, :9]
        return found.error, np.concatenate([_spread(found.by_own), found.by_twist @ twist], axis=-1)

    def tracker_error(self, change: np.ndarray, measurements: Measurements, at: Frame) -> tuple[np.ndarray, np.ndarray]:
        """Measured minus predicted poses of the marker (n, 6) [rad, m], and derivatives (n, 6, `SIZE`).

        Args:
            change: (`SIZE`,).
            measurements: n of them.
            at: `predicted` poses.
        """
        base, marker = self.frames(change)
        seen = base.after(at).after(marker)
        turn = logarithm(measurements.rotation @ np.swapaxes(seen.turn, -1, -2))
        error = np.concatenate([turn, measurements.position - seen.shift], axis=-1)
        derivative = self.marker_derivative(change, self.closures(change, at, measurements.angles), at)
        # Exp(turn) Exp(-d) = Exp(turn - right_jacobian^-1 d), and the right Jacobian is the left of minus the vector.
        derivative[:, :3] = np.linalg.solve(left_jacobian(-turn), derivative[:, :3])
        return error, -derivative

    def marker_derivative(self, change: np.ndarray, found: Closures, at: Frame) -> np.ndarray:
        """Of the marker's predicted pose by the parameters: (n, 6, `SIZE`), turn and shift in the tracker's frame."""
        base, marker = self.frames(change)
        to_marker = self._to_marker(change, at)
        arm = np.einsum("nij,j->ni", at.turn, marker.shift)
        by_legs = to_marker @ np.linalg.solve(found.by_twist, -_spread(found.by_own))
        by_base, by_marker = np.zeros((2, len(arm), 6, 6))
        by_base[:, :3, :3] = left_jacobian(change[OF_ROBOT : OF_ROBOT + 3])
        out = np.einsum("ij,nj->ni", base.turn, at.shift + arm)
        by_base[:, 3:, :3] = -skew(out) @ by_base[:, :3, :3]
        by_base[:, 3:, 3:] = np.eye(3)
        by_marker[:, :3, :3] = base.turn @ at.turn @ left_jacobian(change[OF_ROBOT + 6 : OF_ROBOT + 9])
        by_marker[:, 3:, 3:] = base.turn @ at.turn
        return np.concatenate([by_legs, by_base, by_marker], axis=-1)

    def whitening(self, change: np.ndarray, angles: np.ndarray, at: Frame, noise: MeasurementNoise) -> np.ndarray:
        """Inverse roots (n, 6, 6) of the covariance of `tracker_error`, the encoders' share included."""
        found = self.closures(change, at, angles)
        by_angle = -self._to_marker(change, at) @ np.linalg.solve(found.by_twist, _diagonal(found.by_angle))
        own = np.diag([noise.rotation**2] * 3 + [noise.position**2] * 3)
        covariance = own + noise.encoder**2 * by_angle @ np.swapaxes(by_angle, -1, -2)
        return np.linalg.inv(np.linalg.cholesky(covariance))

    def _to_marker(self, change: np.ndarray, at: Frame) -> np.ndarray:
        """Twists of P in B as twists of the marker in the tracker's frame; (n, 6, 6)."""
        base, marker = self.frames(change)
        made = np.zeros((len(at.shift), 6, 6))
        made[:, :3, :3] = made[:, 3:, 3:] = base.turn
        made[:, 3:, :3] = -base.turn @ skew(np.einsum("nij,j->ni", at.turn, marker.shift))
        return made


def closures(own: Geometry, at: Frame, angles: np.ndarray) -> Closures:
    """See `Model.closures`."""
    true = (angles - own.homing)[..., None]
    crank = np.cos(true) * own.zeros + np.sin(true) * own.quarters
    across = np.cos(true) * own.quarters - np.sin(true) * own.zeros
    arm = np.einsum("nij,lj->nli", at.turn, own.joints)
    rod = arm + at.shift[:, None] - own.shafts - own.cranks[:, None] * crank
    length = np.linalg.norm(rod, axis=-1)
    along = rod / length[..., None]
    by_twist = np.concatenate([cross(arm, along), along], axis=-1)
    by_own = np.empty((*length.shape, PER_LEG))
    by_own[..., :3] = -along
    by_own[..., 3:6] = np.einsum("nji,nlj->nli", at.turn, along)
    by_own[..., 6] = -np.sum(along * crank, axis=-1)
    by_own[..., 7] = -1.0
    by_own[..., 8:10] = -own.cranks[:, None] * np.einsum("nli,lij->nlj", cross(crank, along), own.turning)
    by_angle = -own.cranks * np.sum(along * across, axis=-1)
    by_own[..., 10] = -by_angle
    return Closures(length - own.rods, by_twist, by_own, by_angle)


def _spread(by_own: np.ndarray) -> np.ndarray:
    """Derivatives (n, 6, 11) by each leg's own parameters as those (n, 6, 66) by all."""
    made = np.zeros((*by_own.shape[:2], LEGS, PER_LEG))
    made[:, range(LEGS), range(LEGS)] = by_own
    return made.reshape(*by_own.shape[:2], OF_ROBOT)


def _diagonal(values: np.ndarray) -> np.ndarray:
    """Matrices (n, 6, 6) with values (n, 6) on their diagonals."""
    return values[..., None] * np.eye(LEGS)
