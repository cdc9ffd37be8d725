"""Tables of a case with other values at dotted keys."""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping, MutableSequence
from copy import deepcopy
from typing import Any, cast

from dolfin_elastic.case.toml import key_parts
from dolfin_elastic.core.errors import InputError, nearest


def changed_tables(
    tables: Mapping[str, object], values: Mapping[str, object], optional: frozenset[str]
) -> dict[str, Any]:
    """A copy of tables in which some keys have other values.

    Args:
        tables: Of a case, as they were written.
        values: Dotted key to its value: "materials.rubber.E", "load[0].value[2]"; rows of lists
            also by their name, or by the part that they are on, "load.right.value".
        optional: Tables that a case may leave out: they are made where a key is in them.

    Raises:
        InputError: There is no such table or row, with the nearest name.
    """
    result = deepcopy(dict(tables))
    for key, value in values.items():
        *path, last = _parts(key)
        if len(path) == 1 and path[0] in optional:
            result.setdefault(path[0], {})
        inner = _inside(result, path, key)
        if isinstance(inner, MutableMapping):
            inner[last] = value
        else:
            cast(MutableSequence[object], inner)[_row(inner, last, key)] = value
    return result


def value_at(tables: Mapping[str, object], key: str) -> object:
    """What tables have at a dotted key.

    Raises:
        InputError: They have nothing there.
    """
    *path, last = _parts(key)
    inner = _inside(deepcopy(dict(tables)), path, key)
    if not isinstance(inner, Mapping):
        return inner[_row(inner, last, key)]
    if last not in inner:
        raise _missing(last, inner, key)
    return inner[last]


def _parts(key: str) -> list[str]:
    if parts := key_parts(key):
        return parts
    raise InputError(f"'{key}' is no key", expected='for example "materials.steel.E"')


def _inside(tables: dict[str, Any], path: list[str], key: str) -> Any:
    """The table or list in which the last part of a key stands."""
    inner: Any = tables
    for part, after in zip(path, [*path[1:], ""], strict=True):
        if isinstance(inner, MutableMapping):
            if part not in inner:
                raise _missing(part, inner, key)
            if isinstance(inner[part], tuple):
                inner[part] = list(inner[part])
            inner = inner[part]
        else:
            inner = inner[_row(inner, part, key)]
        if not isinstance(inner, MutableMapping | MutableSequence):
            what = f"'{part}' is no table, and has no '{after or _parts(key)[-1]}'"
            raise InputError(what, where=key, expected="a key of the case file")
    return inner


def _row(rows: MutableSequence[Any], part: str, key: str) -> int:
    """The number of a row that is given by that, by its name or by its part."""
    if part.isdigit() and int(part) < len(rows):
        return int(part)
    names = [_label(row) for row in rows]
    if names.count(part) == 1:
        return names.index(part)
    known = [name for name in names if name]
    numbers = f"numbers from 0 to {len(rows) - 1}" if rows else "a list that is not empty"
    raise InputError(
        f"the list has no row '{part}'",
        where=key,
        expected=nearest(part, known) if known else numbers,
    )


def _label(row: object) -> str:
    """The name of a row of a list of tables, else the parts that it is on."""
    if not isinstance(row, Mapping):
        return ""
    on = row.get("on", "")
    return str(row.get("name") or ("+".join(map(str, on)) if isinstance(on, list) else on))


def _missing(part: str, table: Mapping[str, object], key: str) -> InputError:
    return InputError(f"the case has no '{part}' there", where=key, expected=nearest(part, table))
