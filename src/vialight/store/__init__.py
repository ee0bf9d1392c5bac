"""Every run file of vialight: frames, volumes, plans, meshes, results, folders that fill all at once; foreign files.

Importing this is cheap: h5py, hdf5plugin and zarr are imported when a file is opened.
"""

from vialight.store.folders import staged_file, staged_folder
from vialight.store.foreign.exports import export_mp4, export_png
from vialight.store.foreign.heights import read_heights
from vialight.store.foreign.projections import read_projections
from vialight.store.frames import FrameFile, open_frames
from vialight.store.history import (
    HistoryMoment,
    HistoryNumbers,
    Planes,
    StoredSurface,
    list_history,
    list_surfaces,
    read_history,
    read_history_numbers,
    read_surface,
    write_history,
)
from vialight.store.meshes import write_ply, write_stl
from vialight.store.plans import read_plan, write_plan
from vialight.store.recording import FrameWriter, write_frames
from vialight.store.results import read_json, sha256_of, to_json, write_json
from vialight.store.rigs import rig_to_toml, with_values
from vialight.store.series import SERIES, VolumeSeries, VolumeSeriesWriter, read_series
from vialight.store.states import SavedState, read_state, write_state
from vialight.store.tables import read_table
from vialight.store.tail import FrameTail, NewFrames
from vialight.store.volumes import VolumeWriter, read_volume, write_volume

__all__ = [
    "SERIES",
    "FrameFile",
    "FrameTail",
    "FrameWriter",
    "HistoryMoment",
    "HistoryNumbers",
    "NewFrames",
    "Planes",
    "SavedState",
    "StoredSurface",
    "VolumeSeries",
    "VolumeSeriesWriter",
    "VolumeWriter",
    "export_mp4",
    "export_png",
    "list_history",
    "list_surfaces",
    "open_frames",
    "read_heights",
    "read_history",
    "read_history_numbers",
    "read_json",
    "read_plan",
    "read_projections",
    "read_series",
    "read_state",
    "read_surface",
    "read_table",
    "read_volume",
    "rig_to_toml",
    "sha256_of",
    "staged_file",
    "staged_folder",
    "to_json",
    "with_values",
    "write_frames",
    "write_history",
    "write_json",
    "write_plan",
    "write_ply",
    "write_state",
    "write_stl",
    "write_volume",
]
