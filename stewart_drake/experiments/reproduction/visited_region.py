"""The workspace that the paper means: the states and torques that motions under its controller visit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stewart_drake.experiments.reproduction.study import Study
from stewart_drake.feasibility import largest_amplitude, largest_scale
from stewart_drake.limits import limit_bounds
from stewart_drake.log import AXES, SimulationLog
from stewart_drake.motion_envelope import MotionEnvelope, motion_envelope
from stewart_drake.references import SineReference
from stewart_drake.rigid_body_model import inverse_dynamics
from stewart_drake.scenario import Scenario
from stewart_drake.workspace import measure_poses
from stewart_drake.workspace_region import LIMIT_NAMES, governing_limit, utilisation

AMPLITUDE_SHARE = 0.5
"""Of the largest feasible amplitude, for motions of our own: the controller's lag must have room."""
ONE_HERTZ = 2.0 * math.pi
SIX_AXES = (0.8, 1.1, 0.9, 1.3, 0.7, 1.0)
"""[-] angular frequencies of the motion on all axes at once, as parts of that of the paper."""


def controlled_motions(study: Study) -> dict[str, Scenario]:
    """The runs to look at by name: the base scenario's own motion first, which is the paper's unless the user changes it.

    The others differ in what the paper leaves out of its model (gravity), in the axis, and in the speed.
    """
    base = study.base
    short = {"duration": min(base.duration, study.pick(5.0, 1.5))}
    model = {"gravity": 0.0, "controller.feedforward": "none", "tuner.kind": "fixed"}
    weights = {"tuner.omega_q": 1.0, "tuner.omega_r": 1.0}
    motions = {
        "the paper's motion": base.replace({"duration": min(base.duration, study.pick(10.0, 1.5))}),
        "the same without gravity, weights 1/1": base.replace(short | model | weights),
    }
    for axis in study.pick((1, 2, 3, 4), (4,)):
        largest = largest_amplitude(base.robot, base.limits, axis, 1.0, base.gravity)
        amplitude = AMPLITUDE_SHARE * largest * np.eye(6)[axis]
        motions[f"{_named(axis)} at 1 Hz"] = base.replace(short | _sine(base, amplitude, np.full(6, ONE_HERTZ)))
    frequency = 2.0 * np.array(SIX_AXES)
    whole = np.array([0.35, 0.35, 0.35, 0.06, 0.06, 0.05])

    def reference(scale: float) -> SineReference:
        sine = _sine(base, scale * whole, frequency)["reference"]
        return SineReference(**{k: tuple(v) if isinstance(v, list) else v for k, v in sine.items()})

    scale = largest_scale(base.robot, base.limits, reference, short["duration"], base.gravity)
    motions["all six axes"] = base.replace(short | _sine(base, AMPLITUDE_SHARE * scale * whole, frequency))
    return motions


def _named(axis: int) -> str:
    return AXES[axis] if axis < 3 else AXES[axis].upper()


def _sine(base: Scenario, amplitude: np.ndarray, angular_frequency: np.ndarray) -> dict[str, dict[str, object]]:
    return {
        "reference": {
            "kind": "sine",
            "center": base.robot.home_pose.tolist(),
            "amplitude": amplitude.tolist(),
            "angular_frequency": angular_frequency.tolist(),
        }
    }


@dataclass(frozen=True, eq=False)
class VisitedRegion:
    """What one run visited.

    Attributes:
        name: Of the run.
        log: The run.
        envelope: The box around it.
        use: Utilisation (n,) of each limit at its poses, at rest.
        peak_torque: [N m] largest of any motor, within its limit.
        reference_torque: [N m] largest that the reference itself asks for, by the exact inverse dynamics.
    """

    name: str
    log: SimulationLog
    envelope: MotionEnvelope
    use: dict[str, np.ndarray]
    peak_torque: float
    reference_torque: float

    @property
    def torque_use(self) -> float:
        """[-] part of the motors' torque."""
        return self.peak_torque / self.log.scenario.robot.effort_limit

    @property
    def speed(self) -> float:
        """[rad/s] largest of any crank."""
        return float(np.abs(self.envelope.crank_rate).max())

    @property
    def power(self) -> float:
        """[W] largest of any motor, either way."""
        return float(np.abs(self.envelope.power).max())

    @property
    def worst(self) -> tuple[float, str]:
        """[-] largest part of a limit that a visited pose takes up, and the limit."""
        use, cause = governing_limit(self.use)
        at = int(use.argmax())
        return float(use[at]), LIMIT_NAMES[cause[at]]


def visited_region(name: str, log: SimulationLog) -> VisitedRegion:
    """What one run visited, up to where it ended."""
    scenario = log.scenario
    limit = limit_bounds(scenario.robot, scenario.limits).get("torque")
    measures = measure_poses(scenario.robot, log["pose"], scenario.gravity, limit)
    motion = (log["reference"], log["reference_rate"], log["reference_acceleration"])
    wanted = inverse_dynamics(scenario.robot, *motion, scenario.gravity)
    return VisitedRegion(
        name,
        log,
        motion_envelope(log),
        utilisation(scenario.robot, scenario.limits, log["pose"], measures),
        float(np.abs(log["torque_applied"]).max()),
        float(np.abs(wanted).max()),
    )


def region_verdict(regions: Sequence[VisitedRegion]) -> str:
    """What came of the claim that the method defines the workspace of states and torques."""
    done = [region for region in regions if region.log.status == "completed"]
    if not done:
        return f"Does not hold: none of the {len(regions)} controlled motions came to its end."
    peaks = [region.peak_torque for region in done]
    use, limit = regions[0].worst
    ended = f"{len(done)} of {len(regions)} controlled motions came to their end"
    bounded = (
        f"{ended}; each fills a bounded region of states and torques (up to {max(peaks):.2f} N m, "
        f"{100.0 * max(r.torque_use for r in done):.0f} % of the motors' limit)"
    )
    own = (
        f"The paper's own motion takes up at most {100.0 * use:.0f} % of a limit ({limit.replace('_', ' ')}) and "
        f"{100.0 * regions[0].torque_use:.0f} % of the torque."
    )
    spread = max(peaks) / min(peaks) if min(peaks) > 0.0 else math.inf
    outside = [region.name for region in done if region.worst[0] > 1.0]
    if outside:
        own += f" Visited poses broke a limit in: {', '.join(outside)}."
    if spread < 1.5:
        return f"Holds: {bounded}, and the torques hardly depend on the motion (factor {spread:.2f}). {own}"
    return (
        f"Holds in part: {bounded}. But the region belongs to the motion, not to the method: the largest torque differs "
        f"by a factor of {spread:.3g} between them. {own}"
    )
