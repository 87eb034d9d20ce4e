"""Errors of the package, with the offending data and what is allowed instead.

Two families matter to a caller. `ConfigurationError` is bad input, found before anything runs (exit status 2).
`RunFailure` ends a run midway and leaves its log behind (exit status 3); `reason` is a stable name for tables.
"""

from __future__ import annotations

import copyreg
import shlex
import sys
import traceback
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from stewart_drake.base.atomic_files import Document


class StewartDrakeError(Exception):
    """Base of every error that this package raises on purpose."""

    reason: str = "error"

    def __reduce__(self) -> tuple[object, ...]:
        # The constructors take data, not the message; by default an error could not come back from a worker process.
        return copyreg.__newobj__, (type(self), *self.args), self.__dict__  # type: ignore[attr-defined]


class ConfigurationError(StewartDrakeError):
    """An invalid value from the user: `KEY: expected WHAT, got VALUE; HINT`.

    Not a ValueError: pydantic would wrap that in a ValidationError.

    Attributes:
        key: Dotted name of the scenario key, parameter or file.
        value: What was given.
        allowed: Accepted values, and after `; ` a hint; begins with `no such` if the key is wrong.
        others: Further problems of the same file or section.
    """

    reason = "configuration"

    def __init__(self, key: str, value: object, allowed: str, *, others: tuple[ConfigurationError, ...] = ()) -> None:
        self.key, self.value, self.allowed, self.others = key, value, allowed, others
        expected, semicolon, hint = allowed.partition("; ")
        expected = expected if expected.startswith("no such") else f"expected {expected}"
        super().__init__(" ".join(f"{key}: {expected}, got {_shown(value)}{semicolon}{hint}".split()))

    def __str__(self) -> str:
        return "\n".join([super().__str__(), *map(str, self.others)])

    def within(self, place: str) -> ConfigurationError:
        """The same problems, with `place` before their keys."""
        others = tuple(error.within(place) for error in self.others)
        return ConfigurationError(f"{place}{self.key}", self.value, self.allowed, others=others)


class InfeasibleReferenceError(ConfigurationError):
    """A reference leaves the robot's limits; found before the run.

    Attributes:
        limit: Name of the limit that is broken first.
        time: [s] first instant at which it is broken.
        leg: Leg 0..5, or None for a limit of the platform.
        margin: Signed distance to the limit in the limit's unit; negative is outside.
    """

    reason = "infeasible_reference"

    def __init__(self, limit: str, time: float, leg: int | None, value: str, margin: float, allowed: str) -> None:
        self.limit, self.time, self.leg, self.margin = limit, time, leg, margin
        where = "the platform" if leg is None else f"leg {leg}"
        super().__init__("reference", f"{value} at t = {time:.3f} s, {where}", allowed)

    def __str__(self) -> str:
        return f"reference: breaks the limit {self.limit} with {self.value}; expected {self.allowed}"


class MissingPackageError(ConfigurationError, ImportError):
    """An optional package is not installed; see `installed_with`."""

    reason = "missing_package"

    def __init__(self, package: str, requirement: str, instead: str = "") -> None:
        hint = f"; {instead}" if instead else ""
        self.remedy = f"pip install {shlex.quote(requirement)}{hint}"
        super().__init__(package, None, f"an installed package; {self.remedy}")

    def __str__(self) -> str:
        return f"{self.key} is not installed: {self.remedy}"


class DiskError(StewartDrakeError):
    """A full or broken disk, found while writing."""

    reason = "disk"


class RunFailure(StewartDrakeError, RuntimeError):
    """Something that ends a run midway.

    Attributes:
        leg: Leg 0..5 of the failure, or None.
        time: [s] simulated time, set by the system that failed.
        traceback: Lines of the traceback in a user's code; otherwise empty.
    """

    reason = "run_failure"
    traceback = ""

    def __init__(self, message: str, leg: int | None = None, reason: str | None = None) -> None:
        self.leg = leg
        self.time: float | None = None
        if reason is not None:
            self.reason = reason
        super().__init__(message)


