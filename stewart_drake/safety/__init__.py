"""What stands between any controller and the motors: monitors, and a reaction in levels.

Levels, each entered from the one before: `hold` repeats the last good command for as long as its budget lasts; `ramp`
leads to the torque that carries the robot's weight where it stands, with damping; `safe_hold` stays there; then the run
ends with the monitor's name. Only `hold` is left again by itself. What can be known beforehand is refused before the
start, see `refuse_motion`.

Torque and torque-rate limits with a named stop are libfranka's habit (`limitRate`, `controller_torque_discontinuity`).
"""

from stewart_drake.safety.layer import HOLD, LEVELS, NONE, NOT_THERE, RAMP, SAFE_HOLD, first_trip, safety_part
from stewart_drake.safety.limits import refuse_motion, refuse_start, sample_times
from stewart_drake.safety.safety_options import MONITORS, SafetyInputs, SafetyOptions

__all__ = [
    "HOLD", "LEVELS", "MONITORS", "NONE", "NOT_THERE", "RAMP", "SAFE_HOLD", "SafetyInputs", "SafetyOptions",
    "first_trip", "refuse_motion", "refuse_start", "safety_part", "sample_times",
]  # fmt: skip
