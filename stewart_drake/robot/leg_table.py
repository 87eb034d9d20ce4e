"""A robot from a table of measured positions, a row per leg."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from stewart_drake.base.atomic_files import Document, read_checked
from stewart_drake.base.config import check_value, did_you_mean
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.tables import no_header
from stewart_drake.robot.geometry import check_order, wrapped
from stewart_drake.robot.leg import LARGEST_SIZE, LEG_COUNT, MOST, Signed, Signed3, Size, crank_equation
from stewart_drake.robot.symmetry import doubts, turned_legs

UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "in": 0.0254}  # [m] Units of a table.
Unit = Literal["m", "mm", "cm", "in"]
Cranks = Literal["outwards", "towards", "away", "tangential"]
Home = Literal["level", "perpendicular"]
_POSITIONS = ("shaft_x", "shaft_y", "shaft_z", "joint_x", "joint_y", "joint_z")
_GROUPS = (("crank_x", "crank_y", "crank_z"), ("up_x", "up_y", "up_z"), ("low", "high"))
_OTHERS = (*(name for group in _GROUPS for name in group), "crank_length", "rod_length", "branch", "pair")
_POLAR = {
    ("shaft_radius", "shaft_deg"): ("shaft_x", "shaft_y"),
    ("joint_radius", "joint_deg"): ("joint_x", "joint_y"),
    ("crank_deg",): ("crank_x", "crank_y", "crank_z"),
}
"""Columns in polar coordinates about z -> the columns that they replace. Angles may also be in rad, as crank_rad."""
_PAIR_RATIO = 1.5  # [-] Least distance of a shaft to the other shafts, over that to its partner, for clear pairs.
_SIDE = 0.05  # [-] Least sine of the angle between a partner and the centre.
_LARGE = 3.0  # [m] of most points from the origin, for which the unit is doubtful.
_DOUBLED = 1e-3  # [-] Least distance of two shafts, over that from z.
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
    outwards: bool  # Whether cranks point outwards because no column has their directions.
    warning: str  # A likely mistake; empty if none.


def from_table(
    table: str | Path | ArrayLike | Mapping[str, np.ndarray],
    unit: Unit,
    cranks: Cranks,
    parameters: Document,
    home: Home = "level",
) -> FromTable:
    """Parameters of a robot from a table of its legs.

    Columns of a CSV file, by name, in any order: shaft_x to shaft_z (in B) and joint_x to joint_z (in P), in place of x
    and y also shaft_radius and shaft_deg, joint_radius and joint_deg. Optional: crank_x to crank_z (where the crank
    points at theta = 0) or crank_deg, its angle seen from above, and up_x to up_z (at pi/2), crank_length, rod_length,
    branch, pair (one number for the two motors of a pair), and low and high [rad], its stops. Lines that begin with #
    are comments. In place of _deg also _rad. A mapping has the columns (6,).

    Missing parameters: at `home_height` the cranks are level on average, or with `home` perpendicular to the rods; the
    branch of a leg is the one with the crank nearer to level there; `characteristic_length` is the joints' mean
    distance from the axis of P; links are as slender as the paper's; inertias are those of uniform bars and of a disc.

    Raises:
        ConfigurationError: Too few rows, columns or numbers; an unknown choice; cranks that point to or from a partner,
            where pairs are not clear; a leg that cannot be level.
    """
    check_value("unit", unit, Unit)
    check_value("cranks", cranks, Cranks)
    check_value("home", home, Home)
    for name in parameters.keys() & _CHECKED.keys():
        check_value(f"robot.{name}", parameters[name], _CHECKED[name])
    scale = UNITS[unit]
    chosen = {name: scale * np.array(value) if name in _LENGTHS else value for name, value in parameters.items()}
    columns = _columns(table, scale)
    # Removes rounding errors of millimetres in metres.
    shafts, joints = (np.round(scale * _vectors(columns, end), 12) for end in ("shaft", "joint"))
    # Before the lengths, because with a mirrored axis rods seem too short.
    _check_points(shafts, joints)
    lengths: dict[str, np.ndarray] = {}
    for name in ("crank_length", "rod_length"):
        if name not in columns and name not in chosen:
            raise ConfigurationError(f"table: {name}", None, f"a column {name}, or {name} for all legs")
        column = np.full(LEG_COUNT, chosen[name]) if name not in columns else np.round(scale * columns[name], 12)
        lengths[name] = column
    pairs = () if "crank_x" in columns or cranks == "outwards" else _pairs(columns, shafts)
    zero, up = _directions(columns, shafts, cranks, pairs)
    doubted = [*doubts(shafts, joints, {"crank": zero, **lengths}), *_far_pairs(shafts, pairs)]
    height = chosen.get("home_height")
    with _explained(doubted):
        heights, levels = _home_heights(shafts, joints, zero, lengths, home, None if height is None else float(height))
    points = {"shaft_position": shafts, "platform_joint": joints}
    directions = {"crank_zero_direction": zero, "crank_quarter_direction": up}
    known = {"home_height": float(heights.mean()), **chosen}
    known = _parameters(points | directions | lengths, columns, known) | known
    # A wrong point is no mirrored crank.
    level = [] if doubted and not doubted[0].startswith("the crank ") else _spread(levels, lengths["rod_length"])
    outwards = cranks == "outwards" and "crank_x" not in columns
    return FromTable(_inertias(known) | known, pairs, outwards, "; ".join([*level, *doubted]))


def _parameters(of_legs: dict[str, np.ndarray], columns: Mapping[str, np.ndarray], known: Document) -> Document:
    """Legs and sizes of a robot with a known home."""
    shafts, joints, zero, up, *lengths = of_legs.values()
    span = joints + [0.0, 0.0, known["home_height"]] - shafts
    of_legs["branch"] = (columns["branch"] if "branch" in columns else _branches(span, zero, up, *lengths)).astype(int)
    if "low" in columns:
        of_legs["crank_angle_range"] = np.stack([columns["low"], columns["high"]], axis=-1)
    size = float(np.hypot(joints[:, 0], joints[:, 1]).mean())
    return {
        "legs": [{name: values[leg].tolist() for name, values in of_legs.items()} for leg in range(LEG_COUNT)],
        "characteristic_length": size,
        "link_radius": _LINK_RADIUS * size,
        **{name: float(of_legs[name].mean()) for name in ("crank_length", "rod_length")},
    }


@contextmanager
def _explained(doubted: Sequence[str]) -> Iterator[None]:
    """Adds what is doubtful to the message of an error."""
    try:
        yield
    except ConfigurationError as error:
        allowed, *hint = error.allowed.split("; ", 1)
        raise ConfigurationError(error.key, error.value, "; ".join([allowed, *doubted, *hint])) from None


def _check_points(shafts: np.ndarray, joints: np.ndarray) -> None:
    """Refuses points that are far away, doubled or out of order."""
    for end, points in (("shaft", shafts), ("joint", joints)):
        far = np.abs(points).max(axis=-1)
        leg = int(far.argmax())
        if far[leg] > MOST:
            of_others = f"of the others within {np.delete(far, leg).max():.4g} m: is the decimal point right?"
            allowed = f"a position within {MOST:g} m; {'is the unit mm?' if np.median(far) > _LARGE else of_others}"
            raise ConfigurationError(f"table: {end} of leg {leg}", points[leg].tolist(), allowed)
    apart = np.linalg.norm(shafts[:, None] - shafts, axis=-1) + np.diag(np.full(LEG_COUNT, np.inf))
    one, other = np.unravel_index(int(apart.argmin()), apart.shape)
    with _explained(doubts(shafts, joints)):
        if not apart[one, other] > _DOUBLED * np.linalg.norm(shafts[:, :2], axis=-1).max():
            allowed = f"another position than that of leg {one}; one row twice, or a wrong sign?"
            raise ConfigurationError(f"table: shaft of leg {other}", shafts[other].tolist(), allowed)
        check_order(shafts, joints)


def _far_pairs(shafts: np.ndarray, pairs: Sequence[tuple[int, int]]) -> list[str]:
    """A doubt about pairs of shafts that are clearly further apart than from other shafts."""
    for leg, partner in pairs:
        apart = np.linalg.norm(shafts - shafts[leg], axis=-1)
        apart[leg] = np.inf
        near = int(apart.argmin())
        if apart[partner] > _PAIR_RATIO * apart[near]:
            mm = f"{1e3 * apart[partner]:.4g} mm from leg {leg}, leg {near} {1e3 * apart[near]:.4g}"
            return [f"the partner of leg {leg} is leg {partner}, {mm}: is the column pair right?"]
    return []


def _vectors(columns: Mapping[str, np.ndarray], name: str) -> np.ndarray:
    return np.stack([columns[f"{name}_{axis}"] for axis in "xyz"], axis=-1)


def _columns(table: str | Path | ArrayLike | Mapping[str, np.ndarray], scale: float) -> dict[str, np.ndarray]:
    """Columns (6,) of a table by name."""
    if isinstance(table, Mapping):
        return dict(table)
    rows: ArrayLike = [] if isinstance(table, Path) else table
    names: Sequence[str] = _POSITIONS if np.shape(rows)[1:] != (len(_POSITIONS) + 1,) else (*_POSITIONS, "pair")
    key = "table"
    if isinstance(table, (str, Path)):
        key = f"table {table}"
        text = read_checked(table, key, _MAX_BYTES).decode("utf-8-sig", "replace")
        lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
        names, *rows = [[cell.strip() for cell in row] for row in csv.reader(lines, skipinitialspace=True)] or [[]]
        _check_header(f"{key}: header", names)
        rows = [_numbers(key, row, names, cells) for row, cells in enumerate(rows)]
    allowed = f"{LEG_COUNT} rows, one per leg, of {', '.join(names)}"
    try:
        values = np.asarray(rows, dtype=float)
    except (TypeError, ValueError) as error:
        raise ConfigurationError(key, str(error), allowed) from None
    if values.shape[1:] != (len(names),):
        raise ConfigurationError(key, values.shape, allowed)
    if len(values) == LEG_COUNT and (wrong := ~(np.abs(values) <= LARGEST_SIZE)).any():
        leg, column = np.argwhere(wrong)[0]
        allowed = f"a number within {LARGEST_SIZE:g}"
        raise ConfigurationError(f"{key}: {names[column]} of leg {leg}", float(values[leg, column]), allowed)
    columns = _cartesian(dict(zip(names, values.T, strict=True)))
    if len(values) != LEG_COUNT:
        raise ConfigurationError(key, values.shape, allowed + _missing(columns, scale))
    numbers = columns.pop("leg", np.arange(LEG_COUNT))
    if (np.diff(numbers) != 1.0).any() or numbers[0] not in (0.0, 1.0):
        allowed = "0 to 5, or 1 to 6, in this order: the first row is leg 0"
        raise ConfigurationError("table: leg", numbers.tolist(), allowed)
    return columns


def _numbers(key: str, row: int, names: Sequence[str], cells: Sequence[str]) -> list[float]:
    """Numbers of a row of a CSV file; names row and column of what is none."""
    if len(cells) != len(names):
        hint = "; a decimal comma? numbers need a decimal point" if len(cells) > len(names) else ""
        raise ConfigurationError(f"{key}: row {row + 1}", f"{len(cells)} cells", f"{len(names)} cells{hint}")
    values = []
    for name, cell in zip(names, cells, strict=True):
        try:
            values.append(float(cell))
        except ValueError:
            hint = "; a decimal comma? numbers need a decimal point" if "," in cell else ""
            place = f"{key}: row {row + 1}, {name}"
            raise ConfigurationError(place, cell, f"a number{hint}" if cell else "a number in every cell") from None
        if name in ("low", "high") and 2.0 * math.pi + 0.01 < abs(values[-1]) <= LARGEST_SIZE:
            allowed = f"an angle [rad] within a turn; {cell} deg are {math.radians(values[-1]):.4g} rad"
            raise ConfigurationError(f"{key}: row {row + 1}, {name}", values[-1], allowed)
    return values


def _cartesian(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The columns with x, y, z in place of polar coordinates."""
    turn = 2.0 * math.pi + 0.01
    for (*radius, in_deg), plain in _POLAR.items():
        in_rad = f"{in_deg.removesuffix('deg')}rad"
        for name, other in ((in_deg, in_rad), (in_rad, in_deg)):
            if name not in columns:
                continue
            angle = columns.pop(name)
            leg = int(np.abs(angle).argmax())
            if (name == in_deg) == (abs(angle[leg]) <= turn):
                allowed = f"an angle in {name[-3:]}; in {other[-3:]} the column is {other}"
                raise ConfigurationError(f"table: {name} of leg {leg}", float(angle[leg]), allowed)
            around = np.radians(angle) if name == in_deg else angle
            x, y = math.prod(columns.pop(one) for one in radius) * np.array([np.cos(around), np.sin(around)])
            columns |= dict(zip(plain, (x, y, 0.0 * x), strict=False))
    return columns


