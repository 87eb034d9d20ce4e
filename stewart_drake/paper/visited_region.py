"""The workspace that the paper means: the states and torques that motions under its controller visit."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from stewart_drake.errors import ConfigurationError
from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.motion_envelope import MotionEnvelope, motion_envelope
from stewart_drake.mechanics.dynamics import inverse_dynamics
from stewart_drake.paper.study import Study
from stewart_drake.planning.feasibility import largest_amplitude, largest_scale
from stewart_drake.planning.measures import measure_poses
from stewart_drake.planning.workspace import LIMIT_NAMES, governing_limit, utilisation
from stewart_drake.plotting.panels import COORDINATES
from stewart_drake.references import SineReference, paper_reference
from stewart_drake.robot.robot_scale import LENGTH
from stewart_drake.runs.simulation import check_scenario
from stewart_drake.scenario import Scenario
from stewart_drake.training.collect import six

AMPLITUDE_SHARE = 0.5
"""Of the largest feasible amplitude, for motions of our own: the controller's lag must have room."""
ONE_HERTZ = 2.0 * np.pi
SIX_FREQUENCIES = (1.6, 2.2, 1.8, 2.6, 1.4, 2.0)
"""[rad/s] of the motion on all axes at once, around the paper's 2."""
SIX_AMPLITUDES = (0.35, 0.35, 0.35, 0.06, 0.06, 0.05)
"""[rad, m] from which that motion is scaled to what is feasible; lengths are for the paper's robot."""

LARGE_SPREAD = 1.5
"""[-] factor between the largest torques of runs, beyond which the region is the motion's own."""


def controlled_motions(study: Study) -> dict[str, Scenario]:
    """The runs to look at by name; first the base scenario's own motion, the paper's unless the user changes it.

    The others differ in what the paper leaves out of its model (gravity), in the axis, and in the speed. What this
    robot cannot do is left out.
    """
    base = study.base
    robot, limits = base.robot, base.limits
    whole_period = {"duration": min(base.duration, study.pick(10.0, 3.2))}
    short = {"duration": min(base.duration, study.pick(5.0, 1.5))}
    model = {"gravity": 0.0, "controller.feedforward": "none", "tuner.kind": "fixed"}
    weights = {"tuner.omega_q": 1.0, "tuner.omega_r": 1.0}
    own = "the paper's motion" if base.reference == paper_reference() else "the scenario's motion"
    motions = {
        own: base.replace(whole_period),
        "the same without gravity, weights 1/1": base.replace(whole_period | model | weights),
    }
    for axis in study.pick((1, 2, 3, 4), (4,)):
        largest = largest_amplitude(robot, limits, axis, 1.0, base.gravity)
        reference = _sine(base, AMPLITUDE_SHARE * largest * np.eye(6)[axis], np.full(6, ONE_HERTZ))
        motions[f"{COORDINATES[axis][0]} at 1 Hz"] = base.replace(short | {"reference": dataclasses.asdict(reference)})

    def all_axes(scale: float) -> SineReference:
        return _sine(base, scale * np.array(LENGTH.value(SIX_AMPLITUDES, robot)), np.array(SIX_FREQUENCIES))

    scale = largest_scale(robot, limits, all_axes, short["duration"], base.gravity)
    motions["all six axes"] = base.replace(short | {"reference": dataclasses.asdict(all_axes(AMPLITUDE_SHARE * scale))})
    return {name: motion for name, motion in motions.items() if _can_be_run(motion)}


def _can_be_run(scenario: Scenario) -> bool:
    try:
        check_scenario(scenario)
    except ConfigurationError:
        return False
    return True


def _sine(base: Scenario, amplitude: np.ndarray, angular_frequency: np.ndarray) -> SineReference:
    return SineReference(
        center=six(base.robot.home_pose), amplitude=six(amplitude), angular_frequency=six(angular_frequency)
    )


@dataclass(frozen=True, eq=False)
class VisitedRegion:
    """What one run visited.

    Attributes:
        name: Of the run.
        log: The run.
        envelope: The box around it.
        use: Utilisation (n,) of each limit at its poses, at rest.
        worst: [-] largest part of a limit that a visited pose takes up, and the limit.
        reference_worst: The same of its reference's poses.
        peak_torque: [N m] largest of any motor, within its limit.
        reference_torque: [N m] largest that the reference itself asks for, by the exact inverse dynamics.
    """

    name: str
    log: SimulationLog
    envelope: MotionEnvelope
    use: dict[str, np.ndarray]
    worst: tuple[float, str]
    reference_worst: tuple[float, str]
    peak_torque: float
    reference_torque: float

    @property
    def torque_use(self) -> float:
        """[-] part of the motors' torque."""
        return self.peak_torque / self.log.scenario.robot.effort_limit

    @property
    def far(self) -> np.ndarray:
        """(6,) [rad, m] largest distance of each coordinate from the motion's centre."""
        scenario = self.log.scenario
        middle = np.array(getattr(scenario.reference, "center", scenario.robot.home_pose))
        return np.abs(self.envelope.pose - middle).max(axis=0)

    @property
    def speed(self) -> float:
        """[rad/s] largest of any crank."""
        return float(np.abs(self.envelope.crank_rate).max())

    @property
    def power(self) -> float:
        """[W] largest of any motor, either way."""
        return float(np.abs(self.envelope.power).max())


def _worst(of: dict[str, np.ndarray]) -> tuple[float, str]:
    use, cause = governing_limit(of)
    at = int(use.argmax())
    return float(use[at]), LIMIT_NAMES[cause[at]]


def visited_region(name: str, log: SimulationLog) -> VisitedRegion:
    """What one run visited, up to where it ended."""
    scenario = log.scenario
    robot, limits, gravity = scenario.robot, scenario.limits, scenario.gravity
    uses = [
        utilisation(robot, limits, pose, measure_poses(robot, pose, gravity))
        for pose in (log["pose"], log["reference"])
    ]
    motion = (log["reference"], log["reference_rate"], log["reference_acceleration"])
    wanted = inverse_dynamics(robot, *motion, gravity)
    peaks = (float(np.abs(torque).max()) for torque in (log["torque_applied"], wanted))
    worst, reference_worst = map(_worst, uses)
    return VisitedRegion(name, log, motion_envelope(log), uses[0], worst, reference_worst, *peaks)


def findings(regions: Sequence[VisitedRegion], runs: int) -> dict[str, Any]:
    """What the verdict on the claim rests on, that the method defines the workspace of states and torques.

    Args:
        regions: Of the runs that left a log, the scenario's own motion first.
        runs: All that were tried.
    """
    done = [region for region in regions if region.log.reached_end]
    return {
        "regions": regions,
        "runs": runs,
        "done": done,
        "reasons": sorted({str(region.log.reason) for region in regions if not region.log.reached_end}),
        "outside": [region.name for region in done if region.worst[0] > 1.0],
        "large_spread": LARGE_SPREAD,
    }
