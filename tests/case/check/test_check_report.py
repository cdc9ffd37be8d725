"""What a check says before anything is compiled: sizes, masses, loads, free bodies, notes."""

from __future__ import annotations

import io
import json
from contextlib import redirect_stdout
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dolfinx import fem
from helpers.barriers import usable_ipctk
from helpers.load_examples import example
from mpi4py import MPI

from dolfin_elastic import NeoHookean, Pressure, Problem
from dolfin_elastic.case.case import Case
from dolfin_elastic.case.check.consistency import check
from dolfin_elastic.case.check.integrals import Integrals
from dolfin_elastic.case.check.memory import memory, per_unknown
from dolfin_elastic.case.check.mesh_quality import cell_notes, part_notes
from dolfin_elastic.case.check.report import report
from dolfin_elastic.case.check.sizes import PartSize
from dolfin_elastic.case.run import check_problem
from dolfin_elastic.cli.console_check import show_check
from dolfin_elastic.core import jit
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import on_root, total
from dolfin_elastic.mesh import box_body
from dolfin_elastic.mesh.geometry.simplices import boundary_facets
from dolfin_elastic.model.loads import (
    LOADS,
    Load,
    LoadPoints,
    Traction,
)
from dolfin_elastic.solvers.diagnostics.rigid_body import free_bodies
from dolfin_elastic.solvers.diagnostics.rigid_body_names import motions_in_words
from dolfin_elastic.solvers.eigen.settings import ModalSettings
from dolfin_elastic.solvers.linear.choice import LinearSettings, choose

COMM = MPI.COMM_WORLD
E = 1e6
RUBBER = {"law": "neo-hookean", "E": E, "nu": 0.3, "density": 1000}
EXACT = 1e-12
"""Sums of polynomials that the rules integrate exactly: only round-off is left."""
FREE = "free"


def case(**tables: Any) -> Case:
    """A block of 2 x 1 x 3 m held at its bottom, with changes."""
    defaults: dict[str, Any] = {
        "mesh": {"box": {"size": [2, 1, 3], "cells": [2, 1, 3]}, "degree": 1},
        "materials": {"rubber": RUBBER},
        "support": [{"on": "bottom"}],
    }
    return Case(**{**defaults, **tables})


def named(parts: tuple[PartSize, ...]) -> dict[str, PartSize]:
    return {part.name: part for part in parts}


def meshed(folder: Path, geo: str, **tables: Any) -> Case:
    """A case whose mesh Gmsh makes. Collective."""
    on_root(COMM, lambda: (folder / "body.geo").write_text(geo))
    return Case.from_dict(
        {
            "mesh": {"file": "body.geo", "geometry": "plane-strain", "degree": 1},
            "materials": {"rubber": RUBBER},
            **tables,
        },
        folder,
    )


# --- nothing is compiled ---


def test_loads_beyond_the_full_one(comm):
    """Statics beyond the full load: loads and obstacles are those of its end."""
    tables = {
        "mesh": {"rectangle": {"size": [1, 1], "cells": [2, 2]}, "degree": 1},
        "materials": {"rubber": {"law": "neo-hookean", "E": 1e6, "nu": 0.3}},
        "support": [{"on": "bottom"}],
        "load": [{"kind": "traction", "on": "top", "value": [1e3, 0]}],
        "contact": [{"on": "top", "plane": {"axis": "-y", "at": 5}, "motion": [0, -1.37]}],
        "statics": {"end": 3.0},
    }
    found = report(Case.from_dict(tables), comm=comm)
    assert found.loads[0].force == pytest.approx((3e3, 0))
    assert not any("farther than the body is large" in note for note in found.notes)
    near = report(Case.from_dict({**tables, "statics": {}}), comm=comm)
    assert any("farther than the body is large" in note for note in near.notes)


def test_compiles_no_form(monkeypatch):
    """The report comes without the form compiler."""

    def refuse(*_: Any, **__: Any) -> None:
        raise AssertionError("a form is compiled")

    for name in ("compile_forms", "compile_expression"):
        monkeypatch.setattr(jit, name, refuse)
    monkeypatch.setattr("dolfin_elastic.solvers.assembly.assembler.compile_forms", refuse)
    loads = [{"kind": "gravity"}, {"kind": "traction", "on": "top", "value": ["x*y", 0, "z^2"]}]
    assert len(report(case(load=loads)).loads) == 3


# --- sizes and masses ---


def test_sizes_and_masses():
    """Areas, volumes, centroids and masses of a block and of its lower third."""
    found = report(
        case(
            regions={"foot": {"box": [[0, 0, 0], [2, 1, 1]]}},
            materials={"rubber": RUBBER, "lead": {**RUBBER, "density": 11000, "on": "foot"}},
        )
    )
    assert (found.dim, found.geometry) == (3, "solid")
    surfaces, regions = named(found.surfaces), named(found.regions)
    assert surfaces["right"].measure == pytest.approx(3, rel=EXACT)
    assert surfaces["right"].centroid == pytest.approx((2, 0.5, 1.5), rel=EXACT)
    assert surfaces["right"].mass is None
    assert list(regions) == ["(whole body)", "foot"]
    assert regions["foot"].centroid == pytest.approx((1, 0.5, 0.5), rel=EXACT)
    assert regions["foot"].mass == pytest.approx(22000, rel=EXACT)
    whole = regions["(whole body)"]
    assert whole.mass == pytest.approx(26000, rel=EXACT)
    # (22 t at 0.5 m and 4 t at 2 m)/26 t
    assert whole.centre_of_mass == pytest.approx((1, 0.5, 19 / 26), rel=EXACT)
    assert whole.centroid == pytest.approx((1, 0.5, 1.5), rel=EXACT)
    materials = named(found.materials)
    assert materials["rubber"].mass == pytest.approx(4000, rel=EXACT)
    assert materials["lead"].count == 12


def test_density_that_varies():
    """A density that is linear in the place, in quadratic elements: exact."""
    found = report(
        case(
            mesh={"box": {"size": [2, 1, 3], "cells": [2, 1, 3]}, "degree": 2},
            materials={"rubber": {**RUBBER, "density": "1000*(1 + x)"}},
        )
    )
    whole = found.regions[0]
    assert whole.mass == pytest.approx(12000, rel=EXACT)
    # Integral of x (1 + x) over 0..2, over that of 1 + x: (2 + 8/3)/4.
    assert whole.centre_of_mass == pytest.approx((7 / 6, 0.5, 1.5), rel=EXACT)


def test_without_density():
    """There is no mass, and no reason is given."""
    law = {key: value for key, value in RUBBER.items() if key != "density"}
    found = report(case(materials={"rubber": law}))
    assert found.regions[0].mass is None
    assert found.materials[0].centre_of_mass == ()


