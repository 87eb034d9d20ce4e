"""The parts of the loop as LeafSystems, to wire by hand; each is a part in the shell of `PartSystem`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from stewart_drake.control.computed_torque import ComputedTorqueOptions, computed_torque_part
from stewart_drake.control.joint_pid import PidOptions, pid_part
from stewart_drake.control.lqi import LqiOptions, lqi_part
from stewart_drake.control.network import DensityKind, TunerNetwork, density_part, network_part
from stewart_drake.errors import ConfigurationError
from stewart_drake.hardware.command_link import LinkOptions, link_part
from stewart_drake.hardware.estimator import difference_part
from stewart_drake.hardware.motors import FrictionCompensation, MotorOptions, friction_part, motor_part
from stewart_drake.hardware.observer import ObserverOptions, observer_part
from stewart_drake.hardware.sensors import EncoderOptions, encoder_part
from stewart_drake.robot import RobotParameters
from stewart_drake.safety import SafetyOptions, safety_part
from stewart_drake.systems.part_system import PartSystem


class LqiController(PartSystem):
    """Linear quadratic integral regulator, (19)-(34): a new gain at every tick, from that tick's pose and weights.

    The torque answers within the tick (no added delay) and is held until the next; see `PartSystem`. z, and what
    bridges a failed tick, live in the Context. The gain comes from Drake's `DiscreteAlgebraicRiccatiEquation`, or with
    `solver: split` from the compiled split solution.

    Args:
        robot: As the controller believes it to be.
        options: See `LqiOptions`.
        gravity: [m/s^2].
        weights: Size of the port: 2, or 4 for block weights.

    Ports:
        measurement: in (12,), pose [rad, m], pose rate [rad/s, m/s].
        reference: in (18,), pose [rad, m], pose rate [rad/s, m/s], pose acceleration [rad/s^2, m/s^2].
        weights: in (2,), omega_Q, omega_R, or (4,), q_e, q_v, q_z, r; all > 0.
        torque: out (6,) [N m], within the motors' limits where `saturation` says so.
        error: out (6,) [rad, m], pose minus reference at the tick.
        integral: out (6,) [rad s, m s], z after the tick.
    """

    def __init__(self, robot: RobotParameters, options: LqiOptions, gravity: float, weights: int = 2) -> None:
        if weights not in (2, 4):
            raise ConfigurationError("weights", weights, "2 or 4")
        super().__init__(lqi_part(options, robot, gravity, weights), options.period)


class DensityFeatures(PartSystem):
    """Density of each input over a sliding window, (35), (36).

    The window lives in the Context: two runs of one Diagram never share it.

    Args:
        window: m of (35) [ticks]; means run over m + 1 samples.
        period: [s] tick period.
        kind: See `density.density`.

    Ports:
        error: in (6,) [rad, m].
        torque: in (6,) [N m].
        density: out (12,) [-], of the errors, then of the torques; answers within the tick.
    """

    def __init__(self, window: int, period: float, kind: DensityKind = "magnitude") -> None:
        super().__init__(density_part(window, kind), period)


class AnnTuner(PartSystem):
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

    Ports:
        density: in (12,) [-].
        weights: out (2,), omega_Q, omega_R.
    """

    def __init__(self, network: TunerNetwork, period: float, initial: Sequence[float] = (1.0, 1.0)) -> None:
        super().__init__(network_part(network, initial), period)


class JointPid(PartSystem):
    """PID in the space of the cranks, see `joint_pid`; ports as of `LqiController`, without weights."""

    def __init__(self, robot: RobotParameters, options: PidOptions, gravity: float) -> None:
        super().__init__(pid_part(options, robot, gravity), options.period)


class ComputedTorque(PartSystem):
    """Computed torque in the space of the platform, see `computed_torque`; ports as of `LqiController`, no weights."""

    def __init__(self, robot: RobotParameters, options: ComputedTorqueOptions, gravity: float) -> None:
        super().__init__(computed_torque_part(options, robot, gravity), options.period)


class MotorEncoders(PartSystem):
    """Crank angles as the encoders read them; faults of `EncoderOptions` are another part. A noise number a tick.

    Ports:
        crank_state: in (12,), angles [rad] and rates [rad/s], see `TaskSpaceSensor`.
        reading: out (6,) [rad], from the horizontal.
    """

    def __init__(self, options: EncoderOptions, period: float) -> None:
        super().__init__(encoder_part(options), period)


