"""Camera frames in, parallel-beam sinogram out.

A frame at stage angle theta is a curved cut through the sinogram: its column at ``x_v`` belongs to the virtual angle
``psi = theta - beta + gamma(x_v)``.  So for each (psi, x_v, z) the column, the row and the stage angle that see this
ray are read off, and the frames are interpolated there.

`turns` chooses frames by angle, `background` makes line integrals of counts, `geometry` says where a ray is seen, and
`resampling` reads it there.
"""

from vialight.sinogram.background import attenuation, bin_frames
from vialight.sinogram.geometry import heights_seen, parallel_beam, ray_tilt, rows_seen, vial_edge_columns
from vialight.sinogram.resampling import resample
from vialight.sinogram.turns import select_turn

__all__ = [
    "attenuation",
    "bin_frames",
    "heights_seen",
    "parallel_beam",
    "ray_tilt",
    "resample",
    "rows_seen",
    "select_turn",
    "vial_edge_columns",
]
