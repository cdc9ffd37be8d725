"""Materials that vary in space: fields of mesh files, formulas, directions, safety factors."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
import ufl
from conftest import ROOT
from dolfinx import fem
from mpi4py import MPI
from pydantic import Field

from dolfin_elastic import (
    Dynamics,
    Gravity,
    LinearElastic,
    MooneyRivlin,
    NeoHookean,
    NeoHookeanSplit,
    Problem,
    Selector,
    Statics,
    Support,
    box_body,
    name_parts,
    read_body,
    rectangle_body,
)
from dolfin_elastic.case.case import Case
from dolfin_elastic.case.check.report import report
from dolfin_elastic.case.run import run
from dolfin_elastic.core.errors import InputError, MeshError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.core.units import Stress
from dolfin_elastic.mesh import Body
from dolfin_elastic.mesh.fields import MeshField
from dolfin_elastic.mesh.geometry.simplices import cell_corners
from dolfin_elastic.model.kinematics import green_strain
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.materials.spatial import Direction, Range, direction
from dolfin_elastic.results.evaluate import Evaluator
from dolfin_elastic.results.quantity import Extremes

COMM = MPI.COMM_WORLD
SHARED = ROOT.parent / "shared" / "meshes"
FREE = "free"


def made(action: Callable[[], object]) -> None:
    """Makes a file on rank 0 while the others wait."""
    on_root(COMM, lambda: action() and None)


def middles(body: Body) -> np.ndarray:
    return cell_corners(body.mesh).mean(axis=1)


def largest(values: np.ndarray) -> float:
    return COMM.allreduce(float(np.max(values, initial=-np.inf)), op=MPI.MAX)


def bar(cells: int, n: int = 1, dim: int = 3) -> Body:
    """1 x 0.1 x 0.1."""
    if dim == 2:
        return rectangle_body(size=(1.0, 0.1), cells=(cells, n))
    return box_body(size=(1.0, 0.1, 0.1), cells=(cells, n, n))


def pulled(body: Body, laws: Any, degree: int = 1, by: float = 0.01) -> tuple[Problem, Any]:
    """Stretched along x with all lateral displacement blocked where nothing moves freely."""
    sides = ["bottom", "top"] if body.dim == 2 else ["bottom", "top", "front", "back"]
    axis = {"bottom": 2, "top": 2, "front": 1, "back": 1} if body.dim == 3 else {}
    held = [
        Support(
            on=side,
            displacement=[
                0 if i == axis.get(side, body.dim - 1) else FREE for i in range(body.dim)
            ],
        )
        for side in sides
    ]
    ends = [
        Support(on="left", displacement=[0] + [FREE] * (body.dim - 1)),
        Support(on="right", displacement=[by] + [FREE] * (body.dim - 1)),
    ]
    problem = Problem(body, laws, supports=[*held, *ends], degree=degree)
    *_, state = Statics(problem).steps()
    return problem, state


# --- bars in series and in parallel ---


def halves(body: Body, axis: int = 0, names: tuple[str, str] = ("one", "two")) -> Body:
    low, high = [0.0, 0.0, 0.0], [1.0, 0.1, 0.1]
    middle = [*high]
    middle[axis] = high[axis] / 2
    start = [*low]
    start[axis] = middle[axis]
    return name_parts(
        body,
        regions={
            names[0]: Selector(box=(low, middle)),
            names[1]: Selector(box=(start, high)),
        },
    )


def modulus(E: float, nu: float) -> float:
    """Of a bar that cannot move sideways."""
    return E * (1 - nu) / ((1 + nu) * (1 - 2 * nu))


TWO = {"one": LinearElastic(E=1e9, nu=0.3), "two": LinearElastic(E=3e9, nu=0.2)}
ONE, OTHER = modulus(1e9, 0.3), modulus(3e9, 0.2)
AREA, BY = 0.01, 0.01


def at_x(problem: Problem, x: float) -> np.ndarray:
    """Displacements along x at the nodes of a plane, of all ranks."""
    places = problem.V.tabulate_dof_coordinates()
    near = np.abs(places[:, 0] - x) < 1e-9
    own = problem.u.x.array.reshape(-1, problem.body.dim)[near, 0]
    return np.concatenate(COMM.allgather(own))


@pytest.mark.parametrize("degree", [1, 2])
def test_bars_in_series(degree: int) -> None:
    problem, state = pulled(halves(bar(4)), TWO, degree)
    stiffness = AREA / (0.5 / ONE + 0.5 / OTHER)
    assert state.reactions["right"][0] == pytest.approx(stiffness * BY, rel=1e-10)
    interface = BY * (0.5 / ONE) / (0.5 / ONE + 0.5 / OTHER)
    found = at_x(problem, 0.5)
    assert len(found) >= 4
    np.testing.assert_allclose(found, interface, rtol=1e-10)


def test_bars_in_parallel() -> None:
    """Without Poisson's effect, for with it the bars would push each other aside."""
    laws = {"one": LinearElastic(E=1e9, nu=0), "two": LinearElastic(E=3e9, nu=0)}
    problem, state = pulled(halves(bar(4, 2), axis=2), laws)
    assert state.reactions["right"][0] == pytest.approx(AREA / 2 * 4e9 * BY, rel=1e-10)
    np.testing.assert_allclose(at_x(problem, 0.5), BY / 2, rtol=1e-10)


