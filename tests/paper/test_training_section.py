import itertools
import math

import numpy as np
import pytest
from conftest import make_network
from hypothesis import given
from hypothesis import strategies as st

from stewart_drake.paper.rendering import render
from stewart_drake.paper.training_section import (
    best_possible_scores,
    labels_apart,
    rounding_of_training,
    scores_of,
)
from stewart_drake.training.collect import OMEGAS
from stewart_drake.training.dataset import Dataset
from stewart_drake.training.train import TrainingOptions, TrainingResult, r_squared, split_samples, train_network

PAIRS = np.array(list(itertools.product(OMEGAS, OMEGAS)))
NAMES = ("omega_Q", "omega_R", "ratio")


def made_up(rows=30, seed=0, density="magnitude"):
    """Nine runs whose densities depend on the ratio of the weights and the tick alone."""
    ratio = np.round(np.log10(PAIRS[:, 0] / PAIRS[:, 1])).astype(int)
    noise = np.random.default_rng(seed).uniform(0.5, 1.5, (rows, 12))
    inputs = np.concatenate([noise + 0.4 * np.roll(np.eye(12)[0], k) * r for r in ratio for k in [r % 12]])
    inputs[:, 3] += 0.5 * np.repeat(ratio, rows)
    run = np.repeat(np.arange(9), rows)
    metadata = {"density": density, "window": 9}
    return Dataset(inputs, np.repeat(PAIRS, rows, axis=0), run, 0.005 * np.tile(np.arange(rows), 9), metadata)


# --- what nothing could learn --------------------------------------------------------------------------------------


def test_over_the_nine_pairs_half_of_each_weight_s_variance_is_irreducible():
    # Labels -1, 0, 1; ratio 0 has a variance of 2/3 left in three pairs, ratios -1 and 1 of 1/4 in two, the ends none:
    # (3 * 2/3 + 4 * 1/4) / (9 * 2/3) = 1/2.
    assert best_possible_scores() == pytest.approx({"omega_Q": 0.5, "omega_R": 0.5, "ratio": 1.0}, abs=1e-12)


def brute_force(labels, ratio):
    """R^2 of the least-squares fit of the labels over all functions of the ratio."""
    basis = (ratio[:, None] == np.unique(ratio)).astype(float)
    fit = basis @ np.linalg.lstsq(basis, labels, rcond=None)[0]
    return r_squared(labels, fit)


@given(st.lists(st.sampled_from(range(9)), min_size=2, max_size=40))
def test_the_bound_is_the_best_of_all_functions_of_the_ratio(which):
    outputs = PAIRS[which]
    logs = np.log10(outputs)
    ratio = np.round(logs[:, 0] - logs[:, 1], 6)
    bound = best_possible_scores(outputs)
    rng = np.random.default_rng(0)
    for name, label in zip(NAMES, (*logs.T, ratio), strict=True):
        if np.ptp(label) == 0.0:
            assert bound[name] is None
            continue
        assert bound[name] == pytest.approx(brute_force(label, ratio), abs=1e-9)
        for _ in range(5):
            guess = dict(zip(np.unique(ratio).tolist(), rng.uniform(-1, 1, len(np.unique(ratio))), strict=True))
            assert r_squared(label, np.array([guess[r] for r in ratio])) <= bound[name] + 1e-9


@pytest.mark.parametrize(
    ("validation", "expected"),
    [
        ([0], (1, 1)),  # 0.1/0.1 has the data of 1/1 and 10/10
        ([2], (1, 0)),  # 0.1/10 is alone with its ratio
        ([0, 4, 8], (3, 0)),  # all three of ratio 1
        ([0, 4, 2, 6], (4, 2)),
    ],
)
def test_validation_runs_whose_data_training_saw_under_other_labels_are_counted(validation, expected):
    dataset = made_up(rows=4)
    assert labels_apart(dataset, ~np.isin(dataset.run, validation)) == expected


def test_a_split_by_samples_has_no_run_apart():
    dataset = made_up()
    assert labels_apart(dataset, split_samples(dataset, TrainingOptions())) == (9, 0)


# --- scores --------------------------------------------------------------------------------------------------------


def test_a_score_that_does_not_exist_is_none():
    scores = {
        f"{side} R^2 of log {name}": 0.1 * k for side in ("training", "validation") for k, name in enumerate(NAMES)
    }
    scores["validation R^2 of log omega_R"] = math.nan
    result = TrainingResult(make_network(), np.ones(1), np.ones(1), scores)
    assert scores_of(result, "training") == {"omega_Q": 0.0, "omega_R": 0.1, "ratio": 0.2}
    assert scores_of(result, "validation") == {"omega_Q": 0.0, "omega_R": None, "ratio": 0.2}


# --- repeatability -------------------------------------------------------------------------------------------------


def test_training_again_is_compared_with_the_network_that_is_given():
    dataset, options = made_up(), TrainingOptions(epochs=40)
    network = train_network(dataset, options).network
    assert rounding_of_training(dataset, options, network) < 1e-9
    other = train_network(dataset, TrainingOptions(epochs=40, seed=1)).network
    expected = np.abs(other.log_weights(dataset.inputs) - network.log_weights(dataset.inputs)).max()
    assert rounding_of_training(dataset, options, other) == pytest.approx(expected, rel=1e-6)
    assert expected > 1e-3


@pytest.mark.parametrize(("repeatable", "words"), [(True, "the same weights file to the byte"), (False, "different")])
def test_whether_training_repeats_is_said(repeatable, words):
    numbers = {"repeatable": repeatable, "rounding_of_training": 1e-5}
    said = render("training", "repeatability", n=numbers, epochs=300)
    assert f"gave {words}" in said
    assert "up to 1.0e-05 apart" in said
