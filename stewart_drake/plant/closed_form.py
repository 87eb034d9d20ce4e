"""The closed-form plant: the robot's dynamics in the six coordinates of its platform, compiled.

`semi_implicit` is of first order, as Drake's SAP: accelerations at the beginning of a step, friction and pose at its
end. `rk4` is the classical Runge-Kutta method of order 4 on the same equations.
"""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np

from stewart_drake.base.errors import SingularPoseError
from stewart_drake.base.jit import njit
from stewart_drake.base.records import Mat3, Mat6, Matrix, Record, TickResult, Vec3, Vec6, Vec9, Vec12, record
from stewart_drake.base.sampling import on_grid
from stewart_drake.mechanics import kinematics_laws as laws
from stewart_drake.mechanics.ball import BallOptions
from stewart_drake.mechanics.dynamics_laws import loads, task_inertia
from stewart_drake.mechanics.friction import SWEEPS, Bristles, Friction, implicit_torque, update_bristles
from stewart_drake.mechanics.kinematics import crank_rates, inverse_kinematics, leg_geometry, pose_rate_to_twist
from stewart_drake.mechanics.kinematics_laws import Legs, Robot
from stewart_drake.mechanics.linear_algebra import any_nonzero, copy_to, solve
from stewart_drake.mechanics.rolling_ball import Ball, BallMotion, BallTerms, ball_rate, ball_terms
from stewart_drake.plant.model_files import HomeFrames, home_frames
from stewart_drake.plant.plant_options import BALL, MechanismOptions, foreign_state
from stewart_drake.robot import Gravity, RobotParameters, base_reading

SUBSTEPS = 8
"""Number of substeps of `rk4` in a step in which a motor with dry friction reverses or sticks."""


class ClosedFormState(Record):
    """State of the plant; the first four fields are what a `Plant` measures, the first five with a ball."""

    pose: Vec6  # [rad, m], pitch in [-pi/2, pi/2].
    pose_rate: Vec6  # [rad/s, m/s] Euler rates and velocity.
    angles: Vec6  # [rad] of the cranks, not wrapped.
    crank_rate: Vec6  # [rad/s]
    ball: BallMotion  # [m, m/s, rad/s] place and velocity on the plate, spin; see `mechanics.rolling_ball`.
    twist: Vec6  # [rad/s, m/s] in B.
    bristles: Bristles


class ClosedFormParams(Record):
    """Parameters of the plant."""

    base: Vec9  # What the base's inertial unit reads, see `base_reading`.
    step: float  # [s]
    ball: Ball


class ClosedFormOptions(MechanismOptions):
    """The exact closed form of the robot, compiled, without Drake: several times faster, for studies and searches."""

    compared_with: ClassVar[str | None] = "drake"
    carries_ball: ClassVar[bool] = True

    kind: Literal["closed_form"] = "closed_form"
    integrator: Literal["semi_implicit", "rk4"] = "semi_implicit"
    """Integration: semi-implicit of first order, as in Drake, or Runge-Kutta of order 4. When a motor with dry friction
    reverses or sticks, both are of first order."""

    def make(self, robot: RobotParameters, gravity: Gravity, ball: BallOptions | None = None) -> ClosedForm:
        return ClosedForm(robot, self, gravity, ball)


