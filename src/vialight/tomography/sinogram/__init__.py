"""Camera frames in, parallel-beam sinogram out.

A frame at stage angle theta is a curved cut through the sinogram: its column at ``x_v`` belongs to the virtual angle
``psi = theta - beta + gamma(x_v)``.  So for each (psi, x_v, z) the column, the row and the stage angle that see this
ray are read off, and the frames are interpolated there.

`turns` chooses frames by angle, `background` makes line integrals of counts, `geometry` chooses the rays, and
`resampling` reads them where `vialight.optics.viewing` says that they are seen.
"""

from vialight.tomography.sinogram.background import attenuation, bin_frames
from vialight.tomography.sinogram.geometry import parallel_beam, rows_seen, warn_of_unseen_rays
from vialight.tomography.sinogram.resampling import resample
from vialight.tomography.sinogram.straightening import Straightening, straightening
from vialight.tomography.sinogram.turns import count_turns, frames_a_turn, select_turn

__all__ = [
    "Straightening",
    "attenuation",
    "bin_frames",
    "count_turns",
    "frames_a_turn",
    "parallel_beam",
    "resample",
    "rows_seen",
    "select_turn",
    "straightening",
    "warn_of_unseen_rays",
]
