"""Cases that are refined until a result is known: closed forms, singular peaks, limits, faults."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.bodies import drawing
from helpers.ranks import SIZES, on_ranks
from mpi4py import MPI

from dolfin_elastic import Case
from dolfin_elastic.cli.converge import converge as command
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.results.derived.reductions import REDUCTIONS
from dolfin_elastic.study.converge.converge import Goal, converge
from dolfin_elastic.study.converge.report import Progress
from dolfin_elastic.study.wanted import Wanted, tolerance

WORLD = MPI.COMM_WORLD
HOLE = """\
Point(1) = {0, 0, 0}; Point(2) = {1, 0, 0, 0.7}; Point(3) = {4, 0, 0, 0.8};
Point(4) = {4, 4, 0, 0.8}; Point(5) = {0, 4, 0, 0.8}; Point(6) = {0, 1, 0, 0.7};
Line(1) = {2, 3}; Line(2) = {3, 4}; Line(3) = {4, 5}; Line(4) = {5, 6}; Circle(5) = {6, 1, 2};
Curve Loop(1) = {1, 2, 3, 4, 5}; Plane Surface(1) = {1};
Physical Curve("bottom") = {1}; Physical Curve("right") = {2}; Physical Curve("top") = {3};
Physical Curve("left") = {4}; Physical Curve("hole") = {5}; Physical Surface("plate") = {1};
"""
CORNER = """\
Point(1) = {-5e-19, 0, 0, 0.6}; Point(2) = {1, 0, 0, 0.6}; Point(3) = {1, -1, 0, 0.6};
Point(4) = {-1, -1, 0, 0.6}; Point(5) = {-1, 1, 0, 0.6}; Point(6) = {-5e-19, 1, 0, 0.6};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 5}; Line(5) = {5, 6};
Line(6) = {6, 1};
Curve Loop(1) = {1, 2, 3, 4, 5, 6}; Plane Surface(1) = {1};
Physical Curve("low") = {3}; Physical Curve("right") = {2}; Physical Curve("top") = {5};
Physical Curve("inner") = {1, 6}; Physical Surface("plate") = {1};
"""
# Kirsch's stress for the tension 1 along x and the radius 1 (Timoshenko and Goodier, Theory of
# Elasticity (1970), section 35), with c and s of twice and four times the angle.
C2, S2 = "((x^2 - y^2)/(x^2 + y^2))", "(2*x*y/(x^2 + y^2))"
C4, S4, R2 = f"(2*{C2}^2 - 1)", f"(2*{C2}*{S2})", "(1/(x^2 + y^2))"
XX = f"1 - {R2}*(1.5*{C2} + {C4}) + 1.5*{R2}^2*{C4}"
YY = f"-{R2}*(0.5*{C2} - {C4}) - 1.5*{R2}^2*{C4}"
XY = f"-{R2}*(0.5*{S2} + {S4}) + 1.5*{R2}^2*{S4}"


def case(folder: Path, script: str, **tables: Any) -> Case:
    """A plane case whose mesh is a Gmsh script."""
    on_root(WORLD, lambda: (folder / "body.geo").write_text(script))
    whole: dict[str, Any] = {
        "mesh": {"file": "body.geo", "degree": 2, "geometry": "plane-stress", "curved": True},
        "materials": {"steel": {"law": "linear-elastic", "E": 1000.0, "nu": 0.3}},
    }
    return Case.from_dict({**whole, **tables}, folder)


def plate(folder: Path, **tables: Any) -> Case:
    """A quarter of an infinite plate with a hole: the exact stress acts on the cuts."""
    return case(
        folder,
        HOLE,
        support=[{"on": "left", "kind": "symmetry"}, {"on": "bottom", "kind": "symmetry"}],
        load=[
            {"kind": "traction", "on": "right", "value": [XX, XY]},
            {"kind": "traction", "on": "top", "value": [XY, YY]},
        ],
        output={"probes": {"edge": [0, 1], "far": [4, 0]}, "fields": ["displacement"]},
        **tables,
    )


def last(case: Case, folder: Path, text: str, share: str, **limits: int) -> Progress:
    """What is known at the end."""
    goal = Goal(Wanted.read(text), tolerance(share), **limits)
    *_, progress = converge(case, goal, output=folder)
    return progress


@pytest.mark.long
def test_stress_at_a_hole(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Kirsch: three times the far stress, within the tolerance and the error that is told."""
    folder = on_root(WORLD, lambda: tmp_path)
    with caplog.at_level("INFO", "dolfin_elastic"):
        progress = last(plate(folder), folder / "out", "von_mises on hole", "2%")
    said = [r for r in caplog.records if r.getMessage().startswith("largest von Mises stress")]
    assert len(said) == (WORLD.rank == 0), "of the last mesh alone, once for all ranks"
    assert len(progress.levels) > 1
    found = progress.last
    assert progress.verdict == "reached"
    assert found.error <= 0.02
    assert abs(found.value / 3 - 1) <= found.error
    assert found.limit == pytest.approx(3, rel=0.01)
    assert found.place == pytest.approx((0, 1), abs=1e-6)
    values = [level.value for level in progress.levels]
    assert abs(values[0] / 3 - 1) > 0.02  # the first mesh does not know it
    check_files(folder / "out", progress)


