"""From a scenario to its loop: the ordered list of parts, and the signals between them.

The order is that in which signals run within a tick: sensors, the controller's side (`control_side`), delay, link,
safety layer, motors; at last the parts that act from the next tick on. This file does not know the kinds of sensors and
motors.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from stewart_drake.hardware.ball_sensor import ball_parts
from stewart_drake.hardware.disturbances import total_wrench
from stewart_drake.hardware.faults import faulty_sensor_part
from stewart_drake.hardware.imu import imu_parts
from stewart_drake.hardware.motors import delay_part
from stewart_drake.hardware.moving_base import base_signal
from stewart_drake.loop.part import NOTHING, Part
from stewart_drake.mechanics.kinematics import crank_rates, leg_geometry
from stewart_drake.scenario.control_side import Source, context_of, control_side
from stewart_drake.scenario.scenario import Scenario
from stewart_drake.scenario.small_parts import FINITE, scaled


class Loop(NamedTuple):
    """The loop of a scenario.

    The plant gives the signals `plant_pose` (12,), pose [rad, m] and rate, and `crank_state` (12,), angles [rad] and
    their rates.
    """

    parts: tuple[Part, ...]  # In order.
    sources: tuple[Source, ...]  # Of the controller's side; `wrench`, `base`.
    torque: str  # Name of the signal (6,) [N m] that the motors give the plant.
    logged: Mapping[str, str | np.ndarray]  # See `ControlSide.logged`.
    inputs: Mapping[str, np.ndarray] = NOTHING  # Signals from outside, with their first values.


def loop_of(scenario: Scenario, split: bool = False) -> Loop:
    """The loop of a scenario: sensors, the controller's side, and the path of its command to the motors.

    With `split` an LQI takes the compiled solution of its Riccati equation in any case. Raises as `control_side`.
    """
    sensors = sensor_parts(scenario)
    side = control_side(scenario, split, _reading_of(sensors), scenario.base.sensor is not None)
    outside, logged = _outside(scenario), dict(side.logged)
    names = {"wrench": "disturbance", "base_motion": "base_motion"}
    logged |= {names[source.signal]: source.signal for source in outside if source.signal in names}
    way = command_path(scenario, side.command, side.initial_command, side.context.period, side.safety)
    logged["torque_applied"] = "motor_torque"
    if scenario.ball is not None:
        logged["ball_reading"] = "ball_reading"
    if scenario.sensors.imu is not None:
        logged["imu"] = "imu"
    if side.safety is not None:
        logged["safety"] = "safety"
        if str(side.logged["reference"]) == "used_reference":
            logged["lost_encoder"] = "lost"
    of_base = scenario.base.sensor_parts(scenario.gravity_in_base, side.context.period, scenario.plant.time_step)
    parts = *sensors, *of_base, *side.parts, *way, *side.at_end
    return Loop(parts, (*side.sources, *outside), "motor_torque", logged)


def machine_side(scenario: Scenario) -> Loop:
    """All but the controller's side: from an input `command` (6,), which may change at any step, to the reading.

    Sensors run at the beginning of a step of the plant, what takes the command at its end.
    """
    sensors, step = sensor_parts(scenario), scenario.plant.time_step
    first = scenario.controller_model.motors.initial_command(context_of(scenario, split=True))
    way = [part._replace(end_of_tick=True) for part in command_path(scenario, "command", first, step)]
    reading = {"reading": _reading_of(sensors)}
    if scenario.sensors.imu is not None:
        reading["imu"] = "imu"
    return Loop((*sensors, *way), _outside(scenario), "motor_torque", reading, {"command": first})


def _outside(scenario: Scenario) -> tuple[Source, ...]:
    """External wrenches, forces on a ball; and the motion of the base, `base` in the middle of a step of the plant."""
    pushes, base, sources = scenario.disturbances, scenario.base, list[Source]()
    if (ball := scenario.ball) is not None:
        step = scenario.plant.time_step
        sources.append(Source("ball_push", 2, lambda times: ball.thrown(times, step)))
    if pushes:
        sources.append(Source("wrench", 6, lambda times: total_wrench(pushes, times)))
    if (motion := base.motion) is not None:
        gravity, half = scenario.gravity_in_base, 0.5 * scenario.plant.time_step
        sources.append(Source("base", 9, lambda times: base_signal(motion, gravity, times + half)[:, :9]))
        sources.append(Source("base_motion", 12, lambda times: base_signal(motion, gravity, times)))
    return tuple(sources)


def sensor_parts(scenario: Scenario) -> list[Part]:
    """Parts that compute `reading`, none if it is the pose of the plant, and `imu` and `ball_reading`, if there are."""
    imu, parts, gravity = scenario.sensors.imu, _reading_parts(scenario), scenario.gravity_in_base
    step = scenario.plant.time_step
    if imu is not None:
        first = {"plant_pose": np.concatenate(scenario.start())}
        if (motion := scenario.base.motion) is not None:
            first["base_motion"] = base_signal(motion, gravity, np.zeros(1))[0]
        parts += imu_parts(imu, gravity, step, scenario.reading_period, first)
    return parts if scenario.ball is None else [*parts, *ball_parts(scenario.ball, scenario.controller.period, step)]


def _reading_of(sensors: list[Part]) -> str:
    """Name of the signal that is the reading."""
    given = {part.signal(output) for part in sensors for output in part.outputs}
    return "reading" if "reading" in given else "plant_pose"


def _reading_parts(scenario: Scenario) -> list[Part]:
    period, step = scenario.reading_period, scenario.plant.time_step
    parts = [part._replace(period=period) for part in scenario.sensors.parts(period)]
    gain = servo_gain_error(scenario)
    if scenario.sensors.reading == "angles" and (gain != 1.0).any():
        parts = [
            part.named(reading="servo_reading")
            if "reading" in part.outputs and part.signal("reading") == "reading"
            else part
            for part in parts
        ]
        parts.append(scaled(1.0 / gain, "servo_reading", "reading")._replace(period=period))
    if (steps := round(scenario.sensors.delay / step)) == 0:
        return parts
    pose, rate = scenario.start()
    legs = leg_geometry(scenario.robot, pose)
    cranks = legs.crank_angles, crank_rates(scenario.robot, legs, pose, rate)
    true = {"plant_pose": np.concatenate([pose, rate]), "crank_state": np.concatenate(cranks)}
    read = {str(part.source(port)) for part in parts for port in part.inputs} if parts else {"plant_pose"}
    late = {source: f"late_{source}" if parts else "reading" for source in true if source in read}
    delays = [
        delay_part(steps, true[source], f"{source}_delay")
        ._replace(period=step)
        .connected(value=source)
        .named(value=name)
        for source, name in late.items()
    ]
    ports = [{port: str(part.source(port)) for port in part.inputs} for part in parts]
    moved = [{port: late[source] for port, source in inputs.items() if source in late} for inputs in ports]
    return [*delays, *(part.connected(**inputs) for part, inputs in zip(parts, moved, strict=True))]


def servo_gain_error(scenario: Scenario) -> np.ndarray:
    """(6,) [-] angles of the cranks over those that the controller's side commands and reads.

    Commands and readings on that side are corrected by the model's gains; the servos have the simulated robot's.
    """
    return np.asarray(scenario.robot.servo_gains / scenario.controller_model.robot.servo_gains)


def _delayed(parts: list[Part], command: str, steps: int, first: np.ndarray, name: str, period: float) -> str:
    """Adds a delay of a number of steps of a period [s]; the name of the delayed signal."""
    delay = delay_part(steps, first, name)._replace(period=period)
    parts.append(delay.connected(value=command).named(value=name))
    return name


def command_path(
    scenario: Scenario, command: str, first: np.ndarray, period: float, safety: Part | None = None, bus: bool = True
) -> list[Part]:
    """Delay, link, safety layer and motors: from the signal `command` (6,), new in every period [s], to `motor_torque`.

    Until the first command arrives it is `first` (6,). Without `bus` there are the motors alone, with their dead time.
    """
    parts: list[Part] = []
    tick, step, age = scenario.controller.period, scenario.plant.time_step, dict[str, str]()
    late = scenario.command_delay * tick / period if bus else 0.0
    if round(late) > 0:
        command = _delayed(parts, command, round(late), first, "command_delay", period)
    if bus and not scenario.link.perfect:
        parts.append(scenario.link.part(tick, step, first).connected(torque=command).named(torque="arrived"))
        command, age = "arrived", {"age": "age"}
    if safety is not None:
        parts.append(safety.connected(command=command, **age))
        command = "safe_torque"
    elif scenario.controller.code is not None or scenario.link.faults:
        # Motors would cut an infinite torque to one that looks valid. The package's controllers never give one.
        finite = FINITE._replace(constants={"what": scenario.motors.command_quantity}, period=step)
        parts.append(finite.connected(command=command))
        command = "checked"
    if (dead := round(scenario.motors.dead_time / step)) > 0:
        command = _delayed(parts, command, dead, first, "motor_delay", step)
    gain = servo_gain_error(scenario)
    if scenario.motors.holds and (gain != 1.0).any():
        parts.append(scaled(gain, command, "turned_command")._replace(period=step))
        command = "turned_command"
    motors = scenario.motors.part(scenario.robot, step).connected(command=command).named(torque="motor_torque")
    if faults := [fault for fault in scenario.sensors.faults if getattr(fault, "in_servo", False)]:
        # Angles (6,) alone, not their rates.
        of_legs = [f.replace(leg=leg) for f in faults for leg in (range(6) if f.leg is None else (f.leg,))]
        sensor = faulty_sensor_part(of_legs, 12, step)._replace(name="servo_sensors", period=step)
        parts.append(sensor.connected(reading="crank_state").named(reading="servo_state"))
        motors = motors.connected(crank_state="servo_state")
    return [*parts, motors]
