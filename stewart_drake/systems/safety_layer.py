"""The safety layer."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.systems.framework import Context

from stewart_drake.robot import RobotParameters
from stewart_drake.safety import MEMORY_SIZE, SafetyMemory, SafetyOptions, first_trip, safety_part
from stewart_drake.sampling import WELL
from stewart_drake.systems.ticked import TickedSystem


class SafetyLayer(TickedSystem):
    """Watches commands and measurements, and passes on what may go to the motors; answers within the tick.

    Any controller with a torque port runs behind it: the ports age and health may be left alone.

    Args: As of `safety.safety_part`.

    Ports:
        command: in (6,) [N m], the controller's.
        measurement: in (12,), pose [rad, m], pose rate [rad/s, m/s].
        reference: in (18,), pose [rad, m], pose rate [rad/s, m/s], pose acceleration [rad/s^2, m/s^2].
        age: in (1,) [ticks] of the command; may be left unconnected.
        sensor_health, controller_health: in (2,), what was wrong in the last tick and where, see `TickedSystem`; may be
            left unconnected.
        angles: in (6,) [rad], readings of the encoders; may be left unconnected.
        innovation: in (6,) [rad], of an observer; may be left unconnected.
        pose_reading: in (12,), what a sensor of the pose says, where an observer stands behind it; may be left
            unconnected.
        torque: out (6,) [N m], for the motors.
        state: out (3,): number of the level in `safety.LEVELS`, of the monitor in `safety.MONITORS`, leg or -1.
    """

    def __init__(
        self,
        robot: RobotParameters,
        options: SafetyOptions,
        gravity: float,
        period: float,
        initial: np.ndarray,
        compiled: bool = False,
        quantum: float = 0.0,
        surprise_scale: tuple[float, float] = (0.0, 1.0),
    ) -> None:
        first, self._tick = safety_part(robot, options, gravity, period, initial, compiled, quantum, surprise_scale)
        super().__init__(period, first)
        self._options, self._nominal = options, period
        self.command = self.DeclareVectorInputPort("command", 6)
        self.measurement = self.DeclareVectorInputPort("measurement", 12)
        self.reference = self.DeclareVectorInputPort("reference", 18)
        self.age = self.DeclareVectorInputPort("age", 1)
        self.sensor_health = self.DeclareVectorInputPort("sensor_health", 2)
        self.controller_health = self.DeclareVectorInputPort("controller_health", 2)
        self.angles = self.DeclareVectorInputPort("angles", 6)
        self.innovation = self.DeclareVectorInputPort("innovation", 6)
        self.pose_reading = self.DeclareVectorInputPort("pose_reading", 12)
        self._declare_result()
        self.torque = self._declare_output("torque", 0, 6)
        self.state = self._declare_output("state", 6, 3)

    def tick(self, context: Context, previous: np.ndarray) -> np.ndarray:
        """See `safety.safety_tick`."""
        age = self.age.Eval(context)[0] if self.age.HasValue(context) else 0.0
        sensor, controller = (
            tuple(port.Eval(context)) if port.HasValue(context) else WELL
            for port in (self.sensor_health, self.controller_health)
        )
        angles = self.angles.Eval(context) if self.angles.HasValue(context) else None
        innovation = self.innovation.Eval(context) if self.innovation.HasValue(context) else None
        pose = self.pose_reading.Eval(context)[:6] if self.pose_reading.HasValue(context) else None
        seen = (port.Eval(context) for port in (self.command, self.measurement, self.reference))
        return self._tick(*seen, float(age), sensor, controller, angles, innovation, pose, previous)

    def first_trip(self, context: Context) -> dict[str, Any] | None:
        """See `safety.first_trip`; `context` is that of the whole Diagram.

        The last tick of a run is told too: it has been asked for (by a log), though nothing has stored it.
        """
        mine = self.GetMyContextFromRoot(context)
        asked = not self.get_output_port(self.result.get_index()).cache_entry().is_out_of_date(mine)
        values = self.result.Eval(mine) if asked else mine.get_discrete_state(0).value()
        return first_trip(SafetyMemory.from_flat(values[:MEMORY_SIZE]), self._nominal, self._options.monitor_names)
