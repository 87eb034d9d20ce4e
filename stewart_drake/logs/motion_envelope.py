"""The region of states and of torques that controlled motions visit, from their logs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stewart_drake.logs.log import SimulationLog
from stewart_drake.mechanics.kinematics import pose_jacobian, reach_margin
from stewart_drake.robot import RobotParameters


def crank_rates(robot: RobotParameters, pose: np.ndarray, pose_rate: np.ndarray) -> np.ndarray:
    """Crank rates of a motion of the platform.

    Args:
        robot: Geometry.
        pose: (n, 6) [rad, m].
        pose_rate: (n, 6) [rad/s, m/s] Euler rates and velocity.

    Returns:
        (n, 6) [rad/s]; NaN where a rod cannot span, which a failing run can end with, or at a crank's dead centre.
    """
    rates = np.full(np.shape(pose), np.nan)
    within = np.all(reach_margin(robot, pose) > 0.0, axis=-1)
    rates[within] = np.einsum("nij,nj->ni", pose_jacobian(robot, pose[within]), pose_rate[within])
    return rates


@dataclass(frozen=True, eq=False)
class MotionEnvelope:
    """The box around everything that a motion visited; lower bounds first.

    Attributes:
        pose: (2, 6) [rad, m].
        pose_rate: (2, 6) [rad/s, m/s].
        crank_angle: (2, 6) [rad].
        crank_rate: (2, 6) [rad/s].
        torque: (2, 6) [N m] within the motors' limits.
        power: (2, 6) [W] of the motors; negative where they brake.
    """

    pose: np.ndarray
    pose_rate: np.ndarray
    crank_angle: np.ndarray
    crank_rate: np.ndarray
    torque: np.ndarray
    power: np.ndarray

    def united(self, other: MotionEnvelope) -> MotionEnvelope:
        """The box around both."""
        pairs = ((getattr(self, name), getattr(other, name)) for name in self.__dataclass_fields__)
        return MotionEnvelope(*(np.stack([np.fmin(a[0], b[0]), np.fmax(a[1], b[1])]) for a, b in pairs))


def motion_envelope(log: SimulationLog) -> MotionEnvelope:
    """The box around one run, up to where it ended."""
    rate = crank_rates(log.scenario.robot, log["pose"], log["pose_rate"])
    torque = log["torque_applied"]
    signals = (log["pose"], log["pose_rate"], log["crank_angle"], rate, torque, torque * rate)
    return MotionEnvelope(*(np.stack([np.fmin.reduce(s), np.fmax.reduce(s)]) for s in signals))


def envelope_of_all(logs: Sequence[SimulationLog]) -> MotionEnvelope:
    """The box around all runs; at least one."""
    envelope = motion_envelope(logs[0])
    for log in logs[1:]:
        envelope = envelope.united(motion_envelope(log))
    return envelope
