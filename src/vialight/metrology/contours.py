"""Surfaces of constant value by flying edges (Schroeder et al. 2015), as VTK has them."""

from __future__ import annotations

import numpy as np

from vialight.core.arrays import Float32Array
from vialight.core.mesh import Mesh


def contour(field: Float32Array, origin_mm: tuple[float, float, float], voxel_mm: float, level: float) -> Mesh:
    """Draw the surface between what lies above a level and what does not.

    Parameters
    ----------
    field
        (z, y, x) float32, contiguous; where it is above the level at the grid's end, the surface is open there.
    origin_mm
        z, y, x of the first voxel's centre.
    voxel_mm
        Edge of a voxel.
    level
        See `above_ties`.

    Returns
    -------
    Mesh
        Faces outward: towards lower values.
    """
    # Pieces of VTK rather than PyVista: this import takes a third of the time.
    from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
    from vtkmodules.vtkCommonDataModel import vtkImageData
    from vtkmodules.vtkFiltersCore import vtkFlyingEdges3D

    image = vtkImageData()
    image.SetDimensions(*field.shape[::-1])
    image.SetSpacing(voxel_mm, voxel_mm, voxel_mm)
    image.SetOrigin(*origin_mm[::-1])
    # The array is not copied: `field` must outlive Update().
    image.GetPointData().SetScalars(numpy_to_vtk(field.ravel(), deep=False))  # type: ignore[no-untyped-call]  # of VTK
    edges = vtkFlyingEdges3D()
    edges.SetInputData(image)
    edges.SetValue(0, level)
    edges.ComputeNormalsOff()
    edges.ComputeScalarsOff()
    edges.Update()
    surface = edges.GetOutput()
    vertices = vtk_to_numpy(surface.GetPoints().GetData())  # type: ignore[no-untyped-call]  # of VTK
    faces = vtk_to_numpy(surface.GetPolys().GetConnectivityArray())  # type: ignore[no-untyped-call]  # of VTK
    return Mesh(vertices.astype(np.float64), faces.astype(np.int64).reshape(-1, 3))


def above_ties(level: float) -> float:
    """Return a level half a float32 step higher, which no voxel equals.

    A voxel that did would put several vertices of the surface in one place.

    Examples
    --------
    >>> 100.0 < above_ties(100.0) < 100.00001
    True
    """
    nearest = np.float32(level)
    return (float(nearest) + float(np.nextafter(nearest, np.float32(np.inf)))) / 2
