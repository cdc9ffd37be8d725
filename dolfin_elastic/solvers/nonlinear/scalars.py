"""Scalar unknowns of a problem: pressures of cavities, motions of rigid surfaces, strains.

And the uniform pressure of an incompressible body whose volume only they change.
"""

from __future__ import annotations

import logging

import numpy as np
import ufl
from dolfinx import fem, la

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.mesh.body import span
from dolfin_elastic.model.supports.displacement import Rotation
from dolfin_elastic.problem.constraints.rigid_motion import RigidMotion
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.terms.cavities import BodyCavity
from dolfin_elastic.solvers.assembly.assembler import Assembler, compiled, integral
from dolfin_elastic.solvers.assembly.cell_stress import CellStress
from dolfin_elastic.solvers.nonlinear.bordered import JoinedScalars, ScalarUnknowns
from dolfin_elastic.solvers.nonlinear.uniform_pressure import UniformPressure

log = logging.getLogger("dolfin_elastic")


ROUND_OFF = 1e-14
"""Error of the mean stress over the cell's stiffness, of which strains are computed."""


class FreeStrains:
    """Free components of the macroscopic gradient; their stress is prescribed.

    As unknown each is multiplied by the length of the cell, and its equation V (P - P*) divided by
    it, so that they are a length and a force as those of the nodes are.
    """

    def __init__(self, mean: CellStress) -> None:
        self._mean, self._cell, problem = mean, mean.cell, mean.problem
        self._free, self.size = self._cell.free, len(self._cell.free)
        self.steps = np.full(self.size, 1e-5 * self._cell.length)
        # The residual is the derivative of the energy with respect to them.
        self.signs = np.ones(self.size)
        self.prescribing = np.zeros(self.size, dtype=bool)
        row = ufl.derivative(mean.mean, problem.w, ufl.TestFunction(problem.W))
        self._row = mean.compiled([row])[0]
        self._stiffness = 0.0

    def get(self) -> FloatArray:
        """The free strains times the length of the cell [m]."""
        return self._cell.free_values() * self._cell.length

    def put(self, values: FloatArray) -> None:
        """Sets the free strains."""
        self._cell.set_free(np.asarray(values / self._cell.length, dtype=np.float64))

    @property
    def _area(self) -> float:
        return self._cell.volume / self._cell.length

    def residual(self) -> FloatArray:
        """Stress minus prescribed stress, times the area of a face [N]."""
        gaps = [self._mean.component(*ij) - self._cell.stress[ij] for ij in self._free]
        return self._area * np.array(gaps)

    def rows(self) -> list[FloatArray]:
        """Its derivative with respect to the fields."""
        self._measure_stiffness()
        result, dofmap = [], self._mean.problem.W.dofmap
        size = dofmap.index_map.size_local * dofmap.index_map_bs
        for ij in self._free:
            self._mean.select(*ij)
            row = la.vector(dofmap.index_map, dofmap.index_map_bs)
            fem.assemble_vector(row.array, self._row)
            row.scatter_reverse(la.InsertMode.add)
            result.append(row.array[:size] / self._cell.length)
        return result

    def _measure_stiffness(self) -> None:
        """Measures the stiffness of the cell by differences, for the round-off of stresses."""
        values = self.get()
        result = np.zeros(self.size)
        for b, h in enumerate(self.steps):
            sides = []
            for moved in (h, -h):
                self.put(values + moved * (np.arange(self.size) == b))
                sides.append(self.residual()[b])
            result[b] = (sides[0] - sides[1]) / (2 * h)
        self.put(values)
        self._stiffness = float(np.abs(result).max())

    def settled(self, residual: FloatArray, target: float) -> bool:
        """The stresses are as prescribed, to the tolerance of forces or to round-off.

        The force of a face is spread over its nodes, the target is a norm of nodal forces.

        Args:
            residual: Stress minus prescribed stress, times the area of a face [N].
            target: See `ScalarUnknowns`.
        """
        own = target * np.sqrt(self._cell.pairing.face_nodes)
        floor = ROUND_OFF * self._stiffness * self._cell.length
        return bool(np.abs(residual).max() <= max(own, floor))


def free_strains(mean: CellStress | None) -> FreeStrains | None:
    """The components of the gradient that are unknown, if there are any. Collective."""
    return None if mean is None or not mean.cell.free else FreeStrains(mean)


VOLUME = 1e-10
"""Error of a prescribed volume, as a share of it: the next Newton step would find round-off."""

OPEN = 1e-6
"""Share of the derivative of the volume that is round-off."""

TURN = 1e-5
"""Angle [rad] over which derivatives are taken: its square and round-off over it are alike."""


