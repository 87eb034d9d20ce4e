"""A robot's geometry: whether it can stand at home, and how a table of measured positions gives it.

Messages name leg, number, and what was perhaps meant: millimetres, a mirrored axis, joints that are swapped.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from stewart_drake.config import check_value
from stewart_drake.errors import ConfigurationError
from stewart_drake.files.whole import read_checked
from stewart_drake.robot.leg import LARGEST, LEGS, PARALLEL, Signed3, Size, crank_equation

if TYPE_CHECKING:
    from stewart_drake.robot.robot_parameters import RobotParameters

_HUGE = 30.0
"""[m] no leg is larger: such a number is in millimetres."""
_SLACK = 1e-6
"""[rad] by which directions of joints that meet in one point may seem out of order."""


def check_geometry(robot: RobotParameters) -> None:
    """Refuses directions that are not perpendicular unit vectors, lengths that no leg has, and a home that is none."""
    for leg, own in enumerate(robot.legs or ()):
        for name in ("crank_zero_direction", "crank_quarter_direction"):
            given = getattr(own, name)
            if given is not None and abs(math.hypot(*given) - 1.0) > PARALLEL:
                allowed = f"a vector of length 1, not {math.hypot(*given):.4g}"
                raise ConfigurationError(f"robot.legs.{leg}.{name}", given, allowed)
        quarter = own.crank_quarter_direction or (0.0, 0.0, 1.0)
        if abs(np.dot(robot.crank_zero_directions[leg], quarter)) > PARALLEL:
            allowed = "a direction at a right angle to crank_zero_direction"
            raise ConfigurationError(f"robot.legs.{leg}.crank_quarter_direction", quarter, allowed)
    for name, lengths in _sizes(robot).items():
        leg = int(lengths.argmax())
        given = getattr(robot.legs[leg], name) if robot.legs is not None else None
        if lengths[leg] > _HUGE and (given is not None or name.endswith("length")):
            allowed = f"at most {_HUGE:g} m; millimetres? {lengths[leg]:g} mm would be {lengths[leg] / 1e3:g} m"
            key = f"robot.{name}" if given is None else f"robot.legs.{leg}.{name}"
            raise ConfigurationError(key, getattr(robot, name) if given is None else given, allowed)
    check_order(robot.shaft_positions, robot.platform_joints)
    _check_home(robot)


def check_order(shafts: np.ndarray, joints: np.ndarray) -> None:
    """Refuses platform joints (6, 3) that do not follow each other around the platform as the shafts (6, 3) do."""
    x, y = np.moveaxis(np.stack([shafts, joints]) - np.stack([shafts, joints]).mean(axis=1, keepdims=True), -1, 0)[:2]
    around = np.arctan2(y, x)
    order = np.argsort(around[0], kind="stable")
    following = np.roll(order, -1)
    steps = wrapped(around[:, following] - around[:, order])
    wrong = (steps[0] > _SLACK) & (steps[1] < -_SLACK)
    if wrong.sum() >= LEGS - 1:
        allowed = "joints that go round as the shafts do: these go round the other way; is an axis of P mirrored?"
        raise ConfigurationError("robot.legs.0.platform_joint", joints[0].tolist(), allowed)
    if wrong.any():
        one, other = sorted((int(order[wrong][0]), int(following[wrong][0])))
        allowed = f"a joint [m] on its own side of leg {other}'s: are the joints of legs {one} and {other} swapped?"
        raise ConfigurationError(f"robot.legs.{one}.platform_joint", joints[one].tolist(), allowed)


def _check_home(robot: RobotParameters) -> None:
    """Refuses a robot whose legs do not close at home, or only beyond their stops: it has no SDF."""
    span = robot.platform_joints + robot.home_pose[3:] - robot.shaft_positions
    directions = robot.crank_zero_directions.T, robot.crank_quarter_directions.T
    along, up, constant = crank_equation(span.T, *directions, robot.crank_lengths, robot.rod_lengths)
    size = np.hypot(along, up)
    margin = 1.0 - np.divide(np.abs(constant), size, out=np.full(LEGS, np.inf), where=size > 0.0)
    if not margin.min() > 0.0:
        leg = int(margin.argmin())
        sizes = _sizes(robot)
        own = [name for name in sizes if robot.legs is not None and getattr(robot.legs[leg], name) is not None]
        # One number of its own is the likely cause; more of them say no more than the height.
        key, what, given = "home_height", "a height", robot.home_height
        if robot.legs is not None and len(own) == 1:
            key, what, given = f"legs.{leg}.{own[0]}", "a value", getattr(robot.legs[leg], own[0])
        allowed = (
            f"{what} with which leg {leg} closes at home: its joint is {np.linalg.norm(span[leg]):.4g} m from its "
            f"shaft, its crank {robot.crank_lengths[leg]:g} m and its rod {robot.rod_lengths[leg]:g} m long "
            f"(margin {margin[leg]:.3g})"
        )
        lengths = {name: float(each[leg]) for name, each in sizes.items()} | {"home_height": abs(robot.home_height)}
        raise ConfigurationError(f"robot.{key}", given, allowed + _meant(lengths))
    theta = np.arctan2(up, along) + robot.branches * np.arccos(constant / size)
    low, high = np.clip(robot.crank_angle_ranges, -LARGEST, LARGEST).T
    beyond = np.abs(wrapped(theta - 0.5 * (low + high))) > 0.5 * (high - low)
    if beyond.any():
        leg = int(beyond.argmax())
        allowed = f"a range that holds the angle at home, {theta[leg]:.4g} rad"
        raise ConfigurationError(f"robot.legs.{leg}.crank_angle_range", (float(low[leg]), float(high[leg])), allowed)


def _sizes(robot: RobotParameters) -> dict[str, np.ndarray]:
    """(6,) [m] of what each leg may have of its own."""
    return {
        "rod_length": robot.rod_lengths,
        "crank_length": robot.crank_lengths,
        "shaft_position": np.linalg.norm(robot.shaft_positions, axis=-1),
        "platform_joint": np.linalg.norm(robot.platform_joints, axis=-1),
    }


def _meant(lengths: dict[str, float]) -> str:
    """What was perhaps meant by lengths of a leg that does not close; the middle one of five tells what is usual."""
    usual = float(np.median(list(lengths.values())))
    large = [name for name, size in lengths.items() if size > 100.0 * usual]
    small = [name for name, size in lengths.items() if 100.0 * size < usual]
    if large:
        return f"; is {' or '.join(large)} in millimetres?"
    return f"; are all but {' and '.join(small)} in millimetres?" if small else ""


def wrapped(angle: Any) -> Any:
    """Angles within half a turn of zero."""
    return np.remainder(angle + math.pi, 2.0 * math.pi) - math.pi


# --- from a table ---

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
    names, table = _read(Path(table)) if isinstance(table, (str, Path)) else (_POSITIONS, table)
    try:
        values = np.asarray(table, dtype=float)
    except (TypeError, ValueError) as error:
        raise ConfigurationError("table", table, f"a path, or numbers of shape (6, 6) ({error})") from None
    if values.shape != (LEGS, len(names)):
        allowed = f"{LEGS} rows, one a leg, of {', '.join(names)}"
        raise ConfigurationError("table", values.shape, allowed)
    if not np.isfinite(values).all():
        leg, column = np.argwhere(~np.isfinite(values))[0]
        raise ConfigurationError(f"table: {names[column]} of leg {leg}", float(values[leg, column]), "a finite number")
    columns = dict(zip(names, values.T, strict=True))
    numbers = columns.pop("leg", np.arange(LEGS))
    if (np.diff(numbers) != 1.0).any() or numbers[0] not in (0.0, 1.0):
        allowed = "0 to 5, or 1 to 6, in this order: the first row is leg 0"
        raise ConfigurationError("table: leg", numbers.tolist(), allowed)
    return columns


def _read(path: Path) -> tuple[tuple[str, ...], list[list[float]]]:
    """Names and values of a CSV file with a header."""
    what = f"table {path}"
    text = read_checked(path, what, _MAX_BYTES).decode("utf-8-sig", "replace")
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    names, *rows = [tuple(cell.strip() for cell in row) for row in csv.reader(lines)] or [()]
    parts = [group for group in _GROUPS if not names or set(group) & set(names)]
    missing = [name for group in (_POSITIONS, *parts) for name in group if name not in names]
    strange = [name for name in names if name not in (*_POSITIONS, *_OTHERS, "leg") or names.count(name) > 1]
    if missing or strange:
        wrong = f"without {', '.join(missing)}" if missing else f"with {', '.join(strange)}"
        allowed = f"each once: {', '.join(_POSITIONS)}, and optionally, in groups, {', '.join(_OTHERS)}, leg"
        raise ConfigurationError(f"{what}: header", wrong, allowed)
    values: list[list[float]] = []
    for leg, row in enumerate(rows):
        if len(row) != len(names):
            raise ConfigurationError(f"{what}: leg {leg}", f"{len(row)} numbers", f"{len(names)}, one a column")
        values.append([])
        for name, cell in zip(names, row, strict=True):
            try:
                values[-1].append(float(cell))
            except ValueError:
                raise ConfigurationError(f"{what}: {name} of leg {leg}", cell, "a number") from None
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
