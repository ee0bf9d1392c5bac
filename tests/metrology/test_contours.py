"""Contours of fields whose surfaces are known."""

from __future__ import annotations

import numpy as np

from vialight.metrology.contours import above_ties, contour


def test_a_plane_lies_where_interpolation_has_it_and_faces_lower_values() -> None:
    """A field that falls by 1 a voxel along z, of 0.5 mm from z = 2 mm: 3.25 is reached at 2.875 mm."""
    field = np.broadcast_to(np.arange(5, 0, -1, dtype=np.float32)[:, None, None], (5, 4, 3)).copy()
    plane = contour(field, (2.0, 10.0, 20.0), 0.5, 3.25)
    np.testing.assert_allclose(plane.vertices_mm[:, 2], 2.875)
    np.testing.assert_allclose(plane.bounds_mm, [[20.0, 10.0, 2.875], [21.0, 11.5, 2.875]])
    corners = plane.vertices_mm[plane.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals[:, 2] > 0).all()


def test_no_float32_equals_a_level_above_ties() -> None:
    for level in (100.0, 0.12, -3.5):
        raised = above_ties(level)
        assert float(np.float32(level)) < raised < float(np.nextafter(np.float32(level), np.float32(np.inf)))
