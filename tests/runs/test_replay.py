import base64
import ctypes.util
import dataclasses
import json
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from scipy.spatial.transform import Rotation

from stewart_drake import Scenario, SimulationLog, build_plant, write_film
from stewart_drake.runs.replay import nearest_rows, write_replay


def make_log(rows=101, period=0.005, **outcome):
    scenario = Scenario.from_dict({"name": "made up", "duration": 10.0})
    time = period * np.arange(rows)
    reference, rate, _ = scenario.reference.evaluate(time)
    pose = reference - np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.002])
    _, stewart = build_plant(scenario.robot, scenario.plant)
    signals = {"time": time, "pose": pose, "reference": reference, "plant_state": stewart.assemble(pose, rate)}
    end = float(time[-1]) if rows else 0.0
    return SimulationLog(scenario, signals, end_time=end, **outcome)


def shown(page):
    """What a page shows of each run."""
    return json.loads(re.search(r'<script id="data" type="application/json">(.*?)</script>', page, re.DOTALL)[1])


def links(run):
    """(n, 14, 7) position and quaternion of each link at each frame."""
    return np.frombuffer(base64.b64decode(run["links"]), "<f4").reshape(len(run["frames"]), 14, 7)


def written(log, folder):
    write_replay(log, folder / "replay.html")
    return (folder / "replay.html").read_text()


LOG = make_log()


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    return written(LOG, tmp_path_factory.mktemp("replay"))


def test_platform_and_reference_move_as_logged(page):
    (run,) = shown(page)
    assert list(run["scene"]["links"])[-2:] == ["platform", "reference"]
    np.testing.assert_allclose(run["frames"], np.arange(16) / 30.0, atol=1e-6)
    rows = np.abs(LOG.time[:, None] - run["frames"]).argmin(axis=0)
    for number, signal in ((-2, "pose"), (-1, "reference")):
        at = links(run)[:, number]
        np.testing.assert_allclose(at[:, :3], LOG[signal][rows, 3:], atol=1e-6)
        wanted = Rotation.from_euler("xyz", LOG[signal][rows, :3])
        np.testing.assert_allclose((Rotation.from_quat(at[:, 3:]) * wanted.inv()).magnitude(), 0.0, atol=1e-6)


@given(st.integers(1, 300), st.sampled_from([0.0007, 0.005, 1.0 / 30.0, 1.0]), st.sampled_from([1.0, 30.0, 1000.0]))
def test_every_frame_shows_the_nearest_row_and_no_row_twice(rows, period, rate):
    time = period * np.arange(rows)
    frames, chosen = nearest_rows(time, rate)
    assert frames[0] == chosen[0] == 0
    assert (np.diff(frames) > 0).all()
    assert (np.diff(chosen) > 0).all()
    distance = np.abs(time[chosen] - frames / rate)
    assert (distance <= 0.5 / rate + 1e-9).all()
    assert (distance <= np.abs(time[:, None] - frames / rate).min(axis=0) + 1e-9).all()
    # Whichever is sparser, rows or frames, is used up.
    assert len(frames) >= min(rows, np.floor(time[-1] * rate) + 1) - 1


def test_page_names_the_run_and_needs_nothing_from_outside(page):
    assert "<title>made up</title>" in page
    (run,) = shown(page)
    assert (run["name"], run["lines"]) == ("made up", [["completed at 0.5 s", False]])
    assert re.findall(r'<[a-z]+ [^>]*\b(?:src|href|srcset|poster)=["\']?https?:', page) == []
    assert not re.search(r"@import|url\(|importScripts|XMLHttpRequest|WebSocket|EventSource|fetch\(|import\(", page)
    assert len(page) < 1e6


def test_what_is_not_finite_does_not_break_the_page(tmp_path):
    log = make_log()
    log.signals["torque_applied"] = np.full((101, 6), np.nan)
    text = written(log, tmp_path)
    assert shown(text)[0]["torque"][0][0] is None
    assert "NaN" not in re.search(r'<script id="data" type="application/json">(.*?)</script>', text, re.DOTALL)[1]


def test_errors_and_torques_of_several_runs_are_beside_their_robots(tmp_path):
    first, second = make_log(), dataclasses.replace(make_log(rows=51), status="stopped", message="why\nand where")
    torque = np.arange(606.0).reshape(101, 6)
    first.signals["torque_applied"] = torque
    write_replay([first, second], tmp_path / "both.html")
    runs = shown((tmp_path / "both.html").read_text())
    assert [len(run["time"]) for run in runs] == [101, 51]
    np.testing.assert_allclose(runs[0]["position_m"], 2e-3, rtol=1e-4)
    np.testing.assert_allclose(runs[0]["rotation_deg"], 0.0, atol=1e-9)
    np.testing.assert_allclose(np.transpose(runs[0]["torque"]), torque)
    assert runs[1]["torque"] == []
    assert runs[1]["lines"] == [["stopped at 0.25 s", True], ["why", True], ["and where", True]]


@pytest.mark.slow
@pytest.mark.skipif(ctypes.util.find_library("EGL") is None, reason="Drake's renderer needs libEGL")
def test_a_film_shows_each_frame_at_its_time_and_the_reference_in_green(tmp_path):
    write_film(make_log(rows=81), tmp_path / "film.gif")
    frames = []
    with Image.open(tmp_path / "film.gif") as film:
        assert (film.n_frames, film.info["duration"], film.info["loop"]) == (9, 50, 0)
        for number in range(film.n_frames):
            film.seek(number)
            frames.append(np.asarray(film.convert("RGB"), dtype=float))
    assert np.abs(frames[-1] - frames[0]).mean() > 1.0
    red, green, blue = np.moveaxis(frames[0], -1, 0)
    assert np.mean((green > red + 20) & (green > blue + 5)) > 0.002
