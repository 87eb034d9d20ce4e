"""The paper's whole controller as a pure function, (19)-(36): what a port to hardware needs, without Drake."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from stewart_drake.control.density import DensityKind, density_part
from stewart_drake.control.inputs import Measurement, Setpoint
from stewart_drake.control.lqi import block_weights, lqi_part
from stewart_drake.control.lqi_options import LqiOptions
from stewart_drake.control.network import TunerNetwork, network_part
from stewart_drake.errors import ConfigurationError
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.part import Part
from stewart_drake.robot import RobotParameters
from stewart_drake.section import Window, check_value


class ControlState(NamedTuple):
    """What the controller carries from tick to tick.

    Attributes:
        lqi: Record of the LQI's state, see `lqi.LQI_STATE`.
        weights: (2,) omega_Q, omega_R, or (4,) q_e, q_v, q_z, r, for the next tick.
        density: Record of the density's state; as made where there is no network.
    """

    lqi: np.ndarray
    weights: np.ndarray
    density: np.ndarray

    @property
    def integral(self) -> np.ndarray:
        """(6,) [rad s, m s] z."""
        return self.lqi["integral"][0]


@dataclass(frozen=True)
class ControlLaw:
    """The controller of Fig. 6: `torque, state = law(measurement, setpoint, state)`, once per period.

    Attributes:
        robot: Geometry and masses as the controller believes them.
        options: LQI options; `solver="split"` runs where Drake is not installed.
        gravity: [m/s^2].
        network: Tuner, or None for weights that stay as they start.
        density_kind: Kind of density.
        window: Window m [ticks].
        initial_weights: omega_Q, omega_R at the start, or q_e, q_v, q_z, r.

    Raises:
        ConfigurationError: A window below 1, a kind of density that is not the network's, four weights beside a
            network.
        RiccatiError: Weights that are not positive and finite.
    """

    robot: RobotParameters
    options: LqiOptions = field(default_factory=LqiOptions)
    gravity: float = STANDARD_GRAVITY
    network: TunerNetwork | None = None
    density_kind: DensityKind = "magnitude"
    window: int = 49
    initial_weights: tuple[float, ...] = (1.0, 1.0)

    def __post_init__(self) -> None:
        check_value("window", self.window, Window)
        check_value("density_kind", self.density_kind, DensityKind)
        block_weights(np.array(self.initial_weights))
        if self.network is not None:
            if self.density_kind != self.network.density:
                allowed = f"{self.network.density}, as the network was trained on"
                raise ConfigurationError("density_kind", self.density_kind, allowed)
            if len(self.initial_weights) != 2:
                raise ConfigurationError("initial_weights", self.initial_weights, "two, with a network")

    @cached_property
    def _parts(self) -> tuple[Part, Part, Part | None]:
        lqi = lqi_part(self.options, self.robot, self.gravity, len(self.initial_weights))
        tuner = None if self.network is None else network_part(self.network, self.initial_weights)
        return lqi, density_part(self.window, self.density_kind), tuner

    def initial_state(self) -> ControlState:
        """State before the first tick."""
        lqi, density, tuner = self._parts
        weights = np.array(self.initial_weights) if tuner is None else tuner.initial["weights"][0]
        return ControlState(lqi.initial.copy(), weights.copy(), density.initial.copy())

    def __call__(
        self, measurement: Measurement, setpoint: Setpoint, state: ControlState
    ) -> tuple[np.ndarray, ControlState]:
        """Torques (6,) [N m] for this tick, and the state for the next.

        The weights found in this tick act in the next one: they need this tick's torque.

        Raises:
            RunFailure: See `lqi_part`.
        """
        lqi, density, tuner = self._parts
        weights, after = state.weights, ControlState(*(each.copy() for each in state))
        lqi.tick(np.concatenate(measurement), np.concatenate(setpoint), weights, after.lqi)
        torque = after.lqi["torque"][0]
        if tuner is not None:
            density.tick(after.lqi["error"][0], torque, after.density)
            answer = tuner.initial.copy()
            tuner.tick(after.density["density"][0], answer)
            after = after._replace(weights=answer["weights"][0])
        return torque.copy(), after
