"""The contract itself is a command (`make golden`); here: that it leaves no kind out, and that it notices a change."""

import json

import golden_set
import numpy as np
import processors
import pytest

SCHEMA = json.loads((golden_set.ROOT / "diagrams" / "scenarios" / "schema.json").read_text())
POSE, TORQUE, TEXT = "runs/exact/drake/pose", "runs/exact/drake/torque", "runs/exact/drake/metrics/status"
METRIC, CHAOTIC = "runs/encoders/reduced/metrics/torque_rms", "shipped/paper_fig7_no_gravity/weights"


def kinds(node):
    if "$ref" in node:
        node = SCHEMA["$defs"][node["$ref"].rpartition("/")[2]]
    own = node.get("properties", {}).get("kind", {})
    found = {own["const"]} if "const" in own else set(own.get("enum", ()))
    inside = [*node.get("anyOf", ()), *node.get("oneOf", ()), *([node["items"]] if "items" in node else ())]
    return found.union(*map(kinds, inside))


@pytest.mark.parametrize("part", ["controller", "tuner", "sensors", "estimator"])
def test_every_kind_has_a_run(part):
    own = golden_set.cases()
    used = {case.get(part, {}).get("kind") for group in ("runs", "on_drake") for case in own[group].values()}
    assert len(kinds(SCHEMA["properties"][part])) > 1
    assert kinds(SCHEMA["properties"][part]) <= used


@pytest.mark.parametrize(("part", "group"), [("reference", "references"), ("disturbances", "disturbances")])
def test_every_motion_and_wrench_is_asked(part, group):
    assert kinds(SCHEMA["properties"][part]) == {data["kind"] for data in golden_set.cases()[group].values()}


def test_every_shipped_scenario_has_a_run():
    shipped = {path.stem for path in (golden_set.ROOT / "diagrams" / "scenarios").glob("*.yaml")}
    assert shipped == {case["scenario"] for case in golden_set.cases()["shipped"].values()}


def test_recording_has_all_cases():
    keys = set(golden_set.recorded(golden_set.GOLDEN))
    assert not [key for key in keys if key.endswith("/raised")]
    groups = {"/".join(key.split("/")[:parts]) for key in keys for parts in (1, 2, 3)}
    assert golden_set.jobs().keys() <= groups
    assert golden_set.tolerances(golden_set.GOLDEN).keys() <= keys


@pytest.fixture(scope="module")
def recording():
    return golden_set.recorded(golden_set.GOLDEN)


def changed(recording, key, value):
    wider = golden_set.tolerances(golden_set.GOLDEN)
    return [each for _, each, _ in golden_set.differences(recording, {**recording, key: value}, wider)]


def with_row(value, row, change):
    value = value.copy()
    value[row, 0] += change
    return value


@pytest.mark.parametrize(
    ("key", "change"),
    [
        (POSE, lambda pose, share: with_row(pose, -1, share * 1e-9)),
        (TORQUE, lambda torque, share: with_row(torque, -1, share * 1e-8 * np.abs(torque).max())),
        (METRIC, lambda number, share: number * (1.0 - share * 1e-6)),
        (CHAOTIC, lambda weights, share: with_row(weights, 0, share * 1e-6 * np.abs(weights).max())),
    ],
)
def test_a_change_beyond_its_tolerance_is_reported(recording, key, change):
    assert changed(recording, key, change(recording[key], 0.9)) == []
    assert changed(recording, key, change(recording[key], 1.1)) == [key]


def test_another_text_or_a_missing_key_is_reported(recording):
    assert changed(recording, TEXT, "lost") == [TEXT]
    without = {key: value for key, value in recording.items() if key != POSE}
    assert [key for _, key, _ in golden_set.differences(recording, without, {})] == [POSE]


def test_a_number_is_compared_as_far_as_rounding_leaves_it():
    apart = np.array([[0.0, 0.0], [1e-9, 0.0], [0.0, 3e-6], [0.0, 1e-6]])
    first = {"run/weights": np.ones((4, 2)), "run/status": "ended", "run/x": [1.0, 2.0], "run/y": 3.0, "run/z": None}
    other = first | {"run/weights": 1.0 + apart, "run/status": "lost", "run/x": [1.0, 2.1], "run/late": 1.0}
    wider = golden_set.sensitive(first, other)
    assert wider.keys() == {"run/weights", "run/status", "run/x", "run/late"}
    assert wider["run/weights"] == pytest.approx([0.0, 1e-7, 3e-4, 3e-4])
    assert wider["run/x"] == pytest.approx([0.0, 10.0])
    assert golden_set.differences(first, other, wider) == []
    for key, value in (("run/weights", with_row(first["run/weights"], 2, 4e-4)), ("run/x", [1.1, 2.0]), ("run/y", 3.1)):
        assert [each for _, each, _ in golden_set.differences(first, other | {key: value}, wider)] == [key]


def test_a_setting_reaches_the_checks_and_one_that_differs_is_reported(monkeypatch, capsys):
    program = "import os; assert os.environ['OPENBLAS_CORETYPE'] == 'Haswell'"
    monkeypatch.setattr(processors, "CHECKS", {"kernels": ["-c", program]})
    assert processors.main("Haswell") == 0
    assert processors.main("Nehalem", "Haswell", "oldest") == 1
    told = [line.partition(",")[0] for line in capsys.readouterr().out.splitlines() if ", kernels: differs" in line]
    assert told == ["Nehalem", "oldest"]
    with pytest.raises(SystemExit, match="expected settings that this processor has, native"):
        processors.main("Pentium")
