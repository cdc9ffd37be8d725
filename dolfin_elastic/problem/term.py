"""What surrounds or couples a body beyond its elements, as solvers see it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal, Protocol

import numpy as np
import ufl
from dolfinx import fem

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray, IntArray
from dolfin_elastic.model.amplitude import CONSTANT, Amplitude
from dolfin_elastic.model.supports.springs import ResistingSupport, Spring
from dolfin_elastic.problem.constraints.normals import spring_directions
from dolfin_elastic.problem.constraints.rows import Constraints
from dolfin_elastic.problem.context import FormContext
from dolfin_elastic.problem.pose import Pose

if TYPE_CHECKING:
    from scipy.sparse import csr_array


@dataclass(frozen=True)
class Blocks:
    """Entries of a tangent between nodes of the displacement, which need share no element.

    Each rank may have blocks of any nodes; those of one pair are summed, over the ranks, too.

    Attributes:
        rows: Global number of each block's node of forces in the displacement's space, shape (n,).
        columns: That of its node of displacements, shape (n,).
        values: Derivative of the out-of-balance forces, shape (n, dim, dim) [N/m]; shape (n,) where
            it is the same in all directions, which it does not couple.
    """

    rows: IntArray
    columns: IntArray
    values: FloatArray

    def __add__(self, other: Blocks) -> Blocks:
        """All of both."""
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return Blocks(*(np.concatenate(pair) for pair in pairs))


@dataclass(frozen=True)
class Means:
    """Means of the displacement around vertices of a surface, against which a term may be stiff.

    Of a displacement that is linear on each face it is that of the vertex.

    Attributes:
        vertices: Owned nodes of the displacement at these vertices, shape (n,).
        rows: Weights of nodes, shape (n, nodes).
        nodes: Global number of the node of each column.
    """

    vertices: IndexArray
    rows: csr_array
    nodes: IntArray


@dataclass(frozen=True)
class StepWeights:
    """Coefficients of the step of a motion, see `solvers.dynamics.implicit.generalized_alpha`.

    Attributes:
        h: Length of the step [s].
        alpha_m: Share of the old acceleration in the stage's.
        alpha_f: Share of the old displacement and velocity in the stage's.
        beta: Weight of the new acceleration in the displacement.
        gamma: Weight of the new acceleration in the velocity.
        start: Weight of the old acceleration in the displacement.
    """

    h: float
    alpha_m: float
    alpha_f: float
    beta: float
    gamma: float
    start: float


Acting = Callable[[float], tuple[float, Amplitude]]
Kind = Literal["work", "energy", "bound", "drag"]


class _StepHooks:
    """What a term does in the steps of an implicit motion: nothing, unless it says so."""

    def begin_step(self) -> None:
        """A step of an implicit motion begins at the present state. Collective."""

    def enter_stage(self, step: StepWeights, pose: FloatArray | None) -> None:
        """Until `leave_stage` forces are those of the step at its stage. Not collective.

        Args:
            pose: What `pose.now` is at the end of the step.
        """

    def follow(self) -> None:
        """Moves what follows the displacement of the stage. Collective."""

    def passes(self, back: FloatArray, pose: FloatArray) -> bool:
        """Whether the motion back to a former state leads through it. Collective.

        Args:
            back: See `Term.longest_step`.
            pose: What `Term.pose` was in that state.
        """
        return False

    def make_convex(self) -> bool:
        """Makes its blocks semidefinite until steps are short again; whether that changes them."""
        return False

    def make_exact(self) -> None:
        """Makes its blocks the derivative of its forces, semidefinite or not."""

    def leave_stage(self, *, found: bool) -> None:
        """The stage was found, or there is none. Collective."""


class _Joining(_StepHooks):
    """What a term does that holds parts by each other, or keeps them out of each other."""

    def partings(self, fields: Sequence[FloatArray]) -> FloatArray:
        """How parts that it holds by each other would part under displacements. Collective.

        Args:
            fields: Of all local nodes, each of shape (nodes * dim,).

        Returns:
            A row for each way in which it holds them at a point, a column for each field.
        """
        return np.empty((0, len(fields)))

    def way_to_meet(self, motion: FloatArray) -> float:
        """How much of a motion brings the next points together that it would hold by each other.

        Infinity: no part of it does. Collective.

        Args:
            motion: Of all local nodes, its largest component 1.
        """
        return np.inf

    def intrusion(self) -> tuple[str, tuple[float, ...], str] | None:
        """What lies in the body although no force has seen it; None: nothing does. Collective.

        Returns:
            That in words, where on the unloaded body [m], and what to do.
        """
        return None


class Multipliers(Protocol):
    """Forces of a term that are unknowns of Newton's method, see `contact.multipliers`."""

    def linearise(self) -> bool:
        """Begins an iteration at the present displacement. Collective.

        Returns:
            Whether they are unknowns: the forces are then those with which the iteration solves.
        """

    def foresee(self, motion: FloatArray) -> None:
        """Takes them after the step, a motion of local nodes [m]. Collective."""

    def take_step(self, share: float) -> None:
        """They change by a share of the step. Not collective."""

    def holds(self) -> bool:
        """Whether their own equations hold. Collective."""

    def end(self, *, found: bool) -> None:
        """Forces follow the displacement again; in equilibrium they are the same. Collective."""


