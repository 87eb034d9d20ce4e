"""The closed loop of Fig. 6 as one Diagram: connects plant, sources and parts by the names of their signals."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeVar, cast

import numpy as np
from pydrake.geometry import Meshcat, MeshcatVisualizer
from pydrake.multibody.meshcat import ContactVisualizer
from pydrake.multibody.plant import ExternallyAppliedSpatialForceMultiplexer
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, InputPort, OutputPort, System
from pydrake.systems.primitives import (
    ConstantVectorSource,
    Demultiplexer,
    LogVectorOutput,
    Saturation,
    VectorLogSink,
)

from stewart_drake.base.arguments import checked
from stewart_drake.base.atomic_files import Document
from stewart_drake.base.errors import ConfigurationError, drake_guard
from stewart_drake.base.keys import join_or
from stewart_drake.base.sampling import InBlocks, on_grid, steps_per
from stewart_drake.hardware.motors import limit_torque
from stewart_drake.loop.part import Part
from stewart_drake.plant.base_forces import BaseForces
from stewart_drake.plant.drake_ball import BallForces
from stewart_drake.plant.multibody_plant import StewartRobot, add_plant
from stewart_drake.plant.plant_options import DrakeOptions
from stewart_drake.plant.servo_friction import connect_besides
from stewart_drake.robot.gravity import same_gravity
from stewart_drake.scenario.assembly import loop_of
from stewart_drake.scenario.control_side import Source
from stewart_drake.scenario.scenario import Scenario
from stewart_drake.systems.library import PlatformWrench, ScenarioInput, TaskSpaceSensor, TimeSource, system_of

_System = TypeVar("_System")


class ClosedLoop(Diagram):
    """The plant and all parts of a scenario, connected and logged.

    Output ports: plant_state (nq + nv,) [rad, rad/s], reading (6,) angles of the cranks [rad], or of a sensor of the
    pose pose_reading (12,), measurement (12,) pose [rad, m] and pose rate [rad/s, m/s], reference (18,) pose, pose rate
    and pose acceleration [rad/s^2, m/s^2], torque (6,) [N m] commanded, torque_applied (6,) [N m] of the motors, error
    (6,) [rad, m], integral (6,) [rad s, m s]. Some scenarios have more ports. If the controller takes weights: weights
    (2,) or (4,) [-] and density (12,) [-]. With an observer: innovation (6,) [rad]. With disturbances: disturbance (6,)
    [N m, N] about P. With a safety layer: safety (3,), which is level, monitor, leg or -1. With motors that take angles
    or currents: commanded_angle [rad] or commanded_current [A] (6,).

    The default state of the Diagram is the start of the scenario, so `Simulator(build_diagram(scenario))` begins as
    `run(scenario)` does. The initial rates are set by `Simulator.Initialize`, and a rod breaks at the time of
    `plant.broken_rod`.

    Args:
        scenario: The run to build.
        sparse: False logs all signals at `scenario.log_period`. True logs for `rows`, as little as possible: signals
            that change only at ticks are logged at ticks, and functions of time or of the plant's state are not logged.
        inputs: Names of input ports. `wrench` (6,) [N m, N] about P is added to the disturbances of the scenario;
            `reference` (18,) and `weights` (2,) or (4,) replace its signals. A port without a connection has no effect.
        outputs: Fields of the parts' records to export and log as well, such as `controller.gain`.
        visuals: Register the geometry with a SceneGraph, `plant.scene_graph`, for visualisers and cameras.
        meshcat: A Meshcat that shows the robot and the forces of contact.
        before_finalize: Adds further bodies to the plant, see `add_plant`.

    Attributes:
        scenario, loop: The scenario, and its parts.
        plant: The MultibodyPlant with its indices and `assemble`.
        systems, sinks: Systems of the parts and VectorLogSinks of the signals, by name.
    """

    @checked
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
        if not isinstance(scenario.plant, DrakeOptions):
            raise ConfigurationError("plant.kind", scenario.plant.kind, "drake, for a Diagram")
        builder, shown = DiagramBuilder(), visuals or meshcat is not None
        truth = scenario.robot, scenario.plant, scenario.gravity_in_base
        more: Document = {"visuals": shown, "before_finalize": before_finalize, "ball": scenario.ball}
        self.plant: StewartRobot = add_plant(builder, *truth, **more)
        added = add_loop(builder, scenario, self.plant, inputs=inputs, outputs=outputs)
        self.scenario, self.loop, self.systems = scenario, added.loop, added.systems
        for name, entrance in added.inputs.items():
            builder.ExportInput(entrance, name)
        step = on_grid(scenario.plant.time_step if sparse else scenario.effective_log_period)
        self.sinks: dict[str, VectorLogSink] = {}
        self._tables, self._logged, self._strides = added.tables, added.logged, dict[str, int]()
        for name, port in {"plant_state": self.plant.state_output_port, **added.outputs}.items():
            builder.ExportOutput(port, name)
            signal = added.logged.get(name, name)
            if sparse and (not isinstance(signal, str) or signal == "plant_pose" or signal in added.tables):
                continue
            self._strides[name] = added.strides.get(str(signal), 1) if sparse else 1
            period = self._strides[name] * step
            self.sinks[name] = LogVectorOutput(port, builder, publish_period=period)
            self.sinks[name].set_name(f"log_{name}")
        if meshcat is not None:
            MeshcatVisualizer.AddToBuilder(builder, self.plant.scene_graph, meshcat)
            ContactVisualizer.AddToBuilder(builder, self.plant.plant, meshcat)
        with drake_guard("building the diagram"):
            builder.BuildInto(self)
        self.set_name(scenario.name)

    def rows(self, context: Context) -> tuple[int, dict[str, np.ndarray]]:
        """All signals (n, k) of a sparse log, with n rows, one per step of the plant; returns n and the signals.

        `measured` is the measurement of the plant, see `plant_options.POSE`.
        """
        with drake_guard("reading the logs"):
            logs = {name: sink.FindLog(context) for name, sink in self.sinks.items()}
        # After a failure, some logs can have a row less than others.
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
    """Returns the name; a ConfigurationError if it is not one of the known names that contain `inside`."""
    if name not in (allowed := sorted(other for other in known if inside in other)):
        raise ConfigurationError(key, name, join_or(allowed))
    return name


class LoopSystems:
    """Adds all systems of a scenario except the plant to a DiagramBuilder, and connects them to a robot.

    The plant exists already and is finalised, so its options and its gravity replace those of the scenario. The start
    of the scenario becomes the default state of the robot: a Simulator on the Diagram begins as `run(scenario)` does.

    Args:
        builder: Receives the systems; also those of the motors' stiction, if it does not have them yet.
        scenario: A scenario with the same robot.
        robot: The robot, from `add_robot` or `add_plant`.
        inputs: See `ClosedLoop`.
        outputs: See `ClosedLoop`.
        name: Prefix of the systems' names, needed for several loops in one Diagram.

    Attributes:
        scenario: The scenario, with options and gravity of the plant.
        loop: Its parts.
        systems: Systems of the parts, by name.
        inputs, outputs: Ports by name; the outputs are those of `ClosedLoop` except `plant_state`.
        logged: Signal, or constant, of every output.
        tables: Functions of time, by signal.
        strides: Number of the plant's steps in a tick, for signals that change only at ticks.

    Raises:
        ConfigurationError: The robot differs from the scenario's or has a loop already; a period is not a multiple of
            the plant's step; a name is taken.
    """

    @checked
    def __init__(
        self,
        builder: DiagramBuilder,
        scenario: Scenario,
        robot: StewartRobot,
        *,
        inputs: Sequence[str] = (),
        outputs: Sequence[str] = (),
        name: str = "",
    ) -> None:
        if scenario.robot != robot.robot:
            expected, given = scenario.robot.to_dict(), robot.robot.to_dict()
            others = ", ".join(key for key in expected if expected[key] != given[key])
            raise ConfigurationError("scenario.robot", f"another {others}", "the robot of the plant")
        if scenario.ball != (None if robot.ball is None else robot.ball.options):
            raise ConfigurationError("scenario.ball", scenario.ball, "that of the robot: add_plant(..., ball=...)")
        if scenario.plant != robot.options or not same_gravity(scenario.gravity_in_base, robot.gravity):
            turned = {"base.orientation": (0.0, 0.0, 0.0)} if any(scenario.base.orientation) else {}
            scenario = scenario.replace({"plant": robot.options, "gravity": robot.gravity, **turned})
        self.scenario, self.loop = scenario, loop_of(scenario)
        self._builder, self._prefix = builder, f"{name}_" if name else ""
        self.systems: dict[str, System] = {}
        self.inputs: dict[str, InputPort] = {}
        self.tables: dict[str, InBlocks] = {}
        self.strides: dict[str, int] = {}
        with drake_guard("wiring the loop"):
            self._wire(robot, inputs, outputs)
            robot.set_default_state(*scenario.start())

    def _wire(self, robot: StewartRobot, inputs: Sequence[str], outputs: Sequence[str]) -> None:
        builder = self._builder
        robot.connect_friction(builder)
        if builder.IsConnectedOrExported(robot.torque_input_port):
            raise ConfigurationError("robot", "one whose torques are connected already", "a robot for each loop")
        sensor = self._add("sensor", TaskSpaceSensor(robot))
        builder.Connect(robot.state_output_port, sensor.plant_state)
        self._signals: dict[str, OutputPort] = {"plant_pose": sensor.measurement, "crank_state": sensor.crank_state}
        if robot.ball is not None:
            self._signals["ball"] = sensor.ball
        for source in self.loop.sources:
            self._add_source(source)
        for part in self.loop.parts:
            self._add_part(part)
        self.logged: dict[str, str | np.ndarray] = {**self.loop.logged, **self._add_inputs(inputs)}
        self.logged |= {output: _one_of("outputs", output, self._signals, ".") for output in outputs}
        if "wrench" in self._signals:
            push = self._add("push", PlatformWrench(robot))
            builder.Connect(self._signals["wrench"], push.wrench)
            self._apply(robot, push.spatial_force)
        if "ball_push" in self._signals:
            rolling = self._add("ball_forces", BallForces(robot))
            builder.Connect(robot.state_output_port, rolling.plant_state)
            builder.Connect(self._signals["ball_push"], rolling.ball_push)
            self._apply(robot, rolling.spatial_force)
        if "base" in self._signals:
            moved = self._add("base_forces", BaseForces(robot))
            builder.Connect(robot.state_output_port, moved.plant_state)
            builder.Connect(self._signals["base"], moved.base)
            self._apply(robot, moved.spatial_force)
        for part in self.loop.parts:
            self._connect(part)
        builder.Connect(self._signals[self.loop.torque], robot.torque_input_port)
        self.outputs = {output: self._port(output, signal) for output, signal in self.logged.items()}

    def _apply(self, robot: StewartRobot, forces: OutputPort) -> None:
        both = ExternallyAppliedSpatialForceMultiplexer(2)
        connect_besides(self._builder, forces, robot.plant.get_applied_spatial_force_input_port(), both)

    def _add(self, name: str, system: _System) -> _System:
        name = f"{self._prefix}{name}"
        if self._builder.HasSubsystemNamed(name):
            raise ConfigurationError("name", self._prefix[:-1], f"another one; the Diagram has a system {name} already")
        return cast(_System, self._builder.AddNamedSystem(name, system))

    def _add_source(self, source: Source) -> None:
        table = self.tables[source.signal] = InBlocks(source.evaluate, self.scenario.plant.time_step)
        system = self._add(source.signal, TimeSource(source.signal, source.size, table.at_time))
        self._signals[source.signal] = system.get_output_port()

    def _add_inputs(self, names: Sequence[str]) -> dict[str, str]:
        """Adds input ports; returns the logged signals that they replace."""
        sources: dict[str, str | np.ndarray] = {"wrench": np.zeros(6), "reference": "reference"}
        sources |= {port: part.source(port) for part in self.loop.parts for port in part.inputs if port == "weights"}
        if "reference_ahead" in self._signals:
            del sources["reference"]  # Some part needs the future reference, which an input port cannot give.
        for name in dict.fromkeys(names):
            _one_of("inputs", name, sources)
            scenario = self._port(f"scenario_{name}", name if name in self._signals else sources[name])
            system = self._add(f"{name}_input", ScenarioInput(name, scenario.size(), added=name == "wrench"))
            self._builder.Connect(scenario, system.scenario)
            self.inputs[name] = system.outside
            self._signals[name] = system.signal
            self.tables.pop(name, None)
        logged = {"disturbance": "wrench", "reference": "reference", "weights": "weights"}
        return {log: signal for log, signal in logged.items() if signal in names}

    def _add_part(self, part: Part) -> None:
        """Adds the system of a part. A Demultiplexer in C++ splits its output into signals: no further Python calls."""
        if part.kernel is limit_torque:
            # Drake's Saturation in C++: a Python call at every step of the plant would cost a tenth of the step.
            limit = part.parameters["limit"]
            saturation = self.systems[part.name] = self._add(part.name, Saturation(-limit, limit))
            self._signals[part.signal("torque")] = saturation.get_output_port()
            self.strides[part.signal("torque")] = self.strides.get(str(part.source("command")), 1)
            return
        if part.system is not None:
            self.systems[part.name] = self._add(part.name, part.system)
            self._signals |= {part.signal(name): part.system.GetOutputPort(name) for name in part.outputs}
            return
        system = system_of(part, self.scenario.controller.period)
        self.systems[part.name] = self._add(part.name, system)
        fields = part.initial.dtype.names or ()
        split = self._add(f"{part.name}_outputs", Demultiplexer([part.size(name) for name in fields]))
        self._builder.Connect(system.result, split.get_input_port())
        for place, name in enumerate(fields):
            self._signals[f"{part.name}.{name}"] = split.get_output_port(place)
            if not part.end_of_tick:  # Such a part updates its outputs only after the log has taken the tick's row.
                step = self.scenario.plant.time_step
                self.strides[f"{part.name}.{name}"] = steps_per(f"{part.name}.period", system.period, step)
        for output in part.outputs:
            field, signal = f"{part.name}.{output}", part.signal(output)
            self._signals[signal], self.strides[signal] = self._signals[field], self.strides.get(field, 1)

    def _connect(self, part: Part) -> None:
        """Connects the inputs of a part."""
        if "weights" in self._signals:
            part = part.connected(weights="weights")
        for port in (*part.inputs, *part.replaced):
            source = part.source(port)
            # A `PartSystem` has no ports for the time and for constant arrays.
            if part.system is not None or (port != "time" and isinstance(source, str)):
                if isinstance(source, str):
                    signal = part.signal_in(self._signals, port)
                else:
                    signal = self._port(f"{part.name}_{port}", source)
                system = self.systems[part.name]
                has_one = isinstance(system, Saturation)
                self._builder.Connect(signal, system.get_input_port() if has_one else system.GetInputPort(port))

    def _port(self, name: str, source: str | np.ndarray) -> OutputPort:
        if isinstance(source, str):
            return self._signals[source]
        return self._add(name, ConstantVectorSource(source)).get_output_port()


def add_loop(builder: DiagramBuilder, scenario: Scenario, robot: StewartRobot, **options: Any) -> LoopSystems:
    """Adds the loop of `scenario` around a robot in a plant of yours; for options such as `name` see `LoopSystems`."""
    return LoopSystems(builder, scenario, robot, **options)


def build_diagram(scenario: Scenario, **options: Any) -> ClosedLoop:
    """The closed loop of `scenario` as a Drake Diagram; for options such as `meshcat` see `ClosedLoop`."""
    return ClosedLoop(scenario, **options)
