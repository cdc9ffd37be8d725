"""A law at points, without a mesh and without compiling: UFL as a list of scalar operations.

The operations are the form compiler's own, so nothing is worked out twice; UFL's own evaluation
follows every path through an expression, of which the spectral laws have billions.
"""

from __future__ import annotations

from typing import Any

import basix.ufl
import numpy as np
import ufl
from ffcx.ir.analysis.graph import build_scalar_graph
from ufl import classes
from ufl.algorithms import expand_derivatives
from ufl.algorithms.remove_complex_nodes import remove_complex_nodes

from dolfin_elastic.model.materials.law import Law

_MESH = ufl.Mesh(basix.ufl.element("Lagrange", "tetrahedron", 1, shape=(3,)))
_TENSORS = ufl.FunctionSpace(_MESH, basix.ufl.element("DG", "tetrahedron", 0, shape=(3, 3)))
_BINARY = {
    classes.Sum: np.add,
    classes.Product: np.multiply,
    classes.Division: np.divide,
    classes.Power: np.power,
    classes.Abs: np.abs,
    classes.LT: np.less,
    classes.GT: np.greater,
    classes.MinValue: np.minimum,
    classes.MaxValue: np.maximum,
    classes.Atan2: np.arctan2,
    classes.Conditional: np.where,
}
_FUNCTIONS = {
    "ln": np.log,
    **{n: getattr(np, n) for n in ("exp", "sqrt", "cos", "sin", "cosh", "sinh")},
}


def tensor() -> Any:
    """A symbol of shape (3, 3), for a `Program`."""
    return ufl.Coefficient(_TENSORS)


class Program:
    """A UFL expression of coefficients as a function of arrays."""

    def __init__(self, expression: Any) -> None:
        self.shape = expression.ufl_shape
        expression = remove_complex_nodes(expand_derivatives(expression))
        if isinstance(expression, classes.Zero):
            expression = ufl.as_tensor(np.zeros(self.shape).tolist())
        graph = build_scalar_graph(expression)
        self._steps = [
            (node["expression"], graph.out_edges[i], node.get("component", ()))
            for i, node in graph.nodes.items()
        ]

    def __call__(self, given: dict[Any, np.ndarray]) -> np.ndarray:
        """Values at n points; the coefficients' values are of shape (n, 3, 3)."""
        n = len(next(iter(given.values())))
        out = np.zeros((n, int(np.prod(self.shape))))
        known: list[Any] = []
        with np.errstate(all="ignore"):
            for expression, operands, components in self._steps:
                known.append(_value(expression, [known[i] for i in operands], given))
                for component in components:
                    out[:, component] = known[-1]
        return out.reshape(n, *self.shape)


def _value(expression: Any, operands: list[Any], given: dict[Any, np.ndarray]) -> Any:
    if isinstance(expression, classes.ScalarValue):
        return float(expression)
    if isinstance(expression, classes.Zero):
        return 0.0
    if isinstance(expression, classes.Indexed):
        symbol, at = expression.ufl_operands
        return given[symbol][(slice(None), *(int(i) for i in at))]
    if isinstance(expression, classes.MathFunction):
        return _FUNCTIONS[expression._name](*operands)
    return _BINARY[type(expression)](*operands)


class Point:
    """Energy, stress and tangent of a law at one or many F."""

    def __init__(self, law: Law) -> None:
        self.F, self.H = tensor(), tensor()
        P = law.stress(self.F)
        self._psi = Program(law.energy(self.F)) if law.has_energy else None
        self._P = Program(P)
        self._dP = Program(ufl.derivative(P, self.F, self.H))

    def energies(self, F: np.ndarray) -> np.ndarray:
        assert self._psi is not None
        return self._psi({self.F: F})

    def energy(self, F: np.ndarray) -> float:
        return float(self.energies(F[None])[0])

    def stress(self, F: np.ndarray) -> np.ndarray:
        return self._P({self.F: F[None]})[0]

    def along(self, F: np.ndarray, H: np.ndarray) -> np.ndarray:
        """Derivative of the stress in the direction H."""
        return self._dP({self.F: F[None], self.H: H[None]})[0]

    def tangent(self, F: np.ndarray) -> np.ndarray:
        """dP_ij/dF_kl."""
        units = np.eye(9).reshape(9, 3, 3)
        values = self._dP({self.F: np.repeat(F[None], 9, axis=0), self.H: units})
        return np.moveaxis(values, 0, -1).reshape(3, 3, 3, 3)
