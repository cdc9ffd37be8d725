"""Quality of a mesh: empty parts, thin cells, cells that are too few or too straight."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from contextlib import suppress

import numpy as np
from dolfinx.mesh import exterior_facet_indices

from dolfin_elastic.case.case import Case
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.core.units import metres
from dolfin_elastic.mesh.body import Body, cell_size, span
from dolfin_elastic.mesh.geometry.quality import worst_cells
from dolfin_elastic.mesh.geometry.ridges import ridge_angles
from dolfin_elastic.mesh.geometry.simplices import (
    boundary_facets,
    cell_corners,
    facet_corners,
    prepare_facets,
    qualities,
)
from dolfin_elastic.mesh.geometry.thickness import Thickness, local_thickness
from dolfin_elastic.model.supports.springs import ResistingSupport
from dolfin_elastic.problem.material_regions import STIFF_IN_VOLUME, poisson
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.results.derived.sections import distance_from_plane

THIN = 0.05
"""Quality (1 is regular) below which results near a cell are poor: a needle of one to twenty."""
_SHOWN = 5
"""Thin cells that are listed with their places."""
_FLAT, _SHARP = 0.5, 35.0
"""Angles [degrees] between facets of a plane, and from which on an edge is one of the body."""
_FEW = 0.02
"""Share of edges between these that may be anything else, such as chamfers."""
_SLENDER = 4.0
"""Length over thickness from which on a body bends more than it shears."""
_OFF = 1e-6
"""Distance over the size of the cells that is round-off of a mesh."""
_TOO_STIFF = 1.15
"""Bending stiffness over the true one that is worth a note: some five linear cells across."""


def part_notes(body: Body, inner: Collection[str | None] = ()) -> Iterator[str]:
    """Empty regions and surfaces, and surfaces with facets inside the body. Collective.

    Args:
        inner: Surfaces that are meant to lie inside.
    """
    for name in sorted(body.regions):
        if not int(total(body.comm, len(body.owned_cells(name)))):
            yield f"the region '{name}' is empty: no element carries it"
    prepare_facets(body.mesh)
    outside = exterior_facet_indices(body.mesh.topology)
    for name in sorted(body.surfaces.keys() - body.uncovered.keys()):
        facets = body.owned_facets(name)
        inside = int(np.count_nonzero(~np.isin(facets, outside)))
        count, inside = total(body.comm, np.array([len(facets), inside]))
        if not count:
            yield f"the surface '{name}' is empty: no facet carries it"
        elif inside and name not in inner:
            yield (
                f"{inside} of {count} facets of the surface '{name}' lie inside the body, "
                "not on its boundary"
            )


def cell_notes(body: Body) -> Iterator[str]:
    """The number of thin cells, the worst of them with places. Collective."""
    own = body.owned_cells()
    shape = qualities(cell_corners(body.mesh, own))
    count = int(total(body.comm, int(np.count_nonzero(shape < THIN))))
    if count:
        worst = [cell for cell in worst_cells(body, _SHOWN) if cell.quality < THIN]
        unit = body.unit
        places = ", ".join(
            f"{c.quality:.2g} at {_place(x / unit.metres for x in c.middle)}" for c in worst
        )
        more = ", ..." if count > len(worst) else ""
        yield (
            f"{count} of {body.num_cells} elements are thin (quality below {THIN:g}; 1 is regular)"
            f": {places}{more} {unit.name}"
        )


def shape_notes(case: Case, problem: Problem) -> list[str]:
    """Whether the cells' shape and the degree of the displacement fit each other. Collective.

    Straight cells of size h along a curved surface err in its place by h^2, and in its normal by h.
    The functions of linear elements in curved cells contain no rotation of a rigid body.

    Source: P. G. Ciarlet and P.-A. Raviart, Comput. Methods Appl. Mech. Eng. 1 (1972) 217.

    Args:
        case: Where its mesh comes from.
    """
    mesh = problem.body.mesh
    curved = int(mesh.geometry.cmap.degree) > 1
    if curved and problem.degree == 1:
        return [
            "linear elements in curved elements: they cannot even turn without strain; use "
            + ("straight elements" if case.explicit else "mesh.degree = 2")
        ]
    # In motion, where no error of the stress is estimated, a mesh is mostly all that there is.
    finished = any(one.file is not None and not one.cad for one in case.mesh.sources.values())
    if curved or problem.degree == 1 or not finished or case.dynamics is not None:
        return []
    angles = np.degrees(ridge_angles(mesh))
    round_ones = angles[(angles > _FLAT) & (angles < _SHARP)]
    count, all_of_them, sums = total(
        problem.body.comm, np.array([len(round_ones), len(angles), round_ones.sum()])
    )
    if count <= _FEW * all_of_them:
        return []
    return [
        f"straight elements along curved surfaces: {count:.0f} of {all_of_them:.0f} edges of the "
        f"boundary are bent, by {sums / count:.2g} degrees in the mean, and quadratic elements "
        "converge there as on a polyhedron: stress with the first power of the element size; "
        "export quadratic elements (Gmsh: Mesh.ElementOrder = 2), or give the CAD file"
    ]


def section_notes(case: Case, problem: Problem) -> list[str]:
    """How far the facets lie from the planes that they stand for in sections. Collective.

    A plane that misses the body is left out: `SectionForces` refuses it.
    """
    body, off = problem.body, []
    unit = body.unit
    for name, section in case.output.sections.items():
        if section.plane is None or section.at is None:
            continue
        with suppress(InputError):
            distance = distance_from_plane(body, section)
            if distance > _OFF * cell_size(body):
                at = metres(section.at, unit.metres) / unit.metres
                off += [(name, distance / unit.metres, f"{section.plane} = {at:.4g}")]
    shown = ", ".join(f"'{n}' by up to {d:.2g} {unit.name} from {p} {unit.name}" for n, d, p in off)
    if not off:
        return []
    return [
        f"output.sections: the element faces of a section lie off its plane: {shown}; "
        "its force may differ by what loads the elements between; a finer mesh, or a surface in "
        "the mesh there, brings the faces closer"
    ]


def bending_notes(case: Case, problem: Problem) -> list[str]:
    """How much too stiff linear elements make a slender body in bending. Collective.

    Args:
        case: Its unit of length and its scheme.
    """
    if problem.degree > 1 or problem.cell is not None:
        return []
    result = local_thickness(problem.body.mesh, _held_facets(problem))
    stiffness, size = bending_stiffness(result, _ratios(problem)), span(problem.body)
    # Where a moment runs through parts of several thicknesses, a cell takes part in the compliance
    # by its volume over the fourth power of its thickness.
    thick = np.minimum(result.thickness / size, 1e3)
    shares = result.volumes / np.square(np.square(thick))  # a power takes ten times as long
    terms = [np.ones_like(shares), 1 / stiffness, thick, _ACROSS * size * thick / result.across]
    sums = total(problem.body.comm, np.array([shares @ term for term in terms]))
    factor, thickness, count = sums[0] / sums[1], size * sums[2] / sums[0], sums[3] / sums[0]
    if factor < _TOO_STIFF or size < _SLENDER * thickness:
        return []
    unit = problem.body.unit
    needed = int(np.ceil(max(count, 1) * np.sqrt((factor - 1) / (_TOO_STIFF - 1))))
    dim, (nodes, cells) = (
        problem.body.dim,
        (problem.body.mesh.topology.index_map(d).size_global for d in (0, problem.body.dim)),
    )
    unknowns = dim * nodes * (needed / max(count, 1)) ** dim
    more = f"use {needed} of them across (about {unknowns:.2g} unknowns)"
    # Edges by Euler's formula, without half of the boundary's facets.
    advice = f"use mesh.degree = 2 (about {dim * (2.0 * nodes + cells):.2g} unknowns)"
    if case.explicit:
        advice = f"{more}, or an implicit scheme with mesh.degree = 2"
    elif case.contact:  # with quadratic elements a body that is squeezed may take hundreds of steps
        advice = more
    return [
        f"linear elements bend too stiffly: with about {max(count, 1):.2g} of them across its thin "
        f"parts ({thickness / unit.metres:.3g} {unit.name}), expect the body to be about "
        f"{factor:.2g} times too stiff in bending; {advice}"
    ]


_ACROSS = 0.7
"""Root mean square of an edge's extent across layers of cells, over their height (0.58 to 0.75)."""


