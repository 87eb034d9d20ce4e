"""The observer as a LeafSystem."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from pydrake.systems.framework import Context, OutputPort

from stewart_drake.hardware.estimator import EncoderOptions, estimate, initial_memory
from stewart_drake.hardware.observer import Observer, ObserverOptions, flat_observer
from stewart_drake.mechanics.kinematics import inverse_kinematics
from stewart_drake.systems.ticked import TickedSystem


class PlatformObserver(TickedSystem):
    """State of the platform from readings and the commands that were sent, see `hardware.observer`.

    Args:
        observer: Robot as believed, options, period.
        initial: Memory before the first tick, see `Observer.initial`.
        reading: Entries of a reading: 6 angles of the cranks [rad], or 12 of pose [rad, m] and its rate.
        compiled: See `Scenario.compiled`.
        guarded: See `TickedSystem`.

    Ports:
        reading: in (6,) or (12,).
        sent: in (6,) [N m], the command of the tick before less what friction takes of it.
        reference: in (18,), pose [rad, m], pose rate [rad/s, m/s], pose acceleration [rad/s^2, m/s^2].
        measurement: out (12,), pose [rad, m] then pose rate [rad/s, m/s] now.
        ahead: out (12,), likewise when the command of this tick acts.
        compensation: out (6,) [N m], against what the model does not explain.
        innovation: out (6,) [rad], readings less what was expected.
    """

    def __init__(
        self,
        observer: Observer,
        initial: np.ndarray,
        reading: int = 6,
        compiled: bool = False,
        guarded: bool = False,
    ) -> None:
        super().__init__(observer.period, initial, guarded)
        self._robot, self._poses = observer.robot, reading == 12
        self._observe = flat_observer(observer, _first_pose(observer), compiled)
        self.reading = self.DeclareVectorInputPort("reading", reading)
        self.sent = self.DeclareVectorInputPort("sent", 6)
        self.reference = self.DeclareVectorInputPort("reference", 18)
        self._declare_result()
        self.measurement = self._declare_output("measurement", 0, 12)
        self.ahead = self._declare_output("ahead", 12, 12)
        self.compensation = self._declare_output("compensation", 24, 6)
        self.innovation = self._declare_output("innovation", 30, 6)

    def tick(self, context: Context, previous: np.ndarray) -> np.ndarray:
        """See `observer.observe`."""
        reading = self.reading.Eval(context)
        if self._poses:
            finite = np.isfinite(reading[:6]).all()
            reading = inverse_kinematics(self._robot, reading[:6]) if finite else np.full(6, np.nan)
        return self._observe(reading, self.sent.Eval(context), self.reference.Eval(context), previous)


def _first_pose(observer: Observer) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """What finds the pose of the first readings, near a guess."""

    def found(angles: np.ndarray, guess: np.ndarray) -> np.ndarray:
        options = EncoderOptions()
        return estimate(observer.robot, options, observer.period, angles, initial_memory(guess))[:6]

    return found


def add_observer(wiring: Any, options: ObserverOptions, reading: OutputPort) -> OutputPort:
    """Adds the observer to a closed loop, on readings of any sensor; the measurement (12,)."""
    scenario = wiring.scenario
    delay = scenario.command_delay if options.delay is None else options.delay
    noise = scenario.sensors.reading_noise
    friction = scenario.friction_compensation
    sticks = friction is not None and friction.dry
    observer = Observer(wiring.believed, options, scenario.gravity, wiring.period, noise, sticks)
    pose, rate = scenario.start()
    memory = observer.initial(pose, rate, wiring.standing_torque(), delay)
    made = PlatformObserver(observer, memory, reading.size(), scenario.compiled, wiring.guarded)
    sent = wiring.last_command()
    added = wiring.add("estimator", made, reading=reading, sent=sent, reference=wiring.signals["reference"])
    now, ahead, compensation, innovation = wiring.parts("estimate", added, 12, 12, 6, 6)
    wiring.look_ahead(ahead, delay)
    wiring.compensations.append(compensation)
    wiring.signals["innovation"] = innovation
    return now
