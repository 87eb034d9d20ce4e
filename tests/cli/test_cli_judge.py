import functools

import pytest


@pytest.fixture
def judge(call):
    return functools.partial(call, "tuner", "judge")


@pytest.mark.parametrize("content", [None, "{}"])
def test_a_file_that_is_no_policy_is_refused_before_anything_is_written(judge, tmp_path, content):
    if content is not None:
        (tmp_path / "mine.json").write_text(content)
    status, out, err = judge("mine.json", "--out", "verdict")
    assert (status, out) == (2, "")
    assert "mine.json" in err
    assert err.count("\n") == 1
    assert not (tmp_path / "verdict").exists()


def test_one_seed_of_each_kind_gives_no_interval_and_is_refused(judge):
    status, out, err = judge("--seeds", 1)
    assert (status, out) == (2, "")
    assert "--seeds" in err
