"""Rows of numbers of a run, a drive or a live session, and their columns by name."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

_BLOCK = 1024  # Rows that are allocated together. Blocks are never copied, which would take too long for a tick.
_NO_ROWS = np.empty((0, 10**9))


class Rows:
    """Rows of numbers; one thread may read while another appends.

    Args:
        places: Name -> index or slice in a row; or an array (k,) that is the same in every row.
        max_rows: Rows that are kept at least, the latest; None for all.
    """

    def __init__(self, places: Mapping[str, int | slice | np.ndarray], max_rows: int | None = None) -> None:
        self.places, self._max_rows = places, max_rows
        self._blocks: list[np.ndarray] = []
        self._count = self._dropped = 0

    def __len__(self) -> int:
        return self._count - self._dropped

    def append(self, row: np.ndarray) -> None:
        place = self._count % _BLOCK
        if place == 0:
            if self._max_rows is not None and len(self) >= self._max_rows + _BLOCK:
                del self._blocks[0]
                self._dropped += _BLOCK
            self._blocks.append(np.empty((_BLOCK, len(row))))
        self._blocks[-1][place] = row
        self._count += 1

    def since(self, row: int) -> np.ndarray:
        """Rows (n, k) from number `row` on, if all are kept."""
        count, first = self._count, row // _BLOCK
        if row >= count:
            return np.empty((0, 0))
        blocks = self._blocks[first : -(-count // _BLOCK)]
        return np.concatenate(blocks)[row - first * _BLOCK : count - first * _BLOCK]

    def columns(self) -> dict[str, np.ndarray]:
        """Kept rows as columns (n, ...) by name."""
        count, columns = len(self), {}
        for name, place in self.places.items():
            if isinstance(place, np.ndarray):
                columns[name] = np.tile(place, (count, 1))
            else:
                columns[name] = np.concatenate([block[:, place] for block in (_NO_ROWS, *self._blocks)])[:count]
        return columns


def row_layout(shapes: Mapping[str, tuple[int, ...]]) -> dict[str, int | slice]:
    """Indices and slices of consecutive numbers and arrays in a row, from their shapes."""
    places: dict[str, int | slice] = {}
    end = 0
    for name, shape in shapes.items():
        begin, end = end, end + int(np.prod(shape))
        places[name] = slice(begin, end) if shape else begin
    return places
