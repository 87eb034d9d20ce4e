"""A loop for slow buses: PID of each motor through the robot's inertia, and inverse dynamics along the reference.

    T = Y(reference ahead) + M (omega^2 (e + integral_frequency z) + 2 damping omega e') + stuck sign(rate)

with e = theta(reference) - theta(reading) now, z its integral, and M = (J M^-1 J')^-1 the inertia as the cranks feel
it, at the reference. Nothing but the reading itself is fed back, neither a model's rate nor its disturbance: at 100 Hz
with a tick of delay what a wrong model says comes too late to be mended.

A crank that sticks tells nobody how much friction holds it. Its torque then grows with the way that the reference has
gone on without it, until it breaks away; the less so, the better its friction is known by an adaptive law.
"""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import numpy as np

from stewart_drake.base.config import NotNegative, Period, Positive
from stewart_drake.base.jit import fields, new_record, njit, record
from stewart_drake.control.base import (
    AT_REFERENCE,
    STATUSES,
    ControllerOptions,
    limit_and_integrate,
    measured_legs,
    saturation_params,
)
from stewart_drake.loop.part import LoopContext, Part
from stewart_drake.mechanics.dynamics_laws import motion_torque, task_inertia
from stewart_drake.mechanics.kinematics_laws import (
    LEGS,
    OK,
    PARALLEL,
    UNREACHABLE,
    crank_jacobian,
    crank_rates,
    legs_at,
    robot_record,
    twist_of,
)
from stewart_drake.mechanics.linear_algebra import solve

MOVED, PASSED = 1.5, 3.0
"""[counts] of the encoders beyond which a crank has moved; that the reference must have passed it."""
SLOW = 1e-4  # [rad/s] a crank that is to turn more slowly is to rest.
FADES = 0.3  # [s] time constant with which a torque against sticking fades once the crank has broken away.


class DecoupledPidOptions(ControllerOptions):
    """PID of each motor through the robot's inertia, and inverse dynamics along the reference; for slow buses.

    The reference of the feedforward is that of the time at which the command acts. Commands are limited, and the
    integral of a motor at its limit stops growing.
    """

    looks_ahead: ClassVar[bool] = True
    saturation: ClassVar[str] = "clamp"

    kind: Literal["decoupled_pid"] = "decoupled_pid"
    period: Period = 0.01
    natural_frequency: Positive = 20.0
    """[rad/s] omega. With a tick of delay at 100 Hz, Reachy Mini's head swings ever more at 10."""
    damping: Positive = 0.8
    """[-] damping ratio."""
    integral_frequency: NotNegative = 3.0
    """[rad/s] of the integral action."""
    sticking: NotNegative = 4.0
    """[N m/rad] torque for the way that the reference goes on while a crank sticks; 0 for none."""
    dead_band: NotNegative = 2.5
    """[counts] of the encoders. A crank that is to rest and is less far off is right; its integral stays."""

    def parts(self, context: LoopContext) -> tuple[Part, ...]:
        count = max(context.noise * np.sqrt(12.0), 1e-4)
        params = new_record(
            _PARAMS, self, gravity=context.gravity, count=count, fade=np.exp(-self.period / FADES),
            **saturation_params(self, context.robot),
        )  # fmt: skip
        numbers = {"robot": robot_record(context.robot), "doubt": np.ones(6), "params": params}
        inputs, legs = {"measurement": 12, "reference": 18, "reference_now": 18}, (LEGS, LEGS, LEGS)
        part = Part("controller", decoupled_tick, {}, inputs, ("torque",), new_record(_STATE), legs, STATUSES)
        return (part._replace(parameters=numbers),)


_PARAMS = fields(
    period=(), gravity=(), natural_frequency=(), damping=(), integral_frequency=(), sticking=(), dead_band=(), count=(),
    fade=(), limit=6, clamp=(), back_share=(),
)  # fmt: skip
"""count: [rad] of an encoder. fade: share of a torque against sticking that a tick leaves. The last three: see
`saturation_params`."""
_STATE = fields(torque=6, health=2, error=6, integral=6, against=6, anchor=6, passed=6, turning=6, wanted=6, ticks=())
"""torque [N m]. error, integral: of the cranks [rad, rad s]. against: torque that grows while a crank sticks [N m].
anchor: angle of a crank when it last moved, passed: of the reference then, turning: the sign of its rate, wanted: its
angle at the tick before [rad]. ticks: done."""


