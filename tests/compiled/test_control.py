import itertools

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from robots import PAPER, offsets, robots
from strategies import vectors

from stewart_drake.compiled import control, mechanism
from stewart_drake.control.inputs import Measurement, Setpoint
from stewart_drake.control.lqi import initial_memory, lqi_tick
from stewart_drake.control.lqi_options import LqiOptions
from stewart_drake.control.state_space import acceleration_map
from stewart_drake.errors import NotFiniteError, RiccatiError, RunFailure, UnreachablePoseError
from stewart_drake.mechanics.dynamics import pose_acceleration_map
from stewart_drake.mechanics.kinematics import leg_geometry, line_conditioning, reach_margin

GRAVITY = 9.81
REST = np.zeros(6)
BLOCKS = np.array([4.0e5, 100.0, 1.0e6, 1.0])
EXACT = {"solver": "split", "period": 0.001, "model": "exact", "feedforward": "full", "weight_length": 0.11}


def both(robot, options, measurement, setpoint, weights, memory=None, gravity=GRAVITY):
    """What numpy and numba make of a tick: a memory or a failure, each."""
    memory = initial_memory() if memory is None else memory
    outcomes = []
    for compiled in (False, True):
        own = LqiOptions(**options)
        try:
            with np.errstate(all="ignore"):
                outcomes.append(lqi_tick(robot, own, gravity, measurement, setpoint, weights, memory, compiled))
        except RunFailure as failure:
            outcomes.append(failure)
    return outcomes


def assert_same_memory(one, other):
    for name in one._fields:
        expected = np.asarray(getattr(one, name))
        tolerance = 1e-8 * (1.0 + np.abs(expected).max())
        np.testing.assert_allclose(getattr(other, name), expected, rtol=0.0, atol=tolerance, err_msg=name)


def assert_same_failure(one, other, kind):
    assert type(one) is type(other) is kind
    assert (one.reason, one.leg) == (other.reason, other.leg)
    for name in ("pose", "margin", "kind", "signal"):
        assert hasattr(one, name) == hasattr(other, name)
        if hasattr(one, name):
            expected = getattr(one, name)
            if isinstance(expected, str):
                assert getattr(other, name) == expected
            else:
                np.testing.assert_allclose(getattr(other, name), expected, rtol=1e-9, atol=1e-12)


