"""The closed form: the robot in the six coordinates of its platform.

`semi_implicit` steps as the `MultibodyPlant` does, of first order like SAP: accelerations at the step's beginning,
friction and pose at its end. `rk4` is the classical Runge-Kutta method of order 4 on the same equations.
"""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import numpy as np

from stewart_drake.base.errors import SingularPoseError
from stewart_drake.base.jit import fields, new_record, njit, record
from stewart_drake.base.sampling import on_grid
from stewart_drake.mechanics import kinematics_laws as laws
from stewart_drake.mechanics.dynamics_laws import loads, task_inertia
from stewart_drake.mechanics.friction import SWEEPS, implicit_torque, update_bristles
from stewart_drake.mechanics.kinematics import crank_rates, inverse_kinematics, leg_geometry, pose_rate_to_twist
from stewart_drake.mechanics.linear_algebra import copy_to, solve
from stewart_drake.plant.model_files import HomeFrames, home_frames
from stewart_drake.plant.plant_options import MechanismOptions, foreign_state
from stewart_drake.robot import RobotParameters

STATE = fields(pose=6, pose_rate=6, angles=6, crank_rate=6, twist=6, anchor=6, slip=6)
"""What there is to know of the robot at an instant; first what is measured. pose: [rad, m], pitch in [-pi/2, pi/2].
pose_rate: Euler rates and velocity [rad/s, m/s]. angles: of the cranks [rad], not wrapped. crank_rate: theirs [rad/s].
twist: in B [rad/s, m/s]. anchor: of the bristles [rad]. slip: speed of the anchors in the step before [rad/s]."""
PARAMS = fields(gravity=(), step=())  # [m/s^2], [s].
FINER = 8  # Steps of `rk4` for one in which a motor with dry friction turns round or sticks.


class ClosedFormOptions(MechanismOptions):
    """The exact closed form of the robot, compiled, without Drake: several times faster, for studies and searches."""

    compared_with: ClassVar[str | None] = "drake"

    kind: Literal["closed_form"] = "closed_form"
    integrator: Literal["semi_implicit", "rk4"] = "semi_implicit"
    """How a step is taken: as Drake does, of first order, or by Runge-Kutta of order 4. Where a motor with dry friction
    turns round or sticks, both are of first order."""

    def make(self, robot: RobotParameters, gravity: float) -> ClosedForm:
        return ClosedForm(robot, self, gravity)


class ClosedForm:
    """The robot as a `Plant`; of the options count time step, friction and payload."""

    def __init__(self, robot: RobotParameters, options: MechanismOptions, gravity: float) -> None:
        self._robot, self._home, self._state = robot, home_frames(robot), np.zeros(1, STATE)
        self._measured = self._state.view(np.float64)[:24]
        params = new_record(PARAMS, gravity=gravity, step=on_grid(options.time_step))
        # Other plants' options are stepped as Drake does.
        self._kernel = _rk4 if getattr(options, "integrator", "") == "rk4" else _semi_implicit
        self._fixed = options.loaded(robot), options.friction_of(robot), params, laws.Legs.empty()

    def initial(self, pose: np.ndarray, pose_rate: np.ndarray) -> np.ndarray:
        """Begins at a pose (6,) and its rate (6,), friction without tension."""
        angles, rates = crank_motion(self._robot, self._home, pose, pose_rate)
        moving = {"pose": pose, "pose_rate": pose_rate, "angles": angles, "crank_rate": rates}
        twist = pose_rate_to_twist(pose, pose_rate)
        return self.restore(new_record(STATE, **moving, twist=twist, anchor=angles))

    def step(self, torque: np.ndarray, wrench: np.ndarray) -> np.ndarray:
        """A step; SingularPoseError at a dead centre."""
        leg, margin = self._kernel(*self._fixed, torque, wrench, self._state)
        if leg >= 0:
            raise SingularPoseError("serial", self._state["pose"][0].copy(), margin, 0.0, leg)
        return self._measured

    def save(self) -> np.ndarray:
        return self._state.copy()

    def restore(self, state: np.ndarray) -> np.ndarray:
        if getattr(state, "dtype", None) != STATE:
            raise foreign_state(state, "a closed form")
        self._state[:] = state
        return self._measured


