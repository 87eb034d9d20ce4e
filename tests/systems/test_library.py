"""Each LeafSystem by itself: its ports are those that its docstring names; for its ticks see test_part_system."""

import inspect
import re

import numpy as np
import pytest
from conftest import make_network
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import ROBOT, poses, vectors

from stewart_drake import systems
from stewart_drake.control.lqi import LqiOptions
from stewart_drake.errors import ConfigurationError
from stewart_drake.mechanics.kinematics import inverse_kinematics, pose_jacobian
from stewart_drake.plant.multibody_plant import build_plant
from stewart_drake.plant.plant_options import PlantOptions
from stewart_drake.references import paper_reference
from stewart_drake.scenario import Scenario
from stewart_drake.systems.library import PlatformWrench

GRAVITY, PERIOD = 9.81, 0.001
PLANTS = {kind: build_plant(ROBOT, PlantOptions(rod_joint=kind))[1] for kind in ("universal", "ball")}
PLANT = PLANTS["universal"]

EVERY = [
    systems.AnnTuner(make_network(), PERIOD),
    systems.DensityFeatures(4, PERIOD),
    systems.LqiController(ROBOT, LqiOptions(solver="split", period=PERIOD), GRAVITY),
]
PLAIN = [PlatformWrench(PLANT, ()), systems.ReferenceSource(paper_reference()), systems.TaskSpaceSensor(PLANT)]
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
        told["out", "result"] = system.part.initial.view(float).size + 1
    assert told == {key: port.size() for key, port in ports.items()}
    for (way, name), port in ports.items():
        attribute = f"{name}_out" if way == "out" and ("in", name) in ports else name
        assert getattr(system, attribute).get_index() == port.get_index()


SCENARIOS = {
    systems.JointPid: {"controller": "pid"},
    systems.ComputedTorque: {"controller": "computed_torque"},
    systems.MotorEncoders: {"sensors": "encoders"},
    systems.PoseEstimator: {"sensors": "encoders"},
    systems.PlatformObserver: {"sensors": "encoders", "estimator": "observer"},
    systems.FrictionFeedforward: {"friction_compensation": {"coulomb": 0.01}},
    systems.CommandLink: {"link": {"drop_probability": 0.1}},
    systems.MotorDrive: {"motors": {"ripple": 0.1}},
    systems.SafetyLayer: {"safety": {}},
}


@pytest.mark.parametrize("kind", SCENARIOS, ids=lambda kind: kind.__name__)
def test_a_part_of_a_scenario_has_the_ports_that_its_class_names(kind):
    system = kind(Scenario(**SCENARIOS[kind]))
    line = " ".join(inspect.getdoc(kind).split())
    named = re.search(r"([a-z_, ]+) -> ([a-z_, ]+)", line)
    inputs, outputs = (set(re.findall(r"\w+", names)) for names in named.groups())
    assert (inputs, outputs) == (set(system.part.inputs) - {"time"}, set(system.part.outputs))


def test_a_scenario_without_the_part_is_refused():
    with pytest.raises(ConfigurationError, match=r"whose loop has the part observer.*; it has controller"):
        systems.PlatformObserver(Scenario())


def test_an_observer_wired_by_hand_knows_where_the_platform_is():
    system = systems.PlatformObserver(Scenario(sensors="encoders", estimator="observer"))
    context = system.CreateDefaultContext()
    home = ROBOT.home_pose
    system.reading.FixValue(context, inverse_kinematics(ROBOT, home))
    system.sent.FixValue(context, np.zeros(6))
    system.reference.FixValue(context, [*home, *np.zeros(12)])
    np.testing.assert_allclose(system.measurement.Eval(context)[:6], home, atol=1e-4)


@settings(max_examples=30)
@given(poses(0.8), vectors(6, 1.0), st.sampled_from(["universal", "ball"]))
def test_the_sensor_sees_the_plant_at_its_state(pose, rate, rod_joint):
    system = systems.TaskSpaceSensor(PLANTS[rod_joint])
    context = system.CreateDefaultContext()
    system.plant_state.FixValue(context, PLANTS[rod_joint].assemble(pose, rate))
    np.testing.assert_allclose(system.measurement.Eval(context), [*pose, *rate], atol=1e-12)
    cranks = [*inverse_kinematics(ROBOT, pose), *(pose_jacobian(ROBOT, pose) @ rate)]
    np.testing.assert_allclose(system.crank_state.Eval(context), cranks, atol=1e-11)


def test_the_reference_is_that_of_the_contexts_time_without_state_or_events():
    reference = paper_reference()
    system = systems.ReferenceSource(reference, PERIOD)
    context = system.CreateDefaultContext()
    assert context.num_total_states() == 0
    for time in (0.0, 0.3, 1.70005, 0.3):  # back in time too: nothing stale in the cache
        context.SetTime(time)
        expected = np.concatenate(reference.evaluate(time))
        np.testing.assert_allclose(system.reference.Eval(context), expected, rtol=0.0, atol=1e-12)
