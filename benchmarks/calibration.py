"""How often stated uncertainties of a calibrated axis cover the truth: ``python benchmarks/calibration.py [DRAWS]``.

One recording by the twin's camera, of three posts in a vial that goes round an axis that is off and leans; noise is
drawn anew each time, and the axis found from a rig that is four columns off.  Prints a table for docs/calibration.md.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from calibrate.wobbling import AXIS_COLUMN, axis_found, recorded
from vialight.twin import Faults

TRUTH = np.array([AXIS_COLUMN, np.degrees(0.005), 0.15, 0.0])
ROWS = (("axis, columns", 4), ("tilt, deg", 4), ("run-out x, mm", 5), ("run-out y, mm", 5))


def main(draws: int) -> None:
    """Print the table, after every tenth draw."""
    recording = recorded(Faults(axis_offset_mm=(0.3, 0.0), run_out_mm=0.15, tilt_rad=(0.005, 0.0)))
    unit = np.array([1.0, np.degrees(1.0), 1.0, 1.0])
    values, stated = [], []
    for draw in range(draws):
        fit = axis_found(recording, off=-4.0, seed=draw).fit
        values.append(fit.parameters[:4] * unit)
        stated.append(fit.std[:4] * unit)
        if (draw + 1) % 10 == 0:
            show(np.array(values), np.array(stated))


def show(values: np.ndarray, stated: np.ndarray) -> None:
    """Print what `values` (draw, 4) and their standard uncertainties say."""
    covered = np.abs(values - TRUTH) <= 1.96 * stated
    print(f"\n| {len(values)} draws | mean error | scatter | stated | largest error | covered at 95 % |")
    print("| --- | ---: | ---: | ---: | ---: | ---: |")
    for index, (name, digits) in enumerate(ROWS):
        error = values[:, index] - TRUTH[index]
        figures = (error.mean(), error.std(ddof=1), stated[:, index].mean(), np.abs(error).max())
        text = " | ".join(f"{figure:.{digits}f}" for figure in figures)
        print(f"| {name} | {text} | {100 * covered[:, index].mean():.0f} % |", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 100)
