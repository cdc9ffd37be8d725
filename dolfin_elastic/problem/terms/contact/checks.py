"""Checks that contacts fit the body, and each other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import total
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.model.contact import Contact
from dolfin_elastic.model.self_contact import AnyContact
from dolfin_elastic.model.tie import Tie


def check_contacts(contacts: Sequence[AnyContact], body: Body, *, turned: bool) -> None:
    """Checks that contacts, in metres, fit the body. Not collective.

    Raises:
        InputError: With the key.
    """
    labels: dict[str, int] = {}
    for index, contact in enumerate(contacts):
        first = labels.setdefault(contact.label, index)
        forces = isinstance(contact, Contact) and contact.push is not None
        if first < index and (forces or contact.name or contacts[first].name):
            raise InputError(
                f"contact[{first}] is called '{contact.label}', too",
                where=f"contact[{index}].name",
                expected="a name of its own, for its results",
            )
        try:
            contact.check(body.dim, axisymmetric=turned)
            for name in contact.surfaces:
                body.surface(name)
        except InputError as error:
            raise error.at(f"contact[{index}]") from None


def check_pairs(contacts: Sequence[AnyContact], ties: Sequence[Tie], body: Body) -> None:
    """Refuses contact of two surfaces that another contact or a tie joins, too. Collective.

    Raises:
        InputError: With the key of the contact.
    """
    given = [
        (f"contact[{i}]", one.sides)
        for i, one in enumerate(contacts)
        if isinstance(one, Contact) and one.between is not None
    ]
    pairs = len(given)
    given += [(f"tie[{i}]", (one.surfaces, one.others)) for i, one in enumerate(ties) if pairs]
    nothing = np.empty(0, dtype=np.int32)
    sides = [
        [np.concatenate([body.surfaces.get(name, nothing) for name in side]) for side in two]
        for _, two in given
    ]
    count = np.zeros((pairs, len(given), 4))
    for i, j in np.ndindex(*count.shape[:2]):
        couples = [(a, b) for a in sides[i] for b in sides[j]]
        count[i, j] = [len(np.intersect1d(a, b)) for a, b in couples]
    count = total(body.comm, count)
    for i, (where, (one, two)) in enumerate(given[:pairs]):
        names, expected = f"'{'+'.join(one)}' and '{'+'.join(two)}'", "two surfaces, joined once"
        if count[i, i, 1]:
            what = f"faces of {names} are the same: a part of the surface is on both sides"
            raise InputError(what, where=f"{where}.between", expected=expected)
        for j in [*range(i), *range(pairs, len(given))]:
            straight, crossed = count[i, j, [0, 3]].all(), count[i, j, [1, 2]].all()
            if straight or crossed:
                what = f"{names} are a pair of {given[j][0]}, too"
                raise InputError(what, where=f"{where}.between", expected=expected)
