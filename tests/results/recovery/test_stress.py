"""The recovered stress: exact for polynomials, of higher order, the same on any ranks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import ufl
from dolfinx import fem
from helpers.bodies import soft_and_hard
from helpers.manufactured import NU, E, exact, held_and_loaded
from helpers.ranks import SIZES, on_ranks
from mpi4py import MPI

from dolfin_elastic import (
    LinearElastic,
    NeoHookean,
    Probe,
    Problem,
    Statics,
    Support,
    box_body,
    rectangle_body,
)
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh import Body
from dolfin_elastic.mesh.geometry.curved import cell_quadrature, shape_functions
from dolfin_elastic.model.kinematics import embedded
from dolfin_elastic.problem.state import State
from dolfin_elastic.results.evaluate import Evaluator
from dolfin_elastic.results.quantity import Extremes
from dolfin_elastic.results.recovery.error import ErrorEstimator
from dolfin_elastic.results.recovery.patches import Patches, sampling_points
from dolfin_elastic.results.recovery.stress import COMPONENTS, RegionStress, von_mises

FREE = "free"


def made(dim: int, n: int, comm: MPI.Comm | None = None) -> Body:
    """Rectangle or box of n cells along each edge."""
    make = (rectangle_body, box_body)[dim - 2]
    return make(size=(1.0,) * dim, cells=(n,) * dim, **({} if comm is None else {"comm": comm}))


def shaken(body: Body, share: float = 0.3) -> Body:
    """The nodes inside moved by a smooth function of their place, up to a share of a cell."""
    x = body.mesh.geometry.x
    n = round((body.num_cells / {2: 2, 3: 6}[body.dim]) ** (1 / body.dim))
    inside = np.prod(np.sin(np.pi * x[:, : body.dim]), axis=1)
    waves = np.cos(5 * x[:, [1, 0, 0]] + 3 * x[:, [0, 1, 1]])
    x[:, : body.dim] += (share / n * inside[:, None] * waves)[:, : body.dim]
    return body


def polynomials(x: Any, degree: int) -> Any:
    """Two polynomials of a degree with all monomials, shape (..., 2)."""
    s = np.tensordot(x, np.array([1.3, -0.7, 0.4])[: x.shape[-1]], 1)
    t = np.tensordot(x, np.array([0.2, 1.1, -0.9])[: x.shape[-1]], 1)
    return np.stack([1 + s**degree, 2 + (s - t) * t ** (degree - 1) if degree else s**0], axis=-1)


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize(("dim", "n"), [(2, 1), (2, 4), (3, 2), (3, 3)])
def test_polynomials_are_recovered_everywhere(dim: int, n: int, degree: int) -> None:
    """Also at corners, whose patches have too few points, to the round-off of small systems.

    Two triangles have too few points for their degree: what is left is the degree below.
    """
    body = shaken(made(dim, n))
    problem = Problem(body, LinearElastic(E=1.0, nu=0.3), degree=degree)
    mesh, cells = body.mesh, body.owned_cells()
    nodes = mesh.geometry.x[mesh.geometry.dofmap[cells]][:, :, :dim]
    exact_degree = degree - (n == 1)

    def at(points: Any) -> Any:
        places = np.einsum("sn,cnj->csj", shape_functions(mesh, points), nodes)
        return polynomials(places, exact_degree)

    recovered = Patches(problem.V, cells)(at(sampling_points(dim, degree)))
    right = at(np.asarray(problem.V.element.basix_element.points))
    assert recovered.shape == right.shape
    assert body.comm.allreduce(np.abs(recovered - right).max(initial=0), op=MPI.MAX) < 1e-10


def slender(degree: int) -> Problem:
    """A bar one cell thick, of which only the short cells at one end have patches that serve.

    With quadratic cells: those of long cells are nearly singular.  Linear ones all serve.
    """
    body = box_body(size=(12.0, 1.0, 1.0), cells=(12, 1, 1))
    x = body.mesh.geometry.x[:, 0]
    x[:] = np.where(x > 3, 3 + 6 * (x - 3), x)
    return Problem(body, LinearElastic(E=1.0, nu=0.3), degree=degree)


@pytest.mark.parametrize("degree", [1, 2])
def test_errors_are_not_multiplied_along_a_slender_part(degree: int) -> None:
    """Sum of the absolute weights of the points in the value at each vertex: an error of the points
    grows by as much at most.

    A patch that serves has 10 at most, and a value that is taken from patches beside twice that.
    """
    problem = slender(degree)
    cells, points = problem.body.owned_cells(), len(sampling_points(3, degree))
    columns = problem.body.num_cells * points
    values = np.zeros((len(cells), points, columns))
    own = problem.body.mesh.topology.original_cell_index[: len(cells)]
    for point in range(points):
        values[np.arange(len(cells)), point, own * points + point] = 1
    found = Patches(problem.V, cells)(values)[:, :4]
    np.testing.assert_allclose(found.sum(axis=2), 1, rtol=1e-9)
    gains = np.abs(found).sum(axis=2)
    largest = problem.body.comm.allreduce(gains.max(initial=0), op=MPI.MAX)
    print(degree, largest)
    assert 1 < largest < 20


def test_a_probe_of_a_slender_part_reads_the_field() -> None:
    """It recovers from the cells around alone: no polynomial may come from farther away."""
    problem = slender(2)
    problem.u.interpolate(lambda x: (0.01 * np.sin(x[0]), 0 * x[0], 0.01 * np.cos(x[1] - x[0])))
    state, place = State(1, 1.0, problem.u), [57.0, 0.0, 1.0]
    values = Evaluator(problem, ["cauchy_stress"])(state)["cauchy_stress"]
    x = problem.V.tabulate_dof_coordinates()[: len(values)]
    found = Probe(problem, {"a": place}, ["cauchy_stress"])(state)["a_cauchy_stress"]
    for row in values[np.linalg.norm(x - place, axis=1) < 1e-9]:
        np.testing.assert_allclose(row, found, rtol=1e-9, atol=1e-12)


def stress_errors(dim: int, degree: int, n: int) -> Any:
    """Raw and recovered stress against a manufactured one, L2 norm in the inner half; and of the
    difference of both, in the whole body, over that of the raw one."""
    law = LinearElastic(E=E, nu=NU)
    body = shaken(made(dim, n), 0.2)
    problem = held_and_loaded(body, law, law, degree)
    *_, _ = Statics(problem, rtol=1e-10).steps()
    rule = cell_quadrature(body.mesh, body.owned_cells(), 6)
    assert rule.local is not None
    part = RegionStress(problem, problem.regions[0], problem.w, points=rule.local)
    shape = problem.V.element.basix_element.tabulate(0, rule.local)[0, :, :, 0]
    recovered = shape @ part()
    raw = np.concatenate([part.at_points(chunk) for chunk in part.chunks()])
    X = ufl.SpatialCoordinate(body.mesh)
    sigma = law.stress(embedded(ufl.grad(exact(dim, X)) + ufl.Identity(dim)))
    right = fem.Expression(ufl.as_vector([sigma[i, j] for i, j in COMPONENTS]), rule.local)
    right = right.eval(body.mesh, part.cells).reshape(raw.shape)
    middles = rule.X.mean(axis=1)
    inside = np.all((middles > 0.25) & (middles < 0.75), axis=1)

    def norm(values: Any, chosen: Any) -> float:
        squares = rule.weights * np.sum(values**2, axis=2)
        return float(np.sqrt(body.comm.allreduce(squares[chosen].sum())))

    everywhere = np.ones_like(inside)
    ratio = norm(recovered - raw, everywhere) / norm(raw - right, everywhere)
    return norm(raw - right, inside), norm(recovered - right, inside), ratio


@pytest.mark.parametrize(
    ("dim", "degree", "cells"),
    [(2, 1, (8, 16, 32)), (2, 2, (8, 16)), (3, 1, (8, 16)), (3, 2, (4, 8))],
)
def test_recovered_stress_is_one_order_better_inside(dim: int, degree: int, cells: Any) -> None:
    """Zienkiewicz & Zhu (1992), section 4: degree + 1 where patches are whole, the raw stress has
    the degree; the mesh is not uniform."""
    found = np.array([stress_errors(dim, degree, n) for n in cells])
    rates = np.polyfit(np.log(1 / np.array(cells)), np.log(found), 1)[0]
    print(dim, degree, found.tolist(), rates)
    assert degree - 0.1 < rates[0] < degree + 0.3
    assert rates[1] > degree + 0.75
    assert (found[:, 1] < 0.5 * found[:, 0]).all()
    assert ((found[:, 2] > 0.8) & (found[:, 2] < 1.3)).all()


def loaded(comm: MPI.Comm) -> tuple[Problem, State]:
    """A short cantilever of two materials, finite strains, one cell thin in places."""
    body = soft_and_hard(box_body(comm=comm, size=(2.0, 0.5, 0.5), cells=(5, 2, 1)), at=0.8)
    problem = Problem(
        body,
        {"soft": NeoHookean(E=1e6, nu=0.3), "hard": LinearElastic(E=3e6, nu=0.2, allowable=1e6)},
        degree=2,
        supports=[Support(on="left")],
    )
    u = fem.Function(problem.V)
    u.interpolate(lambda x: (0.1 * x[0] ** 2 * x[1], 0.05 * np.sin(3 * x[0]), 0.1 * x[2] * x[0]))
    return problem, State(1, 1.0, u)


def summed_up(comm: MPI.Comm) -> list[float]:
    """Sums over all nodes of the recovered fields, weighted by their places; values of probes."""
    problem, state = loaded(comm)
    found = Evaluator(problem, ["von_mises", "cauchy_stress", "pressure"])(state)
    own = problem.V.dofmap.index_map.size_local
    x = problem.V.tabulate_dof_coordinates()[:own]
    weight = np.cos(3 * x[:, 0] + 5 * x[:, 1] + 7 * x[:, 2])
    sums = np.concatenate([np.concatenate([weight @ v, weight**2 @ v]) for v in found.values()])
    at = Probe(problem, {"a": [0.7, 0.2, 0.1], "b": [2, 0.5, 0.5]}, ["von_mises", "safety_factor"])
    probed = at(state)
    return [*(float(v) for v in comm.allreduce(sums)), *(float(v[0]) for v in probed.values())]


def test_the_same_on_any_ranks() -> None:
    """Sums of other orders round differently; nothing else may."""
    found = [on_ranks(count, summed_up) for count in SIZES]
    for other in found:
        np.testing.assert_allclose(other, found[0], rtol=1e-10)


def test_a_probe_at_a_node_reads_the_field_there() -> None:
    problem, state = loaded(MPI.COMM_WORLD)
    values = Evaluator(problem, ["von_mises", "safety_factor", "cauchy_stress"])(state)
    own = problem.V.dofmap.index_map.size_local
    x = problem.V.tabulate_dof_coordinates()[:own]
    place = [2.0, 0.5, 0.25]  # the middle of an edge
    here = np.flatnonzero(np.linalg.norm(x - place, axis=1) < 1e-9)
    names = ("von_mises", "safety_factor", "cauchy_stress")
    found = Probe(problem, {"a": place}, names)(state)
    assert problem.body.comm.allreduce(len(here)) == 1
    for name in names:
        for row in values[name][here]:
            np.testing.assert_allclose(row, found[f"a_{name}"], rtol=1e-9)


def test_outputs_share_one_recovery(monkeypatch: pytest.MonkeyPatch) -> None:
    """The stress of a state is recovered once in each of two regions, that of the next anew."""
    problem, state = loaded(MPI.COMM_WORLD)
    calls: list[int] = []
    fit = Patches.fit_parts

    def counted(patches: Patches, width: int, values: Callable[[slice], FloatArray]) -> FloatArray:
        calls.append(width)
        return fit(patches, width, values)

    monkeypatch.setattr(Patches, "fit_parts", counted)
    fields, summary = Evaluator(problem, ["von_mises", "pressure"]), Extremes(problem)
    estimator = ErrorEstimator(problem)
    first = fields(state)["von_mises"]
    largest = summary.of(replace(state, numbers={"of a probe": 1.0}))["von_mises"].value
    assert len(calls) == 2
    comm = problem.body.comm
    assert largest == comm.allreduce(first.max(initial=0.0), op=MPI.MAX)

    state.u.x.array[:] *= 2
    later = State(2, 2.0, state.u)
    estimate = estimator(later)
    second = fields(later)["von_mises"]
    assert summary.of(later)["von_mises"].value > 1.5 * largest
    assert estimator(later) is estimate
    assert len(calls) == 4
    np.testing.assert_allclose(second[:, 0], von_mises(estimate.stress.stress), rtol=1e-12)


def test_a_beam_in_bending() -> None:
    """sigma = 6 M/(b h^2) at the surface, cells as high as half the beam.

    At barycentres, a third of a cell inside, it is a third lower.
    """
    body = rectangle_body(size=(8.0, 1.0), cells=(16, 2))
    problem = Problem(body, LinearElastic(E=1e6, nu=0.0), degree=2)
    problem.u.interpolate(lambda x: (0.012 * x[0] * (x[1] - 0.5), -0.006 * x[0] ** 2))
    state = State(1, 1.0, problem.u)
    found = Evaluator(problem, ["von_mises", "von_mises_cell", "von_mises_nodal"])(state)
    comm = body.comm
    top = {name: comm.allreduce(v.max(initial=0), op=MPI.MAX) for name, v in found.items()}
    assert top["von_mises"] == top["von_mises_nodal"] == pytest.approx(6e3, rel=1e-9)
    assert top["von_mises_cell"] == pytest.approx(4e3, rel=1e-9)
