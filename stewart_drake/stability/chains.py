"""A loop of six motors as six small ones, nearly: along the singular vectors of what torques do to the platform.

The LQI's split and an observer with the same gains for every crank act alike in all directions, so that only gravity's
stiffness and the like tie the six together.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from stewart_drake.stability.linear_loop import LinearLoops

_SIX = 6


class Chains(NamedTuple):
    """Loops (s, n, n) in other coordinates x = axes y, in which six chains of k = n / 6 states stand beside each other.

    Attributes:
        axes: (n, n); chain i has its columns i, i + 6, i + 12 and so on.
        matrices: (6, s, k, k) of the chains alone.
    """

    axes: np.ndarray
    matrices: np.ndarray


def chains(loops: LinearLoops, length: float) -> Chains:
    """The six chains of loops at one pose, whose states come in groups of six: pose and rate first.

    Args:
        loops: With settings that differ in gains alone.
        length: [m] by which the LQI weighs turns against shifts, see `LqiOptions`.
    """
    closed, scale = loops.closed, np.array([length] * 3 + [1.0] * 3)
    n = closed.shape[-1]
    groups = n // _SIX
    blocks = closed[0].reshape(groups, _SIX, groups, _SIX).swapaxes(1, 2)
    turned = np.linalg.svd(scale[:, None] * loops.b[0, _SIX : 2 * _SIX])[0]
    found: dict[int, np.ndarray] = {0: turned / scale[:, None]}
    while len(found) < groups:
        # What a group passes on to another, or gets from it, says along which axes that one lies.
        ways = [
            (np.linalg.cond(block), new, axes, block, forward)
            for old, axes in found.items()
            for new in range(groups)
            if new not in found
            for block, forward in ((blocks[new, old], True), (blocks[old, new], False))
        ]
        _, new, axes, block, forward = min(ways, key=lambda way: way[0])
        axes = block @ axes if forward else np.linalg.solve(block, axes)
        found[new] = axes / np.linalg.norm(axes, axis=0)
    axes = np.zeros((n, n))
    for group, own in found.items():
        at = slice(_SIX * group, _SIX * (group + 1))
        axes[at, at] = own
    apart = np.linalg.solve(axes, closed @ axes)
    return Chains(axes, np.stack([apart[:, i::_SIX, i::_SIX] for i in range(_SIX)]))


def together(axes: np.ndarray, each: np.ndarray) -> np.ndarray:
    """P (..., n, n) of the whole loop from those (6, ..., k, k) of its chains, see `Chains`."""
    n = len(axes)
    whole = np.zeros((*each.shape[1:-2], n, n))
    for i, own in enumerate(each):
        whole[..., i::_SIX, i::_SIX] = own
    back = np.linalg.inv(axes)
    found: np.ndarray = back.T @ whole @ back
    return found
