import numpy as np
import pytest

from stewart_drake.paper import in_the_loop
from stewart_drake.paper.in_the_loop import BEST_FIXED, FIXED, TUNER
from stewart_drake.paper.network import best_possible_scores
from stewart_drake.paper.nine_experiments import distinct, gains_along_reference, relative_distances
from stewart_drake.paper.reproduce import PAIRS
from stewart_drake.scenario import Scenario
from stewart_drake.training.train import r_squared

BASE = Scenario()
ratio_of = np.array([q / r for q, r in PAIRS])


@pytest.mark.parametrize("changed", [{}, {"controller.solver": "split", "controller.force_map": "printed"}], ids=str)
def test_gains_of_one_ratio_are_equal_to_1e_10_and_of_two_ratios_are_not(changed):
    distances = relative_distances(gains_along_reference(BASE.replace(changed)))
    equal = np.isclose(ratio_of[:, None], ratio_of)
    assert distances[equal].max() < 1e-10 < 1e-2 < distances[~equal].min()
    assert distinct(distances, 1e-10) == 5


def test_over_the_nine_pairs_half_of_each_weight_s_variance_is_irreducible():
    # Labels -1, 0, 1; ratio 0 has a variance of 2/3 left in three pairs, ratios -1 and 1 of 1/4 in two, the ends none:
    # (3 * 2/3 + 4 * 1/4) / (9 * 2/3) = 1/2.
    assert best_possible_scores() == pytest.approx({"omega_Q": 0.5, "omega_R": 0.5, "ratio": 1.0}, abs=1e-12)
    # And no function of the ratio does better: least squares over one indicator a ratio.
    logs = np.log10(PAIRS)
    ratio = np.round(logs[:, 0] - logs[:, 1], 6)
    basis = (ratio[:, None] == np.unique(ratio)).astype(float)
    for label in logs.T:
        assert r_squared(label, basis @ np.linalg.lstsq(basis, label, rcond=None)[0]) == pytest.approx(0.5)


def test_the_best_fixed_pair_is_best_by_geometric_mean_and_improvement_is_a_share_of_it():
    def row(**changed):
        return dict(zip(FIXED, (20.0, 10.0, 4.0, 2.0, 1.0), strict=True)) | {TUNER: 5.0} | changed

    better = in_the_loop.baselines({"a": row(), "b": row(**{"ratio 100": 3.0})})
    assert better[BEST_FIXED] == [1.0, 3.0]  # sqrt(1 * 3) against 2
    assert in_the_loop.baselines({"a": row(), "b": row(**{"ratio 100": 5.0})})[BEST_FIXED] == [2.0, 2.0]
    found = in_the_loop.improvement({"a": row(**{TUNER: 0.5}), "b": row(**{TUNER: 2.0})}, [1.0, 1.0])
    assert (found["each"], found["mean"]) == ([50.0, -100.0], pytest.approx(-25.0))
    assert found["typical"] == pytest.approx(0.0)  # half and double
