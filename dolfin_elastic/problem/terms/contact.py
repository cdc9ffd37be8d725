"""`ContactPair`: a surface of the body and a rigid obstacle, as terms and as numbers.

The pressure per reference area is p = max(0, lam - eps g), with the gap g of the current place
X + u, the penalty eps and the multiplier lam; its virtual work is the integral of p n . v over the
reference surface, n the obstacle's normal.  As n is the gradient of g it has the potential
(p^2 - lam^2)/(2 eps), so the tangent is symmetric.

Source: P. Wriggers, Computational Contact Mechanics, 2nd ed., Springer 2006, sections 6.3.4 and
10.3.4 (augmented Lagrange, Uzawa); P. Alart & A. Curnier, Comput. Methods Appl. Mech. Eng. 92
(1991) 353.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.ghosts import summed
from dolfin_elastic.core.jit import compile_forms, options
from dolfin_elastic.core.parallel import largest, total
from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.mesh.body import Body, cell_size
from dolfin_elastic.mesh.geometry.simplices import (
    cell_corners,
    cells_beside_facets,
    facet_corners,
    prepare_facets,
    signed_volumes,
)
from dolfin_elastic.model.amplitude import Amplitude
from dolfin_elastic.model.contact import Contact
from dolfin_elastic.model.kinematics import WeightedMeasure
from dolfin_elastic.problem.context import FormContext
from dolfin_elastic.problem.material_regions import MaterialRegion, shear_modulus, volume_modulus
from dolfin_elastic.problem.term import Kind, Term

FACTOR = 10.0
"""Penalty over the stiffness of the cell beside: enough for a few augmentations."""

SOFT = 0.1
"""Penalty in dynamics over that in statics.

In an explicit scheme a node that hits in mid-step gains energy where the penalty is stiff, see
`stable_step.CONTACT`; and a penalty stiffer than the cells above it only shortens the stable step.
"""

SLACK = 1e-9
"""Gap, over the size of a cell, up to which a surface is in contact.

