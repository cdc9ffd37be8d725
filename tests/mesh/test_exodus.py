"""Exodus files: blocks, side sets and node sets by name, of both kinds of netCDF."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from helpers.decks import COMM, box, made, quadratic

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import AnyArray
from dolfin_elastic.mesh import mesh_statistics, read_body
from dolfin_elastic.mesh.formats.exodus import read_exodus

POINTS, CELLS = box((2, 1, 1), (2, 1, 1))
FORMS = {"CDF-1": 1, "CDF-2": 2, "netCDF-4": 4}


def letters(*words: str) -> AnyArray:
    """Names as rows of letters, filled by zeros, as Exodus stores them."""
    return np.array([list(word.ljust(33, "\0")) for word in words], dtype="S1")


def write(path: Path, form: int, arrays: Mapping[str, object], kinds: Mapping[str, str]) -> None:
    """Arrays of a name each, and types of the elements of blocks."""
    data = {name: np.asarray(values) for name, values in arrays.items()}
    if form < 4:  # they have no integers of 64 bits
        data |= {n: a.astype(np.int32) for n, a in data.items() if a.dtype == np.int64}
    if form == 4:
        import h5py

        with h5py.File(path, "w") as file:
            for name, values in data.items():
                file[name] = values
            for name, kind in kinds.items():
                file[name].attrs["elem_type"] = np.bytes_(kind)
        return
    from scipy.io import netcdf_file

    with netcdf_file(path, "w", version=form) as file:
        for name, values in data.items():
            axes = [f"{name}_{i}" for i in range(values.ndim)]
            for axis, count in zip(axes, values.shape, strict=True):
                file.createDimension(axis, count)
            file.createVariable(name, values.dtype.char.replace("S", "c"), axes)[:] = values
        for name, kind in kinds.items():
            file.variables[name].elem_type = kind


def coordinates(points: AnyArray) -> dict[str, object]:
    return {f"coord{axis}": column for axis, column in zip("xyz", points.T, strict=False)}


def two_blocks(cells: AnyArray, points: AnyArray) -> dict[str, object]:
    """The cube at x < 1 is the second block; side sets below and at the right, and node sets."""
    left = points[cells[:, :4], 0].mean(axis=1) < 1
    ordered = np.concatenate([cells[~left], cells[left]])
    # A side is numbered by the corner that it leaves out: 1, 2, 3, 4 for the third, first, ...
    sides = [
        [
            (i + 1, {2: 1, 0: 2, 1: 3, 3: 4}[j])
            for i, cell in enumerate(ordered)
            for j in range(4)
            if np.delete(points[cell[:4]], j, axis=0)[:, axis].tolist() == [value] * 3
        ]
        for axis, value in ((2, 0), (0, 2))
    ]
    return {
        **coordinates(points),
        "connect1": cells[~left] + 1,
        "connect3": cells[left] + 1,
        "eb_names": letters("hard", "nothing", ""),
        "eb_prop1": np.array([10, 20, 30]),
        **{f"elem_ss{k}": np.array(s)[:, 0] for k, s in enumerate(sides, start=1)},
        **{f"side_ss{k}": np.array(s)[:, 1] for k, s in enumerate(sides, start=1)},
        "ss_names": letters("foot", ""),
        "ss_prop1": np.array([1, 7]),
        "node_ns1": np.flatnonzero(points[:, 0] == 0) + 1,
        "node_ns2": np.array([len(POINTS)]),
        "ns_names": letters("wall", "corner"),
        "ns_prop1": np.array([1, 2]),
        "elem_els1": np.array([1, 2, len(cells)]),
        "els_names": letters("some"),
        "els_prop1": np.array([5]),
    }


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("kind", ["TET4", "TETRA", "TETRA10"])
def test_names_of_blocks_and_sets(folder: Path, form: str, kind: str) -> None:
    """Nodes where they are; quadratic cells in any other order would fold."""
    points, cells = quadratic(POINTS, CELLS) if kind == "TETRA10" else (POINTS, CELLS)
    arrays = two_blocks(cells, points)
    kinds = dict.fromkeys(("connect1", "connect3"), kind)
    made(lambda: write(folder / "a.exo", FORMS[form], arrays, kinds))
    found = read_exodus(folder / "a.exo")
    assert np.array_equal(found.points, points)
    body = read_body(folder / "a.exo")
    size = mesh_statistics(body)
    assert size.volume == pytest.approx(2, rel=1e-14)
    assert size.regions == pytest.approx({"hard": 1, "block_30": 1, "some": 0.5}, rel=1e-14)
    assert size.surfaces == pytest.approx({"foot": 2, "side_set_7": 1, "wall": 1}, rel=1e-14)
    assert body.kinds("corner") == ("point",)
    assert COMM.allreduce(len(body.owned_points("corner"))) == 1
    assert body.notes == ("groups without members: nothing",)
    assert body.mesh.geometry.cmap.degree == (2 if kind == "TETRA10" else 1)


def test_sides_of_flat_shells(folder: Path) -> None:
    """Of a shell without z the edges have the numbers 3 to 5, too: 3 was the wrong edge."""
    points = np.array([[0, 0], [2, 0], [2, 1], [0, 1.0]])
    sides = {"elem_ss1": np.array([1]), "side_ss1": np.array([3])}
    sides |= {"elem_ss2": np.array([2]), "side_ss2": np.array([5]), "ss_prop1": np.array([1, 2])}
    arrays = {**coordinates(points), "connect1": np.array([[1, 2, 3], [1, 3, 4]]), **sides}
    arrays["ss_names"] = letters("low", "left")
    made(lambda: write(folder / "a.g", 4, arrays, {"connect1": "TRISHELL3"}))
    body = read_body(folder / "a.g")
    assert mesh_statistics(body).surfaces == pytest.approx({"low": 2, "left": 1})
    assert body.notes == ()


@pytest.mark.parametrize("dim", [2, 3])
def test_triangles(folder: Path, dim: int) -> None:
    """A side of a plane element is an edge; in space the first two are its faces."""
    points = np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0.0]])[:, :dim]
    shift = 2 if dim == 3 else 0
    arrays = {
        **coordinates(points),
        "connect1": np.array([[1, 2, 3], [1, 3, 4]]),
        "elem_ss1": np.array([1, 2]),
        "side_ss1": np.array([1, 2]) + shift,
        "ss_names": letters("long"),
        "ss_prop1": np.array([1]),
    }
    if dim == 3:
        arrays |= {"elem_ss2": np.array([2]), "side_ss2": np.array([1])}
        arrays |= {"ss_names": letters("long", "upper"), "ss_prop1": np.array([1, 2])}
    made(lambda: write(folder / "a.g", 4, arrays, {"connect1": "TRI3"}))
    size = mesh_statistics(read_body(folder / "a.g"))
    assert size.volume == pytest.approx(2) and size.surfaces == pytest.approx({"long": 4})
    assert size.regions == pytest.approx({"block_1": 2} | ({"upper": 1} if dim == 3 else {}))


@pytest.mark.parametrize("form", ["CDF-2", "netCDF-4"])
def test_fields_at_the_last_time(folder: Path, form: str) -> None:
    x = POINTS[:, 0]
    arrays = {
        **coordinates(POINTS),
        "connect1": CELLS + 1,
        "time_whole": np.array([0.0, 1.0]),
        "name_nod_var": letters("warmth"),
        "vals_nod_var1": np.stack([0 * x, x]),
        "name_elem_var": letters("density"),
        "vals_elem_var1eb1": np.stack([np.zeros(len(CELLS)), np.arange(len(CELLS))]),
    }
    made(lambda: write(folder / "a.e", FORMS[form], arrays, {"connect1": "tetra"}))
    found = read_exodus(folder / "a.e")
    assert found.point_data["warmth"][:, 0].tolist() == x.tolist()
    assert found.blocks[0].data["density"][:, 0].tolist() == list(range(len(CELLS)))
    assert found.information == ["fields at the last of 2 times"]


HEX = np.arange(1, 9).reshape(1, 8)
FAULTS = {
    "hexahedra": ({"connect1": HEX}, "HEX8", "other than simplices: found 1 hexahedra"),
    "polyhedra": ({"connect1": HEX}, "nfaced", "'block_1' has 1 elements of the type 'nfaced'"),
    "8 nodes": ({"connect1": HEX}, "TETRA8", "type 'TETRA8' with 8 nodes, which is not under"),
    "no node": ({"connect1": CELLS + 5}, "TET4", "4 points that do not exist, for example 13"),
    "zero": ({"connect1": CELLS}, "TET4", "1 points that do not exist, for example 0"),
    "no elements": ({"eb_prop1": np.array([1])}, "", "the Exodus file has no elements"),
    "sides": (
        {"connect1": CELLS + 1, "elem_ss1": np.array([1, 2]), "side_ss1": np.array([1, 1, 1])},
        "TET4",
        "the side set 'side_set_1' has 2 elements and 3 sides",
    ),
    "one part": ({"connect1": CELLS + 1, "nem_ftype": np.array([0])}, "TET4", "joined by epu"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_what_is_not_understood(folder: Path, fault: str) -> None:
    arrays, kind, said = FAULTS[fault]
    kinds = {"connect1": kind} if kind else {}
    made(lambda: write(folder / "a.exo", 4, {**coordinates(POINTS), **arrays}, kinds))
    with pytest.raises(MeshError, match=said):
        read_body(folder / "a.exo")


def test_sets_that_are_not_whole(tmp_path: Path) -> None:
    arrays = {
        **coordinates(POINTS),
        "connect1": CELLS + 1,
        "elem_ss1": np.array([1, 99, 2]),
        "side_ss1": np.array([1, 1, 5]),
        "node_ns1": np.array([1, 2, 77]),
        "elem_els1": np.array([1, 88]),
    }
    write(tmp_path / "a.exo", 4, arrays, {"connect1": "TET4"})
    assert read_exodus(tmp_path / "a.exo").incomplete == {
        "side_set_1": "2 of its 3 sides are none of a tetrahedron or triangle",
        "node_set_1": "1 of its 3 nodes do not exist in the file, for example 77",
        "element_set_1": "1 of its 2 elements do not exist in the file, for example 88",
    }


def test_other_files(tmp_path: Path) -> None:
    (tmp_path / "a.exo").write_bytes(b"CDF\x05" + bytes(40))
    with pytest.raises(MeshError, match=r"\(CDF-5\) is not read; nccopy -k nc4 a.exo new.exo"):
        read_exodus(tmp_path / "a.exo")
    (tmp_path / "a.exo").write_bytes(b"nothing")
    with pytest.raises(MeshError, match="this is no Exodus file"):
        read_exodus(tmp_path / "a.exo")


@pytest.mark.parametrize("form", FORMS)
def test_damaged_files(tmp_path: Path, form: str) -> None:
    """Cut at many places, and with bytes changed: read, or a MeshError, never anything else."""
    whole, chance, refused = tmp_path / "whole.exo", np.random.default_rng(3), 0
    kinds = dict.fromkeys(("connect1", "connect3"), "TET4")
    write(whole, FORMS[form], two_blocks(CELLS, POINTS), kinds)
    data = whole.read_bytes()
    for cut in range(4, len(data), len(data) // 20):
        torn = bytearray(data)
        torn[chance.integers(4, len(data))] ^= 1 << int(chance.integers(8))
        for content in (data[:cut], torn):
            (tmp_path / "a.exo").write_bytes(content)
            try:
                read_exodus(tmp_path / "a.exo")
            except MeshError:
                refused += 1
    assert refused >= 15
