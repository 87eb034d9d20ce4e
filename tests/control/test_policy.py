"""Tuners of settings: what they hear, what they may answer, and the file of a policy."""

import json

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from stewart_drake.compiled.constants import TUNER_MEMORY
from stewart_drake.control.features import DRIFT_TIME, FEATURES, TIMES, Heard, Site, features, nothing_yet
from stewart_drake.control.policy import FADE, Layers, Policy, Schedule, answer, load_policy, setting_part
from stewart_drake.control.riccati import chain_gains
from stewart_drake.control.settings import SIZE, STEP, disturbance_of, weights_of
from stewart_drake.errors import ConfigurationError

AT = TUNER_MEMORY
BASE, LEVEL = np.array([4e5, 30.0, 4e7, 1.0]), 16.0
SITE = Site(period=1e-3, noise=2e-5, latency=2e-3, length=0.11, kappa=0.3)


def made(seed=0, reach=0.5, hull=8.0):
    rng, count = np.random.default_rng(seed), len(FEATURES)
    low, high = np.full(count, -hull), np.full(count, hull)
    hidden, output = rng.standard_normal((10, count)), rng.standard_normal((SIZE, 10))
    ends = np.full(SIZE, reach), np.full(SIZE, 2.0 * reach)
    centre = np.array([0.1, -0.2, 0.3, -0.4])
    return Policy(
        Layers(np.zeros(count), np.ones(count), hidden, np.zeros(10), output, np.zeros(4), centre, *ends, low, high)
    )


CHOOSERS = {
    "policy": made(),
    "schedule": Schedule(np.array([-0.2, 0.0, 0.1, -1.0]), np.array([0.2, 0.1, 0.0, 0.5]), threshold=1.5, hold=0.02),
}


def heard(rng, size=1.0):
    return (
        rng.uniform(0.0, 3.0, 12),
        size * 1e-5 * rng.standard_normal(6),
        size * 1e-2 * rng.standard_normal(6),
        size * 3e-5 * rng.standard_normal(6),
        size * rng.standard_normal(18),
    )


def box(memory):
    return memory[AT.setting : AT.outside]


# --- what a setting does ---------------------------------------------------------------------------------------------


@given(st.floats(-0.5, 0.5), st.floats(0.5, 20.0))
def test_speed_is_a_change_of_the_unit_of_time(speed, s):
    faster = 10.0**speed
    slow = chain_gains(np.array([s]), 1e-3 * faster, weights_of(BASE, np.zeros(SIZE)))[0]
    fast = chain_gains(np.array([s]), 1e-3, weights_of(BASE, np.array([speed, 0.0, 0.0, 0.0])))[0]
    np.testing.assert_allclose(fast, slow * faster ** np.array([2.0, 1.0, 3.0]), rtol=1e-7)


def test_the_other_three_act_on_one_number_each():
    decades = np.array([0.0, 1.0, 2.0, -1.0])
    np.testing.assert_allclose(weights_of(BASE, decades), BASE * [1.0, 10.0, 100.0, 1.0])
    assert disturbance_of(LEVEL, decades) == pytest.approx(1.6)


# --- what is heard ---------------------------------------------------------------------------------------------------


def test_features_are_what_their_names_say():
    none = np.zeros(6)
    reference = np.concatenate([none, [0.0, 0.0, 2.0, 0.0, 0.3, 0.0], [0.0] * 5 + [4.0]])
    tilt, shift = np.radians(0.03), 0.03e-3
    first = Heard(np.full(12, 2.0), none, none, none, reference)
    second = first._replace(
        error=np.array([tilt, 0.0, 0.0, 0.0, shift, 0.0]),
        innovation=np.full(6, 6e-5),
        torque=np.array([0.03 * 6.0**0.5, 0.0, 0.0, 0.0, 0.0, 0.0]),
    )
    _, recent = features(SITE, first, nothing_yet(none))
    found, _ = features(SITE, second, recent)
    values = dict(zip(FEATURES, found, strict=True))
    share = dict(zip(("surprise", "surprise_slow", "error", "error_slow", "torque_change"), TIMES, strict=True))
    share = {name: SITE.period / (SITE.period + time) for name, time in share.items()}
    quiet = 1.0 - share["surprise"]
    assert 10.0 ** values["surprise"] == pytest.approx(quiet**2 + 9.0 * share["surprise"] + 0.01)
    assert 10.0 ** values["error"] == pytest.approx(2.0 * share["error"] + 1e-6)
    assert 10.0 ** values["torque_change"] == pytest.approx(share["torque_change"] + 1e-6)
    assert 10.0 ** values["drift"] == pytest.approx((3.0 * SITE.period / (SITE.period + DRIFT_TIME)) ** 2 + 1e-3)
    assert 10.0 ** values["speed"] == pytest.approx(np.hypot(0.22, 0.3) + 1e-3)
    assert 10.0 ** values["acceleration"] == pytest.approx(4.01)
    assert (10.0 ** values["noise"], 10.0 ** values["latency"]) == (pytest.approx(2.0), pytest.approx(2.0))
    assert (values["kappa"], 10.0 ** values["error_density"]) == (0.3, pytest.approx(2.1))


