"""The pressure of an incompressible body that is held all around: known up to a constant.

If the normal displacement of the whole surface is prescribed, a uniform pressure does no work: the
constant pressure is a null space of the tangent, and the sum of the pressure equations contains no
unknown; it is the condition that the supports do not change the volume.  Three things follow.

- One pressure of such a body is fixed in the tangent, with a pivot of the sign of the pressure
  block: all solvers, and all counts of eigenvalues, work with a regular matrix.
- The volume-weighted mean of the pressure equations is removed: J - 1 is the same constant
  everywhere, that of the volume which the supports prescribe, up to the interpolation error of
  their displacements.  If it is no small part of the volume that they sweep, there is no solution.
- The pressure with zero mean is chosen.  It is the limit for slightly compressible materials.

Several materials that are incompressible have a pressure each.  Between them the interface hands
their uniform pressures on, unless it is held; `PressureParts` finds which are free together.

Source: M. Benzi, G. Golub & J. Liesen, Acta Numerica 14 (2005), section 2.3 and 5.7; P. Bochev &
R. Lehoucq, SIAM Review 47 (2005) 50 (one pressure fixed, or none: the same solution).
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from dolfinx import la

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import smallest, total
from dolfin_elastic.core.types import FloatArray, IndexArray, IntArray
from dolfin_elastic.mesh.geometry.curved import cell_quadrature
from dolfin_elastic.mesh.geometry.simplices import outward_normals, prepare_facets
from dolfin_elastic.model.supports.displacement import Normal
from dolfin_elastic.problem.connectivity import ConnectedBodies
from dolfin_elastic.problem.material_regions import MaterialRegion, poisson
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.assembly.pressure_parts import (
    FREE,
    PressureParts,
    pressure_dofs,
    ring,
)

log = logging.getLogger("dolfin_elastic")

NEARLY = 0.4985
"""Poisson's ratio from which K times the error of J is visible in the pressure: K/mu = 300."""

BENT = 1e-3
"""Range of a component of the normals of a surface from which on it is not flat."""

ROUND_OFF = 1e-10
"""Change of volume, over the volume, that is round-off."""

REPORTED, IMPOSSIBLE = 1e-6, 0.05
"""Change of volume that supports prescribe, over what they sweep: reported from the first on,
refused from the second on; between them it is the error of smooth displacements between nodes."""


@dataclass(frozen=True)
class EnclosedBody:
    """A body that is incompressible and held all around.

    Attributes:
        label: The body, or its parts, in words.
        dofs: Entries of its pressures in the local array of all unknowns, owned.
        weights: Integrals of their shape functions over the body, over its volume.
        volume: Of the body [m^3]; in a plane its area.
        pinned: Local entry of the pressure that is fixed, one on its owner; ghosts elsewhere.
        coupled: Scalar unknowns, the motion of a rigid surface or macroscopic strains, change its
            volume: then its uniform pressure is known, but is no unknown of the fields.
        gradient: Derivative of its volume by owned displacements, entries of all unknowns [m^2].
    """

    label: str
    dofs: IndexArray
    weights: FloatArray
    volume: float
    pinned: IndexArray
    coupled: bool
    gradient: FloatArray


