"""The closed loop of Fig. 6 as one Diagram; the only place of the package that connects ports."""

from __future__ import annotations

import contextlib
import re
from typing import TYPE_CHECKING, TypeVar, cast

import numpy as np
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, OutputPort
from pydrake.systems.primitives import (
    ConstantVectorSource,
    Demultiplexer,
    LogVectorOutput,
    VectorLogSink,
    ZeroOrderHold,
)

from stewart_drake.computed_torque import ComputedTorqueOptions
from stewart_drake.errors import UnreachablePoseError, drake_guard
from stewart_drake.estimator import EncoderOptions
from stewart_drake.joint_pid import PidOptions
from stewart_drake.lqi import LqiOptions
from stewart_drake.plant import StewartPlant, add_plant
from stewart_drake.rigid_body_model import static_torque
from stewart_drake.sampling import on_grid, steps_per
from stewart_drake.scenario import Scenario
from stewart_drake.systems.ann_tuner import AnnTuner
from stewart_drake.systems.command_link import CommandLink
from stewart_drake.systems.computed_torque import ComputedTorque
from stewart_drake.systems.density_features import DensityFeatures
from stewart_drake.systems.faulty_sensor import FaultySensor
from stewart_drake.systems.joint_pid import JointPid
from stewart_drake.systems.lqi_controller import LqiController
from stewart_drake.systems.motor_drive import MotorDrive
from stewart_drake.systems.motor_encoders import MotorEncoders
from stewart_drake.systems.platform_wrench import PlatformWrench
from stewart_drake.systems.pose_estimator import PoseEstimator
from stewart_drake.systems.reference_source import ReferenceSource
from stewart_drake.systems.safety_layer import SafetyLayer
from stewart_drake.systems.task_space_sensor import TaskSpaceSensor
from stewart_drake.systems.ticked import TickedSystem
from stewart_drake.systems.tracking_error import TrackingError
from stewart_drake.systems.user_controller import load_user_controller

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat


_System = TypeVar("_System")


