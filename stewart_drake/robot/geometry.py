"""A robot's geometry: checks of its home pose, and parameters from a table of measured positions.

Messages name the leg, the number and the likely mistake: millimetres, a mirrored axis, swapped joints.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from stewart_drake.base.atomic_files import Document, read_checked
from stewart_drake.base.config import check_value
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.tables import no_header
from stewart_drake.robot.leg import (
    DIRECTION_TOLERANCE,
    LARGEST_SIZE,
    LEG_COUNT,
    Signed,
    Signed3,
    Size,
    crank_angles,
    crank_equation,
)

if TYPE_CHECKING:
    from stewart_drake.robot.robot_parameters import RobotParameters

_SLACK = 1e-6  # [rad] Tolerance of the order of joints, for joints that coincide.


def check_geometry(robot: RobotParameters) -> None:
    """Refuses directions that are not perpendicular, joints out of order, and a home pose that is not reachable."""
    for leg, parameters in enumerate(robot.legs or ()):
        quarter = parameters.crank_quarter_direction or (0.0, 0.0, 1.0)
        if abs(np.dot(robot.crank_zero_directions[leg], quarter)) > DIRECTION_TOLERANCE:
            allowed = "a direction perpendicular to crank_zero_direction"
            raise ConfigurationError(f"robot.legs.{leg}.crank_quarter_direction", quarter, allowed)
    check_order(robot.shaft_positions, robot.joints_in_platform)
    _check_home(robot)


def check_order(shafts: np.ndarray, joints: np.ndarray) -> None:
    """Refuses platform joints (6, 3) that are not in the order of the shafts (6, 3) around z."""
    x, y = np.moveaxis(np.stack([shafts, joints]) - np.stack([shafts, joints]).mean(axis=1, keepdims=True), -1, 0)[:2]
    around = np.arctan2(y, x)
    order = np.argsort(around[0], kind="stable")
    following = np.roll(order, -1)
    steps = wrapped(around[:, following] - around[:, order])
    wrong = (steps[0] > _SLACK) & (steps[1] < -_SLACK)
    if wrong.sum() >= LEG_COUNT - 1:
        allowed = "joints in the same order around z as the shafts; the order is reversed: is an axis of P mirrored?"
        raise ConfigurationError("robot.legs.0.platform_joint", joints[0].tolist(), allowed)
    if wrong.any():
        one, other = sorted((int(order[wrong][0]), int(following[wrong][0])))
        allowed = f"a joint [m] that is not beyond leg {other}'s; are the joints of legs {one} and {other} swapped?"
        raise ConfigurationError(f"robot.legs.{one}.platform_joint", joints[one].tolist(), allowed)


def _check_home(robot: RobotParameters) -> None:
    """Refuses a robot whose legs do not close at home, or only beyond their stops: it has no SDF."""
    span = robot.joints_in_platform + [0.0, 0.0, robot.home_height] - robot.shaft_positions
    directions = robot.crank_zero_directions, robot.crank_quarter_directions
    along, up, constant = crank_equation(span, *directions, robot.crank_lengths, robot.rod_lengths)
    size = np.hypot(along, up)
    margin = 1.0 - np.divide(np.abs(constant), size, out=np.full(LEG_COUNT, np.inf), where=size > 0.0)
    if not margin.min() > 0.0:
        leg = int(margin.argmin())
        allowed = (
            f"a height at which leg {leg} can be assembled: its joint is {np.linalg.norm(span[leg]):.4g} m from its "
            f"shaft, its crank {robot.crank_lengths[leg]:g} m and its rod {robot.rod_lengths[leg]:g} m long "
            f"(margin {margin[leg]:.3g}); are all lengths in metres?"
        )
        raise ConfigurationError("robot.home_height", robot.home_height, allowed)
    theta = crank_angles(along, up, constant, robot.branches)
    low, high = np.clip(robot.crank_angle_ranges, -LARGEST_SIZE, LARGEST_SIZE).T
    beyond = np.abs(wrapped(theta - 0.5 * (low + high))) > 0.5 * (high - low)
    if beyond.any():
        leg = int(beyond.argmax())
        allowed = f"a range that contains the angle at home, {theta[leg]:.4g} rad"
        raise ConfigurationError(f"robot.legs.{leg}.crank_angle_range", (float(low[leg]), float(high[leg])), allowed)


def wrapped(angle: np.ndarray) -> np.ndarray:
    """Angles within half a turn of zero."""
    return np.asarray(np.remainder(angle + math.pi, 2.0 * math.pi) - math.pi)


# --- from a table ---

UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "in": 0.0254}  # [m] Units of a table.
Unit = Literal["m", "mm", "cm", "in"]
Cranks = Literal["outwards", "towards", "away", "tangential"]
_POSITIONS = ("shaft_x", "shaft_y", "shaft_z", "joint_x", "joint_y", "joint_z")
_GROUPS = (("crank_x", "crank_y", "crank_z"), ("up_x", "up_y", "up_z"), ("low", "high"))
_OTHERS = (*(name for group in _GROUPS for name in group), "crank_length", "rod_length", "branch", "pair")
_POLAR = {
    ("shaft_radius", "shaft_deg"): ("shaft_x", "shaft_y"),
    ("joint_radius", "joint_deg"): ("joint_x", "joint_y"),
    ("crank_deg",): ("crank_x", "crank_y", "crank_z"),
}
"""Columns in polar coordinates about z -> the columns that they replace."""
_PAIR_RATIO = 1.5  # [-] Least distance of a shaft to the other shafts, over that to its partner, for clear pairs.
_SIDE = 0.05  # [-] Least sine of the angle between a partner and the centre.
LEVEL_SPREAD = 0.01  # [-] Largest difference of the heights at which cranks are level, over the rod's length.
_ALL_LENGTHS = ("crank_length", "rod_length", "home_height", "link_radius", "characteristic_length")
_LENGTHS: dict[str, object] = {
    **dict.fromkeys(_ALL_LENGTHS, Size),
    "home_height": Signed,
    "platform_center_of_mass": Signed3,
}
_CHECKED = _LENGTHS | dict.fromkeys(("platform_mass", "rod_mass", "crank_mass"), Size)
_MAX_BYTES = 1_000_000
_LINK_RADIUS = 0.005 / 0.11  # [-] Over the characteristic length, as in the paper's robot.


class FromTable(NamedTuple):
    """Result of `from_table`."""

    parameters: Document  # Of `RobotParameters`.
    pairs: tuple[tuple[int, int], ...]  # Legs of paired motors; empty if pairs are not needed.
    warning: str  # A likely mistake; empty if none.


def from_table(table: str | Path | ArrayLike, unit: Unit, cranks: Cranks, parameters: Document) -> FromTable:
    """Parameters of a robot from a table of its legs.

    Columns of a CSV file, by name, in any order: shaft_x to shaft_z (in B) and joint_x to joint_z (in P), in place of x
    and y also shaft_radius and shaft_deg, joint_radius and joint_deg. Optional: crank_x to crank_z (where the crank
    points at theta = 0) or crank_deg, its angle seen from above, and up_x to up_z (at pi/2), crank_length, rod_length,
    branch, pair (one number for the two motors of a pair), and low and high [rad], its stops. Lines that begin with #
    are comments.

    Missing parameters: at `home_height` the cranks are level on average; the branch of a leg is the one with the crank
    nearer to level there; `characteristic_length` is the joints' mean distance from the axis of P; links are as slender
    as the paper's; inertias are those of uniform bars and of a disc.

    Raises:
        ConfigurationError: Too few rows, columns or numbers; an unknown choice; cranks that point to or from a partner,
            where pairs are not clear; a leg that cannot be level.
    """
    check_value("unit", unit, Unit)
    check_value("cranks", cranks, Cranks)
    for name in parameters.keys() & _CHECKED.keys():
        check_value(f"robot.{name}", parameters[name], _CHECKED[name])
    scale = UNITS[unit]
    chosen = {name: scale * np.array(value) if name in _LENGTHS else value for name, value in parameters.items()}
    columns = _columns(table)
    # Removes rounding errors of millimetres in metres.
    shafts, joints = (np.round(scale * _vectors(columns, end), 12) for end in ("shaft", "joint"))
    # Before the lengths, because with a mirrored axis rods seem too short.
    check_order(shafts, joints)
    lengths: dict[str, np.ndarray] = {}
    for name in ("crank_length", "rod_length"):
        if name not in columns and name not in chosen:
            raise ConfigurationError(f"table: {name}", None, f"a column {name}, or {name} for all legs")
        column = np.full(LEG_COUNT, chosen[name]) if name not in columns else np.round(scale * columns[name], 12)
        lengths[name] = column
    pairs = () if "crank_x" in columns or cranks == "outwards" else _pairs(columns, shafts)
    zero, up = _directions(columns, shafts, cranks, pairs)
    rods, height = lengths["rod_length"], chosen.get("home_height")
    levels = _levels(
        shafts + lengths["crank_length"][:, None] * zero, joints, rods, height is None, float(height or 0.0) < 0.0
    )
    height = float(levels.mean() if height is None else height)
    span = joints + [0.0, 0.0, height] - shafts
    of_legs = {
        "shaft_position": shafts,
        "platform_joint": joints,
        "crank_zero_direction": zero,
        "crank_quarter_direction": up,
        "branch": (columns["branch"] if "branch" in columns else _branches(span, zero, up, lengths)).astype(int),
        **lengths,
    }
    if "low" in columns:
        of_legs["crank_angle_range"] = np.stack([columns["low"], columns["high"]], axis=-1)
    size = float(np.hypot(joints[:, 0], joints[:, 1]).mean())
    known = {
        "legs": [{name: values[leg].tolist() for name, values in of_legs.items()} for leg in range(LEG_COUNT)],
        "home_height": height,
        "characteristic_length": size,
        "link_radius": _LINK_RADIUS * size,
        **{name: float(values.mean()) for name, values in lengths.items()},
        **chosen,
    }
    return FromTable(_inertias(known) | known, pairs, _spread(levels, rods))


def _vectors(columns: Mapping[str, np.ndarray], name: str) -> np.ndarray:
    return np.stack([columns[f"{name}_{axis}"] for axis in "xyz"], axis=-1)


def _columns(table: str | Path | ArrayLike) -> dict[str, np.ndarray]:
    """Columns (6,) of a table by name."""
    rows: ArrayLike = [] if isinstance(table, Path) else table
    names: Sequence[str] = _POSITIONS if np.shape(rows)[1:] != (len(_POSITIONS) + 1,) else (*_POSITIONS, "pair")
    key = "table"
    if isinstance(table, (str, Path)):
        key = f"table {table}"
        text = read_checked(table, key, _MAX_BYTES).decode("utf-8-sig", "replace")
        lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
        names, *rows = [[cell.strip() for cell in row] for row in csv.reader(lines)] or [[]]
        _check_header(f"{key}: header", names)
    allowed = f"{LEG_COUNT} rows, one per leg, of {', '.join(names)}"
    try:
        values = np.asarray(rows, dtype=float)
    except (TypeError, ValueError) as error:
        raise ConfigurationError(key, str(error), allowed) from None
    if values.shape != (LEG_COUNT, len(names)):
        raise ConfigurationError(key, values.shape, allowed)
    if (wrong := ~(np.abs(values) <= LARGEST_SIZE)).any():
        leg, column = np.argwhere(wrong)[0]
        allowed = f"a number within {LARGEST_SIZE:g}"
        raise ConfigurationError(f"{key}: {names[column]} of leg {leg}", float(values[leg, column]), allowed)
    columns = dict(zip(names, values.T, strict=True))
    for polar, plain in _POLAR.items():
        if polar[-1] in columns:
            *radius, angle = (columns.pop(name) for name in polar)
            x, y = math.prod(radius) * np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
            columns |= dict(zip(plain, (x, y, 0.0 * x), strict=False))
    numbers = columns.pop("leg", np.arange(LEG_COUNT))
    if (np.diff(numbers) != 1.0).any() or numbers[0] not in (0.0, 1.0):
        allowed = "0 to 5, or 1 to 6, in this order: the first row is leg 0"
        raise ConfigurationError("table: leg", numbers.tolist(), allowed)
    return columns


def _check_header(key: str, given: Sequence[str]) -> None:
    names = list(given)
    for polar, plain in _POLAR.items():
        if set(polar) <= set(names):
            names = [name for name in names if name not in polar] + [*plain]
    groups = [group for group in _GROUPS if set(group) & set(names)]
    missing = [name for group in (_POSITIONS, *groups) for name in group if name not in names]
    strange = [name for name in names if name not in (*_POSITIONS, *_OTHERS, "leg") or names.count(name) > 1]
    if missing or strange:
        wrong = f"without {', '.join(missing)}" if missing else f"with {', '.join(dict.fromkeys(strange))}"
        allowed = f"each once: {', '.join(_POSITIONS)}, and optionally, in groups, {', '.join(_OTHERS)}, leg; "
        allowed += no_header(given) or "shaft_radius, shaft_deg, joint_radius, joint_deg, crank_deg are read too"
        raise ConfigurationError(key, wrong, allowed)


def _pairs(columns: Mapping[str, np.ndarray], shafts: np.ndarray) -> tuple[tuple[int, int], ...]:
    """Legs of paired motors: with one number in the column `pair`, or clearly next to each other."""
    if "pair" in columns:
        pairs = [tuple(np.flatnonzero(columns["pair"] == number).tolist()) for number in np.unique(columns["pair"])]
        if {len(legs) for legs in pairs} != {2}:
            allowed = "three numbers, each for the two legs of a pair, such as 0, 0, 1, 1, 2, 2"
            raise ConfigurationError("table: pair", columns["pair"].tolist(), allowed)
        return tuple(sorted((one, other) for one, other in pairs))
    apart = np.linalg.norm(shafts[:, None] - shafts, axis=-1) + np.diag(np.full(LEG_COUNT, np.inf))
    (near, far), (partner, other) = np.sort(apart)[:, :2].T, apart.argsort(kind="stable")[:, :2].T
    clear = (far >= _PAIR_RATIO * near) & (partner[partner] == np.arange(LEG_COUNT))
    if not clear.all():
        leg = int(clear.argmin())
        got = f"none; shaft {partner[leg]} is {near[leg]:.4g} m from shaft {leg}, shaft {other[leg]} {far[leg]:.4g} m"
        allowed = "a column pair with one number for the two motors of a pair, such as 0, 0, 1, 1, 2, 2"
        hint = f"which shaft is the partner of shaft {leg}: {partner[leg]} or {other[leg]}?"
        raise ConfigurationError("table: pair", got, f"{allowed}; {hint}")
    return tuple((leg, int(partner[leg])) for leg in range(LEG_COUNT) if leg < partner[leg])


def _directions(
    columns: Mapping[str, np.ndarray], shafts: np.ndarray, cranks: Cranks, pairs: Sequence[tuple[int, int]]
) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors (6, 3) along the cranks at theta = 0 and pi/2."""
    outwards, partners = shafts * [1.0, 1.0, 0.0], np.arange(LEG_COUNT)
    for one, other in pairs:
        partners[[one, other]] = other, one
    towards = (shafts[partners] - shafts) * [1.0, 1.0, 0.0]
    if "crank_x" in columns:
        zero = _vectors(columns, "crank")
    elif cranks == "outwards":
        zero = outwards
    elif cranks == "tangential":
        across = np.cross([0.0, 0.0, 1.0], outwards)
        side = np.sum(across * towards, axis=-1, keepdims=True)
        sizes = np.linalg.norm(across, axis=-1, keepdims=True) * np.linalg.norm(towards, axis=-1, keepdims=True)
        # A partner directly opposite is on neither side.
        zero = -np.where(np.abs(side) > _SIDE * sizes, np.sign(side), 0.0) * across
    else:
        zero = towards if cranks == "towards" else -towards
    zero = _unit(zero, "crank", "a direction: crank_x to crank_z, or crank_deg")
    up = _vectors(columns, "up") if "up_x" in columns else np.eye(3)[[2] * LEG_COUNT]
    across = up - np.sum(up * zero, axis=-1, keepdims=True) * zero
    return zero, _unit(across, "up", "a direction not along the crank: up_x to up_z")


