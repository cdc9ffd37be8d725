"""VTK's unstructured grids in every encoding, and damaged ones."""

from __future__ import annotations

import base64
import struct
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest
from helpers.decks import COMM, box, made, quadratic

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.core.types import AnyArray
from dolfin_elastic.mesh import mesh_statistics, read_body
from dolfin_elastic.mesh.formats.vtu import read_vtu

POINTS, CELLS = box((1, 1, 1), (1, 1, 1))


class Modes:
    """Numbers of VTK's writer."""

    TEXT, BINARY, APPENDED = 0, 1, 2
    NONE, ZLIB, LZ4, LZMA = 0, 1, 2, 3


def by_vtk(path: Path, *, mode: int, base64: bool, compressor: int, bits: int) -> None:
    """The cube with a surface in it, a region number and a vector, by VTK's own writer."""
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkCommonCore import vtkPoints
    from vtkmodules.vtkCommonDataModel import vtkUnstructuredGrid
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

    grid, places = vtkUnstructuredGrid(), vtkPoints()
    places.SetData(numpy_to_vtk(POINTS, deep=True))
    grid.SetPoints(places)
    for cell in CELLS:
        grid.InsertNextCell(10, 4, [int(i) for i in cell])
    for facet in ([0, 1, 3], [0, 2, 3]):
        grid.InsertNextCell(5, 3, facet)
    part = numpy_to_vtk(np.array([1, 1, 1, 2, 2, 2, 5, 5], dtype=np.int32), deep=True)
    vector = numpy_to_vtk(POINTS, deep=True)
    part.SetName("part")
    vector.SetName("place")
    grid.GetCellData().AddArray(part)
    grid.GetPointData().AddArray(vector)
    writer = vtkXMLUnstructuredGridWriter()
    writer.SetFileName(str(path))
    writer.SetInputData(grid)
    writer.SetDataMode(mode)
    writer.SetEncodeAppendedData(base64)
    writer.SetCompressorType(compressor)
    writer.SetHeaderType(bits)
    writer.Write()


@pytest.mark.sample(2)
@pytest.mark.parametrize(
    ("mode", "base64", "compressor", "bits"),
    [
        (Modes.APPENDED, False, Modes.NONE, 64),  # what meshio refused
        (Modes.APPENDED, False, Modes.ZLIB, 64),  # ParaView's
        (Modes.APPENDED, False, Modes.NONE, 32),
        (Modes.APPENDED, False, Modes.LZMA, 32),
        (Modes.APPENDED, True, Modes.NONE, 32),
        (Modes.APPENDED, True, Modes.NONE, 64),
        (Modes.APPENDED, True, Modes.ZLIB, 64),
        (Modes.APPENDED, True, Modes.ZLIB, 32),
        (Modes.BINARY, False, Modes.NONE, 64),
        (Modes.BINARY, False, Modes.ZLIB, 32),
        (Modes.BINARY, False, Modes.LZMA, 64),
        (Modes.APPENDED, False, Modes.LZ4, 64),
        (Modes.BINARY, False, Modes.LZ4, 32),
        (Modes.TEXT, False, Modes.NONE, 32),
    ],
)
def test_what_vtk_writes(folder: Path, mode: int, base64: bool, compressor: int, bits: int) -> None:
    path = folder / "cube.vtu"
    made(lambda: by_vtk(path, mode=mode, base64=base64, compressor=compressor, bits=bits))
    body = read_body(path)
    size = mesh_statistics(body)
    assert size.volume == pytest.approx(1)
    assert size.regions == pytest.approx({"part_1": 0.5, "part_2": 0.5})
    assert size.surfaces == pytest.approx({"part_5": 1})
    assert set(body.fields) == {"place"}
    place = body.mesh_field("place")
    assert place.centre == "point" and place.columns == 3
    assert np.array_equal(place.values, body.mesh.geometry.x)


