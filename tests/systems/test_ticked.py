import math

import numpy as np
import pytest
from ended import ended
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import LogVectorOutput
from stewart_drake.systems.ticked import TickedSystem

from stewart_drake.errors import ConfigurationError, RiccatiError
from stewart_drake.sampling import on_grid


class Clock(LeafSystem):
    """Time as a signal."""

    def __init__(self):
        super().__init__()
        self.DeclareVectorOutputPort(
            "time", 1, lambda context, output: output.SetFromVector([context.get_time()]), {self.time_ticket()}
        )


class Counter(LeafSystem):
    """Stands for a plant: counts its own steps."""

    def __init__(self, period):
        super().__init__()
        index = self.DeclareDiscreteState([0.0])
        self.DeclareStateOutputPort("count", index)
        self.DeclarePeriodicDiscreteUpdateEvent(on_grid(period), 0.0, self.step)

    def step(self, context, discrete):
        discrete.set_value([context.get_discrete_state_vector()[0] + 1.0])


class Follower(LeafSystem):
    """Stands for what a torque acts on: keeps what it saw at each of its own steps."""

    def __init__(self, period, size):
        super().__init__()
        self.DeclareVectorInputPort("seen", size)
        index = self.DeclareDiscreteState(size)
        self.DeclareStateOutputPort("kept", index)
        self.DeclarePeriodicDiscreteUpdateEvent(on_grid(period), 0.0, self.step)

    def step(self, context, discrete):
        discrete.set_value(self.EvalVectorInput(context, 0).value())


class Sampler(TickedSystem):
    """Result: [input at the latest tick, ticks done, sum of the inputs so far]."""

    def __init__(self, period, fail_at=math.inf, failure=None):
        super().__init__(period, np.array([-1.0, 0.0, 0.0]))
        self.input = self.DeclareVectorInputPort("input", 1)
        self._declare_result()
        self.value = self._declare_output("value", 0, 1)
        self.rest = self._declare_output("rest", 1, 2)
        self.fail_at, self.failure = fail_at, failure

    def tick(self, context, previous):
        if context.get_time() >= self.fail_at:
            raise self.failure
        value = self.input.Eval(context)[0]
        return np.array([value, previous[1] + 1.0, previous[2] + value])


def wire(source, sampler, log_period=None):
    builder = DiagramBuilder()
    builder.AddSystem(source)
    builder.AddSystem(sampler)
    builder.Connect(source.get_output_port(), sampler.input)
    builder.ExportOutput(sampler.value, "value")
    builder.ExportOutput(sampler.rest, "rest")
    sinks = [
        LogVectorOutput(port, builder, publish_period=on_grid(log_period)) if log_period else None
        for port in (sampler.value, sampler.rest)
    ]
    return builder.Build(), sinks


def read(diagram, context):
    # Sample times are stretched by 1.4e-10, see `sampling`.
    return tuple(round(float(x), 6) for name in ("value", "rest") for x in diagram.GetOutputPort(name).Eval(context))


@pytest.mark.parametrize("stop", [0.0, 0.3, 0.5, 1.0, 7.25, 12.0, 12.999])
def test_outputs_answer_within_the_tick_and_are_held_to_the_next(stop):
    diagram, _ = wire(Clock(), Sampler(0.5))
    simulator = Simulator(diagram)
    if stop:
        simulator.AdvanceTo(stop)  # the tick at `stop` itself is still to come
    value, ticks, total = read(diagram, simulator.get_context())
    count = math.floor(stop / 0.5)
    assert value == 0.5 * count
    assert ticks == count + 1
    assert total == sum(0.5 * k for k in range(count + 1))


def test_a_tick_is_done_once_however_often_it_is_read():
    diagram, sinks = wire(Clock(), Sampler(0.005), log_period=0.001)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.1005)
    log = sinks[1].FindLog(simulator.get_context())
    assert log.num_samples() == 101
    np.testing.assert_array_equal(log.data()[0], np.arange(101) // 5 + 1.0)


PERIODS = [(0.001, 0.005), (0.0001, 0.001), (0.001, 0.001), (0.001, 0.002), (1 / 3000, 1 / 600), (1 / 7000, 1 / 700)]


@pytest.mark.parametrize(("step", "period"), PERIODS)
def test_tick_k_sees_the_plant_of_its_own_instant_and_that_is_what_is_kept(step, period):
    # The plant's update of the same instant must not leak into the tick, nor into what is stored of it.
    ratio = round(period / step)
    diagram, sinks = wire(Counter(step), Sampler(period), log_period=step)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(2000.4 * step)
    log = sinks[0].FindLog(simulator.get_context())
    np.testing.assert_array_equal(log.data()[0], np.arange(2001) // ratio * ratio)
    sums = sinks[1].FindLog(simulator.get_context()).data()[1]
    np.testing.assert_array_equal(sums, [sum(range(0, k + 1, ratio)) for k in range(2001)])


@pytest.mark.parametrize(("step", "period"), PERIODS)
def test_what_a_tick_says_acts_from_that_instant_on(step, period):
    ratio = round(period / step)
    builder = DiagramBuilder()
    counter = builder.AddSystem(Counter(step))
    sampler = builder.AddSystem(Sampler(period))
    follower = builder.AddSystem(Follower(step, 1))
    builder.Connect(counter.get_output_port(), sampler.input)
    builder.Connect(sampler.value, follower.get_input_port())
    sink = LogVectorOutput(follower.get_output_port(), builder, publish_period=on_grid(step))
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(2000.4 * step)
    kept = sink.FindLog(simulator.get_context()).data()[0]
    # Step n - 1 used the value of its own tick; the log shows it at n.
    np.testing.assert_array_equal(kept[1:], np.arange(2000) // ratio * ratio)


def test_a_log_at_decimal_times_shows_the_tick_of_its_own_row_however_long_the_run():
    # Decimal times come a little before the stretched ones, more and more so.
    builder = DiagramBuilder()
    sampler = builder.AddSystem(Sampler(0.001))
    builder.Connect(builder.AddSystem(Clock()).get_output_port(), sampler.input)
    sink = LogVectorOutput(sampler.value, builder, publish_period=0.001)
    diagram = builder.Build()
    simulator = Simulator(diagram)
    simulator.AdvanceTo(12.0)
    log = sink.FindLog(simulator.get_context())
    assert log.num_samples() == 12001
    np.testing.assert_allclose(log.data()[0], log.sample_times(), rtol=1e-9)


def test_the_result_is_a_port_too_with_the_ticks_done_at_its_end():
    sampler = Sampler(0.5)
    diagram, _ = wire(Clock(), sampler)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(1.2)
    result = sampler.result.Eval(sampler.GetMyContextFromRoot(simulator.get_context()))
    np.testing.assert_allclose(result, [1.0, 3.0, 1.5, 3.0], rtol=1e-9)


def test_a_run_failure_in_a_tick_carries_the_time_and_other_errors_pass_as_they_are():
    for failure in (RiccatiError("none"), KeyError("other")):
        diagram, _ = wire(Clock(), Sampler(0.5, 1.5, failure))
        assert ended(Simulator(diagram), 10.0, type(failure)) is failure
        assert getattr(failure, "time", None) == (on_grid(1.5) if isinstance(failure, RiccatiError) else None)


@pytest.mark.parametrize("period", [0.0, -0.005, math.nan, math.inf])
def test_a_period_that_would_never_tick_again_is_refused(period):
    with pytest.raises(ConfigurationError):
        Sampler(period)