def test_axisymmetric_and_thickness():
    """What the mesh does not show counts: a ring of 1 to 2 m, 1 m high, and a thin plate."""
    mesh = {"rectangle": {"size": [1, 1], "cells": [2, 2], "origin": [1, 0]}, "degree": 1}
    found = report(case(mesh={**mesh, "geometry": "axisymmetric"}))
    assert (found.dim, found.geometry) == (2, "axisymmetric")
    ring = found.regions[0]
    assert ring.mass == pytest.approx(3000 * np.pi, rel=EXACT)
    assert ring.centre_of_mass == pytest.approx((0, 0.5), rel=EXACT)
    plate = report(case(mesh={**mesh, "thickness": "10 mm"})).regions[0]
    assert plate.mass == pytest.approx(10, rel=EXACT)


CIRCLE = """
Point(1) = {0, 0, 0, 0.5}; Point(2) = {1, 0, 0, 0.5}; Point(3) = {-1, 0, 0, 0.5};
Circle(1) = {2, 1, 3}; Circle(2) = {3, 1, 2};
Curve Loop(1) = {1, 2}; Plane Surface(1) = {1};
Physical Curve("rim") = {1, 2}; Physical Surface("disc") = {1};
Mesh.ElementOrder = 2;
"""


def test_curved_cells(folder: Path):
    """The true length of a circle, with normals that point outwards."""
    disc = meshed(folder, CIRCLE, support=[{"on": "rim"}])
    found = report(disc)
    # Quadratic arcs of half a radius: the fourth power of their half angle, 0.25, is 4e-3; the
    # constant in front is about 1/100.
    assert found.surfaces[0].measure == pytest.approx(2 * np.pi, rel=1e-4)
    assert found.regions[0].measure == pytest.approx(np.pi, rel=1e-4)
    body = disc.read_body()
    points = Integrals(disc.make_problem(body)).facets(["rim"])
    sums = np.concatenate(
        [
            np.einsum("fp,fpj->j", points.weights, points.N),
            [np.einsum("fp,fpj,fpj->", points.weights, points.N, points.X)],
        ]
    )
    sums = total(COMM, sums)
    # Divergence theorem on the curved cells themselves; the rules are not exact on facets.
    np.testing.assert_allclose(sums, [0, 0, 2 * found.regions[0].measure], rtol=1e-9, atol=1e-9)


# --- loads ---


def test_loads_and_their_sum():
    """Forces and moments about the origin by hand, and the sum of all."""
    loads = [
        {"kind": "traction", "on": "top", "value": [0, 0, "-1 kPa"]},
        {"kind": "traction", "on": ["right", "left"], "value": ["x*z", 0, 0]},
        {"kind": "body-force", "value": [0, 10, 0]},
        {"kind": "gravity"},
    ]
    found = report(case(load=loads)).loads
    assert [row.load for row in found][-2:] == ["load[3] (gravity)", "all loads"]
    down, sideways, across, weight, both = found
    assert down.on == "top"
    assert down.force == pytest.approx((0, 0, -2000), rel=EXACT)
    assert down.moment == pytest.approx((-1000, 2000, 0), rel=EXACT)
    # On the right, x = 2: integral of 2 z over 3 m^2 is 9 N, of 2 z^2 is 18 N m, of 2 z y 4.5.
    assert sideways.force == pytest.approx((9, 0, 0), rel=EXACT)
    assert sideways.moment == pytest.approx((0, 18, -4.5), rel=EXACT)
    assert across.force == pytest.approx((0, 60, 0), rel=EXACT)
    assert across.moment == pytest.approx((-90, 0, 60), rel=EXACT)
    assert weight.force == pytest.approx((0, 0, -58860), rel=EXACT)
    assert weight.on == "(whole body)"
    np.testing.assert_allclose(both.force, (9, 60, -60860), rtol=EXACT)
    np.testing.assert_allclose(both.moment, (-30520, 60878, 55.5), rtol=EXACT)
    assert {row.time for row in found} == {1.0}


MESHES: dict[str, dict[str, Any]] = {
    "space": {"box": {"size": [2, 1, 3], "cells": [2, 1, 3]}, "degree": 1},
    "plane-strain": {"rectangle": {"size": [2, 1], "cells": [2, 1]}, "thickness": 0.5, "degree": 1},
    "axisymmetric": {
        "rectangle": {"size": [2, 1], "cells": [2, 1], "origin": [1, 0.5]},
        "degree": 1,
    },
}


@pytest.mark.sample(12)
@pytest.mark.parametrize("geometry", MESHES)
@pytest.mark.parametrize("name", sorted({*LOADS} - {"bearing"}))  # which needs a bore
def test_same_as_the_forms(name, geometry):
    """What is summed up in numbers is what the virtual work gives."""
    if LOADS[name].intensity is Load.intensity:
        pytest.skip("these loads have no resultant in the report")
    if (name, geometry) == ("remote-force", "axisymmetric"):
        pytest.skip("a body of revolution takes no force at a point")
    mesh, dim = dict(MESHES[geometry]), 3 if geometry == "space" else 2
    if dim == 2:
        mesh["geometry"] = geometry
    keys = example(name, dim)
    vector = ["1 + x*y", "z + y", "x^2"][:dim]
    if name == "base-acceleration":
        vector = ["1 + t", "2*t", 3.0][:dim]
    if name in ("gravity", "base-acceleration") and geometry == "axisymmetric":
        vector[0] = 0
    table = {"kind": name, **keys}
    if isinstance(keys.get("value", []), list) and "force" not in keys:
        table["value"] = vector
    elif name == "centrifugal":
        del table["point"]  # of a body of revolution it is on the axis
    this = case(load=[table], mesh=mesh)
    (row,) = report(this).loads
    problem = this.make_problem(this.read_body())
    problem.set_time(1.0)
    form = jit.compile_forms(COMM, [problem.weak_form.external], problem.jit)[0]
    nodal = fem.assemble_vector(form).array.reshape(-1, dim)
    sums = total(COMM, nodal.sum(axis=0))
    np.testing.assert_allclose(row.force, sums, rtol=EXACT, atol=EXACT * np.abs(sums).max())


def test_forces_that_cancel_are_shown_as_zero():
    """A pressure all round had a sum of 1e-12 N, over two lines; what does not cancel stays."""
    mesh = {"box": {"size": [0.7, 0.3, 1.1], "cells": [3, 2, 4]}, "degree": 1}
    skin = {"skin": {"all": True}}
    load = {"kind": "pressure", "on": "skin", "value": 1e7 / 3}
    (row,) = report(case(mesh=mesh, surfaces=skin, load=[load])).loads
    assert row.force == row.moment == (0, 0, 0)
    (row,) = report(case(mesh=mesh, surfaces=skin, load=[{**load, "value": "1 + 1e-6*x"}])).loads
    np.testing.assert_allclose(row.force, [-0.7 * 0.3 * 1.1 * 1e-6, 0, 0], rtol=1e-6)


