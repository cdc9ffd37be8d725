"""What an editor shows of a record: its keys with types, units and defaults, and what they mean."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable, Mapping
from functools import reduce
from inspect import Parameter, Signature
from operator import or_
from types import GenericAlias, NoneType
from typing import Annotated, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from dolfin_elastic.core.units import Quantity, members_of

_SECTION = re.compile(r"^Attributes:\n((?:    .*\n?|\n)+)", re.MULTILINE)
_KEY = re.compile(r"^    (\w+): (.*(?:\n     .*)*)", re.MULTILINE)


def signature(kind: type[BaseModel]) -> Signature:
    """The keys as arguments; a number that may have a unit is ``Annotated[float | str, "Pa"]``.

    A key that the class itself settles, as `kind` and `law` do, is left out.
    """
    own: list[Parameter] = []
    if kind.__init__ is not BaseModel.__init__:
        own = [*inspect.signature(kind.__init__).parameters.values()][1:]
    named = {one.name for one in own}
    taken = getattr(kind, "own_keys", kind.model_fields)  # of an energy, whose others have defaults
    fields = {_key(n, f): f for n, f in kind.model_fields.items() if n in taken}
    keys = [
        _argument(key, field, kind)
        for key, field in fields.items()
        if not (_settled(field) or key in named)
    ]
    keys.sort(key=lambda one: one.default is not Parameter.empty)
    first = [one for one in own if one.kind is not Parameter.VAR_KEYWORD]
    return Signature([*first, *keys, *own[len(first) :]])


def _key(name: str, field: FieldInfo) -> str:
    return field.validation_alias if isinstance(field.validation_alias, str) else name


def _settled(field: FieldInfo) -> bool:
    """It has one possible value, its default."""
    return get_origin(field.annotation) is Literal and get_args(field.annotation) == (
        field.default,
    )


def _argument(key: str, field: FieldInfo, kind: type[BaseModel]) -> Parameter:
    default = Parameter.empty if field.is_required() else field.default
    if field.default_factory is not None:  # one of several that may be given
        default = None
    unit = getattr(kind, "unit", "") if key == "value" else ""
    return Parameter(
        key, Parameter.KEYWORD_ONLY, default=default, annotation=_type(field, unit, default)
    )


def _type(field: FieldInfo, unit: str, default: object) -> object:
    kinds = [_bare(one) for one in members_of(field.annotation)]
    for one in (*field.metadata, *_inside(field.annotation)):
        if isinstance(one, Quantity):
            unit = one.unit
            kinds.insert(1, str)
    if default is None:
        kinds.append(NoneType)
    union = _union(kinds)
    return Annotated[union, unit] if unit else union


def _inside(kind: object) -> list[object]:
    """All that annotates the members of a union."""
    if get_origin(kind) is Annotated:
        return [*get_args(kind)[1:], *_inside(get_args(kind)[0])]
    return [one for member in get_args(kind) for one in _inside(member)]


def _bare(kind: object) -> object:
    """A type without what annotates it or the types inside it."""
    origin, inside = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return _bare(inside[0])
    if not isinstance(origin, type) or not inside:
        return kind
    parts = [one if one is ... else _union(map(_bare, members_of(one))) for one in inside]
    return GenericAlias(origin, tuple(parts))


def _union(kinds: Iterable[object]) -> object:
    return reduce(or_, dict.fromkeys(kinds))


def descriptions(kind: type[BaseModel]) -> dict[str, str]:
    """Field to its description in the docstring of a record's class or of a base."""
    result: dict[str, str] = {}
    for base in kind.__mro__:
        section = _SECTION.search(_written(base))
        for name, text in _KEY.findall(section[1] if section else ""):
            result.setdefault(name, " ".join(text.split()))
    return result


def _written(base: type[object]) -> str:
    """The docstring as it stands in the class."""
    return inspect.cleandoc(vars(base).get("__doc__") or "")


def without_keys(kind: type[object]) -> str:
    """The docstring without its list of keys."""
    return _SECTION.sub("", _written(kind)).rstrip()


def help_text(kind: type[BaseModel]) -> str:
    """The docstring with all keys, those of the bases, too, and an example where there is one."""
    described = descriptions(kind)
    keys = [
        f"    {_key(name, field)}: {described[name]}"
        for name, field in kind.model_fields.items()
        if name in described and not _settled(field)
    ]
    parts = [without_keys(kind), "\n".join(["Attributes:", *keys]) if keys else ""]
    example: Mapping[str, object] = getattr(kind, "example", {})
    if example:
        given = ", ".join(f"{key}={value!r}" for key, value in example.items())
        parts.append(f"Example:\n    {kind.__name__}({given})")
    return "\n\n".join(part for part in parts if part) + "\n"
