"""Pages of the reference that are made from the code when the site is built.

They go to docs/reference/generated, which is no part of the repository; the pages beside it
include them.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import click
import messages
import typer
from messages import escaped

from dolfin_elastic.case.reference.json_schema import case_schema
from dolfin_elastic.cli.app import app
from dolfin_elastic.core.formula_functions import CONSTANTS, FUNCTIONS
from dolfin_elastic.model.materials.library import in_words, library
from dolfin_elastic.results.fields import FIELDS

ROOT = Path(__file__).parents[2]
Schema = Mapping[str, Any]

TABLES: dict[str, str] = {}
"""Name of a definition of the schema to its table of a case file, in their order; see `tables`."""


def write(folder: Path) -> None:
    """Writes all pages.

    Args:
        folder: Where to; it is made.
    """
    folder.mkdir(exist_ok=True)
    pages = {
        "keys.md": keys(case_schema()),
        "commands.md": commands(),
        "messages.md": messages.write(folder.parent / "messages"),
        "fields.md": fields(),
        "library.md": library_table(),
        "verification.md": verification(),
    }
    for name, text in pages.items():
        file = folder / name
        if not file.exists() or file.read_text(encoding="utf-8") != text:
            file.write_text(text, encoding="utf-8")


# --- keys ---


def keys(schema: Schema) -> str:
    """Every table with its keys, in the order of a case file."""
    names = schema["definitions"]
    TABLES.clear()
    for key, one in schema["properties"].items():
        enter(one, f"[[{key}]]" if one.get("type") == "array" else f"[{key}]", names)
    parts = [f"(keys-the-whole-file)=\n## The whole file\n\n{table(schema)}"]
    for name, title in TABLES.items():
        level = "###" if "] " in title.partition("` with")[0] else "##"
        parts.append(f"({anchor(name)})=\n{level} {title}\n\n{table(names[name])}")
    return "\n\n".join(parts)


def enter(schema: Schema, where: str, names: Schema) -> None:
    """Enters the tables that a value may be into `TABLES`, each before those within it.

    Args:
        schema: Of the value.
        where: What its key is called in a case file.
        names: Definitions of the schema.
    """
    for name in referred(schema):
        if name not in TABLES and "properties" in names[name]:
            TABLES[name] = heading(name, where)
            for key, one in names[name]["properties"].items():
                enter(one, f"{where} {key}", names)


def heading(name: str, where: str) -> str:
    """The heading of a table."""
    kind, _, word = name.partition("-")
    special = {
        "FormulaEnergy": "`energy`",
        "SplitFormulaEnergy": "`energy` and `volumetric`",
        "MaterialByName": "`material`",
    }
    if kind == "law":
        return f'`[materials.NAME]` with `law = "{word}"`'
    if name in special:
        return f"`[materials.NAME]` with {special[name]}"
    return f'`{where}` with `kind = "{word}"`' if word else f"`{where}`"


def referred(schema: Schema) -> list[str]:
    """Names of the tables that a value may be."""
    return re.findall(r"#/definitions/([\w-]+)", json.dumps(schema))


def anchor(name: str) -> str:
    """The target of a table."""
    return "keys-" + re.sub(r"\W+", "-", name.lower())


def table(schema: Schema) -> str:
    """One table's keys in Markdown."""
    needed = schema.get("required", [])
    rows = []
    for key, one in schema["properties"].items():
        default = "needed" if key in needed else ""
        if "default" in one and one["default"] not in ("", None):
            default = f"`{json.dumps(one['default'])}`"
        text = str(one.get("description", "")).replace("|", "\\|").replace("None:", "by default")
        rows.append(f"| `{key}` | {kind(one)} | {default} | {escaped(text)} |")
    head = escaped(schema.get("description", ""))
    return "\n".join([head, "", "| key | value | default | what |", "|---|---|---|---|", *rows])


