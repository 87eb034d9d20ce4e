"""The page docs/in_drake.md, and the scripts that it names, headless."""

import ast
import re

import numpy as np
import pytest
from conftest import ROOT, make_network

from stewart_drake import ConfigurationError, Scenario, load_network, load_scenario, run

PAGE = (ROOT / "docs" / "in_drake.md").read_text()


def test_the_page_runs_and_its_numbers_are_right():
    names = {}
    for block in re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL):
        exec(compile(block, "in_drake.md", "exec"), names)
    assert names["gap"] < 1e-6
    np.testing.assert_allclose(names["pose"], names["parameters"].home_pose, atol=5e-4)
    # [m] Half of the platform's thickness and the ball's radius.
    assert names["height"] == pytest.approx(names["pose"][5] + 0.014, abs=1e-4)
    # A log of a run has the same numbers.
    log = run(names["scenario"])
    np.testing.assert_array_equal(names["quiet"][:40], log["error"][:40])
    np.testing.assert_array_equal(names["quiet"], names["again"])
    assert np.abs(names["pushed"] - names["quiet"]).max() > 1e-4
    assert names["gain"].shape == (6, 18)
    assert names["log"].shape == (108, 40)
    masses = [
        names["controller"].parameter(each, "robot")["platform_mass"] for each in (names["other"], names["context"])
    ]
    np.testing.assert_array_equal(np.ravel(masses), [1.1, 1.0])
    assert [sample.output for sample in names["samples"]] == pytest.approx(
        [np.abs(run(each)["error"][-1]).max() for each in names["drawn"]]
    )
    assert len(names["page"]) > 1e5
    # On Drake's default contact approximation; at 0.1 s.
    torque = names["both"].get_system().GetOutputPort("torque").Eval(names["both"].get_context())
    np.testing.assert_allclose(torque, log["torque"][20], atol=1e-5)
    assert names["fastest"] > 0.0  # It falls over.
    with pytest.raises(ConfigurationError):
        names["build_diagram"](names["scenario"], inputs=["wrenches"])


def printed(name, capsys, **names):
    *head, guard = ast.parse((ROOT / "diagrams" / f"{name}.py").read_text()).body
    script = {"__name__": "__main__"}
    exec(compile(ast.Module(head, []), name, "exec"), script)
    script |= {"DURATION": 0.1, **names}
    exec(compile(ast.Module([guard], []), name, "exec"), script)
    rows = capsys.readouterr().out.splitlines()
    return [[float(number) for number in re.findall(r"-?\d+\.\d*(?:e[-+]\d+)?", row)] for row in rows]


def test_the_ball_stays_on_the_platform_above_the_table(capsys):
    errors, place, gap = printed("robot_on_a_table", capsys)
    assert max(errors[:3]) < 0.2
    assert max(errors[3:]) < 1.0
    assert -5.0 < place[1] < -1.0  # [mm] It rolls down.
    assert place[2] == pytest.approx(14.0, abs=0.1)
    assert gap[0] < 1e-6


def test_only_the_robot_with_the_load_is_pulled_down(capsys):
    first, second = printed("two_robots", capsys)
    assert 5.0 * max(first[3:]) < max(second[3:]) < 10.0


def test_monte_carlo_by_drake_prints_a_row_for_each_sample(capsys):
    _, *rows = printed("monte_carlo_by_drake", capsys, SAMPLES=3)
    assert len(rows) == 3
    for mass, off, error in rows:
        assert 0.8 <= mass <= 1.2
        assert abs(off) <= 6.0
        assert 0.0 < error < 10.0
    assert len({row[2] for row in rows}) == 3


def test_a_realistic_loop_wired_by_hand_is_that_of_its_scenario(capsys):
    offset = "initial_offset=[0.05, 0.0, -0.02, 0.004, 0.0, -0.005]"
    changes = ("tuner=block", "command_delay=0", "safety={}", offset)
    errors, level = printed("observer_and_safety", capsys, CHANGES=changes)
    log = run(load_scenario("exact_breathing", (*changes, "duration=0.1", "log_period=0.001")), check=False)
    rms = np.sqrt(np.mean((log["pose"] - log["reference"])[:101] ** 2, axis=0))
    assert np.degrees(rms[0]) > 0.5
    np.testing.assert_allclose(errors, [*np.degrees(rms[:3]), *(1e3 * rms[3:])], atol=6e-5)
    assert level[0] == log["safety"][:101, 0].max()


@pytest.mark.slow
def test_loops_wired_by_hand_are_the_loops_of_scenarios(tmp_path, capsys):
    path = tmp_path / "net.json"
    make_network().save(path)
    fixed = {"controller": {"feedforward": "platform"}, "tuner": {"kind": "fixed", "omega_q": 10.0, "omega_r": 0.1}}
    tuned = {"controller": {"feedforward": "gravity"}, "tuner": {"kind": "paper", "weights_file": str(path)}}
    by_hand = (
        printed("fixed_weight_lqi", capsys, DURATION=0.5),
        printed("ann_tuned_lqi", capsys, DURATION=0.5, load_network=lambda: load_network(path)),
    )
    for keys, found in zip((fixed, tuned), by_hand, strict=True):
        log = run(Scenario.from_dict({"duration": 0.5, **keys}))
        rms = np.sqrt(np.mean(log["error"][log.time >= 0.2499] ** 2, axis=0))
        expected = [*np.degrees(rms[:3]), *(1e3 * rms[3:])]
        # Printed to four places.
        np.testing.assert_allclose(found[0], expected, atol=6e-5 + 1e-3 * np.max(expected))
    weights = log["weights"]
    limits = [weights[:, 0].min(), weights[:, 0].max(), weights[:, 1].min(), weights[:, 1].max()]
    np.testing.assert_allclose(by_hand[1][1], limits, atol=6e-4)


def test_the_open_loop_falls_and_stays_closed(capsys):
    *rows, gap = printed("open_loop", capsys, DURATION=0.15)
    assert len(rows) == 16
    assert rows[0][-1] == pytest.approx(310.0)
    assert rows[-1][-1] < rows[0][-1] - 5.0
    assert gap[0] < 1e-4
