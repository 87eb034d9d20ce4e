import functools

import pytest

TEXT = """
scenario: paper_fig7
set: {duration: 0.05, controller: {kind: pid}}
controllers: {weak: {controller.kp: 20.0}, strong: {controller.kp: 40.0}}
references: {hold: {reference: {kind: hold}}}
"""


@pytest.fixture
def compare(call):
    """The subcommand."""
    return functools.partial(call, "compare")


@pytest.mark.slow
def test_a_file_is_run_and_its_tables_are_shown_and_kept(compare, tmp_path, monkeypatch):
    (tmp_path / "mine.yaml").write_text(TEXT)
    status, out, _ = compare("mine.yaml", "--workers", 1)
    assert status == 0
    assert all(word in out for word in ("weak", "strong", "change per tick", "runs/mine"))
    names = {path.name for path in (tmp_path / "runs" / "mine").iterdir()}
    assert {"comparison.parquet", "comparison.csv", "comparison.md", "rmse.png", "error.png"} <= names
    monkeypatch.setenv("COLUMNS", "80")
    status, out, _ = compare("mine.yaml", "--workers", 1)
    assert "change per tick" not in out
    status, out, _ = compare("mine.yaml", "--quiet", "--quick", "--workers", 1)
    assert (status, out) == (0, "")
    assert (tmp_path / "runs" / "mine-quick").is_dir()
