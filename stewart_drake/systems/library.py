"""LeafSystems of the loop: `PartSystem`, which runs a part at its ticks, and systems without ticks.

The systems of the paper's controller take options. The others take a scenario, and are a part of its loop:
`PlatformObserver(scenario)`, `ScenarioSystem(scenario, "encoders")`. For a part of yours use `PartSystem(part,
period)`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from pydrake.common.value import Value
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, InputPort, LeafSystem, OutputPort, State

from stewart_drake.base.arguments import checked
from stewart_drake.base.errors import ConfigurationError, NotFiniteError, RunFailure, drake_guard
from stewart_drake.base.keys import join_or
from stewart_drake.base.sampling import just_before, on_grid
from stewart_drake.control.base import TRACKING_ERROR
from stewart_drake.control.features import DensityKind, density_part
from stewart_drake.control.lqi import LqiOptions, LqiState, lqi_part
from stewart_drake.control.network import TunerNetwork, network_part, network_tick
from stewart_drake.loop.part import BoundPart, Part
from stewart_drake.plant.context_parameters import WithParameters
from stewart_drake.plant.multibody_plant import StewartRobot
from stewart_drake.plant.plant_options import BALL
from stewart_drake.references import Reference
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.gravity import Gravity, check_gravity
from stewart_drake.scenario.assembly import loop_of
from stewart_drake.scenario.scenario import Scenario

_SAME_TICK = 1e-6
"""Share of a period by which an instant may come before a tick and still belong to it."""
_OUTPUT_DELAY = 1e-9
"""Share of a period, and of the time, after which a part of the end of a tick updates its output."""


class PartSystem(LeafSystem, WithParameters):
    """Runs a part at multiples of its period, or of `period` [s]; its state is in the Context.

    Outputs hold between ticks: a plant gets one torque per tick, without delay, in discrete, unrestricted or continuous
    updates. Ticks are just before the multiples of the period (2.7e-11 of the time), and so before a plant's step at
    the same decimal time.

    A tick has two stages, because parts read other parts' outputs at the same instant. An unrestricted update opens the
    tick: until it is closed, outputs are computed from the inputs on demand. The discrete update, which Drake does
    afterwards, closes it and stores them. A Simulator opens at its start a tick that the Context has not had, also if
    its time was set back. A part of the end of a tick updates its outputs after the tick.

    Ports: those of the part by name and as attributes, and `result`, its state. `field` adds a port for a field of the
    state, and `state` returns the record; an output with the name of an input is the attribute `NAME_out`. An input
    for which the part has an array need not be connected.

    The part's parameters, and the arrays at inputs that are not connected, are numeric parameters in the Context; see
    `parameter`. Changes take effect at the next tick.
    """

    if TYPE_CHECKING:
        # Ports are attributes by name; a type checker cannot know which.
        def __getattr__(self, name: str) -> Any: ...

    def __init__(self, part: Part, period: float) -> None:
        super().__init__()
        self.part, self.period = part, part.period or period
        self._early, self._nominal = just_before(self.period), on_grid(self.period)
        self._kind = part.initial.dtype
        initial = part.initial.view(np.float64)
        # The state, number of its tick, whether it is open; separately the output of a part of the end of a tick.
        output = self.DeclareDiscreteState(initial) if part.end_of_tick else None
        self._tick = int(self.DeclareDiscreteState(np.append(initial, [-1.0, 1.0])))
        self._time = np.zeros(1)
        numbers = {name: value for name, value in part.parameters.items() if name not in part.replaced}
        sources = ((name, part.source(name)) for name in part.inputs)
        numbers |= {name: np.array(source, float) for name, source in sources if not isinstance(source, str)}
        record = self.declare_parameters(numbers)
        # Ports, and the values of those that are not connected.
        self._ports: list[tuple[InputPort | None, np.ndarray | None]] = []
        for name, size in part.inputs.items():
            if name == "time":
                self._ports.append((None, self._time))
                continue
            port = self.DeclareVectorInputPort(name, size)
            self._ports.append((port, record[name] if name in numbers else None))
            setattr(self, name, port)
        self._parameters = [record[name] if name in numbers else value for name, value in part.parameters.items()]
        self._signals = [
            (place, self.DeclareVectorInputPort(name, value.nbytes // 8), value.dtype)
            for place, (name, value) in enumerate(part.parameters.items())
            if name in part.replaced
        ]
        self._bound = BoundPart(part, [None] * len(part.inputs), part.initial.copy())
        self.result: OutputPort
        if output is not None:
            self.result = self.DeclareStateOutputPort("result", output)
        else:
            needs = {self.xd_ticket(), self.all_input_ports_ticket(), self.all_parameters_ticket()}
            needs |= {self.time_ticket()} if "time" in part.inputs else set()
            self.result = self.DeclareVectorOutputPort(
                "result", initial.size, self._answer, prerequisites_of_calc=needs
            )
        for name in part.outputs:
            setattr(self, f"{name}_out" if name in part.inputs else name, self._slice(name))
        self.DeclareInitializationUnrestrictedUpdateEvent(self._begin)
        self.DeclareInitializationDiscreteUpdateEvent(self._close_first)
        self.DeclarePeriodicUnrestrictedUpdateEvent(self._early, 0.0, self._open)
        self.DeclarePeriodicDiscreteUpdateEvent(self._early, 0.0, self._close)
        if part.end_of_tick:
            self.DeclarePeriodicDiscreteUpdateEvent(
                self._nominal * (1.0 + _OUTPUT_DELAY), _OUTPUT_DELAY * self.period, self._update_output
            )

    @checked
    def state(self, context: Context) -> np.ndarray:
        """The part's record (1,) after the last tick; `context` of the Diagram."""
        with drake_guard(f"the state of {self.part.name}"):
            values = self.GetMyContextFromRoot(context).get_discrete_state(self._tick).value()
        return np.array(values[:-2]).view(self._kind)

    def field(self, name: str) -> OutputPort:
        """Output port of a field of the part's record, such as `gain` of an LQI; before the Diagram is built."""
        names = self._kind.names or ()
        if name not in names:
            raise ConfigurationError("field", name, join_or(names))
        port: OutputPort = self.GetOutputPort(name) if self.HasOutputPort(name) else self._slice(name)
        return port

    def _slice(self, name: str) -> OutputPort:
        start, size = int(self._kind.fields[name][1]) // 8, self.part.size(name)  # type: ignore[index]

        def calc(context: Context, output: BasicVector) -> None:
            output.SetFromVector(self.result.Eval(context)[start : start + size])

        ticket = self.get_output_port(self.result.get_index()).cache_entry().ticket()
        needs = {self.xd_ticket()} if self.part.end_of_tick else {ticket}
        return self.DeclareVectorOutputPort(name, size, calc, prerequisites_of_calc=needs)

    def _number(self, context: Context) -> int:
        """Number of the tick to which an instant belongs."""
        return int(context.get_time() / self._early + _SAME_TICK)

    def _answer(self, context: Context, output: BasicVector) -> None:
        held, result = context.get_discrete_state(self._tick).value(), output.get_mutable_value()
        result[:] = held[:-2]
        if held[-1]:
            self._compute(context, result)

    def _compute(self, context: Context, values: np.ndarray) -> None:
        """A tick, in place, on the state (n,) of the tick before."""
        self._time[0] = self._number(context) * self._nominal
        self.read_parameters(context)
        inputs = [
            otherwise if port is None or (otherwise is not None and not port.HasValue(context)) else port.Eval(context)
            for port, otherwise in self._ports
        ]
        try:
            for place, port, kind in self._signals:
                self._parameters[place] = port.Eval(context).view(kind)
            # A record of the same memory; `view` takes three times as long.
            self._bound.bind(self._parameters, inputs, np.ndarray(1, self._kind, values))
            self._bound()
        except RunFailure as error:
            error.time = float(self._time[0])
            raise

    # Drake copies the state before an update, so that it is read and written in one place.

    def _begin(self, context: Context, state: State) -> None:
        tick = state.get_mutable_discrete_state().get_mutable_value(self._tick)
        if self._number(context) != tick[-2]:
            tick[-1] = 1.0

    def _open(self, context: Context, state: State) -> None:
        tick = state.get_mutable_discrete_state().get_mutable_value(self._tick)
        if tick[-1]:
            # The first tick, at 0: a plant that steps in an unrestricted update does so now.
            self._store(context, tick)
        else:
            tick[-1] = 1.0

    def _update_output(self, _: Context, values: DiscreteValues) -> None:
        values.set_value(0, values.value(self._tick)[:-2])

    def _close_first(self, context: Context, values: DiscreteValues) -> None:
        if context.get_time() != self._number(context) * self._early:  # Else a tick is due at once.
            self._close(context, values)

    def _close(self, context: Context, values: DiscreteValues) -> None:
        tick = values.get_mutable_value(self._tick)
        if tick[-1]:
            self._store(context, tick)

    def _store(self, context: Context, tick: np.ndarray) -> None:
        if self.part.end_of_tick:
            self._compute(context, tick[:-2])
        else:
            tick[:-2] = self.result.Eval(context)
        tick[-2:] = self._number(context), 0.0


