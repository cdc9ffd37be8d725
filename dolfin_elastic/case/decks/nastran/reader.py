"""`read`: a Nastran deck as a `Deck`, an analysis for each subcase."""

from __future__ import annotations

from pathlib import Path

from dolfin_elastic.case.decks.deck import Deck, Kind, Place, Step
from dolfin_elastic.case.decks.nastran.actions import Actions, method_of
from dolfin_elastic.case.decks.nastran.control import Control, Subcase, control_of
from dolfin_elastic.case.decks.nastran.materials import take_materials
from dolfin_elastic.case.decks.nastran.table import SOLIDS, Table, place
from dolfin_elastic.mesh.formats.nastran.bulk import bulk_of
from dolfin_elastic.mesh.formats.nastran.elements import KINDS, OTHERS
from dolfin_elastic.mesh.formats.nastran.entries import read_control, read_entries

_OF_THE_MESH = ("GRID", "GRDSET", *KINDS)
_READ = frozenset(
    (
        *("SPC", "SPC1", "SPCADD", "SPCD", "FORCE", "FORCE1", "PLOAD", "PLOAD4", "LOAD", "GRAV"),
        *("RFORCE", "TEMPD", "PSOLID", "MAT1", "MAT11", "EIGRL", "EIGR", "EIGB", "PARAM"),
        *("MAT2", "MAT8", "MAT9", "MAT10", "TEMP", "TEMPP1", "TEMPRB", "TEMPF"),
        *("MOMENT", "MOMENT1", "MOMENT2", "FORCE2", "PLOAD1", "PLOAD2", "PLOADX1", "ACCEL"),
        *("RBE2", "RBE3", "CELAS1", "CELAS2", "PELAS", "CONM2"),
        *("ACCEL1", "SLOAD", "DEFORM", "PLOADB3", "QBDY1", "QHBDY", "SPCOFF", "SPCOFF1"),
    )
)
"""Entries that are read, or listed where a subcase selects them."""
_HARMLESS = frozenset(
    (
        *("PSHELL", "PBAR", "PBARL", "PBEAM", "PBEAML", "PROD", "PCOMP", "PTUBE", "PLOTEL", "SET1"),
        *("SET3", "DTI", "PBUSH", "PDAMP", "PGAP", "MATS1", "NLPARM", "TSTEP", "TSTEPNL"),
        *(
            "TABLED1",
            "TABLEM1",
            "TABLES1",
            "TABDMP1",
            "ENDDATA",
            "FREQ",
            "FREQ1",
            "DESVAR",
            "DEQATN",
        ),
    )
)
"""Entries without an effect on tetrahedra, or that something else must select."""


def read(path: Path) -> Deck:
    """A Nastran deck. Not collective.

    Raises:
        MeshError: A line cannot be read.
    """
    deck = Deck("Nastran", path.name)
    control = control_of(read_control(path), deck)
    entries = list(read_entries(path))
    bulk = bulk_of(entries)
    table = Table(bulk, (e for e in entries if e.name not in _OF_THE_MESH))
    deck.title = control.title
    _elements(table, deck)
    references = take_materials(table, deck)
    _others(table, deck, control.kind)
    actions = Actions(table, deck, references)
    steps, buckled = dict[int, Step](), set[int]()
    for subcase in control.subcases if control.kind else ():
        _subcase(subcase, control, actions, table, steps, buckled)
    deck.steps = [step for number, step in steps.items() if number not in buckled]
    return deck


def _elements(table: Table, deck: Deck) -> None:
    """Order of the elements, and those that have no stiffness here."""
    kinds = table.bulk.elements
    linear = "tetra" in kinds and "tetra10" not in kinds
    deck.mesh |= {"degree": 1 if linear else 2, "formulation": "displacement"}
    if linear:
        first = kinds["tetra"].entries[0]
        text = "linear tetrahedra are too stiff: mesh.degree = 2 has quadratic displacements"
        deck.leave_out(place(first), text)
    for kind, elements in kinds.items():
        stiff = [e for e in elements.entries if e.name != "PLOTEL"]
        if kind not in SOLIDS and stiff:
            text = f"{len(stiff)} elements that have no stiffness here"
            deck.leave_out(place(stiff[0]), text, "changes the answer")


def _others(table: Table, deck: Deck, kind: Kind | None) -> None:
    for name in table.names:
        rows = table.of(name)
        if name in _READ or name in _HARMLESS or name.startswith("CORD"):
            continue
        severe = name in OTHERS or name.startswith(("MATT", "SUPORT", "DMIG", "SPOINT", "BC"))
        text = "this entry is not known here" + (f"; there are {len(rows)}" if rows[1:] else "")
        deck.leave_out(place(rows[0]), text, "changes the answer" if severe else "note")
    weighs = table.of("GRAV") or table.of("RFORCE") or kind != "statics"
    for card in table.of("CONM2"):
        text = "a mass without weight or inertia in statics"
        if weighs:
            text = "a mass at a node: [[mass]] spreads one over a surface"
        deck.leave_out(place(card), text, "changes the answer" if weighs else "note")
    relief = table.parameter("INREL")
    if relief is not None and relief.text(1) not in ("", "0"):
        deck.leave_out(place(relief), "inertia relief", "changes the answer")


def _subcase(
    subcase: Subcase,
    control: Control,
    actions: Actions,
    table: Table,
    done: dict[int, Step],
    buckled: set[int],
) -> None:
    """Adds the analysis of a subcase.

    Args:
        done: Number of a subcase to its step.
        buckled: Numbers of those of which a later one is the buckling; grows.
    """
    assert control.kind is not None
    chosen = {k: int(v) for k, v in subcase.selections.items() if v.isdecimal()}
    where = Place(subcase.place.file, subcase.place.line, f"SUBCASE {subcase.number or 1}")
    method = chosen.get("METHOD")
    buckles = control.kind == "buckling" and method is not None
    kind = "statics" if control.kind == "buckling" and not buckles else control.kind
    step = Step(kind, where)
    if buckles:
        statics = [number for number, one in done.items() if one.kind == "statics"]
        preload = chosen.get("STATSUB", min(statics or done, default=0))
        before = done.get(preload)
        if before is not None:
            buckled.add(preload)
            step.supports, step.loads = before.supports, before.loads
        elif "STATSUB" in chosen:
            text = f"there is no subcase {chosen['STATSUB']} before it (STATSUB)"
            actions.leave_out(where, text)
    elif "STATSUB" in chosen:
        actions.leave_out(where, "the equilibrium of another subcase (STATSUB), about which it is")
    if method is not None and kind != "statics":
        step.settings |= method_of(table, method, buckling=buckles)
    if not (buckles and step.loads):
        load = chosen.get("LOAD", 0)
        actions.support(step, chosen.get("SPC", 0), load)
        if load and kind != "modal":
            actions.load(step, load, dead=control.kind == "buckling")
        if (warm := chosen.get("TEMP")) and kind != "modal":
            actions.warm(step, warm)
    actions.finish(step)
    done[subcase.number] = step
