"""Integrals and values in cells of what has no coefficient but the vector of all unknowns.

DOLFINx copies the coefficients of all cells before it assembles a form or evaluates an expression:
the displacement of a linear tetrahedron takes 96 bytes, more than any other array of a residual,
written and read each time.  Here the same kernels of FFCx are called by a loop that copies those of
one cell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cffi
import numpy as np
from dolfinx import fem
from dolfinx.cpp.fem import pack_constants
from ufl.algorithms import extract_coefficients

from dolfin_elastic.core.compat import cells_of_integral
from dolfin_elastic.core.jit.c_code import CFunctions, compile_c
from dolfin_elastic.core.jit.compile import JitOptions
from dolfin_elastic.core.types import FloatArray, IndexArray

DECLARATIONS = """
int64_t add_vector(int64_t kernel, int64_t count, const int32_t* cells, const int32_t* corners,
                   const double* x, const int32_t* dofs, const double* unknowns, double* packed,
                   int64_t first, const double* constants, double* out);
int64_t add_scalar(int64_t kernel, int64_t count, const int32_t* cells, const int32_t* corners,
                   const double* x, const int32_t* dofs, const double* unknowns, double* packed,
                   int64_t first, const double* constants, double* out);
int64_t evaluate(int64_t kernel, int64_t count, const int32_t* cells, const int32_t* corners,
                 const double* x, const int32_t* dofs, const double* unknowns, double* packed,
                 int64_t first, const double* constants, int64_t size, double* out);
"""

SOURCE = r"""
#include <stddef.h>
#include <stdint.h>
#include <string.h>

/* FFCx 0.10 and newer hand on a pointer to the user's data, too. */
#if ARGUMENTS == 7
typedef void (*tabulate)(double*, const double*, const double*, const double*, const int*,
                         const uint8_t*, void*);
#define CALL(...) tabulate_cell(__VA_ARGS__, NULL, NULL, NULL)
#else
typedef void (*tabulate)(double*, const double*, const double*, const double*, const int*,
                         const uint8_t*);
#define CALL(...) tabulate_cell(__VA_ARGS__, NULL, NULL)
#endif

/* Unknowns stand in rows of BS at ND nodes of a cell, its geometry has NG nodes. */
static inline void take_cell(int64_t c, const int32_t* corners, const double* x,
                             const int32_t* dofs, const double* unknowns, double* y, double* w)
{
  for (int m = 0; m < NG; m++)
    memcpy(y + 3 * m, x + 3 * (int64_t)corners[c * NG + m], 3 * sizeof(double));
  for (int a = 0; a < ND; a++)
    memcpy(w + BS * a, unknowns + BS * (int64_t)dofs[c * ND + a], BS * sizeof(double));
}

int64_t add_vector(int64_t kernel, int64_t count, const int32_t* cells, const int32_t* corners,
                   const double* x, const int32_t* dofs, const double* unknowns, double* packed,
                   int64_t first, const double* constants, double* out)
{
  const tabulate tabulate_cell = (tabulate)(intptr_t)kernel;
  double y[3 * NG], b[BS * ND];
  for (int64_t n = 0; n < count; n++)
  {
    const int64_t c = cells[n];
    take_cell(c, corners, x, dofs, unknowns, y, packed + first);
    memset(b, 0, sizeof(b));
    CALL(b, packed, constants, y);
    for (int a = 0; a < ND; a++)
      for (int i = 0; i < BS; i++)
        out[BS * (int64_t)dofs[c * ND + a] + i] += b[BS * a + i];
  }
  return 0;
}

int64_t add_scalar(int64_t kernel, int64_t count, const int32_t* cells, const int32_t* corners,
                   const double* x, const int32_t* dofs, const double* unknowns, double* packed,
                   int64_t first, const double* constants, double* out)
{
  const tabulate tabulate_cell = (tabulate)(intptr_t)kernel;
  double y[3 * NG];
  for (int64_t n = 0; n < count; n++)
  {
    take_cell(cells[n], corners, x, dofs, unknowns, y, packed + first);
    CALL(out, packed, constants, y);
  }
  return 0;
}

