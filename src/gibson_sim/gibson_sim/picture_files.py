"""Writes pictures through ``writing``: OpenCV's own way prints a warning and says no reason where a disk is full."""

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
"""How the names of pictures that are asked for may end."""
_JPEG_QUALITY = 88


def write_picture(path: str | Path, pixels: NDArray[Any], options: Sequence[int] | None = None, *, durable: bool = True) -> None:
    """Writes a picture in the format that the name says; its folder is made where it is missing.

    Args:
        path: of the file.
        pixels: (H, W) or (H, W, 3 or 4), channels in OpenCV's order: blue first.
        options: of the encoder, as OpenCV takes them; None = JPEG at quality 88, the others as OpenCV writes them.
        durable: as of ``write_file``.

    Raises:
        WriteError: it cannot be written, or no format ends so.
    """
    path = Path(path)
    if options is None:
        options = (cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY) if path.suffix.lower() in (".jpg", ".jpeg") else ()
    try:
        done, data = cv2.imencode(path.suffix, np.ascontiguousarray(pixels), list(options))
    except cv2.error:
        done, data = False, np.zeros(0, dtype=np.uint8)
    if not done:
        raise WriteError(f"cannot write {path}: no picture ends so; the name must end in {', '.join(SUFFIXES)}")
    write_file(path, data.tobytes(), durable=durable)


def write_array(path: str | Path, values: NDArray[Any], *, durable: bool = True) -> None:
    """Writes an array as NumPy reads it; its folder is made where it is missing.

    Args:
        path: of the file, whose name ends in .npy.
        values: of any shape.
        durable: as of ``write_file``.

    Raises:
        WriteError: it cannot be written.
    """
    content = io.BytesIO()
    np.save(content, values)
    write_file(path, content.getvalue(), durable=durable)
