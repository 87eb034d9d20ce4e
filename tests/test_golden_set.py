"""The contract itself is a command (`make golden`); here: that it leaves no kind out, and that it notices a change."""

import json

import golden_set
import numpy as np
import pytest

SCHEMA = json.loads((golden_set.ROOT / "diagrams" / "scenarios" / "schema.json").read_text())
POSE, TORQUE, TEXT = "runs/exact/drake/pose", "runs/exact/drake/torque", "runs/exact/drake/metrics/status"
METRIC, CHAOTIC = "runs/encoders/reduced/metrics/torque_rms", "shipped/paper_fig7_chaotic/metrics/rmse_mm"


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
    keys = set(golden_set.recorded(golden_set.GOLDEN, report=True))
    assert not [key for key in keys if key.endswith("/raised")]
    groups = {"/".join(key.split("/")[:parts]) for key in keys for parts in (1, 2, 3)}
    assert golden_set.jobs().keys() <= groups
    assert "report" in groups


@pytest.fixture(scope="module")
def recording():
    return golden_set.recorded(golden_set.GOLDEN, report=False)


def told(recording, key, value):
    return [each for _, each, _ in golden_set.differences(recording, {**recording, key: value})]


def with_last(value, change):
    value = value.copy()
    value[-1, 2] += change
    return value


@pytest.mark.parametrize(
    ("key", "change"),
    [
        (POSE, lambda pose, share: with_last(pose, share * 1e-9)),
        (TORQUE, lambda torque, share: with_last(torque, share * 1e-8 * np.abs(torque).max())),
        (METRIC, lambda number, share: number * (1.0 - share * 1e-6)),
        (CHAOTIC, lambda three, share: [100.0 ** (share > 1.0) * each for each in three]),
    ],
)
def test_a_change_beyond_its_tolerance_is_told(recording, key, change):
    assert told(recording, key, change(recording[key], 0.9)) == []
    assert told(recording, key, change(recording[key], 1.1)) == [key]
