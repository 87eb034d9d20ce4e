"""Laws in the subset of Python that the printer knows, one for each thing that C does otherwise."""

import numpy as np

from stewart_drake.base.jit import fields, njit, record

STATE = fields(out=6, matrix=(3, 3), count=())
TABLE = (0.5, 1.5, 2.5)


@njit
def numbers(values, state):
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
def swapped(values, state):
    out = record(state).out
    for k in range(6):
        out[k] = values[k]
    out[0], out[5], out[1] = out[5], out[0], out[5] + out[1]
    first, second = values[0], values[1]
    first, second = second, first
    out[2] += first - 2.0 * second


@njit
def arrays(values, state):
    state = record(state)
    squares = values * values
    copy = values.copy()
    copy[1:4] = squares[2:5]
    copy -= 0.5 * values
    for i in range(3):
        for j in range(3):
            state.matrix[i, j] = values[i] * TABLE[j]
    product = state.matrix @ (values[3:] + TABLE[1])
    column = state.matrix.T @ state.matrix
    state.out[0] = copy.max() + squares.min()
    state.out[1] = float(copy.argmax()) + (values > 0.0).sum()
    state.out[2] = squares.sum() if (values > 0.0).any() and not (values > 1.0).all() else product[1]
    state.out[3:] = np.where(values[:3] > 0.0, column[:, 1], -product)
    reversed_into(state.matrix[:, 0], state.out[:3])


@njit
def reversed_into(column, out):
    for k in range(2, -1, -1):
        out[2 - k] += column[k]


@njit
def several(values, state):
    state, index = record(state), 0
    for value in values:
        if value < 0.0:
            continue
        index += 1
        if index == 3:
            break
    larger, at = largest(values)
    state.out[0], state.out[1], state.out[2] = larger, at, index
    for pair in (values[:2], values[2:]):
        state.out[3] += largest(pair)[0]
    for one in (-1.0, 2.0):
        state.out[4] += one * values[4]
    while True:
        state.out[5] += 1.0
        if state.out[5] > abs(values[5]):
            break


@njit
def largest(values):
    best, at = -np.inf, -1
    for k in range(len(values)):
        if values[k] > best:
            best, at = values[k], k
    return best, at


@njit
def comprehension(values, state):
    record(state).out[0] = sum([value * value for value in values])


@njit
def kept(values, state):
    for k in range(6):
        if values[k] > 0.0:
            break
    record(state).out[0] = k
