"""Where the sections look, beside the near box of `planning.pose_box`."""

from __future__ import annotations

import math

from stewart_drake.planning.pose_box import Region

ANNOUNCED = Region(
    "announced",
    (math.pi / 6.0,) * 3 + (0.3,) * 3,
    "turns up to 30 deg and shifts up to 300 mm along each axis, all at once, as section III.D announces",
)
"""The box that section III.D of the paper announces for its data."""

WIDE = Region(
    "wide",
    (math.radians(70.0), math.radians(70.0), math.radians(80.0), 0.2, 0.2, 0.11),
    "turns up to 70, 70 and 80 deg, 200 mm in X and Y and 110 mm in Z to either side of home, all at once",
)
"""About as far as each coordinate alone can go; its corners lie beyond parallel singularities."""
