"""One tick of the paper's controller as a pure function, (19)-(36): what a port to hardware needs, without Drake.

`ControlLaw` is the whole of Fig. 6: LQI, density features and tuner. The LeafSystems of `stewart_drake.systems` call
the same parts; nothing of the mathematics lives in them.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np

from stewart_drake.density import DensityKind, density, push
from stewart_drake.errors import ConfigurationError, NotFiniteError, SingularPoseError, UnreachablePoseError
from stewart_drake.force_map import ForceMapKind, force_map_of_legs
from stewart_drake.kinematics import LegGeometry, leg_geometry, line_conditioning
from stewart_drake.network import TunerNetwork
from stewart_drake.riccati import RiccatiSolver, riccati_gain, solve_drake, split_gain
from stewart_drake.rigid_body_model import STANDARD_GRAVITY, static_torque_of_legs
from stewart_drake.robot import RobotParameters
from stewart_drake.scalars import SECTION, Real, is_finite
from stewart_drake.state_space import (
    AXES,
    INTEGRAL,
    POSITION,
    RATE,
    STATES,
    Discretization,
    discretize,
    input_matrix,
    mass_diagonal,
    state_matrix,
)

Feedforward = Literal["none", "gravity", "platform"]

_DEAD_CENTRE_SLACK = 0.05
"""[-] reach margin down to which a measured pose counts as a crank at its dead centre: loop gap and sensor error."""


@dataclass(frozen=True, kw_only=True)
class LqiOptions:
    """Options of the LQI controller; the defaults are the paper's, with gravity compensated.

    Raises:
        ConfigurationError: A value outside what the field says.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = SECTION

    period: Real = 0.005
    """[s] control period, > 0, a whole multiple of the plant's time step."""
    force_map: ForceMapKind = "statics"
    """tau_2 of (15) as printed, or by statics."""
    feedforward: Feedforward = "gravity"
    """none: the paper, (34) alone. gravity: adds the static torque of all bodies at the measured pose. platform: adds
    to that M q''_d of (9) through the force map at the measured pose."""
    discretization: Discretization = "exact"
    """Zero-order hold of (25): exact, or first order (euler)."""
    solver: RiccatiSolver = "drake"
    """drake: one equation of 18 states. split: six of 3 states, without Drake."""
    min_transmission: Real = 0.02
    """[-] a crank with |e_l . e_N| below this counts as at its dead centre; the run ends."""
    min_conditioning: Real = 0.005
    """[-] sigma_min / sigma_max of tau_1 below this counts as a parallel singularity; the run ends."""

    def __post_init__(self) -> None:
        if not (is_finite(self.period) and self.period > 0.0):
            raise ConfigurationError("controller.period", self.period, "a positive number of seconds")
        for name, options in (
            ("force_map", ("statics", "printed")),
            ("feedforward", ("none", "gravity", "platform")),
            ("discretization", ("exact", "euler")),
            ("solver", ("drake", "split")),
        ):
            if getattr(self, name) not in options:
                raise ConfigurationError(f"controller.{name}", getattr(self, name), " or ".join(options))
        for name in ("min_transmission", "min_conditioning"):
            value = getattr(self, name)
            if not (is_finite(value) and 0.0 < value < 1.0):
                raise ConfigurationError(f"controller.{name}", value, "a number between 0 and 1")


class Measurement(NamedTuple):
    """What the sensor reports: pose (6,) [rad, m] and pose_rate (6,) [rad/s, m/s] of P in B, Euler rates."""

    pose: np.ndarray
    pose_rate: np.ndarray


class Setpoint(NamedTuple):
    """Where the platform should be: pose, pose_rate, pose_acceleration, each (6,)."""

    pose: np.ndarray
    pose_rate: np.ndarray
    pose_acceleration: np.ndarray


class LqiOutput(NamedTuple):
    """Result of one LQI tick: torque (6,) [N m], error (6,) [rad, m], integral (6,) [rad s, m s] for the next tick."""

    torque: np.ndarray
    error: np.ndarray
    integral: np.ndarray


def checked_legs(robot: RobotParameters, options: LqiOptions, pose: np.ndarray) -> LegGeometry:
    """Leg vectors at a measured pose, refused near singularities, where the force map loses its meaning.

    Raises:
        NotFiniteError: The pose is not finite.
        UnreachablePoseError: The pose cannot be assembled.
        SingularPoseError: A crank near its dead centre, or rods near a parallel singularity.
    """
    if not np.isfinite(pose).all():
        raise NotFiniteError("measured pose", pose)
    try:
        legs = leg_geometry(robot, pose)
    except UnreachablePoseError as error:
        if error.margin < -_DEAD_CENTRE_SLACK:
            raise
        # The robot stands there, so it can: the crank has been carried across its dead centre, where reach ends.
        raise SingularPoseError("serial", pose, 0.0, options.min_transmission, error.leg) from error
    transmission = np.abs(legs.transmission)
    leg = int(transmission.argmin())
    if transmission[leg] < options.min_transmission:
        raise SingularPoseError("serial", pose, float(transmission[leg]), options.min_transmission, leg)
    ratio = float(line_conditioning(robot, legs))
    if ratio < options.min_conditioning:
        raise SingularPoseError("parallel", pose, ratio, options.min_conditioning)
    return legs


