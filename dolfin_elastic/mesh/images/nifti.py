"""NIfTI-1 and NIfTI-2 images in one file (.nii, .nii.gz).

Read here: the header is a table of numbers, and a compressed file must not become longer than the
header says.  Source: https://nifti.nimh.nih.gov/nifti-1 (nifti1.h) and /nifti-2 (nifti2.h)
"""

from __future__ import annotations

import gzip
import math
import zlib
from pathlib import Path
from typing import BinaryIO, NamedTuple, cast

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import AnyArray, FloatArray
from dolfin_elastic.core.units import LengthUnit
from dolfin_elastic.mesh.images.image import Image, check_shape, scaled
from dolfin_elastic.mesh.images.stream import CHUNK, RATIO, read_exactly

_TYPES = {
    2: "u1",
    4: "i2",
    8: "i4",
    16: "f4",
    64: "f8",
    256: "i1",
    512: "u2",
    768: "u4",
    1024: "i8",
    1280: "u8",
}
_OTHERS = {
    1: "bits",
    32: "complex numbers",
    128: "colours",
    1792: "complex numbers",
    2304: "colours with opacity",
}
_UNITS = {1: LengthUnit.of(1.0), 2: LengthUnit.of(1e-3), 3: LengthUnit.of(1e-6)}


class _Layout(NamedTuple):
    """Bytes at which the numbers of a header stand."""

    size: int
    real: str
    whole: str
    dim: int
    datatype: int
    pixdim: int
    offset: int
    offset_type: str
    slope: int
    codes: int
    code_type: str
    quaternion: int
    rows: int
    units: int
    units_type: str


_ONE = _Layout(348, "f4", "i2", 40, 70, 76, 108, "f4", 112, 252, "i2", 256, 280, 123, "u1")
_TWO = _Layout(540, "f8", "i8", 16, 12, 104, 168, "i8", 176, 344, "i4", 352, 400, 500, "i4")


def read_nifti(path: Path) -> Image:
    """Reads an image of one volume. Local.

    Raises:
        MeshError: It is damaged, has several volumes, or colours.
    """
    packed = path.name.lower().endswith(".gz")
    try:
        with path.open("rb") as file:
            size = path.stat().st_size
            if not packed:
                return _Header.of(file).image(file, size)
            return _Header.of(stream := cast("BinaryIO", gzip.GzipFile(fileobj=file))).image(
                stream, RATIO * size
            )
    except (EOFError, zlib.error, gzip.BadGzipFile, OSError) as error:
        raise MeshError(f"it cannot be read: {error}", expected="the whole file") from None


