"""What poses cannot tell: directions in which the parameters may change while hardly a pose does."""

from __future__ import annotations

import numpy as np
import scipy.linalg

from stewart_drake.calibration.parameters import OF_LEG, OF_ROBOT, PER_LEG

LARGEST = 0.1
"""[-] standard deviation of a direction, in `parameters.scales`, beyond which it counts as not told: a tenth of the
robot's size is more than anybody's guess is off."""
SHARE = 1e-3
"""[-] of an untold direction beyond which a parameter has no interval."""
_SMALL = 0.05
_FRAMES = ("the tracker's frame", "the marker's frame")


def told_and_untold(derivative: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Orthonormal directions (k, told) and (k, rest) of k parameters, from derivatives (m, k) of whitened errors."""
    _, sigma, directions = np.linalg.svd(derivative, full_matrices=True)
    told = np.zeros(len(directions), dtype=bool)
    told[: len(sigma)] = sigma * LARGEST >= 1.0
    return directions[told].T, directions[~told].T


def in_words(directions: np.ndarray, scales: np.ndarray) -> list[str]:
    """A sentence for each untold direction (`SIZE`, k), in `scales` (`SIZE`,) [m, rad].

    They are combined so that each has a parameter that no other has, and few parameters besides.
    """
    if directions.shape[1] == 0:
        return []
    _, _, order = scipy.linalg.qr(directions.T, mode="economic", pivoting=True)
    own = order[: directions.shape[1]]
    simple = np.linalg.solve(directions[own].T, directions.T) * scales / scales[own, None]
    sentences = []
    for row, first in zip(simple, own, strict=True):
        sizes = np.abs(row) * scales[first] / scales
        others = [at for at in np.argsort(-sizes, kind="stable") if at != first and sizes[at] > _SMALL]
        unit = "mm" if _unit(first) == "m" else "mrad"
        if not others:
            sentences.append(f"{_name(first)} on its own")
            continue
        shown = ", ".join(f"{_name(at)} by {_amount(row[at], at)}" for at in others[:6])
        rest = f" and {len(others) - 6} more" if len(others) > 6 else ""
        sentences.append(f"{_name(first)}: with each {unit} more of it {shown}{rest}")
    return sorted(sentences)


def _amount(value: float, at: int) -> str:
    """A change of a parameter for each mm or mrad of another."""
    return f"{value:+.2g} {'mm' if _unit(at) == 'm' else 'mrad'}"


def _unit(at: int) -> str:
    return OF_LEG[at % PER_LEG].unit if at < OF_ROBOT else ("rad", "m")[(at - OF_ROBOT) % 6 // 3]


def _name(at: int) -> str:
    if at >= OF_ROBOT:
        frame, axis = divmod(at - OF_ROBOT, 6)
        return f"{_FRAMES[frame]} {('turn', 'shift')[axis // 3]} {'xyz'[axis % 3]}"
    parameter = OF_LEG[at % PER_LEG]
    return f"leg {at // PER_LEG} {parameter.name}{f' {parameter.axis}' if parameter.axis else ''}"
