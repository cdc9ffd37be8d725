"""What surrounds or couples a body beyond its elements, as solvers see it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import numpy as np
import ufl
from dolfinx import fem

from dolfin_elastic.core.types import FloatArray, IntArray
from dolfin_elastic.model.amplitude import Amplitude
from dolfin_elastic.model.supports.springs import ResistingSupport, Spring
from dolfin_elastic.problem.context import FormContext


@dataclass(frozen=True)
class Blocks:
    """Entries of a tangent between nodes of the displacement, which need share no element.

    Each rank may have blocks of any nodes; those of one pair are summed, over the ranks, too.

    Attributes:
        rows: Global number of each block's node of forces in the displacement's space, shape (n,).
        columns: That of its node of displacements, shape (n,).
        values: Derivative of the out-of-balance forces, shape (n, dim, dim) [N/m].
    """

    rows: IntArray
    columns: IntArray
    values: FloatArray


Kind = Literal["work", "energy", "bound", "drag"]


class Term:
    """One part of the surroundings: what it does not say itself is nothing.

    Attributes:
        label: What results call it.
        linear: Its forces are linear in the displacement.
        symmetric: Its blocks are those of a symmetric matrix.
        nodal: It has forces that are in no form, see `add_forces`.
        restrains: These answer to the body's motion; else they are loads.
        changes: As a load it changes in motion.
        opens: Its forces begin and end, as those of contact.
        at_rest: What it acts from stands still.
        shift: Displacement of a rigid obstacle that its forces come from [m]; None of other terms,
            whose work is that over the displacement of the body.
        account: Which of the stored energies that of its form is part of.
        memory: What its forces depend on beside displacement and time, by its name in restarts.
    """

    label: str
    linear = symmetric = True
    nodal = restrains = changes = opens = False
    at_rest = True
    shift: fem.Constant | None = None
    account: str = ""
    memory: Mapping[str, fem.Function] = MappingProxyType({})

    def form(self, kind: Kind) -> ufl.Form | None:
        """What it has of integrals; None without any.

        Args:
            kind: "work": virtual work of its forces on the body; "energy": what it stores [J];
                "bound": its assembled vector bounds the row sums of the stiffness; "drag": those of
                the viscosity, and the forces act in motion only.
        """
        return None

    def set_time(self, t: float, default: Amplitude) -> None:
        """Takes over what is prescribed. Not collective.

        Args:
            t: Time [s], or load parameter.
            default: Amplitude where the user gave none.
        """

    def add_forces(self, forces: FloatArray) -> None:
        """Adds its present forces on the body that are in no form. Local.

        Args:
            forces: Of the displacement's owned nodes and ghosts, before the ranks are summed,
                shape (nodes * dim,) [N].
        """

    def blocks(self) -> Blocks | None:
        """Minus the derivative of these forces; None, on all ranks and always, without any.

        Collective.
        """
        return None

    def begin(self, *, moving: bool) -> None:
        """A run begins, in motion or in statics. Not collective."""

    def unsettled(self) -> bool:
        """The equilibrium that was found is none with what `augment` would change. Collective."""
        return False

    def augment(self) -> None:
        """Changes its memory by the equilibrium that was found. Collective."""

    def add_results(self, result: dict[str, float]) -> None:
        """Adds its results by name [SI units] to those of the terms before it. Collective."""


class Resistance(Term):
    """Springs or dashpots on a body."""

    def __init__(self, support: ResistingSupport, context: FormContext) -> None:
        self.support, self.label, self._context = support, support.label, context
        self.account = "springs" if isinstance(support, Spring) else ""
        self.at_rest = support.at_rest

    def form(self, kind: Kind) -> ufl.Form | None:
        """See `Term`."""
        support = self.support
        if kind == "work":
            return support.virtual_work(self._context)
        if isinstance(support, Spring) and kind == "energy":
            return support.energy(self._context)
        if kind == ("bound" if isinstance(support, Spring) else "drag"):
            return support.bound(self._context)
        return None


def forms_of(terms: Sequence[Term], kind: Kind) -> list[ufl.Form]:
    """Those of one kind that the terms have."""
    return [form for term in terms if (form := term.form(kind)) is not None]


def blocks_of(terms: Sequence[Term]) -> Blocks | None:
    """The blocks of all terms; None where no term has any. Collective."""
    result = [blocks for term in terms if (blocks := term.blocks()) is not None]
    if not result:
        return None
    parts = [(blocks.rows, blocks.columns, blocks.values) for blocks in result]
    return Blocks(*(np.concatenate(part) for part in zip(*parts, strict=True)))
