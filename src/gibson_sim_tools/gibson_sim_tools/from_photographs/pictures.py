"""Checks image files before the long work: whether they are there, and whether they were cut short."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from pathlib import Path

from gibson_sim.formats.image_header import MAX_IMAGE_BYTES, image_size
from gibson_sim.reading import read_file
from gibson_sim_tools.scanning.posed_rgbd import ScanError

_PNG, _PNG_END = b"\x89PNG\r\n\x1a\n", b"IEND\xaeB`\x82"
_SCAN, _END_OF_IMAGE = 0xDA, b"\xff\xd9"


def check_pictures(files: Sequence[Path], progress: Callable[[float], None] = lambda _: None) -> int:
    """Reads all image files and returns their size together, bytes.

    Raises:
        ScanError: files are missing, are no images, or were cut short; the message names the first and says how many there are.
    """
    total, bad = 0, []
    for number, path in enumerate(files):
        try:
            data = read_file(path, MAX_IMAGE_BYTES)
        except OSError as error:
            bad.append(f"{path}: cannot be read: {error.strerror or error}")
        else:
            total += len(data)
            if image_size(data) is None:
                bad.append(f"{path}: is not a readable image{' (it is empty)' if not data else ''}")
            elif is_cut(data):
                bad.append(f"{path}: is truncated")
        progress((number + 1) / len(files))
    if bad:
        more = f", and {len(bad) - 1} more of {len(files)} images are broken" if len(bad) > 1 else ""
        raise ScanError(f"{bad[0]}{more}; copy the photographs again, or delete these with their poses")
    return total


def is_cut(data: bytes) -> bool:
    """Returns whether a JPEG or PNG lacks its end; decoders fill the rest with grey."""
    if data.startswith(_PNG):
        return _PNG_END not in data[-4096:]
    if data.startswith(b"\xff\xd8"):
        return data.find(_END_OF_IMAGE, _image_data(data)) < 0
    return False


def _image_data(data: bytes) -> int:
    """Returns where the image data of a JPEG begin; previews in its header end like images, too."""
    at = 2
    while at + 4 <= len(data) and data[at] == 0xFF:
        kind = data[at + 1]
        if kind == _SCAN:
            return at
        at += 1 if kind == 0xFF else 2 + int(struct.unpack_from(">H", data, at + 2)[0])
    return at