@pytest.mark.parametrize("degree", [1, 2])
def test_a_jump_along_facets_is_two_regions(degree: int) -> None:
    """The same two bars from one law whose constants jump."""
    law = LinearElastic(E="where(x < 0.5, 1e9, 3e9)", nu="where(x < 0.5, 0.3, 0.2)")
    _, state = pulled(bar(4), law, degree)
    stiffness = AREA / (0.5 / ONE + 0.5 / OTHER)
    assert state.reactions["right"][0] == pytest.approx(stiffness * BY, rel=1e-10)


def test_what_varies_is_on_one_rank_only() -> None:
    """Two bars in series, the short one of two cells: ranks without one go the same way."""
    short = Selector(box=((0.875, 0, 0), (1, 0.1, 0.1)))
    rest = Selector(box=((0, 0, 0), (0.875, 0.1, 0.1)))
    body = name_parts(bar(8, dim=2), regions={"short": short, "rest": rest})
    laws = {
        "short": NeoHookeanSplit(mu="1e9 + 0*x", nu="0.3 + 0*x"),
        "rest": LinearElastic(E="1e9 + 0*x", nu="0.3 + 0*x"),
    }
    by = 1e-7  # small enough for Hooke's law
    _, state = pulled(body, laws, by=by)
    tip = 1e9 * 2 * 0.7 / 0.4  # lambda + 2 mu
    stiffness = 0.1 / (0.125 / tip + 0.875 / ONE)
    assert state.reactions["right"][0] == pytest.approx(stiffness * by, rel=1e-6)


@pytest.mark.skipif(not SHARED.is_dir(), reason="the folder ../shared/meshes is absent")
def test_two_named_regions_of_a_real_file() -> None:
    """Two tetrahedra glued at z = 0, their apexes held: two springs of stiffness M/6 each."""
    body = read_body(SHARED / "two_regions_named_v41.msh")
    assert set(body.regions) == {"upper", "lower"}
    body = name_parts(body, surfaces={"outside": Selector(all=True)})
    laws = {"upper": TWO["one"], "lower": TWO["two"]}
    held = [Support(on="outside"), Support(on="interface", displacement=[0, 0, 0.01])]
    *_, state = Statics(Problem(body, laws, supports=held, degree=1)).steps()
    force = (ONE + OTHER) / 6 * 0.01
    assert state.reactions["interface"][2] == pytest.approx(force, rel=1e-10)
    assert state.reactions["outside"][2] == pytest.approx(-force, rel=1e-10)


# --- formulas against closed forms ---


@pytest.mark.parametrize(("degree", "rate"), [(1, 2), (2, 4)])
def test_bar_with_a_graded_modulus(degree: int, rate: int) -> None:
    """Force over stretch is 1 / integral of 1/(E A), here E = 1e6 (1 + x)^2: A 2e6."""
    errors = []
    for n in (4, 8):
        _, state = pulled(bar(n, dim=2), LinearElastic(E="1e6*(1 + x)^2", nu=0), degree)
        errors.append(abs(state.reactions["right"][0] / (0.1 * 2e6 * BY) - 1))
    assert errors[1] < 0.01
    assert np.log2(errors[0] / errors[1]) > rate - 0.2


