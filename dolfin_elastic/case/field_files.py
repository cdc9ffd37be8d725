"""Fields of other files that loads, supports and materials of a case take values from."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from dolfin_elastic.core.errors import CaseError, InputError
from dolfin_elastic.core.units import LengthUnit
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.mesh.images.field import ImageField, add_images
from dolfin_elastic.model.values import field_tables


def with_fields(body: Body, images: Mapping[str, ImageField], tables: object, folder: Path) -> Body:
    """A body with the fields of images and of other files. Collective.

    Args:
        images: Name of the field to its image; may be empty.
        tables: See `add_fields`.
        folder: Folder that the paths are relative to.

    Raises:
        InputError: See `add_fields` and `add_images`.
    """
    if images:
        body = add_images(body, images, folder)
    add_fields(body, tables, folder)
    return body


def add_fields(body: Body, tables: object, folder: Path) -> None:
    """Gives a body the fields of other files, each under its `FieldTable.key`. Collective.

    Args:
        body: Its nodes or midpoints of cells are those at which the values are taken.
        tables: Nested tables and lists as they stand in a case file.
        folder: Folder that the paths are relative to.

    Raises:
        InputError: A file that cannot be read, or that has no such field or step; or its mesh is
            another one.
    """
    given = [*field_tables(tables)]
    if not given:
        return
    from dolfin_elastic.mesh.field_files import FieldFile

    files: dict[tuple[str, float | None, float | None], FieldFile] = {}
    for where, table in given:
        source = table.file, table.time, table.metres
        try:
            if table.key in body.fields:
                continue
            if source not in files:
                unit = None if table.metres is None else LengthUnit.of(table.metres)
                path = folder / table.file
                files[source] = FieldFile(body, path, time=table.time, unit=unit)
            body.fields[table.key] = files[source].field(table.field, table.outside)
        except InputError as error:
            what = error.what if table.file in error.what else f"{table.file}: {error.what}"
            raise CaseError(what, where=where, expected=error.expected) from None
