"""A part in Drake's shell: when it ticks, what it sees, what it leaves in the Context."""

import math

import numpy as np
import pytest
from ended import ended
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import LogVectorOutput

from stewart_drake.errors import ConfigurationError, RiccatiError, failure_code
from stewart_drake.jit import fields, new_record
from stewart_drake.part import Part, guarded
from stewart_drake.sampling import on_grid
from stewart_drake.systems import PartSystem

SAMPLER = fields(value=1, rest=2, scratch=1)


def sampler(fail_at=math.inf, failure=None, **changes):
    """value: input at the latest tick. rest: ticks done, sum of the inputs so far."""

    def tick(value, time, state):
        if time[0] >= fail_at:
            raise failure
        state["value"][0] = value
        state["rest"][0] += 1.0, value[0]

    part = Part("sampler", {"input": 1, "time": 1}, ("value", "rest"), new_record(SAMPLER, value=-1.0), tick)
    return part._replace(**changes)


class Clock(LeafSystem):
    """Time as a signal."""

    def __init__(self):
        super().__init__()
        self.DeclareVectorOutputPort(
            "time", 1, lambda context, output: output.SetFromVector([context.get_time()]), {self.time_ticket()}
        )


class Counter(LeafSystem):
    """Stands for a plant: counts its own steps, and keeps what it saw at the last of them."""

    def __init__(self, period):
        super().__init__()
        self.DeclareVectorInputPort("seen", 1)
        count, kept = self.DeclareDiscreteState(1), self.DeclareDiscreteState(1)
        self.DeclareStateOutputPort("count", count)
        self.DeclareStateOutputPort("kept", kept)
        self.DeclarePeriodicDiscreteUpdateEvent(on_grid(period), 0.0, self.step)

    def step(self, context, discrete):
        discrete.set_value(0, context.get_discrete_state(0).value() + 1.0)
        discrete.set_value(1, self.EvalVectorInput(context, 0).value())


def wire(source, part, period, log_period=None):
    """Diagram of a source and a part, the system of the part, and its logs by output."""
    builder = DiagramBuilder()
    system = builder.AddSystem(PartSystem(part, period))
    builder.Connect(builder.AddSystem(source).get_output_port(0), system.input)
    if source.num_input_ports():
        builder.Connect(system.value, source.get_input_port())
        builder.ExportOutput(source.GetOutputPort("kept"), "kept")
    sinks = {}
    if log_period is not None:
        ports = {"value": system.value, "rest": system.rest}
        if source.num_input_ports():
            ports["kept"] = source.GetOutputPort("kept")
        sinks = {name: LogVectorOutput(port, builder, log_period) for name, port in ports.items()}
    return builder.Build(), system, sinks


def read(port, context):
    # Sample times are stretched by 1.4e-10, see `sampling`.
    return np.round(port.Eval(port.get_system().GetMyContextFromRoot(context)), 6).tolist()


@pytest.mark.parametrize("stop", [0.0, 0.3, 0.5, 1.0, 7.25, 12.0, 12.999])
def test_outputs_answer_within_the_tick_and_are_held_to_the_next(stop):
    diagram, system, _ = wire(Clock(), sampler(), 0.5)
    simulator = Simulator(diagram)
    if stop:
        simulator.AdvanceTo(stop)  # the tick at `stop` itself is still to come
    count = math.floor(stop / 0.5)
    context = simulator.get_context()
    assert read(system.value, context) == [0.5 * count]
    assert read(system.rest, context) == [count + 1, sum(0.5 * k for k in range(count + 1))]
    # The same as a record, and as one port with the ticks done at its end.
    state = system.state(context)
    assert state.dtype == SAMPLER
    np.testing.assert_array_equal(state["rest"][0].round(6), read(system.rest, context))
    assert read(system.result, context) == [0.5 * count, *read(system.rest, context), 0.0, count + 1]


def test_what_a_late_part_says_acts_from_the_next_tick_on():
    diagram, system, _ = wire(Clock(), sampler(late=True), 0.5)
    assert not system.HasAnyDirectFeedthrough()
    simulator = Simulator(diagram)
    assert read(system.value, simulator.get_context()) == [-1.0]
    for end, value in ((0.4, 0.0), (0.9, 0.5), (1.0, 0.5), (1.1, 1.0)):
        simulator.AdvanceTo(end)
        assert read(system.value, simulator.get_context()) == [value]
        assert system.state(simulator.get_context())["value"][0].round(6) == value


def test_a_tick_is_done_once_however_often_it_is_read():
    diagram, _, sinks = wire(Clock(), sampler(), 0.005, log_period=0.001)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.1005)
    log = sinks["rest"].FindLog(simulator.get_context())
    assert log.num_samples() == 101
    np.testing.assert_array_equal(log.data()[0], np.arange(101) // 5 + 1.0)


@pytest.mark.parametrize(
    ("step", "period"),
    [(0.001, 0.005), (0.0001, 0.001), (0.001, 0.001), (0.001, 0.002), (1 / 3000, 1 / 600), (1 / 7000, 1 / 700)],
)
def test_tick_k_sees_the_plant_of_its_own_instant_and_acts_from_there_on(step, period):
    # The plant's update of the same instant must not leak into the tick, nor into what is stored of it.
    ratio = round(period / step)
    diagram, _, sinks = wire(Counter(step), sampler(), period, log_period=on_grid(step))
    simulator = Simulator(diagram)
    simulator.AdvanceTo(2000.4 * step)
    value, rest, kept = (sinks[name].FindLog(simulator.get_context()).data() for name in ("value", "rest", "kept"))
    np.testing.assert_array_equal(value[0], np.arange(2001) // ratio * ratio)
    np.testing.assert_array_equal(rest[1], [sum(range(0, k + 1, ratio)) for k in range(2001)])
    # Step n - 1 used the value of its own tick; the log shows it at n.
    np.testing.assert_array_equal(kept[0, 1:], np.arange(2000) // ratio * ratio)


def test_a_run_failure_in_a_tick_carries_the_time_and_other_errors_pass_as_they_are():
    for failure in (RiccatiError("none"), KeyError("other")):
        diagram, _, _ = wire(Clock(), sampler(1.5, failure), 0.5)
        assert ended(Simulator(diagram), 10.0, type(failure)) is failure
        assert getattr(failure, "time", None) == (on_grid(1.5) if isinstance(failure, RiccatiError) else None)


def test_a_guarded_part_says_what_was_wrong_and_repeats_what_it_said():
    kind = fields(value=1, rest=2, health=2)
    part = guarded(sampler(1.5, RiccatiError("none"), initial=new_record(kind)))
    assert part.outputs == ("value", "rest", "health")
    state = part.initial.copy()
    for time, health in ((1.0, (0, -1)), (1.5, (failure_code("riccati"), -1)), (1.0, (0, -1))):
        before = state.copy()
        part.tick(np.array([time]), np.array([time]), state)
        np.testing.assert_array_equal(state["health"][0], health)
        if health[0]:
            np.testing.assert_array_equal(state["rest"], before["rest"])
    np.testing.assert_array_equal(state["rest"][0], [2.0, 2.0])


@pytest.mark.parametrize("period", [0.0, -0.005, math.nan, math.inf])
def test_a_period_that_would_never_tick_again_is_refused(period):
    with pytest.raises(ConfigurationError):
        PartSystem(sampler(), period)
