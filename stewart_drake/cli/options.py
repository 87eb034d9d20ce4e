"""The table of all commands, which load on first use, and the options that several of them share."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from inspect import cleandoc
from pathlib import Path
from typing import Any, NamedTuple

import click

from stewart_drake.cli.terminal import AS_JSON, QUIET, print_json

EXIT_DIFFERENT, EXIT_BAD_INPUT, EXIT_RUN_FAILED, EXIT_INTERNAL, EXIT_INTERRUPTED = 1, 2, 3, 4, 130


class About(NamedTuple):
    """Where a command stands, the arguments of an example, and what it does, in a line."""

    module: str
    example: str
    summary: str


COMMANDS = {
    "run": About("run", "exact_fig7 --set duration=2", "Simulate a scenario"),
    "live": About("view", "exact_breathing", "Steer a robot in the browser, in real time"),
    "replay": About("view", "runs/exact_fig7 runs/exact_fig7-2", "Show runs side by side as one page"),
    "check": About("run", "paper_fig7 --retime", "Check a motion against every limit, without a run"),
    "compare": About("study", "tracking --quick", "Compare controllers over motions and conditions"),
    "tune": About("study", "fair --quick", "Search the gains with the least cost for each controller"),
    "sweep": About("study", "initial_offset --runs 20", "Run a scenario many times with random values"),
    "faults": About("study", "--quick", "Inject every fault, and see how the safety layer reacts"),
    "reproduce": About("run", "--quick", "Test the paper claim by claim"),
    "calibrate": About("robot", "poses.csv --robot guess.yaml", "Estimate geometry and homing from measured poses"),
    "identify": About("robot", "runs/excite --robot guess.yaml", "Estimate masses, friction and payload from logs"),
    "excite": About("robot", "--robot guess.yaml", "Design a motion from which `identify` learns most"),
    "margins": About("run", "exact_breathing --poses 100", "Stability margins of the linearised loop"),
    "workspace": About("run", "--scenario sway --samples 100000", "Compute where a robot can go, and with what torque"),
    "robots": About("robot", "", "List the robots that a scenario can name"),
    "robots show": About("robot", "reachy_mini", "Print a robot's parameters, and what follows from them"),
    "robots table": About("robot", "paper desk.yaml", "Compare robots in workspace, tracking and torque"),
    "robots from-table": About(
        "robot", "points.csv --unit mm --set crank_length=30", "Make a robot from joint positions"
    ),
    "write-sdf": About("robot", "mini.sdf --robot reachy_mini", "Write a robot as an SDF file, for Drake and others"),
    "write-mjcf": About("robot", "mini.xml --robot reachy_mini", "Write a robot as an MJCF file, for MuJoCo"),
    "collect": About("study", "", "Run the paper's nine experiments: the tuner's training data"),
    "train": About("study", "runs/dataset.parquet", "Train a tuner, the paper's or a policy"),
    "tuner": About("study", "show", "Show and assess tuners that change settings online"),
    "tuner show": About("study", "", "Print a policy: its settings, inputs and training"),
    "tuner judge": About("study", "runs/tuner.json", "Compare a policy with other tuners, in new situations"),
    "list": About("lookup", "scenarios", "List scenarios, comparisons, sweeps, robots and kinds"),
    "explain": About("lookup", "controller.period", "Explain a key: what it does, unit, default, allowed values"),
    "init": About("lookup", "mine.yaml", "Write a first scenario, with a comment on each key"),
    "doctor": About("lookup", "", "Check the installation and its speed"),
    "schema": About("lookup", "> schema.json", "Print the JSON schema of scenario files, for editors"),
    "completion": About("lookup", "bash", "Print a script for shell completion"),
}


def _quiet(context: click.Context, _: click.Parameter, given: bool) -> None:
    context.meta[QUIET] = given or context.meta.get(QUIET, False)


def _json(context: click.Context, _: click.Parameter, given: bool) -> None:
    if given and AS_JSON not in context.meta:
        context.meta[AS_JSON] = {}
        context.call_on_close(lambda: print_json(context.meta[AS_JSON]))


def _trust(context: click.Context, _: click.Parameter, given: bool) -> None:
    from stewart_drake.files.code import trusting_code

    context.with_resource(trusting_code(given))


def _flag(name: str, callback: Callable[..., None], words: str) -> click.Option:
    return click.Option([name], is_flag=True, expose_value=False, callback=callback, help=words)


class Command(click.Command):
    """A command whose help begins with an example and its summary from `COMMANDS`, and which may be quiet."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.params.append(_flag("--quiet", _quiet, "No progress and no tables."))
        self.params.append(_flag("--json", _json, "Print the tables as JSON."))

    def format_usage(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        about = COMMANDS.get(" ".join(ctx.command_path.split()[1:]), About("", "run exact_fig7", ""))
        formatter.write(f"Example: {' '.join(f'{ctx.command_path} {about.example}'.split())}\n\n")
        super().format_usage(ctx, formatter)


class Group(Command, click.Group):
    """A group whose commands load when one of them is asked for."""

    def _known(self) -> dict[str, About]:
        first = "" if self.name == "cli" else f"{self.name} "
        names = {name.removeprefix(first): about for name, about in COMMANDS.items() if name.startswith(first)}
        return {name: about for name, about in names.items() if " " not in name}

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        return list(self._known())

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        known = self._known()
        # For a name that is not there, all: click says which one is close to it.
        for about in [known[cmd_name]] if cmd_name in known else known.values():
            import_module(f"stewart_drake.cli.{about.module}_commands")
        return super().get_command(ctx, cmd_name)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        with formatter.section("Commands"):
            formatter.write_dl([(name, about.summary) for name, about in self._known().items()])


def _print_version(context: click.Context, _: click.Parameter, wanted: bool) -> None:
    if wanted:
        from stewart_drake import __version__

        click.echo(f"stewart-drake {__version__}")
        context.exit()


@click.group(
    cls=Group,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 120, "show_default": True},
)
@click.option("--version", is_flag=True, expose_value=False, callback=_print_version, help="Show the version.")
@click.option("--debug", is_flag=True, expose_value=False, help="Show tracebacks; anywhere on the line.")
def cli() -> None:
    """Closed-loop torque control of rotary Stewart platforms in Drake.

    Exit status: 0 done, 1 a number differs (reproduce), 2 bad input, 3 a run was stopped, lost or failed, or no memory
    or workers are left, 4 an internal error, 130 interrupted.
    """


