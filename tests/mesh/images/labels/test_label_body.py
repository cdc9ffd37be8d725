"""Label images that become meshes: the same body on any number of ranks, by case and Python."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.images import write_nifti
from helpers.phantoms import affine, nested_balls, shaft
from mpi4py import MPI

from dolfin_elastic.case.case import Case
from dolfin_elastic.core.errors import InputError, MeshError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh import mesh_statistics
from dolfin_elastic.mesh.images.labels.body import label_body, mesh_regions
from dolfin_elastic.mesh.images.labels.regions import Labels, regions_of
from dolfin_elastic.mesh.images.read import read_image

COMM = MPI.COMM_WORLD
LABELS = {"bone": 1, "marrow": [2]}


def test_nested_balls_have_their_volumes(folder: Path) -> None:
    labels, true = nested_balls(32)
    path = folder / "labels.nii.gz"
    on_root(COMM, lambda: (write_nifti(path, labels, affine(32)), None)[1])
    body = label_body(path, LABELS, size=4, comm=COMM)
    found = mesh_statistics(body)
    voxels = np.bincount(labels.ravel())[1:] * 0.625**3
    # Curved elements of this size have the volume of the voxels to 0.1 %, or finer ones are made;
    # the voxels have that of the balls to 0.05 %.
    for k, name in enumerate(LABELS):
        assert found.regions[name] == pytest.approx(voxels[k] * 1e-9, rel=1e-3)
        assert found.regions[name] == pytest.approx(true[k] * 1e-9, rel=2e-3)
    assert set(found.surfaces) == {"bone-outer", "bone-marrow", "outer"}
    assert found.surfaces["outer"] == pytest.approx(4 * np.pi * 64e-6, rel=0.01)
    assert body.unit.name == "mm"


def test_the_same_image_gives_the_same_body(folder: Path) -> None:
    """On any number of ranks and in any run, to the last digit.

    Four of its quadratic cells fold: Gmsh's optimisation of these moved nodes to other places in
    each run, as it depended on addresses in memory.
    """
    path = folder / "labels.nii.gz"
    on_root(COMM, lambda: (write_nifti(path, nested_balls(32)[0], affine(32)), None)[1])
    body = label_body(path, LABELS, size=2, comm=COMM)
    own = body.mesh.geometry.x[: body.mesh.geometry.index_map().size_local]
    found = np.concatenate(COMM.allgather(own))

    def again() -> FloatArray:
        image = read_image(path)
        regions = regions_of(image, Labels({"bone": [1], "marrow": [2]}))
        options = {"source": path.name, "size": 2.0, "curved": None, "seconds": 60.0}
        return mesh_regions(image, regions, **options).points * 1e-3

    expected = on_root(COMM, again)
    assert np.array_equal(np.unique(found, axis=0), np.unique(expected, axis=0))


def test_an_image_that_ends_within_its_body(folder: Path) -> None:
    """By a case, with straight elements, as explicit motion has them."""
    labels, _ = shaft(16)
    on_root(COMM, lambda: (write_nifti(folder / "a.nii", labels, affine(16)), None)[1])
    tables = {
        "mesh": {"image": "a.nii", "labels": LABELS, "size": 4, "unit": "mm", "curved": False},
        "materials": {"m": {"law": "neo-hookean", "E": "1 MPa", "nu": 0.3}},
    }
    case = Case.from_dict(tables, folder)
    found = mesh_statistics(case.read_mesh(COMM))
    voxels = np.bincount(labels.ravel())[1:] * 1.25**3
    assert found.regions["marrow"] == pytest.approx(voxels[1] * 1e-9, rel=1e-3)
    ends = (labels[0] > 0).sum() * 1.25**2 * 1e-6
    assert found.surfaces["xmin"] == pytest.approx(ends, rel=0.02)
    assert found.high[0] - found.low[0] == pytest.approx(0.02, rel=1e-9)


def test_an_image_without_unit_asks_for_it(folder: Path) -> None:
    path = folder / "a.nii"
    on_root(COMM, lambda: (write_nifti(path, shaft(8)[0], affine(8), unit=0), None)[1])
    with pytest.raises(MeshError, match="does not say the unit"):
        label_body(path, LABELS, comm=COMM)


FAULTS = {
    "image alone": ({"image": "a.nii"}, "labels are missing"),
    "both": ({"image": "a.nii", "labels": {"a": 1}, "threshold": 2}, "given together"),
    "labels of a box": (
        {"box": {"size": [1, 1, 1], "cells": [1, 1, 1]}, "labels": {"a": 1}},
        "a box has no voxels",
    ),
}


@pytest.mark.parametrize(("mesh", "text"), FAULTS.values(), ids=FAULTS)
def test_tables_that_make_no_sense(mesh, text) -> None:
    with pytest.raises(InputError, match=text):
        Case(mesh=mesh, materials={})
