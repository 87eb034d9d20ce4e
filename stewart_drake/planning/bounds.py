"""What a run must keep to for its motion to count as followed."""

from __future__ import annotations

import math
from typing import Annotated

from stewart_drake.robot.robot_scale import LENGTH
from stewart_drake.section import Positive, Section


class Bounds(Section, key="bounds"):
    """What a run must keep to for its motion to count as followed. A bound that is null is off.

    A bound acts while the controller is in charge, from the time on when the run has first been inside it: a start that
    is off by more has to come back. Lengths are for the paper's robot; another has them in proportion.
    """

    rotation: Positive | None = math.radians(10.0)
    """[rad] largest angle between the platform and its reference."""
    position: Annotated[Positive | None, LENGTH] = 0.03
    """[m] largest distance between the platform and its reference."""
    loop_gap: Annotated[Positive | None, LENGTH] = 0.001
    """[m] largest distance from a rod's end to its platform joint: beyond it the simulated loops are open."""
    motion_ratio: Positive | None = 0.25
    """[-] least size of the platform's motion over that of its reference, see docs/promises.md. Friction that swallows
    a motion makes it 0."""
    error_ratio: Positive | None = 1.0
    """[-] largest error, after a time for settling, over the size of the reference's motion, see docs/promises.md."""
