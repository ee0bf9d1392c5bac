"""Compare what the planning methods make of a bracket with holes, at coarse voxels.

Run it with ``python examples/compare_methods.py``; it takes a few seconds and prints a table.
"""

from __future__ import annotations

import tempfile
import time
from importlib.resources import files
from pathlib import Path
from typing import get_args

from vialight.commands import PlanSettings, plan_part
from vialight.planning.projections import MethodName
from vialight.planning.shapes import bracket
from vialight.store import write_stl


def main() -> None:
    """Plan the same part with every method and print how the finished patterns score."""
    folder = Path(tempfile.mkdtemp())
    part = folder / "bracket.stl"
    write_stl(part, bracket(pitch_mm=0.2))
    printer = Path(str(files("vialight") / "commands" / "sample" / "printer.toml"))
    print(f"{'method':<14}{'Jaccard':>9}{'window':>9}{'range':>9}{'errors':>9}{'s':>7}")
    for method in get_args(MethodName):
        settings = PlanSettings(method=method, passes=2 if method == "gradient" else None, voxel_mm=0.3, angles=90)
        started = time.monotonic()
        result = plan_part(part, printer, folder / f"{method}.h5", settings=settings, page=False)["metrics"]
        figures = [result[name] for name in ("jaccard", "process_window", "in_part_dose_range", "voxel_error_rate")]
        print(f"{method:<14}" + "".join(f"{value:9.4f}" for value in figures) + f"{time.monotonic() - started:7.1f}")


if __name__ == "__main__":
    main()