def test_points_and_lines():
    """Force at a point; and along a line of 2 m, -x N/m down: integral of x and of x times x."""
    at = {"kind": "point-force", "at": [2, 1, 3], "value": [5, 0, 0]}
    along = {
        "kind": "line-force",
        "start": [0, 0, 3],
        "end": [2, 0, 3],
        "value": [0, 0, "-x"],
    }
    point, line, both = report(case(load=[at, along])).loads
    assert point.force == pytest.approx((5, 0, 0), rel=EXACT)
    assert point.moment == pytest.approx((0, 15, -5), rel=EXACT)
    np.testing.assert_allclose(line.force, (0, 0, -2), rtol=EXACT, atol=EXACT)
    np.testing.assert_allclose(line.moment, (0, 8 / 3, 0), rtol=EXACT, atol=EXACT)
    np.testing.assert_allclose(both.moment, (0, 15 + 8 / 3, -5), rtol=EXACT)


def test_curves():
    """In statics at the end; in motion when the load is largest, each at its own time."""
    pull = {"kind": "traction", "on": "top", "value": [100, 0, 0], "curve": [[0, 0], [1, 3]]}
    wave = {"kind": "body-force", "value": ["sin(pi*t)", 0, 0]}
    still = report(case(load=[pull, wave])).loads
    assert still[0].force == pytest.approx((600, 0, 0), rel=EXACT)
    assert still[1].force == pytest.approx((0, 0, 0), abs=1e-14)
    peak = {**pull, "curve": [[0, 0], [0.123, -3], [1, 1]]}
    moving = report(
        case(load=[peak, wave, {"kind": "gravity"}], dynamics={"end": 2, "dt": 0.1})
    ).loads
    assert [row.time for row in moving] == pytest.approx([0.123, 0.5, 0.0])
    assert moving[0].force == pytest.approx((-600, 0, 0), rel=EXACT)
    assert moving[1].force == pytest.approx((6, 0, 0), rel=EXACT)
    assert len(moving) == 3  # at different times they have no sum


def test_peak_of_a_curve_in_a_file(folder: Path):
    """Between the times that are looked at anyway."""
    text = "t,f\n0,0\n0.111,0\n0.112,1\n0.113,0\n1,0\n"
    on_root(COMM, lambda: (folder / "peak.csv").write_text(text))
    pull = {"kind": "traction", "on": "top", "value": [100, 0, 0], "curve": {"file": "peak.csv"}}
    tables = {**case(load=[pull]).to_dict(), "dynamics": {"end": 1, "dt": 0.1}}
    (row,) = report(Case.from_dict(tables, folder)).loads
    assert (row.time, row.force[0]) == (0.112, pytest.approx(200, rel=EXACT))


def test_in_the_plane():
    """Thickness counts, the moment is about z; round an axis there is none."""
    mesh = {"rectangle": {"size": [2, 1], "cells": [2, 1]}, "degree": 1}
    load = [{"kind": "traction", "on": "right", "value": [0, "1 kPa"]}]
    (row,) = report(case(mesh={**mesh, "thickness": 0.5}, load=load)).loads
    assert (row.force, row.moment) == (pytest.approx((0, 500)), pytest.approx((1000,)))
    axial = [{"kind": "traction", "on": "top", "value": [0, "1 kPa"]}]
    (row,) = report(case(mesh={**mesh, "geometry": "axisymmetric"}, load=axial)).loads
    assert row.force == pytest.approx((0, 4000 * np.pi), rel=EXACT)
    assert row.moment == ()


def test_load_that_is_not_told(monkeypatch):
    """A kind that does not know its intensity is listed without numbers, and so is the sum."""
    monkeypatch.setattr(Traction, "intensity", lambda self, places: None)
    loads = [{"kind": "traction", "on": "top", "value": [0, 0, 1]}, {"kind": "gravity"}]
    found = report(case(load=loads)).loads
    assert [row.force is None for row in found] == [True, False]


def test_load_that_is_not_finite():
    """A formula that gives no number somewhere is refused, on every rank."""
    loads = [{"kind": "traction", "on": "top", "value": [0, 0, "log(x - 1)"]}]
    with pytest.raises(InputError, match=r"load\[0\]\.value\[2\]: 'log\(x - 1\)' has no .* at \("):
        report(case(load=loads))


@pytest.mark.parametrize(
    ("analysis", "t"), [({"dynamics": {"dt": 0.1, "end": 2.0}}, 1.85), ({"statics": {}}, 0.95)]
)
def test_a_support_must_have_values_all_the_way(analysis, t):
    """Looked at at 41 times: the first one of them that has none."""
    pulled = {"on": "top", "displacement": [0, 0, f"0.01*t*sqrt({t - 0.01:g} - t)"]}
    tables = {"support": [{"on": "bottom"}, pulled], **analysis}
    with pytest.raises(InputError, match=rf"support 'top': .* not finite at .* at t = {t:g}; a "):
        report(case(**tables))
    pulled["displacement"] = [0, 0, f"0.01*t*sqrt({t + 1.2:g} - t)"]
    report(case(**tables))


@pytest.mark.parametrize(
    ("tables", "where", "text"),
    [
        (
            {"solver": {"petsc": {"ts_type": "bdf"}}, "dynamics": {"dt": 1, "end": 2}},
            "solver.petsc",
            "-ts_type has no effect here.*dynamics.scheme",
        ),
        (
            {"output": {"probes": {"reaction_bottom": [0, 0, 0]}}},
            "output.probes",
            "two results called 'reaction_bottom_x'",
        ),
        (
            {"output": {"probes": {"momentum": [0, 0, 0]}}, "dynamics": {"dt": 1, "end": 2}},
            "output.probes",
            "two results called 'momentum_x'",
        ),
    ],
)
def test_what_a_run_would_refuse(tables, where, text):
    with pytest.raises(InputError, match=f"{where}: .*{text}"):
        report(case(**tables))


def test_what_a_run_would_warn_of():
    """Obstacles that a motion begins in, and a preload that small strains do not know."""
    floor = {"on": "top", "plane": {"axis": "-z", "at": 2.9}}
    (note,) = report(case(contact=[floor], dynamics={"dt": 0.1, "end": 1})).notes
    assert note.startswith("at the start 'top' lies 0.1 m deep in its obstacle, at (")
    soft = {"rubber": {"law": "linear-elastic", "E": E, "nu": 0.3, "density": 1000}}
    push = [{"kind": "traction", "on": "top", "value": [0, 0, -1]}]
    tables = {"materials": soft, "load": push, "modal": {"preload": True}}
    assert "small-strain laws know no preload" in report(case(**tables)).notes[-1]


