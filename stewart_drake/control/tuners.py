"""Where the weights of the LQI come from: options of the tuners."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from stewart_drake.control.density import DensityKind
from stewart_drake.control.network import (
    TunerNetwork,
    default_network_path,
    load_network,
    network_part,
    read_weights,
)
from stewart_drake.control.robot_gains import INTEGRAL_WEIGHT, POSE_WEIGHT, RATE_WEIGHT
from stewart_drake.errors import ConfigurationError
from stewart_drake.sampling import Sampled
from stewart_drake.section import Positive, Section, Text, Window


class Tuner(Section, ABC, key="tuner"):
    """What every tuner has; what runs it, `registry.TUNERS.system`, gives weights for densities."""

    kind: str
    density: DensityKind = "magnitude"
    """Kind of density (35), (36); for a network, the one that it was trained on."""
    window: Annotated[Window, Field(le=100_000)] = 49
    """Window m of (35), (36) [ticks]; means run over m + 1 samples. A network works with any: a density has no unit of
    time."""

    @property
    @abstractmethod
    def weights(self) -> tuple[float, ...]:
        """Weights at the start, as the controller takes them."""

    @property
    def label(self) -> str:
        """What its weights are, for titles."""
        return "Weights, held fixed"

    def network(self) -> TunerNetwork | None:
        """The network that it asks, or None where the weights stay.

        Raises:
            ConfigurationError: Missing or corrupt file, trained on another kind of density, or first weights outside of
                the range that it was trained on.
        """
        return None

    def content(self) -> str | None:
        """Text of the file that it depends on, or None where there is none.

        Raises:
            ConfigurationError: It cannot be read.
        """
        return None


class PairTuner(Tuner):
    """What tuners of omega_Q and omega_R have."""

    kind: str
    omega_q: Positive = 1.0
    """omega_Q of (27); for a network, its value before the first inference."""
    omega_r: Positive = 1.0
    """omega_R of (27); for a network, its value before the first inference."""

    @property
    def weights(self) -> tuple[float, ...]:
        """Weights at the start, as the controller takes them."""
        return self.omega_q, self.omega_r


class FixedTuner(PairTuner):
    """Weights that stay as given; densities are logged all the same."""

    kind: Literal["fixed"] = "fixed"


class BlockTuner(Tuner):
    """Q = diag(q_pose I, q_rate I, q_integral I), R = r I, held as given; see `controller.weight_length`.

    The defaults are for the paper's robot; for any other a scenario scales them by what a torque does there, so that
    the loop is as fast. Where commands act later than after 5 ms it is slower in proportion.
    """

    kind: Literal["block"] = "block"
    q_pose: Annotated[Positive, POSE_WEIGHT] = 4.0e5
    """Weight of the pose's error."""
    q_rate: Annotated[Positive, RATE_WEIGHT] = 30.0
    """Weight of its rate."""
    q_integral: Annotated[Positive, INTEGRAL_WEIGHT] = 4.0e7
    """Weight of its integral."""
    r: Positive = 1.0
    """Weight of the torques."""

    @property
    def weights(self) -> tuple[float, ...]:
        """Weights as the controller takes them."""
        return self.q_pose, self.q_rate, self.q_integral, self.r


class AnnTuner(PairTuner):
    """Weights from the paper's neural network, Fig. 5; `systems.AnnTuner` is the LeafSystem that runs it."""

    kind: Literal["paper"] = "paper"
    weights_file: Text | None = None
    """Path of a trained network, relative to the scenario file; null takes the one of the package."""

    @property
    def label(self) -> str:
        """See `Tuner.label`."""
        return "Output of the ANN"

    def network(self) -> TunerNetwork:
        """See `Tuner.network`."""
        path = self.weights_file or default_network_path()
        network = load_network(path)
        if network.density != self.density:
            raise ConfigurationError("tuner.density", self.density, f"{network.density}, as {path} was trained on")
        for key, value, low, high in zip(
            ("omega_q", "omega_r"), self.weights, network.omega_min, network.omega_max, strict=True
        ):
            if not low <= value <= high:
                raise ConfigurationError(f"tuner.{key}", value, f"{low:g} to {high:g}, as {path} was trained on")
        return network

    def content(self) -> str:
        """See `Tuner.content`."""
        return read_weights(default_network_path() if self.weights_file is None else Path(self.weights_file))


def held_weights(options: Tuner, compiled: bool) -> Sampled:  # noqa: ARG001 - nothing to compile
    """Weights that stay, whatever the densities."""
    return Sampled(np.array(options.weights), lambda densities, weights: weights)  # noqa: ARG005


def asked_weights(options: AnnTuner, compiled: bool) -> Sampled:
    """Weights of the network, see `network_part`."""
    return network_part(options.network(), options.weights, compiled)
