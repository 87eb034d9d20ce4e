"""The ball in Drake's plant against the closed form."""

import numpy as np
import pytest

from stewart_drake import load_scenario, run

TILTS = {"kind": "sine", "amplitude": [0.01, 0.02, 0, 0, 0, 0.01], "angular_frequency": [5.0, 4.0, 1.0, 1.0, 1.0, 3.0]}
ROLLS = {"reference": {"kind": "adjusted", "fade_in": 0.3, "motion": TILTS}, "ball_control": None}


def rolled(duration, **ball):
    """Paths on both plants, and the length of the path."""
    options = {"throws": [{"time": 0.5 * duration, "velocity": [0.1, -0.05]}], "resistance": 0.005, **ball}
    scenario = load_scenario("ball").replace({**ROLLS, "duration": duration, "ball": options})
    paths = [run(scenario.replace({"plant.kind": kind}))["ball"] for kind in ("closed_form", "drake")]
    return *paths, np.linalg.norm(np.diff(paths[0], axis=0), axis=1).sum()


@pytest.mark.parametrize("duration", [0.4, pytest.param(2.0, marks=pytest.mark.long)])
def test_a_ball_in_contact_rolls_as_the_closed_form(duration):
    exact, contact, length = rolled(duration, velocity=[0.05, 0.1], plate={"height": 0.03})
    assert length > 0.05
    assert np.linalg.norm(exact - contact, axis=1).max() < 0.01 * length


@pytest.mark.long
def test_a_smooth_ball_slips():
    """With hardly any friction a ball that is thrown does not begin to roll, and goes faster."""
    exact, contact, _ = rolled(0.6, friction=0.001)
    assert np.linalg.norm(contact[-1]) > 1.2 * np.linalg.norm(exact[-1])