def test_intensity_of_pressure_like_loads():
    """Normals are there for whoever needs them."""

    class Push(Traction):
        def intensity(self, places: LoadPoints) -> Any:
            assert places.N is not None
            return -1e3 * places.N

    this = case(load=[Push(on=["top", "right"], value=[0, 0, 0])])
    (row,) = report(this).loads
    assert row.force == pytest.approx((-3000, 0, -2000), rel=EXACT)


def test_force_on_a_rigid_surface():
    """With the moment about the origin: (1, 0.5, 3) x (5, 0, 0) + (0, 0, 7) N m."""
    plate = {"on": "top", "kind": "rigid", "force": ["5 N", 0, 0], "moment": [0, 0, "7 N*m"]}
    weight = {"kind": "gravity"}
    row, push, both = report(case(support=[{"on": "bottom"}, plate], load=[weight])).loads
    assert (push.load, push.on) == ("support[1] (rigid)", "top")
    assert push.force == (5, 0, 0)
    assert push.moment == pytest.approx((0, 15, 4.5), rel=EXACT)
    assert both.force == pytest.approx((5, 0, row.force[2]), rel=EXACT)


# --- cavities ---


@pytest.mark.parametrize(
    ("support", "keys", "found"),
    [
        ([{"on": ["bottom", "top"], "kind": "symmetry"}], {"origin": [2, 0]}, True),
        ([{"on": "bottom", "kind": "symmetry"}], {"origin": [2, 0]}, True),
        ([{"on": ["bottom", "top"]}], {"origin": [2, 0]}, False),
    ],
)
def test_open_cavities(support, keys, found):
    """Between planes at y = 0 and 1, of which one does not go through the origin."""
    mesh = {"rectangle": {"size": [1, 1], "cells": [2, 2]}, "degree": 1}
    load = {"kind": "cavity", "on": "right", "name": "air", **keys}
    held = [*support, {"on": "left", "displacement": [0, FREE]}, {"on": "bottom"}]
    (note,) = report(case(mesh=mesh, support=held, load=[{**load, "pressure": 1}])).notes or ("",)
    assert note.startswith("load[0].on: the cavity 'air' is open") is found
    if found:
        with pytest.raises(InputError, match=r"load\[0\]\.on: the cavity 'air' is open"):
            report(case(mesh=mesh, support=held, load=[{**load, "added": 1}]))


# --- bodies ---

TWO = """
Rectangle(1) = {0, 0, 0, 1, 1}; Rectangle(2) = {2, 0, 0, 1, 1};
Physical Surface("base") = {1}; Physical Surface("lid") = {2};
Physical Curve("foot") = {1}; Physical Curve("edge") = {5};
"""


def test_two_bodies(folder: Path):
    """Each is judged by itself: holding one does not hold the other."""
    geo = 'SetFactory("OpenCASCADE");' + TWO
    both = [{"on": ["foot", "edge"]}]
    held = report(meshed(folder, geo, support=both))
    assert [(body.name, body.motions) for body in held.bodies] == [("base", ()), ("lid", ())]
    one = meshed(folder, geo, support=[{"on": "foot"}])
    with pytest.raises(InputError) as caught:
        report(one)
    assert str(caught.value) == (
        "support: the supports leave bodies free: of 2 bodies that share no nodes, `lid` can move "
        "and turn freely; equilibrium needs supports that hold each body; [dynamics] does not"
    )
    # The same before a solver starts.
    problem = one.make_problem(one.read_body())
    assert [bool(body.motions) for body in free_bodies(problem)] == [False, True]
    rolls = [{"on": "foot"}, {"on": "edge", "displacement": [FREE, 0]}]
    moving = report(meshed(folder, geo, support=rolls, dynamics={"end": 1, "dt": 0.1}))
    assert [body.motions for body in moving.bodies] == [(), ("move along x",)]


@pytest.mark.parametrize(
    ("along", "motion"),
    [
        ((1, 2), "turn about x through (1, 0, 0) m"),
        ((0, 2), "turn about y through (0, 0.5, 0) m"),
    ],
)
def test_axis_and_its_place(along, motion):
    """A block that is held along one edge turns about that edge."""
    problem = case().make_problem(case().read_body())
    x = problem.V.tabulate_dof_coordinates()
    nodes = np.flatnonzero((np.abs(x[:, along]) < 1e-9).all(axis=1))
    nodes = nodes[nodes < problem.V.dofmap.index_map.size_local]
    held = (3 * nodes[:, None] + np.arange(3)).ravel().astype(np.int32)
    problem.constraints.prescribed_dofs = held
    assert free_bodies(problem)[0].motions == (motion,)


def test_axes_that_are_skew():
    """A slanting axis through a place, and a screw, in words."""
    axis = np.array([0.0, 0.6, 0.8])
    point, centre, size = np.array([3.0, 1.0, -2.0]), np.array([1.0, 1.0, 1.0]), 2.0
    shift = -np.cross(axis, (point - centre) / size)
    for pitch, more in ((0.0, ""), (0.25, " while it moves 0.5 m along it per radian")):
        null = np.concatenate([shift + pitch * axis, axis])[:, None]
        (found,) = motions_in_words(null / np.linalg.norm(null), centre, size)
        foot = centre + (point - centre) - axis * (axis @ (point - centre))  # nearest the centre
        place = ", ".join(f"{x:.4g}" for x in foot)
        assert found == f"turn about (0, 0.6, 0.8) through ({place}) m{more}"
    slide = np.array([0.6, -0.8, 0, 0, 0, 0])[:, None]
    assert motions_in_words(slide, centre, size) == ["move along (0.6, -0.8, 0)"]


# --- notes on meshes and on values that are unlikely ---


def test_a_run_says_that_a_load_is_beyond_its_material(caplog):
    """It ended with advice for a buckling body, or with small steps."""
    load = [{"kind": "traction", "on": "top", "value": [0, 0, "1 MPa"]}]
    found = case(load=load)
    check_problem(found, found.make_problem(found.read_body()))
    told = "the loads on the area of the supports are 1 MPa in the mean" in caplog.text
    assert told == (MPI.COMM_WORLD.rank == 0)


def test_forgotten_units():
    """Loads beyond the material, bodies of a kilometre or of nanometres, moves beyond the body."""
    assert report(case(load=[{"kind": "gravity"}])).notes == ()
    load = [{"kind": "traction", "on": "top", "value": [0, 0, "1 MPa"]}]
    (note,) = report(case(load=load)).notes
    assert note.startswith("the loads on the area of the supports are 1 MPa in the mean, Young's")
    (note,) = report(case(load=[{**load[0], "value": [0, 0, "0.49 MPa"]}])).notes or ("",)
    assert note == ""
    for unit, start in (("km", "the body is 3e+03 m long"), ("nm", "the body is 3e-09 m at most")):
        mesh = {"box": {"size": [2, 1, 3], "cells": [2, 1, 3]}, "unit": unit, "degree": 1}
        notes = report(case(mesh=mesh, load=[{"kind": "gravity"}])).notes
        assert any(note.startswith(start) for note in notes)
    (note,) = report(case(support=[{"on": "bottom", "displacement": [0, 0, 5]}])).notes
    assert note.startswith("support[0].displacement: 5 m is more than the body is long (3 m)")


