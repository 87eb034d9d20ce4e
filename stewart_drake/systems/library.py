"""The LeafSystems of the loop, to wire by hand: parts in the shell of `PartSystem`, and what has no tick."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from pydrake.systems.framework import Context, LeafSystem

from stewart_drake.control.computed_torque import ComputedTorqueOptions, computed_torque_part
from stewart_drake.control.joint_pid import PidOptions, pid_part
from stewart_drake.control.lqi import LqiOptions, lqi_part
from stewart_drake.control.network import DensityKind, TunerNetwork, density_part, network_part
from stewart_drake.errors import ConfigurationError
from stewart_drake.hardware.disturbances import Disturbance, total_wrench
from stewart_drake.hardware.estimator import difference_part
from stewart_drake.hardware.motors import (
    FrictionCompensation,
    LinkOptions,
    MotorOptions,
    friction_part,
    link_part,
    motor_part,
)
from stewart_drake.hardware.observer import ObserverOptions, observer_part
from stewart_drake.hardware.sensors import EncoderOptions, encoder_part
from stewart_drake.plant.multibody_plant import StewartPlant
from stewart_drake.references import Reference, in_blocks
from stewart_drake.robot import RobotParameters
from stewart_drake.safety import SafetyOptions, safety_part
from stewart_drake.systems.part_system import PartSystem


class LqiController(PartSystem, ports="measurement reference weights -> torque error integral"):
    """Linear quadratic integral regulator, (19)-(34): a new gain at every tick, from that tick's pose and weights.

    The torque answers within the tick (no added delay), within the motors' limits where `saturation` says so, and is
    held until the next; see `PartSystem`. z, and what bridges a failed tick, live in the Context. The gain comes from
    Drake's `DiscreteAlgebraicRiccatiEquation`, or with `solver: split` from the compiled split solution.

    Args:
        robot: As the controller believes it to be.
        options: See `LqiOptions`.
        gravity: [m/s^2].
        weights: Size of the port: 2, or 4 for block weights.
    """

    def __init__(self, robot: RobotParameters, options: LqiOptions, gravity: float, weights: int = 2) -> None:
        if weights not in (2, 4):
            raise ConfigurationError("weights", weights, "2 or 4")
        super().__init__(lqi_part(options, robot, gravity, weights), options.period)


class JointPid(PartSystem, ports="measurement reference -> torque error integral"):
    """PID in the space of the cranks, see `joint_pid`."""

    def __init__(self, robot: RobotParameters, options: PidOptions, gravity: float) -> None:
        super().__init__(pid_part(options, robot, gravity), options.period)


class ComputedTorque(PartSystem, ports="measurement reference -> torque error integral"):
    """Computed torque in the space of the platform, see `computed_torque`."""

    def __init__(self, robot: RobotParameters, options: ComputedTorqueOptions, gravity: float) -> None:
        super().__init__(computed_torque_part(options, robot, gravity), options.period)


class DensityFeatures(PartSystem, ports="error torque -> density"):
    """Density of each input over a sliding window, (35), (36); answers within the tick.

    The window lives in the Context: two runs of one Diagram never share it.

    Args:
        window: m of (35) [ticks]; means run over m + 1 samples.
        period: [s] tick period.
        kind: See `density.density`.
    """

    def __init__(self, window: int, period: float, kind: DensityKind = "magnitude") -> None:
        super().__init__(density_part(window, kind), period)


class AnnTuner(PartSystem, ports="density -> weights"):
    """omega_Q and omega_R from the densities, Fig. 5.

    `stewart_drake.AnnTuner` is the section of a scenario that asks for it. The weights found at a tick act from the
    next one on: the densities of a tick need its torque, which needs the weights. Until the first inference they are
    `initial`; they are never zero and never outside the range that the network was trained on.

    Args:
        network: Trained.
        period: [s] tick period.
        initial: omega_Q, omega_R before the first inference.

    Raises:
        ConfigurationError: `initial` is not two finite numbers.
    """

    def __init__(self, network: TunerNetwork, period: float, initial: Sequence[float] = (1.0, 1.0)) -> None:
        super().__init__(network_part(network, initial), period)


class MotorEncoders(PartSystem, ports="crank_state -> reading"):
    """Crank angles as the encoders read them; faults of `EncoderOptions` are another part. A noise number a tick."""

    def __init__(self, options: EncoderOptions, period: float) -> None:
        super().__init__(encoder_part(options), period)


class PoseEstimator(PartSystem, ports="reading -> measurement"):
    """Forward kinematics of the encoder readings, and their differences; answers within the tick.

    Args:
        robot: As the controller believes it to be.
        options: See `EncoderOptions`.
        period: [s] tick period.
        start: Pose (6,) [rad, m] roughly where the platform stands at first, which picks the assembly mode; and as it
            may be its rate (6,) [rad/s, m/s], of a robot that is in motion at the start.
    """

    def __init__(self, robot: RobotParameters, options: EncoderOptions, period: float, *start: np.ndarray) -> None:
        super().__init__(difference_part(robot, options, period, *start), period)


class PlatformObserver(
    PartSystem, ports="reading sent reference disturbance -> measurement ahead compensation innovation"
):
    """State of the platform from readings and the commands that were sent, see `hardware.observer`.

    Args: As of `observer.observer_part`: noise, pose, pose_rate, still; as keywords command_delay, friction and size.
    """

    def __init__(
        self, robot: RobotParameters, options: ObserverOptions, gravity: float, period: float, *start: Any, **more: Any
    ) -> None:
        super().__init__(observer_part(robot, options, gravity, period, *start, **more), period)


class FrictionFeedforward(PartSystem, ports="reference -> against_friction"):
    """Torque against the motors' friction along the reference."""

    def __init__(self, robot: RobotParameters, options: FrictionCompensation, period: float) -> None:
        super().__init__(friction_part(robot, options), period)


