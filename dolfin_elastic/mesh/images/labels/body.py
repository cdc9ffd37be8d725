"""`label_body`: a body of tetrahedra from an image of labels."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from mpi4py import MPI

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.core.units import LengthUnit, to_si
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.mesh.distribute import build_body
from dolfin_elastic.mesh.formats.cad.process import Permission
from dolfin_elastic.mesh.formats.raw import Block, MeshFile, assemble, joined
from dolfin_elastic.mesh.geometry.checks import check_cells
from dolfin_elastic.mesh.images.image import Image
from dolfin_elastic.mesh.images.labels.nets import OUTER, Smoothing, surfaces_between
from dolfin_elastic.mesh.images.labels.regions import Labels, Regions, regions_of
from dolfin_elastic.mesh.read import with_stated_unit

_SMOOTHINGS = {
    Smoothing(30, 0.1): "",
    Smoothing(20, 0.3): "less than usual",
    Smoothing(0, 0.0): "not",
}
"""What is tried, one after the other, and how a note calls it."""
_TAKEN = (*(f"{axis}{end}" for axis in "xyz" for end in ("min", "max")), OUTER)
"""Names of surfaces."""


def label_body(
    path: str | os.PathLike[str],
    labels: Mapping[str, int | Sequence[int]] | None = None,
    *,
    threshold: float | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
    scale: float | None = None,
    size: float | str | None = None,
    curved: bool | None = None,
    time_limit: float = 600.0,
) -> Body:
    """Makes a body of the regions of an image, with smooth surfaces between them.

    Collective: rank 0 reads and meshes.  Surfaces are called NAME-outer, NAME-OTHER where two
    regions meet, and xmin, xmax ... where the image ends within a region; `outer` is all of the
    first ones.

    Args:
        path: .nii, .nii.gz, .mha, .mhd, .vti, or a folder of DICOM files.
        labels: Name of each region to its value, or several.
        threshold: Instead of labels: all voxels from this value on are the region "body".
        scale: Metres per unit of length of the file; None: what the file states.
        size: Of the elements, in the file's unit or with a unit; None: a twentieth of the diagonal.
        curved: Quadratic cells that follow the surfaces; None: yes.
        time_limit: Time that Gmsh may take [s].

    Raises:
        MeshError: The image cannot be read, has no such labels, or cannot be meshed.
    """
    path = Path(path)
    if (labels is None) == (threshold is None):
        raise MeshError(
            "an image needs either labels or a threshold",
            where=path.name,
            expected="labels = {bone = 1}, or of a grey image threshold = 300",
        )
    wanted = Labels(
        {n: [v] if isinstance(v, int) else list(v) for n, v in (labels or {}).items()}, threshold
    )
    found: list[tuple[Image, Regions]] = []

    def read() -> tuple[LengthUnit, LengthUnit | None]:
        from dolfin_elastic.mesh.images.read import read_image

        _check_names(wanted)
        image = read_image(path)
        unit = None if scale is None else LengthUnit.of(scale)
        image.metres(unit)  # refuses an image without unit
        found.append((image, regions_of(image, wanted)))
        stated = None if image.unit is None else replace(image.unit, stated=True)
        known = unit or stated
        assert known is not None
        return known, stated

    unit, stated = on_root(comm, read)
    edge = to_si(size, "m") / unit.metres if isinstance(size, str) else size
    if edge is not None and not edge > 0:
        raise MeshError(
            f"the size of the elements must be positive, not {size}",
            where="mesh.size",
            expected='for example "2 mm"',
        )

    def raw() -> MeshFile:
        return mesh_regions(
            *found.pop(), source=path.name, size=edge, curved=curved, seconds=time_limit
        )

    body = build_body(
        lambda: assemble(raw(), source=path.name), comm=comm, unit=unit, source=path.name
    )
    return check_cells(with_stated_unit(body, stated))


def mesh_regions(
    image: Image,
    regions: Regions,
    *,
    source: str,
    size: float | None,
    curved: bool | None,
    seconds: float,
) -> MeshFile:
    """Fills the regions of an image with tetrahedra. Local.

    Where Gmsh fails between smooth surfaces, as those of thin walls may cross, it gets others.

    Args:
        size: Of the elements, in the image's unit.
        seconds: That Gmsh may take.

    Raises:
        MeshError: Gmsh cannot fill them.
    """
    from dolfin_elastic.mesh.formats.surfaces.filling.fill import fill

    until, first = time.monotonic() + seconds, None
    for smoothing, how in _SMOOTHINGS.items():
        plc = surfaces_between(regions.numbers, image.affine, regions.names, smoothing)
        if size is None:
            size = float(np.linalg.norm(np.ptp(plc.points, axis=0))) / 20
        try:
            file = fill(
                plc,
                source=source,
                size=size,
                deviation=None,
                curved=curved,
                permission=Permission(seconds=max(until - time.monotonic(), 1.0)),
                even=True,
            )
        except MeshError as error:
            first = first or error
            continue
        note = [f"surfaces are {how} smoothed, for Gmsh fails between smoother ones"] if how else []
        return replace(
            file,
            blocks=[_with_outer(block) for block in file.blocks],
            notes=[*regions.notes, *note, *file.notes],
            information=[*regions.information, *file.information],
        )
    assert first is not None
    raise first


def _with_outer(block: Block) -> Block:
    """Facets with the surface of all regions."""
    own = [rows for name, rows in block.parts.items() if name.endswith(f"-{OUTER}")]
    if block.dim != 2 or not own:
        return block
    return replace(block, parts={**block.parts, OUTER: np.unique(joined(own))})


def _check_names(labels: Labels) -> None:
    """Refuses names that surfaces have."""
    for name in labels.values:
        if not name or name in _TAKEN:
            raise MeshError(
                f"'{name}' is the name of a surface" if name else "a label has no name",
                where=f"labels.{name}",
                expected="another name for the region",
            )
