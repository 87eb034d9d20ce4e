"""Command `reach`: can a robot take a pose, and if not, which is the nearest that it can take."""

from __future__ import annotations

import json
import math
from contextlib import suppress
from pathlib import Path

import click
import numpy as np

from stewart_drake.analysis.reach import Nearest, Reach, checked_pose
from stewart_drake.base.config import number_in
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.tables import AXES, POSE, numbers_to_csv, read_numbers
from stewart_drake.base.yaml_files import find_file, read_mapping
from stewart_drake.cli import options as opt
from stewart_drake.cli.options import command
from stewart_drake.cli.terminal import print_line, print_table, progress_bar, shown_compiling
from stewart_drake.logs.signals import SCALES
from stewart_drake.robot.robot_files import robot_names
from stewart_drake.runs.outputs import check_ending, prepare_file, write_text
from stewart_drake.scenario.scenario import Scenario, load_driven, load_scenario

_MOST_BYTES, _MOST_ROWS = 100_000_000, 1_000_000
_RESULTS = (("possible", "1"), *POSE, ("distance", "m"), ("shift", "m"), ("turn", "rad"))

_INSIDE = 1e-4  # Share of the way back by which a printed pose is within the limits.


@command(
    "reach",
    name={"metavar": "ROBOT_OR_SCENARIO"},
    file={"required": False, "metavar": "[POSES.csv]"},
    pose=opt.option("Numbers of the pose in deg and mm; what is not given is that of home.", metavar="yaw=70,z=190"),
    from_pose=opt.option("Pose from which the robot moves, in the same form [default: home]."),
    seconds=opt.option("Time in which it must get there, by limits.crank_speed [default: any].", opt.SECONDS, "--in"),
    weight=opt.option("Length that a turn of 1 rad counts as [default: the robot's].", metavar="60mm"),
    out=opt.option("Table of the nearest poses, for POSES.csv.", opt.OUT_FILE),
    example="limits.clearance=0.001",
)
def reach(
    name: str,
    file: Path | None,
    pose: str | None,
    from_pose: str | None,
    seconds: float | None,
    weight: str | None,
    out: Path | None,
    overrides: tuple[str, ...],
    trust_code: bool,
) -> None:
    """Says whether the robot can take a pose, which limit decides, and the nearest pose that it can take.

    The distance is sqrt(shift^2 + (weight turn)^2). POSES.csv has one row per pose: pose_roll_deg, pose_pitch_deg,
    pose_yaw_deg, pose_x_mm, pose_y_mm, pose_z_mm (or _rad, _m).
    """
    if (file is None) == (pose is None) or (file is None) != (out is None):
        raise click.UsageError("give either --pose, or POSES.csv and --out")
    scenario = _scenario(name, overrides, trust_code)
    length = None if weight is None else _number("--weight", weight, "mm", "m")
    if seconds is not None and seconds <= 0.0:
        raise ConfigurationError("--in", seconds, "a number of seconds above 0")
    with shown_compiling():
        found = Reach(scenario.robot, scenario.limits, scenario.gravity_in_base, length)
    start = None if from_pose is None else _pose("--from-pose", scenario, from_pose)
    if file is None or out is None:
        target = _pose("--pose", scenario, str(pose))
        _print(name, found, target, start, seconds)
        return
    check_ending("--out", out, ".csv")
    prepare_file(out)
    poses = read_numbers(file, str(file), POSE, _MOST_BYTES, _MOST_ROWS)
    rows = []
    with progress_bar("reach", float(len(poses)), unit="poses") as advance:
        for n, row in enumerate(poses):
            nearest = found.nearest(checked_pose(f"{file}: row {n + 1}", row), start, seconds)
            rows.append([nearest.distance == 0.0, *nearest.pose, nearest.distance, nearest.shift, nearest.turn])
            advance(float(n + 1))
    write_text(out, numbers_to_csv(_RESULTS, np.reshape(rows, (-1, len(_RESULTS)))))
    print_line(f"{sum(bool(row[0]) for row in rows)} of {len(rows)} poses can be taken; the nearest in {out}")


