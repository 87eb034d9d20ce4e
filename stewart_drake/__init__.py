"""Closed-loop torque control of rotary Stewart platforms, on Drake.

    from stewart_drake import Scenario, run
    log = run(Scenario(duration=2.0))

The names stand in `__init__.pyi` and load on first use: the pure modules (kinematics, control law) need no Drake, and
nothing here needs torch.
"""

from importlib import import_module

with open(f"{__file__}i", encoding="utf-8") as _stream:  # noqa: PTH123 - pathlib takes longer
    _HOME = {words[3]: words[1] for line in _stream if (words := line.split())[:1] == ["from"]}
__all__ = sorted(_HOME)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> object:
    if name == "__version__":
        from importlib.metadata import PackageNotFoundError, version

        try:
            return version("stewart-drake")
        except PackageNotFoundError:
            return "not installed"
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