class LqiController(PartSystem):
    """Linear quadratic integral regulator, (19)-(34): a new gain at every tick, from its pose and weights.

    Its output has no delay; `weights` is the size of its port, 2, or 4 for block weights; gravity in [m/s^2].

    Ports:
        measurement: in (12,), pose [rad, m], pose rate [rad/s, m/s] (Euler rates).
        reference: in (18,), pose [rad, m], pose rate [rad/s, m/s], pose acceleration [rad/s^2, m/s^2].
        weights: in (2,), omega_Q, omega_R; or, for block weights, (4,), q_e, q_v, q_z, r; all > 0.
        torque: out (6,) [N m].
        integral: out (6,) [rad s, m s], z after the tick.
        result: out, the part's whole state.
    """

    @checked
    def __init__(self, robot: RobotParameters, options: LqiOptions, gravity: Gravity, weights: int = 2) -> None:
        if weights not in (2, 4):
            raise ConfigurationError("weights", weights, "2 or 4")
        check_gravity(gravity)
        super().__init__(lqi_part(options, robot, gravity, weights), options.period)


class TrackingError(PartSystem):
    """Measured pose minus that of the reference, without delay. The period is in [s].

    Ports:
        measurement: in (12,), pose [rad, m], pose rate [rad/s, m/s] (Euler rates).
        reference: in (18,), pose [rad, m], pose rate [rad/s, m/s], pose acceleration [rad/s^2, m/s^2].
        error: out (6,) [rad, m].
        result: out, the part's whole state.
    """

    def __init__(self, period: float) -> None:
        super().__init__(TRACKING_ERROR, period)


