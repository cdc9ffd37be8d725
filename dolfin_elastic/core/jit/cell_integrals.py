"""Integrals over cells of forms, and values in cells, by loops of our own.

DOLFINx copies the coefficients of all cells before it assembles a form or evaluates an expression:
the displacement of a linear tetrahedron takes 96 bytes, more than any other array of a residual,
written and read each time.  Here the same kernels of FFCx are called by a loop that copies those of
one cell, or, where there are many, of some cells at once, see `Kernel`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple, Self

import cffi
import numpy as np
from dolfinx import fem
from dolfinx.cpp.fem import Function_float64, pack_constants
from ufl.algorithms import extract_coefficients
from ufl.core.expr import Expr

from dolfin_elastic.core.compat import cells_of_integral
from dolfin_elastic.core.jit.c_code import Code, compile_c
from dolfin_elastic.core.jit.compile import JitOptions, expression_and_module
from dolfin_elastic.core.native.functions import CFunctions, Library, written
from dolfin_elastic.core.types import AnyArray, FloatArray, IndexArray

MANY_CELLS = 10_000
"""Cells of a rank from which lanes pay: half a second of compiling, once, for each kernel saves 0.1
us a linear cell, 0.5 to 2 us a quadratic one each time."""


@dataclass(frozen=True)
class Kernel:
    """A function that FFCx has written for one cell.

    In it a C compiler finds little to do at once: most of a law is straight-line arithmetic.  Where
    there are many cells, each number of it becomes a vector that has one of each of
    `vectorise.LANES` cells, in the same statements; none of them depends on another lane.  Source:
    Sun, Mitchell, Kulkarni, Kloeckner, Ham & Kelly, Int. J. High Perform. Comput. Appl. 34 (2020)
    629, who do so in code of their own generator.

    Attributes:
        address: Of the compiled function.
        arguments: How many it has.
        folder: Of the compiled module, with its code.
        number: Which integral of its form; 0 for an expression.
    """

    address: int
    arguments: int
    folder: Path
    number: int

    def code(self, *, many: bool) -> Code:
        """The kernel as TABULATE(A, w, c, y), of LANES cells at once: the header "kernel.h".

        Vectors A, w, c and y, of the type `lanes`, have a number of each cell.  LANES is 1 where
        there are few cells, or where `vectorise` does not know the kernel's code: then TABULATE
        calls the function at `kernel`, a variable.

        Args:
            many: There are so many cells that lanes pay.
        """

        def make() -> str:
            # Where it is not yet compiled: its expressions take 2 ms to be compiled, too.
            from dolfin_elastic.core.jit.vectorise import kernel_in_lanes, kernel_of_one_cell

            text = kernel_in_lanes(self.folder, self.number) if many else None
            return text or kernel_of_one_cell(self.arguments)

        rules = files(__package__).joinpath("vectorise.py").read_text(encoding="utf-8")
        which = [self.folder.name, self.number] if many else []
        return Code("\n".join(map(str, [rules, written("lanes.h"), self.arguments, *which])), make)


NO_KERNEL = Kernel(0, 7, Path(), 0)
"""Of loops that are given what else a kernel would write."""


_MOST = 4096
"""Numbers of a cell that are evaluated in lanes: 256 kB of the stack, of which most systems give
8 MB. Rules of the highest degrees have more."""


@dataclass(frozen=True)
class _Integral:
    """One integral of a form.

    Attributes:
        kernel: FFCx's function.
        cells: The cells.
        loops: Over them.
    """

    kernel: Kernel
    cells: IndexArray
    loops: CFunctions


@dataclass(frozen=True)
class _Room:
    """The numbers of one cell that a kernel takes.

    Attributes:
        arguments: Their number; where those of the unknowns begin; how many other coefficients
            there are, with five integers of each, as cells.h has them.
        kept: What these are addresses of.
    """

    arguments: tuple[int, int, int, IndexArray]
    kept: list[AnyArray]

    @classmethod
    def of(
        cls,
        coefficients: Sequence[Function_float64],
        w: fem.Function,
        filled: Sequence[fem.Function] = (),
    ) -> Self:
        """For functions of DOLFINx's C++, in the order of the kernel.

        Args:
            filled: Those whose numbers a loop has from elsewhere.
        """
        elsewhere = [one._cpp_object for one in filled]
        first, at = None, 0
        kept, rows = list[AnyArray](), list[int]()
        for one in coefficients:
            space = one.function_space
            if one is w._cpp_object:
                first = at
            elif one not in elsewhere:
                nodes, values = np.ascontiguousarray(space.dofmap.map()), one.x.array
                kept += [nodes, values]
                places = [nodes.ctypes.data, values.ctypes.data]
                rows += [*places, nodes.shape[1], int(space.dofmap.bs), at]
            at += int(space.element.space_dimension)
        if first is None:  # nothing depends on the unknowns
            first, at = at, at + int(w.function_space.element.space_dimension)
        return cls((at, first, len(rows) // 5, np.array(rows, dtype=np.int64)), kept)


class Following(fem.Function):
    """A coefficient that follows from the unknowns: it is found before a kernel reads it."""

    def prepare(self) -> None:
        """Compiles what finds it, once. Collective."""

    def follow(self) -> None:
        """Takes the values that belong to the present unknowns. Not collective."""


def following(coefficients: Iterable[object]) -> list[Following]:
    """Those of a form's coefficients that follow from the unknowns, prepared. Collective."""
    result = [one for one in coefficients if isinstance(one, Following)]
    for one in result:
        one.prepare()
    return result


