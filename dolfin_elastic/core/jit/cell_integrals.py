"""Integrals and values in cells of what has no coefficient but the vector of all unknowns.

DOLFINx copies the coefficients of all cells before it assembles a form or evaluates an expression:
the displacement of a linear tetrahedron takes 96 bytes, more than any other array of a residual,
written and read each time.  Here the same kernels of FFCx are called by a loop that copies those of
one cell, or, where there are many, of some cells at once, see `lanes`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import cffi
import numpy as np
from dolfinx import fem
from dolfinx.cpp.fem import pack_constants
from ufl.algorithms import extract_coefficients
from ufl.core.expr import Expr

from dolfin_elastic.core.compat import cells_of_integral
from dolfin_elastic.core.jit import lanes
from dolfin_elastic.core.jit.c_code import CFunctions, compile_c
from dolfin_elastic.core.jit.compile import JitOptions, Library, expression_and_module
from dolfin_elastic.core.jit.lanes import Kernel
from dolfin_elastic.core.types import AnyArray, FloatArray, IndexArray

DECLARATIONS = """
int64_t width(void);
int64_t add_vector(int64_t kernel, int64_t count, const int32_t* cells, const int32_t* corners,
                   const double* x, const int32_t* dofs, const double* unknowns, int64_t packed,
                   int64_t first, int64_t known, const double* constants, double* out);
int64_t add_scalar(int64_t kernel, int64_t count, const int32_t* cells, const int32_t* corners,
                   const double* x, const int32_t* dofs, const double* unknowns, int64_t packed,
                   int64_t first, int64_t known, const double* constants, double* out);
int64_t evaluate(int64_t kernel, int64_t count, const int32_t* cells, const int32_t* corners,
                 const double* x, const int32_t* dofs, const double* unknowns, int64_t packed,
                 int64_t first, int64_t known, const double* constants, int64_t size, double* out);
"""

TAKING = r"""
#define LANE(values, entry, l) ((values)[(entry) * LANES + (l)])

/* Constants, the same in all lanes. */
static inline void spread(int64_t count, const double* values, double* out)
{
  for (int64_t i = 0; i < count; i++)
    for (int l = 0; l < LANES; l++)
      LANE(out, i, l) = values[i];
}

/* Of the next LANES cells, or of count and the last of them again.  Unknowns stand in rows of BS at
   ND nodes of a cell, its geometry has NG nodes. */
static inline void take_cells(int64_t count, const int32_t* cells, const int32_t* corners,
                              const double* x, const int32_t* dofs, const double* unknowns,
                              double* y, double* w)
{
  for (int l = 0; l < LANES; l++)
  {
    const int64_t c = cells[l < count ? l : count - 1];
    for (int m = 0; m < NG; m++)
      for (int i = 0; i < 3; i++)
        LANE(y, 3 * m + i, l) = x[3 * (int64_t)corners[c * NG + m] + i];
    for (int a = 0; a < ND; a++)
      for (int i = 0; i < BS; i++)
        LANE(w, BS * a + i, l) = unknowns[BS * (int64_t)dofs[c * ND + a] + i];
  }
}

#if LANES == 8
/* Entry l of in[k] becomes entry k of out[l]. */
INLINE void transpose(const lanes* in, lanes* out)
{
  lanes t[8], u[8];
  for (int k = 0; k < 8; k += 2)
  {
    t[k] = __builtin_shuffle(in[k], in[k + 1], (marks){0, 8, 2, 10, 4, 12, 6, 14});
    t[k + 1] = __builtin_shuffle(in[k], in[k + 1], (marks){1, 9, 3, 11, 5, 13, 7, 15});
  }
  for (int k = 0; k < 8; k += k % 4 == 1 ? 3 : 1)
  {
    u[k] = __builtin_shuffle(t[k], t[k + 2], (marks){0, 1, 8, 9, 4, 5, 12, 13});
    u[k + 2] = __builtin_shuffle(t[k], t[k + 2], (marks){2, 3, 10, 11, 6, 7, 14, 15});
  }
  for (int k = 0; k < 4; k++)
  {
    out[k] = __builtin_shuffle(u[k], u[k + 4], (marks){0, 1, 2, 3, 8, 9, 10, 11});
    out[k + 4] = __builtin_shuffle(u[k], u[k + 4], (marks){4, 5, 6, 7, 12, 13, 14, 15});
  }
}

