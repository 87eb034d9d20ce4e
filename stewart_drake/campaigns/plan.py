"""What sweeps and comparisons share: runs of one scenario, each with some of its keys changed."""

from __future__ import annotations

import copy
import difflib
import re
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import Field

from stewart_drake.campaigns.one_run import Measure
from stewart_drake.errors import ConfigurationError
from stewart_drake.files.named_files import anchor_files
from stewart_drake.registry import refuse_given
from stewart_drake.scenario import Scenario, load_scenario
from stewart_drake.section import NAME, NAME_WORDS, Section, Text
from stewart_drake.wording import shown

PlanName = Annotated[Text, Field(min_length=1, max_length=80, pattern=NAME), NAME_WORDS]

_KEY = re.compile(r"[A-Za-z_]\w*(?:\.[A-Za-z_]\w*|\[(?:0|[1-9]\d{0,5})\])*")


class PlanFile(Section):
    """Keys that the files of both have; paths among them are absolute."""

    name: PlanName
    """Used for the output folder and titles."""
    scenario: Text
    """What is changed: a file, relative to this one, or the name of a shipped scenario."""
    set: dict[Text, Any] = Field(default_factory=dict)
    """Scenario key -> value, in every run."""

    @classmethod
    def read(cls, what: str, data: Any, folder: Path) -> Self:
        """The keys from plain values, as YAML gives them.

        Args:
            what: What it is a file of, for messages.
            data: Keys and values.
            folder: Paths in `data` are relative to it.

        Raises:
            ConfigurationError: Names the key, the value and what is allowed.
        """
        if not isinstance(data, Mapping):
            raise ConfigurationError(what, data, "a mapping of keys to values")
        keys = copy.deepcopy(dict(data))
        anchor_files(keys, folder)
        return cls.from_dict(keys)

    def base(self, folder: Path) -> Scenario:
        """The scenario, with `set` in it.

        Args:
            folder: Of this file.

        Raises:
            ConfigurationError: There is no such scenario, or no such key in it.
        """
        relative = folder / self.scenario
        try:
            found = relative.is_file()
        except OSError:
            found = False
        try:
            loaded = load_scenario(relative if found else self.scenario)
        except ConfigurationError as error:
            raise error.within("scenario: ") from None
        return vary(loaded, self.set, "set.")


@dataclass(frozen=True, eq=False)
class Plan(ABC):
    """Runs of one scenario with some keys changed, each known by its index.

    Attributes:
        base: The scenario, with everything fixed in it.
        runs: How many.
        name: For folders and titles.
    """

    base: Scenario
    runs: int = field(kw_only=True)
    name: str = field(kw_only=True)

    @abstractmethod
    def run_seed(self, index: int) -> int:
        """Seed of run `index`, below 2^63."""

    @abstractmethod
    def draw(self, index: int) -> dict[str, Any]:
        """What tells run `index` from the others; `values` of its row."""

    @abstractmethod
    def changes(self, drawn: Mapping[str, Any]) -> Mapping[str, Any]:
        """Scenario key -> value for what `draw` gave."""

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """All that the rows depend on, in plain types."""

    def measure(self, index: int) -> Measure | None:  # noqa: ARG002 - the same for all
        """What goes into the row of a run; None for `one_run.measure`."""
        return None

    def run_name(self, index: int) -> str:
        """Name of the scenario of run `index`."""
        return f"{self.name} {index}"

    def scenario(self, index: int) -> Scenario:
        """The scenario of run `index`.

        Raises:
            ConfigurationError: Its values do not make one.
        """
        return vary(self.base, {"name": self.run_name(index), **self.changes(self.draw(index))})


def vary(base: Scenario, changes: Mapping[str, Any], section: str = "") -> Scenario:
    """A scenario with some keys changed, components of lists among them.

    Args:
        base: What to change.
        changes: Key such as `robot.rod_length` or `initial_offset[0]` -> plain value.
        section: Goes before the key where a message names it.

    Raises:
        ConfigurationError: The key does not exist, or what comes out is no scenario; a part of it was given in Python.
    """
    data = base.to_dict()
    whole: dict[str, Any] = {}
    for key, value in changes.items():
        path = split_key(key, section)
        first = next((k for k, part in enumerate(path) if isinstance(part, int)), len(path))
        name, inside = ".".join(str(part) for part in path[:first]), path[first:]
        if not inside:
            whole[name] = value
            continue
        value_at(data, key, section)
        whole.setdefault(name, copy.deepcopy(value_at(data, name, section)))
        here = whole[name]
        for part in inside[:-1]:
            here = here[part]
        here[inside[-1]] = value
    changed = base.replace(whole)
    refuse_given(changed)
    return changed


def split_key(key: str, section: str = "distributions.") -> tuple[str | int, ...]:
    """Parts of a key: names and indices.

    Raises:
        ConfigurationError: It is none.
    """
    if _KEY.fullmatch(key) is None:
        raise ConfigurationError(f"{section}{shown(key)}", key, "a key such as robot.rod_length or initial_offset[0]")
    return tuple(int(index) if index else name for name, index in re.findall(r"([A-Za-z_]\w*)|\[(\d+)\]", key))


def value_at(data: dict[str, Any], key: str, section: str) -> Any:
    """Value of a key in a scenario.

    Raises:
        ConfigurationError: The scenario has no such key.
    """
    here: Any = data
    where: list[str] = []
    for part in split_key(key, section):
        inside = ".".join(where) or "the scenario"
        if isinstance(part, int):
            if not isinstance(here, list):
                raise ConfigurationError(f"{section}{key}", here, f"a key without [{part}]: {inside} is no list")
            if part >= len(here):
                raise ConfigurationError(f"{section}{key}", part, f"a component from 0 to {len(here) - 1}")
        elif not isinstance(here, dict):
            hint = "; `mismatch: true` fills it" if inside == "model_robot" and here is None else ""
            raise ConfigurationError(f"{section}{key}", here, f"a key in a section: {inside} is none{hint}")
        elif part not in here:
            close = difflib.get_close_matches(part, here, n=1)
            guess = f"did you mean {close[0]}? " if close else ""
            raise ConfigurationError(f"{section}{shown(key)}", part, f"{guess}{inside} has {', '.join(here)}")
        here = here[part]
        where.append(str(part))
    return here