def test_the_first_torque_is_no_change():
    loud = Heard(np.ones(12), np.zeros(6), np.full(6, 5.0), np.zeros(6), np.zeros(18))
    found, _ = features(SITE, loud, nothing_yet(np.zeros(6)))
    assert found[FEATURES.index("torque_change")] == pytest.approx(-6.0)


def test_torch_hears_the_same_of_many_loops():
    rng = np.random.default_rng(2)
    each = [[heard(rng) for _ in range(5)] for _ in range(3)]
    recents, founds = [nothing_yet(np.zeros(6)) for _ in range(3)], []
    site = SITE._replace(
        noise=torch.tensor([2e-5] * 3), latency=torch.tensor([2e-3] * 3), kappa=torch.tensor([0.3] * 3)
    )
    together = nothing_yet(torch.zeros(3, 6, dtype=torch.float64))
    for tick in range(5):
        stacked = [torch.from_numpy(np.stack([loop[tick][k] for loop in each])) for k in range(5)]
        found, together = features(site, Heard(*stacked), together)
        pairs = [features(SITE, Heard(*loop[tick]), recent) for loop, recent in zip(each, recents, strict=True)]
        founds, recents = [one for one, _ in pairs], [one for _, one in pairs]
    np.testing.assert_allclose(found.numpy(), founds, rtol=1e-6)
    answers = answer(Layers(*(torch.from_numpy(part) for part in made().layers)), found)[0]
    np.testing.assert_allclose(answers.numpy(), [answer(made().layers, one)[0] for one in founds], rtol=1e-5, atol=1e-7)


# --- what may be answered --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", CHOOSERS)
def test_compiled_is_the_same(name):
    rng = np.random.default_rng(1)
    parts = [setting_part(CHOOSERS[name], SITE, BASE, LEVEL, compiled) for compiled in (False, True)]
    memories = [part.initial for part in parts]
    for tick in range(100):
        given_now = heard(rng, 10.0 ** rng.uniform(-2.0, 2.0))
        if tick == 50:
            given_now[1][2] = np.nan
        memories = [part.tick(*given_now, memory) for part, memory in zip(parts, memories, strict=True)]
        np.testing.assert_allclose(*memories, rtol=1e-9, atol=1e-12)
    assert np.abs(box(memories[0]) - CHOOSERS[name].centre).max() > 0.01


wild = arrays(float, 54, elements=st.floats(allow_nan=True, allow_infinity=True, width=64))


@given(st.sampled_from([*CHOOSERS]), st.lists(wild, min_size=1, max_size=4))
def test_whatever_is_heard_a_setting_stays_in_its_box_and_moves_by_a_small_share_of_it(name, inputs):
    chooser = CHOOSERS[name]
    part = setting_part(chooser, SITE, BASE, LEVEL)
    memory = part.initial
    np.testing.assert_array_equal(box(memory), chooser.centre)
    for values in inputs:
        before, memory = memory, part.tick(*np.split(values, [12, 18, 24, 36 - 6]), memory)
        assert (box(memory) >= chooser.lowest - 1e-12).all()
        assert (box(memory) <= chooser.lowest + chooser.width + 1e-12).all()
        assert (np.abs(box(memory) - box(before)) <= STEP * chooser.width + 1e-12).all()
        np.testing.assert_allclose(memory[: AT.disturbance], weights_of(BASE, box(memory)))
        assert memory[AT.disturbance] == pytest.approx(disturbance_of(LEVEL, box(memory)))
        assert 0.0 <= memory[AT.outside] <= 1.0


