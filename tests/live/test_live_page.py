"""The live page in a browser, from the shell as a user starts it."""

import os
import re
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from stewart_drake.logs.log import load_log

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


HAS_ROWS = "typeof last !== 'undefined' && last !== null"


class Live:
    """A live session started from the shell."""

    def __init__(self, *args, folder=None):
        command = [sys.executable, "-m", "stewart_drake", "live", *args, "--no-browser"]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=folder)
        self.url = re.search(r"http://localhost:\d+/", self.process.stdout.readline())[0]

    def end(self, number=signal.SIGINT):
        self.process.send_signal(number)
        status = self.process.wait(20)
        self.process.stdout.close()
        return status


@pytest.fixture(scope="module")
def live():
    session = Live("exact_fig7", "--set", "reference=hold")
    yield session
    session.end()


def opened(browser, url, width=1400):
    """A tab on a live page that has its first row, and the errors in it; waiting for conditions needs `eval` there."""
    page, errors = browser.new_page(viewport={"width": width, "height": 1000}, bypass_csp=True), []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(url)
    wait(page, HAS_ROWS, 60_000)
    return page, errors


@pytest.fixture
def page(browser, live):
    page, errors = opened(browser, live.url)
    yield page
    assert errors == []
    page.close()


def wait(page, condition, timeout=30_000):
    page.wait_for_function(condition, timeout=timeout)


def slide(page, name, value):
    """Moves a slider to a value, a number or an expression."""
    script = f"""(value) => {{ const slider = document.getElementById("{name}"); slider.value = eval(value);
        for (const event of ["input", "change"]) slider.dispatchEvent(new Event(event)); }}"""
    page.evaluate(script, str(value))


def test_a_slider_moves_the_platform_and_stops_at_a_named_limit(page):
    wait(page, "Math.abs(last.pose[0]) < 0.01")
    slide(page, "pose-roll", 8)
    wait(page, "Math.abs(last.pose[0] * 180 / Math.PI - 8) < 0.1")
    slide(page, "pose-Z", 100000)
    wait(page, "document.getElementById('message').textContent.includes('as far as it goes')")
    page.evaluate("tell({ do: 'aim', pose: [0, 0, 0, 0, 0, 3] })")
    wait(page, "document.getElementById('message').textContent.includes('expected a pose within')")
    assert page.evaluate("last.target[5]") < 1.0
    page.click("#home")
    wait(page, "Math.abs(last.pose[0]) < 0.01 && Math.abs(last.pose[5] - 0.3) < 0.001")


def test_a_push_shows_in_the_trace_and_a_dead_motor_in_the_torque(page):
    page.click("#push-plus-X")
    wait(page, "Math.max(...traces.error.data[1]) > 0.2e-3")
    page.select_option("#dead", "2")
    wait(page, "last.torque[2] === 0 || last.ended")
    page.click("#reset")
    wait(page, "last.time < 20 && !last.ended && last.torque[2] !== 0")
    assert page.input_value("#dead") == ""


def test_smoothness_is_there_where_the_controller_has_a_tuner(browser):
    own = ["plant.kind=closed_form", "plant.payload_mass=0.2", "tuner={kind: policy, kappa: 0.5}"]
    session = Live("exact_breathing", *(word for each in own for word in ("--set", each)))
    page, _ = opened(browser, session.url)
    wait(page, "last && !document.getElementById('kappa-label').hidden", 60_000)
    assert [page.inner_text(f"#{name}-text") for name in ("payload", "kappa")] == ["0.20 kg", "0.5"]
    page.select_option("#controller", "PID of each motor")
    wait(page, "document.getElementById('kappa-label').hidden && traces.setting.box.hidden")
    page.close()
    assert session.end() == 0


def test_what_a_scenario_has_no_part_for_is_grey_with_the_reason(browser):
    servos = ("motors={kind: position}", "controller={kind: feedforward, period: 0.02}", "safety=null", "sensors=ideal")
    session = Live("sway", *(word for each in servos for word in ("--set", each)))
    page, errors = opened(browser, session.url)
    for name in ("dead", "frozen"):
        assert page.is_disabled(f"#{name}")
        assert page.get_attribute(f"#{name}-label", "title")
    page.close()
    assert errors == []
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


