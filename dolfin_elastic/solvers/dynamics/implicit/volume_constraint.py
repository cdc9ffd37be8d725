"""The equation of the pressure in a step: for the volumes at its ends, not at its stage.

The volume of a mean displacement is not the mean volume: the mean of two positions of a point that
rotates lies on the chord of its arc, too near to the axis by the square of the angle.  With g = 0
at the stage, u_s = (1 - alpha_f) u1 + alpha_f u0, points of a rotating body end outside of their
circle in one step and on it in the next.  The acceleration for that is as large as the centripetal
one, however small the step: the pressure swings between nothing and twice its value.  So the
equation is

    (1 - alpha_f) g(u1) + alpha_f g(u0) = p/k,

p of the stage, and of exactly incompressible materials, 1/k = 0, g(u1) = 0.  The work of p over a
step is then the change of p^2/(2k) but for terms of the third order of the step.

Sources: J. C. Simo & N. Tarnow, ZAMP 43 (1992) 757 (stresses of mean strains, not of the mean
displacement); M. Arnold & O. Bruels, BIT 47 (2007) 185, (14) (constraints at the end of each step
of generalized-alpha).

The tangent keeps the gradient of g at the stage in these rows, so that it stays symmetric; it is
off by the angle of rotation in a step, and Newton's method takes 5 iterations instead of 3
where that is 0.1 rad.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import ufl
from dolfinx import fem

from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.material_regions import MaterialRegion
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.assembly.assembler import Assembler, compiled


class VolumeConstraint:
    """Replaces the pressure's rows at the stage by the volume constraint at the end of the step.

    Collective to make.

    Args:
        alpha_f: Share of the old displacement in the stage's.
    """

    def __init__(self, assembler: Assembler, alpha_f: float) -> None:
        self._assembler, self._problem = assembler, assembler.problem
        self._share = alpha_f
        parts = [part for part in self._problem.regions if part.compliance is not None]
        compressible = [part for part in parts if not part.incompressible]
        forms = [_strain(self._problem, group) for group in (parts, compressible) if group]
        compiled_forms = compiled(self._problem, forms)
        self._with_pressure, self._compressible = (
            compiled_forms[0],
            compiled_forms[1] if compressible else None,
        )
        entries = np.ones(len(self._problem.w.x.array), dtype=bool)
        displacements = np.arange(len(self._problem.u.x.array), dtype=np.int32)
        entries[self._problem.unknowns.mixed_dofs(displacements)] = False
        self._scalars = entries
        self._old: FloatArray = np.empty(0)
        self._compressible_part: FloatArray = np.zeros(assembler.size)
        self._end = 0.0

    @staticmethod
    def needed(problem: Problem, alpha_f: float) -> bool:
        """Whether there is a pressure, and a stage that is not the end of the step.

        In plane stress the stretch out of the plane takes up the volume.

        Args:
            alpha_f: Share of the old displacement in the stage's.
        """
        return alpha_f > 0.0 and problem.mixed and not problem.unknowns.has("stretch")

    def begin(self, t: float) -> None:
        """Stores the displacement at the start of a step. Collective.

        Args:
            t: Time of the start [s].
        """
        self._problem.set_time(t)
        self._old = self._problem.w.x.array.copy()
        self._compressible_part = self._share * self._rows(self._compressible, self._old)

    def end_at(self, t: float) -> None:
        """Sets the end of the step that is tried. Not collective.

        Args:
            t: Its time [s], of which growth and temperatures are taken, too.
        """
        self._end = t

    def complete(self) -> None:
        """Adds the difference of the constraints at step and stage to the residual. Collective."""
        here, s = self._problem.w.x.array.copy(), self._share
        end = self._old + (here - self._old) / (1 - s)
        more = self._compressible_part - self._rows(self._with_pressure, here)
        now = float(self._problem.t.value)
        self._problem.set_time(self._end)
        more += (1 - s) * self._rows(self._with_pressure, end)
        self._problem.set_time(now)
        self._problem.w.x.array[:] = here
        self._assembler.residual.vector.array[: len(more)] += more

    def _rows(self, form: fem.Form | None, w: FloatArray) -> FloatArray:
        """g of a displacement at zero pressure, in the rows of all unknowns [N].

        Args:
            form: Of the regions that count; None: of none.
            w: All unknowns, local entries.
        """
        if form is None:
            return np.zeros(self._assembler.size)
        self._problem.w.x.array[:] = np.where(self._scalars, 0.0, w)
        forces = self._assembler.reactions.nodal(form)
        self._problem.w.x.array[:] = w
        return forces


def _strain(problem: Problem, parts: Sequence[MaterialRegion]) -> ufl.Form:
    F = problem.weak_form.F(problem.w)
    q = problem.unknowns.auxiliary("pressure", ufl.TestFunction(problem.W))
    return sum(problem.weak_form.volume_gap(part, F, q) for part in parts)
