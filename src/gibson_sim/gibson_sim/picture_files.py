"""Writes images and arrays through ``writing``, since OpenCV's function reports a full disk only by a warning without a reason."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import WriteError
from gibson_sim.writing import write_file

SUFFIXES = (".png", ".jpg", ".jpeg")
"""Image suffixes that error messages suggest."""
_JPEG_QUALITY = 88
"""Default quality of JPEG images, 1 to 100."""


def write_picture(path: str | Path, pixels: NDArray[Any], options: Sequence[int] | None = None, *, durable: bool = True) -> None:
    """Writes an image in the format of the file's suffix; creates its folder if necessary.

    Args:
        path: the file.
        pixels: (H, W) or (H, W, 3 or 4), channels in OpenCV's order, blue first.
        options: options of OpenCV's encoder; None = quality 88 for JPEG, OpenCV's defaults for other formats.
        durable: as for ``write_file``.

    Raises:
        WriteError: the file cannot be written, or its suffix is not that of an image format.
    """
    path = Path(path)
    if options is None:
        options = (cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY) if path.suffix.lower() in (".jpg", ".jpeg") else ()
    try:
        encoded, data = cv2.imencode(path.suffix, np.ascontiguousarray(pixels), list(options))
    except cv2.error:
        encoded, data = False, np.zeros(0, dtype=np.uint8)
    if not encoded:
        raise _no_image_format(path)
    write_file(path, data.tobytes(), durable=durable)


def check_picture_suffix(path: Path) -> None:
    """Checks that an image can be written to a file of this name, before it is made.

    Raises:
        WriteError: the suffix is not that of an image format.
    """
    if not cv2.haveImageWriter(path.name):
        raise _no_image_format(path)


def write_array(path: str | Path, values: NDArray[Any], *, durable: bool = True) -> None:
    """Writes an array in NumPy's format; creates its folder if necessary.

    Args:
        path: the file, with suffix .npy.
        values: array of any shape.
        durable: as for ``write_file``.

    Raises:
        WriteError: the file cannot be written.
    """
    content = io.BytesIO()
    np.save(content, values)
    write_file(path, content.getvalue(), durable=durable)


def _no_image_format(path: Path) -> WriteError:
    return WriteError(f"cannot write {path}: its suffix is that of no image format; the name must end in {', '.join(SUFFIXES)}")