class DensityFeatures(PartSystem):
    """Densities of the inputs over a sliding window, (35), (36), without delay.

    `window` is m of (35) [ticks]; means are over m + 1 samples, which are in the Context. The period is in [s].

    Ports:
        error: in (6,) [rad, m], pose minus reference at the tick.
        torque: in (6,) [N m].
        density: out (12,) [-], of the errors, then of the torques.
        result: out, the part's whole state.
    """

    def __init__(self, window: int, period: float, kind: DensityKind = "magnitude") -> None:
        super().__init__(density_part(window, kind), period)


class AnnTuner(PartSystem):
    """omega_Q and omega_R from the densities, Fig. 5; `initial` until the first inference.

    The weights of a tick act at the next one: the densities of a tick need its torque, which needs weights.

    Ports:
        density: in (12,) [-], of the errors, then of the torques.
        weights: out (2,), omega_Q, omega_R; all > 0.
        result: out, the part's whole state.
    """

    @checked
    def __init__(self, network: TunerNetwork, period: float, initial: Sequence[float] = (1.0, 1.0)) -> None:
        super().__init__(network_part(network, initial), period)


class ScenarioSystem(PartSystem):
    """A part of a scenario's loop, by its name, with the ports of the part.

    controller: measurement, reference -> torque; by kind also weights, integral, and reference_now of a pid.
    encoders: crank_state -> reading, angles of the cranks.
    estimator: reading -> measurement, by forward kinematics and differences.
    friction_compensation: reference -> friction_torque.
    command: control_torque, disturbance_torque, friction_torque -> torque, the command.
    net_torque: torque, friction_torque -> net_torque, the input of an observer.
    command_delay: value -> value, of so many ticks ago.
    link: torque -> torque, age; loses, delays and corrupts commands at every step of the plant.
    motors: command, crank_state -> torque of imperfect motors, at every step of the plant.

    Raises:
        ConfigurationError: The loop has no such part.
    """

    @checked
    def __init__(self, scenario: Scenario, name: str) -> None:
        parts = {part.name: part for part in loop_of(scenario).parts}
        if name not in parts:
            allowed = f"a scenario with the part {name}; it has {', '.join(parts)}"
            raise ConfigurationError("scenario", scenario.name, allowed)
        super().__init__(parts[name], scenario.controller.period)


class PlatformObserver(ScenarioSystem):
    """`estimator: observer`.

    observer: reading, net_torque, reference, disturbance -> measurement, predicted, disturbance_torque, innovation.
    """

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(scenario, "observer")


class SafetyLayer(ScenarioSystem):
    """`safety`, which limits or replaces the command; ports without a signal need not be connected.

    safety: command, measurement, reference, age, sensor_health, controller_health, angles, pose_reading, parity ->
    torque, safety, lost.
    """

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(scenario, "safety")


_NAMED = {"tracking_error": TrackingError, "density": DensityFeatures, "observer": PlatformObserver}
_NAMED |= {"safety": SafetyLayer}