def read_rows(folder: Path) -> list[dict[str, str]]:
    """The table, on every rank."""
    text = on_root(WORLD, (folder / "converge.csv").read_text)
    return [*csv.DictReader(text.splitlines())]


def check_files(folder: Path, progress: Progress) -> None:
    """Table, plot and results are those of all meshes and of the last."""
    rows = read_rows(folder)
    assert [int(row["cells"]) for row in rows] == [level.cells for level in progress.levels]
    assert float(rows[-1]["value"]) == pytest.approx(progress.last.value)
    assert float(rows[0]["error"]) > 0  # that of the recovered stress
    assert rows[0]["limit"] == ""
    texts = on_root(
        WORLD,
        lambda: [(folder / f"{name}.json").read_text() for name in ("converge", "summary")],
    )
    known, summary = map(json.loads, texts)
    assert (known["verdict"], known["quantity"], known["unit"]) == (
        "reached",
        "von_mises on hole",
        "Pa",
    )
    assert summary["cells"] == progress.last.cells
    assert on_root(WORLD, lambda: (folder / "converge.png").stat().st_size) > 10_000


@pytest.mark.long
def test_reentrant_corner(tmp_path: Path) -> None:
    """The stress at the corner of an L grows like h^-0.456 and is given up, with the reason.

    The exponent is that of the opening mode in a corner of 270 degrees, 1 - 0.5445 (M. L. Williams,
    J. Appl. Mech. 19 (1952) 526).
    """
    folder = on_root(WORLD, lambda: tmp_path)
    ell = case(
        folder,
        CORNER,
        support=[{"on": "low"}],
        load=[{"kind": "traction", "on": "top", "value": [1.0, 0]}],
    )
    progress = last(ell, folder / "out", "von_mises on inner", "1%")
    assert progress.verdict == "singular"
    assert np.linalg.norm(progress.last.place) <= progress.last.size
    assert "at a re-entrant edge, it grows with every refinement, like h^-0.4" in progress.reason
    assert "has no limit: at (0, 0.0625) m, at" in progress.reason  # Gmsh's x there is -5e-19
    assert len(progress.levels) == 3


