"""Names of the nodes and faces that supports and loads of a Nastran file mean.

Their entries list nodes and elements by number.  Those of a set with the same value are one named
part of the mesh, so that `look` shows them and a case may use them.
Source: MSC Nastran 2021, Quick Reference Guide, entries SPC, SPC1, SPCD, FORCE, FORCE1, PLOAD,
PLOAD4.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import chain

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.formats.nastran.bulk import CELAS, RIGID, Bulk
from dolfin_elastic.mesh.formats.nastran.entries import Entry
from dolfin_elastic.mesh.formats.nastran.systems import Systems

_MOST = 10**7
_SOLID = ("tetra", "tetra10")


@dataclass
class Group:
    """Nodes or faces with the same value.

    Attributes:
        name: In the mesh.
        kind: "spc" of supports, "spcd" of their displacements, "force", "pload" of pressures and
            tractions, "rbe2" and "rbe3" of nodes that follow a reference node, "celas" of springs
            to the ground.
        number: Of the set that it belongs to; 0: of no set, but of the nodes themselves.  Of rigid
            elements and springs their own.
        reference: The node that is followed; of supports and forces the one where they act, if it
            is followed; 0: none.
        entry: The first entry.
        components: Directions of supports and springs, digits 1 to 3, at a reference node to 6.
        system: Of these directions.
        value: Displacement of supports; components of the force; pressure and, where it does not
            act along the normal, the direction.
        nodes: Their numbers.
        facets: Numbers of the nodes of each face.
        behind: Of each face the node of its tetrahedron that is not on it.
    """

    name: str
    kind: str
    number: int
    entry: Entry
    reference: int = 0
    components: str = ""
    system: int = 0
    value: tuple[float, ...] = ()
    nodes: set[int] = field(default_factory=set)
    facets: list[tuple[int, int, int]] = field(default_factory=list)
    behind: list[int] = field(default_factory=list)


class Groups:
    """All of a file.

    Args:
        bulk: The file.
        strict: An entry that cannot be read is an error, else it is passed over.
    """

    def __init__(self, bulk: Bulk, *, strict: bool) -> None:
        self._bulk = bulk
        self._systems: Systems = bulk.basic()
        self._found: dict[tuple[object, ...], Group] = {}
        self._names: dict[str, int] = {}
        self._taken = Counter[tuple[object, ...]]()
        self._solids: dict[int, list[int]] | None = None
        self.references = _references(bulk.grouped)
        for entry in bulk.grouped:
            try:
                _TAKE[entry.name](self, entry)
            except MeshError:
                if strict:
                    raise
        self._take_grids()

    @property
    def all(self) -> list[Group]:
        """The groups, in the order of their first entries."""
        return list(self._found.values())

    def _group(self, kind: str, number: int, entry: Entry, *key: object) -> Group:
        whole = (kind, number, *key)
        if whole not in self._found:
            parts = [kind, str(number), *(k for k in key[:1] if isinstance(k, str))]
            base = "_".join(parts if number else [kind, *parts[2:]])
            self._names[base] = count = self._names.get(base, 0) + 1
            name = base if count == 1 else f"{base}_{count}"
            self._found[whole] = Group(name, kind, number, entry)
        return self._found[whole]

    def _acting(
        self, kind: str, entry: Entry, value: tuple[float, ...], at: Iterable[int], reference: int
    ) -> Group:
        """Group of a load; one that acts once more at the same nodes is of a group of its own.

        Args:
            at: The nodes of one force or of one face.
        """
        number, nodes = entry.integer(0), tuple(sorted(at))
        group = self._group(
            kind, number, entry, value, reference, self._taken[kind, number, value, nodes]
        )
        self._taken[kind, number, value, nodes] += 1
        group.value, group.reference = value, reference
        return group

    # --- supports ---

    def _hold(self, kind: str, entry: Entry, node: int, word: str, value: float) -> None:
        if not word or set(word) - set("0123456"):
            raise entry.error(f"'{word}' are no directions", "digits 1 to 6")
        grid = self._bulk.grids.get(node)
        if grid is None:
            raise entry.error(f"there is no GRID {node}")
        reference = node if node in self.references else 0
        components = "".join(sorted(set(word) & set("123456" if reference else "123")))
        if components:
            number = entry.integer(0) if kind != "grid" else 0
            system = self._bulk.system_of(grid, 5)
            group = self._group(
                "spc" if kind == "grid" else kind,
                number,
                entry,
                components,
                system,
                value,
                reference,
            )
            group.reference = reference
            group.components, group.system, group.value = components, system, (value,)
            group.nodes.add(node)

    def _spc(self, entry: Entry) -> None:
        for at in (1, 4):
            if entry.text(at):
                word = entry.text(at + 1)
                kind = entry.name.lower()
                self._hold(kind, entry, entry.integer(at), word, entry.real(at + 2))

    def _spc1(self, entry: Entry) -> None:
        for node in _listed(entry, 2, self._bulk.grids):
            if node in self._bulk.grids or entry.text(3).upper() != "THRU":
                self._hold("spc", entry, node, entry.text(1), 0.0)

    def _take_grids(self) -> None:
        for number, grid in self._bulk.grids.items():
            if word := self._bulk.supports_at(grid):
                self._hold("grid", grid, number, word, 0.0)

    # --- forces ---

    def _force(self, entry: Entry) -> None:
        node, system = entry.integer(1), entry.integer(2, 0)
        vector = np.array([entry.real(i) for i in (4, 5, 6)])
        self._add_force(entry, node, entry.real(3) * self.direction(entry, system, vector, node))

    def _force1(self, entry: Entry) -> None:
        a, b = (self.place(entry, entry.integer(i)) for i in (3, 4))
        length = float(np.linalg.norm(b - a))
        if not length:
            raise entry.error("its two nodes are at one point")
        self._add_force(entry, entry.integer(1), np.asarray(entry.real(2) / length * (b - a)))

    def _add_force(self, entry: Entry, node: int, vector: FloatArray) -> None:
        self.place(entry, node)
        size = float(np.abs(vector).max())
        # Rounding of the directions must not make a group of each node.
        digits = min(12 - int(np.floor(np.log10(size))), 300) if size else 0
        value = tuple(float(x) + 0.0 for x in np.round(vector, digits))
        reference = node if node in self.references else 0
        self._acting("force", entry, value, [node], reference).nodes.add(node)

    def place(self, entry: Entry, node: int) -> FloatArray:
        """Basic coordinates of a node, shape (3,)."""
        point = self._bulk.point(node)
        if point is None:
            raise entry.error(f"there is no GRID {node}")
        return self._systems.place(point[0], point[1][None, :], entry)[0]

    def direction(
        self, entry: Entry, system: int, vector: FloatArray, node: int | None = None
    ) -> FloatArray:
        """Basic components of a vector.

        Args:
            system: Number of the system in which its components are; 0: the basic one.
            vector: Shape (3,).
            node: Where it acts, which matters to systems that are not rectangular.

        Raises:
            MeshError: The system needs a node.
        """
        if not system:
            return vector
        definition = self._bulk.systems.get(system)
        if definition is not None and definition.kind != "R":
            if node is None:
                raise entry.error(f"the coordinate system {system} is not rectangular")
            return self._systems.axes_at(system, self.place(entry, node), entry).T @ vector
        both = np.stack([np.zeros(3), vector])
        start, end = self._systems.place(system, both, entry)
        return np.asarray(end - start)

    # --- nodes that follow others, and springs ---

    def _rigid(self, entry: Entry) -> None:
        """RBE2 with its dependent nodes, RBE3 with those that it averages, of one weight."""
        if entry.name == "RBE2":
            self._follow(entry, entry.integer(1), entry.text(2), _listed(_bare(entry), 3, ()))
            return
        words = list[str]()
        for word in entry.fields[4:]:
            if word.upper() in ("UM", "ALPHA"):
                break
            words.append(word)
        weights = [i for i, word in enumerate(words) if "." in word]
        if len({entry.real(4 + i) for i in weights}) != 1:
            raise entry.error("its nodes have no weights, or several", "one weight, such as 1.")
        directions = {i + 1 for i in weights}
        if any(not set("123") <= set(words[i]) for i in directions if i < len(words)):
            raise entry.error("its nodes have other directions than 123", "components 123")
        rest = [w for i, w in enumerate(words) if i not in directions and i not in weights]
        nodes = _listed(Entry(entry.name, rest, entry.line), 0, ())
        self._follow(entry, entry.integer(2), entry.text(3), nodes)

    def _follow(self, entry: Entry, node: int, word: str, nodes: Iterable[int]) -> None:
        members = set(nodes)
        for number in (node, *members):
            self.place(entry, number)
        group = self._group(entry.name.lower(), entry.integer(0), entry)
        group.reference, group.components, group.nodes = node, word, members

    def _spring(self, entry: Entry) -> None:
        ends = [i for i in (2, 4) if entry.text(i) not in ("", "0")]
        if len(ends) == 1:
            node = entry.integer(ends[0])
            self.place(entry, node)
            group = self._group("celas", entry.integer(0), entry)
            group.components = entry.text(ends[0] + 1)
            group.nodes.add(node)

    # --- pressures ---

    def _solid(self, entry: Entry, number: int) -> list[int]:
        if self._solids is None:
            self._solids = {
                e.integer(0): nodes[:4]
                for kind in _SOLID
                if (elements := self._bulk.elements.get(kind)) is not None
                for e, nodes in zip(elements.entries, elements.nodes, strict=True)
            }
        if number not in self._solids:
            raise entry.error(f"there is no CTETRA {number}")
        return self._solids[number]

    def _pload4(self, entry: Entry) -> None:
        values = [entry.real(2), *(entry.real(i) for i in (3, 4) if entry.text(i))]
        if any(v != values[0] for v in values):
            raise entry.error("the pressure varies over the face")
        direction = list[float]()
        vector = np.array([entry.real(i) for i in (9, 10, 11)])
        if vector.any():
            basic = self.direction(entry, entry.integer(8, 0), vector)
            direction = [float(x) for x in basic / np.linalg.norm(basic)]
        if entry.text(6).upper() == "THRU":
            raise entry.error("THRU is of shells; faces of CTETRA are named by nodes")
        nodes = self._solid(entry, entry.integer(1))
        first, opposite = entry.integer(6), entry.integer(7)
        if first not in nodes or opposite not in nodes or first == opposite:
            raise entry.error(f"{first} and {opposite} name no face of CTETRA {entry.integer(1)}")
        a, b, c = (node for node in nodes if node != opposite)
        self._press(entry, (values[0], *direction), (a, b, c), opposite)

    def _pload(self, entry: Entry) -> None:
        """Along the normal of its nodes by the right-hand rule: outwards or inwards."""
        a, b, c = (entry.integer(i) for i in (2, 3, 4))
        if entry.text(5):
            raise entry.error("a face of four nodes is none of a tetrahedron")
        x = [self.place(entry, node) for node in (a, b, c)]
        fourth = self._behind(entry, (a, b, c))
        normal = np.cross(x[1] - x[0], x[2] - x[0])
        outwards = float(normal @ (x[0] - self.place(entry, fourth))) > 0
        value = -entry.real(1) if outwards else entry.real(1)
        self._press(entry, (value,), (a, b, c), fourth)

    def _press(
        self, entry: Entry, value: tuple[float, ...], face: tuple[int, int, int], behind: int
    ) -> None:
        group = self._acting("pload", entry, value, face, 0)
        group.facets.append(face)
        group.behind.append(behind)

    def outwards(self, group: Group) -> FloatArray | None:
        """The normal out of the body that all faces of a group have, shape (3,); None: several."""
        of = {
            n: self.place(group.entry, n)
            for n in {*group.behind, *chain.from_iterable(group.facets)}
        }
        x = np.array([[of[n] for n in face] for face in group.facets])
        normals = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        inside = np.array([of[n] for n in group.behind]) - x[:, 0]
        normals *= -np.sign((normals * inside).sum(axis=1))[:, None]
        same = np.abs(normals - normals[0]).max() < 1e-6
        return np.asarray(normals[0]) if same else None

    def _behind(self, entry: Entry, face: tuple[int, int, int]) -> int:
        """The node of the tetrahedron of a face that is not on it."""
        for kind in _SOLID:
            elements = self._bulk.elements.get(kind)
            for nodes in elements.nodes if elements is not None else ():
                if set(face) <= set(nodes[:4]):
                    return next(node for node in nodes[:4] if node not in face)
        raise entry.error(f"{face[0]}, {face[1]} and {face[2]} are no face of a CTETRA")


_TAKE: dict[str, Callable[[Groups, Entry], None]] = {
    "SPC": Groups._spc,
    "SPCD": Groups._spc,
    "SPC1": Groups._spc1,
    "FORCE": Groups._force,
    "FORCE1": Groups._force1,
    "PLOAD4": Groups._pload4,
    "PLOAD": Groups._pload,
    **dict.fromkeys(RIGID, Groups._rigid),
    **dict.fromkeys(CELAS, Groups._spring),
}


def _references(entries: Iterable[Entry]) -> set[int]:
    """Nodes that others follow."""
    at = {"RBE2": 1, "RBE3": 2}
    words = (entry.text(at[entry.name]) for entry in entries if entry.name in RIGID)
    return {int(word) for word in words if word.isdecimal()}


def expansion(entry: Entry) -> float:
    """Coefficient of thermal expansion of an RBE2 or RBE3, in front of its temperature."""
    if entry.name == "RBE2":
        first = len(_bare(entry).fields)
    else:
        words = [word.upper() for word in entry.fields]
        first = words.index("ALPHA") + 1 if "ALPHA" in words else len(words)
    given = [i for i in range(first, len(entry.fields)) if entry.text(i)]
    return 0.0 if given in ([], [first + 1]) else entry.real(given[0])


def _bare(entry: Entry) -> Entry:
    """An RBE2 without its coefficient of expansion and that one's temperature, its last fields."""
    fields = entry.fields
    while fields and ("." in fields[-1] or not fields[-1]):
        fields = fields[:-1]
    return Entry(entry.name, fields, entry.line)


def _listed(entry: Entry, first: int, known: Collection[int]) -> Iterator[int]:
    """Numbers in the fields from one on, in which a THRU b are ranges.

    Args:
        known: Numbers of which alone ranges consist that are longer than these are; none: all.
    """
    words = [entry.text(i).upper() for i in range(first, len(entry.fields))]
    i = 0
    while i < len(words):
        if words[i] == "":
            i += 1
        elif i + 1 < len(words) and words[i + 1] == "THRU":
            start, end = entry.integer(first + i), entry.integer(first + i + 2)
            if end - start > _MOST:
                raise entry.error(f"{start} THRU {end} are more nodes than a file has")
            long = 0 < len(known) < end - start
            yield from (n for n in known if start <= n <= end) if long else range(start, end + 1)
            i += 3
        else:
            yield entry.integer(first + i)
            i += 1
