"""Rigid obstacles that a force moves along a direction: how far is a scalar unknown.

With the displacement s of the obstacle along its unit direction d, the force F on it and the
contact pressure p on the body, p = max(0, lam - eps g), the energy of body, contact and force has
the derivative

    g(u, s) = integral of p n . d - F

with respect to s: the equation of s is the balance of forces on the obstacle.  See `contact` for
the potential of p, of whose gap -n . d is the derivative by s.

Away from the body nothing determines s.  At the start the obstacle is moved to where it first
touches; from where an iterate leaves the body, it is led back, see `_guided`.  That acts while
nothing is in contact, so that no state in which a force is carried contains any of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from dolfinx import fem

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import largest, smallest, total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.body import span
from dolfin_elastic.model.amplitude import CONSTANT, PROPORTIONAL, Amplitude
from dolfin_elastic.problem.context import FormContext
from dolfin_elastic.problem.pose import Pose
from dolfin_elastic.problem.term import Blocks, OutOfBalance, ScalarTerm, StepWeights, Term
from dolfin_elastic.problem.terms.contact.pair import ContactPair

SAME = 1e-10
"""Force out of balance, as a share of the force: the next Newton step would find round-off."""

_ROUND_OFF = 10 * np.finfo(float).eps
"""Of places, over the size of the body."""

_STEP = 1e-5
"""Step of the differences over the size of a cell: its square and round-off over it are alike."""

_STRIDES = 1000
"""Of the search for the first touch, in each of which the gap can not be closed twice."""

_PAST = 10.0
"""Gap over that of the start and the size of the body from which on the obstacle has gone past."""

_TIMES = 101
"""Load factors at which the force must not pull."""


_SEARCHES = 100
"""Newton iterations for the place of a mass: its force is linear but for where nodes hit."""

_SETTLED = 1e-14
"""Last change of that place over the size of the coordinates."""


class MovingMass(Term):
    """A rigid obstacle with a mass m, which moves along its direction d in implicit motion.

    At the stage of a step m a = F - R, with the force F on it and R = integral of p n . d.  For
    each displacement of the body its place at the stage is found by Newton's method: R grows with
    it, so there is one.  What is left is a system of the body alone, with the tangent

        K - (dR/du)^T (dR/du)/(m da/ds + dR/ds),

    the Schur complement of the place s: all nodes in contact are coupled.

    Args:
        pair: Its contact, the obstacle of which it is.
    """

    nodal = restrains = follows_path = True
    at_rest = False

    def __init__(self, pair: ContactPair, context: FormContext) -> None:
        assert pair.contact.mass is not None
        self._pair, self._context, self._where = pair, context, f"contact[{pair.index}]"
        self._comm, self.label, self.mass = context.body.comm, pair.label, pair.contact.mass
        self._way, S = pair.contact.way(context.body.dim), pair.lam.function_space
        self._s, self._v, self._a = fem.Function(S), fem.Function(S), fem.Function(S)
        names = "place", "velocity", "acceleration"
        fields = self._s, self._v, self._a
        self.memory = {
            f"obstacle_{name}_{pair.index}": one for name, one in zip(names, fields, strict=True)
        }
        self._t, self._default = 0.0, CONSTANT
        self._begun, self._step, self._offset = (0.0, 0.0, 0.0), StepWeights(1, 0, 0, 1, 1, 0), 0.0
        self._kept = self._begun
        self._in_stage, self._stiffness = False, np.inf

    def begin(self, *, moving: bool) -> None:
        """See `Term`."""
        if not moving:
            raise InputError(
                f"the obstacle of '{self.label}' has a mass, which moves in [dynamics] only",
                where=f"{self._where}.mass",
                expected="leave it out, or [dynamics] with an implicit scheme",
            )
        self._force = self._pair.along(self._way)
        # The first acceleration follows from the forces at the start of the first step.
        self._take(0.0, self._pair.contact.velocity, np.nan)

    def set_time(self, t: float, default: Amplitude) -> None:
        """See `Term`: between steps it is where it was left."""
        self._t, self._default = t, default
        self._move(self._now[0])

    @property
    def _now(self) -> tuple[float, float, float]:
        """Place [m], velocity [m/s] and acceleration [m/s^2]."""
        if not len(self._s.x.array):  # a rank without a part of the body
            return self._kept
        return (
            float(self._s.x.array[0]),
            float(self._v.x.array[0]),
            float(self._a.x.array[0]),
        )

    def _take(self, s: float, v: float, a: float) -> None:
        self._s.x.array[:], self._v.x.array[:], self._a.x.array[:] = s, v, a
        self._kept = s, v, a
        self._move(s)

    def _move(self, s: float) -> None:
        self._pair.shift.value[:] = s * self._way

    def _given(self) -> float:
        return self._pair.contact.force_at(self._t, self._default)

    def begin_step(self) -> None:
        """See `Term`."""
        every = self._comm.allgather(self._now if len(self._s.x.array) else None)
        s, v, a = next(one for one in every if one is not None)
        if np.isnan(a):
            a = (self._given() - self._force.value()) / self.mass
        self._begun = s, v, a

    def enter_stage(self, step: StepWeights, pose: FloatArray | None) -> None:
        """See `Term`."""
        self._step, self._offset, self._in_stage = step, 0.0, True

    def _stage(self) -> tuple[float, float]:
        """Place at the stage [m], and the acceleration there [m/s^2]."""
        (s, _, a), p, (way, _, end) = self._begun, self._step, self._step_made()
        return s + (1 - p.alpha_f) * way, (1 - p.alpha_m) * end + p.alpha_m * a

    def _step_made(self) -> tuple[float, float, float]:
        """Way over the step [m], and velocity [m/s] and acceleration [m/s^2] at its end."""
        (_, v, a), p = self._begun, self._step
        end = a + self._offset / (p.beta * p.h**2)
        way = p.h * v + p.h**2 * (p.start + p.beta) * a + self._offset
        return way, v + p.h * ((1 - p.gamma) * a + p.gamma * end), end

    def follow(self) -> None:
        """See `Term`.

        Raises:
            InputError: Its force is not finite.
        """
        if not self._in_stage:
            return
        p, given = self._step, self._given()
        inertia = self.mass * (1 - p.alpha_m) / ((1 - p.alpha_f) * p.beta * p.h**2)
        size = largest(self._comm, float(np.max(np.abs(self._pair.places()), initial=0.0)))
        for _ in range(_SEARCHES):
            place, acceleration = self._stage()
            self._move(place)
            moved = self._rows() @ self._way
            self._stiffness = inertia - total(self._comm, float(moved.sum()))
            off = self.mass * acceleration + self._force.value() - given
            change = off / self._stiffness
            if not abs(change) > _SETTLED * size:
                return
            self._offset -= change / (1 - p.alpha_f)

    def _rows(self) -> FloatArray:
        """Derivative of its force on the body by the displacements, owned nodes (n, dim) [N/m]."""
        rows = self._force.row()[self._context.unknowns.displacement_dofs]
        return np.asarray(rows.reshape(-1, len(self._way)))

    def blocks(self) -> Blocks:
        """See `Term`: see the class."""
        rows = self._rows() if self._in_stage else np.zeros((0, len(self._way)))
        own = np.flatnonzero(np.any(rows != 0.0, axis=1)).astype(np.int32)
        mine = self._context.unknowns.V.dofmap.index_map.local_to_global(own), rows[own]
        parts = self._comm.allgather(mine)
        nodes, others = (np.concatenate([part[i] for part in parts]) for i in (0, 1))
        values = -mine[1][:, None, :, None] * others[None, :, None, :] / self._stiffness
        i, j = np.broadcast_arrays(mine[0][:, None], nodes[None])
        d = len(self._way)
        return Blocks(i.ravel().astype(np.int64), j.ravel(), values.reshape(-1, d, d))

    def leave_stage(self, *, found: bool) -> None:
        """See `Term`."""
        s, v, a = self._begun
        if found:
            way, v, a = self._step_made()
            s += way
        self._in_stage = False
        self._take(s, v, a)

    def add_results(self, result: dict[str, float], forces: FloatArray) -> None:
        """See `Term`: displacement, velocity, and the force on the body."""
        s, v, _ = self._now
        result[f"obstacle_displacement_{self.label}"] = s
        result[f"obstacle_velocity_{self.label}"] = v
        result[f"obstacle_force_{self.label}"] = self._force.value()


class LoadedObstacle(ScalarTerm):
    """A rigid obstacle under a force.

    Args:
        pair: Its contact, the obstacle of which it moves.
    """

    restrains = True

    def __init__(self, pair: ContactPair, context: FormContext) -> None:
        self._pair, self._context, self._where = pair, context, f"contact[{pair.index}]"
        self._comm, self.label, self.size = context.body.comm, pair.label, 1
        self._way = pair.contact.way(context.body.dim)
        self.steps, self.signs = np.array([_STEP * pair.size]), np.ones(1)
        self.prescribing = np.zeros(1, dtype=bool)
        self._s = self._stiffness = self._most = 0.0

    def without_motion(self) -> InputError:
        """See `ScalarTerm`."""
        return InputError(
            f"a force moves the obstacle of '{self.label}' in statics only",
            where=f"{self._where}.force",
            expected="a mass of it in implicit motion; or [statics]; or its motion over time",
        )

    def commit(self) -> None:
        """See `Term`.

        Raises:
            InputError: The force pulls, at a load factor that `check_start` has not looked at.
        """
        super().commit()
        self._check_push(self.t)

    def _check_push(self, t: float) -> None:
        """Refuses a force that pulls: only `_guided` would be in balance with it."""
        force = self._pair.contact.force_at(t, PROPORTIONAL)
        self._most = max(self._most, force)
        if force < -SAME * self._most:
            raise InputError(
                f"the force on the obstacle of '{self.label}' is {force:.4g} N at load factor "
                f"{t:.4g}: it pulls the obstacle off the body, where nothing stops it",
                where=f"{self._where}.force",
                expected="a force not below 0, along a direction towards the body",
            )

    # --- the start ---

    def check_start(self) -> str:
        """See `Term`: the obstacle is moved to where it first touches the body.

        Raises:
            InputError: It meets nothing, or its force pulls.
        """
        for t in np.linspace(0.0, 1.0, _TIMES):
            self._check_push(float(t))
        if not self._touch() or not self._approaches():
            raise InputError(
                f"in its direction the obstacle of '{self.label}' meets nothing: its force would "
                "move it on and on",
                where=f"{self._where}.direction",
                expected="a direction from the obstacle towards the surfaces of `on`",
            )
        return ""

    def _approaches(self) -> bool:
        """Whether the obstacle, which touches the body, goes on into it. Collective."""
        gap, start = self._nearest(), self.get()
        self.put(start + self._pair.tolerance)
        nearer = self._nearest() < gap
        self.put(start)
        return nearer

    def _touch(self) -> bool:
        """Moves the obstacle up to the first touch; whether there is one. Collective.

        The gap is a distance: it closes no faster than the obstacle moves.
        """
        far = _PAST * (self._nearest() + span(self._context.body))
        for _ in range(_STRIDES):
            gap = self._nearest()
            if gap <= self._pair.reach / 2:
                return True
            if gap > far:
                return False
            self.put(self.get() + gap)
        return gap <= self._pair.tolerance

    def _nearest(self) -> float:
        """The smallest gap [m]. Collective."""
        return self._smallest(self._pair.gaps()[0])

    def _smallest(self, gaps: FloatArray) -> float:
        return smallest(self._comm, float(np.min(gaps, initial=np.inf)))

    def begin(self, *, moving: bool) -> None:
        """See `Term`."""
        self._force = self._pair.along(self._way)
        self._stiffness = self._force.stiffness

    def unsettled(self) -> bool:
        """See `Term`: it rests above the body, on a multiplier that has no pressure left."""
        return self._smallest(self._pair.pressing_gaps()) > self._pair.tolerance

    # --- the unknown and its equation ---

    def get(self) -> FloatArray:
        """The displacement of the obstacle along its direction [m]."""
        return np.array([self._s])

    def put(self, values: FloatArray) -> None:
        """Moves the obstacle."""
        self._s = float(values[0])
        self._pair.shift.value[:] = self._s * self._way

    def shifts(self, pose: Pose) -> FloatArray:
        """See `ScalarUnknowns`."""
        return self._way[None] if pose is self._pair.pose else super().shifts(pose)

    def _given(self) -> float:
        return self._pair.contact.force_at(self.t, self.default)

    def residual(self, forces: OutOfBalance) -> FloatArray:
        """The force on the body beyond the given one [N]. Collective."""
        carried, given = self._force.value(), self._given()
        return np.array([carried - given if carried != 0.0 else self._guided(given)])

    def _clearances(self) -> FloatArray:
        """Gaps beyond those at which the pressure ends, at the owned nodes [m]. Collective."""
        pair = self._pair
        return pair.pressing_gaps() - pair.lam.x.array[pair.nodes] / pair.eps

    def _guided(self, given: float, farther: float = 0.0) -> float:
        """What leads an obstacle that touches nothing back to the body [N]. Collective.

        -(F + k g) with the penalty k of the whole surface and the gap g beyond the one at which the
        pressure ends: so it goes on where the force that is carried ends.  Where a gap
        is below that, but no pressure is found, -F^2/(F - k g): as steep, and never 0.

        Args:
            given: The force F [N].
            farther: Added to the gap [m].
        """
        clear = self._smallest(self._clearances())
        push = self._stiffness * (clear + farther)
        if push >= 0.0:
            return -(given + push)
        given = max(given, self._stiffness * self._pair.reach)
        return -(given**2) / (given - push)

    def rows(self, forces: OutOfBalance) -> list[FloatArray]:
        """Its derivative [N/m]. Collective."""
        return [self._force.row()]

    def exact(self, rows: Sequence[FloatArray]) -> dict[int, tuple[FloatArray, float]]:
        """See `ScalarUnknowns`: the tangent is symmetric, and gaps depend on u - s d.

        At the first touch differences would see one half of the penalty.
        """
        dim = len(self._way)
        moved = rows[0][self._context.unknowns.displacement_dofs].reshape(-1, dim) @ self._way
        own = -total(self._comm, float(moved.sum()))
        if own == 0.0:  # nothing is in contact
            given, h = self._given(), float(self.steps[0])
            own = (self._guided(given, -h) - self._guided(given, h)) / (2 * h)
        return {0: (rows[0], own)}

    def settled(self, residual: FloatArray, target: float) -> bool:
        """The force that is carried is the one that is given."""
        floor = self._stiffness * _ROUND_OFF * self._size()
        return bool(abs(residual[0]) <= max(SAME * abs(self._given()), floor))

    def _size(self) -> float:
        """Of the coordinates, whose round-off gaps have [m]. Collective."""
        return largest(self._comm, float(np.max(np.abs(self._pair.places()), initial=0.0)))

    def add_results(self, result: dict[str, float], forces: FloatArray) -> None:
        """See `Term`: displacement, and the force that is carried."""
        result[f"obstacle_displacement_{self.label}"] = self._s
        result[f"obstacle_force_{self.label}"] = self._force.value()


def make_loaded_obstacles(
    pairs: Sequence[ContactPair], context: FormContext
) -> Iterator[LoadedObstacle | MovingMass]:
    """Those of the contacts whose obstacle a force moves."""
    for pair in pairs:
        if pair.contact.push is None:
            continue
        kind = LoadedObstacle if pair.contact.mass is None else MovingMass
        yield kind(pair, context)
