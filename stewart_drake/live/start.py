"""A live session with its page and its view."""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from stewart_drake.errors import RunFailure
from stewart_drake.live.loop import LiveLoop
from stewart_drake.live.server import LiveServer
from stewart_drake.live.session import CONTROLLERS, LiveSession
from stewart_drake.live.steering import nearest_allowed
from stewart_drake.runs.replay import RobotView
from stewart_drake.scenario import Scenario

_FARTHEST = np.array([1.0, 1.0, 1.0, 0.5, 0.5, 0.5])


def start_live(scenario: Scenario) -> tuple[LiveSession, LiveServer]:
    """A session to `run`, and its server to `close`."""
    view = RobotView(scenario.robot)
    # Compiled here, none of the panel's controllers makes the robot wait.
    warm = LiveLoop(scenario)
    for changes in CONTROLLERS.values():
        warm.change(changes)
        warm.advance(2)

    def show(loop: LiveLoop) -> None:
        # A robot that falls may be where its rods just no longer span; the picture then stays.
        with suppress(RunFailure):
            view.show(loop.time, view.stewart.assemble(loop.pose), loop.wanted)

    session = LiveSession(scenario, show)
    robot = scenario.robot
    about = {
        "name": scenario.name,
        "meshcat": view.meshcat.web_url(),
        "home": session.loop.reference.home.tolist(),
        "room": _room(scenario, session.loop.reference.home).tolist(),
        "payload": scenario.plant.payload_mass,
        "payload_most": max(float(f"{0.5 * robot.platform_mass:.1g}"), scenario.plant.payload_mass),
        "encoders": scenario.sensors.reading_size == 6,
        "kappa": getattr(scenario.tuner, "kappa", None),
        "setting": session.loop.logged("setting") is not None,
        "controllers": list(CONTROLLERS),
    }
    return session, LiveServer(session, about)


def _room(scenario: Scenario, home: np.ndarray) -> np.ndarray:
    """(6,) [rad, m] how far each axis alone can go from a pose, in its freer direction."""
    room = np.zeros(6)
    for axis in range(6):
        for sign in (1.0, -1.0):
            wanted = home.copy()
            wanted[axis] += sign * _FARTHEST[axis]
            end = nearest_allowed(
                scenario.robot, scenario.limits, home, wanted, scenario.gravity, np.zeros((1, 6))
            ).pose
            room[axis] = max(room[axis], abs(end[axis] - home[axis]))
    return room
