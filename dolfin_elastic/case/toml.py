"""TOML: read with messages that show the line, changed, and written in a case file's layout."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping, MutableMapping, MutableSequence
from copy import deepcopy
from pathlib import Path
from typing import Any, cast

from dolfin_elastic.core.errors import (
    CaseError,
    InputError,
    nearest,
    nearest_file,
    not_shown,
    why_no_file,
)

_BARE = re.compile(r"[A-Za-z0-9_-]+")


def toml_text(tables: Mapping[str, object]) -> str:
    """A TOML document in the layout of a case file, see Decisions in CONTRIBUTING.md.

    Args:
        tables: Top-level values; tables of tables become ``[a.b]``, lists of tables ``[[a]]``,
            tables further down stand in one line.
    """
    plain = [f"{key_text(k)} = {value_text(v)}" for k, v in tables.items() if not _is_table(v)]
    blocks = ["\n".join(plain)] if plain else []
    for key, value in tables.items():
        if isinstance(value, Mapping):
            blocks += _blocks(key_text(key), value)
        elif isinstance(value, list | tuple) and _is_table(value):
            blocks += [block(f"[[{key_text(key)}]]", row) for row in value]
    return "\n\n".join(blocks) + "\n"


def _is_table(value: object) -> bool:
    """Whether a value is a table, or a list of tables only."""
    rows = value if isinstance(value, list | tuple) and value else [value]
    return all(isinstance(row, Mapping) for row in rows)


def _blocks(key: str, table: Mapping[str, object]) -> list[str]:
    """The table ``[key]``, or ``[key.name]`` for each: of materials and parts of [mesh]."""
    if isinstance(parts := table.get("parts"), Mapping):
        rest = {name: value for name, value in table.items() if name != "parts"}
        return [*([block(f"[{key}]", rest)] if rest else []), *_named(f"{key}.parts", parts)]
    materials = {n: row for n, row in table.items() if isinstance(row, Mapping)}
    if key != "materials" or not table or len(materials) < len(table):
        return [block(f"[{key}]", table)]
    return _named(key, materials)


def _named(key: str, tables: Mapping[str, Mapping[str, object]]) -> list[str]:
    return [block(f"[{key}.{key_text(name)}]", row) for name, row in tables.items()]


def block(head: str, table: Mapping[str, object]) -> str:
    """A table as lines of a case file, below its head such as "[materials.gel]"."""
    return "\n".join([head, *(f"{key_text(k)} = {value_text(v)}" for k, v in table.items())])


def key_text(key: str) -> str:
    """A key as it stands in a file: bare where it can be."""
    return key if _BARE.fullmatch(key) else value_text(key)


_PART = re.compile(r'"((?:[^"\\]|\\.)*)"|([^.\[\]"]+)')


def key_parts(where: str) -> list[str]:
    """A dotted key as the keys and indices that it consists of."""
    return [quoted or bare for quoted, bare in _PART.findall(where)]


def position(tables: Mapping[str, object], where: str) -> list[int]:
    """Where a dotted key stands in a document, to be compared; a missing one at its table's end."""
    result, value = list[int](), cast(object, tables)
    for key in key_parts(where):
        if isinstance(value, Mapping):
            keys = list(value)
            result.append(keys.index(key) if key in keys else len(keys))
            value = value.get(key)
        elif isinstance(value, list) and key.isdigit() and int(key) < len(value):
            result.append(int(key))
            value = value[int(key)]
    return result


# --- values at dotted keys ---

_Inner = MutableMapping[str, object] | MutableSequence[object]


def changed_tables(
    tables: Mapping[str, object], values: Mapping[str, object], optional: frozenset[str]
) -> dict[str, object]:
    """A copy of tables in which some keys have other values.

    Args:
        tables: Of a case, as they were written.
        values: Dotted key to its value: "materials.rubber.E", "load[0].value[2]"; rows of lists
            also by their name, or by the part that they are on, "load.right.value".
        optional: Tables that a case may leave out: they are made where a key is in them.

    Raises:
        InputError: There is no such table or row, with the nearest name.
    """
    result = _with_lists(tables)
    for key, value in values.items():
        *path, last = _parts(key)
        if len(path) == 1 and path[0] in optional:
            result.setdefault(path[0], {})
        inner = _inside(result, path, key)
        if isinstance(inner, MutableMapping):
            inner[last] = value
        else:
            inner[_row(inner, last, key)] = value
    return result


