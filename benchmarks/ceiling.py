"""Plan parts with and without a ceiling on light, judge both as `plans` does, and print a table.

Usage: ``python benchmarks/ceiling.py [--short] [--peer-python PYTHON]``.  PYTHON is an interpreter that has pymeshlab,
for the bunny.  Some minutes on two cores.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np
from plans import HELD, Part, Peers, Way, judge, optimise, parts, patterns_of

from vialight.planning.projections import CEILING, method_named

PASSES = 20
CEILINGS = (1.0, CEILING)
IRRADIANCE_MW_PER_CM2, CRITICAL_MJ_PER_CM2, SPEED_DEG_S = 60.0, 962.0, 20.0
"""Of the sample's printer and resin."""


def table(part: Part) -> list[str]:
    """Return a line of Markdown for each ceiling."""
    lines = []
    for ceiling in CEILINGS:
        method = method_named("object-space", ceiling=ceiling)
        projections = optimise(part, Way(method, PASSES, held=HELD))
        score = judge(patterns_of(projections), part)
        # The judge's dose is in levels times rad: a level of 255 for a rad is all light for so many seconds.
        exposure = IRRADIANCE_MW_PER_CM2 * score.best_threshold / 255 / np.radians(SPEED_DEG_S)
        lines.append(
            f"| {part.name} | {'none' if ceiling == 1 else f'{ceiling:g}'} | {score.jaccard:.4f} "
            f"| {score.in_part_dose_range:.3f} | {score.voxel_error_rate:.1e} | {score.process_window:+.3f} "
            f"| {score.light_efficiency:.1%} | {CRITICAL_MJ_PER_CM2 / exposure:.1f} |"
        )
    return lines


def main() -> None:
    """Print the table, a part at a time."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--short", action="store_true", help="two small parts, for a quick look")
    parser.add_argument("--peer-python", default=sys.executable, help="interpreter that has pymeshlab")
    options = parser.parse_args()
    print("| part | ceiling | Jaccard | in-part range | voxel error rate | process window | light | turns |")
    print("| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |")
    with tempfile.TemporaryDirectory() as scratch:
        for part in parts(options.short, Peers(options.peer_python, Path(scratch)).bunny):
            print("\n".join(table(part)), flush=True)


if __name__ == "__main__":
    main()
