"""Arrays of numpy as they pass through the package, by the type of their entries.

Shape, unit and configuration stand in the docstrings of functions that take or return them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:  # the process of Gmsh needs no UFL, which takes longer than all else it imports
    from ufl.core.expr import Expr

FloatArray: TypeAlias = npt.NDArray[np.float64]
"""Coordinates, displacements, forces, values of fields."""
SingleArray: TypeAlias = npt.NDArray[np.float32]
"""Matrices of preconditioners."""
IndexArray: TypeAlias = npt.NDArray[np.int32]
"""Local indices of DOLFINx: cells, facets, nodes, dofs."""
IntArray: TypeAlias = npt.NDArray[np.int64]
"""Global indices, numbers of nodes in files, marks of regions."""
ComplexArray: TypeAlias = npt.NDArray[np.complex128]
"""Exponents and amplitudes of complex solutions."""
BoolArray: TypeAlias = npt.NDArray[np.bool_]
"""Masks."""
Scalar: TypeAlias = "float | FloatArray | Expr"
"""A number, its values at several points, or a scalar UFL expression."""
AnyArray: TypeAlias = npt.NDArray[Any]
"""Arrays whose entries are of several types, or of one that only the caller knows."""
