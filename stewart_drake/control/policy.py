"""Tuners of settings: a network, or two settings and a threshold; from what they hear to weights and disturbance.

A setting is four numbers that a tuner can change in a loop with an observer: powers of ten on top of a base.

    speed        of the regulator: q_pose by its fourth power, q_rate by its second, q_integral by its sixth, as the
                 poles of a chain of integrators move together
    damping      of the regulator: q_rate on top of that
    integral     action of the regulator: q_integral on top of that
    disturbance  that the observer expects, see `ObserverOptions`: its bandwidth moves by the third root

so that any combination within a box is a sensible loop, which four weights on their own are not. Whatever a tuner
wants, a setting stays within a box and moves by a small share of it in a tick; where what it hears lies outside of what
a network was trained on, its answer fades to the middle of the box, the best fixed setting.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np

from stewart_drake.control.features import FEATURES, SETUP, TUNER_STATE, CostScales, features, plausible
from stewart_drake.control.network import load_weights, numbers, weights_bytes
from stewart_drake.errors import ConfigurationError
from stewart_drake.files.whole import PACKAGE, write_atomically
from stewart_drake.jit import fields, new_record, njit, record
from stewart_drake.mechanics.linear_algebra import copy_to
from stewart_drake.part import Part

NAMES = ("speed", "damping", "integral", "disturbance")
"""Of the numbers of a setting."""
SIZE = len(NAMES)
STEP = 0.03
"""[-] share of its box by which a setting moves in a tick, at most. By shares of a second a slow robot would jump, and
its loop can grow by that: docs/results/tuner_safety.md."""
FORMAT, VERSION = "stewart-drake policy", 1
FADE = 0.5
"""[-] what a feature may lie outside of the training data, in their standard deviations, until the answer has faded."""
LARGEST = 30.0
"""[-] features are held within it."""
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
def answer(policy: Any, heard: Any, wanted: Any) -> float:
    """The setting (4,) that a policy wants, of the record of `Layers`, for features (13,).

    Returns what of the answer is the policy's own: 1 within the training data, 0 far outside, where a feature that is
    not finite counts as being.
    """
    scaled, off = np.zeros(_COUNT), 0.0
    for k in range(_COUNT):
        if not np.isfinite(heard[k]):
            off = 2.0 * FADE
            continue
        value = min(max(heard[k], -LARGEST), LARGEST)
        beyond = max(policy.low[k] - value, value - policy.high[k])
        off = max(off, beyond / policy.feature_scale[k])
        scaled[k] = (value - policy.feature_mean[k]) / policy.feature_scale[k]
    own = min(max(1.0 - off / FADE, 0.0), 1.0)
    units = np.empty(policy.hidden_bias.size)
    for i in range(units.size):
        total = policy.hidden_bias[i]
        for k in range(_COUNT):
            total += policy.hidden[i, k] * scaled[k]
        units[i] = np.tanh(total)
    for m in range(SIZE):
        total = policy.output_bias[m]
        for i in range(units.size):
            total += policy.output[m, i] * units[i]
        reach = policy.below[m] if total < 0.0 else policy.above[m]
        wanted[m] = policy.centre[m] + reach * np.tanh(total) * own
    return own


@njit
def settle(setup: Any, wanted: Any, own: float, state: Any) -> None:
    """Moves the setting towards the one that is wanted, no more than a step, and says what it does."""
    for k in range(SIZE):
        change = wanted[k] - state.setting[k]
        state.setting[k] += min(max(change, -setup.step[k]), setup.step[k])
    state.setting[SIZE] = 1.0 - own
    copy_to(state.weights[:], weights_of(setup.weights[:], state.setting[:]))
    state.disturbance[0] = disturbance_of(setup.disturbance, state.setting[:])


@njit
def policy_tick(
    setups: Any, policies: Any, density: Any, error: Any, torque: Any, innovation: Any, reference: Any, states: Any
) -> None:
    """A tick of a policy; where what it hears is not finite, or absurd, the setting goes to the centre.

    Takes `SETUP`, the record of `Layers`, what `features` hears, and `TUNER_STATE` of the tick before, in place.
    """
    setup, state, heard, wanted, own = record(setups), record(states), np.empty(_COUNT), np.empty(SIZE), 0.0
    copy_to(wanted, setup.centre[:])
    if plausible(density, error, torque, innovation, reference):
        features(setup, density, error, torque, innovation, reference, state, heard)
        own = answer(record(policies), heard, wanted)
    settle(setup, wanted, own, state)


@njit
def schedule_tick(
    setups: Any, schedules: Any, density: Any, error: Any, torque: Any, innovation: Any, reference: Any, states: Any
) -> None:
    """A tick of a schedule, otherwise as `policy_tick`: alert while innovations are large, and for a while after."""
    setup, schedule, state, heard = record(setups), record(schedules), record(states), np.empty(_COUNT)
    if not plausible(density, error, torque, innovation, reference):
        state.held = 0.0
        settle(setup, setup.centre, 0.0, state)
        return
    features(setup, density, error, torque, innovation, reference, state, heard)
    loud = 10.0 ** heard[0] > schedule.threshold**2
    state.held = schedule.hold if loud else max(state.held - setup.period, 0.0)
    settle(setup, schedule.alert if loud or state.held > 0.0 else schedule.calm, 1.0, state)


# --- what wants a setting --------------------------------------------------------------------------------------------


class Chooser(Protocol):
    """What wants a setting: a law like `policy_tick`, a record for it, and a box with the setting at the start."""

    @property
    def law(self) -> Callable[..., None]: ...

    def numbers(self) -> np.ndarray: ...

    @property
    def centre(self) -> np.ndarray: ...

    @property
    def lowest(self) -> np.ndarray: ...

    @property
    def width(self) -> np.ndarray: ...


class Layers(NamedTuple):
    """A policy in arrays; h hidden units, which are tanh, and so are the outputs."""

    mean: np.ndarray  # (13,) subtracted from the features.
    scale: np.ndarray  # (13,) divides them afterwards; > 0. Zero weights and not this leave a feature out.
    hidden: np.ndarray  # (h, 13).
    hidden_bias: np.ndarray  # (h,).
    output: np.ndarray  # (4, h).
    output_bias: np.ndarray  # (4,).
    centre: np.ndarray  # (4,) setting in the middle of the box, the best fixed one.
    below: np.ndarray  # (4,) how far the box reaches below it; > 0.
    above: np.ndarray  # (4,) likewise above.
    low: np.ndarray  # (13,) least features of the training data.
    high: np.ndarray  # (13,) largest.


def _shapes(hidden: Any) -> dict[str, tuple[int, ...]]:
    """Of `Layers` with these hidden weights."""
    h = len(hidden) if isinstance(hidden, (list, np.ndarray)) else 0
    own = {"hidden": (h, _COUNT), "hidden_bias": (h,), "output": (SIZE, h)}
    small = dict.fromkeys(("output_bias", "centre", "below", "above"), (SIZE,))
    return dict.fromkeys(Layers._fields, (_COUNT,)) | own | small


@dataclass(frozen=True, eq=False)
class Policy:
    """A trained policy.

    Attributes:
        layers: Its numbers.
        provenance: Where it comes from: data, seeds, cost, date, figures, limits.

    Raises:
        ConfigurationError: Wrong shapes, numbers that are not finite, scales or a box that are not positive.
    """

    law: ClassVar[Callable[..., None]] = staticmethod(policy_tick)
    layers: Layers
    provenance: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        layers = Layers(**numbers(self.layers._asdict(), _shapes(self.layers.hidden), 1e6))
        object.__setattr__(self, "layers", layers)
        for name in ("scale", "below", "above"):
            if not (getattr(layers, name) > 0.0).all():
                raise ConfigurationError(name, getattr(layers, name).tolist(), "positive numbers")
        if not (layers.low <= layers.high).all():
            raise ConfigurationError("low", layers.low.tolist(), "at most `high`")

    @property
    def centre(self) -> np.ndarray:
        return self.layers.centre

    @property
    def lowest(self) -> np.ndarray:
        return self.centre - self.layers.below

    @property
    def width(self) -> np.ndarray:
        return self.layers.below + self.layers.above

    def numbers(self) -> np.ndarray:
        values = self.layers._asdict()
        # A record of numpy has a method `mean` already.
        values |= {"feature_mean": values.pop("mean"), "feature_scale": values.pop("scale")}
        return new_record(fields(**{name: np.shape(value) for name, value in values.items()}), **values)

    def to_bytes(self) -> bytes:
        """The policy as JSON with a checksum; the same policy gives the same bytes."""
        layers = {name: value.tolist() for name, value in self.layers._asdict().items()}
        return weights_bytes(FORMAT, VERSION, {"features": list(FEATURES), **layers, "provenance": self.provenance})

    def save(self, path: str | Path) -> None:
        write_atomically(Path(path), self.to_bytes())

    def box_rows(self) -> list[tuple[str, ...]]:
        """Under `BOX_HEADER`."""
        ends = self.lowest, self.centre, self.lowest + self.width
        return [(name, *(f"{each[k]:.3g}" for each in ends)) for k, name in enumerate(NAMES)]

    def facts(self) -> list[tuple[str, str]]:
        """Rows of two texts: what it is made of, then its provenance."""
        heard = [name for name, column in zip(FEATURES, self.layers.hidden.T, strict=True) if column.any()]
        card = {"inputs": ", ".join(heard) or "nothing", "hidden units": len(self.layers.hidden), **self.provenance}
        return [(name, value if isinstance(value, str) else json.dumps(value)) for name, value in card.items()]


def default_policy_path() -> Path:
    return PACKAGE / "weights" / "policy.json"


def load_policy(path: str | Path | None = None) -> Policy:
    """Reads a policy file; None takes the one that the package carries. Raises as `network.load_weights`."""

    def policy_of(content: dict[str, Any]) -> Policy:
        if content.get("features") != list(FEATURES):
            raise ConfigurationError("features", content.get("features"), f"{list(FEATURES)}")
        return Policy(Layers(*map(content.get, Layers._fields)), content["provenance"])  # type: ignore[arg-type]

    return load_weights(default_policy_path() if path is None else Path(path), FORMAT, VERSION, policy_of)


def setting_part(chooser: Chooser, context: Any, weights: np.ndarray, kappa: float = 0.0) -> Part:
    """A tuner of settings as a part of a loop, for a `part.Setup`: what a tick finds acts from the next one on.

    `weights` (4,) are those of the base; `kappa` [-] from stiff, -1, to quiet, 1: the scale of torque changes in the
    cost is divided by 10^kappa.
    """
    centre, scales = chooser.centre, CostScales()
    params = new_record(
        SETUP,
        context,
        length=context.robot.characteristic_length,
        kappa=kappa,
        rotation=math.radians(scales.rotation),
        position=1e-3 * scales.position,
        # The scale is for a millisecond.
        torque_change=1e3 * context.period * scales.torque_change,
        centre=centre,
        step=STEP * chooser.width,
        weights=weights,
    )
    initial = new_record(
        TUNER_STATE,
        weights=weights_of(np.asarray(weights, dtype=float), centre),
        disturbance=disturbance_of(context.disturbance, centre),
        setting=[*centre, 0.0],
        levels=[1.0, 1.0, 0.0, 0.0, 0.0],
    )

    constants = {"params": params, "source": chooser.numbers()}
    inputs = {"density": 12, "error": 6, "torque": 6, "innovation": 6, "reference": 18}
    outputs = ("weights", "disturbance", "setting")
    return Part("tuner", chooser.law, constants, inputs, outputs, initial, end_of_tick=True)
