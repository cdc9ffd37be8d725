"""What the answer of least squares says of the constants: intervals, and what is not told.

With the weighted sensitivities A and the variance v of the errors of each set, estimated from its
own residuals, the covariance of the constants is B A^T V A B, B = (A^T A)^-1, which for one set is
v B; intervals are those of Student's distribution.

Source: G. A. F. Seber and C. J. Wild, Nonlinear Regression (1989), section 2.1; H. White,
Econometrica 48 (1980) 817 (the covariance where variances differ).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfin_elastic.core.types import BoolArray, FloatArray
from dolfin_elastic.study.least_squares.problem import NULL, LeastSquares

_LEVEL = 0.95


@dataclass(frozen=True)
class Certainty:
    """How well the constants are known.

    Attributes:
        half: Half widths of the intervals of 95 % [units of the constants], shape (k,); infinite
            where nothing tells a constant, nan at a bound.
        correlation: Shape (k, k); nan beside constants that the data cannot tell apart.
        bound: Constants at a bound, shape (k,).
        unknown: Groups of constants, by index, that the data cannot tell apart, or alone.
        weak: The change of z that the data see least, shape (k,).
    """

    half: FloatArray
    correlation: FloatArray
    bound: BoolArray
    unknown: tuple[tuple[int, ...], ...]
    weak: FloatArray


def certainty(model: LeastSquares, z: FloatArray) -> Certainty:
    """See `Certainty`, by the formula of the module."""
    from scipy.stats import t

    A, residuals, k = model.sensitivities(z), model.residuals(z), len(z)
    visible = seen(model, z)
    bound = model.at_bound(z) & visible
    inner = np.flatnonzero(~bound & visible)
    size = np.linalg.norm(A[:, inner], axis=0)
    unknown: list[tuple[int, ...]] = [(int(i),) for i in np.flatnonzero(~visible)]
    half, correlation = np.full(k, np.nan), np.eye(k)
    half[[i for group in unknown for i in group]] = np.inf
    weak = np.zeros(k)
    if len(inner):
        _, s, vt = np.linalg.svd(A[:, inner] / size, full_matrices=False)
        weak[inner] = vt[-1] / size
        null = s < NULL * s[0]
        for v in vt[null]:
            unknown.append(tuple(int(i) for i in inner[np.abs(v) > 0.1]))
        lost = np.abs(vt[null]).max(axis=0, initial=0.0) > 0.1
        half[inner[lost]] = np.inf
        inverse = (vt[~null].T / s[~null] ** 2) @ vt[~null]
        meat = A[:, inner] / size * _variances(model, residuals, len(inner))[:, None]
        covariance = inverse @ (A[:, inner] / size).T @ meat @ inverse
        deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        wide = deviation / size * model.scale[inner]
        quantile = t.ppf((1 + _LEVEL) / 2, len(residuals) - len(inner))
        half[inner[~lost]] = (quantile * wide)[~lost]
        safe = np.where(deviation > 0, deviation, 1.0)
        correlation[np.ix_(inner, inner)] = covariance / np.outer(safe, safe)
        # What is left of a covariance without its lost directions says nothing of their constants.
        correlation[inner[lost]] = correlation[:, inner[lost]] = np.nan
        np.fill_diagonal(correlation, 1.0)
    return Certainty(half, correlation, bound, tuple(unknown), weak)


def seen(model: LeastSquares, z: FloatArray) -> BoolArray:
    """Constants that some number depends on, shape (k,)."""
    size = np.linalg.norm(model.sensitivities(z), axis=0) * np.maximum(np.abs(z), 1e-3)
    return np.asarray(size > NULL * np.linalg.norm(model.weights * model.measured))


def _variances(model: LeastSquares, residuals: FloatArray, k: int) -> FloatArray:
    """Of the weighted errors, estimated curve by curve, shape (N,)."""
    left = 1 - k / len(residuals)
    parts = model.by_curve(residuals)
    return np.concatenate([np.full(len(x), np.sum(x**2) / (len(x) * left)) for x in parts])