def test_a_second_tab_shows_what_is_set_in_the_first(page, browser, live):
    second, errors = opened(browser, live.url, width=390)
    page.click("#move")
    page.select_option("#controller", "computed torque")
    slide(page, "payload", "slider.max")
    wait(second, "document.getElementById('controller').value === 'computed torque'")
    wait(second, "!document.getElementById('move').checked")
    wait(second, "Number(document.getElementById('payload').value) === about.payload_most")
    assert second.inner_text("#payload-text") == f"{second.evaluate('about.payload_most'):.2f} kg"
    third, _ = opened(browser, live.url)
    wait(third, "document.getElementById('controller').value === 'computed torque'")
    third.click("#reset")
    wait(page, "document.getElementById('controller').value === 'as in the scenario'")
    assert second.evaluate("document.documentElement.scrollWidth") <= 390
    assert errors == []
    second.close()
    third.close()


def test_the_page_shows_when_the_session_is_gone_or_silent_and_when_it_is_back(browser):
    session = Live("exact_fig7", "--set", "plant.kind=closed_form")
    page, _ = opened(browser, session.url)
    assert page.is_hidden("#gone")
    session.process.send_signal(signal.SIGSTOP)
    wait(page, "document.getElementById('gone').textContent.includes('not answered')")
    session.process.send_signal(signal.SIGCONT)
    wait(page, "document.getElementById('gone').hidden")
    before = page.evaluate("about.session")
    assert session.end() == 0
    wait(page, "document.getElementById('gone').textContent.includes('the session has ended')")
    assert page.is_visible("#gone")
    # Whoever starts a session in its place sees that one, with its own robot.
    again = Live("exact_heart", "--set", "plant.kind=closed_form")
    if again.url == session.url:
        wait(page, f"{HAS_ROWS} && about.session !== '{before}' && document.title.startsWith('exact_heart')", 60_000)
        wait(page, "document.getElementById('gone').hidden")
    page.close()
    assert again.end() == 0


def test_small_errors_have_a_unit_that_shows_them(page):
    texts = {
        "0.4e-6": "400 nm",
        "1.234e-6": "1.23 µm",
        "0": "0 m",
        "0.3": "300 mm",
        "2": "2 m",
        "-4e-5": "-40 µm",
        "null": "--",
    }
    assert {value: page.evaluate(f"measured({value}, 'm')") for value in texts} == texts
    # Ticks of an axis are all in one unit, and none says 0 for another number.
    ticks = "[0, 5e-7, 1e-6].map((tick) => measured(tick, 'm', 6, 1e-6))"
    assert page.evaluate(ticks) == ["0 µm", "0.5 µm", "1 µm"]
    assert page.evaluate("measured(0.0006, 'deg')") == "0.0006 deg"


def test_a_page_of_another_origin_neither_reads_nor_ends_the_session(page, browser, live):
    """As with Meshcat's websocket, which one empty frame from any page ended."""
    before = page.evaluate("last.time")
    elsewhere = browser.new_page()
    # A page of the web, as far as the browser is concerned: `route` answers in its place.
    elsewhere.route("http://elsewhere.example/", lambda route: route.fulfill(body="<title>elsewhere</title>"))
    elsewhere.goto("http://elsewhere.example/")
    reached = elsewhere.evaluate(
        """async (url) => {
        const tried = {};
        const text = async (answer) => (answer.type === "opaque" ? "opaque" : (await answer.text()).length);
        for (const mode of ["cors", "no-cors"]) for (const path of ["about", "events", "do"]) {
          const how = path === "do" ? { mode, method: "POST", body: '{"do":"reset"}' } : { mode };
          tried[`${mode} ${path}`] = await fetch(url + path, how).then(text).catch(() => "refused");
        }
        const socket = new WebSocket(url.replace("http", "ws"));
        tried.socket = await new Promise((done) => {
          socket.onopen = () => done("open");
          socket.onerror = () => done("refused");
        });
        return tried;
    }""",
        live.url,
    )
    elsewhere.close()
    assert len(reached) == 7
    assert set(reached.values()) <= {"refused", "opaque"}
    wait(page, f"last.time > {before} + 0.2 && document.getElementById('gone').hidden")


def test_the_page_draws_and_steers_under_its_own_policy_of_what_it_loads(browser, live):
    page, errors = browser.new_page(), []
    page.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(live.url)
    deadline = time.monotonic() + 60.0
    while not page.evaluate("last !== null && view.links.length === 27 && view.renderer.info.render.frame > 1"):
        assert time.monotonic() < deadline
        time.sleep(0.2)
    page.close()
    assert errors == []


