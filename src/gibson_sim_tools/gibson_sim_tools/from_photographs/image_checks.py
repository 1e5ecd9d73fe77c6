"""Checks image files before a long job: whether they exist, are readable and whole, and have the size and bit depth of their camera."""

from __future__ import annotations

import struct
from collections.abc import Callable

from gibson_sim.formats.image_header import MAX_IMAGE_BYTES, image_size
from gibson_sim.reading import read_file
from gibson_sim_tools.scanning.posed_images import ASPECT_TOLERANCE, Photograph, Photographs, ScanError

_PNG, _PNG_END = b"\x89PNG\r\n\x1a\n", b"IEND\xaeB`\x82"
_PNG_BITS, _PNG_COLOR_TYPE = 24, 25
"""Offsets of the bits per channel and the colour type, bytes."""
_SCAN, _END_OF_IMAGE = 0xDA, b"\xff\xd9"
_COPY_AGAIN = "copy the photographs again, or delete these with their poses"


def check_photographs(
    photographs: Photographs, progress: Callable[[float], None] = lambda _: None, depth_size: tuple[int, int] | None = None
) -> int:  # fmt: skip
    """Reads all image files, colour and depth, and returns their total size, bytes.

    Args:
        photographs: the photographs.
        progress: called with the fraction that is done, 0 to 1.
        depth_size: width and height that depth images must have, pixels; None = the aspect ratio of their photographs.

    Raises:
        ScanError: files are missing, unreadable, truncated, or of another size or bit depth than their cameras; the message names the first
            one and the number of others.
    """
    total, problems = 0, []
    files = [(item.file, item, False) for item in photographs.items]
    files += [(item.depth, item, True) for item in photographs.items if item.depth is not None]
    for number, (path, item, is_depth) in enumerate(files):
        try:
            data = read_file(path, MAX_IMAGE_BYTES)
        except OSError as error:
            problems.append((f"{path}: cannot be read: {error.strerror or error}", _COPY_AGAIN))
        else:
            total += len(data)
            problem = _problem(data) or (_depth_problem(data, item, depth_size) if is_depth else _size_problem(data, item))
            if problem:
                problems.append((f"{path}: {problem[0]}", problem[1]))
        progress((number + 1) / len(files))
    if problems:
        more = f", and {len(problems) - 1} more of {len(files)} images are broken" if len(problems) > 1 else ""
        raise ScanError(f"{problems[0][0]}{more}; {problems[0][1]}")
    return total


def _problem(data: bytes) -> tuple[str, str] | None:
    """Returns what is wrong with the bytes of an image, and the remedy."""
    if image_size(data) is None:
        return f"is not a readable image{' (it is empty)' if not data else ''}", _COPY_AGAIN
    return ("is truncated", _COPY_AGAIN) if is_truncated(data) else None


def _size_problem(data: bytes, item: Photograph) -> tuple[str, str] | None:
    header, camera = image_size(data), item.camera.intrinsics
    assert header is not None
    # A JPEG may be rotated by its EXIF orientation when it is decoded.
    if sorted((header.width, header.height)) == sorted((camera.width, camera.height)):
        return None
    return (
        f"has {header.width}x{header.height} pixels, its camera {camera.width}x{camera.height}",
        "give photographs of the size that was posed, or the intrinsics of their size",
    )


def _depth_problem(data: bytes, item: Photograph, size: tuple[int, int] | None) -> tuple[str, str] | None:
    header, camera = image_size(data), item.camera.intrinsics
    assert header is not None
    if data.startswith(_PNG) and (data[_PNG_BITS], data[_PNG_COLOR_TYPE]) != (16, 0):
        channels = {0: 1, 2: 3, 4: 2, 6: 4}.get(data[_PNG_COLOR_TYPE], 3)
        return (
            f"has {data[_PNG_BITS]} bits and {channels} channel{'s' if channels > 1 else ''}",
            "depth must be 16 bit with one channel",
        )
    if size is not None and (header.width, header.height) != size:
        return (
            f"has {header.width}x{header.height} pixels, the intrinsics are for {size[0]}x{size[1]}",
            "colours and depths must lie on the same pixels: register or resize them, and give the intrinsics of that size",
        )
    if abs(header.width * camera.height - header.height * camera.width) > ASPECT_TOLERANCE * header.width * camera.height:
        return (
            f"has {header.width}x{header.height} pixels, its photograph {camera.width}x{camera.height}",
            "both must show the same, so that their sides must be in proportion",
        )
    return None


def is_truncated(data: bytes) -> bool:
    """Returns whether a JPEG or PNG lacks its end marker; decoders fill the missing part with grey."""
    if data.startswith(_PNG):
        return _PNG_END not in data[-4096:]
    if data.startswith(b"\xff\xd8"):
        return data.find(_END_OF_IMAGE, _image_data_offset(data)) < 0
    return False


def _image_data_offset(data: bytes) -> int:
    """Returns the offset of a JPEG's start-of-scan segment, bytes; thumbnails in the header have end markers of their own."""
    offset = 2
    while offset + 4 <= len(data) and data[offset] == 0xFF:
        marker = data[offset + 1]
        if marker == _SCAN:
            return offset
        offset += 1 if marker == 0xFF else 2 + int(struct.unpack_from(">H", data, offset + 2)[0])
    return offset