PUSH = {"on": "top", "plane": {"point": [0, 0, 3], "normal": [0, 0, -1]}, "curve": [[0, 0], [1, 1]]}


@pytest.mark.parametrize(
    ("moved", "motion", "told"),
    [
        ({"support": [{"on": "bottom", "displacement": [0, 0, "5*t^2"]}]}, None, "5 m"),
        ({"support": [{"on": "bottom", "displacement": [0, 0, "2*x*sin(pi*t)"]}]}, None, "4 m"),
        ({"support": [{"on": "bottom", "displacement": [0, 0, "0.5*t^2"]}]}, None, ""),
        ({"contact": [PUSH | {"motion": [0, 0, -5]}]}, None, "5 m"),
        ({"contact": [PUSH | {"motion": [0, 0, -5]}]}, 1.0, ""),
        ({"contact": [PUSH | {"motion": [0, 0, -50]}]}, 1.0, "50 m"),
        ({"contact": [PUSH | {"motion": [0, 0, -50], "curve": [[2, 0], [9, 1]]}]}, 1.0, ""),
        ({"contact": [PUSH | {"motion": [0, 0, -5], "curve": "20*t"}]}, 1.0, "100 m"),
        ({"contact": [PUSH | {"motion": [0, 0, "-200*t"], "curve": None}]}, 0.25, "50 m"),
    ],
)
def test_motions_in_time_without_a_unit(moved, motion, told):
    """Formulas and tables, by their largest value within the analysis; a body in motion may go far.

    A press that is to go 5 mm in a mesh of mm ended in advice about the material.
    """
    contacts = [{k: v for k, v in c.items() if v is not None} for c in moved.get("contact", ())]
    tables = moved | ({"contact": contacts} if contacts else {})
    if motion is not None:
        tables |= {"dynamics": {"end": motion, "dt": 0.01}}
    notes = [note for note in report(case(**tables)).notes if "than the body is long" in note]
    assert len(notes) == (1 if told else 0), notes
    assert all(f": {told} is more than the body is long (3 m)" in note for note in notes)


THICK = {"law": "linear-elastic", "E": E, "nu": 0.3}


@pytest.mark.parametrize(
    ("tables", "start"),
    [
        (
            {"mesh": {"box": {"size": [90, 10, 10], "cells": [9, 1, 1]}, "degree": 1}},
            "the body is 90 m long, ",
        ),
        (
            {"support": [{"on": "left"}, {"on": "right", "kind": "normal", "displacement": 5}]},
            "support[1].displacement: 5 m is more than",
        ),
        (
            {"support": [{"on": "bottom", "kind": "rigid", "rotation": [0, 0, 30]}]},
            "support[0].rotation[2]: 1719 degrees are more than a full turn",
        ),
        (
            {
                "materials": {"rubber": THICK},
                "support": [
                    {
                        "on": "bottom",
                        "kind": "rotation",
                        "point": [0, 0, 0],
                        "axis": [0, 0, 1],
                        "angle": 5,
                    }
                ],
            },
            "support[0].angle: a bare 5 is in rad, 286.5 degrees",
        ),
        ({"materials": {"rubber": {**RUBBER, "density": 1e-6}}}, "materials.rubber.density: 1e-06"),
        (
            {"materials": {"rubber": {**THICK, "E": "210 GPa", "density": 7.85}}},
            "materials.rubber.density: 7.85 kg/m^3 with a Young's modulus of 210 GPa has waves "
            'of 164 km/s, faster than in any solid (diamond: 17): is it "7.85 g/cm^3"?',
        ),
        (
            {
                "materials": {"rubber": {**RUBBER, "expansion": 12}},
                "load": [{"kind": "thermal", "value": 80}],
            },
            "load[0].value: it makes 'rubber' 960 times as long",
        ),
        (
            {
                "regions": {"whole": {"all": True}},
                "materials": {"rubber": RUBBER, "wood": {**RUBBER, "on": "whole"}},
            },
            "materials.rubber fills no element",
        ),
        (
            {"load": [{"kind": "traction", "on": "bottom", "value": [0, 0, 1]}]},
            "load[0] (traction) acts on 'bottom', where supports",
        ),
        (
            {"support": [{"on": "bottom"}, {"on": "right", "displacement": ["1 mm", FREE, FREE]}]},
            "support[0] and support[1] prescribe different displacements at 2 corners",
        ),
        (
            {
                "support": [
                    {"on": "bottom", "kind": "normal"},
                    {"on": "right", "displacement": [0, 0, "1 mm"]},
                ]
            },
            "support[0] and support[1] prescribe different displacements at 2 corners",
        ),
    ],
)
def test_implausible_values(tables, start):
    """There is a note on each, and none on a case without them."""
    with_load = {"load": [{"kind": "body-force", "value": [0, 0, 1]}], **tables}
    notes = report(case(**with_load)).notes
    assert [note for note in notes if note.startswith(start)], notes
    assert report(case(load=[{"kind": "body-force", "value": [0, 0, 1]}])).notes == ()


@pytest.mark.parametrize(
    ("E", "nu", "density", "advice"),
    [
        ("1050 GPa", 0.1, 3515, ""),  # diamond
        ("10 MPa", 0.4999999, 1100, ""),  # waves in the bulk have 96 km/s
        ("10 MPa", 0.5, 1100, ""),
        ("210 GPa", 0.3, "7.85 g/cm^3", ""),
        ("210000 GPa", 0.3, 7850, "is a unit of one of them wrong?"),
        ("210 GPa", 0.3, 78.5, "is a unit of one of them wrong?"),
        ("70 GPa", 0.3, 2.7, 'is it "2.7 g/cm^3"?'),
    ],
)
def test_waves_faster_than_in_any_solid(E, nu, density, advice):
    """Density and stiffness are at odds; rubber that keeps its volume is none of this."""
    rubber = {"law": "neo-hookean", "E": E, "nu": nu, "density": density}
    box = {"size": [2, 1, 3], "cells": [2, 1, 3]}
    read = case(mesh={"box": box, "degree": 2}, materials={"rubber": rubber})
    found = [note for note in check(read, read.read_body()) if "any solid" in note]
    assert [note.endswith(advice) for note in found] == [True] * bool(advice)


