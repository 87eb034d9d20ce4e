"""What a batch of loops remembers from tick to tick, what it shows a tuner, and what its ticks cost."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from stewart_drake.training.loop_model import ObserverState, PlantState


class Observed(NamedTuple):
    """What a tuner sees of a tick.

    Attributes:
        error: (B, 6) [rad, m] of the pose that the controller sees.
        torque: (B, 6) [N m] that it asks for.
        innovation: (B, 6) [rad]; zeros without an observer.
        reference: (B, 18) that it follows.
    """

    error: Tensor
    torque: Tensor
    innovation: Tensor
    reference: Tensor


Tuner = Callable[[Observed, Any], tuple[Tensor, Any]]
"""From what is observed and its own memory to settings (B, 4), which act from the next tick on, and the memory."""


class LoopState(NamedTuple):
    """Of all loops before a tick.

    Attributes:
        tick: Its number.
        plant: See there.
        observer: See there; None for sensors that are believed.
        integral: (6, B) [rad s, m s].
        sent: Commands (6, B) [N m] of the ticks before, less what friction takes of them, oldest first.
        asked: Torques (6, B) [N m] likewise, as asked for.
        last: (6, B) [N m] torque of the last tick, within the motors' limits.
        alive: (B,) whether a loop has not failed.
        followed: (B,) whether it has come near its reference.
        setting: (B, 4) in force, see `control.settings`.
        memory: Of the tuner.
    """

    tick: int
    plant: PlantState
    observer: ObserverState | None
    integral: Tensor
    sent: tuple[Tensor, ...]
    asked: tuple[Tensor, ...]
    last: Tensor
    alive: Tensor
    followed: Tensor
    setting: Tensor
    memory: Any = None

    def detached(self) -> LoopState:
        """The same without a graph."""
        found: LoopState = mapped(lambda each: each.detach(), self)
        return found


class Costs(NamedTuple):
    """What each tick costs, (B, ticks).

    Attributes:
        rotation: [deg^2] squared length of the error.
        position: [mm^2] likewise.
        change: [(N m)^2] mean square over the motors of the torque's change since the tick before.
    """

    rotation: Tensor
    position: Tensor
    change: Tensor

    @classmethod
    def joined(cls, parts: Sequence[Costs]) -> Costs:
        """Of ticks one after the other."""
        return cls(*(torch.cat(each, dim=-1) for each in zip(*parts, strict=True)))


def mapped(function: Callable[[Tensor], Tensor], value: Any) -> Any:
    """A nest of tuples with a function on its tensors."""
    if isinstance(value, Tensor):
        return function(value)
    if isinstance(value, tuple):
        parts = [mapped(function, each) for each in value]
        return type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)
    return value


def kept(good: Tensor, new: Any, old: Any) -> Any:
    """New tensors (..., B) of loops that are good, old ones of the others."""
    if isinstance(new, Tensor):
        return torch.where(good, new, old)
    parts = [kept(good, *each) for each in zip(new, old, strict=True)]
    return type(new)(*parts) if hasattr(new, "_fields") else tuple(parts)


def frozen(alive: Tensor, later: LoopState, before: LoopState) -> LoopState:
    """The state after a tick, in which loops that have failed stay as they were."""
    if bool(alive.all()):
        return later
    names = ("plant", "integral", "sent", "asked", "last") + (("observer",) if later.observer is not None else ())
    return later._replace(**{name: kept(alive, getattr(later, name), getattr(before, name)) for name in names})
