"""Fields of images on a mesh: means over cells, places, what lies outside, the skin."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.images import write_dicom, write_nifti
from mpi4py import MPI

from dolfin_elastic import Case, run
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import on_root, total
from dolfin_elastic.mesh import Body, box_body
from dolfin_elastic.mesh.geometry.simplices import cell_corners, signed_volumes
from dolfin_elastic.mesh.images import field as field_module
from dolfin_elastic.mesh.images import means as means_module
from dolfin_elastic.mesh.images.field import ImageField, add_images

COMM = MPI.COMM_WORLD
N = 16
GRID = np.stack(np.meshgrid(*[np.arange(N) + 0.5] * 3, indexing="ij"))
BALL = np.linalg.norm(GRID - np.array([7.3, 8.6, 8.1])[:, None, None, None], axis=0) < 5.2
VALUES = (
    np.where(BALL, 1500, 100)
    + 300 * np.sin(GRID[0] / 3) * np.cos(GRID[1] / 4)
    + np.random.default_rng(1).normal(0, 100, BALL.shape)
).astype(np.int16)
"""A ball with a sharp edge, waves and noise."""
EYE = np.eye(4)


def at_corner(affine: np.ndarray) -> np.ndarray:
    """An affine whose first voxel has its corner at the origin."""
    result = np.array(affine)
    result[:3, 3] = 0.5 * result[:3, :3].sum(axis=1)
    return result


@cache
def box(cells: int, size: float = 1e-3 * N) -> Body:
    """Tetrahedra whose inner nodes are displaced, so that they lie across the voxels."""
    body = box_body(size=(size,) * 3, cells=(cells,) * 3, comm=COMM)
    x = body.mesh.geometry.x
    inner = ((x > 1e-6 * size) & (x < (1 - 1e-6) * size)).all(axis=1)
    waves = np.sin(1e5 * x[:, [1, 2, 0]] + [0.3, 1.7, 2.9])
    x[inner] += 0.15 * size / cells * waves[inner]
    return body


def image(folder: Path, values: np.ndarray = VALUES, affine: np.ndarray = EYE, **more: Any) -> str:
    on_root(COMM, lambda: write_nifti(folder / "a.nii", values, at_corner(affine), **more))
    return "a.nii"


def means(body: Body, folder: Path, **table: Any) -> np.ndarray:
    """Of the owned cells."""
    body.fields.pop("f", None)
    found = add_images(body, {"f": ImageField(**table)}, folder)
    return np.array(found.fields["f"].values[: own(body), 0])


def own(body: Body) -> int:
    return int(body.mesh.topology.index_map(body.dim).size_local)


def integral(body: Body, values: np.ndarray) -> float:
    volumes = abs(signed_volumes(cell_corners(body.mesh)))[: own(body)]
    return float(total(COMM, float(values @ volumes)))


@pytest.mark.parametrize("voxels", [1, 2, 4, 8])
def test_mass_is_the_integral_of_the_image(voxels: int, folder: Path) -> None:
    """To 1e-3, with cells of 1 to 8 voxels: lines are midpoints across cells and voxels."""
    body = box(N // voxels)
    found = integral(body, means(body, folder, image=image(folder)))
    assert found == pytest.approx(1e-9 * float(VALUES.sum(dtype=float)), rel=1e-3)


def test_constants_are_exact_and_means_are_between(folder: Path) -> None:
    body = box(4)
    even = means(body, folder, image=image(folder, np.full((N,) * 3, 7, np.int16)))
    np.testing.assert_allclose(even, 7.0, rtol=1e-12)
    found = means(body, folder, image=image(folder))
    assert VALUES.min() <= found.min(initial=9e9) and found.max(initial=-9e9) <= VALUES.max()


def linear(body: Body) -> np.ndarray:
    """x + 2 y + 4 z [mm] at the middles of cells."""
    middles = 1e3 * cell_corners(body.mesh).mean(axis=1)[: own(body)]
    return np.asarray(middles @ [1.0, 2.0, 4.0])


TURNS = {
    "as it is": np.eye(3),
    "mirrored": np.diag([-1.0, 1.0, 1.0]),
    "exchanged": np.eye(3)[[2, 0, 1]],
    "oblique": np.array([[0.8, -0.6, 0.0], [0.48, 0.64, -0.6], [0.36, 0.48, 0.8]]),
    "sheared": np.array([[0.5, 0.0, 0.2], [0.0, 1.0, 0.1], [0.0, 0.0, 0.8]]),
}


@pytest.mark.parametrize("turn", TURNS)
def test_orientation(turn: str, folder: Path) -> None:
    """The values are a function of the place; only voxels' size remains (0.2 of a voxel's step)."""
    body = box(2, 4e-3)
    affine = np.eye(4)
    affine[:3, :3] = 0.4 * TURNS[turn]
    n = 30
    affine[:3, 3] = 2.0 - affine[:3, :3] @ ([(n - 1) / 2] * 3)
    index = np.stack(np.meshgrid(*[np.arange(n)] * 3, indexing="ij"), -1)
    values = (index @ affine[:3, :3].T + affine[:3, 3]) @ [1.0, 2.0, 4.0]
    on_root(COMM, lambda: write_nifti(folder / "a.nii", values.astype(np.float32), affine))
    found = means(body, folder, image="a.nii")
    np.testing.assert_allclose(found, linear(body), atol=0.25)
    assert integral(body, found) == pytest.approx(integral(body, linear(body)), rel=2e-3)


def test_dicom_is_nifti(folder: Path) -> None:
    """Slices out of order, with slope and intercept: the same field."""
    pytest.importorskip("pydicom")
    body, raw = box(4), VALUES + 1024
    known = means(body, folder, image=image(folder))
    on_root(COMM, lambda: write_dicom(folder / "scan", raw, at_corner(EYE), scale=(1.0, -1024.0)))
    np.testing.assert_allclose(means(body, folder, image="scan"), known, rtol=1e-12)


def test_any_layers_and_ranks(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One layer at a time, and all in one; each rank takes its own cells: the same integral."""
    body, name = box(4), image(folder)
    known = means(body, folder, image=name)
    monkeypatch.setattr(field_module, "_SENT", 1)
    np.testing.assert_allclose(means(body, folder, image=name), known, rtol=1e-11)
    squares = integral(body, known**2)
    assert squares == pytest.approx(1.0681, rel=1e-3)