/* The values of each cell in a row. */
static inline void put_cells(int64_t some, int64_t size, const lanes* values, double* out)
{
  int64_t j = 0;
  for (; j + 8 <= size; j += 8)
  {
    lanes rows[8];
    transpose(values + j, rows);
    for (int64_t l = 0; l < some; l++)
      memcpy(out + l * size + j, rows + l, sizeof(lanes));
  }
  for (; j < size; j++)
    for (int64_t l = 0; l < some; l++)
      out[l * size + j] = LANE((const double*)values, j, l);
}
#else
static inline void put_cells(int64_t some, int64_t size, const lanes* values, double* out) {}
#endif
"""
"""After a kernel's code: what it needs to know of cells."""

SOURCE = r"""
int64_t width(void)
{
  return LANES;
}

int64_t add_vector(int64_t kernel, int64_t count, const int32_t* cells, const int32_t* corners,
                   const double* x, const int32_t* dofs, const double* unknowns, int64_t packed,
                   int64_t first, int64_t known, const double* constants, double* out)
{
  lanes y[3 * NG], w[packed], c[known + 1], b[BS * ND];
  memset(w, 0, sizeof(w));
  spread(known, constants, (double*)c);
  for (int64_t n = 0; n < count; n += LANES)
  {
    const int64_t some = count - n < LANES ? count - n : LANES;
    take_cells(some, cells + n, corners, x, dofs, unknowns, (double*)y, (double*)(w + first));
    memset(b, 0, sizeof(b));
    TABULATE(b, w, c, y);
    for (int l = 0; l < some; l++)
      for (int a = 0; a < ND; a++)
        for (int i = 0; i < BS; i++)
          out[BS * (int64_t)dofs[(int64_t)cells[n + l] * ND + a] + i]
              += LANE((const double*)b, BS * a + i, l);
  }
  return 0;
}

int64_t add_scalar(int64_t kernel, int64_t count, const int32_t* cells, const int32_t* corners,
                   const double* x, const int32_t* dofs, const double* unknowns, int64_t packed,
                   int64_t first, int64_t known, const double* constants, double* out)
{
  lanes y[3 * NG], w[packed], c[known + 1], value[1];
  memset(w, 0, sizeof(w));
  spread(known, constants, (double*)c);
  for (int64_t n = 0; n < count; n += LANES)
  {
    const int64_t some = count - n < LANES ? count - n : LANES;
    take_cells(some, cells + n, corners, x, dofs, unknowns, (double*)y, (double*)(w + first));
    memset(value, 0, sizeof(value));
    TABULATE(value, w, c, y);
    for (int l = 0; l < some; l++)
      *out += LANE((const double*)value, 0, l);
  }
  return 0;
}

int64_t evaluate(int64_t kernel, int64_t count, const int32_t* cells, const int32_t* corners,
                 const double* x, const int32_t* dofs, const double* unknowns, int64_t packed,
                 int64_t first, int64_t known, const double* constants, int64_t size, double* out)
{
  lanes y[3 * NG], w[packed], c[known + 1], room[LANES == 1 ? 1 : size];
  memset(w, 0, sizeof(w));
  spread(known, constants, (double*)c);
  for (int64_t n = 0; n < count; n += LANES)
  {
    const int64_t some = count - n < LANES ? count - n : LANES;
    take_cells(some, cells + n, corners, x, dofs, unknowns, (double*)y, (double*)(w + first));
    double* next = out + n * size;
    lanes* values = LANES == 1 ? (lanes*)next : room;
    memset(values, 0, size * sizeof(lanes));
    TABULATE(values, w, c, y);
    put_cells(some, size, values, next);
  }
  return 0;
}
"""


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

    Where one of its integrals has another coefficient than the unknowns, as a modulus that varies
    in space, DOLFINx assembles the whole form.

    Args:
        form: Of one test function in the space of the unknowns, or of none.
        w: The unknowns.
        jit_options: From `options`.
    """

    def __init__(self, form: fem.Form, w: fem.Function, jit_options: JitOptions) -> None:
        self._form, self._w = form, w
        self._integrals: list[_Integral] | None = None
        if (kernels := _kernels(form, w)) is None:
            return
        self._elements = _elements(w)
        self._packed, self._first = _room(form, w)
        self._integrals = [
            _Integral(kernel, cells, _loops_over_cells(w, kernel, jit_options, many=pays(w)))
            for kernel, cells in kernels
        ]

    def add_to(self, out: FloatArray) -> None:
        """Adds the vector of a form with a test function. Not collective.

        Args:
            out: Local entries, those of ghosts too.
        """
        if self._integrals is None:
            fem.assemble_vector(out, self._form)
        else:
            self._call("add_vector", self._integrals, out)

    def value(self) -> float:
        """The value of a form without arguments over this rank's cells. Not collective."""
        if self._integrals is None:
            return float(fem.assemble_scalar(self._form))
        out = np.zeros(1)
        self._call("add_scalar", self._integrals, out)
        return float(out[0])

    def _call(self, loop: str, integrals: Sequence[_Integral], out: FloatArray) -> None:
        constants = pack_constants(self._form._cpp_object)
        unknowns = (*self._elements, self._w.x.array, self._packed, self._first)
        for one in integrals:
            where = (one.kernel.address, len(one.cells), one.cells)
            one.loops.call(loop, *where, *unknowns, len(constants), constants, out)


