"""How much memory is free, where a container may take less than the machine has."""

from __future__ import annotations

from pathlib import Path

import pytest

from vialight.core.errors import InputError
from vialight.system import memory, need_memory

GB = 1_000_000_000


@pytest.fixture
def groups(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(memory, "_GROUPS", tmp_path)
    monkeypatch.setattr(memory, "_OWN_GROUPS", tmp_path / "own")
    return tmp_path


def write_group(folder: Path, **files: object) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        (folder / name.replace("__", ".")).write_text(f"{content}\n")


def refusal() -> str:
    with pytest.raises(InputError) as caught:
        need_memory(1e15, "v.zarr", "a volume", "take less")
    return str(caught.value)


def test_a_container_with_less_memory_than_the_machine_gives_what_it_has_left(groups: Path) -> None:
    (groups / "own").write_text("0::/box/inner\n")
    write_group(groups / "box" / "inner", memory__max=GB, memory__current=GB // 4)
    assert "0.75 GB are free" in refusal()
    need_memory(0.4e9, "v.zarr", "a volume", "take less")
    with pytest.raises(InputError):
        need_memory(0.7e9, "v.zarr", "a volume", "take less")


def test_the_narrowest_of_the_groups_that_hold_a_process_counts(groups: Path) -> None:
    (groups / "own").write_text("0::/box/inner\n")
    write_group(groups / "box" / "inner", memory__max="max", memory__current=GB // 4)
    write_group(groups / "box", memory__max=GB, memory__current=GB // 2)
    assert "0.5 GB are free" in refusal()


def test_the_older_kind_of_groups_limits_too(groups: Path) -> None:
    (groups / "own").write_text("5:devices:/\n4:memory:/not/seen/from/inside\n0::/\n")
    write_group(groups / "memory", memory__limit_in_bytes=GB, memory__usage_in_bytes=GB // 2)
    assert "0.5 GB are free" in refusal()


def test_files_that_are_merely_kept_in_memory_do_not_count_as_taken(groups: Path) -> None:
    (groups / "own").write_text("0::/\n")
    stat = f"anon 5\ninactive_file {GB // 4}\nactive_file {GB // 4}"
    write_group(groups, memory__max=GB, memory__current=GB, memory__stat=stat)
    assert "0.5 GB are free" in refusal()


@pytest.mark.parametrize("own", [None, "", "nonsense", "0::/", "0::/../../..", "4:memory:/"])
@pytest.mark.parametrize("limit", ["max", "", "9223372036854771712", "-"])
def test_without_a_limit_the_machines_memory_counts(groups: Path, own: str | None, limit: str) -> None:
    if own is not None:
        (groups / "own").write_text(own)
    write_group(groups, memory__max=limit, memory__current=0)
    write_group(groups / "memory", memory__limit_in_bytes=limit, memory__usage_in_bytes=0)
    need_memory(60_000_000, "v.zarr", "a volume", "take less")
    assert "GB are free" in refusal()
