"""Cavities of a body: enclosed volumes, whose pressure or volume is prescribed."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence

import numpy as np
import ufl
from dolfinx import fem

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.ghosts import assembled
from dolfin_elastic.core.jit import compile_forms, options
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.loads import Cavity, Load
from dolfin_elastic.problem.constraints.rows import Constraints
from dolfin_elastic.problem.context import FormContext
from dolfin_elastic.problem.material_regions import shear_modulus
from dolfin_elastic.problem.term import OutOfBalance, ScalarTerm

log = logging.getLogger("dolfin_elastic")


VOLUME = 1e-10
"""Error of a prescribed volume, as a share of it: the next Newton step would find round-off."""

OPEN = 1e-6
"""Share of the derivative of the volume that is round-off."""


class BodyCavity(ScalarTerm):
    """A cavity. Its pressure may be an unknown, with volume = given volume as its equation.

    Attributes:
        label: What results call it.
        closed: Its surfaces and planes of symmetry enclose it, so that it has a volume.
        initial: Volume of the undeformed cavity [m^3].

    Raises:
        InputError: The origin does not fit the body.
    """

    closed, initial = False, 0.0

    def __init__(
        self, cavity: Cavity, context: FormContext, constraints: Constraints, where: str
    ) -> None:
        self._cavity, self._context, self._constraints = cavity, context, constraints
        self.label, self._where, self._unknowns = cavity.label, f"{where}.on", context.unknowns
        self.size = int(cavity.volume_controlled)
        try:
            self._volume = cavity.enclosed(context, context.linear)
            exact = cavity.enclosed(context, linear=False)
        except InputError as error:
            raise error.at(where if error.where else self._where) from None
        w, test = self._unknowns.w, ufl.TestFunction(self._unknowns.W)
        push = cavity.work(context, context.constant(1.0), linear=False)
        self._grown = ufl.derivative(self._volume, w, test)
        self._lost = ufl.derivative(exact, w, test) - push
        # The residual is linear in the pressure: a large difference has no error but round-off.
        self.steps = np.array([max(shear_modulus(region.typical) for region in context.regions)])
        self.signs, self.prescribing = np.array([-1.0]), np.zeros(1, dtype=bool)

    def begin(self, *, moving: bool) -> None:
        """See `Term`: its volume is prescribed, but it is open; or it has none."""
        comm = self._context.body.comm
        forms = [self._volume, self._grown, self._lost]
        self._forms = compile_forms(comm, forms, options(comm))
        self.initial, self.closed = self._undeformed()
        if not self.initial > 0.0 and (self.size or self.closed):
            raise InputError(
                f"the surfaces of the cavity '{self.label}' enclose {self.initial:.3g} m^3",
                where=self._where,
                expected="all surfaces around it, and an origin in all planes of symmetry",
            )
        if not self.closed:
            self._report_open()

    def _undeformed(self) -> tuple[float, bool]:
        """The volume [m^3] of the undeformed body, and whether it is closed. Collective."""
        w = self._unknowns.w.x.array
        present = w.copy()
        w[:] = 0.0
        result = self.volume(), self._is_closed()
        w[:] = present
        return result

    def _is_closed(self) -> bool:
        """The pressure's work is that on the volume: nothing flows through the rim. Collective."""
        moves, sums = self._unknowns.displacement_dofs, []
        for form in self._forms[1:]:
            v = assembled(form, self._unknowns.W)[moves]
            sums.append(np.sum((v - self._constraints.constrained_part(v)) ** 2))
        size, loss = np.sqrt(total(self._context.body.comm, np.array(sums)))
        return bool(loss <= OPEN * size)

    def _report_open(self) -> None:
        """A volume that is prescribed must be one; a pressure acts all the same."""
        text = (
            f"the cavity '{self.label}' is open: a part of its edge is not constrained to a plane "
            "through its origin"
        )
        if self.size:
            raise InputError(
                text,
                where=self._where,
                expected="all surfaces around it, supports in planes of symmetry, and an origin "
                "in all of them",
            )
        log.warning("%s, so it has no volume in the results", text)

    def without_motion(self) -> InputError:
        """See `ScalarTerm`."""
        return InputError(
            "a cavity with a given volume exists in statics only",
            where="load",
            expected="its pressure, or [statics]",
        )

    def volume(self) -> float:
        """Present volume [m^3]. Collective."""
        return total(self._context.body.comm, float(fem.assemble_scalar(self._forms[0])))

    def _prescribed(self) -> float:
        return self._cavity.prescribed_value(self.t, self.default, self.initial)

    def get(self) -> FloatArray:
        """The pressure [Pa]."""
        return np.array([self._pressure()])

    def _pressure(self) -> float:
        unknown = self.size > 0
        return float(self._context.unknown(self.label).value) if unknown else self._prescribed()

    def put(self, values: FloatArray) -> None:
        """Sets it."""
        self._context.unknown(self.label).value = float(values[0])

    def residual(self, forces: OutOfBalance) -> FloatArray:
        """Volume beyond the given one [m^3]. Collective."""
        return np.array([self.volume() - self._prescribed()])

    def rows(self, forces: OutOfBalance) -> list[FloatArray]:
        """Its derivative [m^2]. Collective."""
        return [assembled(self._forms[1], self._unknowns.W)]

    def settled(self, residual: FloatArray, target: float) -> bool:
        """The volume is the given one."""
        return bool(abs(residual[0]) <= VOLUME * max(self.initial, abs(self._prescribed())))

    def add_results(self, result: dict[str, float], forces: FloatArray) -> None:
        """See `Term`: volume, if it has one, and pressure."""
        if self.closed:
            result[f"volume_{self.label}"] = self.volume()
        result[f"pressure_{self.label}"] = self._pressure()


def make_cavities(
    loads: Sequence[Load], context: FormContext, constraints: Constraints
) -> Iterator[BodyCavity]:
    """The cavities among the loads.

    Args:
        loads: All loads of the body.

    Raises:
        InputError: Two have the same name, or the body has none in three dimensions.
    """
    labels: set[str] = set()
    for index, load in enumerate(loads):
        if not isinstance(load, Cavity):
            continue
        if load.label in labels:
            raise InputError(
                f"there is another cavity '{load.label}'",
                where=f"load[{index}].name",
                expected="a name of its own",
            )
        if context.geometry == "plane-stress":
            raise InputError(
                "in plane stress the thickness changes, and no cavity has a volume",
                where=f"load[{index}].kind",
                expected='"pressure"',
            )
        labels.add(load.label)
        yield BodyCavity(load, context, constraints, f"load[{index}]")