@pytest.mark.parametrize(
    ("constants", "density", "said"),
    [
        ({"E": "1 MPa", "nu": 0.45}, 1.2, 'less than any foam weighs: is it "1.2 g/cm^3"?'),
        ({"E": "5 kPa", "nu": 0.3}, 1.06, 'less than any foam weighs: is it "1.06 g/cm^3"?'),
        ({"E": "1 MPa", "nu": 0.3}, 0.95, 'less than a gas weighs: is it "0.95 g/cm^3"?'),
        ({"E": "1 MPa", "nu": 0.3}, 1e-6, "less than a gas weighs: is a unit missing or wrong?"),
        ({"E": "1 MPa", "nu": 0.49}, 11, '(Poisson\'s ratio 0.49): is it "11 g/cm^3"?'),
        ({"E": "1 MPa", "nu": 0.49}, 90, "(Poisson's ratio 0.49): is a unit wrong?"),
        ({"E": "1 MPa", "nu": 0.49}, "1.2 g/cm^3", ""),
        ({"E": "5 MPa", "nu": 0.1}, 15, ""),  # expanded polystyrene
        ({"E": "100 kPa", "nu": 0.3}, 8, ""),  # melamine foam
        ({"E": 1, "nu": 0.3}, 1, ""),  # numbers without dimensions
        ({"E": 1, "nu": 0.49}, 1, ""),
        ({"E": "500 Pa", "nu": 0.49}, 1000, ""),  # a gel
        ({"E": "9 MPa", "nu": 0.3}, 120, ""),  # cork
    ],
)
def test_density_without_its_unit(constants, density, said):
    """One of g/cm^3 written bare is noted for soft solids, too; real foams are not."""
    rubber = {"law": "neo-hookean", **constants, "density": density}
    box = {"size": [2, 1, 3], "cells": [2, 1, 3]}
    read = case(mesh={"box": box}, materials={"rubber": rubber})
    found = [note for note in check(read, read.read_body()) if "density" in note]
    assert [note.endswith(said) for note in found] == [True] * bool(said), found


def test_a_bolt_at_a_cut():
    """A case of it is in order: the cut is meant to lie inside."""
    read = case(
        mesh={"box": {"size": [1, 1, 6], "cells": [1, 1, 5]}, "unit": "mm"},
        surfaces={"neck": {"cut": True, "plane": "z", "at": 3}},
        materials={"steel": {"law": "linear-elastic", "E": "210 GPa", "nu": 0.3}},
        support=[{"kind": "fixed", "on": ["bottom", "top"]}],
        load=[{"kind": "bolt", "on": "neck", "axis": "z", "value": "10 N"}],
    )
    assert check(read, read.read_body()) == ()


def test_parts_that_no_cell_carries():
    """Empty names, and surfaces inside the body."""
    body = box_body(size=(1, 1, 1), cells=(2, 2, 2))
    none = np.empty(0, dtype=np.int32)
    facets = np.arange(body.mesh.topology.index_map(2).size_local, dtype=np.int32)
    inside = np.setdiff1d(facets, boundary_facets(body.mesh))
    count = int(total(COMM, len(inside)))
    odd = body.named(regions={"nobody": none}, surfaces={"nowhere": none, "cut": inside})
    assert list(part_notes(odd)) == [
        "the region 'nobody' is empty: no element carries it",
        f"{count} of {count} facets of the surface 'cut' lie inside the body, not on its boundary",
        "the surface 'nowhere' is empty: no facet carries it",
    ]
    assert list(part_notes(body)) == []


def test_thin_cells():
    """The worst cells are named with their places."""
    (note,) = cell_notes(box_body(size=(100, 1, 1), cells=(1, 1, 1)))
    assert note.startswith("6 of 6 elements are thin (quality below 0.05; 1 is regular): ")
    assert note.count(" at (") == 5
    assert list(cell_notes(box_body(size=(1, 1, 1), cells=(1, 1, 1)))) == []


@pytest.mark.parametrize(
    ("n", "dim", "degree", "direct", "measured"),
    [
        (17496, 3, 1, True, 7.0e3),
        (46875, 3, 1, True, 9.0e3),
        (36501, 3, 2, True, 11.2e3),
        (65522, 2, 2, True, 2.1e3),
        (59049, 3, 1, False, 2.1e3),
        (46875, 3, 2, False, 3.2e3),
    ],
)
def test_memory(n, dim, degree, direct, measured):
    """The estimate stays within 25 % of what has been measured."""
    assert per_unknown(n, dim, degree, direct=direct) == pytest.approx(measured, rel=0.25)


@pytest.mark.parametrize(
    ("petsc", "size", "measured"),
    [({}, "symmetric part", 9.2e3), ({"mat_mumps_icntl_14": 50}, "LU", 18.3e3)],
)
def test_memory_of_a_tangent_that_is_not_symmetric(petsc, size, measured):
    """Of 14739 unknowns: its own factors take twice as much as those of its symmetric part."""
    body = box_body(size=(1, 1, 1), cells=(8, 8, 8))
    problem = Problem(body, NeoHookean(E=1, nu=0.3), loads=[Pressure(on="top", value=1)], degree=2)
    choice = choose(problem, LinearSettings(petsc=petsc))
    assert size in choice.detail
    beside = memory(problem, choice).total - memory(problem, None).total
    matrix = per_unknown(problem.num_dofs, 3, 2, direct=False)
    assert beside / problem.num_dofs + matrix == pytest.approx(measured, rel=0.25)


def test_places_in_another_unit():
    """Numbers that would lie in the body if they were in metres."""
    box = {"box": {"size": [2, 1, 3], "cells": [2, 1, 3]}, "unit": "mm", "degree": 1}
    push = {"kind": "line-force", "start": [0, 0, 0.003], "end": [0.002, 0, 0.003]}
    (start, end) = report(case(mesh=box, load=[{**push, "value": [0, 0, 1]}])).notes
    assert start == (
        "load[0].start: (0, 0, 0.003) mm is beside the origin: is it in m? Numbers are in mm"
    )
    assert "load[0].end: (0.002, 0, 0.003) mm" in end
    turn = {"on": "top", "kind": "rotation", "axis": [0, 0, 1], "angle": 0.1}
    for point, said in (([0.001, 0, 0.003], 1), ([1, 0, 3], 0), (["1 mm", 0, 0.003], 0)):
        supports = [{"on": "bottom"}, {**turn, "point": point}]
        notes = report(case(mesh=box, support=supports)).notes
        found = [note for note in notes if note.startswith("support[1].point: (0.001, 0, 0.003)")]
        assert len(found) == len(notes) == said
    push = {"kind": "remote-force", "on": "top", "force": [0, 0, 1e-6]}
    for point, said in (
        ([0, 0, 0.02], "(0, 0, 0.02) mm is beside the origin: is it in m?"),
        ([0, 0, "2 m"], "(0, 0, 2000) mm is 534 sizes of the body away from it: is it in another"),
        ([0, 0, 30], ""),
    ):
        notes = report(case(mesh=box, load=[{**push, "point": point}])).notes
        assert [note[15:].startswith(said) for note in notes] == [True] * bool(said)
    floor = {"on": "bottom", "plane": {"axis": "z", "at": -0.001}}
    found = report(case(mesh=box, contact=[floor]))
    (beside,) = (n for n in found.notes if n.startswith("contact 'bottom': its"))
    assert beside.endswith("beside the origin: are they in m? Then it would be 1 mm away")
    with redirect_stdout(io.StringIO()) as out:
        show_check(found)
    assert "extent     2 x 1 x 3 mm" in out.getvalue()