class Scalars:
    """All scalar unknowns of a problem, and results of them. Collective to make.

    Attributes:
        parts: The groups: the order is that of `JoinedScalars`.
        joined: All of them as one; None without any.
    """

    def __init__(self, assembler: Assembler) -> None:
        self._assembler, problem = assembler, assembler.problem
        self._prescribed = problem.constraints
        self._cavities = [CavityScalars(assembler, cavity) for cavity in problem.cavities]
        self.parts: list[ScalarUnknowns] = [c for c in self._cavities if c.cavity.volume_controlled]
        self.parts += [
            RigidSurface(assembler, motion)
            for motion in self._prescribed.rigid_motions
            if len(motion.free)
        ]
        if (strains := free_strains(assembler.cell)) is not None:
            self.parts.append(strains)
        enclosed = [] if assembler.level is None else assembler.level.bodies
        self.parts += [UniformPressure(assembler, body) for body in enclosed if body.coupled]
        self.joined = JoinedScalars(self.parts) if self.parts else None

    def get(self) -> list[float]:
        """All scalar unknowns."""
        return [] if self.joined is None else [float(value) for value in self.joined.get()]

    def numbers(self, inertia: FloatArray | None = None) -> dict[str, float]:
        """Results of cavities, rigid and turned surfaces, and periodic cells [SI]. Collective.

        The residual is assembled, so that its forces are up to date.

        Args:
            inertia: Forces of it at the owned displacements, if it is not among those [N].
        """
        cell = self._assembler.cell
        result = {} if cell is None else cell.numbers()
        for chamber in self._cavities:
            if chamber.closed:
                result[f"volume_{chamber.cavity.label}"] = chamber.volume()
            result[f"pressure_{chamber.cavity.label}"] = chamber.cavity.pressure
        for motion in self._prescribed.rigid_motions:
            values = self._prescribed.motion_values(motion)
            for name, value in zip(motion.names, values, strict=True):
                result[f"{motion.label}_{name}"] = float(value)
            moment = self._moment(motion, inertia)
            for name in motion.names:
                if name[0] == "r":
                    axis = name[1]
                    result[f"moment_{motion.label}_{axis}"] = float(moment["xyz".index(axis)])
        for support in self._assembler.problem.supports:
            if isinstance(support, Rotation):
                torque = float(np.dot(support.direction, self._moment(support, inertia)))
                name = f"torque_{support.label}"
                result[name] = result.get(name, 0.0) + torque
        return result

    def _moment(self, motion: RigidMotion | Rotation, inertia: FloatArray | None) -> FloatArray:
        """Moment of a support on the body about its point [N m], shape (3,). Collective."""
        forces = self._assembler.residual.vector.array[self._assembler.displacement_dofs]
        if inertia is not None:
            forces = forces + inertia
        return self._prescribed.moment(motion, forces, self._assembler.problem.u.x.array)


class CavityScalars:
    """A cavity: its pressure, and volume = given volume as its equation. Collective to make.

    Attributes:
        cavity: The cavity.
        closed: Its surfaces and planes of symmetry enclose it, so that it has a volume.
        initial: Volume of the undeformed cavity [m^3].

    Raises:
        InputError: Its volume is prescribed, but it is open; or it has none.
    """

    size = 1

    def __init__(self, assembler: Assembler, cavity: BodyCavity) -> None:
        self._assembler, self._problem, self.cavity = assembler, assembler.problem, cavity
        w, test = self._problem.w, ufl.TestFunction(self._problem.W)
        grown = ufl.derivative(cavity.volume, w, test)
        lost = ufl.derivative(cavity.exact, w, test) - cavity.push
        self._forms = compiled(self._problem, [cavity.volume, grown, lost])
        # The residual is linear in the pressure: a large difference has no error but round-off.
        self.steps, self.signs = np.array([self._problem.stiffness]), np.array([-1.0])
        self.prescribing = np.zeros(1, dtype=bool)
        self.initial, self.closed = self._undeformed()
        if not self.initial > 0.0 and (cavity.volume_controlled or self.closed):
            raise InputError(
                f"the surfaces of the cavity '{cavity.label}' enclose {self.initial:.3g} m^3",
                where=cavity.where,
                expected="all surfaces around it, and an origin in all planes of symmetry",
            )
        if not self.closed:
            self._report_open()

    def _is_closed(self) -> bool:
        """The pressure's work is that on the volume: nothing flows through the rim. Collective."""
        a = self._assembler
        size, loss = np.sqrt(
            [
                total(a.comm, float(np.sum((v - a.constrained_part(v)) ** 2)))
                for v in (a.reactions.nodal(form) for form in self._forms[1:])
            ]
        )
        return bool(loss <= OPEN * size)

    def _report_open(self) -> None:
        """A volume that is prescribed must be one; a pressure acts all the same."""
        text = (
            f"the cavity '{self.cavity.label}' is open: a part of its rim is not held in a plane "
            "through its origin"
        )
        if self.cavity.volume_controlled:
            raise InputError(
                text,
                where=self.cavity.where,
                expected="all surfaces around it, supports in planes of symmetry, and an origin "
                "in all of them",
            )
        log.warning("%s, so it has no volume in the results", text)

    def _undeformed(self) -> tuple[float, bool]:
        """The volume [m^3] of the undeformed body, and whether it is closed. Collective."""
        w = self._problem.w.x.array
        present = w.copy()
        w[:] = 0.0
        result = self.volume(), self._is_closed()
        w[:] = present
        return result

    def volume(self) -> float:
        """Present volume [m^3]. Collective."""
        return integral(self._problem, self._forms[0])

    def get(self) -> FloatArray:
        """The pressure [Pa]."""
        return np.array([self.cavity.pressure])

    def put(self, values: FloatArray) -> None:
        """Sets it."""
        self.cavity.set_pressure(float(values[0]))

    def residual(self) -> FloatArray:
        """Volume beyond the given one [m^3]. Collective."""
        return np.array([self.volume() - self._prescribed_volume])

    def rows(self) -> list[FloatArray]:
        """Its derivative [m^2]. Collective."""
        return [self._assembler.reactions.nodal(self._forms[1])]

    def settled(self, residual: FloatArray, target: float) -> bool:
        """The volume is the given one.

        Args:
            target: See `ScalarUnknowns`.
        """
        return bool(abs(residual[0]) <= VOLUME * max(self.initial, abs(self._prescribed_volume)))

    @property
    def _prescribed_volume(self) -> float:
        return self.cavity.prescribed_volume(self.initial)


