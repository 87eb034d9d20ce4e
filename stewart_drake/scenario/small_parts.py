"""Small parts between those of the kinds: sums, gains of servos, and a check of commands."""

from __future__ import annotations

import numpy as np

from stewart_drake.base.errors import NotFiniteError
from stewart_drake.base.jit import njit
from stewart_drake.base.records import Record, Vec6, record
from stewart_drake.loop.part import Part


class _Torque(Record):
    torque: Vec6  # [N m]


class _NetTorque(Record):
    net_torque: Vec6  # [N m]


class _Checked(Record):
    checked: Vec6


class _Scaled(Record):
    scaled: Vec6  # [rad]


@njit
def _scale(gain: Vec6, angle: Vec6, state: _Scaled) -> None:
    scaled = record(state).scaled
    for i in range(6):
        scaled[i] = gain[i] * angle[i]


def scaled(gain: np.ndarray, angle: str, scaled: str) -> Part:
    """The signal `scaled` (6,) [rad]: gains times the signal `angle`."""
    part = Part(
        f"servo_gain_of_{angle}", _scale, {}, {"angle": 6}, ("scaled",), _Scaled.new(), parameters={"gain": gain}
    )
    return part.connected(angle=angle).named(scaled=scaled)


@njit
def _add_torques(control: Vec6, disturbance_torque: Vec6, friction: Vec6, state: _Torque) -> None:
    torque = record(state).torque
    for i in range(6):
        torque[i] = control[i] + disturbance_torque[i] + friction[i]


COMMAND = Part(
    "command",
    _add_torques,
    {},
    {"control_torque": 6, "disturbance_torque": 6, "friction_torque": 6},
    ("torque",),
    _Torque.new(),
)
"""The commanded torque: of the controller, against an observed disturbance, and against friction."""


@njit
def _store_net_torque(limit: Vec6, torque: Vec6, friction: Vec6, state: _NetTorque) -> None:
    net_torque = record(state).net_torque
    for i in range(6):
        net_torque[i] = min(max(torque[i], -limit[i]), limit[i]) - friction[i]


def net_torque_part(limit: np.ndarray, initial: np.ndarray) -> Part:
    """The command of a tick less its part against friction, for the observer at the next tick.

    The motors cut it at their limit, or the safety layer does, which has to see it.
    """
    first, inputs = _NetTorque.new(net_torque=initial), {"torque": 6, "friction_torque": 6}
    part = Part("net_torque", _store_net_torque, {}, inputs, ("net_torque",), first, end_of_tick=True)
    return part._replace(parameters={"limit": limit})


def _finite_tick(what: str, command: Vec6, state: _Checked) -> None:
    if not np.isfinite(command).all():
        raise NotFiniteError(what, command.copy())
    state["checked"][0] = command


FINITE = Part("finite", _finite_tick, {"what": "torque"}, {"command": 6}, ("checked",), _Checked.new())
"""Ends a run with commands, `what` of the motors, that are not finite, where there is no safety layer."""
