"""The region of states and of torques that controlled motions visit, from their logs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from stewart_drake.logs.log import SimulationLog
from stewart_drake.mechanics.kinematics import pose_jacobian, reach_margin
from stewart_drake.robot import RobotParameters


def crank_rates(robot: RobotParameters, pose: np.ndarray, pose_rate: np.ndarray) -> np.ndarray:
    """Crank rates (n, 6) [rad/s]; NaN where a rod cannot span, as at the end of a failing run, or at a dead centre."""
    rates = np.full(np.shape(pose), np.nan)
    within = np.all(reach_margin(robot, pose) > 0.0, axis=-1)
    rates[within] = np.einsum("nij,nj->ni", pose_jacobian(robot, pose[within]), pose_rate[within])
    return rates


@dataclass(frozen=True, eq=False)
class MotionEnvelope:
    """The box around everything that a motion visited, (2, 6) each, lower bounds first.

    Attributes:
        pose: [rad, m].
        pose_rate: [rad/s, m/s].
        crank_angle: [rad].
        crank_rate: [rad/s].
        torque: [N m] within the motors' limits.
        power: [W] of the motors; negative where they brake.
    """

    pose: np.ndarray
    pose_rate: np.ndarray
    crank_angle: np.ndarray
    crank_rate: np.ndarray
    torque: np.ndarray
    power: np.ndarray


def motion_envelope(log: SimulationLog) -> MotionEnvelope:
    """The box around one run, up to where it ended."""
    rate = crank_rates(log.scenario.robot, log["pose"], log["pose_rate"])
    torque = log["torque_applied"]
    signals = (log["pose"], log["pose_rate"], log["crank_angle"], rate, torque, torque * rate)
    return MotionEnvelope(*(np.stack([np.fmin.reduce(s), np.fmax.reduce(s)]) for s in signals))


def envelope_of_all(logs: Sequence[SimulationLog]) -> MotionEnvelope:
    """The box around all runs; at least one."""
    boxes = [motion_envelope(log) for log in logs]
    signals = [np.stack([getattr(box, field.name) for box in boxes]) for field in fields(MotionEnvelope)]
    return MotionEnvelope(*(np.stack([np.fmin.reduce(s[:, 0]), np.fmax.reduce(s[:, 1])]) for s in signals))
