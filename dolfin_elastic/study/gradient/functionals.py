"""Numbers of an equilibrium with a derivative by its unknowns.

Extremes have none, where two places share them; the gradient of a largest value is that of

    (1/|part| int f^p dV)^(1/p),    p = 16,

which is smooth, below the maximum, and tends to it as p grows.  Source: P. Duysinx and O. Sigmund,
7th AIAA/USAF/NASA/ISSMO Symposium on Multidisciplinary Analysis and Optimization (1998), 1501.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from functools import cached_property

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError, nearest
from dolfin_elastic.core.ghosts import assembled, summed
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.mesh.geometry.curved import shape_functions
from dolfin_elastic.mesh.geometry.locate import LocatedPoint, locate
from dolfin_elastic.model.kinematics import WeightedMeasure, weight
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.spaces import part_nodes
from dolfin_elastic.results.cell_fields import cell_components
from dolfin_elastic.results.derived.part_numbers import has_length, sides_of
from dolfin_elastic.results.fields import FIELDS, component_names
from dolfin_elastic.solvers.assembly.assembler import Assembler, compiled, integral
from dolfin_elastic.study.wanted import SAME, Wanted

NORM = 16
"""Exponent of the norm that stands for a largest value, unless another is given."""
_COMPONENT = re.compile(r"(displacement|reaction)(?:_([xyz]))?")
_NORM = re.compile(r"norm:([1-9]\d*)\s+(.*)", re.DOTALL)
_OPTION = "--of"


class Functional(ABC):
    """One number of the present state of a problem.  All of it is collective.

    Attributes:
        name: What is told, such as "norm:16 von_mises on fillet".
        unit: In SI.
        form: The integral on which it depends, for derivatives by the positions of nodes and by
            values of cells; None: it does not depend on them but by the unknowns.
    """

    form: ufl.Form | None = None

    def __init__(self, name: str, unit: str, problem: Problem) -> None:
        self.name, self.unit, self.problem = name, unit, problem

    @abstractmethod
    def value(self, forces: FloatArray) -> float:
        """Its value.

        Args:
            forces: Out-of-balance nodal forces, owned entries of all unknowns [N].
        """

    @abstractmethod
    def by_unknowns(self, assembler: Assembler) -> FloatArray:
        """dQ/dw at owned entries, at the unknowns at which `value` was asked for last."""

    def by_positions(self, V: fem.FunctionSpace) -> FloatArray | None:
        """What it depends on the nodes' positions beside `form`, owned entries; None: nothing.

        Args:
            V: Space of the positions, a vector at each node of the geometry.
        """
        return None

    def motion(self) -> FloatArray | None:
        """The motion of owned entries of which it is the work of nodal forces; None: of none."""
        return None

    @property
    def factor(self) -> float:
        """dQ over the change of `form`, where `value` was asked for last."""
        return 1.0


class IntegralFunctional(Functional):
    """An integral, a mean or the norm of a field over a part, or the strain energy.

    Args:
        form: The integral of the field, of its p-th power in a norm.
        power: p; 1 of others.
        size: Integral by which it is divided; None: by nothing.
        along: Constant of the form, a vector: the integral is that of the components of the field
            along it, and the length of the row of their integrals is the number; None: of others.
    """

    def __init__(
        self,
        name: str,
        unit: str,
        problem: Problem,
        form: ufl.Form,
        *,
        power: int = 1,
        size: ufl.Form | None = None,
        along: fem.Constant | None = None,
    ) -> None:
        super().__init__(name, unit, problem)
        self._along = along
        self._power, self._size, self._mean = power, 1.0, problem.constant(0.0)
        self._integral = form
        self._value, *sizes = compiled(problem, [form, *([] if size is None else [size])])
        # The change of a mean is that of the integral of what exceeds it.
        self.form = form if size is None else form - self._mean * size
        self._size = integral(problem, sizes[0]) if sizes else 1.0

    def value(self, forces: FloatArray) -> float:
        """See `Functional`."""
        if self._along is not None:
            parts = [self._component(axis) for axis in np.eye(len(self._along.value))]
            self._along.value[:] = _direction(np.array(parts), None)
        mean = integral(self.problem, self._value) / self._size
        self._mean.value = mean
        return float(mean ** (1 / self._power)) if self._power > 1 else mean

    def _component(self, axis: FloatArray) -> float:
        assert self._along is not None
        self._along.value[:] = axis
        return integral(self.problem, self._value)

    @property
    def factor(self) -> float:
        """See `Functional`."""
        mean, p = float(self._mean.value), self._power
        if p > 1 and mean == 0.0:
            raise InputError(
                f"'{self.name}' is 0, where a norm has no derivative",
                where=_OPTION,
                expected="the mean of a component, or a part that is loaded",
            )
        return (mean ** (1 / p - 1) / p if p > 1 else 1.0) / self._size

    def by_unknowns(self, assembler: Assembler) -> FloatArray:
        """See `Functional`."""
        return self.factor * assembled(self._slope, self.problem.W)

    @cached_property
    def _slope(self) -> fem.Form:
        test = ufl.TestFunction(self.problem.W)
        return compiled(self.problem, [ufl.derivative(self._integral, self.problem.w, test)])[0]


class NodalFunctional(Functional):
    """A weighted sum of nodal displacements: at a point, or the mean of the nodes of a part.

    Args:
        weights: Local nodes of this rank and the weight of each; ranks are summed up.
        component: Number of the component; None: the length of the sum.
        point: Where it is evaluated, which stays there when nodes move; None: it is a mean.
    """

    def __init__(
        self,
        name: str,
        problem: Problem,
        weights: tuple[IndexArray, FloatArray],
        component: int | None,
        point: LocatedPoint | None = None,
    ) -> None:
        super().__init__(name, "m", problem)
        self._nodes, self._weights, self._component = *weights, component
        self._point = point
        self._along: FloatArray = np.zeros(problem.body.dim)

    def value(self, forces: FloatArray) -> float:
        """See `Functional`."""
        problem, dim = self.problem, self.problem.body.dim
        rows = problem.u.x.array.reshape(-1, dim)[self._nodes]
        mean: FloatArray = np.asarray(
            total(problem.body.comm, self._weights @ rows), dtype=np.float64
        )
        self._along = _direction(mean, self._component)
        return float(self._along @ mean)

    def by_unknowns(self, assembler: Assembler) -> FloatArray:
        """See `Functional`."""
        forces = self._weights[:, None] * self._along
        rows = summed(self.problem.V.dofmap.index_map, self._nodes, forces)
        return at_displacements(assembler, rows)

    def by_positions(self, V: fem.FunctionSpace) -> FloatArray | None:
        """See `Functional`: nodes that move carry the field past the point, dQ = -grad u dX."""
        if self._point is None:
            return None
        mesh, dim = self.problem.body.mesh, self.problem.body.dim
        nodes, rows = np.empty(0, dtype=np.int32), np.empty((0, dim))
        if self._point.cell >= 0:
            cell, local = np.array([self._point.cell], dtype=np.int32), self._point.local[None]
            slope = fem.Expression(ufl.grad(self.problem.u), local, comm=MPI.COMM_SELF)
            slopes = slope.eval(mesh, cell).reshape(dim, dim)
            nodes = V.dofmap.list[cell[0]]
            rows = -np.outer(shape_functions(mesh, local)[0], self._along @ slopes)
        whole = summed(V.dofmap.index_map, nodes, rows)
        return whole[: V.dofmap.index_map.size_local].reshape(-1)


def at_displacements(assembler: Assembler, rows: FloatArray) -> FloatArray:
    """Rows of local nodes of the displacement, shape (nodes, dim), as owned entries of unknowns."""
    result, dofs = np.zeros(assembler.size), assembler.displacement_dofs
    result[dofs] = rows.reshape(-1)[: len(dofs)]
    return result


class ReactionFunctional(Functional):
    """The force of a support on the body, or a component of it.

    Args:
        entries: Owned entries of all unknowns at which the support holds the body.
        components: Number of the component of each.
        component: Which one is told; None: the length of the force.
    """

    def __init__(
        self,
        name: str,
        problem: Problem,
        entries: tuple[IndexArray, IndexArray],
        component: int | None,
    ) -> None:
        super().__init__(name, "N", problem)
        self._entries, self._components, self._component = *entries, component
        self._along: FloatArray = np.zeros(problem.body.dim)

    def value(self, forces: FloatArray) -> float:
        """See `Functional`."""
        dim, comm = self.problem.body.dim, self.problem.body.comm
        sums = np.bincount(self._components, forces[self._entries], minlength=dim)
        force: FloatArray = np.asarray(total(comm, sums), dtype=np.float64)
        self._along = _direction(force, self._component)
        return float(self._along @ force)

    def motion(self) -> FloatArray:
        """See `Functional`: the support moved by one metre."""
        size = self.problem.W.dofmap.index_map.size_local * self.problem.W.dofmap.index_map_bs
        result = np.zeros(size)
        result[self._entries] = self._along[self._components]
        return result

    def by_unknowns(self, assembler: Assembler) -> FloatArray:
        """See `Functional`."""
        motion = self.motion()
        entries = np.flatnonzero(motion).astype(np.int32)
        return assembler.residual.along(entries, motion[entries])


def _direction(vector: FloatArray, component: int | None) -> FloatArray:
    """Along which the length of a vector changes, or a component."""
    if component is not None:
        return np.asarray(np.eye(len(vector))[component])
    size = float(np.linalg.norm(vector))
    return np.asarray(vector / size if size else np.eye(len(vector))[0])


# --- from their names ---


def functionals(
    names: Sequence[str], problem: Problem, probes: Mapping[str, Sequence[float]]
) -> list[Functional]:
    """Numbers by the names that `converge --until` takes, too. Collective.

    Args:
        names: Such as "displacement_z of tip", "reaction_x of left", "strain_energy",
            "mean von_mises on fillet", "integral energy_density on core", "von_mises on fillet".
        probes: Name to the place of probes that are points [m].

    Raises:
        InputError: There is no such number, or it has no derivative.
    """
    return [_functional(name, problem, probes) for name in names]


def _functional(text: str, problem: Problem, probes: Mapping[str, Sequence[float]]) -> Functional:
    text = " ".join(text.split())
    norm = _NORM.fullmatch(text)
    if norm is None and text.startswith("norm:"):
        raise InputError(
            f"'{text}' is no norm",
            where=_OPTION,
            expected="a whole number from 1 on, such as norm:16 von_mises on fillet",
        )
    power = int(norm[1]) if norm else NORM
    wanted = _read(norm[2] if norm else text, problem, probes)
    if SAME.get(wanted.name, wanted.name) == "strain_energy" and not wanted.part:
        return _energy(problem)
    kind = _COMPONENT.fullmatch(wanted.name)
    component = None if kind is None or kind[2] is None else "xyz".index(kind[2])
    stem, _, axis = wanted.name.partition("_")
    known = "xyz"[: problem.body.dim]
    if stem in ("displacement", "reaction") and axis not in ("", *known):
        raise InputError(
            f"the body has no component '{wanted.name}'",
            where=_OPTION,
            expected=" or ".join(f"{stem}_{one}" for one in known),
        )
    if kind is not None and kind[1] == "reaction":
        return _reaction(text, wanted, problem, component)
    kinds = problem.body.kinds(wanted.part) if wanted.part else {"region"}
    if (
        kind is not None
        and not wanted.reduction
        and (wanted.part in probes or "region" not in kinds)
    ):
        if wanted.part in probes:
            point = locate(problem.body, {_OPTION: probes[wanted.part]})[_OPTION]
            weights = _around(problem, point)
            return NodalFunctional(text, problem, weights, component, point)
        if not kinds:
            raise wanted.unknown("no part and no probe", wanted.part, _known(problem, probes))
        if "surface" not in kinds:
            return NodalFunctional(text, problem, _mean(problem, wanted.part), component)
    if component is not None and not (wanted.reduction or norm):
        raise InputError(
            f"'{text}' has no derivative",
            where=_OPTION,
            expected=f"'mean {wanted.name} on {wanted.part}'"
            if wanted.part
            else _examples(problem, probes, wanted.name),
        )
    if wanted.part in probes:
        raise InputError(
            f"'{text}' has no derivative: {wanted.part} is a point",
            where=_OPTION,
            expected=_examples(problem, probes, wanted.name),
        )
    wanted.check(problem.body, (), problem.constraints.labels)
    bare = norm[2] if norm else text
    return _of_field(bare, wanted, problem, kinds, power)


def _read(text: str, problem: Problem, probes: Mapping[str, Sequence[float]]) -> Wanted:
    """What a name asks for; one of no field is answered with numbers of this problem."""
    try:
        wanted = Wanted.read(text, _OPTION)
        if SAME.get(wanted.name, wanted.name) == "strain_energy":
            return wanted
        field = wanted.quantity.name
        components = component_names(field, FIELDS[field].columns)
        if field in ("displacement", "reaction") or wanted.name in (field, *components):
            return wanted
    except InputError:  # of all fields that there are
        pass
    axes = "xyz"[: problem.body.dim]
    fields = [n for n, one in FIELDS.items() if one.formula is not None and one.of_tensor is None]
    vectors = [f"{stem}_{axis}" for stem in ("displacement", "reaction") for axis in axes]
    names = ["strain_energy", "displacement", "reaction", *vectors, *fields]
    word = re.split(r"\s+(?:on|of|at)\s+", text)[0].split()[-1:] or [""]
    hint = nearest(word[0], names)
    if word[0] in names or not hint.startswith("did"):
        hint = f"for example {_examples(problem, probes, 'von_mises')}, or strain_energy"
    raise InputError(f"'{text}' is no number with a derivative", where=_OPTION, expected=hint)


def _examples(problem: Problem, probes: Mapping[str, Sequence[float]], field: str) -> str:
    """Numbers of a problem: at a probe, of a support, and of a field on a part."""
    axis, parts = "xyz"[problem.body.dim - 1], problem.body.parts
    rows = {
        f"displacement_{axis} of": probes,
        f"reaction_{axis} of": problem.constraints.labels,
        f"mean {field} on": [*parts["surface"], *parts["region"]],
    }
    return ", ".join(f"'{words} {name}'" for words, names in rows.items() for name in [*names][:1])


def _known(problem: Problem, probes: Mapping[str, Sequence[float]]) -> list[str]:
    parts = (name for named in problem.body.parts.values() for name in named)
    return list(dict.fromkeys([*probes, *parts]))


def _energy(problem: Problem) -> Functional:
    form = problem.weak_form.strain_energy
    if form is None:
        raise InputError("a law has no strain energy", where=_OPTION, expected="another number")
    return IntegralFunctional("strain_energy", "J", problem, form)


def _reaction(text: str, wanted: Wanted, problem: Problem, component: int | None) -> Functional:
    held = problem.constraints.labels
    if not wanted.part:
        raise InputError(
            f"'{text}' is of no support", where=_OPTION, expected=f"{text} of {' or '.join(held)}"
        )
    if wanted.part not in held:
        raise wanted.unknown("no support that prescribes displacements", wanted.part, held)
    if problem.constraints.combined:
        raise InputError(
            f"'{text}' has no derivative here: supports along other directions than the axes, "
            "or ties, share the forces",
            where=_OPTION,
            expected="a displacement, a stress or the strain energy",
        )
    own = problem.constraints.reaction_dofs[wanted.part]
    entries = np.asarray(problem.unknowns.mixed_dofs(own), dtype=np.int32)
    parts = np.asarray(own % problem.body.dim, dtype=np.int32)
    return ReactionFunctional(text, problem, (entries, parts), component)


def _around(problem: Problem, point: LocatedPoint) -> tuple[IndexArray, FloatArray]:
    """Local nodes around a point, and their shape functions there; none on other ranks. Local."""
    if point.cell < 0:
        return np.empty(0, dtype=np.int32), np.empty(0)
    table = problem.V.element.basix_element.tabulate(0, point.local[None])[0, 0, :, 0]
    return problem.V.dofmap.list[point.cell], np.asarray(table, dtype=np.float64)


def _mean(problem: Problem, part: str) -> tuple[IndexArray, FloatArray]:
    """Owned nodes of edges or points with equal weights. Collective."""
    nodes = part_nodes(problem.body, problem.V, part)
    own = nodes[nodes < problem.V.dofmap.index_map.size_local]
    return own, np.full(len(own), 1 / total(problem.body.comm, len(own)))


def _of_field(
    text: str, wanted: Wanted, problem: Problem, kinds: Collection[str], power: int
) -> Functional:
    """A mean, an integral or a norm of a field."""
    reduction = wanted.reduction or "max"
    quantity = wanted.quantity
    if reduction not in ("mean", "integral", "max") or wanted.name == "safety_factor":
        raise InputError(
            f"'{text}' has no derivative",
            where=_OPTION,
            expected="a mean, an integral or norm:16 of a stress, strain or displacement",
        )
    part, surface = wanted.part or None, "region" not in kinds
    rows = _components(problem, quantity.name)
    size = max((len(row) for row in rows if row), default=0)
    if not size:
        raise InputError(
            f"'{quantity.name}' has no derivative",
            where=_OPTION,
            expected="displacement, von_mises, pressure, energy_density, or a component of a "
            "stress or strain such as green_strain_xx",
        )
    number, smooth = quantity.component(size), reduction == "max"
    if smooth and number is None and not has_length(quantity.name, FIELDS[quantity.name]):
        raise InputError(
            f"'{wanted.name}' has several components",
            where=_OPTION,
            expected=f"such as '{component_names(quantity.name, size)[0]}'",
        )
    along = problem.constant([0.0] * size) if number is None and not smooth else None

    def chosen(row: Sequence[Expr]) -> Expr:
        if number is not None:
            return row[number]
        if along is not None:
            return ufl.dot(along, ufl.as_vector(row))
        return ufl.sqrt(sum(one * one for one in row))

    measures = _measures(problem, "surface" if surface else "region", part)
    exponent = power if smooth else 1
    form = sum(
        (
            (chosen(row) ** exponent if smooth else chosen(row)) * measure
            for row, measure in zip(rows, measures, strict=True)
            if row and measure is not None
        ),
        ufl.Form([]),
    )
    one = problem.constant(1.0)
    whole = sum((one * measure for measure in measures if measure is not None), ufl.Form([]))
    name = f"norm:{power} {text.removeprefix('max ')}" if smooth else text
    unit = FIELDS[quantity.name].unit
    if reduction == "integral":
        over = "m^2" if surface else "m^3"
        return IntegralFunctional(name, f"{unit} {over}".strip(), problem, form, along=along)
    return IntegralFunctional(name, unit, problem, form, power=exponent, size=whole, along=along)


def _components(problem: Problem, name: str) -> list[list[Expr] | None]:
    """Of a field in each material region; None: they have no formula in UFL."""
    if name == "displacement":
        u = problem.context.u
        return [[u[i] for i in range(problem.body.dim)]] * len(problem.regions)
    if FIELDS[name].formula is None or FIELDS[name].of_tensor is not None:
        return [None] * len(problem.regions)
    return [cell_components(problem, one, problem.w, [name])[0] for one in problem.regions]


def _measures(problem: Problem, kind: str, part: str | None) -> list[WeightedMeasure | None]:
    """The part in each material region as a measure; None where it has nothing of it."""
    sides = sides_of(problem, kind, part)
    data, here = [], []
    for number, region in enumerate(problem.regions, start=1):
        own = sides[np.isin(sides[:, 0], region.cells)]
        cells = own.reshape(-1) if kind == "surface" else own[:, 0]
        data.append((number, np.asarray(cells, dtype=np.int32)))
        here.append(bool(total(problem.body.comm, len(own))))
    over = ufl.Measure(
        "ds" if kind == "surface" else "dx",
        domain=problem.body.mesh,
        subdomain_data=data,
        metadata={"quadrature_degree": 2 * problem.context.order},
    )
    depth = None if problem.thickness == 1.0 else problem.constant(problem.thickness)
    rho = weight(problem.geometry, problem.X, depth)
    return [
        WeightedMeasure(rho, over(number)) if found else None
        for number, found in enumerate(here, start=1)
    ]
