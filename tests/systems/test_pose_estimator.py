import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from strategies import ROBOT

from stewart_drake.errors import EncoderError
from stewart_drake.hardware.estimator import EncoderOptions, flat_estimate, initial_memory
from stewart_drake.mechanics.kinematics import inverse_kinematics
from stewart_drake.systems.pose_estimator import PoseEstimator

HOME = ROBOT.home_pose
PERIOD = 0.001
OPTIONS = EncoderOptions(resolution_bits=17, rate_cutoff=80.0, hold_ticks=2)
both = pytest.mark.parametrize("compiled", [False, True], ids=["numpy", "compiled"])


def make(compiled=False):
    return PoseEstimator(ROBOT, OPTIONS, PERIOD, HOME + 0.002, compiled=compiled)


def reading(tick):
    pose = HOME + 0.02 * np.sin(0.3 * tick) * np.array([1, -1, 1, 0.2, 0.1, -0.2])
    return OPTIONS.read(inverse_kinematics(ROBOT, pose))


def drive(system, simulator, ticks):
    """Measurement at each tick, the reading fixed shortly before it."""
    seen = []
    for tick in ticks:
        system.angles.FixValue(simulator.get_mutable_context(), reading(tick))
        simulator.AdvanceTo((tick + 0.5) * system.period)
        seen.append(system.measurement.Eval(simulator.get_context()).copy())
    return np.array(seen)


def start(system, angles):
    context = system.CreateDefaultContext()
    system.angles.FixValue(context, angles)
    return Simulator(system, context)


@pytest.mark.slow
@both
def test_a_tick_is_the_pure_function(compiled):
    system = make(compiled)
    assert (system.angles.size(), system.measurement.size()) == (6, 12)
    assert (system.num_input_ports(), system.num_output_ports()) == (1, 2)
    seen = drive(system, start(system, reading(0)), range(8))
    estimate, memory = flat_estimate(ROBOT, OPTIONS, PERIOD, compiled), initial_memory(HOME + 0.002)
    for tick in range(8):
        memory = estimate(reading(tick), memory)
        np.testing.assert_array_equal(seen[tick], memory[:12])
    assert np.abs(seen[3, 6:]).max() > 1.0


@pytest.mark.slow
def test_it_answers_within_the_tick_and_holds_until_the_next():
    system = make()
    simulator = start(system, reading(0))
    context = simulator.get_mutable_context()
    # Before the update of the first tick: what the controller asks for at that very instant.
    first = system.measurement.Eval(context).copy()
    np.testing.assert_allclose(first[:6], HOME, atol=1e-4)
    simulator.AdvanceTo(0.5 * PERIOD)
    system.angles.FixValue(context, reading(3))
    np.testing.assert_array_equal(system.measurement.Eval(context), first)


@pytest.mark.slow
def test_memory_lives_in_the_context_and_is_cloned_with_it():
    system = make()
    one = start(system, reading(0))
    drive(system, one, range(4))
    twin = Simulator(system, one.get_context().Clone())
    late = drive(system, twin, range(4, 7))
    other = drive(system, start(system, reading(0)), range(7))
    np.testing.assert_array_equal(drive(system, one, range(4, 7)), late)
    np.testing.assert_array_equal(other[4:], late)


@pytest.mark.slow
@both
def test_a_reading_that_fails_ends_the_run_at_its_time_after_the_ticks_held(compiled):
    system = make(compiled)
    simulator = start(system, reading(0))
    good = drive(system, simulator, range(3))[-1]
    system.angles.FixValue(simulator.get_mutable_context(), np.full(6, np.nan))
    simulator.AdvanceTo(4.5 * system.period)
    np.testing.assert_array_equal(system.measurement.Eval(simulator.get_context()), good)
    with pytest.raises(EncoderError) as caught:
        simulator.AdvanceTo(9.5 * system.period)
    assert caught.value.time == pytest.approx(5 * PERIOD)