def test_density_varies_in_weight_and_inertia() -> None:
    """rho = 1000 (1 + 2 z/0.1): the mean is 2000, so is the mass of 0.01 m^3 times it."""
    law = LinearElastic(E=1e6, nu=0.3, density="1000*(1 + 2*z/0.1)")
    for degree in (1, 2):
        problem = Problem(
            bar(4), law, supports=[Support(on="bottom")], loads=[Gravity()], degree=degree
        )
        *_, state = Statics(problem).steps()
        assert state.reactions["bottom"][2] == pytest.approx(20 * 9.81, rel=1e-10)
        one = ufl.as_vector([0.0, 0.0, 1.0])
        mass = fem.form(ufl.action(problem.weak_form.inertia(one, problem.v), _ones(problem)))
        assert COMM.allreduce(fem.assemble_scalar(mass)) == pytest.approx(20, rel=1e-10)


def _ones(problem: Problem) -> fem.Function:
    ones = fem.Function(problem.V)
    ones.x.array[:] = 1
    return ones


@pytest.mark.long
def test_weight_of_a_region_with_varying_density() -> None:
    body = halves(bar(4))
    laws = {
        "one": LinearElastic(E=1e6, nu=0.3, density="1000*(1 + x)"),
        "two": LinearElastic(E=1e6, nu=0.3, density=10),
    }
    for degree in (1, 2):
        loads = [Gravity(on="one"), Gravity(on="two")]
        problem = Problem(body, laws, supports=[Support(on="bottom")], loads=loads, degree=degree)
        *_, state = Statics(problem).steps()
        weight = 9.81 * AREA * (1000 * (0.5 + 0.125) + 10 * 0.5)
        assert state.reactions["bottom"][2] == pytest.approx(weight, rel=1e-10)


def test_explicit_motion_of_a_varying_material() -> None:
    """Momentum of a free fall is g M t whatever varies."""
    law = LinearElastic(E="1e5*(1 + x)", nu=0.2, density="1000*(2 - x)")
    problem = Problem(bar(4), law, loads=[Gravity()], degree=1)
    *_, state = Dynamics(problem, end=1e-3, scheme="symplectic-euler").steps()
    assert state.momenta["linear"][2] == pytest.approx(-9.81 * 15 * 1e-3, rel=1e-9)


PAIRS = {"E": 2e6, "nu": 0.25, "K": 4e6 / 3, "lmbda": 8e5, "mu": 8e5}


@pytest.mark.long
@pytest.mark.parametrize("pair", [("E", "nu"), ("E", "lmbda"), ("nu", "K"), ("K", "mu")])
def test_any_two_constants_that_vary(pair: tuple[str, str]) -> None:
    """A formula that gives the same number everywhere is that number."""
    given = {name: f"{PAIRS[name]!r}*(1 + 0*x)" for name in pair}
    _, varied = pulled(bar(2), NeoHookean(**given))
    _, plain = pulled(bar(2), NeoHookean(E=2e6, nu=0.25))
    assert varied.reactions["right"] == pytest.approx(plain.reactions["right"], rel=1e-10)
    one_number = {pair[0]: given[pair[0]], pair[1]: PAIRS[pair[1]]}
    _, mixed = pulled(bar(2), NeoHookean(**one_number))
    assert mixed.reactions["right"] == pytest.approx(plain.reactions["right"], rel=1e-10)


@pytest.mark.long
def test_a_volume_that_varies_beside_the_shape() -> None:
    """Of a law with constants of its own for the shape, K comes from nu at each place."""
    given = {"c10": 3e5, "c01": 1e5, "nu": 0.3}
    _, plain = pulled(bar(2), MooneyRivlin(**given))
    _, varied = pulled(bar(2), MooneyRivlin(**{n: f"{v!r} + 0*x" for n, v in given.items()}))
    assert varied.reactions["right"] == pytest.approx(plain.reactions["right"], rel=1e-10)


def test_another_formula_compiles_nothing() -> None:
    problems = [
        Problem(bar(2), NeoHookean(E=E, nu=nu, density=rho), loads=[Gravity()], degree=1)
        for E, nu, rho in (("1e6*(1 + x)", 0.3, "10*(1 + y)"), ("sin(x) + 7e5", 0.1, "5 + z"))
    ]
    for name in ("residual", "tangent", "strain_energy", "external"):
        one, other = (getattr(problem.weak_form, name).signature() for problem in problems)
        assert one == other


