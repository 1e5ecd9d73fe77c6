"""Finds the cameras of a bag, the topics of their images, and their stamps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.bags.images.decode import COMPRESSED, IMAGE, base_topic, raw_image
from gibson_sim.bags.reader import BagReader, image_to_array
from gibson_sim.bags.stamps import stamp_ns, time_from_msg
from gibson_sim.errors import RecordError
from gibson_sim.quoting import quoted
from gibson_sim.sensors.image_codecs import decode_color, without_exif

INFO = "sensor_msgs/msg/CameraInfo"
Kind = Literal["color", "depth", "labels", "vectors"]
_COLORS = ("rgb8", "bgr8", "rgba8", "bgra8", "mono8")
_DEPTHS = ("32FC1", "16UC1", "mono16")
_VECTORS = ("32FC2", "32FC3")
_TO_BGR = {"rgb8": cv2.COLOR_RGB2BGR, "rgba8": cv2.COLOR_RGBA2BGR, "bgra8": cv2.COLOR_BGRA2BGR, "mono8": cv2.COLOR_GRAY2BGR}
_TRANSPORT_PARTS = (
    "compressed",
    "compressedDepth",
    "image",
    "image_raw",
    "image_rect",
    "image_color",
    "image_rect_color",
    "image_rect_raw",
    "image_mono",
)


@dataclass(frozen=True, slots=True)
class Stream:
    """One image topic."""

    topic: str
    type_name: str
    kind: Kind
    encoding: str
    """Encoding of the pixels; for compressed colour images the file suffix, ``jpg`` or ``png``."""
    frame_id: str
    width: int
    height: int

    @property
    def folder(self) -> tuple[str, ...]:
        """Parts of the topic's name without those that image_transport adds."""
        parts = self.topic.strip("/").split("/")
        while len(parts) > 1 and parts[-1] in _TRANSPORT_PARTS:
            parts.pop()
        return tuple(parts)


@dataclass(frozen=True, slots=True)
class Lens:
    """Intrinsics as in sensor_msgs/CameraInfo."""

    model: str
    """``distortion_model``."""
    k: tuple[float, ...]
    """Intrinsic matrix, nine numbers, row-major, pixels; pixel centres are at integer coordinates."""
    d: tuple[float, ...]

    @property
    def is_projective(self) -> bool:
        """Whether K projects directions into the image."""
        return len(self.k) == 9 and self.k[0] > 0.0 and self.k[4] > 0.0


@dataclass(frozen=True, slots=True)
class ExportCamera:
    """Images with one frame and one lens: a colour camera with its pixel-aligned outputs, or a depth camera alone."""

    name: str
    """Name that is valid in file names."""
    path: str
    """Namespace of its topics without the leading slash; the name of the camera in a scene."""
    frame_id: str
    width: int
    height: int
    streams: dict[str, Stream]
    """Output (rgb, depth, semantic, ...) -> stream."""
    lens: Lens | None
    stamps: dict[str, NDArray[np.int64]] = field(default_factory=dict)
    """Output -> stamps, nanoseconds, increasing."""

    @property
    def first(self) -> str:
        """The output whose stamps define the frames: colour if there is one."""
        return next((output for output in ("rgb", "depth") if output in self.streams), next(iter(self.streams)))


def find_cameras(
    bag: BagReader, topics: Sequence[str] = (), begin_ns: int | None = None, end_ns: int | None = None
) -> tuple[tuple[ExportCamera, ...], tuple[str, ...]]:
    """Returns the cameras of a bag with the stamps of their images between two log times, and one note on each topic left out.

    Raises:
        RecordError: the bag has no images, or lacks a requested topic.
    """
    infos = bag.topics()
    unknown = [topic for topic in topics if topic not in infos]
    if unknown:
        raise RecordError(f"bag {bag.folder} has no topic {', '.join(unknown)}; it has {', '.join(infos)}")
    notes: list[str] = []
    streams = []
    for topic, info in infos.items():
        if info.type_name in (IMAGE, COMPRESSED) and info.count and (not topics or topic in topics):
            stream_or_reason = _stream(bag, topic, info.type_name)
            if isinstance(stream_or_reason, str):
                notes.append(f"{topic} is left out: {stream_or_reason}")
            else:
                streams.append(stream_or_reason)
    if not streams:
        raise RecordError(
            f"bag {bag.folder} has no images that can be exported" + (f" ({'; '.join(notes)})" if notes else "")
            + ": record sensor_msgs/Image or CompressedImage topics, or render them with `gibson-sim render`"
        )  # fmt: skip
    cameras = _grouped(bag, streams, notes)
    stamps = _stamps(bag, [stream.topic for camera in cameras for stream in camera.streams.values()], begin_ns, end_ns)
    for camera in cameras:
        camera.stamps.update({output: stamps[stream.topic] for output, stream in camera.streams.items()})
    return tuple(camera for camera in cameras if len(camera.stamps[camera.first])), tuple(notes)