class _Header:
    """The numbers in front of an image.

    Args:
        data: The bytes of the header, all of them.
        layout: Where they stand.
        order: "<" or ">".
    """

    def __init__(self, data: bytes, layout: _Layout, order: str) -> None:
        self._data, self._at, self._order = data, layout, order

    @classmethod
    def of(cls, stream: BinaryIO) -> _Header:
        """Reads it, up to its end."""
        first = stream.read(4)
        for order in "<>":
            for layout in (_ONE, _TWO):
                if first == np.array(layout.size, f"{order}i4").tobytes():
                    data = first + read_exactly(stream, layout.size - 4)
                    return cls(data, layout, order)._checked()
        raise MeshError("this is no NIfTI image", expected="a file that begins with 348 or 540")

    def _checked(self) -> _Header:
        magic = self._data[344:348] if self._at is _ONE else self._data[4:8]
        if magic.startswith((b"ni1", b"ni2")):
            raise MeshError(
                "its voxels are in another file (.img)", expected="one file, saved as .nii"
            )
        if not magic.startswith((b"n+1", b"n+2")):
            raise MeshError(
                "this is an Analyze file: its orientation is not defined",
                expected="the image saved as NIfTI (.nii)",
            )
        return self

    def _numbers(self, kind: str, at: int, count: int) -> AnyArray:
        dtype = np.dtype(f"{self._order}{kind}")
        return np.frombuffer(self._data, dtype, count, at).astype(dtype.newbyteorder("="))

    def image(self, stream: BinaryIO, most: int) -> Image:
        """The image behind the header.

        Args:
            stream: Its next byte is the first one after the header.
            most: Bytes that it can have from its beginning on.
        """
        shape = self._shape()
        code = int(self._numbers("i2", self._at.datatype, 1)[0])
        if code not in _TYPES:
            what = _OTHERS.get(code, f"numbers of the unknown type {code}")
            raise MeshError(f"its voxels have {what}", expected="whole or real numbers")
        dtype = np.dtype(f"{self._order}{_TYPES[code]}")
        start = float(self._numbers(self._at.offset_type, self._at.offset, 1)[0])
        if not start.is_integer() or not self._at.size <= start <= most:
            raise MeshError(f"its voxels begin at byte {start:g}", expected="a byte of the file")
        check_shape(shape, dtype, most - start)
        _skip(stream, int(start) - self._at.size)
        data = read_exactly(stream, math.prod(shape) * dtype.itemsize)
        values = np.frombuffer(data, dtype).reshape(shape, order="F")
        slope, intercept = map(float, self._numbers(self._at.real, self._at.slope, 2))
        if slope == 0 or not math.isfinite(slope):  # by definition: not scaled
            slope, intercept = 1.0, 0.0
        units = int(self._numbers(self._at.units_type, self._at.units, 1)[0]) & 7
        return Image(scaled(values, slope, intercept), self._affine(), _UNITS.get(units))

    def _shape(self) -> tuple[int, int, int]:
        dim = [int(n) for n in self._numbers(self._at.whole, self._at.dim, 8)]
        if not 1 <= dim[0] <= 7:
            raise MeshError(f"an image of {dim[0]} dimensions", expected="3")
        sizes = [*dim[1 : dim[0] + 1], 1, 1][: max(dim[0], 3)]
        further = [n for n in sizes[3:] if n != 1]
        if further:
            raise MeshError(
                f"it has {math.prod(further)} volumes (or components of each voxel)",
                expected="one: save one volume as a file of its own",
            )
        return sizes[0], sizes[1], sizes[2]

    def _affine(self) -> FloatArray:
        """By the header's rows (sform), else its quaternion, else its spacing alone."""
        quaternion_code, rows_code = self._numbers(self._at.code_type, self._at.codes, 2)
        spacing = self._numbers(self._at.real, self._at.pixdim, 8).astype(np.float64)
        affine = np.eye(4)
        if rows_code > 0:
            affine[:3] = self._numbers(self._at.real, self._at.rows, 12).reshape(3, 4)
            return affine
        zooms = np.where(spacing[1:4] > 0, spacing[1:4], 1.0)  # a length, of an axis unused 0
        if quaternion_code > 0:
            numbers = self._numbers(self._at.real, self._at.quaternion, 6).astype(np.float64)
            zooms[2] *= -1.0 if spacing[0] < 0 else 1.0
            affine[:3, :3] = _rotation(numbers[:3]) * zooms
            affine[:3, 3] = numbers[3:]
            return affine
        affine[:3, :3] = np.diag(zooms)
        return affine


def _rotation(vector: FloatArray) -> FloatArray:
    """The rotation of a unit quaternion whose first number is not stored, shape (3, 3)."""
    b, c, d = vector
    rest = 1.0 - float(vector @ vector)
    if not rest >= -1e-5:
        raise MeshError("the quaternion of its orientation is longer than 1")
    a = math.sqrt(max(rest, 0.0))
    if rest <= 0:
        b, c, d = vector / np.linalg.norm(vector)
    return np.array(
        [
            [a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c)],
            [2 * (b * c + a * d), a * a + c * c - b * b - d * d, 2 * (c * d - a * b)],
            [2 * (b * d - a * c), 2 * (c * d + a * b), a * a + d * d - b * b - c * c],
        ]
    )


def _skip(stream: BinaryIO, count: int) -> None:
    while count > 0:
        some = len(stream.read(min(count, CHUNK)))
        if not some:
            raise MeshError("the file ends before its image", expected="the whole file")
        count -= some
