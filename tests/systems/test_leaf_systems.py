"""Each LeafSystem by itself: its ports are those that its docstring names, and a tick of it is the pure function."""

import importlib
import inspect
import pkgutil
import re

import numpy as np
import pytest
from conftest import make_network
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import LeafSystem
from stewart_drake.systems.ann_tuner import NetworkTuner
from stewart_drake.systems.command_link import CommandLink
from stewart_drake.systems.computed_torque import ComputedTorque
from stewart_drake.systems.faulty_sensor import FaultySensor
from stewart_drake.systems.finite_check import FiniteCheck
from stewart_drake.systems.friction_feedforward import FrictionFeedforward
from stewart_drake.systems.joint_pid import JointPid
from stewart_drake.systems.motor_drive import MotorDrive
from stewart_drake.systems.motor_encoders import MotorEncoders
from stewart_drake.systems.platform_observer import PlatformObserver
from stewart_drake.systems.pose_estimator import PoseEstimator
from stewart_drake.systems.safety_layer import SafetyLayer
from stewart_drake.systems.setting_tuner import SettingSource
from stewart_drake.systems.ticked import SampledSystem, TickedSystem
from stewart_drake.systems.tracking_controller import TrackingController
from stewart_drake.systems.tracking_error import TrackingError
from strategies import ROBOT, poses, vectors

from stewart_drake import systems
from stewart_drake.control.computed_torque import ComputedTorqueMemory, ComputedTorqueOptions, computed_torque_tick
from stewart_drake.control.density import density
from stewart_drake.control.features import Site
from stewart_drake.control.inputs import Measurement, Setpoint
from stewart_drake.control.joint_pid import PidMemory, PidOptions, pid_tick
from stewart_drake.control.lqi import initial_memory as lqi_start
from stewart_drake.control.lqi import lqi_tick
from stewart_drake.control.lqi_options import LqiOptions
from stewart_drake.control.policy import Schedule, setting_part
from stewart_drake.hardware.command_link import LinkOptions
from stewart_drake.hardware.friction_feedforward import FrictionCompensation
from stewart_drake.hardware.motors import MotorOptions
from stewart_drake.hardware.observer import Observer, ObserverOptions
from stewart_drake.hardware.sensors import EncoderOptions, flat_estimate, initial_memory
from stewart_drake.mechanics.kinematics import inverse_kinematics
from stewart_drake.plant.multibody_plant import build_plant
from stewart_drake.plant.plant_options import PlantOptions
from stewart_drake.references import HoldReference, SineBurstsReference, paper_reference
from stewart_drake.safety import SafetyOptions
from stewart_drake.systems.density_features import DensityFeatures
from stewart_drake.systems.lqi_controller import LqiController
from stewart_drake.systems.platform_wrench import PlatformWrench
from stewart_drake.systems.reference_source import ReferenceSource
from stewart_drake.systems.task_space_sensor import TaskSpaceSensor

GRAVITY, PERIOD = 9.81, 0.001
HOME = ROBOT.home_pose
START = HOME + 0.002
PLANTS = {kind: build_plant(ROBOT, PlantOptions(rod_joint=kind))[1] for kind in ("universal", "ball")}
PLANT = PLANTS["universal"]
LQI = LqiOptions(solver="split", period=PERIOD)
ENCODERS = EncoderOptions(resolution_bits=17, rate_cutoff=80.0, hold_ticks=2)
OBSERVER = Observer(ROBOT, ObserverOptions(), GRAVITY, PERIOD, 2e-5)
SCHEDULE = Schedule(np.zeros(4), np.ones(4), threshold=2.0, hold=0.1)

EVERY = [
    NetworkTuner(make_network(), PERIOD),
    CommandLink(LinkOptions(), PERIOD, 1, np.zeros(6)),
    ComputedTorque(ROBOT, ComputedTorqueOptions(), GRAVITY),
    DensityFeatures(49, PERIOD),
    FaultySensor((), 12, PERIOD),
    FiniteCheck(),
    FrictionFeedforward(ROBOT, FrictionCompensation(), PERIOD),
    JointPid(ROBOT, PidOptions(), GRAVITY),
    LqiController(ROBOT, LQI, GRAVITY),
    MotorDrive(PLANT, MotorOptions()),
    MotorEncoders(PLANT, ENCODERS, PERIOD),
    PlatformWrench(PLANT, ()),
    PlatformObserver(OBSERVER, OBSERVER.initial(START, np.zeros(6), np.zeros(6), 1)),
    PoseEstimator(ROBOT, ENCODERS, PERIOD, START),
    ReferenceSource(paper_reference()),
    SafetyLayer(ROBOT, SafetyOptions(), GRAVITY, PERIOD, np.zeros(6)),
    SettingSource(setting_part(SCHEDULE, Site(PERIOD, 2e-5, PERIOD, 0.1), np.ones(4), 16.0), PERIOD),
    TaskSpaceSensor(PLANT),
    TrackingError(PERIOD),
]


