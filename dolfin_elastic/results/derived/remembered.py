"""Fields of what materials remember: the variables of a `Memory`, as they were committed last.

Where a law sees what it remembers, see `Memory.seen`, a variable is a field by its name.  What a
law folds before it sees it, as Prony series do, is none.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

from ufl.core.expr import Expr

from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.materials.memory import Variable
from dolfin_elastic.model.materials.stepped import stepped
from dolfin_elastic.results.field import Field


def _remembered(name: str, shape: Literal["scalar", "tensor"], description: str) -> Field:
    """A variable of a law's memory; 0 where a material has none.

    Args:
        name: Of the `Variable`.
    """

    def formula(law: Law, F: Expr) -> Expr:
        """See `Field.formula`.

        Args:
            F: Deformation gradient, 3x3.
        """
        over_step = stepped(law)
        if over_step is not None and name in over_step.past:
            return over_step.past[name]
        nothing = F - F  # a plain 0 has no mesh
        return nothing[0, 0] if shape == "scalar" else nothing

    return Field(shape, "cell", "", description, formula)


REMEMBERED: dict[str, Field] = {
    "plastic_strain": _remembered(
        "plastic_strain",
        "scalar",
        "equivalent plastic strain, which grows wherever the material yields",
    ),
    "plastic_strain_tensor": _remembered(
        "plastic_strain_tensor", "tensor", "plastic strain of laws for small strains"
    ),
}
"""Those with a name that every problem knows, whether a material has them or not."""


def _variables(law: Law) -> list[Variable]:
    """What is remembered and seen by one name."""
    memory = law.memory
    if memory is None:
        return []
    seen = [one.name for one in memory.seen]
    return [one for one in memory.variables if one.name in seen]


def remembers(law: Law, name: str) -> bool:
    """Whether a material has such a variable as a field."""
    return name in [one.name for one in _variables(law)]


def remembered_by(laws: Iterable[Law]) -> dict[str, Field]:
    """Name to field of all variables of laws, those of `REMEMBERED` left out."""
    return {
        one.name: _remembered(
            one.name,
            "scalar" if one.shape == "scalar" else "tensor",
            "what the material remembers under this name",
        )
        for law in laws
        for one in _variables(law)
        if one.name not in REMEMBERED
    }