def test_maps(folder: Path) -> None:
    """A table, then a formula, of each voxel; not of the mean."""
    body, name = box(2), image(folder, np.where(BALL, 1000, 0).astype(np.int16))
    part = means(body, folder, image=name) / 1000
    steps = [[[-1000, 0], [1000, 2.0]], "v^2"]
    np.testing.assert_allclose(means(body, folder, image=name, map=steps), 1 + 3 * part, rtol=1e-9)
    with pytest.raises(InputError, match=r"fields.f.map: the value 0 of the image has no finite"):
        means(body, folder, image=name, map="1/v")


def test_frames_and_places(folder: Path) -> None:
    """LPS changes two signs; turn and move come after it."""
    body = box(4)
    known = means(body, folder, image=image(folder))
    mirrored = np.diag([-1.0, -1.0, 1.0, 1.0])
    name = image(folder, VALUES, mirrored)
    found = means(body, folder, image=name, frame="LPS")
    np.testing.assert_allclose(found, known, rtol=1e-9)
    with pytest.raises(InputError, match='wholly outside.*frame = "LPS": with it'):
        means(body, folder, image=name)
    turned = {"turn": {"axis": "z", "angle": 180}, "move": [0, 0, "1 mm"]}
    values = np.concatenate([VALUES, VALUES[:, :, :1]], axis=2)
    name = image(folder, np.roll(values, -1, axis=2)[:, :, :N], mirrored)
    found = means(body, folder, image=name, outside="nearest", **turned)
    # The first layer is nearest to itself below: all others lie where they were, but for
    # lines, which lie elsewhere in the voxels.
    above = 1e3 * cell_corners(body.mesh)[: own(body), :, 2].min(axis=1) > 1.001
    np.testing.assert_allclose(found[above], known[above], atol=25.0)