def system_of(part: Part, period: float) -> PartSystem:
    """A `PartSystem`, of the class for the part's name if there is one."""
    kind: type[PartSystem] = _NAMED.get(part.name, PartSystem)
    if part.initial.dtype == LqiState.layout:
        kind = LqiController
    elif part.kernel is network_tick:
        kind = AnnTuner
    system: PartSystem = kind.__new__(kind)
    PartSystem.__init__(system, part, period)
    return system


class ScenarioInput(LeafSystem):
    """An external signal in the place of one of a scenario.

    Ports:
        outside: in (size,); if it is not connected, the scenario's signal is the output.
        scenario: in (size,).
        signal: out (size,); the sum of both if `added`.
    """

    def __init__(self, name: str, size: int, added: bool = False) -> None:
        super().__init__()
        self.outside = self.DeclareVectorInputPort("outside", size)
        self.scenario = self.DeclareVectorInputPort("scenario", size)

        def calc(context: Context, output: BasicVector) -> None:
            if not self.outside.HasValue(context):
                return output.SetFromVector(self.scenario.Eval(context))
            value = self.outside.Eval(context)
            if not np.isfinite(value).all():
                raise NotFiniteError(name, value.copy())
            return output.SetFromVector(value + self.scenario.Eval(context) if added else value)

        needs = {self.all_input_ports_ticket()}
        self.signal = self.DeclareVectorOutputPort("signal", size, calc, prerequisites_of_calc=needs)


class TimeSource(LeafSystem):
    """A signal that is a function of time.

    Ports:
        NAME: out (size,), `evaluate(time)` at a time [s].
    """

    def __init__(self, name: str, size: int, evaluate: Callable[[float], np.ndarray]) -> None:
        super().__init__()

        def calc(context: Context, output: BasicVector) -> None:
            output.SetFromVector(evaluate(context.get_time()))

        setattr(self, name, self.DeclareVectorOutputPort(name, size, calc, prerequisites_of_calc={self.time_ticket()}))


class ReferenceSource(TimeSource):
    """A reference motion as a signal.

    Ports:
        reference: out (18,), pose [rad, m], pose rate [rad/s, m/s], pose acceleration [rad/s^2, m/s^2].
    """

    reference: OutputPort

    @checked
    def __init__(self, reference: Reference) -> None:
        super().__init__("reference", 18, lambda time: np.concatenate(reference.evaluate(time)))


class TaskSpaceSensor(LeafSystem):
    """Pose and rate of P in B, and angles and rates of the cranks, exact.

    For a robot with a ball there is another output, `ball` (5,): its motion on the plate, see `plant_options.BALL`.

    Ports:
        plant_state: in (nq + nv,), state of the MultibodyPlant.
        measurement: out (12,), pose [rad, m] then pose rate [rad/s, m/s] (Euler rates).
        crank_state: out (12,), angles of the cranks [rad] from the horizontal, not wrapped, then their rates [rad/s].
    """

    @checked
    def __init__(self, robot: StewartRobot) -> None:
        super().__init__()
        self._plant = robot
        self.plant_state = self.DeclareVectorInputPort("plant_state", self._plant.size)
        needs = {self.input_port_ticket(self.plant_state.get_index())}
        self.measurement = self.DeclareVectorOutputPort("measurement", 12, self._pose, prerequisites_of_calc=needs)
        self.crank_state = self.DeclareVectorOutputPort("crank_state", 12, self._cranks, prerequisites_of_calc=needs)
        if robot.ball is not None:
            self.ball = self.DeclareVectorOutputPort("ball", 5, self._ball, prerequisites_of_calc=needs)

    def _pose(self, context: Context, output: BasicVector) -> None:
        self._plant.read_pose(self.plant_state.Eval(context), output.get_mutable_value())

    def _cranks(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._plant.crank_state(self.plant_state.Eval(context)))

    def _ball(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._plant.measure(self.plant_state.Eval(context))[BALL])


class PlatformWrench(LeafSystem):
    """An external wrench at the centre of the platform.

    Ports:
        wrench: in (6,) [N m, N], moment about P and force, in B.
        spatial_force: out, for the plant's port `applied_spatial_force`.
    """

    @checked
    def __init__(self, robot: StewartRobot) -> None:
        super().__init__()
        self._plant = robot
        self.wrench = self.DeclareVectorInputPort("wrench", 6)
        needs, forces = {self.input_port_ticket(self.wrench.get_index())}, Value[list[ExternallyAppliedSpatialForce]]
        self.spatial_force = self.DeclareAbstractOutputPort(
            "spatial_force", lambda: forces(), self._calc, prerequisites_of_calc=needs
        )

    def _calc(self, context: Context, output: BasicVector) -> None:
        output.set_value([self._plant.push(self.wrench.Eval(context))])
