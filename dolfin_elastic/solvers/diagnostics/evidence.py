"""Evidence from a failed state: cells by det F and residual, and terms without a finite value."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import basix
import numpy as np
import ufl
from dolfinx import fem, la

from dolfin_elastic.core.errors import BadCell, Diagnosis
from dolfin_elastic.core.jit import compile_expression
from dolfin_elastic.core.parallel import (
    first_of,
    largest,
    smallest,
    total,
)
from dolfin_elastic.core.types import BoolArray, FloatArray
from dolfin_elastic.mesh.geometry.quality import SLIVER, quality_at
from dolfin_elastic.mesh.geometry.simplices import cell_corners
from dolfin_elastic.model.point.domain import undefined_operation
from dolfin_elastic.model.point.tested import with_finite_moduli
from dolfin_elastic.problem.material_regions import MaterialRegion
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers import messages
from dolfin_elastic.solvers.assembly.assembler import Assembler, compiled, integral
from dolfin_elastic.solvers.messages import count

WORST = 10
"""Cells that a diagnosis lists."""

_SHOWN = 200
"""Points of each rank at which the operations of an energy are evaluated."""


@dataclass(frozen=True)
class Fault:
    """A term that is not finite.

    Attributes:
        text: Its name, what is wrong, how often and where.
        place: A place of it [m].
        inverted: Its cells have turned inside out, which is why.
        load: It belongs to a load or holding force, not to a material.
    """

    text: str
    place: tuple[float, ...]
    inverted: bool = False
    load: bool = False


class Cells:
    """Cells of a problem, evaluated at the quadrature points of the energy. Collective to make."""

    def __init__(self, assembler: Assembler) -> None:
        self.assembler, self.problem = assembler, assembler.problem
        self.comm, mesh = assembler.comm, assembler.problem.body.mesh
        kind = getattr(basix.CellType, mesh.topology.cell_name())
        problem = self.problem
        self.points, _ = basix.make_quadrature(
            kind, max(map(problem.weak_form.rule, problem.regions))
        )
        self._F = compile_expression(
            self.comm, _flat(problem.weak_form.F(problem.w)), self.points, problem.jit
        )
        self.own = problem.body.owned_cells()
        self.middles = cell_corners(mesh, self.own).mean(axis=1)

    def gradients(self) -> FloatArray:
        """F of the present displacement at owned cells, of shape (cells, points, 3, 3)."""
        values = self._F.eval(self.problem.body.mesh, self.own)
        return np.asarray(values).reshape(len(self.own), len(self.points), 3, 3)

    def jacobians(self) -> FloatArray:
        """Smallest det F of each owned cell; NaN where there is none."""
        with np.errstate(all="ignore"):
            return np.asarray(np.linalg.det(self.gradients()).min(axis=1, initial=np.inf))

    def residuals(self) -> FloatArray:
        """Largest free force out of balance at the nodes of each owned cell [N]. Collective."""
        problem, a = self.problem, self.assembler
        out = a.residual.owned
        free = la.vector(problem.W.dofmap.index_map, problem.W.dofmap.index_map_bs)
        with np.errstate(invalid="ignore"):
            free.array[: a.size] = out - a.constrained_part(out)
        free.scatter_forward()
        entries = np.arange(len(problem.u.x.array), dtype=np.int32)
        forces = free.array[problem.unknowns.mixed_dofs(entries)]
        with np.errstate(all="ignore"):
            norms = np.linalg.norm(forces.reshape(-1, problem.body.dim), axis=1)
        norms = np.where(np.isfinite(norms), norms, np.inf)
        return np.asarray(norms[problem.V.dofmap.list[self.own]].max(axis=1, initial=0.0))

    def worst(self) -> tuple[BadCell, ...]:
        """Cells without a finite force, then those inside out, then by force. Collective."""
        J, force = self.jacobians(), self.residuals()
        # The last digits differ with the number of ranks; places decide between equals.
        keys = [
            (np.isfinite(f), _rounded(j) if j <= 0.0 else 0.0, -_rounded(f), *np.round(x, 12))
            for j, f, x in zip(J, force, self.middles, strict=True)
        ]
        first = sorted(range(len(keys)), key=keys.__getitem__)[:WORST]
        local = [(keys[k], self._bad(k, float(J[k]), float(force[k]))) for k in first]
        result = [pair for part in self.comm.allgather(local) for pair in part]
        return tuple(cell for _, cell in sorted(result, key=lambda pair: pair[0])[:WORST])

    def _bad(self, cell: int, J: float, force: float) -> BadCell:
        body = self.problem.body
        material = next((p.name for p in self.problem.regions if cell in p.cells), "")
        regions = tuple(sorted(n for n, cells in body.regions.items() if cell in cells))
        return BadCell(plain(self.middles[cell]), material, regions, J, force)

    def first(self, where: BoolArray) -> tuple[float, ...]:
        """Middle of a marked cell, on any number of ranks the same one. Collective."""
        return first_of(self.comm, map(plain, self.middles[where])) or ()


class TrialStates:
    """Residual and tangent of a problem at given states."""

    def __init__(self, assembler: Assembler) -> None:
        self.assembler, self.problem = assembler, assembler.problem

    def put(self, values: FloatArray) -> None:
        """Changes the problem's unknowns. Not collective.

        Args:
            values: All unknowns, local array with ghosts.
        """
        self.problem.w.x.array[:] = values
        self.problem.unknowns.w_to_u()

    def residual(self, values: FloatArray) -> bool:
        """Evaluates the residual of a state; whether all of it is finite. Collective."""
        self.put(values)
        x, f = self.assembler.create_vector(), self.assembler.create_vector()
        self.assembler.get(x)
        self.assembler.residual.evaluate(x, f)
        finite = bool(np.isfinite(f.array_r).all() and np.isfinite(x.array_r).all())
        x.destroy()
        f.destroy()
        return largest(self.assembler.comm, float(not finite)) == 0.0

    def tangent(self, values: FloatArray) -> bool:
        """Assembles the tangent of a state; whether its diagonal is finite. Collective."""
        self.put(values)
        x = self.assembler.create_vector()
        self.assembler.get(x)
        self.assembler.tangent.assemble(x)
        x.destroy()
        diagonal = self.assembler.tangent.matrix.getDiagonal()
        bad = not np.isfinite(diagonal.array_r).all()
        diagonal.destroy()
        return largest(self.assembler.comm, float(bad)) == 0.0

    def energy_is_finite(self) -> bool:
        """Whether the strain energy of the present state is finite, if there is one. Collective."""
        energy = self.problem.weak_form.strain_energy
        if energy is None:
            return True
        return bool(np.isfinite(integral(self.problem, compiled(self.problem, [energy])[0])))


# --- terms without a finite value ---


def blind_to_inversion(problem: Problem, cells: Sequence[BadCell]) -> bool:
    """Whether the first of some cells has a law that does not see inversion. Not collective.

    Args:
        cells: Inverted or nearly so, the worst first.
    """
    first = cells[0].material if cells else ""
    return any(p.law.blind_to_inversion for p in problem.regions if first in ("", p.name))


def explained(problem: Problem, diagnosis: Diagnosis) -> Diagnosis:
    """The diagnosis of inverted cells, with why the law did not resist, or that one is a sliver.

    Collective.

    Args:
        diagnosis: Any diagnosis; others than "inverted" are left as they are.
    """
    if diagnosis.cause != "inverted" or not diagnosis.place:
        return diagnosis
    if blind_to_inversion(problem, diagnosis.cells):
        diagnosis = replace(
            diagnosis,
            text=f"{diagnosis.text}; {messages.MIRRORED}",
            advice=f"{diagnosis.advice}; or {messages.SEES_INVERSION}",
        )
    quality = quality_at(problem.body, diagnosis.place)
    if quality > SLIVER:
        return diagnosis
    return replace(
        diagnosis,
        text=f"{diagnosis.text}; {messages.sliver(quality)}",
        advice=messages.WITHOUT_SLIVERS,
    )


NO_ROOT = "the equations of its history have no root that Newton's method finds"


def not_finite(cells: Cells) -> Fault | None:
    """The first term of the residual that has no finite value in the present state. Collective."""
    problem = cells.problem
    for part in problem.regions:
        if (fault := _of_material(cells, part)) is not None:
            return fault
    terms = [
        (f"the load '{load.kind}'" + _on(load.parts), work)
        for load, work in problem.weak_form.works
    ]
    terms += [
        (f"the force of '{label}'", work)
        for label, work in problem.weak_form.restraint_works.items()
    ]
    for name, work in terms:
        if (fault := _of_term(problem, name, work)) is not None:
            return fault
    return None


def _of_material(cells: Cells, part: MaterialRegion) -> Fault | None:
    problem = cells.problem
    lost = {} if problem.history is None else problem.history.follow()
    law, F = problem.weak_form.response(part, problem.w), problem.weak_form.F(problem.w)
    entries = [*_flat(law.stress(F)), *([law.energy(F)] if law.has_energy else [])]
    kernel = compile_expression(cells.comm, ufl.as_vector(entries), cells.points, problem.jit)
    values = np.zeros((0, 1))
    if len(part.cells):
        values = kernel.eval(problem.body.mesh, part.cells).reshape(len(part.cells), -1)
    bad = np.zeros(len(cells.own), dtype=bool)
    bad[part.cells] = ~np.isfinite(values).all(axis=1)
    bad_ones = int(total(cells.comm, int(bad.sum())))
    if not bad_ones:
        return None
    F = cells.gradients()[bad].reshape(-1, 3, 3)
    with np.errstate(all="ignore"):
        J = np.linalg.det(F)
    upright = bool(largest(cells.comm, float(np.any(J > 0.0))))
    place = cells.first(bad)
    no_value = NO_ROOT if lost.get(part.name) else "stress or energy is not finite"
    why = _why(cells, part, F) or no_value
    low = smallest(cells.comm, float(np.min(J, initial=np.inf)))
    inverted = not upright and not np.isnan(low)
    why = f"det F falls to {low:.3g}" if inverted else why
    near = problem.body.unit.point(place)
    text = f"material '{part.name}': {why}, in {count(bad_ones, 'element')} near {near}"
    return Fault(text, place, inverted=inverted)


def _why(cells: Cells, part: MaterialRegion, F: FloatArray) -> str:
    """The operation without a finite value, by the lowest rank that has one. Collective."""
    with np.errstate(all="ignore"):
        law = with_finite_moduli(part.typical)
        operation = undefined_operation(law, F[:_SHOWN]) if len(F) else ""
    formula = "the formula of its energy" if part.law.has_energy else "the formula of its stress"
    operation = next((text for text in cells.comm.allgather(operation) if text), "")
    return f"{formula} takes the {operation}" if operation else ""


def _of_term(problem: Problem, name: str, work: ufl.Form) -> Fault | None:
    form = compiled(problem, [work])[0]
    force = la.vector(problem.W.dofmap.index_map, problem.W.dofmap.index_map_bs)
    fem.assemble_vector(force.array, form)
    force.scatter_reverse(la.InsertMode.add)
    size = problem.V.dofmap.index_map.size_local * problem.body.dim
    entries = problem.unknowns.mixed_dofs(np.arange(size, dtype=np.int32))
    bad = ~np.isfinite(force.array[entries].reshape(-1, problem.body.dim)).all(axis=1)
    bad_ones = int(total(problem.body.comm, int(bad.sum())))
    if not bad_ones:
        return None
    places = problem.places[: len(bad), : problem.body.dim][bad]
    place = first_of(problem.body.comm, map(plain, places)) or ()
    at = f"at {count(bad_ones, 'node')} near {problem.body.unit.point(place)}"
    return Fault(f"{name} is not finite {at}", place, load=True)


# --- words ---


def _on(parts: tuple[str, ...]) -> str:
    return f" on '{', '.join(parts)}'" if parts else ""


def _flat(tensor: ufl.core.expr.Expr) -> ufl.core.expr.Expr:
    return ufl.as_vector([tensor[i, j] for i in range(3) for j in range(3)])


def plain(place: FloatArray) -> tuple[float, ...]:
    """A place as numbers that are the same, and compare alike, on any number of ranks."""
    return tuple(float(x) + 0.0 for x in np.round(place, 12))


def _rounded(value: float) -> float:
    return float(f"{value:.6e}")
