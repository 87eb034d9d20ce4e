"""Random numbers by tick: the same seed and tick give the same number, however often and in which order it is asked."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

_BLOCK = 1024


def tick_normal(seed: int, stream: int, tick: int, size: int) -> np.ndarray:
    """Standard normal numbers (size,) of a tick.

    Args:
        seed: Of the scenario, 0 to `section.MAX_SEED`.
        stream: Number of who asks; different streams of one seed are independent.
        tick: 0, 1, ...
        size: How many.
    """
    return _block(seed, stream, tick // _BLOCK, size, True)[tick % _BLOCK]


def tick_uniform(seed: int, stream: int, tick: int, size: int) -> np.ndarray:
    """Numbers (size,) in [0, 1) of a tick; see `tick_normal`."""
    return _block(seed, stream, tick // _BLOCK, size, False)[tick % _BLOCK]


@lru_cache(maxsize=64)
def _block(seed: int, stream: int, block: int, size: int, normal: bool) -> np.ndarray:
    # Philox counts: a block is reached without drawing those before it. The low counter words run within the block.
    generator = np.random.Generator(np.random.Philox(key=[seed, stream], counter=[0, 0, 0, block]))
    values = generator.standard_normal((_BLOCK, size)) if normal else generator.random((_BLOCK, size))
    values.flags.writeable = False
    return values
