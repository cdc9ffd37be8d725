"""Surfaces of triangles: readers, faults, mending, patches and regions."""

from __future__ import annotations

import os
import tracemalloc
import zipfile

import numpy as np
import pytest
from helpers.complexes import ball

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.units import LengthUnit
from dolfin_elastic.mesh.formats.surfaces.complex import read_complex
from dolfin_elastic.mesh.formats.surfaces.crossings import crossings
from dolfin_elastic.mesh.formats.surfaces.readers.read import read_soup
from dolfin_elastic.mesh.read import read_body, stated_unit_of
from tests.helpers.surfaces import cube, model_3mf, write_3mf, write_stl

MM = LengthUnit.of(1e-3)
UNIT = cube()


def made(path, **options):
    """The complex of a file, and the volume of each region."""
    found = read_complex(path, unit=MM, **options)
    plc = found.plc
    parts = np.linalg.det(plc.points[plc.triangles]) / 6
    numbers = np.arange(len(plc.region_names))
    sides = (plc.regions[:, :, None] == numbers).astype(float)
    return found, parts @ (sides[:, 0] - sides[:, 1])


def tjoint():
    a, b, c = UNIT[0]
    m = (a + b) / 2
    return np.concatenate([UNIT[1:], [(a, m, c), (m, b, c)]])


@pytest.mark.parametrize(
    ("corners", "volumes", "patches"),
    [
        (UNIT, [1.0], 6),
        (UNIT[:, ::-1], [1.0], 6),
        (np.concatenate([UNIT, cube(0.25, 0.75)[:, ::-1]]), [0.875], 12),
        (np.concatenate([UNIT, cube(shift=(3, 0, 0))]), [1.0, 1.0], 12),
    ],
    ids=["cube", "inside out", "hollow", "two"],
)
def test_sound_surfaces(corners, volumes, patches, tmp_path):
    found, result = made(write_stl(tmp_path / "a.stl", corners))
    np.testing.assert_allclose(result, volumes, rtol=1e-12)
    assert found.plc.patch_names == [f"patch {k + 1}" for k in range(patches)]
    assert not found.notes


def test_a_text_of_stl_may_end_in_two_words(tmp_path):
    """Some programs write "end solid", which was said to end before its solid."""
    facets = [
        "\n".join(["outer loop", *(f"vertex {x} {y} {z}" for x, y, z in t), "endloop"])
        for t in UNIT
    ]
    (tmp_path / "a.stl").write_text("\n".join(["solid a", *facets, "end solid"]))
    np.testing.assert_allclose(made(tmp_path / "a.stl")[1], [1.0], rtol=1e-12)


def test_a_byte_behind_the_triangles_of_stl(tmp_path):
    """As much as is no triangle: the file was said to be a part of one."""
    path = write_stl(tmp_path / "a.stl", UNIT)
    path.write_bytes(path.read_bytes() + b"\n")
    np.testing.assert_allclose(made(path)[1], [1.0], rtol=1e-12)
    path.write_bytes(path.read_bytes() + b"\n" * 49)
    with pytest.raises(MeshError, match="it states 12 triangles, which are 684 bytes; it has 734"):
        read_soup(path)


def test_a_damaged_line_of_ply_is_named_once(tmp_path):
    """Its message stood within another one of the kind of elements, with the name of the file."""
    text = "ply\nformat ascii 1.0\nelement vertex 1\nproperty list int int a\nend_header\n1.5\n"
    (tmp_path / "a.ply").write_text(text)
    with pytest.raises(MeshError, match=r"^a.ply:6: this is no vertex as the header describes it"):
        read_soup(tmp_path / "a.ply")


def test_strips_of_ply(tmp_path):
    """A cube of a strip around and one on each end, as of scans: they were refused."""
    head = "ply\nformat ascii 1.0\nelement vertex 8\nproperty float x\nproperty float y\n"
    head += "property float z\nelement tristrips 1\nproperty list int int vertex_indices\n"
    corners = "\n".join(f"{i % 2} {i // 2 % 2} {i // 4}" for i in range(8))
    around = [0, 4, 1, 5, 3, 7, 2, 6, 0, 4]
    strip = [*around, -1, 0, 1, 2, 3, -1, 5, 4, 7, 6]
    (tmp_path / "a.ply").write_text(
        f"{head}end_header\n{corners}\n{len(strip)} {' '.join(map(str, strip))}\n"
    )
    np.testing.assert_allclose(made(tmp_path / "a.ply")[1], [1.0], rtol=1e-12)