A body that only lies on an obstacle has a stiffness against it then, round-off or not; the pull
that such a gap makes is 1e-8 of the modulus.
"""

ROUND = 10.0
"""Largest bulk modulus over shear modulus in the penalty: nearly incompressible cells give way
sideways."""


class ContactPair(Term):
    """One contact on one body. Collective to make.

    Args:
        measure: Reference area of its surfaces, with the rule of `rule`.

    Attributes:
        contact: What the user wrote.
        label: What results call it.
        lam: Multiplier [Pa], nodal values of the displacement's degree; 0 in motion.
        penalty: eps [Pa/m], one number a cell beside the surface.
        size: Mean height of the cells over the surface [m].
        tolerance: Penetration that statics leaves [m].
        nodes: Owned nodes of the surface in the space of `lam`.
        nodes_of_displacement: The same nodes in the displacement's space.
    """

    linear, restrains, opens, account = False, True, True, "contact"

    def __init__(
        self, contact: Contact, context: FormContext, measure: WeightedMeasure, name: str
    ) -> None:
        body = context.body
        self.contact, self.label, self._context, self._measure = (
            contact,
            contact.label,
            context,
            measure,
        )
        self._axisymmetric = context.geometry == "axisymmetric"
        self.comm, self._dim = body.comm, body.dim
        prepare_facets(body.mesh)
        facets = np.unique(np.concatenate([body.surface(name) for name in contact.surfaces]))
        self.lam, self.nodes, self.nodes_of_displacement = _nodal(context, facets)
        self.memory = {name: self.lam}
        self.penalty = fem.Function(fem.functionspace(body.mesh, ("DG", 0)))
        self._heights = _heights(body, facets)
        self.size = _mean(body, facets, self._heights)
        self.tolerance = contact.gap_tolerance or 1e-3 * self.size
        self._fill_penalty()
        if self._axisymmetric:
            self._correct_weights_at_axis(facets)
        self._eps = _at_nodes(body, facets, self.penalty, self.lam.function_space)[self.nodes]
        self._first = self.penalty.x.array.copy(), self._eps.copy()
        self.shift: fem.Constant = context.constant([0.0] * body.dim)
        self.at_rest = not contact.values
        self._reach = context.constant(SLACK * cell_size(body))

    def _fill_penalty(self) -> None:
        cells, heights = self._heights
        eps = np.zeros(len(cells))
        for region in self._context.regions:
            local = np.isin(cells, region.cells)
            eps[local] = FACTOR * _modulus(region) / heights[local]
        if self.contact.stiffness is not None:
            eps[:] = self.contact.stiffness
        dofs = self.penalty.function_space.dofmap.list[:, 0]
        self.penalty.x.array[dofs[cells]] = eps
        # Material regions list owned cells only: ghosts beside the surface get theirs from owners.
        self.penalty.x.scatter_forward()

    @property
    def reach(self) -> float:
        """Gap [m] up to which the surface is in contact."""
        return float(self._reach.value)

    def set_reach(self, gap: float) -> None:
        """Sets the gap [m] up to which the surface is in contact. Not collective."""
        self._reach.value = gap

    def begin(self, *, moving: bool) -> None:
        """See `Term`: motion has penalties alone, and softer ones where the user gave none."""
        factor = SOFT if moving else 1.0
        if self.contact.stiffness is None:
            self.penalty.x.array[:] = factor * self._first[0]
            self._eps = factor * self._first[1]
        if moving:
            self.lam.x.array[:] = 0.0

    def _correct_weights_at_axis(self, facets: IndexArray) -> None:
        """Weights of nodes near the axis of an axisymmetric body.

        With linear elements the trapezoidal rule would give a node on the axis none of the ring
        around it: its weight is the integral of its shape function times the radius, for which
        the radius at a node is replaced by (r + 2 r_middle)/3, r_middle that of the facet.  The
        vertex of a quadratic element has no such integral on the axis: it is left to its
        neighbours.
        """
        if self._context.order > 1:
            X = self.lam.function_space.tabulate_dof_coordinates()
            off = X[self.nodes, 0] > 1e-9 * self.size
            self.nodes, self.nodes_of_displacement = (
                self.nodes[off],
                self.nodes_of_displacement[off],
            )
            return
        weight = 2 * ufl.pi * (self._context.X[0] + 2 * self._middle_radius(facets)) / 3
        self._measure = WeightedMeasure(weight, self._measure.measure)

    def _middle_radius(self, facets: IndexArray) -> Expr:
        """Radius of the middle of the facet at hand [m]: a cell may have several in contact.

        On the reference triangle the outward normals are (1, 1)/sqrt(2), (-1, 0) and (0, -1).
        """
        mesh = self._context.body.mesh
        radii = fem.Function(fem.functionspace(mesh, ("DG", 0, (3,))))
        beside, local = cells_beside_facets(mesh, facets)
        cells = radii.function_space.dofmap.list[beside, 0]
        radii.x.array.reshape(-1, 3)[cells, local] = facet_corners(mesh, facets)[:, :, 0].mean(
            axis=1
        )
        normal = ufl.geometry.ReferenceNormal(mesh)
        left = ufl.conditional(ufl.lt(normal[0], -0.5), radii[1], radii[2])
        return ufl.conditional(ufl.gt(normal[0], 0.5), radii[0], left)

    # --- forms ---

    def form(self, kind: Kind) -> ufl.Form | None:
        """See `Term`."""
        return {"work": self.work, "energy": self.energy, "bound": self.bound}.get(kind)

    @cached_property
    def _gap(self) -> tuple[Expr, Expr]:
        """Gap and normal of the current place."""
        place = self._context.X + self._context.u - self.shift
        distance, normal = self.contact.obstacle.gap(
            [place[i] for i in range(self._dim)], self._context.constant, ufl.sqrt
        )
        return distance, ufl.as_vector(normal)

    @cached_property
    def _trial_pressure(self) -> Expr:
        """Trial contact pressure lam - eps g [Pa]."""
        return self.lam - self.penalty * self._gap[0]

    @cached_property
    def pressure(self) -> Expr:
        """Contact pressure on the reference area [Pa]."""
        in_contact = ufl.ge(self._trial_pressure, -self.penalty * self._reach)
        return ufl.conditional(in_contact, self._trial_pressure, 0.0)

    @cached_property
    def work(self) -> ufl.Form:
        """Virtual work of the obstacle's force on the body."""
        return self.pressure * ufl.inner(self._gap[1], self._context.v) * self._measure

    @cached_property
    def energy(self) -> ufl.Form:
        """Potential of the force, with the multiplier at rest [J]."""
        q = ufl.max_value(self._trial_pressure, 0.0)
        return (q**2 - self.lam**2) / (2 * self.penalty) * self._measure

    @cached_property
    def bound(self) -> ufl.Form:
        """The penalty times each component of `context.v`: bounds the rows of its tangent.

        At an obstacle's curvature 1/R it has the further eigenvalue eps g/R, which is smaller.
        """
        return self.penalty * sum(self._context.v) * self._measure

    # --- numbers at the nodes ---

    def places(self) -> FloatArray:
        """Reference places of the owned nodes of the surface, shape (n, dim)."""
        X = self.lam.function_space.tabulate_dof_coordinates()
        return np.asarray(X[self.nodes, : self._dim])

    def gaps(self) -> tuple[FloatArray, FloatArray]:
        """Gaps [m] and obstacle's normals at the owned nodes, (n,) and (n, dim). Not collective."""
        u = self._context.unknowns.u.x.array.reshape(-1, self._dim)
        x = self.places() + u[self.nodes_of_displacement] - self.shift.value
        distance, normal = self.contact.obstacle.gap(list(x.T), float, np.sqrt)
        gaps = np.asarray(distance, dtype=np.float64)
        normals = [np.broadcast_to(item, gaps.shape) for item in normal]
        return gaps, np.stack(normals, axis=1)

    def pressures(self) -> FloatArray:
        """Pressure per reference area at the owned nodes of the surface [Pa]. Not collective."""
        return np.maximum(0.0, self.lam.x.array[self.nodes] - self._eps * self.gaps()[0])

    def gap_error(self) -> float:
        """Largest distance from the obstacle of nodes that press or penetrate [m]. Collective."""
        gaps, _ = self.gaps()
        off = np.abs(gaps[(self.pressures() > 0) | (gaps < 0)])
        return largest(self.comm, float(np.max(off, initial=0)))

    def unsettled(self) -> bool:
        """See `Term`: a node that presses is off its obstacle, beyond the tolerance."""
        return self.gap_error() > self.tolerance

    def augment(self) -> None:
        """Uzawa's update lam <- max(0, lam - eps g). Collective."""
        self.lam.x.array[self.nodes] = self.pressures()
        self.lam.x.scatter_forward()

    # --- time ---

    def set_time(self, t: float, default: Amplitude) -> None:
        """See `Term`: moves the obstacle."""
        self.shift.value[:] = self.contact.displacement_at(t, default, self._dim)

    # --- results ---

    @cached_property
    def _area(self) -> fem.Form:
        """Reference area on which there is pressure [m^2]."""
        area = ufl.conditional(ufl.gt(self._trial_pressure, 0.0), 1.0, 0.0) * self._measure
        return compile_forms(self.comm, [area], options(self.comm))[0]

    @stage("contact")
    def add_results(self, result: dict[str, float]) -> None:
        """See `Term`: largest penetration [m] and area under pressure [m^2]."""
        depth = largest(self.comm, float(np.max(-self.gaps()[0], initial=0.0)))
        first, second = f"penetration_{self.label}", f"contact_area_{self.label}"
        result[first] = max(result.get(first, 0.0), depth)
        area = total(self.comm, float(fem.assemble_scalar(self._area)))
        result[second] = result.get(second, 0.0) + area