def test_outside_of_what_it_was_trained_on_a_policy_fades_to_the_centre():
    policy = made(hull=2.0)
    inside = np.zeros(len(FEATURES))
    inside[3] = 1.0
    for step, expected in ((0.0, 1.0), (0.5 * FADE, 0.5), (FADE, 0.0), (50.0, 0.0)):
        off = inside.copy()
        off[5] = 2.0 + step
        wanted, own = answer(policy.layers, off)
        assert own == pytest.approx(expected)
        if not expected:
            np.testing.assert_array_equal(wanted, policy.centre)
        else:
            assert (wanted != policy.centre).all()
    for missing in (np.nan, np.inf):
        wanted, own = answer(policy.layers, np.where(np.arange(len(FEATURES)) == 4, missing, inside))
        assert own == 0.0
        np.testing.assert_array_equal(wanted, policy.centre)


def test_what_is_not_finite_leads_to_the_centre_and_is_forgotten():
    part, rng = setting_part(made(), SITE, BASE, LEVEL), np.random.default_rng(3)
    memory = part.initial
    for _ in range(50):
        memory = part.tick(*heard(rng), memory)
    for _ in range(200):
        memory = part.tick(np.ones(12), np.full(6, np.nan), np.zeros(6), np.zeros(6), np.zeros(18), memory)
    np.testing.assert_allclose(box(memory), made().centre)
    assert memory[AT.outside] == 1.0
    memory = part.tick(*heard(rng), memory)
    assert np.isfinite(memory).all()
    assert memory[AT.outside] < 1.0


def test_a_schedule_is_alert_for_as_long_as_it_says():
    schedule = CHOOSERS["schedule"]
    calm, held = schedule.choose(np.zeros(13), 0.0, 1e-3)[::2]
    np.testing.assert_array_equal(calm, schedule.calm)
    loud = np.zeros(13)
    loud[0] = 2.0 * np.log10(1.6)
    alert, _, held = schedule.choose(loud, held, 1e-3)
    np.testing.assert_array_equal(alert, schedule.alert)
    ticks = 0
    while held > 0.0:
        wanted, _, held = schedule.choose(np.zeros(13), held, 1e-3)
        ticks += 1
    assert ticks == pytest.approx(20, abs=1)
    np.testing.assert_array_equal(wanted, schedule.calm)


def test_a_schedule_without_a_hold_is_alert_while_it_is_surprised():
    schedule, loud = Schedule(np.zeros(SIZE), np.ones(SIZE), threshold=1.5, hold=0.0), np.zeros(13)
    loud[0] = 1.0
    np.testing.assert_array_equal(schedule.choose(loud, 0.0, 1e-3)[0], schedule.alert)
    np.testing.assert_array_equal(schedule.choose(np.zeros(13), 0.0, 1e-3)[0], schedule.calm)


# --- the file --------------------------------------------------------------------------------------------------------


def test_a_file_gives_back_the_policy(tmp_path):
    policy = made()
    policy.provenance["seeds"] = [1, 2]
    policy.save(tmp_path / "policy.json")
    found = load_policy(tmp_path / "policy.json")
    assert found.to_bytes() == policy.to_bytes()
    assert found.provenance == {"seeds": [1, 2]}


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"features": ["error"]}, "features"),
        ({"scale": [0.0] * 13}, "scale"),
        ({"below": [1.0, 1.0, 1.0]}, "below"),
        ({"low": [9.0] * 13}, "low"),
        ({"hidden": [[1.0]]}, "hidden"),
        ({"provenance": 3}, "provenance"),
        ({"version": 99}, "version"),
    ],
)
def test_other_files_are_refused_by_the_key(tmp_path, change, key):
    from stewart_drake.files.whole import seal, unseal

    document = {**unseal(json.loads(made().to_bytes())), **change}
    (tmp_path / "policy.json").write_text(json.dumps(seal(document)))
    with pytest.raises(ConfigurationError) as caught:
        load_policy(tmp_path / "policy.json")
    assert key in caught.value.key