def lqi_gain(acceleration_map: np.ndarray, options: LqiOptions, weights: np.ndarray) -> np.ndarray:
    """K of (31) for M^-1 tau at the present pose, u = -K [e; z] in the paper's state order.

    Args:
        acceleration_map: (6, 6) M^-1 tau.
        options: Period, discretisation and solver.
        weights: (2,) omega_Q, omega_R of (27), both > 0.

    Returns:
        (6, 18).

    Raises:
        RiccatiError: No stabilising solution.
    """
    omega_q, omega_r = float(weights[0]), float(weights[1])
    if options.solver == "split":
        return split_gain(acceleration_map, options.period, (omega_q,) * 3 + (omega_r,), options.discretization)
    a, b = discretize(state_matrix(), input_matrix(acceleration_map), options.period, options.discretization)
    q, r = omega_q * np.eye(STATES), omega_r * np.eye(AXES)
    return riccati_gain(a, b, r, solve_drake(a, b, q, r))


def lqi_tick(
    robot: RobotParameters,
    options: LqiOptions,
    gravity: float,
    measurement: Measurement,
    setpoint: Setpoint,
    weights: np.ndarray,
    integral: np.ndarray,
) -> LqiOutput:
    """The LQI of one tick: B(t) from the present pose, exact discretisation, Riccati, (34), feedforward, (23).

    Deviation: u = -K e as in (34), not (30). The integral grows by period * e after it has been used.

    Args:
        robot: Geometry and masses as the controller believes them.
        options: See `LqiOptions`.
        gravity: [m/s^2] for the feedforward; 0 switches the gravity torque off.
        measurement: Pose and rate now.
        setpoint: Reference now.
        weights: (2,) omega_Q, omega_R, both > 0.
        integral: (6,) [rad s, m s] z so far.

    Raises:
        NotFiniteError, UnreachablePoseError, SingularPoseError: See `checked_legs`.
        RiccatiError: See `lqi_gain`.
    """
    if not np.isfinite(measurement.pose_rate).all():
        raise NotFiniteError("measured pose rate", measurement.pose_rate)
    legs = checked_legs(robot, options, measurement.pose)
    force_map = force_map_of_legs(robot, legs, options.force_map)
    mass = mass_diagonal(robot)
    gain = lqi_gain(force_map / mass[:, None], options, weights)

    error = measurement.pose - setpoint.pose
    state = np.empty(STATES)
    state[POSITION], state[RATE], state[INTEGRAL] = error, measurement.pose_rate - setpoint.pose_rate, integral
    torque = -gain @ state
    if options.feedforward != "none" and gravity != 0.0:
        torque += static_torque_of_legs(robot, legs, gravity)
    if options.feedforward == "platform":
        torque += np.linalg.solve(force_map, mass * setpoint.pose_acceleration)
    if not np.isfinite(torque).all():
        raise NotFiniteError("torque", torque)
    return LqiOutput(torque, error, integral + options.period * error)


@dataclass(frozen=True)
class ControlState:
    """What the controller carries from tick to tick.

    Attributes:
        integral: (6,) [rad s, m s].
        weights: (2,) omega_Q, omega_R for the next tick.
        window: (m + 1, 12) last errors and torques, oldest first.
        filled: Rows of the window that are filled.
    """

    integral: np.ndarray
    weights: np.ndarray
    window: np.ndarray
    filled: int = 0


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
        initial_weights: omega_Q, omega_R at the start.
    """

    robot: RobotParameters
    options: LqiOptions = field(default_factory=LqiOptions)
    gravity: float = STANDARD_GRAVITY
    network: TunerNetwork | None = None
    density_kind: DensityKind = "magnitude"
    window: int = 49
    initial_weights: tuple[float, float] = (1.0, 1.0)

    def initial_state(self) -> ControlState:
        """State before the first tick."""
        weights = np.array(self.initial_weights)
        if self.network is not None:
            weights = np.clip(weights, self.network.omega_min, self.network.omega_max)
        return ControlState(np.zeros(6), weights, np.zeros((self.window + 1, 12)))

    def __call__(
        self, measurement: Measurement, setpoint: Setpoint, state: ControlState
    ) -> tuple[np.ndarray, ControlState]:
        """Torques (6,) [N m] for this tick, and the state for the next.

        The weights found in this tick act in the next one: they need this tick's torque.

        Raises:
            RunFailure: See `lqi_tick`.
        """
        output = lqi_tick(self.robot, self.options, self.gravity, measurement, setpoint, state.weights, state.integral)
        state = replace(state, integral=output.integral)
        if self.network is not None:
            sample = np.concatenate([output.error, output.torque])
            window, filled = push(state.window, state.filled, sample)
            features = density(window[-filled:], self.density_kind)
            state = replace(state, weights=self.network.weights(features), window=window, filled=filled)
        return output.torque, state
