"""One page of documentation for each material law, from its class.

    python3 -m dolfin_elastic.model.materials.pages [FOLDER]

writes them; by default into docs/laws.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from pydantic_core import PydanticUndefined

from dolfin_elastic.core.help.records import descriptions, without_keys
from dolfin_elastic.core.schema import Record
from dolfin_elastic.model.materials.law import Branched, Law, SplitLaw
from dolfin_elastic.model.materials.moduli import Isotropic
from dolfin_elastic.model.materials.registry import MATERIALS

COST = """\
The first run with a law compiles its code.  For quadratic elements, residual and tangent together
take 1 to 7 seconds on a busy machine of two cores (`hencky` the longest, then `ogden` with three
terms), and as long again for each further material.  Later runs use the cache.  A change of a
constant needs no compilation.  An `ogden` with another number of terms does, and so does the first
body of at least 10 000 elements a rank, for which eight elements are computed at once."""
KEYS = {"lmbda": "lambda", "yield_stress": "yield"}
"""Field to the key that case files prefer."""


def page(kind: type[Law]) -> str:
    """A law's page in Markdown."""
    title, _, body = without_keys(kind).partition("\n")
    parts = [f"# {kind.name()}", title, body.strip(), "## Keys", _keys(kind), _properties(kind)]
    return "\n\n".join(part for part in [*parts, "## Example", _example(kind)] if part) + "\n"


def _keys(kind: type[Law]) -> str:
    described = descriptions(kind)
    left_out = {"law", "density"}
    if not kind(**kind.example).may_relax:
        left_out |= set(Branched.model_fields)
    names = [name for name in kind.model_fields if name not in left_out]
    rows = [
        f"| `{KEYS.get(name, name)}` | {described.get(name, '')} | {_default(kind, name)} |"
        for name in [*names, "density"]
    ]
    return "\n".join(["| key | meaning | default |", "|---|---|---|", *rows])


def _default(kind: type[Law], name: str) -> str:
    info = kind.model_fields[name]
    if info.default_factory is not None:
        return "any two" if issubclass(kind, Isotropic) else "one of K, nu"
    if info.default is PydanticUndefined:
        return "required"
    return "" if info.default is None else f"`{json.dumps(info.default)}`"


def _properties(kind: type[Law]) -> str:
    law = kind(**kind.example)
    properties = {
        "Linear: for small strains and rotations.": law.linear,
        "It has no strain energy.": not law.has_energy,
        "It resists inversion: the energy has no value where J <= 0.": law.barrier,
        "It allows inversion: an inverted element has a finite stress, which restores it.": (
            law.survives_inversion
        ),
        "It does not detect inversion: a function of C alone gives an inverted element the stress "
        "of its mirror image, so that it remains inverted. Statics and implicit dynamics refuse "
        "such states; in explicit dynamics the audit fails.": law.blind_to_inversion,
        "Its pressure can be a separate unknown, for nearly incompressible bodies.": isinstance(
            law, SplitLaw
        ),
        "Isotropic.": law.small_strain() is not None,
    }
    return "\n".join(f"- {text}" for text, holds in properties.items() if holds)


def _example(kind: type[Law]) -> str:
    lines = [f"{KEYS.get(key, key)} = {_toml(value)}" for key, value in kind.example.items()]
    table = "\n".join(["[materials.part]", f'law = "{kind.name()}"', *lines])
    return f"```toml\n{table}\n```"


def _toml(value: object) -> str:
    if not isinstance(value, dict):
        return json.dumps(value)
    return "{" + ", ".join(f"{key} = {_toml(one)}" for key, one in value.items()) + "}"


def overview() -> str:
    """The list of all laws in Markdown."""
    rows = [
        f"| [{name}]({name}.md) | {summary(kind)} |" for name, kind in sorted(MATERIALS.items())
    ]
    head = (
        "# Material laws",
        "`python3 -m dolfin_elastic.model.materials.pages` writes these pages from the classes in "
        "`dolfin_elastic/model/materials/laws/`.\n"
        "F is the deformation gradient, C = F^T F, J = det F, psi the energy "
        "per undeformed volume.\nThe key `volumetric` selects one of three terms K/2 g(J)^2.",
        COST,
    )
    return "\n\n".join([*head, "\n".join(["| law | description |", "|---|---|", *rows])]) + "\n"


def summary(kind: type[Record]) -> str:
    """The first line of a record's docstring."""
    return without_keys(kind).partition("\n")[0]


def pages() -> dict[str, str]:
    """File name to text of every page."""
    return {"README.md": overview(), **{f"{n}.md": page(kind) for n, kind in MATERIALS.items()}}


def write(folder: Path) -> None:
    """Writes all pages."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in pages().items():
        (folder / name).write_text(text, encoding="utf-8")


def main(arguments: list[str]) -> None:
    """The command in the module's head."""
    write(Path(arguments[0]) if arguments else Path("docs/laws"))


if __name__ == "__main__":
    main(sys.argv[1:])
