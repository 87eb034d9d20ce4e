"""Tuners of settings: a network, or two settings and a threshold; from what they hear to weights and disturbance.

Whatever they want, a setting stays within a box and moves by a small share of it in a tick; where what they hear lies
outside of what a network was trained on, its answer fades to the middle of the box, the best fixed setting.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from stewart_drake.compiled.constants import TUNER_MEMORY
from stewart_drake.control.features import FEATURES, Site, flat_features, nothing_yet
from stewart_drake.control.network import numbers, read_sealed, sealed
from stewart_drake.control.settings import SIZE, STEP, disturbance_of, weights_of
from stewart_drake.errors import ConfigurationError
from stewart_drake.files.whole import PACKAGE, write_atomically
from stewart_drake.mechanics.arrays import Array, namespace
from stewart_drake.sampling import Sampled

FORMAT = "stewart-drake policy"
VERSION = 1
FADE = 0.5
"""[-] what a feature may lie outside of the training data, in their standard deviations, until the answer has faded."""
LARGEST = 30.0
"""[-] features are held within it."""
_ABSURD = 1e9
"""What is heard is below it, in any unit; squares of it stay finite."""
_M = TUNER_MEMORY
_COUNT = len(FEATURES)


class Layers(NamedTuple):
    """A policy in arrays of numpy or torch; h hidden units. Each loop may have weights of its own, (..., h, 13).

    Attributes:
        mean: (13,) subtracted from the features.
        scale: (13,) divides them afterwards; > 0. Zero weights and not this leave a feature out.
        hidden: (h, 13). hidden_bias: (h,). Hidden units are tanh.
        output: (4, h). output_bias: (4,). Outputs too.
        centre: (4,) setting in the middle of the box, the best fixed one.
        below: (4,) how far the box reaches below it; > 0.
        above: (4,) likewise above.
        low: (13,) least features of the training data.
        high: (13,) largest.
    """

    mean: Array
    scale: Array
    hidden: Array
    hidden_bias: Array
    output: Array
    output_bias: Array
    centre: Array
    below: Array
    above: Array
    low: Array
    high: Array


def answer(layers: Layers, found: Array, leak: float = 0.0) -> tuple[Array, Array]:
    """Setting (..., 4) that a policy wants, and what of its own it is (...): 1 within the training data, 0 far outside.

    Args:
        layers: See there.
        found: (..., 13) features; one that is not finite counts as far outside.
        leak: [-] for training in torch: slope that a gradient finds at the ends of the box, where there is none, in
            units of that in the middle.
    """
    xp = namespace(found)
    known = xp.isfinite(found)
    given = xp.where(known, xp.clip(found, -LARGEST, LARGEST), layers.mean)
    off = xp.maximum(layers.low - given, given - layers.high) / layers.scale
    off = xp.where(known, off, 2.0 * FADE)
    own = xp.clip(1.0 - xp.max(off, axis=-1) / FADE, 0.0, 1.0)
    scaled = (given - layers.mean) / layers.scale
    hidden = xp.tanh((layers.hidden @ scaled[..., None])[..., 0] + layers.hidden_bias)
    pressed = (layers.output @ hidden[..., None])[..., 0] + layers.output_bias
    turned = xp.tanh(pressed)
    if leak:
        turned = turned + leak * (pressed - pressed.detach())
    reach = xp.where(turned > 0.0, layers.above, layers.below)
    return layers.centre + reach * turned * own[..., None], own


def limited(wanted: Array, before: Array, step: Array) -> Array:
    """Settings (..., 4) on their way from `before` to `wanted`, no more than `step` (4,) further."""
    return before + namespace(wanted).clip(wanted - before, -step, step)


@dataclass(frozen=True, eq=False)
class Policy:
    """A trained policy.

    Attributes:
        layers: In numpy.
        provenance: Where it comes from: data, seeds, cost, date, figures, limits.

    Raises:
        ConfigurationError: Wrong shapes, numbers that are not finite, scales or a box that are not positive.
    """

    layers: Layers
    provenance: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        hidden = np.asarray(self.layers.hidden).shape[0] if np.ndim(self.layers.hidden) == 2 else 0
        for name, value in self.layers._asdict().items():
            shape = _shape(name, hidden)
            array = np.asarray(value, dtype=float)
            if array.shape != shape or 0 in shape or not (np.abs(array) < 1e6).all():
                raise ConfigurationError(name, value, f"finite numbers of shape {shape}")
        for name in ("scale", "below", "above"):
            if not (getattr(self.layers, name) > 0.0).all():
                raise ConfigurationError(name, getattr(self.layers, name).tolist(), "positive numbers")
        if not (self.layers.low <= self.layers.high).all():
            raise ConfigurationError("low", self.layers.low.tolist(), "at most `high`")

    @property
    def centre(self) -> np.ndarray:
        """(4,) setting at the start."""
        return np.asarray(self.layers.centre)

    @property
    def lowest(self) -> np.ndarray:
        """(4,) lower end of the box."""
        return self.centre - np.asarray(self.layers.below)

    @property
    def width(self) -> np.ndarray:
        """(4,) of the box."""
        return np.asarray(self.layers.below) + np.asarray(self.layers.above)

    def choose(self, found: np.ndarray, held: float, period: float) -> tuple[np.ndarray, float, float]:  # noqa: ARG002
        """See `Chooser`."""
        wanted, own = answer(self.layers, found)
        return wanted, float(own), held

    def compiled(self) -> Chooser:
        """See `Chooser`."""
        return _Compiled(self)

    def to_bytes(self) -> bytes:
        """The policy as JSON with a checksum; the same policy gives the same bytes."""
        layers = {name: np.asarray(value).tolist() for name, value in self.layers._asdict().items()}
        content = {"features": list(FEATURES), **layers}
        return sealed(FORMAT, VERSION, content, self.provenance)

    def save(self, path: str | Path) -> None:
        """Writes `to_bytes` to a file.

        Raises:
            ConfigurationError: The folder is missing or not writable.
        """
        write_atomically(Path(path), self.to_bytes())


def _shape(name: str, hidden: int) -> tuple[int, ...]:
    return {
        "hidden": (hidden, _COUNT),
        "hidden_bias": (hidden,),
        "output": (SIZE, hidden),
        "output_bias": (SIZE,),
        "centre": (SIZE,),
        "below": (SIZE,),
        "above": (SIZE,),
    }.get(name, (_COUNT,))


def default_policy_path() -> Path:
    """The policy that the package carries."""
    return PACKAGE / "weights" / "policy.json"


def load_policy(path: str | Path | None = None) -> Policy:
    """Reads a policy file.

    Args:
        path: File written by `Policy.save`; None takes the one that the package carries.

    Raises:
        ConfigurationError: See `network.read_sealed`; other features than ours, wrong shapes or numbers.
    """
    path = default_policy_path() if path is None else Path(path)
    document = read_sealed(path, FORMAT, VERSION)
    key = f"weights file {path}"
    if document.get("features") != list(FEATURES):
        raise ConfigurationError(f"{key}: features", document.get("features"), f"{list(FEATURES)}")
    try:
        hidden = document.get("hidden")
        units = len(hidden) if isinstance(hidden, list) else 0
        layers = Layers(*(numbers(name, document.get(name), _shape(name, units)) for name in Layers._fields))
        provenance = document.get("provenance", {})
        if not isinstance(provenance, dict):
            raise ConfigurationError("provenance", provenance, "a mapping")
        return Policy(layers, provenance)
    except ConfigurationError as error:
        raise ConfigurationError(f"{key}: {error.key}", error.value, error.allowed) from None


@dataclass(frozen=True, eq=False)
class Schedule:
    """Two settings: one while readings are as expected, one when they are not and for a while after.

    Attributes:
        calm: (4,) setting.
        alert: (4,) setting.
        threshold: [-] of the surprise, RMS of innovations over the noise of a reading.
        hold: [s] that the second one stays.
    """

    calm: np.ndarray
    alert: np.ndarray
    threshold: float
    hold: float

    @property
    def centre(self) -> np.ndarray:
        """(4,) setting at the start."""
        return self.calm

    @property
    def lowest(self) -> np.ndarray:
        """(4,) lower end of the box."""
        return np.minimum(self.calm, self.alert)

    @property
    def width(self) -> np.ndarray:
        """(4,) of the smallest box that has both."""
        return np.abs(self.alert - self.calm)

    def choose(self, found: np.ndarray, held: float, period: float) -> tuple[np.ndarray, float, float]:
        """See `Chooser`."""
        surprised = 10.0 ** found[0] > self.threshold**2
        held = self.hold if surprised else max(held - period, 0.0)
        return self.alert if surprised or held > 0.0 else self.calm, 1.0, held

    def compiled(self) -> Chooser:
        """See `Chooser`."""
        return self


class Chooser(Protocol):
    """What wants a setting."""

    @property
    def centre(self) -> np.ndarray:
        """(4,) setting at the start."""

    @property
    def lowest(self) -> np.ndarray:
        """(4,) lower end of the box."""

    @property
    def width(self) -> np.ndarray:
        """(4,) of the box."""

    def choose(self, found: np.ndarray, held: float, period: float) -> tuple[np.ndarray, float, float]:
        """The setting (4,) for features (13,), what of it is its own, and a number that it remembers."""

    def compiled(self) -> Chooser:
        """The same, by numba where that pays."""


class _Compiled:
    """A policy by numba."""

    def __init__(self, policy: Policy) -> None:
        # numba takes half a second to import, and compiles on first use.
        from stewart_drake.compiled.policy import answer as fast

        own = policy.layers
        hidden = np.concatenate([own.hidden, own.hidden_bias[:, None]], axis=1)
        output = np.concatenate([own.output, own.output_bias[:, None]], axis=1)
        stats, box = np.stack([own.mean, own.scale, own.low, own.high]), np.stack([own.centre, own.below, own.above])
        self._fast, self._fixed = fast, (stats, hidden, output, box, LARGEST, FADE)
        self.centre, self.lowest, self.width = policy.centre, policy.lowest, policy.width

    def choose(self, found: np.ndarray, held: float, period: float) -> tuple[np.ndarray, float, float]:  # noqa: ARG002
        """See `Chooser`."""
        wanted = np.empty(SIZE)
        return wanted, self._fast(*self._fixed, found, wanted), held

    def compiled(self) -> Chooser:
        """See `Chooser`."""
        return self


def setting_part(
    chooser: Chooser, site: Site, weights: np.ndarray, disturbance: float, compiled: bool = False
) -> Sampled:
    """A tuner of settings as a part of a loop: what a tick finds acts from the next one on.

    Args:
        chooser: What wants a setting.
        site: What it is built for.
        weights: (4,) those of the base.
        disturbance: [rad/s^2 per sqrt(s)] that of the base.
        compiled: See `Scenario.compiled`.

    Returns:
        Its tick takes densities (12,), error (6,), torque (6,), innovation (6,), reference (18,) and memory. Where one
        of them is not finite, or absurd, the setting goes to the centre.
    """
    step = STEP * chooser.width
    hear, say = flat_features(site, compiled), _saying(weights, disturbance, step, compiled)
    chooser = chooser.compiled() if compiled else chooser

    def tick(*given: np.ndarray) -> np.ndarray:
        memory, result = given[-1], np.empty(_M.size)
        recent, own, held, wanted = memory[_M.recent : _M.held], 0.0, 0.0, chooser.centre
        if np.abs(np.concatenate(given[:-1])).max() < _ABSURD:
            found, recent = hear(*given[:-1], recent)
            wanted, own, held = chooser.choose(found, float(memory[_M.held]), site.period)
        say(wanted, memory, result)
        result[_M.outside], result[_M.recent : _M.held], result[_M.held] = 1.0 - own, recent, held
        return result

    first = np.zeros(_M.size)
    first[_M.setting : _M.outside], first[_M.recent : _M.held] = chooser.centre, nothing_yet(np.zeros(6)).flat()
    say(chooser.centre, first.copy(), first)
    return Sampled(first, tick)


def _saying(
    weights: np.ndarray, disturbance: float, step: np.ndarray, compiled: bool
) -> Callable[[np.ndarray, np.ndarray, np.ndarray], None]:
    """From the setting that is wanted and the memory before to weights, disturbance and setting in the one after."""
    if compiled:
        from stewart_drake.compiled.policy import settle

        return lambda wanted, before, result: settle(wanted, step, weights, disturbance, before, result)

    def say(wanted: np.ndarray, before: np.ndarray, result: np.ndarray) -> None:
        setting = limited(wanted, before[_M.setting : _M.outside], step)
        result[: _M.disturbance], result[_M.disturbance] = (
            weights_of(weights, setting),
            disturbance_of(disturbance, setting),
        )
        result[_M.setting : _M.outside] = setting

    return say
