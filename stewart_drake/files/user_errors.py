"""What a controller of the user's own raises: told apart from what Drake or this package raises, and shown."""

from __future__ import annotations

import traceback
from contextlib import AbstractContextManager
from pathlib import Path
from types import TracebackType

from stewart_drake.errors import RunFailure, StewartDrakeError

_PACKAGE = __name__.partition(".")[0]
_MOST_LINES = 40
"""Of a traceback: what is beyond, as after an endless recursion, is cut out of its middle."""


class ControllerError(RunFailure):
    """A controller of the user's own raised something in the midst of a run.

    Attributes:
        traceback: Lines of Python's traceback from the first frame on that is the user's; empty where there is none.
    """

    reason = "controller_raised"

    def __init__(self, message: str, traceback: str = "") -> None:
        self.traceback = traceback
        super().__init__(message)


class UserCode(AbstractContextManager[None]):
    """Turns what a user's controller raises in a run into `ControllerError`, which ends the run and keeps its log.

    What ends a run by itself passes, and so does Ctrl-C; so do, where no frame of the traceback is the user's, Drake's
    own verdicts (`SystemExit`, `RuntimeError`, see `drake_guard`) and mistakes in this package.

    A class: a generator under `contextmanager` would let StopIteration pass.

    Args:
        own: Names of the user's modules, or of the packages that they are in; none where no code is the user's.
    """

    def __init__(self, *own: str) -> None:
        self._own = own

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if not self._own or error is None or isinstance(error, (RunFailure, KeyboardInterrupt)):
            return
        # The first frame is the one that has this guard.
        inner = None if trace is None else trace.tb_next
        if _first_own(inner, self._own) is None:
            verdict = type(error) is RuntimeError or isinstance(error, (StewartDrakeError, SystemExit))
            if verdict or (inner is not None and _is_in(inner, (_PACKAGE,))):
                return
        line, lines = describe(error, inner, *self._own)
        raise ControllerError(f"the user's code raised {line}", lines) from error


def describe(error: BaseException, trace: TracebackType | None, *own: str) -> tuple[str, str]:
    """An error in the user's code in one line, with file and line, and the user's part of its traceback."""
    try:
        text = " ".join(str(error).split())
    except Exception:  # a __str__ of the user's own
        text = "its text cannot be shown"
    line = f"{type(error).__name__}: {text}" if text else type(error).__name__
    start = _first_own(trace, own)
    if start is None:
        return line, ""
    frames = [frame for frame, _ in traceback.walk_tb(start) if _belongs(frame.f_globals.get("__name__"), own)]
    numbers = [number for frame, number in traceback.walk_tb(start) if frame is frames[-1]]
    code = frames[-1].f_code
    where = f"{Path(code.co_filename).name}, line {numbers[-1]}, in {code.co_name}"
    lines = "".join(traceback.format_exception(type(error), error, start)).splitlines()
    if len(lines) > _MOST_LINES:
        half = _MOST_LINES // 2
        lines = [*lines[:half], f"  ... {len(lines) - 2 * half} lines ...", *lines[-half:]]
    return f"{line} ({where})", "\n".join(lines)


def _first_own(trace: TracebackType | None, own: tuple[str, ...]) -> TracebackType | None:
    while trace is not None and not _is_in(trace, own):
        trace = trace.tb_next
    return trace


def _is_in(trace: TracebackType, packages: tuple[str, ...]) -> bool:
    return _belongs(trace.tb_frame.f_globals.get("__name__"), packages)


def _belongs(module: object, packages: tuple[str, ...]) -> bool:
    return isinstance(module, str) and any(module == each or module.startswith(f"{each}.") for each in packages)