def make_contacts(contacts: Sequence[Contact], context: FormContext) -> tuple[ContactPair, ...]:
    """All contacts on a body. Collective."""
    points = rule(context.order, context.body.dim)
    return tuple(
        ContactPair(c, context, context.measures.contact_area(c.surfaces, points), f"contact_{i}")
        for i, c in enumerate(contacts)
    )


def rule(degree: int, dim: int) -> dict[str, object]:
    """Quadrature of contact integrals.

    Where there is a rule at the nodes with positive weights it is taken: gap and multiplier are
    compared there, so that a facet on a curved obstacle is not asked for more than its nodes can
    do (trapezoidal for linear elements, Simpson's for quadratic ones in a plane).  Quadratic
    triangles have none and take Gauss's.

    Args:
        degree: Of the displacement or of the mesh's curved cells, whichever is higher.
    """
    if degree > 1 and dim == 3:
        return {"quadrature_degree": 2 * degree}
    if degree == 1:
        return {"quadrature_rule": "vertex", "quadrature_degree": 1}
    return {"quadrature_rule": "GLL", "quadrature_degree": 3}


def placed_contacts(contacts: Sequence[Contact], body: Body, *, turned: bool) -> list[Contact]:
    """Contacts with their obstacles in metres, all of which fit the body. Not collective.

    Raises:
        InputError: With the key.
    """
    placed = [contact.in_metres(body.unit.metres) for contact in contacts]
    for index, contact in enumerate(placed):
        try:
            contact.check(body.dim, axisymmetric=turned)
            for name in contact.surfaces:
                body.surface(name)
        except InputError as error:
            raise error.at(f"contact[{index}]") from None
    return placed


