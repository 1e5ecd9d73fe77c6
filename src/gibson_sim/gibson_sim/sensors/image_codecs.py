"""Compressed images in the formats of image_transport's plugins, for its subscribers, rqt and rosbag tools. Pure.

``compressed``: a JPEG or PNG file. ``compressedDepth``: a header of 12 bytes, then a 16-bit PNG. The header is an int32 (the coding:
0 = inverse depth) and two float32, A and B: a pixel value p encodes the depth A / (p - B), and 0 = no depth. The quantisation steps are
finest near the camera, like those of a stereo camera's disparity.
"""

from __future__ import annotations

import struct
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import ConfigError
from gibson_sim.formats.textures import decode_pixels

ColorCodec = Literal["jpeg", "png"]
U8 = NDArray[np.uint8]
COMPRESSED_DEPTH_FORMAT = "32FC1; compressedDepth png"
"""``format`` field of messages encoded by ``encode_depth``."""
_INVERSE_DEPTH = 0
_HEADER = struct.Struct("<iff")
_LARGEST = 2**16 - 1
_JPEG_START, _EXIF_SEGMENT, _JPEG_SCAN = b"\xff\xd8", b"\xff\xe1", b"\xff\xda"
"""Markers of JPEG: start of the file, the segment APP1, which holds EXIF data, and the start of the coded pixels."""


def color_format(codec: ColorCodec) -> str:
    """Returns the ``format`` field of messages encoded by ``encode_color``: the original encoding, and the encoding decoded by OpenCV."""
    return f"rgb8; {codec} compressed bgr8"


def encode_color(rgb: U8, codec: ColorCodec, *, jpeg_quality: int = 95, png_level: int = 3) -> U8:
    """Returns the bytes of an image file, (N,); ``cv2.imdecode`` decodes them to BGR.

    Args:
        rgb: (H, W, 3), row 0 = top; (H, W) for a greyscale image.
        codec: jpeg, small and lossy; png, lossless.
        jpeg_quality: quality, 1 to 100.
        png_level: compression level, 0 (fast) to 9 (small).

    Raises:
        ConfigError: OpenCV cannot encode the image.
    """
    bgr = cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR) if rgb.ndim == 3 else rgb
    if codec == "jpeg":
        return _encode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality])
    return _encode(".png", bgr, [cv2.IMWRITE_PNG_COMPRESSION, png_level])


def decode_color(data: bytes) -> U8 | None:
    """Returns a compressed image, (H, W, 3) BGR, or None if it cannot be decoded.

    The pixels are the sensor's, as ``camera_info`` describes them: an EXIF orientation, which is for viewers of photographs, is ignored.

    Args:
        data: bytes of a JPEG or PNG file, as from ``encode_color``.
    """
    return decode_pixels(data, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)


def without_exif(data: bytes) -> bytes:
    """Returns a JPEG file without its EXIF data, so that no reader rotates the image; any other data unchanged.

    Args:
        data: bytes of an image file.
    """
    at, kept = len(_JPEG_START), [data[: len(_JPEG_START)]]
    if kept[0] != _JPEG_START:
        return data
    while at + 4 <= len(data) and data[at] == 0xFF and data[at : at + 2] != _JPEG_SCAN:
        end = at + 2 + int.from_bytes(data[at + 2 : at + 4], "big")
        if not (data[at : at + 2] == _EXIF_SEGMENT and data[at + 4 : at + 10] == b"Exif\0\0"):
            kept.append(data[at:end])
        at = end
    return b"".join((*kept, data[at:]))


def encode_depth(
    depth: NDArray[np.float32], *, depth_max: float = 10.0, quantization: float = 100.0, png_level: int = 1
) -> bytes:
    """Returns the header and the PNG of a depth image. Values out of range, too near for 16 bits or not finite become "no depth".

    Args:
        depth: (H, W), metres.
        depth_max: depth from which values become "no depth", metres.
        quantization: at a depth of d metres the quantisation step is d^2 / (quantization (quantization + 1)) metres.
        png_level: compression level, 0 (fast) to 9 (small).

    Raises:
        ConfigError: OpenCV cannot encode the image.
    """
    a = np.float32(quantization * (quantization + 1.0))
    b = np.float32(1.0) - a / np.float32(depth_max)
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = np.rint(a / depth + b)
        # Not clipped: a wrong depth is worse than no depth.
        valid = (depth > 0.0) & (depth < depth_max) & (inverse <= _LARGEST)
    pixels = np.zeros(depth.shape, dtype=np.uint16)
    pixels[valid] = inverse[valid].astype(np.uint16)
    png = _encode(".png", pixels, [cv2.IMWRITE_PNG_COMPRESSION, png_level])
    return _HEADER.pack(_INVERSE_DEPTH, a, b) + png.tobytes()


def is_compressed_depth(image_format: str) -> bool:
    """Returns whether the ``format`` field of a message is that of compressedDepth."""
    return "compressedDepth" in image_format


def decode_depth(data: bytes, *, metric: bool = True) -> NDArray[Any] | None:
    """Returns the depth in the data of a compressedDepth message, or None if the data is damaged.

    Args:
        data: header and PNG, as from ``encode_depth``.
        metric: whether the original encoding was 32FC1 instead of 16UC1.

    Returns:
        (H, W) float32, metres, NaN = no depth; for 16UC1, (H, W) uint16, unit of the original.
    """
    if len(data) <= _HEADER.size:
        return None
    _, a, b = _HEADER.unpack_from(data)
    pixels = decode_pixels(data[_HEADER.size :], cv2.IMREAD_UNCHANGED)
    if pixels is None or pixels.dtype != np.uint16 or pixels.ndim != 2:
        return None
    if not metric:
        return pixels
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.float32(a) / (pixels.astype(np.float32) - np.float32(b))
    depth[pixels == 0] = np.nan
    return np.asarray(depth, dtype=np.float32)


def encode_png(pixels: NDArray[Any], level: int) -> U8:
    """Returns the bytes of a lossless PNG, (N,).

    Args:
        pixels: (H, W), uint8 or uint16.
        level: compression level, 0 (fast) to 9 (small).

    Raises:
        ConfigError: OpenCV cannot encode the image.
    """
    return _encode(".png", pixels, [cv2.IMWRITE_PNG_COMPRESSION, level])


def _encode(suffix: str, pixels: NDArray[Any], flags: list[int]) -> U8:
    try:
        written, data = cv2.imencode(suffix, pixels, flags)
    except cv2.error as error:
        raise ConfigError(f"an image of {pixels.shape[1]}x{pixels.shape[0]} cannot be written as {suffix}: {error}") from error
    if not written:
        raise ConfigError(f"an image of {pixels.shape[1]}x{pixels.shape[0]} cannot be written as {suffix}")
    return np.asarray(data, dtype=np.uint8).ravel()
