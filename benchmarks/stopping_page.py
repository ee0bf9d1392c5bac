"""Results of `stopping` as a page in Markdown."""

from __future__ import annotations

import platform

import numpy as np
from stopping import (
    GOAL_SHARE,
    IRRADIANCE_MW_PER_CM2,
    LATEST_SHARE,
    SIGMAS,
    UPSETS,
    VOXEL_MM,
    WRONG_RESINS,
    Row,
)

TURN_S = 18.0

_COLUMNS = (
    "best, s | turns | auto, s | error, % | RMSE best, mm | reached, mm | sigma, % | covered | sensitivity found | "
    "first told, % of best"
)
_RULE = " ".join(["---:"] * 10).replace(" ", " | ")


def page(rows: list[Row], turns: dict[str, list[list[float]]]) -> str:
    """Return the whole page."""
    unknown = [row for row in rows if not row.upset]
    wrong = [row for row in rows if row.upset in WRONG_RESINS]
    upset = [row for row in rows if row.upset in UPSETS]
    sections = [
        _HEAD.format(voxel=VOXEL_MM, irradiance=IRRADIANCE_MW_PER_CM2, sigmas=SIGMAS, python=platform.python_version()),
        "## Resin of unknown sensitivity\n\n" + _table(unknown, "part | sensitivity", _named_by_sensitivity),
        _goals(unknown),
        "## Resin other than believed\n\n" + _WRONG + _table(wrong, "part | resin", _named_by_upset) + _coverage(wrong),
        "## Print other than rehearsed\n\n" + _UPSET + _table(upset, "part | what", _named_by_upset) + _coverage(upset),
        "## Within a turn\n\n" + _TURN + _turns(turns),
        "## Simpler rules\n\n" + _RULES + _rules(unknown),
    ]
    return "\n".join(section.rstrip("\n") + "\n" for section in sections)


def _named_by_sensitivity(row: Row) -> str:
    return f"{row.part} | {row.sensitivity:.2f}"


def _named_by_upset(row: Row) -> str:
    return f"{row.part} | {row.upset}"


def _table(rows: list[Row], names: str, name_of: object) -> str:
    assert callable(name_of)
    lines = [f"| {names} | {_COLUMNS} |", f"| --- | --- | {_RULE} |"]
    lines += [
        f"| {name_of(row)} | {row.best_s:.1f} | {row.best_s / TURN_S:.1f} | {row.stop_s:.1f} | "
        f"{100 * row.error:+.1f} | {row.best_rmse_mm:.3f} | {row.rmse_mm:.3f} | "
        f"{100 * row.sigma_s / row.predicted_s:.1f} | "
        f"{'yes' if row.covered else '**no**'} | {row.found_sensitivity:.3f} | {100 * row.ready_s / row.best_s:.0f} |"
        for row in rows
    ]
    return "\n".join(lines) + "\n"


def _goals(rows: list[Row]) -> str:
    errors = np.array([row.error for row in rows])
    ratio = max(row.rmse_mm / row.best_rmse_mm for row in rows)
    found = max(abs(row.found_sensitivity / row.sensitivity - 1) for row in rows)
    lines = [
        "| goal | found | met |",
        "| --- | ---: | --- |",
        f"| within {100 * GOAL_SHARE:g} % of the best dose | {100 * np.abs(errors).max():.1f} % at most, "
        f"{100 * np.sqrt(np.mean(errors**2)):.1f} % RMS | {_yes(np.abs(errors).max() <= GOAL_SHARE)} |",
        f"| never later than {100 * LATEST_SHARE:g} % | {100 * errors.max():+.1f} % | "
        f"{_yes(errors.max() <= LATEST_SHARE)} |",
        f"| RMSE within 30 % or 0.015 mm of the best | {100 * (ratio - 1):.0f} % above at most | "
        f"{_yes(all(row.is_close for row in rows))} |",
        f"| errors covered by {SIGMAS:g} sigma | {sum(row.covered for row in rows)} of {len(rows)} | "
        f"{_yes(all(row.covered for row in rows))} |",
    ]
    told = f"The sensitivity is found to {100 * found:.1f} % or better.\n"
    return "\n".join(lines) + "\n\n" + told


