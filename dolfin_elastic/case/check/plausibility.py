"""Plausibility of what a case says: forgotten units, loads and supports without effect.

Nothing but the case and the mesh is needed, so a run warns of the same.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from itertools import combinations, product

import numpy as np

from dolfin_elastic.case.case import Case
from dolfin_elastic.case.toml import key_text
from dolfin_elastic.core.errors import FormulaError, dotted
from dolfin_elastic.core.formula import Formula
from dolfin_elastic.core.parallel import first_of, total
from dolfin_elastic.core.shapes.box import Box
from dolfin_elastic.core.si_text import listed, quantity
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.core.units import MeshLength, metres, to_si
from dolfin_elastic.mesh.body import Body, cell_size, extent, mean_thickness
from dolfin_elastic.mesh.criteria import BoundingBox, bounding_box
from dolfin_elastic.mesh.geometry.simplices import facet_nodes, outward_normals, prepare_facets
from dolfin_elastic.mesh.point_selection import vertices_of
from dolfin_elastic.model.amplitude import CONSTANT, PROPORTIONAL, Amplitude
from dolfin_elastic.model.loads import Load
from dolfin_elastic.model.loads.remote import RemoteForce
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.materials.plasticity import Plastic
from dolfin_elastic.model.records import RATES, RecordFormula
from dolfin_elastic.model.strength import Strength
from dolfin_elastic.model.supports.displacement import (
    NORMAL,
    Normal,
    PrescribingSupport,
    Restraint,
    Rotation,
)
from dolfin_elastic.model.supports.rigid_surface import Rigid
from dolfin_elastic.model.values import Component, amplitude_of, depends_on_time
from dolfin_elastic.problem.material_regions import poisson, young

_LONG, _SHORT = 1e3, 1e-6
"""Lengths of a body [m] beyond which mesh.unit looks wrong."""
_UNITLESS = 20.0
"""Length [m] from which a mesh without a unit looks like one in millimetres."""
_FAR = 10.0
"""Lengths of the body that a moving support or obstacle may go in motion: it may carry the body."""
_DRIFT = 0.01
"""Velocity of a base after a record, over the largest, from which it drifts."""
_STEPPED_OVER = 1.5
"""Time steps over the time between a record's rows from which peaks are missed."""
_TIMES = 101
"""Times at which prescribed motions are evaluated."""
_THICK = re.compile(
    r"yield: (?P<standard>[^;]*), up to (?P<limit>[\d.]+ mm)(?: \((?P<more>[^)]*)\))?"
)
"""Up to which thickness a yield stress holds, in the source of a material."""
_STRONG = 1e-6
"""Least strength over Young's modulus: of concrete in tension it is 1e-4."""
_DENSITIES = 1.0, 30e3
"""Foams are above, osmium is below [kg/m^3]."""
_FAST = 25e3
"""Speed of longitudinal waves in a bar, sqrt(E/rho), that no solid reaches [m/s]; diamond: 17e3.

Not that of bulk waves, sqrt((K + 4/3 mu)/rho), which is unbounded in an incompressible rubber.
"""
_GRAM_PER_CM3 = 1000.0
"""[kg/m^3]"""
_LIGHTEST = 5.0
"""Density below that of foams that carry a load [kg/m^3]; melamine foam and polystyrene: 8."""
_COMPACT = 0.45, 100.0
"""Poisson's ratio above that of foams, and a density that no solid without pores has [kg/m^3]."""
_HEAVIEST = 23.0
"""Density of the heaviest solid, osmium [g/cm^3]."""
_SOFT = 1e3
"""Young's modulus [Pa] below which a case may be in numbers without dimensions."""
_NEAR = 0.01
"""Distance over the body's diagonal up to which a point counts as in the body."""
_REMOTE = 10.0
"""Distance of the point of a remote force from the body, over its size, that is a slip."""
_SMALL_UNIT = 0.1
"""Longest unit of a mesh [m] for which a place may have been meant in metres."""
_BESIDE = 0.1
"""Distance over the size of the cells from which a point is not at its place."""
_BARE_ANGLE = 1.0
"""Number without a unit [rad] from which it was probably meant in degrees."""
_THERMAL_STRAIN = 1.0
"""Thermal strain that no solid survives."""


