import itertools
import math

import numpy as np
import pytest
from conftest import make_network
from hypothesis import given
from hypothesis import strategies as st

from stewart_drake.control.network import load_network
from stewart_drake.errors import ConfigurationError
from stewart_drake.paper import training_section as section_module
from stewart_drake.paper.plots.training_plots import plot_learning_curves, plot_predictions
from stewart_drake.paper.rendering import render
from stewart_drake.paper.study import Study
from stewart_drake.paper.training_section import (
    best_possible_scores,
    labels_apart,
    make,
    rounding_of_inference,
    rounding_of_training,
    scores_of,
)
from stewart_drake.scenario import Scenario
from stewart_drake.training.collect import OMEGAS
from stewart_drake.training.dataset import Dataset, load_dataset
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


def test_a_network_that_knows_the_ratio_alone_stays_below_the_bound():
    dataset = made_up()
    result = train_network(dataset, TrainingOptions(epochs=300, training_share=0.99))
    training = split_samples(dataset, TrainingOptions(training_share=0.99))
    bound = best_possible_scores(dataset.outputs[training])
    for name in NAMES:
        assert result.scores[f"training R^2 of log {name}"] <= bound[name] + 0.01
    assert result.scores["training R^2 of log ratio"] > 0.9


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


@given(st.integers(0, 50))
def test_sums_in_another_order_change_answers_by_rounding_alone(seed):
    densities = np.random.default_rng(seed).uniform(0.0, 3.0, (40, 12))
    assert rounding_of_inference(make_network(seed), densities) < 1e-13


def test_the_order_of_the_sums_is_really_another():
    densities = np.random.default_rng(0).uniform(0.0, 3.0, (400, 12))
    assert max(rounding_of_inference(make_network(seed), densities) for seed in range(5)) > 0.0


def test_training_again_is_compared_with_the_network_that_is_given():
    dataset, options = made_up(), TrainingOptions(epochs=40)
    network = train_network(dataset, options).network
    assert rounding_of_training(dataset, options, network) < 1e-9
    other = train_network(dataset, TrainingOptions(epochs=40, seed=1)).network
    expected = np.abs(other.log_weights(dataset.inputs) - network.log_weights(dataset.inputs)).max()
    assert rounding_of_training(dataset, options, other) == pytest.approx(expected, rel=1e-6)
    assert expected > 1e-3


# --- bad input -----------------------------------------------------------------------------------------------------


def lacking(dataset, split, share):
    """A seed whose training side has no sample of some weight, and one whose has all."""
    found = {}
    for seed in range(500):
        options = TrainingOptions(seed=seed, split=split, training_share=share, epochs=1)
        outputs = dataset.outputs[split_samples(dataset, options)]
        found.setdefault(all(len(np.unique(column)) == 3 for column in outputs.T), options)
        if len(found) == 2:
            break
    return found[False], found[True]


@pytest.mark.parametrize(("split", "share", "rows"), [("runs", 0.7, 10), ("samples", 0.05, 10)])
def test_a_split_that_leaves_a_weight_without_training_samples_is_refused_before_training(split, share, rows):
    dataset = made_up(rows)
    bad, good = lacking(dataset, split, share)
    steps = []
    with pytest.raises(
        ConfigurationError, match=rf"split by {split} leaves training samples of omega_[QR] = "
    ) as caught:
        train_network(dataset, bad, steps.append)
    assert (caught.value.key, caught.value.value) == ("training.seed", bad.seed)
    assert steps == []
    train_network(dataset, good, steps.append)
    assert steps == [1.0]


def test_weights_that_no_two_runs_share_are_no_classes():
    dataset = made_up(10)
    dataset.outputs[:] = 10.0 ** np.linspace(-1, 1, 9)[dataset.run][:, None] * [1.0, 2.0]
    result = train_network(dataset, TrainingOptions(epochs=1, split="runs"))
    assert np.isfinite(result.training_loss).all()


# --- verdict -------------------------------------------------------------------------------------------------------

BEST = {"omega_Q": 0.5, "omega_R": 0.5, "ratio": 1.0}


def said(q, r, ratio):
    numbers = {"validation": {"omega_Q": q, "omega_R": r, "ratio": ratio}, "best_possible": BEST}
    return render("training", "verdict", n=numbers)


def test_the_verdict_follows_from_the_scores():
    text = said(0.42, 0.4, 0.84)
    assert text.startswith("Does not hold: on the validation samples R^2 is 0.42 for omega_Q, 0.4 for omega_R")
    assert "0.84 for their ratio, of at most 0.5, 0.5 and 1." in text
    assert text.endswith("more): ratio.")
    assert said(0.9, 0.7, 0.9).startswith("Holds: ")
    assert said(0.9, 0.7, 0.9).endswith("omega_Q and omega_R and ratio.")
    assert said(0.9, 0.69, 0.9).startswith("Holds in part: ")
    assert said(-4.0, 0.1, 0.3).endswith("more): nothing.")
    none = said(None, 0.1, 0.3)
    assert none.startswith("Does not hold: ")
    assert "- for omega_Q" in none