def bending_stiffness(thickness: Thickness, ratios: FloatArray) -> FloatArray:
    """Bending stiffness of linear elements over the true one, around each cell.

    A linear element has a constant strain, and what bending adds to it is an error: its energy is
    that of the cell's extent across, through which the strain changes, and along, over which shear
    is left behind.  Relative to the energy of bending it goes with the squares of both over that of
    the thickness t, and the stiffness with it: 1 + c (3.6 a^2 + 1.4 b^2)/t^2, a and b the root mean
    squares of the edges across and along.  Lateral contraction counts by the modulus M of uniaxial
    strain, c = 1 + 0.6 (M/E - 1), since a constant strain cannot follow it.

    Source: the form is that of the interpolation error, G. Strang and G. J. Fix, An Analysis of the
    Finite Element Method (1973), section 3.2, and of the parasitic shear of R. D. Cook et al.,
    Concepts and Applications of Finite Element Analysis (2002), section 3.6.  The three numbers are
    fitted to cantilevers of ten thicknesses, solved with linear and with quadratic elements: bars
    and plates of one to four layers of bricks in six tetrahedra, one to four times as long as high,
    strips of one to eight layers of triangles, plates and bars meshed by Gmsh, nu = 0 to 0.45.
    They are met within a third of the excess over 1, but for bars in a few irregular cells and
    cells that are oblong across the bending, which are up to twice as good; a bracket of L shape,
    10 mm thick, in cells of 12 mm has 2.8 and gets 3.2.

    Args:
        ratios: Poisson's ratio of the cells, shape (n,).
    """
    modulus = (1 - ratios) / ((1 + ratios) * (1 - 2 * ratios))
    with np.errstate(divide="ignore"):
        across, along = (
            thickness.across / thickness.thickness,
            thickness.along / thickness.thickness,
        )
    return np.asarray(1 + (1 + 0.6 * (modulus - 1)) * (3.6 * across**2 + 1.4 * along**2))


def _ratios(problem: Problem) -> FloatArray:
    """Poisson's ratio of the owned cells; see `locking_notes` for nearly incompressible ones."""
    ratios = np.zeros(len(problem.body.owned_cells()))
    for region in problem.regions:
        nu = 0.3 if region.compliance is not None else poisson(region.typical)
        ratios[region.cells] = np.clip(nu, 0, STIFF_IN_VOLUME)
    return ratios


def _held_facets(problem: Problem) -> IndexArray:
    """Local facets that are held, as planes of symmetry are, and those on an axis. Collective."""
    body = problem.body
    names = [
        name
        for support in problem.supports
        if not isinstance(support, ResistingSupport)
        for name in support.surfaces
    ]
    result = [body.surfaces[name] for name in names if name in body.surfaces]  # or an edge's
    if problem.geometry == "axisymmetric":
        facets = boundary_facets(body.mesh)
        radius = facet_corners(body.mesh, facets)[:, :, 0].max(axis=1)
        result.append(facets[radius < 1e-9 * cell_size(body)])
    return np.unique(np.concatenate([np.empty(0, dtype=np.int32), *result]))


def _place(point: Iterable[float]) -> str:
    return "(" + ", ".join(f"{x:.4g}" for x in point) + ")"
