"""Networks of one hidden layer, their weights files, and the paper's tuner, Fig. 5.

Inference needs no torch. Weights are in a JSON file with a checksum.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar, Self

import numpy as np

from stewart_drake.base.atomic_files import PACKAGE, Document, plain_json, read_checked, seal, unseal, write_atomically
from stewart_drake.base.config import Real, Window, check_value
from stewart_drake.base.errors import ConfigurationError, Status
from stewart_drake.base.jit import njit
from stewart_drake.base.records import Record, TickResult, Vec2, Vec12, Vector, record
from stewart_drake.control.features import DensityKind
from stewart_drake.loop.part import Part
from stewart_drake.mechanics.linear_algebra import all_finite

MAX_BYTES = 1_000_000  # Largest size of a weights file.


# --- any network -----------------------------------------------------------------------------------------------------


class MlpParams(Record):
    """Arrays of a network of n inputs, h hidden units, which are tanh, and m linear outputs."""

    input_mean: Annotated[np.ndarray, ("n",)]  # Subtracted from the inputs.
    input_scale: Annotated[np.ndarray, ("n",)]  # Divides them afterwards; > 0.
    hidden_weights: Annotated[np.ndarray, ("h", "n")]
    hidden_bias: Annotated[np.ndarray, ("h",)]
    output_weights: Annotated[np.ndarray, ("m", "h")]
    output_bias: Annotated[np.ndarray, ("m",)]


@njit
def forward(network: MlpParams, inputs: Vector, limit: float, out: Vector) -> None:
    """Outputs (m,) of a network for inputs (n,), which are limited to +-limit; NaN where one is NaN."""
    hidden = network.hidden_bias.copy()
    for k in range(inputs.size):
        value = inputs[k]
        if abs(value) > limit:
            value = limit if value > 0.0 else -limit
        scaled = (value - network.input_mean[k]) / network.input_scale[k]
        for i in range(hidden.size):
            hidden[i] += network.hidden_weights[i, k] * scaled
    for i in range(hidden.size):
        hidden[i] = np.tanh(hidden[i])
    for m in range(out.size):
        total = network.output_bias[m]
        for i in range(hidden.size):
            total += network.output_weights[m, i] * hidden[i]
        out[m] = total


@dataclass(frozen=True, eq=False)
class Mlp:
    """Base of networks with a weights file: the arrays of `MlpParams`, and their provenance (data, seeds, versions).

    A kind of network adds further arrays, and the header of its file.

    Raises:
        ConfigurationError: A wrong shape, numbers that are not finite or too large, scales that are not positive, a
            range whose ends are in the wrong order.
    """

    file_format: ClassVar[tuple[str, int]]
    """Name and version of its file."""
    shipped: ClassVar[Path]
    """The file that the package carries."""
    header: ClassVar[tuple[str, ...]]
    """Fields at the head of the file."""
    file_names: ClassVar[Mapping[str, str]] = {}
    """Field -> key in the file, where that differs."""
    largest: ClassVar[float]
    """Bound of all numbers; positive ones are above its reciprocal."""
    positive: ClassVar[tuple[str, ...]]
    ordered: ClassVar[tuple[str, str]]
    """Two arrays; the first is nowhere above the second."""
    record_type: ClassVar[type[MlpParams]]
    sizes: ClassVar[Mapping[str, int]]
    """Numbers of inputs n, outputs m and, if it is fixed, hidden units h."""
    input_mean: np.ndarray
    input_scale: np.ndarray
    hidden_weights: np.ndarray
    hidden_bias: np.ndarray
    output_weights: np.ndarray
    output_bias: np.ndarray
    provenance: Document = field(default_factory=dict, kw_only=True)

    def __post_init__(self) -> None:
        layout = self._sized().layout
        for name in self.record_type.fields:
            value, shape = getattr(self, name), layout[name].shape
            try:
                array = np.array(value)
            except ValueError:
                array = np.array(None)
            # Text, booleans and integers beyond 64 bits have other kinds; NaN fails the comparison.
            numbers = array.dtype.kind in "fi" and array.shape == shape and 0 not in shape
            if not numbers or not (np.abs(array) < self.largest).all():
                raise ConfigurationError(self._key(name), value, f"finite numbers of shape {shape}")
            object.__setattr__(self, name, array.astype(float))
        for name in self.positive:
            if not (getattr(self, name) > 1.0 / self.largest).all():
                raise ConfigurationError(self._key(name), getattr(self, name).tolist(), "positive numbers")
        low, high = self.ordered
        if not (getattr(self, low) <= getattr(self, high)).all():
            raise ConfigurationError(low, getattr(self, low).tolist(), f"at most {high}")

    def _sized(self) -> type[MlpParams]:
        h = len(self.hidden_weights) if isinstance(self.hidden_weights, (list, np.ndarray)) else 0
        return self.record_type.sized(**{"h": h, **self.sizes})

    def params(self) -> MlpParams:
        """Its arrays as a record, for `forward`."""
        return self._sized().new(self)

    def _key(self, name: str) -> str:
        return self.file_names.get(name, name)

    # --- the file ---

    def to_bytes(self) -> bytes:
        """The network as JSON with a checksum; the same network gives the same bytes."""
        kind, version = self.file_format
        content = {"format": kind, "version": version, **{name: getattr(self, name) for name in self.header}}
        content |= {self._key(name): getattr(self, name).tolist() for name in self.record_type.fields}
        content["provenance"] = plain_json(self.provenance)
        return (json.dumps(seal(content), indent=1) + "\n").encode()

    def save(self, path: str | Path) -> None:
        write_atomically(Path(path), self.to_bytes())

    @classmethod
    def load(cls, path: str | Path | None = None) -> Self:
        """Reads a weights file of this kind, None for the shipped one."""
        kind, version = cls.file_format
        key, content = _key_of(path or cls.shipped), cls.content(path)
        values = unseal(content, key, "`stewart-drake train`")
        if values.get("format") != kind:
            raise ConfigurationError(key, f"no {kind.partition(' ')[2]}", f'"format": "{kind}"')
        if values.get("version") != version:
            allowed = f"{version}; `stewart-drake train` makes a new one"
            raise ConfigurationError(f"{key}: version", values.get("version"), allowed)
        try:
            if not isinstance(values.setdefault("provenance", {}), dict):
                raise ConfigurationError("provenance", values["provenance"], "a mapping")
            names = [entry.name for entry in dataclasses.fields(cls)]
            arguments: Document = {name: values.get(cls.file_names.get(name, name)) for name in names}
            return cls(**arguments)
        except ConfigurationError as error:
            raise ConfigurationError(f"{key}: {error.key}", error.value, error.allowed) from None

    @classmethod
    def content(cls, path: str | Path | None = None) -> str:
        """Text of a weights file, None for the shipped one; not yet checked."""
        path = Path(path or cls.shipped)
        try:
            return read_checked(path, _key_of(path), MAX_BYTES).decode()
        except UnicodeDecodeError as error:
            raise ConfigurationError(_key_of(path), str(error), "a JSON document") from None


def _key_of(path: str | Path) -> str:
    return f"weights file {path}"


# --- that of the paper -----------------------------------------------------------------------------------------------

INPUTS, HIDDEN, OUTPUTS = 12, 10, 2
_LARGEST_DENSITY = 1e6
"""Limit of densities, which lie within +-(m + 1), so that products stay finite."""


class TunerNetworkParams(MlpParams):
    """Arrays of a `TunerNetwork`."""

    omega_min: Vec2  # Smallest omega_Q, omega_R of the training data; > 0.
    omega_max: Vec2  # Largest.


@dataclass(frozen=True, eq=False)
class TunerNetwork(Mlp):
    """A trained 12-10-2 network: densities in, log10 of omega_Q and omega_R out, so that no weight is negative.

    Deviation: the paper does not give the scale of its network's outputs.

    Attributes:
        density: Kind of density that the network was trained on.
        window: Window m of the training data [ticks].

    Raises:
        ConfigurationError: As `Mlp`; an unknown density, a window below 1.
    """

    file_format = ("stewart-drake tuner", 2)
    shipped = PACKAGE / "weights" / "tuner.json"
    header = ("density", "window")
    largest = 1e100  # Larger numbers, or their reciprocals, would overflow in the network.
    positive = ("input_scale", "omega_min", "omega_max")
    ordered = ("omega_min", "omega_max")
    record_type = TunerNetworkParams
    sizes: ClassVar = {"n": INPUTS, "h": HIDDEN, "m": OUTPUTS}
    omega_min: np.ndarray
    omega_max: np.ndarray
    density: DensityKind = "magnitude"
    window: int = 49

    def __post_init__(self) -> None:
        check_value("density", self.density, DensityKind)
        check_value("window", self.window, Window)
        super().__post_init__()

    def log_weights(self, densities: np.ndarray) -> np.ndarray:
        """Output (..., 2), log10 of omega_Q, omega_R, without limits, of densities (..., 12), for data sets."""
        return self._by_row(lambda network, row, out: forward(network, row, np.inf, out), densities)

    def weights(self, densities: np.ndarray) -> np.ndarray:
        """omega_Q, omega_R (..., 2) of densities (..., 12), see `network_weights`."""
        return self._by_row(network_weights, densities)

    def _by_row(self, kernel: Callable[..., None], densities: np.ndarray) -> np.ndarray:
        rows = np.ascontiguousarray(densities, dtype=float)
        results, network = np.empty((*rows.shape[:-1], OUTPUTS)), record(self.params())
        for row, out in zip(rows.reshape(-1, INPUTS), results.reshape(-1, OUTPUTS), strict=True):
            kernel(network, row, out)
        return results


def load_network(path: str | Path | None = None) -> TunerNetwork:
    """Reads a weights file, None for the one that the package carries.

    Raises:
        ConfigurationError: The file is missing, no weights file, corrupt, or of another version.
    """
    return TunerNetwork.load(path)


@njit
def network_weights(network: TunerNetworkParams, densities: Vec12, out: Vec2) -> None:
    """omega_Q and omega_R of a network, within the range of its training data; NaN where a density is NaN."""
    forward(network, densities, _LARGEST_DENSITY, out)
    for m in range(OUTPUTS):
        # Limited as a logarithm first: on wild inputs 10**x would overflow.
        low, high = network.omega_min[m], network.omega_max[m]
        if np.isfinite(out[m]):
            out[m] = min(max(10.0 ** min(max(out[m], np.log10(low)), np.log10(high)), low), high)


_STATUSES = {1: Status("not_finite", "density", text="density", numbers=slice(INPUTS))}


class NetworkState(Record):
    """State of the paper's tuner."""

    weights: Vec2  # omega_Q, omega_R


@njit
def network_tick(network: TunerNetworkParams, densities: Vec12, state: NetworkState) -> TickResult:
    """`network_weights` into a state; the status is 1 where a density is not finite."""
    network_weights(record(network), densities, record(state).weights)
    return 0 if all_finite(densities) else 1, -1, 0.0


def network_part(network: TunerNetwork, initial: Sequence[float]) -> Part:
    """The network as a part of a loop; its weights act from the next tick on.

    `initial` omega_Q, omega_R are clipped to the range that it was trained on.
    """
    check_value("initial", list(initial), tuple[Real, Real])
    first = NetworkState.new(weights=np.clip(initial, network.omega_min, network.omega_max))
    part = Part("tuner", network_tick, {}, {"density": INPUTS}, ("weights",), first, statuses=_STATUSES)
    return part._replace(end_of_tick=True, parameters={"network": network.params()})
