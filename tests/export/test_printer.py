"""What is printed computes what numba computes."""

import ctypes
import tempfile
from functools import cache
from pathlib import Path

import laws
import numpy as np
import pytest
from compiled import CHECKED, compiled, compiler, pointer
from hypothesis import given
from hypothesis import strategies as st

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.export.program import Program
from stewart_drake.export.types import Array, Struct, StructType

TAME = st.floats(-3.0, 3.0)
WILD = st.one_of(TAME, st.sampled_from([0.0, -0.0, 1.0, np.nan, np.inf, -np.inf]))
VALUES = Array("double", "values", (6,))


def printed(law, *arguments):
    program = Program()
    name, *_ = program.function(law, arguments)
    names = [argument.pointer for argument in arguments]
    heads = [f"struct {program.struct(x.of)} *state" if isinstance(x, Struct) else "double *values" for x in arguments]
    call = f"{name}({', '.join(names)});"
    head = "#include <math.h>\n#include <stdbool.h>\n\n"
    return f"{head}{program.text()}\nvoid run({', '.join(heads)})\n{{\n    {call}\n}}\n"


def state_of(kind):
    return Struct(StructType(kind, kind.layout), "state")


def source(law):
    return printed(law, VALUES, state_of(laws.LawState))


@cache
def in_c(law):
    folder = Path(tempfile.mkdtemp())
    (folder / "law.c").write_text(source(law))
    for cc in ("gcc", "clang"):
        compiled(folder, "law.c", flags=CHECKED, output="checked.so", cc=compiler(cc))
    return ctypes.CDLL(str(compiled(folder, "law.c"))).run


@pytest.mark.parametrize(
    ("law", "wild"),
    # A cast of what is wild to an integer means nothing in either language.
    [(laws.numbers, 2), (laws.swapped, 0), (laws.arrays, 0), (laws.several, 6), (laws.nested, 2)],
)
@given(data=st.data())
def test_a_law_in_c_is_that_of_numba(law, wild, data):
    values = np.array([data.draw(WILD if k >= wild else TAME) for k in range(6)])
    expected, mine = laws.LawState.new(), laws.LawState.new()
    law(values, expected)
    in_c(law)(pointer(values), pointer(mine))
    for name in laws.LawState.fields:
        np.testing.assert_allclose(mine[name], expected[name], rtol=1e-12, atol=0.0)


def test_a_record_with_a_free_size_and_another_in_it(tmp_path):
    kind = laws.Longer.sized(n=5)
    (tmp_path / "law.c").write_text(printed(laws.longer, state_of(kind)))
    expected = kind.new(out=np.arange(6.0), rows=np.ones((5, 2)), inner=laws.LawState.new(out=2.0))
    mine = expected.copy()
    laws.longer(expected)
    ctypes.CDLL(str(compiled(tmp_path, "law.c", flags=CHECKED[1:2]))).run(pointer(mine))
    np.testing.assert_array_equal(mine.view(float), expected.view(float))
    assert expected["rows"][0, :, 1].tolist() == [3.0] * 5


@pytest.mark.parametrize("law", laws.REFUSED, ids=lambda law: law.__name__)
def test_what_is_not_known_is_refused_with_file_and_line(law):
    with pytest.raises(
        ConfigurationError, match=rf"laws\.py:\d+: expected what can be printed as C.*{laws.REFUSED[law]}"
    ):
        source(law)


def test_the_source_can_be_read():
    text = source(laws.several)
    assert "static struct result_di largest(const double *values)" in text
    assert "for (int k = 0; k < 6; k++) {" in text
    assert "return (struct result_di){best, at};" in text
    assert "/* What a law fills. */\nstruct law_state {\n    double out[6]; /* [-] results. */\n" in text
    assert "static double total_3(const double *values)" in source(laws.arrays)