@settings(max_examples=60)
@given(robots, offsets(), st.booleans(), st.booleans())
def test_acceleration_map(robot, offset, exact, printed):
    pose = robot.home_pose + offset
    assume(reach_margin(robot, pose).min() > 0.01)
    legs, lines, turn, out = np.empty((6, 14)), np.empty((6, 6)), np.empty((3, 3)), np.empty((6, 6))
    packed = mechanism.pack(robot)
    mechanism.leg_vectors(packed, pose, legs)
    mechanism.rod_lines(legs, lines)
    mechanism.rotation(pose[:3], turn)
    assert control.acceleration_map(packed, exact, printed, pose, legs, lines, turn, out)
    kind = "printed" if printed else "statics"
    expected = pose_acceleration_map(robot, pose) if exact else acceleration_map(robot, pose, kind)
    np.testing.assert_allclose(out.T, expected, rtol=0.0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.slow
@settings(max_examples=150)
@given(
    robot=robots,
    offset=offsets(0.7),
    error=vectors(6, 0.02),
    rate=vectors(6, 0.5),
    acceleration=vectors(6, 3.0),
    z=vectors(6, 1e-3),
    weights=st.sampled_from([BLOCKS, np.array([3.0, 0.5])]),
    before=st.sampled_from([None, np.array([1.0e4, 20.0, 3.0e6, 2.0])]),
    gravity=st.sampled_from([0.0, GRAVITY]),
    options=st.fixed_dictionaries(
        {
            "solver": st.just("split"),
            "period": st.sampled_from([0.001, 0.005]),
            "model": st.sampled_from(["paper", "exact"]),
            "force_map": st.sampled_from(["statics", "printed"]),
            "feedforward": st.sampled_from(["none", "gravity", "platform", "full"]),
            "feedforward_at": st.sampled_from(["measured", "reference"]),
            "weight_length": st.sampled_from([1.0, 0.11]),
            "discretization": st.sampled_from(["exact", "euler"]),
            "saturation": st.sampled_from(["none", "clamp", "back_calculation"]),
            "reset_time": st.sampled_from([0.05, 1e-4]),
            "integral_limit": st.sampled_from([None, (5e-4, 2e-4)]),
            "bumpless": st.booleans(),
        }
    ),
)
def test_a_tick_is_numpys_whatever_the_options(
    robot, offset, error, rate, acceleration, z, weights, before, gravity, options
):
    pose = robot.home_pose + offset
    assume(min(reach_margin(robot, pose).min(), reach_margin(robot, pose - error).min()) > 0.02)
    assume(float(line_conditioning(robot, leg_geometry(robot, pose))) > 0.01)
    assume(float(line_conditioning(robot, leg_geometry(robot, pose - error))) > 0.01)
    memory = initial_memory()._replace(integral=z)
    if before is not None:
        memory = memory._replace(weights=before)
    setpoint = Setpoint(pose - error, 0.5 * rate, acceleration)
    one, other = both(robot, options, Measurement(pose, rate), setpoint, weights, memory, gravity)
    assert_same_memory(one, other)


@pytest.mark.slow
def test_an_option_is_none_that_changes_nothing():
    """Each of them shows in the compiled tick, so that agreeing with numpy means something."""
    pose = PAPER.home_pose + [0.1, -0.05, 0.08, 0.01, 0.02, -0.005]
    measurement, setpoint = Measurement(pose, np.full(6, 0.1)), Setpoint(pose - 0.02, REST, np.full(6, 3.0))
    memory = initial_memory()._replace(integral=np.full(6, 1e-3), weights=np.array([1e4, 20.0, 3e6, 2.0]))
    base = LqiOptions(**EXACT)

    def torque_and_z(**options):
        own = LqiOptions(**(EXACT | options))
        output = lqi_tick(PAPER, own, GRAVITY, measurement, setpoint, BLOCKS, memory, True)
        return np.concatenate([output.torque, output.integral])

    reference = torque_and_z()
    for name, value in {
        "period": 0.002,
        "model": "paper",
        "feedforward": "gravity",
        "feedforward_at": "reference",
        "weight_length": 1.0,
        "discretization": "euler",
        "saturation": "clamp",
        "integral_limit": (5e-4, 2e-4),
        "bumpless": True,
    }.items():
        assert getattr(base, name) != value
        assert not np.allclose(torque_and_z(**{name: value}), reference, rtol=1e-6, atol=0.0), name
    limited = torque_and_z(saturation="back_calculation")
    assert not np.allclose(limited, torque_and_z(saturation="clamp"), rtol=1e-6, atol=0.0)
    assert not np.allclose(limited, torque_and_z(saturation="back_calculation", reset_time=0.01), rtol=1e-6, atol=0.0)
    paper, printed = (torque_and_z(model="paper", force_map=kind) for kind in ("statics", "printed"))
    assert not np.allclose(paper, printed, rtol=1e-6, atol=0.0)


# --- failures ------------------------------------------------------------------------------------------------------


AT_HOME = {"pose": PAPER.home_pose, "rate": REST, "reference": PAPER.home_pose, "reference rate": REST}
AT_HOME |= {"acceleration": REST, "weights": BLOCKS, "z": REST}


def at_home(**changes):
    """What both make of a tick at home in which something is wrong."""
    given_ = AT_HOME | changes
    measurement = Measurement(given_["pose"], given_["rate"])
    setpoint = Setpoint(given_["reference"], given_["reference rate"], given_["acceleration"])
    memory = initial_memory()._replace(integral=given_["z"])
    return both(PAPER, EXACT, measurement, setpoint, np.array(given_["weights"]), memory)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize(
    ("where", "signal"),
    [
        *(("pose", "measured pose"), ("rate", "measured pose rate"), ("z", "torque")),
        *((name, "reference") for name in ("reference", "reference rate", "acceleration")),
    ],
)
def test_numbers_that_are_not_finite(where, signal, bad):
    one, other = at_home(**{where: np.array([0.0, 0.0, bad, 0.0, 0.0, 0.0])})
    assert_same_failure(one, other, NotFiniteError)
    assert signal in other.signal


@pytest.mark.parametrize(
    "weights",
    [[1.0, 0.0], [np.nan, 1.0], [1.0] * 3, [1e-300] * 3 + [1e300], [1e300] * 3 + [1e-300], [1e300, 1e-300, 1e300, 1.0]],
)
def test_weights_that_are_none_or_beyond_floating_point(weights):
    one, other = at_home(weights=weights)
    if isinstance(one, RunFailure):
        assert_same_failure(one, other, RiccatiError)
    else:
        assert_same_memory(one, other)


@settings(max_examples=80)
@given(robots, offsets(6.0), st.sampled_from(["measured", "reference"]))
def test_poses_out_of_reach_and_singular_ones(robot, offset, at):
    """Far and near; each has the same name, leg, pose and margin."""
    pose = robot.home_pose + offset
    margins = np.sort(reach_margin(robot, pose))
    # Two legs equally bad may be told apart by rounding.
    assume(abs(margins[0]) > 1e-9 and margins[1] - margins[0] > 1e-9)
    far, home = Measurement(pose, REST), Measurement(robot.home_pose, REST)
    measurement, setpoint = (far, home) if at == "measured" else (home, far)
    options = EXACT | {"feedforward_at": "reference"}
    one, other = both(robot, options, measurement, Setpoint(*setpoint, REST), BLOCKS)
    if isinstance(one, RunFailure):
        assert_same_failure(one, other, type(one))
        if isinstance(one, UnreachablePoseError):
            np.testing.assert_array_equal(other.pose, pose)
    else:
        assert not isinstance(other, RunFailure)


def test_of_two_faults_both_name_the_same():
    """The order of checks: rate, reference, pose, reach, weights."""
    nan, far = np.full(6, np.nan), PAPER.home_pose + [0, 0, 0, 0, 0, 1.0]
    faults = [("rate", nan), ("reference", nan), ("pose", nan), ("pose", far), ("weights", [-1.0, 1.0])]
    for (first, bad), (second, worse) in itertools.combinations(faults, 2):
        one, other = at_home(**{second: worse, first: bad})
        assert isinstance(one, RunFailure), (first, second)
        assert_same_failure(one, other, type(one))
        alone = at_home(**{first: bad})
        assert_same_failure(alone[0], other, type(alone[0]))
