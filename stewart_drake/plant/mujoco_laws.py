"""Forces and measurement of a robot in MuJoCo, compiled: between frame B and motors, and MuJoCo's world and joints."""

from __future__ import annotations

import numpy as np

from stewart_drake.base.jit import njit
from stewart_drake.base.records import Mat3, Record, Vec3, Vec6, Vector, record
from stewart_drake.mechanics import kinematics_laws as laws
from stewart_drake.mechanics.linear_algebra import all_finite


class ModelFrames(Record):
    """Frames and motors of the model."""

    base: Mat3  # R_WB
    origin: Vec3  # [m] of B in the world.
    signs: Vec6  # Sign of the motor's axis in the model against the robot's.
    angles: Vec6  # [rad] theta of the cranks where their joints are zero.
    low: Vec6  # [N m] lowest torques of the motors.
    high: Vec6  # [N m] highest.


@njit
def apply_forces(
    frames: ModelFrames,
    torque: Vec6,
    wrench: Vec6,
    joints: Vector,
    position: Vec3,
    centre: Vec3,
    joint_torque: Vector,
    body_force: Vec6,
) -> None:
    """Sets MuJoCo's forces: torques of the motors, and a wrench about P, moved to its body's centre of mass.

    `joints` are the motors' places in `joint_torque`; positions are in the world.
    """
    frames = record(frames)
    for i in range(6):
        joint_torque[joints[i]] = frames.signs[i] * min(max(torque[i], frames.low[i]), frames.high[i])
    arm, moment = np.empty(3), np.empty(3)
    for i in range(3):
        body_force[i] = laws.dot(frames.base[i], wrench[3:])
        body_force[3 + i] = laws.dot(frames.base[i], wrench[:3])
        arm[i] = position[i] - centre[i]
    laws.cross(arm, body_force[:3], moment)
    for i in range(3):
        body_force[3 + i] += moment[i]


@njit
def measure(
    frames: ModelFrames,
    position: Vec3,
    axes: Vector,
    velocity: Vec6,
    joints: Vector,
    angles: Vector,
    rate_joints: Vector,
    rates: Vector,
    out: Vector,
) -> bool:
    """Measurement (24,) of a `Plant` from P's position, axes (9,) and velocities in the world, and the joints' motion.

    `joints` and `rate_joints` are the motors' places in `angles` and `rates`. False if it is not finite.
    """
    frames = record(frames)
    rotation, twist = np.empty((3, 3)), np.empty(6)
    for i in range(3):
        out[3 + i], twist[i], twist[3 + i] = 0.0, 0.0, 0.0
        for k in range(3):
            rotation[i, k] = 0.0
            for m in range(3):
                rotation[i, k] += frames.base[m, i] * axes[3 * m + k]
            out[3 + i] += frames.base[k, i] * (position[k] - frames.origin[k])
            twist[i] += frames.base[k, i] * velocity[k]
            twist[3 + i] += frames.base[k, i] * velocity[3 + k]
    laws.roll_pitch_yaw(rotation, out[:3])
    laws.rate_of(out[:6], twist, out[6:12])
    for i in range(6):
        out[12 + i] = frames.angles[i] + frames.signs[i] * angles[joints[i]]
        out[18 + i] = frames.signs[i] * rates[rate_joints[i]]
    return all_finite(out)
