"""The supports, loads, contacts and ties of a case, each in one sentence of its own."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from dolfin_elastic.case.case import Case
from dolfin_elastic.case.model_tables import READERS
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.model.describe import Setting
from dolfin_elastic.model.loads import Load
from dolfin_elastic.model.point_mass import PointMass
from dolfin_elastic.model.self_contact import AnyContact
from dolfin_elastic.model.supports.displacement import Restraint
from dolfin_elastic.model.tie import Tie
from dolfin_elastic.problem.problem import Problem

_UNREADABLE = (InputError, ArithmeticError, KeyError, TypeError, ValueError)
"""What the tables of strangers may raise."""


@dataclass(frozen=True)
class Described:
    """A support, load, contact, tie or mass.

    Attributes:
        key: "load[0]".
        label: Its name in results; of loads without one its parts.
        on: The parts that it acts on; none: the whole body.
        text: What it does.
        follows: It is a load that depends on the deformation.
    """

    key: str
    label: str
    on: tuple[str, ...]
    text: str
    follows: bool = False


def described(case: Case, body: Body) -> tuple[Described, ...]:
    """All of a case. Local."""
    kinds = {
        name: next((kind for kind in row.part_kinds if kind in body.kinds(name)), "surface")
        for row in case.support
        for name in row.surfaces
    }
    linear = all(material.law.linear for material in case.materials.values())
    setting = Setting(body.unit.metres, linear, kinds)
    return tuple(_rows({key: getattr(case, key) for key in READERS}, setting))


def described_problem(problem: Problem) -> tuple[Described, ...]:
    """All of a problem. Local."""
    ties = problem.constraints.ties
    lists: dict[str, Sequence[object]] = {
        "support": problem.supports,
        "load": problem.loads,
        "contact": problem.contacts,
        "tie": [] if ties is None else ties.given,
        "mass": problem.context.mounted,
    }
    return tuple(_rows(lists, Setting(linear=problem.context.linear)))  # all is in metres


def described_tables(tables: Mapping[str, object], setting: Setting) -> tuple[Described, ...]:
    """All of a case's tables, which may come from a stranger: what cannot be read has its kind."""
    lists = {key: tables.get(key) for key in READERS}
    return tuple(_rows({k: v for k, v in lists.items() if isinstance(v, list)}, setting))


def _rows(lists: Mapping[str, Sequence[object]], setting: Setting) -> Iterator[Described]:
    for key, rows in lists.items():
        for i, row in enumerate(rows):
            try:
                yield _read(f"{key}[{i}]", READERS[key](row), setting)
            except _UNREADABLE:
                table = row if isinstance(row, Mapping) else {}
                on = table.get("on") or ()
                on = tuple(map(str, on if isinstance(on, list | tuple) else [on]))
                label = str(table.get("name") or "+".join(on))
                yield Described(f"{key}[{i}]", label, on, str(table.get("kind") or key))


def _read(
    key: str, record: Restraint | Load | AnyContact | Tie | PointMass, setting: Setting
) -> Described:
    record = record.in_metres(setting.metres)
    if not isinstance(record, Load):
        return Described(key, record.label, record.surfaces, record.describe(setting))
    label = str(getattr(record, "label", "+".join(record.parts)))
    follows = record.follower and not (setting.linear and record.linearises)
    return Described(key, label, record.parts, record.describe(setting), follows)
