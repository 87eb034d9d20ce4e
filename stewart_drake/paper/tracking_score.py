"""How well a run follows its reference, as one number that ranks controllers and the parts that it is made of; pure."""

from __future__ import annotations

from dataclasses import dataclass

from stewart_drake.errors import ConfigurationError
from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.metrics import run_metrics
from stewart_drake.scenario import Scenario


@dataclass(frozen=True)
class TrackingScore:
    """Errors over the second half of a run that reached its end.

    Attributes:
        pose_mm: [mm] RMS of the pose error, rotations times the robot's characteristic length (0.11 m by default, the
            radius of the platform): about what a joint of the platform is off. Ranks controllers.
        rotation_deg: [deg] RMS length of (roll, pitch, yaw) errors alone.
        position_mm: [mm] RMS length of the position error alone.
        torque_rms: [N m] RMS torque of all motors, over the same time.
    """

    pose_mm: float
    rotation_deg: float
    position_mm: float
    torque_rms: float


def tracking_score(log: SimulationLog) -> TrackingScore | None:
    """The score of a run; None where it ended early, for then there is no second half to speak of."""
    if not log.reached_end:
        return None
    metrics = run_metrics(log)
    names = ("pose_rmse_mm", "rmse_norm_deg", "rmse_norm_mm", "torque_rms_second_half")
    return TrackingScore(*(metrics[name] for name in names))


def refusal(scenario: Scenario) -> str | None:
    """Why a scenario cannot be run, such as a reference beyond the robot's limits; None where it can."""
    from stewart_drake.runs.simulation import check_scenario

    try:
        check_scenario(scenario)
    except ConfigurationError as error:
        return str(error)
    return None
