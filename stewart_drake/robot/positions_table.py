"""A robot from a table of measured positions: what is left out is found, or taken from uniform bodies."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np

from stewart_drake.errors import ConfigurationError
from stewart_drake.files.whole import read_checked
from stewart_drake.robot.leg import LEGS, Signed3, Size, crank_equation
from stewart_drake.robot.robot_checks import check_order
from stewart_drake.section import check_value

Unit = Literal["m", "mm"]
Cranks = Literal["outwards", "towards", "away"]
_POSITIONS = ("shaft_x", "shaft_y", "shaft_z", "joint_x", "joint_y", "joint_z")
_GROUPS = (("crank_x", "crank_y", "crank_z"), ("up_x", "up_y", "up_z"), ("low", "high"))
_OTHERS = (*(name for group in _GROUPS for name in group), "crank_length", "rod_length", "branch")
_LENGTHS = {"crank_length", "rod_length", "home_height", "link_radius", "characteristic_length"}
_MASSES = {"platform_mass", "rod_mass", "crank_mass"}
_MAX_BYTES = 1_000_000
_LINK_RADIUS = 0.005 / 0.11
"""Of a link, over the characteristic length: as the paper's robot has it."""


def from_table(table: Any, unit: Unit, cranks: Cranks, parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters of a robot whose legs stand in a table.

    Columns of a CSV file, by name, in any order: shaft_x to shaft_z (in B) and joint_x to joint_z (in P); if need be
    crank_x to crank_z (where the crank points at theta = 0) and up_x to up_z (at pi/2), crank_length, rod_length,
    branch, and low and high [rad], its stops. Lines that begin with # are remarks.

    What neither table nor parameters say: `home_height` is where the cranks are level in the mean; of the branches each
    leg takes the one nearer to level there; `characteristic_length` is the joints' mean distance from the axis of P;
    links are as slender as the paper's; inertias are those of uniform bars and of a disc.

    Raises:
        ConfigurationError: Too few rows, columns or numbers; an unknown choice; a leg that cannot be level.
    """
    for name, given, choices in (("unit", unit, ("m", "mm")), ("cranks", cranks, ("outwards", "towards", "away"))):
        if given not in choices:
            raise ConfigurationError(name, given, f"one of {', '.join(choices)}")
    scale = 1e-3 if unit == "mm" else 1.0
    columns = _columns(table)
    for name, given in parameters.items():
        if name in _LENGTHS or name in _MASSES:
            check_value(f"robot.{name}", given, Size)
        elif name == "platform_center_of_mass":
            check_value(f"robot.{name}", given, Signed3)
    own = {name: value * scale if name in _LENGTHS else value for name, value in parameters.items()}
    if "platform_center_of_mass" in own:
        own["platform_center_of_mass"] = tuple(scale * x for x in own["platform_center_of_mass"])
    # Whole millimetres in metres have a tail of rounding, which nobody wants to read.
    shafts, joints = (
        np.round(scale * np.stack([columns[f"{end}_{axis}"] for axis in "xyz"], -1), 12) for end in ("shaft", "joint")
    )
    # A mirrored axis would else be told as a rod that is too short.
    check_order(shafts, joints)
    lengths = {name: _lengths(name, columns, own, scale) for name in ("crank_length", "rod_length")}
    zero, up = _directions(columns, shafts, cranks)
    tips = shafts + lengths["crank_length"][:, None] * zero
    height = own["home_height"] if "home_height" in own else _level(tips, joints, lengths["rod_length"])
    span = joints + [0.0, 0.0, height] - shafts
    branch = columns["branch"] if "branch" in columns else _branches(span, zero, up, lengths)
    legs: list[dict[str, Any]] = [
        {
            "shaft_position": shafts[leg].tolist(),
            "platform_joint": joints[leg].tolist(),
            "crank_zero_direction": zero[leg].tolist(),
            "crank_quarter_direction": up[leg].tolist(),
            "branch": int(branch[leg]),
            **{name: float(values[leg]) for name, values in lengths.items()},
        }
        for leg in range(LEGS)
    ]
    if "low" in columns:
        for leg, each in enumerate(legs):
            each["crank_angle_range"] = [float(columns["low"][leg]), float(columns["high"][leg])]
    size = float(np.hypot(joints[:, 0], joints[:, 1]).mean())
    known = {"legs": legs, "home_height": height, "characteristic_length": size, "link_radius": _LINK_RADIUS * size}
    known |= {name: float(values.mean()) for name, values in lengths.items()} | own
    return _inertias(known) | known


def _columns(table: Any) -> dict[str, np.ndarray]:
    """Columns (6,) of a table by name."""
    if isinstance(table, (str, Path)):
        rows = _read(Path(table))
    else:
        try:
            values = np.asarray(table, dtype=float)
        except (TypeError, ValueError) as error:
            raise ConfigurationError("table", table, f"a path, or numbers of shape (6, 6) ({error})") from None
        if values.ndim != 2 or values.shape[1] != len(_POSITIONS):
            allowed = "shape (6, 6): a row a leg, x, y, z of its shaft, then of its platform joint"
            raise ConfigurationError("table", values.shape, allowed)
        rows = [dict(zip(_POSITIONS, row, strict=True)) for row in values.tolist()]
    if len(rows) != LEGS:
        raise ConfigurationError("table", f"{len(rows)} rows", f"{LEGS} rows, one a leg")
    columns = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    for name, values in columns.items():
        if not np.isfinite(values).all():
            leg = int((~np.isfinite(values)).argmax())
            raise ConfigurationError(f"table: {name} of leg {leg}", float(values[leg]), "a finite number")
    return columns


def _read(path: Path) -> list[dict[str, float]]:
    """Rows of a CSV file with a header."""
    what = f"table {path}"
    try:
        text = read_checked(path, what, _MAX_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ConfigurationError(what, "bytes that are no UTF-8", "a CSV file in UTF-8") from None
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    rows = [[cell.strip() for cell in row] for row in csv.reader(lines)]
    names = rows[0] if rows else []
    missing = [name for name in _POSITIONS if name not in names]
    unknown = [name for name in names if name not in (*_POSITIONS, *_OTHERS, "leg")]
    if missing or unknown or len(set(names)) < len(names):
        wrong = f"without {', '.join(missing)}" if missing else ", ".join(unknown or names)
        allowed = f"each once: {', '.join(_POSITIONS)}, and optionally {', '.join(_OTHERS)}, leg"
        raise ConfigurationError(f"{what}: header", wrong, allowed)
    for group in _GROUPS:
        if len({name in names for name in group}) > 1:
            raise ConfigurationError(f"{what}: header", ", ".join(names), f"all of {', '.join(group)}, or none")
    found = []
    for leg, row in enumerate(rows[1:]):
        if len(row) != len(names):
            raise ConfigurationError(f"{what}: leg {leg}", f"{len(row)} numbers", f"{len(names)}, one a column")
        cells = zip(names, row, strict=True)
        found.append({name: _number(f"{what}: {name} of leg {leg}", text) for name, text in cells if name != "leg"})
    if "leg" in names:
        _check_numbering(what, [row[names.index("leg")] for row in rows[1:]])
    return found


def _check_numbering(what: str, labels: list[str]) -> None:
    """Refuses legs that are numbered otherwise than their rows stand; other labels are remarks."""
    numbers = [int(label) for label in labels if label.isdecimal()]
    if len(numbers) == len(labels) and numbers not in (list(range(len(labels))), list(range(1, len(labels) + 1))):
        allowed = f"rows in the order of the legs, 0 to {LEGS - 1} or 1 to {LEGS}: the first row is leg 0"
        raise ConfigurationError(f"{what}: leg", ", ".join(labels), allowed)


def _number(key: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ConfigurationError(key, text, "a number") from None


def _lengths(name: str, columns: Mapping[str, np.ndarray], own: Mapping[str, Any], scale: float) -> np.ndarray:
    """(6,) [m] of a column, or one length for all legs."""
    if name in columns:
        return np.round(scale * columns[name], 12)
    if name not in own:
        raise ConfigurationError(f"table: {name}", None, f"a column {name}, or {name} for all legs")
    return np.full(LEGS, float(own[name]))


def _directions(columns: Mapping[str, np.ndarray], shafts: np.ndarray, cranks: Cranks) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors (6, 3) along the cranks at theta = 0 and pi/2."""
    if "crank_x" in columns:
        zero = np.stack([columns[f"crank_{axis}"] for axis in "xyz"], axis=-1)
    elif cranks == "outwards":
        zero = shafts * [1.0, 1.0, 0.0]
    else:
        apart = np.linalg.norm(shafts[:, None] - shafts, axis=-1) + np.diag(np.full(LEGS, np.inf))
        side = 1.0 if cranks == "towards" else -1.0
        zero = side * (shafts[apart.argmin(axis=1)] - shafts) * [1.0, 1.0, 0.0]
    zero = _unit(zero, "crank", "a direction: crank_x to crank_z")
    up = np.stack([columns[f"up_{axis}"] for axis in "xyz"], axis=-1) if "up_x" in columns else np.eye(3)[[2] * LEGS]
    across = up - np.sum(up * zero, axis=-1, keepdims=True) * zero
    return zero, _unit(across, "up", "a direction across the crank: up_x to up_z")


def _unit(vectors: np.ndarray, name: str, allowed: str) -> np.ndarray:
    size = np.linalg.norm(vectors, axis=-1, keepdims=True)
    if size.min() < 1e-9:
        raise ConfigurationError(f"table: {name} of leg {int(size.argmin())}", "no direction", allowed)
    unit: np.ndarray = vectors / size
    return unit


def _level(tips: np.ndarray, joints: np.ndarray, rods: np.ndarray) -> float:
    """[m] mean over the legs of the height of P at which a leg's crank is at theta = 0."""
    across = np.linalg.norm((joints - tips)[:, :2], axis=-1)
    if (rods <= across).any():
        leg = int((rods - across).argmin())
        allowed = f"more than {across[leg]:.4g} m from level crank to joint of leg {leg}, or a home_height"
        hint = "; positions in millimetres? unit: mm" if across[leg] > 100.0 * rods[leg] else ""
        raise ConfigurationError(f"table: rod_length of leg {leg}", float(rods[leg]), allowed + hint)
    return float(np.mean(tips[:, 2] - joints[:, 2] + np.sqrt(rods**2 - across**2)))


def _branches(span: np.ndarray, zero: np.ndarray, up: np.ndarray, lengths: Mapping[str, np.ndarray]) -> np.ndarray:
    """(6,) -1 or 1: which brings each crank nearer to theta = 0 at home."""
    along, across, constant = crank_equation(span.T, zero.T, up.T, lengths["crank_length"], lengths["rod_length"])
    size = np.maximum(np.hypot(along, across), np.finfo(float).tiny)
    middle, spread = np.arctan2(across, along), np.arccos(np.clip(constant / size, -1.0, 1.0))
    away = [np.abs(np.remainder(middle + side * spread + math.pi, 2.0 * math.pi) - math.pi) for side in (-1.0, 1.0)]
    return np.where(away[0] <= away[1], -1, 1)


def _inertias(known: Mapping[str, Any]) -> dict[str, Any]:
    """Inertias [kg m^2] of uniform bars and of a disc, for the masses that are given."""
    found: dict[str, Any] = {}
    radius, size = known["link_radius"], known["characteristic_length"]
    for name, along in (("rod", 2), ("crank", 0)):
        if f"{name}_mass" in known:
            mass, length = known[f"{name}_mass"], known[f"{name}_length"]
            moments = [mass * (length**2 / 12.0 + radius**2 / 4.0)] * 3
            moments[along] = mass * radius**2 / 2.0
            found[f"{name}_inertia"] = tuple(moments)
    if "platform_mass" in known:
        moment = known["platform_mass"] * size**2 / 4.0
        found["platform_inertia"] = (moment, moment, 2.0 * moment)
    return found
