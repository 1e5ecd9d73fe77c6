"""Conversions between ROS messages and the types of this package."""

from __future__ import annotations

import math
import re
from typing import Any

import cv2
import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Twist, TwistStamped
from sensor_msgs.msg import CompressedImage, Image as ImageMsg

from gibson_path_following.errors import ViewError, quoted
from gibson_path_following.images.cameras import Calibration
from gibson_path_following.images.image_header import deep_png_encoding, image_size
from gibson_path_following.types import Image, Velocity

NS_PER_S = 1_000_000_000
MAX_PIXELS = 2**25
"""Pixels of an image."""
_TO_RGB = {
    "rgb8": (3, None), "bgr8": (3, cv2.COLOR_BGR2RGB), "rgba8": (4, cv2.COLOR_RGBA2RGB), "bgra8": (4, cv2.COLOR_BGRA2RGB),
    "mono8": (1, cv2.COLOR_GRAY2RGB), "8UC1": (1, cv2.COLOR_GRAY2RGB), "8UC3": (3, cv2.COLOR_BGR2RGB),
    # OpenCV names a Bayer pattern by its second row, ROS by its first.
    "bayer_rggb8": (1, cv2.COLOR_BayerBG2RGB), "bayer_bggr8": (1, cv2.COLOR_BayerRG2RGB),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGR2RGB), "bayer_grbg8": (1, cv2.COLOR_BayerGB2RGB),
    "uyvy": (2, cv2.COLOR_YUV2RGB_UYVY), "yuv422": (2, cv2.COLOR_YUV2RGB_UYVY),
    "yuyv": (2, cv2.COLOR_YUV2RGB_YUYV), "yuv422_yuy2": (2, cv2.COLOR_YUV2RGB_YUYV),
}  # fmt: skip
"""Encoding -> bytes of a pixel, and how OpenCV makes RGB of it."""
_PAIRS = ("uyvy", "yuv422", "yuyv", "yuv422_yuy2")
"""Encodings that code two neighbouring pixels together."""
_MEASURED = re.compile(r"mono16|(16U|16S|32S|32F|64F)C\d+")
"""Encodings of depth and labels."""
_COMPRESSED = "/compressed"
"""End of the topics of ``sensor_msgs/CompressedImage``."""
_MIN_NORM = 0.1
"""Norm of a quaternion below which it is no rotation: that of a driver that does not set it is 0."""


def stamp_ns(stamp: Any) -> int:
    """Returns a stamp as nanoseconds."""
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