def kirsch_energy() -> float:
    """Strain energy of the quarter plate by 30 x 30 Gauss points on both sides of its diagonal."""
    x, w = np.polynomial.legendre.leggauss(30)
    x, w, energy = (1 + x) / 2, w / 2, 0.0
    for start in (0.0, np.pi / 4):
        phi = start + x[:, None] * np.pi / 4
        length = 4 / np.maximum(np.cos(phi), np.sin(phi)) - 1
        r = 1 + x[None, :] * length
        c2, s2, c4, s4, a = *(f(k * phi) for k in (2, 4) for f in (np.cos, np.sin)), r**-2
        xx = 1 - a * (1.5 * c2 + c4) + 1.5 * a**2 * c4
        yy = -a * (0.5 * c2 - c4) - 1.5 * a**2 * c4
        xy = -a * (0.5 * s2 + s4) + 1.5 * a**2 * s4
        density = (xx**2 + yy**2 - 0.6 * xx * yy + 2.6 * xy**2) / 2000
        energy += np.pi / 4 * np.sum(w[:, None] * w[None, :] * length * r * density)
    return float(energy)


@pytest.mark.long
@pytest.mark.parametrize(
    ("text", "share", "exact"),
    [
        ("displacement_y of edge", "0.5%", -1e-3),
        ("strain_energy", "0.1%", kirsch_energy()),
        ("integral cauchy_stress_xx on left", "1%", 3 + 3 / 8 + 63 / 128),
    ],
    ids=["probe", "energy", "integral"],
)
def test_other_results(tmp_path: Path, text: str, share: str, exact: float) -> None:
    """As far off as is told: a probe, where Kirsch's displacement is -a S/E, and the energy.

    And the force per thickness across the cut from the hole on, where the stress is
    1 + 1/(2 y^2) + 3/(2 y^4).
    """
    folder = on_root(WORLD, lambda: tmp_path)
    found = last(plate(folder), folder / "out", text, share)
    assert found.verdict == "reached"
    assert abs(found.last.value / exact - 1) <= found.last.error


@pytest.mark.long
@pytest.mark.parametrize(
    ("limits", "verdict", "reason"),
    [
        ({"refinements": 1}, "refinements", "1 refinements, the limit"),
        ({"unknowns": 900}, "unknowns", "above the limit of 900"),
    ],
)
def test_limits(tmp_path: Path, limits: dict[str, int], verdict: str, reason: str) -> None:
    """What ends it is said; the results so far are there."""
    folder = on_root(WORLD, lambda: tmp_path)
    progress = last(plate(folder), folder / "out", "von_mises on hole", "0.001%", **limits)
    assert progress.verdict == verdict
    assert reason in progress.reason
    text = on_root(WORLD, (folder / "out" / "converge.json").read_text)
    assert json.loads(text)["verdict"] == verdict


@pytest.mark.long
def test_nonlinear(tmp_path: Path) -> None:
    """Newton's method goes on from the coarser mesh: three iterations, from rest six."""
    folder = on_root(WORLD, lambda: tmp_path)
    made = Case.from_dict(
        {
            "mesh": {"rectangle": {"size": [1, 0.2], "cells": [4, 1]}, "degree": 2},
            "materials": {"rubber": {"law": "neo-hookean", "E": "1 MPa", "nu": 0.3}},
            "support": [{"on": "left"}],
            "load": [{"kind": "traction", "on": "right", "value": [0, "-4 kPa"]}],
            "output": {"probes": {"tip": [1, 0.1]}},
        },
        folder,
    )
    progress = last(made, folder / "out", "displacement of tip", "0.5%")
    assert progress.verdict == "reached"
    first, *others = [level.newton for level in progress.levels]
    assert max(others) <= 3 < first


