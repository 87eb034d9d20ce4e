"""Where the tracker's frames are, before anything else is known: from the guess's own poses at the readings."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import replace

import numpy as np
import scipy.optimize

from stewart_drake.calibration.measurements import Measurements
from stewart_drake.calibration.model import CLOSED, Frame, Model
from stewart_drake.calibration.parameters import FRAMES, OF_ROBOT, SIZE, FrameName, logarithm
from stewart_drake.errors import ConfigurationError
from stewart_drake.robot import RobotParameters

_LEAST = 4
"""Poses of the guess from which both frames follow."""
_APART, _OTHERS = 10.0, 50
"""How many times further than rows usually are one is off for a stray, and the most rows that it is compared with."""


def located(guess: RobotParameters, measurements: Measurements, known: Collection[FrameName]) -> Model:
    """The guess with the frames at which its own poses at the readings come nearest to the measured ones.

    Raises:
        ConfigurationError: The guess can be assembled at next to none of the readings.
    """
    believed, seen, _ = _both(guess, measurements)
    if len(seen.shift) < _LEAST:
        got = f"readings of which {len(seen.shift)} of {len(measurements)} can be those of this robot"
        allowed = "readings in rad (or _deg), in the order of the legs, near to crank angles of the guess"
        raise ConfigurationError(f"{measurements.source}: theta", got, allowed)
    free = [6 * FRAMES.index(frame) + axis for frame in FRAMES if frame not in known for axis in range(6)]
    model = Model(guess)
    if not free:
        return model
    starts = _starts(believed, seen, known)
    made = (_refined(model, start, believed, seen, free, guess.characteristic_length) for start in starts)
    return min(made, key=lambda each: each[1])[0]


def _both(guess: RobotParameters, measurements: Measurements) -> tuple[Frame, Frame, np.ndarray]:
    """Believed poses of P in B and measured ones of the marker, where the guess can be assembled; and where (n,)."""
    home = Frame(np.tile(np.eye(3), (len(measurements), 1, 1)), np.tile(guess.home_pose[3:], (len(measurements), 1)))
    believed, off = Model(guess).predicted(np.zeros(SIZE), measurements.angles, home)
    good = off <= CLOSED
    return _rows(believed, good), _rows(Frame(measurements.rotation, measurements.position), good), good


def stray_rows(guess: RobotParameters, measurements: Measurements) -> list[int]:
    """Rows that are suspect before anything is fitted: turned or shifted from the others as the guess is not.

    Turns between two poses do not depend on any frame, and their distance hardly does. Suspect are as well the rows at
    which the guess cannot be assembled.
    """
    believed, seen, good = _both(guess, measurements)
    suspect = ~good
    if len(seen.shift) >= _LEAST:
        others = np.unique(np.linspace(0, len(seen.shift) - 1, _OTHERS).astype(int))

        def apart(frames: Frame) -> np.ndarray:
            traces = np.einsum("nij,mij->nm", frames.turn, frames.turn[others])
            distances = np.linalg.norm(frames.shift[:, None] - frames.shift[others], axis=-1)
            return np.stack([np.arccos(np.clip(0.5 * (traces - 1.0), -1.0, 1.0)), distances])

        with np.errstate(all="ignore"):
            off = np.median(np.abs(apart(seen) - apart(believed)), axis=-1)
            usual = _APART * np.median(off, axis=-1, keepdims=True)
        suspect[good] = (off > usual).any(axis=0)
    return np.flatnonzero(suspect).tolist()


def guess_error(model: Model, measurements: Measurements) -> np.ndarray:
    """Measured minus believed poses of the marker (n, 6) [rad, m]; NaN where the guess cannot be assembled."""
    nothing = np.zeros(SIZE)
    at, off = model.predicted(nothing, measurements.angles, model.measured(nothing, measurements))
    error, _ = model.tracker_error(nothing, measurements, at)
    error[off > CLOSED] = np.nan
    return error


def _rows(frames: Frame, chosen: np.ndarray) -> Frame:
    return Frame(frames.turn[chosen], frames.shift[chosen])


def _starts(believed: Frame, seen: Frame, known: Collection[FrameName]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Turns of base and marker to begin with.

    Of two unknown turns the first pair is M. Shah's closed form (2013, Solving the robot-world/hand-eye calibration
    problem using the Kronecker product), which needs poses that are turned; the second lays the positions on each
    other, which needs poses that are not.
    """
    back = np.swapaxes(believed.turn, -1, -2)
    if "base" in known:
        yield np.eye(3), _rotation((back @ seen.turn).sum(axis=0))
        return
    if "platform" in known:
        yield _rotation((seen.turn @ back).sum(axis=0)), np.eye(3)
        return
    kronecker = np.einsum("nij,nkl->ikjl", believed.turn, seen.turn).reshape(9, 9)
    u, _, v = np.linalg.svd(kronecker)
    base, marker = (_rotation(_one_sign(each.reshape(3, 3).T)) for each in (u[:, 0], v[0]))
    yield base, marker.T
    apart = (each - each.mean(axis=0) for each in (seen.shift, believed.shift))
    base = _rotation(np.einsum("ni,nj->ij", *apart))
    yield base, _rotation((back @ base.T @ seen.turn).sum(axis=0))


