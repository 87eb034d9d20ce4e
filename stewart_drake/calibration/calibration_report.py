"""What a calibration leaves in files: the robot, and a report with a table of all parameters."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator

import numpy as np

from stewart_drake.calibration.model import Frame
from stewart_drake.calibration.parameters import OF_LEG, OF_ROBOT, PER_LEG
from stewart_drake.calibration.pose_plan import PosePlan
from stewart_drake.calibration.result import COLUMNS, Calibration
from stewart_drake.files.yaml_files import to_yaml
from stewart_drake.mechanics.kinematics import roll_pitch_yaw
from stewart_drake.robot.leg import LEGS

NOISY = 2.0
"""[-] errors over the stated noise from which on the noise as stated, or the model, is doubtful."""


def robot_file(found: Calibration) -> str:
    """The calibrated robot as a file that goes for `robot:` in a scenario."""
    _, (position, rotation) = found.error_sizes()
    about = (
        f"calibrated from {len(found.measurements)} measured poses: "
        f"pose error {1e3 * position:.3g} mm, {1e3 * rotation:.3g} mrad (RMS)"
    )
    comments = "".join(f"# {line}\n" for line in _frame_lines(found))
    return f"{comments}{to_yaml({'about': about, **found.robot.to_dict()})}"


def parameter_table(found: Calibration) -> str:
    """`Calibration.rows` as CSV."""
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerows([COLUMNS, *found.rows()])
    return stream.getvalue()


def residual_table(found: Calibration) -> str:
    """Errors of each pose before and after as CSV, [rad, m]."""
    names = [*(f"turn_{axis}_rad" for axis in "xyz"), *(f"{axis}_m" for axis in "xyz")]
    stream = io.StringIO()
    table = csv.writer(stream, lineterminator="\n")
    table.writerow(["row", *(f"{when}_{name}" for when in ("before", "after") for name in names)])
    for row, errors in enumerate(np.concatenate([found.before, found.after], axis=-1).tolist()):
        table.writerow([row + 1, *errors])
    return stream.getvalue()


def summary(found: Calibration) -> list[tuple[str, str]]:
    """What was found, as rows of two texts."""
    before, after = (
        f"{1e3 * position:.3g} mm, {1e3 * rotation:.3g} mrad" for position, rotation in found.error_sizes()
    )
    ratio = f"{found.noise_ratio:.3g} times the stated noise"
    if found.noise_ratio > NOISY:
        ratio += ": the noise is larger than stated, or legs have play or bend; the intervals are widened by it"
    return [
        ("poses, numbers told", f"{len(found.measurements)}, {found.told}"),
        ("pose error before (RMS)", before),
        ("pose error after (RMS)", after),
        ("errors that are left", ratio),
        *(("cannot be told by any poses", line) for line in _conventions(found)),
        *(("not told by these poses", line) for line in found.untold),
    ]


def leg_table(found: Calibration) -> tuple[list[str], list[list[str]]]:
    """Header and rows: each leg's changes against the guess with their 95 % intervals, in mm and mrad."""
    names = [f"{own.name} {own.axis}".strip().replace("_", " ") for own in OF_LEG]
    header = ["", *(f"leg {leg}" for leg in range(LEGS))]
    change = 1e3 * found.change[:OF_ROBOT].reshape(LEGS, PER_LEG)
    width = 1e3 * found.half_width[:OF_ROBOT].reshape(LEGS, PER_LEG)
    rows = []
    for at, own in enumerate(OF_LEG):
        cells = [_cell(c, w) for c, w in zip(change[:, at].tolist(), width[:, at].tolist(), strict=True)]
        rows.append([f"{names[at]} [m{own.unit}]", *cells])
    return header, rows


def report(found: Calibration) -> str:
    """A page in Markdown."""
    header, rows = leg_table(found)
    lines = [f"| {' | '.join(row)} |" for row in (header, ["---"] * len(header), *rows)]
    return "\n".join(
        [
            f"# Calibration from {found.measurements.source}",
            "",
            *(f"- {name}: {text}" for name, text in summary(found)),
            *(f"- {line}" for line in _frame_lines(found)),
            "",
            "Changes against the guess, with 95 % intervals. The homing offset is reading minus true angle; the robot",
            "has it in its crank directions, so that its crank angles are the readings.",
            "",
            *lines,
            "",
            "![Errors of the poses and changes of the parameters](calibration.png)",
            "",
        ]
    )


def _cell(change: float, width: float) -> str:
    if width == 0.0:
        return "held"
    return f"{change:+.3f} ± {width:.2g}" if np.isfinite(width) else "not told"


def _conventions(found: Calibration) -> Iterator[str]:
    if "base" not in found.known_frames and "shaft_position" not in found.hold:
        yield "where B is (6 numbers): it was put where the shafts lie nearest to the guess's"
    if "platform" not in found.known_frames and "platform_joint" not in found.hold:
        yield "where P is (6 numbers): it was put where the platform's joints lie nearest to the guess's"


def _frame_lines(found: Calibration) -> Iterator[str]:
    offsets = ", ".join(f"{1e3 * offset:.3f}" for offset in found.homing_offsets)
    yield f"Crank angles are the encoders' readings. Homing offsets in them [mrad], legs 0 to 5: {offsets}"
    yield f"B in the tracker's frame, roll pitch yaw [rad] X Y Z [m]: {_pose(found.base)}"
    yield f"Marker in P, roll pitch yaw [rad] X Y Z [m]: {_pose(found.marker)}"


def _pose(frame: Frame) -> str:
    return " ".join(f"{x:.7g}" for x in (*roll_pitch_yaw(frame.turn), *frame.shift))


def plan_table(plan: PosePlan) -> tuple[list[str], list[list[str]]]:
    """Header and rows: what to expect of planned poses and of as many at random, in mm and mrad."""
    rows = []
    for at, own in enumerate(OF_LEG):
        widths = [
            1e3 * float(width[:OF_ROBOT].reshape(LEGS, PER_LEG)[:, at].max())
            for width in (plan.half_width, plan.random_half_width)
        ]
        name = f"{own.name} {own.axis}".strip().replace("_", " ")
        rows.append([f"{name} [m{own.unit}]", *(f"{width:.2g}" if width > 0.0 else "held" for width in widths)])
    return ["", "planned", "at random"], rows
