"""CAD files and old .msh files, read through Gmsh."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.core.units import METRE, LengthUnit
from dolfin_elastic.mesh.faces import CadFaces
from dolfin_elastic.mesh.formats.cad.faces import CadFace
from dolfin_elastic.mesh.formats.cad.meshing import RESULT, read_normals
from dolfin_elastic.mesh.formats.cad.process import (
    GmshProcess,
    Permission,
    gmsh_process,
    notes_of,
)
from dolfin_elastic.mesh.formats.cad.script import SCRIPTS, files_of_script
from dolfin_elastic.mesh.formats.msh import mesh_alone, read_msh
from dolfin_elastic.mesh.formats.raw import Block, MeshFile
from dolfin_elastic.mesh.local_size import NO_SIZES, CadSizes


def mesh_cad(
    path: Path,
    *,
    size: float | None,
    curved: bool | None,
    dim: int | None,
    join: bool = True,
    stated: LengthUnit | None = None,
    unit: LengthUnit | None = None,
    local: CadSizes = NO_SIZES,
    permission: Permission,
) -> MeshFile:
    """Meshes a CAD file. Local: one rank meshes.

    Args:
        size: Size of the elements, in the file's unit; where the file asks for finer ones, that
            holds.  None: as the file says, or a tenth of its diagonal, or what Gmsh can mesh.
        curved: Quadratic cells that follow curved surfaces; None: where there are any, and the
            cells do not fold.
        dim: 2 or 3; by default 3 where there are volumes.
        join: Bodies that touch share the nodes there; a .geo file joins its bodies itself.
        stated: Unit that the file states.
        unit: Unit that is taken for it, for messages; by default the same, or m.

    Raises:
        MeshError: Gmsh cannot read or mesh the file, or it asks for more than a mesh.
    """
    factor, known = model_unit(stated, path), unit or stated or METRE
    with gmsh_process(path, _files(path, permission), permission) as (gmsh, folder):
        lengths = {"unit": known.name, "factor": factor}
        shapes = gmsh.ask("shapes", dim=dim, join=join, **lengths)
        dim, model = int(shapes["dim"]), factor * known.metres
        faces = [CadFace.read(data, model, dim) for data in shapes["faces"]]
        every = CadFaces({face.number: face for face in faces}, dim, known)
        answer = gmsh.ask(
            "mesh",
            size=size,
            local=local.for_gmsh(every, shapes["bodies"], model, permission.seconds),
            curved=curved,
            dim=dim,
            **lengths,
        )
        file = read_msh(folder / RESULT)
        normals = read_normals(folder, answer["normals"], dim)
    return MeshFile(
        file.points * factor,
        [_with_normals(block, dim, normals) for block in file.blocks],
        [*file.notes, *shapes["notes"], *answer["notes"], *notes_of(permission)],
        [*shapes["information"], *answer["information"], *local.information(known)],
        # Samples tell where faces are before there is a mesh; after that they are a burden.
        faces=[replace(face, samples=(), normals=()) for face in faces],
    )


def _with_normals(block: Block, dim: int, normals: Mapping[int, FloatArray]) -> Block:
    """A block of facets with the normals of its face."""
    result = normals.get(block.entity) if block.dim == dim - 1 else None
    return (
        block
        if result is None or len(result) != len(block.nodes)
        else replace(block, normals=result)
    )


def convert_msh(path: Path, permission: Permission) -> MeshFile:
    """Reads a .msh file of an old version. Local: one rank reads.

    Raises:
        MeshError: Gmsh cannot read it.
    """
    files = {Path(path.name): mesh_alone(path.read_bytes())}
    within = Permission(seconds=permission.seconds)  # a mesh needs no trust
    with gmsh_process(path, files, within) as (gmsh, folder):
        gmsh.ask("convert")
        file = read_msh(folder / RESULT)
    return replace(file, notes=[*file.notes, *notes_of(within)])


class CadModel:
    """Gmsh's model of a CAD file: what it knows of points, curves and surfaces."""

    def __init__(self, gmsh: GmshProcess) -> None:
        self._gmsh = gmsh

    def entities(self, dim: int) -> list[int]:
        """Numbers of all curves or surfaces."""
        return [int(tag) for _, tag in self._ask("getEntities", dim)]

    def box(self, dim: int, tag: int) -> FloatArray:
        """Smallest and largest coordinates of a curve or surface, shape (6,).

        Args:
            dim: 1 or 2.
        """
        return np.array(self._ask("getBoundingBox", dim, tag), dtype=np.float64)

    def kind(self, dim: int, tag: int) -> str:
        """What a curve or surface is: "Line", "Plane", "Cylinder" ...

        Args:
            dim: 1 or 2.
        """
        return str(self._ask("getType", dim, tag))

    def below(self, dim: int, tag: int) -> set[int]:
        """Numbers of the curves of a surface, or of the points of a curve.

        Args:
            dim: 1 or 2.
        """
        return {abs(int(t)) for t in self._ask("getAdjacencies", dim, tag)[1]}

    def nearest(self, dim: int, tag: int, coordinates: FloatArray) -> FloatArray:
        """Nearest places on a curve or surface.

        Args:
            dim: 1 or 2.
            coordinates: In the model's unit, shape (n, 3).

        Raises:
            MeshError: Gmsh finds none.
        """
        if not len(coordinates):
            return coordinates
        points, _ = self._ask("getClosestPoint", dim, tag, coordinates.reshape(-1).tolist())
        return np.asarray(points, dtype=np.float64).reshape(-1, 3)

    def _ask(self, name: str, *arguments: Any) -> Any:
        return self._gmsh.ask("ask", name=name, arguments=arguments)


@contextmanager
def open_model(path: Path, permission: Permission) -> Iterator[CadModel]:
    """The model of a CAD file, which is not meshed. Local.

    Raises:
        MeshError: Gmsh cannot read it.
    """
    with gmsh_process(path, _files(path, permission), permission) as (gmsh, _):
        gmsh.ask("load")
        yield CadModel(gmsh)


def _files(path: Path, permission: Permission) -> Mapping[Path, bytes]:
    """What Gmsh needs of a file: its content, of a script also those of the files it reads."""
    is_script = path.suffix.lower() in SCRIPTS
    if is_script:
        _check_last_line(path)
    if permission.trusted:
        return {}
    return files_of_script(path) if is_script else {Path(path.name): path.read_bytes()}


def model_unit(stated: LengthUnit | None, path: Path) -> float:
    """Units of the file per unit of Gmsh's model: OpenCASCADE converts STEP and IGES to mm.

    Args:
        stated: Unit that the file states.
        path: The file; a script's model is in the script's unit.
    """
    is_script = path.suffix.lower() in SCRIPTS
    return 1.0 if stated is None or is_script else 1e-3 / stated.metres


def _check_last_line(path: Path) -> None:
    """Refuses a last line of several statements without line break: Gmsh 4.13 drops some."""
    last = path.read_bytes().rpartition(b"\n")[2] if path.suffix.lower() == ".geo" else b""
    if last.count(b";") > 1:
        raise MeshError(
            "the last line has no line break: Gmsh would leave a part of it out",
            where=path.name,
            expected="end the file with an empty line",
        )
