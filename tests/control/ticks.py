"""One tick of a controller's part, for tests."""

import numpy as np

from stewart_drake.control.base import Setpoint

GRAVITY = 9.81
REST = np.zeros(6)


def standing(pose):
    """The setpoint that stays at a pose."""
    return Setpoint(np.asarray(pose), REST, REST)


def ticked(part, pose, rate, setpoint, *more, **before):
    """State (a record with the fields as attributes) after a tick; fields of the state before by name."""
    state = part.initial.copy()
    for name, value in before.items():
        state[name][0] = value
    part.tick(np.concatenate([pose, rate]), np.concatenate(setpoint), *more, state)
    return state.view(np.recarray)[0]
