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
from stewart_drake.base.jit import new_record
from stewart_drake.export.printer import Program
from stewart_drake.export.values import Array, Axis, Record

TAME = st.floats(-3.0, 3.0)
WILD = st.one_of(TAME, st.sampled_from([0.0, -0.0, 1.0, np.nan, np.inf, -np.inf]))


def printed(law):
    program = Program()
    signature = program.function(law, [Array("double", "values", (), (Axis("0", 6),)), Record(laws.STATE, "state")])
    call = f"{signature.name}(values, state);"
    head = "#include <math.h>\n#include <stdbool.h>\n\n"
    return f"{head}{program.text(call)}\nvoid run(double *values, struct laws_state *state)\n{{\n    {call}\n}}\n"


@cache
def in_c(law):
    folder = Path(tempfile.mkdtemp())
    (folder / "law.c").write_text(printed(law))
    for cc in ("gcc", "clang"):
        compiled(folder, "law.c", flags=CHECKED, output="checked.so", cc=compiler(cc))
    return ctypes.CDLL(str(compiled(folder, "law.c"))).run


@pytest.mark.parametrize(
    ("law", "wild"),
    # What is wild in a cast to an integer, or in a product of matrices, means nothing in either language.
    [(laws.numbers, 2), (laws.swapped, 0), (laws.arrays, 6), (laws.several, 6)],
)
@given(data=st.data())
def test_a_law_in_c_is_that_of_numba(law, wild, data):
    values = np.array([data.draw(WILD if k >= wild else TAME) for k in range(6)])
    expected, mine = new_record(laws.STATE), new_record(laws.STATE)
    law(values, expected)
    in_c(law)(pointer(values), pointer(mine))
    for name in laws.STATE.names:
        np.testing.assert_allclose(mine[name], expected[name], rtol=1e-12, atol=0.0)


@pytest.mark.parametrize("law", [laws.comprehension, laws.kept], ids=lambda law: law.__name__)
def test_what_is_not_known_is_refused_with_file_and_line(law):
    with pytest.raises(ConfigurationError, match=r"laws\.py:\d+: expected what can be printed as C"):
        printed(law)


def test_the_source_can_be_read():
    text = printed(laws.several)
    assert "static struct result_di largest(const double *values)" in text
    assert "for (int k = 0; k < 6; k++) {" in text
    assert "return (struct result_di){best, at};" in text
