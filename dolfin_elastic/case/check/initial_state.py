"""The initial state: gaps of contacts, initial displacement and velocity; supports over time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from dolfinx import fem

from dolfin_elastic.case.case import Case
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import largest, smallest, total
from dolfin_elastic.core.schema import Record
from dolfin_elastic.core.shapes.surface import FEATURES
from dolfin_elastic.core.units import LengthUnit
from dolfin_elastic.mesh.body import Body, span
from dolfin_elastic.mesh.geometry.curved import facet_areas
from dolfin_elastic.model.amplitude import CONSTANT, PROPORTIONAL, Amplitude
from dolfin_elastic.model.contact import Contact
from dolfin_elastic.problem.connectivity import ConnectedBodies
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.terms.contact.pair import FAR, ContactPair, nearest_spot
from dolfin_elastic.solvers.diagnostics.rigid_body import free_bodies
from dolfin_elastic.solvers.dynamics.settings import DynamicsSettings
from dolfin_elastic.solvers.messages import RELEASE

NOTHING_MOVES = "there is no load and every support is at rest: nothing will move"
"""A note of statics."""
TIMES = 41
"""Times of a motion, or of statics, at which supports and loads are evaluated."""
_NEAR = 0.5
"""Gap over the body's diagonal up to which an obstacle in another unit would fit."""
_ROUND_FACES = 0.5
"""Size of faces over the radius of an edge beyond which forces on it jump."""

_LARGE_FIT = 0.1
"""Interference over the diagonal of all bodies from which on its unit is in doubt."""

_COARSE = 2.0
"""Length of an obstacle's facets over the height of the elements beside it."""

_BESIDE = 0.01
"""Numbers of an obstacle over the body's diagonal that may have been meant in metres."""
_SMALL_UNIT = 0.5
"""Unit of a mesh [m] below which that is looked at."""
_LEVER = 10.0
"""How many times as far as its supports a body may move that nothing else moves."""
_PERCENT = 2.0
"""Coefficient of friction above which it was probably meant in percent."""
_ROUND_OFF = 1e-9
"""Gap over the size of a cell that counts as none."""


_UNTIED = 2e-3
"""Part of a tied surface that may lie opposite nothing without a note: that of curved facets."""


@dataclass(frozen=True)
class ContactGap:
    """The initial gap of a contact.

    Attributes:
        contact: Its key and name.
        on: The surfaces that may touch.
        obstacle: Its shape: "plane", "sphere" or "cylinder"; "between" of two surfaces.
        gap: Smallest initial gap [m], negative inside the obstacle or the other body.
        place: Undeformed place of that node [m].
    """

    contact: str
    on: str
    obstacle: str
    gap: float
    place: tuple[float, ...]


_UNLIKE = 100.0
"""Ratio of the sizes of body and rigid mesh from which on one may be in another unit."""

_TIE = "[[tie]]"
"""What joins bodies, in the notes of meshes that are not joined."""


def contact_gaps(case: Case, problem: Problem) -> tuple[ContactGap, ...]:
    """Initial gaps of all contacts. Collective.

    Args:
        case: Its contacts, and whether there is motion.
    """
    return tuple(
        ContactGap(
            f"contact[{pair.index}] '{pair.label}'",
            ", ".join(pair.contact.surfaces),
            pair.contact.shape,
            gap if abs(gap) > _ROUND_OFF * pair.size else 0.0,
            place,
        )
        for pair, gap, place in _initial_gaps(case, problem)
    )


def _initial_gaps(
    case: Case, problem: Problem
) -> list[tuple[ContactPair, float, tuple[float, ...]]]:
    """Each contact with its smallest gap at the start [m], and where [m]. Collective."""
    if problem.contact_pairs:  # in motion, what names no amplitude acts in full from the start
        problem.set_time(0.0, default=CONSTANT if case.dynamics is not None else PROPORTIONAL)
    result = []
    for pair in problem.contact_pairs:
        moved = pair.shift.value.copy()
        if pair.contact.push is not None:  # it may have been moved to where it touches
            pair.shift.value[:] = 0.0
        result.append((pair, *nearest_spot(pair)))
        pair.shift.value[:] = moved
    return result


