"""Tables that Python and notebooks show."""

from __future__ import annotations

import csv
import io
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from html import escape


class Tabled(ABC):
    """Something whose result is a table."""

    @abstractmethod
    def columns(self) -> dict[str, list[object]]:
        """The table by columns, SI units; nan where a number is not known."""

    def frame(self) -> Mapping[str, object]:
        """The table as a pandas DataFrame, where pandas is there; else `columns`."""
        try:
            from pandas import DataFrame  # type: ignore[import-untyped]
        except ImportError:
            return self.columns()
        return DataFrame(self.columns())

    def _repr_html_(self) -> str:
        columns = self.columns()
        head = "".join(f"<th>{escape(name)}</th>" for name in columns)
        rows = (
            "".join(f"<td>{escape(str(cell_text(value)))}</td>" for value in row)
            for row in zip(*columns.values(), strict=True)
        )
        body = "".join(f"<tr>{row}</tr>" for row in rows)
        return f"<table><tr>{head}</tr>{body}</table>"


def csv_text(columns: Mapping[str, Sequence[object]]) -> str:
    """A table by columns as CSV."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(columns)
    for row in zip(*columns.values(), strict=True):
        writer.writerow([cell_text(value) for value in row])
    return buffer.getvalue()


def cell_text(value: object) -> object:
    """A value as files and notebooks show it, in one line; empty where it is not known."""
    if isinstance(value, str):
        return "; ".join(line.strip() for line in value.splitlines())
    if isinstance(value, float):
        return f"{value:.12g}" if math.isfinite(value) else ""
    return value
