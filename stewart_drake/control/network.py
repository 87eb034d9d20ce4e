"""The tuner's neural network, Fig. 5, and the densities (35), (36) that it hears; weights files.

12 densities in, one hidden layer of 10, omega_Q and omega_R out. A density says how far a sample stands out from its
recent mean. Inference needs no torch. Weights live in a JSON file with a checksum: readable, diffable, no pickle.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np

from stewart_drake.config import Real, Window, check_value
from stewart_drake.errors import ConfigurationError, NotFiniteError
from stewart_drake.files.whole import PACKAGE, plain_json, read_checked, seal, unseal, write_atomically
from stewart_drake.jit import fields, new_record, njit, record
from stewart_drake.mechanics.linear_algebra import all_finite, copy_to
from stewart_drake.part import Part

DensityKind = Literal["magnitude", "signed"]

MEAN_FLOOR = 1e-9
"""Window means below this, in the signal's unit, count as zero; the density is 1 there."""


@njit
def density_of(samples: Any, signed: bool, out: Any) -> None:
    """Densities (k,) [-] of the last sample of a window (n, k), oldest first, n <= m + 1 (fewer while it fills).

    (35), (36), `signed`: x over the window's mean. Deviation: the print is singular where the signed sum crosses zero;
    the result is held within +-n there. Close to it the quotient is ill-conditioned: rounding errors of the samples
    decide it. Else |x| over the window's mean |x|, which lies in [0, n] by itself and is well-conditioned.
    """
    count = samples.shape[0]
    for k in range(samples.shape[1]):
        total, last = 0.0, samples[count - 1, k]
        for row in range(count):
            total += samples[row, k] if signed else abs(samples[row, k])
        mean, value = total / count, last if signed else abs(last)
        out[k] = 1.0 if abs(mean) < MEAN_FLOOR else min(max(value / mean, -count), count)


@njit
def density_tick(window: Any, filled: Any, error: Any, torque: Any, signed: bool, out: Any) -> None:
    """`density_of` an error (6,) [rad, m] and a torque (6,) [N m] that slide into a window (m + 1, 12), oldest first.

    The last `filled` (1,) rows mean something. out: (12,) [-], of the errors, then of the torques.
    """
    rows = window.shape[0]
    for row in range(rows - 1):
        copy_to(window[row], window[row + 1])
    copy_to(window[rows - 1, :6], error)
    copy_to(window[rows - 1, 6:], torque)
    filled[0] = min(filled[0] + 1.0, float(rows))
    density_of(window[rows - int(filled[0]) :], signed, out)


def density(samples: np.ndarray, kind: DensityKind = "magnitude") -> np.ndarray:
    """`density_of` a window (n, k), oldest first."""
    check_value("density", kind, DensityKind)
    values = np.ascontiguousarray(samples, dtype=float)
    out = np.empty(values.shape[1])
    density_of(values, kind == "signed", out)
    return out


def density_part(window: int, kind: DensityKind) -> Part:
    """Densities of errors and torques over a window of m ticks as a part of a loop."""
    check_value("window", window, Window)
    check_value("density", kind, DensityKind)
    constants, inputs = {"signed": kind == "signed"}, {"error": 6, "torque": 6}
    initial = new_record(fields(density=12, filled=(), window=(window + 1, 12)), density=1.0)
    return Part("density", _density_tick, constants, inputs, ("density",), initial)


def _density_tick(signed: bool, error: np.ndarray, torque: np.ndarray, state: np.ndarray) -> None:
    # Field by field: a record with the window in it would have to be compiled for each length.
    density_tick(state["window"][0], state["filled"], error, torque, signed, state["density"][0])


INPUTS, HIDDEN, OUTPUTS = 12, 10, 2
FORMAT, VERSION = "stewart-drake tuner", 2
MAX_BYTES = 1_000_000
"""Of a weights file."""
_LARGEST_DENSITY = 1e6
"""Densities lie within +-(m + 1); anything beyond this is as good as it, and products of it stay finite."""
_LARGEST_NUMBER = 1e100
"""Numbers of a weights file beyond this, or their reciprocals, would overflow on the way through the network."""
_SHAPES: dict[str, tuple[int, ...]] = {
    "input_mean": (INPUTS,),
    "input_scale": (INPUTS,),
    "hidden_weights": (HIDDEN, INPUTS),
    "hidden_bias": (HIDDEN,),
    "output_weights": (OUTPUTS, HIDDEN),
    "output_bias": (OUTPUTS,),
    "omega_min": (OUTPUTS,),
    "omega_max": (OUTPUTS,),
}
_NETWORK, _NETWORK_STATE = fields(**_SHAPES), fields(weights=OUTPUTS)
_Read = TypeVar("_Read")


