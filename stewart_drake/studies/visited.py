"""States and torques that typical motions visit under a scenario's controller, and their share of the limits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, TypedDict

import numpy as np

from stewart_drake.analysis.feasibility import largest_amplitude, largest_scale
from stewart_drake.analysis.workspace import LIMIT_NAMES, governing_limit, utilisation
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.tables import COORDINATES
from stewart_drake.logs.log import SimulationLog
from stewart_drake.mechanics.dynamics import inverse_dynamics
from stewart_drake.mechanics.kinematics import pose_jacobian, reach_margin
from stewart_drake.plotting.style import chart
from stewart_drake.references import SineReference, paper_reference
from stewart_drake.robot.robot_scale import LENGTH
from stewart_drake.runs.checks import check_scenario
from stewart_drake.runs.simulation import run
from stewart_drake.scenario.limits import measure_poses
from stewart_drake.scenario.scenario import Scenario
from stewart_drake.studies.workers import Workers, run_all

if TYPE_CHECKING:
    from matplotlib.figure import Figure

AMPLITUDE_SHARE = 0.5  # Share of the largest feasible amplitude; the rest is for the controller's lag.
SIX_FREQUENCIES = (1.6, 2.2, 1.8, 2.6, 1.4, 2.0)  # [rad/s]
SIX_AMPLITUDES = (0.35, 0.35, 0.35, 0.06, 0.06, 0.05)  # [rad, m] before scaling; lengths for the paper's robot.


def controlled_motions(base: Scenario, quick: bool = False) -> dict[str, Scenario]:
    """Name -> run, the base scenario's motion first, without motions that the robot cannot do."""
    of_robot = base.robot, base.limits
    short = {"duration": min(base.duration, 1.5 if quick else 5.0)}
    whole = {"duration": min(base.duration, 3.2 if quick else 10.0)}
    without = {"gravity": 0.0, "controller.feedforward": "none", "tuner": {"kind": "fixed"}}
    first = "the paper's motion" if base.reference == paper_reference() else "the scenario's motion"

    def sine_of(amplitude: np.ndarray, omega: Sequence[float]) -> SineReference:
        keys = {"center": base.robot.home_pose, "amplitude": amplitude, "angular_frequency": omega}
        return SineReference.from_dict(keys)

    def all_axes(scale: float) -> SineReference:
        return sine_of(scale * np.array(LENGTH.value(SIX_AMPLITUDES, base.robot)), SIX_FREQUENCIES)

    references = {}
    for axis in (4,) if quick else (1, 2, 3, 4):
        size = AMPLITUDE_SHARE * largest_amplitude(*of_robot, axis, 1.0, base.gravity_in_base)
        references[f"{COORDINATES[axis]} at 1 Hz"] = sine_of(size * np.eye(6)[axis], [2.0 * np.pi] * 6)
    scale = AMPLITUDE_SHARE * largest_scale(*of_robot, all_axes, short["duration"], base.gravity_in_base)
    references["all six axes"] = all_axes(scale)
    motions = {first: base.replace(whole), "the same without gravity, weights 1/1": base.replace(whole | without)}
    motions |= {
        name: base.replace(short | {"reference": reference.to_dict()}) for name, reference in references.items()
    }
    return {name: scenario for name, scenario in motions.items() if _is_feasible(scenario)}


def _is_feasible(scenario: Scenario) -> bool:
    try:
        check_scenario(scenario)
    except ConfigurationError:
        return False
    return True


class Visited(TypedDict):
    """Extremes of a run."""

    status: str
    pose: list[list[float]]  # [rad, m] lowest and highest.
    crank_speed: float  # [rad/s]
    peak_torque: float  # [N m]
    reference_torque: float  # [N m] of the reference, by the nominal model.
    peak_power: float  # [W]
    limit_use: float | None  # [-] largest share of a limit on poses at rest; None beyond reach.
    limit: str
    reference_limit_use: float | None  # [-]


def visited(log: SimulationLog) -> Visited:
    """Extremes of states and torques in a run, and its largest share of the limits on poses at rest."""
    scenario, robot = log.scenario, log.scenario.robot
    rates = np.full_like(log["pose"], np.nan)
    within = reach_margin(robot, log["pose"]).min(axis=-1) > 0.0
    rates[within] = np.einsum("nij,nj->ni", pose_jacobian(robot, log["pose"][within]), log["pose_rate"][within])
    motion = (log["reference"], log["reference_rate"], log["reference_acceleration"])
    torque, needed = log["torque_applied"], inverse_dynamics(robot, *motion, scenario.gravity_in_base)

    def worst(pose: np.ndarray) -> tuple[float | None, str]:
        measures = measure_poses(robot, pose, scenario.gravity_in_base)
        use, cause = governing_limit(utilisation(robot, scenario.limits, pose, measures))
        row = int(use.argmax())
        return float(use[row]) if np.isfinite(use[row]) else None, LIMIT_NAMES[cause[row]]

    use, limit = worst(log["pose"])
    return {
        "status": log.status,
        "pose": [log["pose"].min(axis=0).tolist(), log["pose"].max(axis=0).tolist()],
        "crank_speed": float(np.nanmax(np.abs(rates))),
        "peak_torque": float(np.abs(torque).max()),
        "reference_torque": float(np.abs(needed).max()),
        "peak_power": float(np.nanmax(np.abs(torque * rates))),
        "limit_use": use,
        "limit": limit,
        "reference_limit_use": worst(log["reference"])[0],
    }


def motion_numbers(
    base: Scenario,
    quick: bool = False,
    workers: Workers | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> tuple[dict[str, Visited], Callable[[], Figure]]:
    """Motion -> `visited`, and a function that draws the torques; `progress` gets the finished share."""
    motions = controlled_motions(base, quick)
    done = run_all(run, [(motion,) for motion in motions.values()], workers, lambda n: progress(n / len(motions)))
    logs = {name: log for name, log in zip(motions, done, strict=True) if len(log.time)}
    curves = {name: (log.time, np.abs(log["torque_applied"]).max(axis=1)) for name, log in logs.items()}
    draw = partial(chart, "Largest torque of a motor", "time [s]", "[N m]", curves)
    return {name: visited(log) for name, log in logs.items()}, draw