def tie_information(problem: Problem) -> tuple[str, ...]:
    """How much of which surfaces is tied, and over which gap. Local."""
    unit, ties = problem.body.unit, problem.constraints.ties
    power, noise = problem.body.dim - 1, _ROUND_OFF
    return tuple(
        f"tie '{tied.label}': {unit.length(tied.covered, 4, power=power)}, gap at most "
        f"{unit.length(tied.gap if tied.gap > noise * tied.size else 0.0)}, which remains"
        for tied in (() if ties is None else ties.surfaces)
    )


def tie_notes(case: Case, problem: Problem) -> Iterator[str]:
    """Ties of which a part lies opposite nothing. Local."""
    ties = problem.constraints.ties
    for i, tied in enumerate(() if ties is None else ties.surfaces):
        tie, free = case.tie[i], 1 - tied.covered / tied.area
        if free > _UNTIED:
            yield (
                f"tie[{i}]: {100 * free:.2g} % of '{'+'.join(tie.surfaces)}' are not tied: nothing "
                f"of '{'+'.join(tie.others)}' lies opposite within the tolerance; if they should "
                "be, give a larger `tolerance`, and name the smaller surface as `on`"
            )


def mesh_notes(case: Case, body: Body) -> list[str]:
    """What is doubtful in the mesh; with ties, not yet what they may join. Local.

    Bodies in contact with each other are not to be joined.
    """
    meet = bool(case.tie) or _bodies_meet(case)
    return [note for note in body.notes if not (meet and _TIE in note)]


def _bodies_meet(case: Case) -> bool:
    """There is contact between bodies, or of surfaces with themselves."""
    within = len(case.pairs) < len(case.contact)
    return within or any(contact.between for contact in case.pairs.values())


def untied_notes(case: Case, problem: Problem) -> Iterator[str]:
    """Bodies of the mesh that are not joined, where the ties of the case do not. Collective."""
    if _bodies_meet(case):
        return
    if not case.tie or (bodies := ConnectedBodies(problem)).count == 1:
        return
    tied = bodies.regions()
    for note in problem.body.notes:
        named = {name for name in problem.body.regions if f"'{name}'" in note}
        if _TIE in note and not (len(named) > 1 and any(named <= one.keys() for one in tied)):
            yield note


def touching_notes(problem: Problem) -> Iterator[str]:
    """Named surfaces of bodies that touch there and move on their own. Collective."""
    from dolfin_elastic.problem.constraints.ties.touching import touching_surfaces

    remedy = "mesh.join = true joins the bodies, " if problem.body.cad is not None else ""
    body, unit = problem.body, problem.body.unit
    pairs = [*touching_surfaces(problem)]
    if not pairs:
        return
    known = [one.surfaces for one in problem.contacts if one.key_of_names != "on"]
    names = sorted({*sum(known, ()), *(name for *pair, _ in pairs for name in pair)})
    own = [body.owned_facets(name) for name in names]
    lost = [[len(np.setdiff1d(one, other)) for other in own] for one in own]
    row = {name: k for k, name in enumerate(names)}
    part = total(body.comm, np.array(lost)) == 0

    def within(inner: Sequence[str], outer: Sequence[str]) -> bool:
        """Each surface is a part of one of others; none: of the whole boundary."""
        return not outer or all(any(part[row[a], row[b]] for b in outer) for a in inner)

    for a, b, area in pairs:
        others = [pair for *pair, _ in pairs if within(pair, (a, b)) and not within((a, b), pair)]
        if others or any(within((a, b), names) for names in known):
            continue
        yield (
            f"the surfaces '{a}' and '{b}' of two bodies touch on "
            f"{unit.length(area, 4, power=body.dim - 1)}, but each "
            f'moves on its own: {remedy}[[tie]] with on = "{a}" and to = "{b}" ties them'
        )


