"""Obstacles whose surfaces are in files: read on one rank, and prepared for contact."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.jit import compile_c, options
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.core.shapes.rigid_mesh import RigidMesh
from dolfin_elastic.core.shapes.surface import CODE, LEAF
from dolfin_elastic.core.units import LengthUnit, to_si
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.model.contact import Contact
from dolfin_elastic.model.self_contact import AnyContact


def _meshes(contacts: Sequence[AnyContact]) -> Iterator[tuple[int, RigidMesh]]:
    for index, contact in enumerate(contacts):
        if isinstance(contact, Contact) and contact.mesh is not None:
            yield index, contact.mesh


def with_obstacles(body: Body, contacts: Sequence[AnyContact], folder: Path = Path()) -> Body:
    """A body beside which the surfaces of rigid bodies have been read. Collective.

    Args:
        folder: Folder that the paths are relative to.

    Raises:
        InputError: With the key: a file cannot be read, or is no surface.
    """
    obstacles, information = dict(body.obstacles), [*body.information]
    for index, mesh in _meshes(contacts):
        if mesh.key in obstacles:
            continue
        from dolfin_elastic.mesh.facets_of_files import read_facets

        unit = None if mesh.unit is None else LengthUnit.of(to_si(f"1 {mesh.unit}", "m"))
        try:
            read = partial(read_facets, folder / mesh.file, unit, body.unit, mesh.size)
            found = on_root(body.comm, read)
        except InputError as error:
            what = error.what if mesh.file in error.what else f"{mesh.file}: {error.what}"
            where = f"contact[{index}].mesh.file"
            raise InputError(what, where=where, expected=error.expected) from None
        obstacles[mesh.key] = found.facets
        information.append(f"obstacle '{mesh.file}': {found.remarks}")
    if len(obstacles) == len(body.obstacles):
        return body
    return replace(body, obstacles=obstacles, information=tuple(information))


def with_surfaces(contacts: Sequence[AnyContact], body: Body) -> list[AnyContact]:
    """Contacts, in metres, with the surfaces of their obstacles. Collective.

    Raises:
        InputError: See `with_obstacles`.
    """
    result = [*contacts]
    if not any(True for _ in _meshes(contacts)):
        return result
    obstacles = with_obstacles(body, contacts).obstacles
    loops = compile_c(body.comm, CODE, {"LEAF": LEAF}, options(body.comm))
    for index, mesh in _meshes(contacts):
        ready = mesh.with_facets(obstacles[mesh.key], loops)
        result[index] = contacts[index].model_copy(update={"mesh": ready})
    return result
