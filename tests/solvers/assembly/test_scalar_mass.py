"""The mass of one number for each pair of nodes beside that of the compiled form."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
import ufl
from dolfinx import fem
from helpers.annulus import annulus
from helpers.stacked import stacked
from mpi4py import MPI
from petsc4py import PETSc

from dolfin_elastic import (
    NeoHookean,
    Normal,
    PointMass,
    Problem,
    Support,
    Tie,
    box_body,
    rectangle_body,
)
from dolfin_elastic.core.ghosts import assembled
from dolfin_elastic.core.parallel import largest, total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.solvers.assembly.assembler import compiled, integral
from dolfin_elastic.solvers.assembly.mass import initial_acceleration
from dolfin_elastic.solvers.assembly.matrix import BilinearForm, ConstrainedMatrix, TangentMatrix
from dolfin_elastic.solvers.assembly.scalar_mass import InertiaForces, ScalarMass
from dolfin_elastic.solvers.dynamics.residual import DynamicResidual

SPLIT = 2.0**-44
"""Of the sum of two numbers of single precision, see test_symmetric.py."""

CASES = [(2, 1), (2, 2), (3, 1), (3, 2)]
DENSITY = "1000*(1 + x)"


def bent(dim: int, degree: int, *, geometry: str = "", nu: float = 0.3) -> Problem:
    """A strip or a block, held on two walls, of a density that varies, with a mounted mass."""
    if dim == 3:
        body = box_body(size=(2.0, 1.0, 1.0), cells=(5, 3, 3))
    else:
        body = rectangle_body(size=(2.0, 1.0), cells=(9, 5))
    keys = {"geometry": geometry} if geometry else {}
    problem = Problem(
        body,
        NeoHookean(E=1e6, nu=nu, density=DENSITY),
        degree=degree,
        supports=[
            Support(on="left", displacement=[0.0] + ["free"] * (dim - 1)),
            Support(on="bottom", displacement=["free"] * (dim - 1) + [0.0]),
        ],
        masses=[PointMass(on="right", mass=500)],
        **keys,
    )
    for k in range(dim):
        problem.u.x.array[k::dim] = 0.05 * np.sin(problem.places[:, 0] * (k + 1))
    problem.unknowns.u_to_w()
    return problem


def alike(found: FloatArray, wanted: FloatArray, comm: object, within: float = 1e-13) -> None:
    size = largest(comm, float(np.max(np.abs(wanted), initial=0.0)))
    assert size > 0.0
    assert largest(comm, float(np.max(np.abs(found - wanted), initial=0.0))) <= within * size


def some(problem: Problem) -> FloatArray:
    """A smooth acceleration, the same on any number of ranks; owned entries."""
    x = problem.places[: problem.V.dofmap.index_map.size_local, : problem.body.dim]
    return np.ascontiguousarray(np.cos(3.0 * x[:, ::-1]) + x[:, :1]).reshape(-1)


@pytest.mark.parametrize("geometry", ["", "axisymmetric"])
@pytest.mark.parametrize(("dim", "degree"), CASES)
def test_products_and_diagonal_are_those_of_the_form(dim: int, degree: int, geometry: str) -> None:
    if geometry and dim == 3:
        pytest.skip("solids are no bodies of revolution")
    problem = bent(dim, degree, geometry=geometry)
    comm, mass, x = problem.body.comm, ScalarMass(problem), some(problem)
    inertia = InertiaForces(problem, mass, lambda: 1.0)
    a = inertia.rates
    a.x.array[: len(x)] = x
    a.x.scatter_forward()
    wanted = assembled(compiled(problem, [problem.weak_form.inertia(a, problem.v)])[0], problem.W)
    alike(mass.times(x), wanted, comm)
    form = compiled(problem, [problem.weak_form.inertia(ufl.TrialFunction(problem.V), problem.v)])
    matrix = TangentMatrix(BilinearForm(form[0]))
    matrix.assemble([])
    diagonal = matrix.petsc.getDiagonal()
    alike(mass.diagonal(), diagonal.array_r, comm)
    diagonal.destroy()
    matrix.destroy()
    assert np.array_equal(inertia.times(x), mass.times(x))
    vectors = np.array([np.roll(x, k) for k in range(11)])
    images = np.full_like(vectors, np.nan)
    mass.times_several(vectors, images)
    for one, image in zip(vectors, images, strict=True):
        alike(image, mass.times(one), comm, within=1e-15)
    kinetic = compiled(problem, [problem.weak_form.inertia(a, a)])[0]
    energy = total(comm, float(np.dot(x, mass.times(x))))
    assert energy == pytest.approx(integral(problem, kinetic), rel=1e-13)


@contextmanager
def reference(problem: Problem, moving: DynamicResidual) -> Iterator[PETSc.Mat]:
    """The tangent as one compiled form, inertia and damping in it, with the same constraints."""
    displacement = problem.unknowns.displacement(ufl.TrialFunction(problem.W))
    shift, damping = moving.velocity_shift, moving.damping
    factor = problem.constant(moving.acceleration_shift + damping.mass * float(shift.value))
    form = problem.weak_form.tangent + factor * problem.weak_form.inertia(displacement, problem.v)
    if (work := damping.work()) is not None:
        trial = ufl.TrialFunction(problem.W)
        S = ufl.inv(problem.weak_form.F(problem.w)) * damping._stress(problem.regions[0])
        stiffening = ufl.inner(damping._gradient(trial) * S, damping._test)
        form += shift * ufl.derivative(work, damping.rate, trial)
        form += stiffening * damping._volume(problem.regions[0])
    matrix = TangentMatrix(BilinearForm(compiled(problem, [form])[0]))
    dofs = moving.assembler
    matrix.assemble(dofs.bcs)
    constrained = ConstrainedMatrix(problem, dofs, matrix.petsc, dofs.displacement_dofs)
    constrained.renew(1.0)
    yield constrained.matrix
    constrained.destroy()
    matrix.destroy()


def off(moving: DynamicResidual, wanted: PETSc.Mat) -> float:
    """Norm of the difference of the tangent over its norm."""
    assembler = moving.assembler
    x = assembler.create_vector()
    assembler.get(x)
    assembler.tangent.assemble(x, moving.factor, unit=1.0)
    x.destroy()
    with assembler.tangent.entries() as K:
        difference = K.copy()
        difference.axpy(-1.0, wanted)
        result = float(difference.norm() / wanted.norm())
        difference.destroy()
    return result


def shifted(problem: Problem, **damping: float) -> DynamicResidual:
    """In motion, with shifts of which the mass is half of the tangent, or so."""
    iterated = damping.pop("iterated", False)
    moving = DynamicResidual(problem, **damping, iterated=bool(iterated))
    moving.acceleration_shift, moving.velocity_shift.value = 1e5, 300.0
    v = some(problem)
    moving.set_rates(v, 10.0 * v)
    return moving


@pytest.mark.parametrize(
    "damping", [{}, {"mass": 30.0, "stiffness": 1e-3}], ids=["free", "rayleigh"]
)
@pytest.mark.parametrize("iterated", [True, False], ids=["half", "entries"])
@pytest.mark.parametrize(("dim", "degree"), CASES)
def test_tangents_with_it_are_those_of_one_form(
    dim: int, degree: int, iterated: bool, damping: dict[str, float]
) -> None:
    problem = bent(dim, degree)
    moving = shifted(problem, **damping, iterated=iterated)
    assert (moving.assembler.tangent.matrix.getType() == "python") is iterated
    with reference(problem, moving) as wanted:
        assert off(moving, wanted) <= 1e-13
    moving.destroy()


@pytest.mark.parametrize(
    ("geometry", "nu"), [("", 0.499), ("axisymmetric", 0.3), ("axisymmetric", 0.499)]
)
def test_tangents_of_other_unknowns_and_geometries(geometry: str, nu: float) -> None:
    problem = bent(2, 2, geometry=geometry, nu=nu)
    moving = shifted(problem, mass=30.0)
    with reference(problem, moving) as wanted:
        assert off(moving, wanted) <= 1e-13
    moving.destroy()


def combined(kind: str) -> Problem:
    """Two blocks of which one is tied to the other, or one whose support is skew."""
    law = NeoHookean(E=1e6, nu=0.3, density=DENSITY)
    if kind == "tied":
        body = stacked((1.0, 1.0, 1.0), (3, 3, 2), (4, 4, 2))
        supports = [Support(on="bottom")]
        return Problem(body, law, degree=1, supports=supports, ties=[Tie(on="above", to="below")])
    body = annulus(MPI.COMM_WORLD, 3)
    return Problem(body, law, degree=2, supports=[Normal(on="inside")])


@pytest.mark.parametrize("kind", ["tied", "skew"])
def test_diagonal_and_acceleration_where_entries_are_combined(kind: str) -> None:
    """Of T^T M T, and the forces that the acceleration found needs are those that were given."""
    problem = combined(kind)
    moving = DynamicResidual(problem)
    assembler, mass = moving.assembler, moving.inertia.mass
    assert assembler.combined
    form = compiled(problem, [problem.weak_form.inertia(ufl.TrialFunction(problem.V), problem.v)])
    matrix = TangentMatrix(BilinearForm(form[0]))
    matrix.assemble(assembler.bcs)
    constrained = ConstrainedMatrix(problem, assembler, matrix.petsc, assembler.displacement_dofs)
    constrained.renew(0.0)
    diagonal = constrained.matrix.getDiagonal()
    diagonal.array_w[assembler.prescribed_dofs] = 0.0
    alike(moving.mass.array_r, diagonal.array_r, problem.body.comm)
    forces = some(problem)
    assembler.residual.owned[:] = -forces
    a = fem.Function(problem.V)
    initial_acceleration(assembler, mass, np.zeros(len(a.x.array)), a)
    own = a.x.array[: len(forces)]
    rows = problem.constraints
    left = rows.free_part(rows.collect(forces - mass.times(own)))
    given = rows.free_part(rows.collect(forces))
    alike(left + given, given, problem.body.comm, 1e-12)
    np.testing.assert_allclose(rows.constrained_part(own), 0.0, atol=1e-12 * np.abs(own).max())
    diagonal.destroy()
    constrained.destroy()
    matrix.destroy()
    moving.destroy()