class HydrostaticConstant:
    """The bodies of a problem whose pressure is known up to a constant. Collective to make.

    Attributes:
        bodies: The enclosed ones.
        pinned: Local entries of the pressures that are fixed, owned and ghost.
        pivots: Diagonal of the tangent there, negative [N/m].
        nearly: What else is nearly incompressible and held all around, with a g(J) of which the
            mean is not that of J - 1: K times their difference, an error of the mesh, is in its
            pressure.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem, self._comm = problem, problem.body.comm
        self.bodies: list[EnclosedBody] = []
        self.pinned: IndexArray = np.empty(0, dtype=np.int32)
        self.pivots: FloatArray = np.empty(0)
        self._reported = False
        self.nearly: list[str] = []
        if not problem.mixed or problem.unknowns.has("stretch"):
            return
        known = PressureParts(problem, [r for r in problem.regions if r.incompressible])
        enclosed = known.enclosed()
        self.nearly = self._nearly()
        if not enclosed:
            return
        self._check_laws()
        weights = _shape_integrals(problem)
        labels = self._labels(known, enclosed)
        order = sorted(range(len(enclosed)), key=lambda k: labels[k])
        self.bodies = [self._body(known, enclosed[k], labels[k], weights) for k in order]
        self.pinned = np.concatenate([body.pinned for body in self.bodies])
        self.pivots = self._pivots(weights)

    # --- which bodies ---

    def _nearly(self) -> list[str]:
        """Labels of what is held all around and not wholly incompressible. Collective."""
        regions = [region for region in self._problem.regions if _errs(region)]
        if all(region.incompressible for region in regions):
            return []
        parts = PressureParts(self._problem, regions)
        soft = np.zeros(parts.count)
        for region in regions:
            if not region.incompressible:
                soft[parts.of_cell[region.cells]] = 1.0
        soft = total(self._comm, soft)
        enclosed = [held for held in parts.enclosed() if soft[held].any()]
        return sorted(self._labels(parts, enclosed))

    def _labels(self, parts: PressureParts, sets: list[IntArray]) -> list[str]:
        """What sets of parts are called: the body that they fill, or materials. Collective."""
        if not sets:
            return []
        bodies = ConnectedBodies(self._problem)
        names, dofs = bodies.names(), np.asarray(self._problem.unknowns.U.dofmap.list)[:, 0]
        owned = self._problem.body.owned_cells()
        sizes = total(self._comm, np.bincount(bodies.of_node[dofs[owned]], minlength=bodies.count))
        labels = []
        for held in sets:
            inside = parts.cells(held)
            counts = total(
                self._comm, np.bincount(bodies.of_node[dofs[inside]], minlength=bodies.count)
            )
            number = int(np.argmax(counts))
            materials = [
                region.name
                for region in self._problem.regions
                if total(self._comm, int(np.isin(parts.of_cell[region.cells], held).any()))
            ]
            whole = counts[number] == sizes[number]
            labels.append(_label(names[number]) if whole else f"'{'+'.join(materials)}'")
        return labels

    def _check_laws(self) -> None:
        """Refuses laws whose volume strain is not that of J.

        Raises:
            InputError: There is one.
        """
        for part in self._problem.regions:
            law = part.law
            if part.incompressible and not (law.linear or getattr(law, "strain_of_volume", False)):
                raise InputError(
                    f"the law '{law.name()}' does not keep J = 1 at nu = 0.5, and the body is "
                    "constrained on its whole surface, which prescribes its volume",
                    where=f"{part.table}.nu",
                    expected="a law with U(J), such as 'neo-hookean', or nu below 0.5",
                )

    # --- their pressures ---

    def _body(
        self, parts: PressureParts, held: IntArray, label: str, weights: FloatArray
    ) -> EnclosedBody:
        """The pressures of a set of parts; the first one of the first rank with any is fixed."""
        problem = self._problem
        space = problem.W.dofmap.index_map
        dofs = np.unique(pressure_dofs(problem)[parts.cells(held)])
        dofs = dofs[dofs < space.size_local].astype(np.int32)
        first = smallest(self._comm, float(self._comm.rank) if len(dofs) else np.inf)
        mark = la.vector(space, 1)
        mark.array[dofs[:1] if first == self._comm.rank else []] = 1.0
        mark.scatter_forward()
        pinned = np.flatnonzero(mark.array).astype(np.int32)
        own = weights[dofs]
        volume, gradient = total(self._comm, float(own.sum())), parts.gradient(held)
        coupled = self._coupled(gradient)
        return EnclosedBody(label, dofs, own / volume, volume, pinned, coupled, gradient)

    def _coupled(self, gradient: FloatArray) -> bool:
        """Whether rigid surfaces or strains that are free change a volume. Collective.

        Args:
            gradient: Of the volume, owned entries of all unknowns.
        """
        problem = self._problem
        if problem.cell is not None:
            return any(i == j for i, j in problem.cell.free)
        size = len(problem.unknowns.displacement_dofs)
        for motion in problem.constraints.rigid_motions:
            dofs, D = problem.constraints.motion_directions(motion)
            local = dofs < size
            swept = gradient[problem.unknowns.mixed_dofs(dofs[local])][:, None] * D[local]
            grown, whole = (total(self._comm, part.sum(axis=0)) for part in (swept, np.abs(swept)))
            if np.any((np.abs(grown) > FREE * whole)[list(motion.free)]):
                return True
        return False

    def _pivots(self, weights: FloatArray) -> FloatArray:
        """Diagonal of the tangent at the owned fixed pressures: that of the Schur complement."""
        scale = float(self._problem.unknowns.scale["pressure"].value)
        return -(scale**2) / self._problem.stiffness * weights[self.pinned_owned]

    @property
    def pinned_owned(self) -> IndexArray:
        """Local entries of the fixed pressures that this rank owns."""
        dofmap = self._problem.W.dofmap
        return self.pinned[self.pinned < dofmap.index_map.size_local * dofmap.index_map_bs]

    # --- what solvers ask for ---

    def balanced(
        self, rows: FloatArray, bodies: Sequence[EnclosedBody] | None = None
    ) -> FloatArray:
        """Rows of the residual, those of enclosed pressures without their mean. Collective.

        Args:
            rows: Owned entries of all unknowns [N].
            bodies: Of which; None: of all.
        """
        rows = rows.copy()
        for body in self.bodies if bodies is None else bodies:
            rows[body.dofs] -= body.weights * total(self._comm, float(rows[body.dofs].sum()))
        return rows

    def settle(self) -> bool:
        """Takes the mean out of the pressures of enclosed bodies. Collective.

        Returns:
            Whether any was changed: then reactions have changed, too.
        """
        w = self._problem.w.x
        free = [body for body in self.bodies if not body.coupled]
        if free:
            w.array[:] = self.without_mean(w.array, free)
            w.scatter_forward()
        return bool(free)

    def without_mean(self, values: FloatArray, bodies: Sequence[EnclosedBody]) -> FloatArray:
        """Unknowns without the mean of the pressures of bodies, owned entries first. Collective."""
        values = values.copy()
        for body in bodies:
            own = float(np.sum(body.weights * values[body.dofs]))
            values[body.dofs] -= total(self._comm, own)
        return values

    def report(self) -> None:
        """Logs which pressures are known up to a constant."""
        for note in self.notes():
            doubtful = "error of the mesh" in note or "slide along" in note
            log.log(logging.WARNING if doubtful else logging.INFO, "%s", note)

    def _error_notes(self) -> list[str]:
        return [
            f"{label} is nearly incompressible and has no free surface: the mean of its "
            "pressure is K times an error of the mesh, for its U(J) is not quadratic; nu = 0.5, or "
            'volumetric = "quadratic", has no such error'
            for label in self.nearly
        ]

    def notes(self) -> list[str]:
        """What a user should know of the enclosed bodies. Collective."""
        result = self._error_notes() + [
            f"{body.label} is incompressible and has no free surface: its pressure is known up to "
            "a constant, and is set so that its mean is zero"
            for body in self.bodies
            if not body.coupled
        ]
        if self.bodies and (names := _curved_rollers(self._problem)):
            result.append(
                f"rollers on curved surfaces ({', '.join(names)}) let nodes slide along straight "
                "tangents, which changes the volume by half the square of the sliding times the "
                "curvature; the body is incompressible and constrained on its whole surface, so "
                "that it slides by "
                "small steps only and needs many of them; a contact with a sphere or cylinder "
                "keeps to the surface"
            )
        return result

    def check_volumes(self, rows: FloatArray) -> None:
        """Compares what supports leave the bodies with their volumes. Collective.

        Args:
            rows: Owned entries of the residual at the present displacement [N].

        Raises:
            InputError: The supports change the volume of a body that cannot change it.
        """
        if not self.bodies:
            return
        moves = self._problem.unknowns.displacement_dofs
        w = self._problem.w.x.array[moves]
        scale = float(self._problem.unknowns.scale["pressure"].value) * self._problem.thickness
        for body in self.bodies:
            swept = total(self._comm, float(np.sum(np.abs(body.gradient[moves] * w))))
            change = total(self._comm, float(rows[body.dofs].sum())) / scale
            if abs(change) > max(IMPOSSIBLE * swept, ROUND_OFF * body.volume):
                raise InputError(
                    f"{body.label} is incompressible and constrained on its whole surface, and its "
                    "supports, or "
                    f"heat or growth, change its volume by {abs(change) / body.volume:.3g} of it",
                    where="support",
                    expected="a surface that is free to move along its normal, or nu below 0.5",
                )
            if abs(change) > max(REPORTED * swept, ROUND_OFF * body.volume) and not self._reported:
                self._reported = True
                log.info(
                    "%s is constrained on its whole surface by displacements that change its "
                    "volume by %.2g of what "
                    "they sweep: it is spread evenly over the body",
                    body.label,
                    abs(change) / swept,
                )


def _label(name: str) -> str:
    return f"the body '{name}'" if name else "the body"


def _curved_rollers(problem: Problem) -> list[str]:
    """Surfaces that are not flat and held along their normals alone. Collective.

    In the linearised problem nothing distinguishes them from flat ones.  At a finite displacement
    the volume depends on the tangential displacements, to their second order: the mean of the
    pressure equations, which is removed, has a derivative that is in no column of the tangent.
    """
    body, result = problem.body, []
    prepare_facets(body.mesh)
    for support in problem.supports:
        for name in support.surfaces if isinstance(support, Normal) else ():
            normals = outward_normals(body.mesh, body.owned_facets(name))
            most: FloatArray = np.full((2, body.dim), -np.inf)
            if len(normals):
                most = np.stack([normals.max(axis=0), -normals.min(axis=0)])
            if np.max(np.max(body.comm.allgather(most), axis=0).sum(axis=0)) > BENT:
                result.append(f"'{name}'")
    return result


def _errs(part: MaterialRegion) -> bool:
    """Whether a material's mean pressure, where it is enclosed, has the error of the mesh."""
    if part.incompressible:
        return True
    curved = part.compliance is not None and bool(getattr(part.law, "curved_strain", False))
    return curved and poisson(part.typical) > NEARLY


def _shape_integrals(problem: Problem) -> FloatArray:
    """Integrals of the shape functions of pressures, owned entries of all unknowns. Collective."""
    mesh = problem.body.mesh
    cells = problem.body.owned_cells()
    points = cell_quadrature(mesh, cells, 2)
    corners = np.column_stack([1 - points.local.sum(axis=1), points.local])
    sums = np.einsum("cp,pk->ck", points.weights * ring(problem, points.X), corners)
    vector = la.vector(problem.W.dofmap.index_map, problem.W.dofmap.index_map_bs)
    np.add.at(vector.array, pressure_dofs(problem)[cells].reshape(-1), sums.reshape(-1))
    vector.scatter_reverse(la.InsertMode.add)
    size = problem.W.dofmap.index_map.size_local * problem.W.dofmap.index_map_bs
    return np.asarray(vector.array[:size].copy())