class ClosedForm:
    """The robot as a `Plant`; it uses time step, friction and payload of the options."""

    def __init__(
        self, robot: RobotParameters, options: MechanismOptions, gravity: Gravity, ball: BallOptions | None = None
    ) -> None:
        self._robot, self._home, self._state = robot, home_frames(robot), ClosedFormState.new()
        self._measured, self._ball = self._state.view(np.float64)[: 24 if ball is None else BALL.stop], ball
        params = ClosedFormParams.new(base=base_reading(gravity), step=on_grid(options.time_step))
        if ball is not None:
            params["ball"] = ball.record()
        # With options of other plants too, semi-implicit.
        self._kernel = _rk4 if getattr(options, "integrator", "") == "rk4" else _semi_implicit
        self._fixed, self._legs = (options.loaded(robot), options.friction_of(robot), params), Legs.empty()

    def initial(self, pose: np.ndarray, pose_rate: np.ndarray) -> np.ndarray:
        """Begins at a pose (6,) and its rate (6,), with relaxed bristles."""
        angles, rates = crank_motion(self._robot, self._home, pose, pose_rate)
        state = ClosedFormState.new(pose=pose, pose_rate=pose_rate, angles=angles, crank_rate=rates)
        state["twist"], state["bristles"]["anchor"] = pose_rate_to_twist(pose, pose_rate), angles
        if self._ball is not None:
            state["ball"][0, :4] = *self._ball.start, *self._ball.velocity
        return self.restore(state)

    def step(self, torque: np.ndarray, wrench: np.ndarray) -> np.ndarray:
        """A step; SingularPoseError at a dead centre."""
        status, leg, margin = self._kernel(*self._fixed, torque, wrench, self._legs, self._state)
        if status != laws.OK:
            raise SingularPoseError("serial", self._state["pose"][0].copy(), margin, 0.0, leg)
        return self._measured

    def set_base(self, base: np.ndarray) -> None:
        self._fixed[2]["base"] = base

    def push_ball(self, force: np.ndarray) -> None:
        self._fixed[2]["ball"]["push"] = force

    def save(self) -> ClosedFormState:
        return self._state.copy()

    def restore(self, state: ClosedFormState) -> np.ndarray:
        if getattr(state, "dtype", None) != ClosedFormState.layout:
            raise foreign_state(state, "a closed form")
        self._state[:] = state
        return self._measured


