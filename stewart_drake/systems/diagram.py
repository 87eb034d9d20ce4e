"""The closed loop of Fig. 6 as one Diagram; the only place that connects its systems (`plant` wires its own parts)."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeVar, cast

import numpy as np
from pydrake.geometry import Meshcat, MeshcatVisualizer
from pydrake.multibody.meshcat import ContactVisualizer
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, OutputPort
from pydrake.systems.primitives import (
    ConstantVectorSource,
    Demultiplexer,
    LogVectorOutput,
    Saturation,
    VectorLogSink,
)

from stewart_drake.base.errors import ConfigurationError, drake_guard
from stewart_drake.base.keys import join_or
from stewart_drake.base.sampling import InBlocks, on_grid, steps_per
from stewart_drake.hardware.motors import limit_torque
from stewart_drake.loop.part import Part
from stewart_drake.plant.multibody_plant import StewartRobot, add_plant
from stewart_drake.plant.plant_options import DrakeOptions
from stewart_drake.scenario.assembly import Source, loop_of
from stewart_drake.scenario.scenario import Scenario, require_scenario
from stewart_drake.systems.library import PlatformWrench, ScenarioInput, TaskSpaceSensor, TimeSource, system_of

_System = TypeVar("_System")


class ClosedLoop(Diagram):
    """Plant, sensors, reference, controller and what else a scenario has; wired and logged.

    Output ports: plant_state (nq + nv,) [rad, rad/s], reading (6,) angles of the cranks [rad], or of a sensor of the
    pose pose_reading (12,), measurement (12,) pose [rad, m] and pose rate [rad/s, m/s], reference (18,) pose, pose rate
    and pose acceleration [rad/s^2, m/s^2], torque (6,) [N m] asked for, torque_applied (6,) [N m] of the motors, error
    (6,) [rad, m], integral (6,) [rad s, m s]; for controllers that take weights weights (2,) or (4,) [-], density (12,)
    [-]; with an observer innovation (6,) [rad]; with disturbances disturbance (6,) [N m, N] about P; with a safety
    layer safety (3,): level, monitor, leg or -1; with motors that take an angle or a current commanded_angle [rad] or
    commanded_current [A] (6,).

    Its default state is the scenario's start: `Simulator(build_diagram(scenario))` begins as `run(scenario)` does; the
    rates come at `Initialize`. `plant.broken_rod` breaks by itself.

    Args:
        scenario: The run to build.
        sparse: Log for `rows`, a row for each step of the plant: what changes at ticks alone is logged at ticks, what
            follows from the time or the plant's state not at all. Else each signal is logged at `scenario.log_period`.
        inputs: Input ports; left alone, a signal is the scenario's. `wrench` (6,) [N m, N] about P is added to its
            disturbances, `reference` (18,) and `weights` (2,) or (4,) take the place of its own.
        outputs: Fields of the parts' records that are exported and logged too: `controller.gain`.
        visuals: Register the geometry with a SceneGraph, `plant.scene_graph`, for visualisers and cameras.
        meshcat: A Meshcat that shows the robot and the forces of contact.
        before_finalize: Adds what else there shall be to the plant, as of `add_plant`.

    Attributes:
        scenario, loop: What it was built from, and its parts.
        plant: The MultibodyPlant with its indices and `assemble`.
        systems, sinks: The System of each part, and the VectorLogSink of each signal, by name.
    """

    def __init__(
        self,
        scenario: Scenario,
        *,
        sparse: bool = False,
        inputs: Sequence[str] = (),
        outputs: Sequence[str] = (),
        visuals: bool = False,
        meshcat: Meshcat | None = None,
        before_finalize: Callable[[StewartRobot], None] | None = None,
    ) -> None:
        super().__init__()
        require_scenario(scenario)
        self.scenario, self.loop = scenario, loop_of(scenario)
        with drake_guard("building the diagram"):
            wiring = _Wiring(scenario, visuals or meshcat is not None, before_finalize)
        for source in self.loop.sources:
            wiring.add_source(source)
        for part in self.loop.parts:
            wiring.add_part(part)
        logged: dict[str, str | np.ndarray] = {**self.loop.logged, **wiring.add_inputs(inputs, self.loop.parts)}
        logged |= {name: _one_of("outputs", name, wiring.signals, ".") for name in outputs}
        wiring.add_push()
        for part in self.loop.parts:
            wiring.connect(part)
        wiring.builder.Connect(wiring.signals[self.loop.torque], wiring.plant.torque_input_port)
        step = on_grid(scenario.plant.time_step if sparse else scenario.effective_log_period)
        self.sinks: dict[str, VectorLogSink] = {}
        self._tables, self._strides, self._logged = wiring.tables, {}, logged
        wiring.signals["plant_state"] = wiring.plant.state_output_port
        for name, signal in {"plant_state": "plant_state", **logged}.items():
            port = wiring.port(name, signal)
            wiring.builder.ExportOutput(port, name)
            if sparse and (not isinstance(signal, str) or signal == "plant_pose" or signal in self._tables):
                continue
            self._strides[name] = wiring.strides.get(str(signal), 1) if sparse else 1
            period = self._strides[name] * step
            self.sinks[name] = LogVectorOutput(port, wiring.builder, publish_period=period)
            self.sinks[name].set_name(f"log_{name}")
        if meshcat is not None:
            MeshcatVisualizer.AddToBuilder(wiring.builder, wiring.plant.scene_graph, meshcat)
            ContactVisualizer.AddToBuilder(wiring.builder, wiring.plant.plant, meshcat)
        with drake_guard("building the diagram"):
            wiring.builder.BuildInto(self)
        wiring.plant.set_default_state(*scenario.start())
        self.set_name(scenario.name)
        self.plant: StewartRobot = wiring.plant
        self.systems = wiring.systems

    def create_start_context(self) -> Context:
        """A Context at the scenario's start, in motion; a default Context gets its rates at `Initialize`."""
        context = self.CreateDefaultContext()
        self.plant.set_state(context, *self.scenario.start())
        return context

    def rows(self, context: Context) -> tuple[int, dict[str, np.ndarray]]:
        """Of a sparse log: how many rows are complete, all that was logged (n, k), and what the plant measures."""
        logs = {name: sink.FindLog(context) for name, sink in self.sinks.items()}
        # A failure can stop a publish halfway.
        count = min(log.num_samples() * self._strides[name] for name, log in logs.items())
        values = {
            name: np.repeat(log.data().T, self._strides[name], axis=0)[:count].copy() for name, log in logs.items()
        }
        values["measured"] = self.plant.measure(values["plant_state"])
        for name, source in self._logged.items():
            if not isinstance(source, str):
                values[name] = np.tile(source, (count, 1))
            elif source in self._tables:
                values[name] = self._tables[source].rows(count)
            elif name not in values:
                values[name] = values["measured"][:, :12]
        return count, values

    def graph(self) -> str:
        """Graphviz text of the diagram, with plain class names."""
        return re.sub(r"stewart_drake\.[a-z_.]+\.(?=[A-Z])", "", self.GetGraphvizString())


