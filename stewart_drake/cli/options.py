"""The table of all commands, which are imported on first use, and their common options."""

from __future__ import annotations

import glob
import inspect
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple, TypedDict, cast

import click

from stewart_drake.cli.terminal import AS_JSON, QUIET, print_json

EXIT_DIFFERENT, EXIT_BAD_INPUT, EXIT_RUN_FAILED, EXIT_INTERNAL, EXIT_INTERRUPTED = 1, 2, 3, 4, 130
Settings = dict[str, Any]  # Keywords of a click.Option or click.Argument, and `flag`.


class About(NamedTuple):
    """Where a command is, and its help."""

    module: str  # X for `cli.X_commands`, or a module of the package.
    example: str  # Arguments.
    summary: str


_MOVES = "reachy.commands"
COMMANDS = {
    "run": About("run", "exact_fig7 --set duration=2", "Simulate a scenario"),
    "live": About("view", "exact_breathing", "Steer a robot in the browser, in real time"),
    "drive": About("machine", "reachy_nod --machine sim: --for 5", "Drive a real robot, or a simulated one"),
    "export": About("machine", "reachy_nod --c nod", "Write a controller as C99, for a microcontroller or C++"),
    "replay": About("view", "runs/exact_fig7 runs/exact_fig7-2", "Show runs side by side as one page"),
    "check": About("run", "paper_fig7 --retime", "Check a motion against every limit, without a run"),
    "moves": About(_MOVES, "check dances", "Check and fix moves and dances of Reachy Mini"),
    "moves check": About(_MOVES, "dances", "Check recorded moves against every limit of the head"),
    "moves fix": About(_MOVES, "dances", "Change moves, as little as possible, until they are feasible"),
    "moves export": About(_MOVES, "dance:simple_nod", "Write moves as the maker's JSON, also shaped for the servos"),
    "moves play": About(_MOVES, "simple_nod", "Play a dance or a recorded move, in simulation or on a machine"),
    "compare": About("study", "tracking --quick", "Compare controllers over motions and conditions"),
    "tune": About("study", "fair --quick", "Search the gains with the least cost for controllers"),
    "sweep": About("study", "initial_offset --runs 20", "Run a scenario many times with random values"),
    "faults": About("study", "--quick", "Inject every fault, and see how the safety layer reacts"),
    "reproduce": About("run", "--quick", "Test the claims of the paper"),
    "calibrate": About(
        "robot", "poses.csv --robot guess.yaml", "Estimate geometry, homing and servo gains from measured poses"
    ),
    "identify": About("robot", "runs/excite --robot guess.yaml", "Estimate masses, friction and payload from logs"),
    "excite": About("robot", "--robot guess.yaml", "Design an informative motion for `identify`"),
    "margins": About("run", "exact_breathing --poses 100", "Stability margins of the linearised loop"),
    "bode": About("run", "exact_breathing", "Frequency response of the linearised loop"),
    "step": About("run", "exact_breathing --axis Z --size 1mm", "Step response of the whole loop"),
    "workspace": About("run", "--scenario sway --samples 100000", "Compute a robot's workspace and its torques there"),
    "reach": About("reach", "reachy_mini --pose yaw=70,z=190", "Can a robot take a pose? And the nearest that it can"),
    "robots": About("robot", "", "List the robots of the package"),
    "robots show": About("robot", "reachy_mini", "Print a robot's parameters and derived values"),
    "robots from-table": About(
        "robot", "points.csv --unit mm --set crank_length=30", "Make a robot from joint positions"
    ),
    "robots from-urdf": About("robot", "platform.urdf", "Make a robot from a URDF file of yours"),
    "robots from-sdf": About("robot", "platform.sdf", "Make a robot from an SDF file of yours"),
    "robots from-mjcf": About("robot", "platform.xml", "Make a robot from an MJCF file of yours"),
    "write-sdf": About("robot", "mini.sdf --robot reachy_mini", "Write a robot as an SDF file, for Drake and others"),
    "write-mjcf": About("robot", "mini.xml --robot reachy_mini", "Write a robot as an MJCF file, for MuJoCo"),
    "collect": About("study", "", "Run the paper's nine experiments: the tuner's training data"),
    "train": About("study", "runs/dataset.parquet", "Train a tuner, the paper's or a policy"),
    "tuner": About("study", "show", "Show and assess tuners that change settings online"),
    "tuner show": About("study", "", "Print a policy: its settings, inputs and training"),
    "tuner judge": About("study", "runs/tuner.json", "Compare a policy with other tuners, in new situations"),
    "list": About("lookup", "scenarios", "List scenarios, controllers, comparisons, sweeps, robots and kinds"),
    "explain": About("lookup", "controller.period", "Explain a key: text, unit, default, allowed values"),
    "init": About("lookup", "mine.yaml", "Write a first scenario, with comments on its keys"),
    "doctor": About("lookup", "", "Check the installation and its speed"),
    "schema": About("lookup", "> schema.json", "Print the JSON schema of scenario files, for editors"),
    "completion": About("lookup", "bash", "Print a script for shell completion"),
}