@pytest.mark.skipif(WORLD.size == 1, reason="compares numbers of ranks")
def test_ranks_agree(tmp_path: Path) -> None:
    """The same meshes and numbers on all numbers of ranks, in a body with symmetry, too.

    Solutions agree to 1e-9; what is estimated from their differences to less.
    """
    folder = on_root(WORLD, lambda: tmp_path)
    made = Case.from_dict(
        {
            "mesh": {"rectangle": {"size": [1, 1], "cells": [4, 4]}, "degree": 2},
            "materials": {"steel": {"law": "linear-elastic", "E": 1000.0, "nu": 0.3}},
            "support": [{"on": "left", "kind": "symmetry"}, {"on": "bottom", "kind": "symmetry"}],
            "load": [{"kind": "traction", "on": "right", "value": ["y*(1 - y)", 0]}],
        }
    )
    goal = Goal(Wanted.read("von_mises on right"), 1e-4, refinements=3)

    def levels(comm: MPI.Comm) -> list[tuple[int, float, float]]:
        *_, progress = converge(made, goal, output=folder / f"on_{comm.size}", comm=comm)
        return [(level.cells, level.value, level.energy_error) for level in progress.levels]

    first, *others = [on_ranks(size, levels) for size in SIZES]
    for other in others:
        assert [level[0] for level in other] == [level[0] for level in first]
        assert np.allclose(other, first, rtol=1e-7)


@pytest.mark.long
def test_reaction_of_a_support(tmp_path: Path) -> None:
    """The length of the whole force, which is that of the load on every mesh."""
    folder = on_root(WORLD, lambda: tmp_path)
    made = Case.from_dict(
        {
            "mesh": {"rectangle": {"size": [1, 1], "cells": [2, 2]}, "degree": 1},
            "materials": {"steel": {"law": "linear-elastic", "E": 1000.0, "nu": 0.3}},
            "support": [{"on": "left"}],
            "load": [{"kind": "traction", "on": "right", "value": [3.0, 4.0]}],
        }
    )
    progress = last(made, folder / "out", "reaction of left", "1%")
    assert [level.value for level in progress.levels] == pytest.approx([5, 5, 5], rel=1e-9)
    assert (progress.verdict, progress.quantity.unit) == ("reached", "N")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("von_mises on hol", "no part and no probe 'hol'; did you mean 'hole'"),
        ("von_mise on hole", "no field 'von_mise'; did you mean 'von_mises'"),
        ("reaction of lef", "no support 'lef'; did you mean 'left'"),
        ("strain_enrgy", "no result 'strain_enrgy'; did you mean 'strain_energy'"),
        ("displacement of ede", "'ede'; did you mean 'edge'"),
        ("?", "a run has no result"),
        ("meen von_mises on hole", "--until: unknown value 'meen'; did you mean 'mean'"),
        ("mean von_mises of edge", "no result 'edge_von_mises'"),
        ("safety factor on hol", "no part and no probe 'hol'; did you mean 'hole'"),
        ("percentile:95 von_mises on hol", "no part and no probe 'hol'; did you mean 'hole'"),
    ],
)
def test_unknown_results(tmp_path: Path, text: str, message: str) -> None:
    """The nearest name is told, and nothing is written."""
    folder = on_root(WORLD, lambda: tmp_path)
    with pytest.raises(InputError) as caught:
        last(plate(folder), folder / "out", text, "1%")
    assert message in str(caught.value)
    assert not on_root(WORLD, (folder / "out").exists)


def test_help_names_the_reductions() -> None:
    words = (command.__doc__ or "").replace(",", " ").split()
    assert REDUCTIONS.keys() <= {*words}