def plausibility_notes(case: Case, body: Body) -> Iterator[str]:
    """Values that are possible but unlikely, in the order of the functions below. Collective.

    Args:
        case: Consistent with the body, see `consistency.check`.
        body: Its mesh, with all names.
    """
    yield from size_notes(case, body)
    yield from _mesh_place_notes(case, body)
    yield from _distance_notes(case, body)
    yield from _angle_notes(case)
    yield from _material_notes(case, body)
    yield from _thickness_notes(case, body)
    yield from _growth_notes(case)
    yield from _record_notes(case)
    yield from _loads_on_supports(case, body)
    yield from _contradictions(case, body)
    yield from _singular_supports(case, body)


# --- lengths ---


def unit_information(case: Case, body: Body) -> tuple[str, ...]:
    """What the lengths of a mesh file are taken in where nothing says it. Local.

    Args:
        case: Its unit of length.
    """
    if case.mesh.file is None or case.mesh.unit is not None or body.unit.stated:
        return ()
    return (f"lengths in {body.unit.name}: neither the file nor mesh.unit says what they are in",)


def size_notes(case: Case, body: Body) -> Iterator[str]:
    """Bodies that are very large, very small, or displaced by more than their size. Collective."""
    longest = max(extent(body))
    if longest > _LONG or longest < _SHORT:
        what = f"{longest:.3g} m" + (" long" if longest > _LONG else " at most")
        yield f"the body is {what}: is mesh.unit what the mesh is in?"
    elif longest > _UNITLESS and case.mesh.unit is None and not body.unit.stated:
        yield f"the body is {longest:.3g} m long, and no mesh.unit is given: is the mesh in mm?"
    corners = np.array([*product(*zip(*bounding_box(body.mesh), strict=True))])
    for key, values, curve in _prescribed_motions(case):
        moved = max((_farthest(case, value, curve, corners) for value in values), default=0.0)
        far = _FAR if case.dynamics is not None and _changes(values, curve) else 1.0
        if moved > far * longest:
            yield (
                f"{key}: {body.unit.length(moved)} is more than the body is long "
                f"({body.unit.length(longest)}): is a unit missing?"
            )


def _record_notes(case: Case) -> Iterator[str]:
    """Bases that drift at the end of a record, and time steps that pass over its rows. Local."""
    for i, support in enumerate(case.support):
        for key, values in support.vectors.items():
            for axis, value in zip("xyz", values, strict=False):
                if isinstance(value, RecordFormula) and value.integrals == len(RATES) - 1:
                    speed, place = value.drift
                    if abs(speed) > _DRIFT * value.fastest:
                        yield (
                            f"support[{i}].{key}: the {value.text} ends with a velocity of "
                            f"{speed:.3g} m/s along {axis}, displaced by {place:.3g} m, and the "
                            "base drifts on: does it need a baseline correction?"
                        )
    step = None if case.dynamics is None else case.dynamics.dt
    tables = [load.values for load in case.load]
    tables += [values for support in case.support for values in support.vectors.values()]
    records = {v.text: v for values in tables for v in values if isinstance(v, RecordFormula)}
    for value in records.values():
        if step is not None and step > _STEPPED_OVER * value.spacing:
            yield (
                f"dynamics.dt is {step:.3g} s, but the rows of the {value.text} are "
                f"{value.spacing:.3g} s apart: peaks between the steps are missed"
            )


