"""Reads the size and depth of a PNG or JPEG image from its header, so that an unusable image is refused before it is decoded."""

from __future__ import annotations

import struct

_MAX_SEGMENTS = 10_000
"""Maximum number of JPEG segments before the one with the size; each fill byte counts as one."""
_MAX_CHUNKS = 200_000
"""Maximum number of chunks of a PNG; 8 KB each are usual."""
_LARGE_CHUNK = 64 * 2**20
"""Chunks of a PNG that claim more bytes than this and than all data are invalid: OpenCV allocates what they claim, up to 2 GB."""
_JPEG_SIZES = {0xC0, 0xC1, 0xC2, 0xC3, 0xC5, 0xC6, 0xC7, 0xC9, 0xCA, 0xCB, 0xCD, 0xCE, 0xCF}
"""Markers of the segments with the size (SOF)."""


def image_size(data: bytes) -> tuple[int, int] | None:
    """Returns width and height of a PNG or JPEG image, pixels; None for other, truncated or invalid data."""
    if data[:8] == b"\x89PNG\r\n\x1a\n" and data[12:16] == b"IHDR" and len(data) >= 33:
        return _png_size(data)
    return _jpeg_size(data) if data[:2] == b"\xff\xd8" else None


def deep_png_encoding(data: bytes) -> str | None:
    """Returns the encoding of a PNG image with 16 bits per channel, mono16 or rgb16; None for all other data."""
    if not (data[:8] == b"\x89PNG\r\n\x1a\n" and data[12:16] == b"IHDR" and data[24:25] == b"\x10"):
        return None
    return "rgb16" if data[25:26] in (b"\x02", b"\x06") else "mono16"


def _png_size(data: bytes) -> tuple[int, int] | None:
    at = 8
    for _ in range(_MAX_CHUNKS):
        if at + 8 > len(data):
            width, height = struct.unpack_from(">II", data, 16)
            return width, height
        length = int.from_bytes(data[at : at + 4], "big")
        if length > max(len(data), _LARGE_CHUNK):
            return None
        at += 12 + length
    return None


def _jpeg_size(data: bytes) -> tuple[int, int] | None:
    at = 2
    for _ in range(_MAX_SEGMENTS):
        if at + 9 > len(data) or data[at] != 0xFF:
            return None
        marker = data[at + 1]
        if marker in _JPEG_SIZES:
            height, width = struct.unpack_from(">HH", data, at + 5)
            return width, height
        if marker == 0xFF:  # fill byte
            at += 1
        elif marker == 0x01 or 0xD0 <= marker <= 0xD8:  # no length follows
            at += 2
        else:
            at += 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    return None
