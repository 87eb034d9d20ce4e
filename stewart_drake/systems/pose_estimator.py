"""Pose and rate of the platform from the motor encoders."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.systems.framework import InputPort, OutputPort

from stewart_drake.hardware.estimator import EncoderOptions, flat_estimate, initial_memory, starting_crank_rates
from stewart_drake.hardware.observer import DifferenceOptions
from stewart_drake.robot import RobotParameters
from stewart_drake.sampling import Sampled
from stewart_drake.systems.ticked import SampledSystem


class PoseEstimator(SampledSystem):
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

    angles: InputPort
    measurement: OutputPort

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
        tick = flat_estimate(robot, options, period, compiled)
        part = Sampled(initial_memory(start, start_crank_rates), tick)
        super().__init__(period, part, {"angles": 6}, {"measurement": 12}, guarded)


def add_difference(wiring: Any, options: DifferenceOptions, reading: OutputPort) -> OutputPort:  # noqa: ARG001
    """Adds what makes a measurement (12,) of the angles (6,) of encoders; a pose and its rate are one already."""
    if reading.size() == 12:
        return reading
    scenario = wiring.scenario
    start, rates = scenario.start()[0], starting_crank_rates(wiring.believed, *scenario.start())
    made = (wiring.believed, scenario.sensors, wiring.period, start, rates, scenario.compiled, wiring.guarded)
    estimator = wiring.add("estimator", PoseEstimator(*made), angles=reading)
    return wiring.parts("estimate", estimator, 12)[0]
