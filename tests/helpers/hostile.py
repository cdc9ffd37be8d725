"""Broken cases and hostile meshes, the same ones every time: what strangers' files may hold."""

from __future__ import annotations

import random
import tomllib
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dolfin_elastic.case.toml import toml_text

BLOCK = """title = "Block"
[mesh]
box = {size = [2, 1, 1], cells = [2, 1, 1]}
degree = 1
[surfaces]
foot = {plane = "x", at = "min"}
[regions]
core = {sphere = {center = [1, 0.5, 0.5], radius = "1 m"}}
[materials.steel]
law = "linear-elastic"
E = "210 GPa"
nu = 0.3
density = 7850
[[support]]
on = "foot"
displacement = [0, "0.001*t", 0]
[[support]]
kind = "spring"
on = "right"
stiffness = ["1 MPa/m", 0, 0]
[[load]]
kind = "traction"
on = "right"
value = ["1 kPa", 0, "0.1*t"]
[[load]]
kind = "gravity"
value = [0, 0, -9.81]
"""
STATICS = f"""{BLOCK}[statics]
steps = 2
rtol = 1e-8
[output]
fields = ["displacement", "von_mises"]
every = 1
[output.probes]
tip = [2, 1, 1]
[solver]
method = "direct"
petsc = {{ksp_type = "preonly"}}
"""
MOTION = f"""{BLOCK}[dynamics]
end = 0.2
dt = 0.1
spectral_radius = 0.8
initial_velocity = [0, 0, "1 m/s"]
"""
MODES = f"""{BLOCK}[modal]
count = 3
"""
BASES = (STATICS, MOTION, MODES)

ODD = (
    None,
    True,
    -1,
    0,
    1e308,
    -1e-320,
    10**400,
    2**63,
    float("nan"),
    float("inf"),
    "",
    "x" * 5000,
    "1 mm",
    "1 kg*m^2/s^3/K",
    "1/0",
    "t^t^t^t",
    "sin(" * 200,
    "__import__('os').system('touch trace')",
    "{0.__class__}",
    "../../../etc/passwd",
    "a\0b",
    "\x1b]0;x\x07",
    "\u202efdp",
    [],
    [[]],
    {},
    {"kind": []},
    [{"on": "left"}],
    [None],
    [1] * 1000,
)
"""Values for any place of a case."""
LINES = (
    "[mesh]",
    "[[mesh]]",
    "box = 3",
    "= 3",
    "[materials.steel]",
    "x = [",
    "x = {",
    'x = "',
    "x = 2020-13-45",
    "x = 0x",
    "[a.b.c.d.e]",
    "\x00",
    "\ufeff",
    "steps = 3",
    "law = 'neo-hookean'",
    "[[load.curve]]",
)
"""Lines to put in."""


@dataclass(frozen=True)
class Hostile:
    """Something to be read.

    Attributes:
        name: Says what it is.
        text: Of the case file.
        file: Name of the mesh beside it; empty: none.
        content: Of the mesh.
    """

    name: str
    text: bytes
    file: str = ""
    content: bytes = b""

    @staticmethod
    def of_tables(tables: dict[str, Any]) -> bytes:
        """The text of a case."""
        try:
            return toml_text(tables).encode("utf-8", "surrogatepass")
        except (TypeError, ValueError, AttributeError):  # TOML has no such value
            return repr(tables).encode("utf-8", "surrogatepass")

    def write(self, folder: Path) -> Path:
        """Writes both files; returns the case."""
        path = folder / "case.toml"
        path.write_bytes(self.text)
        if self.file:
            (folder / self.file).write_bytes(self.content)
        return path


# --- cases ---


def broken_cases() -> list[Hostile]:
    """At least 500 cases with one fault or more, or none by luck."""
    chance = random.Random(15)
    found = [Hostile(name, text.encode()) for name, text in BY_HAND.items()]
    for number, base in enumerate(BASES):
        pairs = [(place, odd) for place in places(tomllib.loads(base)) for odd in ODD]
        for place, odd in chance.sample(pairs, 110):
            name = f"base {number}, {'.'.join(map(str, place))} = {odd!r:.30}"
            text = Hostile.of_tables(changed(tomllib.loads(base), place, odd))
            found.append(Hostile(name, text))
        for kind in range(60):
            found.append(Hostile(f"base {number}, text {kind}", _torn(base.encode(), chance)))
    return found


