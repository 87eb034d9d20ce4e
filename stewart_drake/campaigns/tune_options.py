"""What a search for the gains of controllers needs, as sections of a comparison file; and the file of what it found."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from stewart_drake.errors import ConfigurationError
from stewart_drake.files.yaml_files import read_mapping
from stewart_drake.section import Count, Fraction, Positive, PositivePair, Section, Seed, Text


class TuneOptions(Section, key="tune"):
    """Keys of controllers, searched by CMA-ES in their logarithms for the least cost over the comparison's own runs."""

    controllers: dict[Text, dict[Text, PositivePair]]
    """Name -> (scenario key -> lowest and highest value). The search starts from what the controller has."""
    generations: Annotated[Count, Field(ge=1, le=10_000)] = 12
    """Most of them, each of `population` settings; fewer where the search has converged."""
    population: Annotated[Count, Field(ge=4, le=1000)] = 8
    """Settings of a generation, the same for all controllers."""
    spread: Fraction = 0.2
    """Standard deviation of the first generation, as a share of the way from lowest to highest."""
    seed: Annotated[Seed, Field(lt=2**32)] = 1
    """Of the search."""
    seeds: Annotated[tuple[Seed, ...], Field(min_length=1)] = (1,)
    """In place of the comparison's own: of the noise in the runs of the search."""
    set: dict[Text, Any] = Field(default_factory=dict)
    """Scenario key -> value, in the runs of the search alone."""

    def rules(self) -> None:
        """See `Section.rules`."""
        if not self.controllers:
            raise ConfigurationError("controllers", {}, "at least one name, with the keys to search")
        for name, keys in self.controllers.items():
            if not keys:
                allowed = "at least one scenario key, with its lowest and highest value"
                raise ConfigurationError(f"controllers.{name}", {}, allowed)
            for key, (low, high) in keys.items():
                if not low < high:
                    raise ConfigurationError(f"controllers.{name}.{key}", [low, high], "a lowest below a highest value")


class TunedFile(Section, key=""):
    """What a search has found."""

    name: Text
    """Of the comparison."""
    controllers: dict[Text, dict[Text, Positive]]
    """Name -> (scenario key -> value)."""

    @classmethod
    def load(cls, path: Path, names: Collection[str]) -> dict[str, dict[str, float]]:
        """Values by controller and key.

        Args:
            path: The file.
            names: Of the controllers that there are.

        Raises:
            ConfigurationError: Missing, unreadable or malformed file; a controller that there is not.
        """
        if not path.is_file():
            raise ConfigurationError("tuned", str(path), "a file as `stewart-drake tune` writes it")
        found = cls.from_dict(read_mapping("tuned", path, 80), "tuned").controllers
        for name in found:
            if name not in names:
                raise ConfigurationError("tuned.controllers", name, f"one of {', '.join(names)}")
        return found
