import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from strategies import ROBOT, poses

from stewart_drake.errors import ConfigurationError
from stewart_drake.mechanics.dynamics import crank_map, force_map, force_map_of_legs
from stewart_drake.mechanics.kinematics import leg_geometry, twist_jacobian

CASES = json.loads((Path(__file__).parents[1] / "data" / "reference_values.json").read_text())["cases"]


@given(pose=poses())
def test_statics_is_the_transposed_jacobian(pose):
    jacobian = twist_jacobian(ROBOT, pose)
    np.testing.assert_allclose(force_map(ROBOT, pose, "statics"), jacobian.T, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("kind", ["printed", "statics"])
def test_both_maps_of_an_independent_implementation(case, kind):
    np.testing.assert_allclose(force_map(ROBOT, case["pose"], kind), case[f"force_map_{kind}"], rtol=1e-11, atol=1e-12)


def test_another_kind_is_refused():
    with pytest.raises(ConfigurationError, match="statics or printed"):
        force_map(ROBOT, ROBOT.home_pose, "static")


def test_at_a_dead_centre_printed_is_zero_and_statics_infinite_without_a_warning():
    legs = leg_geometry(ROBOT, ROBOT.home_pose)
    dead = dataclasses.replace(legs, transmission=legs.transmission * [1, 1, 0, 1, 1, 1])
    assert crank_map(ROBOT, dead, "printed")[2] == 0.0
    assert crank_map(ROBOT, dead, "statics")[2] == np.inf
    assert np.linalg.matrix_rank(force_map_of_legs(ROBOT, dead, "printed")) == 5