# --- weights files ---------------------------------------------------------------------------------------------------


def numbers(values: Mapping[str, Any], shapes: Mapping[str, tuple[int, ...]], largest: float) -> dict[str, np.ndarray]:
    """Values by name as arrays of these shapes; refuses one that is missing, of other shape or kind, or too large."""
    arrays = {}
    for name, shape in shapes.items():
        value = values.get(name)
        try:
            array = np.array(value)
        except ValueError:
            array = np.array(None)
        # Texts, truth values and integers beyond 64 bits come as other kinds; NaN is not below anything.
        if array.dtype.kind not in "fi" or array.shape != shape or 0 in shape or not (np.abs(array) < largest).all():
            raise ConfigurationError(name, value, f"finite numbers of shape {shape}")
        arrays[name] = array.astype(float)
    return arrays


def weights_bytes(kind: str, version: int, content: dict[str, Any]) -> bytes:
    """A weights file, as JSON with a checksum, for `load_weights`; numbers of its provenance may be not finite."""
    plain = {**content, "provenance": plain_json(content["provenance"])}
    return (json.dumps(seal({"format": kind, "version": version, **plain}), indent=1) + "\n").encode()


def load_weights(path: Path, kind: str, version: int, build: Callable[[dict[str, Any]], _Read]) -> _Read:
    """What `build` makes of the content of a weights file of a kind and version; errors name the path."""
    key = f"weights file {path}"
    content = unseal(read_weights(path), key, "`stewart-drake train`")
    if content.get("format") != kind:
        raise ConfigurationError(key, f"no {kind.partition(' ')[2]}", f'"format": "{kind}"')
    if content.get("version") != version:
        allowed = f"{version}; `stewart-drake train` makes a new one"
        raise ConfigurationError(f"{key}: version", content.get("version"), allowed)
    try:
        provenance = content.get("provenance", {})
        if not isinstance(provenance, dict):
            raise ConfigurationError("provenance", provenance, "a mapping")
        return build({"provenance": {}, **content})
    except ConfigurationError as error:
        raise ConfigurationError(f"{key}: {error.key}", error.value, error.allowed) from None


def read_weights(path: Path) -> str:
    """Text of a weights file, not yet looked at."""
    key = f"weights file {path}"
    try:
        return read_checked(path, key, MAX_BYTES).decode()
    except UnicodeDecodeError as error:
        raise ConfigurationError(key, str(error), "a JSON document") from None


# --- the network -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class TunerNetwork:
    """A trained 12-10-2 network.

    Outputs are log10 of the weights, so that a weight cannot come out negative. Deviation: the paper does not say in
    which scale its network answers.

    Attributes:
        input_mean: (12,) [-] subtracted from the densities.
        input_scale: (12,) [-] divides them afterwards; > 0.
        hidden_weights: (10, 12). hidden_bias: (10,). Hidden units are tanh.
        output_weights: (2, 10). output_bias: (2,). log10 of omega_Q, omega_R.
        omega_min: (2,) smallest omega_Q, omega_R of the training data; > 0.
        omega_max: (2,) largest.
        density: Kind of density that the network was trained on.
        window: Window m of the training data [ticks].
        provenance: Where the weights come from: data, seeds, versions.

    Raises:
        ConfigurationError: A wrong shape, numbers that are not finite or beyond 1e100, scales or ranges that are not
            positive, an unknown density, a window below 1.
    """

    input_mean: np.ndarray
    input_scale: np.ndarray
    hidden_weights: np.ndarray
    hidden_bias: np.ndarray
    output_weights: np.ndarray
    output_bias: np.ndarray
    omega_min: np.ndarray
    omega_max: np.ndarray
    density: DensityKind = "magnitude"
    window: int = 49
    provenance: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_value("density", self.density, DensityKind)
        check_value("window", self.window, Window)
        for name, array in numbers(vars(self), _SHAPES, _LARGEST_NUMBER).items():
            object.__setattr__(self, name, array)
        for name in ("input_scale", "omega_min", "omega_max"):
            if not (getattr(self, name) > 1.0 / _LARGEST_NUMBER).all():
                raise ConfigurationError(name, getattr(self, name).tolist(), "positive numbers")
        if not (self.omega_min <= self.omega_max).all():
            raise ConfigurationError("omega_min", self.omega_min.tolist(), "at most omega_max")

    def log_weights(self, densities: np.ndarray) -> np.ndarray:
        """Raw output (..., 2), log10 of omega_Q, omega_R, not limited, of densities (..., 12), for data sets."""
        hidden = np.tanh((densities - self.input_mean) / self.input_scale @ self.hidden_weights.T + self.hidden_bias)
        return np.asarray(hidden @ self.output_weights.T + self.output_bias)

    def weights(self, densities: np.ndarray) -> np.ndarray:
        """omega_Q, omega_R (..., 2) of densities (..., 12), see `network_weights`."""
        rows = np.ascontiguousarray(densities, dtype=float)
        answers, own = np.empty((*rows.shape[:-1], OUTPUTS)), new_record(_NETWORK, self)
        for row, out in zip(rows.reshape(-1, INPUTS), answers.reshape(-1, OUTPUTS), strict=True):
            network_weights(own, row, out)
        return answers

    def to_bytes(self) -> bytes:
        """The network as JSON with a checksum; the same network gives the same bytes."""
        arrays = {name: getattr(self, name).tolist() for name in _SHAPES}
        content = {"density": self.density, "window": self.window, **arrays, "provenance": self.provenance}
        return weights_bytes(FORMAT, VERSION, content)

    def save(self, path: str | Path) -> None:
        write_atomically(Path(path), self.to_bytes())