def value_at(tables: Mapping[str, object], key: str) -> object:
    """What tables have at a dotted key.

    Raises:
        InputError: They have nothing there.
    """
    *path, last = _parts(key)
    return _entry(_inside(_with_lists(tables), path, key), last, key)


def _with_lists(tables: Mapping[str, object]) -> dict[str, object]:
    """A copy in which tuples are lists."""

    def copied(value: object) -> object:
        if isinstance(value, Mapping):
            return {key: copied(inner) for key, inner in value.items()}
        return list(map(copied, value)) if isinstance(value, list | tuple) else deepcopy(value)

    return {key: copied(value) for key, value in tables.items()}


def _parts(key: str) -> list[str]:
    if parts := key_parts(key):
        return parts
    raise InputError(f"'{key}' is no key", expected='for example "materials.steel.E"')


def _inside(tables: dict[str, object], path: list[str], key: str) -> _Inner:
    """The table or list in which the last part of a key stands."""
    inner: _Inner = tables
    for part, after in zip(path, [*path[1:], ""], strict=False):
        value = _entry(inner, part, key)
        if not isinstance(value, MutableMapping | MutableSequence):
            what = f"'{part}' is no table, and has no '{after or _parts(key)[-1]}'"
            raise InputError(what, where=key, expected="a key of the case file")
        inner = value
    return inner


def _entry(inner: _Inner, part: str, key: str) -> object:
    """What a table has under a name, or a list in a row."""
    if not isinstance(inner, MutableMapping):
        return inner[_row(inner, part, key)]
    if part not in inner:
        raise _missing(part, inner, key)
    return inner[part]


def _row(rows: MutableSequence[object], part: str, key: str) -> int:
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


# --- text ---


def value_text(value: object) -> str:
    """A value in one line.

    Raises:
        TypeError: TOML has no such value.
    """
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(value_text, value)) + "]"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key_text(k)} = {value_text(v)}" for k, v in value.items()) + "}"
    raise TypeError(f"TOML has no {type(value).__name__}")


def read_toml(file: str) -> dict[str, Any]:
    """The tables of a file. Not collective.

    Raises:
        CaseError: It cannot be read, or is no TOML: with the line and a caret.
    """
    text = ""
    if fault := why_no_file(file, MOST_BYTES):
        raise CaseError(fault, where=file)
    try:
        text = Path(file).read_text(encoding="utf-8-sig")
        tables = tomllib.loads(text)
    except RecursionError:
        raise CaseError(_TOO_DEEP, where=file, expected="fewer levels") from None
    except tomllib.TOMLDecodeError as error:
        raise CaseError(_syntax(str(error), text), where=file) from None
    except UnicodeDecodeError:
        mesh = f"a case file, which names a mesh or surface by [mesh] file = {value_text(file)}"
        hint = "save it in UTF-8" if file.lower().endswith(".toml") else mesh
        raise CaseError("this is no text file in UTF-8", where=file, expected=hint) from None
    except FileNotFoundError:
        others = sorted(str(p) for p in Path(file).parent.glob("*.toml"))
        near = nearest_file(file, others) if others else "dolfin-elastic new writes a first one"
        hint = not_shown(file) or near
        raise CaseError("there is no such case file", where=file, expected=hint) from None
    except OSError as error:
        raise CaseError(f"cannot be read: {error.strerror}", where=file) from None
    except ValueError:  # Python converts no more than 4300 digits
        raise CaseError(_TOO_LARGE, where=file, expected=_LARGEST) from None
    _check_limits(tables, file)
    return tables


MOST_BYTES = 1 << 24
"""Size of a case file, in which curves of many rows are files of their own."""

MOST_ROWS = 500
"""Tables [[support]], [[load]] and the like: each may be a form of its own, and compilers take a
time that grows with the square of their number."""

LONGEST_NAME = 200
DEEPEST = 20
_TOO_LARGE = "an integer has too many digits"
_LARGEST = "integers of 64 bits, as TOML has them, or a number such as 1e20"
_TOO_DEEP = f"tables or lists are nested more than {DEEPEST} deep"


