import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import LogVectorOutput

from stewart_drake.control.density import density
from stewart_drake.sampling import on_grid
from stewart_drake.systems.density_features import DensityFeatures

PERIOD = 0.005


def error_at(time):
    return np.sin(40.0 * np.asarray(time)[..., None] + np.arange(6.0))


def torque_at(time):
    return 2.0 + np.cos(70.0 * np.asarray(time)[..., None] + np.arange(6.0)) * [1, 3, 5, 1, 3, 0]


class Source(LeafSystem):
    def __init__(self, signal, start=0.0):
        super().__init__()
        self.DeclareVectorOutputPort(
            "signal", 6, lambda c, o: o.SetFromVector(signal(start + c.get_time())), {self.time_ticket()}
        )


def wire(window, kind="magnitude", start=0.0, log_period=PERIOD):
    builder = DiagramBuilder()
    features = builder.AddSystem(DensityFeatures(window, PERIOD, kind))
    for signal, port in ((error_at, features.error), (torque_at, features.torque)):
        builder.Connect(builder.AddSystem(Source(signal, start)).get_output_port(), port)
    sink = LogVectorOutput(features.density, builder, publish_period=on_grid(log_period))
    return builder.Build(), features, sink


def expected(ticks, window, kind, start=0.0):
    times = start + on_grid(PERIOD) * np.arange(ticks)
    samples = np.concatenate([error_at(times), torque_at(times)], axis=1)
    return np.array([density(samples[max(0, k - window) : k + 1], kind) for k in range(ticks)])


def test_ports():
    system = DensityFeatures(49, PERIOD)
    assert {p.get_name(): p.size() for p in (system.error, system.torque)} == {"error": 6, "torque": 6}
    assert (system.density.get_name(), system.density.size()) == ("density", 12)
    assert (system.num_input_ports(), system.num_output_ports()) == (2, 2)


@pytest.mark.parametrize("kind", ["magnitude", "signed"])
@pytest.mark.parametrize("window", [1, 4, 49])
def test_it_is_the_density_of_the_last_m_plus_one_ticks_while_the_window_fills_and_after(window, kind):
    diagram, _, sink = wire(window, kind)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.5001)
    data = sink.FindLog(simulator.get_context()).data().T
    assert data.shape == (101, 12)
    np.testing.assert_allclose(data, expected(101, window, kind), rtol=1e-12)


def test_between_ticks_the_density_is_held_and_the_window_does_not_move():
    diagram, _, sink = wire(4, log_period=0.001)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.1001)
    data = sink.FindLog(simulator.get_context()).data().T
    np.testing.assert_allclose(data, np.repeat(expected(21, 4, "magnitude"), 5, axis=0)[:101], rtol=1e-12)


def test_two_contexts_have_two_windows():
    diagram, features, _ = wire(9)
    one, other = Simulator(diagram), Simulator(diagram)
    one.AdvanceTo(0.2001)
    other.AdvanceTo(0.0301)
    one.AdvanceTo(0.3001)
    for simulator, ticks in ((one, 61), (other, 7)):
        result = features.density.Eval(features.GetMyContextFromRoot(simulator.get_context()))
        np.testing.assert_allclose(result, expected(ticks, 9, "magnitude")[-1], rtol=1e-12)
    twin = Simulator(diagram, other.get_context().Clone())
    twin.AdvanceTo(0.2001)
    result = features.density.Eval(features.GetMyContextFromRoot(twin.get_context()))
    np.testing.assert_allclose(result, expected(41, 9, "magnitude")[-1], rtol=1e-12)


def test_the_first_density_is_one_whatever_the_signal():
    # A window of one sample: x over itself.
    diagram, features, _ = wire(49, start=0.123)
    result = features.density.Eval(features.GetMyContextFromRoot(diagram.CreateDefaultContext()))
    np.testing.assert_allclose(result, np.ones(12))
