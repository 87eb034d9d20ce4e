"""Pose and rate of the platform from the motor encoders."""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import Context

from stewart_drake.hardware.estimator import EncoderOptions, flat_estimate, initial_memory
from stewart_drake.robot import RobotParameters
from stewart_drake.systems.ticked import TickedSystem


class PoseEstimator(TickedSystem):
    """Forward kinematics of the encoder readings, and their differences; answers within the tick.

    Args:
        robot: As the controller believes it to be.
        options: See `EncoderOptions`.
        period: [s] tick period.
        start: (6,) [rad, m] roughly where the platform stands at first; picks the assembly mode.
        start_crank_rates: (6,) [rad/s] that the first tick reports, with no reading before it; None for rest.
        compiled: See `LqiOptions.compiled`.
        guarded: See `TickedSystem`.

    Ports:
        angles: in (6,) [rad].
        measurement: out (12,), pose [rad, m] then pose rate [rad/s, m/s] (Euler rates).
    """

    def __init__(
        self,
        robot: RobotParameters,
        options: EncoderOptions,
        period: float,
        start: np.ndarray,
        start_crank_rates: np.ndarray | None = None,
        compiled: bool = False,
        guarded: bool = False,
    ) -> None:
        super().__init__(period, initial_memory(start, start_crank_rates), guarded)
        self._estimate = flat_estimate(robot, options, period, compiled)
        self.angles = self.DeclareVectorInputPort("angles", 6)
        self._declare_result()
        self.measurement = self._declare_output("measurement", 0, 12)

    def tick(self, context: Context, previous: np.ndarray) -> np.ndarray:
        """See `estimator.held_estimate`."""
        return self._estimate(self.angles.Eval(context), previous)
