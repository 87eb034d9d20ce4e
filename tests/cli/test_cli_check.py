import functools
import hashlib

import pytest

from stewart_drake.planning.limits import RULES
from stewart_drake.runs.motion_fit import motion_report
from stewart_drake.scenario import load_scenario

FAST = ("--set", "reference.angular_frequency=[14,14,14,14,14,14]", "--set", "duration=1")


@pytest.fixture
def check(call):
    """The subcommand."""
    return functools.partial(call, "check")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["heart", "paper_fig7"])
def test_the_shipped_motions_can_be_done_and_every_margin_is_shown(check, tmp_path, name):
    status, out, err = check(name)
    assert (status, err) == (0, "")
    assert "broken" not in out
    smallest = motion_report(load_scenario(name)).smallest
    assert list(smallest) == [rule for rule in RULES if rule != "crank_range"]  # the robot has no stops
    for limit, worst in smallest.items():
        (row,) = [line for line in out.splitlines() if f" {limit} " in line]
        for words in (f"{worst.margin:.4g}", f"{worst.time:.3f} s", worst.where, f"{worst.bound:.4g} {worst.unit}"):
            assert words in row
    assert list(tmp_path.iterdir()) == []


def test_what_cannot_be_done_is_one_line_and_status_2(check):
    status, out, err = check("paper_fig7", *FAST)
    assert status == 2
    assert "broken -" in next(line for line in out.splitlines() if " crank_speed " in line)
    assert err.count("\n") == 1
    assert "crank_speed at t = 0.000 s" in err
    assert "feasible" not in out


def test_the_code_that_a_scenario_runs_is_named_with_its_digest_and_not_run(check, tmp_path):
    folder = tmp_path / "given"
    folder.mkdir()
    (folder / "mine.py").write_text("raise AssertionError('it was run')\n")
    text = "controller: {kind: python, system: 'mine.py:Mine'}\nduration: 1\nreference: {kind: sine}\n"
    (folder / "mine.yaml").write_text(text)
    sha = hashlib.sha256((folder / "mine.py").read_bytes()).hexdigest()[:16]
    line = f"runs code: {folder / 'mine.py'}:Mine, sha256 {sha}"
    status, out, _ = check("given/mine.yaml", "--scale", "--out", "fit.yaml")
    assert f"{line}; `run` asks for --trust-code\n" in out
    assert load_scenario("fit.yaml", trust_code=True).controller.code.files[-1] == folder / "mine.py"
    # Now it is trusted.
    assert f"{line}\n" in check("given/mine.yaml")[1]
    _, out, _ = check("given/mine.yaml", "--set", "controller.system=numpy.linalg:Mine")
    assert "linalg/__init__.py:Mine, sha256 " in out
    status, out, err = check("given/mine.yaml", "--set", "controller.system=no_such_module:Popen")
    assert (status, out, err.count("\n")) == (2, "", 1)


@pytest.mark.slow
@pytest.mark.parametrize("how", ["--scale", "--retime"])
def test_the_scenario_written_can_be_done(check, how):
    status, out, _ = check("paper_fig7", *FAST, how, "--out", "fit.yaml")
    assert status == 2
    fitted = load_scenario("fit.yaml")
    adjusted = fitted.reference
    assert motion_report(fitted).feasible
    if how == "--scale":
        assert f"feasible at {adjusted.scale:.4f} of its size" in out
        assert (adjusted.slowdown, fitted.duration) == (1.0, 1.0)
        assert 0.8 < adjusted.scale < 1.0
    else:
        assert f"feasible {adjusted.slowdown:.4f} times slower, over {fitted.duration:.4g} s" in out
        assert fitted.duration == adjusted.slowdown
        assert 1.0 < adjusted.slowdown < 1.2
    assert check("fit.yaml")[0] == 0


def test_what_no_size_or_speed_can_mend_is_said(check, tmp_path):
    away = ("--set", "reference.center=[0,0,0,0,0,0.6]", "--set", "duration=1")
    status, out, err = check("paper_fig7", *away, "--scale", "--retime")
    assert status == 2
    assert "feasible at no size; resting in its centre, reference: breaks the limit reach" in out
    assert "feasible at no speed; standing still, reference: breaks the limit reach" in out
    assert "reach" in err
    assert check("paper_fig7", *away, "--scale", "--out", "fit.yaml")[0] == 2
    assert list(tmp_path.iterdir()) == []
