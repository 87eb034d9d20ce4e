"""From logs to a robot: reads, fits, makes it one of bodies, and asks logs that were not used."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np

from stewart_drake.errors import ConfigurationError
from stewart_drake.identification.consistency import consistent
from stewart_drake.identification.estimate import ASKED, estimate
from stewart_drake.identification.identified import Identification, Prediction
from stewart_drake.identification.parameters import KINDS, Kind, of_robot
from stewart_drake.identification.recording import Recording, load_recording, of_log
from stewart_drake.identification.samples import Samples, samples_of, together
from stewart_drake.logs.log import SimulationLog
from stewart_drake.robot import RobotParameters

AnyLog = Recording | SimulationLog | str | Path


def identify(
    robot: RobotParameters,
    logs: Sequence[AnyLog],
    hold: Collection[Kind] = (),
    ask: Collection[Kind] = ASKED,
    validate: Sequence[AnyLog] = (),
    bandwidth: float | None = None,
    lag: float = 0.0,
) -> Identification:
    """Masses, inertias, friction and torque constants of a robot from logs of its motion.

    Args:
        robot: The guess: its geometry is taken as it is, its bodies where nothing else is told.
        logs: At least one: recordings, logs, or files of them, see `load_recording`.
        hold: Kinds that keep the guess's value; friction is none there, torque constants are 1.
        ask: Kinds that must be told.
        validate: Logs that are only predicted.
        bandwidth: [Hz] of the filter, see `samples_of`; None for one by the logs' rate.
        lag: [s] of torques in CSV files, see `Recording`.

    Raises:
        ConfigurationError: Nothing to read or free, an unknown kind; as `load_recording`, `samples_of` and `estimate`.
        InconsistentError: No bodies are near what the logs say.
    """
    for name, kinds in (("hold", hold), ("ask", ask)):
        for kind in kinds:
            if kind not in KINDS:
                raise ConfigurationError(name, kind, f"some of {', '.join(KINDS)}")
    if not logs:
        raise ConfigurationError("logs", "none", "at least one log")

    def read(log: AnyLog) -> Samples:
        if isinstance(log, SimulationLog):
            log = of_log(log, robot, f"log of {log.scenario.name}")
        own = log if isinstance(log, Recording) else load_recording(log, robot, lag)
        return samples_of(robot, own, bandwidth)

    parts = [read(log) for log in logs]
    samples, unseen = together(parts), [read(log) for log in validate]
    found = estimate(robot, samples, hold, ask)
    values = consistent(robot, found)
    predictions = tuple(_prediction(robot, each, values) for each in (*parts, *unseen))
    held = tuple(kind for kind in KINDS if kind in hold)
    return Identification(robot, values, found, held, samples, len(parts), predictions)


def _prediction(guess: RobotParameters, samples: Samples, values: np.ndarray) -> Prediction:
    def off(by: np.ndarray, rows: np.ndarray) -> float:
        error = (samples.torque - samples.predicted(by))[rows]
        return float(np.sqrt(np.mean(error**2) / np.mean(samples.torque[rows] ** 2))) if error.size else np.nan

    used, everywhere = samples.used, np.ones_like(samples.used)
    return Prediction(samples.source, off(of_robot(guess), used), off(values, used), off(values, everywhere))