def _percent_notes(case: Case) -> Iterator[str]:
    """Coefficients of friction that may be in percent. Local."""
    for contact in case.contact:
        if (mu := contact.friction) > _PERCENT:
            yield (
                f"contact '{contact.label}': its coefficient of friction is {mu:g}: is it in "
                f"percent? Then it would be {mu / 100:g}"
            )


def contact_notes(case: Case, problem: Problem) -> Iterator[str]:
    """All that is doubtful in contacts, and where there should be one. Collective."""
    yield from _percent_notes(case)
    yield from _name_notes(problem)
    yield from _edge_notes(problem)
    yield from _distance_notes(case, problem)
    yield from _start_notes(case, problem)
    yield from touching_notes(problem)


def _name_notes(problem: Problem) -> Iterator[str]:
    """Contacts of which results have one name, with each other or with a support."""
    labels = [pair.label for pair in problem.contact_pairs]
    supports = {support.label for support in problem.supports}
    for label in dict.fromkeys(labels):
        others = "several contacts" if labels.count(label) > 1 else ""
        if label in supports:
            others = "a contact and a support"
        if others:
            yield (
                f"{others} are called '{label}': results are the sum of both; a `name` for each "
                "tells them apart"
            )


def _edge_notes(problem: Problem) -> Iterator[str]:
    """Round edges of obstacles that faces cannot follow. Collective."""
    mesh, dim, unit = problem.body.mesh, problem.body.dim, problem.body.unit
    for pair in problem.contact_pairs:
        radius = pair.contact.obstacle.edge_radius if pair.contact.between is None else 0.0
        if radius <= 0.0:
            continue
        sizes = facet_areas(mesh, pair.facets) ** (1 / (dim - 1))
        least = smallest(problem.body.comm, float(np.min(sizes, initial=np.inf)))
        if least > _ROUND_FACES * radius:
            yield (
                f"contact '{pair.label}': even its smallest faces, {unit.length(least)}, are long "
                f"for edges of the radius {unit.length(radius)}: the force jumps as the edge "
                f"passes a vertex; faces of {unit.length(radius / 5)} follow it"
            )


def _distance_notes(case: Case, problem: Problem) -> Iterator[str]:
    """Obstacles that the body can never touch, or in which it begins deeply. Collective.

    An obstacle in which the body begins moves it without loads, as in a press fit.  A body that is
    moved reaches no farther than it is large and than its supports move; a body that nothing moves
    stays where it is.

    Args:
        case: Its contacts, and what moves the body.
    """
    if not problem.contact_pairs:
        return
    diagonal, (reach, why), unit = span(problem.body), _reach(case, problem), problem.body.unit
    pressed = False
    written = case.pairs.values()
    for one, (pair, gap, _) in zip(written, _initial_gaps(case, problem), strict=True):
        if pair.contact.push is not None:  # it goes to where it touches, or the run refuses it
            pressed = True
            continue
        later = _gaps_over_time(case, pair)
        nearest = min([*later, gap] if pair.contact.between is None else later)
        pressed |= nearest < -_ROUND_OFF * pair.size
        if np.isposinf(nearest) or nearest > max(reach, _ROUND_OFF * pair.size):
            what = "the obstacle comes" if pair.contact.between is None else "the surfaces come"
            if np.isfinite(nearest):
                yield (
                    f"contact '{pair.label}': it can never touch: {what} no nearer than "
                    f"{unit.length(nearest)}, {why}"
                )
            else:
                yield f"contact '{pair.label}': its surfaces lie nowhere opposite each other"
        elif -gap > diagonal:
            yield (
                f"contact '{pair.label}': it begins {unit.length(-gap)} deep in the obstacle, "
                "more than the body is large"
            )
        fit = pair.contact.interference
        if not isinstance(fit, str) and abs(fit) > _LARGE_FIT * diagonal:
            yield (
                f"contact '{pair.label}': the interference of {unit.length(fit)} is more than a "
                f"tenth of the body, {unit.length(diagonal)}: is its unit right?"
            )
        if text := _coarse_facets(pair, unit) or _other_size(pair, unit, diagonal):
            yield f"contact '{pair.label}': {text}"
        if text := _in_another_unit(unit, one, pair, diagonal):
            yield f"contact '{pair.label}': {text}"
        if (found := _held_along_its_way(case, problem, pair)) is not None:
            when, held = found
            yield f"{when} {held}, which cannot give way: {RELEASE}"
    if not (reach or pressed) and case.dynamics is None and (case.modal is None or case.preloaded):
        yield NOTHING_MOVES


