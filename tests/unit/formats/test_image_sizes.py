"""Untrusted images: their header decides whether they are decoded."""

from __future__ import annotations

import os
import resource
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from gibson_sim.errors import SceneError
from gibson_sim.formats.image_header import image_size
from gibson_sim.formats.textures import decode_pixels
from gibson_sim.render.draw.environment import load_environment
from gibson_sim_tools.scanning.posed_images import ScanError, read_image
from support.effort import effort
from support.gltf import png


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def _bomb(width: int, height: int) -> bytes:
    """Returns a grey PNG, which has a few KB for each gigabyte of pixels."""
    packer = zlib.compressobj(9)
    rows = b"".join(packer.compress(bytes(1 + width)) for _ in range(height)) + packer.flush()
    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + _chunk(b"IHDR", head) + _chunk(b"IDAT", rows) + _chunk(b"IEND", b"")


def test_image_that_holds_too_many_pixels_is_not_decoded(tmp_path: Path) -> None:
    bomb = _bomb(16384, 8192)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert decode_pixels(bomb, cv2.IMREAD_COLOR) is None
    (tmp_path / "sky.png").write_bytes(bomb)
    with pytest.raises(SceneError, match=r"sky\.png: has 16384 x 8192 pixels, must have at most 32 million"):
        load_environment(tmp_path / "sky.png")
    with pytest.raises(ScanError, match="not a readable image"):
        read_image(tmp_path / "sky.png", cv2.IMREAD_COLOR)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100 * 1024, "decoded it takes 128 MB"


def test_image_within_the_limits_is_decoded() -> None:
    pixels = decode_pixels(png((7, 8, 9)), cv2.IMREAD_COLOR)
    assert pixels is not None
    assert pixels.tolist() == [[[9, 8, 7]]]
    assert decode_pixels(b"", cv2.IMREAD_COLOR) is None


def test_png_with_a_chunk_that_claims_gigabytes_is_not_decoded() -> None:
    png = bytearray(cv2.imencode(".png", np.zeros((8, 8, 3), np.uint8))[1].tobytes())
    assert image_size(bytes(png)) is not None
    png[33:37] = (0x7FFFFFFF).to_bytes(4, "big")  # of the chunk after the header; OpenCV allocates as much
    assert image_size(bytes(png)) is None and decode_pixels(bytes(png), cv2.IMREAD_UNCHANGED) is None


def test_bytes_after_the_end_of_a_png_are_ignored() -> None:
    png = cv2.imencode(".png", np.full((2, 3, 3), 7, np.uint8))[1].tobytes()
    pixels = decode_pixels(png + b"\xff" * 40, cv2.IMREAD_UNCHANGED)
    assert pixels is not None and pixels.shape == (2, 3, 3)


def test_png_that_is_cut_has_its_size() -> None:
    png = cv2.imencode(".png", np.random.default_rng(0).integers(0, 256, (64, 64, 3), dtype=np.uint8))[1].tobytes()
    assert image_size(png[: len(png) // 2]).width == 64


def test_jpeg_of_fill_bytes_takes_no_time() -> None:
    data = b"\xff\xd8" + b"\xff" * 50_000_000
    assert image_size(data) is None
    assert effort(lambda: image_size(data)) < 10.0, "byte by byte it takes 15 s"


def test_pipe_in_place_of_an_image_of_a_scan_is_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "frame.png")
    with pytest.raises(ScanError, match="is not a regular file"):
        read_image(tmp_path / "frame.png", cv2.IMREAD_COLOR)
