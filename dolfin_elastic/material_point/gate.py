"""No run starts with a user's energy that is no material."""

from __future__ import annotations

from collections.abc import Mapping

from mpi4py import MPI

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.core.schema import within
from dolfin_elastic.material_point.checks import sound
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.materials.user import UserEnergy


def gate(laws: Mapping[str, Law], comm: MPI.Comm) -> None:
    """Tries the energies that users wrote, each once; other laws are tried by our own tests.

    Collective.

    Args:
        laws: Dotted key of a material to its law.
        comm: The ranks that go on together.

    Raises:
        InputError: On every rank, with the key and the reason.
    """
    for key, law in laws.items():
        # What varies in space is tried with its means, once it is bound to a body.
        if not isinstance(law, UserEnergy) or law.sound or law.deferred():
            continue
        try:
            on_root(comm, lambda law=law: sound(law))  # type: ignore[misc]
        except InputError as error:
            raise within(key, error) from None
        law.passed()
