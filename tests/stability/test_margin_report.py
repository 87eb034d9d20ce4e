"""What margins leave in tables, documents and rows."""

import json

import numpy as np
import pytest

from stewart_drake.planning.pose_box import NEAR, sample_poses
from stewart_drake.scenario import load_scenario
from stewart_drake.stability.linear_loop import linear_loops
from stewart_drake.stability.margins import HEADER, document, facts, loop_margins, rows, table


@pytest.fixture(scope="module")
def loops():
    made = load_scenario("exact_breathing", ["tuner=block"])
    return linear_loops(made, sample_poses(made.robot, NEAR, 20, np.random.default_rng(3)).poses)


@pytest.fixture(scope="module")
def found(loops):
    return loop_margins(loops)


def test_the_table_says_what_the_worst_pose_has(loops, found):
    said = {line[0]: line[1:] for line in table(found, loops.period)}
    assert {len(line) for line in said.values()} == {len(HEADER) - 1}
    assert float(said["disk margin [-]"][3]) == pytest.approx(found.all_at_once.disk.min(), rel=1e-2)
    assert float(said["gain down to [-]"][0]) == pytest.approx(found.single.gain_low.max(), rel=1e-2)
    assert float(said["delay [ms]"][0]) == pytest.approx(1e3 * found.single.delay.min(), rel=1e-2)
    assert float(said["delay [ticks]"][3]) == pytest.approx(found.all_at_once.delay.min() / loops.period, rel=1e-2)
    assert float(said["phase [deg]"][5]) == pytest.approx(np.degrees(np.median(found.all_at_once.phase)), rel=1e-2)


def test_the_document_has_the_same_numbers_and_each_row_a_pose(loops, found):
    said = json.loads(json.dumps(document(loops, found), allow_nan=False))
    assert said["margins"]["disk"]["all_at_once"][0] == found.all_at_once.disk.min()
    assert said["margins"]["delay_s"]["one_motor"][0] == found.single.delay.min()
    assert said["stable"] == said["poses"] == 20
    assert said["worst_pose"] == loops.poses[found.all_at_once.disk.argmin()].tolist()
    kept = rows(loops, found)
    assert kept.num_rows == 20
    np.testing.assert_array_equal(kept["disk_motor_3"], found.single.disk[:, 3])
    np.testing.assert_array_equal(kept["delay_s"], found.all_at_once.delay)


def test_no_margin_without_end_is_a_number_and_what_was_left_out_is_said(loops):
    free = loops._replace(c=0.0 * loops.c, a=0.5 * loops.a, left_out=("a pose: why",))
    found = loop_margins(free)
    assert document(free, found)["margins"]["gain_high"]["all_at_once"] == [None] * 3
    assert ("left out", "1 poses, such as: a pose: why") in facts(free, found)
    assert {line[0]: line[1:] for line in table(found, free.period)}["delay [ms]"] == ("inf",) * 6
