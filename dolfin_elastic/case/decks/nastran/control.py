"""Executive and case control of a Nastran deck: the solution, and what each subcase selects.

Source: MSC Nastran 2021, Quick Reference Guide, sections 3 and 4.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field, replace

from dolfin_elastic.case.decks.deck import Deck, Kind, Place
from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.mesh.formats.nastran.entries import Command

SOLUTIONS: dict[str, Kind] = {
    **dict.fromkeys(("101", "1", "24", "SESTATIC", "SESTATICS", "STATIC", "STATICS"), "statics"),
    **dict.fromkeys(("103", "3", "SEMODES", "MODES"), "modal"),
    **dict.fromkeys(("105", "5", "SEBUCKL", "BUCKLING"), "buckling"),
}
"""Name of a solution to the analysis."""
_SELECTS = {
    **{"SPC": "SPC", "LOAD": "LOAD", "METH": "METHOD", "STAT": "STATSUB"},
    **{"TEMP": "TEMP", "DEFO": "DEFORM", "MPC": "MPC", "ANAL": "ANALYSIS"},
}
"""First four letters of a command to the selection."""
_OUTPUT = frozenset(
    (
        *("DISP", "VECT", "STRE", "ELST", "STRA", "FORC", "ELFO", "SPCF", "MPCF", "GPFO", "OLOA"),
        *("ESE", "EKE", "ECHO", "LINE", "MAXL", "SET", "LABE", "OUTP", "PLOT", "SVEC", "VELO"),
        *("ACCE", "GPST", "GPSD", "THER", "PRES", "XYPL", "PAGE", "SUBS", "SURF", "VOLU", "SKIP"),
        *("BULK", "STRF", "EFFM", "MEFF", "AUTO", "XTIT", "YTIT", "RESV", "MODE", "SCR", "SDRE"),
        *("TITL", "SUBT", "ID", "CEND", "SOL", "TIME", "DIAG", "APP", "INIT", "ASSI", "GEOM"),
        *("FILE", "USER", "SDIS", "SACC", "SVEL", "DSYM", "POST", "TFL", "ENDA", "PARA", "NAST"),
    )
)
"""Beginnings of commands that ask for output, give titles or steer the program."""


@dataclass
class Subcase:
    """What a subcase selects.

    Attributes:
        place: Where it begins.
        number: Its number; 0: what all subcases have.
        title: For people.
        selections: Word to the number of a set, or to a word.
    """

    place: Place
    number: int = 0
    title: str = ""
    selections: dict[str, str] = field(default_factory=dict)


@dataclass
class Control:
    """All of it.

    Attributes:
        kind: The analysis; None where the deck does not say.
        title: For people.
        subcases: One at least.
    """

    kind: Kind | None
    title: str
    subcases: list[Subcase]


def control_of(commands: Iterable[Command], deck: Deck) -> Control:
    """Reads the commands.

    Raises:
        MeshError: A subcase has no number.
    """
    kind: Kind | None = None
    common = Subcase(Place(deck.file, 0))
    every = list[Subcase]()
    for command in commands:
        place = Place(command.file, command.number)
        words = re.split(r"[\s=,(]+", command.text.upper().strip())
        current = every[-1] if every else common
        if words[0] == "SOL":
            kind = _solution(words, place, deck)
        elif words[0] == "SUBCASE":
            every.append(replace(common, place=place, selections=dict(common.selections)))
            every[-1].number = _number(words, command)
        elif words[0] in ("SUBCOM", "REPCASE", "SYM", "SYMCOM"):
            deck.leave_out(place, f"the combination {words[0]}", "changes the answer")
            every.append(Subcase(place))
        elif words[0][:4] == "TEMP" and words[1:2] and words[1][:4] in ("INIT", "MATE", "BOTH"):
            text = f"temperatures of {words[1].strip(')')}: those of reference are TREF's alone"
            deck.leave_out(place, text, "changes the answer")
        elif (word := _SELECTS.get(words[0][:4])) and "=" in command.text:
            value = command.text.upper().rpartition("=")[2].strip()
            if not value.isdecimal() and word != "ANALYSIS":
                deck.leave_out(place, f"{word} = {value[:40]}, no number", "changes the answer")
            current.selections[word] = value
            if common.place.line == 0 and not every:
                common.place = place
        elif words[0][:4] == "TITL":
            current.title = current.title or command.text.partition("=")[2].strip()
        elif words[0][:4] not in _OUTPUT and words[0] not in ("", "$"):
            deck.leave_out(place, f"the command {words[0][:20]}")
    solved = [s for s in every if s.selections] or [common]
    return Control(kind, common.title, solved)


def _solution(words: list[str], place: Place, deck: Deck) -> Kind | None:
    word = words[1] if len(words) > 1 else ""
    if word not in SOLUTIONS:
        text = f"the solution {word[:20]}: 101, 103 and 105 are known here"
        deck.leave_out(place, text, "changes the answer")
    return SOLUTIONS.get(word)


def _number(words: list[str], command: Command) -> int:
    if len(words) < 2 or not words[1].isdecimal():
        where = f"{command.file}:{command.number}"
        raise MeshError("the subcase has no number", where=where, expected="SUBCASE 1")
    return int(words[1])
