"""The robot in a tab: the page of `make tab` does what Python does, faster than real time and without a network."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from stewart_drake.base.registry import ADAPTATIONS

pytest.importorskip("ziglang")
playwright = pytest.importorskip("playwright")

NODE = Path(playwright.__file__).parent / "driver" / "node"
SCRIPT = Path(__file__).parents[2] / "docs" / "scripts" / "tab.js"
CHROMIUM = shutil.which("chromium")
ARGS = ["--no-sandbox", "--disable-quic", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
FIRST_SECOND = """async () => {
  const session = new TabSession(robot);
  await session.load();
  const rows = [];
  for (let k = 0; k < 50; k += 1) { session.advance(robot.stride); rows.push(session.row()); }
  const before = performance.now();
  session.advance(5 * 50 * robot.stride);
  const factor = 5000 / (performance.now() - before);
  return { rows, links: rows.map((row) => linksOf(row.frames)), factor, ended: session.ended };
}"""
LEARNT = """async () => {
  const session = new TabSession(robot);
  await session.load();
  const error = (seconds) => {
    let sum = 0;
    for (let k = 0; k < 50 * seconds; k += 1) { session.advance(robot.stride); sum += session.row().rotation_deg ** 2; }
    return Math.sqrt(sum / 50 / seconds);
  };
  const right = error(6);
  session.tell({ do: "friction", value: robot.friction_ends[1] });
  error(6);
  const wrong = error(6);
  session.tell({ do: "learn", on: true });
  error(10);
  return [right, wrong, error(6), session.ended];
}"""


@pytest.fixture(scope="module")
def data():
    import tab

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ADAPTATIONS, "_lines", dict(ADAPTATIONS._lines))  # the tab adds a law of its own
        yield {name: tab.robot_data(name, scenario) for name, scenario in tab.robots().items()}


def in_node(code, robot):
    """Value of an asynchronous function of JavaScript, with the page's script and a robot."""
    program = (
        f"const {{ TabSession, linksOf }} = require({json.dumps(str(SCRIPT))});\n"
        'const robot = JSON.parse(require("fs").readFileSync(0, "utf-8"));\n'
        f"({code})().then((result) => console.log(JSON.stringify(result)));"
    )
    command = [NODE, "-e", program]
    run = subprocess.run(command, input=json.dumps(robot), capture_output=True, text=True, check=True)
    return json.loads(run.stdout)


@pytest.fixture(scope="module")
def page(data, tmp_path_factory):
    if CHROMIUM is None and "CI" not in os.environ:
        pytest.skip("needs Chromium")
    import tab
    from playwright.sync_api import sync_playwright

    file = tmp_path_factory.mktemp("tab") / "tab.html"
    file.write_text(tab.page(data))
    assert file.stat().st_size < 2e6
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=ARGS)
        page = browser.new_page(viewport={"width": 390, "height": 844})
        page.problems, page.asked = [], []
        page.on("pageerror", lambda error: page.problems.append(str(error)))
        page.on("request", lambda request: page.asked.append(request.url))
        page.goto(file.as_uri())
        page.wait_for_function("typeof last !== 'undefined' && last !== null")
        yield page
        assert not page.problems
        assert page.asked == [file.as_uri()]
        browser.close()


@pytest.mark.slow
@pytest.mark.xdist_group("tab")
@pytest.mark.parametrize("name", ["Robot of the paper", "Reachy Mini"])
def test_the_first_second_is_that_of_python(data, name):
    import tab

    from stewart_drake.live.loop import LiveLoop
    from stewart_drake.runs.scene import link_poses

    result = in_node(FIRST_SECOND, data[name])
    assert result["ended"] == ""
    assert result["factor"] > 3.0
    loop = LiveLoop(tab.robots()[name])
    for row, links in zip(result["rows"], result["links"], strict=True):
        loop.advance(round(tab.SCENE_PERIOD / loop.scenario.plant.time_step))
        np.testing.assert_allclose(row["pose"], loop.pose, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(row["torque"], loop.torque, rtol=0.0, atol=1e-9)
        expected = link_poses(loop.scenario.robot, loop.pose, loop.crank_angles, loop.wanted)
        drawn = np.reshape(links, (14, 7))
        np.testing.assert_allclose(drawn[:, :3], expected[:, :3], atol=2e-3)  # of the picture before
        assert (np.abs(np.sum(drawn[:, 3:] * expected[:, 3:], axis=1)) > 0.999).all()


@pytest.mark.slow
@pytest.mark.xdist_group("tab")
@pytest.mark.parametrize("name", ["Robot of the paper", "Reachy Mini"])
def test_wrong_friction_is_learnt(data, name):
    right, wrong, learnt, ended = in_node(LEARNT, data[name])
    assert ended == ""
    assert wrong > 3.0 * right
    assert learnt < 1.5 * right


@pytest.mark.long
@pytest.mark.xdist_group("browser")
def test_the_panel_reaches_the_robot(page):
    page.click("#push-plus-X")
    page.evaluate("tell({ do: 'push', wrench: [0, 0, 0, 5, 0, 0], duration: 5 })")  # a busy page misses a short one
    page.wait_for_function("last.pushed")
    page.select_option("#controller", "PID of each motor")
    page.wait_for_function("last.controller === 'PID of each motor'")
    page.evaluate("tell({ do: 'aim', pose: home.map((value, k) => value + (k === 5 ? 1 : 0)) })")
    page.wait_for_function("last.message === 'as far as it goes'")
    page.select_option("#dead", "2")
    page.wait_for_function("last.ended.startsWith('safety') || last.torque[2] === 0")
    page.click("#reset")
    page.wait_for_function("last.ended === '' && last.time < 2 && last.dead === null")
    assert page.evaluate("document.documentElement.scrollWidth") == 390