class PoseEstimator(PartSystem):
    """Forward kinematics of the encoder readings, and their differences; answers within the tick.

    Args:
        robot: As the controller believes it to be.
        options: See `EncoderOptions`.
        period: [s] tick period.
        pose: (6,) [rad, m] roughly where the platform stands at first; picks the assembly mode.
        pose_rate: (6,) [rad/s, m/s] of a robot that is in motion at the start.

    Ports:
        reading: in (6,) [rad].
        measurement: out (12,), pose [rad, m] then pose rate [rad/s, m/s] (Euler rates).
    """

    def __init__(
        self, robot: RobotParameters, options: EncoderOptions, period: float, *start: Any, **more: Any
    ) -> None:
        super().__init__(difference_part(robot, options, period, *start, **more), period)


class PlatformObserver(PartSystem):
    """State of the platform from readings and the commands that were sent, see `hardware.observer`.

    Args: As of `observer.observer_part`: noise, pose, pose_rate, still; as keywords command_delay, friction and size.

    Ports:
        reading: in (6,) crank angles [rad], or (12,) pose [rad, m] and its rate.
        sent: in (6,) [N m], the command of the tick before less what friction takes of it.
        reference: in (18,), pose [rad, m], pose rate [rad/s, m/s], pose acceleration [rad/s^2, m/s^2].
        disturbance: in (1,) [rad/s^2 per sqrt(s)] to expect, see `ObserverOptions`.
        measurement: out (12,), pose [rad, m] then pose rate [rad/s, m/s] now.
        ahead: out (12,), likewise when the command of this tick acts.
        compensation: out (6,) [N m], against what the model does not explain.
        innovation: out (6,) [rad], readings less what was expected.
    """

    def __init__(
        self, robot: RobotParameters, options: ObserverOptions, gravity: float, period: float, *start: Any, **more: Any
    ) -> None:
        super().__init__(observer_part(robot, options, gravity, period, *start, **more), period)


class FrictionFeedforward(PartSystem):
    """Torque against the motors' friction along the reference.

    Ports:
        reference: in (18,), pose [rad, m], pose rate [rad/s, m/s], pose acceleration [rad/s^2, m/s^2].
        against_friction: out (6,) [N m].
    """

    def __init__(self, robot: RobotParameters, options: FrictionCompensation, period: float) -> None:
        super().__init__(friction_part(robot, options), period)


class CommandLink(PartSystem):
    """Passes a controller's commands on, or loses, delays and spoils them; at every step of the plant.

    Args:
        options: See `LinkOptions`.
        time_step: [s] of the plant.
        steps_per_tick: Steps of the plant in a control period.
        initial: (6,) [N m] command before the first one arrives.

    Ports:
        torque: in (6,) [N m]; the port out of that name is `torque_out`.
        age: out (1,) [ticks] of the command in force; 0 where it is that of the present tick.
    """

    def __init__(self, options: LinkOptions, time_step: float, steps_per_tick: int, initial: np.ndarray) -> None:
        super().__init__(link_part(options, steps_per_tick, initial), time_step)


class MotorDrive(PartSystem):
    """Torque of imperfect motors for the torque asked for, see `MotorOptions`; at every step of the plant.

    Ports:
        torque: in (6,) [N m], asked for; the port out of that name is `torque_out`.
        crank_state: in (12,), angles [rad] and rates [rad/s], see `TaskSpaceSensor`.
    """

    def __init__(self, options: MotorOptions, time_step: float) -> None:
        super().__init__(motor_part(options), time_step)


class SafetyLayer(PartSystem):
    """Watches commands and measurements, and passes on what may go to the motors; answers within the tick.

    Any controller with a torque port runs behind it. A port for which there is no signal may be left alone, and takes
    its array of `safety.NOT_THERE`.

    Args: As of `safety.safety_part`: initial, and as it may be quantum and innovation_scale.

    Ports:
        command: in (6,) [N m], the controller's.
        measurement: in (12,), pose [rad, m], pose rate [rad/s, m/s].
        reference: in (18,), pose [rad, m], pose rate [rad/s, m/s], pose acceleration [rad/s^2, m/s^2].
        age: in (1,) [ticks] of the command.
        sensor_health, controller_health: in (2,), what was wrong in the last tick and where, see `part.guarded`.
        angles: in (6,) [rad], readings of the encoders.
        innovation: in (6,) [rad], of an observer.
        pose_reading: in (12,), what a sensor of the pose says, where an observer stands behind it.
        torque: out (6,) [N m], for the motors.
        safety: out (3,): number of the level in `safety.LEVELS`, of the monitor in `safety.MONITORS`, leg or -1.
    """

    def __init__(
        self, robot: RobotParameters, options: SafetyOptions, gravity: float, period: float, *more: Any, **named: Any
    ) -> None:
        super().__init__(safety_part(robot, options, gravity, period, *more, **named), period)