class CommandLink(PartSystem, ports="torque -> torque age"):
    """Passes a controller's commands on, or loses, delays and spoils them; at every step of the plant.

    Args:
        options: See `LinkOptions`.
        time_step: [s] of the plant.
        steps_per_tick: Steps of the plant in a control period.
        initial: (6,) [N m] command before the first one arrives.
    """

    def __init__(self, options: LinkOptions, time_step: float, steps_per_tick: int, initial: np.ndarray) -> None:
        super().__init__(link_part(options, steps_per_tick, initial), time_step)


class MotorDrive(PartSystem, ports="torque crank_state -> torque"):
    """Torque of imperfect motors for the torque asked for, see `MotorOptions`; at every step of the plant."""

    def __init__(self, options: MotorOptions, time_step: float) -> None:
        super().__init__(motor_part(options), time_step)


class SafetyLayer(
    PartSystem,
    ports="command measurement reference age sensor_health controller_health angles innovation pose_reading"
    " -> torque safety",
):
    """Watches commands and measurements, and passes on what may go to the motors; answers within the tick.

    Any controller with a torque port runs behind it. A port for which there is no signal may be left alone, and takes
    its array of `safety.NOT_THERE`.

    Args: As of `safety.safety_part`: initial, and as it may be quantum and innovation_scale.
    """

    def __init__(
        self, robot: RobotParameters, options: SafetyOptions, gravity: float, period: float, *more: Any, **named: Any
    ) -> None:
        super().__init__(safety_part(robot, options, gravity, period, *more, **named), period)


# --- what has no tick -------------------------------------------------------------------------------------------------


