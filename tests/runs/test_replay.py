import base64
import ctypes.util
import dataclasses
import re
from html.parser import HTMLParser
from pathlib import Path

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.image import imread
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RollPitchYaw
from strategies import ROBOT

from stewart_drake.errors import ConfigurationError, DrakeCheckError
from stewart_drake.logs.log import SimulationLog
from stewart_drake.plant.multibody_plant import build_plant
from stewart_drake.runs import replay
from stewart_drake.runs.picture import render_png
from stewart_drake.runs.replay import nearest_rows, write_replay
from stewart_drake.scenario import Scenario

needs_egl = pytest.mark.skipif(ctypes.util.find_library("EGL") is None, reason="Drake's renderer needs libEGL")


def make_log(rows=101, period=0.005, rod_joint="universal", **outcome):
    """A log of the paper's reference, followed 2 mm too low."""
    scenario = Scenario.from_dict({"name": "made up", "duration": 10.0, "plant": {"rod_joint": rod_joint}})
    time = period * np.arange(rows)
    reference, rate, _ = scenario.reference.evaluate(time)
    pose = reference - np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.002])
    _, stewart = build_plant(scenario.robot, scenario.plant)
    signals = {"time": time, "pose": pose, "reference": reference, "plant_state": stewart.assemble(pose, rate)}
    end = float(time[-1]) if rows else 0.0
    return SimulationLog(scenario, signals, end_time=end, **outcome)


def commands(page):
    """What a page tells Meshcat: MessagePack behind data URLs."""
    packed = re.findall(r'fetch\("data:application/octet-binary;base64,([^"]*)"\)', page)
    return [msgpack.unpackb(base64.b64decode(data), strict_map_key=False) for data in packed]


def tracks(page):
    """The recording: frames a second, and (path, property) -> frames (k,) and values (k, ...)."""
    (recording,) = (command for command in commands(page) if command["type"] == "set_animation")
    rates, found = set(), {}
    for animation in recording["animations"]:
        rates.add(animation["clip"]["fps"])
        for track in animation["clip"]["tracks"]:
            frames, values = zip(*((key["time"], key["value"]) for key in track["keys"]), strict=True)
            found[animation["path"], track["name"]] = np.array(frames), np.array(values)
    (rate,) = rates
    return rate, found


def written(log, folder, **options):
    write_replay(log, folder / "replay.html", **options)
    return (folder / "replay.html").read_text()


def listening_sockets():
    """Sockets on which this process waits for connections."""
    inodes = set()
    for table in ("/proc/self/net/tcp", "/proc/self/net/tcp6"):
        rows = [line.split() for line in Path(table).read_text().splitlines()[1:]]
        inodes |= {f"socket:[{row[9]}]" for row in rows if row[3] == "0A"}
    mine = set()
    for entry in Path("/proc/self/fd").iterdir():
        try:
            mine.add(str(entry.readlink()))
        except OSError:
            continue
    return inodes & mine


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    return written(make_log(), tmp_path_factory.mktemp("replay"))


@pytest.mark.slow
@pytest.mark.parametrize("rod_joint", ["universal", "ball"])
def test_platform_and_reference_move_as_logged(rod_joint, tmp_path):
    log = make_log(rod_joint=rod_joint)
    rate, found = tracks(written(log, tmp_path))
    assert rate == 30.0
    assert all(np.array_equal(frames, np.arange(16)) for frames, _ in found.values())
    (platform,) = {path for path, _ in found if path.endswith("platform")}
    for path, signal in ((platform, "pose"), ("/drake/reference", "reference")):
        frames, position = found[path, ".position"]
        rows = np.abs(log.time[:, None] - frames / 30.0).argmin(axis=0)
        np.testing.assert_allclose(position, log[signal][rows, 3:], atol=1e-12)
        for quaternion, rpy in zip(found[path, ".quaternion"][1], log[signal][rows, :3], strict=True):
            wanted = RollPitchYaw(rpy).ToQuaternion()
            # Meshcat writes x, y, z, w; both signs are the same rotation.
            dot = np.dot(quaternion, [wanted.x(), wanted.y(), wanted.z(), wanted.w()])
            assert abs(dot) == pytest.approx(1.0, abs=1e-12)


def test_cranks_and_rods_stay_joined_in_every_frame(tmp_path):
    log = make_log()
    _, found = tracks(written(log, tmp_path))

    def poses(body):
        (path,) = {path for path, _ in found if path.endswith(body)}
        for (x, y, z, w), position in zip(found[path, ".quaternion"][1], found[path, ".position"][1], strict=True):
            yield RigidTransform(Quaternion(w, x, y, z), position)

    for leg in range(6):
        parts = zip(poses(f"crank_{leg}"), poses(f"rod_{leg}"), poses("platform"), strict=True)
        for X_WC, X_WR, X_WP in parts:  # noqa: N806 - monogram notation
            np.testing.assert_allclose(X_WC @ [ROBOT.crank_length, 0.0, 0.0], X_WR.translation(), atol=1e-9)
            np.testing.assert_allclose(
                X_WR @ [0.0, 0.0, ROBOT.rod_length], X_WP @ ROBOT.platform_joints[leg], atol=1e-6
            )


@given(
    st.integers(1, 300),
    st.sampled_from([0.0007, 0.001, 0.005, 0.02, 1.0 / 30.0, 0.1, 1.0]),
    st.sampled_from([1.0, 24.0, 30.0, 60.0, 1000.0]),
)
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


