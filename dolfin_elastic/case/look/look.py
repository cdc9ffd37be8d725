"""`look_at`: lists and draws the body of a file or a case."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
from mpi4py import MPI

from dolfin_elastic.case.case import Case, read_case
from dolfin_elastic.case.check.initial_state import mesh_notes, untied_notes
from dolfin_elastic.case.check.integrals import Integrals
from dolfin_elastic.case.check.loads import load_sums
from dolfin_elastic.case.check.sizes import references
from dolfin_elastic.case.described import described
from dolfin_elastic.case.glyphs import glyphs_of
from dolfin_elastic.case.look.faulty import draw_faults
from dolfin_elastic.case.look.listing import Look, listing
from dolfin_elastic.core.errors import DrawingError, InputError, MeshError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.core.shapes.rigid_mesh import RigidMesh
from dolfin_elastic.mesh import Body, read_body
from dolfin_elastic.mesh.formats.surfaces.options import is_surface
from dolfin_elastic.mesh.read import check_file, stated_unit_of
from dolfin_elastic.model.loads.forces import Gravity
from dolfin_elastic.results.scene import series
from dolfin_elastic.results.scene.body import body_scene, patch_colour
from dolfin_elastic.results.scene.obstacles import Reach, obstacles_beside
from dolfin_elastic.results.scene.renderer import RENDERER
from dolfin_elastic.results.scene.scene import Glyphs, Obstacle, Picture, Scene, Up, up_against

_CONTACT = "#b9a8dc"


def look_at(
    path: Path, *, picture: Path | None, trust: bool = False, comm: MPI.Comm = MPI.COMM_WORLD
) -> Look:
    """Lists what a file holds, and draws it. Collective.

    A case that has a fault is listed as far as its body can be read; the fault is a note.

    Args:
        path: A mesh, a CAD file, or a case (.toml).
        picture: The PNG file; None: none is drawn.
        trust: A .geo script may do all that its user may.
        comm: The ranks that share the mesh.

    Raises:
        InputError: The body cannot be read.
        OutputError: The picture cannot be written.
    """
    case = read_case(path, comm=comm, trust=trust) if path.suffix.lower() == ".toml" else None
    try:
        body, notes = _body(path, case, trust, comm)
    except MeshError as error:
        if picture is None:
            raise
        drawn = on_root(comm, lambda: draw_faults(path, case, picture))
        raise drawn or error from None

    def use(name: str, kind: str) -> str:
        return "" if case is None else references(case, body, name, kind)

    glyphs: tuple[Glyphs, ...] = ()
    # Without the names of the case nothing of it has a place.
    placed = case if not notes else None
    notes = (*(body.notes if case is None else mesh_notes(case, body)), *notes)
    if placed is not None:
        try:
            problem = placed.make_problem(body)
            notes = (*notes, *untied_notes(placed, problem))
            integrals = Integrals(problem, placed.metres_thick(body))
            glyphs = glyphs_of(placed, body, load_sums(placed, integrals))
        except InputError as error:
            text = f"the case has a fault, so that loads and supports may be missing: {error}"
            notes = (*notes, text)
    annotated = listing(body, case="" if case is None else case.file, use=use, notes=notes)
    if case is not None:
        annotated = replace(annotated, described=described(case, body))
    if picture is None:
        return annotated
    # Of a plane body regions are drawn; surfaces are its outline.
    named = annotated.surfaces if body.dim == 3 else annotated.regions[1:]
    scene = body_scene(body, [row.name for row in named])
    if scene is not None and placed is not None:
        scene = replace(scene, glyphs=glyphs, obstacles=_obstacles(placed, body, scene))
    legend = tuple((row.name, row.use, patch_colour(i)) for i, row in enumerate(named))
    title, up = annotated.case or body.source, _up(case, body)
    why = on_root(comm, lambda: _why_not_drawn(scene, title, up, legend, picture))
    if why:
        return replace(annotated, notes=(*annotated.notes, f"no picture: {why}"))
    return replace(annotated, picture=str(picture))


def _up(case: Case | None, body: Body) -> Up:
    """What is up, as in the pictures of the case's results."""
    if case is None or body.dim == 2:
        return "z"
    return up_against(g.acceleration(body.dim) for g in case.load if isinstance(g, Gravity))


def _body(
    path: Path, case: Case | None, trust: bool, comm: MPI.Comm
) -> tuple[Body, tuple[str, ...]]:
    """The body with its names, or without those of a case in which one is wrong. Collective."""
    if case is None:
        on_root(comm, lambda: check_file(path))
        if is_surface(path) and on_root(comm, lambda: stated_unit_of(path)) is None:
            return read_body(path, comm=comm, scale=1.0), (on_root(comm, lambda: _in_units(path)),)
        return read_body(path, comm=comm, trust=trust), ()
    try:
        return case.read_body(comm), ()
    except MeshError as error:
        named: InputError = error
    bare = Case.from_dict(
        {
            "mesh": {k: v for k, v in case.to_dict()["mesh"].items() if k != "refine"},
            "materials": case.to_dict()["materials"],
        },
        case.folder,
        file=case.file,
        trust=trust,
    )
    return bare.read_body(comm), (f"without the names of the case: {named}",)


def _in_units(path: Path) -> str:
    from dolfin_elastic.mesh.formats.surfaces.sizes import sizes_in_units

    return (
        "lengths are shown as m, for the file states no unit; the body would have this size with "
        f"unit = {sizes_in_units(path)}"
    )


def _obstacles(case: Case, body: Body, scene: Scene) -> tuple[Obstacle, ...]:
    """As they stand at the start, those that fit the body. On rank 0."""
    reach, result = Reach(), []
    reach.take(scene.points)
    for key, contact in case.pairs.items():
        if contact.between is not None:
            continue
        shape = contact.obstacle.in_metres(body.unit.metres)
        named = f"'{contact.name}'" if contact.name else f"with {', '.join(contact.surfaces)}"
        with suppress(InputError):
            shape.check(body.dim, axisymmetric=case.mesh.geometry == "axisymmetric")
            if isinstance(shape, RigidMesh):
                if shape.key not in body.obstacles:
                    continue
                shape = shape.with_facets(body.obstacles[shape.key])
            result.append((f"{key} {named}", shape, np.zeros(3)))
    return obstacles_beside(result, reach, body.dim, _CONTACT)


def _why_not_drawn(
    scene: Scene | None, title: str, up: Up, legend: tuple[tuple[str, str, str], ...], file: Path
) -> str:
    """Draws a body, a solid from two sides; why it could not be, empty: it was. On rank 0."""
    assert scene is not None
    shown = Picture(scene, "z" if scene.plane else "isometric", up, title=title, legend=legend)
    sides = [shown] if scene.plane else [shown, replace(shown, behind=True)]
    try:
        series.draw_pictures(scene, sides, file)
    except DrawingError as error:
        return str(error)
    finally:
        RENDERER.release(scene)
    return ""
