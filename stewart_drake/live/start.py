"""A live session with its page."""

from __future__ import annotations

import logging

import numpy as np

from stewart_drake.live.ball import about_ball
from stewart_drake.live.instrument import FORCE, largest
from stewart_drake.live.loop import LiveLoop
from stewart_drake.live.machine_session import MachineSession
from stewart_drake.live.server import LiveServer
from stewart_drake.live.session import CONTROLLERS, LiveSession, PageRow
from stewart_drake.live.steering import REACH, nearest_allowed
from stewart_drake.machines.machine import Machine
from stewart_drake.mechanics.ball import BallOptions
from stewart_drake.runs.drive import Start
from stewart_drake.runs.scene import robot_scene
from stewart_drake.scenario.scenario import Scenario


def start_live(scenario: Scenario, port: int | None = None) -> tuple[LiveSession, LiveServer]:
    """A session to `run` and a server to `close`; `port` of this computer, None for the first free one."""
    # Compiles all controllers of the panel, so that none makes the robot wait.
    warm, log = LiveLoop(scenario), logging.getLogger("stewart_drake")
    level = log.level
    log.setLevel(logging.ERROR)  # Nobody chose these kinds, so the keys that they drop are of no interest.
    for changes in CONTROLLERS.values():
        warm.change(changes)
        # To the controller's next tick.
        warm.advance(round(warm.scenario.controller.period / warm.scenario.plant.time_step) + 1)
    log.setLevel(level)

    session = LiveSession(scenario)
    about = about_robot(scenario, session.loop.reference.home, ghost=True, ball=scenario.ball)
    about |= {"session": session.name, "instrument": True, "ball": about_ball(scenario)}
    return session, LiveServer(session, about, port)


def about_robot(scenario: Scenario, home: np.ndarray, ghost: bool = False, ball: BallOptions | None = None) -> PageRow:
    """Description of a robot for the page, with a ball where its rows have one; sliders begin at `home` (6,)."""
    robot = scenario.robot
    return {
        "name": scenario.name,
        "scene": robot_scene(robot, ghost, ball, scenario.ball_control is not None),
        "home": home.tolist(),
        "room": _room(scenario, home).tolist(),
        "payload_most": max(float(f"{0.5 * robot.platform_mass:.1g}"), scenario.plant.payload_mass),
        "test_sizes": [0.01] * 3 + [0.01 * robot.characteristic_length] * 3,
        "effort_limits": robot.effort_limits.tolist(),
        "force_most": largest(robot, scenario.gravity_in_base, FORCE),
        "encoders": scenario.sensors.reading == "angles",
        "may_fail": "dead" in scenario.motors.to_dict(),
        "on_base": any(scenario.base.orientation) or scenario.base.motion is not None,
        "controllers": list(CONTROLLERS),
    }


def start_machine(
    scenario: Scenario, machine: Machine, start: Start, url: str, port: int | None = None
) -> tuple[MachineSession, LiveServer]:
    """Session and server for a connected machine that the page steers."""
    session = MachineSession(scenario, machine, start)
    about = about_robot(session.scenario, session.home, ghost=True)
    about |= {"session": session.name, "machine": url, "controllers": []}
    return session, LiveServer(session, about, port)


def _room(scenario: Scenario, home: np.ndarray) -> np.ndarray:
    """(6,) [rad, m] largest feasible distance along one axis from a pose, in either direction."""
    room = np.zeros(6)
    for axis in range(6):
        for sign in (1.0, -1.0):
            target = home.copy()
            target[axis] += sign * REACH[axis]
            setup = scenario.robot, scenario.limits, home, target, scenario.gravity_in_base
            reached = nearest_allowed(*setup, np.zeros((1, 6))).pose
            room[axis] = max(room[axis], abs(reached[axis] - home[axis]))
    return room
