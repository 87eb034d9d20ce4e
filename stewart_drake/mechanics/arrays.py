"""Robots as arrays, and the little algebra on arrays that lead with components."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from functools import lru_cache, wraps
from importlib import import_module
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np
from array_api_compat import array_namespace, device, is_array_api_obj

from stewart_drake.errors import StewartDrakeError
from stewart_drake.robot import RobotParameters

_F = TypeVar("_F", bound=Callable[..., Any])
_BLOCK = 1024  # poses at a time: vectors of six legs take 150 kB
# From 2.0 on numpy is of the Array API itself; the layer for older ones loads all of it, tests and compilers included.
_NUMPY: Any = np if hasattr(np, "matrix_transpose") else import_module("array_api_compat.numpy")

Array = Any
"""Of any namespace of the Array API; float64."""


class Robot(NamedTuple):
    """A robot, or many: axes after those given are axes of a batch of robots, which broadcast against those of poses.

    A pose for a batch of robots has as many axes before its last as the batch; ones will do.

    Attributes:
        shafts: (3, 6) [m] motor shafts in B.
        joints: (3, 6) [m] platform joints in P.
        zeros: (3, 6) [-] directions of the cranks at theta = 0.
        quarters: (3, 6) [-] directions of the cranks at theta = pi/2.
        cranks: (6,) [m] lengths.
        rods: (6,) [m] lengths.
        branches: (6,) [-] -1 or 1.
        axis_inertias: (6,) [kg m^2] of cranks and rotors about the motor axes.
        rod_mass: () [kg].
        rod_inertia: () [kg m^2] across the rod, about its middle.
        crank_mass: () [kg].
        platform_mass: () [kg].
        platform_moment: (3,) [kg m] mass times centre of mass in P.
        platform_inertia: (3, 3) [kg m^2] about the origin of P.
    """

    shafts: Array
    joints: Array
    zeros: Array
    quarters: Array
    cranks: Array
    rods: Array
    branches: Array
    axis_inertias: Array
    rod_mass: Array
    rod_inertia: Array
    crank_mass: Array
    platform_mass: Array
    platform_moment: Array
    platform_inertia: Array


AnyRobot = RobotParameters | Robot

_RANKS = Robot(2, 2, 2, 2, 1, 1, 1, 1, 0, 0, 0, 0, 1, 2)


@lru_cache(maxsize=128)
def numpy_robot(robot: RobotParameters) -> Robot:
    """A robot as read-only arrays of numpy."""
    fields = (
        robot.shaft_positions.T,
        robot.platform_joints.T,
        robot.crank_zero_directions.T,
        robot.crank_quarter_directions.T,
        robot.crank_lengths,
        robot.rod_lengths,
        robot.branches,
        robot.crank_axis_inertias,
        robot.rod_mass,
        robot.rod_inertia[0],
        robot.crank_mass,
        robot.platform_mass,
        robot.platform_moment,
        robot.platform_inertia_about_origin,
    )
    arrays = [np.array(field, dtype=float, order="C") for field in fields]
    for array in arrays:
        array.flags.writeable = False
    return Robot(*arrays)


def robot_like(robots: RobotParameters | list[RobotParameters], like: Array) -> Robot:
    """One robot, or a batch of them along one axis, in the namespace and on the device of an array."""
    if isinstance(robots, list):
        fields = [np.stack(field, axis=-1) for field in zip(*map(numpy_robot, robots), strict=True)]
    else:
        fields = [field.copy() for field in numpy_robot(robots)]
    return Robot(*(numbers_like(field, like, namespace(like).float64) for field in fields))


def fitted(robot: Robot, rank: int) -> Robot:
    """A robot whose arrays broadcast against those of poses with so many axes."""
    if rank == 0:
        return robot
    fields = []
    for field, own in zip(robot, _RANKS, strict=True):
        missing = rank - (field.ndim - own)
        fields.append(field[(slice(None),) * own + (None,) * missing + (...,)] if missing > 0 else field)
    return Robot(*fields)


def namespace(*arrays: Array) -> Any:
    """Where the functions for arrays are; of numpy's arrays at once."""
    for array in arrays:
        if type(array) is not np.ndarray:
            return array_namespace(*arrays)
    return _NUMPY


def stack(xp: Any, parts: Iterable[Array]) -> Array:
    """Arrays of one shape along a new first axis; four times faster than numpy's own on small ones."""
    return xp.concat([part[None, ...] for part in parts])


