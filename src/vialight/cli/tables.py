"""Results as lines for a terminal."""

from __future__ import annotations

from pathlib import Path
from typing import Any

_KINETICS_ROWS = 12


def reconstruction_lines(result: dict[str, Any], out: Path) -> list[str]:
    """Say what was reconstructed."""
    settings, volume, surface = result["settings"], result["volume"], result["surface"]
    shape = " x ".join(str(count) for count in volume["shape_zyx"])
    lines = [
        f"frames used     {settings['frames_used']}, binning {settings['binning']}",
        f"volume          {shape} voxels of {settings['voxel_mm']:g} mm, "
        f"{volume['density_min']:.4g} to {volume['density_max']:.4g} {volume['unit']}",
    ]
    if surface is None:
        lines.append("surface         not drawn: no threshold; give --threshold or [resin] threshold in the rig")
    else:
        low, high = surface["bounds_mm"]
        size = " x ".join(f"{end - start:.3f}" for start, end in zip(low, high, strict=True))
        lines.append(f"surface         {size} mm, {surface['volume_mm3']:.2f} mm^3, {surface['faces']} faces")
    return [*lines, f"written to      {out} in {result['elapsed_s']:.1f} s"]


def simulation_lines(result: dict[str, Any], out: Path) -> list[str]:
    """Say what the twin printed."""
    printed, truth = result["printed"], result["truth"]
    return [
        f"light on        {printed['lit_s']:.0f} s, {printed['turns_lit']:.2f} turns",
        f"dose            {truth['largest_dose_mj_per_cm2']:.0f} mJ/cm^2 at most; "
        f"critical: {truth['critical_dose_mj_per_cm2']:.0f}",
        f"gelled          {truth['first_gelled_s']:.0f} to {truth['last_gelled_s']:.0f} s, "
        f"{truth['volume_mm3']:.2f} mm^3 ({truth['reference_volume_mm3']:.2f} meant)",
        f"frames          {printed['frames']}, {printed['frames_dropped']} dropped",
        f"written to      {out} in {result['elapsed_s']:.1f} s",
    ]


def measurement_lines(result: dict[str, Any], out: Path) -> list[str]:
    """Tabulate how far the print is off."""
    poses = [(name, result[key]) for name, key in (("as placed", "as_placed"), ("aligned", "aligned")) if result[key]]
    rows = [
        ("RMSE", "rmse_mm", "mm"), ("RMSE, of the largest dimension", "rmse_percent", "%"),
        ("standard deviation", "std_mm", "mm"), ("mean", "mean_mm", "mm"), ("95 % within", "p95_mm", "mm"),
        ("RMSE, reference to print", "reverse_rmse_mm", "mm"), ("largest deviation", "hausdorff_mm", "mm"),
        ("intersection over union", "iou", ""), ("volume error", "volume_error_percent", "%"),
    ]  # fmt: skip
    lines = [" " * 34 + "".join(f"{name:>12}" for name, _ in poses)]
    for title, key, unit in rows:
        values = "".join(f"{pose[key]:12.4f}" if pose[key] is not None else f"{'-':>12}" for _, pose in poses)
        lines.append(f"{title:<34}{values} {unit}".rstrip())
    if result["tolerance"]:
        verdict = "passed" if result["tolerance"]["passed"] else "FAILED"
        lines.append(f"tolerance {result['tolerance']['tolerance_mm']:g} mm: {verdict}")
    return [*lines, f"report: {out / 'report.html'}"]


def plan_lines(result: dict[str, Any], out: Path | None) -> list[str]:
    """Tabulate what a plan is expected to do; without `out`, of a plan that was only judged."""
    metrics = result["metrics"]
    rows = [
        ("Jaccard index, best threshold", "jaccard", ""), ("best threshold, of the dose meant", "best_threshold", ""),
        ("process window", "process_window", ""), ("in-part dose range", "in_part_dose_range", ""),
        ("voxel error rate", "voxel_error_rate", ""), ("light efficiency", "light_efficiency", ""),
        ("exposure a turn", "exposure_per_turn_mj_per_cm2", "mJ/cm^2"),
        ("turns to the critical exposure", "turns_to_critical_exposure", ""),
    ]  # fmt: skip
    lines = [
        f"{title:<34}{metrics[key]:12.4f} {unit}".rstrip() for title, key, unit in rows if metrics.get(key) is not None
    ]
    if out is None:
        return lines
    count, height, width = result["patterns"]["shape"]
    # Patterns that were given took no passes.
    made = f" after {metrics['passes']} passes" if "passes" in metrics else ""
    lines.append(f"{count} patterns of {height} x {width} pixels{made}: {out}")
    return [*lines, f"report: {out.with_suffix('.html')}"]


