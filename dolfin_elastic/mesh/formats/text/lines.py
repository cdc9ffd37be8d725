"""Meshes as plain text: lines of words, and tables of numbers in them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import FloatArray, IntArray
from dolfin_elastic.mesh.formats.raw import Block


class Lines:
    """The lines of a file that are neither blank nor comments (from # on), one at a time."""

    def __init__(self, path: Path) -> None:
        self._file, self._number = path.name, 0
        self._lines = self._words(path)

    def _words(self, path: Path) -> Iterator[list[str]]:
        with path.open(encoding="latin-1") as file:
            for self._number, line in enumerate(file, start=1):
                if words := line.partition("#")[0].split():
                    yield words

    def __iter__(self) -> Iterator[list[str]]:
        return self._lines

    def error(self, what: str, expected: str = "") -> MeshError:
        """An error that names file and line."""
        return MeshError(what, where=f"{self._file}:{self._number}", expected=expected)

    def row(self) -> list[str]:
        """The words of the next line.

        Raises:
            MeshError: There is none.
        """
        words = next(self._lines, None)
        if words is None:
            raise self.error("the file is cut short")
        return words

    def integers(self, words: list[str]) -> list[int]:
        """Words of this line as whole numbers.

        Raises:
            MeshError: One of them is none.
        """
        try:
            return [int(word) for word in words]
        except ValueError:
            raise self.error(f"'{' '.join(words)[:60]}' are no whole numbers") from None

    def table(self, count: int) -> FloatArray:
        """The next lines, all with the same number of numbers; shape (count, n).

        Raises:
            MeshError: There are fewer, or one has another number of them.
        """
        rows = list[list[float]]()
        for _ in range(count):
            words = self.row()
            try:
                rows.append([float(word) for word in words])
            except ValueError:
                raise self.error(f"'{' '.join(words)[:60]}' are no numbers") from None
            if len(rows[-1]) != len(rows[0]):
                raise self.error(f"the line has {len(words)} numbers, those before {len(rows[0])}")
        table = np.array(rows, dtype=np.float64).reshape(count, -1)
        if not np.isfinite(table).all():
            raise self.error("a number before this line is infinite, or none")
        return table


def by_number(kind: str, nodes: IntArray, numbers: IntArray | FloatArray) -> Block:
    """Elements with parts by numbers, whole ones or others, of which 0 is no part.

    Args:
        numbers: One of each element, shape (n,).
    """
    parts = {f"{n:.15g}": np.flatnonzero(numbers == n) for n in np.unique(numbers) if n}
    return Block(kind, nodes, parts)