def load_network(path: str | Path | None = None) -> TunerNetwork:
    """Reads a weights file.

    Args:
        path: File written by `TunerNetwork.save`; None takes the one that the package carries.

    Raises:
        ConfigurationError: The file is missing, no weights file, corrupt, or not of this version.
    """

    def network_of(content: Any) -> TunerNetwork:
        return TunerNetwork(**{name: content.get(name) for name in (*_SHAPES, "density", "window", "provenance")})

    return load_weights(default_network_path() if path is None else Path(path), FORMAT, VERSION, network_of)


def default_network_path() -> Path:
    return PACKAGE / "weights" / "tuner.json"


@njit
def network_weights(networks: Any, densities: Any, out: Any) -> None:
    """omega_Q and omega_R (2,) of the record of a network for densities (12,), held within its training's range.

    NaN where a density is NaN.
    """
    network = record(networks)
    hidden = network.hidden_bias.copy()
    for k in range(INPUTS):
        # Limited: the layers would overflow. NaN stays.
        density = densities[k]
        if abs(density) > _LARGEST_DENSITY:
            density = _LARGEST_DENSITY if density > 0.0 else -_LARGEST_DENSITY
        scaled = (density - network.input_mean[k]) / network.input_scale[k]
        for i in range(HIDDEN):
            hidden[i] += network.hidden_weights[i, k] * scaled
    hidden = np.tanh(hidden)
    for m in range(OUTPUTS):
        log = network.output_bias[m]
        for i in range(HIDDEN):
            log += network.output_weights[m, i] * hidden[i]
        # Limited as a logarithm first: on wild inputs 10**x would overflow.
        low, high = network.omega_min[m], network.omega_max[m]
        out[m] = log
        if np.isfinite(log):
            out[m] = min(max(10.0 ** min(max(log, np.log10(low)), np.log10(high)), low), high)


@njit
def network_tick(networks: Any, densities: Any, states: Any) -> tuple[int]:
    """`network_weights` into a state; the status is 1 where a density is not finite."""
    network_weights(networks, densities, record(states).weights)
    return (0 if all_finite(densities) else 1,)


def network_part(network: TunerNetwork, initial: Sequence[float]) -> Part:
    """The network as a part of a loop: what a tick finds acts from the next one on.

    `initial` omega_Q, omega_R are clipped to the range that it was trained on.
    """
    check_value("initial", list(initial), tuple[Real, Real])
    first = new_record(_NETWORK_STATE, weights=np.clip(initial, network.omega_min, network.omega_max))
    constants, inputs = {"network": new_record(_NETWORK, network)}, {"density": INPUTS}
    return Part("tuner", network_tick, constants, inputs, ("weights",), first, error=_network_error, end_of_tick=True)


def _network_error(_: Any, arguments: Mapping[str, Any]) -> NotFiniteError:
    return NotFiniteError("density", arguments["density"].copy())
