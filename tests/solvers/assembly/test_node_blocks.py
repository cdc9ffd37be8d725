"""Blocks of any pairs of nodes in the tangent: by halves and by entries, and what they carry."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from helpers.stacked import stacked
from mpi4py import MPI
from petsc4py import PETSc

from dolfin_elastic import (
    Contact,
    LinearElastic,
    NeoHookean,
    NeoHookeanSplit,
    Normal,
    Problem,
    Spring,
    Statics,
    Support,
    Tie,
    Traction,
    box_body,
)
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.supports.displacement import Restraint
from dolfin_elastic.problem.term import Blocks, Term
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.linear.choice import LinearSettings

STIFF = 1e6
"""Size of the blocks [N/m]."""


class Couplings(Term):
    """Random springs between random nodes: sum over pairs (u_i - u_j) . A (u_i - u_j)/2.

    Each rank has some of the pairs, of nodes of any ranks, and asks the others for what it needs.

    Args:
        number: Another one chooses other nodes.
    """

    label, nodal, restrains = "couplings", True, True

    def __init__(self, problem: Problem, number: int = 0) -> None:
        self._problem, self._dim = problem, problem.body.dim
        self.comm, self.map = problem.body.comm, problem.V.dofmap.index_map
        # Nodes by their places, so that they are the same on any number of ranks.
        places = np.concatenate(self.comm.allgather(problem.places[: self.map.size_local]))
        self._by_place = np.lexsort(places.round(9).T)
        self.choose(number)

    def choose(self, number: int) -> None:
        """Takes other pairs."""
        random, count = np.random.default_rng(number), 40
        pairs = self._by_place[random.integers(len(self._by_place), size=(count, 2))]
        A = random.normal(size=(count, self._dim, self._dim))
        A = STIFF * np.einsum("nij,nkj->nik", A, A)
        mine = slice(self.comm.rank, count, self.comm.size)
        self.pairs, self.stiffness = pairs[mine], A[mine]

    def blocks(self) -> Blocks:
        """See `Term`."""
        (i, j), A = self.pairs.T, self.stiffness
        return Blocks(np.r_[i, j, i, j], np.r_[i, j, j, i], np.concatenate([A, A, -A, -A]))

    def add_forces(self, forces: FloatArray) -> None:
        """See `Term`; collective here, for the test's own sake."""
        n = self.map.size_local
        u = np.concatenate(self.comm.allgather(self._problem.u.x.array[: n * self._dim]))
        pull = np.einsum(
            "nij,nj->ni",
            self.stiffness,
            np.diff(u.reshape(-1, self._dim)[self.pairs], axis=1)[:, 0],
        )
        every = np.zeros((self.map.size_global, self._dim))
        np.add.at(every, self.pairs[:, 0], pull)
        np.add.at(every, self.pairs[:, 1], -pull)
        first = self.map.local_range[0]
        forces[: n * self._dim] += total(self.comm, every)[first : first + n].reshape(-1)


def dense(matrix: PETSc.Mat) -> FloatArray:
    """All of a matrix, on all ranks."""
    start, columns, values = matrix.getValuesCSR()
    comm, size = matrix.comm.tompi4py(), matrix.getSize()
    rows = np.zeros((len(start) - 1, size[1]))
    np.add.at(rows, (np.repeat(np.arange(len(rows)), np.diff(start)), columns), values)
    return np.concatenate(comm.allgather(rows))


