"""What differs between DOLFINx 0.9 and 0.10/0.11, and the libraries beside them, in one place."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any

import dolfin_elastic.core.startup.started  # noqa: F401  # before anything starts MPI

import numpy as np
from dolfinx import cpp, fem
from dolfinx.graph import adjacencylist
from dolfinx.mesh import GhostMode, Mesh, create_cell_partitioner
from mpi4py import MPI
from petsc4py import PETSc

from dolfin_elastic.core.types import FloatArray, IndexArray, IntArray

if TYPE_CHECKING:
    import pyvista


@contextmanager
def petsc_errors() -> Iterator[None]:
    """Raises PETSc's error where slepc4py 3.25 has wrapped it in a SystemError."""
    try:
        yield
    except SystemError as error:
        cause = error.__cause__
        if isinstance(cause, PETSc.Error):
            raise cause from cause.__cause__
        raise


def integration_entities(mesh: Mesh, facets: IndexArray) -> IndexArray:
    """Pairs (cell, local facet) for measures over facets, one cell beside each facet.

    Not collective once the facet-cell connectivities exist.  Written out by hand because
    `compute_integration_domains` lost an argument in 0.10 and refuses interior facets.

    Args:
        facets: Local facets, shape (n,).

    Returns:
        Shape (2 n,): cell, local facet, cell, local facet ...
    """
    tdim = mesh.topology.dim
    facet_cells = mesh.topology.connectivity(tdim - 1, tdim)
    cell_facets = mesh.topology.connectivity(tdim, tdim - 1)
    first = facet_cells.array[facet_cells.offsets[facets]]
    local = cell_facets.array.reshape(-1, tdim + 1)[first] == np.asarray(facets)[:, None]
    return np.stack([first, np.argmax(local, axis=1)], axis=1).astype(np.int32).reshape(-1)


def interpolation_points(element: fem.FiniteElement) -> FloatArray:
    """Interpolation points of an element: a method in 0.9, a property from 0.10."""
    points = element.interpolation_points
    return points() if callable(points) else points


def collapsed(V: fem.FunctionSpace) -> tuple[fem.FunctionSpace, IndexArray]:
    """A part of a mixed space as a space of its own, and where its entries stand. Collective.

    From 0.11 on there is an array for each kind of cell.

    Args:
        V: The part, `W.sub(i)`.

    Returns:
        The space, and the entry of W of each of its entries, ghosts included.
    """
    space, dofs = V.collapse()
    if len(dofs) and np.ndim(dofs[0]):
        (dofs,) = dofs
    return space, np.asarray(dofs, dtype=np.int32)


def cell_partitioner(mode: GhostMode) -> Any:
    """DOLFINx's own way of distributing cells: 0.11 asks how many cells share a facet.

    Args:
        mode: Which cells are ghosts.
    """
    try:
        return create_cell_partitioner(mode)
    except TypeError:
        return create_cell_partitioner(mode, 2)


def adjacency(rows: IndexArray) -> Any:
    """DOLFINx's list of links, as many of each, for its C++ functions: 0.10 wraps it for Python.

    Args:
        rows: Shape (n, links).
    """
    lists = adjacencylist(rows)
    return getattr(lists, "_cpp_object", lists)


def column_map(pattern: cpp.la.SparsityPattern) -> cpp.common.IndexMap:
    """Columns of a finalised pattern, with ghosts that only its entries have.

    From 0.11 on there is one function for rows and columns.
    """
    if hasattr(pattern, "column_index_map"):
        return pattern.column_index_map()
    return pattern.index_map(1)


def make_index_map(
    comm: MPI.Comm, count: int, ghosts: IntArray, owners: IndexArray
) -> cpp.common.IndexMap:
    """Indices that ranks share: 0.11 asks for the tag of its messages, too. Collective.

    Args:
        comm: The ranks.
        count: Indices that this rank owns.
        ghosts: Global indices of its ghosts, shape (n,).
        owners: Their ranks, shape (n,).
    """
    try:
        return cpp.common.IndexMap(comm, count, ghosts, owners)
    except TypeError:
        return cpp.common.IndexMap(comm, count, ghosts, owners, 1)


def cells_of_integral(form: fem.Form, number: int) -> IndexArray:
    """Cells of an integral over cells: 0.9 asks for its identifier, 0.11 for its number.

    Args:
        number: Of the integral in the compiled form, where those over cells stand first.
    """
    inner = form._cpp_object
    which = form.ufcx_form.form_integral_ids[number] if hasattr(inner, "integral_ids") else number
    return np.asarray(inner.domains(fem.IntegralType.cell, which), dtype=np.int32)


def space_like(V: fem.FunctionSpace, dofmap: cpp.fem.DofMap, mesh: Mesh | None = None) -> Any:
    """The C++ space with the mesh and element of another; 0.10 takes no shape of values.

    Args:
        mesh: Its own mesh; None: the other's.
    """
    other = V._cpp_object
    shape = [other.value_shape] if hasattr(other, "value_shape") else []
    on = other.mesh if mesh is None else mesh._cpp_object
    return type(other)(on, other.element, dofmap, *shape)


def norm_without_value() -> int:
    """PETSc's reason that the norm of a residual is no number: 3.25 calls it by another name."""
    reason = PETSc.SNES.ConvergedReason
    old = getattr(reason, "DIVERGED_FNORM_NAN", None)
    return int(reason.DIVERGED_FUNCTION_NANORINF if old is None else old)


def interpolation_matrix(coarse: fem.FunctionSpace, fine: fem.FunctionSpace) -> PETSc.Mat:
    """Assembled matrix that interpolates functions of one space in another. Collective.

    Args:
        coarse: Space of the functions: columns of the matrix.
        fine: Space of their interpolants, on the same mesh: rows of the matrix.
    """
    from dolfinx.fem import petsc  # 6 ms of each start

    matrix = petsc.interpolation_matrix(coarse, fine)
    matrix.assemble()
    return matrix


def surface_of(
    grid: pyvista.DataSet, *, nonlinear_subdivision: int = 1, pass_pointid: bool = False
) -> pyvista.PolyData:
    """The faces of a PyVista grid that belong to one cell. Not collective.

    From 0.46 on PyVista warns where the filter is not named, before that it cannot be named.

    Args:
        nonlinear_subdivision: Into how many parts edges of quadratic cells are cut, see PyVista.
        pass_pointid: Whether its points know their numbers in the grid.
    """
    extract = grid.extract_surface
    if "algorithm" in inspect.signature(extract).parameters:
        extract = partial(extract, algorithm="dataset_surface")
    return extract(nonlinear_subdivision=nonlinear_subdivision, pass_pointid=pass_pointid)
