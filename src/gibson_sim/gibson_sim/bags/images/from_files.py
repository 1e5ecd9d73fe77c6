"""Writes a bag from photographs or a video: images as a camera driver publishes them, with camera_info, for programs that only read bags.

Must not import rclpy.
"""

from __future__ import annotations

import math
import re
import shutil
from collections.abc import Generator, Iterator
from contextlib import closing
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_typestore

from gibson_sim import reading
from gibson_sim.bags.images.decode import COMPRESSED, IMAGE
from gibson_sim.bags.progress import Advance, no_progress
from gibson_sim.bags.writer import BagWriter
from gibson_sim.errors import GibsonSimError, RecordError
from gibson_sim.formats.textures import decode_pixels
from gibson_sim.quoting import quoted
from gibson_sim.sensors.image_codecs import color_format, encode_color
from gibson_sim.types import NS_PER_S

SUFFIXES = (".jpg", ".jpeg", ".png")
"""Suffixes of the photographs in a folder."""
FIRST_STAMP_NS = NS_PER_S
"""Stamp of the first image, ns; not 0, which is an invalid time in ROS."""
FOLDER_RATE_HZ = 5.0
"""Default rate of the images of a folder, Hz."""
_CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
_MAX_FILE_BYTES = 256 * 2**20
_ROUNDING_NS = 1_000_000
"""Tolerance of the rounded times of video frames, ns."""
_TOPIC = re.compile(r"/[A-Za-z_]\w*(/[A-Za-z_]\w*)*")
_FRAME = re.compile(r"[\w/.-]{1,200}")
U8 = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class CameraSettings:
    """Topic and format of the images, and parameters of their camera."""

    topic: str = "/camera/image_raw"
    """Topic of the images; camera_info is in the same namespace."""
    rate_hz: float | None = None
    """Images per second: rate of the images of a folder (None = 5), maximum rate of the images of a video (None = all)."""
    frame: str = "camera_optical_frame"
    """Frame of the images."""
    hfov_deg: float | None = None
    """Horizontal field of view of a pinhole camera, degrees; None = not calibrated, K is 0."""
    compressed: bool = False
    """Whether the images are JPEG, on ``<topic>/compressed``."""

    def __post_init__(self) -> None:
        if not _TOPIC.fullmatch(self.topic):
            raise RecordError(f"topic {quoted(self.topic)} is not a full topic name; give one such as /camera/image_raw")
        if not _FRAME.fullmatch(self.frame):
            raise RecordError(f"frame {quoted(self.frame)} is not a frame name; give one such as camera_optical_frame")
        if self.rate_hz is not None and not 0.001 <= self.rate_hz <= 1000.0:
            raise RecordError(f"rate is {self.rate_hz:g} Hz, must be 0.001 to 1000")
        if self.hfov_deg is not None and not 1.0 <= self.hfov_deg <= 175.0:
            raise RecordError(f"hfov is {self.hfov_deg:g} degrees, must be 1 to 175, as of a pinhole camera")


@dataclass(frozen=True, slots=True)
class WrittenBag:
    """The written bag."""

    folder: Path
    images: int
    width: int
    height: int
    """Size of each image, pixels."""
    seconds: float
    """Time from the first image to the last."""
    topics: tuple[str, str]
    """Topics of the images and of camera_info."""
    is_calibrated: bool

    def text(self) -> str:
        """Returns one line for a user."""
        hint = "" if self.is_calibrated else "; camera_info is not calibrated, --hfov DEG gives it a field of view"
        return (
            f"wrote {self.folder}: {self.images} images of {self.width}x{self.height} over {self.seconds:.2f} s on {self.topics[0]} "
            f"and {self.topics[1]}{hint}"
        )


def write_bag(source: Path, folder: Path, settings: CameraSettings | None = None, advance: Advance = no_progress) -> WrittenBag:
    """Writes a bag of the images of a folder, in natural order of their names, or of a video.

    Args:
        source: folder of .jpg and .png files, or a video file.
        folder: new folder of the bag; it is removed if this fails.
        settings: topic, format and camera of the images.
        advance: receives the completed fraction.

    Raises:
        RecordError: there are no images, an image cannot be read or has another size, or the bag cannot be written.
    """
    settings = settings or CameraSettings()
    frames = _photographs(source, settings, advance) if reading.is_folder(source) else _video(source, settings, advance)
    with closing(frames):
        first = next(frames, None)
        if first is None:
            raise RecordError(f"{source} holds no image; a folder needs files whose names end in {', '.join(SUFFIXES)}")
        size = (first.rgb.shape[1], first.rgb.shape[0])
        writer = BagWriter(folder)
        try:
            with writer:
                messages, count, last = _Messages(settings, size), 0, first
                for topic, type_name in messages.types.items():
                    writer.add_topic(topic, type_name)
                for frame in chain((first,), frames):
                    if frame.rgb.shape[:2] != first.rgb.shape[:2]:
                        raise RecordError(
                            f"{frame.name} has {frame.rgb.shape[1]}x{frame.rgb.shape[0]} pixels, the first image {size[0]}x{size[1]}; "
                            "all must have one size"
                        )
                    for topic, data in messages.of(frame):
                        writer.write(topic, data, frame.stamp_ns, frame.stamp_ns)
                    count, last = count + 1, frame
        except GibsonSimError:
            shutil.rmtree(folder, ignore_errors=True)
            raise
    image_topic, info_topic = messages.types
    seconds = (last.stamp_ns - first.stamp_ns) / NS_PER_S
    return WrittenBag(folder, count, *size, seconds, (image_topic, info_topic), settings.hfov_deg is not None)