def time_msg(ns: int) -> Any:
    """Returns nanoseconds as a stamp."""
    return Time(sec=ns // NS_PER_S, nanosec=ns % NS_PER_S)


def image_type(node: Any, topic: str) -> Any:
    """Returns the type of the images on a topic: CompressedImage if its name, as given or remapped, ends in /compressed; else Image."""
    is_compressed = any(name.endswith(_COMPRESSED) for name in (topic, node.resolve_topic_name(topic)))
    return CompressedImage if is_compressed else ImageMsg


def info_topic(topic: str) -> str:
    """Returns the topic of the camera_info beside a topic of images."""
    folder = topic.removesuffix(_COMPRESSED).rpartition("/")[0]
    return f"{folder}/camera_info" if folder else "camera_info"


def rgb_of(msg: Any) -> Image:
    """Returns the pixels of a ``sensor_msgs/Image`` or ``sensor_msgs/CompressedImage``, (H, W, 3) RGB.

    Raises:
        ViewError: the image cannot be used.
    """
    return rgb_of_compressed(msg) if hasattr(msg, "format") else rgb_of_image(msg)


def rgb_of_image(msg: Any) -> Image:
    """Returns the pixels of a ``sensor_msgs/Image``, (H, W, 3) RGB.

    Raises:
        ViewError: the encoding is another one, the data do not fit the size, or such a size cannot have that encoding.
    """
    if msg.encoding not in _TO_RGB:
        raise _encoding_error(msg.encoding)
    size, code = _TO_RGB[msg.encoding]
    height, width, step = int(msg.height), int(msg.width), int(msg.step)
    if not (0 < height * width <= MAX_PIXELS and step >= width * size and len(msg.data) >= step * height):
        raise ViewError(
            f"an image of {width}x{height} {msg.encoding} pixels has {len(msg.data)} bytes in rows of {step}, must have {height} rows of "
            f"{width * size} or more, and 1 to {MAX_PIXELS} pixels; correct the camera's driver"
        )
    if width % 2 and msg.encoding in _PAIRS:
        raise ViewError(
            f"an image of {width}x{height} pixels is {msg.encoding}, which needs an even width; correct the camera's driver"
        )
    rows = np.frombuffer(msg.data, dtype=np.uint8, count=step * height).reshape(height, step)
    pixels = rows[:, : width * size].reshape(height, width, size)
    if code is None:
        return np.ascontiguousarray(pixels)
    try:
        return np.asarray(cv2.cvtColor(np.ascontiguousarray(pixels), code))
    except cv2.error as error:
        raise ViewError(f"an image of {width}x{height} pixels cannot have the encoding {msg.encoding}: {error.err}") from error


def _encoding_error(encoding: str) -> ViewError:
    name = f"an image has the encoding {quoted(encoding)}"
    if _MEASURED.fullmatch(encoding):
        return ViewError(f"{name}, that of depth and labels; choose the topic of the colour images")
    return ViewError(f"{name}, must be one of {', '.join(_TO_RGB)}; set it in the camera's driver")


def rgb_of_compressed(msg: Any) -> Image:
    """Returns the pixels of a ``sensor_msgs/CompressedImage``, (H, W, 3) RGB.

    They are the sensor's, as ``camera_info`` describes them: an EXIF orientation, which is for viewers of photographs, is ignored.

    Raises:
        ViewError: it is neither JPEG nor PNG, has more than 8 bits per channel, is too large, or cannot be decoded.
    """
    data = bytes(msg.data)
    # The format begins with the encoding before compression: "16UC1; png compressed". JPEG has 8 bits also of depth.
    encoding = msg.format.partition(";")[0].strip()
    if _MEASURED.fullmatch(encoding):
        raise _encoding_error(encoding)
    if deep := deep_png_encoding(data):
        raise _encoding_error(deep)
    # A small file may decode to gigabytes.
    size = image_size(data)
    if size is None:
        raise ViewError(
            f"a compressed image of {len(data)} bytes, format {quoted(msg.format)}, is neither JPEG nor PNG, or is damaged"
        )
    if not 0 < size[0] * size[1] <= MAX_PIXELS:
        raise ViewError(
            f"a compressed image has {size[0]}x{size[1]} pixels, must have 1 to {MAX_PIXELS}; make the camera's images smaller"
        )
    try:
        bgr = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error:
        bgr = None
    if bgr is None:
        raise ViewError(f"a compressed image of {len(data)} bytes, format {quoted(msg.format)}, cannot be decoded")
    return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB))


def calibration_from(msg: Any) -> Calibration | None:
    """Returns the calibration in a ``sensor_msgs/CameraInfo``; None if it says that there is none, K = 0.

    Raises:
        SettingError: its model is unknown, or its numbers cannot be.
    """
    if float(msg.k[0]) == 0.0:
        return None
    distortion = tuple(map(float, msg.d))
    if msg.distortion_model not in ("equidistant", "fisheye") and not any(distortion):
        return Calibration(int(msg.width), int(msg.height), tuple(map(float, msg.k)), (), "")
    return Calibration(int(msg.width), int(msg.height), tuple(map(float, msg.k)), distortion, str(msg.distortion_model))


def pose_from(msg: Any) -> tuple[float, float, float] | None:
    """Returns x, y and yaw of a ``nav_msgs/Odometry``, metres and radians; None if they are not finite, or there is no rotation."""
    p, q = msg.pose.pose.position, msg.pose.pose.orientation
    if not (math.isfinite(p.x) and math.isfinite(p.y) and _MIN_NORM <= math.hypot(q.x, q.y, q.z, q.w) < math.inf):
        return None
    # Of a quaternion of any norm.
    yaw = math.atan2(2.0 * (q.w * q.z + q.x * q.y), q.w * q.w + q.x * q.x - q.y * q.y - q.z * q.z)
    return float(p.x), float(p.y), yaw


def velocity_from(msg: Any) -> Velocity | None:
    """Returns the velocity in a Twist or a TwistStamped; None if it is not finite."""
    twist = msg.twist if hasattr(msg, "twist") else msg
    linear, angular = float(twist.linear.x), float(twist.angular.z)
    return Velocity(linear, angular) if math.isfinite(linear) and math.isfinite(angular) else None


def twist_msg(velocity: Velocity, ns: int, frame: str, *, stamped: bool) -> Any:
    """Returns a Twist, or a TwistStamped in ``frame``."""
    twist = Twist()
    twist.linear.x, twist.angular.z = float(velocity.linear), float(velocity.angular)
    if not stamped:
        return twist
    msg = TwistStamped(twist=twist)
    msg.header.stamp, msg.header.frame_id = time_msg(ns), frame
    return msg
