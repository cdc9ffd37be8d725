"""`case_texts`: a deck as case files, each table with the line of the deck that it is from."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import cast

from dolfin_elastic.case.decks.deck import Deck, Entry, FieldValue, LeftOut, Quantity, Step
from dolfin_elastic.case.decks.units import System, system
from dolfin_elastic.case.toml import key_text, value_text

Selectors = Sequence[Mapping[str, object]]
Ramp = tuple[tuple[float, float], ...]


@dataclass
class Plan:
    """The steps that one case file has: static ones in a chain, and what is about their end.

    Attributes:
        steps: In their order.
        supports: Tables [[support]], with their curves.
        loads: Tables [[load]], with their curves.
    """

    steps: list[Step]
    supports: list[Entry] = field(default_factory=list)
    loads: list[Entry] = field(default_factory=list)

    @property
    def chain(self) -> list[Step]:
        """Its static steps."""
        return [step for step in self.steps if step.kind == "statics"]


def case_texts(deck: Deck, name: str, units: str = "") -> dict[str, str]:
    """The texts of case files.

    Args:
        deck: As a reader has made it; what cannot be written is added to its `left_out`.
        name: Of the case file, without suffix; of several each has its number behind it.
        units: System of units, see `units.SYSTEMS`; by default the deck's.

    Returns:
        Name of each file, without suffix, to its text, in the order of the steps.

    Raises:
        InputError: The deck does not say what its units are, and neither does the caller.
    """
    known = system(units or deck.units, _moduli(deck))
    plans = _plans(deck)
    for plan in plans:
        _chain(deck, plan)
    names = [name] if len(plans) == 1 else [f"{name}_{i + 1}" for i in range(len(plans))]
    return {one: _text(deck, plan, known) for one, plan in zip(names, plans, strict=True)}


def _moduli(deck: Deck) -> Iterable[float]:
    """The stresses among the constants of materials."""
    for entry in deck.materials.values():
        for value in entry.keys.values():
            for one in value if isinstance(value, list) else [value]:
                if isinstance(one, Quantity) and one.dimension == "stress":
                    yield one.value


# --- which steps are one case ---


def _plans(deck: Deck) -> list[Plan]:
    """Nonlinear static steps go on from one another; modes may be about the end of them."""
    plans = list[Plan]()
    for step in deck.steps:
        last = plans[-1] if plans else None
        before = last.steps[-1] if last else None
        goes_on = step.preloaded or (step.kind == "statics" and step.nonlinear)
        # Modes at rest depend on no loads: they may be beside an equilibrium.
        beside = before and step.kind == "modal" and before.supports == step.supports
        if last and before and (goes_on or beside) and before.kind == "statics":
            last.steps.append(step)
        else:
            plans.append(Plan([step]))
            if step.preloaded:
                text = "it is about an equilibrium that no static step before it gives"
                deck.leave_out(step.place, text, "changes the answer")
    return plans or [Plan([])]


def _chain(deck: Deck, plan: Plan) -> None:
    """Supports and loads of a plan, with curves over its static steps."""
    if not plan.steps:
        return
    chain = plan.chain or plan.steps[:1]
    motion = plan.steps[0].kind == "dynamics"
    plan.loads = _loads(chain, motion=motion)
    plan.supports = _supports(deck, chain, motion=motion)


def _same(one: Entry, other: Entry) -> bool:
    return one.keys == other.keys and one.ramp == other.ramp


def _with_curve(entry: Entry, rows: Iterable[tuple[float, float]]) -> Entry:
    curve = [[t, factor] for t, factor in rows]
    return Entry(entry.place, {**entry.keys, "curve": curve}, entry.remark)


def _loads(chain: list[Step], *, motion: bool) -> list[Entry]:
    """Each load with its factor at the end of each step, between which it changes linearly."""
    result = list[Entry]()
    if len(chain) == 1:
        return [_own_curve(entry, motion=motion) for entry in chain[0].loads]
    different = list[Entry]()
    for step in chain:
        different += [e for e in step.loads if not any(_same(e, other) for other in different)]
    for entry in different:
        rows = [(0.0, 0.0)]
        for number, step in enumerate(chain, start=1):
            there = any(_same(entry, other) for other in step.loads)
            first = there and rows[-1][1] == 0.0 and entry.ramp is not None
            if first and entry.ramp is not None:
                rows += [(number - 1 + t, factor) for t, factor in _within(entry.ramp)]
            else:
                rows.append((float(number), rows[-1][1] if there and rows[-1][1] else float(there)))
        result.append(_with_curve(entry, rows))
    return result


def _within(ramp: Ramp) -> Iterator[tuple[float, float]]:
    """The rows of a curve behind the beginning of a step and up to its end."""
    last = ramp[0]
    for t, factor in ramp:
        if t > 1.0:
            part = (1.0 - last[0]) / (t - last[0])
            yield 1.0, last[1] + part * (factor - last[1])
            return
        if t > 0.0:
            yield t, factor
        if t == 1.0:
            return
        last = t, factor


def _own_curve(entry: Entry, *, motion: bool) -> Entry:
    if entry.ramp is None or (not motion and entry.ramp == ((0.0, 0.0), (1.0, 1.0))):
        return entry
    return _with_curve(entry, entry.ramp)


def _supports(deck: Deck, chain: list[Step], *, motion: bool) -> list[Entry]:
    """The supports, which must be the same parts and components in all steps of a chain."""
    if len(chain) == 1:
        return [_own_curve(entry, motion=motion) for entry in chain[0].supports]
    rows = [{_held(entry): entry for entry in step.supports} for step in chain]
    for step, row in zip(chain, rows, strict=True):
        if row.keys() != rows[0].keys():
            deck.leave_out(
                step.place,
                "this step supports other nodes or directions than the one that it goes on from",
                "changes the answer",
            )
            return chain[-1].supports
    result = list[Entry]()
    for key, entry in rows[0].items():
        every = [row[key] for row in rows]
        if all(one.keys == entry.keys for one in every) and not _moves(entry):
            result.append(entry)
        else:
            result += _by_component(every)
    return result


def _held(entry: Entry) -> str:
    """Which parts and components a support holds, whatever their values."""
    values = entry.keys.get("displacement")
    free = [value == "free" for value in values] if isinstance(values, list) else []
    return repr((entry.keys.get("on"), entry.keys.get("kind", "displacement"), free))


def _moves(entry: Entry) -> bool:
    values = entry.keys.get("displacement")
    return isinstance(values, list) and any(
        _number(value) or isinstance(value, FieldValue) for value in values
    )


def _number(value: object) -> float:
    return value.value if isinstance(value, Quantity) else 0.0


def _by_component(every: list[Entry]) -> list[Entry]:
    """One support for each component that is prescribed, with its value at the end of each step."""
    first, result = every[0], list[Entry]()
    displacements = [cast("list[object]", one.keys["displacement"]) for one in every]
    for i, value in enumerate(displacements[0]):
        if value == "free":
            continue
        ends = [_number(row[i]) for row in displacements]
        size = max(map(abs, ends)) or 1.0
        parts: list[object] = ["free"] * len(displacements[0])
        parts[i] = Quantity(size, "length") if any(ends) else 0
        entry = Entry(first.place, {**first.keys, "displacement": parts}, first.remark)
        curve = [(0.0, 0.0), *((k + 1.0, end / size) for k, end in enumerate(ends))]
        result.append(_with_curve(entry, curve) if any(ends) else entry)
    return result


# --- text ---


def _text(deck: Deck, plan: Plan, known: System) -> str:
    blocks = [_head(deck, plan)]
    title = " ".join(deck.title.split())
    if title:
        blocks.append(f"title = {value_text(title[:120])}")
    mesh = {"file": deck.file, "unit": known.units["length"], **deck.mesh}
    blocks.append(_block("[mesh]", mesh, known))
    for table in ("surfaces", "regions", "points"):
        blocks += _names(table, getattr(deck, table), known)
    for name, entry in deck.materials.items():
        blocks.append(_entry(f"[materials.{key_text(name)}]", entry, known))
    blocks += [_entry("[[support]]", entry, known) for entry in plan.supports]
    blocks += [_entry("[[load]]", entry, known) for entry in plan.loads]
    blocks += [_entry("[[tie]]", entry, known) for entry in deck.ties]
    blocks += [_entry("[[mass]]", entry, known) for entry in deck.masses]
    cells = [step.periodic for step in plan.steps if step.periodic is not None]
    blocks += [_entry("[periodic]", entry, known) for entry in cells]
    yields = any(str(one.keys.get("law")).startswith("j2") for one in deck.materials.values())
    return "\n\n".join([*blocks, *_analyses(plan, known, yields)]) + "\n"


def _analyses(plan: Plan, known: System, yields: bool) -> list[str]:
    """[statics] of all its static steps, and the tables of others.

    Args:
        yields: A material does, so that the result depends on the size of load steps.
    """
    chain, blocks = plan.chain, list[str]()
    if chain:
        settings: dict[str, object] = {}
        for step in chain:
            settings |= step.settings
        if yields and not settings.keys() & {"steps", "method"}:
            settings |= _increments(chain)
        if len(chain) > 1:
            settings |= {"end": len(chain), "times": [float(i + 1) for i in range(len(chain))]}
            steps = [cast("int", one.settings["steps"]) for one in chain if "steps" in one.settings]
            settings |= {"steps": len(chain) * max(steps)} if steps else {}
        places = ", ".join(str(step.place) for step in chain)
        blocks.append(_block("[statics]", settings, known, places))
    for step in plan.steps:
        if step.kind != "statics":
            preload = {"preload": True} if step.preloaded else {}
            keys = {**step.settings, **preload}
            blocks.append(_block(f"[{step.kind}]", keys, known, str(step.place)))
    return blocks


def _increments(chain: Sequence[Step]) -> dict[str, float]:
    """First and largest step of steps that go on from one another, as fractions of all of them."""
    result = {k: v / len(chain) for k, v in chain[0].increments.items()}
    if largest := [step.increments["max_step"] for step in chain if "max_step" in step.increments]:
        result["max_step"] = min(largest) / len(chain)
        result |= {k: min(result[k], result["max_step"]) for k in ("first_step",) if k in result}
    return result


def _head(deck: Deck, plan: Plan) -> str:
    """What the file is, and what it does not have."""
    lines = [f"{deck.file} of {deck.program}, by dolfin-elastic import"]
    faults, notes = deck.faults, [one for one in deck.left_out if one not in deck.faults]
    if faults:
        lines += ["", "NOT CARRIED OVER, and the answer is another one:", *_rows(faults)]
    if notes:
        lines += ["", "Not carried over, or in another way:", *_rows(notes)]
    if not plan.steps:
        lines += ["", "The deck has no step: supports, loads and analysis are yours to write."]
    return comment(lines)


def _rows(every: Sequence[LeftOut]) -> list[str]:
    return [f"  {one}" for one in every]


def comment(lines: Iterable[str]) -> str:
    """Lines as comments, of what may be anything: no character ends a comment but a line's end."""
    return "\n".join(f"# {_printable(line)}".rstrip() for line in lines)