def can_be_packed(coefficient: object, w: fem.Function) -> bool:
    """Whether the loops here can hand a coefficient of a form to a kernel.

    Args:
        coefficient: As `extract_coefficients` gives it.
    """
    if not isinstance(coefficient, fem.Function):
        return False
    space = coefficient.function_space
    same = space.mesh is w.function_space.mesh
    return same and not space.element.needs_dof_transformations


class CellIntegrals:
    """A compiled form whose integrals are all over cells. Collective to make.

    Args:
        form: Of one test function in the space of the unknowns, or of none; its coefficients
            `can_be_packed`.
        coefficients: All of the form in UFL, of which some may follow from the unknowns.
    """

    def __init__(
        self,
        form: fem.Form,
        w: fem.Function,
        jit_options: JitOptions,
        coefficients: Iterable[object] = (),
    ) -> None:
        self._form, self._w = form, w
        self._following = following(coefficients)
        self._elements = _elements(w)
        self._room = _Room.of(form._cpp_object.coefficients, w)
        self._integrals = [
            _Integral(kernel, cells, _loops_over_cells(w, kernel, jit_options, many=pays(w)))
            for kernel, cells in _kernels(form)
        ]

    @property
    def constants(self) -> FloatArray:
        """The present values of its constants."""
        return pack_constants(self._form._cpp_object)

    @property
    def fields(self) -> list[Function_float64]:
        """Its coefficients beside the unknowns."""
        return [c for c in self._form._cpp_object.coefficients if c is not self._w._cpp_object]

    def add_to(self, out: FloatArray, constants: FloatArray | None = None) -> None:
        """Adds the vector of a form with a test function. Not collective.

        Args:
            out: Local entries, those of ghosts too.
            constants: From `constants`, of another time; None: the present ones.
        """
        self._call("add_vector", self.constants if constants is None else constants, out)

    def value(self) -> float:
        """The value of a form without arguments over this rank's cells. Not collective."""
        out = np.zeros(1)
        self._call("add_scalar", self.constants, out)
        return float(out[0])

    def _call(self, loop: str, constants: FloatArray, out: FloatArray) -> None:
        for coefficient in self._following:
            coefficient.follow()
        w = self._w.x.array
        unknowns = (*self._elements, len(w), w, *self._room.arguments)
        for one in self._integrals:
            where = (one.kernel.address, len(one.cells), one.cells)
            one.loops.call(loop, *where, *unknowns, len(constants), constants, out)


class Loops(NamedTuple):
    """Further loops in C that use a kernel.

    Attributes:
        file: In `core.native`; it includes cells.h.
        sizes: Macros, by name.
    """

    file: str
    sizes: dict[str, int]