def _one_of(key: str, name: str, known: Iterable[str], inside: str = "") -> str:
    """The name, where it is known; of those only that have `inside` in them."""
    if name not in (allowed := sorted(each for each in known if inside in each)):
        raise ConfigurationError(key, name, join_or(allowed))
    return name


class _Wiring:
    """A closed loop under construction: ports by the names of their signals, systems by those of the parts."""

    def __init__(
        self, scenario: Scenario, visuals: bool, before_finalize: Callable[[StewartRobot], None] | None
    ) -> None:
        self.scenario, self.period = scenario, scenario.controller.period
        self.builder = DiagramBuilder()
        if not isinstance(scenario.plant, DrakeOptions):
            raise ConfigurationError("plant.kind", scenario.plant.kind, "drake, for a Diagram")
        self.plant: StewartRobot = add_plant(
            self.builder,
            scenario.robot,
            scenario.plant,
            scenario.gravity,
            visuals=visuals,
            before_finalize=before_finalize,
        )
        sensor = self.add("sensor", TaskSpaceSensor(self.plant))
        self.builder.Connect(self.plant.state_output_port, sensor.plant_state)
        self.signals: dict[str, OutputPort] = {"plant_pose": sensor.measurement, "crank_state": sensor.crank_state}
        self.systems: dict[str, Any] = {}
        self.tables: dict[str, InBlocks] = {}
        # Of signals that change at ticks alone: how many steps of the plant a tick takes.
        self.strides: dict[str, int] = {}

    def add(self, name: str, system: _System) -> _System:
        return cast(_System, self.builder.AddNamedSystem(name, system))

    def add_source(self, source: Source) -> None:
        table = self.tables[source.signal] = InBlocks(source.evaluate, self.scenario.plant.time_step)
        system = self.add(source.signal, TimeSource(source.signal, source.size, table.at_time))
        self.signals[source.signal] = system.get_output_port()

    def add_inputs(self, names: Sequence[str], parts: Sequence[Part]) -> dict[str, str]:
        """Input ports of the Diagram; gives what is logged by them."""
        own: dict[str, Any] = {"wrench": np.zeros(6), "reference": "reference"}
        own |= {port: part.source(port) for part in parts for port in part.inputs if port == "weights"}
        if "reference_ahead" in self.signals:
            del own["reference"]  # Nobody knows what comes.
        for name in dict.fromkeys(names):
            _one_of("inputs", name, own)
            scenario = self.port(f"scenario_{name}", name if name in self.signals else own[name])
            system = self.add(f"{name}_input", ScenarioInput(name, scenario.size(), added=name == "wrench"))
            self.builder.Connect(scenario, system.scenario)
            self.builder.ExportInput(system.outside, name)
            self.signals[name] = system.signal
            self.tables.pop(name, None)
        logged = {"disturbance": "wrench", "reference": "reference", "weights": "weights"}
        return {log: signal for log, signal in logged.items() if signal in names}

    def add_push(self) -> None:
        if "wrench" in self.signals:
            push = self.add("push", PlatformWrench(self.plant))
            self.builder.Connect(self.signals["wrench"], push.wrench)
            self.builder.Connect(push.spatial_force, self.plant.plant.get_applied_spatial_force_input_port())

    def add_part(self, part: Part) -> None:
        """Adds the system of a part; its signals are split in C++, a port of its own would be a call of Python."""
        if part.kernel is limit_torque:
            # Drake has it in C++: at every step of the plant a call of Python costs a tenth of the step.
            limit = part.parameters["limit"]
            saturation = self.systems[part.name] = self.add(part.name, Saturation(-limit, limit))
            self.signals[part.signal("torque")] = saturation.get_output_port()
            self.strides[part.signal("torque")] = self.strides.get(str(part.source("command")), 1)
            return
        if part.system is not None:
            self.systems[part.name] = self.add(part.name, part.system)
            self.signals |= {part.signal(name): part.system.GetOutputPort(name) for name in part.outputs}
            return
        system = system_of(part, self.period)
        self.systems[part.name] = self.add(part.name, system)
        fields = part.initial.dtype.names or ()
        split = self.add(f"{part.name}_outputs", Demultiplexer([part.size(name) for name in fields]))
        self.builder.Connect(system.result, split.get_input_port())
        for place, name in enumerate(fields):
            self.signals[f"{part.name}.{name}"] = split.get_output_port(place)
            if not part.end_of_tick:  # Which shows what it found only after the log of its tick.
                step = self.scenario.plant.time_step
                self.strides[f"{part.name}.{name}"] = steps_per(f"{part.name}.period", system.period, step)
        for output in part.outputs:
            field, signal = f"{part.name}.{output}", part.signal(output)
            self.signals[signal], self.strides[signal] = self.signals[field], self.strides.get(field, 1)

    def connect(self, part: Part) -> None:
        """Connects the inputs of a part."""
        for port in (*part.inputs, *part.replaced):
            source = "weights" if port == "weights" in self.signals else part.source(port)
            # A `PartSystem` has the time and its arrays without a port.
            if part.system is not None or (port != "time" and isinstance(source, str)):
                signal, system = self.port(f"{part.name}_{port}", source), self.systems[part.name]
                only = isinstance(system, Saturation)
                self.builder.Connect(signal, system.get_input_port() if only else system.GetInputPort(port))

    def port(self, name: str, source: str | np.ndarray) -> OutputPort:
        if isinstance(source, str):
            return self.signals[source]
        return self.add(name, ConstantVectorSource(source)).get_output_port()


def build_diagram(scenario: Scenario, **options: Any) -> ClosedLoop:
    """The closed loop of `scenario` as a Drake Diagram; for options as inputs and meshcat see `ClosedLoop`."""
    return ClosedLoop(scenario, **options)
