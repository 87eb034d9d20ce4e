"""What stands between any controller and the motors: monitors, and a reaction in levels; pure.

Levels, each entered from the one before: `hold` repeats the last good command for as long as its budget lasts; `ramp`
leads to the torque that carries the robot's weight where it stands, with damping; `safe_hold` stays there; then the run
ends with the monitor's name. Only `hold` is left again by itself. What can be known beforehand is refused before the
start, see `refuse_motion`.

Torque and torque-rate limits with a named stop are libfranka's habit (`limitRate`, `controller_torque_discontinuity`).
"""

from stewart_drake.safety.frozen import FROZEN_SIZE, frozen_tick
from stewart_drake.safety.layer import safety_part
from stewart_drake.safety.memory import (
    END,
    HOLD,
    LEVELS,
    MEMORY_SIZE,
    MONITORS,
    NONE,
    RAMP,
    SAFE_HOLD,
    Level,
    SafetyInputs,
    SafetyMemory,
    Trip,
    first_trip,
    initial_memory,
)
from stewart_drake.safety.monitors import surprise
from stewart_drake.safety.refusals import refuse_motion, refuse_start, sample_times
from stewart_drake.safety.safety_options import SafetyOptions
from stewart_drake.safety.tick import FlatTick, flat_tick, safety_tick

__all__ = [
    "END",
    "FROZEN_SIZE",
    "HOLD",
    "LEVELS",
    "MEMORY_SIZE",
    "MONITORS",
    "NONE",
    "RAMP",
    "SAFE_HOLD",
    "FlatTick",
    "Level",
    "SafetyInputs",
    "SafetyMemory",
    "SafetyOptions",
    "Trip",
    "first_trip",
    "flat_tick",
    "frozen_tick",
    "initial_memory",
    "refuse_motion",
    "refuse_start",
    "safety_part",
    "safety_tick",
    "sample_times",
    "surprise",
]