def crank_motion(
    robot: RobotParameters, home: HomeFrames, pose: np.ndarray, pose_rate: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Angles of the cranks (6,) [rad], within half a turn of home, and their rates (6,) [rad/s]."""
    angles = home.crank_angles + home.motor_angles(inverse_kinematics(robot, pose))
    return angles, crank_rates(robot, leg_geometry(robot, pose), pose, pose_rate)


@njit
def _accelerations(
    robot: Robot,
    legs: Legs,
    twist: Vec6,
    base: Vec9,
    rolls: bool,
    terms: BallTerms,
    torque: Vec6,
    wrench: Vec6,
    jacobian: Mat6,
    out: Matrix,
) -> None:
    """Acceleration under torques and a wrench in the last column of `out` (6, 1 or 7), with M^-1 J' before it if 7.

    `terms` are those of a ball that `rolls`.
    """
    inertia, load, crank_torque, still, last = np.empty((6, 6)), np.empty(6), np.empty(6), np.zeros(6), out.shape[1] - 1
    task_inertia(robot, legs, inertia)
    loads(robot, legs, twist, still, base, load, crank_torque)
    laws.crank_jacobian(legs, jacobian)
    if rolls:
        for k in range(6):
            load[k] += terms[k, 6]
            for i in range(6):
                inertia[k, i] += terms[k, i]
    for k in range(6):
        out[k, last] = wrench[k] - load[k]
    for i in range(6):
        net = torque[i] - crank_torque[i]
        for k in range(6):
            if last == 6:
                out[k, i] = jacobian[i, k]
            out[k, last] += jacobian[i, k] * net
    solve(inertia, out)


@njit
def _friction_torque(
    friction: Friction,
    jacobian: Mat6,
    accelerations: Matrix,
    step: float,
    state: ClosedFormState,
    twist: Vec6,
    out: Vec6,
) -> None:
    """Friction torque at a step's end, viscous included, for the twist that there would be without it."""
    rates, mobility = np.zeros(6), np.zeros((6, 6))
    for i in range(6):
        for m in range(6):
            rates[i] += jacobian[i, m] * twist[m]
            for k in range(6):
                mobility[i, k] += jacobian[i, m] * accelerations[m, k]
    implicit_torque(friction, state.bristles, state.angles, rates, mobility, step, SWEEPS, out)


@njit
def _moved_pose(rotation: Mat3, position: Vec3, turn: Vec3, shift: Vec3, pose: Vec6) -> None:
    """Pose after a turn [rad], see `_turn`, and a shift [m]."""
    turned, axis, result = np.empty((3, 3)), np.empty(3), np.empty(3)
    for k in range(3):
        for i in range(3):
            axis[i] = rotation[i, k]
        _turn(axis, turn, result)
        for i in range(3):
            turned[i, k] = result[i]
        pose[3 + k] = position[k] + shift[k]
    laws.roll_pitch_yaw(turned, pose[:3])


@njit
def _end_step(
    robot: Robot, friction: Friction, legs: Legs, step: float, pose: Vec6, twist: Vec6, state: ClosedFormState
) -> int:
    """Sets the state at a step's end; -1, or the leg that cannot span there, and then the state is not changed."""
    bad = laws.legs_at(robot, pose, legs)
    if bad >= 0:
        return bad
    copy_to(state.pose[:], pose)
    copy_to(state.twist[:], twist)
    laws.rate_of(pose, twist, state.pose_rate[:])
    laws.crank_rates(legs, twist, state.crank_rate[:])
    for i in range(6):
        change = np.arctan2(legs.sine[i], legs.cosine[i]) - state.angles[i]
        state.angles[i] += change - 2.0 * np.pi * np.rint(change / (2.0 * np.pi))
    update_bristles(friction, state.angles[:], step, state.bristles.anchor[:], state.bristles.slip[:])
    return -1


@njit
def _semi_implicit(
    robot: Robot,
    friction: Friction,
    params: ClosedFormParams,
    torque: Vec6,
    wrench: Vec6,
    legs: Legs,
    state: ClosedFormState,
) -> TickResult:
    """One step of M(pose) d(twist)/dt + h = J' (T + friction) + wrench [N m, N], the external one about P.

    Returns OK, or SERIAL with the leg that cannot span and its margin, and then the state is not changed.
    """
    robot, friction, params, legs, state = record(robot), record(friction), record(params), record(legs), record(state)
    step, jacobian, accelerations = params.step, np.empty((6, 6)), np.empty((6, 7))
    twist, move, pose, friction_torque, change = np.empty(6), np.empty(6), np.empty(6), np.empty(6), np.empty(6)
    bad = laws.legs_at(robot, state.pose[:], legs)
    if bad >= 0:
        return laws.SERIAL, bad, legs.reach_margin[bad]
    rolls, terms, rate = params.ball.mass > 0.0, np.empty((8, 7)), np.empty(5)
    if rolls:
        ball_terms(params.ball, legs.rotation[:], state.twist[:], params.base[:], state.ball[:], terms)
    _accelerations(robot, legs, state.twist[:], params.base[:], rolls, terms, torque, wrench, jacobian, accelerations)
    for k in range(6):
        twist[k] = state.twist[k] + step * accelerations[k, 6]
    if any_nonzero(friction.break_away[:]) or any_nonzero(friction.viscous[:]):
        _friction_torque(friction, jacobian, accelerations, step, state, twist, friction_torque)
        for k in range(6):
            for i in range(6):
                twist[k] += step * accelerations[k, i] * friction_torque[i]
    for k in range(6):
        move[k] = step * twist[k]
    if rolls:
        for k in range(6):
            change[k] = (twist[k] - state.twist[k]) / step
        ball_rate(params.ball, legs.rotation[:], state.twist[:], change, terms, state.ball[:], rate)
    _moved_pose(legs.rotation[:], state.pose[3:], move[:3], move[3:], pose)
    bad = _end_step(robot, friction, legs, step, pose, twist, state)
    if rolls and bad < 0:
        for k in range(2):
            state.ball[2 + k] += step * rate[2 + k]
            state.ball[k] += step * state.ball[2 + k]
        state.ball[4] += step * rate[4]
    return laws.SERIAL if bad >= 0 else laws.OK, bad, legs.reach_margin[max(bad, 0)]


@njit
def _rk4(
    robot: Robot,
    friction: Friction,
    params: ClosedFormParams,
    torque: Vec6,
    wrench: Vec6,
    legs: Legs,
    state: ClosedFormState,
) -> TickResult:
    """`_semi_implicit` by Runge-Kutta of order 4, in `SUBSTEPS` if a motor with dry friction reverses or sticks."""
    before, step, dry = state.copy(), record(params).step, any_nonzero(record(friction).break_away[:])
    bad, margin = _rk4_step(robot, friction, params, legs, torque, wrench, step, state)
    if not dry or bad >= 0 or _keep_turning(record(before).crank_rate[:], record(state).crank_rate[:]):
        return laws.SERIAL if bad >= 0 else laws.OK, bad, margin
    state[0] = before[0]
    for _ in range(SUBSTEPS):
        bad, margin = _rk4_step(robot, friction, params, legs, torque, wrench, step / SUBSTEPS, state)
        if bad >= 0:
            state[0] = before[0]
            break
    return laws.SERIAL if bad >= 0 else laws.OK, bad, margin


@njit
def _keep_turning(before: Vec6, after: Vec6) -> bool:
    """Whether no crank rests or has reversed."""
    for i in range(6):  # noqa: SIM110 - numba knows no generators here
        if not before[i] * after[i] > 0.0:
            return False
    return True


@njit
def _rk4_step(
    robot: Robot,
    friction: Friction,
    params: ClosedFormParams,
    legs: Legs,
    torque: Vec6,
    wrench: Vec6,
    step: float,
    state: ClosedFormState,
) -> tuple[int, float]:
    """A step [s] of order 4: W. Kutta, Z. Math. Phys. 46 (1901) 435.

    Rotations are integrated in the coordinates of `_turn`. Dry friction is that of a semi-implicit step, and constant.
    """
    robot, friction, params, legs, state = record(robot), record(friction), record(params), record(legs), record(state)
    jacobian, acceleration = np.empty((6, 6)), np.empty((6, 1))
    # Turn, shift, and change of twist and ball since the step's beginning, their rates in a stage, the mean of these.
    change, rate, mean = np.zeros(17), np.empty(17), np.zeros(17)
    rolls, terms, ball = params.ball.mass > 0.0, np.empty((8, 7)), np.empty(5)
    size = 17 if rolls else 12
    held, applied, twist, pose, start = np.empty(6), np.empty(6), np.empty(6), np.empty(6), np.empty((3, 3))
    copy_to(held, torque)
    copy_to(pose, state.pose[:])
    for stage in range(4):
        bad = laws.legs_at(robot, pose, legs)
        if bad >= 0:
            return bad, legs.reach_margin[bad]
        for k in range(6):
            twist[k] = state.twist[k] + change[6 + k]
        if rolls:
            for k in range(5):
                ball[k] = state.ball[k] + change[12 + k]
            ball_terms(params.ball, legs.rotation[:], twist, params.base[:], ball, terms)
        if stage == 0:
            for k in range(3):
                copy_to(start[k], legs.rotation[k])
            if any_nonzero(friction.break_away[:]) or any_nonzero(friction.viscous[:]):
                _add_dry_friction(robot, friction, params, legs, rolls, terms, wrench, step, state, held)
        copy_to(applied, held)
        _add_viscous_friction(friction, legs, twist, applied)
        _accelerations(robot, legs, twist, params.base[:], rolls, terms, applied, wrench, jacobian, acceleration)
        _turn_rate(change[:3], twist[:3], rate[:3])
        for k in range(3):
            rate[3 + k] = twist[3 + k]
        for k in range(6):
            rate[6 + k] = acceleration[k, 0]
        if rolls:
            ball_rate(params.ball, legs.rotation[:], twist, acceleration[:, 0], terms, ball, rate[12:])
        weight, ahead = (2.0 if 0 < stage < 3 else 1.0) / 6.0, 0.5 if stage < 2 else 1.0
        for k in range(size):
            mean[k] += weight * rate[k]
            change[k] = step * (ahead * rate[k] if stage < 3 else mean[k])
        _moved_pose(start, state.pose[3:], change[:3], change[3:6], pose)
    for k in range(6):
        twist[k] = state.twist[k] + change[6 + k]
    bad = _end_step(robot, friction, legs, step, pose, twist, state)
    if rolls and bad < 0:
        for k in range(5):
            state.ball[k] += change[12 + k]
    return bad, legs.reach_margin[max(bad, 0)]


@njit
def _add_viscous_friction(friction: Friction, legs: Legs, twist: Vec6, torque: Vec6) -> None:
    """Adds the viscous friction at a twist to torques."""
    for i in range(6):
        torque[i] -= (
            friction.viscous[i]
            * (laws.dot(legs.line[i, :3], twist[:3]) + laws.dot(legs.line[i, 3:], twist[3:]))
            / legs.lever[i]
        )


@njit
def motion_rate(
    robot: Robot, friction: Friction, base: Vec9, legs: Legs, motion: Vec12, torque: Vec6, wrench: Vec6, out: Vec12
) -> tuple[int, float]:
    """Time derivative of pose and pose rate in Euler angles, with viscous friction only, for other integrators.

    Returns leg and margin as `_semi_implicit`.
    """
    robot, friction, legs = record(robot), record(friction), record(legs)
    twist, applied, jacobian, acceleration = np.empty(6), np.empty(6), np.empty((6, 6)), np.empty((6, 1))
    bad = laws.legs_at(robot, motion[:6], legs)
    if bad >= 0:
        return bad, legs.reach_margin[bad]
    laws.twist_of(motion[:6], motion[6:], twist)
    copy_to(applied, torque)
    _add_viscous_friction(friction, legs, twist, applied)
    _accelerations(robot, legs, twist, base, False, np.empty((8, 7)), applied, wrench, jacobian, acceleration)
    laws.euler_drift(motion[:3], motion[6:], out[6:9])
    for k in range(6):
        out[k] = motion[6 + k]
        out[6 + k] = acceleration[k, 0] - (out[6 + k] if k < 3 else 0.0)
    laws.euler_rates(motion[:3], out[6:9], out[6:9])
    return -1, 0.0


@njit
def _add_dry_friction(
    robot: Robot,
    friction: Friction,
    params: ClosedFormParams,
    legs: Legs,
    rolls: bool,
    terms: BallTerms,
    wrench: Vec6,
    step: float,
    state: ClosedFormState,
    torque: Vec6,
) -> None:
    """Adds the dry friction of a semi-implicit step to torques: its friction without the viscous part at its end."""
    jacobian, accelerations, twist, friction_torque = np.empty((6, 6)), np.empty((6, 7)), np.empty(6), np.empty(6)
    _accelerations(robot, legs, state.twist[:], params.base[:], rolls, terms, torque, wrench, jacobian, accelerations)
    for k in range(6):
        twist[k] = state.twist[k] + step * accelerations[k, 6]
    _friction_torque(friction, jacobian, accelerations, step, state, twist, friction_torque)
    for i in range(6):
        for k in range(6):
            twist[k] += step * accelerations[k, i] * friction_torque[i]
    for i in range(6):
        rate = 0.0
        for k in range(6):
            rate += jacobian[i, k] * twist[k]
        torque[i] += friction_torque[i] + friction.viscous[i] * rate


@njit
def _turn(axis: Vec3, turn: Vec3, out: Vec3) -> None:
    """An axis after a turn [rad]: by 2 atan(|turn| / 2) about it, a step of a unit quaternion."""
    half, inner, outer = np.empty(3), np.empty(3), np.empty(3)
    for k in range(3):
        half[k] = 0.5 * turn[k]
    scale = 2.0 / (1.0 + half[0] * half[0] + half[1] * half[1] + half[2] * half[2])
    laws.cross(half, axis, inner)
    for k in range(3):
        inner[k] += axis[k]
    laws.cross(half, inner, outer)
    for k in range(3):
        out[k] = axis[k] + scale * outer[k]


@njit
def _turn_rate(turn: Vec3, omega: Vec3, out: Vec3) -> None:
    """Rate [rad/s] of a turn of `_turn`, after which the angular velocity in B is omega [rad/s]."""
    across, along = np.empty(3), 0.25 * laws.dot(turn, omega)
    laws.cross(omega, turn, across)
    for k in range(3):
        out[k] = omega[k] + 0.5 * across[k] + along * turn[k]
