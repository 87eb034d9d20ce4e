"""Abstract and section IV: states and torques of motions under the controller."""

from __future__ import annotations

import numpy as np

from stewart_drake.paper.reproduce import Claim, Reproduction, Result
from stewart_drake.studies.visited import motion_numbers
from stewart_drake.studies.workers import Workers

LARGE_SPREAD = 1.5  # [-] Ratio of the peak torques of motions above which the region depends on the motion.


def reproduce(study: Reproduction) -> Result:
    motions, draw = motion_numbers(study.base, study.quick, Workers(study.workers), study.progress)
    done = [motion for motion in motions.values() if motion["status"] in ("completed", "lost")]
    torques = [motion["peak_torque"] for motion in done]
    spread, use = max(torques) / min(torques), 100.0 * (motions["the paper's motion"]["limit_use"] or np.nan)
    kept = sum(motion["status"] == "completed" for motion in motions.values())
    claims = [
        Claim("abstract: motions that are followed", "all", kept, f"of {len(motions)}", kept == len(motions)),
        Claim("abstract: largest torque of a run over the least", "1", spread, "", spread <= LARGE_SPREAD),
        Claim("IV: largest part of a limit on (37), (38)", "<= 100 %", use, "%", use <= 100.0),
    ]
    return Result({"motions": motions}, claims, {"workspace": draw})
