"""Options of the tuners, which give the LQI its weights."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from copy import copy
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, PrivateAttr

from stewart_drake.base.config import NotNegative, Period, Positive, Real, Section, Text, Window
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.control.base import INTEGRAL_WEIGHT, POSE_WEIGHT, RATE_WEIGHT
from stewart_drake.control.features import DensityKind, density_part
from stewart_drake.control.network import TunerNetwork, network_part
from stewart_drake.control.policy import (
    Policy,
    Schedule,
    SettingSource,
    schedule_tick,
    setting_part,
    weights_of,
)
from stewart_drake.loop.part import LoopContext, Part

Decades = Annotated[Real, Field(ge=-3.0, le=3.0)]


class Tuner(Section, ABC, key="tuner"):
    """Base of the options of tuners."""

    label: ClassVar[str] = "Weights, held fixed"
    """Source of the weights, for titles."""
    needs_observer: ClassVar[bool] = False
    """Whether it needs the innovations of an observer."""
    kind: str
    period: Period | None = None
    """[s] between two decisions, a whole multiple of controller.period; null takes controller.period."""
    density: DensityKind = "magnitude"
    """Kind of density (35), (36) that is computed and logged; for a network, the one that it was trained on."""
    window: Annotated[Window, Field(le=100_000)] = 49
    """[ticks] window m of (35), (36); means run over m + 1 samples. A network works with any window, because a density
    has no unit of time."""

    @property
    @abstractmethod
    def weights(self) -> tuple[float, ...]:
        """Weights at the start, in the form of the controller: (omega_Q, omega_R), or the four block weights."""

    def density_part(self) -> Part:
        """The part of the densities, which are always logged."""
        return density_part(self.window, self.density)

    def parts(self, context: LoopContext) -> tuple[Part, ...]:  # noqa: ARG002 - nothing depends on it here
        """The parts that change the weights; none if they are constant."""
        return ()

    def opened(self) -> Self:
        """A copy that has read its file of weights, if any, so that the file is read only once."""
        return self

    def network(self) -> TunerNetwork | None:
        """Its network; None if the weights are constant."""
        return None

    def content(self) -> str | None:
        """Text of its file; None without one."""
        return None


class PairTuner(Tuner):
    """Base of tuners of omega_Q and omega_R."""

    omega_q: Positive = 1.0
    """Weight omega_Q of (27); for a network, its value before the first inference."""
    omega_r: Positive = 1.0
    """Weight omega_R of (27); for a network, its value before the first inference."""

    @property
    def weights(self) -> tuple[float, ...]:
        return self.omega_q, self.omega_r


class FixedTuner(PairTuner):
    """Constant weights omega_Q and omega_R; densities are logged too."""

    knobs = (("omega_q", "weight Q"), ("omega_r", "weight R"))
    kind: Literal["fixed"] = "fixed"


class BlockWeights(Tuner):
    """Base of tuners of block weights: Q = diag(q_pose I, q_rate I, q_integral I), R = r I.

    The defaults are for the paper's robot. A scenario scales them to another robot by its acceleration per torque, so
    that its loop is as fast as that of the paper's robot. A command delay above 5 ms makes the loop slower, in
    proportion to the delay.
    """

    q_pose: Annotated[Positive, POSE_WEIGHT] = 4.0e5
    """Weight of the pose error."""
    q_rate: Annotated[Positive, RATE_WEIGHT] = 30.0
    """Weight of the rate of the pose error."""
    q_integral: Annotated[Positive, INTEGRAL_WEIGHT] = 4.0e7
    """Weight of the integral of the pose error."""
    r: Positive = 1.0
    """Weight of the torques."""

    @property
    def weights(self) -> tuple[float, ...]:
        return self.q_pose, self.q_rate, self.q_integral, self.r


class BlockTuner(BlockWeights):
    """Constant block weights; `controller.weight_length` converts rotations to lengths."""

    knobs = (("q_pose", "weight: pose"), ("q_rate", "weight: rate"), ("q_integral", "weight: integral"))
    kind: Literal["block"] = "block"


class PaperTuner(PairTuner):
    """Weights from the paper's neural network, Fig. 5."""

    label: ClassVar[str] = "Output of the ANN"
    kind: Literal["paper"] = "paper"
    weights_file: Text | None = None
    """File of a trained network, relative to the scenario file; null takes the package's."""

    def network(self) -> TunerNetwork:
        """Its network.

        Raises a ConfigurationError for a network that was trained on another kind of density, or on a range of weights
        without the initial ones.
        """
        path = self.weights_file or TunerNetwork.shipped
        network = TunerNetwork.load(path)
        if network.density != self.density:
            raise ConfigurationError("tuner.density", self.density, f"{network.density}, as {path} was trained on")
        for key, value, low, high in zip(
            ("omega_q", "omega_r"), self.weights, network.omega_min, network.omega_max, strict=True
        ):
            if not low <= value <= high:
                raise ConfigurationError(f"tuner.{key}", value, f"{low:g} to {high:g}, as {path} was trained on")
        return network

    def parts(self, context: LoopContext) -> tuple[Part, ...]:  # noqa: ARG002 - a density has no unit
        return (network_part(self.network(), self.weights),)

    def content(self) -> str:
        return TunerNetwork.content(self.weights_file)