class UnreachablePoseError(RunFailure):
    """A rod cannot reach from its crank to its platform joint; `margin` is that of the worst leg, negative."""

    reason = "unreachable_pose"

    def __init__(self, pose: np.ndarray, leg: int, margin: float) -> None:
        self.pose, self.margin = pose, margin
        super().__init__(f"pose {pose_text(pose)} is out of reach of leg {leg} (margin {margin:.4g}, less than 0)", leg)


class SingularPoseError(RunFailure):
    """A singular pose; `margin` is the measure that fell below its limit [-], negative beyond the singularity.

    `kind` is `serial` (a crank at its dead centre), `parallel` (the lines of the rods are linearly dependent) or
    `rod_joint` (a rod turned by 90 deg in its joint at the crank, where the angles of the joint are undefined).
    """

    def __init__(self, kind: str, pose: np.ndarray, margin: float, limit: float, leg: int | None = None) -> None:
        self.kind, self.pose, self.margin = kind, pose, margin
        place = "beyond its dead centre: margin" if margin < 0.0 else "at its dead centre: transmission |e_l . e_N|"
        reason, what = {
            "serial": ("crank_dead_centre", f"crank of leg {leg} {place}"),
            "parallel": ("parallel_singularity", "parallel singularity: sigma_min / sigma_max"),
            "rod_joint": ("rod_joint", f"rod of leg {leg} turned by 90 deg in its joint at the crank: cos"),
        }[kind]
        text = f"{what} = {margin:.4g} at pose {pose_text(pose)} (allowed: >= {limit:g})"
        super().__init__(text, leg, reason)


class ForwardKinematicsError(RunFailure):
    """Newton's method on the loop closure did not converge; `residual` [m] is the largest rod-length error."""

    reason = "forward_kinematics"

    def __init__(self, residual: float, iterations: int) -> None:
        self.residual, self.iterations = residual, iterations
        super().__init__(
            f"forward kinematics did not converge in {iterations} iterations: rod-length error {residual:.3g} m; "
            "give a guess closer to the pose, or check that these crank angles can be assembled"
        )


class AssemblyModeError(RunFailure):
    """Forward kinematics found another assembly mode than that of `last`, the pose of the previous tick."""

    reason = "assembly_mode"

    def __init__(self, pose: np.ndarray, last: np.ndarray) -> None:
        self.pose, self.last = pose, last
        super().__init__(
            f"forward kinematics went from pose {pose_text(last)} to {pose_text(pose)} in one tick: "
            "another assembly mode, or a jump"
        )


class RiccatiError(RunFailure):
    """The discrete Riccati equation has no stabilising solution for these matrices."""

    reason = "riccati"


class NotFiniteError(RunFailure):
    """A signal in the loop is NaN or infinite."""

    reason = "not_finite"

    def __init__(self, signal: str, value: ArrayLike) -> None:
        self.signal = signal
        super().__init__(f"{signal} is not finite: {np.asarray(value)}")


class DrakeCheckError(RunFailure):
    """A failed check in Drake, which raises SystemExit or RuntimeError for it."""

    reason = "drake_check"


class SafetyStop(RunFailure):
    """The safety layer ended the run; `reason` is the monitor's name, `trip` the first trip of the run."""

    def __init__(self, monitor: str, message: str, leg: int | None, trip: Document | None) -> None:
        self.reason, self.trip = monitor, trip
        super().__init__(message, leg)


class Status(NamedTuple):
    """Meaning of a status of a kernel other than 0."""

    reason: str  # One of `FAILURES`.
    signal: str = ""  # The argument of the kernel that caused it: `reference`, or a field such as `state.pose`.
    of_leg: bool = False  # Whether the second number of the result is a leg.
    text: str = ""  # Name of a signal that is not finite, or message with {at}, {leg} and arguments.
    limit: float = 0.0  # [-] of the margin, the third number of the result.
    last: str = ""  # Like `signal`, the pose of the previous tick.
    numbers: slice = slice(6)  # Of the signal, for the message; by default a pose or crank angles.


