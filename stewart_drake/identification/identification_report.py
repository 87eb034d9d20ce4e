"""What an identification leaves in files: the robot, its friction, and a report with a table of all parameters."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator

import numpy as np

from stewart_drake.files.yaml_files import to_yaml
from stewart_drake.identification.identified import COLUMNS, Identification
from stewart_drake.identification.parameters import GAIN, PARAMETERS


def robot_file(found: Identification) -> str:
    """The identified robot as a file that goes for `robot:` or `model_robot:` in a scenario."""
    about = f"identified from {found.logs} {'log' if found.logs == 1 else 'logs'}: " + "; ".join(_short(found))
    lines = [
        "Friction, for `plant.friction` of a scenario:",
        *friction_file(found).splitlines(),
        *_constant_lines(found),
    ]
    lines += ["Values with 95 % intervals:", *(f"  {name}: {text}" for name, _, text, _ in _table(found))]
    comments = "".join(f"# {line}\n" for line in lines)
    return f"{comments}{to_yaml({'about': about, **found.robot.to_dict()})}"


def friction_file(found: Identification) -> str:
    """Friction of the motors as a part of a scenario."""
    return to_yaml({"plant": {"friction": found.friction}})


def parameter_table(found: Identification) -> str:
    """`Identification.rows` as CSV."""
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerows([COLUMNS, *found.rows()])
    return stream.getvalue()


def summary(found: Identification) -> list[tuple[str, str]]:
    """What was found, as rows of two texts."""
    mass, place = found.payload
    at = f" at {' '.join(f'{1e3 * x:.1f}' for x in place)} mm in P" if np.isfinite(place).all() else ""
    corrected = np.abs(found.values - found.estimate.values).max() > 0.0
    return [
        ("instants, numbers told", f"{len(found.samples.time)}, {len(found.estimate.covariance)}"),
        ("rows in which a crank moves", f"{100.0 * found.samples.used.mean():.0f} %"),
        *(
            (
                f"torques off (RMS), {'fitted' if at < found.logs else 'not used'}: {each.source}",
                f"{100 * each.guess:.3g} % -> {100 * each.found:.3g} % where no crank sticks, "
                f"{100 * each.everywhere:.3g} % everywhere",
            )
            for at, each in enumerate(found.predictions)
        ),
        ("platform beyond the guess", f"{mass:+.4g} ± {found.half_width[0]:.2g} kg{at}"),
        ("bodies", "moved to the nearest that can be" if corrected else "as estimated: they can be"),
        *(("torque constants", line) for line in _constant_lines(found)),
        *(("not told, the guess's stays", line) for line in found.untold()),
    ]


def parameter_columns(found: Identification) -> tuple[list[str], list[list[str]]]:
    """Header and rows: guess, value and 95 % interval of each parameter, and what it means."""
    return ["", "guess", "value", "means"], [list(row) for row in _table(found)]


def report(found: Identification) -> str:
    """A page in Markdown."""
    header, rows = parameter_columns(found)
    lines = [f"| {' | '.join(row)} |" for row in (header, ["---"] * len(header), *rows)]
    return "\n".join(
        [
            f"# Identification from {found.samples.source}",
            "",
            *(f"- {name}: {text}" for name, text in summary(found)),
            "",
            "Values with 95 % intervals. Moments and inertias of the platform are about the origin of P. Where a value",
            "means a sum, the parameters after the first have the guess's values; the logs tell the sum alone.",
            "",
            *lines,
            "",
            "![Torques and what is left of them](identification.png)",
            "",
        ]
    )


def _short(found: Identification) -> Iterator[str]:
    for at, each in enumerate(found.predictions):
        kind = "its torques" if at < found.logs else "torques of a log not used"
        yield f"{kind} within {100 * each.found:.2g} %"


def _table(found: Identification) -> Iterator[tuple[str, str, str, str]]:
    """Name with unit, guess, value ± half width, meaning of each parameter; torque constants as factors."""
    for at, (row, own) in enumerate(zip(found.rows(), PARAMETERS, strict=True)):
        *_, guess, value, width, meaning = row
        if at >= GAIN.start:
            guess, value, width = np.exp(guess), np.exp(value), np.exp(value) * width
        sure = f"{value:.5g} ± {width:.2g}" if width > 0.0 else f"{value:.5g}, kept"
        unit = f" [{own.unit}]" if own.unit else ""
        yield f"{str(own).replace('_', ' ')}{unit}", f"{guess:.5g}", sure, "" if meaning == str(own) else meaning


def _constant_lines(found: Identification) -> list[str]:
    constants = ", ".join(f"{constant:.4f}" for constant in found.torque_constants)
    what = "of the torques in the logs" if "platform_mass" in found.held else "of their geometric mean, taken as 1"
    return [f"Motors 0 to 5 give {constants} {what}"]
