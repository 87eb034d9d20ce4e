import ast
import io
import re
from contextlib import redirect_stdout

import numpy as np
import pytest
from conftest import ROOT, make_network

from stewart_drake.control.network import load_network
from stewart_drake.errors import UnreachablePoseError
from stewart_drake.runs.simulation import run
from stewart_drake.scenario import Scenario
from stewart_drake.systems.diagram import ClosedLoop, build_diagram

DIAGRAMS = ROOT / "diagrams"
PORTS = {"measurement": 12, "reference": 18, "torque": 6, "error": 6, "integral": 6, "weights": 2, "density": 12}


def scenario(**keys):
    return Scenario.from_dict({"duration": 0.1, "tuner": {"kind": "fixed"}, **keys})


def with_network(folder, **keys):
    path = folder / "net.json"
    make_network(**keys).save(path)
    return {"kind": "paper", "weights_file": str(path), "density": keys.get("density", "magnitude")}


# --- wiring --------------------------------------------------------------------------------------------------------


def test_every_signal_is_an_exported_port_by_its_name():
    loop = build_diagram(scenario())
    ports = [loop.get_output_port(i) for i in range(loop.num_output_ports())]
    states = loop.plant.plant.num_positions() + loop.plant.plant.num_velocities()
    assert {port.get_name(): port.size() for port in ports} == {**PORTS, "plant_state": states}
    assert loop.num_input_ports() == 0
    assert set(loop.sinks) == {*PORTS, "plant_state"}
    assert set(loop.systems) == {"controller", "density"} == {part.name for part in loop.loop.parts}


def test_a_start_context_stands_assembled_at_the_references_start():
    offset = (0.05, -0.02, 0.03, 0.01, -0.01, 0.02)
    case = scenario(initial_offset=list(offset))
    loop = ClosedLoop(case)
    context = loop.create_start_context()
    pose, rate, _ = case.reference.evaluate(0.0)
    measured = loop.GetOutputPort("measurement").Eval(context)
    np.testing.assert_allclose(measured, np.concatenate([pose + offset, rate]), atol=1e-12)
    assert loop.plant.loop_gap(loop.GetOutputPort("plant_state").Eval(context)).max() < 1e-12
    assert context.get_time() == 0.0
    np.testing.assert_allclose(loop.GetOutputPort("error").Eval(context), offset, atol=1e-12)
    measured = loop.GetOutputPort("measurement").Eval(loop.CreateDefaultContext())
    np.testing.assert_allclose(measured, np.concatenate([case.robot.home_pose, np.zeros(6)]), atol=1e-12)
    with pytest.raises(UnreachablePoseError):
        ClosedLoop(scenario(initial_offset=[0, 0, 0, 0, 0, 0.3])).create_start_context()


# --- numbers -------------------------------------------------------------------------------------------------------


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


# --- the same loops, wired by hand ---------------------------------------------------------------------------------


def printed(name, **names):
    """What the script prints, run as it stands in this process, but for some of its constants and imports."""
    module = ast.parse((DIAGRAMS / f"{name}.py").read_text())
    *head, guard = module.body
    assert ast.unparse(guard) == "if __name__ == '__main__':\n    main()"
    script = {"__name__": "__main__"}
    exec(compile(ast.Module(head, []), name, "exec"), script)
    assert set(names) <= set(script)
    script.update(names)
    stream = io.StringIO()
    with redirect_stdout(stream):
        exec(compile(ast.Module([guard], []), name, "exec"), script)
    return stream.getvalue()


def numbers(text):
    return [float(x) for x in re.findall(r"-?\d+\.\d*(?:e[-+]\d+)?", text)]


HAND_WIRED = {
    "fixed_weight_lqi": {
        "controller": {"feedforward": "platform"},
        "tuner": {"kind": "fixed", "omega_q": 10.0, "omega_r": 0.1},
    },
    "ann_tuned_lqi": {"controller": {"feedforward": "gravity"}, "tuner": {"kind": "paper"}},
}


@pytest.mark.slow
@pytest.mark.parametrize("name", HAND_WIRED)
def test_a_loop_wired_by_hand_is_the_loop_of_the_scenario(name, tmp_path):
    keys = HAND_WIRED[name]
    replaced = {"DURATION": 0.5}
    if name == "ann_tuned_lqi":
        tuner = with_network(tmp_path)
        keys = {**keys, "tuner": tuner}
        replaced["load_network"] = lambda: load_network(tuner["weights_file"])
    text = printed(name, **replaced)
    log = run(Scenario.from_dict({"duration": 0.5, **keys}))
    half = log["error"][log.time >= 0.2499]
    rms = np.sqrt(np.mean(half**2, axis=0))
    expected = [*np.degrees(rms[:3]), *(1e3 * rms[3:])]
    found = numbers(text.splitlines()[0])
    # Printed to four places.
    np.testing.assert_allclose(found, expected, atol=6e-5 + 1e-3 * np.max(expected))
    if name == "ann_tuned_lqi":
        weights = log["weights"]
        found = numbers(text.splitlines()[1])
        limits = [weights[:, 0].min(), weights[:, 0].max(), weights[:, 1].min(), weights[:, 1].max()]
        np.testing.assert_allclose(found, limits, atol=6e-4)


def test_the_open_loop_falls_and_stays_closed():
    text = printed("open_loop")
    *rows, gap = text.splitlines()
    assert len(rows) == 16
    heights = [numbers(row)[-1] for row in rows]
    assert heights[0] == pytest.approx(310.0)
    assert heights[-1] < heights[0] - 5.0
    assert numbers(gap)[0] < 1e-4
