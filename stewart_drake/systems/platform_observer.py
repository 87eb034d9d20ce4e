"""The observer as a LeafSystem."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.systems.framework import InputPort, OutputPort

from stewart_drake.hardware.observer import Observer, ObserverOptions
from stewart_drake.hardware.observing import observer_at, observer_part
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
        reference: in (18,), pose [rad, m], pose rate [rad/s, m/s], pose acceleration [rad/s^2, m/s^2].
        disturbance: in (1,) [rad/s^2 per sqrt(s)] to expect, see `ObserverOptions`.
        measurement: out (12,), pose [rad, m] then pose rate [rad/s, m/s] now.
        ahead: out (12,), likewise when the command of this tick acts.
        compensation: out (6,) [N m], against what the model does not explain.
        innovation: out (6,) [rad], readings less what was expected.
    """

    reading: InputPort
    sent: InputPort
    reference: InputPort
    disturbance: InputPort
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
        inputs = {"reading": reading, "sent": 6, "reference": 18, "disturbance": 1}
        outputs = {"measurement": 12, "ahead": 12, "compensation": 6, "innovation": 6}
        part = observer_part(observer, initial, reading, compiled)
        super().__init__(observer.period, part, inputs, outputs, guarded)


def add_observer(wiring: Any, options: ObserverOptions, reading: OutputPort) -> OutputPort:
    """Adds the observer to a closed loop, on readings of any sensor; the measurement (12,)."""
    made = observer_at(options, wiring.site, wiring.scenario.sensors)
    observer = PlatformObserver(*made[:2], reading.size(), wiring.site.compiled, wiring.guarded)
    sent = wiring.last_command()
    added = wiring.add("estimator", observer, reading=reading, sent=sent, reference=wiring.signals["reference"])
    now, ahead, compensation, innovation = wiring.parts("estimate", added, 12, 12, 6, 6)
    wiring.expecting = added.disturbance
    wiring.look_ahead(ahead, made.ahead)
    wiring.compensations.append(compensation)
    wiring.signals["innovation"], wiring.surprise_scale = innovation, made.observer.surprise_scale
    if reading.size() == 12:
        wiring.pose_reading = reading
    return now
