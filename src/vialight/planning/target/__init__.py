"""A part becomes what is to be cured: checked, placed in the vial, cut into voxels.

- `soundness`, `self_intersection`: whether a mesh says what is inside
- `room`: where in the vial the projector can print
- `placement`: turning, scaling and centring a part in that room
- `voxels`: the grid round a part, and the share of every voxel that is inside
"""

from vialight.planning.target.placement import Placement, place, radius_about_axis
from vialight.planning.target.room import Room, printable_room
from vialight.planning.target.self_intersection import intersecting_faces
from vialight.planning.target.soundness import check_sound
from vialight.planning.target.voxels import target_grid, voxelise

__all__ = [
    "Placement",
    "Room",
    "check_sound",
    "intersecting_faces",
    "place",
    "printable_room",
    "radius_about_axis",
    "target_grid",
    "voxelise",
]
