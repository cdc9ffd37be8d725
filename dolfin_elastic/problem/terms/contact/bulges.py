"""`FaceBulges`: what keeps quadratic faces from bulging between vertices that press.

Mean gaps around vertices leave a quadratic face free to bulge: its vertices move one way and its
midside nodes the other.  A pressure per reference area is a dead load for this motion.  On an
incompressible half-space of the shear modulus mu, with the displacements a cos kX along the normal
and b sin kX along the surface, the energy per area is

    mu k (a^2 + b^2)/2 - p k a b/2,

so that the surface wrinkles from p = 2 mu on, as rubber under the pressure of a seal.  It never
does with a further energy s a^2/4 where s >= p^2 k/(2 mu).  So faces whose vertices all press have
the energy kappa (g - g_l)^2/2, with the gap g and its linear part g_l on the face: no resultant and
no uniform pressure has a part in it.  Where all faces of length h bulge alike k is 2 pi/h and s is
0.71 kappa, where neighbours bulge to opposite sides pi/h and 0.36 kappa: either way

    kappa >= 4.4 p^2/(mu h).

In an equilibrium the bulges vanish as far as faces can follow the obstacle; and where p is small
against mu, kappa is small against the body's own stiffness.  Its p is the multiplier; where this
is an unknown of Newton's method that of the iteration, of which the tangent has no derivative.

Source: M. A. Biot, Appl. Sci. Res. A 12 (1963) 168 (instability of surfaces under compression);
K. L. Johnson, Contact Mechanics, Cambridge 1985, section 13.2 (half-space under a wave).
"""

from __future__ import annotations

import numpy as np

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import BoolArray, FloatArray
from dolfin_elastic.problem.context import FormContext
from dolfin_elastic.problem.material_regions import shear_modulus
from dolfin_elastic.problem.terms.contact.pair import ContactPair
from dolfin_elastic.problem.terms.contact.vertex_functions import VertexFunctions

CURB = 20.0
"""kappa mu h/p^2: four times that, for p is the mean on a face, and grows within a load step."""


class FaceBulges:
    """The stiffness of quadratic faces on an obstacle against bulges; of others none.

    Args:
        pair: Its multipliers are the p in kappa; two surfaces of a mesh have no stiffness.
        functions: Neither have linear faces, which cannot bulge.

    Attributes:
        some: There is a stiffness, once vertices press.
    """

    def __init__(self, pair: ContactPair, functions: VertexFunctions, context: FormContext) -> None:
        self._pair, self._functions = pair, functions
        self.some = pair.contact.between is None and not functions.linear
        self._regions = context.regions
        self._softest: tuple[bytes | None, float] = None, 1.0

    @property
    def _per_square(self) -> FloatArray:
        """kappa over p^2 of the facets, with the present constants of materials [1/(Pa m)]."""
        known, mu = self._softest
        constants = (c.value for one in self._regions for c in one.constants.values())
        if (present := b"".join(value.tobytes() for value in constants)) != known:
            mu = min(shear_modulus(region.typical) for region in self._regions)
            self._softest = present, mu
        return np.asarray(CURB / mu / self._functions.lengths)

    def _means(self) -> FloatArray:
        """p of the facets [Pa]; 0 where not all vertices press. Collective."""
        p, kept = self._pair.values(), self._pair.kept
        both = np.stack([p, (p > 0.0 if kept is None else kept).astype(float)], axis=1)
        at_vertices = self._functions.at_vertices(both)
        press = np.all(at_vertices[..., 1] > 0.0, axis=1)
        return np.where(press, np.mean(at_vertices[..., 0], axis=1), 0.0)

    def _stiffness(self) -> FloatArray:
        """kappa times the areas of the points, shape (facets, points) [N/m]. Collective."""
        return np.asarray(
            (self._per_square * self._means() ** 2)[:, None] * self._functions.weights
        )

    def by_multipliers(self, gaps: FloatArray, along: FloatArray) -> FloatArray:
        """Derivatives of the virtual work by the p at the owned vertices, (n,) [m^3]. Collective.

        Args:
            gaps: At the points of the functions [m].
            along: The virtual displacement along the normals there [m].
        """
        functions, bulge = self._functions, self._functions.bulge
        bent = (bulge @ gaps[..., None] * (bulge @ along[..., None]))[..., 0]
        d = functions.psi.shape[-1]
        each = -2 / d * self._per_square * self._means() * np.sum(functions.weights * bent, axis=1)
        return functions.summed(np.repeat(each[:, None], d, axis=1)[..., None])[:, 0]

    def pressures(self, gaps: FloatArray) -> FloatArray:
        """With integrals, at the points of the functions, shape of the gaps there [N]. Collective.

        Args:
            gaps: Or what is as they are, such as their derivative along a direction [m].
        """
        if not self.some:
            return np.zeros_like(gaps)
        bulge = self._functions.bulge
        bent = self._stiffness()[..., None] * (bulge @ gaps[..., None])
        return np.asarray(-(bulge.swapaxes(1, 2) @ bent)[..., 0])

    def loads(self, pressures: FloatArray, gaps: FloatArray) -> FloatArray:
        """The same with pressures at the vertices [N]. Collective."""
        at_points = self._functions.at_points(pressures[:, None])[..., 0]
        return np.asarray(at_points + self.pressures(gaps))

    def energy(self, gaps: FloatArray) -> float:
        """That of all faces [J]. Collective."""
        return -total(self._pair.comm, float(np.sum(self.pressures(gaps) * gaps))) / 2

    def tangent(self, normals: FloatArray) -> tuple[BoolArray, FloatArray]:
        """Which facets have any stiffness, and their blocks of nodes [N/m]. Collective.

        Args:
            normals: At the points of the functions, shape (facets, points, dim).
        """
        stiffness = self._stiffness()
        some: BoolArray = np.asarray(stiffness.any(axis=1))
        N, bulge = self._functions.at(some), self._functions.bulge[some]
        rows = np.einsum("fqp,fpk,fpd->fqkd", bulge, N, normals[some], optimize=True)
        blocks = np.einsum("fq,fqkd,fqle->fklde", stiffness[some], rows, rows, optimize=True)
        return some, np.asarray(blocks)
