"""The closed loop of Fig. 6 as one Diagram; the only place that connects its systems (`plant` wires its own parts)."""

from __future__ import annotations

import re
from typing import Any, TypeVar, cast

import numpy as np
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, OutputPort
from pydrake.systems.primitives import (
    ConstantVectorSource,
    Demultiplexer,
    LogVectorOutput,
    Saturation,
    VectorLogSink,
)

from stewart_drake.base.errors import ConfigurationError, drake_guard
from stewart_drake.base.sampling import InBlocks, on_grid, steps_per
from stewart_drake.hardware.motors import limit_torque
from stewart_drake.loop.part import Part
from stewart_drake.plant.multibody_plant import StewartRobot, add_plant
from stewart_drake.plant.plant_options import DrakeOptions
from stewart_drake.scenario.assembly import Source, loop_of
from stewart_drake.scenario.scenario import Scenario, require_scenario
from stewart_drake.systems.library import PartSystem, PlatformWrench, TaskSpaceSensor, TimeSource

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

    Args:
        scenario: The run to build.
        sparse: Log for `rows`, a row for each step of the plant: what changes at ticks alone is logged at ticks, what
            follows from the time or the plant's state not at all. Else each signal is logged at `scenario.log_period`.

    Attributes:
        scenario, loop: What it was built from, and its parts.
        plant: The MultibodyPlant with its indices and `assemble`.
        systems, sinks: The System of each part, and the VectorLogSink of each signal, by name.
    """

    def __init__(self, scenario: Scenario, sparse: bool = False) -> None:
        super().__init__()
        require_scenario(scenario)
        self.scenario, self.loop = scenario, loop_of(scenario)
        wiring = _Wiring(scenario)
        for source in self.loop.sources:
            wiring.add_source(source)
        for part in self.loop.parts:
            wiring.add_part(part)
        for part in self.loop.parts:
            wiring.connect(part)
        wiring.builder.Connect(wiring.signals[self.loop.torque], wiring.plant.torque_input_port)
        step = on_grid(scenario.plant.time_step if sparse else scenario.effective_log_period)
        self.sinks: dict[str, VectorLogSink] = {}
        self._tables, self._strides = wiring.tables, {}
        wiring.signals["plant_state"] = wiring.plant.state_output_port
        for name, signal in {"plant_state": "plant_state", **self.loop.logged}.items():
            port = wiring.port(name, signal)
            wiring.builder.ExportOutput(port, name)
            if sparse and (not isinstance(signal, str) or signal == "plant_pose" or signal in self._tables):
                continue
            self._strides[name] = wiring.strides.get(str(signal), 1) if sparse else 1
            period = self._strides[name] * step
            self.sinks[name] = LogVectorOutput(port, wiring.builder, publish_period=period)
            self.sinks[name].set_name(f"log_{name}")
        with drake_guard("building the diagram"):
            wiring.builder.BuildInto(self)
        self.set_name(scenario.name)
        self.plant: StewartRobot = wiring.plant
        self.systems = wiring.systems

    def create_start_context(self) -> Context:
        """A Context at the scenario's start, in motion; a default Context is at home, at rest."""
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
        for name, source in self.loop.logged.items():
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


class _Wiring:
    """A closed loop under construction: ports by the names of their signals, systems by those of the parts."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario, self.period = scenario, scenario.controller.period
        self.builder = DiagramBuilder()
        if not isinstance(scenario.plant, DrakeOptions):
            raise ConfigurationError("plant.kind", scenario.plant.kind, "drake, for a Diagram")
        self.plant: StewartRobot = add_plant(self.builder, scenario.robot, scenario.plant, scenario.gravity)
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
        signal = self.add(source.signal, TimeSource(source.signal, source.size, table.at_time)).get_output_port()
        self.signals[source.signal] = signal
        if source.signal == "wrench":
            push = self.add("push", PlatformWrench(self.plant))
            self.builder.Connect(signal, push.wrench)
            self.builder.Connect(push.spatial_force, self.plant.plant.get_applied_spatial_force_input_port())

    def add_part(self, part: Part) -> None:
        """Adds the system of a part; its signals are split in C++, a port of its own would be a call of Python."""
        if part.kernel is limit_torque:
            # Drake has it in C++: at every step of the plant a call of Python costs a tenth of the step.
            limit = part.constants["limit"]
            saturation = self.systems[part.name] = self.add(part.name, Saturation(-limit, limit))
            self.signals[part.signal("torque")] = saturation.get_output_port()
            self.strides[part.signal("torque")] = self.strides.get(str(part.source("command")), 1)
            return
        if part.system is not None:
            self.systems[part.name] = self.add(part.name, part.system)
            self.signals |= {part.signal(name): part.system.GetOutputPort(name) for name in part.outputs}
            return
        system = PartSystem(part, self.period)
        self.systems[part.name] = self.add(part.name, system)
        sizes, places = system.split()
        split = self.add(f"{part.name}_outputs", Demultiplexer(sizes))
        self.builder.Connect(system.result, split.get_input_port())
        for output, place in zip(part.outputs, places, strict=True):
            self.signals[part.signal(output)] = split.get_output_port(place)
            if not part.end_of_tick:  # Which shows what it found only after the log of its tick.
                step = self.scenario.plant.time_step
                self.strides[part.signal(output)] = steps_per(f"{part.name}.period", system.period, step)

    def connect(self, part: Part) -> None:
        """Connects the inputs of a part."""
        for port in (*part.inputs, *part.replaced):
            source = part.source(port)
            # A `PartSystem` has the time and its arrays without a port.
            if part.system is not None or (port != "time" and isinstance(source, str)):
                signal, system = self.port(f"{part.name}_{port}", source), self.systems[part.name]
                only = isinstance(system, Saturation)
                self.builder.Connect(signal, system.get_input_port() if only else system.GetInputPort(port))

    def port(self, name: str, source: str | np.ndarray) -> OutputPort:
        if isinstance(source, str):
            return self.signals[source]
        return self.add(name, ConstantVectorSource(source)).get_output_port()


def build_diagram(scenario: Scenario) -> ClosedLoop:
    """The closed loop of `scenario` as a Drake Diagram, see `ClosedLoop`."""
    return ClosedLoop(scenario)
