"""Functions of tensors and of their principal values and directions, of many points at once.

They are evaluated in NumPy from the tensor's components: eigenvalues and eigenvectors written in
UFL take FFCx minutes, and their closed forms lose half of the digits where two values are close.

Source: Bonet & Wood, Nonlinear Continuum Mechanics for Finite Element Analysis, 2nd ed.,
Cambridge 2008, section 4.6 (stretches and strains); equation numbers below are theirs.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dolfin_elastic.core.types import FloatArray

Rows = Callable[[FloatArray], FloatArray]
"""Function of rows of a tensor, shape (n, 9), to rows of what follows from it."""


def _decomposed(tensors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Principal values, largest first, and unit directions of symmetric tensors.

    Args:
        tensors: Shape (n, 3, 3); NaN where there is none.

    Returns:
        Values of shape (n, 3), and directions as rows of shape (n, 3, 3): of each the component of
        largest magnitude is positive.
    """
    known = np.asarray(np.isfinite(tensors).all(axis=(1, 2)))
    values, columns = np.linalg.eigh(np.where(known[:, None, None], tensors, 0.0))
    directions = np.swapaxes(columns, 1, 2)[:, ::-1]
    largest = np.take_along_axis(directions, np.abs(directions).argmax(axis=2)[..., None], axis=2)
    directions = directions * np.where(largest < 0, -1.0, 1.0)
    missing = ~known
    values, directions = values[:, ::-1].copy(), directions.copy()
    values[missing], directions[missing] = np.nan, np.nan
    return values, directions


def _symmetric(rows: FloatArray) -> FloatArray:
    tensors = rows.reshape(-1, 3, 3)
    return np.asarray((tensors + np.swapaxes(tensors, 1, 2)) / 2)


def principal_values(rows: FloatArray) -> FloatArray:
    """Principal values of symmetric tensors, largest first, shape (n, 3)."""
    return _decomposed(_symmetric(rows))[0]


def principal_value(number: int) -> Rows:
    """The function that gives one principal value; 0: the largest, shape (n, 1)."""
    return lambda rows: principal_values(rows)[:, number : number + 1]


def principal_direction(number: int) -> Rows:
    """The function that gives the unit direction of a principal value, shape (n, 3).

    Of its two senses it is the one whose component of largest magnitude is positive.
    """
    return lambda rows: _decomposed(_symmetric(rows))[1][:, number]


def tresca(rows: FloatArray) -> FloatArray:
    """Largest minus smallest principal stress, twice the largest shear stress; shape (n, 1).

    Source: H. Tresca, Comptes Rendus 59 (1864) 754.
    """
    values = principal_values(rows)
    return values[:, :1] - values[:, 2:]


def von_mises(rows: FloatArray) -> FloatArray:
    """Von Mises stress, sqrt(3/2) times the norm of the deviator of a stress; shape (n, 1).

    Source: R. von Mises, Nachr. Ges. Wiss. Goettingen, Math.-Phys. Kl. (1913) 582.
    """
    deviator = rows - np.outer(rows[:, [0, 4, 8]].mean(axis=1), np.eye(3))
    return np.asarray(np.sqrt(1.5) * np.linalg.norm(deviator, axis=1, keepdims=True))


def _strains(rows: FloatArray, *, spatial: bool) -> FloatArray:
    """C - I = H + H^T + H^T H, or b - I = H + H^T + H H^T, without the rounding of I + H.

    Args:
        rows: Of the displacement gradient H = F - I.
        spatial: b = F F^T in place of C = F^T F.
    """
    H = rows.reshape(-1, 3, 3)
    transposed = np.swapaxes(H, 1, 2)
    square = H @ transposed if spatial else transposed @ H
    return np.asarray(H + transposed + square)


def principal_stretches(rows: FloatArray) -> FloatArray:
    """Stretches lambda_i, roots of the principal values of C = F^T F (4.27), largest first.

    Args:
        rows: Of the displacement gradient H = F - I.
    """
    squares = 1.0 + _decomposed(_strains(rows, spatial=False))[0]
    return np.asarray(np.sqrt(np.maximum(squares, 0.0)))


def principal_strain(number: int) -> Rows:
    """The function of H = F - I that gives a principal strain lambda_i - 1; 0: the largest.

    Biot's strain U - I, without the rounding of U; shape (n, 1).
    """

    def rows_of(rows: FloatArray) -> FloatArray:
        excess = _decomposed(_strains(rows, spatial=False))[0][:, number : number + 1]
        excess = np.maximum(excess, -1.0)
        return np.asarray(excess / (1 + np.sqrt(1 + excess)))

    return rows_of


def stretch_direction(number: int) -> Rows:
    """The function of H = F - I that gives a principal direction N_i of C, undeformed body.

    Sense as in `principal_direction`.
    """
    return lambda rows: _decomposed(_strains(rows, spatial=False))[1][:, number]


def log_strain(rows: FloatArray) -> FloatArray:
    """Hencky's strain ln V = sum ln(lambda_i) n_i n_i, in the current configuration; shape (n, 9).

    Args:
        rows: Of the displacement gradient H = F - I; V^2 = F F^T (4.35).

    Source: H. Hencky, Z. techn. Physik 9 (1928) 215; it is what Abaqus calls LE.
    """
    excess, n = _decomposed(_strains(rows, spatial=True))
    with np.errstate(divide="ignore", invalid="ignore"):
        logarithms = np.log1p(excess) / 2
    return np.einsum("pi,pij,pik->pjk", logarithms, n, n).reshape(-1, 9)
