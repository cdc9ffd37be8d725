"""MetaImage files (.mha, and .mhd with a file of raw data in the same folder).

Source: https://itk.org/Wiki/ITK/MetaIO/Documentation
"""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import BinaryIO

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.files.regular import open_regular
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.core.units import LengthUnit
from dolfin_elastic.mesh.images.image import LPS, Image, check_shape, scaled
from dolfin_elastic.mesh.images.stream import RATIO, read_exactly, read_unpacked

_TYPES = {
    "MET_CHAR": "i1",
    "MET_UCHAR": "u1",
    "MET_SHORT": "i2",
    "MET_USHORT": "u2",
    "MET_INT": "i4",
    "MET_UINT": "u4",
    "MET_LONG": "i4",
    "MET_ULONG": "u4",
    "MET_LONG_LONG": "i8",
    "MET_ULONG_LONG": "u8",
    "MET_FLOAT": "f4",
    "MET_DOUBLE": "f8",
}
_MOST_LINES = 200
_LONGEST = 4096
_MILLIMETRE = LengthUnit.of(1e-3)


def read_metaimage(path: Path) -> Image:
    """Reads an image of one number a voxel; lengths are millimetres, as ITK defines. Local.

    Raises:
        MeshError: It is damaged, of another kind, or its data are elsewhere.
    """
    with path.open("rb") as file:
        header = _Header(file)
        shape, dtype = header.shape(), header.dtype()
        name = header.text("ElementDataFile")
        if name.upper() == "LOCAL":
            size = path.stat().st_size - file.tell()
            return header.image(_data(file, size, header, shape, dtype))
        with _beside(path, name) as other:
            size = os.fstat(other.fileno()).st_size
            return header.image(_data(other, size, header, shape, dtype))


def _beside(path: Path, name: str) -> BinaryIO:
    """The file of the voxels: a regular one, in the folder of the header."""
    if name.upper().startswith("LIST") or "%" in name:
        raise MeshError("its slices are in files of their own", expected="one file of data")
    if not name or name != Path(name).name or "\\" in name or "\0" in name:
        raise MeshError(
            f"ElementDataFile = {name}", expected="the name of a file in the folder of the .mhd"
        )
    try:
        return os.fdopen(open_regular(path.parent / name, os.O_RDONLY), "rb")
    except OSError as error:
        raise MeshError(f"ElementDataFile = {name}: {(error.strerror or '').lower()}") from None


def _data(
    file: BinaryIO, size: int, header: _Header, shape: tuple[int, ...], dtype: np.dtype[np.generic]
) -> np.ndarray[tuple[int, ...], np.dtype[np.generic]]:
    """The voxels, shape (ni, nj, nk)."""
    need, skipped = math.prod(map(float, shape)) * dtype.itemsize, header.skipped()
    packed = header.flag("CompressedData")
    check_shape(shape, dtype, size * RATIO if packed else size - max(skipped, 0))
    count = int(need)
    if packed:
        data = read_unpacked(file, count)
    else:
        file.seek(size - count - skipped if skipped < 0 else skipped, os.SEEK_CUR)
        data = read_exactly(file, count)
    return np.frombuffer(data, dtype).reshape(shape, order="F")


