"""The observer as a LeafSystem."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.systems.framework import InputPort, OutputPort

from stewart_drake.hardware.observer import Observer, ObserverOptions
from stewart_drake.hardware.observing import observer_part
from stewart_drake.systems.ticked import SampledSystem


class PlatformObserver(SampledSystem):
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
        measurement: out (12,), pose [rad, m] then pose rate [rad/s, m/s] now.
        ahead: out (12,), likewise when the command of this tick acts.
        compensation: out (6,) [N m], against what the model does not explain.
        innovation: out (6,) [rad], readings less what was expected.
    """

    reading: InputPort
    sent: InputPort
    measurement: OutputPort
    ahead: OutputPort
    compensation: OutputPort
    innovation: OutputPort

    def __init__(
        self,
        observer: Observer,
        initial: np.ndarray,
        reading: int = 6,
        compiled: bool = False,
        guarded: bool = False,
    ) -> None:
        outputs = {"measurement": 12, "ahead": 12, "compensation": 6, "innovation": 6}
        part = observer_part(observer, initial, reading, compiled)
        super().__init__(observer.period, part, {"reading": reading, "sent": 6}, outputs, guarded)


def add_observer(wiring: Any, options: ObserverOptions, reading: OutputPort) -> OutputPort:
    """Adds the observer to a closed loop, on readings of any sensor; the measurement (12,)."""
    scenario = wiring.scenario
    delay = scenario.command_delay if options.delay is None else options.delay
    noise = scenario.sensors.reading_noise
    observer = Observer(wiring.believed, options, scenario.gravity, wiring.period, noise)
    pose, rate = scenario.start()
    memory = observer.initial(pose, rate, wiring.still, delay)
    made = PlatformObserver(observer, memory, reading.size(), scenario.compiled, wiring.guarded)
    sent = wiring.last_command()
    added = wiring.add("estimator", made, reading=reading, sent=sent)
    now, ahead, compensation, innovation = wiring.parts("estimate", added, 12, 12, 6, 6)
    wiring.look_ahead(ahead, delay)
    wiring.compensations.append(compensation)
    wiring.signals["innovation"] = innovation
    return now
