"""Bytes to counts: by hand for each format, and by packing at random."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vialight.devices import DeviceError
from vialight.devices.cameras.pixels import frame_bytes, full_level, unpack


def packed(pixel_format: str, pixels: list[int]) -> np.ndarray:
    """Pack pixels as PFNC and GigE Vision describe it, bit by bit."""
    if pixel_format == "Mono12Packed":
        pairs = zip([*pixels[::2]], [*pixels[1::2], 0], strict=False)
        data = [byte for a, b in pairs for byte in (a >> 4, (a & 15) | (b & 15) << 4, b >> 4)]
        return np.array(data[: (12 * len(pixels) + 7) // 8], np.uint8)
    bits = {"Mono8": 8, "Mono10": 16, "Mono10p": 10, "Mono12": 16, "Mono12p": 12, "Mono14": 16, "Mono16": 16}
    stream = "".join(format(pixel, f"0{bits[pixel_format]}b")[::-1] for pixel in pixels)
    stream += "0" * (-len(stream) % 8)
    return np.array([int(stream[i : i + 8][::-1], 2) for i in range(0, len(stream), 8)], np.uint8)


@pytest.mark.parametrize(
    ("pixel_format", "data", "counts"),
    [
        ("Mono8", "01 ff 80 00", [1, 255, 128, 0]),
        ("Mono10", "ff 03 01 00", [1023, 1]),
        ("Mono12", "ff 0f 34 02", [4095, 0x234]),
        ("Mono16", "34 12 ff ff", [0x1234, 0xFFFF]),
        ("Mono12p", "bc fa de", [0xABC, 0xDEF]),
        ("Mono12Packed", "ab fc de", [0xABC, 0xDEF]),
        ("Mono10p", "ff 03 00 c0 ff", [1023, 0, 0, 1023]),
        ("Mono10p", "01 08 30 00 01", [1, 2, 3, 4]),
    ],
)
def test_hand_made_bytes_give_their_counts(pixel_format: str, data: str, counts: list[int]) -> None:
    image = unpack(np.frombuffer(bytes.fromhex(data), np.uint8), pixel_format, len(counts), 1)
    assert image.tolist() == [counts]
    assert image.dtype == np.uint16


@given(
    st.sampled_from(["Mono8", "Mono10", "Mono10p", "Mono12", "Mono12p", "Mono12Packed", "Mono14", "Mono16"]),
    st.integers(1, 5), st.integers(1, 4), st.integers(0, 3), st.integers(0, 2**32 - 1),
)  # fmt: skip
def test_what_is_packed_is_unpacked_whatever_the_size_and_whatever_follows(
    pixel_format: str, columns: int, rows: int, padding: int, seed: int
) -> None:
    counts = np.random.default_rng(seed).integers(0, full_level(pixel_format) + 1, (rows, columns))
    if padding:  # then each row begins with a byte
        lines = [np.concatenate([packed(pixel_format, row.tolist()), np.full(padding, 7, np.uint8)]) for row in counts]
        data = np.concatenate(lines)
    else:
        data = packed(pixel_format, counts.reshape(-1).tolist())
        assert len(data) == frame_bytes(pixel_format, columns, rows)
    with_chunk = np.concatenate([data, np.full(9, 255, np.uint8)])
    np.testing.assert_array_equal(unpack(with_chunk, pixel_format, columns, rows, padding), counts)


def test_an_image_that_is_cut_short_or_in_colour_is_refused() -> None:
    with pytest.raises(DeviceError, match="sent 5 bytes; 3 x 2 pixels of Mono8 are 6"):
        unpack(np.zeros(5, np.uint8), "Mono8", 3, 2)
    with pytest.raises(DeviceError, match=r"sends BayerRG8; set .* pixel_format: Mono8"):
        unpack(np.zeros(6, np.uint8), "BayerRG8", 3, 2)


def test_a_frame_has_memory_of_its_own() -> None:
    data = np.zeros(8, np.uint8)
    for pixel_format in ("Mono8", "Mono16"):
        image = unpack(data, pixel_format, 2, 2)
        data[:] = 9
        assert image.max() == 0
        data[:] = 0
