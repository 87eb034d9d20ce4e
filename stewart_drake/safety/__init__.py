"""The safety layer between any controller and the motors: monitors, and a reaction in levels.

Levels: `hold` repeats the last good command for as long as its budget lasts, and is the only one that ends by itself;
`ramp` leads to the torque that carries the robot's weight where it is, damped; `safe_hold` keeps that torque; then the
run ends. Torque and torque-rate limits with a named stop follow libfranka (`limitRate`).
"""

from stewart_drake.safety.limits import refuse_motion, refuse_start, sample_times
from stewart_drake.safety.options import MONITORS, SafetyInputs, SafetyOptions
from stewart_drake.safety.part import first_trip, later, safety_part
from stewart_drake.safety.state import HOLD, LEVELS, NONE, NOT_THERE, RAMP, SAFE_HOLD
from stewart_drake.safety.stillness import Stillness, first_standstill, standstill_text

__all__ = [
    "HOLD",
    "LEVELS",
    "MONITORS",
    "NONE",
    "NOT_THERE",
    "RAMP",
    "SAFE_HOLD",
    "SafetyInputs",
    "SafetyOptions",
    "Stillness",
    "first_standstill",
    "first_trip",
    "later",
    "refuse_motion",
    "refuse_start",
    "safety_part",
    "sample_times",
    "standstill_text",
]
