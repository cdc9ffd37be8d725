"""Preloaded bolts: the free strain of a shank, with the force in it as its equation."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import ufl
from dolfinx import fem

from dolfin_elastic.core.errors import InputError, keyed
from dolfin_elastic.core.ghosts import assembled
from dolfin_elastic.core.jit import compile_forms, options
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.loads import Load
from dolfin_elastic.model.loads.bolt import Bolt
from dolfin_elastic.problem.context import FormContext
from dolfin_elastic.problem.eigenstrain import Shank
from dolfin_elastic.problem.material_regions import young
from dolfin_elastic.problem.term import OutOfBalance, ScalarTerm

if TYPE_CHECKING:
    from dolfin_elastic.problem.weak_form import WeakForm

_SAME = 1e-10
"""Error of the force, over the preload: the next Newton step would find round-off."""
_ROUND_OFF = 1e-14
"""Strain that is round-off."""


class PreloadedBolt(ScalarTerm):
    """A bolt, whose shortening is an unknown, as a strain.  Collective to make.

    Args:
        shank: From `shanks_of`.
        weak_form: Gives the stress, once the problem is made.

    Attributes:
        length: L of `Bolt` [m].
    """

    def __init__(
        self, bolt: Bolt, shank: Shank, context: FormContext, weak_form: Callable[[], WeakForm]
    ) -> None:
        self._bolt, self._context, self._weak_form = bolt, context, weak_form
        self.label, self.size = bolt.label, 1
        self.steps, self.signs = np.array([1e-6]), np.ones(1)
        self.prescribing = np.zeros(1, dtype=bool)
        self.follows_path = bolt.locked_at is not None
        self._locked: float | None = None
        self._shank, self.length = shank, shank.length
        if context.axisymmetric and abs(bolt.direction[1]) < 1 - 1e-9:
            raise InputError(
                "the shank of a body of revolution is along its axis",
                where="axis",
                expected='axis = "y"',
            )
        self._modulus = max(young(region.typical) for region in context.regions)
        self._stiffness = 0.0  # [N], known once a run begins

    def begin(self, *, moving: bool) -> None:
        """See `Term`."""
        context, weak, bolt = self._context, self._weak_form(), self._bolt
        w, comm = context.unknowns.w, context.body.comm
        a, g = ufl.as_vector([*map(float, bolt.direction)]), self._shank.g / self.length
        F = weak.F(w)
        force = sum(
            ufl.inner(weak.response(region, w).stress(F), ufl.outer(a, g))
            * weak.volume(region, weak.rule(region))
            for region in context.regions
        )
        section = sum(ufl.dot(a, g) * weak.volume(region, 0) for region in context.regions)
        row = ufl.derivative(force, w, ufl.TestFunction(context.unknowns.W))
        self._force, self._row, size = compile_forms(comm, [force, row, section], options(comm))
        area = float(total(comm, float(fem.assemble_scalar(size))))
        self._stiffness = self._modulus * area

    def without_motion(self) -> InputError:
        """See `ScalarTerm`."""
        return InputError(
            "a bolt is tightened in statics only",
            where="load",
            expected="[statics], or a growth of the shank",
        )

    def get(self) -> FloatArray:
        """The strain by which the shank is shortened."""
        return np.array([float(self._context.unknown(self.label).value)])

    def put(self, values: FloatArray) -> None:
        """Sets it."""
        self._context.unknown(self.label).value = float(values[0])

    def force(self) -> float:
        """Present force in the shank [N]. Collective."""
        return float(total(self._context.body.comm, float(fem.assemble_scalar(self._force))))

    @property
    def _is_locked(self) -> bool:
        at = self._bolt.locked_at
        return at is not None and self._locked is not None and self.t > at * (1 + 1e-9)

    def residual(self, forces: OutOfBalance) -> FloatArray:
        """Force beyond the preload [N], or shortening beyond that of the lock. Collective."""
        if self._is_locked:
            assert self._locked is not None
            return self._stiffness * (self.get() - self._locked)
        return np.array([self.force() - self._bolt.force(self.t, self.default)])

    def rows(self, forces: OutOfBalance) -> list[FloatArray]:
        """Its derivative [N/m]. Collective."""
        row = assembled(self._row, self._context.unknowns.W)
        return [np.zeros_like(row) if self._is_locked else row]

    def settled(self, residual: FloatArray, target: float) -> bool:
        """The force is the preload, or the shortening that of the lock."""
        least = _ROUND_OFF * self._stiffness
        given = abs(self._bolt.force(self.t, self.default))
        return bool(abs(residual[0]) <= max(_SAME * given, least))

    def commit(self) -> None:
        """See `Term`: the shortening up to the lock is what it keeps."""
        super().commit()
        self._locked = float(self.get()[0])  # locked, it has not changed; or a run goes on here

    def add_results(self, result: dict[str, float], forces: FloatArray) -> None:
        """See `Term`: force and shortening."""
        result[f"bolt_force_{self.label}"] = self.force()
        result[f"shortening_{self.label}"] = float(self.get()[0]) * self.length


def make_bolts(
    loads: Sequence[Load],
    shanks: Mapping[int, Shank],
    context: FormContext,
    weak_form: Callable[[], WeakForm],
) -> Iterator[PreloadedBolt]:
    """The bolts among the loads. Collective.

    Args:
        loads: All loads of the body.
        shanks: From `shanks_of`.
        weak_form: See `PreloadedBolt`.

    Raises:
        InputError: Two have the same name.
    """
    labels: set[str] = set()
    for index, load in enumerate(loads):
        if isinstance(load, Bolt):
            if load.label in labels:
                raise InputError(
                    f"there is another bolt '{load.label}'",
                    where=f"load[{index}].name",
                    expected="a name of its own",
                )
            labels.add(load.label)
            with keyed(f"load[{index}]"):
                bolt = PreloadedBolt(load, shanks[index], context, weak_form)
            yield bolt