# --- the section ---------------------------------------------------------------------------------------------------


def test_the_section_scores_both_densities_and_both_splits(report):
    section, data = report.sections["training"], load_dataset(report.folder / "dataset-quick.parquet")
    n = section.numbers
    assert set(n["scores"]) == {f"{k} {s}" for k in ("magnitude", "signed") for s in ("samples", "runs")}
    rows = {
        tuple(r[:3]): r[3:] for r in (line.strip("| ").split(" | ") for line in section.body.split("\n")) if len(r) == 8
    }
    for split, side in itertools.product(("samples", "runs"), ("training", "validation")):
        # What the network of the data that the report left scores, beside the bound of these very samples.
        options = TrainingOptions(epochs=300, split=split)
        training = split_samples(data, options)
        mask = training if side == "training" else ~training
        bound = best_possible_scores(data.outputs[mask])
        if split == "samples":
            network = load_network(report.folder / "tuner-quick.json")
            answers, labels = (np.log10(x) @ [1.0, -1.0] for x in (network.weights(data.inputs), data.outputs))
            score = n["scores"]["magnitude samples"][side]["ratio"]
            # The answers are held within the range of the labels, the score is of the answers before.
            assert score == pytest.approx(r_squared(labels[mask], answers[mask]), abs=0.02)
        q, q_bound, r, r_bound, ratio = map(float, rows["magnitude", split, side])
        assert [q, r, ratio] == pytest.approx([n["scores"][f"magnitude {split}"][side][k] for k in NAMES], rel=1e-3)
        assert [q_bound, r_bound] == pytest.approx([bound["omega_Q"], bound["omega_R"]], rel=1e-3)
    assert n["validation"] == n["scores"]["magnitude samples"]["validation"]
    assert n["best_possible"] == pytest.approx(BEST)
    assert n["equal_ratio_spread"] < 1e-6
    assert section.verdict == render("training", "verdict", n=n)


def test_repeatability_is_told_with_its_numbers(report):
    section = report.sections["training"]
    n = section.numbers
    assert n["repeatable"] is True
    assert 0.0 <= n["rounding_of_inference"] < 1e-12
    assert 0.0 <= n["rounding_of_training"] < 1e-3
    assert "the same weights file to the byte" in section.body
    assert f"{n['rounding_of_inference']:.1e} relative" in section.body
    assert f"up to {n['rounding_of_training']:.1e} apart" in section.body


def test_the_section_says_so_where_training_does_not_repeat(tmp_path, monkeypatch):
    calls = itertools.count()

    def unsteady(dataset, options, progress=None):
        assert progress is None
        result = train_network(dataset, options)
        result.network.output_bias[0] += 1e-3 * next(calls)
        return result

    monkeypatch.setattr(section_module, "run_experiments", lambda _: (None, None))
    monkeypatch.setattr(section_module, "dataset_of", lambda *given: made_up(10, density=given[-1]))
    monkeypatch.setattr(section_module, "train_network", unsteady)
    made = make(Study(tmp_path, True, Scenario()))
    assert made.numbers["repeatable"] is False
    assert "gave different weights files" in made.body
    assert made.files[-1] == "tuner-quick.json"
    assert load_network(tmp_path / "tuner-quick.json").density == "magnitude"


def test_the_figures_have_labelled_axes_and_show_the_data():
    dataset = made_up()
    result = train_network(dataset, TrainingOptions(epochs=5))
    curves = plot_learning_curves({("magnitude", "samples"): result, ("signed", "samples"): result})
    assert [axes.get_xlabel() for axes in curves.axes] == ["epoch", "epoch"]
    assert curves.axes[0].get_ylabel() == "mean squared error of log10 weights"
    assert [axes.get_title(loc="left") for axes in curves.axes] == ["magnitude densities", "signed densities"]
    np.testing.assert_array_equal(curves.axes[1].lines[1].get_ydata(), result.validation_loss)
    answers = plot_predictions(result.network, dataset)
    assert [axes.get_xlabel() for axes in answers.axes] == ["log10 of the label"] * 3
    assert answers.axes[0].get_ylabel() == "log10 of the network's answer"
    predicted = result.network.log_weights(dataset.inputs[dataset.run == 8])
    medians = [line.get_ydata()[0] for line in answers.axes[2].lines if line.get_marker() == "o"]
    assert medians[8] == pytest.approx(np.median(predicted[:, 0] - predicted[:, 1]))