def crank_motion(
    robot: RobotParameters, home: HomeFrames, pose: np.ndarray, pose_rate: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Angles of the cranks [rad], within half a turn of home, and their rates [rad/s], (6,) of a pose and its rate."""
    angles = home.crank_angles + home.motor_angles(inverse_kinematics(robot, pose))
    return angles, crank_rates(robot, leg_geometry(robot, pose), pose, pose_rate)


@njit
def _accelerated(
    robot: Any, legs: Any, twist: Any, gravity: float, torque: Any, wrench: Any, jacobian: Any, out: Any
) -> None:
    """Acceleration M^-1 (J' (torque - of_cranks) - load + wrench) in the last column; before it M^-1 J', if any."""
    inertia, load, of_cranks, still, last = np.empty((6, 6)), np.empty(6), np.empty(6), np.zeros(6), out.shape[1] - 1
    task_inertia(robot, legs, inertia)
    loads(robot, legs, twist, still, gravity, load, of_cranks)
    laws.crank_jacobian(legs, jacobian)
    for k in range(6):
        out[k, last] = wrench[k] - load[k]
    for i in range(6):
        given = torque[i] - of_cranks[i]
        for k in range(6):
            if last == 6:
                out[k, i] = jacobian[i, k]
            out[k, last] += jacobian[i, k] * given
    solve(inertia, out)


@njit
def _friction_torque(friction: Any, jacobian: Any, pushed: Any, step: float, state: Any, twist: Any, out: Any) -> None:
    """Friction's torque (6,) at a step's end, viscous included, for the twist (6,) that there would be without it."""
    rates, mobility = np.zeros(6), np.zeros((6, 6))
    for i in range(6):
        for m in range(6):
            rates[i] += jacobian[i, m] * twist[m]
            for k in range(6):
                mobility[i, k] += jacobian[i, m] * pushed[m, k]
    implicit_torque(friction, state, state.angles, rates, mobility, step, SWEEPS, out)


@njit
def _moved(rotation: Any, position: Any, turn: Any, shift: Any, pose: Any) -> None:
    """The pose (6,) after a turn (3,) [rad], see `_turn`, and a shift (3,) [m]."""
    turned = np.empty((3, 3))
    for k in range(3):
        _turn(rotation[:, k], turn, turned[:, k])
        pose[3 + k] = position[k] + shift[k]
    laws.roll_pitch_yaw(turned, pose[:3])


@njit
def _arrive(robot: Any, friction: Any, legs: Any, step: float, pose: Any, twist: Any, state: Any) -> int:
    """The state at a step's end; -1, or the leg that cannot span the pose there, and then the state is as it was."""
    bad = laws.legs_at(robot, pose, legs)
    if bad >= 0:
        return bad
    copy_to(state.pose[:], pose)
    copy_to(state.twist[:], twist)
    laws.rate_of(pose, twist, state.pose_rate[:])
    laws.crank_rates(legs, twist, state.crank_rate[:])
    for i in range(6):
        ahead = np.arctan2(legs.sine[i], legs.cosine[i]) - state.angles[i]
        state.angles[i] += ahead - 2.0 * np.pi * np.rint(ahead / (2.0 * np.pi))
    update_bristles(friction, state.angles[:], step, state.anchor[:], state.slip[:])
    return -1


@njit
def _semi_implicit(robot: Any, friction: Any, params: Any, legs: Any, torque: Any, wrench: Any, state: Any) -> Any:
    """One step of M(pose) d(twist)/dt + h = J' (T + friction) + wrench (6,) [N m, N], the push from outside about P.

    Returns -1, or the leg that cannot span, and then the state is as it was; its margin.
    """
    robot, friction, params, legs, state = record(robot), record(friction), record(params), record(legs), record(state)
    step, jacobian, pushed = params.step, np.empty((6, 6)), np.empty((6, 7))
    bad = laws.legs_at(robot, state.pose[:], legs)
    if bad >= 0:
        return bad, legs.reach_margin[bad]
    _accelerated(robot, legs, state.twist[:], params.gravity, torque, wrench, jacobian, pushed)
    twist, pose = state.twist + step * pushed[:, 6], np.empty(6)
    if _has_friction(friction):
        friction_torque = np.empty(6)
        _friction_torque(friction, jacobian, pushed, step, state, twist, friction_torque)
        for k in range(6):
            for i in range(6):
                twist[k] += step * pushed[k, i] * friction_torque[i]
    _moved(legs.rotation[:], state.pose[3:], step * twist[:3], step * twist[3:], pose)
    bad = _arrive(robot, friction, legs, step, pose, twist, state)
    return bad, legs.reach_margin[max(bad, 0)]


@njit
def _has_friction(friction: Any) -> bool:
    return (friction.break_away > 0.0).any() or (friction.viscous > 0.0).any()


@njit
def _rk4(robot: Any, friction: Any, params: Any, legs: Any, torque: Any, wrench: Any, state: Any) -> Any:
    """`_semi_implicit` by Runge-Kutta of order 4, and by `FINER` steps where a motor with friction turns or sticks."""
    before, step, dry = state.copy(), record(params).step, (record(friction).break_away > 0.0).any()
    bad, margin = _rk4_step(robot, friction, params, legs, torque, wrench, step, state)
    if not dry or bad >= 0 or (before[0].crank_rate * state[0].crank_rate > 0.0).all():
        return bad, margin
    state[0] = before[0]
    for _ in range(FINER):
        bad, margin = _rk4_step(robot, friction, params, legs, torque, wrench, step / FINER, state)
        if bad >= 0:
            state[0] = before[0]
            break
    return bad, margin


@njit
def _rk4_step(
    robot: Any, friction: Any, params: Any, legs: Any, torque: Any, wrench: Any, step: float, state: Any
) -> Any:
    """A step of order 4 [s]: W. Kutta, Z. Math. Phys. 46 (1901) 435.

    A turn is integrated in the coordinates of `_turn`. Dry friction is that of a semi-implicit step, and constant.
    """
    robot, friction, params, legs, state = record(robot), record(friction), record(params), record(legs), record(state)
    jacobian, acceleration = np.empty((6, 6)), np.empty((6, 1))
    # Turn, shift and change of the twist since the step's beginning, their rates in a stage, and the mean of these.
    change, rate, mean = np.zeros(12), np.empty(12), np.zeros(12)
    given, twist, pose, start = torque.copy(), np.empty(6), state.pose.copy(), np.empty((3, 3))
    for stage in range(4):
        bad = laws.legs_at(robot, pose, legs)
        if bad >= 0:
            return bad, legs.reach_margin[bad]
        for k in range(6):
            twist[k] = state.twist[k] + change[6 + k]
        if stage == 0:
            start[:] = legs.rotation
            if _has_friction(friction):
                _hold_dry_friction(robot, friction, params, legs, wrench, step, state, given)
        with_viscous = given.copy()
        _add_viscous(friction, legs, twist, with_viscous)
        _accelerated(robot, legs, twist, params.gravity, with_viscous, wrench, jacobian, acceleration)
        _turn_rate(change[:3], twist[:3], rate[:3])
        for k in range(3):
            rate[3 + k] = twist[3 + k]
        for k in range(6):
            rate[6 + k] = acceleration[k, 0]
        share, ahead = (2.0 if 0 < stage < 3 else 1.0) / 6.0, 0.5 if stage < 2 else 1.0
        for k in range(12):
            mean[k] += share * rate[k]
            change[k] = step * (ahead * rate[k] if stage < 3 else mean[k])
        _moved(start, state.pose[3:], change[:3], change[3:6], pose)
    for k in range(6):
        twist[k] = state.twist[k] + change[6 + k]
    bad = _arrive(robot, friction, legs, step, pose, twist, state)
    return bad, legs.reach_margin[max(bad, 0)]


@njit
def _add_viscous(friction: Any, legs: Any, twist: Any, torque: Any) -> None:
    """Adds to torques (6,) the viscous friction at a twist (6,)."""
    for i in range(6):
        torque[i] -= (
            friction.viscous[i]
            * (laws.dot(legs.line[i, :3], twist[:3]) + laws.dot(legs.line[i, 3:], twist[3:]))
            / legs.lever[i]
        )


@njit
def motion_rate(
    robot: Any, friction: Any, gravity: float, legs: Any, motion: Any, torque: Any, wrench: Any, out: Any
) -> Any:
    """Time derivative (12,) of pose and rate (12,) in Euler angles, for other people's integrators.

    Of friction the viscous one counts. Returns leg and margin as `_semi_implicit`.
    """
    robot, friction, legs = record(robot), record(friction), record(legs)
    twist, given, jacobian, acceleration = np.empty(6), torque.copy(), np.empty((6, 6)), np.empty((6, 1))
    bad = laws.legs_at(robot, motion[:6], legs)
    if bad >= 0:
        return bad, legs.reach_margin[bad]
    laws.twist_of(motion[:6], motion[6:], twist)
    _add_viscous(friction, legs, twist, given)
    _accelerated(robot, legs, twist, gravity, given, wrench, jacobian, acceleration)
    laws.euler_drift(motion[:3], motion[6:], out[6:9])
    for k in range(6):
        out[k] = motion[6 + k]
        out[6 + k] = acceleration[k, 0] - (out[6 + k] if k < 3 else 0.0)
    laws.euler_rates(motion[:3], out[6:9], out[6:9])
    return -1, 0.0


@njit
def _hold_dry_friction(
    robot: Any, friction: Any, params: Any, legs: Any, wrench: Any, step: float, state: Any, torque: Any
) -> None:
    """Adds to torques (6,) the dry friction of a semi-implicit step: all of it less what is viscous at its end."""
    jacobian, pushed = np.empty((6, 6)), np.empty((6, 7))
    _accelerated(robot, legs, state.twist[:], params.gravity, torque, wrench, jacobian, pushed)
    twist, friction_torque = state.twist + step * pushed[:, 6], np.empty(6)
    _friction_torque(friction, jacobian, pushed, step, state, twist, friction_torque)
    for i in range(6):
        for k in range(6):
            twist[k] += step * pushed[k, i] * friction_torque[i]
    for i in range(6):
        rate = 0.0
        for k in range(6):
            rate += jacobian[i, k] * twist[k]
        torque[i] += friction_torque[i] + friction.viscous[i] * rate


@njit
def _turn(axis: Any, turn: Any, out: Any) -> None:
    """An axis (3,) after a turn (3,) [rad]: by 2 atan(|turn| / 2) about it, a step of a quaternion of length one."""
    half, inner, outer = 0.5 * turn, np.empty(3), np.empty(3)
    scale = 2.0 / (1.0 + half[0] * half[0] + half[1] * half[1] + half[2] * half[2])
    laws.cross(half, axis, inner)
    for k in range(3):
        inner[k] += axis[k]
    laws.cross(half, inner, outer)
    for k in range(3):
        out[k] = axis[k] + scale * outer[k]


@njit
def _turn_rate(turn: Any, omega: Any, out: Any) -> None:
    """Rate (3,) [rad/s] of a turn of `_turn`, after which the angular velocity in B is omega (3,) [rad/s]."""
    across, along = np.empty(3), 0.25 * laws.dot(turn, omega)
    laws.cross(omega, turn, across)
    for k in range(3):
        out[k] = omega[k] + 0.5 * across[k] + along * turn[k]
