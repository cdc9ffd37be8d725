"""A tangent by the half of its blocks beside the same one by PETSc's entries."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from petsc4py import PETSc

from dolfin_elastic import (
    NeoHookean,
    Problem,
    Support,
    Traction,
    box_body,
    rectangle_body,
)
from dolfin_elastic.core.jit import cell_integrals
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.assembly.two_stage.form import TwoStageForm

SPLIT = 2.0**-44
"""Of the sum of two numbers of single precision, after the contributions of some twenty cells: each
rounds by 2^-48 of the sum."""

CASES = [(2, 1), (2, 2), (3, 1), (3, 2)]


@pytest.fixture(autouse=True, params=[cell_integrals.MANY_CELLS, 0], ids=["few", "many"])
def cells_from_which_lanes_pay(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch):
    """All cases cell by cell, and eight cells at once."""
    monkeypatch.setattr(cell_integrals, "MANY_CELLS", request.param)


def bent(dim: int, degree: int) -> Problem:
    """A strip or a block, held on one wall and deformed."""
    if dim == 3:
        body = box_body(size=(2.0, 1.0, 1.0), cells=(5, 3, 3))
    else:
        body = rectangle_body(size=(2.0, 1.0), cells=(9, 5))
    problem = Problem(
        body,
        NeoHookean(E=1e6, nu=0.3),
        degree=degree,
        supports=[
            Support(on="left", displacement=[0.0] + ["free"] * (dim - 1)),
            Support(on="bottom", displacement=["free"] * (dim - 1) + [0.0]),
        ],
        loads=[Traction(on="right", value=[1e4] * dim)],
    )
    problem.u.interpolate(lambda x: 0.1 * np.stack([np.sin(x[0] * (k + 1)) for k in range(dim)]))
    return problem


@contextmanager
def both(problem: Problem) -> Iterator[tuple[Assembler, Assembler, PETSc.Vec]]:
    """The same tangent twice, by its half and by entries, and where it is."""
    half, entries = Assembler(problem, iterated=True), Assembler(problem)
    x = half.create_vector()
    half.get(x)
    for assembler in (half, entries):
        assembler.tangent.assemble(x)
    yield half, entries, x
    x.destroy()
    half.destroy()
    entries.destroy()


def some(matrix: PETSc.Mat) -> PETSc.Vec:
    v = matrix.createVecRight()
    first, last = v.getOwnershipRange()
    v.array_w[:] = np.sin(7.0 * np.arange(first, last))
    return v


def times(matrix: PETSc.Mat, v: PETSc.Vec) -> FloatArray:
    y = matrix.createVecLeft()
    matrix.mult(v, y)
    found = np.array(y.array_r)
    y.destroy()
    return found


def same(found: FloatArray, expected: FloatArray, within: float, comm: object) -> None:
    off, size = total(comm, np.array([np.sum((found - expected) ** 2), np.sum(expected**2)]))
    assert np.sqrt(off) <= within * np.sqrt(size)


@pytest.mark.parametrize(("dim", "degree"), CASES)
def test_products_and_diagonal_are_those_of_the_entries(dim: int, degree: int) -> None:
    with both(bent(dim, degree)) as (half, entries, _):
        K, A = half.tangent.matrix, entries.tangent.matrix
        assert (K.getType(), A.getType()[-3:]) == ("python", "aij")
        assert isinstance(half.tangent.form, TwoStageForm)
        in_lanes = [term.moduli.in_lanes for term in half.tangent.form._terms]
        assert in_lanes == [cell_integrals.MANY_CELLS == 0]
        v = some(A)
        same(times(K, v), times(A, v), SPLIT, half.comm)
        diagonals = [matrix.getDiagonal() for matrix in (K, A)]
        same(diagonals[0].array_r, diagonals[1].array_r, SPLIT, half.comm)
        for vector in (v, *diagonals):
            vector.destroy()


@pytest.mark.parametrize(("dim", "degree"), CASES)
def test_products_with_several_vectors_are_those_with_each(dim: int, degree: int) -> None:
    """Eight at once, and the three that are left."""
    with both(bent(dim, degree)) as (half, _, _):
        K = half.tangent.matrix
        v = some(K)
        vectors = np.array([np.roll(v.array_r, k) * (k + 1) for k in range(11)])
        images = np.full_like(vectors, np.nan)
        K.getPythonContext().times_several(vectors, images)
        for x, image in zip(vectors, images, strict=True):
            v.array_w[:] = x
            same(image, times(K, v), 1e-15, half.comm)
        v.destroy()


@pytest.mark.parametrize(("dim", "degree"), CASES)
def test_as_entries_it_is_the_same_matrix(dim: int, degree: int) -> None:
    with both(bent(dim, degree)) as (half, entries, _), half.tangent.entries() as K:
        A = entries.tangent.matrix
        difference = K.copy()
        difference.axpy(-1.0, A)
        assert difference.norm() <= SPLIT * A.norm()
        difference.destroy()


def test_the_rounded_product_is_that_of_single_precision() -> None:
    with both(bent(3, 1)) as (half, entries, _):
        blocks = half.tangent.matrix.getPythonContext()
        v, A = some(entries.tangent.matrix), entries.tangent.matrix
        x, y = np.zeros((blocks.halo.size, 3)), np.zeros((blocks.halo.owned, 3))
        x[: blocks.halo.owned] = v.array_r.reshape(-1, 3)
        blocks.halo.fill(x)
        blocks.times(x, y, rounded=True)
        same(y.reshape(-1), times(A, v), np.finfo(np.float32).eps, half.comm)
        v.destroy()


def test_a_shift_of_the_diagonal_is_added_to_it() -> None:
    with both(bent(2, 1)) as (half, entries, _):
        for assembler in (half, entries):
            assembler.tangent.shift_diagonal(0.25)
        v = some(entries.tangent.matrix)
        found = [times(assembler.tangent.matrix, v) for assembler in (half, entries)]
        same(*found, SPLIT, half.comm)
        v.destroy()


def test_another_state_and_entries_in_place_of_halves() -> None:
    with both(bent(3, 2)) as (half, entries, x):
        x.scale(-0.5)
        for assembler in (half, entries):
            assembler.put(x)
            assembler.tangent.assemble(x)
        v = some(entries.tangent.matrix)
        expected = times(entries.tangent.matrix, v)
        same(times(half.tangent.matrix, v), expected, SPLIT, half.comm)
        half.tangent.to_entries()
        assert half.tangent.matrix.getType()[-3:] == "aij"
        same(times(half.tangent.matrix, v), expected, 1e-14, half.comm)
        v.destroy()