@pytest.mark.long
def test_notes_of_a_run(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """What `run` warns of is said of the first mesh, once: a beam of two linear cells across."""
    folder = on_root(WORLD, lambda: tmp_path)
    beam = Case.from_dict(
        {
            "mesh": {"rectangle": {"size": [8, 1], "cells": [16, 2]}, "degree": 1},
            "materials": {"steel": {"law": "linear-elastic", "E": 1000.0, "nu": 0.3}},
            "support": [{"on": "left"}],
            "load": [{"kind": "traction", "on": "right", "value": [0, 1]}],
            "output": {"fields": ["displacement"]},
        },
        folder,
    )
    last(beam, folder / "out", "strain_energy", "0.001%", refinements=1)
    notes = [r.getMessage() for r in caplog.records if "bend too stiffly" in r.getMessage()]
    assert WORLD.bcast(len(notes)) == 1


@pytest.mark.parametrize("share", ["0", "100%", "three", "-1%", "nan"])
def test_shares(share: str) -> None:
    """Between nothing and everything."""
    with pytest.raises(InputError, match="is no tolerance"):
        tolerance(share)


def test_other_analyses(tmp_path: Path) -> None:
    """Motion, modes and periodic cells are refused, with what is possible."""
    folder = on_root(WORLD, lambda: tmp_path)
    made = Case.from_dict(
        {
            "mesh": {"rectangle": {"size": [1, 1], "cells": [1, 1]}},
            "materials": {"m": {"law": "linear-elastic", "E": 1, "nu": 0.3, "density": 1}},
            "modal": {"count": 1},
        }
    )
    with pytest.raises(InputError, match=r"this is \[modal\]; compute it with `run`"):
        last(made, folder / "out", "von_mises", "1%")


# --- straight cells of a finished mesh ---


def disk(path: Path) -> None:
    """A hollow quarter disk of radii 1 and 2 of straight cells, six and three on its arcs."""
    with drawing() as gmsh:
        geo = gmsh.model.geo
        places = [(0, 0), (1, 0), (2, 0), (0, 2), (0, 1)]
        o, a, b, c, d = (geo.addPoint(*place, 0, 0.5) for place in places)
        lines = [
            geo.addLine(a, b),
            geo.addCircleArc(b, o, c),
            geo.addLine(c, d),
            geo.addCircleArc(d, o, a),
        ]
        geo.addPlaneSurface([geo.addCurveLoop(lines)])
        geo.mesh.setTransfiniteCurve(lines[1], 4)
        geo.mesh.setTransfiniteCurve(lines[3], 4)
        geo.synchronize()
        for name, number in zip(("bottom", "outer", "left", "inner"), lines, strict=True):
            gmsh.model.addPhysicalGroup(1, [number], name=name)
        gmsh.model.addPhysicalGroup(2, [1], name="body")
        gmsh.model.mesh.generate(2)
        gmsh.write(str(path))


@pytest.mark.long
@pytest.mark.parametrize(("degree", "nu"), [(2, 0.3), (1, 0.4999)])
@pytest.mark.parametrize("wanted", ["strain_energy", "reaction of inner"])
def test_the_polygon_is_not_certified(folder: Path, degree: int, nu: float, wanted: str) -> None:
    """Refining a finished mesh of straight cells converges to another body.

    A tube whose inner side is turned by a small angle, with the outer one held: M = 4 pi mu psi
    /(1/a^2 - 1/b^2) (see `test_enclosed`), a quarter of that.
    """
    on_root(WORLD, lambda: disk(folder / "disk.msh"))
    psi = 1e-3
    tables = {
        "mesh": {"file": str(folder / "disk.msh"), "degree": degree},
        "materials": {"rubber": {"law": "linear-elastic", "mu": 1.0, "nu": nu}},
        "support": [
            {"on": "outer", "displacement": [0, 0]},
            {"on": "inner", "displacement": [f"{-psi}*y", f"{psi}*x"]},
            {"on": "bottom", "displacement": [0, "free"]},
            {"on": "left", "displacement": ["free", 0]},
        ],
    }
    energy = 4 * np.pi * psi**2 / (1 - 1 / 4) / 2 / 4
    goal = Goal(Wanted.read(wanted), 0.01, refinements=4)
    *_, last = converge(Case.from_dict(tables), goal, output=folder / "out")
    print([(level.value / energy - 1, level.error) for level in last.levels])
    assert last.verdict == "refinements"
    assert "straight elements cut" in last.reason
    if wanted == "strain_energy":
        assert abs(last.last.value / energy - 1) <= 1.3 * last.last.error
