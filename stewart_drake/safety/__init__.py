"""What stands between any controller and the motors: monitors, and a reaction in levels.

Levels, each entered from the one before: `hold` repeats the last good command for as long as its budget lasts; `ramp`
leads to the torque that carries the robot's weight where it stands, with damping; `safe_hold` stays there; then the run
ends with the monitor's name. Only `hold` is left again by itself. What can be known beforehand is refused before the
start, see `refuse_motion`.

Torque and torque-rate limits with a named stop are libfranka's habit (`limitRate`, `controller_torque_discontinuity`).
"""

from stewart_drake.safety.layer import END as END
from stewart_drake.safety.layer import HOLD as HOLD
from stewart_drake.safety.layer import LEVELS as LEVELS
from stewart_drake.safety.layer import NONE as NONE
from stewart_drake.safety.layer import NOT_THERE as NOT_THERE
from stewart_drake.safety.layer import RAMP as RAMP
from stewart_drake.safety.layer import SAFE_HOLD as SAFE_HOLD
from stewart_drake.safety.layer import first_trip as first_trip
from stewart_drake.safety.layer import safety_part as safety_part
from stewart_drake.safety.refusals import refuse_motion as refuse_motion
from stewart_drake.safety.refusals import refuse_start as refuse_start
from stewart_drake.safety.refusals import sample_times as sample_times
from stewart_drake.safety.safety_options import MONITORS as MONITORS
from stewart_drake.safety.safety_options import SafetyInputs as SafetyInputs
from stewart_drake.safety.safety_options import SafetyOptions as SafetyOptions
