"""Records inside records: what is read apart from the outer one, and its errors."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import Field

from dolfin_elastic import Contact
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.schema import Record, WhenGiven


class Inner(Record):
    """A table."""

    count: int = Field(ge=1)
    label: str = ""


class Untouched(Record):
    """A table that is read nowhere."""

    count: int = 1


class Plain(Record):
    """Its inner tables have their schemas inside its own."""

    one: Inner | None = None
    rows: int | list[Inner] = 0
    usual: Inner = Inner(count=1)


class Apart(Record):
    """Its inner tables have schemas of their own."""

    one: WhenGiven[Inner] | None = None
    rows: int | list[WhenGiven[Inner]] = 0
    usual: WhenGiven[Inner] = Inner.model_construct(count=1)


WRONG = [
    {"one": 3},
    {"one": True},
    {"one": {}},
    {"one": {"count": 0, "label": 3}},
    {"one": {"cuont": 1}},
    {"one": {}, "usual": {"count": "x"}},
    {"usual": None},
    {"rows": "x"},
    {"rows": {"count": 1}},
    {"rows": [{"count": 1}, {"count": 0}]},
    {"rows": [3]},
    {"rows": [{}]},
]


@pytest.mark.parametrize("table", WRONG, ids=str)
def test_errors_of_tables_read_apart_are_those_of_others(table):
    """The place and the words are the same, and so is which of several faults is told."""
    with pytest.raises(InputError) as plain:
        Plain(**table)
    with pytest.raises(InputError) as apart:
        Apart(**table)
    assert str(apart.value) == str(plain.value)


@pytest.mark.parametrize("table", [{}, {"one": {"count": 2}}, {"rows": [{"count": 3}]}], ids=str)
def test_tables_read_apart_are_written_as_others(table):
    """Whatever is left out."""
    for options in ({}, {"exclude_unset": True, "exclude_none": True}):
        assert Apart(**table).model_dump(**options) == Plain(**table).model_dump(**options)
    assert Apart(**table).model_dump_json() == Plain(**table).model_dump_json()
    given = Inner(count=4)
    assert Apart(one=given).one is given


class WithDefault(Record):
    """Has a table by default."""

    usual: WhenGiven[Untouched] = Untouched.model_construct()


def test_a_default_needs_no_schema_before_it_is_written():
    """Its class may have none when the outer record is written."""
    record = WithDefault()
    assert not Untouched.__pydantic_complete__
    assert record.model_dump() == {"usual": {"count": 1}}


class Place(Record):
    """Has at least two numbers."""

    at: tuple[float, ...] = Field(min_length=2)


@pytest.mark.parametrize(
    ("at", "said"),
    [
        ([1, "x"], 'at[1]: "x" is wrong; expected a number'),
        ([1], "at: [1] is wrong; expected a list of 2"),
    ],
)
def test_an_item_that_is_wrong_does_not_make_a_list_too_short(at, said):
    """One fault, one message: the list has as many items as it needs."""
    with pytest.raises(InputError) as caught:
        Place(at=at)
    assert str(caught.value) == said


def test_a_table_with_an_unknown_key_tells_its_other_errors() -> None:
    """Also those that a table makes as a whole, but not what may follow from the key left out."""
    plane, ball = {"axis": "z", "at": 0}, {"center": [0, 0, 0], "radius": 1}
    rows: list[tuple[dict[str, Any], list[str]]] = [
        ({"plane": plane, "sphere": ball, "frictoin": 1}, ["frictoin", "plane and sphere are"]),
        ({"plane": plane, "motion": [0, 0, "x"], "new": 1}, ["new", "motion[2]: the obstacle is"]),
        ({"plane": plane, "friction": -1, "new": 1}, ["new", "friction: -1"]),
        ({"plane": plane, "force": 1, "directoin": "x"}, ["directoin"]),
        ({"plane": plane, "force": 1, "new": "x"}, ["new"]),
        ({"new": 1}, ["new"]),
    ]
    for keys, said in rows:
        with pytest.raises(InputError) as caught:
            Contact(on="top", **keys)
        errors = [str(one) for one in caught.value.each]
        assert len(errors) == len(said)
        assert all(word in error for word, error in zip(said, errors, strict=True))
