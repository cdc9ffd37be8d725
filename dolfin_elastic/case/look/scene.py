"""What the picture of a case shows on its body: supports, loads and obstacles."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np

from dolfin_elastic.case.case import Case
from dolfin_elastic.case.check.consistency import acts_on_surfaces
from dolfin_elastic.case.check.integrals import Integrals
from dolfin_elastic.case.check.loads import LoadSum, load_sums
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.shapes.shapes import Shape
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.model.loads import Load, LoadPoints
from dolfin_elastic.problem.terms.edges_points import points_of
from dolfin_elastic.results.scene.body import Symbols, spread_facets


@dataclass(frozen=True)
class Drawn:
    """What of a case is drawn on its body.

    Attributes:
        symbols: Of supports and loads.
        obstacles: Of contacts, by their names.
        notes: Why some are missing.
    """

    symbols: tuple[Symbols, ...] = ()
    obstacles: Mapping[str, Shape] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def drawn_of(case: Case, body: Body) -> Drawn:
    """Supports, loads and obstacles of a case, and its first fault. Collective."""
    notes: tuple[str, ...] = ()
    sums: tuple[LoadSum, ...] = ()
    try:
        problem = case.make_problem(body)
        sums = load_sums(case, Integrals(problem, case.mesh.metres_thick(body)))
    except InputError as error:
        notes = (f"the case has a fault, so that loads and supports may be missing: {error}",)
    symbols: tuple[Symbols, ...] = ()
    if not notes:
        symbols = (*_supports(case, body), *_loads(case, body, sums))
    return Drawn(symbols, dict(_obstacles(case, body)), notes)


def _supports(case: Case, body: Body) -> Iterator[Symbols]:
    """Where displacements are prescribed, springs and rigid surfaces. Collective."""
    for support in case.support:
        for name in support.surfaces:
            if (at := _on_part(body, name)) is not None:
                yield Symbols("support", f"{support.label}", at[0], at[1], at[1])


def _on_part(body: Body, name: str) -> tuple[FloatArray, FloatArray] | None:
    """Places of a surface, edge or point, and normals there. Collective."""
    if name in body.surfaces:
        return spread_facets(body, body.surfaces[name])
    for kind in ("edge", "point"):
        if name in body.parts[kind]:
            x = points_of(body, kind, [name], 1).X.reshape(-1, body.dim)
            every = np.concatenate(body.comm.allgather(x))
            some = every[np.linspace(0, len(every) - 1, min(len(every), 14)).astype(int)]
            wide = np.pad(some, ((0, 0), (0, 3 - body.dim)))
            up = np.zeros_like(wide)
            up[:, body.dim - 1] = -1.0
            return wide, up
    return None


def _loads(case: Case, body: Body, sums: tuple[LoadSum, ...]) -> Iterator[Symbols]:
    """Arrows along the force of each load. Collective."""
    for index, load in enumerate(case.load):
        resultant = next((one for one in sums if one.load.startswith(f"load[{index}]")), None)
        label = f"load[{index}] {load.kind}"
        if resultant is not None and resultant.force is not None:
            size = float(np.linalg.norm(resultant.force))
            label += f", {size:.4g} N in sum" if size > 0 else ""
        if (found := _arrows(case, load, body, resultant)) is not None:
            yield Symbols("load", label, *found)


def _arrows(
    case: Case, load: Load, body: Body, resultant: LoadSum | None
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Places, unit vectors of force and normals; None: nothing can be drawn. Collective."""
    force = np.zeros(3)
    if resultant is not None and resultant.force is not None:
        force[: len(resultant.force)] = resultant.force
    if acts_on_surfaces(load) and load.parts:
        facets = np.unique(np.concatenate([body.surface(name) for name in load.parts]))
        x, n = spread_facets(body, np.asarray(facets, dtype=np.int32))
        vectors = _intensity(case, load, body, x, n)
        along = np.broadcast_to(force, x.shape) if vectors is None else vectors
        return _unit(x, along, n)
    parts = [at for name in load.parts if (at := _on_part(body, name)) is not None]
    if parts:
        x = np.concatenate([at[0] for at in parts])
        return _unit(x, np.broadcast_to(force, x.shape), np.zeros_like(x))
    x = _middle(body, load)[None]
    return _unit(x, force[None], np.zeros((1, 3)))


def _intensity(
    case: Case, load: Load, body: Body, x: FloatArray, n: FloatArray
) -> FloatArray | None:
    """Force per area at places of surfaces at the end; None: it is not known. Local."""
    d = body.dim
    time = case.final_load if case.dynamics is None else case.dynamics.end
    found = load.intensity(LoadPoints(x[:, :d], time, N=n[:, :d]))
    return None if found is None else np.pad(found, ((0, 0), (0, 3 - d)))


def _unit(
    x: FloatArray, vectors: FloatArray, normals: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    size = np.linalg.norm(vectors, axis=1)
    some = np.isfinite(size) & (size > 1e-9 * size.max(initial=0.0)) & (size > 0)
    if not some.any():
        return None
    return x[some], vectors[some] / size[some, None], normals[some]


def _middle(body: Body, load: Load) -> FloatArray:
    """The mean corner of the cells that a load acts on [m], shape (3,). Collective."""
    cells: IndexArray = body.owned_cells()
    regions = [name for name in load.parts if name in body.regions]
    if regions:
        cells = np.unique(np.concatenate([body.owned_cells(name) for name in regions]))
    nodes = np.unique(body.mesh.geometry.dofmap[cells][:, : body.dim + 1])
    own = np.append(body.mesh.geometry.x[nodes].sum(axis=0), float(len(nodes)))
    sums = total(body.comm, own)
    return np.asarray(sums[:3] / max(sums[3], 1.0))


def _obstacles(case: Case, body: Body) -> Iterator[tuple[str, Shape]]:
    """Obstacles as they stand at the start, those that fit the body."""
    for index, contact in enumerate(case.contact):
        shape = contact.obstacle.in_metres(body.unit.metres)
        named = f"'{contact.name}'" if contact.name else f"with {', '.join(contact.surfaces)}"
        with suppress(InputError):
            shape.check(body.dim, axisymmetric=case.mesh.geometry == "axisymmetric")
            yield f"contact[{index}] {named}", shape
