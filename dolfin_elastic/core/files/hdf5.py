"""HDF5 files that others have written: looked at as a whole before any array is read.

An HDF5 file can name other files as the place of its arrays (external links, external storage,
virtual arrays), and can state arrays that are far larger than itself (compressed, or never
written): who reads one hands out bytes of files that the writer of the file has chosen, or fills
the memory.  So all reading of HDF5 in this package goes through this module:

* the file is a regular one;
* no link in it leads out of it, and no array is stored outside;
* no array is larger than the compression of HDF5 can make of a file of this size: DEFLATE makes at
  most 1032 bytes of one (https://zlib.net/zlib_tech.html, "Maximum Compression Factor");
* what is read at once takes at most half of the free memory, and is an array of numbers.

h5py keeps HDF5 from printing its error stack, so it is imported before the library is used.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dolfin_elastic.core.errors import why_no_file
from dolfin_elastic.core.files.memory import free_memory, in_words
from dolfin_elastic.core.types import AnyArray

if TYPE_CHECKING:
    import h5py

_COMPRESSION = 1032
"""Largest number of bytes that DEFLATE makes of one."""
_SMALL = 1 << 20
"""Size of an array below which it is read whatever the size of the file [byte]."""
_SHARE = 0.5
"""Share of the free memory that one array may take."""
_NUMBERS = "biuf"


class UnsafeHdf5Error(OSError):
    """A file that leads out of itself, or states more than it can hold."""


@dataclass(frozen=True)
class _Stored:
    """What an array in a file takes.

    Attributes:
        name: Its path in the file.
        size: Bytes of the array, with texts of any length as long as the file.
        chunk: Bytes of one of its chunks; 0: there are none.
        packed: It is compressed, or parts of it need not be in the file.
    """

    name: str
    size: int
    chunk: int
    packed: bool


@contextmanager
def opened(path: Path, *, virtual: bool = False, checked: bool = False) -> Iterator[h5py.File]:
    """Opens a file for reading, after all in it has been looked at. Not collective.

    Args:
        virtual: Virtual arrays may be in it, as in the files that this program writes.
        checked: It has been looked at before.

    Raises:
        UnsafeHdf5Error: It leads out of itself, or states more than it can hold.
        OSError: It is missing, or no HDF5 file.
    """
    import h5py

    if fault := why_no_file(path, sys.maxsize):
        raise UnsafeHdf5Error(fault)
    with _plain_errors():
        file = h5py.File(path, "r")
    with file:
        if not checked:
            with _plain_errors():
                size = path.stat().st_size
                for stored in _arrays(file.id, size, virtual=virtual):
                    _check_size(stored, size)
        yield file


@contextmanager
def _plain_errors() -> Iterator[None]:
    """What h5py raises of damaged files, as an `OSError`."""
    try:
        yield
    except (RuntimeError, KeyError, ValueError, TypeError, OverflowError) as error:
        raise OSError(f"its content is damaged: {_text(error)}") from None


def _text(error: Exception) -> str:
    return str(error.args[0]) if error.args else type(error).__name__


def check(path: Path) -> None:
    """Looks at all in a file that another library is to read. Not collective.

    Raises:
        UnsafeHdf5Error: See `opened`; or the whole of it does not fit into the memory.
        OSError: See `opened`.
    """
    with opened(path) as file, _plain_errors():
        every = list(_arrays(file.id, path.stat().st_size, virtual=False))
    _check_memory("it", sum(one.size for one in every))


def is_hdf5(path: Path) -> bool:
    """Whether a file begins as an HDF5 file. Not collective."""
    if why_no_file(path, sys.maxsize) or not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(8) == b"\x89HDF\r\n\x1a\n"


def shape_in(file: h5py.File, name: str) -> tuple[int, ...]:
    """Shape of an array of numbers. Not collective.

    Args:
        file: From `opened`.

    Raises:
        OSError: There is no such array.
    """
    return tuple(int(n) for n in _array(file, name).shape)


def read_rows(
    path: Path, name: str, start: int = 0, stop: int | None = None, *, checked: bool = False
) -> AnyArray:
    """Some rows of an array of numbers. Not collective.

    Args:
        stop: The row after the last one; None: all of them.
        checked: `opened` has looked at this file before, perhaps on another rank.

    Returns:
        Shape (stop - start, ...).

    Raises:
        OSError: There is no such array, it has fewer rows or holds no numbers; see `opened`.
    """
    with opened(path, checked=checked) as file:
        return rows_of(file, name, start, stop)


def rows_of(file: h5py.File, name: str, start: int = 0, stop: int | None = None) -> AnyArray:
    """As `read_rows`, of a file from `opened`.

    Args:
        stop: The row after the last one; None: all of them.
    """
    data = _array(file, name)
    count = int(data.shape[0])
    stop = count if stop is None else stop
    if not 0 <= start <= stop <= count:
        raise OSError(f"'{name}' has {count} rows, of which {start} to {stop} are needed")
    stored = _stored(data.id, name, 0)
    each = int(np.prod(data.shape[1:], dtype=object)) * data.dtype.itemsize
    _check_memory(f"'{name}'", (stop - start) * each + stored.chunk)
    with _plain_errors():
        return np.asarray(data[start:stop])


def _array(file: h5py.File, name: str) -> h5py.Dataset:
    import h5py

    with _plain_errors():
        dataset = file.get(name) if name else None
        if not isinstance(dataset, h5py.Dataset) or not dataset.shape:
            raise OSError(f"it has no array '{name}'")
        if dataset.dtype.kind not in _NUMBERS:
            raise OSError(f"'{name}' holds {dataset.dtype}, no numbers")
        if dataset.is_virtual or dataset.external:
            raise UnsafeHdf5Error(f"'{name}' is stored in other files")
    return dataset


def _arrays(root: h5py.h5g.GroupID, size: int, *, virtual: bool) -> Iterator[_Stored]:
    """All arrays and attributes of a file; refuses links that lead out of it, and outer storage."""
    import h5py

    waiting, known = [("/", root)], set[int]()
    while waiting:
        path, group = waiting.pop()
        yield from _attributes(group, path, size)
        for name in list(group):
            full = f"{path.rstrip('/')}/{name.decode('utf-8', 'replace')}"
            kind = group.links.get_info(name).type
            if kind not in (h5py.h5l.TYPE_HARD, h5py.h5l.TYPE_SOFT):
                raise UnsafeHdf5Error(f"'{full}' is a link to another file, which is not followed")
            if kind == h5py.h5l.TYPE_SOFT:  # its target, in this file, is looked at in its place
                continue
            child = h5py.h5o.open(group, name)
            address = int(h5py.h5o.get_info(child).addr)
            if address in known:
                continue
            known.add(address)
            if isinstance(child, h5py.h5g.GroupID):
                waiting.append((full, child))
            elif isinstance(child, h5py.h5d.DatasetID):
                if not _is_virtual(child, full, allowed=virtual):
                    yield _stored(child, full, size)
                yield from _attributes(child, full, size)


def _is_virtual(data: h5py.h5d.DatasetID, name: str, *, allowed: bool) -> bool:
    import h5py

    properties = data.get_create_plist()
    if properties.get_external_count():
        raise UnsafeHdf5Error(f"'{name}' is stored in another file, which is not read")
    virtual = bool(properties.get_layout() == h5py.h5d.VIRTUAL)
    if virtual and not allowed:
        raise UnsafeHdf5Error(f"'{name}' is put together from other files, which are not read")
    return virtual


def _stored(data: h5py.h5d.DatasetID, name: str, size: int) -> _Stored:
    import h5py

    item, varies = _item(data.get_type(), size)
    properties, shape = data.get_create_plist(), data.shape or (0,) * (data.shape is None)
    if properties.get_layout() != h5py.h5d.CHUNKED:
        packed = varies or data.get_storage_size() == 0  # never written: it is made of one value
        return _Stored(name, math.prod(shape) * item, 0, packed)
    chunk = properties.get_chunk()
    whole = math.prod(-(-n // c) * c for n, c in zip(shape, chunk, strict=True))
    return _Stored(name, whole * item, math.prod(chunk) * item, packed=True)


def _item(kind: h5py.h5t.TypeID, size: int) -> tuple[int, bool]:
    """Bytes of one entry in memory; if they vary, at most `size`, those of the file, and True."""
    import h5py

    varies = kind.detect_class(h5py.h5t.VLEN) or (
        isinstance(kind, h5py.h5t.TypeStringID) and kind.is_variable_str()
    )
    return int(kind.get_size()) + (size if varies else 0), bool(varies)


def _attributes(one: h5py.h5i.ObjectID, name: str, size: int) -> Iterator[_Stored]:
    import h5py

    for index in range(h5py.h5a.get_num_attrs(one)):
        attribute = h5py.h5a.open(one, index=index)
        full = f"{name}@{attribute.name.decode('utf-8', 'replace')}"
        item, varies = _item(attribute.get_type(), size)
        yield _Stored(full, math.prod(attribute.shape or ()) * item, 0, packed=varies)


def _check_size(stored: _Stored, size: int) -> None:
    """Refuses an array that a file of this size [byte] cannot hold."""
    most = max(_SMALL, (_COMPRESSION if stored.packed else 1) * size)
    if max(stored.size, stored.chunk) > most:
        raise UnsafeHdf5Error(
            f"'{stored.name}' states {in_words(max(stored.size, stored.chunk))}, more than a file "
            f"of {in_words(size)} can hold"
        )


def _check_memory(what: str, size: float) -> None:
    free = free_memory()
    if size > max(_SMALL, _SHARE * free):
        raise UnsafeHdf5Error(
            f"{what} takes {in_words(size)}, but {in_words(free)} of memory are free"
        )