def _modulus(region: MaterialRegion) -> float:
    """K + 4 mu/3 of a material [Pa], K bounded."""
    mu = shear_modulus(region.typical)
    known = region.typical.small_strain()
    K = volume_modulus(region.typical) if known is None else known.K
    return min(K, ROUND * mu) + 4 / 3 * mu


def _nodal(context: FormContext, facets: IndexArray) -> tuple[fem.Function, IndexArray, IndexArray]:
    """Multiplier, owned nodes of the surface, and the same nodes of the displacement. Collective.

    Two spaces of one element need not number their nodes alike, but do so within each cell.
    """
    mesh, V = context.body.mesh, context.unknowns.V
    S = fem.functionspace(mesh, ("Lagrange", context.unknowns.degree))
    nodes = fem.locate_dofs_topological(S, mesh.topology.dim - 1, facets)
    owned = np.sort(nodes[nodes < S.dofmap.index_map.size_local]).astype(np.int32)
    number = np.zeros(S.dofmap.index_map.size_local + S.dofmap.index_map.num_ghosts, np.int32)
    number[S.dofmap.list.ravel()] = V.dofmap.list.ravel()
    return fem.Function(S), owned, number[owned]


def _heights(body: Body, facets: IndexArray) -> tuple[IndexArray, FloatArray]:
    """Local cells beside facets, and their smallest height over one of them [m]."""
    mesh, d = body.mesh, body.dim
    beside, _ = cells_beside_facets(mesh, facets)
    corners = facet_corners(mesh, facets)
    edges = corners[:, 1:] - corners[:, :1]
    gram = np.linalg.det(np.einsum("nik,njk->nij", edges, edges))
    area = np.sqrt(np.maximum(gram, np.finfo(float).tiny)) / (d - 1)
    height = d * np.abs(signed_volumes(cell_corners(mesh, beside))) / area
    cells, offset = np.unique(beside, return_inverse=True)
    smallest = np.full(len(cells), np.inf)
    np.minimum.at(smallest, offset, height)
    return cells.astype(np.int32), smallest


def _mean(body: Body, facets: IndexArray, heights: tuple[IndexArray, FloatArray]) -> float:
    """Mean height over the facets that ranks own [m]. Collective."""
    own = facets[facets < body.mesh.topology.index_map(body.dim - 1).size_local]
    beside, _ = cells_beside_facets(body.mesh, own)
    result = heights[1][np.searchsorted(heights[0], beside)]
    sums = total(body.comm, np.array([result.sum(), len(result)]))
    return float(sums[0] / max(sums[1], 1.0))


def _at_nodes(
    body: Body, facets: IndexArray, penalty: fem.Function, S: fem.FunctionSpace
) -> FloatArray:
    """Harmonic mean at each owned node of the penalties around it [Pa/m]. Collective.

    The softest counts most: a step of the multiplier that is too long would not converge.
    """
    d = body.dim
    own = facets[facets < body.mesh.topology.index_map(d - 1).size_local]
    beside, local = cells_beside_facets(body.mesh, own)
    eps = penalty.x.array[penalty.function_space.dofmap.list[beside, 0]]
    closure = [S.dofmap.dof_layout.entity_closure_dofs(d - 1, i) for i in range(d + 1)]
    nodes = S.dofmap.list[beside[:, None], np.array(closure, dtype=np.int32)[local]]
    rows = np.column_stack([np.ones(len(own)), 1 / eps])[:, None]
    count, inverse = summed(S.dofmap.index_map, nodes, rows).T
    return np.asarray(np.divide(count, inverse, out=np.ones_like(count), where=inverse > 0))