def _prescribed_motions(
    case: Case,
) -> Iterator[tuple[str, tuple[Component, ...], Amplitude | None]]:
    """Keys of displacements of supports and obstacles [m], their values and curves."""
    for i, support in enumerate(case.support):
        values = support.vectors.get("displacement", ())
        if isinstance(support, Normal):
            values = (support.value,)
        yield f"support[{i}].displacement", values, getattr(support, "curve", None)
    for key, contact in case.pairs.items():
        yield f"{key}.motion", contact.values, contact.curve


def _changes(values: tuple[Component, ...], curve: Amplitude | None) -> bool:
    """Whether a body in motion may be meant to be carried along: what moves depends on time."""
    return depends_on_time(values) or curve not in (None, CONSTANT)


def _farthest(case: Case, value: Component, curve: Amplitude | None, corners: FloatArray) -> float:
    """Largest size of a component within the analysis, at the corners of the body [m].

    What has no value somewhere is left out: other checks tell of it.

    Args:
        curve: Its amplitude, if it has one.
        corners: Of the bounding box [m], shape (n, dim).
    """
    end = case.final_load if case.dynamics is None else case.dynamics.end
    amplitude = amplitude_of(value, curve) or CONSTANT
    times = sorted({*np.linspace(0.0, end, _TIMES), *(t for t in amplitude.breakpoints if t < end)})
    coordinates = {"z": np.zeros(len(corners)), **dict(zip("xyz", corners.T, strict=False))}
    result = 0.0
    for t in times:
        try:
            size = _size(value)
            if isinstance(value, Formula):
                size = float(
                    np.max(np.abs(np.nan_to_num(value.evaluate(t=t, **coordinates), posinf=0)))
                )
            result = max(result, abs(amplitude.at(float(t))) * size)
        except FormulaError:
            continue
    return result


def _size(value: Component) -> float:
    return abs(value) if isinstance(value, int | float) else 0.0


def _mesh_place_notes(case: Case, body: Body) -> Iterator[str]:
    """Places that seem to be in another unit. Collective.

    Those of remote forces lie far away, or would do so less in metres.

    A place in the mesh's unit is taken as it stands; one of numbers in metres is then so near the
    origin that it is found in a body with a corner there, and says something else.
    """
    around, remote = (
        Box(*bounding_box(body.mesh)),
        {f"load[{i}].point" for i, load in enumerate(case.load) if isinstance(load, RemoteForce)},
    )
    for key, place in _mesh_places(case):
        if len(place) != body.dim:
            continue
        there = np.array([metres(x, body.unit.metres) for x in place])
        away = float(around.outside(there)) / around.diagonal
        if key in remote and away > _REMOTE:
            yield (
                f"{key}: {body.unit.point(there)} is {away:.3g} sizes of the body away from it: is "
                f"it in another unit? Numbers are in {body.unit.name}"
            )
        if body.unit.metres > _SMALL_UNIT or any(isinstance(x, str) for x in place):
            continue
        point = np.array([float(x) for x in place])
        near = _REMOTE if key in remote else _NEAR
        if point.any() and around.outside(point) <= near * around.diagonal:
            shown, unit = ", ".join(f"{x:.4g}" for x in point), body.unit.name
            yield f"{key}: ({shown}) {unit} is beside the origin: is it in m? Numbers are in {unit}"


def _mesh_places(case: Case) -> Iterator[tuple[str, Sequence[MeshLength]]]:
    """Keys of places whose bare numbers are in the mesh's unit, and where nothing else is off."""
    for name, choices in case.points.items():
        for choice in choices:
            if choice.nearest is not None:
                yield f"points.{key_text(name)}.nearest", choice.nearest
    for name, probe in case.output.probes.items():
        if probe.at is not None:
            yield f"output.probes.{key_text(name)}", probe.at
    for key in ("support", "load"):
        for i, row in enumerate(getattr(case, key)):
            places = {k: v for k, v in row.given_lengths().items() if isinstance(v, tuple)}
            yield from ((f"{key}[{i}].{name}", place) for name, place in places.items())