class LaneLoops(NamedTuple):
    """Loops in C that use a kernel for several cells at once.

    Attributes:
        declarations: Of the functions, for cffi.
        source: In C; it has the code of `TAKING`, and stands where LANES > 1 only.  Else the same
            functions do nothing, and are not called.
        sizes: Macros, by name.
    """

    declarations: str
    source: str
    sizes: dict[str, int]


class CellExpression:
    """An expression without arguments, compiled, at points in cells. Collective to make.

    Where it has another coefficient than the unknowns, DOLFINx evaluates it.

    Args:
        expression: In UFL.
        points: Of the reference cell, shape (points, dim).
        w: The unknowns.
        jit_options: From `options`.
        more: What else is to be done with it in lanes.

    Attributes:
        size: Numbers in a cell: points times components.
        kernel: FFCx's function, which has no coefficient but the unknowns; else None.
        in_lanes: It has code for several cells at once, and so have the functions of `more`.
    """

    def __init__(
        self,
        expression: Expr,
        points: FloatArray,
        w: fem.Function,
        jit_options: JitOptions,
        more: LaneLoops | None = None,
    ) -> None:
        comm = w.function_space.mesh.comm
        self._expression, library = expression_and_module(comm, expression, points, jit_options)
        self._w, self.kernel, self.in_lanes = w, _kernel(self._expression, library, w), False
        compiled = self._expression.ufcx_expression
        self.size = int(compiled.num_points) * int(self._expression.value_size)
        if self.kernel is None:
            return
        self._elements = _elements(w)
        many = pays(w) and self.size <= _MOST
        self._loops = _loops_over_cells(
            w, self.kernel, jit_options, many=many, more=more if many else None
        )
        self._packed = w.function_space.element.space_dimension
        self.in_lanes = self._loops.call("width") > 1

    @property
    def constants(self) -> FloatArray:
        """Values of the constants of the expression."""
        return pack_constants(self._expression._cpp_object)

    def call(self, name: str, *arguments: int | AnyArray) -> int:
        """Calls a function of `more`, where it is `in_lanes`. Not collective.

        Args:
            name: Of the function.
            arguments: Integers and arrays.
        """
        return self._loops.call(name, *arguments)

    def eval(self, cells: IndexArray, out: FloatArray | None = None) -> FloatArray:
        """Values in cells, shape (cells, size). Not collective.

        Args:
            cells: Local cells.
            out: Room for them, of that shape.
        """
        out = np.empty((len(cells), self.size)) if out is None else out
        if self.kernel is None:
            found = self._expression.eval(self._w.function_space.mesh, cells)
            out[:] = found.reshape(out.shape)  # 0.11 has axes of points and of components
            return out
        cells = np.ascontiguousarray(cells, dtype=np.int32)
        constants = self.constants
        where = (self.kernel.address, len(cells), cells, *self._elements, self._w.x.array)
        sizes = (self._packed, 0, len(constants))
        self._loops.call("evaluate", *where, *sizes, constants, self.size, out)
        return out


