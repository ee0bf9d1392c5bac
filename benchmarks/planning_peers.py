"""Light patterns by other packages, each in a process of its own and as its examples call it.

Usage: ``python benchmarks/planning_peers.py METHOD CASE.npz OUT.npz``, started by `plans` with the interpreter that
has the packages; without arguments it says which are there.  A case holds ``inside`` (z, y, x), ``voxel_mm``, the mesh
as ``vertices_mm`` and ``faces``, and ``angles`` in a full turn; what comes out are ``patterns`` (angle, row, column) in
floats, ordered as vialight's, with ``seconds`` and ``processor_seconds``, of all threads together, that the
optimisation took, and under what ``circumstances``.

Nothing of vialight is needed here.  VAMToolbox is not on the package index: put a copy on ``PYTHONPATH``; it projects
with ``astra-toolbox``.  Dr.TVAM is ``drtvam``, and needs ``DRJIT_LIBLLVM_PATH`` where a libLLVM is not found by itself.
``pymeshlab`` brings the bunny.
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import json
import os
import sys
import tempfile
import time
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import numpy as np
from numpy.typing import NDArray

VAM_ITERATIONS = 20
DRTVAM_STEPS, DRTVAM_ABSORPTION_PER_MM = 40, 1e-3
_FOR_DISPLAY = ("OpenGL", "colorama", "cv2", "dill", "ffmpeg", "imageio", "pyglet", "pyvista", "torch", "vedo")
_ROOM_MM = 60.0

PACKAGES = {
    "VAMToolbox FBP": "vamtoolbox", "VAMToolbox CAL": "vamtoolbox", "VAMToolbox OSMO": "vamtoolbox",
    "VAMToolbox PM": "vamtoolbox", "Dr.TVAM threshold loss": "drtvam",
}  # fmt: skip
"""What has to be importable for each method."""


def what_is_here() -> dict[str, Any]:
    """Return the methods that this interpreter can run, and where the bunny's mesh is, None without one."""
    needs = {"vamtoolbox": ("vamtoolbox", "astra", "skimage"), "drtvam": ("drtvam", "mitsuba")}
    found = importlib.util.find_spec("pymeshlab")
    return {
        "methods": [name for name, package in PACKAGES.items() if all(map(importlib.util.find_spec, needs[package]))],
        "bunny": None if found is None else str(Path(str(found.origin)).parent / "tests/sample_meshes/bunny.obj"),
    }


def circumstances(package: str) -> str:
    """Say when this runs, on what, with which packages, and how busy the machine is."""
    versions = [f"Python {sys.version.split()[0]}"]
    for name in (package, "astra-toolbox" if package == "vamtoolbox" else "mitsuba", "numpy"):
        try:
            versions.append(f"{name} {version(name)}")
        except PackageNotFoundError:  # a copy on the path
            versions.append(f"{name} {getattr(importlib.import_module(name), '__version__', '')}".strip())
    return (
        f"{time.strftime('%Y-%m-%d', time.gmtime())}, priority {os.nice(0)}, load {os.getloadavg()[0]:.1f}, "
        + ", ".join(versions)
    )


def vamtoolbox(method: str, case: dict[str, NDArray[Any]]) -> dict[str, Any]:
    """Optimise half a turn by ASTRA's projector for processors; opposite patterns are mirror images.

    Thresholds, filters and other parameters are the package's defaults; all iterative methods do as many iterations.
    """
    _stand_in_for_display()
    np.__dict__.setdefault("product", np.prod)  # which it calls, and NumPy 2 has dropped
    vam = importlib.import_module("vamtoolbox")
    count = int(case["angles"]) // 2
    degrees = np.arange(count) * (180.0 / count)
    # Rows of its arrays run along vialight's y: ASTRA counts them from the top, and turns the other way.
    target = vam.geometry.TargetGeometry(target=np.ascontiguousarray(case["inside"].transpose(1, 2, 0)) >= 0.5)
    target.array = target.array.astype(float)
    rays = vam.geometry.ProjectionGeometry(degrees, ray_type="parallel", CUDA=False)
    options = vam.optimize.Options(method=method, n_iter=VAM_ITERATIONS)
    start, processor_start = time.perf_counter(), time.process_time()
    sinogram, _, _ = vam.optimize.optimize(target, rays, options)
    spent = {"seconds": time.perf_counter() - start, "processor_seconds": time.process_time() - processor_start}
    half = sinogram.array.transpose(1, 2, 0)
    return {"patterns": np.concatenate([half, half[:, :, ::-1]])[:, ::-1], **spent}