def _missing(columns: Mapping[str, np.ndarray], scale: float) -> str:
    """Which row is missing, if there are five: by the numbers of the legs, or by the pattern of the others."""
    legs = {end: scale * _vectors(columns, end) for end in ("shaft", "joint")}
    numbers = columns.get("leg", np.arange(len(legs["shaft"])))
    gaps = np.flatnonzero(np.diff(numbers) > 1.0)
    if len(gaps):
        return f"; leg {numbers[gaps[0]] + 1.0:g} is missing"
    if len(numbers) == LEG_COUNT - 1:
        for _, right in turned_legs(legs):
            x, y = 1e3 * right["shaft"][:2] + 0.0
            return f"; by the pattern of the others the leg with its shaft at x, y = {x:.4g}, {y:.4g} mm is missing"
    return ""


def _check_header(key: str, given: Sequence[str]) -> None:
    angles = [polar[-1] for polar in _POLAR]
    names = [f"{name[:-3]}deg" if name.endswith("_rad") and f"{name[:-3]}deg" in angles else name for name in given]
    for polar, plain in _POLAR.items():
        if set(polar) <= set(names):
            names = [name for name in names if name not in polar] + [*plain]
    groups = [group for group in _GROUPS if set(group) & set(names)]
    missing = [name for group in (_POSITIONS, *groups) for name in group if name not in names]
    strange = [name for name in names if name not in (*_POSITIONS, *_OTHERS, "leg") or names.count(name) > 1]
    if any(";" in name for name in given):
        allowed = "commas between columns, and a decimal point in numbers; save it as CSV with commas"
        raise ConfigurationError(key, "semicolons", allowed)
    if missing or strange:
        wrong = f"without {', '.join(missing)}" if missing else f"with {', '.join(dict.fromkeys(strange))}"
        allowed = f"each once: {', '.join(_POSITIONS)}, and optionally, in groups, {', '.join(_OTHERS)}, leg; "
        polar_columns = "shaft_radius, shaft_deg, joint_radius, joint_deg, crank_deg (of the level crank, from above)"
        guess = did_you_mean(strange[0], (*angles, *_POSITIONS, *_OTHERS)).lstrip("; ") if strange else ""
        hints = [no_header(given) or f"{polar_columns} are read too, and _rad for _deg", guess]
        raise ConfigurationError(key, wrong, allowed + "; ".join(filter(None, hints)))


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


