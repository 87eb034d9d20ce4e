"""Each LeafSystem by itself: its ports are those that its docstring names, and what it says is what its part says."""

import inspect
import re

import numpy as np
import pytest
from conftest import make_network
from ended import ended
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.systems.analysis import Simulator
from strategies import ROBOT, poses, vectors

from stewart_drake import systems
from stewart_drake.control.computed_torque import ComputedTorqueOptions
from stewart_drake.control.density import density
from stewart_drake.control.joint_pid import PidOptions
from stewart_drake.control.lqi import LqiOptions
from stewart_drake.errors import ConfigurationError, NotFiniteError
from stewart_drake.hardware.command_link import LinkOptions
from stewart_drake.hardware.motors import FrictionCompensation, MotorOptions
from stewart_drake.hardware.observer import ObserverOptions
from stewart_drake.hardware.sensors import EncoderOptions
from stewart_drake.mechanics.kinematics import inverse_kinematics, pose_jacobian
from stewart_drake.plant.multibody_plant import build_plant
from stewart_drake.plant.plant_options import PlantOptions
from stewart_drake.references import HoldReference, SineBurstsReference, paper_reference
from stewart_drake.safety import SafetyOptions
from stewart_drake.systems.sources import PlatformWrench

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


def test_every_system_is_looked_at():
    exported = {getattr(systems, name) for name in systems.__all__}
    assert {type(system) for system in EVERY + PLAIN} == exported - {systems.PartSystem} | {PlatformWrench}


@pytest.mark.parametrize("system", EVERY + PLAIN, ids=lambda system: type(system).__name__)
def test_ports_are_those_of_the_docstring(system):
    text = inspect.getdoc(type(system)).partition("Ports:")[2]
    if not text:
        # As `LqiController` has them, less the weights.
        text = inspect.getdoc(systems.LqiController).partition("Ports:")[2]
        text = re.sub(r" {4}weights:.*\n", "", text)
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
    # What it keeps is a port as well.
    ports.pop(("out", "result"), None)
    for way, name in re.findall(r"the port (out) of that name is `(\w+)_out`", text):
        told[way, name] = 6
    assert told == {key: port.size() for key, port in ports.items()}
    for (way, name), port in ports.items():
        attribute = f"{name}_out" if way == "out" and ("in", name) in ports else name
        assert getattr(system, attribute).get_index() == port.get_index()


# --- a tick is the part's ------------------------------------------------------------------------------------------


def wave(tick, size):
    return np.sin(0.3 * tick + np.arange(float(size)))


def signals(tick):
    """What may be at the ports at a tick; a platform in motion about its home."""
    pose = HOME + 0.01 * wave(tick, 6)
    measurement, angles = np.concatenate([pose, 0.05 * wave(tick, 6)]), inverse_kinematics(ROBOT, pose)
    return {
        "measurement": measurement,
        "reference": np.concatenate([HOME, 0.05 * wave(tick, 6), 0.1 * wave(tick, 6)]),
        "weights": np.array([1.0 + 0.1 * tick, 1.0]),
        "density": 1.0 + wave(tick, 12),
        "error": wave(tick, 6),
        "torque": 2.0 + wave(2 * tick, 6) * [1, 3, 5, 1, 3, 0],
        "command": 0.3 + 0.01 * wave(tick, 6),
        "reading": angles,
        "sent": 0.3 + 0.01 * wave(tick, 6),
        "disturbance": np.array([2.0]),
        "crank_state": np.concatenate([angles, pose_jacobian(ROBOT, pose) @ measurement[6:]]),
    }


def expected(system, ticks):
    """Outputs of the part by itself, tick by tick."""
    part, state, said = system.part, system.part.initial.copy(), []
    for tick in range(ticks):
        known = {**signals(tick), "time": np.array([tick * system.period])}
        part.tick(*(known[port] if port in known else part.source(port) for port in part.inputs), state)
        said.append({name: state[name].ravel().copy() for name in part.outputs})
    return said


@pytest.mark.parametrize("system", EVERY, ids=lambda system: type(system).__name__)
def test_it_answers_at_its_ticks_holds_between_them_and_remembers_in_the_context(system):
    part, known = system.part, signals(0)
    outputs = {n: getattr(system, f"{n}_out" if n in part.inputs else n) for n in part.outputs}

    def go(simulator, ticks):
        context, said = simulator.get_mutable_context(), []
        for tick in ticks:
            if tick:
                simulator.AdvanceTo(tick * system.period)
            for when in (tick, tick + 1):
                for name in part.inputs.keys() & known.keys():
                    system.GetInputPort(name).FixValue(context, signals(when)[name])
                said.append({name: port.Eval(context).copy() for name, port in outputs.items()})
                # The tick of this instant is done; what comes in later waits for the next one.
                simulator.AdvanceTo((tick + 0.5) * system.period)
        return said

    wanted = expected(system, 8)
    # What a late one says acts from half a tick on, here.
    wanted = [each for each in wanted for _ in range(2)]
    if part.late:
        wanted = [{n: part.initial[n].ravel() for n in part.outputs}, *wanted[:-1]]
    one = Simulator(system, system.CreateDefaultContext())
    said = go(one, range(4))
    twin = Simulator(system, one.get_context().Clone())
    for later in (go(one, range(4, 8)), go(twin, range(4, 8))):
        for got, each in zip(said + later, wanted, strict=True):
            for name in part.outputs:
                np.testing.assert_array_equal(got[name], each[name], err_msg=name)
    assert any(np.ptp([each[name] for each in wanted], axis=0).max() > 0.0 for name in part.outputs)


