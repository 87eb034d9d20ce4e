"""A ball that rolls without slipping on the platform's plate: its share of the dynamics, exact, compiled.

The plate is a plane across the z axis of the platform's frame P. Coordinates: x, y [m] of the ball's centre in P, their
rates u, and the spin s [rad/s], the component of the ball's absolute angular velocity along the plate's normal n. With
the twist [w, v] of P,

    velocity of the centre = v + w x p + u,  angular velocity = w - n (n . w) + n x u / r + s n.

Kane's equations for [w, v, u] then have the symmetric inertia [[M, C], [C', k I]], k = m + I / r^2, and u' is
eliminated from them. The contact gives no torque about n, so that s' = -w . u / r. The base is at rest.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from stewart_drake.base.jit import njit
from stewart_drake.base.records import Mat3, Record, Vec2, Vec5, Vec6, Vec9
from stewart_drake.mechanics.kinematics_laws import cross, dot

SLOW = 1e-3  # [m/s] speed below which rolling resistance fades, so that a ball comes to rest without chatter. Assumed.
BallTerms = Annotated[np.ndarray, (8, 7)]
BallMotion = Vec5  # x, y [m], their rates [m/s], spin [rad/s].


class Ball(Record):
    """A ball, and the plate that it rolls on."""

    mass: float  # [kg]; 0 for no ball.
    radius: float  # [m]
    inertia: float  # [kg m^2] about its centre.
    height: float  # [m] of the plate over P.
    resistance: float  # [-] coefficient of rolling resistance.
    push: Vec2  # [N] external force on its centre, along the plate's x and y axes.


@njit
def ball_terms(ball: Ball, turn: Mat3, twist: Vec6, base: Vec9, motion: BallMotion, out: BallTerms) -> None:
    """What a ball adds to the platform's dynamics, after elimination of u'.

    Args:
        ball: The ball.
        turn: R_BP.
        twist: [rad/s, m/s] of P in B.
        base: What an inertial unit on the base at rest reads, see `robot.gravity.base_reading`.
        motion: x, y [m], their rates [m/s], spin [rad/s].
        out: Rows 0 to 5: inertia (6, 6), and as the last column the load (6,). Rows 6 and 7: u' as a linear function of
            the twist's rate, with the constant as the last column.
    """
    rows, w, r, inertia = np.zeros((9, 3)), twist[:3], ball.radius, ball.inertia
    normal, place, roll, centre, spin = rows[0], rows[1], rows[2], rows[3], rows[4]
    axis, side, first, second = rows[5], rows[6], rows[7], rows[8]
    for i in range(3):
        normal[i] = turn[i, 2]
        place[i] = turn[i, 0] * motion[0] + turn[i, 1] * motion[1] + normal[i] * (ball.height + r)
        roll[i] = turn[i, 0] * motion[2] + turn[i, 1] * motion[3]
    # Acceleration of the centre, less gravity, without accelerations of the coordinates; the same of the rotation.
    cross(w, place, first)
    cross(w, roll, second)
    for i in range(3):
        first[i] += 2.0 * roll[i]
    cross(w, first, centre)
    cross(normal, roll, first)
    cross(w, first, spin)
    cross(w, normal, second)
    along = dot(w, normal)
    for i in range(3):
        spin[i] = spin[i] / r + (motion[4] - along) * second[i]
    along = dot(spin, normal)
    weight = max(0.0, ball.mass * dot(base[:3], normal))
    drag = ball.resistance * weight / np.sqrt(motion[2] ** 2 + motion[3] ** 2 + SLOW**2)
    for i in range(3):
        spin[i] = inertia * (spin[i] - along * normal[i])
        centre[i] = ball.mass * (centre[i] + base[i]) - turn[i, 0] * ball.push[0] - turn[i, 1] * ball.push[1]
    cross(place, centre, first)
    for i in range(3):
        out[i, 6], out[3 + i, 6] = first[i] + spin[i], centre[i]
    # Inertia of a point mass about P, and of the rotation without its part about the normal.
    square = ball.mass * dot(place, place) + inertia
    for i in range(3):
        for k in range(3):
            out[i, k] = -ball.mass * place[i] * place[k] - inertia * normal[i] * normal[k] + (square if i == k else 0.0)
            out[i, 3 + k] = out[3 + i, k] = 0.0
            out[3 + i, 3 + k] = ball.mass if i == k else 0.0
    x, y, z = ball.mass * place[0], ball.mass * place[1], ball.mass * place[2]
    out[0, 4] = out[4, 0] = -z
    out[0, 5] = out[5, 0] = y
    out[1, 3] = out[3, 1] = z
    out[1, 5] = out[5, 1] = -x
    out[2, 3] = out[3, 2] = -y
    out[2, 4] = out[4, 2] = x
    total = ball.mass + inertia / (r * r)
    for number in range(2):
        for i in range(3):
            axis[i] = turn[i, number]
        cross(normal, axis, side)
        cross(place, axis, first)
        row = out[6 + number]
        for i in range(3):
            row[i], row[3 + i] = -(ball.mass * first[i] + inertia * side[i] / r) / total, -ball.mass * axis[i] / total
        row[6] = -(dot(axis, centre) + dot(side, spin) / r + drag * motion[2 + number]) / total
        for i in range(6):
            for k in range(7):
                out[i, k] -= total * row[i] * row[k]


@njit
def ball_rate(
    ball: Ball, turn: Mat3, twist: Vec6, twist_rate: Vec6, terms: BallTerms, motion: BallMotion, out: BallMotion
) -> None:
    """Time derivative of a ball's motion, from `ball_terms` and the twist's rate [rad/s^2, m/s^2]."""
    slip = 0.0
    for number in range(2):
        out[number] = motion[2 + number]
        out[2 + number] = terms[6 + number, 6]
        for i in range(6):
            out[2 + number] += terms[6 + number, i] * twist_rate[i]
        for i in range(3):
            slip += twist[i] * turn[i, number] * motion[2 + number]
    out[4] = -slip / ball.radius
