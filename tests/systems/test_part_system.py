"""A part in Drake's shell; that a tick sees the plant of its own instant is in test_loop."""

import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from stewart_drake.errors import RiccatiError
from stewart_drake.jit import fields, new_record
from stewart_drake.part import Part
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


def wire(part, period):
    """Diagram of a clock and a part, and the system of the part."""
    builder = DiagramBuilder()
    system = builder.AddSystem(PartSystem(part, period))
    builder.Connect(builder.AddSystem(Clock()).get_output_port(0), system.input)
    return builder.Build(), system


def read(port, context):
    # Sample times are stretched by 1.4e-10, see `sampling`.
    return np.round(port.Eval(port.get_system().GetMyContextFromRoot(context)), 6).tolist()


@pytest.mark.parametrize("stop", [0.0, 0.3, 0.5, 7.25, 12.999])
def test_outputs_answer_within_the_tick_and_are_held_to_the_next(stop):
    diagram, system = wire(sampler(), 0.5)
    simulator = Simulator(diagram)
    if stop:
        simulator.AdvanceTo(stop)  # the tick at `stop` itself is still to come
    count = math.floor(stop / 0.5)
    context = simulator.get_context()
    assert read(system.value, context) == [0.5 * count]
    assert read(system.rest, context) == [count + 1, sum(0.5 * k for k in range(count + 1))]
    # The same as one port with the ticks done at its end.
    assert read(system.result, context) == [0.5 * count, *read(system.rest, context), 0.0, count + 1]


def test_what_a_late_part_says_acts_from_the_next_tick_on():
    diagram, system = wire(sampler(late=True), 0.5)
    assert not system.HasAnyDirectFeedthrough()
    simulator = Simulator(diagram)
    assert read(system.value, simulator.get_context()) == [-1.0]
    for end, value in ((0.4, 0.0), (0.9, 0.5), (1.0, 0.5), (1.1, 1.0)):
        simulator.AdvanceTo(end)
        assert read(system.value, simulator.get_context()) == [value]
        assert system.state(simulator.get_context())["value"][0].round(6) == value


def test_an_error_ends_the_simulation_and_one_of_a_run_carries_its_time():
    for failure in (RiccatiError("none"), KeyError("other")):
        diagram, _ = wire(sampler(1.5, failure), 0.5)
        with pytest.raises(type(failure)):
            Simulator(diagram).AdvanceTo(10.0)
        # The frames of a traceback hold references to Contexts that die with the Simulator; pydrake may crash.
        failure.__traceback__ = None
        assert getattr(failure, "time", None) == (on_grid(1.5) if isinstance(failure, RiccatiError) else None)
