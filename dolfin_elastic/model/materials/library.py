"""Materials by name, from the library of the package and from a user's own.

A library is a TOML file of tables with the keys of [materials.NAME]; see `library.toml`.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Collection, Iterable, Iterator, Mapping
from functools import cache
from importlib.resources import files
from typing import Any

from dolfin_elastic.core.errors import InputError, all_errors, joined, keyed, nearest
from dolfin_elastic.core.schema import known_keys, quoted
from dolfin_elastic.model.materials.registry import MATERIALS

Entry = Mapping[str, Any]

_ELASTIC = frozenset(("E", "nu", "K", "lambda", "lmbda", "mu"))
_DENSITY = frozenset(("density", "rho"))
_ABOUT = frozenset(("also", "yield", "source", "note"))
"""Keys of an entry that are none of a law."""


@cache
def library() -> dict[str, Entry]:
    """Name to entry of the library of the package."""
    text = files("dolfin_elastic.model.materials").joinpath("library.toml").read_text("utf-8")
    return tomllib.loads(text)


def completed(table: Entry, own: Mapping[str, Entry] | None = None) -> dict[str, Any]:
    """A material's table with what it leaves out from a library, and with the `source` of that.

    Of elastic constants both are left out where the table has two of its own.

    Args:
        table: With the name of an entry under `material`, which is left out of the result.
        own: A user's library, which wins over that of the package.

    Raises:
        InputError: There is no entry of this name.
    """
    given = {key: value for key, value in table.items() if key != "material"}
    own = own or {}
    try:  # the first one wins that has the name
        name, entry = _found(table["material"], {**own, **library(), **own})
    except InputError as error:
        others = () if "energy" in given else _unknown_keys(given, ("law", "on", "source"))
        raise joined([error, *others]) from None
    law = {} if "energy" in given else {"law": entry.get("law", "linear-elastic")}
    law.update(given)
    keys = {*_DENSITY, "expansion", "allowable", "viscosity"}
    if isinstance(kind := law.get("law"), str) and kind in MATERIALS:
        keys.update(known_keys(MATERIALS[kind]))
    for same, most in ((_ELASTIC, 1), (_DENSITY, 0)):
        if len(same & given.keys()) > most:
            keys -= same
    values = {_limit(law, keys): entry["yield"]} if "yield" in entry else {}
    values |= {key: value for key, value in entry.items() if key not in _ABOUT}
    result = {**{key: value for key, value in values.items() if key in keys}, **law}
    if len(_ELASTIC & given.keys()) == 1 and len(have := sorted(_ELASTIC & result.keys())) > 2:
        pair = " and ".join(sorted(_ELASTIC & entry.keys()))
        raise InputError(
            f"two elastic constants are needed, {len(have)} given ({', '.join(have)})",
            expected=f"'{name}' has {pair}: give one of these, or two of your own",
        )
    if _ELASTIC & result.keys() == {"nu"} and "note" in entry:
        raise InputError("this key is missing", where="E", expected=str(entry["note"]))
    mine = ", ".join(key for key in given if key in values)
    credit = f"{name}, but {mine} of the case" if mine else name
    return {"source": ": ".join(filter(None, (credit, entry.get("source")))), **result}


def check_library(entries: Mapping[str, object]) -> None:
    """Checks the keys of a user's library.

    Raises:
        InputError: An entry is no table, or has a key that its law does not have, or a name twice.
    """
    with all_errors() as attempt:
        for name, entry in entries.items():
            with attempt(), keyed(f'"{name}"'):
                _check_entry(entry)
        first: dict[str, str] = {}
        for name, entry in entries.items():
            also = entry.get("also") if isinstance(entry, Mapping) else ()
            for one in map(str, (name, *(also if isinstance(also, list) else ()))):
                with attempt(), keyed(f'"{name}"'):
                    if (other := first.setdefault(_plain(one), name)) != name:
                        raise InputError(
                            f"the name '{one}' is that of '{other}', too",
                            expected="each name once, without regard to capitals",
                        )


def _limit(table: Mapping[str, object], keys: Collection[str]) -> str:
    """Which key the yield stress of an entry is: of a law that yields no other may be given."""
    hardening = table.get("hardening")
    curve = isinstance(hardening, list) or (isinstance(hardening, dict) and "table" in hardening)
    return "yield" if "yield" in keys and not curve and "yield_stress" not in table else "allowable"


def _check_entry(entry: object) -> None:
    if not isinstance(entry, Mapping):
        raise InputError(f"{quoted(entry)} is wrong", expected="expected a table")
    law = entry.get("law", "linear-elastic")
    if not isinstance(law, str) or law not in MATERIALS:
        raise InputError(f"unknown law '{law}'", where="law", expected=nearest(str(law), MATERIALS))
    if not isinstance(also := entry.get("also", []), list):
        raise InputError(f"{quoted(also)} is wrong", where="also", expected="expected a list")
    if errors := [*_unknown_keys(entry, _ABOUT)]:
        raise joined(errors)


def _unknown_keys(table: Entry, beside: Iterable[str]) -> Iterator[InputError]:
    """Errors about keys that are none of the table's law, and none of those beside them."""
    law = table.get("law", "linear-elastic")
    is_law = isinstance(law, str) and law in MATERIALS
    known = {*known_keys(MATERIALS[law]), *beside} if is_law else {*table}
    for key in table:
        if key not in known:
            yield InputError(f"unknown key '{key}'", expected=nearest(key, known))


def in_words(name: str) -> tuple[str, ...]:
    """Name, elastic constants, density, expansion, yield, and sources with a note, of a material.

    Raises:
        InputError: There is no such material in the library of the package.
    """
    known, entry = _found(name, library())
    constants = ", ".join(f"{key} = {entry[key]}" for key in sorted(_ELASTIC & entry.keys()))
    texts = (str(entry.get(key, "")) for key in ("density", "expansion", "yield"))
    about = "; ".join(str(entry[key]) for key in ("source", "note") if key in entry)
    return (known, constants, *texts, about)


def _found(name: object, entries: Mapping[str, Entry]) -> tuple[str, Entry]:
    """The entry of a name, which may be one of its other names, without regard to capitals."""
    if not isinstance(name, str):
        raise InputError(
            f"{quoted(name)} is wrong", where="material", expected="expected the name of a material"
        )
    for known, entry in entries.items():
        if _plain(name) in map(_plain, (known, *map(str, entry.get("also", ())))):
            return known, entry
    raise InputError(
        f"there is no material '{name}' in the library",
        where="material",
        expected=f"{alike(name, entries)} (dolfin-elastic materials lists all, and `library` names "
        "a file of your own)",
    )


def alike(name: str, entries: Mapping[str, Entry]) -> str:
    """Which materials an unknown name may mean: those that contain it, or the nearest."""
    return containing(name, entries) or nearest(name, entries)


def containing(name: str, entries: Mapping[str, Entry]) -> str:
    """The materials in whose names a word stands, as a hint; empty without any."""
    names = [known for known in entries if _plain(name) in _plain(known)]
    return "known: " + ", ".join(f'"{known}"' for known in names) if names else ""


def _plain(name: str) -> str:
    return re.sub(r"[\s_]+", " ", name.strip()).casefold()
