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

from stewart_drake.errors import UnreachablePoseError, drake_guard
from stewart_drake.estimator import EncoderOptions
from stewart_drake.plant import StewartPlant, add_plant
from stewart_drake.rigid_body_model import static_torque
from stewart_drake.sampling import on_grid
from stewart_drake.scenario import Scenario
from stewart_drake.systems.ann_tuner import AnnTuner
from stewart_drake.systems.density_features import DensityFeatures
from stewart_drake.systems.lqi_controller import LqiController
from stewart_drake.systems.motor_encoders import MotorEncoders
from stewart_drake.systems.pose_estimator import PoseEstimator
from stewart_drake.systems.reference_source import ReferenceSource
from stewart_drake.systems.task_space_sensor import TaskSpaceSensor
from stewart_drake.systems.ticked import TickedSystem

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat


_System = TypeVar("_System")


class ClosedLoop(Diagram):
    """Plant, sensor, reference, LQI, density features and tuner of one scenario, wired and logged.

    Output ports: plant_state (nq + nv,), measurement (12,), reference (18,), torque (6,), error (6,), integral (6,),
    weights (2,) or (4,), density (12,); with a delay also torque_applied (6,), what reaches the motors.

    Args:
        scenario: The run to build.
        meshcat: A Meshcat to show the run in while it happens, or None.

    Raises:
        ConfigurationError: The tuner's weights file is missing or corrupt.

    Attributes:
        scenario: What it was built from.
        plant: The MultibodyPlant with its indices and `assemble`.
        controller: The LqiController.
        sinks: Signal name -> VectorLogSink.
    """

    def __init__(self, scenario: Scenario, meshcat: Meshcat | None = None) -> None:
        super().__init__()
        self.scenario = scenario
        network = scenario.load_tuner_network()
        period = scenario.controller.period
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

        def parts(name: str, system: TickedSystem, *sizes: int) -> list[OutputPort]:
            """First entries of a result as ports, split in C++: a port of the system's own is a call of Python."""
            rest = system.result.size() - sum(sizes)
            split = add(name, Demultiplexer(output_ports_sizes=[*sizes, rest]))
            builder.Connect(system.result, split.get_input_port())
            return [split.get_output_port(k) for k in range(len(sizes))]

        options, believed = scenario.controller, scenario.believed_robot
        if isinstance(scenario.sensors, EncoderOptions):
            encoders = add("encoders", MotorEncoders(self.plant, scenario.sensors))
            start = scenario.start()[0]
            estimator = add(
                "estimator", PoseEstimator(believed, scenario.sensors, period, start, compiled=options.compiled)
            )
            builder.Connect(self.plant.state_output_port, encoders.plant_state)
            builder.Connect(encoders.angles, estimator.angles)
            (measurement,) = parts("estimate", estimator, 12)
        else:
            sensor = add("sensor", TaskSpaceSensor(self.plant))
            builder.Connect(self.plant.state_output_port, sensor.plant_state)
            measurement = sensor.measurement
        reference = add("reference", ReferenceSource(scenario.reference, scenario.plant.time_step))
        initial = scenario.tuner.weights
        self.controller = add("controller", LqiController(believed, options, scenario.gravity, weights=len(initial)))
        torque, error, integral = parts("command", self.controller, 6, 6, 6)
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

        builder.Connect(measurement, self.controller.measurement)
        builder.Connect(reference.reference, self.controller.reference)
        builder.Connect(weights, self.controller.weights)
        builder.Connect(error, features.error)
        builder.Connect(torque, features.torque)
        # A hold that takes its input in the plant's last step before a tick passes it on from that tick, one period
        # late; taken at a tick, it would be at the motors one step of the plant later. Steps that do not coincide with
        # ticks to the last bit need it taken clear of both.
        applied = torque
        step = on_grid(scenario.plant.time_step)
        ratio = round(self.controller.period / step)
        taken = self.controller.period - (step if ratio * step == self.controller.period else 0.5 * step)
        self._delays = [
            add(f"delay_{k}", ZeroOrderHold(self.controller.period, 6, taken)) for k in range(scenario.command_delay)
        ]
        for hold in self._delays:
            builder.Connect(applied, hold.get_input_port())
            applied = hold.get_output_port()
        builder.Connect(applied, self.plant.torque_input_port)

        ports: dict[str, OutputPort] = {
            "plant_state": self.plant.state_output_port,
            "measurement": measurement,
            "reference": reference.reference,
            "torque": torque,
            "error": error,
            "integral": integral,
            "weights": weights,
            "density": density,
        }
        if self._delays:
            ports["torque_applied"] = applied
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
            # A robot that, as believed, cannot stand there has no such torque: the first tick says so, with a log.
            with contextlib.suppress(UnreachablePoseError, np.linalg.LinAlgError):
                hold_still = static_torque(self.scenario.believed_robot, start, self.scenario.gravity)
                for delay in self._delays:
                    delay.SetVectorState(delay.GetMyMutableContextFromRoot(context), hold_still)
        return context

    def graph(self) -> str:
        """Graphviz text of the diagram, with plain class names."""
        return re.sub(r"stewart_drake\.[a-z_.]+\.(?=[A-Z])", "", self.GetGraphvizString())


def build_diagram(scenario: Scenario, meshcat: Meshcat | None = None) -> ClosedLoop:
    """The closed loop of `scenario` as a Drake Diagram, see `ClosedLoop`.

    Raises:
        ConfigurationError: The tuner's weights file is missing or corrupt.
    """
    return ClosedLoop(scenario, meshcat)
