import ast
import io
import re
from contextlib import redirect_stdout

import numpy as np
import pytest
from conftest import ROOT, make_network

from stewart_drake.control.network import load_network
from stewart_drake.runs.simulation import run
from stewart_drake.scenario.scenario import Scenario
from stewart_drake.systems.diagram import build_diagram

DIAGRAMS = ROOT / "diagrams"
PORTS = {
    **{"measurement": 12, "reference": 18, "torque": 6, "torque_applied": 6, "error": 6, "integral": 6, "weights": 2},
    "density": 12,
}


def scenario(**keys):
    return Scenario.from_dict({"duration": 0.1, "tuner": {"kind": "fixed"}, **keys})


def test_every_signal_is_an_exported_port_by_its_name():
    loop = build_diagram(scenario())
    ports = [loop.get_output_port(i) for i in range(loop.num_output_ports())]
    assert {port.get_name(): port.size() for port in ports} == {**PORTS, "plant_state": loop.plant.default.size}
    assert loop.num_input_ports() == 0
    assert set(loop.sinks) == {*PORTS, "plant_state"}
    names = {"tracking_error", "controller", "density", "motors"}
    assert set(loop.systems) == names == {part.name for part in loop.loop.parts}


@pytest.mark.slow
def test_tracking_errors_are_those_of_the_independent_study_in_the_notes():
    # (37), (38), gravity off, omega 1/1, statics, control period 1 ms: a separate program measured 0.166 deg, 3.54 mm.
    # A tick that sees the plant one step too late gives 0.157 deg.
    case = Scenario.from_dict(
        {
            "gravity": 0.0,
            "controller": {"period": 0.001, "feedforward": "none", "solver": "split"},
            "tuner": {"kind": "fixed"},
        }
    )
    rms = np.sqrt(np.mean(run(case)["error"] ** 2, axis=0))
    assert np.degrees(rms[0]) == pytest.approx(0.166, rel=0.01)
    assert 1e3 * rms[5] == pytest.approx(3.54, rel=0.01)


def printed(name, **names):
    # What the script prints, run as it stands in this process, but for some of its constants and imports.
    *head, guard = ast.parse((DIAGRAMS / f"{name}.py").read_text()).body
    script = {"__name__": "__main__"}
    exec(compile(ast.Module(head, []), name, "exec"), script)
    assert set(names) <= set(script)
    script.update(names)
    with redirect_stdout(io.StringIO()) as stream:
        exec(compile(ast.Module([guard], []), name, "exec"), script)
    return [[float(x) for x in re.findall(r"-?\d+\.\d*(?:e[-+]\d+)?", row)] for row in stream.getvalue().splitlines()]


@pytest.mark.slow
def test_loops_wired_by_hand_are_the_loops_of_scenarios(tmp_path):
    path = tmp_path / "net.json"
    make_network().save(path)
    fixed = {"controller": {"feedforward": "platform"}, "tuner": {"kind": "fixed", "omega_q": 10.0, "omega_r": 0.1}}
    tuned = {"controller": {"feedforward": "gravity"}, "tuner": {"kind": "paper", "weights_file": str(path)}}
    by_hand = (
        printed("fixed_weight_lqi", DURATION=0.5),
        printed("ann_tuned_lqi", DURATION=0.5, load_network=lambda: load_network(path)),
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


def test_the_open_loop_falls_and_stays_closed():
    *rows, gap = printed("open_loop")
    assert len(rows) == 16
    assert rows[0][-1] == pytest.approx(310.0)
    assert rows[-1][-1] < rows[0][-1] - 5.0
    assert gap[0] < 1e-4