def _unit(vectors: np.ndarray, name: str, allowed: str) -> np.ndarray:
    size = np.linalg.norm(vectors, axis=-1, keepdims=True)
    if size.min() < 1e-9:
        raise ConfigurationError(f"table: {name} of leg {int(size.argmin())}", "no direction", allowed)
    return np.asarray(vectors / size)


def _levels(tips: np.ndarray, joints: np.ndarray, rods: np.ndarray, needed: bool, below: bool) -> np.ndarray:
    """Heights (6,) [m] of P at which the legs' cranks are at theta = 0, maybe below them.

    NaN where a rod is too short, if that is not needed.
    """
    across = np.linalg.norm((joints - tips)[:, :2], axis=-1)
    if needed and (rods <= across).any():
        leg = int((rods - across).argmin())
        allowed = f"more than {across[leg]:.4g} m from level crank to joint of leg {leg}, or a home_height"
        hint = "; are the positions in millimetres? set unit to mm" if across[leg] > 100.0 * rods[leg] else ""
        raise ConfigurationError(f"table: rod_length of leg {leg}", float(rods[leg]), allowed + hint)
    with np.errstate(invalid="ignore"):
        return np.asarray(tips[:, 2] - joints[:, 2] + (-1.0 if below else 1.0) * np.sqrt(rods**2 - across**2))