TAKE_CONTROLLERS = ("check", "drive", "export", "live")  # Commands that also take a file of a controller alone.


def _quiet(context: click.Context, _: click.Parameter, given: bool) -> None:
    context.meta[QUIET] = given or context.meta.get(QUIET, False)


def _json(context: click.Context, _: click.Parameter, given: bool) -> None:
    if given and AS_JSON not in context.meta:
        context.meta[AS_JSON] = {}
        context.call_on_close(lambda: print_json(context.meta[AS_JSON]))


def _flag(name: str, callback: Callable[..., None], text: str) -> click.Option:
    return click.Option([name], is_flag=True, expose_value=False, callback=callback, help=text)


class Command(click.Command):
    """A command with the options `--quiet` and `--json`, and an example in its help."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.params.append(_flag("--quiet", _quiet, "No progress and no tables."))
        self.params.append(_flag("--json", _json, "Print the tables as JSON."))

    def format_usage(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        about = COMMANDS.get(" ".join(ctx.command_path.split()[1:]), About("", "run exact_fig7", ""))
        formatter.write(f"Example: {' '.join(f'{ctx.command_path} {about.example}'.split())}\n\n")
        super().format_usage(ctx, formatter)


class Group(Command, click.Group):
    """A group whose commands are imported when one is used."""

    def _known(self) -> dict[str, About]:
        first = "" if self.name == "cli" else f"{self.name} "
        names = {name.removeprefix(first): about for name, about in COMMANDS.items() if name.startswith(first)}
        return {name: about for name, about in names.items() if " " not in name}

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        return list(self._known())

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        known = self._known()
        # All for an unknown name: click suggests similar ones.
        for about in [known[cmd_name]] if cmd_name in known else known.values():
            place = about.module if "." in about.module else f"cli.{about.module}_commands"
            import_module(f"stewart_drake.{place}")
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

    Exit status: 0 done, 1 a number differs (reproduce), 2 bad input, 3 a run was stopped, lost or failed, or memory or
    workers were exhausted, 4 an internal error, 130 interrupted.
    """


PATH = click.Path(path_type=Path)
OUT_FILE, OUT_FOLDER = click.Path(dir_okay=False, path_type=Path), click.Path(file_okay=False, path_type=Path)


class Seconds(click.ParamType):
    """A number of seconds, at least `least`, also with a unit: `20s`, `15 ms`."""

    name = "seconds"

    def __init__(self, least: float | None = None) -> None:
        self.range = click.FloatRange(min=least)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        from stewart_drake.base.config import number_in

        with suppress(ValueError):
            return self.range.convert(float(value), param, ctx)
        number = number_in(param.opts[0] if param else self.name, value, "s")
        return self.range.convert(number, param, ctx)


SECONDS = Seconds()


def option(text: str, kind: click.ParamType | type | None = None, flag: str | None = None, **more: object) -> Settings:
    """An option with its help text, its type, and its flag if that is not the name."""
    return {"help": text, "type": kind, "flag": flag, **more}


def switch(text: str) -> Settings:
    """An option without a value."""
    return option(text, is_flag=True)


def _completed_from(kind: str) -> Settings:
    """Shell completion by the package's files of a kind; the shell completes paths."""

    def complete(ctx: click.Context, __: click.Parameter, begun: str) -> list[str]:
        from stewart_drake.base.yaml_files import shipped_folder

        kinds = (kind, "controllers") if ctx.info_name in TAKE_CONTROLLERS else (kind,)
        files = (path for name in kinds for path in shipped_folder(name).glob(f"{glob.escape(begun)}*.yaml"))
        return sorted({path.stem for path in files})

    return {"shell_complete": complete}