def test_the_replay_plays_and_seeks(browser, tmp_path):
    run = [sys.executable, "-m", "stewart_drake"]
    subprocess.run([*run, "run", "exact_fig7", "--set", "duration=1", "--out", tmp_path / "a", "--quiet"], check=True)
    page = browser.new_page(viewport={"width": 390, "height": 900})
    errors = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto((tmp_path / "a" / "replay.html").as_uri())
    wait(page, "time > 0.1")
    page.click("#play")
    page.evaluate("go(0.5)")
    assert page.inner_text("#clock").startswith("0.50 of 1.00")
    # The platform stands where the log has it, and its label fits into the page.
    log = load_log(tmp_path / "a")
    row = np.abs(log.time - 0.5).argmin()
    platform = page.evaluate("scenes[0].view.links[12].position.toArray()")
    np.testing.assert_allclose(platform, log["pose"][row, 3:], atol=1e-6)
    edges = page.evaluate("plots.map((plot) => plot.bbox.left / devicePixelRatio - plot.axes[1]._size)")
    assert min(edges) >= -1.0
    labels = page.evaluate("plots[0].axes[1]._values")
    assert len(set(labels)) == len(labels)
    assert labels[-1].endswith(("nm", "µm"))
    page.evaluate("go(0.51)")
    assert page.evaluate("scenes[0].view.links[12].position.toArray()") != platform
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    assert errors == []
    page.close()


def middle_of(page, link):
    return page.evaluate(
        """(link) => {
          const at = view.links.find(({ name }) => name === link).getWorldPosition(new THREE.Vector3());
          const { left, top, width, height } = view.renderer.domElement.getBoundingClientRect();
          const { x, y } = at.project(view.camera);
          return [left + (x + 1) / 2 * width, top + (1 - y) / 2 * height];
        }""",
        link,
    )


def test_the_platform_is_pulled_where_the_mouse_grabs_it(page):
    page.click("#reset")
    place = middle_of(page, "platform")
    page.mouse.move(*place)
    page.mouse.down()
    page.mouse.move(place[0] + 60, place[1], steps=5)
    wait(page, "last.pull !== null && last.pull.force > 1")
    assert page.evaluate("view.controls.enabled") is False
    page.mouse.up()
    wait(page, "last.pull === null")
    page.click("#reset")


def test_a_ball_is_held_and_thrown_by_the_mouse_and_a_click_moves_its_target(browser):
    session = Live("ball", "--set", "ball.throws=[]", "--set", "ball.start=[0, 0]")
    page, errors = opened(browser, session.url)
    x, y = middle_of(page, "platform")
    page.mouse.click(x + 30, y + 8)
    wait(page, "Math.hypot(...last.ball.target) > 0.02 && last.ball.away_m < 0.003")
    x, y = middle_of(page, "ball")
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x - 80, y, steps=5)
    wait(page, "last.ball.away_m > 0.03 && last.pull === null")
    page.mouse.up()
    wait(page, "view.controls.enabled && last.ball.away_m < 0.003")
    page.evaluate("tell({ do: 'throw', velocity: [2, 0] }); undefined")
    wait(page, "document.getElementById('message').textContent.includes('the ball fell off')")
    wait(page, "last.ball && !last.ended")
    page.close()
    assert errors == []
    assert session.end() == 0


def test_commands_arrive_in_their_order_on_a_slow_line(page):
    page.evaluate(
        """() => {
          const sent = window.fetch;
          window.fetch = async (url, request) => {
            if (request?.body?.includes('"pull"')) await new Promise((after) => setTimeout(after, 500));
            return sent(url, request);
          };
        }"""
    )
    page.evaluate("tell({ do: 'pull', point: [0, 0, 0], place: [0.5, 0, 0.3] }); tell({ do: 'release' }); undefined")
    assert page.evaluate("waiting.length") == 1
    wait(page, "!sending && last.obeyed >= told")
    assert page.evaluate("last.pull") is None
    page.click("#reset")


@pytest.mark.parametrize("how", ["shift", "right button", "checkbox"])
def test_the_platform_is_turned_by_the_mouse(page, how):
    page.click("#reset")
    place, button = middle_of(page, "platform"), "right" if how == "right button" else "left"
    page.set_checked("#turns", how == "checkbox")
    if how == "shift":
        page.keyboard.down("Shift")
    page.mouse.move(*place)
    page.mouse.down(button=button)
    page.mouse.move(place[0] + 60, place[1], steps=5)
    # To the right: about the vertical of the picture.
    wait(page, "last.moment !== null && last.moment[2] > 0.01")
    assert page.evaluate("last.pull") is None
    wait(page, "document.getElementById('message').textContent.startsWith('turned with ')")
    page.mouse.up(button=button)
    if how == "shift":
        page.keyboard.up("Shift")
    wait(page, "last.moment === null && view.controls.enabled")
    page.set_checked("#turns", False)
    page.click("#reset")


