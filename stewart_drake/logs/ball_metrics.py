"""What a run tells of a ball on the platform: its errors, and the friction that it needed to roll without slipping."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stewart_drake.mechanics.kinematics import pose_rate_to_twist, rotation_matrix
from stewart_drake.robot.gravity import gravity_vector

if TYPE_CHECKING:
    from stewart_drake.logs.outcomes import RunRows


def ball_errors(rows: RunRows) -> np.ndarray | None:
    """(n,) [m] distance of the ball from its target; None without a target."""
    if (control := rows.scenario.ball_control) is None:
        return None
    return np.linalg.norm(rows["ball"] - control.target.evaluate(rows.time)[:, :2], axis=1)


def needed_friction(rows: RunRows) -> float | None:
    """Friction over normal force [-] between ball and plate, exceeded in a thousandth of the steps; None without them.

    From the motion alone, so that it is of any plant; steps in which the ball is thrown are left out.
    """
    if (ball := rows.scenario.ball) is None or rows.steps < 2:
        return None
    turn, twist = rotation_matrix(rows["pose"][:, :3]), pose_rate_to_twist(rows["pose"], rows["pose_rate"])
    place, slide = np.full((rows.steps, 3), ball.plate.height + ball.radius), np.zeros((rows.steps, 3))
    place[:, :2], slide[:, :2] = rows["ball"], rows["ball_velocity"]
    arm, roll = (np.einsum("nij,nj->ni", turn, vector) for vector in (place, slide))
    speed = twist[:, 3:] + np.cross(twist[:, :3], arm) + roll
    steps = np.diff(rows.time)[:, None]
    force = np.diff(speed, axis=0) / steps - gravity_vector(rows.scenario.gravity_in_base)
    normal = np.sum(force * turn[:-1, :, 2], axis=1)
    along = np.linalg.norm(force - normal[:, None] * turn[:-1, :, 2], axis=1)
    with np.errstate(divide="ignore"):
        needed = np.where(normal > 0.0, along / normal, np.inf)
    needed = needed[~ball.thrown(rows.time[:-1], rows.scenario.plant.time_step).any(axis=1)]
    return float(np.quantile(needed, 0.999, method="higher")) if len(needed) else None
