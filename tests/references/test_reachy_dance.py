"""The dances of Reachy Mini's maker, as a reference of one's own; `diagrams/comparisons/reachy_dance.py`."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

from stewart_drake import ConfigurationError, load_robot, load_scenario, run
from stewart_drake.base.errors import InfeasibleReferenceError
from stewart_drake.base.yaml_files import find_file
from stewart_drake.runs.checks import check_scenario

FILE = Path(find_file("comparison", "reachy")).with_name("reachy_dance.py")
PACKAGE = "reachy_mini_dances_library"
installed = pytest.mark.skipif(
    importlib.util.find_spec(PACKAGE) is None, reason=f"pip install --no-deps {PACKAGE}, see Makefile"
)


def dancing(move, **arguments):
    motion = {"kind": f"{FILE}:Dance", "arguments": {"move": move, **arguments}}
    reference = {"kind": "adjusted", "fade_in": 1.0, "center": load_robot("reachy_mini").home_pose.tolist()}
    return load_scenario("reachy_nod").replace({"reference": {**reference, "motion": motion}, "duration": 4.0})


@installed
def test_a_dance_begins_at_rest_at_home_and_is_the_makers_move_a_beat_at_its_tempo():
    reference = dancing("simple_nod").reference
    pose, rate, acceleration = reference.evaluate(0.0)
    np.testing.assert_allclose(pose, [0.0, 0.0, 0.0, 0.0, 0.0, 0.177], atol=1e-12)
    assert np.abs([rate, acceleration]).max() < 1e-12
    times = np.linspace(1.0, 4.0, 50)
    pitch = np.radians(20.0) * np.sin(2.0 * np.pi * times * 114.0 / 60.0)  # 20 deg, a nod a beat
    np.testing.assert_allclose(reference.evaluate(times)[0][:, 1], pitch, atol=1e-6)
    assert PACKAGE not in sys.modules  # its own `__init__` would import all that drives the robot


@installed
@pytest.mark.parametrize("move", ["grid_snap", "yeah_nod"])
def test_a_move_that_jumps_is_smooth_once_it_is_averaged(move):
    check_scenario(dancing(move, smoothing=0.04))  # its rates, and what it asks of the motors
    with pytest.raises(InfeasibleReferenceError, match="breaks the limit"):
        run(dancing(move))


@installed
def test_a_move_beyond_the_cranks_is_refused_with_the_size_that_can_be_done():
    with pytest.raises(InfeasibleReferenceError, match=r"about 8\d % of its size"):
        run(dancing("headbanger_combo"))


@installed
def test_a_move_that_is_not_there_is_one_line_with_those_that_are():
    with pytest.raises(ConfigurationError, match=r"arguments\.move: expected one of simple_nod, .*, got 'wave'"):
        run(dancing("wave"))


def test_without_the_library_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda *_: None)
    with pytest.raises(ConfigurationError, match=r"^reference: .*; pip install --no-deps reachy_mini_dances_library=="):
        run(dancing("simple_nod"))
