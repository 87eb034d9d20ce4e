"""Controllers as parts of a loop: flat vectors in and out, tick by tick."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from stewart_drake.control.controller_options import ControllerOptions, OwnControllerOptions
from stewart_drake.control.inputs import Measurement, Setpoint
from stewart_drake.robot import RobotParameters
from stewart_drake.sampling import Running, Sampled


class ControllerSite(NamedTuple):
    """What a controller is built for.

    Attributes:
        robot: As the controller believes it to be.
        gravity: [m/s^2].
        weights: Size of the weights that the tuner gives.
        guarded: See `sampling.ill`.
        compiled: See `Scenario.compiled`.
    """

    robot: RobotParameters
    gravity: float
    weights: int = 2
    guarded: bool = False
    compiled: bool = False


FlatLaw = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], bool]


def law_part(
    law: Callable[..., Any],
    memory: Any,
    options: OwnControllerOptions,
    site: ControllerSite,
    fast: FlatLaw | None = None,
) -> Sampled:
    """A pure law of robot, options, gravity, measurement, setpoint and memory, for flat vectors.

    Args:
        law: Gives the memory for the next tick.
        memory: Its NamedTuple of arrays (6,); it begins with the controller's results.
        options: Of the controller.
        site: What it is built for.
        fast: The same compiled, of measurement, reference, memory and result; False where the law raises.

    Returns:
        Its tick takes measurement (12,), reference (18,) and memory (6 n,).
    """

    def tick(measured: np.ndarray, wanted: np.ndarray, before: np.ndarray) -> np.ndarray:
        seen = Measurement(measured[:6], measured[6:]), Setpoint(wanted[:6], wanted[6:12], wanted[12:])
        return np.concatenate(law(site.robot, options, site.gravity, *seen, memory(*before.reshape(-1, 6))))

    def quick(measured: np.ndarray, wanted: np.ndarray, before: np.ndarray) -> np.ndarray:
        result = np.empty_like(before)
        if fast is not None and fast(measured, wanted, before, result):
            return result
        # Rare: the law says what was wrong.
        return tick(measured, wanted, before)

    return Sampled(np.zeros(6 * len(memory._fields)), tick if fast is None else quick)


class Answer(NamedTuple):
    """What a controller says: torque (6,) [N m], error (6,) [rad, m] and integral (6,) [rad s, m s]."""

    torque: np.ndarray
    error: np.ndarray
    integral: np.ndarray


class TickedControl:
    """A controller of the package in one run outside of a Diagram.

    Attributes:
        weighted: Whether it takes weights.
        health: What was wrong in the last tick, see `sampling.ill`.
    """

    def __init__(self, part: Sampled, options: ControllerOptions, site: ControllerSite) -> None:
        self.weighted, self._tells = options.weighted, len(options.results) > 1
        self._running, self._nothing = Running(part, site.guarded), np.zeros(6)
        self._last = Answer(*np.zeros((3, 6)))

    @property
    def health(self) -> tuple[float, float]:
        """See above."""
        return self._running.health

    def tick(self, time: float, measured: np.ndarray, wanted: np.ndarray, weights: np.ndarray) -> Answer:
        """The answer at a tick."""
        inputs = (measured, wanted, weights) if self.weighted else (measured, wanted)
        said = self._running(time, *inputs)
        more = (said[6:12], said[12:18]) if self._tells else (measured[:6] - wanted[:6], self._nothing)
        self._last = Answer(said[:6], *more)
        return self._last

    def between(
        self,
        time: float,  # noqa: ARG002
        measured: np.ndarray,  # noqa: ARG002
        wanted: np.ndarray,  # noqa: ARG002
        weights: np.ndarray,  # noqa: ARG002
    ) -> Answer:
        """The answer at a step of the plant between ticks: that of the last tick."""
        return self._last

    def advance(self, time: float) -> None:
        """Goes on to a time [s]; nothing happens between ticks."""

    def close(self) -> None:
        """Lets go of it all."""
