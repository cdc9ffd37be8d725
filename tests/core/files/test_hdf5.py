"""HDF5 files that lead out of themselves, or state more than they hold."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from dolfin_elastic.core.files import hdf5, memory
from dolfin_elastic.core.files.hdf5 import UnsafeHdf5Error, check, opened, read_rows

pytestmark = pytest.mark.usefixtures("serial_only")

HUGE = 1 << 31
"""Numbers of 8 bytes: 17 GB."""


def virtual(file: h5py.File) -> None:
    layout = h5py.VirtualLayout((4,), "f8")
    layout[:] = h5py.VirtualSource("other.h5", "a", (4,))
    file.create_virtual_dataset("a", layout)


def linked(file: h5py.File) -> None:
    file["deep/down/a"] = h5py.ExternalLink("/etc/other.h5", "/a")


def double_packed(file: h5py.File) -> None:
    """DEFLATE of DEFLATE: ratios of a million, which one DEFLATE cannot have."""
    properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    properties.set_chunk((1 << 23,))
    properties.set_deflate(9)
    properties.set_deflate(9)
    space = h5py.h5s.create_simple((1 << 23,))
    data = h5py.h5d.create(file.id, b"a", h5py.h5t.NATIVE_DOUBLE, space, properties)
    h5py.Dataset(data)[:] = 0.0


UNSAFE: dict[str, tuple[Callable[[h5py.File], object], str]] = {
    "compressed": (
        lambda f: f.create_dataset("a", (HUGE,), "f8", chunks=(1 << 20,), compression="gzip"),
        "'/a' states 17.2 GB, more than a file of .* can hold",
    ),
    "never written": (lambda f: f.create_dataset("a", (HUGE,), "f8"), "'/a' states 17.2 GB"),
    "chunk": (
        lambda f: f.create_dataset("a", (3,), "f8", chunks=(1 << 28,), maxshape=(None,)),
        "'/a' states 2.15 GB",
    ),
    "packed twice": (double_packed, "'/a' states 67.1 MB"),
    "long texts": (lambda f: f.create_dataset("a", (1 << 12,), "S1000000"), "'/a' states 4.1 GB"),
    "external link": (linked, "'/deep/down/a' is a link to another file"),
    "external storage": (
        lambda f: f.create_dataset("a", (10,), "u1", external=[("/etc/passwd", 0, 10)]),
        "'/a' is stored in another file",
    ),
    "virtual": (virtual, "'/a' is put together from other files"),
}


@pytest.mark.parametrize("kind", UNSAFE)
def test_unsafe_files(tmp_path: Path, kind: str) -> None:
    """Refused before an array is read: 17 GB would be."""
    make, said = UNSAFE[kind]
    with h5py.File(tmp_path / "a.h5", "w") as file:
        make(file)
    assert (tmp_path / "a.h5").stat().st_size < 2e4
    for read in (check, lambda path: read_rows(path, "a")):
        with pytest.raises(UnsafeHdf5Error, match=said):
            read(tmp_path / "a.h5")


def test_what_is_read(tmp_path: Path) -> None:
    """Links within the file, circles of groups, texts beside, and zeros packed as far as can be."""
    values, zeros = np.arange(6.0).reshape(2, 3), np.zeros((20000, 300))
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["b"], file["texts"] = values, ["a", "bc"]
        file["zeros"] = 0
        del file["zeros"]
        file.create_dataset("zeros", data=zeros, compression="gzip", compression_opts=9)
        file["a"], file["circle"] = h5py.SoftLink("/b"), file["/"]
        file["b"].attrs["unit"] = "m"
        file["b"].attrs["numbers"] = np.arange(100.0)
    check(tmp_path / "a.h5")
    assert np.array_equal(read_rows(tmp_path / "a.h5", "a", 1, 2), values[1:])
    assert np.array_equal(read_rows(tmp_path / "a.h5", "/zeros"), zeros)
    with opened(tmp_path / "a.h5") as file:
        assert hdf5.shape_in(file, "b") == (2, 3)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("texts", "holds object, no numbers"),
        ("references", "holds object, no numbers"),
        ("pairs", "no numbers"),
        ("scalar", "no array"),
        ("empty", "no array"),
        ("group", "no array"),
        ("nowhere", "no array"),
        ("dangling", "no array"),
        ("", "no array"),
        ("rows", "has 2 rows, of which 0 to 3 are needed"),
    ],
)
def test_what_is_no_array_of_numbers(tmp_path: Path, name: str, said: str) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["texts"], file["rows"], file["scalar"] = ["a"], [[1.0], [2.0]], 1.0
        file.create_dataset("references", (2,), h5py.ref_dtype)
        file.create_dataset("pairs", (2,), np.dtype([("a", "f8"), ("b", "f8")]))
        file["empty"] = h5py.Empty("f8")
        file.create_group("group")
        file["dangling"] = h5py.SoftLink("/nothing")
    with pytest.raises(OSError, match=said):
        read_rows(tmp_path / "a.h5", name, 0, 3 if name == "rows" else None)


def test_little_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An honest file that is too large, too: rows of it can still be read."""
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["a"] = np.zeros((1 << 15, 8))
    monkeypatch.setattr(hdf5, "free_memory", lambda: 3e6)
    with pytest.raises(UnsafeHdf5Error, match=r"'a' takes 2.1 MB, but 3 MB of memory are free"):
        read_rows(tmp_path / "a.h5", "a")
    with pytest.raises(UnsafeHdf5Error, match="it takes"):
        check(tmp_path / "a.h5")
    assert read_rows(tmp_path / "a.h5", "a", 5, 9).shape == (4, 8)


def test_damaged_files(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """An `OSError` each time, and nothing of HDF5's own on the terminal."""
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file["a"], file["group/b"] = np.arange(100.0), np.arange(3)
    whole = path.read_bytes()
    generator = np.random.default_rng(0)
    for _ in range(60):
        broken = bytearray(whole)
        start = int(generator.integers(0, len(whole)))
        length = int(generator.integers(1, 200))
        broken[start : start + length] = generator.bytes(len(broken[start : start + length]))
        path.write_bytes(bytes(broken[: int(generator.integers(len(whole) // 2, len(whole)))]))
        with pytest.raises(OSError):  # noqa: PT011 (whatever is broken)
            read_rows(path, "a", 0, 200)
    assert capfd.readouterr().err == ""


def test_pipes_are_not_opened(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.h5")
    with pytest.raises(OSError, match="this is a pipe, not a file"):
        check(tmp_path / "a.h5")
    assert not hdf5.is_hdf5(tmp_path / "a.h5")
    (tmp_path / "b.h5").symlink_to("/dev/zero")
    with pytest.raises(OSError, match="this is a device, not a file"):
        read_rows(tmp_path / "b.h5", "a")


def test_memory_in_words() -> None:
    assert memory.free_memory() > 1e6
    assert [memory.in_words(n) for n in (3, 1.4e3, 2.5e6, 17.2e9, 3e13)] == [
        "3 bytes",
        "1.4 kB",
        "2.5 MB",
        "17.2 GB",
        "3e+04 GB",
    ]