def test_every_system_is_looked_at():
    found = set()
    for module in pkgutil.iter_modules(systems.__path__):
        for value in vars(importlib.import_module(f"stewart_drake.systems.{module.name}")).values():
            if (
                isinstance(value, type)
                and issubclass(value, LeafSystem)
                and value.__module__.startswith(systems.__name__)
            ):
                found.add(value)
    assert {type(system) for system in EVERY} == found - {TickedSystem, SampledSystem, TrackingController}


@pytest.mark.parametrize("system", EVERY, ids=lambda system: type(system).__name__)
def test_ports_are_those_of_the_docstring(system):
    text = inspect.getdoc(type(system)).partition("Ports:")[2]
    sizes = {"nq + nv": PLANT.plant.num_multibody_states(), "size": 12, None: 0}
    told = {
        name: (way, sizes[size] if size in sizes else int(size))
        for names, way, size in re.findall(r"^ {4}([\w, ]+): (in|out)(?: \(([^,)]*),\))?", text, re.M)
        for name in names.split(", ")
        for size in [size or None]
    }
    inputs = [system.get_input_port(k) for k in range(system.num_input_ports())]
    outputs = [system.get_output_port(k) for k in range(system.num_output_ports())]
    ports = {way: {p.get_name(): p for p in each} for way, each in (("in", inputs), ("out", outputs))}
    # What a ticked system keeps is a port as well.
    for name in ("result", "health"):
        ports["out"].pop(name, None)
    assert told == {name: (way, port.size()) for way in ports for name, port in ports[way].items()}
    for way in ports:
        for name, port in ports[way].items():
            assert getattr(system, name).get_index() == port.get_index()


# --- a tick is the pure function -----------------------------------------------------------------------------------


def wave(tick, size):
    return np.sin(0.3 * tick + np.arange(float(size)))


def tracked(tick):
    """What every controller sees at a tick."""
    measurement = np.concatenate([HOME + 0.01 * wave(tick, 6), 0.05 * wave(tick, 6)])
    reference = np.concatenate([HOME, np.zeros(6), 0.1 * wave(tick, 6)])
    return {"measurement": measurement, "reference": reference}


def with_weights(tick):
    return tracked(tick) | {"weights": np.array([1.0 + 0.1 * tick, 1.0])}


def by_memory(function, start, inputs):
    """Outputs of the pure ticks of a controller, one after the other."""

    def expected(ticks):
        memory, told = start, []
        for tick in range(ticks):
            seen = inputs(tick)
            measurement = Measurement(*np.split(seen["measurement"], 2))
            setpoint = Setpoint(*np.split(seen["reference"], 3))
            more = [seen["weights"]] if "weights" in seen else []
            memory = function(measurement, setpoint, *more, memory)
            told.append(memory._asdict())
        return told

    return inputs, expected


def samples(tick):
    return {"error": wave(tick, 6), "torque": 2.0 + wave(2 * tick, 6) * [1, 3, 5, 1, 3, 0]}


def densities(kind, window):
    def expected(ticks):
        seen = np.array([np.concatenate(list(samples(k).values())) for k in range(ticks)])
        return [{"density": density(seen[max(0, k - window) : k + 1], kind)} for k in range(ticks)]

    return samples, expected


def readings(tick):
    return {"angles": ENCODERS.read(inverse_kinematics(ROBOT, HOME + 0.02 * wave(tick, 6) * [1, 1, 1, 0.2, 0.1, 0.2]))}


def estimates(compiled):
    def expected(ticks):
        estimate, memory, told = flat_estimate(ROBOT, ENCODERS, PERIOD, compiled), initial_memory(START), []
        for tick in range(ticks):
            memory = estimate(readings(tick)["angles"], memory)
            told.append({"measurement": memory[:12]})
        return told

    return readings, expected


