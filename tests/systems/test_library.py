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
from stewart_drake.control.classical import ComputedTorqueOptions, PidOptions
from stewart_drake.control.lqi import LqiOptions
from stewart_drake.hardware.motors import FrictionCompensation, LinkOptions, MotorOptions
from stewart_drake.hardware.observer import ObserverOptions
from stewart_drake.hardware.sensors import EncoderOptions
from stewart_drake.mechanics.kinematics import inverse_kinematics, pose_jacobian
from stewart_drake.plant.multibody_plant import build_plant
from stewart_drake.plant.plant_options import PlantOptions
from stewart_drake.references import paper_reference
from stewart_drake.safety import SafetyOptions
from stewart_drake.systems.library import PlatformWrench

GRAVITY, PERIOD = 9.81, 0.001
HOME, ZERO = ROBOT.home_pose, np.zeros(6)
PLANTS = {kind: build_plant(ROBOT, PlantOptions(rod_joint=kind))[1] for kind in ("universal", "ball")}
PLANT = PLANTS["universal"]

ENCODERS = EncoderOptions(resolution_bits=17, rate_cutoff=80.0, noise=1e-4, hold_ticks=2)

EVERY = [
    systems.AnnTuner(make_network(), PERIOD),
    systems.CommandLink(LinkOptions(), PERIOD, 1, ZERO),
    systems.ComputedTorque(ROBOT, ComputedTorqueOptions(), GRAVITY),
    systems.DensityFeatures(4, PERIOD),
    systems.FrictionFeedforward(ROBOT, FrictionCompensation(coulomb=0.01), PERIOD),
    systems.JointPid(ROBOT, PidOptions(), GRAVITY),
    systems.LqiController(ROBOT, LqiOptions(solver="split", period=PERIOD), GRAVITY),
    systems.MotorDrive(MotorOptions(ripple=0.01), PERIOD),
    systems.MotorEncoders(ENCODERS, PERIOD),
    systems.PlatformObserver(ROBOT, ObserverOptions(), GRAVITY, PERIOD, 2e-5, HOME, ZERO, ZERO, size=6),
    systems.PoseEstimator(ROBOT, ENCODERS, PERIOD, HOME + 0.002),
    systems.SafetyLayer(ROBOT, SafetyOptions(), GRAVITY, PERIOD, ZERO),
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


@settings(max_examples=30)
@given(poses(0.8), vectors(6, 1.0), st.sampled_from(["universal", "ball"]))
def test_the_sensor_sees_the_plant_at_its_state(pose, rate, rod_joint):
    system = systems.TaskSpaceSensor(PLANTS[rod_joint])
    context = system.CreateDefaultContext()
    system.plant_state.FixValue(context, PLANTS[rod_joint].assemble(pose, rate))
    np.testing.assert_allclose(system.measurement.Eval(context), [*pose, *rate], atol=1e-12)
    cranks = [*inverse_kinematics(ROBOT, pose), *(pose_jacobian(ROBOT, pose) @ rate)]
    np.testing.assert_allclose(system.crank_state.Eval(context), cranks, atol=1e-11)
