"""Rows of numbers as a run, a drive or a live session gives them; by name once they are asked for."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

_BLOCK = 1024  # Rows that are allocated together: those that are there are never moved, which would take a tick's time.
_NONE = np.empty((0, 10**9))


class Rows:
    """Rows of numbers; one thread may read while another appends.

    Args:
        places: Name -> where in a row, a number for a single one; or an array (k,) that is the same in every row.
        most: Rows that are kept at least, the latest; None for all.
    """

    def __init__(self, places: Mapping[str, int | slice | np.ndarray], most: int | None = None) -> None:
        self.places, self._most = places, most
        self._blocks: list[np.ndarray] = []
        self._count = self._dropped = 0

    def __len__(self) -> int:
        return self._count - self._dropped

    def append(self, row: np.ndarray) -> None:
        place = self._count % _BLOCK
        if place == 0:
            if self._most is not None and len(self) >= self._most + _BLOCK:
                del self._blocks[0]
                self._dropped += _BLOCK
            self._blocks.append(np.empty((_BLOCK, len(row))))
        self._blocks[-1][place] = row
        self._count += 1

    def since(self, row: int) -> np.ndarray:
        """Rows (n, k) from one on, where all are kept."""
        count, first = self._count, row // _BLOCK
        blocks = self._blocks[first : -(-count // _BLOCK)]
        return (
            np.concatenate(blocks)[row - first * _BLOCK : count - first * _BLOCK] if row < count else np.empty((0, 0))
        )

    def columns(self) -> dict[str, np.ndarray]:
        """What is kept by name, (n, ...) of each."""
        count, columns = len(self), {}
        for name, place in self.places.items():
            if isinstance(place, np.ndarray):
                columns[name] = np.tile(place, (count, 1))
            else:
                columns[name] = np.concatenate([block[:, place] for block in (_NONE, *self._blocks)])[:count]
        return columns


def side_by_side(shapes: Mapping[str, tuple[int, ...]]) -> dict[str, int | slice]:
    """Places of numbers and vectors that follow one another in a row."""
    places: dict[str, int | slice] = {}
    end = 0
    for name, shape in shapes.items():
        begin, end = end, end + int(np.prod(shape))
        places[name] = slice(begin, end) if shape else begin
    return places
