import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stewart_drake.control.features import CostScales, cost
from stewart_drake.logs.cost import FAILED, mean_cost, run_cost

SCALES = CostScales(rotation=0.5, position=0.02, torque_change=0.1)
sizes = st.just(0.0) | st.floats(1e-6, 1e3)


@given(sizes, sizes, sizes)
def test_the_cost_is_the_length_of_the_scaled_parts_in_numpy_and_torch_alike(rotation, position, change):
    torch = pytest.importorskip("torch")
    expected = math.hypot(rotation / 0.5, position / 0.02, change / 0.1)
    assert cost(rotation, position, change, SCALES) == pytest.approx(expected)
    parts = (np.array([[rotation], [0.5]]), np.array([position, position]), change)
    found = cost(*parts, SCALES)
    assert found.shape == (2, 2)
    np.testing.assert_allclose(found[0], expected)
    as_torch = cost(*(torch.as_tensor(part, dtype=torch.float64) for part in parts), SCALES)
    np.testing.assert_allclose(as_torch.numpy(), found)


def test_the_change_of_torque_counts_for_a_millisecond_and_a_run_that_was_not_completed_costs_the_most():
    figures = {"rmse_norm_deg": 0.0, "rmse_norm_mm": 0.0, "torque_change_rms": 0.5}
    assert run_cost(figures, "completed", 0.001, SCALES) == pytest.approx(5.0)
    assert run_cost(figures, "completed", 0.005, SCALES) == pytest.approx(1.0)
    assert run_cost(figures, "lost", 0.001, SCALES) == FAILED
    assert run_cost({**figures, "rmse_norm_mm": 1e9}, "completed", 0.001, SCALES) == FAILED
    assert run_cost({**figures, "rmse_norm_mm": None}, "completed", 0.001, SCALES) == FAILED
    assert run_cost(figures, "completed", 0.001, SCALES) < FAILED


@given(st.lists(st.floats(1e-6, FAILED), min_size=1, max_size=9), st.floats(0.01, 10.0))
def test_the_mean_grows_as_each_cost_does(costs, factor):
    assert min(costs) * (1 - 1e-9) <= mean_cost(costs) <= max(costs) * (1 + 1e-9)
    more = [costs[0] + factor, *costs[1:]]
    assert mean_cost(more) == pytest.approx(mean_cost(costs) + factor / len(costs))
