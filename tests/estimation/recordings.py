"""Robots and recordings that the tests of identification share."""

import numpy as np
from simulated_identification import deviating, recorded

from stewart_drake.hardware.sensors import EncoderOptions
from stewart_drake.references.motions import SineReference, SumReference

EXACT = EncoderOptions(resolution_bits=0)
FINE = EncoderOptions(resolution_bits=17, noise=2e-5)


def motion(robot, seed=3, size=1.0):
    """Sines of 0.3 to 1.6 Hz in all coordinates."""
    rng = np.random.default_rng(seed)
    length = np.array([1.0] * 3 + [robot.characteristic_length] * 3)
    parts = [
        SineReference(
            center=tuple(robot.home_pose),
            amplitude=tuple(0.09 * size * length / frequency**0.5),
            angular_frequency=tuple(frequency * rng.uniform(0.8, 1.25, 6)),
            phase=tuple(rng.uniform(0.0, 6.0, 6)),
        )
        for frequency in (2.0, 4.0, 9.0)
    ]
    return SumReference(parts=tuple(parts))


def truth_of(robot, seed=0):
    """Parameters of a robot that is off, with a payload and friction."""
    return deviating(robot, np.random.default_rng(seed), 0.02, 0.01)


def recording(robot, values, reference=None, seconds=20.0, rate=250.0, encoders=EXACT, noise=0.0, seed=0):
    """Of a robot in motion."""
    reference = motion(robot) if reference is None else reference
    return recorded(robot, values, reference, seconds, rate, encoders, noise, np.random.default_rng(seed))
