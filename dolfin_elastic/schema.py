"""`Record`: the base of everything a user may write, in Python or in a case file.

The fields of a record ARE the keys of its TOML table.  Records are frozen, refuse unknown keys
with the nearest known one, and say what is wrong as an `InputError` with the dotted path.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

from pydantic import AliasChoices, BaseModel, ConfigDict, ValidationError, model_validator

from dolfin_elastic.errors import InputError, nearest

if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass
else:
    ModelMetaclass = type(BaseModel)  # which pydantic does not name in public


class _Raising(ModelMetaclass):
    """Turns pydantic's error into ours, at the outermost constructor only."""

    def __call__(cls, *args: Any, **kwargs: Any) -> Any:  # noqa: N805  of a metaclass
        try:
            return super().__call__(*args, **kwargs)
        except ValidationError as error:
            raise input_error(error) from None


class Record(BaseModel, metaclass=_Raising):
    """A frozen set of named values.

    Raises:
        InputError: A key is unknown or missing, or a value is of the wrong kind.
    """

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        arbitrary_types_allowed=True,
        populate_by_name=True,
        validate_default=False,
    )

    @model_validator(mode="before")
    @classmethod
    def _refuse_unknown_keys(cls, data: Any) -> Any:
        if isinstance(data, dict):
            for name in data:
                if name not in (known := known_keys(cls)):
                    raise InputError(f"unknown key '{name}'", expected=nearest(str(name), known))
        return data


def input_error(error: ValidationError) -> InputError:
    """The first fault of a pydantic error as one message: dotted key, what, expected."""
    faults = error.errors()
    fault = min(faults, key=_rank)
    path = dotted(fault["loc"])
    inner = fault.get("ctx", {}).get("error")
    if isinstance(inner, InputError):
        return within(path, inner)
    if fault["type"] == "missing":
        return InputError("this key is missing", where=path)
    if fault["type"] == "value_error":
        return InputError(str(inner), where=path)
    same = [other for other in faults if dotted(other["loc"]) == path]
    return InputError(f"{shown(fault['input'])} is wrong", where=path, expected=_wanted(same))


def within(path: str, error: InputError) -> InputError:
    """The same error, seen from the table that holds `path`."""
    joint = "" if not path or not error.where or error.where.startswith("[") else "."
    return type(error)(error.what, where=path + joint + error.where, expected=error.expected)


def _rank(fault: Any) -> int:
    # What was written and is wrong comes before what is only missing.
    return int(fault["type"] == "missing")


LONGEST_SHOWN = 60


def shown(value: Any) -> str:
    """A value as it stands in a case file, shortened."""
    try:
        text = json.dumps(value, ensure_ascii=False)
    except (TypeError, ValueError):
        text = repr(value)
    return text if len(text) <= LONGEST_SHOWN else text[: LONGEST_SHOWN - 3] + "..."


_WANTED = {
    "string_type": "a text",
    "list_type": "a list",
    "tuple_type": "a list",
    "dict_type": "a table",
    "model_type": "a table",
    "model_attributes_type": "a table",
    "int_type": "a whole number",
    "int_parsing": "a whole number",
    "int_from_float": "a whole number",
    "float_type": "a number",
    "float_parsing": "a number",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "greater_than": "a number above {gt:g}",
    "less_than": "a number below {lt:g}",
    "greater_than_equal": "a number of at least {ge:g}",
    "less_than_equal": "a number of at most {le:g}",
    "too_short": "a list of {min_length}",
    "too_long": "a list of {max_length}",
}


def _wanted(faults: Sequence[Any]) -> str:
    """What the members of a union, or the one type, would have taken."""
    for fault in faults:
        choices = re.findall(r"'([^']*)'", str(fault.get("ctx", {}).get("expected", "")))
        if fault["type"] == "literal_error" and choices and isinstance(fault["input"], str):
            return nearest(fault["input"], choices)
    wanted = dict.fromkeys(_phrase(fault) for fault in faults)
    return "expected " + " or ".join(wanted)


def _phrase(fault: Any) -> str:
    context = fault.get("ctx", {})
    if fault["type"] == "literal_error":
        return str(context["expected"])
    if fault["type"] in _WANTED:
        return _WANTED[fault["type"]].format(**context)
    return str(fault["msg"]).removeprefix("Input should be ")


_TAGS = ("str", "int", "float", "bool")


def dotted(path: Iterable[str | int]) -> str:
    """``("support", 0, "on")`` as ``support[0].on``; names of union members are left out."""
    parts = list(path)
    if len(parts) > 1 and parts[-1] in _TAGS:
        del parts[-1]
    text = ""
    for part in parts:
        if isinstance(part, int):
            text += f"[{part}]"
        elif not any(mark in part for mark in "[('"):
            text += f".{part}" if text else part
    return text


def known_keys(model: type[BaseModel]) -> list[str]:
    """Keys that a record's table may have, other spellings included."""
    keys = []
    for name, info in model.model_fields.items():
        alias = info.validation_alias
        if isinstance(alias, str):  # the attribute has another name, which is no key
            keys.append(alias)
            continue
        others = alias.choices if isinstance(alias, AliasChoices) else ()
        keys += [name, *(str(other) for other in others if other != name)]
    return keys
