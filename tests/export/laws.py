"""Laws in the subset of Python that the printer knows, where C differs from Python, and laws beyond it."""

from typing import Annotated

import numpy as np

from stewart_drake.base.jit import njit
from stewart_drake.base.records import Mat3, Matrix, Record, Vec3, Vec6, Vector, record

TABLE = (0.5, 1.5, 2.5)


class LawState(Record):
    """What a law fills."""

    out: Vec6  # [-] results.
    matrix: Mat3
    count: float


class Longer(LawState):
    """One with a free size and another record."""

    inner: LawState
    rows: Annotated[np.ndarray, ("n", 2)]


SCRATCH = LawState.layout


@njit
def numbers(values: Vec6, state: LawState) -> None:
    state = record(state)
    a, b, c = values[0], values[1], values[2]
    state.out[0] = min(a, b) + max(b, c)
    state.out[1] = min(max(a, -b), b)
    state.out[2] = np.minimum(a, b) + np.sign(c)
    state.out[3] = a**5 - (b - (c - a)) / (1.0 + c**2)
    state.out[4] = a % 0.7 + float(int(b)) + abs(c)
    state.out[5] = 1.0 if 0.0 < a <= b or not np.isfinite(c) else 2.0
    state.count += 1.0


@njit
def swapped(values: Vec6, state: LawState) -> None:
    out = record(state).out
    for k in range(6):
        out[k] = values[k]
    out[0], out[5], out[1] = out[5], out[0], out[5] + out[1]
    first, second = values[0], values[1]
    first, second = second, first
    out[2] += first - 2.0 * second


@njit
def arrays(values: Vec6, state: LawState) -> None:
    state, copy, column = record(state), values.copy(), np.zeros((3, 1))
    for k in range(1, 4):
        copy[k] = values[k + 1] * values[k + 1]
    for i in range(3):
        for j in range(3):
            state.matrix[i, j] = values[i] * TABLE[j]
        column[2 - i, 0] = copy[i]
    state.out[0] = total(copy) + total(copy[2:]) + total(state.matrix[2])
    state.out[1] = last(column[:, 0]) + last(values[:3])
    reversed_into(column, state.out[3:])
    half = copy[3:]
    half[0] = total_of_rows(state.matrix[1:], half)
    state.out[2] = half[0]


@njit
def total(values: Vector) -> float:
    result = 0.0
    for k in range(len(values)):
        result += values[k]
    return result


@njit
def last(values: Vec3) -> float:
    return values[2]


@njit
def total_of_rows(rows: Matrix, out: Vec3) -> float:
    result = 0.0
    for k in range(len(rows)):
        result += total(rows[k])
        out[k + 1] = result
    return result


@njit
def reversed_into(column: Matrix, out: Vec3) -> None:
    for k in range(2, -1, -1):
        out[2 - k] += column[k, 0]


@njit
def several(values: Vec6, state: LawState) -> None:
    state, index = record(state), 0
    for k in range(6):
        if values[k] < 0.0:
            continue
        index += 1
        if index == 3:
            break
    larger, at = largest(values)
    state.out[0], state.out[1], state.out[2] = larger, at, index
    if at == 0:
        state.out[3] = 1.0
    elif at > 3 and larger > 1.0:
        state.out[3] = 2.0
    else:
        state.out[3] = 3.0
    both = counted(state)
    if both[1] == 1:
        state.out[4] = both[0] + TABLE[0]
    for _ in range(9):
        state.out[5] += 1.0
        if state.out[5] > abs(values[5]):
            break


@njit
def largest(values: Vec6) -> tuple[float, int]:
    best, at = -np.inf, -1
    for k in range(len(values)):
        if values[k] > best:
            best, at = values[k], k
    return best, at


@njit
def counted(state: LawState) -> tuple[float, int]:
    state.count += 1.0
    return state.count, 1


@njit
def nested(values: Vec6, state: LawState) -> None:
    scratch = np.empty(1, SCRATCH)
    swapped(values, scratch)
    before = scratch.copy()
    numbers(values, scratch)
    doubled(before, scratch, state)


@njit
def doubled(before: LawState, after: LawState, state: LawState) -> None:
    before, after, state = record(before), record(after), record(state)
    for k in range(6):
        state.out[k] = before.out[k] + 2.0 * after.out[k]


@njit
def longer(state: Longer) -> None:
    state = record(state)
    for k in range(len(state.rows)):
        state.rows[k, 1] = state.rows[k, 0] + state.inner.out[k]
    counted(state.inner)


# --- refused ---------------------------------------------------------------------------------------------------------


@njit
def comprehension(values: Vec6, state: LawState) -> None:
    record(state).out[0] = sum([value * value for value in values])


@njit
def loop_variable(values: Vec6, state: LawState) -> None:
    for k in range(6):
        if values[k] > 0.0:
            break
    record(state).out[0] = k


@njit
def two_types(values: Vec6, state: LawState) -> None:
    total = 0
    for k in range(6):
        total += values[k]
    record(state).out[0] = total


@njit
def vectors(values: Vec6, state: LawState) -> None:
    record(state).out[:] = values - values


@njit
def reduction(values: Vec6, state: LawState) -> None:
    record(state).out[0] = values.sum()


@njit
def wrong_size(values: Vec6, state: LawState) -> None:
    record(state).out[0] = last(values)


@njit
def column(values: Vec6, state: LawState) -> None:
    record(state).out[0] = values[0] + last(record(state).matrix[:, 0])


@njit
def other_field(values: Vec6, state: LawState) -> None:
    record(state).out[0] = values[0] + record(state).outs[0]


@njit
def no_types(values, state: LawState) -> None:
    record(state).out[0] = values[0]


@njit
def caller(values: Vec6, state: LawState) -> None:
    no_types(values, state)


REFUSED = {
    comprehension: "this kind of expression",
    loop_variable: "give that another name",
    two_types: r"begin with `0\.0`",
    vectors: "write a loop",
    reduction: "write a loop",
    wrong_size: r"`array \(6,\)` where `last` takes `values: Vec3`",
    column: "copy it in a loop",
    other_field: "no field `outs` of `LawState`",
    caller: "write its type, such as `values: Vec6`",
}
"""Refused laws, and a part of the message."""
