"""Plan parts with and without a ceiling on light, judge both as `planning` does, and print a table.

Usage: ``python benchmarks/ceiling.py [--short] [--peer-python PYTHON] [--markdown docs/light-ceiling.md]``.  PYTHON is
an interpreter that has pymeshlab, for the bunny.  A minute on two cores.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np
from planning import Part, Peers, judge, optimise, parts, patterns_of

from vialight.projections import CEILING, method_named

PASSES = 20
CEILINGS = (1.0, CEILING)
IRRADIANCE_MW_PER_CM2, CRITICAL_MJ_PER_CM2, SPEED_DEG_S = 60.0, 962.0, 20.0
"""Of the sample's printer and resin."""


def table(part: Part) -> list[str]:
    """Return a line of Markdown for each ceiling."""
    lines = []
    for ceiling in CEILINGS:
        projections = optimise(part, method_named("object-space", ceiling=ceiling), PASSES)
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
    """Print the table, or put it into a page between its marks."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--short", action="store_true", help="two small parts, for a quick look")
    parser.add_argument("--peer-python", default=sys.executable, help="interpreter that has pymeshlab")
    parser.add_argument("--markdown", type=Path, help="the page whose table is to be replaced")
    options = parser.parse_args()
    lines = [
        "| part | ceiling | Jaccard | in-part range | voxel error rate | process window | light | turns |",
        "| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |",
    ]
    with tempfile.TemporaryDirectory() as scratch:
        for part in parts(options.short, Peers(options.peer_python, Path(scratch)).bunny):
            lines += table(part)
            print("\n".join(lines[-len(CEILINGS) :]), file=sys.stderr, flush=True)
    text = "\n".join(lines)
    if options.markdown is None:
        print(text)
        return
    before, after = options.markdown.read_text(encoding="utf-8").split("<!-- table -->")[::2]
    options.markdown.write_text(f"{before}<!-- table -->\n\n{text}\n\n<!-- table -->{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