@pytest.mark.parametrize(
    ("shape", "gap"),
    [
        ({"plane": {"axis": "z", "at": -1}}, 1e-3),
        ({"plane": {"axis": "z", "at": "-1 mm"}}, 1e-3),
        ({"plane": {"point": [0, 0, -2], "normal": [0, 0, 1]}}, 2e-3),
        ({"sphere": {"center": [1, 0.5, -4], "radius": 3}}, 1e-3),
        ({"sphere": {"center": [1, 0.5, "-4 mm"], "radius": "0.3 cm"}}, 1e-3),
        ({"cylinder": {"axis": "x", "point": [0, 0.5, -4], "radius": 3.5}}, 0.5e-3),
    ],
)
def test_obstacles_are_in_the_unit_of_the_mesh(shape, gap):
    """As surfaces, points and probes are; with a unit of its own a length is what it says."""
    box = {"box": {"size": [2, 1, 3], "cells": [2, 2, 3]}, "unit": "mm", "degree": 1}
    (row,) = report(case(mesh=box, contact=[{"on": "bottom", **shape}])).contacts
    assert row.gap == pytest.approx(gap, rel=1e-9)


@pytest.mark.parametrize(
    ("tables", "said"),
    [
        ({}, "no nearer than 0.5 m, and nothing moves the body"),
        ({"motion": [0, 0, 0.4]}, "no nearer than 0.1 m, and nothing moves the body"),
        ({"motion": [0, 0, 0.6]}, ""),
        (
            {"support": [{"on": "top", "displacement": [0, 0, -0.04]}]},
            "its supports move it by 0.04",
        ),
        ({"support": [{"on": "top", "displacement": [0, 0, -0.06]}]}, ""),
        ({"motion": [0, 0, "0.6*sin(pi*t)"]}, ""),
        ({"load": [{"kind": "gravity"}]}, ""),
        ({"load": [{"kind": "gravity"}], "at": -5}, "no nearer than 5 m, farther than the body"),
        ({"load": [{"kind": "gravity"}], "at": -5, "motion": [0, 0, 4.5]}, ""),
        ({"load": [{"kind": "gravity"}], "at": -5, "dynamics": {"end": 2, "dt": 0.1}}, ""),
    ],
)
def test_a_contact_that_can_never_touch(tables, said):
    given = dict(tables)
    plane = {"axis": "z", "at": given.pop("at", -0.5)}
    row = {"on": "bottom", "plane": plane, "motion": given.pop("motion", [0, 0, 0])}
    box = {"box": {"size": [2, 1, 3], "cells": [2, 1, 3]}, "degree": 1}
    given.setdefault("load", [])
    notes = report(case(mesh=box, contact=[row], **given)).notes
    found = [note for note in notes if "can never touch" in note]
    assert len(found) == bool(said) and all(said in note for note in found)


def test_contacts_of_several_kinds():
    """Gaps are those of the rows that have some, whatever is before them."""
    usable_ipctk()
    floor = {"on": "top", "plane": {"axis": "z", "at": -1}}
    run = {"dynamics": {"end": 1, "dt": 0.1}}
    found = report(case(contact=[{"all": True}, floor], **run))
    assert [(gap.contact, gap.gap) for gap in found.contacts] == [("contact[1] 'top'", 4.0)]
    assert "no outer surface passes through itself" in str(found.described)


@pytest.mark.parametrize(
    ("row", "said"),
    [
        (
            {"at": 0.1},
            ["begins 0.1 m deep in its obstacle, at (0, 0, 0) m, with all of its surface"],
        ),
        ({"tilt": 0.1}, ["deep in its obstacle, at (2, 0, 0) m, from where the first load step"]),
        ({"friction": 0.3}, ["friction alone supports the body, which could else move along x"]),
        ({"friction": 30}, ["friction is 30: is it in percent? Then it would be 0.3", "alone"]),
    ],
)
def test_the_start_of_a_contact(row, said):
    """Overlaps with depth and place, friction in percent, and what only friction supports."""
    tilt, at, friction = row.get("tilt", 0.0), row.get("at", 0.0), row.get("friction", 0.0)
    plane = {"point": [0, 0, at], "normal": [-tilt, 0, 1]}
    floor = {"on": "bottom", "plane": plane, "friction": friction}
    supports = [{"on": "top"}] if not friction else []
    box = {"box": {"size": [2, 1, 3], "cells": [2, 1, 3]}, "degree": 1}
    load = [{"kind": "gravity"}]
    notes = report(case(mesh=box, contact=[floor], support=supports, load=load)).notes
    assert len(notes) == len(said)
    for note, text in zip(notes, said, strict=True):
        assert text in note


STACK = """
Rectangle(1) = {0, 0, 0, 1, 1}; Rectangle(2) = {0, GAP + 1, 0, 1, 1};
Physical Surface("base") = {1}; Physical Surface("lid") = {2};
Physical Curve("foot") = {1}; Physical Curve("up") = {3};
Physical Curve("down") = {5}; Physical Curve("head") = {7};
"""


@pytest.mark.parametrize(
    ("gap", "row", "said"),
    [
        (-0.1, {}, ["begins 0.1 m deep in the other surface, at (0.02254, 1) m: this overlap"]),
        (-0.1, {"interference": "ignore"}, ["nothing will move"]),
        (0.1, {}, ["can never touch: the surfaces come no nearer than 0.1 m", "nothing will"]),
        (0.1, {"adjust": 0.1, "interference": 0.01}, []),
        (0.0, {"interference": 0.3}, ["the interference of 0.3 m is more than a tenth"]),
        (0.0, {"friction": 0.3}, ["friction alone supports `lid`, which could else move along x"]),
    ],
)
def test_the_start_of_contact_between_bodies(gap, row, said, folder: Path):
    """Overlaps with depth and place, pairs that never meet, and what only friction supports."""
    supports = [{"on": ["foot"] if "friction" in row else ["foot", "head"]}]
    load = [{"kind": "gravity"}] if "friction" in row else []
    geo = 'SetFactory("OpenCASCADE");' + STACK.replace("GAP", str(gap))
    contact = [{"between": ["up", "down"], **row}]
    notes = report(meshed(folder, geo, support=supports, load=load, contact=contact)).notes
    assert len(notes) == len(said)
    for note, text in zip(notes, said, strict=True):
        assert text in note