BY_HAND = {
    "empty": "",
    "blank": " \n\t\n",
    "no toml": "{]",
    "nested arrays": f"x = {'[' * 5000}{']' * 5000}",
    "nested tables": f"x = {'{a = ' * 3000}1{'}' * 3000}",
    "long name": STATICS.replace("steel", "s" * 5000),
    "long key": f"{'k' * 100000} = 1\n{STATICS}",
    "many supports": STATICS + '[[support]]\non = "left"\n' * 3000,
    "many cells": STATICS.replace("cells = [2, 1, 1]", "cells = [100000, 100000, 100000]"),
    "more cells": STATICS.replace("cells = [2, 1, 1]", "cells = [9223372036854775807, 1, 1]"),
    "no end": MOTION.replace("end = 0.2", "end = 1e308"),
    "no step": MOTION.replace("dt = 0.1", "dt = 1e-300"),
    "many modes": MODES.replace("count = 3", "count = 1000000000"),
    "folder with NUL": STATICS.replace("every = 1", 'every = 1\nfolder = "a\\u0000b"'),
    "long folder": STATICS.replace("every = 1", f'every = 1\nfolder = "{"f" * 300}"'),
    "mesh is a folder": STATICS.replace(
        "box = {size = [2, 1, 1], cells = [2, 1, 1]}", 'file = "."'
    ),
    "mesh is the case": STATICS.replace(
        "box = {size = [2, 1, 1], cells = [2, 1, 1]}", 'file = "case.toml"'
    ),
    "mesh is endless": STATICS.replace(
        "box = {size = [2, 1, 1], cells = [2, 1, 1]}", 'file = "/dev/zero"'
    ),
    "mesh is a url": STATICS.replace(
        "box = {size = [2, 1, 1], cells = [2, 1, 1]}", 'file = "http://localhost/x.msh"'
    ),
    "python": STATICS.replace('ksp_type = "preonly"', 'pc_type = "python"'),
    "viewer": STATICS.replace('ksp_type = "preonly"', 'ksp_view = "ascii:trace"'),
    "path of a field": STATICS.replace('"von_mises"', '"../trace"'),
    "no units": STATICS.replace("210 GPa", "210 parsec^9^9^9"),
    "not stable": STATICS.replace("nu = 0.3", "nu = 0.7"),
    "formula of the machine": STATICS.replace('"0.1*t"', "\"open('trace','w')\""),
    "tower": STATICS.replace('"0.1*t"', '"9^9^9^9^9^9"'),
    "long formula": STATICS.replace('"0.1*t"', f'"{"t+" * 20000}t"'),
    "deep formula": STATICS.replace('"0.1*t"', f'"{"(" * 5000}t{")" * 5000}"'),
}


