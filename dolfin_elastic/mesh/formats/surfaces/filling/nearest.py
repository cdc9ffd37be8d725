"""The triangle that is nearest to a point."""

from __future__ import annotations

import numpy as np

from dolfin_elastic.core.types import FloatArray, IntArray


def nearest_triangles(points: FloatArray, triangles: IntArray, x: FloatArray) -> IntArray:
    """The nearest triangle to each place, shape (n,); VTK looks for it.

    Args:
        points: Corners, shape (k, 3).
        triangles: Rows of these, shape (m, 3).
        x: Places, shape (n, 3).
    """
    from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray
    from vtkmodules.vtkCommonCore import reference, vtkPoints
    from vtkmodules.vtkCommonDataModel import (
        vtkCellArray,
        vtkGenericCell,
        vtkPolyData,
        vtkStaticCellLocator,
    )

    surface, corners, rows = vtkPolyData(), vtkPoints(), vtkCellArray()
    corners.SetData(numpy_to_vtk(np.ascontiguousarray(points), deep=True))
    flat = np.ascontiguousarray(triangles.ravel(), dtype=np.int64)
    rows.SetData(3, numpy_to_vtkIdTypeArray(flat, deep=True))
    surface.SetPoints(corners)
    surface.SetPolys(rows)
    locator = vtkStaticCellLocator()
    locator.SetDataSet(surface)
    locator.BuildLocator()
    cell, nearest = vtkGenericCell(), [0.0, 0.0, 0.0]
    number, part, distance = reference(0), reference(0), reference(0.0)
    result = np.empty(len(x), dtype=np.int64)
    for k, place in enumerate(x):
        locator.FindClosestPoint(place, nearest, cell, number, part, distance)
        result[k] = int(number)
    return result