def _print(title: str, found: Reach, target: np.ndarray, start: np.ndarray | None, seconds: float | None) -> None:
    check, nearest = found.check(target), found.nearest(target, start, seconds)
    shown = SCALES * nearest.pose
    # A little inside, so that the rounded numbers are within the limits.
    inside = np.round(shown + _INSIDE * (SCALES * (found.robot.home_pose if start is None else start) - shown), 3)
    if nearest.distance > 0.0 and found.nearest(inside / SCALES, start, seconds).distance == 0.0:
        shown = inside
    in_time = check.possible and nearest.distance > 0.0
    answer = "no" if nearest.distance > 0.0 else "yes"
    reason = "not from there, within the time or on the way that was found" if in_time else check.reason
    distance = f"{1e3 * nearest.shift:.3g} mm, {math.degrees(nearest.turn):.3g} deg"
    rows = [
        ("can take it", answer),
        ("why", reason),
        ("nearest [deg, mm]", "  ".join(f"{round(value, 7) + 0.0:.9g}" for value in shown)),
        ("away by", f"{distance}; {1e3 * nearest.distance:.3g} mm with 1 rad as {1e3 * found.weight:.3g} mm"),
    ]
    # The pose may be within the limits, but no way to it.
    limit = check.margin.limit if answer == "yes" or check.margin.margin < 0.0 else None
    print_table(f"{title}: reach", rows, numbers=(), data=_plain(answer == "yes", reason, limit, nearest))


def _plain(possible: bool, reason: str, limit: str | None, nearest: Nearest) -> dict[str, object]:
    data: dict[str, object] = {"possible": possible, "reason": reason, "limit": limit}
    return data | {
        "nearest_pose": nearest.pose.tolist(),
        "distance_m": nearest.distance,
        "shift_m": nearest.shift,
        "turn_rad": nearest.turn,
    }


def _scenario(name: str, overrides: tuple[str, ...], trust_code: bool) -> Scenario:
    """A scenario or controller by its name or file; for a robot a scenario with it."""
    is_robot = name in robot_names()
    if not is_robot:
        try:
            file = next((place for kind in ("scenario", "controller") if (place := _found(kind, name))), None)
            keys = set(read_mapping("scenario", file or find_file("scenario", name), 100))
        except ConfigurationError as error:
            allowed = (
                f"a robot ({', '.join(robot_names())}), a scenario, a controller, or a file of one; {error.allowed}"
            )
            raise ConfigurationError("ROBOT_OR_SCENARIO", name, allowed) from None
        is_robot = not keys & (set(Scenario.__pydantic_fields__) - {"name"})
    if not is_robot:
        return load_driven(name, overrides, trust_code)
    return load_scenario("hold", (f"robot={json.dumps(name)}", *overrides), trust_code)


def _found(kind: str, name: str) -> Path | None:
    with suppress(ConfigurationError):
        return find_file(kind, name)
    return None


def _number(key: str, text: str, usual: str, unit: str) -> float:
    """A number [unit] of a text, in the usual unit where it has none."""
    is_plain = text.replace("e", "").replace("E", "").strip("0123456789.+-") == ""
    return number_in(key, f"{text} {usual}" if is_plain else text, unit)


def _pose(option: str, scenario: Scenario, text: str) -> np.ndarray:
    """A pose from pairs such as `yaw=70,z=190`, in deg and mm or with a unit."""
    pose, seen = scenario.robot.home_pose.copy(), set[str]()
    for pair in text.split(","):
        name, _, value = (part.strip() for part in pair.partition("="))
        if name.lower() not in AXES or not value:
            raise ConfigurationError(option, pair.strip(), f"pairs such as yaw=70,z=190, of {', '.join(AXES)}")
        if name.lower() in seen:
            raise ConfigurationError(option, text, f"{name} once")
        seen.add(name.lower())
        axis = AXES.index(name.lower())
        pose[axis] = _number(f"{option} {name}", value, *(("deg", "rad") if axis < 3 else ("mm", "m")))
        if axis == 5 and 0.0 < abs(pose[axis]) < 0.001 and value[-1] in "0123456789.":
            raise ConfigurationError(
                f"{option} {name}", f"{value} mm", f"a height of 1 mm or more; {value}m for metres"
            )
    return checked_pose(option, pose)
