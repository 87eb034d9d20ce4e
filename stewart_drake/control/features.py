"""What control is for, in one number, and what a tuner hears of its loop, in numbers that compare between robots.

The densities (35), (36) are the paper's. A density has no scale, so sizes stand beside it: errors and torque changes in
the units of the cost, innovations of the observer in those of the noise of a reading.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from stewart_drake.config import Positive, Section
from stewart_drake.jit import fields, njit


class CostScales(Section, key="cost"):
    """Scales of the cost of a run: how large an error or change of torque counts as one."""

    rotation: Positive = 0.03
    """[deg] RMS rotation error that counts as one."""
    position: Positive = 0.03
    """[mm] RMS position error that counts as one."""
    torque_change: Positive = 0.03
    """[N m] RMS change of a motor's torque in a millisecond that counts as one."""

    def at(self, kappa: float) -> CostScales:
        """The scales by smoothness, from stiff, kappa = -1, to quiet, 1: the last one divided by 10^kappa."""
        return CostScales(
            rotation=self.rotation, position=self.position, torque_change=self.torque_change * 10.0**-kappa
        )


def cost(rotation: Any, position: Any, torque_change: Any, scales: CostScales) -> Any:
    """J = sqrt((rotation / its scale)^2 + (position / its scale)^2 + (torque_change / its scale)^2) [-].

    Takes numbers, or arrays of any shape: RMS length of the error [deg] and [mm], RMS change of a motor's torque in a
    millisecond [N m].
    """
    squares = (rotation / scales.rotation) ** 2 + (position / scales.position) ** 2
    return (squares + (torque_change / scales.torque_change) ** 2) ** 0.5


FEATURES = (
    "surprise",
    "surprise_slow",
    "drift",
    "error",
    "error_slow",
    "torque_change",
    "error_density",
    "torque_density",
    "speed",
    "acceleration",
    "noise",
    "latency",
    "kappa",
)
"""Names of features, as policy files have them; all but the last are decimal logarithms. The first two are mean squares
of normalised innovations."""
TIMES = (0.010, 0.100, 0.020, 0.200, 0.020)
"""[s] over which normalised innovations (twice), error (twice) and torque change are averaged."""
DRIFT_TIME = 0.020
"""[s] over which innovations are averaged with their signs: what pushes the robot has one."""
INNOVATION_FLOOR, DRIFT_FLOOR, COST_FLOOR = 1e-2, 1e-3, 1e-6
"""Added before the logarithm of a square: of innovations, of the drift, of errors and torque changes."""
LARGEST = 1e9
"""What is heard is below it, in any unit; squares of it stay finite."""

SETUP = fields(
    period=(), noise=(), latency=(), length=(), kappa=(), rotation=(), position=(), torque_change=(),
    centre=4, step=4, weights=4, disturbance=(),
)  # fmt: skip
"""What a tuner of settings is made for. period [s]. noise of a reading [rad]. latency from a reading to the torque that
it causes [s]. length: characteristic length of the robot [m]. rotation, position, torque_change: what counts as one in
the cost [rad], [m] and, from tick to tick, [N m]. centre, step: of a setting. weights, disturbance: of the base."""
TUNER_STATE = fields(
    weights=4, disturbance=1, setting=5, levels=5, drift=6, torque=6, ticks=(), held=()
)  # fmt: skip
"""weights, disturbance [rad/s^2 per sqrt(s)]. setting: four, and from 0 to 1 how far what is heard lies outside of the
training. levels: mean squares over `TIMES`. drift: mean normalised innovations. torque: of the tick before [N m]. ticks
heard. held: [s] that a schedule goes on."""


@njit
def plausible(density: Any, error: Any, torque: Any, innovation: Any, reference: Any) -> bool:
    """Whether all that is heard is finite and below `LARGEST`."""
    for values in (density, error, torque, innovation, reference):
        for value in values:
            if not abs(value) < LARGEST:
                return False
    return True


@njit
def features(
    setup: Any, density: Any, error: Any, torque: Any, innovation: Any, reference: Any, state: Any, out: Any
) -> None:
    """Features (13,) [-] at a tick, see `FEATURES`; of a `SETUP` record, and a `TUNER_STATE` that is counted on.

    Heard are densities (12,) [-], the error (6,) [rad, m] that the controller saw, the torque (6,) [N m] that it asks
    for, the innovation (6,) [rad] of the observer, and the reference (18,).
    """
    period = setup.period
    innovations, drift, changes, rotation, position = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(6):
        normalised = innovation[i] / setup.noise
        innovations += normalised * normalised / 6.0
        state.drift[i] += period / (period + DRIFT_TIME) * (normalised - state.drift[i])
        drift += state.drift[i] ** 2 / 6.0
        if state.ticks > 0.0:
            changes += ((torque[i] - state.torque[i]) / setup.torque_change) ** 2 / 6.0
        state.torque[i] = torque[i]
    state.ticks += 1.0
    for k in range(3):
        rotation += (error[k] / setup.rotation) ** 2
        position += (error[3 + k] / setup.position) ** 2
    now = (innovations, innovations, rotation + position, rotation + position, changes)
    for k in range(5):
        state.levels[k] += period / (period + TIMES[k]) * (now[k] - state.levels[k])
    out[0], out[1] = state.levels[0] + INNOVATION_FLOOR, state.levels[1] + INNOVATION_FLOOR
    out[2] = drift + DRIFT_FLOOR
    for k in range(3):
        out[3 + k] = state.levels[2 + k] + COST_FLOOR
    for part in range(2):
        mean, square = 0.0, 1e-12
        for k in range(6):
            mean += density[6 * part + k] / 6.0
        for k in range(3):
            square += (setup.length * reference[6 + 6 * part + k]) ** 2 + reference[9 + 6 * part + k] ** 2
        out[6 + part] = abs(mean) + 0.1
        out[8 + part] = np.sqrt(square) + (1e-3 if part == 0 else 1e-2)
    out[10], out[11] = setup.noise / 1e-5, setup.latency / 1e-3
    for k in range(12):
        out[k] = np.log10(out[k])
    out[12] = setup.kappa
