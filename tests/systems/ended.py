"""How a simulation ends that does not get to its end."""

import pytest


def ended(simulator, time, kind):
    """The error of `kind` that ends the simulation before `time`, without its traceback.

    The frames of a traceback hold references to Contexts that die with the Simulator; pydrake may take a new object
    at the address of a dead one for it, and crash.
    """
    try:
        simulator.AdvanceTo(time)
    except kind as error:
        return error.with_traceback(None)
    return pytest.fail(f"{kind.__name__} was not raised")