class CellExpression:
    """An expression without arguments, compiled, at points in cells. Collective to make.

    Where a coefficient cannot be packed, DOLFINx evaluates it, see `can_be_packed`.

    Args:
        points: Of the reference cell, shape (points, dim).
        loops: What is to be done with it; by default it can only be evaluated, and else not,
            where it has a kernel.
        follows: Coefficients that follow from the unknowns are found before.
        filled: Coefficients whose numbers these loops fill in, see `place_of`.

    Attributes:
        size: Numbers in a cell: points times components.
        kernel: FFCx's function; None where DOLFINx evaluates it.
        in_lanes: It has code for several cells at once.
    """

    def __init__(
        self,
        expression: Expr,
        points: FloatArray,
        w: fem.Function,
        jit_options: JitOptions,
        loops: Loops | None = None,
        *,
        follows: bool = True,
        filled: Sequence[fem.Function] = (),
    ) -> None:
        comm = w.function_space.mesh.comm
        self._expression, library = expression_and_module(comm, expression, points, jit_options)
        compiled = self._expression.ufcx_expression
        coefficients = extract_coefficients(self._expression.ufl_expression)
        positions = compiled.original_coefficient_positions
        used = [coefficients[positions[i]] for i in range(compiled.num_coefficients)]
        self._used, self._following = used, following(used) if follows else []
        self._w, self.kernel, self.in_lanes = w, None, False
        if all(can_be_packed(one, w) for one in used):
            self.kernel = _function(compiled.tabulate_tensor_float64, library, 0)
        self._room = _Room.of([one._cpp_object for one in used], w, filled)
        self.size = int(compiled.num_points) * int(self._expression.value_size)
        if self.kernel is None and loops is None:
            return
        self._elements, kernel = _elements(w), self.kernel or NO_KERNEL
        many = self.kernel is not None and pays(w) and self.size <= _MOST
        self.loops = _loops_over_cells(w, kernel, jit_options, many=many, loops=loops)
        self.in_lanes = self.loops.call("width") > 1

    @property
    def constants(self) -> FloatArray:
        """Values of the constants of the expression."""
        return pack_constants(self._expression._cpp_object)

    def call(self, name: str, cells: IndexArray, *arguments: int | AnyArray) -> int:
        """Calls one of the loops that it was made with, over some cells. Not collective.

        Args:
            name: Of the function, which takes the kernel, or 0, the cells, and what cells.h says.
            cells: Local cells.
            arguments: What else it takes.
        """
        for one in self._following:
            one.follow()
        w, constants, address = self._w.x.array, self.constants, (self.kernel or NO_KERNEL).address
        where = (address, len(cells), cells, *self._elements, len(w), w)
        room = self._room.arguments
        return self.loops.call(name, *where, *room, len(constants), constants, *arguments)

    @property
    def fields(self) -> list[fem.Function]:
        """Its coefficients beside the unknowns."""
        return [one for one in self._used if one is not self._w]

    def place_of(self, coefficient: fem.Function) -> int:
        """Where the numbers of a coefficient begin among those of a cell; below 0: it has none."""
        at = 0
        for one in self._used:
            if one is coefficient:
                return at
            at += int(one.function_space.element.space_dimension)
        return -1

    def eval(self, cells: IndexArray, out: FloatArray | None = None) -> FloatArray:
        """Values in cells, shape (cells, size). Not collective.

        Args:
            cells: Local cells.
            out: Room for them, of that shape.
        """
        out = np.empty((len(cells), self.size)) if out is None else out
        for one in self._following:
            one.follow()
        if self.kernel is None:
            values = self._expression.eval(self._w.function_space.mesh, cells)
            out[:] = values.reshape(out.shape)  # 0.11 has axes of points and of components
            return out
        cells = np.ascontiguousarray(cells, dtype=np.int32)
        constants = self.constants
        w = self._w.x.array
        where = (self.kernel.address, len(cells), cells, *self._elements, len(w), w)
        room = self._room.arguments
        self.loops.call("evaluate", *where, *room, len(constants), constants, self.size, out)
        return out


def _elements(w: fem.Function) -> tuple[int, IndexArray, int, FloatArray, IndexArray]:
    """Geometry nodes of cells, their places, with the number of both; nodes of unknowns."""
    mesh, dofmap = w.function_space.mesh, w.function_space.dofmap
    corners, dofs = (np.ascontiguousarray(m) for m in (mesh.geometry.dofmap, dofmap.list))
    return len(corners), corners, len(mesh.geometry.x), mesh.geometry.x, dofs


def pays(w: fem.Function) -> bool:
    """Whether there are so many cells that code for several at once pays; the same on all ranks."""
    mesh = w.function_space.mesh
    return mesh.topology.index_map(mesh.topology.dim).size_global >= MANY_CELLS * mesh.comm.size


def _loops_over_cells(
    w: fem.Function,
    kernel: Kernel,
    jit_options: JitOptions,
    *,
    many: bool,
    loops: Loops | None = None,
) -> CFunctions:
    """The loops for a kernel, by default of cells.c; `many` cells pay for lanes. Collective."""
    _, corners, _, _, dofs = _elements(w)
    sizes = {"NG": corners.shape[1], "NW": dofs.shape[1], "BS": w.function_space.dofmap.bs}
    file, further = loops or ("cells.c", {})
    code = kernel.code(many=many)
    comm = w.function_space.mesh.comm
    return compile_c(comm, file, sizes | further, jit_options, kernel=code)


def _function(function: cffi.FFI.CData, library: Library, number: int) -> Kernel:
    address = int(library.ffi.cast("intptr_t", function))
    arguments = len(library.ffi.typeof(function).args)
    return Kernel(address, arguments, Path(library.__file__).parent, number)


def _kernels(form: fem.Form) -> list[tuple[Kernel, IndexArray]]:
    """The functions of a form's integrals over cells, with their cells."""
    compiled = form.ufcx_form
    offsets, result = compiled.form_integral_offsets, []
    for k in range(offsets[0], offsets[1]):  # those of cells stand first
        tabulate = compiled.form_integrals[k].tabulate_tensor_float64
        cells = np.ascontiguousarray(cells_of_integral(form, k))
        result.append((_function(tabulate, form.module, k), cells))
    return result