def test_data_that_are_compressed_otherwise_are_named(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = folder / "cube.vtu"
    made(lambda: by_vtk(path, mode=2, base64=False, compressor=Modes.LZ4, bits=32))
    monkeypatch.setitem(sys.modules, "lz4", None)
    with pytest.raises(MeshError, match="LZ4, for which the Python package lz4 is missing"):
        read_body(path)
    other = path.read_bytes().replace(b"vtkLZ4Data", b"vtkOwnData")
    made(lambda: path.write_bytes(other))
    with pytest.raises(MeshError, match="by vtkOwnDataCompressor are not read; .* Compressor Type"):
        read_body(path)


def raw_file(
    points: AnyArray,
    cells: AnyArray,
    *,
    kind: int,
    head: str = "",
    tail: bytes = b"",
    ghosts: str = "",
) -> bytes:
    """A file with raw appended data by hand: version 2.2, offsets padded with blanks.

    Args:
        points: Coordinates.
        cells: Rows of points.
        kind: VTK's number of the kind of cells.
        head: Attributes of the root besides the usual ones.
        ghosts: Flags of the cells as text, if there are any.
    """
    n, k = cells.shape
    arrays = [
        ("Points", "Points", "Float64", 3, points.astype("<f8")),
        ("Cells", "connectivity", "Int64", 1, cells.astype("<i8")),
        ("Cells", "offsets", "Int64", 1, (k * np.arange(1, n + 1)).astype("<i8")),
        ("Cells", "types", "UInt8", 1, np.full(n, kind, dtype="u1")),
    ]
    xml, data = {"Points": "", "Cells": ""}, b""
    for part, name, code, columns, values in arrays:
        xml[part] += (
            f'<DataArray type="{code}" Name="{name}" NumberOfComponents="{columns}" '
            f'format="appended" offset="{len(data)}        "/>\n'
        )
        data += struct.pack("<Q", values.nbytes) + values.tobytes()
    flags = f'<DataArray type="UInt8" Name="vtkGhostType" format="ascii">{ghosts}</DataArray>'
    text = (
        '<?xml version="1.0"?>\n<VTKFile type="UnstructuredGrid" version="2.2" '
        f'byte_order="LittleEndian" header_type="UInt64"{head}>\n<UnstructuredGrid>'
        f'<Piece NumberOfPoints="{len(points)}" NumberOfCells="{n}">\n'
        f"<CellData>{flags if ghosts else ''}</CellData>"
        f"<Points>{xml['Points']}</Points><Cells>{xml['Cells']}</Cells></Piece>\n"
        '</UnstructuredGrid>\n<AppendedData encoding="raw">\n_'
    )
    return text.encode() + data + b"\n</AppendedData></VTKFile>\n"


def test_raw_data_that_look_like_xml(folder: Path) -> None:
    """Bytes of coordinates that spell line breaks, underscores and the end of the data."""
    points = POINTS.copy()
    points[7] = np.frombuffer(b"\n_\n_\n_\n@</Appendey_>\n\n@?\n", dtype="<f8", count=3)
    made(lambda: (folder / "cube.vtu").write_bytes(raw_file(points, CELLS, kind=10)))
    found = read_vtu(folder / "cube.vtu")
    assert np.array_equal(found.points, points)
    assert np.array_equal(found.blocks[0].nodes, CELLS)


@pytest.mark.parametrize("kind", [24, 71])
def test_quadratic_and_lagrange_cells(folder: Path, kind: int) -> None:
    points, cells = quadratic(POINTS, CELLS)
    points[points[:, 2] == 0.5] += [0.05, 0, 0]  # every edge of that height is bent alike
    made(lambda: (folder / "cube.vtu").write_bytes(raw_file(points, cells, kind=kind)))
    body = read_body(folder / "cube.vtu")
    assert body.mesh.geometry.cmap.degree == 2
    assert mesh_statistics(body).volume == pytest.approx(1)  # the side faces move in parallel


def test_ghost_cells_are_left_out(folder: Path) -> None:
    text = raw_file(POINTS, CELLS, kind=10, ghosts="0 0 0 0 1 1")
    made(lambda: (folder / "cube.vtu").write_bytes(text))
    assert read_body(folder / "cube.vtu").num_cells == 4


def test_size_and_data_encoded_apart(folder: Path) -> None:
    """Some writers pad the size of base64 data by itself; VTK reads both."""
    data = POINTS.tobytes()
    size = base64.b64encode(struct.pack("<I", len(data))).decode()
    apart = size + base64.b64encode(data).decode()
    text = (
        '<VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian">'
        '<UnstructuredGrid><Piece NumberOfPoints="8" NumberOfCells="1"><Points>'
        f'<DataArray type="Float64" NumberOfComponents="3" format="binary">{apart}</DataArray>'
        '</Points><Cells><DataArray type="Int32" Name="connectivity">0 1 3 7</DataArray>'
        '<DataArray type="Int32" Name="offsets">4</DataArray>'
        '<DataArray type="UInt8" Name="types">10</DataArray></Cells></Piece></UnstructuredGrid>'
        "</VTKFile>"
    )
    made(lambda: (folder / "cell.vtu").write_text(text))
    assert mesh_statistics(read_body(folder / "cell.vtu")).volume == pytest.approx(1 / 6)


def test_an_array_that_ends_before_the_next_one(folder: Path) -> None:
    """In base64 a padding ends an array, whatever its size says: the next one is not part of it."""
    data, next_one = POINTS.tobytes()[:-8], np.arange(4, dtype="<i4").tobytes()
    short = base64.b64encode(struct.pack("<I", len(data) + 8) + data).decode()
    assert short.endswith("=")
    following = base64.b64encode(struct.pack("<I", len(next_one)) + next_one).decode()
    text = (
        '<VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian">'
        '<UnstructuredGrid><Piece NumberOfPoints="8" NumberOfCells="1"><Points>'
        '<DataArray type="Float64" NumberOfComponents="3" format="appended" offset="0"/>'
        '</Points><Cells><DataArray type="Int32" Name="connectivity" format="appended" '
        f'offset="{len(short)}"/><DataArray type="Int32" Name="offsets">4</DataArray>'
        '<DataArray type="UInt8" Name="types">10</DataArray></Cells></Piece></UnstructuredGrid>'
        f'<AppendedData encoding="base64">_{short}{following}</AppendedData></VTKFile>'
    )
    made(lambda: (folder / "cell.vtu").write_text(text))
    with pytest.raises(MeshError, match="the data end after 184 of 192 bytes"):
        read_body(folder / "cell.vtu")


GOOD = raw_file(POINTS, CELLS, kind=10)
BOMB = struct.pack("<QQQQ", 1, 1 << 40, 0, 30) + zlib.compress(bytes(1 << 20))


LIES = {
    "polydata": (
        b"<VTKFile type='PolyData'/>",
        "this is a PolyData file; an UnstructuredGrid is needed",
    ),
    "entity": (GOOD.replace(b"<VTKFile", b"<!DOCTYPE a [<!ENTITY b 'c'>]><VTKFile"), "definitions"),
    "points": (
        GOOD.replace(b'NumberOfPoints="8"', b'NumberOfPoints="9"'),
        "192 bytes, 216 are needed",
    ),
    "many points": (
        GOOD.replace(b'NumberOfPoints="8"', b'NumberOfPoints="888888888888888"'),
        "are needed",
    ),
    "negative": (
        GOOD.replace(b'NumberOfPoints="8"', b'NumberOfPoints="-8"'),
        "NumberOfPoints = '-8'",
    ),
    "cells": (GOOD.replace(b'NumberOfCells="6"', b'NumberOfCells="7"'), "'types': 6 bytes, 7"),
    "offset": (GOOD.replace(b'offset="0 ', b'offset="99999 '), "the data end after 0 of 8 bytes"),
    "size": (GOOD.replace(struct.pack("<Q", 192), struct.pack("<Q", 1 << 62)), "192 are needed"),
    "offsets": (
        GOOD.replace(struct.pack("<q", 24), struct.pack("<q", 1 << 60)),
        "are needed|ascend",
    ),
    "header": (GOOD.replace(b"UInt64", b"Int8"), "header_type Int8 is unknown"),
    "pieces": (GOOD.replace(b"<Piece", b"<Piece/><Piece"), "in 2 pieces"),
    "types": (GOOD.replace(b'Name="types"', b'Name="kinds"'), "no array 'types'"),
    "float80": (GOOD.replace(b"Float64", b"Float80"), "unknown type 'Float80'"),
    "cut": (GOOD[:-40], "no beginning or no end"),
    "hex": (GOOD.replace(b'"raw"', b'"hex"'), "of the encoding 'hex'"),
    "range": (
        raw_file(POINTS, CELLS + 1, kind=10),
        "elements refer to the point 8, but there are 8 points",
    ),
    "bomb": (
        raw_file(POINTS, CELLS, kind=10, head=' compressor="vtkZLibDataCompressor"').replace(
            struct.pack("<Q", 192), BOMB, 1
        ),
        "1099511627776 bytes, 192 are needed",
    ),
}


@pytest.mark.parametrize("lie", LIES)
def test_sizes_that_lie(folder: Path, lie: str) -> None:
    """Each number that a file states is compared with what there is before anything is made."""
    content, said = LIES[lie]
    made(lambda: (folder / "cube.vtu").write_bytes(content))
    with pytest.raises(MeshError, match=said) as caught:
        read_body(folder / "cube.vtu")
    assert str(caught.value).startswith("cube.vtu: ")


@pytest.mark.parametrize("compressor", [Modes.NONE, Modes.ZLIB, Modes.LZ4])
def test_damaged_files(folder: Path, compressor: int) -> None:
    """Cut at many places, and with bytes changed: read, or a MeshError, never anything else."""
    path, bad = folder / "cube.vtu", folder / "bad.vtu"

    def attempt() -> int:
        by_vtk(path, mode=Modes.APPENDED, base64=False, compressor=compressor, bits=64)
        whole, refused = path.read_bytes(), 0
        random = np.random.default_rng(1)
        for i in range(160):
            data = bytearray(whole)
            if i % 2:
                data = data[: len(whole) * i // 160]
            else:
                at = int(random.integers(len(data) - 8))
                data[at : at + 8] = random.bytes(8)
            bad.write_bytes(bytes(data))
            try:
                read_vtu(bad)
            except MeshError:
                refused += 1
        return refused

    assert on_root(COMM, attempt) >= 80
