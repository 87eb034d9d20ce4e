"""The live page in a browser, from the shell as a user starts it."""

import os
import re
import shutil
import subprocess
import sys
import time

import pytest

pytestmark = [pytest.mark.long, pytest.mark.xdist_group("browser")]
CHROMIUM = shutil.which("chromium")
ARGS = ["--no-sandbox", "--disable-quic", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


@pytest.fixture(scope="module")
def browser():
    if CHROMIUM is None and "CI" not in os.environ:
        pytest.skip("needs Chromium")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=CHROMIUM, args=ARGS)
        yield opened
        opened.close()


class Live:
    """A live session started from the shell."""

    def __init__(self, *args):
        command = [sys.executable, "-m", "stewart_drake", "live", *args, "--no-browser"]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        self.url = re.search(r"http://localhost:\d+/", self.process.stdout.readline())[0]

    def end(self):
        self.process.send_signal(2)
        status = self.process.wait(20)
        self.process.stdout.close()
        return status


@pytest.fixture(scope="module")
def live():
    session = Live("exact_fig7", "--set", "reference=hold")
    yield session
    session.end()


@pytest.fixture
def page(browser, live):
    page = browser.new_page(viewport={"width": 1400, "height": 1000})
    errors = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(live.url)
    page.wait_for_function("typeof last !== 'undefined' && last !== null", timeout=60_000)
    yield page
    assert errors == []
    page.close()


def wait(page, condition, timeout=30_000):
    page.wait_for_function(condition, timeout=timeout)


def test_a_slider_moves_the_platform_and_stops_at_a_named_limit(page):
    wait(page, "Math.abs(last.pose[0]) < 0.01")
    slide = """([name, value]) => { const slider = document.getElementById(`pose-${name}`);
        slider.value = value; slider.dispatchEvent(new Event('input')); slider.dispatchEvent(new Event('change')); }"""
    page.evaluate(slide, ["roll", "8"])
    wait(page, "Math.abs(last.pose[0] * 180 / Math.PI - 8) < 0.1")
    page.evaluate(slide, ["Z", "100000"])
    page.evaluate("tell({ do: 'aim', pose: [0, 0, 0, 0, 0, 3] })")
    wait(page, "document.getElementById('message').textContent.includes('as far as it goes')")
    assert page.evaluate("last.target[5]") < 1.0
    page.click("#home")
    wait(page, "Math.abs(last.pose[0]) < 0.01 && Math.abs(last.pose[5] - 0.3) < 0.001")


def test_a_push_shows_in_the_trace_and_a_dead_motor_in_the_torque(page):
    page.click("#push-plus-X")
    wait(page, "Math.max(...traces.error.data[1]) > 0.2")
    page.select_option("#dead", "2")
    wait(page, "last.torque[2] === 0 || last.ended")
    page.click("#reset")
    page.wait_for_function(
        "typeof last !== 'undefined' && last !== null && last.time < 20 && !last.ended && last.torque[2] !== 0",
        timeout=60_000,
    )


def test_smoothness_is_there_where_the_controller_has_a_tuner(browser):
    own = ["plant.engine=reduced", "plant.payload_mass=0.2", "tuner={kind: policy, kappa: 0.5}"]
    session = Live("exact_breathing", *(word for each in own for word in ("--set", each)))
    page = browser.new_page()
    page.goto(session.url)
    wait(page, "last && !document.getElementById('kappa-label').hidden", 60_000)
    assert [page.inner_text(f"#{name}-text") for name in ("payload", "kappa")] == ["0.20 kg", "0.5"]
    page.select_option("#controller", "PID of each motor")
    wait(page, "document.getElementById('kappa-label').hidden && traces.setting.box.hidden")
    page.close()
    assert session.end() == 0


def test_pausing_stops_the_clock(page):
    page.click("#pause")
    wait(page, "last.paused")
    before = page.evaluate("last.time")
    time.sleep(0.5)
    assert page.evaluate("last.time") == before
    page.click("#pause")
    wait(page, f"last.time > {before} + 0.2")


def test_a_second_session_takes_another_port_and_ctrl_c_ends_it(live):
    second = Live("exact_fig7")
    assert second.url != live.url
    assert second.end() == 0


def test_the_replay_plays_seeks_and_shows_no_controls_of_meshcat(browser, tmp_path):
    run = [sys.executable, "-m", "stewart_drake"]
    subprocess.run([*run, "run", "exact_fig7", "--set", "duration=1", "--out", tmp_path / "a", "--quiet"], check=True)
    page = browser.new_page(viewport={"width": 390, "height": 900})
    errors = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto((tmp_path / "a" / "replay.html").as_uri())
    wait(page, "frames[0].contentWindow.viewer && frames[0].contentWindow.viewer.animator.duration > 0.9", 60_000)
    wait(page, "time > 0.1")
    page.click("#play")
    page.evaluate("go(0.5)")
    assert page.inner_text("#clock").startswith("0.50 of 1.00")
    assert page.evaluate("frames[0].contentWindow.viewer.animator.actions[0].time") == pytest.approx(0.5)
    assert page.evaluate("frames[0].contentWindow.viewer.gui.domElement.style.display") == "none"
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    assert errors == []
    page.close()
