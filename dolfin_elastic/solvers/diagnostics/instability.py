"""Evidence of instability: negative eigenvalues, lost stiffness, and the motion they belong to."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dolfin_elastic.core.parallel import largest, total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.core.units import coordinates
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers import messages
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.diagnostics.evidence import Cells, TrialStates
from dolfin_elastic.solvers.diagnostics.material_limit import NEARLY, softest_spot
from dolfin_elastic.solvers.diagnostics.stability import (
    LIMIT,
    FactorisedTangent,
    Mode,
    curvature,
)

SOFT = 0.5
"""Stiffness of a mode over that at rest, below which it is lost if the last iterate is unstable."""

LOST = 0.1
"""The same ratio, below which the stiffness is lost whatever the last iterate is."""

SIDEWAYS = 0.02
"""Cosine between mode and load up to which the load does no work on the mode: a bifurcation."""

HUGE = 1.0
"""Green-Lagrange strain from which a unit of the load is probably wrong: a stretch of 1.7."""


@dataclass(frozen=True)
class Spectrum:
    """A tangent's signs and weakest mode.

    Attributes:
        negative: Negative eigenvalues; None: not counted.
        mode: The weakest one, or None.
    """

    negative: int | None
    mode: Mode | None

    @property
    def unstable(self) -> bool:
        """There is a motion that the body does not resist."""
        return bool(self.negative) or (
            self.negative is None and self.mode is not None and self.mode.stiffness < 0.0
        )


@dataclass(frozen=True)
class Finding:
    """What was found of stability.

    Attributes:
        text: In words; empty if there is no evidence of an instability.
        advice: What to try.
        place: Where the motion or the material's instability is [m].
        not_examined: What was not looked at, for other diagnoses.
    """

    text: str = ""
    advice: str = ""
    place: tuple[float, ...] = ()
    not_examined: str = ""


def unstable(
    states: TrialStates, good: FloatArray, failed: FloatArray, *, settled: bool = False
) -> Finding:
    """Looks for an instability. Collective."""
    problem = states.problem
    if problem.num_dofs > LIMIT[problem.body.dim]:
        return _by_curvature(states, good, failed)
    at_good = _spectrum(states, good)
    if at_good is None or at_good.unstable:
        return Finding() if at_good is None else _finding(states, good, at_good)
    at_failed = _spectrum(states, failed)
    lost = at_failed is not None and at_failed.unstable
    if settled and lost and at_failed is not None:
        which = f"equilibrium at load factor {float(problem.context.t.value):.6g}"
        return _finding(states, failed, at_failed, which=which)
    if at_good.mode is None or at_failed is None:
        return Finding()
    left = _stiffness_left(_spectrum(states, np.zeros_like(good)), at_good.mode)
    near = left <= (SOFT if lost else LOST)
    return _finding(states, good, at_good, left=left) if near else Finding()


def _stiffness_left(at_rest: Spectrum | None, mode: Mode) -> float:
    """Share of the stiffness at rest that is left; 1 where that is not known."""
    if at_rest is None or at_rest.mode is None or at_rest.mode.stiffness <= 0.0:
        return 1.0
    return mode.stiffness / at_rest.mode.stiffness


def _spectrum(states: TrialStates, values: FloatArray) -> Spectrum | None:
    """Factorises the tangent of a state; None where it has none."""
    if not states.tangent(values):
        return None
    stability = FactorisedTangent(states.assembler)
    try:
        return Spectrum(stability.negative, stability.weakest()) if stability.sound else None
    finally:
        stability.destroy()


def _by_curvature(states: TrialStates, good: FloatArray, failed: FloatArray) -> Finding:
    """For large bodies: curvature along the difference of last iterate and equilibrium. Collective.

    A negative one proves an instability without a factorisation.
    """
    not_examined = "; the tangent's eigenvalues were not looked at, the body is too large for that"
    assembler = states.assembler
    difference = (failed - good)[: assembler.size]
    motion = difference[assembler.displacement_dofs]
    size = float(np.sqrt(total(assembler.comm, float(np.sum(motion**2)))))
    if not (np.isfinite(size) and size > 0.0):
        return Finding(not_examined=not_examined)
    for state in (good, failed):
        if states.tangent(state) and (k := curvature(assembler, difference)) < 0.0:
            spectrum = Spectrum(None, Mode(k, np.asarray(motion / size, dtype=np.float64)))
            return replace(
                _finding(states, good, spectrum, by_curvature=True), not_examined=not_examined
            )
    return Finding(not_examined=not_examined)


def take_newton_step(assembler: Assembler) -> bool:
    """Takes a full step of Newton's method with the tangent as it is assembled. Collective.

    Returns:
        Whether there is such a step.
    """
    stability = FactorisedTangent(assembler)
    x, f, step = (assembler.create_vector() for _ in range(3))
    if stability.sound:
        assembler.get(x)
        assembler.residual.evaluate(x, f)
        stability.solve(f, step)
        x.axpy(-1.0, step)
        assembler.put(x)
    for thing in (x, f, step, stability):
        thing.destroy()
    return stability.sound


# --- in words ---


def _finding(
    states: TrialStates,
    good: FloatArray,
    spectrum: Spectrum,
    *,
    left: float = 0.0,
    by_curvature: bool = False,
    which: str = "last equilibrium",
) -> Finding:
    """The finding in words, with advice. Collective.

    Args:
        left: Share of its stiffness at rest that the weakest mode has left.
        by_curvature: The mode is only the difference from the last equilibrium to the last iterate.
    """
    states.put(good)
    assembler = states.assembler
    mode = spectrum.mode
    text = (
        f"the {which} is unstable, so that the body leaves it at the slightest push: its tangent "
        f"has {_eigenvalues(spectrum.negative)}"
        if spectrum.unstable
        else "near the last equilibrium stability is lost: the stiffness against one motion has "
        f"fallen to {100 * left:.2g} % of that at rest"
    )
    if by_curvature:
        text = "the body has a negative stiffness along the way that Newton's method went"
    if mode is None:
        return Finding(text, messages.BUCKLING)
    if (spot := softest_spot(Cells(assembler))) is not None and spot.share < NEARLY:
        material, advice = spot.in_words(assembler.problem)
        return Finding(f"{material}; {text}", advice, spot.place)
    place, direction, names = _largest_motion(assembler.problem, mode.motion)
    strain = _largest_strain(assembler)
    if strain > HUGE:
        kind, advice = f"the material is strained by {100 * strain:.2g} %", messages.HUGE
    else:
        kind, advice = _kind(assembler, mode.motion)
    at, along = assembler.problem.body.unit.point(place), coordinates(direction)
    text += f"; {kind}; the motion is largest at {at}{names}, along {along}"
    return Finding(text, advice, place)


def _eigenvalues(negative: int | None) -> str:
    if negative is None:
        return "at least one negative eigenvalue"
    return messages.count(negative, "negative eigenvalue")


def _largest_strain(assembler: Assembler) -> float:
    """Largest entry of the Green-Lagrange strain of the present state. Collective."""
    F = Cells(assembler).gradients()
    strains = (np.einsum("cpki,cpkj->cpij", F, F) - np.eye(3)) / 2
    return largest(assembler.comm, float(np.max(np.abs(strains), initial=0.0)))


def _kind(assembler: Assembler, motion: FloatArray) -> tuple[str, str]:
    """Buckling, to which the load does no work, or a limit point.

    Source: E. Riks, Int. J. Solids Structures 15 (1979) 529: at a bifurcation the mode is
    orthogonal to the load, at a limit point it is not.
    """
    forces = assembler.reactions.loads().copy()
    load = (forces - assembler.constrained_part(forces))[assembler.displacement_dofs]
    sums = total(assembler.comm, np.array([np.sum(load * motion), np.sum(load**2)]))
    if sums[1] == 0.0:
        return "it buckles or snaps through", messages.BUCKLING
    if abs(sums[0]) <= SIDEWAYS * np.sqrt(sums[1]):
        return "it buckles, sideways to the load", messages.BUCKLING
    return "a limit point of the load", messages.LIMIT_POINT


def _largest_motion(
    problem: Problem, motion: FloatArray
) -> tuple[tuple[float, ...], tuple[float, ...], str]:
    """Place and direction of the largest nodal motion, and the material there. Collective."""
    dim, comm = problem.body.dim, problem.body.comm
    rows = motion.reshape(-1, dim)
    lengths = np.linalg.norm(rows, axis=1)
    top = largest(comm, float(np.max(lengths, initial=0.0)))
    places = problem.unknowns.unknown_places[: len(rows), :dim]
    # Nodes that move alike: the same one on any number of ranks.
    near = np.flatnonzero(lengths >= (1 - 1e-3) * top)
    node = min(near, key=lambda n: tuple(places[n].round(12)), default=None)
    local = None
    if node is not None:
        local = (
            tuple((places[node].round(12) + 0.0).tolist()),
            rows[node],
            _material_at(problem, node),
        )
    result = [one for one in comm.allgather(local) if one is not None]
    place, moved, name = min(result, key=lambda one: one[0])
    unit = np.array(moved) / np.linalg.norm(moved)
    unit *= np.sign(unit[np.argmax(np.abs(unit))])  # a mode has no sign of its own
    return place, tuple(float(c) for c in unit.round(3) + 0.0), name


def _material_at(problem: Problem, node: int) -> str:
    if len(problem.regions) == 1:
        return ""
    nodes = problem.unknowns.U.dofmap.list
    names = sorted(p.name for p in problem.regions if np.any(nodes[p.cells] == node))
    return f" ({messages.material(problem, names)})" if names else ""