def print_lines(result: dict[str, Any], out: Path) -> list[str]:
    """Say what was printed, who ended it and why, and how true it is."""
    printed = result["printed"]
    lines = [
        f"light on        {printed['lit_s']:.1f} s, {printed['lit_turns']:.2f} turns; ended by {printed['ended_by']}",
        f"frames          {printed['frames']}, {printed['frames_missed']} missed",
        f"patterns        {printed['refreshes']} refreshes, {printed['refreshes_not_due']} with another than was due, "
        f"{printed['refreshes_off']} by more than a refresh",
    ]
    if printed["forecast"]:
        lines.append(f"forecast        {printed['forecast']['why']}")
    lines += [f"doubtful        {doubt}" for doubt in printed["doubts"]]
    if printed["fault"]:
        lines.append(f"fault           {printed['fault']}")
    lines += [f"written to      {out} in {result['elapsed_s']:.1f} s", ""]
    if result["measured"] is None:
        return [*lines, f"not measured    {result['why_not_measured']}"]
    return [*lines, *measurement_lines(result["measured"], out)]


def watch_lines(result: dict[str, Any]) -> list[str]:
    """Say what a replay has shown, and how late."""
    lines = [
        f"frames          {result['frames']}, {result['snapshots']} snapshots, {result['surfaces']} surfaces measured",
        f"latency         {1e3 * result['latency_p50_s']:.0f} ms median, {1e3 * result['latency_p95_s']:.0f} ms "
        "in 95 % of snapshots, from a frame's arrival",
        f"refraction      adds {result['refraction_delay_half_field_s']:.1f} s at half of the field, "
        f"{result['refraction_delay_edge_s']:.1f} s at its edge",
    ]
    if result["rmse_mm"] is not None:
        lines.append(f"at the end      RMSE {result['rmse_mm']:.3f} mm, reverse {result['reverse_rmse_mm']:.3f} mm, "
                     f"IoU {result['iou']:.4f}")  # fmt: skip
    return lines


def calibration_lines(result: dict[str, Any], out: Path) -> list[str]:
    """Tabulate what a calibration found."""
    lines = [f"{'':<44}{'before':>14}{'found':>14}{'standard':>12}"]
    for found in result["found"]:
        values = [found["before"], found["value"], found["uncertainty"]]
        cells = [_cell(value, width) for value, width in zip(values, (14, 14, 12), strict=True)]
        lines.append(f"{'[' + found['table'] + '] ' + found['key']:<44}{''.join(cells)}".rstrip())
    for table in result["tables"]:
        lines += ["", *_aligned([[table["title"], *table["heads"][1:]], *table["rows"]])]
    return [*lines, "", *result["notes"], f"new rig: {out}", f"page: {out.with_suffix('.html')}"]