def _start_notes(case: Case, problem: Problem) -> Iterator[str]:
    """Overlaps, and bodies that friction alone supports: right, if they are meant. Collective.

    Args:
        case: In motion, penalty and inertia make other notes of both.
    """
    if case.dynamics is not None and not case.dynamics.preload:
        return
    unit = problem.body.unit
    for pair, gap, place in _initial_gaps(case, problem):
        if pair.contact.push is not None or not gap < -pair.tolerance:
            continue
        begins = f"contact '{pair.label}': it begins {unit.length(-gap)} deep in"
        if pair.contact.between is not None:
            if pair.contact.interference == "resolve" and not -gap <= (pair.contact.adjust or 0.0):
                yield (
                    f"{begins} the other surface, at {unit.point(place)}: this overlap grows in "
                    'the load steps, as in a press fit; interference = "ignore" removes it'
                )
            continue
        outside = -smallest(pair.comm, float(np.min(-pair.gaps()[0], initial=np.inf)))
        where = (
            "with all of its surface: right in a press fit, else its normal points the wrong way"
            if outside < -pair.tolerance
            else "from where the first load step pushes it out"
        )
        if gap >= -pair.size:  # else the run is refused
            yield f"{begins} its obstacle, at {unit.point(place)}, {where}"
    if not problem.terms.dissipates:
        return
    bodies = zip(free_bodies(problem), free_bodies(problem, rubbing=False), strict=True)
    for body, sliding in bodies:
        if sliding.motions and not body.motions:
            name = f"`{body.name}`" if body.name else "the body"
            yield (
                f"friction alone supports {name}, which could else {', '.join(sliding.motions)}: "
                "there is no equilibrium under loads that it cannot carry"
            )


def _held_along_its_way(case: Case, problem: Problem, pair: ContactPair) -> tuple[str, str] | None:
    """When an obstacle pushes into nodes that are held, and that in words. Collective."""
    end, default = _end(case)
    moves = not (pair.at_rest and all(support.at_rest for support in problem.supports))
    earlier = np.linspace(0.0, end, TIMES)[:-1] if moves else ()
    found: tuple[str, str] | None = None
    for t in map(float, (end, *earlier)):
        problem.constraints.set_time(t, default)
        pair.set_time(t, default)
        if (held := pair.conflict(problem.constraints)) is not None:
            at = f"at t = {t:.4g} s" if case.dynamics is not None else f"at load factor {t:.4g}"
            found = "in the end" if t == end else at, held[0]
            break
    problem.constraints.set_time(0.0, default)
    pair.set_time(0.0, default)
    return found