class Term(_Joining):
    """One part of the surroundings: what it does not say itself is nothing.

    Attributes:
        label: What results call it.
        mass: Its own, that steps of an implicit motion move beside the body [kg].
        linear: Its forces are linear in the displacement.
        symmetric: Its blocks are those of a symmetric matrix.
        nodal: It has forces that are in no form, see `add_forces`.
        bars: It does not let every step pass, see `longest_step`.
        only_implicit: Its forces are too dear, or too stiff, for the steps of explicit schemes.
        restrains: These answer to the body's motion; else they are loads.
        changes: As a load it changes in motion.
        opens: Its forces begin and end, as those of contact.
        joins: It holds parts of the body by each other, see `partings`.
        delays: What acts in an iteration does not end before equilibrium is found.
        multipliers: Its forces, where Newton's method can have them as unknowns.
        in_steps: Those of a step of an implicit motion do the work that it stores.
        at_rest: What it acts from stands still.
        follows_path: The equilibrium under a load depends on those before it.
        pose: Of a rigid obstacle that its forces come from; None of other terms, whose work is that
            over the displacement of the body.
        dissipates: Its forces do work that is not stored, over the motion past the obstacle.
        account: Which of the stored energies that of its form is part of.
        memory: What its forces depend on beside displacement and time, by its name in restarts.
        states: In words, what `point_states` numbers.
    """

    label: str
    mass = 0.0
    linear = symmetric = True
    nodal = restrains = changes = opens = delays = False
    multipliers: Multipliers | None = None
    in_steps = bars = only_implicit = joins = False
    at_rest = True
    follows_path = dissipates = False
    pose: Pose | None = None
    account: str = ""
    memory: Mapping[str, fem.Function] = MappingProxyType({})
    states: tuple[str, ...] = ()
    _committed: Sequence[FloatArray] = ()

    def form(self, kind: Kind) -> ufl.Form | None:
        """What it has of integrals; None without any.

        Args:
            kind: "work": virtual work of its forces on the body; "energy": what it stores [J];
                "bound": its assembled vector bounds the row sums of the stiffness; "drag": those of
                the viscosity, and the forces act in motion only.
        """
        return None

    def set_time(self, t: float, default: Amplitude) -> None:
        """Takes over what is prescribed. Not collective.

        Args:
            t: Time [s], or load parameter.
            default: Amplitude where the user gave none.
        """

    def add_forces(self, forces: FloatArray) -> None:
        """Adds its present forces on the body that are in no form. Collective.

        Args:
            forces: Of the displacement's owned nodes and ghosts, before the ranks are summed,
                shape (nodes * dim,) [N].
        """

    def energy(self) -> float:
        """What it stores of which it has no form [J]. Collective."""
        return 0.0

    def blocks(self) -> Blocks | None:
        """Minus the derivative of these forces; None, on all ranks and always, without any.

        Collective.
        """
        return None

    def means(self) -> Means | None:
        """What its blocks are of; None, on all ranks, where they are of anything else. Collective.

        They stay the same.
        """
        return None

    def longest_step(self, motion: FloatArray) -> float:
        """The share of a motion from the present state in which it lets nothing pass. Collective.

        Args:
            motion: Of the displacement's nodes, local array [m].
        """
        return 1.0

    def without_rest(self) -> InputError | None:
        """That it acts in motion only, with what to do; None: it does not."""
        return None

    # --- where its forces begin and end ---

    def held(self, *, near: bool = False) -> Iterator[tuple[IndexArray, FloatArray]]:
        """Owned nodes that it holds, (n,), and along which unit vectors, (n, dim). Collective.

        Args:
            near: Also those that are not held, but no farther from it than a cell.
        """
        yield from ()

    def slip_limits(self) -> tuple[IndexArray, FloatArray, FloatArray] | None:
        """Owned nodes that it keeps from sliding, and how; None: it keeps none. Collective.

        Returns:
            The nodes, the largest force against their sliding, (n,) [N], and normals of the planes
            in which they would slide, (n, dim).
        """
        return None

    def stick(self, always: bool) -> None:
        """Points that it keeps from sliding do not, whatever the force; or as it is. Local."""

    def point_states(self) -> tuple[FloatArray, IndexArray] | None:
        """Reference places, (n, dim) [m], and states of the points at which its forces begin.

        Collective.
        """
        return None

    def assume(self, closed: bool | None, *, near: bool = False) -> None:
        """All that may open counts as closed, or as open; None: as it is. Not collective.

        Args:
            near: As closed only what is within the tolerance of equilibria.
        """

    def distance(self) -> float:
        """How far away it is from acting [m]; 0 where it acts. Collective."""
        return 0.0

    def within_stride(self, t: float, goal: float, acting: Acting) -> float:
        """The end of a step from t, at most `goal`, up to which it jumps over no part of the body.

        Args:
            t: Load factor at which the step begins.
            goal: Load factor at which it may end at most.
            acting: Gives time and default amplitude at a load factor, see `Problem.acting`.
        """
        return goal

    def check_start(self) -> str:
        """A warning where it acts at once; empty without one. Collective.

        Raises:
            InputError: A run that begins here makes no sense.
        """
        return ""

    def conflict(self, constraints: Constraints) -> tuple[str, tuple[float, ...]] | None:
        """Why it and the constraints leave no state to the body, and where [m]. Collective."""
        return None

    # --- a run ---

    def begin(self, *, moving: bool) -> None:
        """A run begins, in motion or in statics. Collective.

        Raises:
            InputError: It cannot.
        """

    def commit(self) -> None:
        """The present equilibrium is accepted: the next step begins here. Collective.

        Its results have been asked for before.  In motion only the start is committed.
        """
        self._committed = [field.x.array.copy() for field in self.memory.values()]

    def advance(self) -> None:
        """A step of a motion is accepted: what depends on the path has passed it. Collective."""

    def go_on(self) -> None:
        """A motion starts at the present time, or goes on from a stored state. Not collective."""

    def rollback(self) -> None:
        """Goes back to what was committed last. Not collective."""
        for field, saved in zip(self.memory.values(), self._committed, strict=True):
            field.x.array[:] = saved

    def unsettled(self) -> bool:
        """The equilibrium that was found is none with what `augment` would change. Collective."""
        return False

    def augment(self) -> None:
        """Changes its memory by the equilibrium that was found. Collective."""

    def add_results(self, result: dict[str, float], forces: FloatArray) -> None:
        """Adds its results by name [SI units] to those of the terms before it. Collective.

        Args:
            forces: Out of balance at the displacement's owned entries, in motion with inertia [N].
        """


