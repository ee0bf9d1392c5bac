from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vialight.core.errors import InputError
from vialight.store import read_json, sha256_of, to_json, write_json


def test_numpy_values_and_paths_become_plain_json_in_the_order_given(tmp_path: Path) -> None:
    results = {
        "rmse_mm": np.float32(0.5), "count": np.int64(3), "passed": np.bool_(True), "a": (1, None), "path": Path("x/y"),
        "transform": np.eye(2), "nested": {"b": [np.float64(1.5)], "a": "µm"},
    }  # fmt: skip
    write_json(tmp_path / "r.json", results)
    text = (tmp_path / "r.json").read_text(encoding="utf-8")
    assert text.startswith('{\n  "rmse_mm": 0.5,\n  "count": 3,\n  "passed": true,\n')
    assert text.endswith("\n}\n")
    back = read_json(tmp_path / "r.json")
    assert list(back) == list(results)
    assert back["transform"] == [[1.0, 0.0], [0.0, 1.0]]
    assert back["nested"] == {"b": [1.5], "a": "µm"}
    assert back["path"] == str(Path("x/y"))


def test_what_is_not_a_finite_number_becomes_null(tmp_path: Path) -> None:
    write_json(tmp_path / "r.json", {"a": float("nan"), "b": np.float32("inf"), "c": np.array([1.0, -np.inf])})
    assert read_json(tmp_path / "r.json") == {"a": None, "b": None, "c": [1.0, None]}


NESTED = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda children: st.lists(children, max_size=3) | st.dictionaries(st.text(), children, max_size=3),
    max_leaves=8,
)


@given(st.dictionaries(st.text(), NESTED, max_size=4))
def test_plain_values_come_back_as_they_were(results: dict[str, object]) -> None:
    assert json.loads(to_json(results)) == results


def test_what_json_cannot_hold_is_refused_and_leaves_the_former_file(tmp_path: Path) -> None:
    path = tmp_path / "r.json"
    write_json(path, {"a": 1})
    with pytest.raises(TypeError, match="set"):
        write_json(path, {"a": {1, 2}})
    assert read_json(path) == {"a": 1}
    assert [item.name for item in tmp_path.iterdir()] == ["r.json"]


@pytest.mark.parametrize(
    ("content", "complaint"),
    [(b"", "is not JSON"), (b'{"a": ', "is not JSON"), (b"\xff\xfe{}", "is not JSON"), (b"[1]", "holds a list")],
)
def test_a_file_that_is_no_result_is_refused(tmp_path: Path, content: bytes, complaint: str) -> None:
    path = tmp_path / "r.json"
    path.write_bytes(content)
    with pytest.raises(InputError, match=rf"r\.json: {complaint}"):
        read_json(path)


def test_missing_files_are_named(tmp_path: Path) -> None:
    for read in (read_json, sha256_of):
        with pytest.raises(InputError, match=r"none: cannot be read \(No such file or directory\)"):
            read(tmp_path / "none")


def test_the_hash_of_a_file_is_the_one_that_sha256sum_gives(tmp_path: Path) -> None:
    content = bytes(range(256)) * 5000
    (tmp_path / "f").write_bytes(content)
    assert sha256_of(tmp_path / "f") == hashlib.sha256(content).hexdigest()


def test_the_hash_of_a_folder_depends_on_names_and_contents_and_nothing_else(tmp_path: Path) -> None:
    def make(name: str, files: dict[str, str]) -> str:
        for path, content in files.items():
            file = tmp_path / name / path
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(content)
        return sha256_of(tmp_path / name)

    original = make("a", {"zarr.json": "{}", "0/c/0": "data"})
    assert make("b", {"0/c/0": "data", "zarr.json": "{}"}) == original
    changed = [
        make("c", {"zarr.json": "{}", "0/c/0": "DATA"}),
        make("d", {"zarr.json": "{}", "0/c/1": "data"}),
        make("e", {"zarr.json": "{}"}),
        make("f", {"zarr.json": "data", "0/c/0": "{}"}),
    ]
    assert len({original, *changed}) == 5