FAULTS = {
    "hole": (UNIT[1:], r"has a hole: 3 edges .* mm; repair = true closes gaps and small holes"),
    "turned": (np.concatenate([UNIT[:2, ::-1], UNIT[2:]]), "2 triangles are turned round, first"),
    "doubled": (np.concatenate([UNIT, UNIT[:1]]), "1 triangle is there twice, at"),
    "touching": (
        np.concatenate([UNIT, cube(shift=(0, 0, 1))]),
        "faces touch: 2 triangles are there twice, .*; repair = true makes one body",
    ),
    "tjoint": (tjoint(), r"1 edge is divided on one side only, at \(0, 0, 0.5\) mm"),
    "overlap": (np.concatenate([UNIT, cube(shift=(0.5, 0.4, 0.3))]), "two bodies run into each"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_named_and_mended(fault, tmp_path):
    corners, said = FAULTS[fault]
    path = write_stl(tmp_path / "a.stl", corners)
    with pytest.raises(MeshError, match=said):
        made(path)
    if fault == "overlap":
        pytest.importorskip("manifold3d")
    found, result = made(path, repair=True)
    volume = {"overlap": 2 - 0.5 * 0.6 * 0.7, "touching": 2}.get(fault, 1)
    assert sum(result) == pytest.approx(volume, rel=1e-6)  # single precision in the file
    assert len(result) == 1
    assert "the surface has been mended: " in found.notes[0]


def klein_bottle(m=12, n=12):
    """Of the figure eight: closed, with one side, and it runs through itself."""

    def point(i, j):
        u, v = (i, j) if i < m else (0, -j)
        u, v = 2 * np.pi * u / m, 2 * np.pi * (v % n) / n
        a, b = np.sin(v), np.sin(2 * v)
        r = 2 + np.cos(u / 2) * a - np.sin(u / 2) * b
        z = np.sin(u / 2) * a + np.cos(u / 2) * b
        return r * np.cos(u), r * np.sin(u), z

    squares = [
        [point(i, j), point(i + 1, j), point(i + 1, j + 1), point(i, j + 1)]
        for i in range(m)
        for j in range(n)
    ]
    return np.array([t for a, b, c, d in squares for t in ((a, b, c), (a, c, d))])


def test_one_side_alone_is_one_message(tmp_path):
    """It was a crash with repair."""
    path = write_stl(tmp_path / "a.stl", klein_bottle())
    with pytest.raises(MeshError, match="the surface has one side only"):
        made(path)
    with pytest.raises(MeshError, match="repair cannot mend this: the surface has one side only"):
        made(path, repair=True)


DENTED = np.where((UNIT == 0).all(axis=2, keepdims=True), (0.5, 0.25, 1.0), UNIT)
"""A cube of which a corner is pressed in until it touches the face opposite."""
IN_VAIN = ".*mend it in the program that it comes from; repair = true cannot"


@pytest.mark.parametrize(
    ("corners", "said"),
    [
        (UNIT * [1, 1, 0], "no thickness"),
        (
            np.concatenate([UNIT, cube(shift=(1, 1, 0))]),
            f"more than two triangles meet in 1 edge{IN_VAIN}",
        ),
        (DENTED, f"touches itself{IN_VAIN}"),
        (UNIT[[*range(2), *range(6, 12)]], f"the surface has a hole: 6 edges{IN_VAIN}"),
        (np.where(np.arange(36).reshape(12, 3, 1) == 4, np.nan, UNIT), "corner of triangle 2 has"),
    ],
    ids=["flat", "edge", "dented", "open", "nan"],
)
def test_what_is_refused(corners, said, tmp_path):
    with pytest.raises(MeshError, match=said):
        made(write_stl(tmp_path / "a.stl", corners))


def test_unions_need_manifold3d(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "manifold3d", None)
    path = write_stl(tmp_path / "a.stl", FAULTS["overlap"][0])
    with pytest.raises(MeshError, match="pip install manifold3d"):
        made(path, repair=True)


def test_groups_of_obj_keep_their_names(tmp_path):
    """A group of one patch names it; one with sharp edges is that of its patches."""
    rows, number = [], 1
    for name, faces in (("top", [5]), ("rest", [0, 1, 2, 3, 4])):
        rows.append(f"g {name}")
        for face in faces:
            a, b, c = UNIT[2 * face]
            for x in (a, b, c, UNIT[2 * face + 1][2]):
                rows.append("v {} {} {}".format(*x))
            rows.append(f"f {number} {number + 1} {number + 2} {number + 3}")
            number += 4
    (tmp_path / "a.obj").write_text("\n".join(rows))
    found, result = made(tmp_path / "a.obj")
    assert sorted(found.plc.patch_names) == [*(f"patch {k}" for k in range(1, 6)), "top"]
    rest = [found.plc.patch_names[k] for k in found.plc.groups["rest"]]
    assert sorted(rest) == [f"patch {k}" for k in range(1, 6)]
    assert result == pytest.approx([1])


def test_concave_polygons(tmp_path):
    """An L of six corners, cut within its plane."""
    outline = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]
    rows = [f"v {x} {y} {z}" for z in (0, 1) for x, y in outline]
    rows += ["f 6 5 4 3 2 1", "f 7 8 9 10 11 12"]
    rows += [f"f {k + 1} {(k + 1) % 6 + 1} {(k + 1) % 6 + 7} {k + 7}" for k in range(6)]
    (tmp_path / "a.obj").write_text("\n".join(rows))
    found, result = made(tmp_path / "a.obj")
    assert result == pytest.approx([3])
    assert len(found.plc.patch_names) == 8


@pytest.mark.parametrize("order", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_ply(order, tmp_path):
    points, rows = np.unique(UNIT.reshape(-1, 3), axis=0, return_inverse=True)
    rows = rows.reshape(-1, 3)
    head = f"ply\nformat {order} 1.0\nelement vertex 8\nproperty float x\nproperty float y\n"
    head += (
        "property float z\nelement face 12\nproperty list uchar int vertex_indices\nend_header\n"
    )
    sign = ">" if "big" in order else "<"
    if order == "ascii":
        lines = ["{} {} {}".format(*x) for x in points] + ["3 {} {} {}".format(*r) for r in rows]
        body = "\n".join(lines).encode()
    else:
        body = points.astype(f"{sign}f4").tobytes()
        body += b"".join(b"\x03" + r.astype(f"{sign}i4").tobytes() for r in rows)
    (tmp_path / "a.ply").write_bytes(head.encode() + body)
    assert made(tmp_path / "a.ply")[1] == pytest.approx([1])
    (tmp_path / "a.ply").write_bytes(head.encode() + body[:-7])
    with pytest.raises(MeshError, match="it ends|is no face"):
        read_soup(tmp_path / "a.ply")


def test_3mf(tmp_path):
    """Unit, name and place of an object; a mirror image stays outwards."""
    item = '<item objectid="1" transform="-2 0 0 0 1 0 0 0 1 5 0 0"/>'
    path = write_3mf(tmp_path / "a.3mf", model_3mf(UNIT, items=item))
    found, result = made(path)
    assert stated_unit_of(path).metres == 0.0254
    assert (result, found.plc.region_names) == (pytest.approx([2]), ["block"])
    np.testing.assert_allclose(found.plc.points.max(axis=0), [5, 1, 1])


SLICERS = {
    "prusa": (
        "Metadata/Slic3r_PE_model.config",
        '<config><object id="1"><volume firstid="0" lastid="11"><metadata type="volume" '
        'key="volume_type" value="ModelPart"/></volume><volume firstid="12" lastid="23"><metadata '
        'type="volume" key="volume_type" value="{}"/></volume></object></config>',
        ("ParameterModifier", "NegativeVolume"),
    ),
    "bambu": (
        "Metadata/model_settings.config",
        '<config><object id="3"><part id="1" subtype="normal_part"/><part id="2" subtype="{}"/>'
        "</object></config>",
        ("modifier_part", "negative_part"),
    ),
    "item": ("Metadata/other.xml", "{}", ("<a/>", "")),
}


@pytest.mark.parametrize("slicer", SLICERS)
def test_parts_of_3mf_that_are_no_material_are_said(slicer, tmp_path):
    """Modifiers of slicers, support and what is not printed are left out; holes are refused."""
    part, content, (other, negative) = SLICERS[slicer]
    both = np.concatenate([UNIT, cube(2, 3)])
    if slicer == "prusa":
        model = model_3mf(both, items='<item objectid="1"/>')
    else:
        second = model_3mf(cube(2, 3)).partition("<resources>")[2].partition("</resources>")[0]
        second = second.replace('id="1"', 'id="2"')
        third = (
            '<object id="3"><components><component objectid="1"/><component objectid="2"/>'
            "</components></object>"
        )
        items = '<item objectid="3"/>'
        if slicer == "item":
            second = second.replace('id="2"', 'id="2" type="support"')
            items += '<item objectid="1" printable="0"/>'
        model = model_3mf(UNIT, items=items)
        model = model.replace("</resources>", second + third + "</resources>")
    for role in (other, negative):
        path = write_3mf(tmp_path / "a.3mf", model)
        with zipfile.ZipFile(path, "a") as file:
            file.writestr(part, content.format(role))
        if role == negative and slicer != "item":
            with pytest.raises(MeshError, match="volume to subtract"):
                read_soup(path)
            continue
        found, result = made(path)
        assert result == pytest.approx([1])
        expected = "1 'modifier'" if slicer != "item" else "1 'not to be printed', 1 'object of the"
        assert f"left out of the 3MF file: {expected}" in found.information[0]


def bomb(path):
    text = model_3mf(UNIT).replace("</resources>", f"</resources><!--{' ' * 60_000_000}-->")
    return write_3mf(path, text)


HOSTILE = {
    "bomb": (bomb, "it is larger than"),
    "entity": (
        lambda path: write_3mf(path, model_3mf(UNIT, head='<!DOCTYPE a [<!ENTITY b "c">]>')),
        "definitions of entities",
    ),
    "itself": (
        lambda path: write_3mf(
            path,
            '<model><resources><object id="1"><components><component objectid="1"/></components>'
            '</object></resources><build><item objectid="1"/></build></model>',
        ),
        "consists of itself",
    ),
    "no zip": (lambda path: path.write_bytes(b"PK\x03\x04" + b"\0" * 99), "it is no 3MF file"),
    "pipe": (os.mkfifo, "pipe"),
}


@pytest.mark.parametrize("kind", HOSTILE)
def test_hostile_3mf(kind, tmp_path):
    make, said = HOSTILE[kind]
    make(tmp_path / "a.3mf")
    with pytest.raises(MeshError, match=said):
        read_soup(tmp_path / "a.3mf")


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.stl", b"\0" * 80 + b"\xff\xff\xff\xff", "states 4294967295 triangles"),
        (
            "a.stl",
            b"solid a\nfacet\nouter loop\nvertex 0 0 0\n",
            "a.stl:4: it ends before its solid does",
        ),
        (
            "a.ply",
            b"ply\nformat binary_little_endian 1.0\nelement vertex 999999999999\n"
            b"property float x\nend_header\n",
            "need at least 3999999999996 bytes; 0 are left",
        ),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex x\nend_header\n", "a.ply:3: "),
        (
            "a.ply",
            b"ply\nformat binary_little_endian 1.0\nelement vertex 3\nelement face 1\n"
            b"end_header\n" + bytes(80),
            "no x, y and z",
        ),
        (
            "a.ply",
            b"ply\nformat binary_little_endian 1.0\nelement face 1\nproperty int a\n"
            b"property int a\nend_header\n" + bytes(80),
            "cannot be read",
        ),
        (
            "a.ply",
            b"ply\nformat binary_little_endian 1.0\nelement face 1\n"
            b"property list float int vertex_indices\nend_header\n" + b"\xff" * 80,
            "cannot be read",
        ),
        (
            "a.obj",
            b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf" + b" 1 2 3" * 5000 + b"\n",
            "a polygon of 15000 corners",
        ),
        ("a.obj", b"v 0 0 0\ncurv 0 1 1\n", "a.obj:2: 'curv' describes a curved surface"),
    ],
)
def test_damaged_files(name, content, said, tmp_path):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(MeshError, match=said):
        read_soup(tmp_path / name)


def test_unit_is_asked_for(tmp_path):
    path = write_stl(tmp_path / "a.stl", cube(0, 20))
    with pytest.raises(MeshError, match="mm: 20 x 20 x 20 mm; inch: 508 x 508 x 508 mm; m: 20 x"):
        read_body(path)
    with pytest.raises(MeshError, match=r"mesh.repair is given, but this file is no surface"):
        (tmp_path / "a.msh").write_text("x")
        read_body(tmp_path / "a.msh", repair=True)


def test_the_search_for_crossings_takes_little_memory() -> None:
    """At most 1 kB a triangle: it looks at 100 000 pairs at once, with 500 000 it took 2.2 kB."""
    points, triangles, _ = ball(1, times=6)
    tracemalloc.start()
    try:
        assert not len(crossings(points, triangles))
        assert tracemalloc.get_traced_memory()[1] < 1000 * len(triangles)
    finally:
        tracemalloc.stop()
