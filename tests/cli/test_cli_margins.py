import functools
import json

import pytest

from stewart_drake.files.yaml_files import shipped_folder

PD = f"{shipped_folder('comparisons') / 'task_space_pd.py'}:TaskSpacePd"


@pytest.fixture
def margins(call):
    """The subcommand."""
    return functools.partial(call, "margins")


def test_it_prints_the_table_and_writes_numbers_rows_and_a_picture(margins, tmp_path):
    import pyarrow.parquet as pq

    status, out, err = margins("--poses", 10, "--set", "estimator.kind=observer")
    assert (status, err) == (0, "")
    for words in ("disk margin [-]", "delay [ticks]", "all at once: least", "10 of 10 poses", "worst pose"):
        assert words in out
    folder = tmp_path / "runs" / "margins"
    assert sorted(path.name for path in folder.iterdir()) == ["margins.json", "margins.parquet", "margins.png"]
    said = json.loads((folder / "margins.json").read_text())
    assert pq.read_table(folder / "margins.parquet").num_rows == said["poses"] == 10
    assert (folder / "margins.png").read_bytes().startswith(b"\x89PNG")
    least = f"{said['margins']['disk']['all_at_once'][0]:.3g}"
    assert least in next(line for line in out.splitlines() if "disk margin" in line)


def test_the_same_poses_give_the_same_bytes_and_a_seed_gives_others(margins, tmp_path):
    for out, seed in (("one", 0), ("two", 0), ("three", 1)):
        assert margins("--poses", 3, "--seed", seed, "--out", out, "--quiet") == (0, "", "")
    one, two, three = ((tmp_path / name / "margins.json").read_bytes() for name in ("one", "two", "three"))
    assert one == two != three


def test_another_robot_has_a_box_of_its_size(margins, tmp_path):
    status, _, err = margins("reachy_nod", "--poses", 5, "--quiet", "--out", "reachy")
    assert (status, err) == (0, "")
    said = json.loads((tmp_path / "reachy" / "margins.json").read_text())
    assert said["poses"] + said["left_out"] == 5


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--set", f"controller={{kind: '{PD}'}}"), "controller.kind: expected lqi, pid or"),
        (("--set", "controller={kind: 'psutil:Popen'}"), "say --trust-code"),
        (("no_such_scenario",), "no_such_scenario"),
        (("--set", "tuner.q_pose=-1"), "tuner.q_pose: expected "),
        (("--poses", "0"), "--poses"),
    ],
)
def test_bad_input_is_one_line_and_nothing_is_written(margins, tmp_path, arguments, words):
    status, out, err = margins(*arguments)
    assert (status, out) == (2, "")
    assert words in err
    assert err.strip().splitlines()[-1].count(":") >= 1
    assert list(tmp_path.iterdir()) == []
