"""What tracker and encoders would say of a robot, and the derivatives of that by every parameter.

Two kinds of error. The closure of leg i, |R p_i + G - s_i - a_i u_i| - l_i, needs measured pose and reading and has a
value whatever the guess; the noise of both is in it. The tracker's error, measured pose minus the pose that forward
kinematics makes of the readings, is plain noise where the parameters are right: its derivatives do not depend on the
measured pose, so that noise does not bias the estimate. The first leads to the neighbourhood, the second to the answer.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from stewart_drake.calibration.frames import STILL, Frame, derivative
from stewart_drake.calibration.parameters import HOMING, OF_ROBOT, PER_LEG, SIZE, changed
from stewart_drake.mechanics.kinematics import newton, roll_pitch_yaw, rotation_matrix
from stewart_drake.mechanics.kinematics_laws import robot_record
from stewart_drake.robot import RobotParameters

if TYPE_CHECKING:
    from stewart_drake.calibration.measurements import MeasurementNoise

_NEWTON_STEPS = 40
CLOSED = 1e-12
"""[m] rod-length error at which a pose counts as that of the readings."""


@dataclass(frozen=True, eq=False)
class Model:
    """A guess and where the tracker stands: `base` is B in the tracker's frame, `marker` the marker in P.

    Changes (`SIZE`,) are counted from them; `at` are n poses of P in B, `angles` (n, 6) [rad] the readings there.
    """

    guess: RobotParameters
    base: Frame = STILL
    marker: Frame = STILL

    def frames(self, change: np.ndarray) -> tuple[Frame, Frame]:
        """Base and marker after a change."""
        base, marker = change[OF_ROBOT : OF_ROBOT + 6], change[OF_ROBOT + 6 :]
        return self.base.moved(base[:3], base[3:]), self.marker.moved(marker[:3], marker[3:])

    def with_frames(self, change: np.ndarray) -> Model:
        """The same guess with the frames of a change."""
        base, marker = self.frames(change)
        return replace(self, base=base, marker=marker)

    def seen(self, change: np.ndarray, at: Frame) -> Frame:
        """Poses of the marker in the tracker's frame."""
        base, marker = self.frames(change)
        return base.after(at).after(marker)

    def measured(self, change: np.ndarray, seen: Frame) -> Frame:
        """Poses of P in B from those of the marker: undoes `seen`."""
        base, marker = self.frames(change)
        return base.inverse().after(seen).after(marker.inverse())

    def predicted(self, change: np.ndarray, angles: np.ndarray, start: Frame) -> tuple[Frame, np.ndarray]:
        """Poses of P in B that forward kinematics makes of readings, from poses near to them; errors (n,) [m] left."""
        robot = robot_record(self.guess).copy()
        for name, values in changed(self.guess, change)._asdict().items():
            robot[name] = values
        pose = np.concatenate([roll_pitch_yaw(start.turn), start.shift], axis=-1)
        pose, off, _ = newton(robot, angles, pose, CLOSED, _NEWTON_STEPS)
        pose, off = np.nan_to_num(pose, posinf=0.0, neginf=0.0), np.nan_to_num(off, nan=np.inf)
        return Frame(rotation_matrix(pose[:, :3]), pose[:, 3:]), off

    def assembled(self, angles: np.ndarray) -> tuple[Frame, np.ndarray]:
        """Poses of P in B at those of n readings at which the guess can be assembled, and which these are (n,)."""
        home = Frame(np.tile(np.eye(3), (len(angles), 1, 1)), np.tile(self.guess.home_pose[3:], (len(angles), 1)))
        at, off = self.predicted(np.zeros(SIZE), angles, home)
        return at.rows(off <= CLOSED), off <= CLOSED

    def closures(self, change: np.ndarray, at: Frame, angles: np.ndarray) -> np.ndarray:
        """Errors (n, 6) [m] of the rods' lengths."""
        own = changed(self.guess, change)
        crank = np.cos(angles)[..., None] * own.crank_x + np.sin(angles)[..., None] * own.crank_y
        rod = np.einsum("nij,lj->nli", at.turn, own.joint) + at.shift[:, None] - own.shaft
        rod = rod - own.crank_length[:, None] * crank
        return np.sqrt(np.sum(rod * rod, axis=-1)) - own.rod_length

    def tracker_error(self, change: np.ndarray, at: Frame, seen: Frame) -> np.ndarray:
        """Measured minus predicted poses of the marker (n, 6) [rad, m]."""
        return seen.minus(self.seen(change, at))

    def tracker_slope(self, change: np.ndarray, at: Frame, angles: np.ndarray, seen: Frame | None = None) -> np.ndarray:
        """Derivatives (n, 6, `SIZE`) of the tracker's error at predicted poses; None: where it errs by nothing."""
        marker = self.seen(change, at) if seen is None else seen

        def both(change: np.ndarray, at: Frame) -> np.ndarray:
            return np.concatenate([self.tracker_error(change, at, marker), self.closures(change, at, angles)], axis=-1)

        by_change = derivative(lambda step: both(change + step, at), SIZE)
        by_pose = derivative(lambda step: both(change, at.moved(step[:3], step[3:])), 6)
        # The pose moves so that all legs stay closed.
        return by_change[:, :6] - by_pose[:, :6] @ np.linalg.solve(by_pose[:, 6:], by_change[:, 6:])

    def whitening(self, change: np.ndarray, at: Frame, angles: np.ndarray, noise: MeasurementNoise) -> np.ndarray:
        """Inverse roots (n, 6, 6) of the covariance of the tracker's error, the encoders' share included."""
        by_reading = self.tracker_slope(change, at, angles)[..., HOMING:OF_ROBOT:PER_LEG]
        own = np.diag([noise.rotation**2] * 3 + [noise.position**2] * 3)
        covariance = own + noise.encoder**2 * by_reading @ np.swapaxes(by_reading, -1, -2)
        return np.linalg.inv(np.linalg.cholesky(covariance))
