"""The commands `check` and `margins`."""

import json

import numpy as np
import pytest

from stewart_drake.runs.checks import motion_report
from stewart_drake.scenario.limits import RULES
from stewart_drake.scenario.scenario import load_scenario

FAST = ("--set", "reference.angular_frequency=[14,14,14,14,14,14]", "--set", "duration=1")


def test_a_shipped_motion_can_be_done_and_every_margin_is_shown(call, tmp_path):
    status, out, err = call("check", "paper_fig7")
    assert (status, err) == (0, "")
    assert "broken" not in out
    smallest = motion_report(load_scenario("paper_fig7")).smallest
    assert list(smallest) == [rule for rule in RULES if rule != "crank_range"]  # the robot has no stops
    for limit, worst in smallest.items():
        (row,) = [line for line in out.splitlines() if f" {limit} " in line]
        for words in (f"{worst.margin:.4g}", f"{worst.time:.3f} s", worst.where, f"{worst.bound:.4g} {worst.unit}"):
            assert words in row
    assert list(tmp_path.iterdir()) == []


BEYOND = {
    "reference={kind: hold, pose: [0, 0, 45, 0, 0, 0.31]}": "yaw 45 rad at t = 0.000 s, did you mean 45 deg?",
    "reference={kind: sine, amplitude: [30, 0, 0, 0, 0, 0]}": "roll 30 rad, did you mean 30 deg?",
    "initial_offset=[0, 0, 12.5664, 0, 0, 0]": "720 deg: 0 is the same orientation",
}


@pytest.mark.parametrize("command", ["check", "run"])
@pytest.mark.parametrize(("change", "said"), BEYOND.items(), ids=["degrees", "sine", "start"])
def test_a_pose_beyond_half_a_turn_is_refused_with_what_was_meant(call, tmp_path, command, change, said):
    status, _, err = call(command, "hold", "--set", change, "--set", "duration=1")
    assert (status, err.count("\n")) == (2, 1)
    assert all(words in err for words in (f"{change.partition('=')[0]}: expected ", "half a turn", *said.split(", ")))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_what_cannot_be_done_is_named_and_the_scenario_written_can_be(call):
    status, out, err = call("check", "paper_fig7", *FAST)
    assert status == 2
    assert "broken -" in next(line for line in out.splitlines() if " crank_speed " in line)
    assert err.count("\n") == 1
    assert all(text in err for text in ("crank_speed with 10.97 rad/s at t = 0.000 s, leg 2", "about 1.1 times slower"))
    assert "feasible" not in out
    for how, words in (("--scale", "at {0.scale:.4f} of its size"), ("--retime", "{0.slowdown:.4f} times slower")):
        status, out, _ = call("check", "paper_fig7", *FAST, how, "--out", "fit.yaml")
        assert status == 2
        fitted = load_scenario("fit.yaml")
        assert "feasible " + words.format(fitted.reference) in out
        assert fitted.duration == fitted.reference.slowdown < 1.2
        assert 0.8 < fitted.reference.scale <= 1.0
        assert call("check", "fit.yaml")[0] == 0


def test_margins_are_printed_and_written(call, tmp_path):
    status, out, err = call("margins", "--poses", 10, "--set", "estimator.kind=observer")
    assert status == 0, err
    for words in ("disk margin [-]", "delay [ticks]", "all at once: least", "10 of 10 poses", "worst pose"):
        assert words in out
    folder = tmp_path / "runs" / "margins"
    assert sorted(path.name for path in folder.iterdir()) == ["margins.json", "margins.png"]
    said = json.loads((folder / "margins.json").read_text())
    assert said["poses"] == 10
    assert (folder / "margins.png").read_bytes().startswith(b"\x89PNG")
    least = f"{said['margins']['disk']['all_at_once'][0]:.3g}"
    assert least in next(line for line in out.splitlines() if "disk margin" in line)


def test_a_load_that_the_controller_does_not_know_is_checked_too(call):
    status, out, err = call("check", "exact_fig7", "--set", "plant.payload_mass=300")
    assert (status, err.count("\n")) == (2, 1)
    assert "plant_torque" in out
    assert "breaks the limit torque with 82.37 N m at t = 7.068 s" in err
    assert "(leg 0 with payload 300 kg)" in err
    status, out, err = call("check", "exact_fig7", "--set", "plant.payload_mass=1")
    assert (status, err) == (0, "")
    assert "payload 1 kg" in " ".join(out.split())


@pytest.mark.slow
def test_bode_and_step_leave_a_picture_and_print_their_figures(call, tmp_path):
    status, out, err = call("bode", "--set", "estimator.kind=observer")
    assert status == 0, err
    assert "gains of the loop fall below 1 at" in out
    assert (tmp_path / "runs" / "bode" / "bode.png").read_bytes().startswith(b"\x89PNG")
    gains = np.genfromtxt(tmp_path / "runs" / "bode" / "bode.csv", delimiter=",", names=True)
    assert gains["sensitivity_0"][0] < 1e-2 < gains["loop_0"][0]
    status, out, err = call("step", "--size", "1 mm", "--set", "plant.kind=closed_form", "--set", "duration=0.5")
    assert status == 0, err
    assert "settling time, 2 %" in out
    assert (tmp_path / "runs" / "step" / "step.png").exists()
    assert call("step", "--size", "3 deg")[2].startswith("stewart-drake: --size: expected a number [m]")
