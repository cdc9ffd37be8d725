"""Groups of MED files: of volumes, faces, edges and nodes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.decks import COMM, box, made, shared_folder
from mpi4py import MPI

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.mesh import Body, mesh_statistics, read_body

POINTS, CELLS = box((2, 1, 1), (2, 1, 1))


def write(path: Path) -> None:
    """Two cubes; groups of each kind of element, and of nodes."""
    import meshio

    low = np.flatnonzero(POINTS[:, 2] == 0)
    faces = [c[list(f)] for c in CELLS for f in ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3))]
    faces = [f for f in faces if np.isin(f, low).all()]
    rim = np.array([[0, 1], [1, 2]])  # the edge along x
    mesh = meshio.Mesh(
        POINTS,
        [("tetra", CELLS), ("triangle", np.array(faces)), ("line", rim)],
        cell_data={"cell_tags": [np.full(len(CELLS), -6), np.full(len(faces), -7), np.full(2, -8)]},
        point_data={"point_tags": np.where(np.arange(len(POINTS)) == len(POINTS) - 1, 3, 0)},
    )
    mesh.cell_tags = {-6: ["block"], -7: ["foot"], -8: ["rim"]}
    mesh.point_tags = {3: ["corner"]}
    mesh.write(path)


def test_groups_of_every_dimension() -> None:
    """Those of edges and nodes were left out."""
    with shared_folder() as folder:
        made(lambda: write(folder / "block.med"))
        body = read_body(folder / "block.med")
    size = mesh_statistics(body)
    assert size.regions == pytest.approx({"block": 2})
    assert size.surfaces == pytest.approx({"foot": 2})
    assert body.kinds("rim") == ("edge",) and body.kinds("corner") == ("point",)
    assert COMM.allreduce(len(body.owned_edges("rim"))) == 2
    assert places(body, "corner") == [(2, 1, 1)]


def thin(path: Path) -> None:
    """Leaves out what MED may leave out: groups of a family, numbers of families that are 0."""
    import h5py

    write(path)
    with h5py.File(path, "r+") as file:
        families = file["FAS/mesh/ELEME"]
        for family in families.values():
            if family.attrs["NUM"] == -6:
                del family["GRO"]
        step = next(iter(file["ENS_MAA/mesh"].values()))
        del step["MAI/SE2/FAM"]


def test_families_without_groups(folder: Path) -> None:
    """They name nothing, and neither do elements without a number of a family."""
    made(lambda: thin(folder / "block.med"))
    body = read_body(folder / "block.med")
    size = mesh_statistics(body)
    assert size.volume == pytest.approx(2) and size.regions == {}
    assert size.surfaces == pytest.approx({"foot": 2})
    names = {name for parts in body.parts.values() for name in parts}
    assert names == {"foot", "corner"} and body.notes == ()


def test_meshes_without_families(folder: Path) -> None:
    def bare() -> None:
        import h5py

        write(folder / "block.med")
        with h5py.File(folder / "block.med", "r+") as file:
            del file["FAS"]
            step = next(iter(file["ENS_MAA/mesh"].values()))
            for group in (step["NOE"], *step["MAI"].values()):
                del group["FAM"]

    made(bare)
    assert mesh_statistics(read_body(folder / "block.med")).volume == pytest.approx(2)


def old(path: Path) -> None:
    """As MED 2 writes it: no steps, no ESP, names as letters up to a zero, fields by kinds."""
    import h5py

    write(path)
    with h5py.File(path, "r+") as file:
        mesh = file["ENS_MAA/mesh"]
        step = next(iter(mesh.values()))
        for name in ("NOE", "MAI"):
            file.move(f"{step.name}/{name}", f"{mesh.name}/{name}")
        del mesh[step.name], mesh.attrs["ESP"]
        file.move("FAS/mesh", "ENS_MAA/mesh/FAS")
        for kind in ("ELEME", "NOEUD"):
            for family in mesh[f"FAS/{kind}"].values():
                name = bytes(family["GRO/NOM"][()].astype(np.uint8).tobytes()).rstrip(b"\0 ")
                del family["GRO/NOM"]
                family["GRO/NOM"] = np.frombuffer((name + b"\0\xf8@").ljust(81, b"\xff"), "S1")
        file.create_group("CHA/heat/MAI.TE4")


def test_version_2(folder: Path) -> None:
    """It was refused by a KeyError of 'ESP'."""
    made(lambda: old(folder / "block.med"))
    body = read_body(folder / "block.med")
    size = mesh_statistics(body)
    assert size.volume == pytest.approx(2) and size.regions == pytest.approx({"block": 2})
    assert size.surfaces == pytest.approx({"foot": 2})
    assert places(body, "corner") == [(2, 1, 1)]
    assert body.notes == ("fields of MED 2 are not read: save the file anew, as MED 3 or 4",)


def test_fields_on_some_elements(folder: Path) -> None:
    """One of the volumes alone was refused by a TypeError of meshio."""

    def heated() -> None:
        import h5py
        import meshio

        data = {"heat": [np.arange(len(CELLS), dtype=float), np.zeros(1)]}
        cells = [("tetra", CELLS), ("triangle", CELLS[:1, :3])]
        meshio.Mesh(POINTS, cells, cell_data=data).write(folder / "block.med")
        with h5py.File(folder / "block.med", "r+") as file:
            step = next(iter(file["CHA/heat"].values()))
            del step["MAI.TR3"]

    made(heated)
    body = read_body(folder / "block.med")
    found = COMM.allgather(body.fields["heat"].values[body.owned_cells(), 0].tolist())
    assert sorted(x for part in found for x in part) == list(range(len(CELLS)))


def test_elements_that_are_not_read(tmp_path: Path) -> None:
    """Polygons ended in a KeyError 'POG'."""
    import h5py

    write(tmp_path / "block.med")
    with h5py.File(tmp_path / "block.med", "r+") as file:
        step = next(iter(file["ENS_MAA/mesh"].values()))
        file.move(f"{step.name}/MAI/TR3", f"{step.name}/MAI/POG")
    with pytest.raises(MeshError, match=r"block\.med: its elements POG are not read; TE4 or T10"):
        read_body(tmp_path / "block.med", comm=MPI.COMM_SELF)


def places(body: Body, name: str) -> list[tuple[float, ...]]:
    """Nodes of a point on all ranks [m]."""
    own = body.mesh.geometry.x[body.owned_points(name)]
    return sorted(tuple(row) for rows in COMM.allgather(own.tolist()) for row in rows)