def drtvam(case: dict[str, NDArray[Any]]) -> dict[str, Any]:
    """Optimise a full turn by its threshold loss and L-BFGS, in a resin that absorbs next to nothing.

    The mesh is made voxels by Dr.TVAM itself, at their centres as by vialight.  Parameters are its defaults, with
    pixels left out that no part of the mesh is behind.
    """
    importlib.import_module("drtvam")  # hears of the variant, and brings its plug-ins
    importlib.import_module("mitsuba").set_variant("llvm_ad_mono")
    optimize = importlib.import_module("drtvam.optimize")
    voxel, (slices, rows, columns) = float(case["voxel_mm"]), case["inside"].shape
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "patterns").mkdir()
        part = Path(folder) / "part.ply"
        _write_ply(part, case["vertices_mm"], case["faces"])
        start, processor_start = time.perf_counter(), time.process_time()
        optimize.optimize(
            {
                "output": folder,
                "vial": {
                    "type": "index_matched", "r": _ROOM_MM / 2, "height": _ROOM_MM,
                    "medium": {"ior": 1.0, "extinction": DRTVAM_ABSORPTION_PER_MM, "albedo": 0.0},
                },
                "projector": {
                    "type": "collimated", "n_patterns": int(case["angles"]), "resx": columns, "resy": slices,
                    "pixel_size": voxel, "motion": "circular", "distance": _ROOM_MM,
                },
                "sensor": {
                    "type": "dda", "scalex": columns * voxel, "scaley": rows * voxel, "scalez": slices * voxel,
                    "film": {"type": "vfilm", "resx": columns, "resy": rows, "resz": slices},
                },
                "target": {"filename": str(part), "scale_and_center": False},
                "loss": {"type": "threshold"}, "optimizer": {"type": "lbfgs"},
                "n_steps": DRTVAM_STEPS, "filter_radon": True, "time": 1 / DRTVAM_ABSORPTION_PER_MM,
            }
        )  # fmt: skip
        spent = {"seconds": time.perf_counter() - start, "processor_seconds": time.process_time() - processor_start}
        with np.load(Path(folder) / "patterns.npz") as saved:
            patterns = saved["patterns"]
    # Its projector starts at +x and goes round counter-clockwise, where the part would turn clockwise.
    count = len(patterns)
    return {"patterns": patterns[(3 * count // 4 - np.arange(count)) % count], **spent}


def _stand_in_for_display() -> None:
    """Let VAMToolbox be imported without what it shows pictures with, and does not compute with here."""

    class Finder:
        @staticmethod
        def find_spec(name: str, path: object = None, target: object = None) -> Any:
            if name.partition(".")[0] not in _FOR_DISPLAY:
                return None
            return importlib.util.spec_from_loader(name, Finder())  # type: ignore[arg-type]  # finder and loader in one

        @staticmethod
        def create_module(spec: Any) -> Any:
            return MagicMock(name=spec.name, __path__=[])

        @staticmethod
        def exec_module(module: object) -> None:
            pass

    # Last, so that those that are installed are found first.
    sys.meta_path.append(Finder)


def _write_ply(path: Path, vertices: NDArray[Any], faces: NDArray[Any]) -> None:
    triangles = np.empty(len(faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    triangles["count"], triangles["corners"] = 3, faces
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    path.write_bytes(header.encode() + vertices.astype("<f4").tobytes() + triangles.tobytes())


def main() -> None:
    """Run one method on one case, or say which there are."""
    if len(sys.argv) == 1:
        print(json.dumps(what_is_here()))
        return
    method, case_path, out_path = sys.argv[1:]
    with np.load(case_path) as saved:
        case = dict(saved)
    with contextlib.redirect_stdout(sys.stderr):
        found = drtvam(case) if PACKAGES[method] == "drtvam" else vamtoolbox(method.split()[1], case)
    # Under another name until it is whole: what is there is not computed again.
    with Path(f"{out_path}.part").open("wb") as part:
        np.savez(part, circumstances=circumstances(PACKAGES[method]), **found)
    Path(f"{out_path}.part").rename(out_path)


if __name__ == "__main__":
    main()