def _stream(bag: BagReader, topic: str, type_name: str) -> Stream | str:
    """Returns the stream of a topic by its first message, or the reason why it cannot be exported."""
    msg = bag.first(topic)
    if type_name == COMPRESSED:
        try:
            image = raw_image(msg)
        except RecordError:
            return f"its format {quoted(msg.format)} is neither JPEG nor PNG"
        if image.encoding not in _COLORS:
            of_16_bits: Kind = _kind(image.encoding, topic) or "labels"
            return Stream(topic, type_name, of_16_bits, image.encoding, msg.header.frame_id, image.width, image.height)
        suffix = "png" if bytes(msg.data[:4]) == b"\x89PNG" else "jpg"
        return Stream(topic, type_name, "color", suffix, msg.header.frame_id, image.width, image.height)
    kind = _kind(msg.encoding, topic)
    if kind is None:
        return (
            f"encoding {quoted(msg.encoding)} is not supported: convert it to one of {', '.join((*_COLORS, *_DEPTHS, *_VECTORS))}"
        )
    return Stream(topic, type_name, kind, msg.encoding, msg.header.frame_id, msg.width, msg.height)


def _kind(encoding: str, topic: str) -> Kind | None:
    if encoding in _COLORS:
        return "color"
    if encoding in _VECTORS:
        return "vectors"
    if encoding in _DEPTHS:
        return "depth" if encoding == "32FC1" or "depth" in topic else "labels"
    return None


def _grouped(bag: BagReader, streams: Sequence[Stream], notes: list[str]) -> list[ExportCamera]:
    """Groups streams into cameras: each colour stream with the others of its frame and size whose names are nearest; then the rest."""
    members: dict[tuple[str, ...], dict[str, Stream]] = {}
    colors = sorted((s for s in streams if s.kind == "color"), key=lambda s: (s.type_name == COMPRESSED, s.topic))
    for stream in colors:
        if "rgb" in members.setdefault(stream.folder, {}):
            notes.append(f"{stream.topic} is left out: {members[stream.folder]['rgb'].topic} shows the same")
        else:
            members[stream.folder]["rgb"] = stream
    others = sorted((s for s in streams if s.kind != "color"), key=lambda s: (s.type_name == COMPRESSED, s.topic))
    raw = {stream.topic for stream in others if stream.type_name == IMAGE}
    for stream in others:
        if stream.type_name == COMPRESSED and base_topic(stream.topic) in raw:
            notes.append(f"{stream.topic} is left out: {base_topic(stream.topic)} shows the same")
            continue
        alike = [
            folder
            for folder, outputs in members.items()
            if _common(folder, stream.folder)
            and {(s.frame_id, s.width, s.height) for s in outputs.values()} == {(stream.frame_id, stream.width, stream.height)}
        ]
        output = "depth" if stream.kind == "depth" else stream.folder[-1]
        parent = max(alike, key=lambda folder: _common(folder, stream.folder), default=stream.folder[:-1] or stream.folder)
        if output in members.setdefault(parent, {}):
            parent = stream.folder
        members.setdefault(parent, {})[output] = stream
    lenses = _lenses(bag)
    return [
        ExportCamera(
            "_".join(folder),
            "/".join(folder),
            first.frame_id,
            first.width,
            first.height,
            outputs,
            _lens_of(lenses, outputs.values()),
        )
        for folder, outputs in members.items()
        if outputs
        for first in [next(iter(outputs.values()))]
    ]


def _common(a: tuple[str, ...], b: tuple[str, ...]) -> int:
    """Returns the length of the common prefix of two names, in parts."""
    return next((i for i, (x, y) in enumerate(zip(a, b, strict=False)) if x != y), min(len(a), len(b)))


