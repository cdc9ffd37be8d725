"""The mass matrix, the rigid motions of a body in it, and those that nothing prevents."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from petsc4py import PETSc

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import largest, total
from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray
from dolfin_elastic.problem.connectivity import ConnectedBodies
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.assembly.matrix import ConstrainedMatrix, marked
from dolfin_elastic.solvers.assembly.node_blocks import NodeBlocks
from dolfin_elastic.solvers.assembly.scalar_mass import ScalarMass
from dolfin_elastic.solvers.assembly.symmetric.blocks import SymmetricBlocks, halves
from dolfin_elastic.solvers.diagnostics.rigid_body import rigid_motions
from dolfin_elastic.solvers.diagnostics.rigid_body_names import motions_in_words
from dolfin_elastic.solvers.linear.ksp import null_combinations, times

FREE = 1e-12
"""Force against a rigid motion, over the largest stiffness of a node, that is round-off."""

SAME = 1e-6
"""Share of a unit motion that is no motion of its own."""


class FreeMass:
    """The mass of what is free to move, as PETSc calls a matrix of type "python".

    Args:
        assembler: Of unknowns that are prescribed by themselves only.
        fixed: Owned entries without inertia; those that are prescribed, or none yet.
    """

    def __init__(self, assembler: Assembler, mass: ScalarMass, fixed: IndexArray) -> None:
        self._assembler, self._mass, self._fixed = assembler, mass, fixed

    def mult(self, matrix: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Collective."""
        free = x.array_r.copy()
        free[self._fixed] = 0.0
        y.array_w[:] = self._mass.times(free)
        y.array_w[self._fixed] = 0.0

    def times_several(self, vectors: FloatArray, images: FloatArray) -> None:
        """Overwrites images by products with free vectors, one below the other. Collective."""
        self._mass.times_several(vectors, images)
        images[:, self._fixed] = 0.0

    def getDiagonal(self, matrix: PETSc.Mat, diagonal: PETSc.Vec) -> None:
        """Collective."""
        diagonal.array_w[:] = self._mass.diagonal()
        diagonal.array_w[self._fixed] = 0.0

    def aij(self) -> PETSc.Mat:
        """The same as an AIJ matrix, which the caller destroys. Collective."""
        blocks = NodeBlocks(self._assembler, self._mass.blocks)
        matrix = blocks.free().copy()
        matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        blocks.destroy()
        return matrix

    def add_to(self, blocks: SymmetricBlocks, factor: float) -> None:
        """Adds a multiple to half of the tangent of the same unknowns. Collective."""
        fixed = marked(self._assembler.bcs, blocks.dim * blocks.halo.size)
        self._mass.add_to_assembled(blocks, factor, fixed)


class Mass:
    """The consistent mass matrix, the integral of density a . v. Collective; `destroy` it.

    One number for each pair of nodes where the tangent is kept by the half of its blocks.

    Args:
        assembler: Of the same unknowns.

    Attributes:
        matrix: The PETSc matrix: at first of the whole body, after `constrain` with zero rows and
            columns where displacements are prescribed or tied.
    """

    def __init__(self, assembler: Assembler) -> None:
        self._assembler, problem = assembler, assembler.problem
        self._scalar = ScalarMass(problem)
        self._halved = halves(assembler.tangent.matrix) is not None
        if self._halved:
            self.matrix: PETSc.Mat = self._of_free(np.empty(0, dtype=np.int32))
            return
        self._blocks = NodeBlocks(assembler, self._scalar.blocks)
        self.matrix = self._blocks.assembled()
        moves = assembler.displacement_dofs
        self._constrained = ConstrainedMatrix(problem, assembler, self.matrix, moves)

    def _of_free(self, fixed: IndexArray) -> PETSc.Mat:
        sizes, context = ((self._assembler.size, None),) * 2, (self._assembler, self._scalar, fixed)
        matrix = PETSc.Mat().createPython(sizes, FreeMass(*context), self._assembler.comm)
        matrix.setUp()
        return matrix

    def constrain(self) -> None:
        """Leaves the inertia of what is free to move only. Collective."""
        if self._halved:
            self.matrix.destroy()
            self.matrix = self._of_free(self._assembler.prescribed_dofs)
            return
        self._constrained.renew(0.0)
        self.matrix = self._constrained.matrix
        start = self.matrix.getOwnershipRange()[0]
        rows = (self._assembler.prescribed_dofs + start).astype(PETSc.IntType)
        self.matrix.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        self.matrix.zeroRowsColumns(rows, diag=0.0)
        self.matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)

    def times(self, columns: FloatArray) -> FloatArray:
        """M times columns of owned entries, shape (entries, n). Collective."""
        return times(self.matrix, columns)

    def destroy(self) -> None:
        """Frees the matrix. Collective."""
        if self._halved:
            self.matrix.destroy()
            return
        self._constrained.destroy()
        self._blocks.destroy()