def _printable(text: str) -> str:
    return "".join(c if c.isprintable() else "?" for c in text)


def _names(table: str, named: Mapping[str, Entry], known: System) -> list[str]:
    """[surfaces], [regions] or [points], a row for each name."""
    if not named:
        return []
    lines = [f"[{table}]"]
    for name, entry in named.items():
        every = cast("Selectors", entry.keys["any"])
        value = _plain(every[0] if len(every) == 1 else list(every), known)
        lines += [comment([_origin(entry)]), f"{key_text(name)} = {value_text(value)}"]
    return ["\n".join(lines)]


def _entry(head: str, entry: Entry, known: System) -> str:
    return _block(head, entry.keys, known, _origin(entry))


def _origin(entry: Entry) -> str:
    return f"{entry.place}: {entry.remark}" if entry.remark else str(entry.place)


def _block(head: str, keys: Mapping[str, object], known: System, origin: str = "") -> str:
    lines = [comment([origin])] if origin else []
    rows = (f"{key_text(k)} = {value_text(_plain(v, known))}" for k, v in keys.items())
    return "\n".join([*lines, head, *rows])


def _plain(value: object, known: System) -> object:
    """A value with its units as texts."""
    if isinstance(value, Quantity):
        return known.text(value)
    if isinstance(value, FieldValue):
        field = {"field": value.field, "unit": known.units[value.dimension]}
        return field | ({"reference": value.reference} if value.reference else {})
    if isinstance(value, list | tuple):
        return [_plain(one, known) for one in value]
    if isinstance(value, Mapping):
        return {str(key): _plain(one, known) for key, one in value.items()}
    return value
