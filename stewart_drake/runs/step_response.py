"""Step response of the nonlinear loop: a run that starts at an offset from a constant reference."""

from __future__ import annotations

from pathlib import Path

from stewart_drake.analysis.response import StepResponse, step_figures
from stewart_drake.base.errors import ConfigurationError, RunFailure
from stewart_drake.base.tables import COORDINATES
from stewart_drake.logs.outcomes import describe_outcome
from stewart_drake.runs.simulation import run
from stewart_drake.scenario.scenario import Scenario, load_scenario

_DEFAULT_SIZE = 0.01  # [rad], or times the characteristic length.


def step(scenario: Scenario | str | Path, axis: str = "Z", size: float | None = None) -> StepResponse:
    """Response of a scenario's nonlinear loop to a step of the reference.

    Args:
        scenario: A scenario, its file or its name; the step ends at the pose of its motion at t = 0.
        axis: roll, pitch, yaw, X, Y or Z.
        size: [rad] or [m] of the step; None takes 0.01 rad, or a hundredth of the characteristic length.

    Raises:
        ConfigurationError: No such axis, a size of 0, or a pose that cannot be reached.
        RunFailure: The run was not completed.
    """
    if axis not in COORDINATES:
        raise ConfigurationError("axis", axis, f"one of {', '.join(COORDINATES)}")
    if not isinstance(scenario, Scenario):
        scenario = load_scenario(scenario)
    number, offset = COORDINATES.index(axis), [0.0] * 6
    if size is None:
        size = _DEFAULT_SIZE * (1.0 if number < 3 else scenario.robot.characteristic_length)
    if size == 0.0:
        raise ConfigurationError("size", size, "a number other than 0")
    offset[number] = -size
    pose = scenario.start()[0].tolist()
    log = run(scenario.replace({"reference": {"kind": "hold", "pose": pose}, "initial_offset": offset}))
    if log.status != "completed":
        outcome = describe_outcome(log.status, log.reason, log.outcome_time)
        raise RunFailure(f"{outcome}: such a run has no step response", reason="step")
    return step_figures(log.time, 1.0 + (log["pose"][:, number] - log["reference"][:, number]) / size)
