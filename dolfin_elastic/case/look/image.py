"""What an image holds: the values of its voxels, such as the labels of a segmented scan."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

_LABELS = 200
"""Most values that are listed: an image of more is a grey one."""


@dataclass(frozen=True)
class ValueRow:
    """A value of voxels.

    Attributes:
        value: What stands in these voxels, after the file's slope and intercept.
        voxels: How many voxels of the whole image have it.
        volume: Theirs [unit^3].
    """

    value: float
    voxels: int
    volume: float


@dataclass(frozen=True)
class ImageLook:
    """What `dolfin-elastic look` tells of an image.

    Attributes:
        source: Name of the file, without the folder in which it lies.
        shape: Voxels along each axis.
        spacing: Their edges [unit].
        unit: Of lengths; empty: the file does not say it.
        low, high: Smallest and largest value.
        values: Each value; empty for a grey image, which has too many.
    """

    source: str
    shape: tuple[int, ...]
    spacing: tuple[float, ...]
    unit: str
    low: float
    high: float
    values: tuple[ValueRow, ...]


def look_at_image(path: Path, *, series: str = "") -> ImageLook:
    """Counts the voxels of each value. Not collective.

    Args:
        path: An image of any kind that `read_image` reads.
        series: Of a folder of DICOM files, see there.

    Raises:
        MeshError: It cannot be read.
    """
    from dolfin_elastic.mesh.images.read import read_image

    image = read_image(path, series=series)
    values, counts = np.unique(image.values, return_counts=True)
    volume = float(abs(np.linalg.det(image.affine[:3, :3])))
    rows = [
        ValueRow(float(value), int(count), int(count) * volume)
        for value, count in zip(values[: _LABELS + 1], counts, strict=False)
    ]
    return ImageLook(
        source=path.resolve().name,
        shape=tuple(int(n) for n in image.values.shape),
        spacing=tuple(float(x) for x in image.spacing),
        unit="" if image.unit is None else image.unit.name,
        low=float(values[0]),
        high=float(values[-1]),
        values=tuple(rows) if len(rows) <= _LABELS else (),
    )
