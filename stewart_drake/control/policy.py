"""Tuners of settings: a network, or two settings and a threshold; from features to weights and disturbance.

A setting is four numbers that a tuner can change in a loop with an observer: powers of ten on top of a base.

    speed        of the regulator: q_pose by its fourth power, q_rate by its second, q_integral by its sixth, as the
                 poles of a chain of integrators move together
    damping      of the regulator: q_rate on top of that
    integral     action of the regulator: q_integral on top of that
    disturbance  that the observer expects, see `ObserverOptions`: its bandwidth moves by the third root

so that any combination within a box is a sensible loop, which four weights on their own are not. A setting stays within
a box and moves by a small share of it in a tick. To a network a signal beyond those of its training is the largest of
them. Of a robot with more noise or latency than all of its training it knows nothing: its output fades to the middle of
the box, the best fixed setting of when it was trained.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import numpy as np

from stewart_drake.base.atomic_files import PACKAGE
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.jit import fields, new_record, njit, record
from stewart_drake.control.features import FEATURES, TUNER_PARAMS, TUNER_STATE, CostScales, compute_features
from stewart_drake.control.network import Mlp, forward
from stewart_drake.loop.part import LoopContext, Part
from stewart_drake.mechanics.linear_algebra import copy_to

NAMES = ("speed", "damping", "integral", "disturbance")
"""Of the numbers of a setting."""
SIZE = len(NAMES)
STEP = 0.03
"""[-] share of its box by which a setting moves in a tick, at most. By shares of a second a slow robot would jump, and
its loop can grow by that: docs/results/tuner_safety.md."""
FADE = 0.5
"""[-] what noise and latency may lie outside of the training data, in their standard deviations, until the output has
faded."""
_NOISE, _LATENCY = FEATURES.index("noise"), FEATURES.index("latency")
LARGEST_FEATURE = 30.0
"""[-] features are held within it where a policy has no ends for them."""
BOX_HEADER = ("setting", "least", "centre", "largest")
_COUNT = len(FEATURES)
SCHEDULE = fields(calm=SIZE, alert=SIZE, threshold=(), hold=())
"""Two settings, [-], [s]; see `tuners.ScheduleTuner`."""


# --- the laws --------------------------------------------------------------------------------------------------------


@njit
def weights_of(base: Any, setting: Any) -> Any:
    """Block weights (4,) q_pose, q_rate, q_integral, r of a setting (4,), from those of the base (4,)."""
    speed, damping, integral = setting[0], setting[1], setting[2]
    weights = np.empty(4)
    weights[0] = base[0] * 10.0 ** (4.0 * speed)
    weights[1] = base[1] * 10.0 ** (2.0 * speed + damping)
    weights[2] = base[2] * 10.0 ** (6.0 * speed + integral)
    weights[3] = base[3]
    return weights


@njit
def disturbance_of(base: float, setting: Any) -> float:
    """Disturbance [rad/s^2 per sqrt(s)] of a setting (4,), from that of the base."""
    return base * 10.0 ** setting[3]


@njit
def policy_setting(policy: Any, features: Any, setting: Any) -> float:
    """The setting (4,) that a policy chooses for features (13,), of its record.

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
def slew(params: Any, target: Any, confidence: float, state: Any) -> None:
    """Moves the setting of a `TUNER_STATE` towards a target (4,), no more than a step; sets weights and disturbance."""
    params, state = record(params), record(state)
    for k in range(SIZE):
        change = target[k] - state.setting[k]
        state.setting[k] += min(max(change, -params.step[k]), params.step[k])
    state.setting[SIZE] = 1.0 - confidence
    copy_to(state.weights[:], weights_of(params.weights[:], state.setting[:]))
    state.disturbance[0] = disturbance_of(params.disturbance, state.setting[:])


@njit
def policy_tick(
    params: Any, policy: Any, density: Any, error: Any, torque: Any, innovation: Any, reference: Any,
    state: Any,
) -> None:  # fmt: skip
    """A tick of a policy; where a signal is not finite, or absurd, the setting goes to the centre.

    Takes `TUNER_PARAMS`, the record of a `Policy`, the signals of `compute_features`, and `TUNER_STATE` of the tick
    before, in place.
    """
    values, target, confidence = np.empty(_COUNT), np.empty(SIZE), 0.0
    copy_to(target, record(params).centre[:])
    if compute_features(params, density, error, torque, innovation, reference, state, values):
        confidence = policy_setting(record(policy), values, target)
    slew(params, target, confidence, state)


