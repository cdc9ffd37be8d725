"""`State` and `Mode`: what solvers yield; `RestartState`: what a solver needs to continue a run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass, field
from math import pi
from typing import Any, Literal, Protocol, TypeVar, runtime_checkable

import numpy as np
from dolfinx import fem

from dolfin_elastic.core.errors import ElasticError, RestartError
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.core.units import METRE, LengthUnit
from dolfin_elastic.model.kinematics import moment_of


def plain(t: float) -> float:
    """A time or load factor rounded to 12 digits, which removes the round-off of sums."""
    return float(f"{t:.12g}")


Verdict = Literal["pass", "warn", "fail"]
"""Of an audit; what fails is not to be relied on."""


@dataclass(frozen=True)
class Audit:
    """Audit of a converged step: balance of forces, moments and energy, and positive volumes.

    Attributes:
        force: Norm of the sum of applied forces, reactions and, in motion, inertia, over the sum of
            the norms of these nodal forces; axial components only in an axisymmetric body; nan of a
            periodic cell.
        moment: The same of their moments about the origin; nan where moments need not balance.
        work: Work of loads, supports, springs and contact with its friction on the body since the
            start [J], by the trapezoidal rule.
        energy: Strain energy, in motion with kinetic energy, minus that of the start [J]; nan where
            a law has no strain energy.
        min_jacobian: Smallest det F at the quadrature points of the energy.
        max_jacobian: Largest det F there.
        min_place: Barycentre [m] of the cell with the smallest det F, reference configuration.
        max_place: Barycentre of the cell with the largest det F.
        inverted: Number of cells with a det F that is not positive, where a law survives that;
            else None.
        verdict: Of this step.
        reasons: Reasons against it, at most one for each check.
        so_far: The worst reason of each check since the start, with its time; what fails first.
        verdict_so_far: Of all steps since the start.
        notes: Checks that are left out, and why.
    """

    force: float
    moment: float
    work: float
    energy: float
    min_jacobian: float
    max_jacobian: float
    min_place: tuple[float, ...] = ()
    max_place: tuple[float, ...] = ()
    inverted: int | None = None
    verdict: Verdict = "pass"
    reasons: tuple[str, ...] = ()
    so_far: tuple[str, ...] = ()
    verdict_so_far: Verdict = "pass"
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Stability:
    """Whether an equilibrium is stable, by the eigenvalues of its tangent.

    Attributes:
        negative: How many are negative, those of pressures and constraints left out: 0 of a stable
            equilibrium; None where it could not be judged.
        at_least: There may be more than these.
        reason: Why it could not be judged, or need not be.
    """

    negative: int | None
    at_least: bool = False
    reason: str = ""

    @property
    def verdict(self) -> Literal["stable", "unstable", "not judged"]:
        """In a word."""
        if self.negative is None:
            return "not judged"
        return "unstable" if self.negative else "stable"

    def __str__(self) -> str:
        if self.negative is None:
            return f"stability not judged: {self.reason}"
        if not self.negative:
            return "stable"
        least = "at least " if self.at_least else ""
        plural = "" if self.negative == 1 else "s"
        return f"unstable: its tangent has {least}{self.negative} negative eigenvalue{plural}"


@dataclass(frozen=True)
class Moment:
    """Moment of a support on the body.

    Attributes:
        value: The moment [N m], shape (3,), of a plane body about z, shape (1,).
        about: The point [m], fixed in space, shape (dim,).
    """

    value: FloatArray
    about: FloatArray

    def about_point(self, point: Sequence[float] | FloatArray, force: FloatArray) -> FloatArray:
        """The moment about another point [N m].

        Args:
            point: Coordinates [m], shape (dim,).
            force: Resultant of the forces [N], shape (dim,).
        """
        return self.value + moment_of(self.about - np.asarray(point, dtype=np.float64), force)


@dataclass(frozen=True)
class State:
    """One converged step: plain data, the same on every rank but for the fields.

    The fields are the solver's own, which overwrites them in the next step: copy them for later.

    Attributes:
        step: 0 for the initial state, then 1, 2, ...
        t: Time [s] in motion, and in statics whose end is a time or whose materials depend on
            it, see `timed`; else the load parameter.
        u: Displacement [m] on the reference configuration.
        w: All unknowns, where there are others beside u.
        v: Velocity [m/s], in motion only.
        a: Acceleration [m/s^2], in motion only; of explicit schemes and "alpha2" its mean over the
            step, 0 in the initial state.
        load_factor: Load factor in statics; 1 in motion.
        newton: Newton iterations since the state before.
        krylov: Linear iterations since then (0 with a direct solver).
        reason: PETSc's name of the reason of convergence.
        residuals: Norm of the free residual [N] before each Newton iteration and after the last.
        energies: "strain" [J]; in motion also "kinetic", "external" (work of the loads so far),
            "total"; with springs "springs", the energy stored in them, no part of the total; in
            implicit motion "damping" and "dashpots" (dissipated so far), "potential" (of dead
            loads), "balance" (the energy error: strain, kinetic and dissipated energy minus the
            work).
        reactions: Support's name to its force on the body [N], from the residual with inertia
            (virtual work); of "alpha2" at a time within the step.
        moments: Support's name to its moment on the body, of the same forces, about the middle of
            its surface; none of bodies of revolution and periodic cells.
        momenta: In motion "linear" [kg m/s] and "angular" [kg m^2/s] about the origin.
        max_displacement: Largest norm of u over the body's nodes [m].
        stability: In statics whether the equilibrium is stable; None of the initial state.
        limit_points: Load factors of the limit points that the path has passed so far, and at which
            it was left for another equilibrium, as where the body buckles.
        limit_errors: Estimated errors of these load factors.
        numbers: Further results by name in SI units, for example of probes or the volume of a
            cavity.
        audit: The audit of the step; None of explicit states between, and where nothing is judged.
        failure: Why nothing of the run so far is to be relied on, with the time of the worst; empty
            where nothing is known against it.
        done: Completed share of the whole run, 0 to 1.
        unit: Of the mesh: lengths are shown in it.
        between: It is between two states that were asked for, so no output takes it: only for a
            checkpoint and the display of a long run.
        seconds: In statics: `t` is a time, see `timed`.
        derived: What outputs have computed of the state, by name, so that others need not compute
            it again: the recovered stress, the estimated error.  Copies of the state share it.
    """

    step: int
    t: float
    u: fem.Function
    w: fem.Function | None = None
    v: fem.Function | None = None
    a: fem.Function | None = None
    load_factor: float = 1.0
    newton: int = 0
    krylov: int = 0
    reason: str = ""
    residuals: tuple[float, ...] = ()
    energies: Mapping[str, float] = field(default_factory=dict)
    reactions: Mapping[str, FloatArray] = field(default_factory=dict)
    moments: Mapping[str, Moment] = field(default_factory=dict)
    momenta: Mapping[str, FloatArray] = field(default_factory=dict)
    max_displacement: float = 0.0
    stability: Stability | None = None
    limit_points: tuple[float, ...] = ()
    limit_errors: tuple[float, ...] = ()
    numbers: Mapping[str, float] = field(default_factory=dict)
    audit: Audit | None = None
    failure: str = ""
    done: float = 0.0
    unit: LengthUnit = METRE
    between: bool = False
    seconds: bool = False
    derived: dict[str, object] = field(default_factory=dict, compare=False, repr=False)

    def __repr__(self) -> str:
        """Its step and largest displacement, without the fields."""
        at = f"t = {self.t:.6g} s" if self.timed else f"load factor {self.load_factor:.6g}"
        return f"<State {self.step}: {at}, largest displacement {self.max_displacement:.6g} m>"

    @property
    def timed(self) -> bool:
        """`t` is a time [s]: in motion, and in statics where materials or the case say so."""
        return self.v is not None or self.seconds

    @property
    def negative(self) -> int | None:
        """Negative eigenvalues of the tangent, see `Stability`; None where they are not known."""
        return None if self.stability is None else self.stability.negative


@dataclass(frozen=True)
class Mode:
    """One mode of vibration or of buckling: plain data, the same on every rank but for the fields.

    Masses are those of the whole thickness or circumference; rotations are about the centre of
    mass.  Directions are "x", "y", "z", "rx", "ry", "rz", of a plane body "x", "y", "rz", of a body
    of revolution "y".

    Source: R. Clough and J. Penzien, Dynamics of Structures (2003), sections 12-4 and 26-3.

    Attributes:
        number: 1, 2, ... in the order of the frequencies or load factors.
        kind: "rigid"; "elastic"; "unstable", of negative omega^2 in a preloaded state; or
            "buckling".
        u: Mode shape, scaled to a largest nodal displacement of 1 m.
        base: Displacement [m] of the state about which the body vibrates or buckles.
        eigenvalue: omega^2 [1/s^2], or the load factor.
        frequency: [Hz]; 0 of rigid and unstable modes, nan of buckling.
        mass: Generalised mass u . M u [kg]; nan of buckling.
        participation: Direction to participation factor u . M r/(u . M u) with the unit rigid
            motion r.
        effective: Direction to effective modal mass (u . M r)^2/(u . M u) [kg, kg m^2].
        whole: Direction to mass and moment of inertia of the whole body, r . M r.
        name: Description of a rigid mode.
        solver: What has found all modes of the same loads, and in how many iterations.
        done: Share of the modes that have been yielded, 0 to 1.
    """

    number: int
    kind: Literal["rigid", "elastic", "unstable", "buckling"]
    u: fem.Function
    base: fem.Function
    eigenvalue: float
    frequency: float = float("nan")
    mass: float = float("nan")
    participation: Mapping[str, float] = field(default_factory=dict)
    effective: Mapping[str, float] = field(default_factory=dict)
    whole: Mapping[str, float] = field(default_factory=dict)
    name: str = ""
    solver: str = ""
    done: float = 0.0

    @property
    def omega(self) -> float:
        """Angular frequency [rad/s]."""
        return 2 * pi * self.frequency

    @property
    def load_factor(self) -> float:
        """Factor on all loads at which the body buckles; nan of vibration."""
        return self.eigenvalue if self.kind == "buckling" else float("nan")


@dataclass(frozen=True)
class RestartState:
    """All that the step after the present one depends on.

    Attributes:
        fields: Name to function, the solver's own, in spaces of Lagrange elements, continuous
            or not: they change with the next step.
        numbers: The rest as JSON data: numbers, texts, lists and tables with text keys; the same
            on all ranks.
    """

    fields: Mapping[str, fem.Function]
    numbers: Mapping[str, Any] = field(default_factory=dict)


class SavedState(Protocol):
    """A `RestartState` that was saved, in memory or in a checkpoint."""

    @property
    def numbers(self) -> Mapping[str, Any]:
        """Those of the `RestartState`."""

    def fill(self, fields: Mapping[str, fem.Function]) -> None:
        """Writes the saved values into these functions, ghosts too. Collective.

        Args:
            fields: Names of the `RestartState` to functions in the same spaces.
        """


@contextmanager
def restoring(where: object) -> Iterator[None]:
    """Turns what readers of a saved state raise of other data into a `RestartError`.

    Not collective: the numbers are the same on all ranks, and so is the error.

    Args:
        where: The saved state, or the folder that it is from.

    Raises:
        RestartError: The data are not those of such a run.
    """
    try:
        yield
    except ElasticError:
        raise
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        raise RestartError(
            f"what the checkpoint holds does not fit this run ({type(error).__name__}: {error})",
            where=str(getattr(where, "path", where)),
            expected="a checkpoint as the run has written it, or compute the case anew",
        ) from error


class StateCopy:
    """A restart state saved in memory, for the same mesh on the same ranks.

    Args:
        state: What is saved first; without it the copy is empty, and false.
    """

    def __init__(self, state: RestartState | None = None) -> None:
        self._values: dict[str, FloatArray] = {}
        self.numbers: Mapping[str, Any] = {}
        if state is not None:
            self.save(state)

    def __bool__(self) -> bool:
        """A state has been saved."""
        return bool(self._values)

    def save(self, state: RestartState) -> None:
        """Replaces what was saved before. Not collective."""
        for name, function in state.fields.items():
            if name in self._values:
                self._values[name][:] = function.x.array
            else:
                self._values[name] = function.x.array.copy()
        self.numbers = deepcopy(dict(state.numbers))

    def fill(self, fields: Mapping[str, fem.Function]) -> None:
        """See `SavedState`. Not collective."""
        assert fields.keys() == self._values.keys()
        for name, function in fields.items():
            function.x.array[:] = self._values[name]


Data_co = TypeVar("Data_co", covariant=True)
Saved_contra = TypeVar("Saved_contra", contravariant=True)


class Restartable(Protocol[Data_co, Saved_contra]):
    """What takes part in a restart: a loop over steps, or a part of it with a memory.

    A loop gives a `RestartState` and restores a `SavedState`; its parts (step sizes, audits,
    monitors) give JSON data, which the loop puts among its own numbers, and restore the same data.
    """

    def restart_state(self) -> Data_co:
        """All that its next step depends on, between two steps."""

    def restore(self, saved: Saved_contra) -> None:
        """Sets what `restart_state` gave, so that the next step is the one after it.

        Args:
            saved: What `restart_state` gave.
        """


@runtime_checkable
class RestartableSolver(Protocol):
    """An analysis whose run can be continued from a checkpoint."""

    def restart_state(self) -> RestartState:
        """All that the next step depends on, while `steps` has stopped at a state. Collective."""

    def steps(self, saved: SavedState | None = None) -> Iterator[State]:
        """Yields the states. Collective.

        Args:
            saved: Where the run continues: the first state is the one after it.
        """
