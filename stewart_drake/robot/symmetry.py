"""Doubts about measured legs: what breaks the pattern of the other legs, or has an unlikely size.

Nearly every robot looks the same after a third of a turn about z. A leg that does not is measured or typed wrongly, or
is meant so; a message has its number, and the number that the others would have.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

_SAME = 0.03  # [-] Largest difference of a leg from the turned next one, over the radius of the shafts.
_ODD = 0.06  # [-] Least difference of a leg that is mentioned: points are measured with a ruler.
_PER_RADIAN = 0.5  # [-] By which a difference of directions counts in this.
_THIRD = np.array([[-0.5, -math.sqrt(0.75), 0.0], [math.sqrt(0.75), -0.5, 0.0], [0.0, 0.0, 1.0]])
_CURES = {
    "crank": "is it mirrored or turned?",
    "crank_length": "is it another unit?",
    "rod_length": "is it another unit?",
}
_SIZES = {"crank_length": (0.05, 1.5), "rod_length": (0.4, 8.0)}  # [-] Usual ones, over the radius of the shafts.
_RADIUS = 0.03, 1.0  # [m] Usual ones, of the shafts.
_TWIST = 40.0  # [deg] Largest usual turn about z from shafts to joints, on average.


def turned_legs(legs: Mapping[str, np.ndarray]) -> list[tuple[int | None, dict[str, np.ndarray]]]:
    """Legs that break the pattern, and what they would be; None for the number of one that is missing.

    Args:
        legs: Quantities (n, 3) of six legs, or of five: positions [m] `shaft` and `joint`, and optionally directions
            `crank`, and lengths (n,).
    """
    after, match = _turned_by_a_third(legs), _matches(legs)
    followed, preceded = match.any(axis=1), match.any(axis=0)
    alone, result = np.flatnonzero(~followed & ~preceded).tolist(), list[tuple[int | None, dict[str, np.ndarray]]]()
    for leg in np.flatnonzero(preceded & ~followed):
        right = {name: values[leg] for name, values in after.items()}
        distances = {one: float(np.linalg.norm(legs["shaft"][one] - right["shaft"])) for one in alone}
        result.append((min(distances, key=distances.__getitem__, default=None), right))
    return result


def doubts(shafts: np.ndarray, joints: np.ndarray, others: Mapping[str, np.ndarray] | None = None) -> list[str]:
    """What is perhaps wrong with six legs, most telling first.

    Args:
        shafts: (6, 3) [m]
        joints: (6, 3) [m]
        others: `crank`, directions (6, 3), `crank_length` and `rod_length` (6,) [m], once they are known.
    """
    points = {"shaft": shafts, "joint": joints}
    legs = points | dict(others or {})
    radius = _radius(shafts)
    result = []
    for leg, right in turned_legs(legs):
        off = {} if leg is None else {name: float(_off(legs[name][leg] - right[name], name, radius)) for name in legs}
        name = max(off, key=off.__getitem__, default="")
        if leg is None or off[name] < _ODD:
            continue
        cure = _CURES.get(name, "a wrong sign, order or number?")
        given, expected = (_text(name, values) for values in (legs[name][leg], right[name]))
        result.append(f"the {name} of leg {leg} is {given}, by the pattern of the other legs {expected}: {cure}")
    if others and not result and _matches(points).any() and not _matches(points | {"crank": legs["crank"]}).any():
        angles = ", ".join(_text("crank", crank) for crank in legs["crank"])
        cure = "are they measured clockwise, from another axis, or in radians?"
        result.append(f"the cranks of legs 0 to 5 point to {angles}, which does not turn with the shafts: {cure}")
    return [*result, *_turned(shafts, joints), *(_unlikely(shafts, others, radius) if others else ())]


def regular(shafts: np.ndarray, joints: np.ndarray) -> bool:
    """Whether every leg (6, 3) [m], turned by a third, is another one."""
    return bool(_matches({"shaft": shafts, "joint": joints}).any(axis=1).all())


def _turned_by_a_third(legs: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: values @ _THIRD.T if values.ndim == 2 else values for name, values in legs.items()}


def _matches(legs: Mapping[str, np.ndarray]) -> np.ndarray:
    """(n, n) whether a leg, turned by a third, is another one."""
    after, radius = _turned_by_a_third(legs), _radius(legs["shaft"])
    off = np.max([_off(after[name][:, None] - legs[name], name, radius) for name in legs], axis=0)
    return (off <= _SAME) & ~np.eye(len(off), dtype=bool)


def _unlikely(shafts: np.ndarray, lengths: Mapping[str, np.ndarray], radius: float) -> list[str]:
    result, mm = [], 1e3
    for name, (low, high) in _SIZES.items():
        share = lengths[name] / np.maximum(np.linalg.norm(shafts[:, :2], axis=-1), 1e-9)
        leg = int(np.abs(np.log(share / math.sqrt(low * high))).argmax())
        if not low <= share[leg] <= high:
            sizes = f"{mm * lengths[name][leg]:.4g} mm, its shaft {mm * lengths[name][leg] / share[leg]:.4g} mm from z"
            result.append(f"{name} of leg {leg} is {sizes}: is it in the unit of the table?")
    short = lengths["rod_length"] <= lengths["crank_length"]
    if short.any():
        leg = int(short.argmax())
        result.append(f"the rod of leg {leg} is not longer than its crank: are crank_length and rod_length swapped?")
    if not _RADIUS[0] <= radius <= _RADIUS[1]:
        result.append(f"the shafts, as of leg 0, are {mm * radius:.4g} mm from z: is the unit right?")
    return result


def _turned(shafts: np.ndarray, joints: np.ndarray) -> list[str]:
    x, y = np.moveaxis(np.stack([shafts, joints]), -1, 0)[:2]
    around = np.exp(1j * (np.arctan2(y[1], x[1]) - np.arctan2(y[0], x[0])))
    mean, first = (float(np.degrees(np.angle(turn))) for turn in (around.mean(), around[0]))
    if not abs(mean) > _TWIST:
        return []
    where = f"{first:.0f} deg around z from its shaft, all are {mean:.0f} on average"
    return [f"the joint of leg 0 is {where}: do the joints begin with another leg than the shafts?"]


def _radius(shafts: np.ndarray) -> float:
    return float(max(np.median(np.linalg.norm(shafts[:, :2], axis=-1)), 1e-9))


def _off(difference: np.ndarray, name: str, radius: float) -> np.ndarray:
    """Sizes of differences [-], of directions or over the radius."""
    if name.endswith("length"):
        return np.abs(difference) / radius
    return np.linalg.norm(difference, axis=-1) * (_PER_RADIAN if name == "crank" else 1.0 / radius)


def _text(name: str, values: np.ndarray) -> str:
    if name == "crank":
        return f"{round(math.degrees(math.atan2(values[1], values[0])), 1) + 0.0:g} deg"
    return ", ".join(f"{1e3 * value + 0.0:.4g}" for value in np.ravel(values)) + " mm"
