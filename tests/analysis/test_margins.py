"""Margins against python-control, against loops that are perturbed, and against themselves."""

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stewart_drake.analysis.feasibility import NEAR, sample_poses
from stewart_drake.analysis.linear_loop import linear_loops
from stewart_drake.analysis.margins import balanced, gain_of_disk, loop_margins, lower_bound, refined, upper_bound
from stewart_drake.scenario.scenario import load_scenario

SETTINGS = {"difference": [], "observer": ["estimator.kind=observer"], "pid": ["controller={kind: pid}"]}


@pytest.fixture(scope="module", params=SETTINGS, ids=str)
def loops(request):
    plain = ["estimator={kind: difference, rate_cutoff: 150}", "tuner={kind: block}"]
    made = load_scenario("exact_breathing", [*plain, *SETTINGS[request.param]])
    return linear_loops(made, sample_poses(made.robot, NEAR, 5, np.random.default_rng(2)))


@pytest.fixture(scope="module")
def found(loops):
    return loop_margins(loops)


def radius(matrices):
    return np.abs(np.linalg.eigvals(matrices)).max(axis=-1)


def single_loop(loops, pose, motor):
    """A, B, C of one motor's loop, the others closed, with the sign of negative feedback."""
    others = [k for k in range(6) if k != motor]
    a, b, c = loops.a[pose], loops.b[pose], loops.c[pose]
    return a + b[:, others] @ c[others], b[:, [motor]], -c[[motor]]


@pytest.mark.slow
def test_one_motor_at_a_time_is_what_python_control_finds(loops, found):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import control
    for pose, motor in ((0, 0), (1, 3), (2, 5)):
        system = control.ss(*single_loop(loops, pose, motor), 0.0, loops.period)
        with warnings.catch_warnings():
            # It forms the transfer function of 36 states and more, and says that this is delicate.
            warnings.simplefilter("ignore")
            disk, gain_db, phase_deg = control.disk_margins(system, found.frequencies, skew=0.0)
            answer = control.frequency_response(system, found.frequencies)
            gain, phase, _, _, at_gain, _ = control.stability_margins(
                (answer.magnitude.ravel(), np.degrees(np.unwrap(answer.phase.ravel())), found.frequencies),
                returnall=True,
            )
        one = found.single
        assert one.disk[pose, motor] == pytest.approx(disk, rel=1e-6)
        assert 20.0 * np.log10(gain_of_disk(one.disk[pose, motor])) == pytest.approx(gain_db, rel=1e-6)
        assert 2.0 * np.degrees(np.arctan(0.5 * one.disk[pose, motor])) == pytest.approx(phase_deg, rel=1e-6)
        gain = np.asarray(gain)
        assert one.gain_high[pose, motor] == pytest.approx(gain[gain > 1.0].min(), rel=2e-3)
        assert one.gain_low[pose, motor] == pytest.approx(gain[gain < 1.0].max(), rel=2e-3)
        phase, at = np.radians(np.asarray(phase)), np.asarray(at_gain)
        assert one.phase[pose, motor] == pytest.approx(np.abs(phase).min(), rel=2e-3)
        lags = np.mod(phase, 2.0 * np.pi)
        assert one.delay[pose, motor] == pytest.approx((lags / at).min(), rel=5e-3)


def with_ticks(loops, pose, motors, ticks):
    """The closed loop with so many ticks more at some motors."""
    a, b, c = loops.a[pose], loops.b[pose], loops.c[pose]
    for _ in range(ticks):
        n, k = len(a), len(motors)
        a = np.block([[a, np.zeros((n, k))], [c[motors], np.zeros((k, k))]])
        b = np.vstack([b, np.zeros((k, 6))])
        c = np.hstack([c, np.zeros((6, k))])
        c[motors] = 0.0
        c[motors, n + np.arange(k)] = 1.0
    return a + b @ c


def test_all_motors_bear_delays_within_the_margin_of_all_at_once(loops, found):
    for pose in range(len(loops.a)):
        ticks = int(found.all_at_once.delay[pose] / loops.period)
        for motors in ([0, 1, 2, 3, 4, 5], [0, 2, 4], [1, 5]):
            assert radius(with_ticks(loops, pose, motors, ticks)) < 1.0


@settings(max_examples=50)
@given(seed=st.integers(0, 2**32 - 1))
def test_no_gains_within_the_disk_make_a_loop_unstable(loops, found, seed):
    rng = np.random.default_rng(seed)
    pose = rng.integers(len(loops.a))
    delta = 0.999 * found.all_at_once.disk[pose] * np.exp(2j * np.pi * rng.uniform(size=6))
    factors = (1.0 + 0.5 * delta) / (1.0 - 0.5 * delta)
    assert radius(loops.a[pose] + loops.b[pose] @ (factors[:, None] * loops.c[pose])) < 1.0


def test_the_bounds_of_mu_meet_for_these_loops(found):
    # So the margin is not cautious: some gains just beyond it bring a pole onto the circle.
    np.testing.assert_allclose(found.not_above, found.all_at_once.disk, rtol=1e-3)
    assert (found.not_above >= found.all_at_once.disk * (1.0 - 1e-9)).all()


def test_an_unstable_loop_has_no_margin(loops):
    found = loop_margins(loops._replace(c=4.0 * loops.c))
    assert (found.radius > 1.0).all()
    for margins in (found.single, found.all_at_once):
        assert not np.any([margins.disk, margins.delay])
        assert (margins.gain_high == 1.0).all()


@given(seed=st.integers(0, 2**32 - 1))
def test_mu_of_a_product_of_two_vectors_is_known(seed):
    # det(I - a b' Delta) = 1 - sum a_i b_i delta_i, so that mu = sum |a_i b_i|.
    rng = np.random.default_rng(seed)
    a, b = (rng.normal(size=6) + 1j * rng.normal(size=6) for _ in range(2))
    matrix = (a[:, None] * b)[None]
    logs = refined(matrix[0], balanced(matrix)[0])
    assert lower_bound(matrix[0], logs) == pytest.approx(np.abs(a * b).sum(), rel=1e-3)
    assert upper_bound(matrix, logs[None])[0] == pytest.approx(np.abs(a * b).sum(), rel=1e-3)