def test_outside(folder: Path) -> None:
    """A half of the image: an error, its own value, or that of the nearest voxel."""
    body, name = box(4), image(folder, np.full((N // 2, N, N), 10, np.int16))
    with pytest.raises(InputError, match=r"partly outside of the image.*\(8, 16, 16\)|partly"):
        means(body, folder, image=name)
    near = means(body, folder, image=name, outside="nearest")
    np.testing.assert_allclose(near, 10.0, rtol=1e-12)
    air = means(body, folder, image=name, outside=-1000.0, map="v/10")
    mean = integral(body, air) / (1e-9 * N**3)
    assert mean == pytest.approx((1.0 - 100.0) / 2, rel=1e-3)


def test_skin(folder: Path) -> None:
    """A blurred ball in air: outer cells get what lies inside, thin walls are said."""
    from scipy.ndimage import gaussian_filter

    far = np.linalg.norm(GRID - 8.0, axis=0)
    blurred = gaussian_filter(np.where(far < 7.3, 1000.0, -1000.0), 0.8).astype(np.float32)
    name = image(folder, blurred)
    body = box_body(size=(8e-3,) * 3, cells=(4,) * 3, comm=COMM)
    body.mesh.geometry.x[:] += 4e-3  # corners are 6.9 voxels from the middle
    plain = means(body, folder, image=name)
    body.fields.pop("f")
    found = add_images(body, {"f": ImageField(image=name, skin=2, threshold=0.0)}, folder)
    filled = found.fields["f"].values[: own(body), 0]
    lowest = COMM.allreduce(float(filled.min(initial=9e9)), op=MPI.MIN)
    assert lowest > 960 > COMM.allreduce(float(plain.min(initial=9e9)), op=MPI.MIN)
    assert any("skin = 2 changes" in text for text in found.information)
    assert not found.notes
    wall = np.where(abs(GRID[0] - 3.0) < 1, 900, blurred).astype(np.float32)
    body.fields.pop("f")
    more = add_images(
        body, {"f": ImageField(image=image(folder, wall), skin=2, threshold=0.0)}, folder
    )
    assert any("thinner than 4 voxels" in text for text in more.notes)
    with pytest.raises(InputError, match="no voxel lies 9 voxels below"):
        means(body, folder, image=name, skin=9, threshold=0.0)


@pytest.mark.long
def test_memory(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside the image itself a few layers and lines, whatever its size."""
    import tracemalloc

    values = np.ones((100, 100, 200), np.int16)  # 4 MB; as numbers of 8 bytes 16 MB
    body = box(4, 5e-2)
    affine = np.diag([0.5, 0.5, 0.25, 1.0])
    table = ImageField(image=image(folder, values, affine))
    monkeypatch.setattr(field_module, "_SENT", 1 << 15)
    monkeypatch.setattr(means_module, "_LINES", 1 << 11)
    try:
        tracemalloc.start()
        add_images(body, {"g": table}, folder)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
        body.fields.pop("g", None)
    assert peak < (2.6 if COMM.rank == 0 else 1.6) * values.nbytes


def test_in_a_case(folder: Path) -> None:
    """A modulus and a density of the same image; the mass is the image's integral."""
    image(folder)
    case = Case.from_dict(
        {
            "mesh": {"box": {"size": [N, N, N], "cells": [4, 4, 4]}, "unit": "mm"},
            "fields": {
                "E": {"image": "a.nii", "map": "max(v, 1)"},
                "ash": {"image": "a.nii", "map": [[[-1000, 1.0], [3000, 5.0]]]},
            },
            "materials": {
                "bone": {
                    "law": "linear-elastic",
                    "E": {"field": "E", "unit": "MPa"},
                    "nu": 0.3,
                    "density": "1000*ash",
                }
            },
            "support": [{"on": "left"}],
        },
        folder,
    )
    again = Case.from_dict(case.to_dict(), folder)
    body = again.read_body(COMM)
    ash = np.array(body.fields["ash"].values[: own(body), 0])
    expected = 1e-9 * float((2.0 + 1e-3 * VALUES.astype(float)).sum())
    assert integral(body, ash) == pytest.approx(expected, rel=1e-3)
    assert any("16 x 16 x 16 voxels of 1 x 1 x 1 mm" in text for text in body.information)
    taken = Case.from_dict({**case.to_dict(), "fields": {"E": {"image": "b.nii"}}}, folder)
    with pytest.raises(InputError, match=r"fields.E.image.*b.nii: there is no image"):
        taken.read_body(COMM)


def test_keys(folder: Path) -> None:
    for table, message in {
        "skin": ({"skin": 2}, "threshold: skin and threshold need each other"),
        "map": ({"map": [["a", 1]]}, "map"),
        "table": ({"map": [[0, 1], [0, 2]]}, "ascending"),
        "unit": ({"unit": "kg"}, "unit"),
    }.values():
        with pytest.raises(InputError, match=message):
            ImageField(image="a.nii", **table)


def test_temperatures_of_an_image(folder: Path) -> None:
    """A free body becomes longer by alpha T, T uniform in the image: exact for linear elements."""
    name = image(folder, np.full((N,) * 3, 50, np.int16))
    case = Case.from_dict(
        {
            "mesh": {"box": {"size": [N, N, N], "cells": [1, 1, 1]}, "unit": "mm"},
            "fields": {"T": {"image": name}},
            "materials": {
                "m": {"law": "linear-elastic", "E": "1 GPa", "nu": 0.3, "expansion": 1e-5}
            },
            "support": [{"kind": "symmetry", "on": side} for side in ("left", "bottom", "back")],
            "load": [{"kind": "thermal", "value": {"field": "T"}}],
        },
        folder,
    )
    *_, last = run(case, output=str(folder / "hot"))
    assert last.max_displacement == pytest.approx(3**0.5 * 5e-4 * 1e-3 * N, rel=1e-6)
