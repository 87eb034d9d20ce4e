"""Gains of regulator and observer for many loops at once, in torch, with their exact derivatives.

Both are read off spectral factors, see `spectral`, as `riccati.chain_gains` and `observer.kalman_gains` do.

The gain of a whole robot is a function of one symmetric matrix, X = A A' with A = S M^-1 tau: K = A' f(X) S for each of
pose, rate and integral. Its derivative is that of Y. Daleckii and S. Krein (1951), safe where eigenvalues coincide, as
those of a symmetric robot do at home.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor

from stewart_drake.hardware.observer import SHARE
from stewart_drake.spectral import Factor, chain_cubic, chain_read, filter_cubic, filter_read, spectral_factor

_TOGETHER = 1e-6
"""Relative distance of eigenvalues below which a divided difference is taken as the derivative between them."""


def factor(b2: Tensor, b1: Tensor, b0: Tensor) -> Factor:
    """`spectral.spectral_factor`, differentiable by the implicit function theorem."""
    with torch.no_grad():
        c2, c1, c0 = spectral_factor(b2, b1, b0)
    if any(each.requires_grad for each in (b2, b1, b0)):
        c0 = torch.sqrt(b0)
        # Both equations at the solution found: their values are zero, their derivatives are not.
        first, second = b1 + 2.0 * c0 * c2 - c1 * c1, b2 + 2.0 * c1 - c2 * c2
        with torch.no_grad():
            scale = 0.5 / (c1 * c2 - c0)
        c1, c2 = c1 + (c2 * first + c0.detach() * second) * scale, c2 + (first + c1 * second) * scale
    return Factor(c2, c1, c0)


def kalman_gains(noise: Tensor, disturbance: Tensor, period: float) -> tuple[Tensor, Tensor, Tensor]:
    """Of `observer.kalman_gains`, for tensors of one shape: to angle [-], rate [1/s] and surplus [1/s^2]."""
    wandering = disturbance * disturbance * (period**5 / (noise * noise))
    white = SHARE**2 * wandering ** (2.0 / 3.0)
    return filter_read(factor(*filter_cubic(wandering, white)), period)


def chain_gains(square: Tensor, weights: Tensor, period: float) -> Tensor:
    """f(X) of pose, rate and integral for each eigenvalue: `riccati.chain_gains` over s, exact hold.

    Args:
        square: (n, ...) s^2 > 0.
        weights: (4, ...) q_pose, q_rate, q_integral, r.
        period: [s].

    Returns:
        (3, n, ...) k / s.
    """
    g = square / weights[3]
    pose, rate, integral = (g * (weights[k] * period**power) for k, power in enumerate((4, 2, 6)))
    k_e, k_v, k_z = chain_read(factor(*chain_cubic(rate, pose, integral)))
    over = 1.0 / (square * period)
    return torch.stack([k_e * over / period, k_v * over, k_z * over / period**2])


def chain_slopes(square: Tensor, weights: Tensor, period: float) -> Tensor:
    """Derivatives (3, n, ...) of `chain_gains` by s^2, without a graph."""
    with torch.enable_grad():
        at = square.detach().requires_grad_()
        values = chain_gains(at, weights.detach(), period)
        return torch.stack([torch.autograd.grad(each.sum(), at, retain_graph=True)[0] for each in values])


class _Applied(torch.autograd.Function):
    """Sum over n of U diag(values_n) U' vectors_n for X = U diag(squares) U', values a function of the squares."""

    @staticmethod
    def forward(
        ctx: Any, _matrix: Tensor, values: Tensor, vectors: Tensor, squares: Tensor, basis: Tensor, slopes: Tensor
    ) -> Tensor:
        inside = (basis * vectors[:, :, None]).sum(dim=1)
        ctx.save_for_backward(values, inside, squares, basis, slopes)
        return (basis * (values * inside).sum(dim=0)).sum(dim=1)

    @staticmethod
    def backward(ctx: Any, *grads: Any) -> tuple[Tensor | None, ...]:
        values, inside, squares, basis, slopes = ctx.saved_tensors
        grad = (basis * grads[0][:, None]).sum(dim=0)
        by_vectors = (basis * (values * grad)[:, None]).sum(dim=2)
        apart = squares[:, None] - squares
        near = apart.abs() <= _TOGETHER * squares[-1]
        apart = torch.where(near, 1.0, apart)
        ratio = torch.where(
            near, 0.5 * (slopes[:, :, None] + slopes[:, None]), (values[:, :, None] - values[:, None]) / apart
        )
        inner = (ratio * inside[:, None]).sum(dim=0) * grad[:, None]
        by_matrix = product(product(basis, inner), basis.transpose(0, 1))
        return 0.5 * (by_matrix + by_matrix.transpose(0, 1)), grad * inside, by_vectors, None, None, None


def product(left: Tensor, right: Tensor) -> Tensor:
    """Of matrices (n, m, B) and (m, k, B); several times as fast as that of (B, n, m) and (B, m, k)."""
    return (left[:, :, None] * right).sum(dim=1)


class Regulator(NamedTuple):
    """The gain of each loop at a pose.

    Attributes:
        matrix: (6, 6, B) X.
        gains: (3, 6, B) f of its eigenvalues.
        slopes: (3, 6, B) their derivatives; of no meaning where nothing asks for a gradient.
        squares: (6, B) eigenvalues.
        basis: (6, 6, B) eigenvectors, the second axis counts them.
    """

    matrix: Tensor
    gains: Tensor
    slopes: Tensor
    squares: Tensor
    basis: Tensor

    @classmethod
    def at(cls, acceleration: Tensor, weights: Tensor, period: float) -> Regulator:
        """From A (6, 6, B), the scaled M^-1 tau, and weights (4, B)."""
        matrix = product(acceleration, acceleration.transpose(0, 1))
        with torch.no_grad():
            squares, basis = torch.linalg.eigh(matrix.permute(2, 0, 1))
            squares, basis = squares.T.contiguous(), basis.permute(1, 2, 0).contiguous()
        gains = chain_gains(squares, weights, period)
        slopes = chain_slopes(squares, weights, period) if matrix.requires_grad else gains
        return cls(matrix, gains, slopes, squares, basis)

    def applied(self, states: Tensor) -> Tensor:
        """f(X) of pose, rate and integral times scaled errors (3, 6, B), added; (6, B)."""
        return self._function(self.gains, states, self.slopes)

    def integral_for(self, force: Tensor) -> Tensor:
        """Scaled integral (6, B) that answers A times a torque: f(X)^-1 X^-1 of the integral."""
        gain = self.gains[2:]
        values = 1.0 / (gain * self.squares)
        return self._function(values, force[None], -values * (self.slopes[2:] / gain + 1.0 / self.squares))

    def _function(self, values: Tensor, vectors: Tensor, slopes: Tensor) -> Tensor:
        found: Tensor = _Applied.apply(  # type: ignore[no-untyped-call]
            self.matrix, values, vectors, self.squares, self.basis, slopes
        )
        return found
