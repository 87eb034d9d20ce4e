"""Older name of `config`."""

from stewart_drake.config import *  # noqa: F403