class ReferenceSource(LeafSystem):
    """A reference motion as a signal.

    Args:
        reference: The motion.
        period: [s] at whose multiples the signal is mostly asked for; they are evaluated some hundred at a time, which
            costs a tenth. Other times are answered too.
        ahead: [s] by which it is ahead of its time.

    Ports:
        reference: out (18,), pose [rad, m], pose rate [rad/s, m/s], pose acceleration [rad/s^2, m/s^2].
    """

    def __init__(self, reference: Reference, period: float | None = None, ahead: float = 0.0) -> None:
        super().__init__()
        self._reference, self._ahead = reference, ahead
        self._blocks = None if period is None else in_blocks(reference, period)
        needs = {self.time_ticket()}
        self.reference = self.DeclareVectorOutputPort("reference", 18, self._calc, prerequisites_of_calc=needs)

    def _calc(self, context: Context, output: Any) -> None:
        time = context.get_time() + self._ahead
        if self._blocks is not None:
            at, value = self._blocks.at(round(time / self._blocks.period))
            if at == time:
                output.SetFromVector(value)
                return
        output.SetFromVector(np.concatenate(self._reference.evaluate(time)))


class TaskSpaceSensor(LeafSystem):
    """Pose and rate of P in B, and angles and rates of the cranks, exact.

    Ports:
        plant_state: in (nq + nv,), state of the MultibodyPlant.
        measurement: out (12,), pose [rad, m] then pose rate [rad/s, m/s] (Euler rates).
        crank_state: out (12,), angles of the cranks [rad] from the horizontal, not wrapped, then their rates [rad/s].
    """

    def __init__(self, plant: StewartPlant) -> None:
        super().__init__()
        self._plant = plant
        size = plant.plant.num_multibody_states()
        # A sensor asks at every tick: what `StateMap.crank_angles` does, without its generality.
        self._index = np.concatenate([plant.indices.crank, plant.indices.crank_rate])
        self._zero = np.concatenate([plant.crank_angles(np.zeros(size)), np.zeros(6)])
        self.plant_state = self.DeclareVectorInputPort("plant_state", size)
        needs = {self.input_port_ticket(self.plant_state.get_index())}
        self.measurement = self.DeclareVectorOutputPort("measurement", 12, self._pose, prerequisites_of_calc=needs)
        self.crank_state = self.DeclareVectorOutputPort("crank_state", 12, self._cranks, prerequisites_of_calc=needs)

    def _pose(self, context: Context, output: Any) -> None:
        output.SetFromVector(np.concatenate(self._plant.pose_and_rate(self.plant_state.Eval(context))))

    def _cranks(self, context: Context, output: Any) -> None:
        output.SetFromVector(self.plant_state.Eval(context)[self._index] + self._zero)


class PlatformWrench(LeafSystem):
    """The disturbances of a scenario, at the centre of the platform.

    Ports:
        wrench: out (6,) [N m, N], moment about P and force, in B.
        spatial_force: out, for the plant's port `applied_spatial_force`.
    """

    def __init__(self, plant: StewartPlant, disturbances: Sequence[Disturbance]) -> None:
        super().__init__()
        self._disturbances = tuple(disturbances)
        self._body = plant.plant.GetBodyByName("platform").index()
        needs, forces = {self.time_ticket()}, Value[list[ExternallyAppliedSpatialForce]]
        self.wrench = self.DeclareVectorOutputPort("wrench", 6, self._calc, prerequisites_of_calc=needs)
        self.spatial_force = self.DeclareAbstractOutputPort(
            "spatial_force", lambda: forces(), self._calc_force, prerequisites_of_calc=needs
        )

    def _calc(self, context: Context, output: Any) -> None:
        output.SetFromVector(total_wrench(self._disturbances, context.get_time()))

    def _calc_force(self, context: Context, output: Any) -> None:
        wrench = self.wrench.Eval(context)
        force = ExternallyAppliedSpatialForce()
        force.body_index = self._body
        # The origin of the link `platform` is P.
        force.p_BoBq_B = np.zeros(3)
        force.F_Bq_W = SpatialForce(tau=wrench[:3], f=wrench[3:])
        output.set_value([force])
