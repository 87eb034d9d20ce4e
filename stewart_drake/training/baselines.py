"""What a trained tuner has to beat: settings that stay, and a schedule; `make tuner_baselines` has searched them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from stewart_drake.files.whole import PACKAGE
from stewart_drake.files.yaml_files import read_mapping
from stewart_drake.section import Real, Section, Text

SHIPPED = PACKAGE / "weights" / "baselines.yaml"

Numbers = tuple[Real, Real, Real, Real]


class Baselines(Section, key=""):
    """What the search has found: settings (4,) in decades above the default, and what they cost in it."""

    name: Text = "baselines"
    best: Numbers
    """Over both robots."""
    best_of_robot: dict[Text, Numbers]
    """Robot -> the best over its own kinds."""
    best_of_kind: dict[Text, dict[Text, Numbers]]
    """Robot -> kind -> the best for it, also of kinds that nothing is trained on: what knowing the kind is worth."""
    pair: dict[Text, tuple[Real, Real]]
    """Robot -> the best of the paper's nine pairs."""
    schedule: dict[Text, Any]
    """Keys of `ScheduleTuner`, made over both robots."""
    costs: dict[Text, dict[Text, dict[Text, Real]]]
    """Robot -> kind -> geometric mean of J over the seeds: default, and the above."""
    evaluations: dict[Text, Real]
    """Points in each search, and seeds of each kind."""

    @classmethod
    def load(cls, path: Path = SHIPPED) -> Baselines:
        """Reads the file that the package carries, or another.

        Raises:
            ConfigurationError: Missing, unreadable or malformed.
        """
        return cls.from_dict(read_mapping("settings", path, 200))