def _aligned(rows: list[list[str]]) -> list[str]:
    """Return rows with their columns one below the other, the first to the left, the others to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(f"{cell:<{widths[0]}}" if k == 0 else f"{cell:>{widths[k]}}" for k, cell in enumerate(row)).rstrip()
        for row in rows
    ]


def _cell(value: Any, width: int) -> str:
    text = "-" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)
    return f"{text:>{width}}"


def device_lines(result: dict[str, Any]) -> list[str]:
    """List what is connected, each with the lines that name it in a rig."""
    named = [
        ("cameras", [(f"{one['model']}, serial number {one['serial']}, {one['protocol']}", one["rig"])
                     for one in result["cameras"]]),
        ("serial ports", [(f"{one['port']}: {one['description']}", one["rig"]) for one in result["serial_ports"]]),
        ("monitors", [(f"{one['index']}: {one['name']}, {one['columns']} x {one['rows']} at {one['refresh_hz']} Hz",
                       one["rig"]) for one in result["monitors"]]),
    ]  # fmt: skip
    lines = []
    for title, found in named:
        lines.append(f"{title}: {len(found) or 'none'}")
        for told, rig in found:
            lines += [f"  {told}", *(f"      {line}" for line in rig)]
    return lines + [f"not looked for: {told}" for told in result["unable"].values()]


def doctor_lines(result: dict[str, Any]) -> list[str]:
    """Say what was found of each device, and what to do."""
    lines = []
    for one in result["findings"]:
        lines.append(f"{one['state']:<6}{one['device']:<10}{one['told']}")
        if one["remedy"]:
            lines.append(f"{'':<16}-> {one['remedy']}")
    return [*lines, "all is well" if result["is_well"] else "something is wrong"]


def record_lines(result: dict[str, Any]) -> list[str]:
    """Say what was recorded."""
    columns = result["image_shape"][1]
    return [
        f"frames          {result['frames']} of {columns} x {result['image_shape'][0]} pixels, "
        f"{result['frames_missed']} missed, {result['dark_frames']} dark",
        f"turns           {result['turns']:.3f}" + ("" if result["is_complete"] else ", ended early"),
        f"written to      {result['file']} in {result['elapsed_s']:.1f} s",
    ]


def kinetics_lines(result: dict[str, Any], out: Path) -> list[str]:
    """Say what happened at a place, in a dozen rows, and what failed."""
    table, settings = result["table"], result["settings"]
    unit = result["dose_unit"]
    has_dose = unit is not None
    lines = [
        f"at {', '.join(f'{value:g}' for value in settings['at_mm'])} mm"
        + (f", within {settings['radius_mm']:g} mm" if settings["radius_mm"] else "")
        + f"; gelled above {settings['threshold_counts_per_mm']:g} counts per mm",
        f"light: {result['light']}",
        "",
        "   turns of light    light, s     time, s   counts per mm" + (f"   dose, {unit}" if has_dose else ""),
    ]
    count = len(table["time_s"])
    for row in sorted({round(k * (count - 1) / _KINETICS_ROWS) for k in range(_KINETICS_ROWS + 1)}):
        values = [table[name][row] for name in ("turn", "lit_s", "time_s", "density_counts_per_mm")]
        turn, lit_s, time_s, density = (float(value) for value in values)
        dose = f"{float(table['dose'][row]):12.4g}" if has_dose else ""
        lines.append(f"   {turn:14.2f} {lit_s:11.1f} {time_s:11.1f} {density:15.1f}{dose}")
    gelled = result["gelled_at_lit_s"]
    lines += ["", "never gelled here" if gelled is None else f"seen to gel here after {gelled:.1f} s of light"]
    if result["failures"] is None:
        lines.append("no reference: failures were not looked for")
    elif not result["failures"]:
        lines.append("nothing failed: no matter outside the tolerance, none inside stopped gaining")
    else:
        lines.append("what failed, the first first:")
        lines += [
            f"   {one['what']} from turn {one['turn']:.2f} ({one['lit_s']:.1f} s of light, {one['time_s']:.1f} s), at "
            f"({', '.join(f'{value:.2f}' for value in one['at_mm'])}) mm, {one['size_mm3']:.2f} mm^3 in the end"
            for one in result["failures"]
        ]
    return [*lines, f"written to {out}"]


def check_lines(result: dict[str, Any]) -> list[str]:
    """Tabulate what has changed since a calibration."""
    lines = [f"{'':<40}{'expected':>12}{'found':>12}{'may differ':>12}"]
    for check in result["checks"]:
        values = "".join(f"{check[key]:12.4g}" for key in ("rig", "found", "allowed"))
        changed = "" if check["good"] else f"CHANGED: {check['means']}"
        lines.append(f"{check['what']:<40}{values} {check['unit']:<8}{changed}".rstrip())
    verdict = "the calibration is still good" if result["good"] else "calibrate again"
    return [*lines, *result["notes"], verdict, f"page: {result['page']}"]