class OutOfBalance(Protocol):
    """Nodal forces out of balance, as they were assembled last."""

    @property
    def owned(self) -> FloatArray:
        """At the owned entries of all unknowns [N]."""

    def along(self, entries: IndexArray, motion: FloatArray) -> FloatArray:
        """Derivative of their work on a motion of some entries, owned entries [N]. Collective.

        Args:
            entries: Local, owned and perhaps ghost.
            motion: Displacement of each [m]; all others rest.
        """


class ScalarUnknowns:
    """Scalar unknowns s and their equations g(u, s) = 0; all ranks know both.

    Attributes:
        size: How many there are.
        steps: Differences of s by which derivatives with respect to it are taken, shape (size,).
        signs: What each is in the energy of the whole system, shape (size,).  1: a coordinate,
            whose equation is a force; -1: a multiplier, whose equation is a constraint; 0: neither.
        prescribing: Whether each changes prescribed displacements only, and no force.
    """

    size: int
    steps: FloatArray
    signs: FloatArray
    prescribing: BoolArray

    def get(self) -> FloatArray:
        """The present scalars."""
        raise NotImplementedError

    def put(self, values: FloatArray) -> None:
        """Changes the scalars and what depends on them in the problem. Not collective.

        Args:
            values: The scalars, shape (size,).
        """
        raise NotImplementedError

    def shifts(self, pose: Pose) -> FloatArray:
        """Motion of the obstacle with this pose by each of them, shape (size, dim) [m]."""
        return np.zeros((self.size, len(pose.shift.value)))

    def residual(self, forces: OutOfBalance) -> FloatArray:
        """g at the present state, for which the residual is assembled. Collective."""
        raise NotImplementedError

    def rows(self, forces: OutOfBalance) -> list[FloatArray]:
        """dg/du at the owned entries, one array a scalar. Collective."""
        raise NotImplementedError

    def exact(self, rows: Sequence[FloatArray]) -> dict[int, tuple[FloatArray, float]]:
        """Derivatives that are known, where differences would step over a kink. Collective.

        Args:
            rows: Of `rows`, at the present state.

        Returns:
            Index of a scalar to the derivative of the nodal forces out of balance by it, at the
            owned entries and without constraints, and that of its own equation.
        """
        return {}

    def settled(self, residual: FloatArray, target: float) -> bool:
        """Whether the equations hold well enough.

        Args:
            target: Norm of nodal forces out of balance that counts as none [N].
        """
        raise NotImplementedError


