"""Tangents by the half of their blocks, assembled again and again."""

from __future__ import annotations

from petsc4py import PETSc

from dolfin_elastic.core.types import IntArray
from dolfin_elastic.solvers.assembly.dofs import ConstrainedDofs
from dolfin_elastic.solvers.assembly.matrix import marked
from dolfin_elastic.solvers.assembly.node_blocks import NodeBlocks, node_blocks
from dolfin_elastic.solvers.assembly.scalar_mass import InertiaForces
from dolfin_elastic.solvers.assembly.symmetric.blocks import SymmetricBlocks
from dolfin_elastic.solvers.assembly.two_stage.form import TwoStageForm


class SymmetricMatrix:
    """A tangent of a displacement as `SymmetricBlocks`; see `matrix.TangentMatrix`. Collective.

    Args:
        dofs: Whose displacement is the only unknown.
        more: Symmetric blocks beside those of the form; None without any.
        inertia: What is added, too; None: nothing.

    Attributes:
        petsc: The PETSc matrix, of type "python", owned here.
        blocks: Its blocks; others as soon as `more` has other pairs of nodes.
    """

    def __init__(
        self,
        dofs: ConstrainedDofs,
        form: TwoStageForm,
        more: NodeBlocks | None = None,
        inertia: InertiaForces | None = None,
    ) -> None:
        self._dofs, self._form, self._more, self._inertia = dofs, form, more, inertia
        self._rest = NodeBlocks(dofs, form.rest_blocks) if form.has_rest else None
        self._parts = [part for part in (self._rest, more) if part is not None]
        self._patterns: list[int] = []
        self._places: list[IntArray] = []
        self.blocks = SymmetricBlocks(dofs.problem, form.form)
        self.petsc = self.blocks.petsc()

    def assemble(self) -> None:
        """Assembles the form, with ones on the diagonal of prescribed rows. Collective."""
        parts = [node_blocks(part.free(), self.blocks.dim) for part in self._parts]
        if (patterns := [part.pattern for part in self._parts]) != self._patterns:
            if self._more is not None:
                pairs = parts[-1][:2]
                self.blocks = SymmetricBlocks(self._dofs.problem, self._form.form, pairs)
                self.petsc.setPythonContext(self.blocks)  # which destroys the one before
            self._places = [self.blocks.places(*part[:2]) for part in parts]
            self._patterns = patterns
        self._form.assemble_half(self.blocks, self._dofs.bcs)
        if self._inertia is not None:
            fixed = marked(self._dofs.bcs, self.blocks.dim * self.blocks.halo.size)
            self._inertia.add_to_half(self.blocks, fixed)
        for coordinates, part in zip(self._places, parts, strict=True):
            self.blocks.add_at(coordinates, part[2])
        self.blocks.assembled(self._dofs.prescribed_dofs)
        self.petsc.stateIncrease()
        self.petsc.assemble()

    def aij(self) -> PETSc.Mat:
        """The same as an AIJ matrix, which the caller destroys. Collective."""
        return self.blocks.aij()

    def destroy(self) -> None:
        """Frees the PETSc matrix. Collective."""
        if self._rest is not None:
            self._rest.destroy()
        self.petsc.destroy()


def can_be_halved(dofs: ConstrainedDofs, form: TwoStageForm) -> bool:
    """Whether the tangent is symmetric and no rows of it are combined. Not collective."""
    problem = dofs.problem
    combined = dofs.combined or problem.cell is not None
    return form.can_be_halved and problem.symmetric and not combined
