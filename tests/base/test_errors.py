import pickle

import numpy as np
import pytest

from stewart_drake.base import errors
from stewart_drake.base.errors import (
    AssemblyModeError,
    ConfigurationError,
    DiskError,
    DrakeCheckError,
    ForwardKinematicsError,
    InfeasibleReferenceError,
    MissingPackageError,
    NotFiniteError,
    RiccatiError,
    RunFailure,
    SafetyStop,
    SingularPoseError,
    StewartDrakeError,
    UnreachablePoseError,
    drake_guard,
)

POSE = np.array([0.1, 0.2, 0.3, 0.01, 0.02, 0.5])
EXAMPLES = [
    StewartDrakeError("plain"),
    ConfigurationError("robot.branch", 2, "-1 or 1"),
    InfeasibleReferenceError("torque", 0.25, 3, "6.5 N m", -1.5, "|motor torque| <= 5 N m"),
    MissingPackageError("gymnasium", "stewart-drake[gym]"),
    RunFailure("stopped", leg=2),
    UnreachablePoseError(POSE, 4, -0.125),
    SingularPoseError("serial", POSE, -3.9e-6, 0.0, leg=5),
    ForwardKinematicsError(0.02, 30),
    RunFailure("encoder readings", reason="encoder"),
    AssemblyModeError(POSE, 1.1 * POSE),
    SafetyStop("deadline", "deadline: stopped", None, {"monitor": "deadline", "time": 0.5}),
    RiccatiError("no solution"),
    NotFiniteError("torque", np.array([1.0, np.nan])),
    DrakeCheckError("Simulator: condition failed"),
    DiskError("log.parquet: No space left on device"),
]


@pytest.mark.parametrize("value", [10**5000, "\ud800\n", np.zeros(10**6)], ids=range(3))
def test_any_value_can_be_shown_in_one_short_line(value):
    text = str(ConfigurationError("key", value, "another"))
    assert len(text) < 200
    assert text.isprintable()


def test_every_error_of_the_module_has_a_stable_reason_of_its_own():
    kinds = {k for k in vars(errors).values() if isinstance(k, type) and issubclass(k, StewartDrakeError)}
    assert kinds == {type(error) for error in EXAMPLES}
    assert len({error.reason for error in EXAMPLES}) == len(EXAMPLES)
    assert all(error.reason.isidentifier() and str(error) for error in EXAMPLES)


def test_what_lies_beyond_a_dead_centre_is_no_absolute_value():
    text = "crank of leg 1 {} at pose [0.1, 0.2, 0.3, 0.01, 0.02, 0.5] (allowed: >= {})"
    beyond, near = (SingularPoseError("serial", POSE, *each, leg=1) for each in ((-3.9e-6, 0.0), (0.001, 0.02)))
    assert str(beyond) == text.format("beyond its dead centre: margin = -3.9e-06", 0)
    assert str(near) == text.format("at its dead centre: transmission |e_l . e_N| = 0.001", 0.02)


@pytest.mark.parametrize("error", EXAMPLES, ids=lambda e: type(e).__name__)
def test_an_error_crosses_a_process_boundary_with_all_it_carries(error):
    twin = pickle.loads(pickle.dumps(error))
    assert (type(twin), str(twin), twin.reason) == (type(error), str(error), error.reason)
    np.testing.assert_equal(vars(twin), vars(error))


@pytest.mark.parametrize("inner", [SystemExit("condition 'x > 0' failed."), RuntimeError("bad\n  state")])
def test_drake_guard_turns_what_drake_raises_into_our_error(inner):
    with pytest.raises(DrakeCheckError, match="solving") as caught, drake_guard("solving"):
        raise inner
    assert caught.value.__cause__ is inner
    assert "\n" not in str(caught.value)
    with pytest.raises(KeyError), drake_guard("solving"):
        raise KeyError
