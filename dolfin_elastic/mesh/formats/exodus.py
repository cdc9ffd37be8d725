"""Exodus files (.e, .exo, .ex2, .g, .gen), as Cubit, MOOSE, Sierra and ParaView write them.

Read here rather than through meshio 5.3, which needs a library for netCDF, fails on blocks of TET4
and leaves out side sets and names.  Classic netCDF files (CDF-1 and CDF-2) are read by scipy,
netCDF-4 files, which are HDF5, by h5py.  Elements of four and ten nodes list these as VTK does.
Source: L. A. Schoof, V. R. Yarberry, EXODUS II: A Finite Element Data Model, SAND92-2137 (1994).
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.files import hdf5
from dolfin_elastic.core.types import AnyArray, FloatArray, IntArray
from dolfin_elastic.mesh.fields import as_columns
from dolfin_elastic.mesh.formats.raw import Block, MeshFile, joined, missing

if TYPE_CHECKING:
    import h5py

# Beginning of the type of a block's elements, and kinds by their number of nodes.
_KINDS = {
    "TRI": {3: "triangle", 6: "triangle6"},
    "TET": {4: "tetra", 10: "tetra10"},
    "HEX": {8: "hexahedron", 20: "hexahedron20", 27: "hexahedron27"},
    "WED": {6: "wedge", 15: "wedge15"},
    "PYR": {5: "pyramid", 13: "pyramid13"},
    "QUA": {4: "quad", 8: "quad8", 9: "quad9"},
    "SHE": {3: "triangle", 4: "quad", 6: "triangle6", 8: "quad8", 9: "quad9"},
    **{stem: {2: "line", 3: "line3"} for stem in ("BAR", "BEA", "TRU", "ROD", "EDG")},
    **{stem: {1: "vertex"} for stem in ("SPH", "CIR", "POI")},
}
_MOST_LETTERS = 1 << 26
_TETRA = ((0, 1, 3), (1, 2, 3), (0, 3, 2), (0, 2, 1))
_TRIANGLE = ((0, 1), (1, 2), (2, 0))
_BOTH = ((0, 1, 2), (2, 1, 0))
"""In space, and of shells, the sides 1 and 2 of a triangle are the triangle itself."""


@dataclass(frozen=True)
class _File:
    """Arrays of a netCDF file.

    Attributes:
        names: Of all arrays.
        get: Name to numbers.
        last: Name to its last row, of data at several times.
        letters: Name to an array of single letters, a text in each row.
        kind: Name of the nodes of a block to the type of its elements.
    """

    names: frozenset[str]
    get: Callable[[str], AnyArray]
    last: Callable[[str], AnyArray]
    letters: Callable[[str], AnyArray]
    kind: Callable[[str], str]

    @property
    def times(self) -> int:
        """Number of the times of fields."""
        return len(self.get("time_whole")) if "time_whole" in self.names else 0

    def fields(self, titles: str, member: str, after: str, rows: int) -> dict[str, FloatArray]:
        """Fields at the last time, shape (rows, 1) each.

        Args:
            member: Beginning of the arrays of their numbers; 1, 2 ... and `after` follow.
        """
        names = self.texts(titles) if self.times else []
        arrays = {title: f"{member}{i}{after}" for i, title in enumerate(names, start=1)}
        return {
            title: as_columns(self.last(array), rows, title)
            for title, array in arrays.items()
            if array in self.names
        }

    def integers(self, name: str) -> IntArray:
        """Whole numbers; none where there is no such array."""
        if name not in self.names:
            return np.empty(0, dtype=np.int64)
        return np.asarray(self.get(name)).astype(np.int64)

    def texts(self, name: str) -> list[str]:
        """Texts that end at their first zero, which numpy shows as an empty letter."""
        rows: Iterable[AnyArray] = self.letters(name) if name in self.names else ()
        words = [b"".join(takewhile(bool, row)) for row in rows]
        return [word.decode("utf-8", "replace").strip() for word in words]

    def titles(self, names: str, numbers: str, word: str, member: str) -> list[str]:
        """Names of blocks or sets; those without one have their number.

        Args:
            word: What stands before the number.
            member: Beginning of the arrays of their members, which is followed by 1, 2 ...
        """
        given, ids = self.texts(names), self.integers(numbers)
        present = [int(n[len(member) :]) for n in self.names if _is_counted(n, member)]
        count = max([*present, len(ids)], default=0)
        ids = ids if len(ids) == count else np.arange(1, count + 1)
        given += [""] * (count - len(given))
        return [name or f"{word}_{i}" for name, i in zip(given[:count], ids, strict=True)]


@dataclass
class _Blocks:
    """Blocks of elements, in the order that numbers the elements.

    Attributes:
        names: Of the blocks that have elements.
        kinds: In the words of meshio.
        shells: Whether the type is one of shells, and not of plane elements.
        nodes: Rows of points.
        parts: Further names of elements, to rows of the block.
        data: Name to numbers of each element.
        empty: Names of blocks and sets without members.
    """

    names: list[str] = field(default_factory=list)
    kinds: list[str] = field(default_factory=list)
    shells: list[bool] = field(default_factory=list)
    nodes: list[IntArray] = field(default_factory=list)
    parts: list[dict[str, IntArray]] = field(default_factory=list)
    data: list[dict[str, FloatArray]] = field(default_factory=list)
    empty: list[str] = field(default_factory=list)

    def split(self, elements: IntArray) -> Iterator[tuple[int, IntArray, IntArray]]:
        """Index of each block, which of some elements are in it, and their rows there."""
        start = 0
        for i, nodes in enumerate(self.nodes):
            at = np.flatnonzero((elements >= start) & (elements < start + len(nodes)))
            yield i, at, elements[at] - start
            start += len(nodes)


def read_exodus(path: Path) -> MeshFile:
    """Reads an Exodus file, with the fields of its last time. Local: one rank reads.

    Raises:
        MeshError: It is damaged, of a kind that is not read, or has elements that are not
            understood.
    """
    with _opened(path) as file:
        try:
            return _mesh(file, path.name)
        except MeshError:
            raise
        except Exception as error:  # of any kind where the file is damaged
            raise _damaged(path, error) from None


def _damaged(path: Path, error: Exception) -> MeshError:
    reason = " ".join(f"{type(error).__name__} {error}".split())[:200]
    return MeshError(
        f"the Exodus file is damaged: {reason}",
        where=path.name,
        expected="the file as it was written",
    )


@contextmanager
def _opened(path: Path) -> Iterator[_File]:
    """A classic netCDF file, or one of HDF5."""
    with path.open("rb") as start:
        magic = start.read(4)
    if magic == b"CDF\x05":
        raise MeshError(
            "its 64-bit classic format (CDF-5) is not read",
            where=path.name,
            expected=f"nccopy -k nc4 {path.name} new{path.suffix}",
        )
    if magic in (b"CDF\x01", b"CDF\x02"):
        with _classic(path) as file:
            yield file
    elif hdf5.is_hdf5(path):
        with _of_hdf5(path) as file:
            yield file
    else:
        raise MeshError(
            "this is no Exodus file: it is neither a netCDF file nor an HDF5 file",
            where=path.name,
            expected="the file as it was written",
        )


@contextmanager
def _classic(path: Path) -> Iterator[_File]:
    from scipy.io import netcdf_file

    try:
        file = netcdf_file(path, "r", mmap=True)
    except Exception as error:  # of any kind where the file is damaged
        raise _damaged(path, error) from None
    arrays = file.variables

    def native(values: AnyArray) -> AnyArray:
        return np.array(values, dtype=values.dtype.newbyteorder("="))

    def kind(name: str) -> str:
        return bytes(arrays[name].elem_type).decode("ascii", "replace")

    try:
        yield _File(
            frozenset(arrays),
            lambda name: native(arrays[name][:]),
            lambda name: native(arrays[name][-1]),
            lambda name: np.array(arrays[name][:]),
            kind,
        )
    finally:
        with warnings.catch_warnings():  # where an error holds views of the file
            warnings.simplefilter("ignore", RuntimeWarning)
            file.close()


@contextmanager
def _of_hdf5(path: Path) -> Iterator[_File]:
    try:
        with hdf5.opened(path) as file:

            def last(name: str) -> AnyArray:
                count = hdf5.shape_in(file, name)[0]
                return hdf5.rows_of(file, name, count - 1, count)[0]

            def kind(name: str) -> str:
                text = np.ravel(file[name].attrs["elem_type"])[0]
                return text.decode("ascii", "replace") if isinstance(text, bytes) else str(text)

            yield _File(
                frozenset(file),
                lambda name: hdf5.rows_of(file, name),
                last,
                lambda name: _letters(file[name]),
                kind,
            )
    except OSError as error:
        raise _damaged(path, error) from None


def _letters(data: h5py.Dataset) -> AnyArray:
    """Names of blocks, sets or fields; of a size that no names have, which would fill the memory.

    Raises:
        OSError: They are larger than that.
    """
    if math.prod(data.shape) > _MOST_LETTERS:
        raise OSError(f"'{data.name}' states {math.prod(data.shape)} letters")
    return np.asarray(data[()]).astype("S1")


def _mesh(file: _File, source: str) -> MeshFile:
    if "nem_ftype" in file.names or "node_mapi" in file.names:
        raise MeshError(
            "the file is one of the parts of a mesh", where=source, expected="joined by epu"
        )
    axes = [f"coord{axis}" for axis in "xyz" if f"coord{axis}" in file.names]
    if not axes and "coord" not in file.names:
        raise MeshError("the Exodus file has no nodes", where=source)
    columns = [file.get(axis) for axis in axes] if axes else list(file.get("coord"))
    points = np.stack([np.asarray(column, dtype=np.float64) for column in columns], axis=1)
    blocks = _blocks(file, len(points), source)
    sides, lost = _side_sets(file, blocks, points.shape[1], source)
    lost |= _element_sets(file, blocks)
    sets = dict[str, IntArray]()
    for k, name in enumerate(file.titles("ns_names", "ns_prop1", "node_set", "node_ns"), start=1):
        wanted = np.unique(file.integers(f"node_ns{k}")) - 1
        inside = (wanted >= 0) & (wanted < len(points))
        _note(name, missing(wanted[~inside] + 1, len(wanted), "nodes"), lost)
        if len(wanted):
            sets[name] = wanted[inside]
        else:
            blocks.empty.append(name)
    solid = [
        Block(kind, nodes, {name: np.arange(len(nodes)), **parts}, data)
        for name, kind, nodes, parts, data in zip(
            blocks.names, blocks.kinds, blocks.nodes, blocks.parts, blocks.data, strict=True
        )
    ]
    notes = [f"groups without members: {', '.join(blocks.empty)}"] if blocks.empty else []
    return MeshFile(
        points,
        [*solid, *sides],
        notes,
        point_sets=sets,
        information=[f"fields at the last of {file.times} times"] if file.times > 1 else [],
        point_data=file.fields("name_nod_var", "vals_nod_var", "", len(points)),
        incomplete=lost,
    )


def _blocks(file: _File, points: int, source: str) -> _Blocks:
    blocks = _Blocks()
    for k, name in enumerate(file.titles("eb_names", "eb_prop1", "block", "connect"), start=1):
        nodes = file.integers(f"connect{k}") - 1
        if not len(nodes):
            blocks.empty.append(name)
            continue
        text = file.kind(f"connect{k}").strip().rstrip("\0")
        kind = _KINDS.get(text[:3].upper(), {}).get(nodes.shape[1]) if nodes.ndim == 2 else None
        if kind is None:
            raise MeshError(
                f"the block '{name}' has {len(nodes)} elements of the type '{text}' with "
                f"{nodes.shape[-1]} nodes, which is not understood",
                where=source,
                expected="TETRA4, TETRA10, TRI3 or TRI6",
            )
        lost = np.unique(nodes[(nodes < 0) | (nodes >= points)]) + 1
        if len(lost):
            raise MeshError(
                f"elements refer to {len(lost)} points that do not exist, for example {lost[0]}",
                where=source,
            )
        blocks.names.append(name)
        blocks.kinds.append(kind)
        blocks.shells.append("SHELL" in text.upper())
        blocks.nodes.append(nodes)
        blocks.parts.append({})
        blocks.data.append(file.fields("name_elem_var", "vals_elem_var", f"eb{k}", len(nodes)))
    if not blocks.nodes:
        raise MeshError("the Exodus file has no elements", where=source)
    return blocks


def _side_sets(
    file: _File, blocks: _Blocks, dim: int, source: str
) -> tuple[list[Block], dict[str, str]]:
    """Facets of the side sets, and names of those that are not whole."""
    found, lost = list[Block](), dict[str, str]()
    for k, name in enumerate(file.titles("ss_names", "ss_prop1", "side_set", "elem_ss"), start=1):
        elements, numbers = file.integers(f"elem_ss{k}") - 1, file.integers(f"side_ss{k}") - 1
        if not len(elements):
            blocks.empty.append(name)
            continue
        if len(numbers) != len(elements):
            raise MeshError(
                f"the side set '{name}' has {len(elements)} elements and {len(numbers)} sides",
                where=source,
                expected="the file as it was written",
            )
        known = 0
        for i, at, rows in blocks.split(elements):
            for number, corners in enumerate(
                _sides(blocks.kinds[i], dim == 2 and not blocks.shells[i])
            ):
                own = rows[numbers[at] == number]
                known += len(own)
                if corners in _BOTH:
                    parts = blocks.parts[i]
                    parts[name] = np.union1d(parts.get(name, own), own)
                elif len(own):
                    kind = "line" if len(corners) == 2 else "triangle"
                    facets = blocks.nodes[i][own][:, list(corners)]
                    found.append(Block(kind, facets, {name: np.arange(len(own))}))
        if known < len(elements):
            lost[name] = (
                f"{len(elements) - known} of its {len(elements)} sides are none of a tetrahedron "
                "or triangle"
            )
    return found, lost


def _sides(kind: str, plane: bool) -> Sequence[tuple[int, ...]]:
    """Corners of the sides of an element."""
    if kind.startswith("tetra"):
        return _TETRA
    if kind.startswith("triangle"):
        return _TRIANGLE if plane else (*_BOTH, *_TRIANGLE)
    return ()


def _element_sets(file: _File, blocks: _Blocks) -> dict[str, str]:
    """Names the elements of sets; returns names of those that are not whole."""
    lost = dict[str, str]()
    titles = file.titles("els_names", "els_prop1", "element_set", "elem_els")
    for k, name in enumerate(titles, start=1):
        elements = np.unique(file.integers(f"elem_els{k}")) - 1
        present = list[IntArray]()
        for i, at, rows in blocks.split(elements):
            parts = blocks.parts[i]
            parts[name] = np.union1d(parts.get(name, rows), rows)
            present.append(elements[at])
        if not len(elements):
            blocks.empty.append(name)
        outside = np.setdiff1d(elements, joined(present)) + 1
        _note(name, missing(outside, len(elements), "elements"), lost)
    return lost


def _is_counted(name: str, member: str) -> bool:
    return name.startswith(member) and name[len(member) :].isdecimal()


def _note(name: str, reason: str, lost: dict[str, str]) -> None:
    if reason:
        lost[name] = reason