def _reach(case: Case, problem: Problem) -> tuple[float, str]:
    """How far points of the body may move [m], 0 where nothing moves it, and why. Collective."""
    moving = any(not support.at_rest for support in problem.supports)
    loaded = bool(problem.loads) or bool(problem.eigenstrains)
    started = case.dynamics is not None and (
        any(value != 0.0 for value in (*case.dynamics.displacement, *case.dynamics.velocity))
    )
    pushed = len(problem.contact_pairs) > 1 and any(
        c.moves or c.push is not None for c in case.pairs.values()
    )
    if not (moving or loaded or started or pushed or problem.cell is not None):
        return 0.0, "and nothing moves the body"
    if case.dynamics is not None and (loaded or started):  # it may fall, or fly
        return np.inf, ""
    end, default = _end(case)
    times = [end * i / (TIMES - 1) for i in range(TIMES)]
    values = problem.constraints.values_at(times, default)
    local = max((float(np.abs(row).max(initial=0.0)) for row in values), default=0.0)
    far, size, text = largest(problem.body.comm, local), span(problem.body), "the body is large"
    still = case.dynamics is None and not (loaded or pushed) and problem.cell is None
    if still and _LEVER * far < size:
        size, text = (_LEVER - 1) * far, f"its supports move it by {problem.body.unit.length(far)}"
    return size + far, f"farther than {text}"


def _gaps_over_time(case: Case, pair: ContactPair) -> list[float]:
    """Smallest gap of the body at rest as the obstacle moves [m]. Collective."""
    end, default = _end(case)
    if pair.contact.between is not None:  # less what counts as no gap
        pair.set_time(end, default)
        acting = smallest(pair.comm, float(np.min(pair.pressing_gaps(), initial=np.inf)))
        pair.set_time(0.0, default)
        return [acting if acting < FAR / 4 else nearest_spot(pair)[0]]
    x, result = pair.places(), []
    for t in np.linspace(0.0, end, TIMES if pair.contact.moves else 1):
        pose = pair.contact.pose_at(float(t), default, x.shape[1])
        gaps = pair.contact.obstacle.gaps(pair.pose.seen(x - pose[:, 0], pose[:, 1:]))[0]
        result.append(float(np.min(gaps, initial=np.inf)))
    return [smallest(pair.comm, gap) for gap in result]


def _coarse_facets(pair: ContactPair, unit: LengthUnit) -> str:
    """That an obstacle's facets are coarse for the elements that touch it. Collective."""
    mesh = pair.contact.mesh
    if mesh is None or mesh.smooth:
        return ""
    surface = mesh.surface
    beside = surface.near(pair.seen()).feature // FEATURES
    size = largest(pair.comm, surface.coarseness(np.unique(beside)))
    if size <= _COARSE * pair.size:
        return ""
    return (
        f"facets of {mesh.file} are up to {unit.length(size)} long where it is curved, elements "
        f"{unit.length(pair.size)} high: the body follows each facet; a finer file is smoother"
    )


def _other_size(pair: ContactPair, unit: LengthUnit, diagonal: float) -> str:
    """That the sizes of a rigid mesh and of the body differ as units of length do. Local."""
    if (mesh := pair.contact.mesh) is None:
        return ""
    size = mesh.surface.size
    if 1 / _UNLIKE < size / diagonal < _UNLIKE:
        return ""
    return (
        f"{mesh.file} is {unit.length(size)} large, the body {unit.length(diagonal)}: is the file "
        "in another unit? `unit` beside `file` states it"
    )


def _in_another_unit(unit: LengthUnit, written: Contact, pair: ContactPair, diagonal: float) -> str:
    """That an obstacle beside the origin would be near the body in metres. Collective."""
    if written.between is not None:
        return ""
    shape = written.obstacle
    largest_number = max((abs(x) for x in shape.bare_lengths()), default=0.0)
    if not 0.0 < unit.metres * largest_number <= _BESIDE * diagonal or unit.metres >= _SMALL_UNIT:
        return ""
    gaps = shape.in_metres(1.0).gaps(pair.places())[0]
    near = smallest(pair.comm, float(np.min(gaps, initial=np.inf)))
    if abs(near) > _NEAR * diagonal:
        return ""
    there = f"be {unit.length(abs(near))} away" if abs(near) > _ROUND_OFF * pair.size else "touch"
    return (
        f"its numbers are in {unit.name}, as those of the mesh, and beside the origin: are they in "
        f"m? Then it would {there}"
    )


