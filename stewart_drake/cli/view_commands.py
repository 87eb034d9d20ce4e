"""Commands that show the robot in a browser: `live` and `replay`."""

from __future__ import annotations

import webbrowser
from contextlib import suppress
from pathlib import Path

import click

from stewart_drake.base.errors import ConfigurationError, RunFailure
from stewart_drake.cli import options as opt
from stewart_drake.cli.options import command
from stewart_drake.cli.run_commands import write_results
from stewart_drake.cli.terminal import print_line, shown_compiling
from stewart_drake.logs.log import load_log
from stewart_drake.scenario.scenario import Scenario, load_driven, load_scenario


@command(
    "live",
    scenario="sway",
    port=opt.option("Port of the page [default: the first free one from 8000 on].", click.IntRange(1, 65535)),
    machine=opt.option("Steer a real machine, with an address as for `drive`; it moves."),
    example="plant.payload_mass=0.2",
)
def live(
    scenario: str,
    machine: str | None,
    port: int | None,
    overrides: tuple[str, ...],
    browser: bool,
    trust_code: bool,
) -> None:
    """SCENARIO is a file or a shipped name [default: sway].

    Pull or turn the platform with the mouse, move it with sliders, change gains, model and robot, break a motor,
    command a step, compare with a second controller. Only this computer can open the page. Ctrl-C ends it.

    With --machine the sliders steer a real robot, with the checks of `drive`, and the page shows it and its desired
    pose, in a pale colour. The motion of SCENARIO, which may be recorded, is played as often as you switch it on. The
    last ten minutes are logged as by `drive`.
    """
    if machine is not None:
        _steer(load_driven(scenario, overrides, trust_code), machine, port, browser, trust_code)
        return
    from stewart_drake.live.start import start_live

    loaded, engine = load_scenario(scenario, overrides, trust_code), ""
    if loaded.plant.in_diagram and not any(text.startswith("plant") for text in overrides):
        # Scenarios with features that only Drake's plant has keep it.
        with suppress(ConfigurationError):
            loaded = loaded.replace({"plant.kind": "closed_form"})
            engine = "simulated by the closed form, by Drake with --set plant=drake; "
    with shown_compiling():
        session, server = start_live(loaded, port)
    try:
        click.echo(f"{loaded.name} is live at {server.url} ({engine}Ctrl-C ends it)")
        if browser:
            webbrowser.open(server.url)
        session.run()
    except KeyboardInterrupt:
        click.echo()
    finally:
        server.close()


def _steer(loaded: Scenario, url: str, port: int | None, browser: bool, trust_code: bool) -> None:
    from stewart_drake.live.start import start_machine
    from stewart_drake.machines.machine import open_machine
    from stewart_drake.runs.checks import check_scenario
    from stewart_drake.runs.drive import connected
    from stewart_drake.runs.outputs import new_run_folder

    if (address := getattr(loaded.reference, "udp", None)) is not None:
        allowed = "null: here the page steers the machine; `drive` follows a stream"
        raise ConfigurationError("reference.udp", address, allowed)
    machine = open_machine(url, loaded, trust_code)
    try:
        with shown_compiling():
            check_scenario(loaded)
            session, server = start_machine(loaded, machine, connected(loaded, machine), url, port)
        try:
            click.echo(f"{loaded.name} on {url} is live at {server.url} (Ctrl-C stops it)")
            if browser:
                webbrowser.open(server.url)
            why = session.run()
        finally:
            server.close()
    finally:
        machine.disconnect()
    log = session.log(why)
    with new_run_folder(log.scenario, duration=False) as claimed:
        place = write_results(log, claimed, machine=url)
    print_line(f"to play what it did: --set 'reference={{kind: recorded, motion_file: {place / 'log.parquet'}}}'")
    if isinstance(why, RunFailure):
        raise why


@command("replay", logs={"required": True}, out="runs/replay.html")
def replay(logs: tuple[Path, ...], out: Path, browser: bool) -> None:
    """LOGS are results folders of `run`, or log files."""
    from stewart_drake.runs.outputs import prepare_file
    from stewart_drake.runs.replay import write_replay

    shown = [load_log(log) for log in logs]
    for path, log in zip(logs, shown, strict=True):
        if log.reason == "cut_off":
            print_line(f"{path}: {log.message}")
    prepare_file(out)
    write_replay(shown, out, logs)
    print_line(f"page in {out}")
    if browser:
        webbrowser.open(out.absolute().as_uri())
