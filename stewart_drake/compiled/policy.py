"""What a tuner hears, and a policy's answer to it."""

from __future__ import annotations

import numpy as np

from stewart_drake.compiled.constants import RECENT, TUNER_MEMORY, TUNER_SITE
from stewart_drake.compiled.jit import njit

_R, _S, _T = RECENT, TUNER_SITE, TUNER_MEMORY


@njit(cache=True, error_model="numpy")
def features(
    site: np.ndarray,
    times: np.ndarray,
    density: np.ndarray,
    error: np.ndarray,
    torque: np.ndarray,
    innovation: np.ndarray,
    reference: np.ndarray,
    before: np.ndarray,
    found: np.ndarray,
    recent: np.ndarray,
) -> None:
    """Reference `features.features`.

    Args:
        site: `TUNER_SITE`.
        times: (6,) [s] of the means: those of the levels, that of the drift.
        density: (12,).
        error: (6,) [rad, m].
        torque: (6,) [N m].
        innovation: (6,) [rad].
        reference: (18,).
        before: (18,) `RECENT` of the tick before.
        found: (13,) out.
        recent: (18,) out.
    """
    period, noise = site[_S.period], site[_S.noise]
    surprise, restless, drift, turned, moved = 0.0, 0.0, 0.0, 0.0, 0.0
    along = period / (period + times[5])
    for i in range(6):
        noisy = innovation[i] / noise
        surprise += noisy * noisy / 6.0
        recent[_R.drift + i] = before[_R.drift + i] + along * (noisy - before[_R.drift + i])
        drift += recent[_R.drift + i] ** 2 / 6.0
        restless += ((torque[i] - before[_R.torque + i]) * site[_S.change]) ** 2 / 6.0
        recent[_R.torque + i] = torque[i]
    for k in range(3):
        turned += (error[k] / site[_S.rotation]) ** 2
        moved += (error[3 + k] / site[_S.position]) ** 2
    if before[_R.ticks] == 0.0:
        restless = 0.0
    recent[_R.ticks] = before[_R.ticks] + 1.0
    for k in range(5):
        now = surprise if k < 2 else turned + moved if k < 4 else restless
        recent[_R.levels + k] = before[_R.levels + k] + period / (period + times[k]) * (now - before[_R.levels + k])
    found[0] = recent[_R.levels] + site[_S.of_surprise]
    found[1] = recent[_R.levels + 1] + site[_S.of_surprise]
    found[2] = drift + site[_S.of_drift]
    for k in range(3):
        found[3 + k] = recent[_R.levels + 2 + k] + site[_S.of_cost]
    for part in range(2):
        mean = 0.0
        for k in range(6):
            mean += density[6 * part + k] / 6.0
        found[6 + part] = abs(mean) + 0.1
    for part in range(2):
        square = 1e-12
        for k in range(3):
            square += (site[_S.length] * reference[6 + 6 * part + k]) ** 2 + reference[9 + 6 * part + k] ** 2
        found[8 + part] = np.sqrt(square) + (1e-3 if part == 0 else 1e-2)
    found[10], found[11] = noise / 1e-5, site[_S.latency] / 1e-3
    for k in range(12):
        found[k] = np.log10(found[k])
    found[12] = site[_S.kappa]


@njit(cache=True, error_model="numpy")
def answer(
    stats: np.ndarray,
    hidden: np.ndarray,
    output: np.ndarray,
    box: np.ndarray,
    largest: float,
    fade: float,
    found: np.ndarray,
    wanted: np.ndarray,
) -> float:
    """Reference `policy.answer` of finite features.

    Args:
        stats: (4, n) mean, scale, low and high of the features.
        hidden: (h, n + 1) weights and bias.
        output: (m, h + 1) weights and bias.
        box: (3, m) centre, reach below and above.
        largest: See `policy.LARGEST`.
        fade: See `policy.FADE`.
        found: (n,).
        wanted: (m,) out.

    Returns:
        What of the answer is the policy's own.
    """
    count, units = found.size, np.empty(hidden.shape[0])
    off = 0.0
    for i in range(units.size):
        units[i] = hidden[i, count]
    for k in range(count):
        given = min(max(found[k], -largest), largest)
        off = max(off, (stats[2, k] - given) / stats[1, k], (given - stats[3, k]) / stats[1, k])
        scaled = (given - stats[0, k]) / stats[1, k]
        for i in range(units.size):
            units[i] += hidden[i, k] * scaled
    own = min(max(1.0 - off / fade, 0.0), 1.0)
    for i in range(units.size):
        units[i] = np.tanh(units[i])
    for m in range(wanted.size):
        total = output[m, units.size]
        for i in range(units.size):
            total += output[m, i] * units[i]
        wanted[m] = box[0, m] + box[1 if total < 0.0 else 2, m] * np.tanh(total) * own
    return own


@njit(cache=True, error_model="numpy")
def settle(
    wanted: np.ndarray,
    step: np.ndarray,
    weights: np.ndarray,
    disturbance: float,
    before: np.ndarray,
    result: np.ndarray,
) -> None:
    """References `policy.limited`, `settings.weights_of` and `settings.disturbance_of`.

    Args:
        wanted: (4,) setting.
        step: (4,) by which it may change.
        weights: (4,) of the base.
        disturbance: Of the base.
        before: `TUNER_MEMORY` of the tick before.
        result: Out: weights, disturbance and setting of a `TUNER_MEMORY`.
    """
    setting = result[_T.setting : _T.outside]
    for k in range(4):
        old = before[_T.setting + k]
        setting[k] = old + min(max(wanted[k] - old, -step[k]), step[k])
    speed, damping, integral = setting[0], setting[1], setting[2]
    result[_T.weights] = weights[0] * 10.0 ** (4.0 * speed)
    result[_T.weights + 1] = weights[1] * 10.0 ** (2.0 * speed + damping)
    result[_T.weights + 2] = weights[2] * 10.0 ** (6.0 * speed + integral)
    result[_T.weights + 3] = weights[3]
    result[_T.disturbance] = disturbance * 10.0 ** setting[3]
