"""What a controller does with the reading of a sensor on a moving base: its model counts with it, its reference too."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from stewart_drake.base.jit import njit
from stewart_drake.base.records import Record, Vec1, Vec12, Vec18, record
from stewart_drake.loop.part import Part
from stewart_drake.mechanics.dynamics_laws import twists_of_motion
from stewart_drake.mechanics.kinematics_laws import cross, euler_drift, euler_rates, roll_pitch_yaw, rotation, turned

if TYPE_CHECKING:
    from stewart_drake.references.motions import Reference

READING = "base_reading"
"""Signal (12,): what the base's inertial unit reads, see `robot.gravity.base_reading`, then its roll, pitch, yaw."""


def informed(parts: Iterable[Part]) -> tuple[list[Part], list[Part]]:
    """The parts, with the measured motion of the base in their `params`; and those that write it there, to go first."""
    writers, result = [], []
    for part in parts:
        params: Any = part.parameters.get("params")
        if params is None or "base" not in (params.dtype.names or ()):
            result.append(part)
            continue
        name, first = f"{part.name}_params", np.zeros(1, np.dtype([("params", params.dtype)]))
        first["params"] = params
        writer = Part(name, _write, {"given": params}, {READING: 12}, ("params",), first, period=part.period)  # type: ignore[arg-type]
        writers.append(writer.named(params=name))
        result.append(part.connected(params=name))
    return result, writers


def _write(given: np.ndarray, base_reading: np.ndarray, state: np.ndarray) -> None:
    state["params"] = given
    for params in (
        state["params"],
        *(state["params"][name] for name in ("residual",) if name in (given.dtype.names or ())),
    ):
        params["base"] = base_reading[:9]


class LevelReference:
    """A motion as it is asked of a robot on a base that moves: `level_tick` of its rows, where nothing is measured.

    `base` gives the reading (n, 12) of an ideal sensor at times (n,) [s].
    """

    def __init__(self, motion: Reference, base: Callable[[np.ndarray], np.ndarray]) -> None:
        self._motion, self._base = motion, base

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        times, now, state = np.atleast_1d(np.asarray(time, dtype=float)).ravel(), np.zeros(1), LevelState.new()
        rows = np.concatenate(self._motion.evaluate(times), axis=-1)
        for row, reading in zip(rows, self._base(times), strict=True):
            level_tick(now, row, reading, state)
            row[:] = state["reference"][0]
        rows = rows.reshape(*np.shape(time), 3, 6)
        return rows[..., 0, :], rows[..., 1, :], rows[..., 2, :]


class LevelState(Record):
    """State of `level_tick`."""

    reference: Vec18  # Pose, rate and acceleration in B.


def level_part(source: str, reference: str, ahead: float) -> Part:
    """From a motion (18,) on a base at rest, `source`, to `reference` (18,) on the base as it will be `ahead` [s]."""
    numbers, inputs = {"ahead": np.array([ahead])}, {"motion": 18, READING: 12}
    part = Part(f"level_{reference}", level_tick, {}, inputs, ("reference",), LevelState.new(), parameters=numbers)
    return part.connected(motion=source).named(reference=reference)


@njit
def level_tick(ahead: Vec1, motion: Vec18, base_reading: Vec12, state: LevelState) -> None:
    """Turns a motion against the base, so that the platform's attitude in the world is that on a base at rest.

    R_BP = R_MB' R_MP, with B where it will be after `ahead`. Positions stay those in B.
    """
    out, rows, turn, wanted = record(state).reference, np.zeros((8, 3)), np.empty((3, 3)), np.empty((3, 3))
    attitude, w, alpha, in_mean, world_w, world_alpha = rows[0], rows[1], rows[2], rows[3], rows[4], rows[5]
    twist, twist_rate, result, h = np.empty(6), np.empty(6), np.zeros((3, 3)), ahead[0]
    rotation(base_reading[9:], turn)
    for k in range(3):
        alpha[k] = base_reading[6 + k]
        w[k] = base_reading[3 + k] + h * alpha[k]
        rows[6, k] = base_reading[3 + k] + 0.5 * h * alpha[k]
    turned(turn, rows[6], in_mean)
    euler_rates(base_reading[9:], in_mean, attitude)
    for k in range(3):
        attitude[k] = base_reading[9 + k] + h * attitude[k]
    rotation(attitude, turn)
    rotation(motion[:3], wanted)
    twists_of_motion(motion[:6], motion[6:12], motion[12:], twist, twist_rate)
    for k in range(3):
        for m in range(3):
            world_w[k] += turn[m, k] * twist[m]
            world_alpha[k] += turn[m, k] * twist_rate[m]
            for j in range(3):
                result[k, m] += turn[j, k] * wanted[j, m]
    roll_pitch_yaw(result, out[:3])
    cross(w, world_w, rows[6])
    for k in range(3):
        world_alpha[k] -= rows[6, k] + alpha[k]
        world_w[k] -= w[k]
        for row in range(3):
            out[6 * row + 3 + k] = motion[6 * row + 3 + k]
    euler_rates(out[:3], world_w, out[6:9])
    euler_drift(out[:3], out[6:9], rows[7])
    for k in range(3):
        world_alpha[k] -= rows[7, k]
    euler_rates(out[:3], world_alpha, out[12:15])
