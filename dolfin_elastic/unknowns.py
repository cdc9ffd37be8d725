"""What is solved for: the displacement, and scalar fields beside it where a problem needs them.

All unknowns are lengths and all their equations forces: a scalar field is its unknown times a
scale, so that one norm measures the whole residual.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import basix.ufl
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from dolfinx.fem import Constant
from dolfinx.mesh import Mesh
from ufl.core.expr import Expr

Dofs = npt.NDArray[np.int32]


@dataclass(frozen=True)
class Extra:
    """A scalar field beside the displacement.

    Attributes:
        name: "pressure" or "stretch" (out of the plane).
        degree: Degree of its polynomials.
        continuous: Whether it is continuous between cells.
    """

    name: str
    degree: int
    continuous: bool


class Unknowns:
    """Function spaces and functions of all unknowns. Collective to make.

    Args:
        mesh: The mesh.
        degree: Degree of the displacement.
        extras: Scalar fields beside it.

    Attributes:
        V: Space of the displacement.
        u: The displacement [m], on V.
        W: Space of all unknowns; V itself when there are no others.
        w: All unknowns; `u` itself when there are no others.
        v: Test function of the displacement.
        degree: Degree of the displacement.
        scale: Extra's name to what its unknown is multiplied by (UFL constant, 1 at first).
    """

    def __init__(self, mesh: Mesh, degree: int, extras: Sequence[Extra] = ()) -> None:
        self.extras, self.degree = tuple(extras), degree
        cell = mesh.basix_cell()
        vector = basix.ufl.element("Lagrange", cell, degree, shape=(mesh.geometry.dim,))
        self._dofs: Dofs | None = None
        if self.extras:
            scalars = [
                basix.ufl.element("Lagrange" if e.continuous else "DG", cell, e.degree)
                for e in self.extras
            ]
            self.W = fem.functionspace(mesh, basix.ufl.mixed_element([vector, *scalars]))
            self.V, dofs = self.W.sub(0).collapse()
            self._dofs = np.asarray(dofs, dtype=np.int32)
            self.w = fem.Function(self.W, name="unknowns")
            self.u = fem.Function(self.V, name="displacement")
        else:
            self.V = self.W = fem.functionspace(mesh, vector)
            self.w = self.u = fem.Function(self.V, name="displacement")
        self.tests = self._split(ufl.TestFunction(self.W))
        self.v = self.tests[0]
        self.scale = {e.name: Constant(mesh, 1.0) for e in self.extras}

    def _split(self, w: Expr) -> tuple[Expr, ...]:
        return tuple(ufl.split(w)) if self.extras else (w,)

    def displacement(self, w: Expr) -> Expr:
        """The displacement in a function, test or trial function of W."""
        return self._split(w)[0]

    def extra(self, name: str, w: Expr) -> Expr:
        """A scalar field in physical units, in a function, test or trial function of W."""
        index = [e.name for e in self.extras].index(name)
        return self.scale[name] * self._split(w)[1 + index]

    def count(self, name: str) -> int:
        """How many unknowns a scalar field has on all ranks."""
        if not self.has(name):
            return 0
        index = [e.name for e in self.extras].index(name)
        dofmap = self.W.sub(1 + index).collapse()[0].dofmap
        return int(dofmap.index_map.size_global)

    @property
    def stabilised(self) -> bool:
        """The pressure is as rich as the displacement and needs to be held."""
        return any(
            e.name == "pressure" and e.continuous and e.degree == self.degree for e in self.extras
        )

    def has(self, name: str) -> bool:
        """Whether there is such a scalar field."""
        return name in self.scale

    def places(self, dofs: Dofs) -> Dofs:
        """Entries of the displacement's local array as entries of all unknowns' local array."""
        return dofs if self._dofs is None else self._dofs[dofs]

    def tell(self) -> None:
        """Copies the displacement out of all unknowns, after they were changed."""
        if self._dofs is not None:
            self.u.x.array[:] = self.w.x.array[self._dofs]

    def take(self) -> None:
        """Copies the displacement into all unknowns, after it was changed."""
        if self._dofs is not None:
            self.w.x.array[self._dofs] = self.u.x.array