def kind(schema: Schema) -> str:
    """What a value is, in words."""
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        word = name.partition("-")[2] or TABLES.get(name, "").rpartition(" with ")[2]
        return "curve" if name == "Curve" else f"[{word}](#{anchor(name)})"
    if "const" in schema:
        return f"`{json.dumps(schema['const'])}`"
    if "enum" in schema:
        return " or ".join(f"`{json.dumps(one)}`" for one in schema["enum"])
    if "anyOf" in schema:
        words = dict.fromkeys(kind(one) for one in schema["anyOf"])
        return " or ".join(words)
    return simple(schema)


def simple(schema: Schema) -> str:
    """What a value without alternatives is."""
    if "x-unit" in schema:
        unit = schema["x-unit"]
        return "number" + (f" \\[{unit}\\]" if unit else "") + bounds(schema)
    type_ = schema.get("type")
    if type_ == "array":
        low, high = schema.get("minItems"), schema.get("maxItems")
        count = f"{low} " if low == high and low else f"{low} to {high} " if low and high else ""
        return f"list of {count}({kind(schema['items'])})"
    if type_ == "object":
        inner = schema.get("additionalProperties")
        if inner:
            return f"names, each {kind(inner)}"
        return "`{" + ", ".join(f"{key} = .." for key in schema.get("properties", {})) + "}`"
    words = {"string": "text", "boolean": "true or false", "integer": "whole number"}
    if isinstance(type_, list):
        return "number"
    return words.get(str(type_), str(type_ or "number, text or list")) + bounds(schema)


def bounds(schema: Schema) -> str:
    """Limits of a number."""
    words = {"exclusiveMinimum": ">", "minimum": "≥", "exclusiveMaximum": "<", "maximum": "≤"}
    found = [f"{sign} {schema[key]:g}" for key, sign in words.items() if key in schema]
    return f", {' and '.join(found)}" if found else ""


# --- commands ---


def commands() -> str:
    """The help of every command."""
    group = typer.main.get_command(app)
    assert isinstance(group, click.Group)
    with click.Context(group, info_name="dolfin-elastic") as top:
        parts = []
        for name in group.list_commands(top):
            command = group.get_command(top, name)
            assert command is not None
            context = click.Context(command, info_name=name, parent=top, terminal_width=100)
            text = command.get_help(context)
            parts.append(f"## `{name}`\n\n```text\n{text}\n```")
    return "\n\n".join(parts) + "\n"


# --- fields, functions ---


def fields() -> str:
    """Names of fields, and of functions in formulas."""
    rows = [
        f"| `{name}` | {escaped(field.description)} | {field.unit} |"
        for name, field in sorted(FIELDS.items())
    ]
    listed = ", ".join(f"`{name}`" for name in (*FUNCTIONS, *CONSTANTS))
    table = "\n".join(["| field | what | unit |", "|---|---|---|", *rows])
    return f"{table}\n\nFunctions and numbers of formulas: {listed}.\n"


# --- verification ---


def verification() -> str:
    """The table of the last recorded `dolfin-elastic verify --full`."""
    file = ROOT / "docs/verification.json"
    rows: Iterable[Mapping[str, Any]] = json.loads(file.read_text(encoding="utf-8"))
    return "\n".join(
        [
            "| case | computed | reference | error | limit | |",
            "|---|---|---|---|---|---|",
            *lines(rows),
            "",
        ]
    )


def library_table() -> str:
    """The materials of the library with their sources."""
    rows = [f"| {' | '.join(map(escaped, in_words(name)))} |" for name in library()]
    heads = [
        "| name | elastic constants | density | expansion | yield | source |",
        "|---|---|---|---|---|---|",
    ]
    return "\n".join([*heads, *rows, ""])


def lines(rows: Iterable[Mapping[str, Any]]) -> Iterator[str]:
    """Rows of the table of verification."""
    for row in rows:
        unit = f" {row['unit']}" if row["unit"] else ""
        share = min(1.0, row["error"] / row["limit"])
        bar = "▮" * max(1, round(10 * share)) + "▯" * (10 - max(1, round(10 * share)))
        numbers = (
            f"{row['computed']:.8g}{unit} | {row['reference']:.8g}{unit} | "
            f"{row['error']:.1e} | {row['limit']:.0e}"
        )
        what = f"**{row['name']}**: {escaped(row['what'])}. {escaped(row['source'])}"
        yield f"| {what} | {numbers} | {bar} |"