def test_long_recordings_get_fewer_frames_not_a_shorter_time_and_rows_that_are_not_finite_none(tmp_path, monkeypatch):
    monkeypatch.setattr(replay, "MAX_FRAMES", 11)
    log = make_log(rows=501)
    log["plant_state"][401:] = np.nan
    rate, found = tracks(written(log, tmp_path))
    assert rate < 30.0
    for frames, values in found.values():
        assert frames[-1] / rate == pytest.approx(2.0, abs=0.5 / rate)
        assert len(frames) <= 11
        assert np.isfinite(values).all()


def test_page_names_the_run_and_needs_nothing_from_outside(page):
    assert "<title>made up</title>" in page
    assert "<b>made up</b>: completed at 0.5 s<br>green disc: reference</div>" in page
    external = []

    class Finder(HTMLParser):
        def handle_starttag(self, tag, attributes):
            names = ("src", "href", "data", "srcset", "poster")
            external.extend(value for name, value in attributes if name in names)
            external.extend([tag] if tag in {"link", "iframe", "object", "base"} else [])

    Finder().feed(page)
    assert external == []
    script = page[page.index("</script>") :]
    assert not re.search(r"@import|url\(|importScripts|XMLHttpRequest|new WebSocket", script)
    assert all(target.startswith('"data:') for target in re.findall(r"fetch\(([^)]{0,10})", script))


def test_failed_run_says_why_with_its_markup_disarmed(tmp_path):
    log = make_log(rows=3, status="failed", reason="crank_dead_centre", message="|e_l . e_N| <script> & more", leg=5)
    assert "</b>: failed at 0.01 s<br>|e_l . e_N| &lt;script&gt; &amp; more<br>" in written(log, tmp_path)


def test_camera_sees_the_robot_and_not_the_grid(page):
    said = commands(page)
    hidden = {command["path"] for command in said if command.get("property") == "visible" and not command["value"]}
    assert {"/Grid", "/Axes"} <= {path.removesuffix("/<object>") for path in hidden}
    assert any(command["type"] == "set_target" for command in said)


@pytest.mark.slow
def test_a_page_leaves_no_port_and_says_nothing_and_a_failure_leaves_the_earlier_page(tmp_path, monkeypatch, capfd):
    before = listening_sockets()
    earlier = written(make_log(rows=1), tmp_path)
    assert all(frames.tolist() == [0] for frames, _ in tracks(earlier)[1].values())
    assert capfd.readouterr() == ("", "")

    def fail(*_):
        raise RuntimeError("Drake's own words")

    monkeypatch.setattr(replay, "_furnish", fail)
    with pytest.raises(DrakeCheckError, match="recording the replay: Drake's own words"):
        written(make_log(rows=5), tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["replay.html"]
    assert (tmp_path / "replay.html").read_text() == earlier
    assert listening_sockets() == before


def test_what_cannot_be_shown_is_refused_and_writes_nothing(tmp_path):
    log = make_log(rows=3)
    nowhere = dataclasses.replace(log, signals={**log.signals, "plant_state": np.nan * log["plant_state"]})
    for bad, rows in ((nowhere, 3), (make_log(rows=0), 0)):
        with pytest.raises(ConfigurationError, match=f"log: expected .*got '{rows} rows'"):
            written(bad, tmp_path)
    for rate in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(ConfigurationError, match="frames_per_second"):
            written(log, tmp_path, frames_per_second=rate)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@needs_egl
@pytest.mark.parametrize("size", [1.0, 2.0])
def test_still_shows_the_whole_robot_on_white(size, tmp_path):
    lengths = [
        field.name for field in dataclasses.fields(ROBOT) if field.name.split("_")[-1] in {"radius", "height", "length"}
    ]
    robot = ROBOT.replace(**{name: size * getattr(ROBOT, name) for name in lengths})
    images = []
    for passes in (1, 2):
        render_png(robot, robot.home_pose, tmp_path / "robot.png", width=240, height=180, passes=passes)
        images.append(imread(tmp_path / "robot.png"))
    image = images[0]
    assert np.abs(image - images[1]).mean() < 0.03
    assert image.shape == (180, 240, 4)
    edges = (
        image[:2].reshape(-1, 4),
        image[-2:].reshape(-1, 4),
        image[:, :2].reshape(-1, 4),
        image[:, -2:].reshape(-1, 4),
    )
    assert np.mean(np.concatenate(edges).min(axis=-1) < 0.9) < 0.02
    red, green, blue, _ = np.moveaxis(image, -1, 0)
    assert 0.01 < np.mean((blue > red + 0.2) & (blue > green)) < 0.2, "the platform's disc"
    assert 0.002 < np.mean((red > blue + 0.2) & (red > green + 0.1)) < 0.1, "the cranks"


def test_picture_of_the_readme_is_small_and_shows_the_whole_robot():
    path = Path(__file__).parents[2] / "docs" / "images" / "robot.png"
    assert path.stat().st_size < 400_000
    image = imread(path)
    assert image.shape == (900, 1200, 4)
    for edge in (image[:20], image[-20:], image[:, :20], image[:, -20:]):
        assert edge.min() > 0.9
    assert image[20:-20, 20:-20].min() < 0.2
