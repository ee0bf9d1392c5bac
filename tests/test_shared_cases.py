"""How accurate it is: on frames made by an optical model apart from this project, and on a tall part."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from soft_parts import Field, frames_of_part
from vialight.core.arrays import FloatArray, Grid, IntArray, Volume
from vialight.core.config import Camera, Resin, Rig, Vial
from vialight.core.mesh import Mesh
from vialight.metrology.distance import deviation, sample_surface
from vialight.metrology.surface import isosurface, pieces
from vialight.store import open_frames, write_frames
from vialight.store.foreign.meshes import load_mesh
from vialight.store.rig_files import load_rig
from vialight.tomography.reconstruct import Settings, open_scan, reconstruct
from vialight.twin.sensor import Sensor

THRESHOLD = 100.0

_TURN = np.arange(180)
KEPT = {
    "all frames": _TURN,
    "10 % missing": np.delete(_TURN, np.random.default_rng(3).choice(180, 18, replace=False)),
    # No frames for 16 deg: seven missing leave 15 deg without a frame within half a degree.
    "15 deg gap": np.delete(_TURN, np.s_[100:107]),
}


class Accuracy(NamedTuple):
    """What the issue bounds."""

    rms_mm: float
    share_found: float
    volumes_mm3: FloatArray


def measured_surface(folder: Path, kept: IntArray, settings: Settings) -> Mesh:
    rig = load_rig(folder / "rig.toml")
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "frames.h5"
        with open_frames(folder / "frames.h5") as whole:
            dark = whole.dark()
            assert dark is not None
            # Scaled, so that the mean of eight dark frames stays whole.
            write_frames(
                path, whole.read(kept) * np.uint16(8), whole.angles_rad[kept], dark=np.rint(8 * dark).astype(np.uint16)
            )
        with open_frames(path) as frames:
            volume = reconstruct(open_scan(frames, rig, settings), settings)
    return isosurface(Volume(volume.density / np.float32(8), volume.grid), THRESHOLD)


@cache
def accuracy(folder: Path, kept: str, accurate: bool) -> Accuracy:
    surface = measured_surface(folder, KEPT[kept], Settings(accurate=accurate))
    truth = load_mesh(folder / "truth.stl")
    to_truth = deviation(sample_surface(surface, 30_000), truth)
    from_truth = deviation(sample_surface(truth, 30_000), surface)
    return Accuracy(to_truth.rmse_mm, from_truth.share_within(0.1), pieces(surface))


@pytest.mark.parametrize("kept", KEPT)
@pytest.mark.parametrize("case", ["part", "cylinder"])
def test_the_surface_is_true_to_12_um(shared_cases: Path, case: str, kept: str) -> None:
    """RMS in um, of all frames, of 90 %, with a gap: part 10.1, 11.0, 10.5; cylinder 8.5, 9.1, 8.8.

    Half of it is noise, most of the rest the soft rims.
    """
    found = accuracy(shared_cases / case, kept, accurate=False)
    assert found.rms_mm <= 0.012
    assert found.share_found >= 0.999
    assert (found.volumes_mm3 > 1.0).sum() == 1


@pytest.mark.parametrize("case", ["part", "cylinder"])
def test_accurate_is_no_worse_on_low_parts(shared_cases: Path, case: str) -> None:
    """RMS in um: part 9.7, by default 10.1; cylinder 8.2, by default 8.5."""
    default, accurate = (accuracy(shared_cases / case, "all frames", accurate=mode) for mode in (False, True))
    assert accurate.rms_mm <= min(default.rms_mm, 0.012)
    assert accurate.share_found >= max(default.share_found - 1e-4, 0.999)
    assert (accurate.volumes_mm3 > 1.0).sum() == 1


def tall_part(x: Any, y: Any, z: Any) -> Any:
    """Signed distance to four posts off the axis on a plate, with a step 8.3 mm and flat ends 9 mm above and below."""
    from_post, height = np.hypot(np.abs(x) - 3.9, np.abs(y) - 3.9), np.abs(z)
    posts = np.minimum(_cylinder(from_post - 1.2, height - 8.3), _cylinder(from_post - 0.72, height - 9.0))
    return np.minimum(posts, _cylinder(np.hypot(x, y) - 5.5, height - 0.6))


def _cylinder(beside: Any, beyond: Any) -> Any:
    return np.minimum(np.maximum(beside, beyond), 0) + np.hypot(np.maximum(beside, 0), np.maximum(beyond, 0))


def plates(x: Any, y: Any, z: Any) -> Any:
    """Signed distance to two plates of 12.4 mm about the axis, 16 mm apart, on a shaft."""
    from_axis, height = np.hypot(x, y), np.abs(z)
    return np.minimum(_cylinder(from_axis - 6.2, np.abs(height - 8.0) - 0.6), _cylinder(from_axis - 2.0, height - 8.0))


@pytest.mark.parametrize(
    ("part", "symmetry", "most_of_default", "most_of_default_at_ends"),
    [pytest.param(tall_part, 4, 0.75, 0.55, id="posts off axis"), pytest.param(plates, 180, 1.0, 1.0, id="about it")],
)
def test_accurate_is_truer_on_tall_parts(
    part: Field, symmetry: int, most_of_default: float, most_of_default_at_ends: float, tmp_path: Path
) -> None:
    """RMS in um at D = 145 mm, of all and beyond 7 mm of height, with noise.

    Posts off the axis: default 13.6 and 28.2, accurate 9.0 and 14.1; an end face is seen up to 0.2 mm higher from one
    side than from the other.  Plates about it: default 12.3 and 13.7, accurate 10.8 and 12.1; both sides see the same,
    and rims are lost if what no ray measures is left out, which made accurate worse than default.
    """
    rig = Rig(
        vial=Vial(outer_radius_mm=12.4, wall_mm=1.1, wall_index=1.472),
        resin=Resin(index_imaging=1.48),
        camera=Camera(distance_mm=145.0, pixel_mm=0.155, axis_column=87.3, optical_row=74.5),
    )
    angles = np.arange(180, dtype=np.float64) * (2 * np.pi / 180)
    # The part looks the same again after so many frames.
    seen = frames_of_part(part, Grid((380, 254, 254), 0.05), rig, (150, 176), angles[: 180 // symmetry])
    counts = Sensor().photograph(np.concatenate([seen] * symmetry), np.random.default_rng(0))
    write_frames(tmp_path / "frames.h5", counts, angles)
    rms, rms_of_ends = [], []
    for settings in (Settings(voxel_mm=0.1), Settings(voxel_mm=0.1, accurate=True)):
        with open_frames(tmp_path / "frames.h5") as frames:
            surface = isosurface(reconstruct(open_scan(frames, rig, settings), settings), THRESHOLD)
        samples = sample_surface(surface, 50_000)
        distance, area = part(*samples.points_mm.T), samples.weights_mm2
        ends = np.abs(samples.points_mm[:, 2]) > 7
        rms.append(np.sqrt(np.average(distance**2, weights=area)))
        rms_of_ends.append(np.sqrt(np.average(distance[ends] ** 2, weights=area[ends])))
    assert rms[1] < 0.012
    assert rms[1] < most_of_default * rms[0]
    assert rms_of_ends[1] < most_of_default_at_ends * rms_of_ends[0]
