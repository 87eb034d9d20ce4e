"""The command `live`: parse, call, print."""

from __future__ import annotations

import webbrowser

import click

from stewart_drake.cli.common_options import overrides, trust_flag


@click.command()
@click.argument("scenario", default="exact_fig7")
@overrides("plant.payload_mass=0.2")
@trust_flag
@click.option("--browser/--no-browser", default=True, help="Open the page.", show_default=True)
def live(scenario: str, overrides: tuple[str, ...], browser: bool) -> None:
    """Steer SCENARIO in the browser, in real time.

    Sliders for the platform, pushes, a payload, a dead motor, a frozen encoder, another controller; traces of error and
    torque. The page is served to this machine alone. Ctrl-C ends it.
    """
    from stewart_drake.live.start import start_live
    from stewart_drake.scenario import load_scenario

    session, server = start_live(load_scenario(scenario, overrides))
    click.echo(f"{scenario} is live at {server.url} - Ctrl-C ends it")
    if browser:
        webbrowser.open(server.url)
    try:
        session.run()
    except KeyboardInterrupt:
        click.echo("\nended")
    finally:
        server.close()
