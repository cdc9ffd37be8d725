"""`look_at`: lists and draws the body of a file or a case."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from mpi4py import MPI

from dolfin_elastic.case.case import Case, read_case
from dolfin_elastic.case.check.sizes import references
from dolfin_elastic.case.described import described
from dolfin_elastic.case.look.listing import Look, listing
from dolfin_elastic.case.look.scene import Drawn, drawn_of
from dolfin_elastic.core.errors import DrawingError, InputError, MeshError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.mesh import Body, read_body
from dolfin_elastic.model.loads.forces import Gravity
from dolfin_elastic.results.scene.body import Scene, gather_scene
from dolfin_elastic.results.scene.scene import Up, up_against


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
    body, notes = _body(path, case, trust, comm)

    def use(name: str, kind: str) -> str:
        return "" if case is None else references(case, body, name, kind)

    # Without the names of the case nothing of it has a place.
    drawn = Drawn() if case is None or notes else drawn_of(case, body)
    notes = (*notes, *drawn.notes)
    found = listing(body, case="" if case is None else case.file, use=use, notes=notes)
    if case is not None:
        found = replace(found, described=described(case, body))
    if picture is None:
        return found
    # Of a plane body regions are drawn; surfaces are its outline.
    named = found.surfaces if body.dim == 3 else found.regions[1:]
    legend = {row.name: row.use for row in named}
    title = found.case or body.source
    scene = gather_scene(body, title, legend)
    if scene is not None:
        up = _up(case, body)
        scene = replace(scene, symbols=drawn.symbols, obstacles=drawn.obstacles, up=up)
    why = on_root(comm, lambda: _why_not_drawn(scene, picture))
    if why:
        return replace(found, notes=(*found.notes, f"no picture: {why}"))
    return replace(found, picture=str(picture))


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


def _why_not_drawn(scene: Scene | None, picture: Path) -> str:
    """Why the picture could not be drawn; empty: it was. On rank 0."""
    from dolfin_elastic.results.scene.body_picture import draw_scene

    assert scene is not None
    try:
        draw_scene(scene, picture)
    except DrawingError as error:
        return str(error)
    return ""
