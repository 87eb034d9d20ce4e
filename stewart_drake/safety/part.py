"""The safety layer as a part of a loop, with a user's monitors; the stop and the first trip in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from stewart_drake.base.atomic_files import Document
from stewart_drake.base.errors import FAILURES, SafetyStop
from stewart_drake.base.records import Vec2, Vec6
from stewart_drake.loop.part import LoopContext, Part
from stewart_drake.mechanics.friction import Friction
from stewart_drake.mechanics.kinematics_laws import Legs, Robot, robot_record
from stewart_drake.safety.actuators import ActuatorState
from stewart_drake.safety.layer import BLIND, HOLD_OVER, RUNAWAY, safety_tick
from stewart_drake.safety.limits import SUSPECT_HOLD, Observed, SafetyParams, safety_params
from stewart_drake.safety.lost_encoder import reaction
from stewart_drake.safety.options import (
    INERTIAL_WRONG,
    MEANINGS,
    MONITORS,
    NO_TRIP,
    PARITY,
    SafetyInputs,
    SafetyOptions,
)
from stewart_drake.safety.residual import ResidualState
from stewart_drake.safety.state import END, LEVELS, NONE, NOT_THERE, RAMP, SafetyState, SafetyStatus


def safety_part(options: SafetyOptions, context: LoopContext) -> Part:
    """The safety layer; ports for which a loop may have no signal read `NOT_THERE`.

    Where the very first command is bad, that for `context.initial_torque` is held.
    """
    robot, period, torque = context.robot, context.period, context.initial_torque
    params = safety_params(robot, options, context.gravity, period, context.noise, context)
    params["goes_on"] = reaction(options, context) != "stop"
    command = context.motors.initial_command(context)
    first = SafetyState.new(
        torque=command,
        good=command,
        rest=command,
        weight=torque,
        command=command,
        safety=SafetyStatus.new(level=NONE, monitor=NO_TRIP, leg=-1.0),
        actuators=ActuatorState.new(torque=torque, cranks=np.nan, sent=command),
        residual=ResidualState.new(angles=np.nan, poses=np.nan, sent_torques=torque),
        lost=-1.0,
    )
    kernel: Any = safety_tick
    numbers = {"robot": robot_record(robot), "friction": context.friction.record(), "friction_unknown": Friction.new()}
    constants: dict[str, object] = {"user_trip": np.zeros(2)}
    if options.monitors:
        kernel, constants = _safety_tick_with_monitors, {**constants, "options": options}
    inputs = {"command": 6, "measurement": 12, "reference": 18}
    inputs |= {name: len(value) for name, value in NOT_THERE.items()}
    error = partial(_stopped, options, period)
    part = Part("safety", kernel, constants, inputs, ("torque", "safety", "lost"), first, (Legs, Observed), error=error)
    return part._replace(connections=NOT_THERE, parameters={**numbers, "gain": context.motors.gains, "params": params})


def later(layer: Part, ticks: int) -> Part:
    """The layer for a loop in which its commands arrive ticks later than in the model of the motors."""
    params = layer.parameters["params"].copy()
    params["actuators"]["late"] += ticks
    return layer._replace(parameters={**layer.parameters, "params": params})


def _safety_tick_with_monitors(
    robot: Robot,
    friction: Friction,
    friction_unknown: Friction,
    gain: Vec6,
    params: SafetyParams,
    user_trip: Vec2,
    options: SafetyOptions,
    *arguments: Any,
) -> tuple[int, float]:
    """`safety_tick` with the first of a user's monitors that trips, if any."""
    command, measured, wanted, age, sensor, controller, *_ = arguments
    user_trip[:] = 0.0
    if np.isfinite(measured).all():
        health = tuple(sensor), tuple(controller)
        inputs = SafetyInputs(command, measured[:6], measured[6:], wanted[:6], float(age[0]), *health)
        trip = options.first_user_trip(inputs)
        user_trip[:] = user_trip if trip is None else trip
    return safety_tick(robot, friction, friction_unknown, gain, params, user_trip, *arguments)


def _stopped(options: SafetyOptions, period: float, result: Any, arguments: Mapping[str, Any]) -> SafetyStop:
    (status, fastest), state = result, arguments["state"]
    names, status_now = options.monitor_names, state["safety"][0]
    name, leg = names[int(status_now["monitor"])], status_now["leg"]
    goes_on = state["lost"][0, 0] >= 0.0
    longest = SUSPECT_HOLD if state["residual"]["suspect"].any() and not goes_on else np.inf
    by = " on five encoders and the inertial sensor" if goes_on else ""
    what = {
        BLIND: "stopped: no measurement to hold the robot by",
        RUNAWAY: f"stopping, but a crank turns at {fastest:.3g} rad/s",
        HOLD_OVER: f"stopped, and held{by} for {min(longest, options.safe_hold_time):g} s",
    }[status]
    meaning = INERTIAL_WRONG if name == MONITORS[PARITY] and leg < 0.0 else MEANINGS.get(name)
    text = "; ".join(filter(None, (meaning, what)))
    if status != HOLD_OVER:
        state["safety"]["level"] = state["worst"] = END
    return SafetyStop(name, f"{name}: {text}", int(leg) if leg >= 0.0 else None, first_trip(state, period, names))


def first_trip(state: np.ndarray, period: float, names: Sequence[str] = MONITORS) -> Document | None:
    """The first trip by the layer's state after ticks of a period [s]; None where no monitor tripped.

    monitor, level, time [s], leg, cause of the first trip; worst, the highest level; last, the level now; stopped, the
    trip after which the controller no longer was in charge, or None.
    """
    now: np.ndarray = state[0]
    monitor, level, leg, tick, cause = now["first"].item()
    if monitor == 0.0:
        return None

    def trip(monitor: float, tick: float, leg: float) -> Document:
        time = round(float(tick) * period, 9)
        return {"monitor": names[int(monitor)], "time": time, "leg": int(leg) if leg >= 0.0 else None}

    last, by, at = now["safety"].item()
    return {
        **trip(monitor, tick, leg),
        "level": LEVELS[int(level)],
        "cause": FAILURES[int(cause) - 1] if cause > 0.0 else None,
        "worst": LEVELS[int(now["worst"])],
        "last": LEVELS[int(last)],
        "stopped": trip(by, now["ticks"] - now["stop_ticks"], at) if last >= RAMP else None,
    }
