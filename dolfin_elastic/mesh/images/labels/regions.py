"""Which region each voxel belongs to, by its label or by a threshold."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import AnyArray, IntArray
from dolfin_elastic.mesh.images.image import Image

ISLAND = 27
"""Voxels of a connected part below which it is taken for noise."""
_SHOWN = 12
"""Values that a message names."""
BODY = "body"
"""Name of the region above a threshold."""
_MOST = 1000
"""Regions."""


@dataclass(frozen=True)
class Labels:
    """What the values of voxels mean.

    Attributes:
        values: Name of a region to its values.
        threshold: From which value on voxels are the body; instead of `values`.
    """

    values: Mapping[str, Sequence[int]]
    threshold: float | None = None


@dataclass(frozen=True)
class Regions:
    """Regions of an image.

    Attributes:
        numbers: Of the region of each voxel, 1 for the first name; 0 is not meshed; shape
            (ni, nj, nk).
        names: Of the regions.
        notes, information: For the user.
    """

    numbers: AnyArray
    names: Sequence[str]
    notes: Sequence[str]
    information: Sequence[str]


def regions_of(image: Image, labels: Labels) -> Regions:
    """The regions of an image; parts of a few voxels are given to what surrounds them. Local.

    Raises:
        MeshError: A label has no voxels, or two names have the same; there is no body.
    """
    if labels.threshold is not None:
        numbers, names = _above(image, labels.threshold), [BODY]
        information = list[str]()
    else:
        numbers, names, information = _labelled(image, labels.values)
    notes = _without_islands(numbers, names)
    counts = np.bincount(numbers.ravel(), minlength=len(names) + 1)[1:]
    size = " x ".join(map(str, image.values.shape))
    parts = ", ".join(f"{name} {count}" for name, count in zip(names, counts, strict=True))
    return Regions(
        numbers, names, notes, [f"image of {size} voxels, in regions: {parts}", *information]
    )


def _above(image: Image, threshold: float) -> AnyArray:
    numbers = (image.values >= threshold).astype(np.int16)
    if not numbers.any():
        raise MeshError(
            f"no voxel of the image is {threshold:g} or more",
            where="threshold",
            expected=f"at most {float(np.max(image.values)):g}, its largest value",
        )
    return np.asarray(numbers)


def _labelled(
    image: Image, labels: Mapping[str, Sequence[int]]
) -> tuple[AnyArray, list[str], list[str]]:
    """Numbers and names of the regions, and what has no name."""
    values, every, counts = _values(image)
    if not labels:
        raise MeshError(
            "labels are missing: which values of the image are which region",
            where="labels",
            expected=f"for example labels = {{bone = 1}}; {_listed(values, counts)}",
        )
    if len(labels) > _MOST:
        raise MeshError(f"{len(labels)} labels", where="labels", expected=f"at most {_MOST}")
    number_of = np.zeros(len(values), dtype=np.int16)
    for number, (name, wanted) in enumerate(labels.items(), start=1):
        for one in wanted:
            at = int(np.searchsorted(values, one))
            if at == len(values) or values[at] != one:
                near = values[np.argmin(np.abs(values.astype(np.float64) - one))]
                raise MeshError(
                    f"no voxel of the image has the value {one}",
                    where=f"labels.{name}",
                    expected=f"the nearest is {near}; {_listed(values, counts)}",
                )
            if number_of[at]:
                other = list(labels)[number_of[at] - 1]
                raise MeshError(
                    f"the value {one} is that of '{other}' already", where=f"labels.{name}"
                )
            number_of[at] = number
    rest = (number_of == 0) & (values != 0)
    information = (
        [f"not meshed, for they have no name: {_listed(values[rest], counts[rest])}"]
        if rest.any()
        else []
    )
    return number_of[every], list(labels), information


def _values(image: Image) -> tuple[IntArray, AnyArray, IntArray]:
    """The different values, their rows for each voxel, and the number of voxels with each."""
    values = image.values
    if values.dtype.kind == "f":
        if not np.isfinite(values).all() or (values != np.round(values)).any():
            raise MeshError(
                "its values are no whole numbers, so it is no image of labels",
                where="labels",
                expected="of a grey image threshold = VALUE in place of labels",
            )
        values = values.astype(np.int64)
    unique, rows, counts = np.unique(values, return_inverse=True, return_counts=True)
    return unique, rows.reshape(values.shape), counts


def _listed(values: IntArray, counts: IntArray) -> str:
    """Values with their numbers of voxels."""
    order = np.argsort(-counts, kind="stable")[:_SHOWN]
    text = ", ".join(f"{values[k]} ({counts[k]} voxels)" for k in sorted(order))
    return f"values: {text}{' ...' if len(values) > _SHOWN else ''}"


def _without_islands(numbers: AnyArray, names: Sequence[str]) -> list[str]:
    """Gives parts of a few voxels to what surrounds them most, in place; a note if there are any.

    The largest part of a region stays, however small it is.
    """
    from scipy.ndimage import find_objects, label

    moved = []
    for number, name in enumerate(["", *names]):
        parts, count = label(numbers == number)
        if count <= 1:
            continue
        sizes = np.bincount(parts.ravel())[1:]
        small = np.flatnonzero(sizes < ISLAND) + 1
        small = small[small != int(np.argmax(sizes)) + 1]
        places = find_objects(parts)
        for part in small:
            around = tuple(slice(max(s.start - 1, 0), s.stop + 1) for s in places[part - 1])
            inside = parts[around] == part
            numbers[around][inside] = _around(numbers[around], inside)
        if len(small):
            what = f"of '{name}'" if number else "outside of all regions"
            moved.append(f"{len(small)} {what} ({sizes[small - 1].sum()} voxels)")
    if not moved:
        return []
    return [
        f"parts of fewer than {ISLAND} voxels were given to what surrounds them: {', '.join(moved)}"
    ]


def _around(numbers: AnyArray, inside: AnyArray) -> int:
    """The number that most voxels beside some others have; 0 of none, at the end of the image."""
    from scipy.ndimage import binary_dilation

    beside = numbers[binary_dilation(inside) & ~inside]
    return int(np.bincount(beside).argmax()) if len(beside) else 0