@njit
def decoupled_tick(
    robot: Any, doubt: Any, params: Any, measurement: Any, reference: Any, reference_now: Any, legs: Any,
    target_legs: Any, ahead_legs: Any, state: Any,
) -> Any:  # fmt: skip
    """A tick; status, leg or -1, margin as of `pid_tick`."""
    robot, params, state = record(robot), record(params), record(state)
    legs, target, ahead = record(legs), record(target_legs), record(ahead_legs)
    status, leg, margin = measured_legs(robot, measurement, legs)
    if status != OK:
        return status, leg, margin
    bad = legs_at(robot, reference_now[:6], target)
    if bad >= 0:
        return AT_REFERENCE + UNREACHABLE, bad, target.reach_margin[bad]
    bad = legs_at(robot, reference[:6], ahead)
    if bad >= 0:
        return AT_REFERENCE + UNREACHABLE, bad, ahead.reach_margin[bad]
    feedforward, inertia = np.zeros(6), np.empty((6, 6))
    if not motion_torque(robot, ahead, reference[:12], reference[12:], params.gravity, feedforward):
        return AT_REFERENCE + PARALLEL, -1, 0.0
    jacobian, twist, rates = np.empty((6, 6)), np.empty(6), np.empty(6)
    twist_of(reference_now[:6], reference_now[6:12], twist)
    crank_rates(target, twist, rates)
    omega, h, push = params.natural_frequency, params.period, np.empty((6, 1))
    counted = np.empty(6)
    for i in range(6):
        sine = target.sine[i] * legs.cosine[i] - target.cosine[i] * legs.sine[i]
        error = np.arctan2(sine, legs.cosine[i] * target.cosine[i] + legs.sine[i] * target.sine[i])
        change = (error - state.error[i]) / h if state.ticks > 0.0 else 0.0
        state.error[i] = error
        push[i, 0] = omega * (omega * (error + params.integral_frequency * state.integral[i]))
        push[i, 0] += 2.0 * params.damping * omega * change
        rests = abs(rates[i]) < SLOW and abs(error) < params.dead_band * params.count
        counted[i] = 0.0 if rests else error
        angle = np.arctan2(legs.sine[i], legs.cosine[i])
        _stick(params, doubt[i], i, angle, angle + error, rates[i], state)
    # (J M^-1 J')^-1 push = J'^-1 M J^-1 push.
    crank_jacobian(target, jacobian)
    task_inertia(robot, target, inertia)
    transposed = np.ascontiguousarray(jacobian.T)
    if solve(jacobian, push) == 0.0:
        return AT_REFERENCE + PARALLEL, -1, 0.0
    wrench = inertia @ push
    solve(transposed, wrench)
    wanted = np.empty(6)
    for i in range(6):
        wanted[i] = feedforward[i] + wrench[i, 0] + state.against[i] * state.turning[i]
    state.ticks += 1.0
    # Only back-calculation would use the gain; any matrix stands for it.
    return limit_and_integrate(params, wanted, counted, inertia, True, state.torque[:], state.integral[:])


@njit
def _stick(params: Any, doubt: float, leg: int, angle: float, wanted: float, rate: float, state: Any) -> None:
    """Whether a crank sticks while its reference goes on, and the torque against that."""
    turning = 0.0 if abs(rate) < SLOW else np.sign(rate)
    way = wanted - state.wanted[leg] if state.ticks > 0.0 else 0.0
    state.wanted[leg] = wanted
    moved = abs(angle - state.anchor[leg]) > MOVED * params.count
    if moved or turning != state.turning[leg] or state.ticks == 0.0:
        state.anchor[leg], state.passed[leg] = angle, wanted
    if turning != state.turning[leg]:
        state.against[leg] = 0.0
    state.turning[leg] = turning
    if (wanted - state.passed[leg]) * turning > PASSED * params.count:
        state.against[leg] += doubt * params.sticking * abs(way)
    else:
        state.against[leg] *= params.fade
