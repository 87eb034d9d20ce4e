"""Training of the policy, on the slow robot with few situations: a run takes some hundredths of a second."""

import numpy as np
import pytest

from stewart_drake import ConfigurationError, run, run_metrics
from stewart_drake.base.records import record
from stewart_drake.control.features import CostScales
from stewart_drake.control.policy import Policy, policy_setting
from stewart_drake.control.tuners import PolicyTuner
from stewart_drake.logs.metrics import run_cost
from stewart_drake.studies.workers import Workers
from stewart_drake.training import policy_training
from stewart_drake.training.benchmark import HIGHEST, LOWEST
from stewart_drake.training.policy_training import (
    WEIGHTS,
    PolicyOptions,
    State,
    Training,
    episode_cost,
    episode_features,
    policy_of,
    train_policy,
)
from stewart_drake.training.situations import Case, situation

SMALL = PolicyOptions(generations=2, situations=1, pool=2, validation=1, robots=("reachy_mini",))


def state_of(training):
    # Without a run; the centre costs 1 everywhere.
    pool, validation = (np.zeros((2, len(cases))) for cases in (training.pool, training.validation))
    weights = np.zeros(WEIGHTS)
    return State(pool, validation, np.zeros(13), np.ones(13), weights, np.zeros((2, WEIGHTS)), weights)


def test_in_training_a_policy_trusts_itself_whatever_the_features():
    weights = np.random.default_rng(0).standard_normal(WEIGHTS)
    policy, setting = policy_of(weights, np.zeros(4)), np.empty(4)
    for features in (np.zeros(13), np.full(13, 8.0), np.full(13, -8.0)):
        assert policy_setting(record(policy.params()), features, setting) == 1.0
        assert np.abs(setting).max() > 0.01


@pytest.mark.slow
def test_an_episode_costs_what_the_same_run_from_a_file_costs(tmp_path):
    policy, kappa, case = Policy.load(), 0.4, Case("pushes", "reachy_mini", 7, 0.4)
    policy.save(tmp_path / "policy.json")
    tuner = {"kind": "policy", "weights_file": str(tmp_path / "policy.json"), "kappa": kappa}
    log = run(situation(*case[:3]).replace({"plant.kind": "closed_form", "plant.time_step": 0.005, "tuner": tuner}))
    expected = run_cost(run_metrics(log), log.status, 0.01, CostScales().at(kappa))
    assert np.exp(episode_cost(policy, case)) == pytest.approx(expected)
    features = episode_features(policy, case)
    assert features.shape == (28, 13)
    assert (features[:, -1] == kappa).all()


def test_each_kind_counts_alike_but_more_where_the_policy_is_behind():
    training = Training(PolicyOptions(pool=4, situations=2), Workers(0))
    chosen = training._batch(0)
    share = training._shares(chosen, np.zeros((1, len(chosen))))
    assert share.sum() == pytest.approx(1.0)
    kinds = np.array([training.pool[place][:2] for place in chosen])
    nod = (kinds == ("nod", "reachy_mini")).all(axis=1)
    fast = (kinds == ("fast", "paper")).all(axis=1)
    # Runs of the slow robot are short: twice as many.
    assert (nod.sum(), fast.sum()) == (4, 2)
    assert share[nod].sum() == pytest.approx(share[fast].sum())
    # Behind the second of two rows that stay.
    behind = training._shares(chosen, np.array([np.full(len(nod), -1.0), np.where(nod, np.log(2.0), -1.0)]))
    assert behind[nod].sum() == pytest.approx((1.0 + policy_training.FAIRNESS * np.log(2.0)) * share[nod].sum())
    assert behind[fast] == pytest.approx(share[fast])


def test_evolution_goes_down_and_keeps_its_best_generation(monkeypatch):
    bowl = np.random.default_rng(3).normal(size=WEIGHTS) * 0.05

    def cost(policy, case):
        layers = policy.hidden_weights, policy.hidden_bias, policy.output_weights, policy.output_bias
        away = np.concatenate([np.ravel(layer) for layer in layers]) - bowl
        return float(away @ away) + case.kappa

    monkeypatch.setattr(policy_training, "episode_cost", cost)
    monkeypatch.setattr(policy_training, "VALIDATED", 1)
    training = Training(PolicyOptions(generations=60, situations=4, pool=4, robots=("reachy_mini",)), Workers(0))
    state = state_of(training)
    state.validated += bowl @ bowl
    while state.generation < 60:
        state = training.step(state)
    assert state.least == state.history[:, 2].min()
    assert state.least < -0.5 * bowl @ bowl
    assert np.sum((state.best - bowl) ** 2) - bowl @ bowl == pytest.approx(state.least)


@pytest.mark.long
def test_interrupted_or_on_more_processes_it_comes_to_the_same_policy(tmp_path, monkeypatch):
    monkeypatch.setattr(policy_training, "cells_for", lambda robot, **_: [("hold", robot)])
    whole = train_policy(SMALL, workers=Workers(0))
    file = tmp_path / "policy.state"

    def stop(done, _):
        if done == 1.0:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_policy(SMALL, file, stop, Workers(0))
    again = train_policy(SMALL, file, workers=Workers(2))
    assert not file.exists()
    for name in Policy.record_type.fields:
        np.testing.assert_array_equal(getattr(whole, name), getattr(again, name))


def test_the_state_of_another_training_is_refused(tmp_path):
    file = tmp_path / "policy.state"
    state_of(Training(SMALL, Workers(0))).save(file, "its own")
    assert State.load(file, "its own").history.shape == (0, 3)
    with pytest.raises(ConfigurationError, match="of other options"):
        train_policy(SMALL, file, workers=Workers(0))


@pytest.mark.parametrize(
    "damage", [lambda good: good.replace(b"0.0", b"0.1", 1), lambda good: good[:-9], lambda _: b""]
)
def test_a_damaged_state_is_refused_and_an_unchanged_one_is_the_same(tmp_path, damage):
    file, state = tmp_path / "policy.state", state_of(Training(SMALL, Workers(0)))
    state.weights[:3], state.history = [0.1, 1e-300, -np.pi], np.array([[5.0, -0.3, -0.2]])
    state.save(file, "its own")
    for name, value in vars(State.load(file, "its own")).items():
        np.testing.assert_array_equal(value, getattr(state, name))
    file.write_bytes(damage(file.read_bytes()))
    with pytest.raises(ConfigurationError, match=r"an unchanged file from `stewart-drake train`, .*; remove it"):
        State.load(file, "its own")


def test_the_shipped_policy_is_one_and_names_the_revision_that_trained_it():
    policy = Policy.load()
    assert policy.to_bytes() == Policy.shipped.read_bytes()
    assert len(policy.provenance["versions"]["git_revision"]) == 40
    np.testing.assert_allclose(PolicyTuner().source().centre, policy.centre)
    assert (policy.lowest >= LOWEST - 1e-9).all()
    assert (policy.lowest + policy.width <= HIGHEST + 1e-9).all()
