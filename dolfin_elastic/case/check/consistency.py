"""Whether a case is consistent with itself and with its mesh."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import combinations

import numpy as np

from dolfin_elastic.case.analysis import ANALYSES
from dolfin_elastic.case.case import Case, in_order, locate_errors
from dolfin_elastic.case.check.initial_state import NOTHING_MOVES
from dolfin_elastic.case.check.materials import step_notes
from dolfin_elastic.case.check.plausibility import plausibility_notes
from dolfin_elastic.case.toml import key_parts, key_text
from dolfin_elastic.core.errors import (
    CaseError,
    InputError,
    MeshError,
    all_errors,
    joined,
    keyed,
    nearest,
)
from dolfin_elastic.core.parallel import on_root, total
from dolfin_elastic.core.shapes.directions import check_components
from dolfin_elastic.core.types import BoolArray, IndexArray
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.model.axes import MATERIAL
from dolfin_elastic.model.loads import Load
from dolfin_elastic.model.materials.law import SplitLaw
from dolfin_elastic.model.materials.plasticity import Plastic
from dolfin_elastic.model.supports.displacement import Normal
from dolfin_elastic.model.supports.springs import ResistingSupport
from dolfin_elastic.model.tie import EXPLICIT_TIES, IMPLICIT
from dolfin_elastic.model.values import sized
from dolfin_elastic.problem.coefficients import CoefficientBinder
from dolfin_elastic.problem.material_regions import check_user_energies, volume_modulus
from dolfin_elastic.problem.mesh_fields import check_fields
from dolfin_elastic.problem.problem import placed_axes
from dolfin_elastic.results.components import check_axes
from dolfin_elastic.results.derived.remembered import REMEMBERED, remembers
from dolfin_elastic.results.field import Field
from dolfin_elastic.results.fields import (
    FIBRE_FIELDS,
    check_field_names,
    field_table,
    has_fibre,
)
from dolfin_elastic.solvers.dynamics import settings as dynamics
from dolfin_elastic.solvers.eigen.settings import refuse_stiffness
from dolfin_elastic.solvers.statics import settings as statics


def check(case: Case, body: Body) -> tuple[str, ...]:
    """Checks a case against its mesh. Collective.

    Args:
        body: From `case.read_body`.

    Returns:
        Notes on what is allowed but probably not meant, without those of `run_notes`.

    Raises:
        InputError: All faults, each with file and key, the same on every rank.
    """
    with locate_errors(case.file), in_order(lambda: case.written):
        if found := faults(case, body):
            raise joined(found)
    return (*_notes(case), *plausibility_notes(case, body))


def faults(case: Case, body: Body, wrong: frozenset[str] = frozenset()) -> tuple[InputError, ...]:
    """All faults of a case, without what follows from others. Collective.

    Args:
        wrong: Tables that the case has lost because they are wrong; "" for an unknown one.
    """
    names = _errors_of(_check_names, case, body)
    found = list(names)
    of_names = {where[0] for error in names if (where := key_parts(error.where))}
    for check_case, by_names, needs in _CHECKS:
        if not wrong & {*needs} and not (by_names and of_names & {*needs}):
            found += _errors_of(check_case, case, body)
    return tuple(found)


def _errors_of(
    check_case: Callable[[Case, Body], None], case: Case, body: Body
) -> tuple[InputError, ...]:
    try:
        check_case(case, body)
    except InputError as error:
        return error.each
    return ()


def _check_memory(case: Case, body: Body) -> None:
    """What materials that remember do not allow.

    Raises:
        InputError: An analysis or steps in which no time passes, or a stiffness to choose where
            there is only one.
    """
    memories = [m.law.memory for m in case.materials.values() if m.law.memory is not None]
    timed = any(memory.timed for memory in memories)
    for table, modes in (("modal", case.modal), ("buckling", case.buckling)):
        if modes is not None:
            relaxes = any(memory.fades for memory in memories)
            flows = any(isinstance(m.law, Plastic) for m in case.materials.values())
            refuse_stiffness(modes, table, relaxes=relaxes, flows=flows)
    if not memories:
        return
    if case.dynamics is not None:
        dynamics.refuse_memory(case.dynamics, timed=timed)
    elif case.analysis == "statics":
        statics.refuse_memory(case.statics or statics.StaticsSettings(), timed=timed)


def _check_explicit(case: Case, body: Body) -> None:
    """What an explicit scheme cannot do: a pressure as unknown, quadratic elements.

    The material is checked first: the advice for it names the mesh's `formulation`, which an
    explicit scheme would refuse in turn.

    Raises:
        CaseError: An incompressible material, or quadratic elements.
    """
    if case.dynamics is None or not case.explicit:
        return
    scheme = case.dynamics.scheme
    for name, material in case.materials.items():
        if isinstance(material.law, SplitLaw) and math.isinf(volume_modulus(material.law)):
            raise CaseError(
                f"'{scheme}' solves for displacements only, and an incompressible material needs "
                "a pressure beside them",
                where=f"materials.{key_text(name)}.nu",
                expected='a nu below 0.5, such as 0.49, or dynamics.scheme = "generalized-alpha" '
                'with mesh.formulation = "mixed"',
            )
    if case.tie:
        raise CaseError(EXPLICIT_TIES, where="tie[0]", expected=IMPLICIT)
    if case.degree > 1:
        raise CaseError(
            f"{scheme} has a lumped mass, for linear elements only",
            where="mesh.degree",
            expected="use degree = 1 or generalized-alpha",
        )


# --- names ---


def _check_names(case: Case, body: Body) -> None:
    """Every `on` names a part of the body of the right kind that is not empty. Collective."""
    with all_errors() as attempt:
        for where, name, kinds, rule in _named(case, body):
            with attempt():
                _check_name(where, name, kinds, rule, body)


def _named(case: Case, body: Body) -> Iterator[tuple[str, str, Sequence[str], str]]:
    """Key and name of each part in use, the kinds that it may be of, and that rule in words."""
    for name, material in case.materials.items():
        for where, region in _names(f"materials.{key_text(name)}.on", material.on):
            yield where, region, ("region",), "a material fills regions"
    for i, support in enumerate(case.support):
        for where, name in _names(f"support[{i}].on", support.on):
            kind = "support" if support.kind in ("displacement", "fixed") else support.kind
            rule = f"{_a(kind)} holds {_listed(support.part_kinds)}"
            yield where, name, support.part_kinds, rule
            if isinstance(support, ResistingSupport) and "surface" in body.kinds(name):
                yield where, name, ("surface",), rule
    for i, load in enumerate(case.load):
        kinds = load_kinds(load)
        for where, name in _names(f"load[{i}].on", getattr(load, "on", None)):
            rule = f"{_a(load.kind)} acts on {_listed(kinds)}{_instead(load, name, body)}"
            yield where, name, kinds, rule
    for i, contact in enumerate(case.contact):
        for where, name in _names(
            f"contact[{i}].{contact.key_of_names}", contact.on or contact.surfaces or None
        ):
            yield where, name, ("surface",), "a contact holds surfaces"
    for where, name, rule in _joined_names(case):
        yield where, name, ("surface",), rule
    for k, pair in enumerate(case.periodic.pairs if case.periodic else ()):
        for where, name in _names(f"periodic.pairs[{k}]", pair):
            yield where, name, ("surface",), "surfaces come in pairs"


def _joined_names(case: Case) -> Iterator[tuple[str, str, str]]:
    """Key and name of the surfaces of masses and of both sides of ties, and that rule in words."""
    for i, mass in enumerate(case.mass):
        for where, name in _names(f"mass[{i}].on", mass.on):
            yield where, name, "a mass is mounted on surfaces"
    for i, tie in enumerate(case.tie):
        for key, on in (("on", tie.on), ("to", tie.to)):
            for where, name in _names(f"tie[{i}].{key}", on):
                yield where, name, "a tie joins surfaces"


def load_kinds(load: Load) -> tuple[str, ...]:
    """Kinds of part that a load acts on."""
    return load.part_kinds or (load.domain.kind,)


_FORCES = {"surface": "traction", "edge": "line-force", "point": "point-force"}
"""Kind of part to the kind of a force on it."""


def _instead(load: Load, name: str, body: Body) -> str:
    """Which kind of force acts on a part of another dimension, in words."""
    kinds = [kind for kind in body.kinds(name) if kind in _FORCES]
    if not kinds or load.kind not in (*_FORCES.values(), "pressure"):
        return ""
    return f'; on {_a(kinds[0])} use kind = "{_FORCES[kinds[0]]}"'


def _a(word: str) -> str:
    return f"{'an' if word[0] in 'aeiou' else 'a'} {word}"


def _listed(kinds: Sequence[str]) -> str:
    plural = [f"{kind}s" for kind in kinds]
    return " and ".join([", ".join(plural[:-1]), plural[-1]] if len(plural) > 1 else plural)


def _names(key: str, on: str | Sequence[str] | None) -> Iterator[tuple[str, str]]:
    """The names in an `on`, each after its key."""
    if isinstance(on, str):
        yield key, on
        return
    if on is not None and not on:
        raise CaseError("no name is given", where=key, expected="leave `on` out or name a part")
    for index, name in enumerate(on or ()):
        yield f"{key}[{index}]", name


def _check_name(where: str, name: str, kinds: Sequence[str], rule: str, body: Body) -> None:
    """A part of one of the kinds has the name, is whole and not empty. Collective."""
    try:
        body.check_whole(name)
    except MeshError as error:
        raise error.at(where) from None
    here = [kind for kind in kinds if name in body.parts[kind]]
    if not here and (others := body.kinds(name)):
        raise MeshError(f"'{name}' is {_a(others[0])}", where=where, expected=rule)
    if not here:
        every = {n: part for kind in kinds for n, part in body.parts[kind].items()}
        near = [_suggestion(name, every)] if every or not body.faces else []
        near += [body.faces.alike(name)] if body.faces and "surface" in kinds else []
        raise MeshError(f"there is no {kinds[0]} '{name}'", where=where, expected="; ".join(near))
    if not sum(_count(body, kind, name) for kind in here):
        raise MeshError(
            f"the {here[0]} '{name}' is empty",
            where=where,
            expected="a name that has members, or another selector",
        )
    if len(kinds) == 1:
        _check_area(where, name, body, here[0])


def _check_area(where: str, name: str, body: Body, kind: str = "surface") -> None:
    """A part is more than a set of nodes.

    Raises:
        MeshError: It is a set of nodes that is no surface.
    """
    try:
        body.part(kind, name)
    except MeshError as error:
        raise error.at(where) from None


def _count(body: Body, kind: str, name: str) -> int:
    """Number of entities of a part. Collective."""
    if kind == "surface":
        return body.count(name)
    pick = {"region": body.owned_cells, "edge": body.owned_edges, "point": body.owned_points}
    return int(total(body.comm, len(pick[kind](name))))


def _suggestion(name: str, names: Mapping[str, IndexArray]) -> str:
    return nearest(name, names) if names else "the mesh has none; name one by where it lies"


def _check_components(case: Case, body: Body) -> None:
    """Vectors, axes and obstacles are those of a body of as many dimensions."""
    vectors = [
        (f"support[{i}].{key}", values)
        for i, support in enumerate(case.support)
        for key, values in support.vectors.items()
    ]
    vectors += [
        (f"load[{i}].{key}", values)
        for i, load in enumerate(case.load)
        for key, values in load.vectors.items()
    ]
    if case.dynamics is not None:
        vectors += [
            ("dynamics.initial_displacement", case.dynamics.displacement),
            ("dynamics.initial_velocity", case.dynamics.velocity),
        ]
    turned = case.mesh.geometry == "axisymmetric"
    with all_errors() as attempt:
        for where, values in vectors:
            with attempt():
                check_components(sized(values, body.dim) if values else None, body.dim, where)
        for i, support in enumerate(case.support):
            with attempt(), keyed(f"support[{i}]"):
                support.check_axis(body.dim)
        for i, contact in enumerate(case.contact):
            with attempt(), keyed(f"contact[{i}]"):
                contact.in_metres(body.unit.metres).check(body.dim, axisymmetric=turned)


def _check_mesh_fields(case: Case, body: Body) -> None:
    """Fields that loads and supports take their values from, and their components."""
    uses = [(f"load[{i}].value", load.values) for i, load in enumerate(case.load)]
    for i, support in enumerate(case.support):
        uses += [(f"support[{i}].{key}", values) for key, values in support.vectors.items()]
        if isinstance(support, Normal):
            uses.append((f"support[{i}].displacement", (support.value,)))
        if isinstance(support, ResistingSupport) and support.by_normal:
            uses.append((f"support[{i}].normal", support.coefficients))
    for where, values in uses:
        with keyed(where):
            check_fields(body, values)


def _check_output(case: Case, body: Body) -> None:
    """Points of probes and planes of pictures meet the body. Collective."""
    case.output.check_probes(body)
    case.output.check_clips(body)
    on_root(body.comm, lambda: case.output.check_exports(case.folder))


def _check_field_names(case: Case, body: Body) -> None:
    """Fields that are asked for exist, and can be written, drawn or evaluated there."""
    laws = [material.law for material in case.materials.values()]
    with all_errors() as attempt:
        for i, name in enumerate(case.output.fields or ()):
            with attempt(), keyed(f"output.fields[{i}]"):
                check_field_names([name], body, laws)
        for i, picture in enumerate(case.output.pictures):
            from dolfin_elastic.results.scene.pictures import check_drawable

            for name in picture.fields:
                with attempt(), keyed(f"output.pictures[{i}].field"):
                    check_drawable(name, body, laws)
        for key, probe in case.output.probes.items():
            with attempt(), keyed(f"output.probes.{key_text(key)}.fields"):
                probe.check_fields(body, laws)


def _check_fields(case: Case, body: Body) -> None:
    table = field_table(body, [material.law for material in case.materials.values()])
    fields = [(f"output.fields[{i}]", name) for i, name in enumerate(case.output.fields or ())]
    fields += [
        (f"output.pictures[{i}].field", name)
        for i, p in enumerate(case.output.pictures)
        for name in p.fields
    ]
    fields += [
        (f"output.probes.{key_text(key)}.fields", name)
        for key, probe in case.output.probes.items()
        for name in probe.fields
    ]
    if case.analysis in ("modal", "buckling"):
        _check_mode_pictures(case)
    placed_axes(case.axes, body, case.mesh.geometry)
    for where, name in fields:
        if (field := table.get(name)) is None:
            continue
        with keyed(where):
            check_axes([name], case.axes, table)
        if field.motion and case.dynamics is None:
            raise CaseError(
                f"there is no '{name}' in statics",
                where=where,
                expected="leave it out, or use [dynamics]",
            )
        if field.statics and case.dynamics is not None:
            raise CaseError(
                f"there is no '{name}' in motion",
                where=where,
                expected="history.csv has the reaction of each support",
            )
        _check_field_of_materials(case, where, name, field)


def _check_field_of_materials(case: Case, where: str, name: str, field: Field) -> None:
    """What a field needs of the materials.

    Args:
        where: Dotted key of the case file that asks for the field, for messages.
        name: Of the field, or of its component in local axes.

    Raises:
        CaseError: A material has not got it, or none has.
    """
    laws = [material.law for material in case.materials.values()]
    without_energy = [n for n, m in case.materials.items() if not m.law.has_energy]
    if name == "energy_density" and without_energy:
        raise CaseError(
            f"the law of '{without_energy[0]}' has no strain energy",
            where=where,
            expected="leave the field out",
        )
    component = field.component
    of_law = component is not None and component.axes == MATERIAL
    number = 0 if of_law else FIBRE_FIELDS.get(name)
    if number is not None and not any(has_fibre(law, number) for law in laws):
        raise CaseError(
            f"no material has a {('first', 'second')[number]} direction of fibres",
            where=where,
            expected="leave the field out, or a law with fibres",
        )
    whole = field.whole or name
    if whole in REMEMBERED and not any(remembers(law, whole) for law in laws):
        raise CaseError(
            f"there is no '{whole}': no material yields",
            where=where,
            expected="leave the field out, or a law such as j2",
        )
    if name == "safety_factor" and all(law.allowable is None for law in laws):
        raise CaseError(
            "no material has an allowable stress",
            where=where,
            expected='write for example allowable = "40 MPa" under [materials.NAME]',
        )


def _check_mode_pictures(case: Case) -> None:
    for i, picture in enumerate(case.output.pictures):
        if picture.film:
            raise CaseError(
                "a film shows a motion or a growing load, not modes",
                where=f"output.pictures[{i}].file",
                expected="a picture: each mode has one, and an animation for ParaView",
            )
        if "field" in picture.model_fields_set and picture.fields != ["displacement"]:
            raise _no_field_of_modes(picture.fields[0], f"output.pictures[{i}]")
    for i, one in enumerate(() if case.preloaded else case.output.exports):
        if one.field not in (None, "displacement"):
            raise _no_field_of_modes(one.field, f"output.exports[{i}]")


def _no_field_of_modes(name: str, where: str) -> CaseError:
    return CaseError(
        f"a mode has no '{name}': it has no size of its own",
        where=f"{where}.field",
        expected="leave it out; modes are coloured by their displacement",
    )


# --- materials ---


def _check_energies(case: Case, body: Body) -> None:
    """Energies that users have written pass the checks. Collective."""
    laws = {f"materials.{key_text(name)}": item.law for name, item in case.materials.items()}
    check_user_energies(laws, body.comm)


def _check_materials(case: Case, body: Body) -> None:
    """Every cell has exactly one material. Collective."""
    materials = case.materials
    everywhere = [name for name, material in materials.items() if not material.regions]
    if len(everywhere) > 1:
        raise CaseError(
            f"'{everywhere[0]}' and '{everywhere[1]}' both have no `on`",
            where=f"materials.{key_text(everywhere[1])}",
            expected="only one material can fill what the others leave",
        )
    owned = len(body.owned_cells())
    filled = {
        name: _marked(body, material.regions, owned)
        for name, material in materials.items()
        if material.regions
    }
    for (one, first), (two, second) in combinations(filled.items(), 2):
        if twice := int(total(body.comm, int(np.sum(first & second)))):
            raise CaseError(
                f"{twice} elements are in '{one}' too",
                where=f"materials.{key_text(two)}.on",
                expected="every element needs exactly one material",
            )
    marked = int(np.sum(np.any(list(filled.values()), axis=0))) if filled else 0
    missing = int(total(body.comm, owned - marked))
    if missing and not everywhere:
        raise CaseError(
            f"{missing} of {body.num_cells} elements have no material",
            where="materials",
            expected="a material without `on` fills what the others leave",
        )


def _marked(body: Body, regions: Sequence[str], owned: int) -> BoolArray:
    """Which of the owned cells lie in regions, shape (owned cells,). Local."""
    marks = np.zeros(owned, dtype=bool)
    for name in regions:
        marks[body.owned_cells(name)] = True
    return marks


def _check_densities(case: Case, body: Body) -> None:
    """Every material has a density where inertia or weight of the whole body needs one."""
    weights = (
        f"load[{i}] ({load.kind})"
        for i, load in enumerate(case.load)
        if load.needs_density and not load.parts
    )
    reason = next(weights, "")
    if case.analysis in ("dynamics", "modal"):
        reason = f"[{case.analysis}]"
    for name, material in case.materials.items():
        if reason and material.law.density is None:
            raise CaseError(
                "this key is missing",
                where=f"materials.{key_text(name)}.density",
                expected=f'{reason} needs it, for example "1100 kg/m^3"',
            )


def _check_constants(case: Case, body: Body) -> None:
    """Evaluates constants that vary in space in all cells where they are used. Collective.

    Raises:
        InputError: A value is out of range, or a field of the mesh is missing.
    """
    binder = CoefficientBinder(body, max(case.degree, int(body.mesh.geometry.cmap.degree)))
    owned = len(body.owned_cells())
    filled = [_marked(body, material.regions, owned) for material in case.materials.values()]
    unnamed = ~np.any(filled, axis=0)
    for (name, material), marks in zip(case.materials.items(), filled, strict=True):
        if material.law.spatial_constants():
            cells = np.flatnonzero(marks if material.regions else unnamed).astype(np.int32)
            binder.values(material.law, cells, f"materials.{key_text(name)}")


_ANALYSIS = ("", *ANALYSES)
_CHECKS: tuple[tuple[Callable[[Case, Body], None], bool, tuple[str, ...]], ...] = (
    (_check_components, False, ()),
    (_check_mesh_fields, False, ("fields",)),
    (_check_densities, False, ("materials", *_ANALYSIS)),
    (_check_field_names, False, ("fields",)),
    (_check_fields, False, ("fields", "materials", "axes", "output", *_ANALYSIS)),
    (_check_materials, True, ("", "materials", "regions")),
    (_check_energies, True, ("materials",)),
    (_check_constants, True, ("fields", "materials", "regions")),
    (_check_output, True, ("output",)),
    (_check_memory, True, ("materials", "periodic", *_ANALYSIS)),
    (_check_explicit, True, ("materials", *_ANALYSIS)),
)
"""Checks after that of the names, whether a wrong name touches them, and what they need."""


# --- notes ---


def run_notes(case: Case) -> Iterator[str]:
    """Notes that `Problem` and the solvers log themselves, also of problems made in Python."""
    for name, material in case.materials.items():
        if material.law.warning:
            yield f"materials.{key_text(name)}: {material.law.warning}"
    for i, support in enumerate(case.support):
        if support.kind == "dashpot" and (rate_free := _rate_free(case)):
            yield f"support[{i}]: a dashpot does nothing in {rate_free}"


def _rate_free(case: Case) -> str:
    """The analysis, if there are no velocities in it; empty in motion."""
    if case.dynamics is not None:
        return ""
    return f"[{case.analysis}]" if case.modal or case.buckling else "statics"


def _yielding_preload(case: Case, name: str, law: Plastic, stiffness: str) -> Iterator[str]:
    """What becomes of a metal that yields under the preload of modes."""
    if law.timed:
        yield (
            f"materials.{name}.plastic_viscosity: no time passes in the preload of "
            f"[{case.analysis}]: nothing yields, as under a sudden load"
        )
    elif stiffness != "elastic":
        yield (
            f"materials.{name}: a preload under which it yields is refused, unless "
            f'{case.analysis}.stiffness = "elastic" takes its stiffness of unloading'
        )


def _notes(case: Case) -> Iterator[str]:
    """Keys without effect in the case's analysis."""
    for name, material in case.materials.items():
        if isinstance(material.law, Plastic) and case.degree == 1:
            yield (
                f"materials.{key_text(name)}: linear elements lock where the material yields, and "
                "limit loads are up to a third too high: mesh.degree = 2 does not"
            )
        if material.law.viscosity is not None and (rate_free := _rate_free(case)):
            yield f"materials.{key_text(name)}: viscosity does nothing in {rate_free}"
        memory = material.law.memory
        modes = case.modal or case.buckling
        chosen = modes is not None and "stiffness" in modes.model_fields_set
        relaxes = memory is not None and memory.timed and not isinstance(material.law, Plastic)
        if relaxes and case.gives_modes and not chosen:
            key = "viscous" if material.law.viscous else "history"
            yield (
                f"materials.{key_text(name)}.{key}: nothing relaxes in [{case.analysis}]: the "
                "stiffness is that of a sudden load"
            )
        if isinstance(material.law, Plastic) and modes is not None and modes.preload:
            yield from _yielding_preload(case, key_text(name), material.law, modes.stiffness)
    yield from step_notes(case)
    if case.analysis != "dynamics" and case.whole.dynamics is not None:
        for key in ("load", "support"):
            for i, row in enumerate(getattr(case, key)):
                if getattr(row, "curve", None) is not None:
                    yield (
                        f"{key}[{i}].curve: its t is the load factor in [{case.analysis}], and the "
                        "time in seconds in [dynamics]"
                    )
    moving = any(not support.at_rest for support in case.support)
    moving = moving or any(value != 0.0 for c in case.pairs.values() for value in c.values)
    if case.modal is not None and not case.preloaded:
        small = all(material.law.linear for material in case.materials.values())
        if (case.load or moving) and not small:  # a preload changes nothing there
            yield "modal.preload is not set: the modes are those at rest, without the loads"
        return
    unloaded = case.dynamics is None and not case.load and not moving
    if unloaded and case.periodic is None and not case.contact:  # see `contact_notes`
        yield NOTHING_MOVES
