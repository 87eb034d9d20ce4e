"""Errors of the package; each carries the offending data and says what is allowed.

Two families matter to a caller. `ConfigurationError` is bad input, found before anything runs (exit status 2).
`RunFailure` ends a run midway and leaves its log behind (exit status 3); `reason` is a stable name for tables.
"""

from __future__ import annotations

import reprlib
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np


class _Short(reprlib.Repr):
    """A value in a few words, whatever its type; where it cannot be shown, what it is."""

    def repr1(self, x: Any, level: int) -> str:
        try:
            return super().repr1(x, level)
        except Exception:  # whatever the value's own __repr__, __len__ or the like may raise
            return f"<{type(x).__name__}>"

    def repr_int(self, x: int, level: int) -> str:
        # Python refuses to write out thousands of digits.
        return super().repr_int(x, level) if x.bit_length() < 2000 else f"<a whole number of {x.bit_length()} bits>"


UNTRUSTED_CODE = "untrusted_code"
"""`reason` of a `ConfigurationError` about code that may not run."""

_SHORT = _Short()
_SHORT.maxother = _SHORT.maxstring = 120


class StewartDrakeError(Exception):
    """Base of every error that this package raises on purpose."""

    reason: str = "error"

    def __reduce__(self) -> tuple[Any, ...]:
        # The constructors take data, not the message; by default an error could not come back from a worker process.
        return _restore, (type(self), self.args, self.__dict__)


class ConfigurationError(StewartDrakeError):
    """A value that the user gave is not usable: `KEY: expected WHAT, got VALUE; HINT`.

    Not a ValueError: pydantic would wrap that into an error of its own.

    Attributes:
        key: Dotted name of the scenario key, parameter or file.
        value: What was given.
        allowed: What would have been accepted, after `; ` a hint. With `no such` it begins where the key is wrong.
        others: Further problems of the same file or section; each has a line of its own in the message.
    """

    reason = "configuration"

    def __init__(self, key: str, value: Any, allowed: str) -> None:
        self.key, self.value, self.allowed = key, value, allowed
        self.others: tuple[ConfigurationError, ...] = ()
        self._left_out = 0
        shown = " ".join(_SHORT.repr(value).split())
        if len(shown) > 120:
            shown = shown[:117] + "..."
        expected, semicolon, hint = allowed.partition("; ")
        text = allowed if allowed.startswith("no such") else f"expected {expected}, got {shown}{semicolon}{hint}"
        super().__init__(f"{key}: {text}")

    def __str__(self) -> str:
        own = " ".join(super().__str__().split())
        rest = [f"and {self._left_out} more problems"] if self._left_out > 0 else []
        return "\n".join([own, *map(str, self.others), *rest])

    def with_others(self, others: Sequence[ConfigurationError], most: int = 20) -> ConfigurationError:
        """The same error with further problems, of which so many are shown."""
        self.others, self._left_out = tuple(others[:most]), len(others) - most
        return self

    def within(self, place: str) -> ConfigurationError:
        """The same problems, with the place where they were found before each key."""
        made = ConfigurationError(f"{place}{self.key}", self.value, self.allowed)
        made.others, made._left_out = tuple(each.within(place) for each in self.others), self._left_out
        made.reason = self.reason
        return made


class InfeasibleReferenceError(ConfigurationError):
    """A reference leaves the robot's limits; found before the run.

    Attributes:
        limit: Name of the limit that is broken first.
        time: [s] first instant at which it is broken.
        leg: Leg 0..5, or None where the limit belongs to the platform as a whole.
        margin: Signed distance to the limit in its own unit; negative is outside.
    """

    reason = "infeasible_reference"

    def __init__(self, limit: str, time: float, leg: int | None, margin: float, allowed: str) -> None:
        self.limit, self.time, self.leg, self.margin = limit, time, leg, margin
        where = "the platform" if leg is None else f"leg {leg}"
        self.found = f"{limit} at t = {time:.3f} s, {where}, margin {margin:.4g}"
        super().__init__("reference", self.found, allowed)

    def __str__(self) -> str:
        return f"reference: breaks the limit {self.found}; expected {self.allowed}"


