"""A pressure for each material: where it is doubled, and that all around it stays as it was.

The reference is a stack of two layers that is stretched along them, free across: the strain is the
same everywhere and the stress in each layer uniform, so quadratic elements hold the solution, but
only with a pressure that jumps.  Everything is exact to round-off.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from dolfinx import fem
from mpi4py import MPI

from dolfin_elastic import (
    Growth,
    LinearElastic,
    NeoHookean,
    NeoHookeanSplit,
    Periodic,
    Problem,
    Selector,
    Statics,
    Support,
    box_body,
    name_parts,
)
from dolfin_elastic.core.parallel import largest, smallest, total
from dolfin_elastic.mesh import Body
from dolfin_elastic.mesh.refine.refinement import refine_body
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.problem import problem as problems
from dolfin_elastic.problem.pressure.groups import pressure_groups
from dolfin_elastic.results.checkpoint.mesh_order import DofOrdering
from dolfin_elastic.solvers.linear.choice import LinearSettings
from dolfin_elastic.study.converge.converge import refined_unknowns

COMM = MPI.COMM_WORLD
FREE = "free"
STRAIN = 1e-3
MU = {"low": 1e6, "high": 1e5}


def layered(dim: int, cells: int = 4) -> Body:
    """The unit cube or square in two layers across its last direction."""
    body = box_body(size=(1.0,) * dim, cells=(cells - 1,) * (dim - 1) + (cells,))
    halves = {"low": ([0.0] * dim, [*[1.0] * (dim - 1), 0.5])}
    halves["high"] = ([*[0.0] * (dim - 1), 0.5], [1.0] * dim)
    regions = {name: Selector(box=[*map(tuple, ends)]) for name, ends in halves.items()}
    return name_parts(body, regions=regions)


def stretched(dim: int, laws: dict[str, Law], body: Body | None = None, **more: Any) -> Problem:
    """Along x; in space the strain across y is none, too."""
    sides = [
        Support(on="left", displacement=[0, *[FREE] * (dim - 1)]),
        Support(on="right", displacement=[STRAIN, *[FREE] * (dim - 1)]),
        Support(on="bottom", displacement=[*[FREE] * (dim - 1), 0]),
    ]
    if dim == 3:
        sides.append(Support(on=["front", "back"], displacement=[FREE, 0, FREE]))
    return Problem(body or layered(dim), laws, degree=2, supports=sides, **more)


def elastic(nu: float) -> dict[str, Law]:
    return {name: LinearElastic(mu=mu, nu=nu) for name, mu in MU.items()}


def pressure_range(problem: Problem, name: str) -> tuple[float, float]:
    """Smallest and largest pressure of a region [Pa], as an unknown."""
    (region,) = (part for part in problem.regions if part.name == name)
    rows = problem.w.x.array[problem.W.sub(1).dofmap.list[region.cells]]
    rows = rows * float(problem.unknowns.scale["pressure"].value)
    low, high = rows.min(initial=np.inf), rows.max(initial=-np.inf)
    return smallest(COMM, float(low)), largest(COMM, float(high))


@pytest.mark.parametrize("method", ["direct", "iterative"])
@pytest.mark.parametrize("nu", [0.4999, 0.5])
@pytest.mark.parametrize("dim", [2, 3])
def test_two_layers(dim, nu, method):
    """Plane strain, nothing across: sigma_xx = 2 mu/(1 - nu) eps; the unknown is lmbda tr eps."""
    problem = stretched(dim, elastic(nu))
    tight = LinearSettings(method=method, petsc={"ksp_rtol": 1e-12} if method != "direct" else {})
    *_, state = Statics(problem, linear=tight, rtol=1e-10).steps()
    for name, mu in MU.items():
        wanted = 2 * mu * nu / (1 - nu) * STRAIN
        assert pressure_range(problem, name) == pytest.approx((wanted, wanted), rel=1e-7)
    force = sum(mu / (1 - nu) * STRAIN for mu in MU.values())
    assert state.reactions["right"][0] == pytest.approx(force, rel=1e-9)
    assert state.audit is not None
    assert state.audit.verdict == "pass"


@pytest.mark.long
def test_iterations_are_those_of_one_pressure(monkeypatch):
    """The solver does not see that nodes are doubled."""
    counts = []
    for groups in (pressure_groups, lambda *_: None):
        monkeypatch.setattr(problems, "pressure_groups", groups)
        problem = stretched(3, elastic(0.4999))
        *_, state = Statics(problem, linear=LinearSettings(method="iterative")).steps()
        counts.append(state.krylov)
    assert counts[0] <= 1.1 * counts[1] + 2


def doubled_nodes(laws: dict[str, Law], **more: Any) -> int:
    """How many unknowns there are more than with one material."""
    body = layered(2)
    plain = Problem(body, NeoHookean(mu=1.0, nu=0.4999), degree=2)
    return Problem(body, laws, degree=2, **more).num_dofs - plain.num_dofs


SOFT = NeoHookean(mu=1.0, nu=0.4999, density=1.0)


@pytest.mark.parametrize(
    ("other", "loads", "count"),
    [
        (SOFT, [], 0),
        (SOFT.model_copy(update={"density": 2.0, "allowable": 3.0}), [], 0),
        (NeoHookean(mu=2.0, nu=0.4999), [], 4),
        (NeoHookean(mu=1.0, nu=0.499), [], 4),
        (NeoHookean(mu=1.0, nu=0.3), [], 4),
        (SOFT, [Growth(value=[1.1, 1, 1])], 0),
        (SOFT, [Growth(on="high", value=[1.1, 1, 1])], 4),
    ],
    ids=["same", "density", "stiffness", "nu", "no pressure", "growth", "growth of one"],
)
def test_which_materials_share_one(other, loads, count):
    """The same law with the same constants and the same growth; four nodes lie between."""
    assert doubled_nodes({"low": SOFT, "high": other}, loads=loads) == count


def test_constants_that_vary_are_compared_as_written():
    """Two fields with the same mean are two materials."""
    laws = [NeoHookean(mu=f"1e6*({a} + {b}*x)", nu=0.4999) for a, b in ((1, 1), (2, -1))]
    assert doubled_nodes({"low": laws[0], "high": laws[1]}) == 4
    assert doubled_nodes({"low": laws[0], "high": laws[0]}) == 0


def test_a_pressure_is_of_its_group_on_any_ranks():
    """A field that jumps keeps its values through ghosts, checkpoints and their ordering."""
    problem = stretched(2, elastic(0.4999))
    w, table = fem.Function(problem.W), np.asarray(problem.W.sub(1).dofmap.list)
    mesh = problem.body.mesh
    x = mesh.geometry.x[mesh.geometry.dofmap]
    assert problem.unknowns.groups is not None
    values = 10.0 * (1 + problem.unknowns.groups[:, None]) + x[:, :, 0] + x[:, :, 1] / 8
    w.x.array[table] = values
    w.x.scatter_forward()
    np.testing.assert_array_equal(w.x.array[table], values)
    owned = np.unique(table[table < problem.W.dofmap.index_map.size_local])
    assert total(COMM, len(owned)) == problem.unknowns.count("pressure") == 4 * 5 + 4
    # The values in the order of the file, and back in another function.
    order = DofOrdering(problem.W)
    rows = order.rows(w)
    marks = np.arange(rows.first, rows.first + len(rows.values))
    assert total(COMM, float(marks @ rows.values[:, 0])) == pytest.approx(ORDERED, rel=1e-14)
    again = fem.Function(problem.W)
    order.fill(again, rows.values)
    np.testing.assert_array_equal(again.x.array[table], values)


ORDERED = 32848.6875
"""Sum of the values times their places in the file, on one rank."""


def test_transfer_to_a_finer_mesh():
    """Each side of the interface gets the pressure of its own side."""
    coarse = stretched(2, elastic(0.4999))
    [*_] = Statics(coarse).steps()
    refinement = refine_body(coarse.body, coarse.body.owned_cells()[::3])
    fine = stretched(2, elastic(0.4999), refinement.body)
    fine.w.x.array[:] = refined_unknowns(refinement, coarse, coarse.w, fine)
    for name in MU:
        known, found = (pressure_range(p, name) for p in (coarse, fine))
        assert found == pytest.approx(known, rel=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("nu", [0.4999, 0.5])
@pytest.mark.parametrize("dim", [2, 3])
def test_a_periodic_laminate(dim, nu):
    """Below and above the cell other materials meet: displacements are one, pressures are two."""
    gradient: list[list[Any]] = np.eye(dim).tolist()
    gradient[0][0] += STRAIN
    gradient[-1][-1] = FREE
    pairs = [["left", "right"], ["front", "back"], ["bottom", "top"]]
    if dim == 2:
        pairs.pop(1)
    problem = Problem(
        layered(dim), elastic(nu), degree=2, periodic=Periodic(pairs=pairs, gradient=gradient)
    )
    *_, state = Statics(problem).steps()
    for name, mu in MU.items():
        wanted = 2 * mu * nu / (1 - nu) * STRAIN
        assert pressure_range(problem, name) == pytest.approx((wanted, wanted), rel=1e-7)
    mean = sum(mu / (1 - nu) * STRAIN for mu in MU.values())
    assert state.numbers["P11"] == pytest.approx(mean, rel=1e-8)


def test_stabilised_linear_elements():
    """Pressures of both degrees jump."""
    laws = {name: NeoHookeanSplit(mu=mu, nu=0.4999) for name, mu in MU.items()}
    problem = Problem(layered(2), laws, degree=1, formulation="mixed")
    assert problem.unknowns.stabilised
    assert problem.unknowns.count("pressure") == 4 * 5 + 4


@pytest.mark.parametrize(
    ("mu", "told"),
    [("where(y < 0.5, 1e6, 2e6)", "by a factor of up to 2 "), ("1e6*(1 + x/5)", ""), (1e6, "")],
)
def test_stiffness_that_jumps_inside_a_material_is_told(mu, told, caplog):
    """By the ratio of neighbouring cells: a jump is told, what is graded finely is not."""
    with caplog.at_level("WARNING", logger="dolfin_elastic"):
        Problem(layered(2), NeoHookean(mu=mu, nu=0.4999), degree=2)
        said = [r.getMessage() for r in caplog.records if "one continuous field" in r.getMessage()]
    said = COMM.bcast(said)  # only rank 0 speaks
    assert len(said) == bool(told)
    assert all(told in text for text in said)
