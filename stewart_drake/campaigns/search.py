"""The least of a function that can only be asked: CMA-ES, a generation at a time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

SPREAD = 0.2
"""Standard deviation of the first generation, as a share of the way from lowest to highest."""


def minimise(
    evaluate: Callable[[list[np.ndarray]], Sequence[float]],
    start: np.ndarray,
    low: np.ndarray | None = None,
    high: np.ndarray | None = None,
    *,
    generations: int,
    population: int,
    seed: int,
    spread: float = SPREAD,
    diagonal: bool = False,
) -> tuple[np.ndarray, float]:
    """Searches a box, or all of the space.

    N. Hansen, "The CMA evolution strategy: a tutorial", arXiv 1604.00772 (2016). The same arguments give the same
    points, so that a search whose evaluations are kept goes on where it was.

    Args:
        evaluate: Costs of some points (n,); the lower the better. It is asked for the start first, then for a
            generation at a time.
        start: (n,) where the search starts, within the box.
        low: (n,) lowest values; None, and so `high`, for no bounds.
        high: (n,) highest values.
        generations: Most of them; fewer where the search has converged.
        population: Points in each.
        seed: Of the search.
        spread: Of the first generation, as a share of the box; without one as it stands.
        diagonal: Learn no correlations: for hundreds of numbers and more.

    Returns:
        (n,) the best point that was asked for, and its cost.
    """
    # It loads matplotlib.
    import cma

    start = np.asarray(start, dtype=float)
    zero = np.zeros_like(start) if low is None else np.asarray(low, dtype=float)
    width = np.ones_like(start) if high is None else np.asarray(high, dtype=float) - zero
    best, least = start, float(evaluate([start])[0])
    rng = np.random.default_rng(seed)
    options: dict[str, Any] = {
        "bounds": [None, None] if low is None else [0.0, 1.0],
        "popsize": population,
        "randn": lambda *shape: rng.standard_normal(shape),
        "seed": np.nan,
        "verbose": -10,
        "verb_log": 0,
        "CMA_diagonal": diagonal,
    }
    # It is made for two dimensions and more: a second one without effect.
    inside = np.resize(np.append((start - zero) / width, 0.5), max(2, len(start)))
    strategy = cma.CMAEvolutionStrategy(inside, spread, options)
    for _ in range(generations):
        points = strategy.ask()
        asked = [zero + width * point[: len(start)] for point in points]
        costs = [float(cost) for cost in evaluate(asked)]
        strategy.tell(points, costs)
        first = int(np.argmin(costs))
        if costs[first] < least:
            best, least = asked[first], costs[first]
        if strategy.stop():
            break
    return best, least
