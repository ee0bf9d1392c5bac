"""Every run file of vialight: frames, volumes, meshes, results, and folders that fill all at once.

Importing this is cheap: h5py, hdf5plugin and zarr are imported when a file is opened.
"""

from vialight.store.folders import staged_file, staged_folder
from vialight.store.frames import FrameFile, open_frames
from vialight.store.meshes import write_ply, write_stl
from vialight.store.recording import FrameWriter, write_frames
from vialight.store.results import read_json, sha256_of, to_json, write_json
from vialight.store.volumes import VolumeWriter, read_volume, write_volume

__all__ = [
    "FrameFile",
    "FrameWriter",
    "VolumeWriter",
    "open_frames",
    "read_json",
    "read_volume",
    "sha256_of",
    "staged_file",
    "staged_folder",
    "to_json",
    "write_frames",
    "write_json",
    "write_ply",
    "write_stl",
    "write_volume",
]