class SettingTuner(BlockWeights):
    """Base of tuners that choose a setting: factors, as decades, on these weights and on `estimator.disturbance`.

    Their inputs include the innovations of the observer, see `features`. The factor on its expected disturbance changes
    the observer's bandwidth.
    """

    needs_observer: ClassVar[bool] = True

    @abstractmethod
    def source(self) -> SettingSource:
        """Source of the settings."""

    @property
    def weights(self) -> tuple[float, ...]:
        return tuple(weights_of(np.array(super().weights), self.source().centre).tolist())

    def parts(self, context: LoopContext) -> tuple[Part, ...]:
        base = np.array([self.q_pose, self.q_rate, self.q_integral, self.r])
        part = setting_part(self.source(), context, base, getattr(self, "kappa", 0.0))
        return (part.named(disturbance="expected_disturbance"),)


class PolicyTuner(SettingTuner):
    """Weights and observer bandwidth from a neural network, trained in the loop for the least cost."""

    label: ClassVar[str] = "Output of the policy"
    kind: Literal["policy"] = "policy"
    kappa: Annotated[Real, Field(ge=-1.0, le=1.0)] = 0.0
    """Preference from -1, stiff, to 1, quiet: in the cost, changes of torque are weighted by 10^kappa, errors by 1."""
    weights_file: Text | None = None
    """File of a trained policy, relative to the scenario file; null takes the package's."""
    _source: SettingSource | None = PrivateAttr(None)

    def opened(self) -> Self:
        opened = copy(self)
        opened._source = self.source()
        return opened

    def source(self) -> SettingSource:
        return self._source or Policy.load(self.weights_file)

    def content(self) -> str:
        return Policy.content(self.weights_file)


FourNumbers = tuple[Decades, Decades, Decades, Decades]


class ScheduleTuner(SettingTuner):
    """Two settings of weights and observer: one while readings are as expected, one while they are not."""

    label: ClassVar[str] = "Weights of the schedule"
    kind: Literal["schedule"] = "schedule"
    calm: FourNumbers = (0.0, 0.0, 0.0, 0.0)
    """Setting while readings are as expected: decades of speed, damping, integral and disturbance, see
    `control.policy`."""
    alert: FourNumbers = (0.0, 0.0, 0.0, 0.0)
    """Setting while they are not: the same four decades."""
    threshold: Positive = 2.0
    """[-] innovation above which `alert` is used: its RMS over some 10 ms, relative to the noise of a reading."""
    hold: NotNegative = 0.1
    """[s] how long `alert` is still used afterwards."""

    kernel: ClassVar[Callable[..., None]] = staticmethod(schedule_tick)

    def source(self) -> ScheduleTuner:
        return self

    def params(self) -> Schedule:
        return Schedule.new(self)

    @property
    def centre(self) -> np.ndarray:
        return np.array(self.calm)

    @property
    def width(self) -> np.ndarray:
        return np.abs(np.subtract(self.alert, self.calm))
