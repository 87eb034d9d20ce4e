"""The exported controller takes targets, and keeps them within the limits as the filter in Python does."""

import subprocess

import pytest

from stewart_drake import load_scenario
from stewart_drake.export.controller_c import export_controller

pytestmark = pytest.mark.slow
FILE = "time_s,roll_deg,pitch_deg,yaw_deg,x_mm,y_mm,z_mm\n0,0,0,0,0,0,177\n0.1,0,0,70,0,0,190\n0.4,30,0,0,0,40,190\n"
FILE += "0.6,0,80,0,0,40,190\n"


@pytest.mark.parametrize("controller", [{}, {"kind": "feedforward", "feedforward": "none", "period": 0.02}])
def test_commands_are_those_of_the_controller(controller, tmp_path):
    (tmp_path / "targets.csv").write_text(FILE)
    changes = {"reference": {"kind": "stream", "motion_file": str(tmp_path / "targets.csv")}, "tuner": "block"}
    if controller:
        servos = {"kind": "position", "preset": "xl330_m288"}
        changes |= {"controller": controller, "motors": servos, "estimator": "difference", "tuner": "fixed"}
        changes |= {"model": {"friction": None, "motors": servos}, "safety": None}
    scenario = load_scenario("reachy_nod").replace({**changes, "safety": None})
    export_controller(scenario, "streamed", tmp_path / "c")
    header = (tmp_path / "c" / "streamed.h").read_text()
    assert "#define STREAMED_REFERENCE 6 /* numbers of a sample of the reference, a target pose */" in header
    assert "(6,) the newest target, a pose [rad, m], which is kept within the limits; NaN for none." in header
    done = subprocess.run(["make", "-C", tmp_path / "c", "check"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "largest difference of a command" in done.stderr
