"""Compressed images, read back by decoders written here."""

from __future__ import annotations

import struct

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_sim.sensors.image_codecs import (
    COMPRESSED_DEPTH_FORMAT,
    color_format,
    decode_color,
    encode_color,
    encode_depth,
    without_exif,
)
from support.exif import jpeg_with_orientation


def _decoded_depth(data: bytes) -> NDArray[np.float64]:
    """Decodes compressedDepth as its subscribers do: int32, two float32, then a PNG; pixel 0 is no depth."""
    kind, a, b = struct.unpack("<iff", data[:12])
    assert kind == 0, "inverse depth"
    pixels = cv2.imdecode(np.frombuffer(data[12:], np.uint8), cv2.IMREAD_UNCHANGED)
    assert pixels.dtype == np.uint16
    out = np.full(pixels.shape, np.nan)
    out[pixels != 0] = a / (pixels[pixels != 0].astype(np.float64) - b)
    return out


def _red_and_blue() -> NDArray[np.uint8]:
    rgb = np.zeros((16, 32, 3), dtype=np.uint8)
    rgb[:, :16] = (200, 30, 0)
    rgb[:, 16:] = (0, 40, 220)
    return rgb


def test_formats_are_those_of_image_transport() -> None:
    assert color_format("jpeg") == "rgb8; jpeg compressed bgr8"
    assert color_format("png") == "rgb8; png compressed bgr8"
    assert COMPRESSED_DEPTH_FORMAT == "32FC1; compressedDepth png"


def test_png_decodes_to_the_same_colours() -> None:
    data = encode_color(_red_and_blue(), "png")
    assert data[:8].tobytes() == b"\x89PNG\r\n\x1a\n"
    bgr = cv2.imdecode(data, cv2.IMREAD_COLOR)
    assert np.array_equal(bgr[:, :, ::-1], _red_and_blue())


def test_jpeg_decodes_to_nearly_the_same_colours() -> None:
    data = encode_color(_red_and_blue(), "jpeg", jpeg_quality=95)
    assert data[:3].tobytes() == b"\xff\xd8\xff"
    bgr = cv2.imdecode(data, cv2.IMREAD_COLOR)
    wrong = np.abs(bgr[:, :, ::-1].astype(int) - _red_and_blue()).max(axis=(0, 2))
    assert np.delete(wrong, [15, 16]).max() <= 6, "beside the edge, whose colours JPEG smears"


@pytest.mark.parametrize("orientation", range(1, 9))
def test_an_image_is_not_rotated_by_its_exif_orientation(orientation: int) -> None:
    data = jpeg_with_orientation(_red_and_blue(), orientation)
    pixels = decode_color(data)
    assert pixels is not None and pixels.shape == (16, 32, 3)
    assert (
        np.abs(pixels[8, 4].astype(int) - (200, 30, 0)).max() < 8 and np.abs(pixels[8, 28].astype(int) - (0, 40, 220)).max() < 8
    )


def test_without_exif_data_every_reader_sees_the_pixels_of_the_sensor() -> None:
    data = jpeg_with_orientation(_red_and_blue())
    assert cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR).shape == (32, 16, 3)
    stripped = without_exif(data)
    assert cv2.imdecode(np.frombuffer(stripped, np.uint8), cv2.IMREAD_COLOR).shape == (16, 32, 3)
    assert without_exif(stripped) == stripped == encode_color(_red_and_blue()[:, :, ::-1], "jpeg", jpeg_quality=100).tobytes()


@pytest.mark.parametrize(
    "data", [b"", b"\xff", b"\xff\xd8", b"\xff\xd8\xff\xe1\0", b"\xff\xd8\xff\xe0\0\0\xff", b"\x89PNG\r\n\x1a\n"]
)
def test_an_image_without_exif_data_is_unchanged(data: bytes) -> None:
    assert without_exif(data) == data


def test_lower_jpeg_quality_makes_smaller_files() -> None:
    noise = np.random.default_rng(1).integers(0, 256, (64, 64, 3), dtype=np.uint8)
    assert len(encode_color(noise, "jpeg", jpeg_quality=30)) < 0.5 * len(encode_color(noise, "jpeg", jpeg_quality=95))


def test_compressed_depth_is_right_within_half_a_step() -> None:
    depth = np.linspace(0.2, 9.9, 640, dtype=np.float32).reshape(20, 32)
    decoded = _decoded_depth(encode_depth(depth, depth_max=10.0, quantization=100.0))
    # A step at d metres is d^2 / (100 * 101) metres: 1 cm at 10 m; half of it, and a little for the next order.
    assert np.all(np.abs(decoded - depth) <= 0.51 * depth**2 / 10100.0)


def test_header_of_compressed_depth_holds_kind_and_both_parameters() -> None:
    kind, a, b = struct.unpack("<iff", encode_depth(np.ones((2, 2), np.float32), depth_max=10.0, quantization=100.0)[:12])
    assert (kind, a, b) == (0, 10100.0, -1009.0)


def test_a_depth_of_two_metres_is_the_pixel_computed_by_hand() -> None:
    data = encode_depth(np.full((1, 1), 2.0, np.float32), depth_max=10.0, quantization=100.0)
    assert cv2.imdecode(np.frombuffer(data[12:], np.uint8), cv2.IMREAD_UNCHANGED)[0, 0] == 4041  # 10100 / 2 - 1009


@pytest.mark.parametrize("value", [np.inf, -np.inf, np.nan, 0.0, 10.0, 25.0, 0.15])
def test_depth_out_of_range_becomes_no_depth(value: float) -> None:
    # 0.15 m would be 66324, which 16 bits do not hold.
    decoded = _decoded_depth(encode_depth(np.array([[value, 1.0]], dtype=np.float32), depth_max=10.0, quantization=100.0))
    assert np.isnan(decoded[0, 0])
    assert decoded[0, 1] == pytest.approx(1.0, abs=1e-4)


def test_larger_depth_max_reaches_farther() -> None:
    decoded = _decoded_depth(encode_depth(np.full((1, 1), 25.0, np.float32), depth_max=40.0, quantization=100.0))
    assert decoded[0, 0] == pytest.approx(25.0, abs=0.51 * 625 / 10100)