@pytest.mark.parametrize(("kind", "window"), [("magnitude", 1), ("signed", 4), ("magnitude", 49)])
def test_densities_are_those_of_the_last_samples(kind, window):
    seen = [np.concatenate([signals(k)["error"], signals(k)["torque"]]) for k in range(8)]
    for tick, said in enumerate(expected(systems.DensityFeatures(window, PERIOD, kind), 8)):
        samples = np.array(seen[max(0, tick - window) : tick + 1])
        np.testing.assert_allclose(said["density"], density(samples, kind), rtol=1e-12)


# --- the tuner of the paper ----------------------------------------------------------------------------------------


def test_weights_are_the_networks_answer_and_break_the_algebraic_loop(network):
    tuner = systems.AnnTuner(network, PERIOD, (2.0, 0.5))
    assert not tuner.HasAnyDirectFeedthrough()
    for tick, said in enumerate(expected(tuner, 5)):
        np.testing.assert_allclose(said["weights"], network.weights(signals(tick)["density"]), rtol=1e-10)
    for initial, held in (((99.0, 1e-9), (10.0, 0.1)), ((0.0, 0.0), (0.1, 0.1))):
        system = systems.AnnTuner(network, PERIOD, initial)
        np.testing.assert_array_equal(system.weights.Eval(system.CreateDefaultContext()), held)


@pytest.mark.parametrize("bad", [np.nan, -np.inf])
def test_a_density_that_is_not_finite_ends_the_run_with_its_time(network, bad):
    tuner = systems.AnnTuner(network, 0.005)
    simulator = Simulator(tuner, tuner.CreateDefaultContext())
    tuner.density.FixValue(simulator.get_mutable_context(), np.ones(12))
    simulator.AdvanceTo(0.0475)
    tuner.density.FixValue(simulator.get_mutable_context(), np.where(np.arange(12) == 7, bad, 1.0))
    error = ended(simulator, 0.2, NotFiniteError)
    assert error.signal == "density"
    assert error.time == pytest.approx(0.05, abs=1e-9)


@pytest.mark.parametrize("weights", [0, 1, 3])
def test_a_regulator_of_another_number_of_weights_is_refused(weights):
    with pytest.raises(ConfigurationError, match=r"weights.*2 or 4"):
        systems.LqiController(ROBOT, LqiOptions(), GRAVITY, weights)


# --- what has no tick ----------------------------------------------------------------------------------------------


@settings(max_examples=30)
@given(poses(0.8), vectors(6, 1.0), st.sampled_from(["universal", "ball"]))
def test_the_sensor_sees_the_plant_at_its_state(pose, rate, rod_joint):
    system = systems.TaskSpaceSensor(PLANTS[rod_joint])
    context = system.CreateDefaultContext()
    system.plant_state.FixValue(context, PLANTS[rod_joint].assemble(pose, rate))
    np.testing.assert_allclose(system.measurement.Eval(context), [*pose, *rate], atol=1e-12)
    cranks = [*inverse_kinematics(ROBOT, pose), *(pose_jacobian(ROBOT, pose) @ rate)]
    np.testing.assert_allclose(system.crank_state.Eval(context), cranks, atol=1e-11)


@pytest.mark.parametrize(
    "reference",
    [
        HoldReference(pose=(0.1, 0.2, 0.3, 0.01, 0.02, 0.3)),
        paper_reference(),
        SineBurstsReference(frequency=(1.0, 3.0), amplitude=((0.1, 0.05, 0.05, 0.01, 0.01, 0.02),) * 2),
    ],
    ids=lambda r: r.kind,
)
def test_the_reference_is_that_of_the_contexts_time_without_state_or_events(reference):
    system = systems.ReferenceSource(reference)
    context = system.CreateDefaultContext()
    assert context.num_total_states() == 0
    for time in (0.0, 0.3, 1.7, 0.3):  # back in time too: nothing stale in the cache
        context.SetTime(time)
        pose, rate, acceleration = reference.evaluate(time)
        np.testing.assert_array_equal(system.reference.Eval(context), [*pose, *rate, *acceleration])
    simulator = Simulator(system, system.CreateDefaultContext())
    simulator.AdvanceTo(2.0)
    assert simulator.get_num_steps_taken() <= 21  # of its own, the Simulator steps by 0.1 s
