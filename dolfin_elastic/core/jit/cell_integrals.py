"""Integrals and values in cells of what has no coefficient but the vector of all unknowns.

DOLFINx copies the coefficients of all cells before it assembles a form or evaluates an expression:
the displacement of a linear tetrahedron takes 96 bytes, more than any other array of a residual,
written and read each time.  Here the same kernels of FFCx are called by a loop that copies those of
one cell, or, where there are many, of some cells at once, see `Kernel`.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

import cffi
import numpy as np
from dolfinx import fem
from dolfinx.cpp.fem import pack_constants
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


class CellIntegrals:
    """A compiled form whose integrals are all over cells. Collective to make.

    Args:
        form: Of one test function in the space of the unknowns, or of none; it has no coefficient
            but the unknowns.
    """

    def __init__(self, form: fem.Form, w: fem.Function, jit_options: JitOptions) -> None:
        self._form, self._w = form, w
        self._elements = _elements(w)
        self._packed, self._first = _room(form, w)
        self._integrals = [
            _Integral(kernel, cells, _loops_over_cells(w, kernel, jit_options, many=pays(w)))
            for kernel, cells in _kernels(form)
        ]

    @property
    def constants(self) -> FloatArray:
        """The present values of its constants."""
        return pack_constants(self._form._cpp_object)

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
        w = self._w.x.array
        unknowns = (*self._elements, len(w), w, self._packed, self._first)
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

    Where it has another coefficient than the unknowns, DOLFINx evaluates it.

    Args:
        points: Of the reference cell, shape (points, dim).
        loops: What is to be done with it; by default it can only be evaluated, and else not,
            where it has a kernel.

    Attributes:
        size: Numbers in a cell: points times components.
        kernel: FFCx's function, which has no coefficient but the unknowns; else None.
        in_lanes: It has code for several cells at once.
    """

    def __init__(
        self,
        expression: Expr,
        points: FloatArray,
        w: fem.Function,
        jit_options: JitOptions,
        loops: Loops | None = None,
    ) -> None:
        comm = w.function_space.mesh.comm
        self._expression, library = expression_and_module(comm, expression, points, jit_options)
        self._w, self.kernel, self.in_lanes = w, _kernel(self._expression, library, w), False
        compiled = self._expression.ufcx_expression
        self.size = int(compiled.num_points) * int(self._expression.value_size)
        if self.kernel is None and loops is None:
            return
        self._elements, kernel = _elements(w), self.kernel or NO_KERNEL
        many = self.kernel is not None and pays(w) and self.size <= _MOST
        self.loops = _loops_over_cells(w, kernel, jit_options, many=many, loops=loops)
        self._packed = w.function_space.element.space_dimension
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
        w, constants, address = self._w.x.array, self.constants, (self.kernel or NO_KERNEL).address
        where = (address, len(cells), cells, *self._elements, len(w), w)
        return self.loops.call(name, *where, len(constants), constants, *arguments)

    def eval(self, cells: IndexArray, out: FloatArray | None = None) -> FloatArray:
        """Values in cells, shape (cells, size). Not collective.

        Args:
            cells: Local cells.
            out: Room for them, of that shape.
        """
        out = np.empty((len(cells), self.size)) if out is None else out
        if self.kernel is None:
            values = self._expression.eval(self._w.function_space.mesh, cells)
            out[:] = values.reshape(out.shape)  # 0.11 has axes of points and of components
            return out
        cells = np.ascontiguousarray(cells, dtype=np.int32)
        constants = self.constants
        w = self._w.x.array
        where = (self.kernel.address, len(cells), cells, *self._elements, len(w), w)
        sizes = (self._packed, 0, len(constants))
        self.loops.call("evaluate", *where, *sizes, constants, self.size, out)
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


def _kernel(expression: fem.Expression, library: Library, w: fem.Function) -> Kernel | None:
    """The function of a compiled expression; None where it has other coefficients than w."""
    compiled = expression.ufcx_expression
    positions = compiled.original_coefficient_positions
    coefficients = extract_coefficients(expression.ufl_expression)
    if any(coefficients[positions[i]] is not w for i in range(compiled.num_coefficients)):
        return None
    return _function(compiled.tabulate_tensor_float64, library, 0)


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


def _room(form: fem.Form, w: fem.Function) -> tuple[int, int]:
    """Coefficients of one cell, and where those of the unknowns begin among them."""
    sizes = [c.function_space.element.space_dimension for c in form._cpp_object.coefficients]
    ours = [one is w._cpp_object for one in form._cpp_object.coefficients]
    own = w.function_space.element.space_dimension
    if not any(ours):  # no integral depends on the unknowns
        return sum(sizes) + own, sum(sizes)
    return sum(sizes), sum(sizes[: ours.index(True)])
