"""`GainRemoval`: what barriers have gained in a step is taken out of the motion of what touches.

The force of a step is that of its end.  Along the displacement du it does the work f1 . du, and the
potential B changes by B1 - B0.  Where B is convex, as between points that near or leave each other,
B1 - B0 + f1 . du is never positive; where parts slide past each other over edges and corners it is
not, and the scheme makes that energy.  What of it the scheme does not damp by itself, g, leaves the
velocity after the step: with the rigid motion w of what touches that has all of its linear and
angular momentum,

    v <- v - a (v - w),    a = 1 - sqrt(1 - 2 g/((v - w) . M (v - w))).

Source: D. Dinev, T. Liu, J. Li, B. Thomaszewski & L. Kavan, ACM Trans. Graph. 37 (2018) 79 (the
energy of steps is put right by the velocity, without a change of momenta); convexity: A. M. Stuart
& A. R. Humphries, SIAM Rev. 36 (1994) 226.
"""

from __future__ import annotations

import numpy as np
from dolfinx import fem

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.connectivity import ConnectedBodies
from dolfin_elastic.problem.term import Term
from dolfin_elastic.solvers.audit.equilibrium import EnergyBook
from dolfin_elastic.solvers.diagnostics.rigid_body import rigid_motions
from dolfin_elastic.solvers.dynamics.residual import DynamicResidual
from dolfin_elastic.solvers.dynamics.work import EnergyBalance


class GainRemoval:
    """Looks at the energy after each step of a motion with barriers. Collective to make.

    Args:
        book: Gives strain energy and contact energy at the present displacement.
        balance: Has the work of each step before the step is looked at.
        v: Velocity of the scheme, changed where energy is gained [m/s].
    """

    def __init__(
        self, moving: DynamicResidual, book: EnergyBook, balance: EnergyBalance, v: fem.Function
    ) -> None:
        self._moving, self._book, self._balance, self._v = moving, book, balance, v
        self._rows = [row for row, term in enumerate(moving.obstacles) if term.bars]
        self._bodies = ConnectedBodies(moving.problem)
        self._level = self._stored = 0.0

    @property
    def _terms(self) -> list[Term]:
        return [self._moving.obstacles[row] for row in self._rows]

    def begin(self) -> None:
        """A step will begin at the present state. Collective."""
        self._stored = sum(term.energy() for term in self._terms)
        self._level = self._energy() - self._balance.work

    def end(self, contact: FloatArray, du: FloatArray) -> bool:
        """Takes out what the step that ends at the present state has gained. Collective.

        Args:
            contact: `Forces.contact` of the step, see `EnergyBalance.add`.
            du: Change of the displacement, owned entries [m].

        Returns:
            Whether the velocity was changed.
        """
        pushes, before, level = contact[self._rows].sum(axis=0), self._stored, self._level
        self.begin()
        work = total(self._moving.comm, float(np.dot(pushes, du)))
        gained = min(self._level - level, self._stored - before + work)
        if not gained > 0.0:  # nor where a law has no energy
            return False
        self._level -= self._slow_down(gained, pushes)
        self._balance.begin()  # the next step begins with this velocity
        return True

    def _energy(self) -> float:
        """Kinetic energy, and what the body stores [J]. Collective."""
        stored, v = self._book.stored(), self._velocity
        kinetic = total(self._moving.comm, float(np.dot(v, self._momentum(v)))) / 2
        return stored["strain"] + stored.get("contact", 0.0) + kinetic

    @property
    def _velocity(self) -> FloatArray:
        return self._v.x.array[: len(self._moving.displacement_dofs)]

    def _momentum(self, v: FloatArray) -> FloatArray:
        return self._moving.momentum(v)[self._moving.displacement_dofs]

    def _slow_down(self, energy: float, pushes: FloatArray) -> float:
        """Takes energy out of the motion of bodies against each other. Collective.

        Args:
            energy: At most so much [J].
            pushes: Forces on the bodies that touch, owned entries [N].

        Returns:
            How much [J].
        """
        v = self._velocity
        way = self._moving.problem.constraints.free_part(self._within(pushes, v))
        p = self._momentum(way)
        along, square = total(self._moving.comm, np.array([np.dot(v, p), np.dot(way, p)]))
        if along <= 0.0:
            return 0.0
        a = (along - np.sqrt(max(along**2 - 2 * energy * square, 0.0))) / square
        v -= a * way
        self._v.x.scatter_forward()
        return float(a * along - a * a * square / 2)

    def _within(self, pushes: FloatArray, v: FloatArray) -> FloatArray:
        """Of the velocity what is not a rigid motion of all bodies that touch. Collective."""
        problem, comm = self._moving.problem, self._moving.comm
        dim, here = problem.body.dim, self._bodies.of_node[: len(v) // problem.body.dim]
        pushed = np.any(pushes.reshape(-1, dim) != 0.0, axis=1)
        touched = total(comm, np.bincount(here[pushed], minlength=self._bodies.count)) > 0
        chosen = np.repeat(touched[here], dim)
        places = problem.places[: len(here), :dim] + problem.u.x.array[: len(v)].reshape(-1, dim)
        modes = rigid_motions(places).reshape(len(v), -1) * chosen[:, None]
        momenta = np.stack([self._momentum(mode) for mode in modes.T], axis=1)
        sums = total(comm, np.concatenate([modes.T @ momenta, (momenta.T @ v)[:, None]], axis=1))
        rates = np.linalg.lstsq(sums[:, :-1], sums[:, -1], rcond=None)[0]
        return np.asarray(v * chosen - modes @ rates)
