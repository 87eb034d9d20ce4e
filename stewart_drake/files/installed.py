"""What this package uses but does not install."""

from __future__ import annotations

import importlib.util

from stewart_drake.errors import ConfigurationError


def need_pandas(instead: str) -> None:
    """Asks for pandas.

    Args:
        instead: What gives the same without it.

    Raises:
        ConfigurationError: It is not installed.
    """
    if importlib.util.find_spec("pandas") is None:
        allowed = f"an installation with pandas: pip install pandas; {instead}"
        raise ConfigurationError("to_pandas", "no pandas", allowed)