class RunFailure(StewartDrakeError, RuntimeError):
    """Something that ends a run midway.

    Attributes:
        leg: Leg 0..5 to which the failure belongs, or None.
        time: [s] simulated time, filled in by the system in which it happened.
        traceback: Lines of the traceback where a user's code raised; empty otherwise.
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
    """A rod cannot span from its crank circle to its platform joint; `margin` is that of the worst leg, negative."""

    reason = "unreachable_pose"

    def __init__(self, pose: np.ndarray, leg: int, margin: float) -> None:
        self.pose, self.margin = pose, margin
        super().__init__(
            f"pose {pose_text(pose)} is out of reach of leg {leg} (margin {margin:.4g}; reachable: margin >= 0)",
            leg,
        )


class SingularPoseError(RunFailure):
    """A pose at which a map loses rank.

    `kind` is `serial` (a crank at its dead centre), `parallel` (the rods' lines) or `rod_joint` (a rod turned by 90 deg
    in its joint at the crank, whose angles mean nothing there); `margin` is the measure that fell below its limit [-].
    """

    def __init__(self, kind: str, pose: np.ndarray, margin: float, limit: float, leg: int | None = None) -> None:
        self.kind, self.pose, self.margin = kind, pose, margin
        self.reason, what = {
            "serial": (
                "crank_dead_centre",
                f"crank of leg {leg} at its dead centre: transmission |e_l . e_N| = {margin:.4g}",
            ),
            "parallel": ("parallel_singularity", f"parallel singularity: sigma_min / sigma_max = {margin:.4g}"),
            "rod_joint": (
                "rod_joint",
                f"rod of leg {leg} turned by 90 deg in its joint on the crank: cos = {margin:.3g}",
            ),
        }[kind]
        super().__init__(f"{what} at pose {pose_text(pose)} (allowed: >= {limit:g})", leg)


class ForwardKinematicsError(RunFailure):
    """Newton's method on the loop closure did not converge; `residual` [m] is the largest rod-length error."""

    reason = "forward_kinematics"

    def __init__(self, residual: float, iterations: int) -> None:
        self.residual, self.iterations = residual, iterations
        super().__init__(
            f"forward kinematics did not converge in {iterations} iterations: rod-length error {residual:.3g} m; "
            "give a guess nearer to the pose, or check that these crank angles can be assembled"
        )


class AssemblyModeError(RunFailure):
    """Forward kinematics has found another assembly mode than that of `last`, the pose of the tick before."""

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

    def __init__(self, signal: str, value: Any) -> None:
        self.signal = signal
        super().__init__(f"{signal} is not finite: {np.asarray(value)}")


class DrakeCheckError(RunFailure):
    """A check inside Drake failed; Drake itself would have ended the process."""

    reason = "drake_check"


class SafetyStop(RunFailure):
    """The safety layer has ended the run; `reason` is the monitor's name, `trip` the first trip of the run."""

    def __init__(self, monitor: str, message: str, leg: int | None, trip: dict[str, Any] | None) -> None:
        self.reason, self.trip = monitor, trip
        super().__init__(message, leg)


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
    "frozen",
)
"""Reasons for which a tick may fail, counted from 1 in signals; 1 stands for any other."""


def failure_code(reason: str) -> int:
    """Number of a reason, see `FAILURES`."""
    return 1 + (FAILURES.index(reason) if reason in FAILURES else 0)


def raised_at(error: BaseException) -> str:
    """Where an exception came from, as ` (file, line n)`; nothing where that depends on how deep or full memory was."""
    frames = traceback.extract_tb(error.__traceback__)
    if not frames or isinstance(error, (RecursionError, MemoryError)):
        return ""
    return f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})"


@contextmanager
def drake_guard(doing: str) -> Iterator[None]:
    """Turns what a failed Drake check raises (`SystemExit`, `RuntimeError`) into a `DrakeCheckError` with `doing`."""
    try:
        yield
    except StewartDrakeError:
        raise
    except (SystemExit, RuntimeError) as error:
        if type(error) not in (SystemExit, RuntimeError):
            # Python's own kinds, such as RecursionError, are no verdict of Drake's.
            raise
        text = str(error) or type(error).__name__
        raise DrakeCheckError(f"{doing}: {' '.join(text.split())}") from error


def _restore(kind: type[StewartDrakeError], args: tuple[Any, ...], state: dict[str, Any]) -> StewartDrakeError:
    error = kind.__new__(kind, *args)
    error.__dict__.update(state)
    return error


def pose_text(pose: np.ndarray) -> str:
    """Six numbers in a few digits each."""
    return "[" + ", ".join(f"{x:.4g}" for x in np.ravel(pose)) + "]"
