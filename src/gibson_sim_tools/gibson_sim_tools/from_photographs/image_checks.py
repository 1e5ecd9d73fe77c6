"""Checks image files before a long job: whether they exist, are readable, and are not truncated."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from pathlib import Path

from gibson_sim.formats.image_header import MAX_IMAGE_BYTES, image_size
from gibson_sim.reading import read_file
from gibson_sim_tools.scanning.posed_rgbd import ScanError

_PNG, _PNG_END = b"\x89PNG\r\n\x1a\n", b"IEND\xaeB`\x82"
_SCAN, _END_OF_IMAGE = 0xDA, b"\xff\xd9"


def check_images(files: Sequence[Path], progress: Callable[[float], None] = lambda _: None) -> int:
    """Reads all image files and returns their total size, bytes.

    Raises:
        ScanError: files are missing, unreadable or truncated; the message names the first one and the number of others.
    """
    total, problems = 0, []
    for number, path in enumerate(files):
        try:
            data = read_file(path, MAX_IMAGE_BYTES)
        except OSError as error:
            problems.append(f"{path}: cannot be read: {error.strerror or error}")
        else:
            total += len(data)
            if image_size(data) is None:
                problems.append(f"{path}: is not a readable image{' (it is empty)' if not data else ''}")
            elif is_truncated(data):
                problems.append(f"{path}: is truncated")
        progress((number + 1) / len(files))
    if problems:
        more = f", and {len(problems) - 1} more of {len(files)} images are broken" if len(problems) > 1 else ""
        raise ScanError(f"{problems[0]}{more}; copy the photographs again, or delete these with their poses")
    return total


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
