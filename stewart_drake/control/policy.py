"""Tuners of settings: from features of the loop to weights and disturbance, by a network or by a threshold.

A setting is four numbers that a tuner changes in a loop with an observer, as powers of ten on top of a base.

    speed        of the regulator: q_pose by its fourth power, q_rate by its second, q_integral by its sixth, as the
                 poles of a chain of integrators move together
    damping      of the regulator: q_rate on top of that
    integral     action of the regulator: q_integral on top of that
    disturbance  that the observer expects, see `ObserverOptions`: its bandwidth moves by the third root

Unlike four weights, any setting within a box gives a sensible loop. A setting stays within its box and moves by a small
share of it in a tick. Features are limited to the range of the training data. For a robot with more noise or latency
than that the output fades to the middle of the box, the best fixed setting of the training.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Protocol, cast

import numpy as np

from stewart_drake.base.atomic_files import PACKAGE
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.jit import njit
from stewart_drake.base.records import Record, Vec4, Vec6, Vec12, Vec18, record
from stewart_drake.control.features import FEATURES, CostScales, Features, TunerParams, TunerState, compute_features
from stewart_drake.control.network import Mlp, MlpParams, forward
from stewart_drake.loop.part import LoopContext, Part
from stewart_drake.mechanics.linear_algebra import copy_to

NAMES = ("speed", "damping", "integral", "disturbance")
"""Names of the four numbers of a setting."""
SIZE = len(NAMES)
STEP = 0.03
"""[-] share of its box by which a setting moves in a tick, at most. Per second instead, the setting of a slow robot
would jump, which can make its loop unstable: docs/results/tuner.md."""
FADE = 0.5
"""[-] distance of noise or latency from the training data, in their standard deviations, at which the output has faded
to the centre."""
_NOISE, _LATENCY = FEATURES.index("noise"), FEATURES.index("latency")
LARGEST_FEATURE = 30.0
"""[-] limit of features where a policy has none."""
BOX_HEADER = ("setting", "least", "centre", "largest")
_COUNT = len(FEATURES)


class Schedule(Record):
    """Parameters of a schedule, see `tuners.ScheduleTuner`."""

    calm: Vec4  # Setting while innovations are small.
    alert: Vec4  # Setting while they are large.
    threshold: float  # [-] of a normalised innovation.
    hold: float  # [s] for which the alert setting is still used.


class PolicyParams(MlpParams):
    """Arrays of a `Policy`."""

    centre: Vec4  # Setting in the middle of the box.
    below: Vec4  # Distance of the lower end of the box; > 0.
    above: Vec4  # Distance of the upper end; > 0.
    low: Features  # Smallest features of the training data.
    high: Features  # Largest.


# --- the laws --------------------------------------------------------------------------------------------------------


@njit
def set_weights(base: Vec4, setting: Vec4, out: Vec4) -> None:
    """Block weights q_pose, q_rate, q_integral, r at a setting, from those of the base."""
    speed, damping, integral = setting[0], setting[1], setting[2]
    out[0] = base[0] * 10.0 ** (4.0 * speed)
    out[1] = base[1] * 10.0 ** (2.0 * speed + damping)
    out[2] = base[2] * 10.0 ** (6.0 * speed + integral)
    out[3] = base[3]


def weights_of(base: Vec4, setting: Vec4) -> Vec4:
    """`set_weights` into a new array."""
    weights = np.empty(4)
    set_weights(base, setting, weights)
    return weights


@njit
def disturbance_of(base: float, setting: Vec4) -> float:
    """Disturbance [rad/s^2 per sqrt(s)] at a setting, from that of the base."""
    return base * 10.0 ** setting[3]


@njit
def policy_setting(policy: PolicyParams, features: Features, setting: Vec4) -> float:
    """The setting (4,) that a policy chooses for features (13,).

    Returns its confidence: 1 for a robot like those of the training, 0 for another, and where a feature is not finite.
    With less confidence the setting is nearer to the centre.
    """
    values, outside = features.copy(), 0.0
    for k in range(_COUNT):
        if not np.isfinite(values[k]):
            values[k], outside = policy.input_mean[k], 2.0 * FADE
            continue
        held = min(max(values[k], policy.low[k]), policy.high[k])
        if k == _NOISE or k == _LATENCY:  # noqa: SIM109 - C has no `in`
            outside = max(outside, abs(values[k] - held) / policy.input_scale[k])
        values[k] = held
    confidence = min(max(1.0 - outside / FADE, 0.0), 1.0)
    forward(policy, values, LARGEST_FEATURE, setting)
    for m in range(SIZE):
        width = policy.below[m] if setting[m] < 0.0 else policy.above[m]
        setting[m] = policy.centre[m] + width * np.tanh(setting[m]) * confidence
    return confidence


@njit
def slew(params: TunerParams, target: Vec4, confidence: float, state: TunerState) -> None:
    """Moves the setting towards a target by a step at most; sets weights and disturbance."""
    params, state = record(params), record(state)
    for k in range(SIZE):
        change = target[k] - state.setting[k]
        state.setting[k] += min(max(change, -params.step[k]), params.step[k])
    state.setting[SIZE] = 1.0 - confidence
    set_weights(params.weights[:], state.setting[:SIZE], state.weights[:])
    state.disturbance[0] = disturbance_of(params.disturbance, state.setting[:SIZE])


@njit
def policy_tick(
    params: TunerParams,
    policy: PolicyParams,
    density: Vec12,
    error: Vec6,
    torque: Vec6,
    innovation: Vec6,
    reference: Vec18,
    state: TunerState,
) -> None:
    """A tick of a policy; where a signal is implausible, the setting goes to the centre. See `compute_features`."""
    values, target, confidence = np.empty(_COUNT), np.empty(SIZE), 0.0
    copy_to(target, record(params).centre[:])
    if compute_features(params, density, error, torque, innovation, reference, state, values):
        confidence = policy_setting(record(policy), values, target)
    slew(params, target, confidence, state)


@njit
def schedule_tick(
    params: TunerParams,
    schedule: Schedule,
    density: Vec12,
    error: Vec6,
    torque: Vec6,
    innovation: Vec6,
    reference: Vec18,
    state: TunerState,
) -> None:
    """A tick of a schedule: the alert setting while innovations are large, and for a while after; else the calm one."""
    values, target, confidence = np.empty(_COUNT), np.empty(SIZE), 0.0
    if compute_features(params, density, error, torque, innovation, reference, state, values):
        confidence = 1.0
        _schedule_setting(record(params), record(schedule), values, record(state), target)
    else:
        record(state).hold_left = 0.0
        copy_to(target, record(params).centre[:])
    slew(params, target, confidence, state)


@njit
def _schedule_setting(
    params: TunerParams, schedule: Schedule, features: Features, state: TunerState, setting: Vec4
) -> None:
    loud = 10.0 ** features[0] > schedule.threshold**2
    state.hold_left = schedule.hold if loud else max(state.hold_left - params.period, 0.0)
    if loud or state.hold_left > 0.0:
        copy_to(setting, schedule.alert[:])
    else:
        copy_to(setting, schedule.calm[:])


# --- sources of settings ---------------------------------------------------------------------------------------------


class SettingSource(Protocol):
    """Source of settings: a kernel like `policy_tick`, its parameters, and a box around the first setting."""

    @property
    def kernel(self) -> Callable[..., None]: ...

    def params(self) -> Record: ...

    @property
    def centre(self) -> np.ndarray: ...

    @property
    def width(self) -> np.ndarray: ...


@dataclass(frozen=True, eq=False)
class Policy(Mlp):
    """A trained policy: features in; the tanh of its outputs is the position of the setting in its box.

    Attributes:
        features: Names of the inputs; one that is not used has zero weights.

    Raises:
        ConfigurationError: As `Mlp`; other features.
    """

    file_format = ("stewart-drake policy", 1)
    shipped = PACKAGE / "weights" / "policy.json"
    header = ("features",)
    file_names: ClassVar = {
        "input_mean": "mean",
        "input_scale": "scale",
        "hidden_weights": "hidden",
        "output_weights": "output",
    }
    largest = 1e6
    positive = ("input_scale", "below", "above")
    ordered = ("low", "high")
    record_type = PolicyParams
    sizes: ClassVar = {"n": _COUNT, "m": SIZE}
    kernel: ClassVar[Callable[..., None]] = staticmethod(policy_tick)
    centre: np.ndarray
    below: np.ndarray
    above: np.ndarray
    low: np.ndarray
    high: np.ndarray
    features: tuple[str, ...] = FEATURES

    def __post_init__(self) -> None:
        if not isinstance(self.features, (list, tuple)) or tuple(self.features) != FEATURES:
            raise ConfigurationError("features", self.features, f"{list(FEATURES)}")
        super().__post_init__()

    def params(self) -> PolicyParams:
        return cast("PolicyParams", super().params())

    @property
    def lowest(self) -> np.ndarray:
        return self.centre - self.below

    @property
    def width(self) -> np.ndarray:
        return self.below + self.above

    def box_rows(self) -> list[tuple[str, ...]]:
        """Under `BOX_HEADER`."""
        ends = self.lowest, self.centre, self.lowest + self.width
        return [(name, *(f"{end[k]:.3g}" for end in ends)) for k, name in enumerate(NAMES)]

    def facts(self) -> list[tuple[str, str]]:
        """Rows of two texts: inputs and size, then its provenance."""
        used = [name for name, column in zip(FEATURES, self.hidden_weights.T, strict=True) if column.any()]
        card = {"inputs": ", ".join(used) or "nothing", "hidden units": len(self.hidden_weights), **self.provenance}
        return [(name, value if isinstance(value, str) else json.dumps(value)) for name, value in card.items()]


def setting_part(source: SettingSource, context: LoopContext, weights: np.ndarray, kappa: float = 0.0) -> Part:
    """A tuner of settings as a part of a loop; its setting acts from the next tick on.

    `weights` (4,) are those of the base; `kappa` [-] from stiff, -1, to quiet, 1: the scale of torque changes in the
    cost is divided by 10^kappa.
    """
    centre, scales = source.centre, CostScales()
    params = TunerParams.new(
        context,
        length=context.robot.characteristic_length,
        kappa=kappa,
        rotation=math.radians(scales.rotation),
        position=1e-3 * scales.position,
        # The scale is for a millisecond.
        torque_change=1e3 * context.period * scales.torque_change,
        centre=centre,
        step=STEP * source.width,
        weights=weights,
    )
    initial = TunerState.new(
        weights=weights_of(np.asarray(weights, dtype=float), centre),
        disturbance=disturbance_of(context.disturbance, centre),
        setting=[*centre, 0.0],
        averages=[1.0, 1.0, 0.0, 0.0, 0.0],
    )
    numbers = {"params": params, "source": source.params()}
    inputs = {"density": 12, "error": 6, "torque": 6, "innovation": 6, "reference": 18}
    outputs = ("weights", "disturbance", "setting")
    return Part("tuner", source.kernel, {}, inputs, outputs, initial, end_of_tick=True, parameters=numbers)