def _distance_notes(case: Case, body: Body) -> Iterator[str]:
    """Points that are nearest to a place, and yet some way from it. Collective."""
    limit, unit = _BESIDE * cell_size(body), body.unit
    for name, choices in case.points.items():
        if len(choices) != 1 or choices[0].nearest is None or choices[0].tolerance is not None:
            continue
        place = BoundingBox.of(body, unit.metres).point(choices[0].nearest, "nearest")
        x = body.mesh.geometry.x[body.owned_points(name), : body.dim]
        first = first_of(body.comm, [tuple(map(float, row)) for row in x])
        assert first is not None
        distance = float(np.linalg.norm(np.array(first) - place))
        if distance > limit:
            exact = (x if abs(x) > 1e-9 * limit else 0.0 for x in first)  # round-off of the mesh
            shown = ", ".join(f"{x / unit.metres:.4g}" for x in exact)
            yield (
                f"points.{key_text(name)}: the nearest vertex is ({shown}) {unit.name}, "
                f"{distance / unit.metres:.3g} {unit.name} from these coordinates: a finer mesh "
                "has a "
                "nearer one"
            )


# --- growth in time ---


def _growth_notes(case: Case) -> Iterator[str]:
    """What grows with the load parameter where that is a time of many seconds."""
    end = case.final_load
    if case.dynamics is not None or not case.timed or end <= 1.0:
        return
    keys = [f"support[{i}]" for i, support in enumerate(case.support) if support.proportional]
    keys += [f"load[{i}]" for i, load in enumerate(case.load) if load.amplitude is None]
    for key, contact in case.pairs.items():
        if any(v != 0.0 and amplitude_of(v, contact.curve) is None for v in contact.moves):
            keys.append(key)
    if keys:
        yield (
            f"{listed(keys)}: numbers without a curve are multiplied by the time in seconds, at "
            f"the end by {end:g}: was that meant?"
        )


# --- angles ---


def _angle_notes(case: Case) -> Iterator[str]:
    """Rotations of more than a turn, and of more than a radian beside a law of small strains."""
    small = any(material.law.linear for material in case.materials.values())
    for i, support in enumerate(case.support):
        for key, written, angle in _angles(support):
            where, turned = f"support[{i}].{key}", math.degrees(angle)
            if angle > math.tau:
                yield f"{where}: {turned:.4g} degrees are more than a full turn: is a unit missing?"
            elif angle > _BARE_ANGLE and small and isinstance(written, int | float):
                yield (
                    f"{where}: a bare {written} is in rad, {turned:.4g} degrees, and a law is for "
                    "small rotations: is a unit missing?"
                )


def _angles(support: Restraint) -> Iterator[tuple[str, object, float]]:
    """Key, value as written, and angle [rad] of each rotation that a support prescribes."""
    if isinstance(support, Rotation):
        yield "angle", support.angle, _size(support.rotation_angle)
    elif isinstance(support, Rigid):
        written = support.rotation
        rows = written if isinstance(written, list | tuple) else [written]
        for i, (text, value) in enumerate(zip(rows, support.rotation_components, strict=False)):
            yield f"rotation[{i}]" if len(rows) > 1 else "rotation", text, _size(value)


# --- materials ---


def _material_notes(case: Case, body: Body) -> Iterator[str]:
    """Densities, thermal strains, and materials without cells. Collective."""
    for name, material in case.materials.items():
        where = f"materials.{key_text(name)}"
        yield from _density_notes(where, material.law)
        yield from _allowable_notes(where, material.law)
        if not material.regions and not _unnamed_cells(case, body):
            yield f"{where} fills no element: the others leave none"
        for i, load in enumerate(case.load):
            strain = _thermal_strain(load, material.law.expansion)
            if strain > _THERMAL_STRAIN:
                yield (
                    f"load[{i}].value: it makes '{name}' {strain:.3g} times as long again: is a "
                    f"unit of it or of {where}.expansion missing?"
                )