def _refined(
    model: Model,
    turns: tuple[np.ndarray, np.ndarray],
    believed: Frame,
    seen: Frame,
    free: list[int],
    length: float,
) -> tuple[Model, float]:
    """The frames nearest to given turns that lay believed poses on seen ones, and the error that is left."""
    base, marker = turns
    places = np.concatenate([np.broadcast_to(np.eye(3), (len(seen.shift), 3, 3)), base @ believed.turn], axis=-1)
    off = seen.shift - believed.shift @ base.T
    shifts = np.zeros(6)
    columns = [column for column, at in enumerate((3, 4, 5, 9, 10, 11)) if at in free]
    shifts[columns] = np.linalg.lstsq(places.reshape(-1, 6)[:, columns], off.ravel(), rcond=None)[0]
    start = replace(model, base=Frame(base, shifts[:3]), marker=Frame(marker, shifts[3:]))

    def change_of(found: np.ndarray) -> np.ndarray:
        change = np.zeros(SIZE)
        change[OF_ROBOT + np.array(free)] = found
        return change

    def error(found: np.ndarray) -> np.ndarray:
        base, marker = start.frames(change_of(found))
        there = base.after(believed).after(marker)
        turn = logarithm(seen.turn @ np.swapaxes(there.turn, -1, -2))
        return np.concatenate([length * turn, seen.shift - there.shift]).ravel()

    found = scipy.optimize.least_squares(error, np.zeros(len(free)), x_scale="jac")
    return start.with_frames(change_of(found.x)), float(found.cost)


def _one_sign(matrix: np.ndarray) -> np.ndarray:
    return matrix if np.linalg.det(matrix) > 0.0 else -matrix


def _rotation(matrix: np.ndarray) -> np.ndarray:
    """The rotation nearest to a matrix."""
    u, _, v = np.linalg.svd(matrix)
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v


def refuse_units(guess: RobotParameters, measurements: Measurements) -> None:
    """Refuses motions so much larger or smaller than believed that a unit must be wrong.

    How far a pose is turned from the one before it does not depend on any frame; how far it is moved hardly does.

    Raises:
        ConfigurationError: The unit of positions, orientations or readings must be wrong.
    """
    believed, seen, _ = _both(guess, measurements)
    if len(seen.shift) < _LEAST:
        return

    def sizes(frames: Frame) -> tuple[float, float]:
        turned = np.linalg.norm(logarithm(frames.turn[1:] @ np.swapaxes(frames.turn[:-1], -1, -2)), axis=-1)
        moved = np.linalg.norm(np.diff(frames.shift, axis=0), axis=-1)
        return float(np.median(turned)), float(np.median(moved))

    (turned, moved), (turned_too, moved_too) = sizes(seen), sizes(believed)
    tiny = 1e-9
    turns, moves = (turned + tiny) / (turned_too + tiny), (moved + tiny) / (moved_too + tiny)
    degrees, kilo = 57.3, 1000.0
    what = ""
    if max(turns, moves) < 3.0 / degrees and min(turns, moves) > 1.0 / (3.0 * degrees):
        key, what = "theta", "degrees for radians"
    elif min(turns, moves) > degrees / 6.0 and max(turns, moves) < 6.0 * degrees:
        key, what = "theta", "radians for degrees"
    elif not 4.0 / kilo < moves < kilo / 4.0:
        key, what = "x, y, z", "millimetres for metres" if moves > 1.0 else "metres for millimetres"
    elif turned_too > 0.01 and not 3.0 / degrees < turns < degrees / 3.0:
        key, what = "roll, pitch, yaw", "degrees for radians" if turns > 1.0 else "radians for degrees"
    if what:
        here, there = (f"{way:.3g} m and {turn:.3g} rad" for way, turn in ((moved, turned), (moved_too, turned_too)))
        got = f"poses {here} apart where the guess moves by {there}"
        raise ConfigurationError(f"{measurements.source}: {key}", got, f"motions of that size; perhaps {what}?")
