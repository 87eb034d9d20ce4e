"""The paper's LQI as a LeafSystem."""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import Context

from stewart_drake.control_law import LqiOptions, Measurement, Setpoint, lqi_tick
from stewart_drake.robot import RobotParameters
from stewart_drake.systems.ticked import TickedSystem


class LqiController(TickedSystem):
    """Linear quadratic integral regulator, (19)-(34): a new gain at every tick, from that tick's pose and weights.

    The torque answers within the tick (no added delay) and is held until the next; see `TickedSystem`. z lives in the
    Context.

    Ports:
        measurement: in (12,), pose [rad, m], pose rate [rad/s, m/s].
        reference: in (18,), pose, pose rate, pose acceleration.
        weights: in (2,), omega_Q, omega_R, > 0.
        torque: out (6,) [N m], not limited.
        error: out (6,) [rad, m], pose minus reference at the tick.
        integral: out (6,) [rad s, m s], z after the tick.
    """

    def __init__(self, robot: RobotParameters, options: LqiOptions, gravity: float) -> None:
        super().__init__(options.period, np.zeros(18))
        self._robot, self._options, self._gravity = robot, options, gravity
        self.measurement = self.DeclareVectorInputPort("measurement", 12)
        self.reference = self.DeclareVectorInputPort("reference", 18)
        self.weights = self.DeclareVectorInputPort("weights", 2)
        self._declare_result()
        self.torque = self._declare_output("torque", 0, 6)
        self.error = self._declare_output("error", 6, 6)
        self.integral = self._declare_output("integral", 12, 6)

    def tick(self, context: Context, previous: np.ndarray) -> np.ndarray:
        """See `control_law.lqi_tick`."""
        measured, wanted = self.measurement.Eval(context), self.reference.Eval(context)
        output = lqi_tick(
            self._robot,
            self._options,
            self._gravity,
            Measurement(measured[:6], measured[6:]),
            Setpoint(wanted[:6], wanted[6:12], wanted[12:]),
            self.weights.Eval(context),
            previous[12:],
        )
        return np.concatenate(output)