def _allowable_notes(where: str, law: Law) -> Iterator[str]:
    """A strength of less than a millionth of the stiffness, as of a bare number meant in MPa."""
    if law.spatial_constants():
        return
    given = law.allowable.stresses() if isinstance(law.allowable, Strength) else {"": law.allowable}
    strengths = {dotted(f"{where}.allowable", key): value for key, value in given.items()}
    if isinstance(law, Plastic):
        key = "yield" if law.yield_stress is not None else "hardening"
        strengths[f"{where}.{key}"] = law.first_yield
    for key, allowable in strengths.items():
        if allowable is None:
            continue
        if allowable < _STRONG * (modulus := young(law)) and modulus > _SOFT:
            meant = f'did you mean "{allowable:.4g} MPa"?'
            if 1e6 * allowable > modulus:
                meant = "is a unit missing or wrong?"
            yield (
                f"{key}: {allowable:.4g} Pa beside a Young's modulus "
                f"of {quantity(modulus, 'Pa')}: {meant}"
            )


def _thickness_notes(case: Case, body: Body) -> Iterator[str]:
    """A yield stress of plates that are thinner than the part. Collective.

    Modes and buckling loads are compared with no yield stress.  The limit stands in the source of
    the value.  The mean thickness is at most the largest one, so that thin parts give no note,
    however they are bent; of several materials it is not known.
    """
    if case.gives_modes or body.dim < 3 or len(case.materials) > 1:
        return
    for name, material in case.materials.items():
        credit, found = material.source.partition(":")[0], _THICK.search(material.source)
        if found is None or "allowable" in credit or material.law.allowable is None:
            continue
        thick = mean_thickness(body)
        if thick > to_si(found["limit"], "m"):
            yield (
                f"materials.{key_text(name)}.allowable: the yield stress of {found['standard']} is "
                f"that of thicknesses up to {found['limit']}, and the part is about "
                f"{body.unit.length(thick)} thick (twice its volume over its surface): "
                f"{found['more'] or 'give that of this thickness'}"
            )


def _density_notes(where: str, law: Law) -> Iterator[str]:
    """A density that no solid has, or no solid of this stiffness: by the speed of waves."""
    (low, high), rho = _DENSITIES, law.density
    if not isinstance(rho, int | float):
        return
    if not low <= rho <= high:
        meant = "is a unit missing or wrong?"
        if 0.1 * low <= rho < low:
            meant = f'is it "{rho:.4g} g/cm^3"?'
        yield (
            f"{where}.density: {rho:.3g} kg/m^3 is "
            f"{'less than a gas' if rho < low else 'more than any metal'} weighs: {meant}"
        )
        return
    if law.spatial_constants():  # constants that vary in space have no value before they are bound
        return
    modulus = young(law)
    if modulus > _FAST**2 * rho:
        speed = math.sqrt(modulus / rho)
        fits = _GRAM_PER_CM3 * rho <= high and speed < _FAST * math.sqrt(_GRAM_PER_CM3)
        wanted = f'is it "{rho:.4g} g/cm^3"?' if fits else "is a unit of one of them wrong?"
        yield (
            f"{where}.density: {rho:.4g} kg/m^3 with a Young's modulus of "
            f"{quantity(modulus, 'Pa')} has "
            f"waves of {speed / 1e3:.3g} km/s, faster than in any solid (diamond: 17): {wanted}"
        )
    elif modulus > _SOFT:
        # Soft solids such as rubber, too soft for waves to tell.  Foams have pores, which no solid
        # has that keeps its volume.
        (least, compact), nu = _COMPACT, poisson(law)
        if rho < _LIGHTEST:
            yield (
                f"{where}.density: {rho:.4g} kg/m^3 is less than any foam weighs: is it "
                f'"{rho:.4g} g/cm^3"?'
            )
        elif rho < compact and nu > least:
            yield (
                f"{where}.density: {rho:.4g} kg/m^3 is less than any solid without pores weighs "
                f"(Poisson's ratio {nu:.4g}): "
                + (f'is it "{rho:.4g} g/cm^3"?' if rho < _HEAVIEST else "is a unit wrong?")
            )


