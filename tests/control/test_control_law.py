import copy
import json

import numpy as np
import pytest
from conftest import make_network, python
from strategies import ROBOT

from stewart_drake.control.control_law import ControlLaw
from stewart_drake.control.density import density
from stewart_drake.control.inputs import Measurement, Setpoint
from stewart_drake.control.lqi import initial_memory, lqi_tick
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
        memory = initial_memory()._replace(integral=states[k].integral)
        measurement, setpoint = Measurement(HOME + 0.01 * wave, rate), Setpoint(HOME, REST, REST)
        expected = lqi_tick(ROBOT, OPTIONS, law.gravity, measurement, setpoint, states[k].weights, memory)
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


@pytest.mark.parametrize("kind", ["magnitude", "signed"])
def test_the_law_is_pure(kind):
    law = law_with(make_network(density=kind), window=3, density_kind=kind)
    _, states = drive(law, 5)
    state = states[-1]
    kept = copy.deepcopy(state)
    first, second = drive(law, 4, state), drive(law, 4, state)
    np.testing.assert_array_equal(first[0], second[0])
    for name in ("integral", "weights", "window"):
        np.testing.assert_array_equal(getattr(state, name), getattr(kept, name))
    assert state.filled == kept.filled == 4


@pytest.mark.slow
def test_the_law_runs_where_drake_is_not_installed(tmp_path, network):
    network.save(tmp_path / "net.json")
    code = (
        "import sys, json\n"
        "sys.modules.update(pydrake=None, torch=None, pyarrow=None, matplotlib=None)\n"
        "import numpy as np\n"
        "from stewart_drake.control.control_law import ControlLaw\n"
        "from stewart_drake.control.inputs import Measurement, Setpoint\n"
        "from stewart_drake.control.lqi_options import LqiOptions\n"
        "from stewart_drake.control.network import load_network\n"
        "from stewart_drake.robot import RobotParameters\n"
        "robot = RobotParameters()\n"
        "law = ControlLaw(robot, LqiOptions(solver='split'), network=load_network(sys.argv[1]), window=4)\n"
        "state, torques, home, rest = law.initial_state(), [], robot.home_pose, np.zeros(6)\n"
        "for k in range(6):\n"
        "    pose = home + 0.01 * np.sin(0.3 * k + np.arange(6.0))\n"
        "    rate = 0.05 * np.cos(0.2 * k + np.arange(6.0))\n"
        "    torque, state = law(Measurement(pose, rate), Setpoint(home, rest, rest), state)\n"
        "    torques.append(torque.tolist())\n"
        "print(json.dumps(torques))\n"
    )
    torques = json.loads(python("-c", code, tmp_path / "net.json"))
    np.testing.assert_array_equal(torques, drive(law_with(network, window=4), 6)[0])


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
