"""Pose and rate of the platform from the motor encoders."""

from __future__ import annotations

import contextlib
from typing import Any

import numpy as np
from pydrake.systems.framework import Context, OutputPort

from stewart_drake.errors import UnreachablePoseError
from stewart_drake.hardware.estimator import EncoderOptions, flat_estimate, initial_memory
from stewart_drake.hardware.observer import DifferenceOptions
from stewart_drake.mechanics.kinematics import crank_rates, leg_geometry
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
        compiled: See `Scenario.compiled`.
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


def add_difference(wiring: Any, options: DifferenceOptions, reading: OutputPort) -> OutputPort:  # noqa: ARG001
    """Adds what makes a measurement (12,) of the angles (6,) of encoders; a pose and its rate are one already."""
    if reading.size() == 12:
        return reading
    scenario = wiring.scenario
    start, rates = scenario.start()[0], _starting_crank_rates(wiring.believed, *scenario.start())
    made = (wiring.believed, scenario.sensors, wiring.period, start, rates, scenario.compiled, wiring.guarded)
    estimator = wiring.add("estimator", PoseEstimator(*made), angles=reading)
    return wiring.parts("estimate", estimator, 12)[0]


def _starting_crank_rates(robot: RobotParameters, pose: np.ndarray, pose_rate: np.ndarray) -> np.ndarray:
    """Crank rates (6,) [rad/s] of the robot, as believed, at a pose; zeros where it cannot stand there."""
    # In that case the first tick says so, with a log.
    with contextlib.suppress(UnreachablePoseError), np.errstate(all="ignore"):
        rates = crank_rates(robot, leg_geometry(robot, pose), pose, pose_rate)
        if np.isfinite(rates).all():
            return rates
    return np.zeros(6)