def _home_heights(
    shafts: np.ndarray,
    joints: np.ndarray,
    zero: np.ndarray,
    lengths: Mapping[str, np.ndarray],
    home: Home,
    height: float | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Heights (6,) [m] of P at home by leg, and where the cranks are at theta = 0; NaN where there is none.

    A known `height` may be negative, below the base.
    """
    needed, side = height is None, -1.0 if height is not None and height < 0.0 else 1.0
    crank, rod = lengths["crank_length"], lengths["rod_length"]
    level = shafts + crank[:, None] * zero, rod, "level crank"
    # A rod perpendicular to its crank: the shaft is sqrt(rod^2 + crank^2) from the joint.
    upright = shafts, np.hypot(rod, crank), "shaft"
    result = []
    for place, (points, reach, name) in {"level": level, "perpendicular": upright}.items():
        across = np.linalg.norm((joints - points)[:, :2], axis=-1)
        if needed and place == home and (reach <= across).any():
            leg = int((reach - across).argmin())
            allowed = f"more than {across[leg]:.4g} m from {name} to joint of leg {leg}, or a home_height"
            raise ConfigurationError(f"table: rod_length of leg {leg}", float(rod[leg]), allowed)
        with np.errstate(invalid="ignore"):
            result.append(points[:, 2] - joints[:, 2] + side * np.sqrt(reach**2 - across**2))
    return result[home == "perpendicular"], result[0]


def _spread(levels: np.ndarray, rods: np.ndarray) -> list[str]:
    """Doubt if the cranks are level at very different heights (6,) [m]; else empty."""
    if not np.ptp(levels) > LEVEL_SPREAD * rods.min():
        return []
    leg = int(np.abs(levels - np.median(levels)).argmax())
    others, mm = np.delete(levels, leg), 1e3 * levels
    if np.ptp(others) > LEVEL_SPREAD * rods.min():
        low, high = int(mm.argmin()), int(mm.argmax())
        at = f"the crank of leg {low} is level at {mm[low]:.4g} mm, of leg {high} at {mm[high]:.4g}"
        return [f"{at}: is this meant? if not, the crank of one is wrong, or angles are from another axis"]
    among = f"the others at {1e3 * others.min():.4g} to {1e3 * others.max():.4g}"
    return [f"the crank of leg {leg} is level at {mm[leg]:.4g} mm, {among}: is it mirrored, or a point of it wrong?"]


def _branches(span: np.ndarray, zero: np.ndarray, up: np.ndarray, crank: np.ndarray, rod: np.ndarray) -> np.ndarray:
    """Branches (6,), -1 or 1, of which the crank is nearer to theta = 0 at home."""
    along, across, constant = crank_equation(span, zero, up, crank, rod)
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
