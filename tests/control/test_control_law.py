import numpy as np
import pytest
from stewart_drake.control.control_law import ControlLaw
from strategies import ROBOT
from ticks import ticked

from stewart_drake.control.density import density
from stewart_drake.control.inputs import Measurement, Setpoint
from stewart_drake.control.lqi import lqi_part
from stewart_drake.control.lqi_options import LqiOptions
from stewart_drake.errors import StewartDrakeError

HOME = ROBOT.home_pose
REST = np.zeros(6)
OPTIONS = LqiOptions(solver="split")


def drive(law, ticks, state=None):
    """Torques, states and samples along a motion that the controller does not influence."""
    state = law.initial_state() if state is None else state
    torques, states = [], [state]
    for k in range(ticks):
        wave = np.sin(0.3 * k + np.arange(6.0))
        measurement = Measurement(HOME + 0.01 * wave, 0.05 * np.cos(0.2 * k + np.arange(6.0)))
        torque, state = law(measurement, Setpoint(HOME, REST, REST), state)
        torques.append(torque)
        states.append(state)
    return np.array(torques), states


def law_with(network, **changes):
    return ControlLaw(**{"robot": ROBOT, "options": OPTIONS, "network": network, **changes})


def test_weights_found_in_a_tick_act_in_the_next(network):
    law = law_with(network, window=4, initial_weights=(2.0, 0.5))
    torques, states = drive(law, 8)
    history = []
    for k in range(8):
        wave = np.sin(0.3 * k + np.arange(6.0))
        rate = 0.05 * np.cos(0.2 * k + np.arange(6.0))
        part = lqi_part(OPTIONS, ROBOT, law.gravity, 2)
        at = HOME + 0.01 * wave, rate, Setpoint(HOME, REST, REST), states[k].weights
        expected = ticked(part, *at, integral=states[k].integral)
        np.testing.assert_array_equal(torques[k], expected.torque)
        np.testing.assert_array_equal(states[k + 1].integral, expected.integral)
        history.append(np.concatenate([expected.error, expected.torque]))
        features = density(np.array(history[-5:]))
        np.testing.assert_allclose(states[k + 1].weights, network.weights(features), rtol=1e-12)
    np.testing.assert_array_equal(states[0].weights, [2.0, 0.5])
    assert len({tuple(state.weights) for state in states}) > 3  # the network does answer


def test_without_a_network_the_weights_stay():
    _, states = drive(law_with(None, initial_weights=(3.0, 0.2)), 3)
    for state in states:
        np.testing.assert_array_equal(state.weights, [3.0, 0.2])


def test_initial_weights_are_held_within_the_networks_range(network):
    np.testing.assert_array_equal(law_with(network, initial_weights=(99.0, 1e-6)).initial_state().weights, [10.0, 0.1])
    np.testing.assert_array_equal(law_with(None, initial_weights=(99.0, 1e-6)).initial_state().weights, [99.0, 1e-6])


def test_the_law_is_pure(network):
    law = law_with(network, window=3)
    state = drive(law, 5)[1][-1]
    kept = [each.copy() for each in state]
    first, second = drive(law, 4, state), drive(law, 4, state)
    np.testing.assert_array_equal(first[0], second[0])
    for now, before in zip(state, kept, strict=True):
        np.testing.assert_array_equal(now, before)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"window": 0}, "window"),
        ({"window": 2.5}, "window"),
        ({"density_kind": "loud"}, "magnitude or signed"),
        ({"density_kind": "signed"}, "as the network was trained on"),
        ({"initial_weights": (1.0, 0.0)}, "positive"),
        ({"initial_weights": (1.0, 1.0, 1.0, 1.0)}, "two, with a network"),
    ],
)
def test_what_cannot_be_a_law_is_refused_when_it_is_made(network, changes, words):
    with pytest.raises(StewartDrakeError, match=words):
        ControlLaw(ROBOT, network=network, **changes)