@pytest.mark.long
def test_the_cache_does_not_grow(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Counted in the folder itself, through solves with other formulas and numbers."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder))
    counts = []
    for E, nu in (("1e6*(1 + x)", 0.3), ("2e9 + 1e9*sin(y)", 0.1)):
        pulled(bar(2, dim=2), LinearElastic(E=E, nu=nu))
        COMM.barrier()
        counts.append(COMM.bcast(len(list(folder.rglob("*.c")))))
    assert counts[0] == counts[1] >= 2


def test_typical_law_has_numbers_only() -> None:
    law = LinearElastic(E="2e6*x", nu=0.25, density=3)
    (bound,) = Problem(bar(8), law).regions
    assert pytest.approx(1e6, rel=1e-12) == bound.typical.E
    assert bound.typical.mu == pytest.approx(4e5, rel=1e-12)
    assert bound.typical.spatial_constants() == {}


# --- fields of mesh files ---


def blocks(n: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Points and tetrahedra of the unit cube, six in each little cube."""
    grid = np.stack(np.meshgrid(*[np.arange(n + 1)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    number = {tuple(row): i for i, row in enumerate(grid.tolist())}
    cells = []
    for corner in grid[(grid < n).all(axis=1)]:
        for order in ((0, 1, 2), (1, 2, 0), (2, 0, 1), (0, 2, 1), (2, 1, 0), (1, 0, 2)):
            path = [corner]
            for axis in order:
                path.append(path[-1] + np.eye(3, dtype=int)[axis])
            cells.append([number[tuple(p.tolist())] for p in path])
    return grid / n, np.array(cells)


def rho(x: np.ndarray) -> np.ndarray:
    return 1000 * (1 + x[..., 0] + x[..., 1] * x[..., 2])


def warm(x: np.ndarray) -> np.ndarray:
    return 20 + x[..., 0] - 2 * x[..., 1] + 3 * x[..., 2]


def turned(x: np.ndarray) -> np.ndarray:
    return np.stack([np.cos(x[..., 2]), np.sin(x[..., 2]), 0 * x[..., 2]], axis=-1)


def write_meshio(path: Path) -> None:
    import meshio

    points, cells = blocks()
    # Points that no cell uses and a cell that stands twice: the rows of data must follow.
    points = np.concatenate([[[9.0, 9, 9]], points, [[8.0, 8, 8]]])
    cells = cells + 1
    if path.suffix != ".xdmf":
        cells = np.concatenate([cells[5:6], cells])
    middle = points[cells].mean(axis=1)
    tag = (middle[:, 0] > 0.5).astype(np.int32)
    cell_data = {"rho": [rho(middle)], "fibre": [turned(middle)]}
    if path.suffix not in (".xdmf", ".med"):
        cell_data["tag"] = [tag]
    meshio.Mesh(
        points,
        [("tetra", cells)],
        point_data={"warm": warm(points)},
        cell_data=cell_data,
    ).write(path)


def check_fields(body: Body) -> None:
    cells = body.owned_cells()
    barycentre = np.full((1, 3), 0.25)
    x = middles(body)
    found = {n: f.at(body.mesh, cells, barycentre)[:, 0] for n, f in body.fields.items()}
    np.testing.assert_allclose(found["rho"][:, 0], rho(x), rtol=1e-12)
    np.testing.assert_allclose(found["warm"][:, 0], warm(x), rtol=1e-12)
    np.testing.assert_allclose(found["fibre"], turned(x), rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", ["a.vtu", "a.vtk", "a.xdmf", "a.med"])
def test_fields_of_meshio_files(folder: Path, name: str) -> None:
    made(lambda: write_meshio(folder / name))
    body = read_body(folder / name)
    assert body.num_cells == 162
    assert set(body.fields) == {"rho", "warm", "fibre"}
    check_fields(body)
    if name[2:] in ("vtu", "vtk"):
        assert set(body.regions) == {"tag_0", "tag_1"}
    check_fields(name_parts(body, regions={"near": Selector(box=((0, 0, 0), (0.5, 1, 1)))}))


@pytest.mark.parametrize("version", [2.2, 4.1])
@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize("order", [1, 2])
def test_fields_of_gmsh_files(folder: Path, version: float, binary: bool, order: int) -> None:
    path = folder / "a.msh"
    made(lambda: write_gmsh(path, version, binary, order))
    check_fields(read_body(path))


def write_gmsh(path: Path, version: float, binary: bool, order: int) -> None:
    import gmsh

    gmsh.initialize(readConfigFiles=False, interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.add("a")
        gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
        gmsh.model.occ.synchronize()
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.5)
        gmsh.model.mesh.generate(3)
        gmsh.model.mesh.setOrder(order)
        gmsh.option.setNumber("Mesh.MshFileVersion", version)
        gmsh.option.setNumber("Mesh.Binary", binary)
        nodes, x, _ = gmsh.model.mesh.getNodes()
        x = x.reshape(-1, 3)
        place = dict(zip(nodes.tolist(), x, strict=True))
        (elements,), (corners,) = gmsh.model.mesh.getElements(3)[1:]
        corners = corners.reshape(len(elements), -1)[:, :4]
        middle = np.array([[place[n] for n in row] for row in corners.tolist()]).mean(axis=1)
        views = []
        for name, kind, tags, data in (
            ("rho", "ElementData", elements, rho(middle)[:, None]),
            ("fibre", "ElementData", elements, turned(middle)),
            ("warm", "NodeData", nodes, warm(x)[:, None]),
        ):
            view = gmsh.view.add(name)
            gmsh.view.addModelData(view, 0, "a", kind, tags, data)
            views.append(view)
        gmsh.write(str(path))
        gmsh.option.setNumber("PostProcessing.SaveMesh", 0)
        for view in views:
            gmsh.view.write(view, str(path), append=True)
    finally:
        gmsh.finalize()


def test_fields_of_dolfinx_files(folder: Path) -> None:
    """XDMF is read in shares; a vector of the points is written beside a scalar of the cells."""
    from dolfinx.io import XDMFFile

    body = box_body(size=(1, 1, 1), cells=(3, 3, 3))
    one = fem.Function(fem.functionspace(body.mesh, ("DG", 0)), name="rho")
    one.interpolate(lambda x: rho(x.T))
    two = fem.Function(fem.functionspace(body.mesh, ("Lagrange", 1)), name="warm")
    two.interpolate(lambda x: warm(x.T))
    three = fem.Function(fem.functionspace(body.mesh, ("DG", 0, (3,))), name="fibre")
    three.interpolate(lambda x: turned(x.T).T)
    with XDMFFile(COMM, str(folder / "a.xdmf"), "w") as file:
        file.write_mesh(body.mesh)
        for function in (one, two, three):
            file.write_function(function)
    COMM.barrier()
    body = read_body(folder / "a.xdmf")
    assert set(body.fields) == {"rho", "warm", "fibre"}
    check_fields(body)


def test_a_case_over_fields_of_a_file(folder: Path) -> None:
    """A field is the formula it was made of; density to modulus as in bone."""
    made(lambda: write_meshio(folder / "a.vtu"))

    def reactions(E: Any, density: Any) -> np.ndarray:
        material = {"law": "linear-elastic", "E": E, "nu": 0.3, "density": density}
        case = Case.from_dict(
            {
                "mesh": {"file": "a.vtu", "degree": 1},
                "surfaces": {
                    n: {"plane": "z", "at": at} for n, at in (("foot", "min"), ("lid", "max"))
                },
                "materials": {"bone": material},
                "support": [{"on": "foot"}, {"on": "lid", "displacement": [0, 0, -0.01]}],
                "load": [{"kind": "gravity"}],
            },
            folder,
        )
        assert Case.from_dict(case.to_dict(), folder).to_dict() == case.to_dict()
        assert "bone" in case.to_toml()
        told = report(case)
        assert told.cells == 162
        assert [text.split(":")[0] for text in told.fields] == ["fibre", "rho", "warm"]
        # Results have a field of that name, the direction of fibres.
        assert told.fields[0] == "fibre: cells, 3 components; in results 'fibre_of_mesh'"
        assert told.fields[2] == "warm: points, 18 to 24"
        *_, state = run(case, output=folder / "out")
        return np.array(state.reactions["foot"])

    formula = "1000*(1 + x + y*z)"
    of_field = reactions("6850e6*(rho/1000)^1.49", {"field": "rho", "unit": "kg/m^3"})
    of_place = reactions(f"6850e6*(({formula})/1000)^1.49", formula)
    np.testing.assert_allclose(of_field, of_place, rtol=1e-9)
    in_MPa = reactions({"field": "rho", "unit": "MPa"}, "rho")
    in_Pa = reactions("rho*1e6", formula)
    np.testing.assert_allclose(in_MPa, in_Pa, rtol=1e-9)


# --- what is refused ---


def with_fields(body: Body, **fields: np.ndarray) -> Body:
    cells = {n: MeshField("cell", f.reshape(len(f), -1)) for n, f in fields.items()}
    return replace(body, fields={**body.fields, **cells})


def complaint(law: dict[str, Any], **fields: np.ndarray) -> str:
    """What making a problem says, the same on all ranks."""
    with pytest.raises(InputError) as caught:
        body = with_fields(bar(4), **fields)
        Problem(body, LinearElastic(**{"E": 1e9, "nu": 0.3, **law}), degree=1)
    said = COMM.allgather(str(caught.value))
    assert len(set(said)) == 1
    assert caught.value.exit_code == 2
    return said[0]


def cells_of(value: Any) -> np.ndarray:
    x = middles(bar(4))
    return np.array([value(p) if callable(value) else value for p in x], dtype=float).reshape(
        len(x), -1
    )


@pytest.mark.parametrize(
    ("law", "said"),
    [
        ({"E": "1e9*(roh/1000)"}, "E: unknown name 'roh'; did you mean 'rho'?\n    1e9*(roh/"),
        ({"E": "1e9*t"}, "E: unknown name 't'; known: e, flow, holes, pi, rho, x, y, z"),
        (
            {"E": {"field": "roh"}},
            "E.field: no field 'roh' in box 1 x 0.1 x 0.1; did you mean 'rho'",
        ),
        (
            {"E": {"field": "rho", "unit": "kg"}},
            "E.unit: 'kg' has the wrong unit; expected a unit ",
        ),
        ({"E": {"feld": "rho"}}, "E: unknown key 'feld'; did you mean 'field'?"),
        ({"E": {"field": "flow"}}, "E.field: the field 'flow' has 3 components; expected a scalar"),
        ({"E": "flow + 1"}, "E: the field 'flow' has 3 components; expected a scalar"),
        (
            {"E": "1e9*holes"},
            "E: the field 'holes' of box 1 x 0.1 x 0.1 has no finite value in 12 ",
        ),
        ({"E": "1e9*(0.5 - x)"}, "to 4.375e+08; E must be above 0"),
        ({"E": "1e9/(x - x)"}, "E: inf at (0.9375, "),
        ({"nu": "x"}, "nu must be above -1 and below 0.5"),
        ({"density": "x - 10"}, "density must be above 0"),
        ({"allowable": "-x"}, "allowable must be above 0"),
        ({"E": "1e9*(x"}, "this parenthesis is never closed"),
        ({"E": "2 mmm"}, "unknown unit 'mmm'"),
    ],
)
def test_what_is_refused(law: dict[str, Any], said: str) -> None:
    fields = {
        "rho": cells_of(1.0),
        "flow": cells_of([1.0, 0, 0]),
        "holes": cells_of(lambda p: np.nan if p[0] > 0.5 else 1.0),
    }
    assert said in complaint(law, **fields)


def test_values_and_places_are_told() -> None:
    text = complaint({"E": "1e9*(0.5 - x)"})
    assert text.startswith("E: -4.375e+08 at (0.9375, ")
    assert "is not possible; the values run from -4.375e+08 to 4.375e+08; E must be above 0" in text


def test_an_unstable_pair_is_told() -> None:
    with pytest.raises(InputError, match="no stable elastic solid: "):
        Problem(bar(4), LinearElastic(E=2e6, K="1e4 + 1e6*x"), degree=1)


def test_names_are_looked_up_by_check(folder: Path) -> None:
    """The key is that of the case, also where one material fills the body."""
    made(lambda: write_meshio(folder / "a.vtu"))
    case = Case.from_dict(
        {
            "mesh": {"file": "a.vtu", "degree": 1},
            "materials": {"hard bone": {"law": "linear-elastic", "E": "1e9*roh", "nu": 0.3}},
        },
        folder,
        file="case.toml",
    )
    with pytest.raises(InputError) as caught:
        report(case)
    assert str(caught.value) == (
        "case.toml: materials.\"hard bone\".E: unknown name 'roh'; did you mean 'rho'?\n"
        "    1e9*roh\n"
        "        ^"
    )


def test_a_damaged_field_of_a_gmsh_file(folder: Path) -> None:
    path = folder / "a.msh"
    made(lambda: write_gmsh(path, 4.1, False, 1))

    def cut() -> None:
        text = path.read_text()
        at = text.index("$EndElementData")
        path.write_text(text[: at - 20] + "\n" + text[at:])

    made(cut)
    with pytest.raises(MeshError, match=r"a.msh: section \$ElementData of 'rho' does not hold"):
        read_body(path)


def test_an_xdmf_field_of_the_wrong_size(folder: Path) -> None:
    import h5py

    path = folder / "a.xdmf"

    def spoil() -> None:
        write_meshio(path)
        text = path.read_text()
        with h5py.File(path.with_suffix(".h5"), "a") as file:
            name = next(n for n in file if file[n].shape == (162,))
            data = file[name][:100]
            del file[name]
            file[name] = data
        path.write_text(text.replace('Dimensions="162"', 'Dimensions="100"'))

    made(spoil)
    with pytest.raises(MeshError, match="a.xdmf: the field 'rho': it has 100 rows, but"):
        read_body(path)


# --- directions ---


class Fibres(Law):
    """Stiff along a direction that varies: for tests only."""

    law: str = "fibres"
    mu: Stress = Field(default=1e6, gt=0)
    k: Stress = 1e7
    fibre: Direction
    linear: ClassVar[bool] = False
    directions: ClassVar[tuple[str, ...]] = ("fibre",)

    def energy(self, F: Any) -> Any:
        C, E = F.T * F, green_strain(F)
        a = direction(self.fibre)
        return self.mu * ufl.inner(E, E) + self.k / 8 * (ufl.inner(a, C * a) - 1) ** 2


def fibre_energy(fibre: Any, degree: int = 1, body: Body | None = None) -> float:
    """Energy of a cube stretched along x."""
    body = body or box_body(size=(1, 1, 1), cells=(4, 4, 4))
    problem = Problem(body, Fibres(fibre=fibre), degree=degree)
    problem.u.interpolate(lambda x: np.stack([0.1 * x[0], 0 * x[1], 0 * x[2]]))
    return COMM.allreduce(fem.assemble_scalar(fem.form(problem.weak_form.strain_energy)))


BASE = 1e6 * 0.105**2
ALONG = 1e7 / 8 * 0.21**2


@pytest.mark.parametrize("degree", [1, 2])
def test_directions(degree: int) -> None:
    assert fibre_energy([2, 0, 0], degree) == pytest.approx(BASE + ALONG, rel=1e-12)
    assert fibre_energy([0, 1, 0], degree) == pytest.approx(BASE, rel=1e-12)
    half = fibre_energy(["3*cos(pi/4 + 0*x)", "3*sin(pi/4)", 0], degree)
    assert half == pytest.approx(BASE + ALONG / 4, rel=1e-12)
    # cos^4 over a quarter turn is 3/8; the rule of one point or of degree 2 is near it.
    turning = fibre_energy(["cos(pi/2*z)", "sin(pi/2*z)", 0], degree)
    assert turning == pytest.approx(BASE + ALONG * 3 / 8, rel=1e-2 if degree == 1 else 1e-4)


def test_directions_of_the_mesh() -> None:
    body = box_body(size=(1, 1, 1), cells=(4, 4, 4))
    x = middles(body)
    angle = np.pi / 2 * x[:, 2]
    body = with_fields(body, fibre=5 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1))
    found = fibre_energy({"field": "fibre"}, body=body)
    formula = fibre_energy(["cos(pi/2*z)", "sin(pi/2*z)", 0], body=body)
    assert found == pytest.approx(formula, rel=1e-12)
    with pytest.raises(InputError, match="fibre: the direction has the length 0 at "):
        fibre_energy(["where(x < 0.5, 0, 1)", 0, 0], body=body)
    with pytest.raises(InputError, match="fibre: a direction needs a length"):
        fibre_energy([0, 0, 0], body=body)
    with pytest.raises(InputError, match=r"fibre\[1\]: a value is missing"):
        fibre_energy([0, "x*", 0], body=body)
    with pytest.raises(InputError, match="has 1 component"):
        fibre_energy({"field": "one"}, body=with_fields(body, one=angle))


def test_bounds_of_a_law_hold_where_it_varies() -> None:
    """pydantic's own bounds, for numbers at once and for the rest on the body."""
    for key in ("mu", "density", "allowable"):
        with pytest.raises(InputError, match=f"{key}: -1.* is wrong; expected a number above 0"):
            Fibres(**{key: -1, "fibre": [1, 0, 0]})
    law = Fibres(mu="1e6*(0.5 - x)", fibre=[1, 0, 0])
    with pytest.raises(InputError, match="mu: -437500 at .* mu must be above 0"):
        Problem(bar(4), law, degree=1)
    Problem(bar(4), Fibres(mu="1e6*(2 - x)", fibre=[1, 0, 0]), degree=1)


# --- results ---


def test_safety_factor_and_constants_as_fields(folder: Path) -> None:
    laws = {
        "one": LinearElastic(E="1e9*(1 + x)", nu=0, density=7, allowable="40 MPa"),
        "two": LinearElastic(E=3e9, nu=0),
    }
    problem, state = pulled(halves(bar(4)), laws)
    names = ("safety_factor", "young_modulus", "density", "von_mises")
    values = Evaluator(problem, names)(state)
    x = middles(problem.body)[:, 0]
    one = x < 0.5
    np.testing.assert_allclose(
        values["young_modulus"][:, 0], np.where(one, 1e9 * (1 + x), 3e9), rtol=1e-12
    )
    np.testing.assert_array_equal(values["density"][:, 0], np.where(one, 7, np.nan))
    factor = values["safety_factor"][:, 0]
    own = problem.V.dofmap.index_map.size_local
    one = problem.V.tabulate_dof_coordinates()[:own, 0] < 0.5 - 1e-9
    np.testing.assert_allclose(factor[one], 40e6 / values["von_mises"][one, 0], rtol=1e-12)
    beyond = problem.V.tabulate_dof_coordinates()[:own, 0] > 0.5 + 1e-9
    assert np.isnan(factor[beyond]).all()
    one = ~beyond  # the interface has the factor of the material that has one
    smallest = Extremes(problem).of(state)["safety_factor"]
    own = factor[one].min(initial=np.inf)
    assert smallest.value == pytest.approx(COMM.allreduce(own, op=MPI.MIN), rel=1e-12)
    assert smallest.part == "one" and smallest.place[0] <= 0.5 + 1e-9


def test_safety_factor_in_a_case(folder: Path) -> None:
    tables: dict[str, Any] = {
        "mesh": {"box": {"size": [1, 0.1, 0.1], "cells": [4, 1, 1]}, "degree": 1},
        "materials": {
            "part": {"law": "linear-elastic", "E": "1 GPa", "nu": 0, "allowable": "40 MPa"}
        },
        "support": [{"on": "left"}],
        "load": [{"kind": "traction", "on": "right", "value": ["10 MPa", 0, 0]}],
        "output": {"fields": ["safety_factor", "young_modulus"], "folder": "out"},
    }
    case = Case.from_dict(tables, folder)
    *_, _state = run(case)
    summary = on_root(COMM, lambda: json.loads((folder / "out/summary.json").read_text()))
    found = summary["extremes"]["safety_factor"]
    assert found["value"] == pytest.approx(4, rel=1e-9)
    assert found["part"] == "part" and len(found["place"]) == 3
    del tables["materials"]["part"]["allowable"]
    with pytest.raises(InputError, match="no material has an allowable stress"):
        report(Case.from_dict(tables, folder))


def test_how_far_values_lie_outside_of_a_range():
    """Of several the farthest is named, be it less than one outside or more."""
    values = np.array([0.0, 0.5, 1.0, 1.25, 1.75, -3.0, np.nan, np.inf])
    found = Range(low=0.0, high=1.0, high_too=True).distance(values)
    np.testing.assert_array_equal(found, [0.0, -1, -1, 0.25, 0.75, 3.0, np.inf, np.inf])


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (Range(low=0.0, high=0.5), "above 0 and below 0.5"),
        (Range(low=-1.0, low_too=True), "at least -1"),
        (Range(high=2.0, high_too=True), "at most 2"),
        (Range(), "a finite number"),
    ],
)
def test_ranges_in_words(values: Range, words: str):
    assert str(values) == words
