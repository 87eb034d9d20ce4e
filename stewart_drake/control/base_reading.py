"""What a controller does with the reading of a sensor on a moving base: its model counts with it, its reference too."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

import numpy as np

from stewart_drake.base.records import Record, Vec18
from stewart_drake.loop.part import Part
from stewart_drake.mechanics.dynamics_laws import twists_of_motion
from stewart_drake.mechanics.kinematics_laws import euler_drift, euler_rates, roll_pitch_yaw, rotation

if TYPE_CHECKING:
    from stewart_drake.references.motions import Reference

READING = "base_reading"
"""Signal (12,): what the base's inertial unit reads, see `robot.gravity.base_reading`, then its roll, pitch, yaw."""


def informed(parts: Iterable[Part]) -> tuple[list[Part], list[Part]]:
    """The parts, with the measured motion of the base in their `params`; and those that write it there, to go first."""
    writers, result = [], []
    for part in parts:
        params = part.parameters.get("params")
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
        times = np.atleast_1d(np.asarray(time, dtype=float)).ravel()
        rows = levelled(np.concatenate(self._motion.evaluate(times), axis=-1), self._base(times))
        rows = rows.reshape(*np.shape(time), 3, 6)
        return rows[..., 0, :], rows[..., 1, :], rows[..., 2, :]


def levelled(rows: np.ndarray, readings: np.ndarray) -> np.ndarray:
    """Rows (n, 18) of a motion, turned against the base by `level_tick`, with readings (n, 12) of the same times."""
    now, state, turned = np.zeros(1), LevelState.new(), np.empty_like(rows)
    for row, reading, out in zip(rows, readings, turned, strict=True):
        level_tick(now, row, reading, state)
        out[:] = state["reference"][0]
    return turned


class LevelState(Record):
    """State of `level_tick`."""

    reference: Vec18  # Pose, rate and acceleration in B.


def level_part(source: str, reference: str, ahead: float) -> Part:
    """From a motion (18,) on a base at rest, `source`, to `reference` (18,) on the base as it will be `ahead` [s]."""
    numbers, inputs = {"ahead": np.array([ahead])}, {"motion": 18, READING: 12}
    part = Part(f"level_{reference}", level_tick, {}, inputs, ("reference",), LevelState.new(), parameters=numbers)
    return part.connected(motion=source).named(reference=reference)


def level_tick(ahead: np.ndarray, motion: np.ndarray, base_reading: np.ndarray, state: np.ndarray) -> None:
    """Turns a motion against the base, so that the platform's attitude in the world is that on a base at rest.

    R_BP = R_MB' R_MP, with B where it will be after `ahead`. Positions stay those in B.
    """
    (_, spin, alpha, attitude), out, h = base_reading.reshape(4, 3), state["reference"][0], ahead[0]
    turn, wanted, rate, twist, twist_rate, drift = (np.empty(n) for n in ((3, 3), (3, 3), 3, 6, 6, 3))
    rotation(attitude, turn)
    euler_rates(attitude, turn @ (spin + 0.5 * h * alpha), rate)
    rotation(attitude + h * rate, turn)
    rotation(motion[:3], wanted)
    twists_of_motion(motion[:6], motion[6:12], motion[12:], twist, twist_rate)
    roll_pitch_yaw(turn.T @ wanted, out[:3])
    w, in_base = spin + h * alpha, turn.T @ twist[:3]
    euler_rates(out[:3], in_base - w, out[6:9])
    euler_drift(out[:3], out[6:9], drift)
    euler_rates(out[:3], turn.T @ twist_rate[:3] - np.cross(w, in_base) - alpha - drift, out[12:15])
    out.reshape(3, 6)[:, 3:] = motion.reshape(3, 6)[:, 3:]
