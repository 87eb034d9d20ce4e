import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from strategies import ROBOT, poses

from stewart_drake.errors import ConfigurationError
from stewart_drake.mechanics.force_map import crank_map, force_map, force_map_of_legs
from stewart_drake.mechanics.kinematics import leg_geometry, twist_jacobian

CASES = json.loads((Path(__file__).parents[1] / "data" / "reference_values.json").read_text())["cases"]
_SHAFT = 0.20 * math.cos(math.radians(8.0)) + 0.11, 0.20 * math.sin(math.radians(8.0))
UPRIGHT = ROBOT.replace(
    platform_joint_radius=math.hypot(*_SHAFT), platform_half_angle=math.atan2(*_SHAFT[::-1]), home_height=-0.07 + 0.404
)
"""Its platform joints lie straight above the tips of its horizontal cranks: at home every rod lies along e_N."""


@given(pose=poses())
def test_statics_is_the_transposed_jacobian(pose):
    jacobian = twist_jacobian(ROBOT, pose)
    np.testing.assert_allclose(force_map(ROBOT, pose, "statics"), jacobian.T, rtol=1e-12, atol=1e-14)


def test_printed_and_statics_agree_where_every_rod_lies_along_e_n_and_nowhere_near():
    np.testing.assert_allclose(leg_geometry(UPRIGHT, UPRIGHT.home_pose).transmission, 1.0, rtol=1e-15)
    printed, statics = (force_map(UPRIGHT, UPRIGHT.home_pose, kind) for kind in ("printed", "statics"))
    np.testing.assert_allclose(printed, statics, rtol=1e-13, atol=1e-14)
    raised = UPRIGHT.home_pose + 0.05 * np.eye(6)[5]
    printed, statics = (force_map(UPRIGHT, raised, kind) for kind in ("printed", "statics"))
    assert np.all(np.abs(printed[5]) < 0.99 * np.abs(statics[5]))


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
