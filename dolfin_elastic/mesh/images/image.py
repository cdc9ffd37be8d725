"""`Image`: values of voxels and where they lie."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.files.memory import free_memory, in_words
from dolfin_elastic.core.types import AnyArray, FloatArray
from dolfin_elastic.core.units import LengthUnit

LPS = np.diag([-1.0, -1.0, 1.0, 1.0])
"""Turns places to the left, posterior and superior into right, anterior and superior, and back."""
_MOST_VOXELS = 1 << 40
_AT_A_TIME = 4.0
"""Copies of an image that are in memory while it is read and its values are scaled."""


@dataclass(frozen=True, eq=False)
class Image:
    """An image of voxels, in NIfTI's frame: x to the right, y anterior, z superior (RAS).

    DICOM and MetaImage state places to the left and posterior (LPS): both signs are changed when
    they are read.  VTK's images have no such frame; their places are as the file has them.

    Attributes:
        values: Whole numbers or real ones, after the file's slope and intercept, shape
            (ni, nj, nk).
        affine: From (i, j, k, 1), whole numbers at the middles of voxels, to (x, y, z, 1) in
            `unit`, shape (4, 4).
        unit: Of lengths; None: the file does not say it.
    """

    values: AnyArray
    affine: FloatArray
    unit: LengthUnit | None

    def __post_init__(self) -> None:
        if not np.isfinite(self.affine).all() or not abs(np.linalg.det(self.affine[:3, :3])) > 0:
            raise MeshError(
                "its voxels have no volume: spacing and directions are "
                f"{np.array2string(self.affine[:3, :3], precision=4).replace(chr(10), '')}",
                expected="numbers other than 0, and directions that are not parallel",
            )

    @property
    def spacing(self) -> FloatArray:
        """Edges of a voxel in `unit`, shape (3,)."""
        return np.asarray(np.linalg.norm(self.affine[:3, :3], axis=0))

    @property
    def corners(self) -> FloatArray:
        """Corners of the whole image, half a voxel around the outer middles, shape (8, 3)."""
        ends = [(-0.5, n - 0.5) for n in self.values.shape]
        index = np.stack(np.meshgrid(*ends, indexing="ij"), -1).reshape(-1, 3)
        return np.asarray(index @ self.affine[:3, :3].T + self.affine[:3, 3])

    def metres(self, unit: LengthUnit | None = None) -> FloatArray:
        """`affine` in metres.

        Args:
            unit: Of its lengths, if the file does not say it; else it counts before the file's.

        Raises:
            MeshError: Neither is known.
        """
        unit = unit or self.unit
        if unit is None:
            size = " x ".join(f"{x:.4g}" for x in self.spacing * self.values.shape)
            raise MeshError(
                f"the file does not say the unit of its lengths; the image is {size}",
                where="unit",
                expected='the unit of length, such as unit = "mm"',
            )
        return np.vstack([unit.metres * self.affine[:3], [0.0, 0.0, 0.0, 1.0]])


def check_shape(shape: Sequence[int], dtype: np.dtype[np.generic], most: float) -> None:
    """Refuses an image before it is read.

    Args:
        shape: Numbers of voxels along each axis.
        dtype: Of each.
        most: Bytes that the file can have of them, however well they are compressed.

    Raises:
        MeshError: There are none, or more than the file or the memory can have.
    """
    size = " x ".join(map(str, shape))
    if not all(0 < n < _MOST_VOXELS for n in shape):
        raise MeshError(f"an image of {size} voxels", expected="a positive number on each axis")
    need = float(np.prod([float(n) for n in shape])) * dtype.itemsize
    if need > most:
        raise MeshError(
            f"the file ends before its image of {size} voxels does", expected="the whole file"
        )
    if _AT_A_TIME * need > (free := free_memory()):
        raise MeshError(
            f"an image of {size} voxels needs about {in_words(_AT_A_TIME * need)} of memory, "
            f"{in_words(free)} are free",
            expected="a part of the image, or a machine with more memory",
        )


def scaled(values: AnyArray, slope: float, intercept: float) -> AnyArray:
    """Values times a slope plus an intercept, with as few bytes as are exact to 7 digits.

    Args:
        values: As stored.
        slope: Whole numbers remain whole ones where slope and intercept are whole, too.
        intercept: Of the scanner's units, for example -1024.

    Raises:
        MeshError: A number is not finite.
    """
    if not (np.isfinite(slope) and np.isfinite(intercept)) or slope == 0:
        raise MeshError(f"its values have the slope {slope} and the intercept {intercept}")
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        count = int(np.count_nonzero(~np.isfinite(values)))
        raise MeshError(
            f"{count} of its voxels have no number (NaN or infinite)",
            expected="a number in each: export the image anew, with a value for its background",
        )
    if (slope, intercept) == (1.0, 0.0):
        return values.astype(values.dtype.newbyteorder("="), copy=False)
    ends = [slope * float(v) + intercept for v in (values.min(), values.max())]
    whole = values.dtype.kind in "iu" and float(slope).is_integer() and intercept.is_integer()
    if whole and max(map(abs, ends)) < 1 << 31:
        small = max(map(abs, ends)) < 1 << 15
        wide = values.astype(np.int32 if small or values.itemsize < 4 else np.int64)
        np.multiply(wide, int(slope), out=wide)
        np.add(wide, int(intercept), out=wide)
        return wide.astype(np.int16 if small else np.int32)
    real = values.astype(np.float32 if values.itemsize <= 2 else np.float64)
    np.multiply(real, slope, out=real)
    np.add(real, intercept, out=real)
    return np.asarray(real)