# --- supports over time, initial motion ---


def check_supports(case: Case, problem: Problem) -> None:
    """Evaluates prescribed displacements over the whole analysis. Collective.

    Leaves them as they are at the start.

    Args:
        case: Its end, or that of its load parameter.

    Raises:
        InputError: A formula gives no finite number somewhere.
    """
    if all(support.at_rest for support in problem.supports):
        return
    end, default = _end(case)
    prescribed = problem.constraints
    for t in np.linspace(0.0, end, TIMES):
        prescribed.set_time(float(t), default)
        prescribed.check_finite()
    prescribed.set_time(0.0, default)


def _end(case: Case) -> tuple[float, Amplitude]:
    """Time or load parameter at the end, and the amplitude of what has no curve."""
    if case.dynamics is not None:
        return case.dynamics.end, CONSTANT
    return case.final_load, PROPORTIONAL


def check_curves(case: Case, dim: int) -> None:
    """Evaluates curves, and what moves obstacles and cells, over the whole analysis.

    Not collective.

    Args:
        case: Its end, or that of its load parameter.

    Raises:
        InputError: A formula gives no finite number at some time.
    """
    end, default = _end(case)
    values: dict[str, Callable[[float], object]] = {}
    rows: dict[str, Record] = {f"support[{i}]": row for i, row in enumerate(case.support)}
    rows |= {f"load[{i}]": row for i, row in enumerate(case.load)}
    rows |= {f"contact[{i}]": row for i, row in enumerate(case.contact)}
    for key, row in rows.items():
        curve: Amplitude | None = getattr(row, "curve", None)
        if curve is not None and curve.formula is not None:
            values[f"{key}.curve"] = curve.at
    for key, contact in case.pairs.items():
        values[f"{key}.motion"] = partial(_moved, contact, default, dim)
        values[f"{key}.force"] = partial(contact.force_at, default=default)
        if contact.rotation is not None:
            values[f"{key}.rotation.angle"] = partial(_turned, contact, default, dim)
    if (cell := case.periodic) is not None:
        values["periodic"] = partial(cell.gradient_at, default=default)
    for where, value in values.items():
        _check_at(where, value, [float(t) for t in np.linspace(0.0, end, TIMES)])


def _moved(contact: Contact, default: Amplitude, dim: int, t: float) -> list[float]:
    return contact.displacement_at(t, default, dim)


def _turned(contact: Contact, default: Amplitude, dim: int, t: float) -> object:
    return contact.pose_at(t, default, dim)


def _check_at(where: str, value: Callable[[float], object], times: Sequence[float]) -> None:
    try:
        for t in times:
            value(t)
    except InputError as error:
        expected = error.expected or f"a value at all times from 0 to {times[-1]:g}"
        raise type(error)(error.what, where=where, expected=expected) from None


def start_notes(problem: Problem, settings: DynamicsSettings) -> tuple[str, ...]:
    """Initial conditions that do not fit supports and obstacles. Collective.

    Leaves the body undeformed and at rest.

    Returns:
        Why the scheme is unstable with any step, if it is; incompatible velocities of supports,
        and initial penetrations.

    Raises:
        InputError: A formula is not finite, or the body begins deep in an obstacle.
    """
    from dolfin_elastic.solvers.dynamics.initial_conditions import set_initial

    v, s = fem.Function(problem.V), settings
    incompatible = set_initial(problem, v, s.displacement, s.velocity, s.end)
    if s.preload:
        incompatible = [one for one in incompatible if one.what != "displacement"]
    penetrations = problem.check_start()
    problem.u.x.array[:] = 0.0
    problem.unknowns.u_to_w()
    unstable = [s.stability_limit] if s.stability_limit else []
    return (*unstable, *map(str, incompatible), *penetrations)
