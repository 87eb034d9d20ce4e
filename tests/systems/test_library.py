"""LeafSystems by themselves: ports as their docstrings name them, and a part in their shell; ticks are in test_loop."""

import inspect
import math
import re
from typing import Annotated

import numpy as np
import pytest
from conftest import make_network
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from strategies import ROBOT

from stewart_drake import ConfigurationError, LqiOptions, Scenario, build_plant, paper_reference, systems
from stewart_drake.base.errors import RiccatiError
from stewart_drake.base.records import Record, Vec2
from stewart_drake.base.sampling import on_grid
from stewart_drake.loop.part import Part
from stewart_drake.systems import PartSystem
from stewart_drake.systems.library import PlatformWrench

GRAVITY, PERIOD = 9.81, 0.001
PLANT = build_plant(ROBOT)[1]

EVERY = [
    systems.AnnTuner(make_network(), PERIOD),
    systems.DensityFeatures(4, PERIOD),
    systems.TrackingError(PERIOD),
    systems.LqiController(ROBOT, LqiOptions(solver="split", period=PERIOD), GRAVITY),
]
PLAIN = [
    PlatformWrench(PLANT),
    systems.ReferenceSource(paper_reference()),
    systems.TaskSpaceSensor(PLANT),
    systems.ClosedFormPlant(ROBOT),
]
"""Those without a part."""


@pytest.mark.parametrize("system", EVERY + PLAIN, ids=lambda system: type(system).__name__)
def test_ports_are_those_of_the_docstring(system):
    text = inspect.getdoc(type(system)).partition("Ports:")[2]
    sizes = {"nq + nv": PLANT.plant.num_multibody_states(), None: 0}
    told = {
        (way, name): sizes[size] if size in sizes else int(size)
        for names, way, size in re.findall(r"^ {4}([\w, ]+): (in|out)(?: \(([^,)]*),\))?", text, re.M)
        for name in names.split(", ")
        for size in [size or None]
    }
    inputs = [system.get_input_port(k) for k in range(system.num_input_ports())]
    outputs = [system.get_output_port(k) for k in range(system.num_output_ports())]
    ports = {("in", p.get_name()): p for p in inputs} | {("out", p.get_name()): p for p in outputs}
    if isinstance(system, systems.PartSystem):
        told["out", "result"] = system.part.initial.view(float).size
    assert told == {key: port.size() for key, port in ports.items()}
    for (way, name), port in ports.items():
        attribute = f"{name}_out" if way == "out" and ("in", name) in ports else name
        assert getattr(system, attribute).get_index() == port.get_index()


FRICTION = {"model": {"friction": {"coulomb": 0.01}}}
OBSERVER = {"sensors": "encoders", "estimator": "observer"}
SCENARIOS = {
    "controller": {"controller": "computed_torque"},
    "encoders": {"sensors": "encoders"},
    "estimator": {"sensors": "encoders"},
    "observer": OBSERVER,
    "friction_compensation": FRICTION,
    "command": FRICTION,
    "net_torque": OBSERVER,
    "command_delay": {"command_delay": 1},
    "link": {"link": {"drop_probability": 0.1}},
    "motors": {"motors": {"ripple": 0.1}},
    "safety": {"safety": {}},
}
KINDS = {"observer": systems.PlatformObserver, "safety": systems.SafetyLayer}


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_part_of_a_scenario_has_the_ports_that_its_docstring_names(name):
    scenario, kind = Scenario(**SCENARIOS[name]), KINDS.get(name, systems.ScenarioSystem)
    system = kind(scenario) if name in KINDS else kind(scenario, name)
    lines = " ".join(inspect.getdoc(kind).split())
    named = re.search(rf"{name}: ([a-z_, ]+) -> ([a-z_, ]+)", lines)
    inputs, outputs = (set(re.findall(r"\w+", names)) for names in named.groups())
    assert set(system.part.inputs) - {"time"} == inputs
    assert set(system.part.outputs) <= outputs | {"integral"}


def test_a_scenario_without_the_part_is_refused():
    with pytest.raises(ConfigurationError, match=r"with the part observer.*; it has tracking_error, controller"):
        systems.PlatformObserver(Scenario())


def test_every_field_of_a_record_can_be_a_port():
    system = systems.LqiController(ROBOT, LqiOptions(solver="split", period=PERIOD), GRAVITY)
    gain = system.field("gain")
    assert (gain.size(), system.field("gain").get_index(), system.field("torque").get_index()) == (
        108,
        gain.get_index(),
        system.torque.get_index(),
    )
    with pytest.raises(ConfigurationError, match=r"^field: expected .*feedforward.*, got 'speed'"):
        system.field("speed")


class Sampler(Record):
    value: Annotated[np.ndarray, (1,)]
    rest: Vec2
    scratch: Annotated[np.ndarray, (1,)]


def sampler(fail_at=math.inf, failure=None, **changes):
    """value: input at the latest tick. rest: ticks done, sum of the inputs so far."""

    def tick(value, time, state):
        if time[0] >= fail_at:
            raise failure
        state["value"][0] = value
        state["rest"][0] += 1.0, value[0]

    part = Part("sampler", tick, {}, {"input": 1, "time": 1}, ("value", "rest"), Sampler.new(value=-1.0))
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
    assert read(system.result, context) == [0.5 * count, *read(system.rest, context), 0.0]


def test_what_a_part_of_the_end_of_a_tick_gives_acts_from_the_next_tick_on():
    diagram, system = wire(sampler(end_of_tick=True), 0.5)
    assert not system.HasAnyDirectFeedthrough()
    simulator = Simulator(diagram)
    assert read(system.value, simulator.get_context()) == [-1.0]
    for end, value, found in ((0.4, 0.0, 0.0), (0.9, 0.5, 0.5), (1.0, 0.5, 1.0), (1.1, 1.0, 1.0)):
        simulator.AdvanceTo(end)
        assert read(system.value, simulator.get_context()) == [value]
        assert system.state(simulator.get_context())["value"][0].round(6) == found


def test_an_error_ends_the_simulation_and_one_of_a_run_carries_its_time():
    for failure in (RiccatiError("none"), KeyError("other")):
        diagram, _ = wire(sampler(1.5, failure), 0.5)
        with pytest.raises(type(failure)):
            Simulator(diagram).AdvanceTo(10.0)
        # The frames of a traceback hold references to Contexts that die with the Simulator; pydrake may crash.
        failure.__traceback__ = None
        assert getattr(failure, "time", None) == (on_grid(1.5) if isinstance(failure, RiccatiError) else None)
