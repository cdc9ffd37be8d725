"""`ImageField`: a field in the cells of a mesh from an image of voxels."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from dolfin_elastic.core.errors import InputError, MeshError, keyed
from dolfin_elastic.core.parallel import agree, on_root, total
from dolfin_elastic.core.schema import Record
from dolfin_elastic.core.shapes.turn import Turn
from dolfin_elastic.core.types import AnyArray, FloatArray
from dolfin_elastic.core.units import LengthUnit, to_si
from dolfin_elastic.mesh.assembly.placement import Place, Placed
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.mesh.fields import MeshField
from dolfin_elastic.mesh.geometry.simplices import cell_corners, signed_volumes
from dolfin_elastic.mesh.images.image import LPS, Image
from dolfin_elastic.mesh.images.means import CellMeans, Layers
from dolfin_elastic.mesh.images.value_map import ValueMap

_SENT = 1 << 22
"""Voxels that are sent to all ranks at a time, at least a layer."""
_BEYOND = 0.5
"""Voxels by which nodes may lie outside: meshes of a whole image have such round-off."""
_CHANGED = 0.01
"""Part of its value by which a cell changes that is counted."""


class ImageField(Record):
    """A field in cells: the mean, over each cell, of the mapped values of an image's voxels.

    Attributes:
        image: .nii, .nii.gz, .mha, .mhd, .vti, or a folder of DICOM files; relative to the case.
        series: Of a folder with several series, a part of the name, or the number, of the one.
        unit: Unit of length of the image; empty: the one that it states.
        frame: Of the mesh: x to the right and y anterior (RAS, as in NIfTI files), or x to the left
            and y posterior (LPS, as DICOM and programs built on ITK write surfaces and meshes).
        turn: How the image is turned before it lies where the mesh is.
        move: How it is moved then, bare numbers in the unit of the mesh.
        outside: What becomes of elements outside of the image: an error, the value of the nearest
            voxel, or a value of the image, such as -1000.
        map: Steps from the values of voxels to those of the field: each a formula in v, or a table
            of pairs, linear between them.  They are applied before the means.
        skin: Depth in voxels below the surface of what is at least `threshold` in which each voxel
            gets the value of the nearest one deeper inside; 0: it has its own.
        threshold: Value of the image from which on a voxel belongs to the body.
    """

    lengths: ClassVar[tuple[str, ...]] = ("move",)
    image: str
    series: str = ""
    unit: str = ""
    frame: Literal["RAS", "LPS"] = "RAS"
    turn: Turn | None = None
    move: Place | None = None
    outside: Literal["error", "nearest"] | float = "error"
    map: str | list[object] = Field(default=[])
    skin: int = Field(default=0, ge=0, le=20)
    threshold: float | None = None

    @model_validator(mode="after")
    def _complete(self) -> ImageField:
        with keyed("unit"):
            _ = self.length_unit
        with keyed("map"):
            ValueMap(self.map)
        if bool(self.skin) != (self.threshold is not None):
            raise InputError(
                "skin and threshold need each other",
                where="threshold" if self.skin else "skin",
                expected="for example skin = 2, threshold = 200",
            )
        return self

    @property
    def length_unit(self) -> LengthUnit | None:
        """Of the image; None: as it states."""
        return LengthUnit.of(to_si(f"1 {self.unit}", "m")) if self.unit else None

    def placed(self, image: Image, body: Body) -> FloatArray:
        """From voxels to metres of the mesh, shape (4, 4).

        Raises:
            MeshError: The unit is not known, or a vector has another size than the body.
        """
        affine = image.metres(self.length_unit)
        if self.frame == "LPS":
            affine = LPS @ affine
        d, place = body.dim, Placed(body, self.move, self.turn)
        ends = np.vstack([np.zeros(d), np.eye(d)])
        ends = place.points(ends)
        motion = np.eye(4)
        motion[:d, :d], motion[:d, 3] = (ends[1:] - ends[0]).T, ends[0]
        return np.asarray(motion @ affine)

    def on(self, body: Body, image: Image | None) -> Found:
        """The field on a body. Collective.

        Only rank 0 has the image.  It sends some layers at a time, of the part around the body, to
        all ranks, which take what lies in their own cells.

        Args:
            image: On rank 0.

        Raises:
            InputError: The body is not inside of the image, or a value has no finite result.
        """
        return _Sampled(self, body, image).found()


@dataclass(frozen=True)
class Found:
    """A field with what is to be said of it.

    Attributes:
        field: Of one number a cell.
        notes: What is doubtful.
        information: What the image is.
    """

    field: MeshField
    notes: tuple[str, ...]
    information: tuple[str, ...]


class _Sampled:
    """Means of an image on a body. Collective."""

    def __init__(self, table: ImageField, body: Body, image: Image | None) -> None:
        self._table, self._body, self._image = table, body, image
        comm = body.comm

        def placed() -> tuple[FloatArray, tuple[int, ...]]:
            assert image is not None
            if body.dim == 2 and image.values.shape[2] != 1:
                raise MeshError(
                    f"the image has {image.values.shape[2]} slices, the body is plane",
                    expected="an image of one slice",
                )
            return table.placed(image, body), image.values.shape

        affine, self._shape = on_root(comm, placed)
        self._volume = abs(float(np.linalg.det(affine[:3, :3])))
        d = body.dim
        back = np.linalg.inv(affine[:d, :d])
        x = cell_corners(body.mesh)[..., :d] - affine[:d, 3]
        # Sums in a fixed order: the same on any number of ranks.
        parts = [x[..., j, None] * back[:, j] for j in range(d)]
        self._corners = np.asarray(sum(parts[1:], parts[0]) + 0.5)
        self._affine = affine
        self._check_inside()

    def _ends(self) -> tuple[FloatArray, FloatArray]:
        """Of the body along the axes of the image [voxels], shape (3,)."""
        comm, d = self._body.comm, self._body.dim
        flat = self._corners.reshape(-1, d)
        low, high = np.zeros(3), np.ones(3)
        low[:d] = np.min(comm.allgather(flat.min(axis=0, initial=np.inf)), axis=0)
        high[:d] = np.max(comm.allgather(flat.max(axis=0, initial=-np.inf)), axis=0)
        return low, high

    def _check_inside(self) -> None:
        self._low, self._high = self._ends()
        shape = np.array(self._shape)
        beyond = np.maximum(-self._low, self._high - shape)
        self._reaches_out = bool((beyond > _BEYOND).any())
        apart = bool(((self._low >= shape) | (self._high <= 0)).any())
        if not apart and not (self._reaches_out and self._table.outside == "error"):
            return
        unit = self._body.unit
        corners = np.array([[0, 0, 0], [1, 1, 1]]) * shape - 0.5
        index = np.stack(np.meshgrid(*corners.T, indexing="ij"), -1).reshape(-1, 3)
        places = index @ self._affine[:3, :3].T + self._affine[:3, 3]
        body = cell_corners(self._body.mesh).reshape(-1, 3)
        comm, d = self._body.comm, self._body.dim
        low = np.min(comm.allgather(body.min(axis=0, initial=np.inf)), axis=0)[:d]
        high = np.max(comm.allgather(body.max(axis=0, initial=-np.inf)), axis=0)[:d]
        own = places[:, :d].min(axis=0), places[:, :d].max(axis=0)
        raise MeshError(
            f"the body, from {unit.point(low)} to {unit.point(high)}, lies "
            f"{'wholly' if apart else 'partly'} outside of the image, which reaches from "
            f"{unit.point(own[0])} to {unit.point(own[1])}",
            where="image",
            expected=self._advice(low, high, own),
        )

    def _advice(self, low: FloatArray, high: FloatArray, own: Sequence[FloatArray]) -> str:
        """What to write, after a look at whether the other frame would fit."""
        turned_low, turned_high = low.copy(), high.copy()
        turned_low[:2], turned_high[:2] = -high[:2], -low[:2]
        slack = _BEYOND * float(self._volume) ** (1 / 3)
        if (turned_low >= own[0] - slack).all() and (turned_high <= own[1] + slack).all():
            other = "RAS" if self._table.frame == "LPS" else "LPS"
            return f'frame = "{other}": with it the body lies inside'
        return (
            "the right unit or frame, or move and turn; where it may reach out, "
            'outside = "nearest" or a value of the image'
        )

    def found(self) -> Found:
        """The field, and what is to be said."""
        table, comm = self._table, self._body.comm
        crop = self._crop()

        def describe() -> str:
            assert self._image is not None
            return self._describe(self._image, crop)

        notes, information = list[str](), [on_root(comm, describe)]
        part = None if self._image is None else self._image.values[crop]
        means = self._means(part, crop)
        if self._reaches_out:
            notes.append("elements reach out of the image: outside says what becomes of them")
        if table.skin:
            plain = means
            part, thin = self._skinned(part)
            means = self._means(part, crop)
            information.append(self._change(plain, means))
            if thin > _CHANGED:
                notes.append(
                    f"{100 * thin:.2g} % of the voxels above the threshold are in walls thinner "
                    f"than {2 * table.skin} voxels, which have no inside: they have values of "
                    "thicker places nearby"
                )
        return Found(MeshField("cell", means[:, None]), tuple(notes), tuple(information))

    def _describe(self, image: Image, crop: tuple[slice, ...]) -> str:
        unit = self._body.unit
        edges = np.linalg.norm(self._affine[:3, :3], axis=0) / unit.metres
        size = " x ".join(map(str, image.values.shape))
        some = image.values[crop]
        return (
            f"{size} voxels of {' x '.join(f'{e:.4g}' for e in edges)} {unit.name}, around the "
            f"body {float(some.min()):.4g} to {float(some.max()):.4g}"
        )

    def _crop(self) -> tuple[slice, slice, slice]:
        """Voxels around the body, with as many further ones as the skin is deep."""
        more = 2 * self._table.skin + 1
        low = np.clip(np.floor(self._low).astype(int) - more, 0, np.array(self._shape) - 1)
        high = np.clip(np.ceil(self._high).astype(int) + more, 1, self._shape)
        one, two, three = (slice(int(a), int(b)) for a, b in zip(low, high, strict=True))
        return one, two, three

    def _skinned(self, part: AnyArray | None) -> tuple[AnyArray | None, float]:
        """The part with values carried outwards, on rank 0, and how much of it is thin."""
        from dolfin_elastic.mesh.images.skin import carried_outwards

        result: list[AnyArray] = []

        def carry() -> float:
            assert part is not None
            assert self._table.threshold is not None
            spacing = np.linalg.norm(self._affine[:3, :3], axis=0)
            found = carried_outwards(part, self._table.threshold, self._table.skin, spacing)
            result.append(found.values)
            return found.thin

        thin = on_root(self._body.comm, carry)
        return (result[0] if result else None), thin

    def _means(self, part: AnyArray | None, crop: tuple[slice, slice, slice]) -> FloatArray:
        shift = [float(one.start) for one in crop[: self._body.dim]]
        found = CellMeans(self._corners - shift)
        for layers in self._layers(part, crop):
            found.add(layers)
        return found.means

    def _layers(self, part: AnyArray | None, crop: tuple[slice, slice, slice]) -> Iterator[Layers]:
        """Layers of the mapped part, some at a time."""
        comm, steps = self._body.comm, ValueMap(self._table.map)
        ni, nj, nk = shape = tuple(one.stop - one.start for one in crop)
        outside = None
        if isinstance(self._table.outside, float):
            with keyed("outside"):
                outside = float(steps(np.array([self._table.outside]))[0])
        count = max(_SENT // (ni * nj), 1)
        for first in range(0, nk, count):
            values, error = np.empty((min(count, nk - first), nj, ni)), None
            if part is not None:
                try:
                    with keyed("map"):
                        values[:] = steps(part[:, :, first : first + count].T)
                except InputError as caught:
                    error = caught
            agree(comm, error)
            comm.Bcast(values)
            yield Layers.of(values, first, (shape[0], shape[1], shape[2]), outside)

    def _change(self, plain: FloatArray, means: FloatArray) -> str:
        own = slice(0, self._body.mesh.topology.index_map(self._body.dim).size_local)
        volumes = abs(signed_volumes(cell_corners(self._body.mesh)))[own]
        plain, means = plain[own], means[own]
        changed = np.count_nonzero(abs(means - plain) > _CHANGED * abs(plain))
        before, after, count = total(
            self._body.comm,
            np.array([float(plain @ volumes), float(means @ volumes), float(changed)]),
        )
        part = (after - before) / abs(before) if before else 0.0
        return (
            f"skin = {self._table.skin} changes {int(count)} of {self._body.num_cells} elements by "
            f"more than 1 %, and the integral over the body by {100 * part:+.2g} %"
        )


def add_images(
    body: Body, fields: Mapping[str, ImageField], folder: Path, names: str = "fields"
) -> Body:
    """The body with fields from images. Collective.

    Args:
        body: Its `fields` get them, too.
        fields: Name to where they come from.
        folder: Folder that the paths are relative to.
        names: Key of the tables in the case file.

    Raises:
        InputError: An image that cannot be read, or that is not around the body; or a name that a
            field of the mesh has.
    """
    read: dict[tuple[str, str], Image] = {}
    notes, information = [*body.notes], [*body.information]
    for name, table in fields.items():
        key = table.image, table.series
        with keyed(f"{names}.{name}"):
            if name in body.fields:
                raise MeshError("the mesh has a field of this name", expected="another name")

            def load(table: ImageField = table, key: tuple[str, str] = key) -> None:
                from dolfin_elastic.mesh.images.read import read_image

                if key not in read:
                    read[key] = read_image(folder / table.image, series=table.series)

            with keyed("image"):
                on_root(body.comm, load)
            found = table.on(body, read.get(key))
        body.fields[name] = found.field
        place = f"field '{name}' from {Path(table.image).name}: "
        notes += [place + text for text in found.notes]
        information += [place + text for text in found.information]
    return replace(body, notes=tuple(notes), information=tuple(information))