@pytest.mark.parametrize(
    ("tables", "deep"),
    [
        ({}, "0.1"),
        ({"motion": [0, 0, "0.1*sin(pi*t)"]}, "0.00785"),  # 0.1 sin(pi/40)
        ({"support": [{"on": "bottom", "displacement": [0, 0, 0.1]}]}, ""),
        ({"support": [{"on": "bottom", "displacement": [0, 0, 0.05]}]}, "0.05"),
        ({"support": [{"on": "top"}]}, ""),
    ],
)
def test_a_contact_that_goes_into_held_nodes(tables, deep):
    """In the end, or on its way, where the first of 41 times that finds it is said."""
    given = dict(tables)
    plane = {"axis": "z", "at": 0}
    row = {"on": "bottom", "plane": plane, "motion": given.pop("motion", [0, 0, 0.1])}
    notes = report(case(contact=[row], **given)).notes
    when = "in the end" if deep != "0.00785" else "at load factor 0.025"
    start = f"{when} the obstacle of contact[0] 'bottom' pushes {deep} m deep into nodes that "
    found = [note for note in notes if "which cannot give way" in note]
    assert len(found) == bool(deep)
    assert all(
        note.startswith(f"{start}the support 'bottom' holds, at (0, 0, 0)") for note in found
    )


# --- how it is shown ---


@pytest.mark.parametrize(
    ("size", "keys", "told"),
    [
        ([300, 300, 20], {}, "is about 17.6 mm thick"),
        ([300, 300, 16], {}, ""),
        ([300, 300, 20], {"allowable": "225 MPa"}, ""),
        ([300, 300, 20], {"material": "steel 42CrMo4+QT"}, ""),
        ([300, 300, 20], {"source": "yield: mine, up to 10 mm"}, "give that of this thickness"),
    ],
)
def test_yield_stress_of_thinner_plates(size: list[int], keys: dict[str, str], told: str) -> None:
    """2 V/A of a plate is 2/(2/300 + 2/300 + 2/20) * 2 mm; thin ones give no note."""
    mesh = {"box": {"size": size, "cells": [2, 2, 1]}, "unit": "mm"}
    one = Case.from_dict(
        {"mesh": mesh, "materials": {"steel": {"material": "S235", **keys}}, "support": []}
    )
    notes = [note for note in check(one, one.read_body()) if "thick" in note]
    assert len(notes) == bool(told)
    modes = one.model_copy(update={"modal": ModalSettings()})
    assert not [note for note in check(modes, modes.read_body()) if "thick" in note]
    for note in notes:
        assert told in note
        assert note.startswith("materials.steel.allowable: the yield stress of ")
        assert keys or "up to 16 mm" in note
        assert keys or note.endswith(
            ": 225 MPa up to 40 mm, 215 MPa up to 100 mm, 195 MPa up to 150 mm"
        )


def test_what_belongs_to_a_line_has_no_label() -> None:
    """The source of a material; and what of the mass is mounted."""
    found = report(
        case(materials={"steel": {"material": "S235"}}, mass=[{"on": "top", "mass": "100 kg"}])
    )
    with redirect_stdout(io.StringIO()) as out:
        show_check(found)
    lines = out.getvalue().splitlines()
    assert [line.split()[1] for line in lines if line.startswith("  material ")] == ["steel:"]
    assert any(line.startswith("               source: steel S235") for line in lines)
    assert any("  mass       4.72e+04 kg, 100 kg of it mounted, centre" in line for line in lines)


def test_shown_and_as_json():
    """The screen keeps to 100 columns, and JSON has the same numbers."""
    loads = [{"kind": "gravity"}, {"kind": "traction", "on": "top", "value": [100, 0, 0]}]
    found = report(case(load=loads))
    with redirect_stdout(io.StringIO()) as out:
        show_check(found)
    text = out.getvalue()
    assert max(map(len, text.splitlines())) <= 100
    assert "\n\n\n" not in text
    assert "mass       6000 kg, centre of mass (1, 0.5, 1.5) m" in text
    assert "all loads" in text
    assert "Loads are summed up on the undeformed body, each at load parameter 1." in text
    assert "is constrained against every rigid motion" in text
    read = json.loads(json.dumps(asdict(found), allow_nan=False))
    assert read["loads"][2]["force"] == pytest.approx([200, 0, -58860])
    assert read["memory"]["solver"] == "direct"
    assert read["bodies"] == [{"name": "", "motions": []}]


# --- materials ---

FITTED = {"law": "mooney-rivlin", "c10": "-0.25 MPa", "c01": "0.9 MPa", "nu": 0.49}


@pytest.mark.long
@pytest.mark.usefixtures("serial_only")
def test_unstable_constants_are_named_with_their_range():
    """A note with the constant, in one line; other laws have none, or what is theirs anyway."""

    def found(material: dict[str, Any]) -> tuple[str, str]:
        given = case(materials={"r": material})
        made = report(given)
        notes = [note for note in made.notes if "stable" in note]
        return "\n".join(notes), "\n".join(made.information)

    note, _ = found(FITTED)
    assert note.startswith("materials.r: with c10 = -2.5e+05 Pa the law 'mooney-rivlin' is stable")
    assert "stretch 0.53 to 1.6 (uniaxial), stretch 0.65 to 1.4 (equibiaxial)" in note
    assert "\n" not in note
    note, _ = found({"law": "yeoh", "c10": "0.19 MPa", "c20": "-50 kPa", "nu": 0.45})
    assert "c20 = -5e+04 Pa" in note
    note, information = found({"law": "st-venant-kirchhoff", "E": "1 MPa", "nu": 0.3})
    assert not note
    assert "'st-venant-kirchhoff' is stable for stretch 0.59 to 2 (uniaxial)" in information
    assert found(RUBBER) == ("", "")


@pytest.mark.usefixtures("serial_only")
def test_energies_in_F_round_small_strains():
    """Said of formulas with F, C, J and invariants, and not of those in E."""
    parameters = {"mu": 4e5, "lmbda": 2e6}
    trace = "E11 + E22 + E33"
    squares = "E11^2 + E22^2 + E33^2 + 2*(E12^2 + E13^2 + E23^2)"
    in_E = {"energy": f"mu*({squares}) + lmbda/2*({trace})^2", "parameters": parameters}
    in_J = {"energy": "mu/2*(I1 - 3) - mu*ln(J) + lmbda/2*ln(J)^2", "parameters": parameters}
    for law, said in ((in_E, False), (in_J, True)):
        made = report(case(materials={"r": law}))
        text = "\n".join(made.information)
        assert ("materials.r.energy: strains below about 1e-9 lose digits" in text) == said