def _lenses(bag: BagReader) -> dict[str, Lens]:
    """Returns the calibration of each camera_info topic by its first message."""
    lenses = {}
    for topic, info in bag.topics().items():
        if info.type_name == INFO and info.count:
            msg = bag.first(topic)
            lenses[topic] = Lens(msg.distortion_model, tuple(map(float, msg.k)), tuple(map(float, msg.d)))
    return lenses


def _lens_of(lenses: dict[str, Lens], streams: Any) -> Lens | None:
    """Returns the first calibration beside a stream: ``camera_info`` in the same namespace, as in image_transport."""
    for stream in streams:
        parts = base_topic(stream.topic).split("/")
        if (topic := "/".join((*parts[:-1], "camera_info"))) in lenses:
            return lenses[topic]
    return None


def _stamps(bag: BagReader, topics: Sequence[str], begin_ns: int | None, end_ns: int | None) -> dict[str, NDArray[np.int64]]:
    stamps_by_topic: dict[str, list[int]] = {topic: [] for topic in topics}
    for topic, _, data in bag.raw_messages(topics, start_ns=begin_ns, stop_ns=end_ns):
        stamps_by_topic[topic].append(stamp_ns(data))
    return {topic: np.unique(np.array(stamps, dtype=np.int64)) for topic, stamps in stamps_by_topic.items()}


def nearest(stamps: NDArray[np.int64], stamp: int, most_ns: int) -> int | None:
    """Returns the nearest stamp; None if none is within ``most_ns``."""
    if not len(stamps):
        return None
    at = int(np.searchsorted(stamps, stamp))
    best = min((int(stamps[i]) for i in (at - 1, at) if 0 <= i < len(stamps)), key=lambda s: abs(s - stamp))
    return best if abs(best - stamp) <= most_ns else None


@dataclass(frozen=True, slots=True, eq=False)
class CameraImage:
    """One image of a camera."""

    camera: ExportCamera
    output: str
    stamp_ns: int
    message: Any

    @property
    def stream(self) -> Stream:
        """Stream of the image."""
        return self.camera.streams[self.output]

    def encoded(self) -> bytes | None:
        """Returns the JPEG or PNG bytes of a compressed colour image, without EXIF data; None otherwise."""
        is_encoded = self.stream.type_name == COMPRESSED and self.stream.kind == "color"
        return without_exif(bytes(self.message.data)) if is_encoded else None

    def bgr(self) -> NDArray[np.uint8]:
        """Returns a colour image, (H, W, 3) uint8, blue first."""
        if self.stream.type_name == COMPRESSED:
            decoded = decode_color(bytes(self.message.data))
            if decoded is None:
                raise RecordError(f"{self.stream.topic}: an image is neither JPEG nor PNG, or is broken; leave the topic out")
            return decoded
        pixels = image_to_array(self.message)
        code = _TO_BGR.get(self.stream.encoding)
        return np.asarray(pixels if code is None else cv2.cvtColor(pixels, code), dtype=np.uint8)

    def metres(self) -> NDArray[np.float32]:
        """Returns a depth image, (H, W) float32, metres; 16-bit images are millimetres (REP 118)."""
        pixels = image_to_array(raw_image(self.message))
        return np.asarray(pixels if pixels.dtype == np.float32 else pixels * np.float32(0.001), dtype=np.float32)

    def array(self) -> NDArray[Any]:
        """Returns the unconverted pixels."""
        return image_to_array(raw_image(self.message))


def camera_images(
    bag: BagReader, cameras: Sequence[ExportCamera], begin_ns: int | None = None, end_ns: int | None = None
) -> Iterator[CameraImage]:
    """Yields the images of cameras in the order of the bag."""
    owners = {stream.topic: (camera, output) for camera in cameras for output, stream in camera.streams.items()}
    for topic, _, msg in bag.messages(list(owners), start_ns=begin_ns, stop_ns=end_ns):
        camera, output = owners[topic]
        yield CameraImage(camera, output, time_from_msg(msg.header.stamp), msg)


def depth_in_units(metres: NDArray[np.float32], per_metre: float) -> NDArray[np.uint16]:
    """Returns 16-bit depth, ``per_metre`` units per metre; 0 = no surface, too far for 16 bits, or not measured (REP 118)."""
    units = np.nan_to_num(metres * np.float32(per_metre), nan=0.0, posinf=0.0, neginf=0.0).round()
    units[(units < 0) | (units > 65535)] = 0
    return np.asarray(units, dtype=np.uint16)
