"""What an editor shows of the records: arguments, and help with keys, units and an example."""

from __future__ import annotations

import inspect
import re
from typing import Annotated, get_args, get_origin

import pytest
from pydantic import BaseModel

import dolfin_elastic
from dolfin_elastic.core.errors import InputError

RECORDS = {
    name: kind
    for name in dolfin_elastic.__all__
    if isinstance(kind := getattr(dolfin_elastic, name), type) and issubclass(kind, BaseModel)
}


@pytest.mark.parametrize("name", RECORDS)
def test_arguments_are_the_keys(name: str) -> None:
    """All that may be given, with types and defaults; without what the class settles itself."""
    arguments = inspect.signature(RECORDS[name]).parameters
    own = {"given", "keys", "law"} | ({"parameters"} if name.endswith("Energy") else set())
    for key, argument in arguments.items():
        if key in own:
            continue
        field = RECORDS[name].model_fields[key]
        assert (argument.default is inspect.Parameter.empty) == field.is_required()
        assert "Quantity" not in str(argument.annotation)
    assert {*RECORDS[name].model_fields} - {*arguments} <= {"kind", *own}


def test_units_and_texts_are_seen() -> None:
    """Of numbers, and of the values of loads; whether a class has been used or not."""
    for _ in range(2):
        rubber = inspect.signature(dolfin_elastic.NeoHookean).parameters
        assert rubber["E"].annotation == Annotated[float | str | None, "Pa"]
        assert rubber["nu"].annotation == float | str | None
        value = inspect.signature(dolfin_elastic.Traction).parameters["value"].annotation
        assert get_origin(value) is Annotated and get_args(value)[1] == "Pa"
        dolfin_elastic.NeoHookean(E=1, nu=0.3)
        dolfin_elastic.Traction(on="top", value=[0, 0, 1])
    kind = inspect.signature(dolfin_elastic.Contact).parameters["on"]
    assert str(kind) == "on: str | list[str] = ''"


@pytest.mark.parametrize("name", RECORDS)
def test_help(name: str) -> None:
    """It has all keys, also those of bases, and an example that can be typed."""
    text = inspect.getdoc(RECORDS[name]) or ""
    listed = set(re.findall(r"^    (\w+): ", text.partition("Attributes:\n")[2], re.MULTILINE))
    arguments = {*inspect.signature(RECORDS[name]).parameters} - {"given", "keys", "kind"}
    assert arguments <= listed
    example = re.search(r"^Example:\n    (.*)", text, re.MULTILINE)
    if example:
        assert isinstance(eval(example[1], dict(RECORDS)), RECORDS[name])
    assert example or not re.search(r"\.(loads|supports|laws|mesh)\b", RECORDS[name].__module__)


@pytest.mark.parametrize(
    ("record", "key", "word", "class_name"),
    [
        ("Support", "kind", "normal", "Normal"),
        ("Traction", "kind", "body-force", "BodyForce"),
        ("NeoHookean", "law", "st-venant-kirchhoff", "StVenantKirchhoff"),
    ],
)
def test_the_word_of_a_case_file_names_the_class(
    record: str, key: str, word: str, class_name: str
) -> None:
    """A class whose kind it is not says which one it is."""
    with pytest.raises(InputError, match=rf"{key}: {record} is of another .*{class_name}\("):
        RECORDS[record](**{key: word, "on": "left"})
