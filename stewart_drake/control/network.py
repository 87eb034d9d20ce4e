"""The tuner's neural network, Fig. 5: 12 densities in, one hidden layer of 10, omega_Q and omega_R out.

Inference is numpy alone, so that a controller needs no torch. Weights live in a JSON file: readable, diffable, no
pickle.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import numpy as np

from stewart_drake.control.density import DensityKind
from stewart_drake.errors import ConfigurationError, NotFiniteError
from stewart_drake.files.whole import PACKAGE, plain_json, read_checked, seal, unseal, write_atomically
from stewart_drake.sampling import Sampled
from stewart_drake.section import Real, Window, check_value

INPUTS, HIDDEN, OUTPUTS = 12, 10, 2
FORMAT = "stewart-drake tuner"
VERSION = 2
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
        for name, shape in _SHAPES.items():
            try:
                array = np.asarray(getattr(self, name), dtype=float)
            except (TypeError, ValueError):
                raise ConfigurationError(name, getattr(self, name), f"finite numbers of shape {shape}") from None
            object.__setattr__(self, name, array)
            # NaN is not below anything.
            if np.shape(array) != shape or not (np.abs(array) < _LARGEST_NUMBER).all():
                raise ConfigurationError(name, array.tolist(), f"finite numbers of shape {shape}")
        for name in ("input_scale", "omega_min", "omega_max"):
            if not (getattr(self, name) > 1.0 / _LARGEST_NUMBER).all():
                raise ConfigurationError(name, getattr(self, name).tolist(), "positive numbers")
        if not (self.omega_min <= self.omega_max).all():
            raise ConfigurationError("omega_min", self.omega_min.tolist(), "at most omega_max")

    def log_weights(self, densities: np.ndarray) -> np.ndarray:
        """Raw network output.

        Args:
            densities: (..., 12) [-], six of the errors, six of the torques.

        Returns:
            (..., 2) log10 of omega_Q, omega_R, not limited.
        """
        hidden = np.tanh((densities - self.input_mean) / self.input_scale @ self.hidden_weights.T + self.hidden_bias)
        return np.asarray(hidden @ self.output_weights.T + self.output_bias)

    def weights(self, densities: np.ndarray) -> np.ndarray:
        """omega_Q, omega_R, held within the range of the training data.

        Args:
            densities: (..., 12) [-].

        Returns:
            (..., 2), positive; NaN where a density is NaN.
        """
        # Limited before and as a logarithm: on wild inputs the layers or 10**x would overflow first.
        limited = np.clip(densities, -_LARGEST_DENSITY, _LARGEST_DENSITY)
        log = np.clip(self.log_weights(limited), np.log10(self.omega_min), np.log10(self.omega_max))
        return np.clip(10.0**log, self.omega_min, self.omega_max)

    def compiled_weights(self) -> Callable[[np.ndarray], np.ndarray]:
        """`weights` of one vector (12,), compiled by numba; NaN where a density is not finite."""
        # numba takes half a second to import, and compiles on first use.
        from stewart_drake.compiled.tuner import weights

        layers = np.zeros((HIDDEN + OUTPUTS, INPUTS + 1))
        layers[:HIDDEN, :INPUTS] = self.hidden_weights / self.input_scale
        layers[:HIDDEN, INPUTS] = self.hidden_bias - layers[:HIDDEN, :INPUTS] @ self.input_mean
        layers[HIDDEN:, :HIDDEN] = self.output_weights
        layers[HIDDEN:, HIDDEN:] = np.stack([self.output_bias, self.omega_min, self.omega_max], axis=1)

        def answer(densities: np.ndarray) -> np.ndarray:
            result = np.empty(OUTPUTS)
            weights(densities, layers, _LARGEST_DENSITY, result)
            return result

        return answer

    def to_bytes(self) -> bytes:
        """The network as JSON with a checksum; the same network gives the same bytes.

        Numbers of the provenance that are not finite become null, see `whole.plain_json`.
        """
        numbers = {name: getattr(self, name).tolist() for name in _SHAPES}
        content = {"density": self.density, "window": self.window, **numbers}
        return sealed(FORMAT, VERSION, content, self.provenance)

    def save(self, path: str | Path) -> None:
        """Writes `to_bytes` to a file.

        Raises:
            ConfigurationError: The folder is missing or not writable.
        """
        write_atomically(Path(path), self.to_bytes())


def network_part(network: TunerNetwork, initial: Sequence[float], compiled: bool) -> Sampled:
    """omega_Q and omega_R from densities (12,), tick by tick: what a tick finds acts from the next one on.

    Args:
        network: Trained.
        initial: omega_Q, omega_R at first, clipped to the range that it was trained on.
        compiled: See `Scenario.compiled`.

    Raises:
        ConfigurationError: `initial` is not two finite numbers.
    """
    check_value("initial", list(initial), tuple[Real, Real])
    answer = network.compiled_weights() if compiled else network.weights

    def tick(densities: np.ndarray, memory: np.ndarray) -> np.ndarray:  # noqa: ARG001 - it remembers nothing
        weights: np.ndarray = answer(densities)
        # The compiled network sees for itself whether all are finite.
        if not weights[0] > 0.0 or not (compiled or np.isfinite(densities).all()):
            raise NotFiniteError("density", densities)
        return weights

    return Sampled(np.clip(initial, network.omega_min, network.omega_max), tick)


def load_network(path: str | Path | None = None) -> TunerNetwork:
    """Reads a weights file.

    Args:
        path: File written by `TunerNetwork.save`; None takes the one that the package carries.

    Raises:
        ConfigurationError: See `read_weights`; wrong format, version, checksum or shape, numbers that are not finite or
            beyond 1e100, scales or ranges that are not positive.
    """
    path = default_network_path() if path is None else Path(path)
    key = f"weights file {path}"
    document = read_sealed(path, FORMAT, VERSION)
    provenance = document.get("provenance", {})
    if not isinstance(provenance, dict):
        raise ConfigurationError(f"{key}: provenance", provenance, "a mapping")
    try:
        arrays = {name: numbers(name, document.get(name), shape) for name, shape in _SHAPES.items()}
        kind, window = cast(DensityKind, document.get("density")), cast(int, document.get("window"))
        return TunerNetwork(**arrays, density=kind, window=window, provenance=provenance)
    except ConfigurationError as error:
        raise ConfigurationError(f"{key}: {error.key}", error.value, error.allowed) from None


def sealed(kind: str, version: int, content: dict[str, Any], provenance: dict[str, Any]) -> bytes:
    """A weights file of a kind and version, as JSON with a checksum, for `read_sealed`."""
    document = {"format": kind, "version": version, **content, "provenance": plain_json(provenance)}
    return (json.dumps(seal(document), indent=1) + "\n").encode()


def read_sealed(path: Path, kind: str, version: int) -> dict[str, Any]:
    """What a weights file of a kind and version holds.

    Raises:
        ConfigurationError: See `read_weights`; another kind or version, a checksum that does not fit.
    """
    key = f"weights file {path}"
    try:
        document = json.loads(read_weights(path))
    except (ValueError, RecursionError) as error:
        raise ConfigurationError(key, str(error), "a JSON document") from error
    if not isinstance(document, dict) or document.get("format") != kind:
        raise ConfigurationError(key, f"no {kind.partition(' ')[2]}", f'"format": "{kind}"')
    if document.get("version") != version:
        allowed = f"{version}; `stewart-drake train` makes a new one"
        raise ConfigurationError(f"{key}: version", document.get("version"), allowed)
    try:
        return unseal(document)
    except (ValueError, RecursionError) as error:
        raise ConfigurationError(key, str(error), "a file as `stewart-drake train` left it") from None


def read_weights(path: Path) -> str:
    """Text of a weights file, not yet looked at.

    Raises:
        ConfigurationError: Missing, unreadable, no regular file, larger than `MAX_BYTES`, or no text in UTF-8.
    """
    key = f"weights file {path}"
    try:
        return read_checked(path, key, MAX_BYTES).decode()
    except UnicodeDecodeError as error:
        raise ConfigurationError(key, str(error), "a JSON document") from None


def numbers(name: str, value: Any, shape: tuple[int, ...]) -> np.ndarray:
    """A list of numbers of a weights file as an array.

    Raises:
        ConfigurationError: It is none.
    """
    try:
        array = np.array(value)
    except ValueError:
        array = np.array(None)
    # Texts and integers beyond 64 bits come as other kinds.
    if array.dtype.kind not in "fi":
        raise ConfigurationError(name, value, f"finite numbers of shape {shape}")
    return array.astype(float)


def default_network_path() -> Path:
    """The trained tuner that the package carries."""
    return PACKAGE / "weights" / "tuner.json"
