"""Tuners of settings: their features, the settings that they may choose, and the file of a policy."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from strategies import ROBOT

from stewart_drake.base.records import record
from stewart_drake.control.features import DRIFT_TIME, FEATURES, TIMES, compute_features
from stewart_drake.control.policy import FADE, SIZE, STEP, Policy, policy_setting, setting_part, weights_of
from stewart_drake.control.riccati import chain_gain
from stewart_drake.control.tuners import ScheduleTuner

BASE, LEVEL = np.array([4e5, 30.0, 4e7, 1.0]), 16.0
CONTEXT = SimpleNamespace(period=1e-3, noise=2e-5, latency=2e-3, robot=ROBOT, disturbance=LEVEL)


def made(seed=0, reach=0.5, hull=8.0):
    rng, count = np.random.default_rng(seed), len(FEATURES)
    low, high = np.full(count, -hull), np.full(count, hull)
    hidden, output = rng.standard_normal((10, count)), rng.standard_normal((SIZE, 10))
    ends = np.full(SIZE, reach), np.full(SIZE, 2.0 * reach)
    centre = np.array([0.1, -0.2, 0.3, -0.4])
    layers = np.zeros(count), np.ones(count), hidden, np.zeros(10), output, np.zeros(4)
    return Policy(*layers, centre, *ends, low, high)


SOURCES = {
    "policy": (made(), made().lowest),
    "schedule": (
        ScheduleTuner(calm=(-0.2, 0.0, 0.1, -1.0), alert=(0.2, 0.1, 0.0, 0.5), threshold=1.5, hold=0.02),
        np.array([-0.2, 0.0, 0.0, -1.0]),
    ),
}


@given(st.floats(-0.5, 0.5), st.floats(0.5, 20.0))
def test_speed_is_a_change_of_the_unit_of_time(speed, s):
    faster, slow, fast = 10.0**speed, np.empty(3), np.empty(3)
    assert chain_gain(s, 1e-3 * faster, weights_of(BASE, np.zeros(SIZE)), slow)
    assert chain_gain(s, 1e-3, weights_of(BASE, np.array([speed, 0.0, 0.0, 0.0])), fast)
    np.testing.assert_allclose(fast, slow * faster ** np.array([2.0, 1.0, 3.0]), rtol=1e-7)


def features_after(*inputs):
    """Features by name after the last of several ticks."""
    out, policy = np.empty(len(FEATURES)), made()

    def kernel(params, _, *rest):
        compute_features(params, *rest, out)

    source = SimpleNamespace(centre=policy.centre, width=policy.width, params=policy.params, kernel=kernel)
    part = setting_part(source, CONTEXT, BASE, 0.3)
    state = part.initial.copy()
    for each in inputs:
        part.tick(*each, state)
    return dict(zip(FEATURES, out, strict=True))


def test_features_are_what_their_names_say():
    none, density = np.zeros(6), np.full(12, 2.0)
    reference = np.concatenate([none, [0.0, 0.0, 2.0, 0.0, 0.3, 0.0], [0.0] * 5 + [4.0]])
    error = np.array([np.radians(0.03), 0.0, 0.0, 0.0, 0.03e-3, 0.0])
    torque = np.array([0.03 * 6.0**0.5, 0.0, 0.0, 0.0, 0.0, 0.0])
    values = features_after(
        (density, none, none, none, reference), (density, error, torque, np.full(6, 6e-5), reference)
    )
    share = dict(zip(("surprise", "surprise_slow", "error", "error_slow", "torque_change"), TIMES, strict=True))
    share = {name: CONTEXT.period / (CONTEXT.period + time) for name, time in share.items()}
    for name in ("surprise", "surprise_slow"):
        quiet = 1.0 - share[name]
        assert 10.0 ** values[name] == pytest.approx(quiet**2 + 9.0 * share[name] + 0.01)
    for name in ("error", "error_slow"):
        assert 10.0 ** values[name] == pytest.approx(2.0 * share[name] + 1e-6)
    assert 10.0 ** values["torque_change"] == pytest.approx(share["torque_change"] + 1e-6)
    drift = 3.0 * CONTEXT.period / (CONTEXT.period + DRIFT_TIME)
    assert 10.0 ** values["drift"] == pytest.approx(drift**2 + 1e-3)
    assert 10.0 ** values["speed"] == pytest.approx(np.hypot(0.22, 0.3) + 1e-3)
    assert 10.0 ** values["acceleration"] == pytest.approx(4.01)
    assert (10.0 ** values["noise"], 10.0 ** values["latency"]) == (pytest.approx(2.0), pytest.approx(2.0))
    assert (values["kappa"], 10.0 ** values["error_density"]) == (0.3, pytest.approx(2.1))
    first = features_after((density, none, np.full(6, 5.0), none, reference))
    assert first["torque_change"] == pytest.approx(-6.0)


wild = arrays(float, 54, elements=st.floats(allow_nan=True, allow_infinity=True, width=64))


@given(st.sampled_from([*SOURCES]), st.lists(wild, min_size=1, max_size=4))
def test_whatever_comes_in_a_setting_stays_in_its_box_and_moves_by_a_small_share_of_it(name, inputs):
    source, lowest = SOURCES[name]
    part = setting_part(source, CONTEXT, BASE, 0.3)
    memory = part.initial.copy()
    setting = memory["setting"][0, :4]
    np.testing.assert_array_equal(setting, source.centre)
    for values in inputs:
        before = setting.copy()
        part.tick(*np.split(values, [12, 18, 24, 36 - 6]), memory)
        assert (setting >= lowest - 1e-12).all()
        assert (setting <= lowest + source.width + 1e-12).all()
        assert (np.abs(setting - before) <= STEP * source.width + 1e-12).all()
        np.testing.assert_allclose(memory["weights"][0], weights_of(BASE, setting))
        assert memory["disturbance"][0, 0] == pytest.approx(LEVEL * 10.0 ** setting[3])
        assert 0.0 <= memory["setting"][0, 4] <= 1.0


@pytest.mark.parametrize(("beyond", "expected"), [(0.0, 1.0), (0.5 * FADE, 0.5), (FADE, 0.0), (np.nan, 0.0)])
def test_for_a_robot_unlike_those_of_its_training_a_policy_fades_to_the_centre(beyond, expected):
    policy, setting = made(hull=2.0), np.empty(SIZE)
    features = np.eye(len(FEATURES))[3]
    features[FEATURES.index("latency")] = 2.0 + beyond
    assert policy_setting(record(policy.params()), features, setting) == pytest.approx(expected)
    assert ((setting == policy.centre) == (expected == 0.0)).all()


def test_a_signal_beyond_those_of_its_training_counts_as_the_largest_of_them():
    policy, largest, beyond = made(hull=2.0), np.empty(SIZE), np.empty(SIZE)
    features = 2.0 * np.eye(len(FEATURES))[0]
    assert policy_setting(record(policy.params()), features, largest) == 1.0
    assert policy_setting(record(policy.params()), 50.0 * features, beyond) == 1.0
    np.testing.assert_array_equal(beyond, largest)
    assert (largest != policy.centre).all()


@pytest.mark.parametrize("hold", [0.0, 0.02])
def test_a_schedule_is_alert_while_innovations_are_large_and_for_its_hold_time(hold):
    schedule = ScheduleTuner(alert=(1.0,) * SIZE, threshold=1.5, hold=hold)
    part, quiet = setting_part(schedule, CONTEXT, BASE, 0.3), [np.ones(12), *np.zeros((3, 6)), np.zeros(18)]
    loud = [*quiet[:3], np.full(6, 1e-4), quiet[4]]
    state, places = part.initial.copy(), [0.0]
    for inputs in [quiet] * 20 + [loud] * 40 + [quiet] * 200:
        part.tick(*inputs, state)
        places.append(state["setting"][0, 0])
    assert places[20] == places[0]
    assert (places[60], places[-1]) == (pytest.approx(1.0), pytest.approx(0.0, abs=1e-12))
    # The mean of the squares, of 10 ms, rises towards 25, and falls below 1.5^2 - 0.01 within some 25 ticks.
    kept = 1.0 - CONTEXT.period / (CONTEXT.period + TIMES[0])
    level = 25.0 + (kept**20 - 25.0) * kept**40
    ticks = np.ceil(np.log((1.5**2 - 0.01) / level) / np.log(kept))
    assert np.flatnonzero(np.diff(places[60:]) < 0.0)[0] == pytest.approx(ticks - 1 + hold / CONTEXT.period, abs=1)
