"""Reads the OpenEXR files with several layers that Blender writes: one part, scan lines, uncompressed. NumPy only.

https://openexr.com/en/latest/OpenEXRFileLayout.html
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import GibsonSimError

_MAGIC = 20000630
_VERSION, _LONG_NAMES = 2, 0x400
_TYPES: dict[int, np.dtype[Any]] = {0: np.dtype("<u4"), 1: np.dtype("<f2"), 2: np.dtype("<f4")}


def read_exr(path: Path) -> dict[str, NDArray[np.float32]]:
    """Returns channel -> values, (H, W), row 0 at the top.

    Raises:
        GibsonSimError: the file has another layout.
    """
    data = path.read_bytes()
    if len(data) < 8:
        raise GibsonSimError(f"{path}: has {len(data)} bytes, is no OpenEXR file")
    magic, version = struct.unpack_from("<ii", data)
    if magic != _MAGIC or version & ~_LONG_NAMES != _VERSION:
        raise GibsonSimError(
            f"{path}: is no OpenEXR file of one part with scan lines: its first numbers are {magic} and {version:#x}"
        )
    header, offset = _header(data)
    if header["compression"] != b"\0":
        raise GibsonSimError(f"{path}: is compressed, must not be")
    channels = _channels(header["channels"])
    x_min, y_min, x_max, y_max = struct.unpack("<4i", header["dataWindow"])
    width, height = x_max - x_min + 1, y_max - y_min + 1
    pixels = {name: np.zeros((height, width), dtype=np.float32) for name, _ in channels}
    for start in struct.unpack_from(f"<{height}Q", data, offset):
        (y,) = struct.unpack_from("<i", data, start)
        position = start + 8
        for name, kind in channels:
            pixels[name][y - y_min] = np.frombuffer(data, kind, width, position)
            position += width * kind.itemsize
    return pixels


def _header(data: bytes) -> tuple[dict[str, bytes], int]:
    """Returns the attributes, and the offset behind them."""
    attributes, offset = {}, 8
    while data[offset]:
        name, offset = _text(data, offset)
        _, offset = _text(data, offset)
        (size,) = struct.unpack_from("<i", data, offset)
        attributes[name] = data[offset + 4 : offset + 4 + size]
        offset += 4 + size
    return attributes, offset + 1


def _channels(data: bytes) -> list[tuple[str, np.dtype[np.generic]]]:
    found: list[tuple[str, np.dtype[np.generic]]] = []
    offset = 0
    while data[offset]:
        name, offset = _text(data, offset)
        found.append((name, _TYPES[struct.unpack_from("<i", data, offset)[0]]))
        offset += 16
    return found


def _text(data: bytes, offset: int) -> tuple[str, int]:
    """Returns the text that ends with a zero byte, and the offset behind it."""
    end = data.index(b"\0", offset)
    return data[offset:end].decode(), end + 1