class ScalarTerm(Term, ScalarUnknowns):
    """A term with scalar unknowns; without any, of size 0, it only has results.

    Attributes:
        default: Amplitude where the user gave none.
        t: Time [s], or load parameter, that was set last.
        dt: Since the equilibrium that was committed last, in the same unit.
    """

    default: Amplitude = CONSTANT
    t = _start = 0.0

    @property
    def dt(self) -> float:
        """See the class."""
        return self.t - self._start

    def set_time(self, t: float, default: Amplitude) -> None:
        """See `Term`."""
        self.t, self.default = t, default

    def commit(self) -> None:
        """See `Term`."""
        super().commit()
        self._start = self.t

    def without_motion(self) -> InputError:
        """That its unknowns exist in statics only, with what to do."""
        raise NotImplementedError


class Resistance(Term):
    """Springs or dashpots on a body."""

    def __init__(self, support: ResistingSupport, context: FormContext) -> None:
        self.support, self.label, self._context = support, support.label, context
        self.account = "springs" if isinstance(support, Spring) else ""
        self.at_rest = support.at_rest

    def form(self, kind: Kind) -> ufl.Form | None:
        """See `Term`."""
        support = self.support
        if kind == "work":
            return support.virtual_work(self._context)
        if isinstance(support, Spring) and kind == "energy":
            return support.energy(self._context)
        if kind == ("bound" if isinstance(support, Spring) else "drag"):
            return support.bound(self._context)
        return None

    def held(self, *, near: bool = False) -> Iterator[tuple[IndexArray, FloatArray]]:
        """See `Term`: springs hold, dashpots do not."""
        if isinstance(self.support, Spring):
            body, V = self._context.body, self._context.unknowns.V
            for nodes, P in spring_directions(self.support, body, V):
                yield np.repeat(nodes, body.dim), P.reshape(-1, body.dim)