OPTIONS: dict[str, Settings] = {
    "about": option("One line on the robot.", default=""),
    "browser": option("Open the page in a browser.", flag="--browser/--no-browser", default=True),
    "budget": option("Evaluations per controller, in place of the file's generations.", click.IntRange(1)),
    "controllers": option("Controller to tune [default: all].", flag="--controller", multiple=True, metavar="NAME"),
    "cranks": option(
        "Direction of level cranks, if the table has none: outwards, towards the partner, away from it, tangential.",
        default="outwards",
    ),
    "encoder_bits": option("Encoder resolution, bits per turn.", click.IntRange(4, 40), default=17),
    "force": switch("Replace the results of another scenario in the folder."),
    "hold": option("Do not estimate these parameters.", multiple=True),
    "home": option(
        "Home: where cranks are level, or perpendicular to the rods (perpendicular), or its height.",
        default="level",
        metavar="[level|perpendicular|HEIGHT]",
    ),
    "keep_model": option("Start with the `model` in FILE, if it exists, and save the learnt one there.", OUT_FILE),
    "lag": option("Delay of the torques in a CSV file [s].", SECONDS, "--torque-lag", default=0.0),
    "out": option("Folder for results [default: runs/NAME].", PATH),
    "overrides": option("Change a key, e.g. --set {example}.", flag="--set", multiple=True, metavar="KEY=VALUE"),
    "picture": option("Write a picture of it at home: FILE.png.", OUT_FILE),
    "plan": option("Write the N most informative poses to measure; without POSES.", int, metavar="N"),
    "plots": switch("Also draw the signals over time: states.png, torques.png, learnt.png."),
    "poses": option("Number of random poses.", click.IntRange(1, 100_000), default=1000),
    "position_noise": option("Standard deviation of positions [m] [default: that of --with].", float),
    "quick": switch("Few and short runs, for a first look."),
    "report_folder": option("Folder for a report with tables and a plot.", OUT_FOLDER, "--report"),
    "restart": switch("Ignore the finished runs of an earlier call."),
    "retime": switch("If the motion is infeasible, find the highest feasible speed."),
    "robot": option("Name or YAML file; motions, loads and faults are scaled to it [default: the file's robot]."),
    "rotation_noise": option("Standard deviation of angles [rad] [default: that of --with].", float),
    "runs": option("Number of runs, in place of the file's.", click.IntRange(1)),
    "samples": option("Poses per workspace.", click.IntRange(1000, 10**7), default=10**6),
    "scale": switch("If the motion is infeasible, find the largest feasible size."),
    "scheduler": option("Run on a Dask cluster, e.g. tcp://host:8786.", metavar="ADDRESS"),
    "seed": option("Seed of everything random.", click.IntRange(0), default=0),
    "seeds": option("Situations per kind and robot.", click.IntRange(2), default=14),
    "trust_code": switch("Allow Python code named in files or by --set to run."),
    "unit": option("Unit of all lengths, in the table and after --set: m, mm, cm or in.", default="m"),
    "validate": option("A log for validation, which is not fitted.", PATH, multiple=True),
    "video": option("Also write a film of the run: FILE.gif, or FILE.mp4 (needs ffmpeg).", PATH),
    "workers": option("Processes [default: one per core, at most 8].", click.IntRange(1, 1024)),
}
"""Parameter of a command's function -> its option, unless the command gives another."""
ARGUMENTS = {name: _completed_from(f"{name}s") for name in ("scenario", "sweep", "comparison")}


class StudyOptions(TypedDict):
    """Options of all commands of many runs, in `**options` of their functions."""

    workers: int | None
    scheduler: str | None
    restart: bool


GUESS = option("First guess of the robot: a YAML file or a name.", required=True, metavar="GUESS")


def command(
    path: str,
    kind: type[click.Command] = Command,
    *,
    group: dict[str, object] | None = None,
    example: str = "duration=2",
    **settings: Settings | str,
) -> Callable[[Callable[..., None]], click.Command]:
    """Makes a function a command of `COMMANDS`; its docstring follows the summary in the help.

    Parameters are options of `OPTIONS`, or arguments. `settings` has changes for this command: an option, an argument's
    keywords, or a default; a default of `out` with an ending is a file. `example` is one of a change by `--set`.
    """
    *parent, name = path.split()
    parent_group = cast("Group", cli.commands[parent[0]] if parent else cli)

    def add(function: Callable[..., None]) -> click.Command:
        params: list[click.Parameter] = []
        for parameter in inspect.signature(function).parameters.values():
            for part in StudyOptions.__annotations__ if parameter.kind is parameter.VAR_KEYWORD else (parameter.name,):
                params.append(_parameter(part, str(parameter.annotation), settings.get(part), example))
        text = f"{COMMANDS[path].summary}.\n\n{inspect.cleandoc(function.__doc__ or '')}"
        return parent_group.command(name, cls=kind, help=text, params=params, **(group or {}))(function)

    return add


def _parameter(name: str, annotation: str, given: Settings | str | None, example: str) -> click.Parameter:
    """The argument or option for a parameter of a command's function."""
    changed = given if isinstance(given, dict) else {} if given is None else {"default": given}
    if name == "out" and isinstance(given, str):
        changed |= option("File to write.", OUT_FILE) if Path(given).suffix else option("Folder for results.", PATH)
    if name not in OPTIONS and "help" not in changed:
        several = annotation.startswith("tuple")
        is_optional = several or "default" in changed or "None" in annotation
        usual = {"type": PATH if "Path" in annotation else None, "required": not is_optional}
        return click.Argument([name], nargs=-1 if several else 1, **usual | ARGUMENTS.get(name, {}) | changed)
    settings = {**OPTIONS.get(name, {}), **changed}
    flag = settings.pop("flag", None) or f"--{name.replace('_', '-')}"
    settings["help"] = settings["help"].format(example=example)
    return click.Option([flag, name], **settings)
