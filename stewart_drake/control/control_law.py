"""The paper's whole controller as a pure function, (19)-(36): what a port to hardware needs, without Drake.

`ControlLaw` is the whole of Fig. 6: LQI, density features and tuner. The LeafSystems of `stewart_drake.systems` call
the same parts; nothing of the mathematics lives in them.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from stewart_drake.control.density import DensityKind, density, push
from stewart_drake.control.inputs import Measurement, Setpoint
from stewart_drake.control.lqi import LqiMemory, block_weights, held_tick, initial_memory
from stewart_drake.control.lqi_options import LqiOptions
from stewart_drake.control.network import TunerNetwork
from stewart_drake.errors import ConfigurationError
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.robot import RobotParameters
from stewart_drake.section import Window, check_value


@dataclass(frozen=True)
class ControlState:
    """What the controller carries from tick to tick.

    Attributes:
        lqi: Of the LQI.
        weights: (2,) omega_Q, omega_R, or (4,) q_e, q_v, q_z, r, for the next tick.
        window: (m + 1, 12) last errors and torques, oldest first.
        filled: Rows of the window that are filled.
    """

    lqi: LqiMemory
    weights: np.ndarray
    window: np.ndarray
    filled: int = 0

    @property
    def integral(self) -> np.ndarray:
        """(6,) [rad s, m s] z."""
        return self.lqi.integral


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
        compiled: Ticks compiled by numba where they can be, with `solver="split"`.

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
    compiled: bool = False

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

    def initial_state(self) -> ControlState:
        """State before the first tick."""
        weights = np.array(self.initial_weights)
        if self.network is not None:
            weights = np.clip(weights, self.network.omega_min, self.network.omega_max)
        return ControlState(initial_memory(), weights, np.zeros((self.window + 1, 12)))

    def __call__(
        self, measurement: Measurement, setpoint: Setpoint, state: ControlState
    ) -> tuple[np.ndarray, ControlState]:
        """Torques (6,) [N m] for this tick, and the state for the next.

        The weights found in this tick act in the next one: they need this tick's torque.

        Raises:
            RunFailure: See `lqi.held_tick`.
        """
        output = held_tick(
            self.robot, self.options, self.gravity, measurement, setpoint, state.weights, state.lqi, self.compiled
        )
        state = replace(state, lqi=output)
        if self.network is not None:
            sample = np.concatenate([output.error, output.torque])
            window, filled = push(state.window, state.filled, sample)
            features = density(window[-filled:], self.density_kind)
            state = replace(state, weights=self.network.weights(features), window=window, filled=filled)
        return output.torque, state
