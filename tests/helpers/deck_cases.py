"""The case that an imported deck becomes, and its last state."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from dolfin_elastic import Case, run
from dolfin_elastic.case.decks.deck import Deck
from dolfin_elastic.case.decks.writer import case_texts


def one(deck: Deck, units: str = "m-kg-s") -> dict[str, Any]:
    """Its only case, with nothing left out that changes the answer."""
    assert not deck.faults
    (text,) = case_texts(deck, Path(deck.file).stem, units).values()
    return tomllib.loads(text)


def last(table: dict[str, Any], folder: Path) -> Any:
    """The last state of a case."""
    case = Case.from_dict({**table, "output": {"formats": ["csv"]}}, folder)
    *_, state = run(case, output=folder / "results")
    return state