def command(name: str, kind: type[click.Command] = Command, **options: Any) -> Callable[[Callable[..., None]], Any]:
    """Makes a function the command of this name in `COMMANDS`; its docstring says what the summary there does not."""
    *parent, own = name.split()
    group: Any = cli.commands[parent[0]] if parent else cli

    def add(function: Callable[..., None]) -> Any:
        text = f"{COMMANDS[name].summary}.\n\n{cleandoc(function.__doc__ or '')}"
        return group.command(own, cls=kind, help=text, **options)(function)

    return add


PATH = click.Path(path_type=Path)
OUT_FILE, OUT_FOLDER = click.Path(dir_okay=False, path_type=Path), click.Path(file_okay=False, path_type=Path)
guess_option = click.option(
    "--robot", required=True, metavar="GUESS", help="First guess of the robot: a YAML file or a name."
)


def out_folder(default: str | None = None) -> Callable[[Any], Any]:
    words = "" if default else " [default: runs/NAME]"
    return click.option("--out", type=PATH, default=default, help=f"Folder for results{words}.")


def out_file(default: str) -> Callable[[Any], Any]:
    return click.option("--out", type=OUT_FILE, default=default, help="File to write.")


def trust_flag(function: Any) -> Any:
    words = "Allow Python code named in files or by --set to run."
    if any(each.name == "trust_code" for each in getattr(function, "__click_params__", ())):
        return function
    return click.option("--trust-code", is_flag=True, expose_value=False, callback=_trust, help=words)(function)


def names(kind: str) -> Callable[[click.Context, click.Parameter, str], list[str]]:
    """For a shell to complete: files of a kind that the package has; the shell's own are paths."""

    def complete(_: click.Context, __: click.Parameter, begun: str) -> list[str]:
        from stewart_drake.files.yaml_files import shipped_folder

        return [path.stem for path in shipped_folder(kind).glob("*.yaml") if path.stem.startswith(begun)]

    return complete


SCENARIO: Any = {"shell_complete": names("scenarios")}


def overrides(example: str = "duration=2") -> Callable[[Any], Any]:
    changes = click.option(
        "--set", "overrides", multiple=True, metavar="KEY=VALUE", help=f"Change a key, e.g. --set {example}."
    )
    return lambda function: changes(trust_flag(function))
