"""Photographs with an EXIF orientation, by which viewers rotate them."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

ROTATED = 6
"""Orientation: viewers rotate the image by 90 degrees clockwise."""


def jpeg_with_orientation(pixels: NDArray[np.uint8], orientation: int = ROTATED) -> bytes:
    """Returns a JPEG file of an image, (H, W, 3) BGR, whose EXIF data consist of an orientation.

    Args:
        pixels: the image.
        orientation: 1 to 8.
    """
    jpeg: Any = cv2.imencode(".jpg", pixels, (cv2.IMWRITE_JPEG_QUALITY, 100))[1]
    # A TIFF header and one entry: tag 0x0112, type SHORT, one value.
    exif = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0" + bytes([orientation, 0, 0, 0]) + bytes(4)
    return jpeg.tobytes()[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif + jpeg.tobytes()[2:]
