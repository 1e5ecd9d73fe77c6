"""Reads the size of an image from its header, so that images that are too large are rejected before decoding."""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass

MAX_PIXELS = 8192 * 8192
"""Maximum number of pixels of a texture, 200 MB as RGB."""

MAX_IMAGE_BYTES = 512 * 2**20
"""Maximum size of an image file, bytes."""
_MAX_SEGMENTS = 10_000
"""Maximum number of JPEG segments before the one with the size; each fill byte counts as one."""
_MAX_CHUNKS = 200_000
"""Maximum number of chunks of a PNG; 8 KB each are usual."""
_LARGE_CHUNK = 64 * 2**20
"""Chunks of a PNG that claim more bytes than this and than the whole file has are invalid: OpenCV allocates what they claim, up to 2 GB."""
_JPEG_SIZES = {0xC0, 0xC1, 0xC2, 0xC3, 0xC5, 0xC6, 0xC7, 0xC9, 0xCA, 0xCB, 0xCD, 0xCE, 0xCF}
_PNG_CHANNELS = {0: 3, 2: 3, 3: 4, 4: 4, 6: 4}
_SPACE = rb"(?:\s|#[^\n]*\n)+"
_PNM = re.compile(rb"P([1-6])" + _SPACE + rb"(\d+)" + _SPACE + rb"(\d+)(?:" + _SPACE + rb"(\d+))?")
_RADIANCE = re.compile(rb"[-+]Y\s+(\d+)\s+[-+]X\s+(\d+)")


@dataclass(frozen=True, slots=True)
class ImageHeader:
    """Size and channels of an image, from its header."""

    width: int
    """Width, pixels."""
    height: int
    """Height, pixels."""
    channels: int
    """Channels of the decoded image, 3 or 4."""

    kind: str = ""
    """Name in Pillow of kinds that OpenCV cannot decode, or not with their alpha: TGA, TIFF, BMP, GIF; else ""."""
    white: int = 0
    """Value of white in a PNM whose values OpenCV does not scale; 0 = the largest of the type."""
    transparent_grey: int | None = None
    """Value of the transparent pixels of a greyscale PNG, as OpenCV decodes it (8 bits, or 16); None = all are opaque."""

    @property
    def pixels(self) -> int:
        """Number of pixels."""
        return self.width * self.height

    @property
    def decoded_bytes(self) -> int:
        """Size of the decoded image, bytes."""
        return self.pixels * self.channels


def image_size(data: bytes) -> ImageHeader | None:
    """Returns the header of a PNG, JPEG, WebP, BMP, GIF, TIFF, TGA, PNM or Radiance image, or None for other data."""
    try:
        return _size(data)
    except (struct.error, IndexError):
        return None


def _size(data: bytes) -> ImageHeader | None:
    if data.startswith(b"\x89PNG\r\n\x1a\n"):
        return _png(data)
    if data.startswith(b"\xff\xd8"):
        return _jpeg(data)
    if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        return _webp(data)
    if data.startswith(b"BM"):
        width, height, _, bits = struct.unpack_from("<iiHH", data, 18)
        return ImageHeader(abs(width), abs(height), 4 if bits == 32 else 3, "BMP")
    if data.startswith((b"GIF87a", b"GIF89a")):
        width, height = struct.unpack_from("<HH", data, 6)
        return ImageHeader(width, height, 4, "GIF")
    if data[:4] in (b"II*\0", b"MM\0*"):
        return _tiff(data, "<" if data[:2] == b"II" else ">")
    if data.startswith(b"#?"):
        match = _RADIANCE.search(data[:4096])
        return None if match is None else ImageHeader(int(match[2]), int(match[1]), 3)
    match = _PNM.match(data[:4096])
    if match is not None:
        white = int(match[4] or 0) if match[1] not in b"14" else 0
        # OpenCV scales text of 8 bits only.
        return ImageHeader(int(match[2]), int(match[3]), 3, white=0 if match[1] in b"23" and white < 256 else white)
    return _tga(data)


def _png(data: bytes) -> ImageHeader | None:
    width, height = struct.unpack_from(">II", data, 16)
    at = 8
    grey: int | None = None
    for _ in range(_MAX_CHUNKS):
        if at + 8 > len(data) or data[at + 4 : at + 8] == b"IEND":  # decoders ignore what follows
            channels = 4 if grey is not None else _PNG_CHANNELS.get(data[25], 4)
            return ImageHeader(width, height, channels, transparent_grey=grey)
        (length,) = struct.unpack_from(">I", data, at)
        if data[25] == 0 and length == 2 and data[at + 4 : at + 8] == b"tRNS":
            largest = 2 ** data[24] - 1
            (value,) = struct.unpack_from(">H", data, at + 8)
            grey = (value & largest) * (max(largest, 255) // max(largest, 1))
        if length > max(len(data), _LARGE_CHUNK):
            return None
        at += 12 + length
    return None


def _jpeg(data: bytes) -> ImageHeader | None:
    at = 2
    for _ in range(_MAX_SEGMENTS):
        if at + 9 >= len(data):
            return None
        if data[at] != 0xFF:
            return None
        marker = data[at + 1]
        if marker in _JPEG_SIZES:
            height, width = struct.unpack_from(">HH", data, at + 5)
            return ImageHeader(width, height, 3)
        if marker == 0xFF or marker == 0x01 or 0xD0 <= marker <= 0xD8:
            at += 1 if marker == 0xFF else 2
            continue
        at += 2 + int(struct.unpack_from(">H", data, at + 2)[0])
    return None


def _webp(data: bytes) -> ImageHeader | None:
    kind = data[12:16]
    if kind == b"VP8X":
        width, height = (int.from_bytes(data[at : at + 3], "little") + 1 for at in (24, 27))
        return ImageHeader(width, height, 4 if data[20] & 0x10 else 3)
    if kind == b"VP8L":
        bits = int(struct.unpack_from("<I", data, 21)[0])
        return ImageHeader((bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1, 4)
    if kind == b"VP8 ":
        width, height = struct.unpack_from("<HH", data, 26)
        return ImageHeader(width & 0x3FFF, height & 0x3FFF, 3)
    return None


def _tiff(data: bytes, order: str) -> ImageHeader | None:
    (at,) = struct.unpack_from(f"{order}I", data, 4)
    (count,) = struct.unpack_from(f"{order}H", data, at)
    tags: dict[int, int] = {}
    for k in range(count):
        tag, kind = struct.unpack_from(f"{order}HH", data, at + 2 + 12 * k)
        tags[tag] = int(struct.unpack_from(f"{order}{'H' if kind == 3 else 'I'}", data, at + 10 + 12 * k)[0])
    return ImageHeader(tags[256], tags[257], 4 if tags.get(277, 3) == 4 else 3, "TIFF") if 256 in tags and 257 in tags else None


def _tga(data: bytes) -> ImageHeader | None:
    if len(data) < 18 or data[1] not in (0, 1) or data[2] not in (1, 2, 3, 9, 10, 11) or data[16] not in (8, 15, 16, 24, 32):
        return None
    width, height = struct.unpack_from("<HH", data, 12)
    bits = data[7] if data[2] in (1, 9) else data[16]
    has_opacity = bits == 32 or (bits == 16 and (data[17] & 15 > 0 or data[2] in (3, 11)))
    return ImageHeader(width, height, 4 if has_opacity else 3, "TGA")
