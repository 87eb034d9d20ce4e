"""How to train a policy: options, and the box of its settings."""

from __future__ import annotations

from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field

from stewart_drake.control.policy import Policy
from stewart_drake.section import Count, NotNegative, Positive, Section, Seed

Method = Literal["gradient", "evolution"]


class PolicyOptions(Section, key="training"):
    """How to train a policy."""

    seed: Seed = 0
    """Of the first weights, tastes and, for evolution, directions."""
    method: Method = "gradient"
    """gradient: backpropagation through the loops, cut into pieces. evolution: each loop goes another way."""
    epochs: Annotated[Count, Field(ge=1)] = 3
    """Rollouts of all situations; of evolution, with more of those that are short."""
    situations: Annotated[Count, Field(ge=1, le=1000)] = 20
    """Of each kind and robot."""
    hidden: Annotated[Count, Field(ge=1, le=200)] = 16
    """Hidden units."""
    pieces: Annotated[Count, Field(ge=1, le=1000)] = 9
    """Of the scored half of a run, each with a step of Adam after it."""
    learning_rate: Positive = 0.03
    """Of Adam at first; it falls to a tenth along half a cosine."""
    spread: Positive = 0.1
    """Of the directions of evolution."""
    width: NotNegative = 0.05
    """[-] rounding of friction's corners, as a share of the break-away torque."""
    tastes: Annotated[NotNegative, Field(lt=1)] = 0.5
    """Share of the situations with a taste of their own, kappa from -1 to 1; the others have 0."""
    fairness: NotNegative = 4.0
    """What a kind counts for more in which the policy is worse than the centre, times the logarithm of how much."""
    without: tuple[str, ...] = ()
    """Names of features that it does not get."""


EVOLUTION: dict[str, Any] = {"method": "evolution", "epochs": 20, "situations": 40, "width": 0.0}
"""Options of evolution from weights of zero: many situations cost it little, and it needs no smooth friction."""
POLISH: dict[str, Any] = {**EVOLUTION, "epochs": 10, "learning_rate": 0.01, "spread": 0.05, "fairness": 8.0}
"""Options of a second training, by evolution, that goes on from a policy. Whole runs tell what a gradient cannot: that
a tuner which hears an unrest of its own making stays as it is, and so keeps it up."""


class Box(NamedTuple):
    """Settings that a policy can choose.

    Attributes:
        centre: (4,) the best fixed one.
        lowest: (4,).
        highest: (4,).
    """

    centre: np.ndarray
    lowest: np.ndarray = np.array([-0.05, -0.6, -1.2, -1.9])
    highest: np.ndarray = np.array([0.4, 0.1, 0.1, 0.5])

    @classmethod
    def of(cls, policy: Policy) -> Box:
        """That of a policy."""
        return cls(policy.centre, policy.lowest, policy.lowest + policy.width)