def first(xp: Any, array: Array, count: int) -> Array:
    """The last axes of an array moved to the front, in reverse: (..., 6, 3) to (3, 6, ...)."""
    if array.ndim == count:
        return array if count == 1 else array.T
    axes = range(array.ndim)
    return xp.permute_dims(array, (*reversed(axes[-count:]), *axes[:-count]))


def last(xp: Any, array: Array, count: int) -> Array:
    """Undoes `first`."""
    if array.ndim == count:
        return array if count == 1 else array.T
    axes = range(array.ndim)
    return xp.permute_dims(array, (*axes[count:], *reversed(axes[:count])))


def dot(a: Array, b: Array) -> Array:
    """Scalar product over the first axis, of length three."""
    return a[0, ...] * b[0, ...] + a[1, ...] * b[1, ...] + a[2, ...] * b[2, ...]


def cross(xp: Any, a: Array, b: Array) -> Array:
    """Cross product over the first axis: of one pose in few operations, of many with few copies."""
    if a.ndim < 3 and b.ndim < 3:
        a, b = xp.concat([a, a[:2, ...]]), xp.concat([b, b[:2, ...]])
        return a[1:4, ...] * b[2:5, ...] - a[2:5, ...] * b[1:4, ...]
    ax, ay, az = (a[k, ...] for k in range(3))
    bx, by, bz = (b[k, ...] for k in range(3))
    return stack(xp, (ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx))


def turned(rotation: Array, vector: Array) -> Array:
    """R v of vectors (3, k, ...)."""
    return (
        rotation[:, 0, None, ...] * vector[0, ...]
        + rotation[:, 1, None, ...] * vector[1, ...]
        + rotation[:, 2, None, ...] * vector[2, ...]
    )


def as_array(values: Any) -> Array:
    """Arrays of other namespaces as they are; anything else as numpy's, of float64."""
    if isinstance(values, np.ndarray) or not is_array_api_obj(values):
        return np.asarray(values, dtype=float)
    return values


def numbers_like(values: np.ndarray, like: Array, dtype: Any = None) -> Array:
    """Numpy's numbers, copied, in the namespace and on the device of an array; of its type, if of no other."""
    dtype = like.dtype if dtype is None else dtype
    return namespace(like).asarray(np.array(values), dtype=dtype, device=device(like))


def in_blocks(function: _F) -> _F:
    """Runs a function of a robot and arrays (..., 6) of numpy over blocks whose temporaries stay in the cache.

    Cut are the arguments with axes before the last, by place or by name, arrays or lists, where all have one shape;
    others go to each block whole. What it raises for a block it raises for all, so that an error names the worst of
    all.
    """

    @wraps(function)
    def run(robot: AnyRobot, *args: Any, **keywords: Any) -> Any:
        given: dict[Any, Any] = {**dict(enumerate(args)), **keywords}
        cut = {at: as_array(value) for at, value in given.items() if np.ndim(value) > 1}
        shape, *others = {array.shape for array in cut.values()} or {(6,)}
        count = math.prod(shape[:-1])
        whole = bool(others) or shape[-1] != 6 or not all(isinstance(array, np.ndarray) for array in cut.values())
        if count <= _BLOCK or whole or (isinstance(robot, Robot) and robot.cranks.ndim > 1):
            return function(robot, *args, **keywords)
        rows = {at: array.reshape(-1, 6) for at, array in cut.items()}
        result: np.ndarray | None = None
        for start in range(0, count, _BLOCK):
            block = {**given, **{at: array[start : start + _BLOCK] for at, array in rows.items()}}
            try:
                part = function(robot, *(block.pop(at) for at in range(len(args))), **block)
            except StewartDrakeError:
                return function(robot, *args, **keywords)
            if result is None:
                result = np.empty((count, *part.shape[1:]))
            result[start : start + _BLOCK] = part
        return np.reshape(np.asarray(result), (*shape[:-1], *part.shape[1:]))

    return cast(_F, run)


def to_numpy(array: Array) -> np.ndarray:
    """Values without gradients, on the CPU."""
    return np.asarray(array.detach().cpu() if hasattr(array, "detach") else array)


def arrays_of(robot: AnyRobot, like: Array) -> Robot:
    """The arrays of a robot, in the namespace of an array."""
    if isinstance(robot, Robot):
        return robot
    return numpy_robot(robot) if isinstance(like, np.ndarray) else robot_like(robot, like)
