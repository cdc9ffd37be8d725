"""Named parts of a mesh, found by their names whatever the case of the letters."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TypeVar

T = TypeVar("T")


class PartNames(Mapping[str, T]):
    """Name to part.  A name is found as it is written, else as the only one that differs by case.

    Names of Abaqus and Nastran do not distinguish capitals, and tools write the names of one set
    in several ways; names of other formats that differ by case only are different names.
    Iteration yields the names as the file has them.

    Args:
        parts: Name to part.
    """

    def __init__(self, parts: Mapping[str, T]) -> None:
        self._parts = dict(parts)
        self._caseless: dict[str, list[str]] = {}
        for name in self._parts:
            self._caseless.setdefault(name.casefold(), []).append(name)

    def alike(self, name: str) -> tuple[str, ...]:
        """The names that are this one: itself, or else all that differ from it by case only."""
        if name in self._parts:
            return (name,)
        return tuple(self._caseless.get(name.casefold(), ()))

    def __getitem__(self, name: str) -> T:
        alike = self.alike(name)
        if len(alike) != 1:
            raise KeyError(name)
        return self._parts[alike[0]]

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and len(self.alike(name)) == 1

    def __iter__(self) -> Iterator[str]:
        return iter(self._parts)

    def __len__(self) -> int:
        return len(self._parts)

    def __repr__(self) -> str:
        return f"PartNames({self._parts!r})"