class _Header:
    """The lines ``Key = value`` up to ElementDataFile. `file` stands behind them afterwards."""

    def __init__(self, file: BinaryIO) -> None:
        self._lines: dict[str, str] = {}
        for _ in range(_MOST_LINES):
            line = file.readline(_LONGEST)
            key, equals, value = line.decode("latin-1").partition("=")
            if not line.endswith(b"\n") or not (equals or not line.strip()):
                break
            self._lines[key.strip()] = value.strip()
            if key.strip() == "ElementDataFile":
                return
        raise MeshError(
            "a line of its header is not of the form Key = value, or the header does not end",
            expected="a text header whose last line is ElementDataFile",
        )

    def text(self, key: str, other: str | None = None) -> str:
        """A value."""
        value = self._lines.get(key, other)
        if value is None:
            raise MeshError(f"its header has no {key}", expected="a MetaImage file")
        return value

    def flag(self, key: str) -> bool:
        """A value that is true or false."""
        return self.text(key, "False").lower() in ("true", "1", "yes")

    def numbers(self, keys: tuple[str, ...], count: int, other: FloatArray | None) -> FloatArray:
        """Numbers under the first of several keys that is there."""
        key = next((key for key in keys if key in self._lines), None)
        if key is None and other is not None:
            return other
        text = self.text(key or keys[0])
        try:
            numbers = np.array([float(word) for word in text.split()])
        except ValueError:
            numbers = np.empty(0)
        if len(numbers) != count or not np.isfinite(numbers).all():
            raise MeshError(f"{key} = {text[:60]}", expected=f"{count} numbers")
        return numbers

    def shape(self) -> tuple[int, ...]:
        """Numbers of voxels along three axes."""
        dim = int(self.numbers(("NDims",), 1, None)[0])
        if dim not in (2, 3):
            raise MeshError(f"NDims = {dim}", expected="2 or 3")
        sizes = self.numbers(("DimSize",), dim, None)
        if not all(float(n).is_integer() and 0 < n < 1 << 40 for n in sizes):
            raise MeshError(f"DimSize = {self.text('DimSize')[:60]}", expected="positive numbers")
        if self.numbers(("ElementNumberOfChannels",), 1, np.ones(1))[0] != 1:
            raise MeshError("its voxels have several numbers (ElementNumberOfChannels)")
        return (*(int(n) for n in sizes), *[1] * (3 - dim))

    def dtype(self) -> np.dtype[np.generic]:
        """Of a voxel."""
        kind = self.text("ElementType")
        if kind not in _TYPES:
            raise MeshError(f"ElementType = {kind[:60]}", expected=f"one of {', '.join(_TYPES)}")
        if not self.flag("BinaryData") and "BinaryData" in self._lines:
            raise MeshError("its voxels are text (BinaryData = False)", expected="binary data")
        order = "BinaryDataByteOrderMSB", "ElementByteOrderMSB"
        return np.dtype((">" if any(map(self.flag, order)) else "<") + _TYPES[kind])

    def skipped(self) -> int:
        """Bytes in front of the data; -1: the data are the last bytes."""
        skipped = int(self.numbers(("HeaderSize",), 1, np.zeros(1))[0])
        if skipped < -1:
            raise MeshError(f"HeaderSize = {skipped}", expected="a number of bytes, or -1")
        return skipped

    def _spacing(self, dim: int) -> FloatArray:
        """Edges of a voxel; programs write three for plane images, too."""
        key = next((key for key in _SPACING if key in self._lines), "")
        three = dim == 2 and len(self._lines.get(key, "").split()) == 3
        return self.numbers(_SPACING, 3 if three else dim, np.ones(dim))[:dim]

    def image(self, values: np.ndarray[tuple[int, ...], np.dtype[np.generic]]) -> Image:
        """The voxels with their places, in NIfTI's frame."""
        dim = 2 if values.shape[2] == 1 and self.text("NDims").strip() == "2" else 3
        affine = np.eye(4)
        spacing = self._spacing(dim)
        axes = self.numbers(_AXES, dim * dim, np.eye(dim).ravel()).reshape(dim, dim)
        affine[:dim, :dim] = axes.T * spacing  # a row of the file is the direction of an axis
        affine[:dim, 3] = self.numbers(_ORIGIN, dim, np.zeros(dim))
        slope = float(self.numbers(("ElementToIntensityFunctionSlope",), 1, np.ones(1))[0])
        offset = float(self.numbers(("ElementToIntensityFunctionOffset",), 1, np.zeros(1))[0])
        return Image(scaled(values, slope, offset), LPS @ affine, _MILLIMETRE)


_AXES = "TransformMatrix", "Rotation", "Orientation"
_SPACING = "ElementSpacing", "ElementSize"
_ORIGIN = "Offset", "Origin", "Position"