@dataclass(frozen=True, slots=True)
class _Frame:
    """One image, (H, W, 3) RGB, with its stamp and a name for messages."""

    stamp_ns: int
    rgb: U8
    name: str


def _photographs(folder: Path, settings: CameraSettings, advance: Advance) -> Generator[_Frame, None, None]:
    try:
        files = [path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES]
    except OSError as error:
        raise RecordError(f"cannot read {folder}: {error.strerror}") from error
    rate_hz = settings.rate_hz or FOLDER_RATE_HZ
    for number, path in enumerate(sorted(files, key=lambda path: _natural(path.name))):
        try:
            data = reading.read_file(path, _MAX_FILE_BYTES)
        except OSError as error:
            raise RecordError(f"cannot read {path}: {error.strerror}") from error
        bgr = decode_pixels(data, cv2.IMREAD_COLOR)  # rotated according to its EXIF data
        if bgr is None:
            raise RecordError(
                f"{path} cannot be decoded as an image, or is too large; remove it from the folder or scale it down"
            )
        yield _Frame(
            FIRST_STAMP_NS + round(number * NS_PER_S / rate_hz), np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB)), path.name
        )
        advance((number + 1) / len(files))


def _video(path: Path, settings: CameraSettings, advance: Advance) -> Generator[_Frame, None, None]:
    if not reading.is_file(path):
        raise RecordError(f"{path} is neither a folder of images nor a video file")
    try:
        with av.open(str(path)) as container:
            if not container.streams.video:
                raise RecordError(f"{path} has no video stream; give a video, or a folder of images")
            stream = container.streams.video[0]
            duration = float(container.duration or 0) / av.time_base
            period_ns = 0 if settings.rate_hz is None else NS_PER_S / settings.rate_hz
            begin_s: float | None = None
            frame_count = 0
            before_ns = -1
            for number, frame in enumerate(container.decode(stream)):
                if frame.time is None:
                    raise RecordError(f"{path} has frames without time; write it anew, or give its frames as a folder of images")
                begin_s = frame.time if begin_s is None else begin_s
                time_ns = round((frame.time - begin_s) * NS_PER_S)
                if time_ns <= before_ns or time_ns < frame_count * period_ns - _ROUNDING_NS:
                    continue
                frame_count, before_ns = frame_count + 1, time_ns
                rgb = np.rot90(frame.to_ndarray(format="rgb24"), round(frame.rotation / 90))
                yield _Frame(FIRST_STAMP_NS + time_ns, np.ascontiguousarray(rgb), f"frame {number} of {path.name}")
                advance(min(1.0, time_ns / NS_PER_S / duration) if duration > 0.0 else 0.0)
    except (av.FFmpegError, OSError) as error:
        raise RecordError(f"{path} cannot be decoded as a video: {error.strerror or error}") from error


class _Messages:
    """Converts frames to messages."""

    def __init__(self, settings: CameraSettings, size: tuple[int, int]) -> None:
        """``size``: (width, height), pixels."""
        self._settings, self._size = settings, size
        self._store = get_typestore(Stores.ROS2_JAZZY)
        image = f"{settings.topic}/compressed" if settings.compressed else settings.topic
        info = f"{settings.topic.rpartition('/')[0]}/camera_info"
        self.types = {image: COMPRESSED if settings.compressed else IMAGE, info: _CAMERA_INFO}
        """Topic -> type: of the images, and of their camera_info."""

    def of(self, frame: _Frame) -> Iterator[tuple[str, bytes]]:
        """Yields the messages of a frame, each with its topic: camera_info first, since receivers need it to use the image."""
        types = self._store.types
        stamp = types["builtin_interfaces/msg/Time"](sec=frame.stamp_ns // NS_PER_S, nanosec=frame.stamp_ns % NS_PER_S)
        header = types["std_msgs/msg/Header"](stamp=stamp, frame_id=self._settings.frame)
        (image_topic, image_type), (info_topic, info_type) = self.types.items()
        yield info_topic, bytes(self._store.serialize_cdr(self._info(header), info_type))
        yield image_topic, bytes(self._store.serialize_cdr(self._image(header, frame.rgb), image_type))

    def _image(self, header: Any, rgb: U8) -> Any:
        if self._settings.compressed:
            return self._store.types[COMPRESSED](header=header, format=color_format("jpeg"), data=encode_color(rgb, "jpeg"))
        height, width = rgb.shape[:2]
        return self._store.types[IMAGE](
            header=header, height=height, width=width, encoding="rgb8", is_bigendian=0, step=3 * width, data=rgb.reshape(-1)
        )

    def _info(self, header: Any) -> Any:
        (width, height), hfov_deg = self._size, self._settings.hfov_deg
        k, p = np.zeros(9), np.zeros(12)
        if hfov_deg is not None:
            focal = width / 2 / math.tan(math.radians(hfov_deg) / 2)
            k[[0, 2, 4, 5, 8]] = p[[0, 2, 5, 6, 10]] = (focal, (width - 1) / 2, focal, (height - 1) / 2, 1.0)
        roi = self._store.types["sensor_msgs/msg/RegionOfInterest"](x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
        return self._store.types[_CAMERA_INFO](
            header=header, height=height, width=width, distortion_model="plumb_bob", d=np.zeros(5), k=k, r=np.eye(3).reshape(-1), p=p,
            binning_x=0, binning_y=0, roi=roi,
        )  # fmt: skip


def _natural(name: str) -> list[tuple[int, int, str]]:
    """Returns a sort key that sorts frame2 before frame10."""
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in re.split(r"([0-9]{1,30})", name) if part]