def summed(blocks: Blocks, size: int, comm: MPI.Comm) -> FloatArray:
    """The same of blocks of a displacement."""
    dim = blocks.values.shape[1]
    found = np.zeros((size // dim, dim, size // dim, dim))
    np.add.at(found, (blocks.rows, slice(None), blocks.columns), blocks.values)
    return total(comm, found).reshape(size, size)


def block(degree: int, supports: Sequence[Restraint] = (), kind: str = "") -> Problem:
    """A block that is moved on its left side; of some kind."""
    laws = {"linear": LinearElastic(E=1e6, nu=0.3), "mixed": NeoHookeanSplit(E=1e6, nu=0.4999)}
    law = laws.get(kind, NeoHookean(E=1e6, nu=0.3))
    held = [Support(on="left", displacement=[0.01, 0.0, 0.0])]
    return Problem(
        box_body(size=(2.0, 1.0, 1.0), cells=(4, 2, 2)),
        law,
        degree=degree,
        supports=[*held, *supports],
        loads=[Traction(on="right", value=[2e4, 1e4, -1e4])],
        # Without updates of the multiplier, of which different load steps make different ones.
        contacts=[Contact(on="bottom", plane={"axis": "z", "at": 0}, gap_tolerance=1e-3)]
        if kind == "contact"
        else [],
    )


def tangent(problem: Problem, *, iterated: bool) -> FloatArray:
    assembler = Assembler(problem, iterated=iterated)
    x = assembler.create_vector()
    assembler.get(x)
    assembler.tangent.assemble(x)
    assert (assembler.tangent.matrix.getType() == "python") == iterated
    with assembler.tangent.entries() as K:
        found = dense(K)
    x.destroy()
    assembler.destroy()
    return found


def without_prescribed(matrix: FloatArray, problem: Problem) -> FloatArray:
    free = np.ones(problem.V.dofmap.index_map.size_local * problem.body.dim)
    free[problem.constraints.prescribed_dofs] = 0.0
    free = np.concatenate(problem.body.comm.allgather(free))
    return free[:, None] * matrix * free


@pytest.mark.parametrize("iterated", [True, False], ids=["halves", "entries"])
@pytest.mark.parametrize("degree", [1, 2])
def test_the_tangent_is_the_sum(degree: int, iterated: bool) -> None:
    problem = block(degree)
    alone = tangent(problem, iterated=iterated)
    term = Couplings(problem)
    problem.terms.append(term)
    for number in (0, 1):
        term.choose(number)
        added = without_prescribed(summed(term.blocks(), len(alone), problem.body.comm), problem)
        found = tangent(problem, iterated=iterated)
        np.testing.assert_allclose(found, alone + added, rtol=0, atol=1e-12 * np.abs(added).max())


@pytest.mark.parametrize("iterated", [True, False], ids=["halves", "entries"])
def test_pairs_may_change_from_one_tangent_to_the_next(iterated: bool) -> None:
    problem = block(1)
    term = Couplings(problem)
    problem.terms.append(term)
    assembler = Assembler(problem, iterated=iterated)
    x = assembler.create_vector()
    matrix = assembler.tangent.matrix
    for number in (0, 1, 1, 2):
        term.choose(number)
        assembler.tangent.invalidate()
        assembler.tangent.assemble(x)
        assert assembler.tangent.matrix is matrix
        with assembler.tangent.entries() as K:
            found = dense(K)
        expected = tangent(problem, iterated=False)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    x.destroy()
    assembler.destroy()


def test_facets_are_added_to_halves() -> None:
    problem = block(2, [Spring(on="top", normal=1e7, tangential=2e6)], "contact")
    problem.u.interpolate(lambda x: np.stack([0.0 * x[0], 0.0 * x[0], -0.02 * x[0]]))
    found, expected = (tangent(problem, iterated=iterated) for iterated in (True, False))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def end(problem: Problem, method: str) -> FloatArray:
    """Mean displacement of the loaded end after a static solve."""
    states = list(Statics(problem, linear=LinearSettings(method=method)).steps())
    assert sum(state.newton for state in states) <= 30
    assert [reason for state in states for reason in state.audit.reasons] == []
    n, dim = problem.V.dofmap.index_map.size_local, problem.body.dim
    u, places = problem.u.x.array[: n * dim].reshape(-1, dim), problem.places[:n]
    far = np.isclose(places[:, 0], places[:, 0].max())
    sums = total(problem.body.comm, np.append(u[far].sum(axis=0), far.sum()))
    return np.asarray(sums[:-1] / sums[-1])


SUPPORTS: dict[str, list[Restraint]] = {
    "plain": [],
    "springs": [Spring(on="top", normal=1e5, tangential=1e4)],
    "skew": [Normal(on="bottom")],
}


@pytest.mark.parametrize("name", [*SUPPORTS, "linear", "ties", "mixed", "contact"])
@pytest.mark.sample(3)
def test_both_solvers_find_the_same(name: str) -> None:
    found = []
    for method in ("direct", "iterative"):
        if name == "ties":
            problem = Problem(
                stacked(size=(1.0, 0.8, 0.6), lower=(3, 2, 2), upper=(4, 3, 2)),
                NeoHookean(E=1e6, nu=0.3),
                supports=[Support(on="bottom", displacement=[0.0, 0.0, 0.0])],
                loads=[Traction(on="top", value=[1e4, 0.0, 2e4])],
                ties=[Tie(on="below", to="above")],
            )
        else:
            problem = block(2, SUPPORTS.get(name, []), name)
        problem.terms.append(Couplings(problem))
        assert problem.mixed == (name == "mixed")
        found.append(end(problem, method))
    np.testing.assert_allclose(*found, rtol=1e-5)
