"""The command line, run as a user runs it: in a process of its own."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from vialight import cli
from vialight.commands import PlanSettings
from vialight.tomography.reconstruct import Settings

ROOT = Path(__file__).parents[2]
SAMPLE = ROOT / "src" / "vialight" / "commands" / "sample"
PROGRAM = str(Path(sys.executable).parent / "vialight")


def run(*arguments: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    command = [PROGRAM, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=cwd, timeout=300)


@pytest.fixture(scope="module")
def reconstruction(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out: Path = tmp_path_factory.mktemp("cli") / "print"
    done = run("reconstruct", SAMPLE / "frames.h5", "--rig", SAMPLE / "rig.toml", "--voxel", 0.155, "--out", out)
    assert done.returncode == 0, done.stderr
    return out


def test_every_command_has_help_with_an_example() -> None:
    commands = re.findall(r"^  (\w+) ", run("--help").stdout.split("Commands:")[1], flags=re.MULTILINE)
    assert {"reconstruct", "measure", "plan", "export", "demo"} <= set(commands)
    inner = re.findall(r"^  (\w+) ", run("calibrate", "--help").stdout.split("Commands:")[1], flags=re.MULTILINE)
    for command in [*commands, *(f"calibrate {name}" for name in inner)]:
        text = run(*command.split(), "--help").stdout
        # On a line of its own, to be copied.
        assert re.search(rf"^    vialight {command}( |$)", text.split("Example:\n")[1], flags=re.MULTILINE), text


def test_help_imports_nothing_heavy() -> None:
    code = "import sys, vialight.cli; print(sorted({'numpy', 'numba', 'vtk', 'h5py', 'pydantic'} & set(sys.modules)))"
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "[]"


def test_reconstruct_writes_what_the_design_says(reconstruction: Path) -> None:
    assert {path.name for path in reconstruction.iterdir()} == {
        "volume.zarr", "surface.stl", "reconstruction.json", "pictures",
    }  # fmt: skip
    result = json.loads((reconstruction / "reconstruction.json").read_text())
    assert result["settings"]["threshold_counts_per_mm"] == 100.0
    assert result["surface"]["volume_mm3"] == pytest.approx(233.5, rel=0.02)
    assert len(result["inputs"]["frames"]["sha256"]) == 64


def test_measure_takes_the_folder_and_prints_json_alone(reconstruction: Path, tmp_path: Path) -> None:
    done = run("measure", reconstruction, "--reference", SAMPLE / "part.stl", "--out", tmp_path / "m", "--json")
    assert done.returncode == 0, done.stderr
    metrics = json.loads(done.stdout)
    assert metrics == json.loads((tmp_path / "m" / "metrics.json").read_text())
    assert metrics["as_placed"]["rmse_mm"] < 0.03
    assert metrics["aligned"]["rmse_mm"] <= metrics["as_placed"]["rmse_mm"] + 1e-4
    report = (tmp_path / "m" / "report.html").read_text()
    assert "A frame, with the vial as the rig has it" in report
    assert (tmp_path / "m" / "deviation.ply").read_bytes().startswith(b"ply")


def test_the_readme_commands_run(tmp_path: Path) -> None:
    """The worked examples, line by line, as they stand in the README."""
    blocks = re.findall(r"```sh\n(vialight .*?)```", (ROOT / "README.md").read_text(), flags=re.DOTALL)
    for name in ("frames.h5", "rig.toml", "part.stl", "printer.toml"):
        shutil.copy(SAMPLE / name, tmp_path)
    lines = "".join(blocks).strip().splitlines()
    assert len(lines) >= 4
    for line in lines:
        done = run(*shlex.split(line, comments=True)[1:], cwd=tmp_path)
        assert done.returncode == 0, (line, done.stderr)
    assert (tmp_path / "print" / "report.html").is_file()
    assert (tmp_path / "plan.html").is_file()


def frames_file(path: Path, *, frames: int = 180, theta: np.ndarray | None = None) -> Path:
    with h5py.File(path, "w") as file:
        file["implements"] = "exchange"
        file["exchange/data"] = np.ones((frames, 20, 176), np.uint16)
        file["exchange/theta"] = np.arange(180) * 2.0 if theta is None else theta
    return path


def rig_with(tmp_path: Path, old: str, new: str) -> Path:
    text = (SAMPLE / "rig.toml").read_text()
    assert old in text
    path = tmp_path / "rig.toml"
    path.write_text(text.replace(old, new))
    return path


def bad_inputs(tmp_path: Path) -> dict[str, tuple[list[object], str]]:
    """Arguments of `reconstruct` and a part of the one line that must come."""
    good_rig, good_frames = SAMPLE / "rig.toml", SAMPLE / "frames.h5"
    text = tmp_path / "text.h5"
    text.write_text("no frames")
    empty = tmp_path / "empty.h5"
    h5py.File(empty, "w").close()
    half = tmp_path / "half.h5"
    half.write_bytes(good_frames.read_bytes()[:300_000])
    nan = np.arange(180) * 2.0
    nan[7] = np.nan
    (tmp_path / "file").write_text("in the way")

    def rig(old: str, new: str, name: str) -> Path:
        folder = tmp_path / name
        folder.mkdir()
        return rig_with(folder, old, new)

    return {
        "missing file": (["nowhere.h5", "--rig", good_rig], "nowhere.h5: there is no such file"),
        "not HDF5": ([text, "--rig", good_rig], "not HDF5"),
        "cut short": ([half, "--rig", good_rig], "half.h5"),
        "no data": ([empty, "--rig", good_rig], "/exchange/data"),
        "counts differ": ([frames_file(tmp_path / "c.h5", frames=179), "--rig", good_rig], "179"),
        "NaN angle": ([frames_file(tmp_path / "n.h5", theta=nan), "--rig", good_rig], "angle 7 is nan"),
        "missing rig": ([good_frames, "--rig", "nowhere.toml"], "nowhere.toml"),
        "unknown key": ([good_frames, "--rig", rig("wall_mm", "wal_mm", "u")], "unknown key wal_mm"),
        "missing key": ([good_frames, "--rig", rig("axis_column = 86.7", "", "m")], "axis_column"),
        "negative radius": ([good_frames, "--rig", rig("= 12.4", "= -12.4", "r")], "-12.4"),
        "axis outside": ([good_frames, "--rig", rig("= 86.7", "= 186.7", "a")], "186.7 lies outside the image"),
        "vial too wide": ([good_frames, "--rig", rig("= 12.4", "= 14.5", "w")], "the vial spans columns"),
        "empty surface": ([good_frames, "--rig", good_rig, "--threshold", 1e6], "no surface at 1e+06"),
        "negative threshold": ([good_frames, "--rig", good_rig, "--threshold", -5], "accepted: a positive density"),
        "NaN threshold": ([good_frames, "--rig", good_rig, "--threshold", "nan"], "--threshold: is nan"),
        "no such turn": ([good_frames, "--rig", good_rig, "--turn", 2], "--turn: is 2"),
        "no voxel": ([good_frames, "--rig", good_rig, "--voxel", 0], "--voxel: is 0"),
        "no binning": ([good_frames, "--rig", good_rig, "--bin", 0], "--bin: is 0"),
        "huge volume": ([good_frames, "--rig", good_rig, "--voxel", 0.001], "GB"),
    }


@pytest.mark.parametrize(
    "case",
    [
        "missing file", "not HDF5", "cut short", "no data", "counts differ", "NaN angle", "missing rig", "unknown key",
        "missing key", "negative radius", "axis outside", "vial too wide", "empty surface", "NaN threshold",
        "no such turn", "no voxel", "no binning", "huge volume",
    ],
)  # fmt: skip
def test_bad_input_gets_one_line_and_leaves_nothing(case: str, tmp_path: Path) -> None:
    arguments, message = bad_inputs(tmp_path)[case]
    out = tmp_path / "out"
    done = run("reconstruct", *arguments, "--out", out)
    assert done.returncode == 2, done.stderr
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith("vialight: ")
    assert message in done.stderr
    assert not out.exists()
    assert not list(tmp_path.glob(".*partial*"))


def test_an_output_folder_that_cannot_be_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    done = run("reconstruct", SAMPLE / "frames.h5", "--rig", SAMPLE / "rig.toml", "--out", tmp_path / "file" / "x")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("content", "message"),
    [(b"", "is empty"), (b"solid nothing\nendsolid\n", "no"), (b"\0" * 84, "no triangles")],
    ids=["no bytes", "no facets", "no triangles"],
)
def test_a_mesh_without_triangles_is_refused(content: bytes, message: str, tmp_path: Path) -> None:
    path = tmp_path / "empty.stl"
    path.write_bytes(content)
    done = run("measure", path, "--reference", SAMPLE / "part.stl", "--out", tmp_path / "out")
    assert done.returncode == 2, done.stderr
    assert done.stderr.count("\n") == 1
    assert message in done.stderr
    assert not (tmp_path / "out").exists()


def test_an_open_reference_is_measured_unsigned_with_a_warning(reconstruction: Path, tmp_path: Path) -> None:
    content = (SAMPLE / "part.stl").read_bytes()
    count = int.from_bytes(content[80:84], "little") - 1
    opened = tmp_path / "open.stl"
    opened.write_bytes(content[:80] + count.to_bytes(4, "little") + content[84:-50])
    done = run("measure", reconstruction, "--reference", opened, "--out", tmp_path / "m", "--json")
    assert done.returncode == 0, done.stderr
    assert "warning" in done.stderr
    assert "not watertight" in done.stderr
    assert json.loads(done.stdout)["iou"] is None


def test_a_file_of_a_folder_without_surface_says_what_to_do(tmp_path: Path) -> None:
    done = run("measure", tmp_path, "--reference", SAMPLE / "part.stl", "--out", tmp_path / "m")
    assert done.returncode == 2
    assert "--threshold" in done.stderr


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder: Path = tmp_path_factory.mktemp("plan")
    path = folder / "plan.h5"
    done = run(
        "plan", SAMPLE / "part.stl", "--rig", SAMPLE / "printer.toml", "--out", path, "--voxel", 0.4, "--angles", 60,
        "--passes", 3, "--save-state", folder / "state.npz",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return path


def test_plan_writes_patterns_metrics_and_a_page(plan: Path) -> None:
    assert {path.name for path in plan.parent.iterdir()} == {"plan.h5", "plan.json", "plan.html", "state.npz"}
    metrics = json.loads(plan.with_suffix(".json").read_text())["metrics"]
    assert 0.5 < metrics["jaccard"] <= 1
    assert metrics["turns_to_critical_exposure"] > 0


def test_a_plan_is_judged_under_another_rig(plan: Path, tmp_path: Path) -> None:
    clear = tmp_path / "clear.toml"
    clear.write_text(
        (SAMPLE / "printer.toml").read_text().replace("absorption_per_mm = 0.08", "absorption_per_mm = 0.0")
    )
    same, other = (
        json.loads(run("plan", "--score", plan, "--rig", rig, "--json").stdout)["metrics"]
        for rig in (SAMPLE / "printer.toml", clear)
    )
    planned = json.loads(plan.with_suffix(".json").read_text())["metrics"]
    assert same["jaccard"] == pytest.approx(planned["jaccard"], rel=1e-6)
    assert other["in_part_mean"] > 1.5 * same["in_part_mean"]


def test_patterns_are_exported_as_images(plan: Path, tmp_path: Path) -> None:
    done = run("export", plan, "--out", tmp_path / "patterns")
    assert done.returncode == 0, done.stderr
    assert len(list((tmp_path / "patterns").glob("*.png"))) == 60


def test_patterns_are_exported_as_a_video(plan: Path, tmp_path: Path) -> None:
    done = run("export", plan, "--out", tmp_path / "patterns.mp4", "--turns", 1)
    assert done.returncode == 0, done.stderr
    assert b"ftyp" in (tmp_path / "patterns.mp4").read_bytes()[:16]


def test_projections_of_another_program_become_a_plan(tmp_path: Path) -> None:
    np.save(tmp_path / "given.npy", np.ones((60, 20, 40), np.float32))
    done = run(
        "plan", SAMPLE / "part.stl", "--rig", SAMPLE / "printer.toml", "--out", tmp_path / "plan.h5", "--voxel", 0.4,
        "--projections", tmp_path / "given.npy", "--axes", "angle,row,column", "--span", 360,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "60 patterns of" in done.stdout
    assert {path.name for path in tmp_path.iterdir()} == {"given.npy", "plan.h5", "plan.json", "plan.html"}


@pytest.mark.parametrize("fault", ["cut short", "not a number"])
def test_damaged_projections_get_one_line(fault: str, tmp_path: Path) -> None:
    given = tmp_path / "given.npy"
    np.save(given, np.full((60, 20, 40), 1.0 if fault == "cut short" else np.nan, np.float32))
    given.write_bytes(given.read_bytes()[: 5000 if fault == "cut short" else None])
    done = run(
        "plan", SAMPLE / "part.stl", "--rig", SAMPLE / "printer.toml", "--out", tmp_path / "plan.h5", "--voxel", 0.4,
        "--projections", given, "--axes", "angle,row,column", "--span", 360,
    )  # fmt: skip
    assert done.returncode == 2, done.stderr
    assert done.stderr.count("\n") == 1
    assert str(given) in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["given.npy"]


def test_a_plan_goes_on_from_a_saved_state(plan: Path, tmp_path: Path) -> None:
    asked: list[object] = ["--rig", SAMPLE / "printer.toml", "--voxel", 0.4, "--angles", 60, "--passes", 6, "--json"]
    part = SAMPLE / "part.stl"
    gone_on = run("plan", part, *asked, "--resume", plan.with_name("state.npz"), "--out", tmp_path / "gone_on.h5")
    at_once = run("plan", part, *asked, "--out", tmp_path / "at_once.h5")
    found, expected = (json.loads(done.stdout)["metrics"] for done in (gone_on, at_once))
    assert found["passes"] == expected["passes"]
    assert found["in_part_dose_range"] == pytest.approx(expected["in_part_dose_range"], rel=1e-3)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere.stl", "--rig", SAMPLE / "printer.toml"], "nowhere.stl"),
        ([SAMPLE / "part.stl", "--rig", SAMPLE / "rig.toml"], "[projector]"),
        ([SAMPLE / "part.stl", "--rig", SAMPLE / "printer.toml", "--scale", "3"], "largest"),
        ([SAMPLE / "part.stl", "--rig", SAMPLE / "printer.toml", "--angles", "7"], "--angles"),
        ([SAMPLE / "part.stl", "--rig", SAMPLE / "printer.toml", "--void-limit", "2"], "--void-limit"),
    ],
    ids=["no part", "no projector", "too large", "odd angles", "void limit"],
)
def test_a_plan_that_cannot_be_made_gets_one_line(arguments: list[object], message: str, tmp_path: Path) -> None:
    done = run("plan", *arguments, "--out", tmp_path / "plan.h5")
    assert done.returncode == 2, done.stderr
    assert done.stderr.count("\n") == 1
    assert message in done.stderr
    assert not list(tmp_path.iterdir())


def test_defaults_are_those_of_the_library() -> None:
    """They stand twice, as the command line may import nothing heavy to answer."""
    rig, part, frames = (str(SAMPLE / name) for name in ("printer.toml", "part.stl", "frames.h5"))
    planned = cli.plan.make_context("plan", [part, "--rig", rig, "--out", "plan.h5"]).params
    assert cli._plan_settings(planned) == PlanSettings()
    told = cli.reconstruct.make_context("reconstruct", [frames, "--rig", rig, "--out", "print"]).params
    names = [told[name] for name in ("voxel", "binning", "turn", "accurate", "filter_name")]
    assert Settings(*names) == Settings()