class Frame:
    """Unit rigid motions of some nodes about their centre of mass, and their inertia. Collective.

    Args:
        inside: Which of the owned nodes move.

    Attributes:
        names: Of the directions: "x", "y", "z", "rx", "ry", "rz".
        centre: Centre of mass of the present shape [m].
        columns: The motions as owned entries of all unknowns, shape (entries, directions).
        images: M times these.
        whole: Mass [kg] and moments of inertia [kg m^2].
        size: Largest distance from the centre of mass [m].
    """

    def __init__(self, problem: Problem, mass: Mass, inside: BoolArray) -> None:
        comm, dim = problem.body.comm, problem.body.dim
        places = _places(problem)
        unit = _spread(problem, np.eye(dim)[:1] * inside[:, None])
        nodal = mass.times(unit[:, None])[problem.unknowns.displacement_dofs, 0].reshape(-1, dim)[
            :, 0
        ]
        with np.errstate(over="ignore"):
            sums = total(comm, np.array([nodal.sum(), *(nodal @ places)]))
        if not np.isfinite(sums).all():
            raise InputError(
                f"the mass of the body is no finite number, {sums[0]:.3g} kg",
                where="materials",
                expected="a density in kg/m^3 that such a body can have",
            )
        self.centre: FloatArray = sums[1:] / sums[0]
        motions = rigid_motions(places - self.centre) * inside[:, None, None]
        names = ["x", "y", "z"][:dim] + (["rx", "ry", "rz"] if dim == 3 else ["rz"])
        if problem.geometry == "axisymmetric":  # of rigid motions only the one along the axis is
            motions, names, self.centre[0] = motions[:, :, 1:2], ["y"], 0.0
        self.names = tuple(names)
        self.columns = np.stack(
            [_spread(problem, motions[:, :, k]) for k in range(len(names))], axis=1
        )
        self.images = mass.times(self.columns)
        self.whole: FloatArray = np.diag(total(comm, self.columns.T @ self.images))
        arms = np.linalg.norm((places - self.centre)[inside], axis=1)
        self.size = largest(comm, float(np.max(arms, initial=0.0))) or 1.0

    def scaled(self, mix: FloatArray) -> FloatArray:
        """A combination of the motions with rotations in units of 1/size, as one unit column."""
        scaled = mix * np.where(np.arange(len(mix)) < len(self.centre), 1.0, self.size)
        return np.asarray(scaled / np.linalg.norm(scaled))[:, None]


def _places(problem: Problem) -> FloatArray:
    """Present places of the owned nodes [m]; with small-strain laws the undeformed ones."""
    dim = problem.body.dim
    own = len(problem.unknowns.displacement_dofs) // dim
    x = problem.places[:own, :dim]
    if problem.context.linear:
        return np.asarray(x)
    return np.asarray(x + problem.u.x.array[: own * dim].reshape(-1, dim))


def _spread(problem: Problem, motion: FloatArray) -> FloatArray:
    """Displacement of the owned nodes, shape (nodes, dim), as entries of all unknowns."""
    moves, W = problem.unknowns.displacement_dofs, problem.W.dofmap
    entries = np.zeros(W.index_map.size_local * W.index_map_bs)
    entries[moves] = motion.reshape(-1)
    return entries


@dataclass(frozen=True)
class RigidMode:
    """A rigid motion that nothing prevents.

    Attributes:
        vector: Owned entries of all unknowns; v . M v = 1, and M-orthogonal to all others.
        name: In words.
    """

    vector: FloatArray
    name: str


def rigid_modes(assembler: Assembler, mass: Mass) -> list[RigidMode]:
    """The rigid motions of each connected body that the tangent maps to nothing. Collective.

    They are known from the geometry, and so is whether the tangent resists them; nothing is
    concluded from eigenvalues near zero.

    Args:
        assembler: With the tangent as it is assembled.
    """
    problem = assembler.problem
    bodies = ConnectedBodies(problem)
    own, names = len(assembler.displacement_dofs) // problem.body.dim, bodies.names()
    modes = []
    for number in range(bodies.count):
        frame = Frame(problem, mass, bodies.of_node[:own] == number)
        label = f"{names[number]}: " if names[number] else ""
        modes += [RigidMode(m.vector, label + m.name) for m in _free(assembler, frame)]
    return modes


def _free(assembler: Assembler, frame: Frame) -> list[RigidMode]:
    """Those of one body."""
    comm, problem = assembler.comm, assembler.problem
    lengths = np.sqrt(total(comm, (frame.columns**2).sum(axis=0)))
    columns = frame.columns / lengths
    null = null_combinations(assembler, columns, FREE)
    gram = total(comm, columns.T @ (frame.images / lengths))
    modes = []
    for mix in _orthogonal(null, gram):
        if problem.geometry == "axisymmetric":
            name = "move along y"
        else:
            scaled, unit = frame.scaled(mix / lengths), problem.body.unit
            (name,) = motions_in_words(scaled, frame.centre, frame.size, unit)
        modes.append(RigidMode(columns @ mix, name))
    return modes


def _orthogonal(null: FloatArray, gram: FloatArray) -> list[FloatArray]:
    """A basis of combinations, orthonormal in `gram`: pure unit motions first, where there are.

    Args:
        gram: Products of the motions that are combined.
    """
    candidates = (null @ null.T).T
    pure = [c for k, c in enumerate(candidates) if np.linalg.norm(c - np.eye(len(c))[k]) < SAME]
    result: list[FloatArray] = []
    for candidate in [*pure, *candidates]:
        size = np.sqrt(candidate @ gram @ candidate)
        rest = candidate - sum((f * (f @ gram @ candidate) for f in result), np.zeros(len(gram)))
        length = np.sqrt(max(rest @ gram @ rest, 0.0))
        if len(result) < null.shape[1] and length > SAME * max(size, 1e-300):
            result.append(rest / length)
    return result
