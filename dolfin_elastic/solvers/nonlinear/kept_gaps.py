"""`KeptGaps`: the gaps that contact keeps closed, as constraints of an adjoint.

With the gaps g of the vertices in contact, their areas A and multipliers lam, contact does the work
-A (lam - eps g) . g_w v on a motion v.  So the derivative of the work on an adjoint by lam is minus
A times the rate at which the gaps open along it: these rates vanish.  Where scalar unknowns s move
an obstacle, or what supports prescribe, equations of s are work on such a motion, too.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.nonlinear.bordered import Bordered


class KeptGaps:
    """The gaps of all contacts of a problem, one after the other.  All of it is collective.

    Args:
        assembler: Of a problem whose contacts keep what presses, see `Pressures.keep`.
        bordered: Scalar unknowns with their equations; None: there are none.

    Attributes:
        eps: Penalties at owned vertices [Pa/m].
        stiffness: Penalties times areas [N/m].
    """

    def __init__(self, assembler: Assembler, bordered: Bordered | None) -> None:
        problem = assembler.problem
        self._assembler, self._bordered, self._pairs = assembler, bordered, problem.contact_pairs
        self._entries = problem.unknowns.mixed_dofs(np.arange(len(problem.u.x.array), dtype="i4"))
        self._gaps = [pair.linearised for pair in self._pairs]
        self.eps = np.concatenate([pair.eps for pair in self._pairs])
        self.stiffness = self.eps * np.concatenate([one.areas for one in self._gaps])
        self._cuts = np.cumsum([len(pair.nodes) for pair in self._pairs])[:-1]
        dim, scalars = problem.body.dim, None if bordered is None else bordered.scalars
        self._shifts = [
            np.zeros((0, dim)) if scalars is None else scalars.shifts(pair.pose)
            for pair in self._pairs
        ]

    def way(
        self, fields: FloatArray, scalars: FloatArray, motion: FloatArray | None
    ) -> list[FloatArray]:
        """A motion of all local nodes as each contact has it, shape (nodes * dim,) [m].

        Args:
            fields: Owned entries of free unknowns.
            scalars: Those of scalar unknowns, with what they prescribe.
            motion: Added to it, owned entries; None: nothing.
        """
        assembler = self._assembler
        way = assembler.ghosted_vector()
        whole = way.array[: len(fields)]
        whole[:] = fields
        if (bordered := self._bordered) is not None:
            for s, column in zip(scalars, bordered.columns, strict=True):
                whole -= s * bordered.prescribed_part(column)
        assembler.extend(way.array)
        if motion is not None:
            whole += motion
        way.scatter_forward()
        moved = way.array[self._entries].reshape(-1, assembler.problem.body.dim)
        return [(moved - scalars @ shifts).ravel() for shifts in self._shifts]

    def rates(self, way: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
        """How gaps open along a motion, and how far it moves the vertices, both (n,) [m].

        Args:
            way: See `way`.
        """
        rates, sizes = list[FloatArray](), list[FloatArray]()
        dim = self._assembler.problem.body.dim
        for pair, gaps, past in zip(self._pairs, self._gaps, way, strict=True):
            rates.append(gaps.rates(past))
            moved = past.reshape(-1, dim)[pair.nodes_of_displacement]
            sizes.append(np.linalg.norm(moved, axis=1))
        return np.concatenate(rates), np.concatenate(sizes)

    def left_out(self, way: Sequence[FloatArray], multipliers: FloatArray) -> FloatArray:
        """What the tangent and `loads` leave out, owned entries of all unknowns.

        Args:
            way: See `way`; the work along it is differentiated.
            multipliers: See `loads`.
        """
        result: FloatArray = np.zeros(self._assembler.size)
        parts = np.split(multipliers, self._cuts)
        for gaps, past, own in zip(self._gaps, way, parts, strict=True):
            if (more := gaps.left_out(past, own)) is not None:
                result += more
        return result

    def loads(self, multipliers: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives of the gaps by fields and scalars, times multipliers.

        Args:
            multipliers: At owned vertices, areas included [N].

        Returns:
            Owned entries of all unknowns, and an entry for each scalar.
        """
        assembler, dim = self._assembler, self._assembler.problem.body.dim
        fields: FloatArray = np.zeros(assembler.size)
        scalars: FloatArray = np.zeros(0 if self._bordered is None else self._bordered.scalars.size)
        parts = np.split(multipliers, self._cuts)
        for gaps, own, shifts in zip(self._gaps, parts, self._shifts, strict=True):
            forces = gaps.spread(own / gaps.areas)
            rows = forces[assembler.displacement_dofs].reshape(-1, dim)
            fields += forces
            scalars -= shifts @ total(assembler.comm, rows.sum(axis=0))
        return fields, scalars
