"""What the cut of two surfaces changes of forces and gaps, against differences of these."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from dolfinx import mesh
from helpers.stacked import stacked

from dolfin_elastic import Contact, NeoHookean, Problem, Support
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.terms.bodies.contact import BodyContact
from dolfin_elastic.problem.terms.bodies.cut_changes import CutChanges
from dolfin_elastic.problem.terms.contact.vertex import gap_rates

STEP = 1e-5
MESHES: dict[int, dict[str, Any]] = {
    2: {"size": (1.0, 0.6), "lower": (3, 2), "upper": (5, 2), "shift": 0.13, "width": 0.8},
    3: {"size": (1.0, 0.8, 0.6), "lower": (3, 2, 1), "upper": (4, 3, 1), "width": 0.8},
}
LAWS = {name: NeoHookean(E=1e6, nu=0.3) for name in ("lower", "upper")}


def waves(X: FloatArray, seed: int) -> FloatArray:
    """A field, shape of the places."""
    rng, dim = np.random.default_rng(seed), X.shape[1]
    A, B, phase = rng.normal(size=(dim, dim)), rng.normal(size=(dim, dim)), rng.normal(size=dim)
    return np.sin(5 * X @ A.T + phase) + np.cos(7 * X @ B.T + 2 * phase)


class Pressed:
    """Two bodies with pressures between their wavy surfaces, of which one has moved aside.

    Attributes:
        a: A motion.
        v: Another one.
        b: Numbers at the owned vertices.
    """

    def __init__(self, dim: int, degree: int, more: dict[str, Any], aside: float = 0.04) -> None:
        geometry, shape = more.pop("geometry", "solid"), {**MESHES[dim], **more}
        body = stacked(**shape)
        # A soft penalty: what the cut changes is to be no small part of all.
        contact = Contact(between=["below", "above"], stiffness="1 kPa/m")
        supports = [Support(on="bottom")]
        options = {"geometry": geometry} if dim == 2 and geometry != "solid" else {}
        self.problem = Problem(
            body, LAWS, degree=degree, supports=supports, contacts=[contact], **options
        )
        (pair,) = self.problem.contact_pairs
        assert isinstance(pair, BodyContact)
        self.pair, self.comm, V = pair, body.comm, self.problem.V
        X = V.tabulate_dof_coordinates()[:, :dim]
        cells = body.mesh.topology.index_map(dim)
        every = np.arange(cells.size_local + cells.num_ghosts, dtype=np.int32)
        above = mesh.compute_midpoints(body.mesh, dim, every)[:, dim - 1] > shape["size"][-1] / 2
        upper = np.unique(V.dofmap.list[above])
        u = 0.01 / (dim - 1) ** 2 * waves(X, 5)
        u[upper] *= 0.7
        u[upper, :-1] += aside * (1 + X[upper, :1])
        self.problem.u.x.array[:] = self.start = u.ravel()
        self.a, self.v = waves(X, 12), waves(X, 11)
        self.a[upper] *= -0.3
        self.v[upper] *= -0.7
        places = pair.lam.function_space.tabulate_dof_coordinates()
        pair.lam.x.array[:] = 100 * (1 + 0.3 * np.sin(4 * places[:, 0]))
        pair.pieces.renew()
        pair.keep(pair.pieces.covered.copy())
        along = pair.places() @ np.arange(1, dim + 1)
        self.b = np.where(pair.pieces.covered, np.cos(5 * along), 0.0)

    def number(self, step: float) -> float:
        """The work of the forces along a, and the sum of b g, after a step along v."""
        self.problem.u.x.array[:] = self.start + step * self.v.ravel()
        forces, gaps = self.pair.forces(), self.pair.pressing_gaps()
        self.problem.u.x.array[:] = self.start
        local = forces @ self.a.ravel() + np.where(self.pair.kept, self.b * gaps, 0.0).sum()
        return total(self.comm, float(local))

    def slope(self, step: float) -> float:
        """Its derivative along v, by differences of fourth order."""
        first, second = (self.number(k * step) - self.number(-k * step) for k in (1, 2))
        return (8 * first - second) / (12 * step)

    def by_tangent(self) -> float:
        """The same where the pieces keep the places and the shares of their points."""
        pieces, blocks = self.pair.pieces, self.pair.blocks()
        a, v = (
            pieces.values(field.ravel(), nodes)
            for field, nodes in ((self.a, blocks.rows), (self.v, blocks.columns))
        )
        local = np.sum(self.b * gap_rates(self.pair, self.v.ravel()))
        local -= np.einsum("nd,nde,ne->", a, blocks.values, v)
        return total(self.comm, float(local))

    def by_cut(self) -> float:
        """What the cut adds to that."""
        pair, pieces = self.pair, self.pair.pieces
        changes = CutChanges(pair, pieces, pair.state()[0])
        along = np.sum(pieces.there.normal * pieces.relative(self.a.ravel()), axis=2)
        follows = pair.state()[1] * pieces.areas * pieces.means(along[..., None])[:, 0]
        rows = changes.transposed(self.a.ravel(), self.b - follows)
        return total(self.comm, float(rows @ self.v.ravel()[: len(rows)]))


@pytest.mark.parametrize(
    ("dim", "degree", "more"),
    [
        (2, 1, {}),
        (2, 2, {}),
        (2, 1, {"geometry": "axisymmetric"}),
        (2, 2, {"geometry": "axisymmetric", "order": 2}),
        (2, 2, {"order": 2}),
        (3, 1, {}),
        (3, 2, {}),
        (3, 1, {"order": 2}),
    ],
)
def test_against_differences(dim: int, degree: int, more: dict[str, Any]) -> None:
    """Faces are covered in part, and gaps are wavy; 1e-8 is what differences leave."""
    here = Pressed(dim, degree, dict(more))
    slope, fixed, cut = here.slope(STEP), here.by_tangent(), here.by_cut()
    assert abs(cut) > 1e-4 * abs(slope)
    assert slope - fixed == pytest.approx(cut, rel=1e-7, abs=1e-9 * abs(slope))


def test_nodes_of_both_sides_coincide() -> None:
    """Where pieces come and go with any motion the derivative is the mean of both sides."""
    matching = {"lower": (4, 2), "upper": (6, 2), "shift": -0.25, "width": 1.5}
    here = Pressed(2, 1, matching, aside=0.0)
    slope = here.slope(1e-6) - here.by_tangent()
    assert here.by_cut() == pytest.approx(slope, rel=1e-4)
