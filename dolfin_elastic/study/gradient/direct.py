"""`Direct`: derivatives by the motion of an equilibrium, which takes one search a parameter.

The tangent of contact between surfaces of the mesh leaves out how the cut of their faces changes,
so that its transpose gives no adjoint.  There the motion v = dw/dm of the unknowns and the rates of
the pressures p are found from

    J v + dR/dp dp/dm = -dR/dm,    dp/dm = d(p - eps g)/dm,

with the gaps g: steps with the tangent K against what is left of the first, and Uzawa's update of
the second.  Products with J are central differences along v, exact whatever K leaves out.
Source: as of `solvers.nonlinear.adjoint` (direct differentiation); Uzawa as in `Terms.solve_again`.
"""

from __future__ import annotations

import numpy as np

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import largest, total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.solvers.nonlinear.mixing import Mixing
from dolfin_elastic.study.gradient.parameters import Equilibrium, Sides, move_prescribed

NEAR = 1e-5
"""Of a cell's size, by which the unknowns are moved for a difference; scalars by their `steps`."""
SETTLED = 1e-8
"""Change of the motion over the motion."""
_STEPS = 100
"""With the tangent, each of which gains a digit or so."""


class Direct:
    """Finds motions of one equilibrium. Collective.

    Args:
        here: Whose solver has assembled the tangent there, with what it keeps in contact.
    """

    def __init__(self, here: Equilibrium) -> None:
        self._here, self._newton = here, here.newton
        self._pairs = here.problem.contact_pairs
        self._start, self._pressures = self._newton.unknowns(), [p.values() for p in self._pairs]
        self._eps = np.concatenate([np.zeros(0), *(pair.eps for pair in self._pairs)])

    def total(self, by: Sides) -> Sides:
        """What a parameter changes with the motion: numbers alone, for nothing is left of others.

        Args:
            by: Derivatives by the parameter at fixed unknowns.

        Raises:
            InputError: The motion was not found.
        """
        comm = self._here.problem.body.comm
        mixing = Mixing(comm)
        cuts = np.cumsum([self._newton.assembler.size, len(self._eps)])
        present: FloatArray = np.zeros(cuts[1] + len(by.equations))
        for _ in range(_STEPS):
            motion, lengths, scalars = np.split(present, cuts)
            pressures = lengths * self._eps
            along = self._along(motion, scalars, pressures)
            step, more = self._newton.correction(
                by.forces + along.forces, by.equations + along.equations
            )
            at_rest = self._along(motion + step, scalars + more, 0 * pressures)
            change = np.concatenate([step, (by.pressures + at_rest.pressures) / self._eps, more])
            sizes = total(comm, np.array([np.sum(change**2), np.sum(present**2)]))
            if sizes[0] <= SETTLED**2 * sizes[1]:
                none = np.zeros_like(by.forces), np.zeros_like(by.equations)
                return Sides(*none, by.numbers + along.numbers)
            present = mixing.next(present, change)
        raise InputError(
            f"the motion by a parameter was not found: contact has not settled in {_STEPS} steps",
            where="gradient",
            expected="`sweep`, or a stiffer contact",
        )

    def _along(self, motion: FloatArray, scalars: FloatArray, pressures: FloatArray) -> Sides:
        """Derivatives along a motion of the unknowns and of the pressures.

        Args:
            motion: Of owned entries of the fields [m, or as they are, by the parameter].
            scalars: Of the scalar unknowns, in the order of `Newton.bordered`.
            pressures: Of the multipliers of contact, in the order of `pressures_of` [Pa by it].
        """
        assembler = self._newton.assembler
        near, bordered = NEAR * self._newton.cell_size, self._newton.bordered
        ways = [motion[assembler.displacement_dofs] / near, pressures / self._eps / near]
        if bordered is not None:  # an obstacle may move much farther than the body
            ways.append(scalars / bordered.scalars.steps)
        longest = largest(assembler.comm, float(np.abs(np.concatenate(ways)).max(initial=0.0)))
        step = 1 / longest if longest else 1.0
        ends = []
        try:
            for sign in (step, -step):
                self._move(sign * motion, sign * scalars, sign * pressures)
                ends.append(self._here.evaluated())
        finally:
            self._restore()
        first, last = (vars(one) for one in ends)
        differences = {
            name: np.asarray((first[name] - last[name]) / (2 * step), dtype=np.float64)
            for name in first
        }
        return Sides(**differences)

    def _move(self, motion: FloatArray, scalars: FloatArray, pressures: FloatArray) -> None:
        """Moves all unknowns from the equilibrium. Collective."""
        unknowns, start = self._start.copy(), 0
        unknowns[: len(motion)] += motion
        unknowns[len(unknowns) - len(scalars) :] += scalars
        self._newton.put_back(unknowns)
        for pair, values in zip(self._pairs, self._pressures, strict=True):
            pair.lam.x.array[pair.nodes] = values + pressures[start : start + len(values)]
            pair.lam.x.scatter_forward()
            start += len(values)
        move_prescribed(self._newton.assembler)

    def _restore(self) -> None:
        """To the last bit, for a run that goes on. Collective."""
        for pair, values in zip(self._pairs, self._pressures, strict=True):
            pair.lam.x.array[pair.nodes] = values
            pair.lam.x.scatter_forward()
        self._newton.put_back(self._start)
