"""The bulk data of a Nastran deck by their names."""

from __future__ import annotations

from collections.abc import Iterable

from dolfin_elastic.case.decks.deck import Place
from dolfin_elastic.mesh.formats.nastran.bulk import Bulk
from dolfin_elastic.mesh.formats.nastran.entries import Entry
from dolfin_elastic.mesh.formats.nastran.groups import Group, Groups

SOLIDS = ("tetra", "tetra10")


def place(entry: Entry) -> Place:
    """Where an entry stands."""
    return Place(*entry.place, entry.name)


class Table:
    """All entries.

    Args:
        entries: Those whose names the mesh does not need.
    """

    def __init__(self, bulk: Bulk, entries: Iterable[Entry]) -> None:
        self.bulk, self.groups = bulk, Groups(bulk, strict=True)
        self._rows: dict[str, list[Entry]] = {}
        for entry in entries:
            self._rows.setdefault(entry.name, []).append(entry)

    def of(self, name: str) -> list[Entry]:
        """Entries of a name."""
        return self._rows.get(name, [])

    @property
    def names(self) -> list[str]:
        """Names of the entries."""
        return list(self._rows)

    def solids(self) -> dict[int, Entry]:
        """Number of each property of tetrahedra to the first of these."""
        result = dict[int, Entry]()
        for kind in SOLIDS:
            if (elements := self.bulk.elements.get(kind)) is not None:
                for part, entry in zip(elements.parts, elements.entries, strict=True):
                    result.setdefault(part or entry.integer(0), entry)
        return result

    def in_set(self, kind: str, number: int) -> list[Group]:
        """Groups of a kind in a set."""
        return [g for g in self.groups.all if g.kind == kind and g.number == number]

    def parameter(self, name: str) -> Entry | None:
        """A PARAM."""
        rows = [e for e in self.of("PARAM") if e.text(0).upper() == name]
        return rows[-1] if rows else None

    @property
    def mass_factor(self) -> float:
        """Mass of a unit of density (WTMASS)."""
        factor = self.parameter("WTMASS")
        return 1.0 if factor is None else factor.real(1)
