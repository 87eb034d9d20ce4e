"""Gains of regulator and observer for many loops at once, in torch, with their exact derivatives.

Both are spectral factors of a cubic. On the unit circle let z = (1 + s/2) / (1 - s/2), s imaginary. A chain of three
integrators with quadratic weights, and one observed through noise, lead to

    u^3 + b2 u^2 + b1 u + b0,   u = -s^2,   all b positive,

which is to be written as p(s) p(-s), p(s) = s^3 + c2 s^2 + c1 s + c0 with roots on the left. Comparing coefficients,
c0 = sqrt(b0), c1 = sqrt(b1 + 2 c0 c2), and c2 is the largest root of one convex function, which Newton's method finds
from above. In d = z - 1 = s / (1 - s/2) that is the closed loop's polynomial, off which gains are read. Reference:
`riccati.chain_gains` and `observer.kalman_gains`, which find the roots instead.

The gain of a whole robot is a function of one symmetric matrix, X = A A' with A = S M^-1 tau: K = A' f(X) S for each of
pose, rate and integral. Its derivative is that of Y. Daleckii and S. Krein (1951), safe where eigenvalues coincide, as
those of a symmetric robot do at home.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor

from stewart_drake.hardware.observer import SHARE

_FIXED, _NEWTON = 2, 6
"""Steps from above: of a fixed point, which is robust, and of Newton, which doubles the digits."""
_TOGETHER = 1e-6
"""Relative distance of eigenvalues below which a divided difference is taken as the derivative between them."""


class Factor(NamedTuple):
    """p(d) = d^3 + c2 d^2 + c1 d + c0 in d = z - 1; tensors of one shape."""

    c2: Tensor
    c1: Tensor
    c0: Tensor


def spectral_factor(b2: Tensor, b1: Tensor, b0: Tensor) -> Factor:
    """Stable factor, in d, of u^3 + b2 u^2 + b1 u + b0, all > 0; differentiable by the implicit function theorem."""
    c0 = torch.sqrt(b0)
    with torch.no_grad():
        # In units in which c0 is one: (y^2 - f2)^2 = 4 (2 y + f1).
        unit = b0 ** (1.0 / 6.0)
        f2, f1 = b2 / (unit * unit), b1 / unit**4
        y = 2.0 + torch.sqrt(f2) + torch.sqrt(2.0 * torch.sqrt(f1))
        for _ in range(_FIXED):
            y = torch.sqrt(f2 + 2.0 * torch.sqrt(f1 + 2.0 * y))
        for _ in range(_NEWTON):
            over = y * y - f2
            y = y - (0.25 * over * over - 2.0 * y - f1) / (y * over - 2.0)
        c2 = unit * y
        c1 = torch.sqrt(b1 + 2.0 * c0 * c2)
    if any(each.requires_grad for each in (b2, b1, b0)):
        # Both equations at the solution found: their values are zero, their derivatives are not.
        first, second = b1 + 2.0 * c0 * c2 - c1 * c1, b2 + 2.0 * c1 - c2 * c2
        with torch.no_grad():
            scale = 0.5 / (c1 * c2 - c0)
        c1, c2 = c1 + (c2 * first + c0.detach() * second) * scale, c2 + (first + c1 * second) * scale
    low = 1.0 / (1.0 + 0.5 * c2 + 0.25 * c1 + 0.125 * c0)
    return Factor((c2 + c1 + 0.75 * c0) * low, (c1 + 1.5 * c0) * low, c0 * low)


def kalman_gains(noise: Tensor, disturbance: Tensor, period: float) -> tuple[Tensor, Tensor, Tensor]:
    """Of `observer.kalman_gains`, for tensors of one shape: to angle [-], rate [1/s] and surplus [1/s^2]."""
    wandering = disturbance * disturbance * (period**5 / (noise * noise))
    white = SHARE**2 * wandering ** (2.0 / 3.0)
    c2, c1, c0 = spectral_factor(0.25 * white + wandering / 16.0, white + 0.5 * wandering, wandering)
    return c2 - c1 + c0, (c1 - 1.5 * c0) / period, c0 / period**2


def chain_gains(square: Tensor, weights: Tensor, period: float) -> Tensor:
    """f(X) of pose, rate and integral for each eigenvalue: `riccati.chain_gains` over s, exact hold.

    Args:
        square: (..., n) s^2 > 0.
        weights: (..., 4) q_pose, q_rate, q_integral, r.
        period: [s].

    Returns:
        (3, ..., n) k / s.
    """
    g = square / weights[..., 3:]
    rate, pose, integral = (g * (weights[..., k : k + 1] * period**power) for k, power in ((1, 2), (0, 4), (2, 6)))
    lead = 1.0 / (1.0 + 0.25 * rate + integral / 576.0)
    b2, b1 = rate + 0.25 * pose + (7.0 / 144.0) * integral, pose + (5.0 / 12.0) * integral
    c2, c1, c0 = spectral_factor(b2 * lead, b1 * lead, integral * lead)
    held = c1 - c0
    over = 1.0 / (square * period)
    return torch.stack([held * over / period, (c2 - 0.5 * held - c0 / 6.0) * over, c0 * over / period**2])


def chain_slopes(square: Tensor, weights: Tensor, period: float) -> tuple[Tensor, Tensor]:
    """`chain_gains` and their derivatives by s^2, without a graph; (3, ..., n) each."""
    with torch.enable_grad():
        at = square.detach().requires_grad_()
        values = chain_gains(at, weights.detach(), period)
        slopes = [torch.autograd.grad(each.sum(), at, retain_graph=True)[0] for each in values]
    return values.detach(), torch.stack(slopes)


class _Applied(torch.autograd.Function):
    """Sum over n of U diag(values_n) U' vectors_n for X = U diag(squares) U', values a function of the squares."""

    @staticmethod
    def forward(
        ctx: Any, _matrix: Tensor, values: Tensor, vectors: Tensor, squares: Tensor, basis: Tensor, slopes: Tensor
    ) -> Tensor:
        inside = torch.einsum("bik,nbi->nbk", basis, vectors)
        ctx.save_for_backward(values, inside, squares, basis, slopes)
        return torch.matmul(basis, (values * inside).sum(dim=0)[..., None])[..., 0]

    @staticmethod
    def backward(ctx: Any, *grads: Any) -> tuple[Tensor | None, ...]:
        values, inside, squares, basis, slopes = ctx.saved_tensors
        grad = torch.matmul(grads[0][..., None, :], basis)[..., 0, :]
        by_values = grad * inside
        by_vectors = torch.einsum("bik,nbk->nbi", basis, values * grad)
        apart = squares[..., :, None] - squares[..., None, :]
        near = apart.abs() <= _TOGETHER * squares[..., -1:, None]
        apart = torch.where(near, torch.ones_like(apart), apart)
        ratio = torch.where(
            near,
            0.5 * (slopes[..., :, None] + slopes[..., None, :]),
            (values[..., :, None] - values[..., None, :]) / apart,
        )
        inner = (ratio * inside[..., None, :]).sum(dim=0) * grad[..., :, None]
        by_matrix = basis @ inner @ basis.mT
        return 0.5 * (by_matrix + by_matrix.mT), by_values, by_vectors, None, None, None


class Regulator(NamedTuple):
    """The gain of each loop at a pose.

    Attributes:
        matrix: (B, 6, 6) X.
        gains: (3, B, 6) f of its eigenvalues.
        slopes: (3, B, 6) their derivatives; of no meaning where nothing asks for a gradient.
        squares: (B, 6) eigenvalues.
        basis: (B, 6, 6) eigenvectors.
    """

    matrix: Tensor
    gains: Tensor
    slopes: Tensor
    squares: Tensor
    basis: Tensor

    @classmethod
    def at(cls, acceleration: Tensor, weights: Tensor, period: float) -> Regulator:
        """From A (B, 6, 6), the scaled M^-1 tau, and weights (B, 4)."""
        matrix = acceleration @ acceleration.mT
        with torch.no_grad():
            squares, basis = torch.linalg.eigh(matrix)
        gains = chain_gains(squares, weights, period)
        slopes = chain_slopes(squares, weights, period)[1] if matrix.requires_grad else gains
        return cls(matrix, gains, slopes, squares, basis)

    def applied(self, states: Tensor) -> Tensor:
        """f(X) of pose, rate and integral times scaled errors (3, B, 6), added; (B, 6)."""
        found: Tensor = _Applied.apply(  # type: ignore[no-untyped-call]
            self.matrix, self.gains, states, self.squares, self.basis, self.slopes
        )
        return found

    def integral_for(self, force: Tensor) -> Tensor:
        """Scaled integral (B, 6) that answers A times a torque: f(X)^-1 X^-1 of the integral."""
        gain = self.gains[2:]
        values = 1.0 / (gain * self.squares)
        slopes = -values * (self.slopes[2:] / gain + 1.0 / self.squares)
        found: Tensor = _Applied.apply(  # type: ignore[no-untyped-call]
            self.matrix, values, force[None], self.squares, self.basis, slopes
        )
        return found
