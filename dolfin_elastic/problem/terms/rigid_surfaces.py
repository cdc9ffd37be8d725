"""Rigid surfaces with free motion, and the results of these and of surfaces that are turned."""

from __future__ import annotations

import numpy as np

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import largest, total
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.mesh.body import span
from dolfin_elastic.model.supports.displacement import Rotation
from dolfin_elastic.problem.constraints.rigid_motion import RigidMotion
from dolfin_elastic.problem.constraints.rows import Constraints
from dolfin_elastic.problem.context import FormContext
from dolfin_elastic.problem.term import OutOfBalance, ScalarTerm, Term

TURN = 1e-5
"""Angle [rad] over which derivatives are taken: its square and round-off over it are alike."""


class RigidSurface(ScalarTerm):
    """A rigid surface: its free degrees of freedom, with equilibrium of forces and moments.

    The forces are virtual work, the sum over its nodes of (du/dq) . (force on the body).
    """

    def __init__(self, motion: RigidMotion, context: FormContext, constraints: Constraints) -> None:
        self._motion, self._constraints, self._unknowns = motion, constraints, context.unknowns
        self._comm, self.label, self.size = context.body.comm, motion.label, len(motion.free)
        is_turn = np.array(motion.free) >= context.body.dim
        self.steps = np.where(is_turn, TURN, TURN * span(context.body))
        self.signs, self.prescribing = np.ones(self.size), np.ones(self.size, dtype=bool)

    def begin(self, *, moving: bool) -> None:
        """See `Term`."""
        levers = np.abs(self._directions()[1]).max(axis=0, initial=0.0)
        self._levers = np.array([largest(self._comm, float(lever)) for lever in levers])

    def _directions(self) -> tuple[IndexArray, FloatArray]:
        dofs, D = self._constraints.motion_directions(self._motion)
        return dofs, D[:, list(self._motion.free)]

    def without_motion(self) -> InputError:
        """See `ScalarTerm`."""
        return InputError(
            "a rigid surface with free motion exists in statics only",
            where="support",
            expected="all its components prescribed, or [statics]",
        )

    def get(self) -> FloatArray:
        """The free degrees of freedom [m, rad]."""
        return self._motion.values.copy()

    def put(self, values: FloatArray) -> None:
        """Sets them and the prescribed values that depend on them."""
        self._motion.values[:] = values
        self._constraints.update_motion(self._motion)

    def residual(self, forces: OutOfBalance) -> FloatArray:
        """Forces and moments that the body needs beyond the applied ones [N, N m]. Collective."""
        dofs, D = self._directions()
        nodal = forces.owned[self._unknowns.displacement_dofs]
        own = dofs < len(nodal)
        needed = total(self._comm, D[own].T @ nodal[dofs[own]])
        return np.asarray(needed - self._constraints.motion_forces(self._motion))

    def rows(self, forces: OutOfBalance) -> list[FloatArray]:
        """Their derivatives. Collective."""
        dofs, D = self._directions()
        entries = self._unknowns.mixed_dofs(dofs)
        return [forces.along(entries, column) for column in D.T]

    def settled(self, residual: FloatArray, target: float) -> bool:
        """Forces out of balance are small, and moments over their levers, too."""
        return bool(np.all(np.abs(residual) <= target * self._levers))

    def add_results(self, result: dict[str, float], forces: FloatArray) -> None:
        """See `Term`: degrees of freedom, and moments about its point."""
        motion = self._motion
        for name, value in zip(motion.names, self._constraints.motion_values(motion), strict=True):
            result[f"{self.label}_{name}"] = float(value)
        moment = self._constraints.moment(motion, forces, self._unknowns.u.x.array)
        for axis in (name[1] for name in motion.names if name[0] == "r"):
            result[f"moment_{self.label}_{axis}"] = float(moment["xyz".index(axis)])


class TurnedSurface(Term):
    """A surface that a support turns: it has a torque among the results."""

    def __init__(self, turn: Rotation, context: FormContext, constraints: Constraints) -> None:
        self._turn, self._constraints, self.label = turn, constraints, turn.label
        self._u = context.unknowns.u

    def add_results(self, result: dict[str, float], forces: FloatArray) -> None:
        """See `Term`: those of one label are summed up."""
        moment = self._constraints.moment(self._turn, forces, self._u.x.array)
        name = f"torque_{self.label}"
        result[name] = result.get(name, 0.0) + float(np.dot(self._turn.direction, moment))
