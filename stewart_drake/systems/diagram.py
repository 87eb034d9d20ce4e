"""The closed loop of Fig. 6 as one Diagram; the only place that connects its systems (`plant` wires its own parts)."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TypeVar, cast

from pydrake.systems.framework import Context, Diagram, DiagramBuilder, InputPort, OutputPort
from pydrake.systems.primitives import (
    Adder,
    ConstantVectorSource,
    Demultiplexer,
    Gain,
    LogVectorOutput,
    Saturation,
    VectorLogSink,
    ZeroOrderHold,
)

from stewart_drake.control.parts import ControllerSite
from stewart_drake.errors import drake_guard
from stewart_drake.hardware.sensing import LoopSite
from stewart_drake.plant.multibody_plant import StewartPlant, add_plant
from stewart_drake.registry import CONTROLLERS, ESTIMATORS, SENSORS, TUNERS
from stewart_drake.sampling import on_grid, steps_per
from stewart_drake.scenario import Scenario, require_scenario
from stewart_drake.systems.command_link import CommandLink
from stewart_drake.systems.density_features import DensityFeatures
from stewart_drake.systems.faulty_sensor import FaultySensor
from stewart_drake.systems.finite_check import FiniteCheck
from stewart_drake.systems.friction_feedforward import FrictionFeedforward
from stewart_drake.systems.motor_drive import MotorDrive
from stewart_drake.systems.platform_wrench import PlatformWrench
from stewart_drake.systems.reference_source import ReferenceSource
from stewart_drake.systems.safety_layer import SafetyLayer
from stewart_drake.systems.ticked import TickedSystem
from stewart_drake.systems.tracking_error import TrackingError

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat


_System = TypeVar("_System")


class ClosedLoop(Diagram):
    """Plant, sensor, reference, controller and, where that takes weights, density features and tuner; wired and logged.

    Output ports: plant_state (nq + nv,) [rad, rad/s], measurement (12,) pose [rad, m] and pose rate [rad/s, m/s],
    reference (18,) pose, pose rate and pose acceleration [rad/s^2, m/s^2], torque (6,) [N m], error (6,) [rad, m],
    integral (6,) [rad s, m s]; for controllers that take weights weights (2,) or (4,) [-], density (12,) [-]; where
    something stands between controller and motors (delay, link, safety layer, imperfect motors) torque_applied (6,)
    [N m], what the motors are given; with disturbances disturbance (6,) [N m, N] about P; with a safety layer safety
    (3,): numbers of level and monitor, leg or -1.

    Args:
        scenario: The run to build.
        meshcat: A Meshcat to show the run in while it happens, or None.
        log_period: [s] between two rows of the sinks; None takes that of the scenario.

    Raises:
        ConfigurationError: The tuner's weights file is missing or corrupt; a user's controller that cannot be used.
        TypeError: Something else than a Scenario.

    Attributes:
        scenario: What it was built from.
        plant: The MultibodyPlant with its indices and `assemble`.
        controller: The LqiController, or the System of another kind of controller.
        safety: The SafetyLayer, or None.
        sinks: Signal name -> VectorLogSink.
    """

    def __init__(self, scenario: Scenario, meshcat: Meshcat | None = None, log_period: float | None = None) -> None:
        super().__init__()
        require_scenario(scenario)
        self.scenario = scenario
        wiring = _Wiring(scenario, meshcat)
        wiring.add_disturbances()
        wiring.add_reference()
        wiring.add_sensors()
        wiring.add_controller()
        wiring.add_compensation()
        wiring.add_tuner()
        wiring.add_level()
        wiring.add_delay_and_link()
        wiring.add_safety()
        wiring.add_motors()
        self.sinks = wiring.add_log(scenario.effective_log_period if log_period is None else log_period)
        with drake_guard("building the diagram"):
            wiring.builder.BuildInto(self)
        self.set_name(scenario.name)
        self.plant = wiring.plant
        self.controller = wiring.controller
        self.safety = wiring.safety
        self._holds, self._still = wiring.holds, wiring.still

    def create_start_context(self) -> Context:
        """A Context assembled at the scenario's start: the reference's pose (plus the offset) and velocity.

        A default Context stands at the home pose, at rest.

        Raises:
            UnreachablePoseError: The start pose cannot be assembled.
        """
        context = self.CreateDefaultContext()
        start, rate = self.scenario.start()
        self.plant.set_state(context, start, rate)
        for hold in self._holds:
            hold.SetVectorState(hold.GetMyMutableContextFromRoot(context), self._still)
        return context

    def graph(self) -> str:
        """Graphviz text of the diagram, with plain class names."""
        return re.sub(r"stewart_drake\.[a-z_.]+\.(?=[A-Z])", "", self.GetGraphvizString())


class _Wiring:
    """A closed loop under construction. The steps are taken in the order in which signals run.

    Attributes:
        signals: Exported and logged so far, by name.
        command: Torques as far as they have come on their way to the motors.
        health: What guarded systems say of their last tick, by name.
    """

    controller: Any
    command: OutputPort

    def __init__(self, scenario: Scenario, meshcat: Meshcat | None) -> None:
        self.scenario, self.believed = scenario, scenario.believed_robot
        self.options, self.period = scenario.controller, scenario.controller.period
        self.builder = DiagramBuilder()
        self.plant: StewartPlant = add_plant(
            self.builder,
            scenario.robot,
            scenario.plant,
            scenario.gravity,
            visuals=meshcat is not None,
            compiled=scenario.compiled,
        )
        if meshcat is not None:
            # Half a second to import; only a live view pays it.
            from pydrake.visualization import ApplyVisualizationConfig, VisualizationConfig

            config = VisualizationConfig(publish_contacts=False, enable_alpha_sliders=False)
            ApplyVisualizationConfig(config, builder=self.builder, meshcat=meshcat)
        self.signals: dict[str, OutputPort] = {"plant_state": self.plant.state_output_port}
        # Behind a safety layer a tick that fails says so in its result.
        self.site = LoopSite.of(scenario)
        self.guarded = self.site.guarded
        self.health: dict[str, OutputPort] = {}
        self.angles: OutputPort | None = None
        self.age: OutputPort | None = None
        self.safety: SafetyLayer | None = None
        self.seen: dict[str, OutputPort] = {}
        self.compensations: list[OutputPort] = []
        self.sent: ZeroOrderHold | None = None
        self.surprise_scale = (0.0, 1.0)
        self.pose_reading: OutputPort | None = None
        self.expecting: InputPort | None = None
        self.level: OutputPort | None = None
        self.holds: list[ZeroOrderHold] = []
        # Holds the robot at the start, until the first command is there.
        self.still = self.site.still

    def add(self, name: str, system: _System, **inputs: OutputPort) -> _System:
        """Adds a system and connects its input ports, by name."""
        added = cast(_System, self.builder.AddNamedSystem(name, system))
        for port, source in inputs.items():
            self.builder.Connect(source, cast(Any, added).GetInputPort(port))
        return added

    def parts(self, name: str, system: TickedSystem, *sizes: int) -> list[OutputPort]:
        """First entries of a result as ports, split in C++: a port of the system's own is a call of Python."""
        rest = system.result.size() - sum(sizes)
        more = [size for size in ((rest - 3, 2, 1) if system.guarded else (rest,)) if size > 0]
        split = self.add(name, Demultiplexer(output_ports_sizes=[*sizes, *more]), u0=system.result)
        if system.guarded:
            self.health[name] = split.get_output_port(len(sizes) + len(more) - 2)
        return [split.get_output_port(k) for k in range(len(sizes))]

    def add_disturbances(self) -> None:
        """Wrenches on the platform."""
        if self.scenario.disturbances:
            push = self.add("push", PlatformWrench(self.plant, self.scenario.disturbances))
            self.builder.Connect(push.spatial_force, self.plant.plant.get_applied_spatial_force_input_port())
            self.signals["disturbance"] = push.wrench

    def add_reference(self) -> None:
        """Where the platform should be."""
        self.signals["reference"] = self.add("reference", self._reference(0)).reference

    def _reference(self, ticks: int) -> ReferenceSource:
        """The reference so many ticks ahead."""
        step = self.scenario.plant.time_step
        return ReferenceSource(self.scenario.reference, step, ticks * on_grid(self.period))

    def add_sensors(self) -> None:
        """From the plant's state to what is read of it, and to what the controller sees."""
        sensors, estimator = self.scenario.sensors, self.scenario.estimator
        reading = SENSORS.system(sensors.kind)(self, sensors)
        self.signals["measurement"] = ESTIMATORS.system(estimator.kind)(self, estimator, reading)
        self.seen = {name: self.signals[name] for name in ("measurement", "reference")} | self.seen

    def look_ahead(self, measurement: OutputPort, ticks: int) -> None:
        """Lets the controller see this measurement, and the reference so many ticks ahead."""
        self.seen["measurement"] = measurement
        if ticks > 0:
            self.seen["reference"] = self.add("reference_ahead", self._reference(ticks)).reference

    def last_command(self) -> OutputPort:
        """The command of the tick before, (6,) [N m], less what friction takes of it."""
        self.sent = self.hold("sent")
        return self.sent.get_output_port()

    def hold(self, name: str) -> ZeroOrderHold:
        """Adds what passes a command on one tick later; at first it is what holds the start pose."""
        # A hold that takes its input in the plant's last step before a tick passes it on from that tick, one period
        # late; taken at a tick, it would be at the motors one step of the plant later. Steps that do not coincide with
        # ticks to the last bit need it taken clear of both.
        sampled, step = on_grid(self.period), on_grid(self.scenario.plant.time_step)
        taken = sampled - (step if round(sampled / step) * step == sampled else 0.5 * step)
        self.holds.append(self.add(name, ZeroOrderHold(sampled, 6, taken)))
        return self.holds[-1]

    def with_faults(self, reading: OutputPort, faults: Sequence[Any]) -> OutputPort:
        """A reading, by way of a sensor that fails where the scenario asks for one."""
        if not faults:
            return reading
        faulty = FaultySensor(faults, reading.size(), self.period)
        self.add("faulty_sensor", faulty, reading=reading)
        return self.parts("reading", faulty, reading.size())[0]

    def add_controller(self) -> None:
        """From measurement and reference to torques, and what else the controller tells of itself."""
        options, seen = self.options, self.seen
        weights, compiled = len(self.scenario.tuner.weights), self.scenario.compiled
        site = ControllerSite(self.believed, self.scenario.gravity, weights, self.guarded, compiled)
        system, sizes = CONTROLLERS.system(options.kind)(options, site), options.results
        self.controller = self.add("controller", system, **seen)
        told = self.parts("command", system, *sizes) if sizes else [system.GetOutputPort("torque")]
        self.command, *errors = told
        if not errors:
            if system.HasOutputPort("error"):
                errors = [system.GetOutputPort(name) for name in ("error", "integral")]
            else:
                tracking = self.add("tracking_error", TrackingError(self.period), **seen)
                errors = self.parts("errors", tracking, 6, 6)
        self.signals["torque"] = self.command
        self.signals["error"], self.signals["integral"] = errors

    def add_compensation(self) -> None:
        """What is added to a controller's torque: against friction, and against what an observer cannot explain."""
        friction, terms = self.scenario.friction_compensation, [self.command, *self.compensations]
        limit = self.believed.effort_limits
        explained: list[OutputPort] = []
        if friction is not None:
            made = FrictionFeedforward(self.believed, friction, self.period, self.scenario.compiled)
            self.add("friction_feedforward", made, reference=self.seen["reference"])
            terms += self.parts("against_friction", made, 6)
            explained = [self.add("less_friction", Gain(-1.0, 6), u0=terms[-1]).get_output_port()]
        if len(terms) > 1:
            self.command = self.signals["torque"] = self.sum("command_sum", terms)
        if self.sent is not None:
            # What the motors cannot give is cut by them, or by the safety layer, which has to see it.
            bound = self.add("command_limit", Saturation(-limit, limit), u0=self.command).get_output_port()
            self.builder.Connect(self.sum("explained", [bound, *explained]), self.sent.get_input_port())

    def sum(self, name: str, terms: Sequence[OutputPort]) -> OutputPort:
        """Sum of torques (6,)."""
        inputs = {f"u{k}": term for k, term in enumerate(terms)}
        return cast(OutputPort, self.add(name, Adder(len(terms), 6), **inputs).get_output_port())

    def add_tuner(self) -> None:
        """Densities, and the weights that a controller takes; nothing for one that takes none."""
        if not self.controller.HasInputPort("weights"):
            return
        tuner = self.scenario.tuner
        features = DensityFeatures(tuner.window, self.period, tuner.density, self.scenario.compiled)
        self.add("density", features, error=self.signals["error"], torque=self.signals["torque"])
        (density,) = self.parts("densities", features, 12)
        weights = TUNERS.system(tuner.kind)(self, tuner, density)
        self.builder.Connect(weights, self.controller.GetInputPort("weights"))
        self.signals |= {"weights": weights, "density": density}

    def add_level(self) -> None:
        """The disturbance that an observer is to expect, of a tuner or as the scenario has it."""
        if self.expecting is not None:
            if self.level is None:
                fixed = ConstantVectorSource([self.scenario.estimator.expected])
                self.level = self.add("expected", fixed).get_output_port()
            self.builder.Connect(self.level, self.expecting)

    def add_delay_and_link(self) -> None:
        """What lies between the controller's computer and the motors'."""
        for k in range(self.scenario.command_delay):
            delay = self.hold(f"delay_{k}")
            self.builder.Connect(self.command, delay.get_input_port())
            self.command = delay.get_output_port()
        time_step = self.scenario.plant.time_step
        if not self.scenario.link.perfect:
            steps = steps_per("controller.period", self.period, time_step)
            link = CommandLink(self.scenario.link, time_step, steps, self.still)
            self.add("link", link, torque=self.command)
            self.command, self.age = self.parts("arrived", link, 6, 1)

    def add_safety(self) -> None:
        """The layer that lets no command through unseen."""
        scenario = self.scenario
        if scenario.safety is None:
            return
        quantum = scenario.sensors.quantum
        still, compiled = self.still, scenario.compiled
        made = self.believed, scenario.safety, scenario.gravity, self.period, still, compiled, quantum
        layer = SafetyLayer(*made, self.surprise_scale)
        seen = {name: self.signals[name] for name in ("measurement", "reference")}
        self.safety = self.add("safety", layer, command=self.command, **seen)
        for port, source in (
            (layer.angles, self.angles),
            (layer.innovation, self.signals.get("innovation")),
            (layer.pose_reading, self.pose_reading),
            (layer.age, self.age),
            (layer.sensor_health, self.health.get("estimate")),
            (layer.controller_health, self.health.get("command")),
        ):
            if source is not None:
                self.builder.Connect(source, port)
        self.command, self.signals["safety"] = self.parts("guarded", layer, 6, 3)

    def add_motors(self) -> None:
        """The end of the loop: imperfect motors, where the scenario has them, and the plant."""
        if not self.scenario.motors.perfect:
            drive = MotorDrive(self.plant, self.scenario.motors)
            self.add("drive", drive, torque=self.command, plant_state=self.plant.state_output_port)
            self.command = drive.torque_applied
        if self.command is not self.signals["torque"]:
            self.signals["torque_applied"] = self.command
        unchecked = self.options.code is not None or self.scenario.link.faults
        if self.scenario.safety is None and unchecked:
            # The plant would clip an infinite torque to one that looks valid; our own controllers never give one.
            self.command = self.add("finite", FiniteCheck(), torque=self.command).checked
        self.builder.Connect(self.command, self.plant.torque_input_port)

    def add_log(self, period: float) -> dict[str, VectorLogSink]:
        """Exports all signals, and logs them every so many seconds."""
        log_period = on_grid(period)
        sinks: dict[str, VectorLogSink] = {}
        for name, port in self.signals.items():
            self.builder.ExportOutput(port, name)
            sinks[name] = LogVectorOutput(port, self.builder, publish_period=log_period)
            sinks[name].set_name(f"log_{name}")
        return sinks


def build_diagram(scenario: Scenario, meshcat: Meshcat | None = None) -> ClosedLoop:
    """The closed loop of `scenario` as a Drake Diagram, see `ClosedLoop`.

    Raises:
        ConfigurationError: The tuner's weights file is missing or corrupt.
    """
    return ClosedLoop(scenario, meshcat)