ZERO = np.zeros(6)
CASES = {
    "lqi": (
        LqiController(ROBOT, LQI, GRAVITY),
        *by_memory(lambda m, s, w, memory: lqi_tick(ROBOT, LQI, GRAVITY, m, s, w, memory), lqi_start(), with_weights),
    ),
    "pid": (
        JointPid(ROBOT, PidOptions(), GRAVITY),
        *by_memory(
            lambda m, s, memory: pid_tick(ROBOT, PidOptions(), GRAVITY, m, s, memory), PidMemory(ZERO, ZERO), tracked
        ),
    ),
    "computed torque": (
        ComputedTorque(ROBOT, ComputedTorqueOptions(), GRAVITY),
        *by_memory(
            lambda m, s, memory: computed_torque_tick(ROBOT, ComputedTorqueOptions(), GRAVITY, m, s, memory),
            ComputedTorqueMemory(ZERO, ZERO, ZERO),
            tracked,
        ),
    ),
    **{
        f"density, {kind}, {window}": (DensityFeatures(window, PERIOD, kind), *densities(kind, window))
        for kind, window in (("magnitude", 1), ("magnitude", 4), ("signed", 4), ("signed", 49))
    },
    **{
        f"estimator, {compiled=}": (
            PoseEstimator(ROBOT, ENCODERS, PERIOD, START, compiled=compiled),
            *estimates(compiled),
        )
        for compiled in (False, True)
    },
}


@pytest.mark.parametrize(("system", "inputs", "expected"), CASES.values(), ids=CASES.keys())
def test_a_tick_is_the_pure_function_answers_at_once_and_is_held(system, inputs, expected):
    def go(simulator, ticks):
        context, told = simulator.get_mutable_context(), []
        for tick in ticks:
            if tick:
                simulator.AdvanceTo(tick * system.period)
            for when in (tick, tick + 1):
                for name, value in inputs(when).items():
                    system.GetInputPort(name).FixValue(context, value)
                outputs = {name: system.GetOutputPort(name).Eval(context).copy() for name in names}
                told.append(outputs)
                # The tick of this instant is done; what comes in later waits for the next one.
                simulator.AdvanceTo((tick + 0.5) * system.period)
        return told

    wanted = expected(8)
    names = [name for name in wanted[0] if system.HasOutputPort(name)]
    one = Simulator(system, system.CreateDefaultContext())
    told = go(one, range(4))
    # All that it remembers lives in the Context.
    twin = Simulator(system, one.get_context().Clone())
    for later in (go(one, range(4, 8)), go(twin, range(4, 8))):
        for index, outputs in enumerate(told + later):
            for name in names:
                np.testing.assert_allclose(outputs[name], wanted[index // 2][name], rtol=1e-12, atol=1e-15)
    assert names


# --- what has no tick ----------------------------------------------------------------------------------------------


@settings(max_examples=30)
@given(poses(0.8), vectors(6, 1.0), st.sampled_from(["universal", "ball"]), st.sampled_from([0, 8, 17]))
def test_sensors_see_the_plant_at_its_state(pose, rate, rod_joint, bits):
    plant = PLANTS[rod_joint]
    options = EncoderOptions(resolution_bits=bits, offset=(0.01, -0.02, 0.03, 0.0, 0.05, -0.01))
    for system, port, expected in (
        (TaskSpaceSensor(plant), "measurement", np.concatenate([pose, rate])),
        (MotorEncoders(plant, options, PERIOD), "angles", options.read(inverse_kinematics(ROBOT, pose))),
    ):
        context = system.CreateDefaultContext()
        system.plant_state.FixValue(context, plant.assemble(pose, rate))
        np.testing.assert_allclose(system.GetOutputPort(port).Eval(context), expected, atol=1e-12)


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
    system = ReferenceSource(reference)
    context = system.CreateDefaultContext()
    assert context.num_total_states() == 0
    for time in (0.0, 0.3, 1.7, 0.3):  # back in time too: nothing stale in the cache
        context.SetTime(time)
        pose, rate, acceleration = reference.evaluate(time)
        np.testing.assert_array_equal(system.reference.Eval(context), [*pose, *rate, *acceleration])
    simulator = Simulator(system, system.CreateDefaultContext())
    simulator.AdvanceTo(2.0)
    assert simulator.get_num_steps_taken() <= 21  # of its own, the Simulator steps by 0.1 s
