import re
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated

import numpy as np
import pytest

from stewart_drake.base.jit import njit
from stewart_drake.base.records import Mat3, Record, Vec3, record

ROOT = Path(__file__).parents[2]


class Body(Record):
    mass: float  # [kg]
    tensor: Mat3  # [kg m^2]


class Arm(Body):
    limit: Vec3  # [N m]
    load: Body
    history: Annotated[np.ndarray, ("ticks", 2)]


ARM = Arm.sized(ticks=4)


def test_fields_are_stored_in_their_order_those_of_the_extended_record_first():
    assert ARM.layout.names == ("mass", "tensor", "limit", "load", "history")
    assert [ARM.layout[name].shape for name in ARM.layout.names] == [(), (3, 3), (3,), (), (4, 2)]
    assert ARM.layout["load"] == Body.layout
    assert ARM.layout.itemsize == 8 * (1 + 9 + 3 + 10 + 8)
    assert ARM is Arm.sized(ticks=4)
    with pytest.raises(TypeError, match="Arm has sizes without a number"):
        Arm.new(mass=1.0)
    with pytest.raises(TypeError, match=r"^Counter\.ticks: expected float, an array such as Vec6, or a Record, got"):
        type("Counter", (Record,), {"__annotations__": {"ticks": int}})


def test_sizes_by_name_reach_nested_records():
    class Pair(Record):
        left: Arm
        right: Body

    assert Pair.sized(ticks=4).layout["left"] == ARM.layout


def test_a_new_record_has_the_options_numbers_and_those_given():
    options = SimpleNamespace(mass=2.0, tensor=np.eye(3), limit=None, load=None, other=3.0)
    arm = ARM.new(options, load=Body.new(mass=5.0), history=1.0)
    with pytest.raises(AttributeError, match="history"):  # It would be zero without a word.
        ARM.new(options, load=Body.new())
    assert arm.shape == (1,)
    assert arm["mass"] == 2.0
    np.testing.assert_array_equal(arm["limit"], [[np.inf] * 3])
    assert arm["load"]["mass"] == 5.0
    np.testing.assert_array_equal(arm["tensor"][0], np.eye(3))
    np.testing.assert_array_equal(arm["history"], 1.0)


@njit
def _shift(arm: Arm, change: Vec3) -> None:
    arm = record(arm)
    arm.load.mass += arm.mass
    for k in range(3):
        arm.load.tensor[k, k] = change[k]


def test_a_compiled_law_reads_and_writes_nested_records():
    arm = ARM.new(mass=2.0)
    _shift(arm, np.arange(3.0))
    assert arm["load"]["mass"] == 2.0
    np.testing.assert_array_equal(arm["load"]["tensor"][0], np.diag(np.arange(3.0)))


MISTAKES = {
    "a misspelt field": ("out.reach_margin[i] =", "out.reach_margn[i] =", "attr-defined"),
    "another record": ("crank_speeds(robot, legs,", "crank_speeds(legs, legs,", "arg-type"),
    "a missing argument": ("crank_rates(legs, twist, out)", "crank_rates(legs, twist)", "call-arg"),
}


@pytest.mark.long
def test_the_type_checker_finds_mistakes_in_a_law(tmp_path, monkeypatch):
    api = pytest.importorskip("mypy.api")
    text, wrong = (ROOT / "stewart_drake" / "mechanics" / "singularities.py").read_text(), tmp_path / "laws.py"
    for right, mistake, _ in MISTAKES.values():
        assert text.count(right) == 1
        text = text.replace(right, mistake)
    wrong.write_text(text)
    monkeypatch.chdir(ROOT)
    monkeypatch.setenv("MYPYPATH", str(ROOT))
    settings = ["--config-file", str(ROOT / "pyproject.toml"), "--cache-dir", str(tmp_path / "cache")]
    report, _, _ = api.run([*settings, "--follow-imports=silent", str(wrong)])
    found = {(int(line), code) for line, code in re.findall(r"laws\.py:(\d+): error: .*\[([a-z-]+)\]", report)}
    rows = text.splitlines()
    lines = {
        kind: 1 + next(n for n, row in enumerate(rows) if seeded in row) for kind, (_, seeded, _) in MISTAKES.items()
    }
    assert found == {(lines[kind], code) for kind, (_, _, code) in MISTAKES.items()}, report