class RigidSurface:
    """A rigid surface: its free degrees of freedom, with equilibrium of forces and moments.

    The forces are virtual work, the sum over its nodes of (du/dq) . (force on the body).
    Collective to make.
    """

    def __init__(self, assembler: Assembler, motion: RigidMotion) -> None:
        self._assembler, self._problem, self._motion = assembler, assembler.problem, motion
        problem = self._problem
        self._prescribed, self.size = problem.constraints, len(motion.free)
        dim = problem.body.dim
        length = span(problem.body)
        is_turn = np.array(motion.free) >= dim
        self.steps, self.signs = np.where(is_turn, TURN, TURN * length), np.ones(self.size)
        self.prescribing = np.ones(self.size, dtype=bool)
        self._along = fem.Function(problem.W)
        test = ufl.TestFunction(problem.W)
        works = ufl.derivative(ufl.action(problem.weak_form.residual, self._along), problem.w, test)
        self._work = compiled(problem, [works])[0]
        _, D = self._directions()
        lever = np.abs(D).max(axis=0, initial=0.0)
        self._levers = np.array([max(problem.body.comm.allgather(x)) for x in lever])

    def _directions(self) -> tuple[IndexArray, FloatArray]:
        dofs, D = self._prescribed.motion_directions(self._motion)
        return dofs, D[:, list(self._motion.free)]

    def get(self) -> FloatArray:
        """The free degrees of freedom [m, rad]."""
        return self._motion.values.copy()

    def put(self, values: FloatArray) -> None:
        """Sets them and the prescribed values that depend on them."""
        self._motion.values[:] = values
        self._prescribed.update_motion(self._motion)

    def residual(self) -> FloatArray:
        """Forces and moments that the body needs beyond the applied ones [N, N m]. Collective."""
        dofs, D = self._directions()
        forces = self._assembler.residual.vector.array[self._assembler.displacement_dofs]
        own = dofs < len(forces)
        needed = total(self._problem.body.comm, D[own].T @ forces[dofs[own]])
        return np.asarray(needed - self._prescribed.motion_forces(self._motion))

    def rows(self) -> list[FloatArray]:
        """Their derivatives. Collective."""
        dofs, D = self._directions()
        offsets = self._problem.unknowns.mixed_dofs(dofs)
        result = []
        for column in D.T:
            self._along.x.array[:] = 0.0
            self._along.x.array[offsets] = column
            self._along.x.scatter_forward()
            result.append(self._assembler.reactions.nodal(self._work))
        return result

    def settled(self, residual: FloatArray, target: float) -> bool:
        """Forces out of balance are small, and moments over their levers, too.

        Args:
            target: See `ScalarUnknowns`.
        """
        return bool(np.all(np.abs(residual) <= target * self._levers))


def refuse_scalars(problem: Problem) -> None:
    """Motion has no scalar unknowns.

    Raises:
        InputError: The problem has some.
    """
    if any(cavity.volume_controlled for cavity in problem.cavities):
        raise InputError(
            "a cavity with a given volume exists in statics only",
            where="load",
            expected="its pressure, or [statics]",
        )
    if any(len(motion.free) for motion in problem.constraints.rigid_motions):
        raise InputError(
            "a rigid surface with free motion exists in statics only",
            where="support",
            expected="all its components prescribed, or [statics]",
        )
