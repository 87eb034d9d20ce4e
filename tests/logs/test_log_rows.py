"""Rows that a run, a drive or a live session keeps."""

import numpy as np

from stewart_drake.logs.rows import Rows, row_layout

PLACES = row_layout({"time": (), "pose": (6,)}) | {"weights": np.array([1.0, 2.0])}


def filled(count, max_rows=None):
    rows = Rows(PLACES, max_rows)
    for number in range(count):
        rows.append(np.full(7, float(number)))
    return rows


def test_with_a_limit_the_latest_are_kept():
    for count in (1, 1023, 1024, 1025, 5000):
        rows = filled(count, max_rows=1000)
        time = rows.columns()["time"]
        assert len(time) == len(rows) >= min(count, 1000)
        np.testing.assert_array_equal(time, np.arange(count - len(rows), count))
    assert len(rows) < 4000


def test_another_thread_gets_each_row_once():
    rows, read = Rows(PLACES), []
    for number in range(2500):
        rows.append(np.full(7, float(number)))
        if number % 700 == 0:
            read += rows.since(len(read))[:, 0].tolist()
    read += rows.since(len(read))[:, 0].tolist()
    assert read == list(range(2500))
    assert len(rows.since(2500)) == 0