def test_the_second_robot_is_in_the_plots(page):
    page.select_option("#ghost", "PID of each motor")
    wait(page, "traces.error.data[2].at(-1) > 0 && traces.angle.data[2].at(-1) >= 0", 60_000)
    wait(page, "document.querySelector('#traces .u-title').textContent.includes('(pale: ')")
    page.select_option("#ghost", "")
    wait(page, "traces.error.data[2].every((value) => value === null)")
    assert page.evaluate("last.ghost") == ""


def test_a_step_is_asked_for_and_its_figures_and_curves_are_shown(page):
    page.fill("#test-size", "2")
    page.click("#test-step")
    wait(
        page, "document.querySelector('.test .u-title')?.textContent.startsWith('change of Z; step of Z, 2 mm: rise ')"
    )
    assert page.inner_text("#test-result").startswith("rise ")


def test_keys_pause_move_and_reset_but_not_while_something_is_typed(page):
    page.keyboard.press(" ")
    wait(page, "last.paused")
    page.keyboard.press(" ")
    wait(page, "!last.paused")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Shift+ArrowUp")
    wait(page, "last.target[3] > about.home[3] + 0.001 && last.target[5] > about.home[5] + 0.001")
    page.focus("#test-size")
    before = page.evaluate("last.time")
    page.keyboard.press("r")
    page.keyboard.press("ArrowRight")
    page.evaluate("document.activeElement.blur()")
    wait(page, "!sending && last.obeyed >= told && last.target[3] > about.home[3] + 0.001")
    assert page.evaluate("last.time") >= before
    page.keyboard.press("r")
    wait(page, "Math.abs(last.target[3] - about.home[3]) < 1e-9 && last.time < 5")


@pytest.mark.parametrize("height", [720, 900])
def test_the_page_has_one_scrollbar_and_shows_what_ended_a_run(page, height):
    page.set_viewport_size({"width": 1280, "height": height})
    scrolls = """[...document.querySelectorAll('body *')].filter((each) =>
        ['auto', 'scroll'].includes(getComputedStyle(each).overflowY) && each.scrollHeight > each.clientHeight)"""
    assert page.evaluate(f"{scrolls}.length") == 0
    assert page.evaluate("document.documentElement.scrollWidth") <= 1280
    page.evaluate("tell({ do: 'push', wrench: [0, 0, 0, 5000, 0, 0], duration: 0.5 }); undefined")
    wait(page, "last.cause && !document.getElementById('cause').hidden")
    page.click("#reset")
    wait(page, "document.getElementById('cause').hidden")


def test_sliders_of_the_machine_and_of_the_model_are_independent(page):
    slide(page, "knob-command_delay", 1)
    wait(page, "last.knobs.find(({ key }) => key === 'command_delay').value === 1")
    assert page.evaluate("last.knobs.find(({ key }) => key === 'model.delay').value") == 0
    page.click("#reset")


def test_a_page_that_steers_a_machine_and_leaves_a_log(browser, tmp_path):
    session = Live("reachy_servos", "--machine", "sim:", folder=tmp_path)
    page, errors = opened(browser, session.url, width=390)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    assert page.inner_text("#name") == "reachy_servos on sim:"
    page.evaluate("scrollTo(0, document.body.scrollHeight)")
    assert page.locator("#stop").bounding_box()["y"] < 1000
    assert not page.is_visible("#pause")
    assert not page.is_visible("#payload")
    slide(page, "pose-yaw", 5)
    wait(page, "Math.abs(last.pose[2] - 5 * Math.PI / 180) < 0.01")
    # The wanted robot stands where the real one is, but for its errors.
    apart = "view.links[26].position.distanceTo(view.links[12].position)"
    wait(page, f"{apart} > 0 && {apart} < 0.005")
    page.click("#stop")
    wait(page, "last.ended === 'stopped'")
    assert session.process.wait(60) == 0
    session.process.stdout.close()
    log = load_log(tmp_path / "runs" / "reachy_servos")
    assert np.degrees(np.ptp(log["reference"][:, 2])) == pytest.approx(5.0, abs=0.1)
    wait(page, "document.getElementById('gone').textContent.startsWith('Ended: stopped. No connection')")
    assert errors == []
    page.close()
