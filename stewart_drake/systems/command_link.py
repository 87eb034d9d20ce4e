"""The way of a command to the motors."""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import Context

from stewart_drake.hardware.command_link import LinkOptions, command_link
from stewart_drake.systems.ticked import TickedSystem


class CommandLink(TickedSystem):
    """Passes a controller's commands on, or loses, delays and spoils them, see `command_link.link_step`.

    It runs at every step of the plant, so that a late command may arrive between two ticks.

    Args:
        options: See `LinkOptions`.
        time_step: [s] of the plant.
        steps_per_tick: Steps of the plant in a control period.
        initial: (6,) [N m] command before the first one arrives.

    Ports:
        torque: in (6,) [N m], the controller's.
        arrived: out (6,) [N m], the newest command that has arrived.
        age: out (1,) [ticks] of that command; 0 where it is that of the present tick.
    """

    def __init__(self, options: LinkOptions, time_step: float, steps_per_tick: int, initial: np.ndarray) -> None:
        first, self._tick = command_link(options, steps_per_tick, initial)
        super().__init__(time_step, first)
        self.torque = self.DeclareVectorInputPort("torque", 6)
        self._declare_result()
        self.arrived = self._declare_output("arrived", 0, 6)
        self.age = self._declare_output("age", 6, 1)

    def tick(self, context: Context, previous: np.ndarray) -> np.ndarray:
        """See `command_link.link_step`."""
        time = context.get_time()
        return self._tick(self.torque.Eval(context), time, round(time / self.period), previous)