def _unnamed_cells(case: Case, body: Body) -> int:
    """Number of cells in no region that a material names. Collective."""
    marks = np.ones(len(body.owned_cells()), dtype=bool)
    for material in case.materials.values():
        for name in material.regions:
            marks[body.owned_cells(name)] = False
    return int(total(body.comm, int(np.count_nonzero(marks))))


def _thermal_strain(load: Load, expansion: object) -> float:
    """Strain by a change of temperature, where both are numbers."""
    if load.kind != "thermal" or not isinstance(expansion, int | float):
        return 0.0
    return abs(expansion) * max(map(_size, load.values), default=0.0)


# --- supports ---


def _loads_on_supports(case: Case, body: Body) -> Iterator[str]:
    """Loads on surfaces where all displacements are prescribed. Collective."""
    names = [name for s in case.support if _prescribes_all(s, body.dim) for name in s.surfaces]
    empty = np.empty(0, dtype=np.int32)
    held = [body.surfaces[name] for name in names if name in body.surfaces]
    prescribed = np.concatenate([empty, *held])
    for i, load in enumerate(case.load):
        covered = body.surfaces.keys() - body.uncovered.keys()
        if load.domain.kind != "surface" or not set(load.parts) <= covered:
            continue
        facets = np.concatenate([body.owned_facets(name) for name in load.parts])
        free = np.count_nonzero(~np.isin(facets, prescribed))
        if not total(body.comm, int(free)):
            yield (
                f"load[{i}] ({load.kind}) acts on '{', '.join(load.parts)}', where supports "
                "prescribe the displacement: it changes nothing but the reaction"
            )


def _singular_supports(case: Case, body: Body) -> Iterator[str]:
    """Displacements prescribed on edges and points, where the force has no area.

    The stress at the distance r of a force on a line goes as 1/r, of a force at a point of a solid
    as 1/r^2.  Source: Timoshenko & Goodier, Theory of Elasticity (1970), sections 36 and 138.
    """
    result: dict[str, str] = {}
    for i, support in enumerate(case.support):
        if not isinstance(support, PrescribingSupport):
            continue
        for name in support.surfaces:
            kinds = [kind for kind in body.kinds(name) if kind != "region"]
            if "surface" in kinds and name not in body.uncovered:
                continue
            what = "edge" if kinds[0] == "edge" else "point" if kinds == ["point"] else "nodes"
            result.setdefault(name, f"the {what} '{name}' (support[{i}])")
    if result:
        plural = len(result) > 1 or next(iter(result.values())).startswith("the nodes")
        yield (
            f"{', '.join(result.values())} {'are' if plural else 'is'} fixed: the reaction there "
            "is "
            "exact, but the stress beside is singular, growing with every refinement, unless it "
            "is zero"
        )


def _prescribes_all(support: Restraint, dim: int) -> bool:
    return isinstance(support, PrescribingSupport) and support.prescribed_components(dim) == tuple(
        range(dim)
    )


def _contradictions(case: Case, body: Body) -> Iterator[str]:
    """Supports that prescribe different values for one component at one vertex. Collective."""
    supports = [
        (i, support, _vertices(body, support))
        for i, support in enumerate(case.support)
        if isinstance(support, PrescribingSupport)
        and NORMAL not in support.prescribed_components(body.dim)
    ]
    yield from _contradictions_along_normals(case, body)
    for (i, one, first), (j, two, second) in combinations(supports, 2):
        shared = np.intersect1d(first, second)
        differs = np.zeros(len(shared), dtype=bool)
        tolerance = 1e-9 * max(extent(body))
        for k in {*one.prescribed_components(body.dim)} & {*two.prescribed_components(body.dim)}:
            a, b = (_final_value(case, body, s, k, shared) for s in (one, two))
            differs |= np.abs(a - b) > tolerance
        yield from _told_of_both(body, i, j, shared[differs])


