"""What an estimate with intervals tells: in some lines, as CSV, as a pandas.DataFrame, and as a page in Markdown."""

from __future__ import annotations

import csv
import io
from abc import ABC, abstractmethod
from typing import Any, ClassVar

from stewart_drake.errors import installed_with


class Report(ABC):
    """Base of results that have a row of numbers for each parameter, a summary, and a table of texts."""

    columns: ClassVar[tuple[str, ...]]
    """Of `rows`."""
    about: ClassVar[str]
    """What the table says, a paragraph."""
    picture: ClassVar[str]
    """What the report's picture shows."""

    @property
    @abstractmethod
    def title(self) -> str:
        """Of a page."""

    @abstractmethod
    def rows(self) -> list[tuple[Any, ...]]:
        """A row of `columns` for each parameter, in SI units; the half width is that of the 95 % interval."""

    @abstractmethod
    def summary(self) -> list[tuple[str, str]]:
        """Name and text of each result."""

    @abstractmethod
    def table(self) -> tuple[list[str], list[list[str]]]:
        """Header and rows of texts: the parameters with their 95 % intervals."""

    def __repr__(self) -> str:
        return "\n".join([self.title, *(f"  {name}: {text}" for name, text in self.summary())])

    def to_csv(self) -> str:
        """`rows` as a table."""
        stream = io.StringIO()
        csv.writer(stream, lineterminator="\n").writerows([self.columns, *self.rows()])
        return stream.getvalue()

    def to_pandas(self) -> Any:
        """`rows` as a pandas.DataFrame; a `MissingPackageError` where pandas is not installed."""
        with installed_with("pandas", "rows() gives the same as tuples"):
            import pandas as pd

        return pd.DataFrame(self.rows(), columns=self.columns)

    def to_markdown(self, picture: str) -> str:
        """A page with a picture, a file beside it."""
        header, rows = self.table()
        summary = "\n".join(f"- {name}: {text}" for name, text in self.summary())
        table = "\n".join(f"| {' | '.join(row)} |" for row in (header, ["---"] * len(header), *rows))
        return f"# {self.title}\n\n{summary}\n\n{self.about}\n\n{table}\n\n![{self.picture}]({picture})\n"