def failure(status: Status, leg: int, margin: float, arguments: Mapping[str, np.ndarray]) -> RunFailure:
    """Error of a failed tick, from the meaning of its status, leg (or -1), margin, and the kernel's arguments."""

    def value(place: str) -> np.ndarray:
        name, _, field = place.partition(".")
        found = arguments[name][field] if field else arguments[name]
        return np.array(found, dtype=float).ravel()[status.numbers]

    match status.reason:
        case "unreachable_pose":
            return UnreachablePoseError(value(status.signal), leg, margin)
        case "crank_dead_centre":
            return SingularPoseError("serial", value(status.signal), margin, status.limit, leg)
        case "parallel_singularity":
            return SingularPoseError("parallel", value(status.signal), margin, status.limit)
        case "forward_kinematics":
            return ForwardKinematicsError(margin, leg)
        case "assembly_mode":
            return AssemblyModeError(value(status.signal), value(status.last))
        case "not_finite":
            return NotFiniteError(status.text, value(status.signal) if status.signal else margin)
    at = pose_text(value(status.signal)) if status.signal else ""
    kind = RiccatiError if status.reason == "riccati" else RunFailure
    text = status.text.format(at=at, leg=leg, **arguments)
    return kind(text, leg if status.of_leg else None, status.reason)


FAILURES = (
    "run_failure",
    "unreachable_pose",
    "crank_dead_centre",
    "parallel_singularity",
    "forward_kinematics",
    "encoder",
    "assembly_mode",
    "riccati",
    "not_finite",
)
"""Reasons of failed ticks, numbered from 1 in signals; 1 is also any other reason."""


def failure_code(reason: str) -> int:
    """Number of a reason, see `FAILURES`."""
    return 1 + (FAILURES.index(reason) if reason in FAILURES else 0)


def raised_at(error: BaseException) -> str:
    """Place of an exception, as ` (file, line n)`; empty for errors of this package, of recursion and of memory."""
    frames = traceback.extract_tb(error.__traceback__)
    if not frames or isinstance(error, (RecursionError, MemoryError, StewartDrakeError)):
        return ""
    return f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})"


def one_line(error: BaseException) -> str:
    """Message of an exception in one line, with its class unless it is of this package."""
    text = " ".join(str(error).split())
    kind = "" if isinstance(error, StewartDrakeError) and text else f"{type(error).__name__}: "
    return f"{kind}{text}".removesuffix(": ")


@contextmanager
def installed_with(requirement: str, instead: str = "") -> Iterator[None]:
    """Around an import of an optional package: names the requirement for pip, and what works `instead`.

    Raises:
        MissingPackageError: The package is missing.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        raise MissingPackageError((error.name or requirement).partition(".")[0], requirement, instead) from None


@contextmanager
def drake_guard(doing: str) -> Iterator[None]:
    """Turns what a failed Drake check raises (`SystemExit`, `RuntimeError`) into a `DrakeCheckError` with `doing`."""
    try:
        yield
    except StewartDrakeError:
        raise
    except (SystemExit, RuntimeError) as error:
        if type(error) not in (SystemExit, RuntimeError):
            # Subclasses such as RecursionError do not come from Drake.
            raise
        text = str(error) or type(error).__name__
        raise DrakeCheckError(f"{doing}: {' '.join(text.split())}") from error


def pose_text(pose: np.ndarray) -> str:
    """A pose with four digits per number."""
    return "[" + ", ".join(f"{x:.4g}" for x in np.ravel(pose)) + "]"


def _shown(value: object) -> str:
    """A value in one short line."""
    try:
        text = " ".join(repr(value).split())
    except Exception:  # Whatever its __repr__ raises; Python refuses to print thousands of digits.
        text = f"<{type(value).__name__}>"
    return text if len(text) <= 120 else f"{text[:117]}..."


@contextmanager
def quiet_libraries() -> Iterator[None]:
    """Silences libraries' warnings about numbers, which are checked elsewhere; Python's -W shows them."""
    with np.errstate(all="ignore"), warnings.catch_warnings():
        if not sys.warnoptions:
            warnings.simplefilter("ignore")
        yield
