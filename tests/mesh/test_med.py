"""Groups of MED files: of volumes, faces, edges and nodes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.decks import COMM, box, made, shared_folder

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


def places(body: Body, name: str) -> list[tuple[float, ...]]:
    """Nodes of a point on all ranks [m]."""
    own = body.mesh.geometry.x[body.owned_points(name)]
    return sorted(tuple(row) for rows in COMM.allgather(own.tolist()) for row in rows)
