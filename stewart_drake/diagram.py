"""The closed loop of Fig. 6 as one Diagram; the only place of the package that connects ports."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, TypeVar, cast

from pydrake.systems.framework import Context, Diagram, DiagramBuilder, OutputPort
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput, VectorLogSink

from stewart_drake.errors import drake_guard
from stewart_drake.plant import StewartPlant, add_plant
from stewart_drake.sampling import on_grid
from stewart_drake.scenario import Scenario
from stewart_drake.systems.ann_tuner import AnnTuner
from stewart_drake.systems.density_features import DensityFeatures
from stewart_drake.systems.lqi_controller import LqiController
from stewart_drake.systems.reference_source import ReferenceSource
from stewart_drake.systems.task_space_sensor import TaskSpaceSensor

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat


_System = TypeVar("_System")


class ClosedLoop(Diagram):
    """Plant, sensor, reference, LQI, density features and tuner of one scenario, wired and logged.

    Output ports, each also a system's own port: plant_state (nq + nv,), measurement (12,), reference (18,), torque
    (6,), error (6,), integral (6,), weights (2,), density (12,).

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

        sensor = add("sensor", TaskSpaceSensor(self.plant))
        reference = add("reference", ReferenceSource(scenario.reference))
        self.controller = add(
            "controller", LqiController(scenario.believed_robot, scenario.controller, scenario.gravity)
        )
        density = add("density", DensityFeatures(scenario.tuner.window, period, scenario.tuner.density))
        initial = (scenario.tuner.omega_q, scenario.tuner.omega_r)
        if network is None:
            weights = add("tuner", ConstantVectorSource(initial)).get_output_port()
        else:
            tuner = add("tuner", AnnTuner(network, period, initial))
            builder.Connect(density.density, tuner.density)
            weights = tuner.weights

        builder.Connect(self.plant.state_output_port, sensor.plant_state)
        builder.Connect(sensor.measurement, self.controller.measurement)
        builder.Connect(reference.reference, self.controller.reference)
        builder.Connect(weights, self.controller.weights)
        builder.Connect(self.controller.error, density.error)
        builder.Connect(self.controller.torque, density.torque)
        builder.Connect(self.controller.torque, self.plant.torque_input_port)

        ports: dict[str, OutputPort] = {
            "plant_state": self.plant.state_output_port,
            "measurement": sensor.measurement,
            "reference": reference.reference,
            "torque": self.controller.torque,
            "error": self.controller.error,
            "integral": self.controller.integral,
            "weights": weights,
            "density": density.density,
        }
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
        self.plant.set_state(context, *self.scenario.start())
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
