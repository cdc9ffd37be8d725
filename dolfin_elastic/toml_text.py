"""Writes nested dictionaries as TOML, which Python itself can only read."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any

_BARE = re.compile(r"[A-Za-z0-9_-]+")


def toml_text(tables: Mapping[str, Any]) -> str:
    """A TOML document.

    Args:
        tables: Top-level values; tables of tables become ``[a.b]``, lists of tables ``[[a]]``,
            tables further down stand in one line.
    """
    plain = [f"{key_text(k)} = {value_text(v)}" for k, v in tables.items() if not _is_table(v)]
    blocks = ["\n".join(plain)] if plain else []
    for key, value in tables.items():
        if isinstance(value, Mapping):
            blocks += _blocks(key_text(key), value)
        elif _is_table(value):
            blocks += [_block(f"[[{key_text(key)}]]", row) for row in value]
    return "\n\n".join(blocks) + "\n"


def _is_table(value: Any) -> bool:
    rows = value if isinstance(value, list | tuple) and value else [value]
    return all(isinstance(row, Mapping) for row in rows)


def _blocks(key: str, table: Mapping[str, Any]) -> list[str]:
    named = table and all(isinstance(v, Mapping) and "law" in v for v in table.values())
    if not named:
        return [_block(f"[{key}]", table)]
    return [_block(f"[{key}.{key_text(name)}]", row) for name, row in table.items()]


def _block(head: str, table: Mapping[str, Any]) -> str:
    return "\n".join([head, *(f"{key_text(k)} = {value_text(v)}" for k, v in table.items())])


def key_text(key: str) -> str:
    """A key as it stands in a file: bare where it can be."""
    return key if _BARE.fullmatch(key) else value_text(key)


def value_text(value: Any) -> str:
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
