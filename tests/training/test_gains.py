"""Gains for many loops at once: those of the reference, and their derivatives those of Drake's solution."""

import numpy as np
import pytest
import torch

from stewart_drake.control.lqi import lqi_gain
from stewart_drake.control.riccati import chain_gains, split_gain
from stewart_drake.control.settings import weights_of
from stewart_drake.control.state_space import INTEGRAL, POSITION, RATE
from stewart_drake.hardware.observer import kalman_gains
from stewart_drake.mechanics.dynamics import pose_acceleration_map
from stewart_drake.scenario import load_scenario
from stewart_drake.training import gains

BLOCK = ("tuner={kind: block}",)
SITES = {"paper": load_scenario("exact_breathing", BLOCK), "reachy_mini": load_scenario("reachy_nod", BLOCK)}
HALF = np.array([0.4, 0.5, 1.0, 0.0])
"""Decades of a setting, each way."""
sites = pytest.mark.parametrize("site", SITES.values(), ids=SITES)


def tensor(values, gradient=False):
    return torch.tensor(values, dtype=torch.float64, requires_grad=gradient)


def scaled_map(site, pose=None):
    """A (6, 6), and the scale (6,) of rotations in it."""
    scale = np.array([site.lqi.length] * 3 + [1.0] * 3)
    return scale[:, None] * pose_acceleration_map(site.robot, site.robot.home_pose if pose is None else pose), scale


@sites
@pytest.mark.parametrize("period", [1e-3, 1e-2])
def test_chains_have_the_regulators_gains(site, period):
    rng = np.random.default_rng(0)
    weights = weights_of(np.array(site.tuner.weights), rng.uniform(-1.0, 1.0, (200, 4)) * HALF)
    s = np.linalg.svd(scaled_map(site)[0])[1] * 10.0 ** rng.uniform(-0.5, 0.5, (200, 6))
    roots = np.stack([chain_gains(each, period, weight) for each, weight in zip(s, weights, strict=True)], axis=1)
    mine = gains.chain_gains(tensor(s.T**2), tensor(weights.T), period).numpy() * s.T
    np.testing.assert_allclose(mine, np.moveaxis(roots, -1, 0), rtol=1e-9)


@pytest.mark.parametrize("period", [1e-3, 1e-2])
def test_the_filter_has_the_observers_gains(period):
    rng = np.random.default_rng(1)
    noise, disturbance = 10.0 ** rng.uniform(-5.0, -3.0, 300), 10.0 ** rng.uniform(-1.0, 2.5, 300)
    roots = [kalman_gains(*pair, period) for pair in zip(noise, disturbance, strict=True)]
    mine = torch.stack(gains.kalman_gains(tensor(noise), tensor(disturbance), period)).numpy()
    np.testing.assert_allclose(mine.T, roots, rtol=1e-9)


def test_the_factor_is_one():
    """p(s) p(-s) is the cubic that was given, its roots lie on the left, fast or slow ones."""
    rng = np.random.default_rng(2)
    b2, b1, b0 = 10.0 ** rng.uniform(-6.0, 6.0, (3, 500))
    c2, c1, c0 = (each.numpy() for each in gains.factor(*map(tensor, (b2, b1, b0))))
    poles = np.stack([np.roots([1.0, *each]) for each in zip(c2, c1, c0, strict=True)])
    assert poles.real.max() < 0.0
    u = 10.0 ** rng.uniform(-3.0, 3.0, 500)
    there = np.abs(np.polyval([np.ones(500), c2, c1, c0], 1j * np.sqrt(u))) ** 2
    np.testing.assert_allclose(there, np.polyval([np.ones(500), b2, b1, b0], u), rtol=1e-12)


def test_gradients_of_the_factor():
    b = tensor(10.0 ** np.random.default_rng(3).uniform(-1.0, 1.0, (3, 6)), True)
    assert torch.autograd.gradcheck(lambda b: torch.stack(gains.factor(*b)), (b,))


def command(matrix, weights, states, period):
    """K x of maps (6, 6, B)."""
    regulator = gains.Regulator.at(matrix, weights, period)
    return (matrix * regulator.applied(states)[:, None]).sum(dim=0)


