"""Training of the policy, on short runs of the slow robot."""

import numpy as np
import pytest
import torch

from stewart_drake.control.policy import answer, default_policy_path, load_policy
from stewart_drake.control.tuners import PolicyTuner
from stewart_drake.errors import ConfigurationError
from stewart_drake.training import policy_training
from stewart_drake.training.policy_options import Box, PolicyOptions
from stewart_drake.training.policy_progress import Progress, kept
from stewart_drake.training.policy_training import Training, train_policy
from stewart_drake.training.situations import situation

CENTRE = np.array([0.1, -0.3, -0.7, -1.0])


@pytest.fixture
def short(monkeypatch):
    """Situations of 0.4 s."""
    monkeypatch.setattr(policy_training, "situation", lambda *case: situation(*case).replace({"duration": 0.4}))


def made(**changes):
    options = {"epochs": 2, "situations": 1, "hidden": 4, "pieces": 2, "learning_rate": 0.05, **changes}
    return Training(PolicyOptions(**options), Box(CENTRE), ("reachy_mini",))


def same(one, other):
    for a, b in zip(one.layers, other.layers, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.usefixtures("short")
def test_it_starts_at_the_centre_and_knows_what_that_costs():
    training = made()
    begun = training.begin(lambda _: None)
    found = torch.randn(7, 13, dtype=torch.float64)
    np.testing.assert_allclose(answer(training.layers(begun), found)[0], np.tile(CENTRE, (7, 1)))
    assert begun.fixed.shape == (len(training.names),)
    assert (begun.fixed < 100.0).all()
    assert (begun.scale > 0.0).all()
    assert training.share.sum() == pytest.approx(1.0)


@pytest.mark.slow
@pytest.mark.usefixtures("short")
@pytest.mark.parametrize(("costs", "best"), [((0.9, 0.5, 0.8), 2), ((1.2, 1.1, 1.3), 0)])
def test_the_best_epoch_is_handed_on_or_the_start(monkeypatch, costs, best):
    def epoch(_, at, tell):
        tell("")
        return Progress(**{**vars(at), "weights": at.weights + 1.0, "latest": costs[at.epoch] * at.fixed})

    monkeypatch.setattr(Training, "_by_gradient", epoch)
    policy = train_policy(made(epochs=3))
    np.testing.assert_array_equal(policy.layers.hidden_bias, best)


@pytest.mark.slow
@pytest.mark.usefixtures("short")
@pytest.mark.parametrize("method", ["gradient", "evolution"])
def test_interrupted_it_goes_on_to_the_same_policy(tmp_path, method):
    whole = train_policy(made(method=method))
    assert np.abs(np.asarray(whole.layers.output)).max() > 1e-3

    def stop(done, _):
        if done >= 1.0:
            raise KeyboardInterrupt

    file = tmp_path / "checkpoint"
    with pytest.raises(KeyboardInterrupt):
        train_policy(made(method=method), file, stop)
    # Told after the epoch, and before it is kept: the next call does it again.
    assert not file.exists()
    with pytest.raises(KeyboardInterrupt):
        train_policy(made(method=method), file, lambda done, word: None if word.startswith("J ") else stop(done, word))
    again = train_policy(made(method=method), file)
    same(whole, again)
    assert not file.exists()
    assert again.provenance["options"]["method"] == method


@pytest.mark.slow
@pytest.mark.usefixtures("short")
def test_a_checkpoint_of_another_training_is_refused(tmp_path):
    training, file = made(epochs=1), tmp_path / "checkpoint"
    policy_training.keep(training.begin(lambda _: None), "its own", file)
    assert kept(file, "its own").epoch == 0
    with pytest.raises(ConfigurationError, match="of other options"):
        train_policy(made(seed=1), file)
    file.write_bytes(b"no checkpoint")
    with pytest.raises(ConfigurationError, match="as training left it"):
        train_policy(training, file)


@pytest.mark.slow
@pytest.mark.usefixtures("short")
def test_a_policy_goes_on_from_another():
    first = train_policy(made(epochs=1))
    training = made(epochs=1)
    begun = training.begin(lambda _: None, first)
    np.testing.assert_allclose(begun.mean, first.layers.mean)
    found = torch.randn(5, 13, dtype=torch.float64)
    np.testing.assert_allclose(
        answer(training.layers(begun), found)[0].numpy(),
        answer(first.layers._replace(low=begun.low, high=begun.high), found.numpy())[0],
    )
    assert train_policy(training, start=first).provenance["start"] == first.provenance


@pytest.mark.slow
@pytest.mark.usefixtures("short")
def test_each_epoch_of_evolution_goes_through_short_runs_more_often():
    training = Training(PolicyOptions(method="evolution", situations=1, hidden=4), Box(CENTRE))
    begun = training.begin(lambda _: None)
    made = training.epoch(begun, lambda _: None)
    assert made.steps == max(group.ticks for group in training._groups) // min(
        group.ticks for group in training._groups
    )
    assert (made.latest != begun.latest).all()


def test_the_shipped_policy_is_one():
    policy = load_policy()
    assert policy.to_bytes() == default_policy_path().read_bytes()
    assert {"data", "options", "date", "limits", "processor_seconds"} <= policy.provenance.keys()
    np.testing.assert_allclose(PolicyTuner().chooser().centre, policy.centre)
    lowest, highest = policy.lowest, policy.lowest + policy.width
    assert (lowest < policy.centre).all()
    assert (policy.centre < highest).all()
