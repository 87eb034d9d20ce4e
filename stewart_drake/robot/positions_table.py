"""A robot from a table of measured positions: what is left out is found, or taken from uniform bodies."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np

from stewart_drake.config import check_value
from stewart_drake.errors import ConfigurationError
from stewart_drake.files.whole import read_checked
from stewart_drake.robot.leg import LEGS, Signed3, Size, crank_equation
from stewart_drake.robot.robot_checks import check_order, wrapped

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
    check_value("unit", unit, Unit)
    check_value("cranks", cranks, Cranks)
    scale = 1e-3 if unit == "mm" else 1.0
    own = dict(parameters)
    for name, given in parameters.items():
        if name in _LENGTHS | _MASSES | {"platform_center_of_mass"}:
            check_value(f"robot.{name}", given, Signed3 if name == "platform_center_of_mass" else Size)
            own[name] = given if name in _MASSES else scale * np.array(given)
    columns = _columns(table)
    # Whole millimetres in metres have a tail of rounding, which nobody wants to read.
    shafts, joints = (
        np.round(scale * np.stack([columns[f"{end}_{axis}"] for axis in "xyz"], -1), 12) for end in ("shaft", "joint")
    )
    # A mirrored axis would else be told as a rod that is too short.
    check_order(shafts, joints)
    lengths: dict[str, np.ndarray] = {}
    for name in ("crank_length", "rod_length"):
        if name not in columns and name not in own:
            raise ConfigurationError(f"table: {name}", None, f"a column {name}, or {name} for all legs")
        lengths[name] = np.round(scale * columns[name], 12) if name in columns else np.full(LEGS, float(own[name]))
    zero, up = _directions(columns, shafts, cranks)
    height = float(own.get("home_height", np.nan))
    if "home_height" not in own:
        height = _level(shafts + lengths["crank_length"][:, None] * zero, joints, lengths["rod_length"])
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
            **({"crank_angle_range": [columns["low"][leg], columns["high"][leg]]} if "low" in columns else {}),
        }
        for leg in range(LEGS)
    ]
    size = float(np.hypot(joints[:, 0], joints[:, 1]).mean())
    known = {"legs": legs, "home_height": height, "characteristic_length": size, "link_radius": _LINK_RADIUS * size}
    known |= {name: float(values.mean()) for name, values in lengths.items()} | own
    return _inertias(known) | known


def _columns(table: Any) -> dict[str, np.ndarray]:
    """Columns (6,) of a table by name."""
    if isinstance(table, (str, Path)):
        names, values = _read(Path(table))
    else:
        names = list(_POSITIONS)
        try:
            values = np.asarray(table, dtype=float)
        except (TypeError, ValueError) as error:
            raise ConfigurationError("table", table, f"a path, or numbers of shape (6, 6) ({error})") from None
        if values.ndim != 2 or values.shape[1] != len(names):
            allowed = "shape (6, 6): a row a leg, x, y, z of its shaft, then of its platform joint"
            raise ConfigurationError("table", values.shape, allowed)
    if len(values) != LEGS:
        raise ConfigurationError("table", f"{len(values)} rows", f"{LEGS} rows, one a leg")
    if not np.isfinite(values).all():
        leg, column = np.argwhere(~np.isfinite(values))[0]
        raise ConfigurationError(f"table: {names[column]} of leg {leg}", float(values[leg, column]), "a finite number")
    return dict(zip(names, values.T, strict=True))


def _read(path: Path) -> tuple[list[str], np.ndarray]:
    """Names and values of a CSV file with a header."""
    what = f"table {path}"
    text = read_checked(path, what, _MAX_BYTES).decode("utf-8-sig", "replace")
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    names, *rows = [[cell.strip() for cell in row] for row in csv.reader(lines)] or [[]]
    missing = [name for name in _POSITIONS if name not in names]
    unknown = [name for name in names if name not in (*_POSITIONS, *_OTHERS, "leg")]
    if missing or unknown or len(set(names)) < len(names):
        wrong = f"without {', '.join(missing)}" if missing else ", ".join(unknown or names)
        allowed = f"each once: {', '.join(_POSITIONS)}, and optionally {', '.join(_OTHERS)}, leg"
        raise ConfigurationError(f"{what}: header", wrong, allowed)
    for group in _GROUPS:
        if len({name in names for name in group}) > 1:
            raise ConfigurationError(f"{what}: header", ", ".join(names), f"all of {', '.join(group)}, or none")
    values = np.empty((len(rows), len(names)))
    for leg, row in enumerate(rows):
        if len(row) != len(names):
            raise ConfigurationError(f"{what}: leg {leg}", f"{len(row)} numbers", f"{len(names)}, one a column")
        for column, (name, cell) in enumerate(zip(names, row, strict=True)):
            try:
                values[leg, column] = leg if name == "leg" and not cell.isdecimal() else float(cell)
            except ValueError:
                raise ConfigurationError(f"{what}: {name} of leg {leg}", cell, "a number") from None
    numbers = values[:, names.index("leg")].tolist() if "leg" in names else []
    if numbers and numbers not in (list(range(len(rows))), list(range(1, len(rows) + 1))):
        allowed = "0 to 5, or 1 to 6, in this order: the first row is leg 0"
        raise ConfigurationError(f"{what}: leg", ", ".join(f"{number:g}" for number in numbers), allowed)
    return names, values


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
    return np.where(np.abs(wrapped(middle - spread)) <= np.abs(wrapped(middle + spread)), -1, 1)


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