def _check_limits(tables: Mapping[str, Any], file: str) -> None:
    """Refuses what no case needs, and what would cost more than the memory or patience there is.

    Raises:
        CaseError: With the key.
    """
    left: list[tuple[str, Any, int]] = [("", tables, 0)]
    while left:
        where, value, depth = left.pop()
        place = f"{file}: {shortened(where)}" if where else file
        if depth > DEEPEST:
            raise CaseError(_TOO_DEEP, where=place, expected="fewer levels")
        if isinstance(value, dict):
            for key in value:
                if len(key) > LONGEST_NAME:
                    raise CaseError(
                        f"a name of {len(key)} characters is too long, {shortened(key)}",
                        where=place,
                        expected=f"at most {LONGEST_NAME} characters",
                    )
            left += [(f"{where}.{k}".lstrip("."), v, depth + 1) for k, v in value.items()]
        elif isinstance(value, list):
            if len(value) > MOST_ROWS and isinstance(value[0], dict):
                raise CaseError(
                    f"{len(value)} tables are too many",
                    where=place,
                    expected=f"at most {MOST_ROWS}; one table can have several surfaces in `on`",
                )
            left += [
                (f"{where}[{i}]", v, depth + 1)
                for i, v in enumerate(value)
                if isinstance(v, dict | list) or _too_large(v)
            ]
        elif _too_large(value):
            raise CaseError(_TOO_LARGE, where=place, expected=_LARGEST)
        elif isinstance(value, str) and "\0" in value:
            raise CaseError("a text with the character NUL", where=place, expected="leave it out")


def _too_large(value: object) -> bool:
    return isinstance(value, int) and not -(2**63) <= value < 2**63


def shortened(text: str) -> str:
    """The beginning of a text that is too long for a message."""
    return text if len(text) <= LONGEST_NAME else f"{text[:40]}..."


_PLAINER = {
    "Illegal character '\\n'": "the closing quote is missing",
    "Unterminated string": "the closing quote is missing",
    "Cannot overwrite a value": "this key stands here for the second time",
    "Expected '=' after a key in a key/value pair": "there is no = behind the key",
    "Expected newline or end of document after a statement": "something stands behind the value",
    "Expected ']' at the end of a table declaration": "the heading has no closing bracket ]",
    "Expected ']]' at the end of an array declaration": "the heading has no closing brackets ]]",
    "Invalid value": "there is no value of TOML here",
    "Invalid statement": "there is no key and no heading here",
    "Unclosed array": "the list has no closing bracket ]",
    "Unclosed inline table": "the table has no closing brace }",
}
"""What `tomllib` says, in words of a case file."""

_UNQUOTED = re.compile(r"(?!true\b|false\b|inf\b|nan\b)[A-Za-z_]\w+|[*/^()]|\d\s*[A-Za-df-z%]")
"""What a value has outside quotes if it is a text."""


_VALUE = re.compile(r"[-+.\d\"'\[{]|true\b|false\b")
"""The begin of a value."""

_BEGIN = re.compile(r"\s*(\[\[?[\w.\"' -]+\]\]?\s*(#.*)?$|(\"[^\"]*\"|'[^']*')\s*=)")
"""The line of a heading, or of a key in quotes: what was open before it should be closed."""


def _syntax(message: str, text: str) -> str:
    """A syntax error of `tomllib`, what to write, and the line with a caret under the column.

    Args:
        message: What `tomllib` says.
        text: The file.
    """
    match = re.fullmatch(r"(.*?) \(at line (\d+), column (\d+)\)", message, re.DOTALL)
    if not match:
        what, _, where = message.partition(" (")
        return f"{_PLAINER.get(what, what[:1].lower() + what[1:])} ({where}".removesuffix(" (")
    what, line, column = match[1], int(match[2]), int(match[3])
    if twice := re.fullmatch(r"Cannot declare \((.*?),?\) twice", what):
        key = twice[1].replace("'", "").replace(", ", ".")
        what = f"[{key}] stands here for the second time"
    what = _PLAINER.get(what, what[:1].lower() + what[1:])
    shown = text.splitlines()[line - 1].replace("\t", " ")
    if re.search(r"\d$", shown[: column - 1]) and re.match(r",\d", shown[column - 1 :]):
        what = "a decimal point is needed in place of the comma"
    elif (
        match[1] == "Unclosed array"
        and _VALUE.match(shown[column - 1 :])
        and not _BEGIN.match(shown)
    ):
        what = "a comma is missing in the list"
    elif _unquoted(shown):
        what += '; texts, values with units and formulas stand in quotes: "1 MPa", "2*x"'
    return f"line {line}: {what}\n    {shown}\n    {' ' * (column - 1)}^"


def _unquoted(line: str) -> bool:
    """The value in a line is a text without quotes."""
    value = re.sub(r"#.*|'[^']*'|\"[^\"]*\"", "", line.partition("=")[2])
    return _UNQUOTED.search(value) is not None and "'" not in value and '"' not in value