def _contradictions_along_normals(case: Case, body: Body) -> Iterator[str]:
    """Displacements that move nodes along a normal that another support prescribes. Collective.

    Of curved surfaces facets are compared, whose normals are not those of the nodes: only what
    moves along the normal more than across it counts there.
    """
    dim = body.dim
    along = [
        (i, one)
        for i, one in enumerate(case.support)
        if isinstance(one, PrescribingSupport) and NORMAL in one.prescribed_components(dim)
    ]
    others = [
        (j, two, _vertices(body, two))
        for j, two in enumerate(case.support)
        if isinstance(two, PrescribingSupport) and NORMAL not in two.prescribed_components(dim)
    ]
    if not (along and others):  # normals take long in large meshes
        return
    prepare_facets(body.mesh)
    for i, one in along:
        facets = np.unique(np.concatenate([body.surfaces[name] for name in one.surfaces]))
        facets = facets.astype(np.int32)
        nodes, normals = facet_nodes(body.mesh, facets), outward_normals(body.mesh, facets)
        normals = np.repeat(normals, nodes.shape[1], axis=0)
        flat = _are_parallel(body, normals)
        for j, two, held in others:
            here = np.isin(nodes.ravel(), held)
            at, n = nodes.ravel()[here], normals[here]
            u, known = np.zeros((len(at), dim)), np.zeros(dim, dtype=bool)
            for k in two.prescribed_components(dim):
                u[:, k], known[k] = _final_value(case, body, two, k, at), True
            off = np.abs(np.sum(u * n, axis=1) - _final_value(case, body, one, NORMAL, at))
            off[np.abs(n[:, ~known]).max(axis=1, initial=0.0) > 1e-9] = 0.0  # free along n
            least = 1e-9 * max(extent(body))
            across = 0.0 if flat else 0.5 * np.linalg.norm(u, axis=1)
            yield from _told_of_both(
                body, min(i, j), max(i, j), np.unique(at[off > least + across])
            )


def _are_parallel(body: Body, normals: FloatArray) -> bool:
    """Whether all of some unit normals are the same. Collective."""
    mean = total(body.comm, normals.sum(axis=0))
    mean = mean / max(float(np.linalg.norm(mean)), 1e-300)
    return not total(body.comm, int(np.count_nonzero(normals @ mean < 1 - 1e-9)))


def _told_of_both(body: Body, i: int, j: int, nodes: IndexArray) -> Iterator[str]:
    """That two supports differ at some nodes, if they do on any rank. Collective.

    Args:
        nodes: Local nodes of the geometry, ghosts too.
    """
    owned = nodes[nodes < body.mesh.geometry.index_map().size_local]
    if count := int(total(body.comm, len(owned))):
        yield (
            f"support[{i}] and support[{j}] prescribe different displacements at "
            f"{count} corner{'s' if count > 1 else ''} of elements that both hold: the later one "
            "counts"
        )


def _final_value(
    case: Case, body: Body, support: PrescribingSupport, component: int, nodes: IndexArray
) -> FloatArray:
    """Displacement that a support prescribes at the end of the analysis, shape (nodes,) [m]."""
    motion = case.dynamics
    t, default = (case.final_load, PROPORTIONAL) if motion is None else (motion.end, CONSTANT)
    x = np.asarray(body.mesh.geometry.x[nodes])
    value = support.in_metres(body.unit.metres).at(component, x, t, default)
    return np.asarray(np.broadcast_to(value, len(x)))


def _vertices(body: Body, support: Restraint) -> IndexArray:
    """Local vertices of a support's parts, as nodes of the geometry. Collective."""
    result = [np.flatnonzero(vertices_of(body, name)) for name in support.surfaces]
    return np.unique(np.concatenate(result)).astype(np.int32)