@sites
def test_a_whole_robots_gain_is_that_of_the_split(site):
    rng = np.random.default_rng(4)
    pose = site.robot.home_pose + 0.01 * rng.standard_normal(6)
    matrix, scale = scaled_map(site, pose)
    weights, states = (
        weights_of(np.array(site.tuner.weights), rng.uniform(-1.0, 1.0, 4) * HALF),
        rng.normal(size=(3, 6)),
    )
    gain = split_gain(matrix / scale[:, None], site.lqi.period, weights, length=site.lqi.length)
    wanted = gain[:, POSITION] @ states[0] + gain[:, RATE] @ states[1] + gain[:, INTEGRAL] @ states[2]
    given = (tensor(each)[..., None] for each in (matrix, weights, scale * states))
    found = command(*given, site.lqi.period)[:, 0].numpy()
    np.testing.assert_allclose(found, wanted, rtol=1e-10, atol=1e-12 * np.abs(wanted).max())


@sites
def test_derivatives_are_those_of_drakes_solution(site):
    """By all weights and by the map, at home, where singular values come in pairs: differences of Drake's 18 states."""
    rng = np.random.default_rng(5)
    (matrix, scale), period = scaled_map(site), site.lqi.period
    states, way = rng.normal(size=(3, 6)), 0.1 * matrix * rng.normal(size=(6, 6))
    options = site.replace({"controller.solver": "drake"}).lqi
    base, decades = np.array(site.tuner.weights), np.array([0.3, -0.5, 0.7, 0.2])

    def drakes(step):
        gain = lqi_gain((matrix + step * way) / scale[:, None], options, base * 10.0 ** (step * decades))
        return sum(gain[:, part] @ state for part, state in zip((POSITION, RATE, INTEGRAL), states, strict=True))

    step = 1e-4
    differences = (8.0 * (drakes(step) - drakes(-step)) - drakes(2 * step) + drakes(-2 * step)) / (12.0 * step)

    def mine(along):
        moved = tensor(matrix) + along * tensor(way)
        weights = tensor(base) * 10.0 ** (along * tensor(decades))
        return command(moved[..., None], weights[:, None], tensor(scale * states)[..., None], period)[:, 0]

    along = torch.zeros((), dtype=torch.float64, requires_grad=True)
    exact = torch.stack([torch.autograd.grad(each, along, retain_graph=True)[0] for each in mine(along)])
    np.testing.assert_allclose(exact.numpy(), differences, rtol=2e-5, atol=2e-6 * np.abs(differences).max())


def test_gradients_by_map_states_and_cut_off_torque():
    rng = np.random.default_rng(6)
    weights = tensor([[4e5], [30.0], [4e7], [1.0]])
    turned = np.linalg.qr(rng.normal(size=(2, 6, 6)))[0]
    # Pairs to all digits, and pairs that are nearly equal.
    for s in ([90.0, 90.0, 70.0, 70.0, 40.0, 40.0], [90.0, 90.0 + 1e-6, 70.0, 70.1, 40.0, 55.0]):
        matrix = tensor(((turned[0] * s) @ turned[1])[..., None], True)
        states = tensor(rng.normal(size=(3, 6, 1)), True)
        check = lambda a, x: 1e-3 * command(a, weights, x, 1e-3)  # noqa: E731
        assert torch.autograd.gradcheck(check, (matrix, states), rtol=1e-4, atol=1e-4)
        back = lambda a, x: 1e3 * gains.Regulator.at(a, weights, 1e-3).integral_for(x[0])  # noqa: E731
        assert torch.autograd.gradcheck(back, (matrix, states), rtol=1e-4, atol=1e-6)


def test_what_was_cut_off_comes_back_as_integral():
    site = SITES["paper"]
    matrix, scale = scaled_map(site)
    weights, cut = np.array(site.tuner.weights), np.arange(6.0)
    gain = split_gain(matrix / scale[:, None], 1e-3, weights, length=site.lqi.length)
    regulator = gains.Regulator.at(tensor(matrix)[..., None], tensor(weights)[:, None], 1e-3)
    found = regulator.integral_for(tensor(matrix @ cut)[:, None])[:, 0].numpy() / scale
    np.testing.assert_allclose(gain[:, INTEGRAL] @ found, cut, atol=1e-9)
