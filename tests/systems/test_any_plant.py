"""The controller's systems on plants of other people: one torque a tick, that which `Controller` gives for readings."""

import numpy as np
import pytest
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource
from strategies import ROBOT

from stewart_drake import ClosedFormPlant, Controller, LqiOptions, Scenario, add_plant, add_robot, paper_reference
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.sampling import on_grid
from stewart_drake.control.lqi import lqi_part
from stewart_drake.systems import PartSystem, ReferenceSource, TaskSpaceSensor

PERIOD = 0.005
OPTIONS = LqiOptions(period=PERIOD, solver="split", feedforward="gravity")
SCENARIO = Scenario.from_dict({"controller": OPTIONS.to_dict(), "tuner": "fixed"})
START = paper_reference().evaluate(0.0)[:2]


class Watched:
    """An LQI that notes what its kernel is given and gives, each time that it runs."""

    def __init__(self, builder, measurement):
        part, self.calls = lqi_part(OPTIONS, ROBOT, 9.81, 2), []
        names = [*part.leading, *part.inputs]

        def kernel(*arguments):
            result = part.kernel(*arguments)
            given = dict(zip(names, arguments, strict=False))
            self.calls.append((given["measurement"].copy(), arguments[-1]["torque"][0].copy()))
            return result

        self.system = builder.AddNamedSystem("controller", PartSystem(part._replace(kernel=kernel), PERIOD))
        reference = builder.AddNamedSystem("reference", ReferenceSource(paper_reference()))
        weights = builder.AddNamedSystem("weights", ConstantVectorSource([1.0, 1.0]))
        builder.Connect(measurement, self.system.measurement)
        builder.Connect(reference.reference, self.system.reference)
        builder.Connect(weights.get_output_port(), self.system.weights)

    def assert_ticks_are_those_of_the_controller(self, count):
        assert len(self.calls) == count
        controller, torque = Controller(SCENARIO), np.empty(6)
        for tick, (measurement, given) in enumerate(self.calls):
            controller.step(measurement, tick * on_grid(PERIOD), torque)
            # A tick's time, at which the reference is asked, is 1.7e-10 of it before that of `on_grid`.
            np.testing.assert_allclose(given, torque, rtol=1e-10)


def on_multibody(sampled=False, step=0.001):
    builder = DiagramBuilder()
    plant = builder.AddSystem(MultibodyPlant(step))
    plant.SetUseSampledOutputPorts(sampled)
    robot = add_robot(plant, ROBOT)
    plant.Finalize()
    sensor = builder.AddSystem(TaskSpaceSensor(robot))
    builder.Connect(robot.state_output_port, sensor.plant_state)
    watched = Watched(builder, sensor.measurement)
    builder.Connect(watched.system.torque, robot.torque_input_port)
    diagram = builder.Build()
    return diagram, watched, lambda context: robot.set_state(context, *START)


def on_closed_form(scheme):
    builder = DiagramBuilder()
    plant = builder.AddSystem(ClosedFormPlant(ROBOT))
    watched = Watched(builder, plant.measurement)
    builder.Connect(watched.system.torque, plant.torque)
    return builder.Build(), watched, lambda context: plant.set_state(context, *START), scheme


PLANTS = {
    "Drake's defaults": lambda: on_multibody(sampled=True),
    "without sampled ports": lambda: on_multibody(),
    "stretched step, sampled": lambda: on_multibody(True, on_grid(0.001)),
    "stretched step": lambda: on_multibody(False, on_grid(0.001)),
    "a step that does not divide the tick": lambda: on_multibody(True, 0.0007),
}


@pytest.mark.parametrize("make", PLANTS.values(), ids=PLANTS)
@pytest.mark.parametrize("caching", [True, False])
def test_one_torque_a_tick_on_a_discrete_plant(make, caching):
    diagram, watched, start = make()
    simulator = Simulator(diagram)
    if not caching:
        simulator.get_mutable_context().DisableCaching()
    start(simulator.get_mutable_context())
    held = []
    for end in np.arange(1, 31) * 0.001:
        simulator.AdvanceTo(end)
        held.append(watched.system.torque.Eval(watched.system.GetMyContextFromRoot(simulator.get_context())))
    # Ticks at 0, 5, ... 30 ms, the last just before.
    if caching:
        watched.assert_ticks_are_those_of_the_controller(7)
        assert len(np.unique(held, axis=0)) == 7
    else:
        assert len(np.unique([given for _, given in watched.calls], axis=0)) == 7


@pytest.mark.parametrize("scheme", ["runge_kutta2", "runge_kutta3", "explicit_euler"])
def test_one_torque_a_tick_on_a_continuous_plant(scheme):
    from pydrake.systems.analysis import ResetIntegratorFromFlags

    diagram, watched, start, scheme = on_closed_form(scheme)
    simulator = Simulator(diagram)
    ResetIntegratorFromFlags(simulator, scheme, 0.005)
    simulator.get_mutable_integrator().set_fixed_step_mode(scheme != "runge_kutta3")
    start(simulator.get_mutable_context())
    simulator.AdvanceTo(0.1)
    watched.assert_ticks_are_those_of_the_controller(21)


def test_a_context_whose_time_is_set_back_and_a_clone_begin_anew():
    diagram, watched, start = on_multibody(sampled=True)
    simulator, runs = Simulator(diagram), []
    fresh = simulator.get_context().Clone()
    for _ in range(2):
        context = simulator.get_mutable_context()
        context.SetTimeStateAndParametersFrom(fresh)
        start(context)
        simulator.Initialize()
        watched.calls.clear()
        simulator.AdvanceTo(0.05)
        watched.assert_ticks_are_those_of_the_controller(11)
        runs.append([given for _, given in watched.calls])
    np.testing.assert_array_equal(*runs)
    # With what the controller remembers, but from the start again: it goes on, tick by tick.
    simulator.get_mutable_context().SetTime(0.0)
    start(simulator.get_mutable_context())
    simulator.Initialize()
    watched.calls.clear()
    simulator.AdvanceTo(0.05)
    assert len(watched.calls) == 11
    twin = Simulator(diagram, simulator.get_context().Clone())
    watched.calls.clear()
    twin.AdvanceTo(0.1)
    assert len(watched.calls) == 10


def test_a_plant_is_opened_before_it_is_finished():
    def load(robot):
        body = robot.plant.AddRigidBody("load", robot.instance, SpatialInertia.SolidSphereWithMass(0.3, 0.02))
        robot.plant.WeldFrames(robot.frame("platform"), body.body_frame(), RigidTransform([0.0, 0.0, 0.03]))

    builder = DiagramBuilder()
    robot = add_plant(builder, ROBOT, before_finalize=load)
    assert robot.plant.HasBodyNamed("load")
    with pytest.raises(ConfigurationError, match=r"^name: expected one that no other system .* got 'plant'"):
        add_plant(builder, ROBOT)
    add_plant(builder, ROBOT, name="other")
