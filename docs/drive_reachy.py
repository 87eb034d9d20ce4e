"""Drives the daemon of Reachy Mini's maker; writes docs/results/drive.md and its picture: `make drive`, three minutes.

The daemon is the maker's own, unchanged, in its simulation; docs/reachy_daemon.py installs and starts it.
"""

import socket
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from reachy_daemon import start

from stewart_drake import SimulationLog, run_metrics
from stewart_drake.base.markdown import markdown_table
from stewart_drake.machines.machine import MachineError, open_machine
from stewart_drake.mechanics.kinematics import inverse_kinematics
from stewart_drake.plotting.style import save_figure, styled
from stewart_drake.runs.drive import Drive, connected
from stewart_drake.scenario.scenario import Scenario, load_driven

ROOT = Path(__file__).parents[1]
OUT, FOLDER = ROOT / "docs" / "results", ROOT / "build" / "reachy_daemon"
SCHEMES: Mapping[str, Mapping[str, Any]] = {
    "angles of the inverse kinematics": {
        "controller.feedforward": "none",
        "model.friction": None,
        "model.motors": {"kind": "position", "preset": "perfect_actuator", "damping": 0.0},
    },
    "exact model, ball joints believed free": {"model.friction.joints": None},
    "exact model": {},
}
ENDS = "angles of the inverse kinematics", "exact model"
LOOK = {
    "kind": "minimum_jerk",
    "poses": [
        *([0, 0, 0, 0, 0, 0.177], [0, 0, 0.5, 0, 0, 0.177], [0, -0.2, -0.4, 0, 0, 0.182]),
        *([0, 0.25, -0.3, 0, 0, 0.177], [0.25, 0, 0.2, 0, 0.005, 0.177], [0, 0, 0, 0, 0, 0.177]),
    ],
    "durations": [0.8, 1.0, 0.7, 0.9, 0.7],
    "dwell": [0.2, 0.3, 0.3, 0.3, 0.3],
}
MOTIONS: Mapping[str, tuple[float, Mapping[str, Any]]] = {
    "nod": (8.0, {}),
    "look around": (6.0, {"reference": LOOK}),
    "breathing": (
        20.0,
        {"reference": {"kind": "sine", "amplitude": [0, 0, 0, 0, 0, 0.005], "angular_frequency": "0.1 Hz"}},
    ),
}
FREE = {"bounds": {"rotation": None, "position": None, "motion_ratio": None, "error_ratio": None}}


def rise(scenario: Scenario, url: str) -> None:
    """To home: the simulated head begins asleep, 50 mm low, and the daemon takes some seconds to answer."""
    machine, ends = open_machine(url, scenario), time.monotonic() + 60.0
    while True:
        try:
            machine.connect()
            break
        except MachineError:
            if time.monotonic() > ends:
                raise
            time.sleep(0.5)
    for _ in range(150):
        machine.read()
        machine.command(inverse_kinematics(scenario.belief.robot, scenario.belief.robot.home_pose))
    machine.disconnect()


@contextmanager
def daemon(folder: Path) -> Iterator[str]:
    """The URL of a daemon whose head is at home; it is installed in a folder, if it is not there yet."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    process = start(folder, port)
    try:
        rise(load_driven("reachy_daemon"), f"reachy://127.0.0.1:{port}")
        yield f"reachy://127.0.0.1:{port}"
    finally:
        process.terminate()
        process.wait()


def driven(url: str, scheme: str, motion: str) -> SimulationLog:
    """One of the page."""
    seconds, more = MOTIONS[motion]
    scenario = load_driven("reachy_daemon").replace({**FREE, **SCHEMES[scheme], **more})
    machine = open_machine(url, scenario)
    log = Drive(scenario, machine, connected(scenario, machine, seconds)).run()
    if log.status != "completed":
        raise RuntimeError(f"{scheme}, {motion}: {log.message}")
    return log


@styled
def draw(logs: Mapping[tuple[str, str], SimulationLog]) -> Figure:
    """The pitch of two nods."""
    figure = Figure((7.5, 3.4), layout="constrained")
    axis = figure.subplots()
    plain, exact = logs["angles of the inverse kinematics", "nod"], logs["exact model", "nod"]
    shown = (exact.time > 4.0) & (exact.time < 6.5)
    axis.plot(exact.time[shown], np.degrees(exact["reference"][shown, 1]), color="0.75", lw=6, label="wanted")
    for log, color, label in (
        (plain, "#d55e00", "angles of the inverse kinematics"),
        (exact, "#0072b2", "exact model"),
    ):
        shown = (log.time > 4.0) & (log.time < 6.5)
        axis.plot(log.time[shown], np.degrees(log["pose"][shown, 1]), color=color, label=label)
    axis.set(xlabel="time [s]", ylabel="pitch [deg]", title="A nod through the maker's daemon")
    figure.legend(loc="outside lower center", ncols=3)
    return figure


TEXT = """# Through the maker's own daemon

`stewart-drake drive` against the daemon of `reachy_mini` 1.12.0, unchanged, in its own MuJoCo simulation, through its
web socket: 50 Hz, in step with its ticks. The head's pose is the one that the daemon tells. RMS errors over the second
half, lag included; ripple is the error of the velocity above 2 Hz.

{table}

![Pitch of a nod over time](drive.png)

**Angles of the inverse kinematics** is what its owners send. **Exact model** is `drive reachy_daemon`: nothing is
learnt; the numbers are those of the maker's MJCF, where the ball joints of the rods have a motor's friction. A real
head hardly has such joints, and its motors have other numbers: see [Reachy Mini](reachy.md) for those. The file has the
dry friction of a ball joint about three axes, which for the head and one of the rods are not those of the model.

The daemon's clock is no wall clock: it stalls, here for {age:.0f} ms at most. `drive` counts its ticks and stays in
step.

Made by `make drive`, with the daemon that it installs under build/, 400 MB.
`make results` recomputes some of these numbers.
"""


def main() -> None:
    """Starts the daemon, drives, and writes the page."""
    with daemon(FOLDER) as url:
        logs = {(scheme, motion): driven(url, scheme, motion) for scheme in SCHEMES for motion in MOTIONS}
    lines = []
    for scheme in SCHEMES:
        figures = {motion: run_metrics(logs[scheme, motion]) for motion in MOTIONS}
        fast = [figures[motion] for motion in ("nod", "look around")]
        cells = [f"{each['rmse_norm_deg']:.2f} / {each['rmse_norm_mm']:.2f}" for each in fast]
        cells += [f"{figures['nod']['ripple_mm_s']:.1f}", f"{figures['breathing']['rmse_norm_mm']:.3f}"]
        lines.append((scheme, *cells, f"{figures['breathing']['ripple_mm_s']:.2f}"))
    header = (
        *("", "nod [deg], [mm]", "look around [deg], [mm]", "ripple of the nod [mm/s]", "breathing [mm]"),
        "its ripple [mm/s]",
    )
    save_figure(draw(logs), OUT / "drive.png")
    age = 1e3 * max(float(log["reading_age"].max()) for log in logs.values())
    (OUT / "drive.md").write_text(TEXT.format(table=markdown_table(header, lines), age=age), encoding="utf-8")


if __name__ == "__main__":
    main()