class ClosedLoop(Diagram):
    """Plant, sensor, reference, controller and, where that takes weights, density features and tuner; wired and logged.

    Output ports: plant_state (nq + nv,), measurement (12,), reference (18,), torque (6,), error (6,), integral (6,),
    for controllers that take weights weights (2,) or (4,), density (12,);
    where something stands between controller and motors (delay, link, safety layer, imperfect motors) torque_applied
    (6,), what the motors are given; with disturbances disturbance (6,); with a safety layer safety (3,).

    Args:
        scenario: The run to build.
        meshcat: A Meshcat to show the run in while it happens, or None.

    Raises:
        ConfigurationError: The tuner's weights file is missing or corrupt; a user's controller that cannot be used.

    Attributes:
        scenario: What it was built from.
        plant: The MultibodyPlant with its indices and `assemble`.
        controller: The LqiController, or the System of another kind of controller.
        safety: The SafetyLayer, or None.
        sinks: Signal name -> VectorLogSink.
    """

    def __init__(self, scenario: Scenario, meshcat: Meshcat | None = None) -> None:
        super().__init__()
        self.scenario = scenario
        period = scenario.controller.period
        sampled = on_grid(period)
        builder = DiagramBuilder()

        self.plant: StewartPlant = add_plant(
            builder, scenario.robot, scenario.plant, scenario.gravity, visuals=meshcat is not None
        )
        if meshcat is not None:
            # Half a second to import; only a live view pays it.
            from pydrake.visualization import ApplyVisualizationConfig, VisualizationConfig

            config = VisualizationConfig(publish_contacts=False, enable_alpha_sliders=False)
            ApplyVisualizationConfig(config, builder=builder, meshcat=meshcat)

        def add(name: str, system: _System) -> _System:
            return cast(_System, builder.AddNamedSystem(name, system))

        # Behind a safety layer a tick that fails says so in its result.
        guarded = scenario.safety is not None and scenario.safety.failures
        health: dict[str, OutputPort] = {}

        def parts(name: str, system: TickedSystem, *sizes: int) -> list[OutputPort]:
            """First entries of a result as ports, split in C++: a port of the system's own is a call of Python."""
            rest = system.result.size() - sum(sizes)
            split = add(
                name, Demultiplexer(output_ports_sizes=[*sizes, *([rest - 3, 2, 1] if system.guarded else [rest])])
            )
            builder.Connect(system.result, split.get_input_port())
            if system.guarded:
                health[name] = split.get_output_port(len(sizes) + 1)
            return [split.get_output_port(k) for k in range(len(sizes))]

        def with_faults(reading: OutputPort) -> OutputPort:
            """A reading, by way of a sensor that fails where the scenario asks for one."""
            if not scenario.sensors.faults:
                return reading
            faulty = add("faulty_sensor", FaultySensor(scenario.sensors.faults, reading.size(), period))
            builder.Connect(reading, faulty.reading)
            return parts("reading", faulty, reading.size())[0]

        if scenario.disturbances:
            push = add("push", PlatformWrench(self.plant, scenario.disturbances))
            builder.Connect(push.spatial_force, self.plant.plant.get_applied_spatial_force_input_port())
        options, believed = scenario.controller, scenario.believed_robot
        angles: OutputPort | None = None
        if isinstance(scenario.sensors, EncoderOptions):
            encoders = add("encoders", MotorEncoders(self.plant, scenario.sensors, period, options.compiled))
            start = scenario.start()[0]
            estimator = add(
                "estimator", PoseEstimator(believed, scenario.sensors, period, start, options.compiled, guarded)
            )
            builder.Connect(self.plant.state_output_port, encoders.plant_state)
            angles = with_faults(encoders.angles)
            builder.Connect(angles, estimator.angles)
            (measurement,) = parts("estimate", estimator, 12)
        else:
            sensor = add("sensor", TaskSpaceSensor(self.plant))
            builder.Connect(self.plant.state_output_port, sensor.plant_state)
            measurement = with_faults(sensor.measurement)
        reference = add("reference", ReferenceSource(scenario.reference, scenario.plant.time_step))
        initial = scenario.tuner.weights
        takes_weights = isinstance(options, LqiOptions)
        if isinstance(options, LqiOptions):
            lqi = LqiController(believed, options, scenario.gravity, len(initial), guarded)
            self.controller = add("controller", lqi)
            torque, error, integral = parts("command", lqi, 6, 6, 6)
        elif isinstance(options, ComputedTorqueOptions):
            computed_torque = ComputedTorque(believed, options, scenario.gravity)
            self.controller = add("controller", computed_torque)
            torque, error, integral = parts("command", computed_torque, 6, 6, 6)
        else:
            if isinstance(options, PidOptions):
                pid = JointPid(believed, options, scenario.gravity)
                self.controller = add("controller", pid)
                (torque,) = parts("command", pid, 6)
            else:
                user = load_user_controller(options, believed, scenario.gravity, weights=len(initial))
                self.controller = add("controller", user)
                torque, takes_weights = user.GetOutputPort("torque"), user.HasInputPort("weights")
            if self.controller.HasOutputPort("error"):
                error, integral = (self.controller.GetOutputPort(name) for name in ("error", "integral"))
            else:
                errors = add("tracking_error", TrackingError(period))
                builder.Connect(measurement, errors.measurement)
                builder.Connect(reference.reference, errors.reference)
                error, integral = parts("errors", errors, 6, 6)
        tuning: dict[str, OutputPort] = {}
        if takes_weights:
            network = scenario.load_tuner_network()
            features = add(
                "density", DensityFeatures(scenario.tuner.window, period, scenario.tuner.density, options.compiled)
            )
            (density,) = parts("densities", features, 12)
            if network is None:
                weights = add("tuner", ConstantVectorSource(initial)).get_output_port()
            else:
                tuner = add("tuner", AnnTuner(network, period, initial, options.compiled))
                builder.Connect(density, tuner.density)
                weights = tuner.weights
            builder.Connect(weights, self.controller.GetInputPort("weights"))
            builder.Connect(error, features.error)
            builder.Connect(torque, features.torque)
            tuning = {"weights": weights, "density": density}

        builder.Connect(measurement, self.controller.GetInputPort("measurement"))
        builder.Connect(reference.reference, self.controller.GetInputPort("reference"))
        # A hold that takes its input in the plant's last step before a tick passes it on from that tick, one period
        # late; taken at a tick, it would be at the motors one step of the plant later. Steps that do not coincide with
        # ticks to the last bit need it taken clear of both.
        applied = torque
        step = on_grid(scenario.plant.time_step)
        ratio = round(sampled / step)
        taken = sampled - (step if ratio * step == sampled else 0.5 * step)
        self._delays = [add(f"delay_{k}", ZeroOrderHold(sampled, 6, taken)) for k in range(scenario.command_delay)]
        for hold in self._delays:
            builder.Connect(applied, hold.get_input_port())
            applied = hold.get_output_port()
        age: OutputPort | None = None
        if not scenario.link.perfect:
            steps = steps_per("controller.period", period, scenario.plant.time_step)
            link = add("link", CommandLink(scenario.link, scenario.plant.time_step, steps, _standing_torque(scenario)))
            builder.Connect(applied, link.torque)
            applied, age = parts("arrived", link, 6, 1)
        self.safety: SafetyLayer | None = None
        if scenario.safety is not None:
            still = _standing_torque(scenario)
            quantum = scenario.sensors.quantum if isinstance(scenario.sensors, EncoderOptions) else 0.0
            self.safety = add(
                "safety",
                SafetyLayer(believed, scenario.safety, scenario.gravity, period, still, options.compiled, quantum),
            )
            builder.Connect(applied, self.safety.command)
            builder.Connect(measurement, self.safety.measurement)
            builder.Connect(reference.reference, self.safety.reference)
            if angles is not None:
                builder.Connect(angles, self.safety.angles)
            if age is not None:
                builder.Connect(age, self.safety.age)
            for name, port in (("estimate", self.safety.sensor_health), ("command", self.safety.controller_health)):
                if name in health:
                    builder.Connect(health[name], port)
            applied, safety_state = parts("guarded", self.safety, 6, 3)
        if not scenario.motors.perfect:
            drive = add("drive", MotorDrive(self.plant, scenario.motors))
            builder.Connect(applied, drive.torque)
            builder.Connect(self.plant.state_output_port, drive.plant_state)
            applied = drive.torque_applied
        builder.Connect(applied, self.plant.torque_input_port)

        ports: dict[str, OutputPort] = {
            "plant_state": self.plant.state_output_port,
            "measurement": measurement,
            "reference": reference.reference,
            "torque": torque,
            "error": error,
            "integral": integral,
            **tuning,
        }
        if applied is not torque:
            ports["torque_applied"] = applied
        if self.safety is not None:
            ports["safety"] = safety_state
        if scenario.disturbances:
            ports["disturbance"] = push.wrench
        log_period = on_grid(scenario.effective_log_period)
        self.sinks: dict[str, VectorLogSink] = {}
        for name, port in ports.items():
            builder.ExportOutput(port, name)
            self.sinks[name] = LogVectorOutput(port, builder, publish_period=log_period)
            self.sinks[name].set_name(f"log_{name}")
        with drake_guard("building the diagram"):
            builder.BuildInto(self)
        self.set_name(scenario.name)

    def create_start_context(self) -> Context:
        """A Context assembled at the scenario's start: the reference's pose (plus the offset) and velocity.

        A default Context stands at the home pose, at rest.

        Raises:
            UnreachablePoseError: The start pose cannot be assembled.
        """
        context = self.CreateDefaultContext()
        start, rate = self.scenario.start()
        self.plant.set_state(context, start, rate)
        if self._delays:
            hold_still = _standing_torque(self.scenario)
            for delay in self._delays:
                delay.SetVectorState(delay.GetMyMutableContextFromRoot(context), hold_still)
        return context

    def graph(self) -> str:
        """Graphviz text of the diagram, with plain class names."""
        return re.sub(r"stewart_drake\.[a-z_.]+\.(?=[A-Z])", "", self.GetGraphvizString())


def _standing_torque(scenario: Scenario) -> np.ndarray:
    """Torques (6,) that hold the robot, as believed, at the start pose; zeros where it cannot stand there."""
    # In that case the first tick says so, with a log.
    with contextlib.suppress(UnreachablePoseError, np.linalg.LinAlgError):
        return static_torque(scenario.believed_robot, scenario.start()[0], scenario.gravity)
    return np.zeros(6)


def build_diagram(scenario: Scenario, meshcat: Meshcat | None = None) -> ClosedLoop:
    """The closed loop of `scenario` as a Drake Diagram, see `ClosedLoop`.

    Raises:
        ConfigurationError: The tuner's weights file is missing or corrupt.
    """
    return ClosedLoop(scenario, meshcat)
