"""Six small loops in place of a large one."""

import numpy as np
import pytest

from stewart_drake.scenario import load_scenario
from stewart_drake.stability.chains import chains, together
from stewart_drake.stability.setting_loops import setting_loops
from stewart_drake.stability.switching import common_lyapunov, growth

POSE = np.array([[0.2, -0.1, 0.15, 0.02, -0.01, 0.31]])
SETTINGS = np.array([[0.0, 0.1, -0.3, -0.5], [0.1, 0.0, 0.0, 0.0], [-0.1, 0.1, -0.5, -1.0]])


@pytest.fixture(scope="module", params=[(), ("gravity=0",), ("command_delay=3",)], ids=str)
def split(request):
    made = load_scenario("exact_breathing", ["tuner=block", *request.param])
    loops = next(setting_loops(made, POSE, SETTINGS))
    return request.param, loops, chains(loops, made.lqi.length)


def test_the_chains_have_the_poles_of_the_loop(split):
    changes, loops, found = split
    assert found.matrices.shape[:2] == (6, 3)
    own = np.sort(np.abs(np.linalg.eigvals(found.matrices)).swapaxes(0, 1).reshape(3, -1), axis=-1)[:, -18:]
    whole = np.sort(np.abs(np.linalg.eigvals(loops.closed)), axis=-1)[:, -18:]
    # Without gravity nothing ties them together.
    np.testing.assert_allclose(own, whole, atol=1e-7 if "gravity=0" in changes else 2e-3)


def test_norms_of_the_chains_are_one_of_the_whole_loop(split):
    _, loops, found = split
    norms = np.stack([common_lyapunov(each) for each in found.matrices])
    one = np.ones((3, 1))
    alone = max(growth(m, p[None], one, one[:, None]).max() for m, p in zip(found.matrices, norms, strict=True))
    whole = growth(loops.closed, together(found.axes, norms[:, None]), one, one[:, None]).max()
    assert alone < 1.0
    assert whole < 1.0