int64_t evaluate(int64_t kernel, int64_t count, const int32_t* cells, const int32_t* corners,
                 const double* x, const int32_t* dofs, const double* unknowns, double* packed,
                 int64_t first, const double* constants, int64_t size, double* out)
{
  const tabulate tabulate_cell = (tabulate)(intptr_t)kernel;
  double y[3 * NG];
  memset(out, 0, sizeof(double) * size * count);
  for (int64_t n = 0; n < count; n++)
  {
    take_cell(cells[n], corners, x, dofs, unknowns, y, packed + first);
    CALL(out + n * size, packed, constants, y);
  }
  return 0;
}
"""


@dataclass(frozen=True)
class _Integral:
    """One integral of a form.

    Attributes:
        kernel: Address of FFCx's function.
        cells: The cells.
    """

    kernel: int
    cells: IndexArray


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
        self._integrals, arguments = _kernels(form, w)
        if self._integrals is None:
            return
        self._elements, self._loops = _loops_over_cells(w, arguments, jit_options)
        self._packed, self._first = _room(form, w)

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
            where = (one.kernel, len(one.cells), one.cells)
            self._loops.call(loop, *where, *unknowns, constants, out)


class CellExpression:
    """A compiled expression without arguments, at its points in cells. Collective to make.

    Where it has another coefficient than the unknowns, DOLFINx evaluates it.

    Args:
        expression: Its points are those of a reference cell.
        w: The unknowns.
        jit_options: From `options`.

    Attributes:
        size: Numbers in a cell: points times components.
    """

    def __init__(
        self, expression: fem.Expression, w: fem.Function, jit_options: JitOptions
    ) -> None:
        self._expression, self._w = expression, w
        compiled = expression.ufcx_expression
        self.size = int(compiled.num_points) * int(expression.value_size)
        self._kernel = 0
        positions = compiled.original_coefficient_positions
        found = extract_coefficients(expression.ufl_expression)
        others = [i for i in range(compiled.num_coefficients) if found[positions[i]] is not w]
        if others:
            return
        function = compiled.tabulate_tensor_float64
        self._kernel = int(_ffi.cast("intptr_t", function))
        arguments = len(_ffi.typeof(function).args)
        self._elements, self._loops = _loops_over_cells(w, arguments, jit_options)
        self._packed = np.zeros(w.function_space.element.space_dimension)

    def eval(self, cells: IndexArray, out: FloatArray | None = None) -> FloatArray:
        """Values in cells, shape (cells, size). Not collective.

        Args:
            cells: Local cells.
            out: Room for them, of that shape.
        """
        out = np.empty((len(cells), self.size)) if out is None else out
        if not self._kernel:
            found = self._expression.eval(self._w.function_space.mesh, cells)
            out[:] = found.reshape(out.shape)  # 0.11 has axes of points and of components
            return out
        cells = np.ascontiguousarray(cells, dtype=np.int32)
        constants = pack_constants(self._expression._cpp_object)
        where = (self._kernel, len(cells), cells, *self._elements, self._w.x.array)
        self._loops.call("evaluate", *where, self._packed, 0, constants, self.size, out)
        return out


_ffi = cffi.FFI()


def _loops_over_cells(
    w: fem.Function, arguments: int, jit_options: JitOptions
) -> tuple[tuple[IndexArray, FloatArray, IndexArray], CFunctions]:
    """Geometry nodes of cells, their places, nodes of unknowns; and the loops. Collective.

    Args:
        w: The unknowns.
        arguments: How many FFCx's functions have.
        jit_options: From `options`.
    """
    mesh, dofmap = w.function_space.mesh, w.function_space.dofmap
    corners, dofs = (np.ascontiguousarray(m) for m in (mesh.geometry.dofmap, dofmap.list))
    sizes = {"NG": corners.shape[1], "ND": dofs.shape[1], "BS": dofmap.bs, "ARGUMENTS": arguments}
    loops = compile_c(mesh.comm, DECLARATIONS, SOURCE, sizes, jit_options)
    return (corners, mesh.geometry.x, dofs), loops


def _kernels(form: fem.Form, w: fem.Function) -> tuple[Sequence[_Integral] | None, int]:
    """The integrals of a form, and how many arguments FFCx's functions have.

    None in place of them where another coefficient than w is in one.

    Args:
        form: Of cells.
        w: The unknowns.
    """
    inner, compiled, ffi = form._cpp_object, form.ufcx_form, form.module.ffi
    ours = [one is w._cpp_object for one in inner.coefficients]
    offsets, found, arguments = compiled.form_integral_offsets, [], 0
    for k in range(offsets[0], offsets[1]):  # those of cells stand first
        integral = compiled.form_integrals[k]
        if any(integral.enabled_coefficients[i] and not own for i, own in enumerate(ours)):
            return None, 0
        function = integral.tabulate_tensor_float64
        arguments = len(ffi.typeof(function).args)
        cells = np.ascontiguousarray(cells_of_integral(form, k))
        found.append(_Integral(int(ffi.cast("intptr_t", function)), cells))
    return found, arguments


def _room(form: fem.Form, w: fem.Function) -> tuple[FloatArray, int]:
    """Room for the coefficients of one cell, and where those of the unknowns begin in it."""
    sizes = [c.function_space.element.space_dimension for c in form._cpp_object.coefficients]
    ours = [one is w._cpp_object for one in form._cpp_object.coefficients]
    own = w.function_space.element.space_dimension
    if not any(ours):  # no integral depends on the unknowns
        return np.zeros(sum(sizes) + own), sum(sizes)
    return np.zeros(sum(sizes)), sum(sizes[: ours.index(True)])