def places(value: Any, place: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Keys and numbers that lead to each value within a value."""
    if place:
        yield place
    if isinstance(value, dict):
        entries = list(value.items())
    else:
        entries = list(enumerate(value)) if isinstance(value, list) else []
    for key, inner in entries:
        yield from places(inner, (*place, key))


def changed(tables: dict[str, Any], place: tuple[Any, ...], odd: Any) -> dict[str, Any]:
    """Tables with another value at a place; None: without that place."""
    inner: Any = tables
    for key in place[:-1]:
        inner = inner[key]
    if odd is None:
        del inner[place[-1]]
    else:
        inner[place[-1]] = deepcopy(odd)  # it may be changed in turn
    return tables


def _torn(data: bytes, chance: random.Random) -> bytes:
    """Data with a part cut off, changed, doubled or put in."""
    lines, at = data.splitlines(keepends=True), chance.randrange(len(data))
    line = chance.randrange(len(lines))
    match chance.randrange(6):
        case 0:
            return data[:at]
        case 1:
            return data[:at] + bytes([chance.randrange(256)]) + data[at + 1 :]
        case 2:
            return b"".join([*lines[:line], lines[line], *lines[line:]])
        case 3:
            return b"".join(lines[:line] + lines[line + 1 :])
        case 4:
            put = chance.choice(LINES).encode() + b"\n"
            return b"".join([*lines[:line], put, *lines[line:]])
        case _:
            other = chance.randrange(len(data))
            return data[: min(at, other)] + data[max(at, other) :]


# --- meshes ---

NODES = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1)]
TETS = [(1, 2, 3, 4), (2, 3, 4, 5)]
_ROWS = "\n".join(f"{i} {x} {y} {z}" for i, (x, y, z) in enumerate(NODES, 1))
MSH2 = f"""$MeshFormat
2.2 0 8
$EndMeshFormat
$PhysicalNames
1
3 1 "body"
$EndPhysicalNames
$Nodes
5
{_ROWS}
$EndNodes
$Elements
2
1 4 2 1 1 1 2 3 4
2 4 2 1 1 2 3 4 5
$EndElements
"""
MSH4 = """$MeshFormat
4.1 0 8
$EndMeshFormat
$Entities
0 0 0 1
1 0 0 0 1 1 1 1 1 0
$EndEntities
$Nodes
1 5 1 5
3 1 0 5
1
2
3
4
5
0 0 0
1 0 0
0 1 0
0 0 1
1 1 1
$EndNodes
$Elements
1 2 1 2
3 1 4 2
1 1 2 3 4
2 2 3 4 5
$EndElements
"""
MSH1 = f"$NOD\n5\n{_ROWS}\n$ENDNOD\n$ELM\n2\n1 4 1 1 4 1 2 3 4\n2 4 1 1 4 2 3 4 5\n$ENDELM\n"
INP = (
    "*NODE\n"
    + "\n".join(f"{i}, {x}., {y}., {z}." for i, (x, y, z) in enumerate(NODES, 1))
    + "\n*ELEMENT, TYPE=C3D4, ELSET=body\n1, 1, 2, 3, 4\n2, 2, 3, 4, 5\n"
)
VTU = f"""<?xml version="1.0"?>
<VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian"><UnstructuredGrid>
<Piece NumberOfPoints="5" NumberOfCells="2"><Points>
<DataArray type="Float64" NumberOfComponents="3" format="ascii">
{" ".join(f"{x} {y} {z}" for x, y, z in NODES)}</DataArray></Points><Cells>
<DataArray type="Int64" Name="connectivity" format="ascii">0 1 2 3 1 2 3 4</DataArray>
<DataArray type="Int64" Name="offsets" format="ascii">4 8</DataArray>
<DataArray type="UInt8" Name="types" format="ascii">10 10</DataArray></Cells>
</Piece></UnstructuredGrid></VTKFile>
"""
MEDIT = (
    "MeshVersionFormatted 2\nDimension 3\nVertices\n5\n"
    + "\n".join(f"{x} {y} {z} 0" for x, y, z in NODES)
    + "\nTetrahedra\n2\n1 2 3 4 1\n2 3 4 5 1\nEnd\n"
)
GEO = 'SetFactory("OpenCASCADE");\nBox(1) = {0, 0, 0, 1, 1, 1};\nMesh.MeshSizeMin = 1;\n'
ATTACKS = (
    'SystemCall "touch trace";',
    'Printf("x") > "trace";',
    'Save "trace.msh";',
    'Merge "/etc/passwd";',
    'Include "../a.geo";',
    "Plugin(AnalyseMeshQuality).Run;",
    'OnelabRun("x", "touch trace");',
    "Exit;",
    "Delete All;",
    "For i In {1:1e9}\n x = i;\nEndFor",
    "Box(2) = {0, 0, 0, 1e-30, 1, 1};",
    "Box(2) = {0, 0, 0, 1e300, 1, 1};",
    "Macro m\n Call m;\nReturn\nCall m;",
    "Mesh.MeshSizeMax = 1e-4;",
    'Include "mesh.geo";',
)
MESHES = {
    "mesh2.msh": MSH2,
    "mesh4.msh": MSH4,
    "mesh1.msh": MSH1,
    "mesh.inp": INP,
    "mesh.vtu": VTU,
    "mesh.mesh": MEDIT,
    "mesh.geo": GEO,
}
NUMBERS = (b"-1", b"0", b"99", b"4294967296", b"9223372036854775807", b"1e308", b"nan", b"x", b"")


def hostile_meshes() -> list[Hostile]:
    """At least 120 meshes with a fault, or that want more than to be a mesh."""
    chance = random.Random(16)
    found = [_of_mesh(f"attack {i}", "mesh.geo", f"{GEO}{a}\n") for i, a in enumerate(ATTACKS)]
    for name, text in MESHES.items():
        data = text.encode()
        for kind in range(10):
            torn = _torn(data, chance)
            found.append(_of_mesh(f"{name}, text {kind}", name, torn))
        for kind in range(8):
            found.append(_of_mesh(f"{name}, number {kind}", name, _other_number(data, chance)))
    for suffix in (".step", ".brep", ".iges", ".stl", ".msh", ".unv", ".med", ".xdmf", ".vtk"):
        for content in (b"", b"\0" * 1000, chance.randbytes(500)):
            found.append(_of_mesh(f"noise{suffix}, {len(content)}", f"mesh{suffix}", content))
    return found


def good_ones() -> dict[str, Hostile]:
    """What the others are made of."""
    cases = {f"base {number}": Hostile("", base.encode()) for number, base in enumerate(BASES)}
    return cases | {name: _of_mesh("", name, text) for name, text in MESHES.items()}


def _of_mesh(name: str, file: str, content: bytes | str) -> Hostile:
    box = "box = {size = [2, 1, 1], cells = [2, 1, 1]}"
    text = BLOCK.replace(box, f'file = "{file}"\ntime_limit = "3 s"').replace('"right"', '"foot"')
    data = content.encode() if isinstance(content, str) else content
    return Hostile(name, text.encode(), file, data)


def _other_number(data: bytes, chance: random.Random) -> bytes:
    """Data with one of its words replaced by a number."""
    words = data.split(b" ")
    words[chance.randrange(len(words))] = chance.choice(NUMBERS)
    return b" ".join(words)
