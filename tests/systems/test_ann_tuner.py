import numpy as np
import pytest
from conftest import make_network
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import LogVectorOutput

from stewart_drake.errors import NotFiniteError
from stewart_drake.sampling import on_grid
from stewart_drake.systems import AnnTuner

PERIOD = 0.005


def densities_at(time):
    return 1.0 + np.sin(90.0 * time + np.arange(12.0))


class Source(LeafSystem):
    def __init__(self, signal):
        super().__init__()
        self.DeclareVectorOutputPort(
            "density", 12, lambda c, o: o.SetFromVector(signal(c.get_time())), {self.time_ticket()}
        )


def wire(network, signal=densities_at, initial=(1.0, 1.0), log_period=PERIOD):
    builder = DiagramBuilder()
    tuner = builder.AddSystem(AnnTuner(network, PERIOD, initial))
    builder.Connect(builder.AddSystem(Source(signal)).get_output_port(), tuner.density)
    sink = LogVectorOutput(tuner.weights, builder, publish_period=on_grid(log_period))
    return builder.Build(), tuner, sink


def test_ports(network):
    system = AnnTuner(network, PERIOD)
    assert (system.density.get_name(), system.density.size()) == ("density", 12)
    assert (system.weights.get_name(), system.weights.size()) == ("weights", 2)
    assert (system.num_input_ports(), system.num_output_ports()) == (1, 1)
    assert not system.HasAnyDirectFeedthrough()  # otherwise the loop torque, density, weights would be algebraic


def test_weights_are_the_networks_answer_one_tick_later(network):
    diagram, _, sink = wire(network, initial=(2.0, 0.5))
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.2001)
    weights = sink.FindLog(simulator.get_context()).data().T
    np.testing.assert_array_equal(weights[0], [2.0, 0.5])
    answers = [network.weights(densities_at(k * on_grid(PERIOD))) for k in range(40)]
    np.testing.assert_allclose(weights[1:], answers, rtol=1e-12)
    assert np.ptp(weights, axis=0).min() > 0.1


def test_weights_are_held_between_ticks(network):
    diagram, _, sink = wire(network, log_period=0.001)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.1001)
    weights = sink.FindLog(simulator.get_context()).data().T
    # Row 5 k is the publish before the update of tick k; the rows up to the next tick show its answer.
    blocks = weights[1:].reshape(20, 5, 2)
    np.testing.assert_array_equal(blocks, np.broadcast_to(blocks[:, :1], blocks.shape))
    assert np.sum(np.any(blocks[1:, 0] != blocks[:-1, 0], axis=-1)) > 10


@pytest.mark.parametrize(("initial", "held"), [((99.0, 1e-9), (10.0, 0.1)), ((0.0, 0.0), (0.1, 0.1))])
def test_initial_weights_are_never_outside_the_trained_range_and_never_zero(network, initial, held):
    system = AnnTuner(network, PERIOD, initial)
    np.testing.assert_array_equal(system.weights.Eval(system.CreateDefaultContext()), held)


@pytest.mark.parametrize("value", [1e300, -1e300, 0.0])
def test_absurd_densities_stay_in_range(value):
    network = make_network(gain=100.0)
    diagram, tuner, _ = wire(network, lambda _: np.where(np.arange(12) % 2, value, -value))
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.011)
    weights = tuner.weights.Eval(tuner.GetMyContextFromRoot(simulator.get_context()))
    assert np.all((weights >= network.omega_min) & (weights <= network.omega_max))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("begin", [0.0, 0.05])
def test_a_density_that_is_not_finite_ends_the_run_with_its_time(network, bad, begin):
    def signal(time):
        values = densities_at(time)
        values[7] = bad if time >= begin else values[7]
        return values

    diagram, _, _ = wire(network, signal)
    with pytest.raises(NotFiniteError) as caught:
        Simulator(diagram).AdvanceTo(0.2)
    assert caught.value.signal == "density"
    assert caught.value.time == pytest.approx(begin, abs=1e-9)


def test_weights_live_in_the_context(network):
    diagram, tuner, _ = wire(network)
    one, other = Simulator(diagram), Simulator(diagram)
    one.AdvanceTo(0.0501)
    np.testing.assert_array_equal(tuner.weights.Eval(tuner.GetMyContextFromRoot(other.get_context())), [1.0, 1.0])
    twin = Simulator(diagram, one.get_context().Clone())
    for simulator in (one, twin):
        simulator.AdvanceTo(0.1001)
    first, second = (tuner.weights.Eval(tuner.GetMyContextFromRoot(s.get_context())) for s in (one, twin))
    np.testing.assert_array_equal(first, second)
    np.testing.assert_allclose(first, network.weights(densities_at(20 * on_grid(PERIOD))), rtol=1e-12)
