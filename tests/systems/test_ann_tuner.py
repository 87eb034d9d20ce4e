import numpy as np
import pytest
from ended import ended
from pydrake.systems.analysis import Simulator

from stewart_drake.errors import NotFiniteError
from stewart_drake.systems import AnnTuner

PERIOD = 0.005


def densities_at(tick):
    return 1.0 + np.sin(0.45 * tick + np.arange(12.0))


@pytest.fixture(params=[False, True], ids=["numpy", "compiled"])
def tuner(network, request):
    return AnnTuner(network, PERIOD, (2.0, 0.5), compiled=request.param)


def drive(tuner, simulator, ticks):
    """Weights at each tick, and between it and the next."""
    context, told = simulator.get_mutable_context(), []
    for tick in ticks:
        if tick:
            simulator.AdvanceTo(tick * PERIOD)
        tuner.density.FixValue(context, densities_at(tick))
        told.append(tuner.weights.Eval(context).copy())
        simulator.AdvanceTo((tick + 0.5) * PERIOD)
        tuner.density.FixValue(context, np.zeros(12))
        told.append(tuner.weights.Eval(context).copy())
    return np.array(told)


def test_weights_are_the_networks_answer_one_tick_later_and_live_in_the_context(tuner, network):
    assert not tuner.HasAnyDirectFeedthrough()  # otherwise the loop torque, density, weights would be algebraic
    one = Simulator(tuner, tuner.CreateDefaultContext())
    told = drive(tuner, one, range(10))
    twin = Simulator(tuner, one.get_context().Clone())
    answers = [network.weights(densities_at(tick)) for tick in range(20)]
    for later in (drive(tuner, one, range(10, 20)), drive(tuner, twin, range(10, 20))):
        weights = np.concatenate([told, later])
        np.testing.assert_array_equal(weights[0], [2.0, 0.5])
        # A new answer from half a tick on, held over the next instant.
        np.testing.assert_allclose(weights[1:], np.repeat(answers, 2, axis=0)[:-1], rtol=1e-10)
    assert np.ptp(weights, axis=0).min() > 0.1


@pytest.mark.parametrize(("initial", "held"), [((99.0, 1e-9), (10.0, 0.1)), ((0.0, 0.0), (0.1, 0.1))])
def test_initial_weights_are_never_outside_the_trained_range_and_never_zero(network, initial, held):
    system = AnnTuner(network, PERIOD, initial)
    np.testing.assert_array_equal(system.weights.Eval(system.CreateDefaultContext()), held)


@pytest.mark.parametrize("bad", [np.nan, -np.inf])
def test_a_density_that_is_not_finite_ends_the_run_with_its_time(tuner, bad):
    simulator = Simulator(tuner, tuner.CreateDefaultContext())
    drive(tuner, simulator, range(10))
    tuner.density.FixValue(simulator.get_mutable_context(), np.where(np.arange(12) == 7, bad, 1.0))
    error = ended(simulator, 0.2, NotFiniteError)
    assert error.signal == "density"
    assert error.time == pytest.approx(0.05, abs=1e-9)
