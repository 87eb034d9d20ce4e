"""What a killed process leaves: every row that was written whole, and no other."""

from pathlib import Path

import numpy as np
import pytest

from stewart_drake import ConfigurationError, Scenario, SimulationLog, inverse_kinematics, load_log
from stewart_drake.base.errors import RunFailure
from stewart_drake.logs.journal import JOURNAL, Journal

SCENARIO = Scenario(duration=1.0, sensors="encoders")
HOME = SCENARIO.robot.home_pose
ANGLES = inverse_kinematics(SCENARIO.robot, HOME)
ROWS = 40


def row(number):
    still = {"reference": np.concatenate([HOME, np.zeros(12)]), "reading": ANGLES, "reported_pose": np.full(6, np.nan)}
    return {
        "time": 0.005 * number,
        **still,
        "torque": np.zeros(6),
        "reading_age": 0.001,
        "lateness": 0.0,
        "sent": np.full(6, 0.1 * number),
    }


@pytest.fixture
def journal(tmp_path):
    journal = Journal(SCENARIO, tmp_path / JOURNAL)
    for number in range(ROWS):
        journal.append(row(number))
    yield journal
    journal.close()


def width():
    return 8 * (1 + sum(np.size(value) for value in row(0).values()))


def test_the_file_has_what_memory_has(journal, tmp_path):
    journal.close()
    left, log = load_log(tmp_path), SimulationLog(**journal.log_fields(RunFailure("the machine is lost")))
    assert set(left) == set(log)
    for name in log:
        np.testing.assert_array_equal(left[name], log[name])
    assert (left.status, left.reason, left.end_time, log.reason) == ("failed", "cut_off", 0.195, "run_failure")
    assert left.message == "the run was cut off after 0.2 s: its process was killed"
    assert left.scenario == SCENARIO
    assert left.versions == log.versions
    np.testing.assert_allclose(log["pose"], np.tile(HOME, (ROWS, 1)), atol=1e-9)


ENDS = {
    "half a row": (lambda content: content[: -width() // 2], 1),
    "zeros": (lambda content: content + bytes(3 * width()), 0),
    "old content": (lambda content: content + content[-3 * width() :], 0),
    "another order": (lambda c: c[: -3 * width()] + c[-2 * width() :] + c[-3 * width() : -2 * width()], 3),
}


@pytest.mark.parametrize(("change", "lost"), ENDS.values(), ids=ENDS)
def test_rows_that_are_not_whole_or_in_another_order_are_left_out(journal, tmp_path, change, lost):
    journal.close()
    path = tmp_path / JOURNAL
    path.write_bytes(change(path.read_bytes()))
    assert len(load_log(tmp_path).time) == ROWS - lost


def test_a_log_that_was_saved_counts(journal, tmp_path):
    journal.close()
    SimulationLog(**journal.log_fields(None)).save(tmp_path / "log.parquet")
    assert load_log(tmp_path).reason != "cut_off"


def test_no_row_of_which_a_bit_has_flipped_is_believed(journal, tmp_path):
    journal.close()
    path, chance = tmp_path / JOURNAL, np.random.default_rng(1)
    content = path.read_bytes()
    start = len(content) - ROWS * width()
    for at in chance.integers(start + width(), len(content), 30).tolist():
        damaged = bytearray(content)
        damaged[at] ^= 1 << int(chance.integers(8))
        path.write_bytes(damaged)
        number = (at - start) // width()
        log = load_log(tmp_path)
        assert len(log.time) == number
        behind = ROWS - number - 1
        assert (f"row {number} of its file is damaged, and {behind} good ones" in log.message) == (behind > 0)


@pytest.mark.parametrize("content", [b"", b"{}\n", b"\0" * 5000, None])
def test_a_journal_that_is_none_is_one_line(journal, tmp_path, content):
    journal.close()
    path = tmp_path / JOURNAL
    path.write_bytes(path.read_bytes().split(b"\n", 1)[0] + b"\n" if content is None else content)
    with pytest.raises(ConfigurationError, match=r"log .*rows\.journal"):
        load_log(tmp_path)


def test_a_full_disk_costs_the_file_and_not_the_run():
    journal = Journal(SCENARIO, Path("/dev/full"))
    for number in range(3):
        journal.append(row(number))
    journal.close()
    assert len(SimulationLog(**journal.log_fields(None)).time) == 3