def _elements(w: fem.Function) -> tuple[IndexArray, FloatArray, IndexArray]:
    """Geometry nodes of cells, their places, nodes of unknowns."""
    mesh, dofmap = w.function_space.mesh, w.function_space.dofmap
    corners, dofs = (np.ascontiguousarray(m) for m in (mesh.geometry.dofmap, dofmap.list))
    return corners, mesh.geometry.x, dofs


def pays(w: fem.Function) -> bool:
    """Whether there are so many cells that code for several at once pays; the same on all ranks."""
    mesh = w.function_space.mesh
    return mesh.topology.index_map(mesh.topology.dim).size_global >= lanes.FROM * mesh.comm.size


def _loops_over_cells(
    w: fem.Function,
    kernel: Kernel,
    jit_options: JitOptions,
    *,
    many: bool,
    more: LaneLoops | None = None,
) -> CFunctions:
    """The loops for a kernel. Collective.

    Args:
        w: The unknowns.
        kernel: FFCx's function.
        jit_options: From `options`.
        many: There are so many cells that lanes pay.
        more: Further loops.
    """
    corners, _, dofs = _elements(w)
    sizes = {"NG": corners.shape[1], "ND": dofs.shape[1], "BS": w.function_space.dofmap.bs}
    declarations, loops = DECLARATIONS, TAKING + SOURCE
    if more is not None:
        declarations += more.declarations
        idle = more.declarations.replace(";", " { return -1; }")
        loops += f"#if LANES > 1\n{more.source}\n#else\n{idle}\n#endif\n"
        sizes |= more.sizes
    code = kernel.code(loops, many=many)
    return compile_c(w.function_space.mesh.comm, declarations, code, sizes, jit_options)


def _kernel(expression: fem.Expression, library: Library, w: fem.Function) -> Kernel | None:
    """The function of a compiled expression; None where it has other coefficients than w."""
    compiled = expression.ufcx_expression
    positions = compiled.original_coefficient_positions
    found = extract_coefficients(expression.ufl_expression)
    if any(found[positions[i]] is not w for i in range(compiled.num_coefficients)):
        return None
    return _function(compiled.tabulate_tensor_float64, library, 0)


def _function(function: cffi.FFI.CData, library: Library, number: int) -> Kernel:
    address = int(library.ffi.cast("intptr_t", function))
    arguments = len(library.ffi.typeof(function).args)
    return Kernel(address, arguments, Path(library.__file__).parent, number)


def _kernels(form: fem.Form, w: fem.Function) -> list[tuple[Kernel, IndexArray]] | None:
    """The functions of a form's integrals, with their cells.

    None where another coefficient than w is in one.

    Args:
        form: Of cells.
        w: The unknowns.
    """
    inner, compiled = form._cpp_object, form.ufcx_form
    ours = [one is w._cpp_object for one in inner.coefficients]
    offsets, found = compiled.form_integral_offsets, []
    for k in range(offsets[0], offsets[1]):  # those of cells stand first
        integral = compiled.form_integrals[k]
        if any(integral.enabled_coefficients[i] and not own for i, own in enumerate(ours)):
            return None
        kernel = _function(integral.tabulate_tensor_float64, form.module, k)
        found.append((kernel, np.ascontiguousarray(cells_of_integral(form, k))))
    return found


def _room(form: fem.Form, w: fem.Function) -> tuple[int, int]:
    """Coefficients of one cell, and where those of the unknowns begin among them."""
    sizes = [c.function_space.element.space_dimension for c in form._cpp_object.coefficients]
    ours = [one is w._cpp_object for one in form._cpp_object.coefficients]
    own = w.function_space.element.space_dimension
    if not any(ours):  # no integral depends on the unknowns
        return sum(sizes) + own, sum(sizes)
    return sum(sizes), sum(sizes[: ours.index(True)])
