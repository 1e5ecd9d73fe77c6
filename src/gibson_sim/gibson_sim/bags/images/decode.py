"""Decodes compressed images of bags, so that readers of images can read both raw and compressed ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import RecordError
from gibson_sim.formats.textures import decode_pixels
from gibson_sim.quoting import quoted
from gibson_sim.sensors.image_codecs import decode_depth, is_compressed_depth

IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
IMAGE_TYPES = (IMAGE, COMPRESSED)
SUFFIXES = ("/compressed", "/compressedDepth")
"""Suffixes of image_transport's topics of compressed images."""


@dataclass(frozen=True, slots=True, eq=False)
class DecodedImage:
    """A decoded image, with the fields of ``sensor_msgs/Image``."""

    header: Any
    encoding: str
    height: int
    width: int
    step: int
    """Size of a row, bytes."""
    data: NDArray[np.uint8]
    """Rows, (N,), little-endian."""
    is_bigendian: int = 0


def raw_image(msg: Any) -> Any:
    """Returns an image with the fields of ``sensor_msgs/Image``: the message itself, or a decoded ``sensor_msgs/CompressedImage``.

    Compressed colour images are decoded to bgr8 or mono8, 16-bit images to the encoding in ``format``, compressedDepth to 32FC1 or 16UC1.

    Raises:
        RecordError: the image is neither JPEG nor PNG, or is damaged.
    """
    if not hasattr(msg, "format"):
        return msg
    original = msg.format.partition(";")[0].strip()
    encoding, pixels = _decoded(bytes(msg.data), msg.format, original)
    pixels = np.ascontiguousarray(pixels)
    return DecodedImage(
        msg.header, encoding, pixels.shape[0], pixels.shape[1], pixels.strides[0], pixels.view(np.uint8).reshape(-1)
    )


def _decoded(data: bytes, image_format: str, original: str) -> tuple[str, NDArray[Any]]:
    """Returns encoding and pixels, (H, W) or (H, W, C)."""
    if is_compressed_depth(image_format):
        depth = decode_depth(data, metric=original == "32FC1")
        if depth is None:
            raise _unreadable(image_format)
        return ("32FC1" if depth.dtype == np.float32 else "16UC1"), depth
    pixels = decode_pixels(data, cv2.IMREAD_UNCHANGED)
    if pixels is None:
        raise _unreadable(image_format)
    if pixels.ndim == 3:
        encodings = {(np.dtype(np.uint8), 3): "bgr8", (np.dtype(np.uint8), 4): "bgra8"}
        encoding = encodings.get((pixels.dtype, pixels.shape[2]))
        if encoding is None:
            raise _unreadable(image_format)
        return encoding, pixels
    if pixels.dtype == np.uint16:
        return ("mono16" if original == "mono16" else "16UC1"), pixels
    return "mono8", pixels


def _unreadable(image_format: str) -> RecordError:
    return RecordError(
        f"a compressed image of format {quoted(image_format)} cannot be decoded: it must be JPEG or PNG, and whole"
    )


def base_topic(topic: str) -> str:
    """Returns the topic of the raw image: ``/camera/image_raw`` for ``/camera/image_raw/compressed``."""
    for suffix in SUFFIXES:
        if topic.endswith(suffix):
            return topic.removesuffix(suffix)
    return topic
