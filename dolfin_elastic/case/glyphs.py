"""Glyphs of the supports and loads of a case, as its pictures and its report draw them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from dolfin_elastic.case.case import Case
from dolfin_elastic.case.check.loads import LoadSum
from dolfin_elastic.core.parallel import largest_row, total
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.mesh.body import Body, extent
from dolfin_elastic.mesh.geometry.curved import facet_points
from dolfin_elastic.mesh.geometry.simplices import outward_normals, prepare_facets
from dolfin_elastic.model.loads import Load, LoadPoints
from dolfin_elastic.model.loads.point_loads import ConcentratedLoad
from dolfin_elastic.model.values import fields_of
from dolfin_elastic.problem.terms.edges_points import points_of
from dolfin_elastic.results.scene.scene import Glyphs

SAMPLES = 14
"""Glyphs on a part."""
_DIGITS = 6
_SAME = 1e-12
"""Distance over the size of the body that is round-off."""
_COLOURS = ("#1b7837", "#b2182b")
_OFF = 0.01
"""Distance of arrows from the surface that they run along, over the body's size."""
_PUSHING = -0.1


def glyphs_of(case: Case, body: Body, sums: Sequence[LoadSum]) -> tuple[Glyphs, ...]:
    """Where displacements are prescribed, and along which forces act. Collective.

    Args:
        sums: Resultants of the loads; without any no loads are drawn.
    """
    return (*_supports(case, body), *(_loads(case, body, sums) if sums else ()))


def _supports(case: Case, body: Body) -> Iterator[Glyphs]:
    for k, support in enumerate(case.support):
        rows = _on_parts(body, support.surfaces)
        inward = -rows[:, 3:]
        inward[~inward.any(axis=1)] = np.eye(3)[body.dim - 1]
        if len(rows):
            tails = np.zeros(len(rows), dtype=bool)
            yield Glyphs(
                f"support {k}", support.label, False, rows[:, :3], inward, tails, _COLOURS[0]
            )


def _loads(case: Case, body: Body, sums: Sequence[LoadSum]) -> Iterator[Glyphs]:
    for k, load in enumerate(case.load):
        resultant = next((one.force for one in sums if one.load.startswith(f"load[{k}]")), None)
        force, label = np.zeros(3), f"load[{k}] {load.kind}"
        if resultant is not None:
            force[: len(resultant)] = resultant
            size = float(np.linalg.norm(force))
            label += f", {size:.4g} N in sum" if size > 0 else ""
        rows = _on_parts(body, load.parts)
        if inside := not len(rows):
            x = _middle(body, load)[None]
            if isinstance(load, ConcentratedLoad):
                x = load.in_metres(body.unit.metres).samples()[0]
            rows = np.pad(x, ((0, 0), (0, 6 - x.shape[1])))
        x, normals = rows[:, :3], rows[:, 3:]
        along = np.tile(force, (len(rows), 1))
        if load.domain.kind == "surface" and load.parts:
            along = _intensity(case, load, body, rows, along)
        size = np.linalg.norm(along, axis=1)
        some = np.isfinite(size) & (size > 1e-9 * size.max(initial=0.0, where=np.isfinite(size)))
        if some.any():
            along = along[some] / size[some, None]
            tails = np.einsum("ij,ij->i", along, normals[some]) > _PUSHING
            coordinates = x[some] + _OFF * max(extent(body)) * normals[some]
            yield Glyphs(f"load {k}", label, True, coordinates, along, tails, _COLOURS[1], inside)


def _on_parts(body: Body, names: Sequence[str]) -> FloatArray:
    """Places on surfaces, edges and points, and normals or zeros, shape (n, 6). Collective."""
    result: list[FloatArray] = [np.zeros((0, 6))]
    for name in names:
        if name in body.surfaces and name not in body.uncovered:
            prepare_facets(body.mesh)
            facets = body.owned_facets(name)
            inner = np.full((1, body.dim - 1), 1.0 / body.dim)
            x = facet_points(body.mesh, facets, inner)[0][:, 0]
            result.append(_spread(body, np.hstack([x, outward_normals(body.mesh, facets)])))
        else:
            for kind in ("edge", "point"):
                if name in body.parts[kind]:
                    x = points_of(body, kind, [name], 1).X.reshape(-1, body.dim)
                    result.append(_spread(body, np.hstack([x, np.zeros_like(x)])))
                    break
    return np.concatenate(result)


def _spread(body: Body, rows: FloatArray) -> FloatArray:
    """Rows of places and normals that are spread over all, shape (n, 6). Collective.

    Each is the farthest in space from those before, the first that nearest to the origin, so that
    they are the same on any number of ranks: T. F. Gonzalez, TCS 38 (1985) 293.
    """
    comm, d, x = body.comm, body.dim, rows[:, : body.dim]
    size, away, result = max(extent(body)), np.full(len(rows), np.inf), list[list[float]]()
    while len(result) < SAMPLES:
        far = largest_row(comm, away, lambda some: x[some], least=_SAME * size)
        if far is None or far.value <= _SAME * size:
            break
        row = comm.bcast(rows[far.row].tolist() if comm.rank == far.rank else None, far.rank)
        away = np.minimum(away, np.linalg.norm(x - np.array(row[:d]), axis=1))
        wide = [0.0] * (3 - d)
        result.append(
            [_plain(v, size) for v in row[:d]] + wide + [_plain(v, 1.0) for v in row[d:]] + wide
        )
    return np.array(result).reshape(-1, 6)


def _plain(value: float, size: float) -> float:
    """A number without digits that round-off has made."""
    return float(f"{value:.{_DIGITS}g}") if abs(value) > _SAME * size else 0.0


def _intensity(
    case: Case, load: Load, body: Body, rows: FloatArray, along: FloatArray
) -> FloatArray:
    """Force per area at places of surfaces at the end; as given where it is not known. Local."""
    d = body.dim
    time = case.final_load if case.dynamics is None else case.dynamics.end
    intensity = load.intensity(LoadPoints(rows[:, :d], time, N=rows[:, 3 : 3 + d]))
    return (
        along
        if intensity is None or fields_of(load.values)
        else np.pad(intensity, ((0, 0), (0, 3 - d)))
    )


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
