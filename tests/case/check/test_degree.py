"""The degree of elements where a case leaves it out, and what `check` says of degrees and shapes.

The factors by which linear elements are too stiff in bending are measured here: the same mesh with
linear and with quadratic elements, which bend to a per cent or better.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ROOT
from mpi4py import MPI
from numpy.polynomial import chebyshev

from dolfin_elastic import (
    Case,
    LinearElastic,
    Problem,
    Statics,
    Support,
    Traction,
    box_body,
    rectangle_body,
    run,
)
from dolfin_elastic.case.check.mesh_quality import bending_notes, bending_stiffness
from dolfin_elastic.case.check.report import report
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.mesh import Body
from dolfin_elastic.mesh.geometry.ridges import ridge_angles
from dolfin_elastic.mesh.geometry.thickness import _ROUNDED, Thickness, _power, local_thickness
from dolfin_elastic.solvers.dynamics.schemes import SCHEMES, ExplicitRow

FREE = "free"
ROD = {"rectangle": {"size": [10, 1], "cells": [10, 1]}}
TIP = {"kind": "traction", "on": "right", "value": [0, 1]}
EXPLICIT = [name for name, row in SCHEMES.items() if isinstance(row, ExplicitRow)]
BRACKET = """
SetFactory("OpenCASCADE");
Box(1) = {0, 0, 0, 10, 60, 90};
Box(2) = {0, 0, 0, 90, 60, 10};
BooleanUnion(3) = { Volume{1}; Delete; }{ Volume{2}; Delete; };
Box(4) = {10, 0, 10, 6, 60, 6};
Cylinder(5) = {16, 0, 16, 0, 60, 0, 6};
BooleanDifference(6) = { Volume{4}; Delete; }{ Volume{5}; Delete; };
Cylinder(7) = {0, 15, 70, 10, 0, 0, 5.5};
Cylinder(8) = {0, 45, 70, 10, 0, 0, 5.5};
BooleanUnion(9) = { Volume{3}; Delete; }{ Volume{6}; Delete; };
BooleanDifference(10) = { Volume{9}; Delete; }{ Volume{7, 8}; Delete; };
Physical Volume("steel") = {10};
"""


def rod(**tables: Any) -> dict[str, Any]:
    """A strip that is held on the left."""
    return {
        "mesh": ROD,
        "materials": {"m": {"law": "neo-hookean", "E": 1e6, "nu": 0.3, "density": 1e3}},
        "support": [{"on": "left"}],
        "load": [TIP],
        **tables,
    }


# --- what is left out ---


@pytest.mark.parametrize(
    ("analysis", "degree"),
    [
        ({}, 2),
        ({"statics": {}}, 2),
        ({"dynamics": {"end": 1, "dt": 0.1}}, 2),
        ({"dynamics": {"end": 1, "dt": 0.1, "scheme": "newmark"}}, 2),
        ({"modal": {}, "load": []}, 2),
        ({"buckling": {}}, 2),
        *(({"dynamics": {"end": 1, "scheme": name}}, 1) for name in EXPLICIT),
    ],
)
def test_default(analysis: dict[str, Any], degree: int) -> None:
    """Quadratic elements, and linear ones where the mass is lumped; `check` counts the same."""
    case = Case.from_dict(rod(**analysis))
    found = report(case)
    assert (case.mesh.degree, case.degree, found.degree) == (None, degree, degree)
    assert found.unknowns == {1: 2 * 11 * 2, 2: 2 * 21 * 3}[degree]
    assert "degree" not in case.to_toml()


def test_what_is_written_holds() -> None:
    explicit = {"end": 1, "scheme": EXPLICIT[0]}
    for degree, tables in ((1, {}), (2, {}), (1, {"dynamics": explicit})):
        case = Case.from_dict(rod(mesh={**ROD, "degree": degree}, **tables))
        assert case.make_problem(case.read_body()).degree == degree
        assert f"degree = {degree}" in case.to_toml()


def test_a_pressure_comes_with_quadratic_elements() -> None:
    """formulation = "auto" follows the degree that is found, not only one that is written."""
    soft = {"law": "neo-hookean", "E": 1e6, "nu": 0.49, "density": 1e3}
    found = [
        Case.from_dict(rod(materials={"m": soft}, **tables))
        for tables in ({}, {"dynamics": {"end": 1, "scheme": EXPLICIT[0]}})
    ]
    assert [case.make_problem(case.read_body()).mixed for case in found] == [True, False]


def test_python() -> None:
    body = rectangle_body(size=(1, 1), cells=(1, 1))
    assert Problem(body, LinearElastic(E=1e6, nu=0.3)).degree == 2


GEO = 'SetFactory("OpenCASCADE");\nBox(1) = {0, 0, 0, 4, 4, 4};\n'
HOLE = """
Cylinder(2) = {2, 2, 0, 0, 0, 4, 1};
BooleanDifference(3) = { Volume{1}; Delete; }{ Volume{2}; Delete; };
"""
RULED = """
Point(1) = {0, 0, 0}; Point(2) = {4, 0, 0}; Point(3) = {0, 4, 0};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 1};
Curve Loop(1) = {1, 2, 3}; Plane Surface(1) = {1};
Extrude {0, 0, 4} { Surface{1}; }
"""


@pytest.mark.sample(3)
@pytest.mark.parametrize(
    ("geo", "mesh", "order"),
    [
        (GEO + HOLE, {}, 2),
        (GEO + HOLE, {"degree": 2}, 2),
        (GEO + HOLE, {"degree": 1}, 1),
        (GEO + HOLE, {"curved": False}, 1),
        (GEO + HOLE, {"degree": 1, "curved": True}, 2),
        (GEO, {}, 1),  # nothing is curved, and straight elements are cheaper
        (RULED, {}, 1),  # nor here, though Gmsh does not call these sides planes
        (GEO, {"curved": True}, 2),
    ],
)
def test_cells_of_cad(geo: str, mesh: dict[str, Any], order: int, folder: Path) -> None:
    """They follow curved surfaces by default."""
    on_root(MPI.COMM_WORLD, lambda: (folder / "a.geo").write_text(geo) and None)
    tables = rod(mesh={"file": "a.geo", "size": 2, **mesh}, support=[], load=[])
    body = Case.from_dict(tables, folder).read_body()
    assert body.mesh.geometry.cmap.degree == order
    assert ("elements curved" in " ".join(body.information)) == (order == 2)


def test_explicit_schemes_keep_straight_cells(folder: Path) -> None:
    on_root(MPI.COMM_WORLD, lambda: (folder / "a.geo").write_text(GEO + HOLE) and None)
    tables = rod(mesh={"file": "a.geo", "size": 2}, support=[], load=[])
    case = Case.from_dict({**tables, "dynamics": {"end": 1, "scheme": EXPLICIT[0]}}, folder)
    assert case.read_body().mesh.geometry.cmap.degree == 1


# --- thickness ---


def middle(values: np.ndarray, weights: np.ndarray) -> float:
    """Mean on all ranks."""
    sums = np.array([values @ weights, weights.sum()])
    MPI.COMM_WORLD.Allreduce(MPI.IN_PLACE, sums)
    return float(sums[0] / sums[1])


@pytest.mark.parametrize(
    ("size", "cells", "thickness"),
    [
        ((10, 1), (20, 2), 1),
        ((8, 1, 1), (16, 2, 2), 1),
        ((6, 6, 1), (6, 6, 1), 1),
        ((8, 2, 0.5), (8, 2, 1), 0.5),
        ((2, 2, 2), (4, 4, 4), 2),
    ],
)
def test_thickness(size: Any, cells: Any, thickness: float) -> None:
    """Exact for plates, square bars and cubes; bars of other sections have their smaller side.

    The mean over the volume; in a few layers of cells the walk forgets where in them it began.
    """
    found = local_thickness(box_body(size=size, cells=cells).mesh, np.empty(0, dtype=np.int32))
    assert middle(found.thickness, found.volumes) == pytest.approx(thickness, rel=0.02)
    height = size[-1] / cells[-1]
    assert middle(found.across / height, found.volumes) == pytest.approx(0.75, rel=0.1)


@pytest.mark.parametrize("scale", [1e-9, 1e6])
def test_thickness_in_any_unit(scale: float) -> None:
    """Of a body a billionth or a million times as large so much, though volumes are its cube.

    To six of the seven digits of single precision, in which the walk adds up.
    """
    none = np.empty(0, dtype=np.int32)
    one, other = (
        local_thickness(box_body(size=(8, 2, 0.5), cells=(8, 2, 1), scale=s).mesh, none)
        for s in (1.0, scale)
    )
    for name in ("thickness", "across", "along"):
        assert getattr(other, name) / scale == pytest.approx(getattr(one, name), rel=1e-6)


@pytest.mark.parametrize("n", [1, 2, 5, 39])
def test_power_of_the_step(n: int) -> None:
    """Of eigenvalues from 0 to 1; the one of constants, 1, is met."""
    weights = _power(n)
    x = np.linspace(0.0, 1.0, 1001)
    found = chebyshev.chebval(2 * x - 1, weights.astype(float))
    assert found == pytest.approx(x**n, abs=1.01 * _ROUNDED)
    assert float(weights.sum(dtype=float)) == pytest.approx(1.0, abs=1e-7)  # of single precision
    assert len(weights) == {1: 2, 2: 3, 5: 6, 39: 18}[n]


def test_thickness_of_a_tilted_foil() -> None:
    """Cells ten thousand times as long as high, in no plane of the axes.

    The extent across is a difference of numbers 10^8 times as large: nothing of it is left in
    single precision.
    """
    size, cells = (2e4, 2e4, 1.0), (4, 4, 2)
    none, extents = np.empty(0, dtype=np.int32), []
    for tilted in (False, True):
        body = box_body(size=size, cells=cells)
        if tilted:
            a, b = np.cos(0.6), np.sin(0.6)
            turn = np.array([[a, -b, 0], [b, a, 0], [0, 0, 1]]) @ [[a, 0, b], [0, 1, 0], [-b, 0, a]]
            body.mesh.geometry.x[:] = body.mesh.geometry.x @ turn.T
        found = local_thickness(body.mesh, none)
        assert np.isfinite(found.across).all()
        extents.append(middle(found.across, found.volumes))
        assert middle(found.thickness, found.volumes) == pytest.approx(1.0, rel=0.01)
    assert extents[1] == pytest.approx(extents[0], rel=1e-3)


def test_thickness_beside_a_plane_of_symmetry() -> None:
    """Half a plate is as thick as the whole one."""
    body = rectangle_body(size=(10, 0.5), cells=(20, 1))
    found = local_thickness(body.mesh, body.surface("bottom"))
    assert middle(found.thickness, found.volumes) == pytest.approx(1.0, rel=0.02)


# --- bending ---


def factor(body: Body, nu: float) -> float:
    """Deflection with quadratic elements over that with linear ones."""
    up = [0] * (body.dim - 1) + [1.0]
    found = []
    for degree in (1, 2):
        problem = Problem(
            body,
            LinearElastic(E=1e6, nu=nu),
            supports=[Support(on="left")],
            loads=[Traction(on="right", value=up)],
            degree=degree,
        )
        *_, state = Statics(problem).steps()
        found.append(state.max_displacement)
    return found[1] / found[0]


def foretold(case: Case) -> list[float]:
    """The factors in the notes of a check."""
    marker, end = "expect the body to be about ", " times too stiff in bending"
    notes = bending_notes(case, case.make_problem(case.read_body()))
    return [float(note.partition(marker)[2].partition(end)[0]) for note in notes]


BARS = [
    ((10, 1), (10, 1), 0.3),
    ((10, 1), (20, 2), 0.3),
    ((10, 1), (20, 4), 0.3),
    ((10, 1, 1), (10, 1, 1), 0.3),
    ((10, 1, 1), (20, 2, 2), 0.0),
    ((10, 1, 1), (20, 2, 2), 0.45),
    ((10, 1, 1), (10, 2, 2), 0.3),
    ((10, 1, 1), (15, 3, 3), 0.3),
    ((10, 4, 1), (10, 4, 1), 0.3),
]


@pytest.mark.sample(2)
@pytest.mark.parametrize(("size", "cells", "nu"), BARS)
def test_linear_elements_in_bending(size: Any, cells: Any, nu: float) -> None:
    """What is foretold is found, but for a third of the excess over 1."""
    kind = "box" if len(size) == 3 else "rectangle"
    mesh = {kind: {"size": list(size), "cells": list(cells)}, "degree": 1}
    law = {"law": "linear-elastic", "E": 1e6, "nu": nu}
    load = {"kind": "traction", "on": "right", "value": [0] * (len(size) - 1) + [1]}
    [said] = foretold(Case.from_dict(rod(mesh=mesh, materials={"m": law}, load=[load])))
    true = factor(box_body(size=size, cells=cells), nu)
    assert true > 1.15
    assert said - 1 == pytest.approx(true - 1, rel=1 / 3)


@pytest.mark.parametrize(
    "tables",
    [
        {"mesh": ROD},  # quadratic
        {"mesh": {"rectangle": {"size": [10, 1], "cells": [80, 8]}, "degree": 1}},
        {"mesh": {"rectangle": {"size": [2, 1], "cells": [2, 1]}, "degree": 1}},  # it shears
        {"mesh": {"box": {"size": [3, 3, 3], "cells": [2, 2, 2]}, "degree": 1}, "load": []},
    ],
)
def test_nothing_to_say_of_bending(tables: dict[str, Any]) -> None:
    case = Case.from_dict(rod(**tables))
    assert not [note for note in report(case).notes if "bending" in note]


def test_bending_in_explicit_motion() -> None:
    """Quadratic elements are no way out there but by another scheme."""
    case = Case.from_dict(rod(dynamics={"end": 1, "scheme": EXPLICIT[0]}))
    [note] = [note for note in report(case).notes if "bending" in note]
    assert re.search(r"use 6 of them across \(about \S+ unknowns\), or an implicit scheme", note)
    assert note.endswith("with mesh.degree = 2")


@pytest.mark.parametrize("touches", [False, True], ids=["free", "contact"])
def test_advice_for_bending_is_enough(folder: Path, touches: bool) -> None:
    """What is advised runs to its end, with as many unknowns as said, and is not noted again."""
    mesh: dict[str, Any] = {"rectangle": {"size": [10, 1], "cells": [30, 3]}, "degree": 1}
    floor = {"on": "bottom", "plane": {"axis": "y", "at": -0.01}}
    load = [{"kind": "traction", "on": "right", "value": [0, -3]}]
    tables = rod(mesh=mesh, contact=[floor] if touches else [], load=load)
    [note] = [n for n in report(Case.from_dict(tables)).notes if "bending" in n]
    if touches:
        told = re.search(r"with about ([\d.]+) of .* use (\d+) of them across \(about (\S+) ", note)
        assert told is not None, note
        finer = float(told[2]) / float(told[1])
        mesh["rectangle"]["cells"] = [int(np.ceil(n * finer)) for n in (30, 3)]
    else:
        told = re.search(r"use mesh.degree = (2)()? \(about (\S+) unknowns\)$", note)
        assert told is not None, note
        mesh["degree"] = 2
    case = Case.from_dict(tables)
    assert not [n for n in report(case).notes if "bending" in n]
    *_, state = run(case, output=folder / "out")
    assert state.load_factor == 1.0
    V = case.make_problem(case.read_body()).V
    assert V.dofmap.index_map.size_global * V.dofmap.index_map_bs == pytest.approx(
        float(told[3]), rel=0.3
    )


@pytest.mark.long
@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="takes two minutes")
def test_advice_for_a_body_in_contact_ends(folder: Path) -> None:
    """Quadratic elements, once advised for a duck that tips, were at 8 % of its load after 400 s.

    What is advised now is run to its end: so many linear elements across.
    """
    path = ROOT / "demos" / "tipping" / "case.toml"
    tables = tomllib.loads(path.read_text(encoding="utf-8"))
    [note] = [n for n in report(Case.from_dict(tables, path.parent)).notes if "bending" in n]
    assert "mesh.degree" not in note
    told = re.search(r"with about ([\d.]+) of them .* use (\d+) of them across \(about", note)
    assert told is not None, note
    tables["mesh"]["size"] *= float(told[1]) / float(told[2])
    tables["output"] = {}
    case = Case.from_dict(tables, path.parent)
    after = [note for note in report(case).notes if "bending" in note]
    factors = [float(n.partition("be about ")[2].split()[0]) for n in (note, *after)]
    assert all(factor < factors[0] - 0.1 for factor in factors[1:])
    *_, state = run(case, output=folder / "out")
    assert state.load_factor == 1.0
    assert state.audit is not None and state.audit.verdict_so_far == "pass"


def bracket(folder: Path, **mesh: Any) -> Case:
    """The bracket of steel: 10 mm thick, 60 wide, fillet of 6 mm, held by two holes, 2 kN."""
    on_root(MPI.COMM_WORLD, lambda: (folder / "bracket.geo").write_text(BRACKET) and None)
    holes = [{"cylinder": {"axis": "x", "point": [0, y, 70], "radius": 5.5}} for y in (15, 45)]
    return Case.from_dict(
        {
            "mesh": {"file": "bracket.geo", "unit": "mm", **mesh},
            "surfaces": {"holes": holes, "lip": {"plane": "x", "at": "max"}},
            "materials": {"steel": {"law": "linear-elastic", "E": "210 GPa", "nu": 0.3}},
            "support": [{"on": "holes"}],
            "load": [{"kind": "force", "on": "lip", "value": [0, 0, "-2 kN"]}],
        },
        folder,
    )


def deflection(case: Case, folder: Path) -> float:
    """Largest displacement [mm]."""
    *_, state = run(case, output=folder / "out")
    return 1e3 * state.max_displacement


@pytest.mark.long
def test_a_bracket_without_further_keys(folder: Path) -> None:
    """1.157 mm where linear cells gave 0.373: now within 5 % on cells of 12 mm, too stiff.

    One of them reaches through the thickness; cells of 4 mm give 1.157 mm.
    """
    case = bracket(folder, size=12)
    assert not foretold(case)
    assert deflection(case, folder) == pytest.approx(1.157, rel=0.05)


def test_a_bracket_of_linear_cells(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    """It is three times too stiff as before, and both `check` and `run` say so."""
    case = bracket(folder, size=12, degree=1)
    [said] = foretold(case)
    true = 1.157 / deflection(case, folder)
    assert true > 2.5
    assert said == pytest.approx(true, rel=0.25)
    if MPI.COMM_WORLD.rank == 0:
        assert f"{said:.2g} times too stiff in bending; use mesh.degree = 2" in caplog.text


# --- shapes ---


@contextmanager
def meshed(folder: Path, geo: str, order: int) -> Iterator[Path]:
    """A finished mesh of order 1 or 2."""
    import gmsh

    def write() -> None:
        (folder / "a.geo").write_text(geo)
        gmsh.initialize(readConfigFiles=False, interruptible=False)
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.open(str(folder / "a.geo"))
        gmsh.option.setNumber("Mesh.MeshSizeMax", 1.5)
        gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", 24)
        gmsh.model.mesh.generate(3)
        gmsh.model.mesh.setOrder(order)
        gmsh.write(str(folder / "a.msh"))
        gmsh.finalize()

    on_root(MPI.COMM_WORLD, write)
    yield folder / "a.msh"


@pytest.mark.parametrize(
    ("geo", "order", "degree", "said"),
    [
        (GEO + HOLE, 1, 2, "straight elements along curved surfaces: "),
        (GEO + HOLE, 2, 2, ""),
        (GEO, 1, 2, ""),
        (GEO + HOLE, 2, 1, "linear elements in curved elements: "),
        (GEO + HOLE, 1, 1, ""),  # of the order of what linear elements err anyhow
    ],
)
@pytest.mark.sample(3)
def test_shapes(geo: str, order: int, degree: int, said: str, folder: Path) -> None:
    """Finished meshes whose cells do not fit the surface, or the displacement."""
    with meshed(folder, geo, order):
        tables = rod(mesh={"file": "a.msh", "degree": degree}, support=[], load=[])
        notes = " ".join(report(Case.from_dict({**tables, "modal": {}}, folder)).notes)
        motion = {"end": 1, "dt": 0.1}
        moving = " ".join(report(Case.from_dict({**tables, "dynamics": motion}, folder)).notes)
    assert "straight elements along" not in moving
    for text in ("straight elements along", "linear elements in curved"):
        assert (text in notes) == said.startswith(text)
    if said.startswith("straight"):
        # At 24 facets around the hole the normal turns by 15 degrees, along some edges by less.
        assert 5 < float(notes.partition(" are bent, by ")[2].partition(" degrees")[0]) < 15


def test_ridges() -> None:
    """A cube: 0 in its faces, and 90 degrees at each of its edges, once on all ranks."""
    angles = np.degrees(ridge_angles(box_body(size=(1, 1, 1), cells=(3, 3, 3)).mesh))
    bent = np.array([np.sum(np.isclose(angles, 90)), np.sum(np.isclose(angles, 0, atol=1e-5))])
    MPI.COMM_WORLD.Allreduce(MPI.IN_PLACE, bent)
    assert list(bent) == [12 * 3, 6 * (2 * 3 * 2 + 9)]


@pytest.mark.parametrize("nu", [0.0, 0.45])
@pytest.mark.parametrize(("across", "along"), [(0.3, 0.0), (0.0, 3.0), (0.5, 2.0)])
def test_excess_stiffness_goes_with_the_square_of_cells(nu: float, across: float, along: float):
    """A constant strain errs by what bending changes across a cell, its energy by the square."""

    def excess(factor: float) -> float:
        one, size = np.ones(1), np.full(1, factor)
        found = Thickness(volumes=one, thickness=2 * one, across=across * size, along=along * size)
        return float(bending_stiffness(found, np.full(1, nu))[0]) - 1

    assert excess(0.0) == 0
    assert excess(2.0) == pytest.approx(4 * excess(1.0), rel=1e-12)
    assert excess(1.0) > 0