@njit
def schedule_tick(
    params: Any, schedule: Any, density: Any, error: Any, torque: Any, innovation: Any, reference: Any,
    state: Any,
) -> None:  # fmt: skip
    """A tick of a schedule, otherwise as `policy_tick`: alert while innovations are large, and for a while after."""
    values, target, confidence = np.empty(_COUNT), np.empty(SIZE), 0.0
    if compute_features(params, density, error, torque, innovation, reference, state, values):
        confidence = 1.0
        _schedule_setting(record(params), record(schedule), values, record(state), target)
    else:
        record(state).hold_left = 0.0
        copy_to(target, record(params).centre[:])
    slew(params, target, confidence, state)


@njit
def _schedule_setting(params: Any, schedule: Any, features: Any, state: Any, setting: Any) -> None:
    loud = 10.0 ** features[0] > schedule.threshold**2
    state.hold_left = schedule.hold if loud else max(state.hold_left - params.period, 0.0)
    copy_to(setting, schedule.alert[:] if loud or state.hold_left > 0.0 else schedule.calm[:])


# --- sources of settings ---------------------------------------------------------------------------------------------


class SettingSource(Protocol):
    """What chooses settings: a kernel like `policy_tick` with a record for it, and a box about the first setting."""

    @property
    def kernel(self) -> Callable[..., None]: ...

    def params(self) -> np.ndarray: ...

    @property
    def centre(self) -> np.ndarray: ...

    @property
    def width(self) -> np.ndarray: ...


@dataclass(frozen=True, eq=False)
class Policy(Mlp):
    """A trained policy: features in, and the tanh of its outputs is where in the box a setting lies.

    Attributes:
        centre: (4,) setting in the middle of the box.
        below: (4,) how far the box reaches below it; > 0.
        above: (4,) likewise above.
        low: (13,) least features of the training data.
        high: (13,) largest.
        features: Names of the inputs. Zero weights, and not a scale, leave one out.

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
    sizes = (_COUNT, None, SIZE)
    more: ClassVar = {**dict.fromkeys(("centre", "below", "above"), (SIZE,)), **dict.fromkeys(ordered, (_COUNT,))}
    kernel: ClassVar[Callable[..., None]] = staticmethod(policy_tick)
    centre: np.ndarray
    below: np.ndarray
    above: np.ndarray
    low: np.ndarray
    high: np.ndarray
    features: Any = FEATURES

    def __post_init__(self) -> None:
        if not isinstance(self.features, (list, tuple)) or tuple(self.features) != FEATURES:
            raise ConfigurationError("features", self.features, f"{list(FEATURES)}")
        super().__post_init__()

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
        """Rows of two texts: what it is made of, then its provenance."""
        used = [name for name, column in zip(FEATURES, self.hidden_weights.T, strict=True) if column.any()]
        card = {"inputs": ", ".join(used) or "nothing", "hidden units": len(self.hidden_weights), **self.provenance}
        return [(name, value if isinstance(value, str) else json.dumps(value)) for name, value in card.items()]


def setting_part(source: SettingSource, context: LoopContext, weights: np.ndarray, kappa: float = 0.0) -> Part:
    """A tuner of settings as a part of a loop: what a tick chooses acts from the next one on.

    `weights` (4,) are those of the base; `kappa` [-] from stiff, -1, to quiet, 1: the scale of torque changes in the
    cost is divided by 10^kappa.
    """
    centre, scales = source.centre, CostScales()
    params = new_record(
        TUNER_PARAMS,
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
    initial = new_record(
        TUNER_STATE,
        weights=weights_of(np.asarray(weights, dtype=float), centre),
        disturbance=disturbance_of(context.disturbance, centre),
        setting=[*centre, 0.0],
        averages=[1.0, 1.0, 0.0, 0.0, 0.0],
    )

    numbers = {"params": params, "source": source.params()}
    inputs = {"density": 12, "error": 6, "torque": 6, "innovation": 6, "reference": 18}
    outputs = ("weights", "disturbance", "setting")
    return Part("tuner", source.kernel, {}, inputs, outputs, initial, end_of_tick=True, parameters=numbers)
