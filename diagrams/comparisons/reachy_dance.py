"""A motion of one's own: the dances that Reachy Mini's maker publishes in a package, `DANCES`."""

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from stewart_drake import ConfigurationError
from stewart_drake.reachy.moves import dances

SAMPLE = 0.002  # [s].


class Dance:
    """A move of the library, again and again as `play_on` plays it; antennas are not part of the platform.

    It turns and shifts the head from `home` [rad, m], at a tempo in beats/min. A move that jumps needs `smoothing`, the
    standard deviation [s] of the Gaussian that it is averaged with.
    """

    def __init__(self, move, tempo=114.0, smoothing=0.0, home=(0.0, 0.0, 0.0, 0.0, 0.0, 0.177)):
        known = dances()
        if move not in known:
            raise ConfigurationError("reference.arguments.move", move, f"one of {', '.join(known)}")
        function, keywords, facts = known[move]
        beats = facts["default_duration_beats"]
        period = beats * 60.0 / tempo
        times, step = np.linspace(0.0, period, round(period / SAMPLE) + 1, retstep=True)
        made = [function(time * beats / period, **keywords) for time in times[:-1]]
        poses = np.array(home) + [[*each.orientation_offset, *each.position_offset] for each in made]
        if smoothing > 0.0:
            poses = gaussian_filter1d(poses, smoothing / step, axis=0, mode="wrap")
        self.motion = CubicSpline(times, np.vstack([poses, poses[:1]]), bc_type="periodic")

    def evaluate(self, time):
        """Pose, rate and acceleration (6,) at a time [s]."""
        return self.motion(time), self.motion(time, 1), self.motion(time, 2)