def _coverage(rows: list[Row]) -> str:
    if not rows:
        return ""
    errors = np.array([row.predicted_s - row.best_s for row in rows]) / [row.sigma_s for row in rows]
    late = max(100 * row.error for row in rows)
    return (
        f"\n{sum(row.covered for row in rows)} of {len(rows)} errors are covered; the largest is "
        f"{np.abs(errors).max():.1f} sigma, the latest stop {late:+.1f} %.  RMSE within 30 % or 0.015 mm of the best "
        f"in {sum(row.is_close for row in rows)} of {len(rows)}.\n"
    )


def _turns(turns: dict[str, list[list[float]]]) -> str:
    text = ""
    for part, rows in turns.items():
        text += f"\n| {part}, turns | RMSE, mm | of an even dose, mm | waiting, s |\n| ---: | ---: | ---: | ---: |\n"
        text += "".join(f"| {turn:.2f} | {real:.4f} | {even:.4f} | {wait:.1f} |\n" for turn, real, even, wait in rows)
    near = [1000 * (row[1] - row[2]) for rows in turns.values() for row in rows if _is_near(row, rows)]
    if near:
        text += f"\nWithin 3 % of the best stop, the two differ by {np.abs(near).max():.1f} um at most.\n"
    return text


def _is_near(row: list[float], rows: list[list[float]]) -> bool:
    best = min(rows, key=lambda other: other[2])[0]
    return abs(row[0] - best) <= 0.03 * best


def _rules(rows: list[Row]) -> str:
    lines = ["| rule | largest error, % | RMS, % | latest, % |", "| --- | ---: | ---: | ---: |"]
    stops = {"auto": np.array([row.error for row in rows])}
    for rule in rows[0].rules_s if rows else ():
        stops[rule] = np.array([row.rules_s[rule] / row.best_s - 1 for row in rows])
    lines += [
        f"| {rule} | {100 * np.abs(errors).max():.1f} | {100 * np.sqrt(np.mean(errors**2)):.1f} | "
        f"{100 * errors.max():+.1f} |"
        for rule, errors in stops.items()
    ]
    return "\n".join(lines) + "\n"


def _yes(met: bool | np.bool_) -> str:
    return "yes" if met else "**no**"


_HEAD = """# When a print stops

Made by `python benchmarks/stopping.py --markdown docs/stopping.md`, Python {python}.  How `auto` decides, and why so,
is in [ADR 6](adr/0006-when-to-stop.md).

The twin prints five parts, planned on voxels of {voxel:g} mm, in DUDMA, with {irradiance:g}
mW/cm^2 at level 255 and noisy frames of 0.31 mm pixels.  The live volume is that of
`tomography.sliding.window.SlidingWindow`, looked at thirty times a turn.
All that is known beforehand is a rehearsal of the plan in resins of nominal chemistry.

- *best*: lit time after which the final shape, dark cure included, has the least two-sided RMSE to the design,
  `sqrt((RMSE(print to design)^2 + RMSE(design to print)^2) / 2)`.  The twin's state is kept every 2 s, its light cut,
  its dark cure let finish; the best is the lowest point of a parabola through the squares.
- *auto*: lit time at which `control.prediction.should_stop` turned the light off; *error*: its dose relative to the
  best.
- *sigma*: the stated standard deviation; *covered*: predicted and best differ by no more than {sigmas:g} of them.
- *first told*: when a prediction was first good enough to act on.
"""

_WRONG = """Sensitivity 1; the rehearsal believes the nominal resin, and I_p is the density at *its* gel point.  With
another scattering middle, I_p is met at a conversion that is not the gel point, and nothing that is seen tells this
from another sensitivity: this error can be stated, not removed.

"""
_UPSET = """Sensitivity 1, nominal resin.

"""
_TURN = """Real patterns against the same dose spread evenly, about the best stop.  *Waiting* is the model's measure of
how uneven the dose of a part of a turn is: the RMS of how many seconds places near the surface are ahead or behind.
"""
_RULES = """The 25 prints of the first table, had they been stopped otherwise; *onset* is when 2 % of the places watched
have been seen to cure.

"""