def _spread(levels: np.ndarray, rods: np.ndarray) -> str:
    """Warning if the cranks are level at very different heights (6,) [m]; else empty."""
    if not np.ptp(levels) > LEVEL_SPREAD * rods.min():
        return ""
    leg = int(np.abs(levels - np.median(levels)).argmax())
    others, mm = np.delete(levels, leg), 1e3 * levels
    if np.ptp(others) > LEVEL_SPREAD * rods.min():
        low, high = int(mm.argmin()), int(mm.argmax())
        return f"the crank of leg {low} is level at {mm[low]:.4g} mm, of leg {high} at {mm[high]:.4g}: is this meant?"
    among = f"the others at {1e3 * others.min():.4g} to {1e3 * others.max():.4g}"
    return f"the crank of leg {leg} is level at {mm[leg]:.4g} mm, {among}: is it mirrored?"


def _branches(span: np.ndarray, zero: np.ndarray, up: np.ndarray, lengths: Mapping[str, np.ndarray]) -> np.ndarray:
    """Branches (6,), -1 or 1, of which the crank is nearer to theta = 0 at home."""
    along, across, constant = crank_equation(span, zero, up, lengths["crank_length"], lengths["rod_length"])
    size = np.maximum(np.hypot(along, across), np.finfo(float).tiny)
    middle, spread = np.arctan2(across, along), np.arccos(np.clip(constant / size, -1.0, 1.0))
    return np.where(np.abs(wrapped(middle - spread)) <= np.abs(wrapped(middle + spread)), -1, 1)


def _inertias(known: Document) -> Document:
    """Inertias [kg m^2] of uniform bars and of a disc, for the known masses."""
    values: Document = {}
    radius, size = known["link_radius"], known["characteristic_length"]
    for name, along in (("rod", 2), ("crank", 0)):
        if f"{name}_mass" in known:
            mass, length = known[f"{name}_mass"], known[f"{name}_length"]
            moments = [mass * (length**2 / 12.0 + radius**2 / 4.0)] * 3
            moments[along] = mass * radius**2 / 2.0
            values[f"{name}_inertia"] = tuple(moments)
    if "platform_mass" in known:
        moment = known["platform_mass"] * size**2 / 4.0
        values["platform_inertia"] = (moment, moment, 2.0 * moment)
    return values
